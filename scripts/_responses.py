"""The bench's two frequency responses: compared and drawn side by side."""

from typing import Any

import numpy as np

from nassim import FRF, LinearModel, frequency_response
from nassim.plotting import plot_frf, plot_frf_error, plt


def compare_frf(estimated: FRF, model: LinearModel, *, least_coherence: float = 0.99) -> dict[str, float]:
    """Largest difference in dB and degrees per output, where the coherence is high, and in what share."""
    reference = frequency_response(model, estimated.frequency)
    result = {}
    for row, output in enumerate(estimated.outputs):
        assert estimated.coherence is not None
        good = estimated.coherence[row] > least_coherence
        ratio = estimated.values[row, 0, good] / reference.values[row, 0, good]
        result[f"{output}_magnitude_error_dB"] = float(np.max(np.abs(20 * np.log10(np.abs(ratio))), initial=0.0))
        result[f"{output}_phase_error_deg"] = float(np.max(np.abs(np.angle(ratio, deg=True)), initial=0.0))
        result[f"{output}_coherent_share"] = float(np.mean(good))
    return result


COMPARED = {
    "magnitude [dB]": "magnitude_error_dB:.2f",
    "phase [deg]": "phase_error_deg:.2f",
    "coherent [%]": "coherent_share*100:.0f",
}
"""Columns that print what `compare_frf` gives for an output."""


def plot_bode_pair(frfs: list[FRF], *, markers: list[str] | None = None) -> list[Any]:
    """The bench's two FRFs side by side in one figure; returns the Axes."""
    columns = plt.figure(figsize=(13, 7), layout="constrained").subfigures(1, 2)
    axes: list[Any] = []
    for column, (output, unit) in zip(columns, (("sensor_voltage", "V/V"), ("encoder", "m/V")), strict=True):
        axes += plot_frf(frfs, output=output, input="actuator_voltage", unit=unit, markers=markers or [], figure=column)
    return axes


def plot_error_pair(frfs: list[FRF], references: list[FRF]) -> list[Any]:
    """Errors of the bench's two FRFs side by side in one figure; returns the Axes."""
    columns = plt.figure(figsize=(13, 6), layout="constrained").subfigures(1, 2)
    axes: list[Any] = []
    for column, output in zip(columns, ("sensor_voltage", "encoder"), strict=True):
        axes += plot_frf_error(frfs, references, output=output, input="actuator_voltage", figure=column)
    return axes
