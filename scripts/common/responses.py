"""Comparison and plots of the bench's two frequency responses."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from common.report import with_prefix
from nassim import FRF, LinearModel, frequency_response
from nassim.plotting import plot_frf, plot_frf_error, plt


def compare_frf(estimated: FRF, model: LinearModel, *, least_coherence: float = 0.99) -> dict[str, float]:
    """Return `frf_errors` of each output alone, under `output_key`."""
    result = {}
    for output in estimated.outputs:
        result |= with_prefix(output, frf_errors(estimated, model, [output], least_coherence=least_coherence))
    return result


def frf_errors(estimated: FRF, model: LinearModel, outputs: Sequence[str], *, least_coherence: float) -> dict[str, Any]:
    """Return the largest difference in dB and degrees where coherence is high, and the share of these lines.

    The differences are those from all inputs to some outputs. They are None where coherence is nowhere high.
    """
    assert estimated.coherence is not None
    rows = [estimated.outputs.index(output) for output in outputs]
    good = estimated.coherence[rows] > least_coherence
    reference = frequency_response(model, estimated.frequency)
    pairs = [(output, name) for output in outputs for name in estimated.inputs]
    ratio = np.array([estimated.response(*pair) / reference.response(*pair) for pair in pairs])
    ratio = ratio[np.repeat(good, len(estimated.inputs), axis=0)]
    return {
        "magnitude_error_dB": float(np.max(np.abs(20 * np.log10(np.abs(ratio))))) if good.any() else None,
        "phase_error_deg": float(np.max(np.abs(np.angle(ratio, deg=True)))) if good.any() else None,
        "coherent_share": float(np.mean(good)),
    }


COMPARED = {
    "magnitude error [dB]": "magnitude_error_dB:.2f",
    "phase error [deg]": "phase_error_deg:.2f",
    "coherent [%]": "coherent_share*100:.0f",
}
"""Columns of the table of `frf_errors`."""


def plot_bode_pair(frfs: list[FRF], *, markers: list[str] | None = None) -> list[Any]:
    """Plot the bench's two FRFs side by side; return the Axes."""
    columns = plt.figure(figsize=(13, 7), layout="constrained").subfigures(1, 2)
    axes: list[Any] = []
    for column, (output, unit) in zip(columns, (("sensor_voltage", "V/V"), ("encoder", "m/V")), strict=True):
        axes += plot_frf(frfs, output=output, input="actuator_voltage", unit=unit, markers=markers or [], figure=column)
    return axes


def plot_error_pair(frfs: list[FRF], references: list[FRF]) -> list[Any]:
    """Plot errors of the bench's two FRFs side by side; return the Axes."""
    columns = plt.figure(figsize=(13, 6), layout="constrained").subfigures(1, 2)
    axes: list[Any] = []
    for column, output in zip(columns, ("sensor_voltage", "encoder"), strict=True):
        axes += plot_frf_error(frfs, references, output=output, input="actuator_voltage", figure=column)
    return axes
