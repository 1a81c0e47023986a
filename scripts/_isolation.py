"""How well benches keep the ground's motion and forces off their payload."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from nassim import FRF, Scene, frequency_response, linearize
from nassim.plotting import plot_frf, plt, save_figure
from nassim.simulation import linearize_closed
from nassim.systems import transmissibility

ISOLATION = {
    "ground to payload, 500 Hz": "transmissibility_500_Hz:.5f",
    "compliance, 1 Hz [um/N]": "compliance_1_Hz_um_per_N:.3f",
    "largest [um/N]": "largest_compliance_um_per_N:.3f",
}
"""Columns that print `isolation_figures`."""


def responses(scenes: Mapping[str, Scene], frequency: np.ndarray) -> tuple[list[FRF], list[FRF]]:
    """FRFs of named benches with disturbances, their loops closed, and the ways from ground to payload."""
    frfs = []
    for name, scene in scenes.items():
        model = linearize_closed(scene, continuous=True) if scene.loops else linearize(scene)
        frfs.append(frequency_response(model, frequency, label=name))
    return frfs, [transmissibility(frf, output="encoder", ground="ground_acceleration") for frf in frfs]


def isolation_figures(frf: FRF, way: FRF) -> dict[str, float]:
    """What passes from the ground at 500 Hz, the compliance of the payload at the first line, and below 300 Hz."""
    compliance = 1e6 * np.abs(frf.response("encoder", "payload_force"))
    return {
        "transmissibility_500_Hz": abs(way.values[0, 0, np.argmin(np.abs(way.frequency - 500.0))]),
        "compliance_1_Hz_um_per_N": compliance[0],
        "largest_compliance_um_per_N": compliance[frf.frequency < 300].max(),
    }


def plot_isolation(frfs: list[FRF], isolation: list[FRF], path: Path) -> None:
    """Transmissibility from the ground and compliance of the payload, side by side."""
    columns = plt.figure(figsize=(13, 7), layout="constrained").subfigures(1, 2)
    plot_frf(isolation, output="absolute motion", input="ground", unit="m/m", figure=columns[0])
    save_figure(plot_frf(frfs, output="encoder", input="payload_force", unit="m/N", figure=columns[1]), path)
