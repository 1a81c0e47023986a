"""Pictures of the hexapod's FRFs: entries of a matrix one beside the other."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.ticker import MultipleLocator

from nassim import FRF
from nassim.plotting import COLORS, plt

N_POINTS = 60
"""Markers along a curve, for the eye."""


def plot_entries(model: FRF, estimated: FRF, rows: Sequence[str], unit: str) -> Any:
    """Identified points over the model's curves: the diagonal, and beside it one output's answers to all inputs.

    rows: outputs, in the order of the inputs; unit: of the magnitude. Returns the Axes, phases below magnitudes.
    """
    _, axes = plt.subplots(
        2, 2, figsize=(13, 7.5), sharex=True, sharey="row", height_ratios=[3, 2], layout="constrained"
    )
    kind = rows[0].partition("/")[2].replace("_", " ")
    groups = (list(zip(rows, estimated.inputs, strict=True)), [(rows[0], drive) for drive in estimated.inputs])
    titles = (f"{kind} of each strut for its own voltage", f"{kind} of strut 1 for the voltage of each strut")
    shown = np.unique(np.searchsorted(estimated.frequency, np.geomspace(*estimated.frequency[[0, -1]], N_POINTS)))
    for column, (pairs, title) in enumerate(zip(groups, titles, strict=True)):
        for color, pair in zip(COLORS, pairs, strict=False):
            curve, points = model.response(*pair), estimated.response(*pair)[shown]
            dots = {"ls": "", "marker": "o", "ms": 4, "mfc": "none", "color": color}
            label = pair[1].partition("/")[0].replace("_", " ")
            axes[0, column].loglog(model.frequency, np.abs(curve), color=color, lw=1.0, label=label)
            axes[0, column].loglog(estimated.frequency[shown], np.abs(points), **dots)
            axes[1, column].semilogx(model.frequency, _without_jumps(np.angle(curve, deg=True)), color=color, lw=0.8)
            axes[1, column].semilogx(estimated.frequency[shown], np.angle(points, deg=True), **dots)
        axes[0, column].set_title(title, fontsize=11)
        axes[0, column].legend(fontsize=8, ncols=2)
        axes[1, column].set_xlabel("frequency [Hz]")
        axes[1, column].yaxis.set_major_locator(MultipleLocator(90))
    axes[0, 0].set_ylabel(f"magnitude [{unit}]\n{model.label} (lines), {estimated.label} (points)")
    axes[1, 0].set_ylabel("phase [deg]")
    for ax in axes.flat:
        ax.grid(True, which="both", alpha=0.25)
    return list(axes.flat)


def _without_jumps(degrees: np.ndarray) -> np.ndarray:
    """Phase [deg] with a gap where it leaves the picture and returns at the other end."""
    jumps = np.abs(np.diff(degrees, prepend=degrees[0])) > 180
    return np.where(jumps, np.nan, degrees)
