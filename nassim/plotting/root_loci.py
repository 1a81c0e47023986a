"""Figures of root loci: closed-loop poles over a gain."""

from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from nassim.base.checks import positive
from nassim.plotting.figures import COLORS, plt
from nassim.systems.root_loci import Optimum, RootLocus


def plot_root_locus(locus: RootLocus, *, frequency: float, optimum: Optimum | None = None, ax: Any = None) -> Any:
    """Plot the branches of a root locus in the s-plane over 2 pi, with lines of equal damping.

    Crosses are the poles at the first gain, and circles are zeros.

    Args:
        locus: the root locus.
        frequency: largest natural frequency in the figure [Hz].
        optimum: optimum to mark, with its gain, damping ratio and frequency.
        ax: Axes to plot in (default: new ones).

    Returns:
        The Axes.

    Raises:
        ValueError: for a frequency that is not positive.
    """
    frequency = positive("frequency", frequency, "Hz")
    ax = ax or plt.subplots(figsize=(7.5, 6), layout="constrained")[1]
    right = 0.2 * frequency
    ax.axvspan(0, right, color="#d62728", alpha=0.06, lw=0)
    for ratio in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9):
        end = frequency * np.array([-ratio, np.sqrt(1 - ratio**2)])
        ax.plot([0, end[0]], [0, end[1]], color="0.85", lw=0.7, zorder=0)
        ax.annotate(f"{ratio:g}", 1.03 * end, fontsize=7, color="0.45", ha="center", va="center", zorder=0)
    turn = np.linspace(np.pi / 2, np.pi, 90)
    for part in (0.25, 0.5, 0.75, 1.0):
        ax.plot(part * frequency * np.cos(turn), part * frequency * np.sin(turn), color="0.85", lw=0.7, zorder=0)
    # The upper half-plane is sufficient: poles form conjugate pairs, which have one colour.
    points = locus.poles.real / (2 * np.pi) + 1j * np.abs(locus.poles.imag) / (2 * np.pi)
    points[np.abs(points) > 1.1 * frequency] = np.nan
    shown = np.flatnonzero(np.any(np.isfinite(points), axis=0))
    pairs = sorted({f"{size:.6e}" for size in locus.frequency[0, shown]}, key=float)
    for k in shown:
        color = COLORS[pairs.index(f"{locus.frequency[0, k]:.6e}") % len(COLORS)]
        ax.plot(points[:, k].real, points[:, k].imag, ".-", color=color, lw=1.4, ms=3)
        ax.plot(points[0, k].real, points[0, k].imag, "x", color=color, ms=9, mew=2)
    zeros = locus.zeros[locus.zeros.imag >= 0] / (2 * np.pi)
    ax.plot(zeros.real, zeros.imag, "o", color="black", mfc="none", ms=8, mew=1.3)
    handles = [
        Line2D([], [], ls="", marker="x", color="black", label=f"poles at gain {locus.gains[0]:g}"),
        Line2D([], [], ls="", marker="o", color="black", mfc="none", label="zeros of the open loop"),
        Line2D([], [], color="black", marker=".", label=f"poles up to gain {locus.gains[-1]:.4g}"),
    ]
    if optimum is not None:
        root = optimum.frequency * np.array([-optimum.damping_ratio, np.sqrt(max(1 - optimum.damping_ratio**2, 0.0))])
        ax.plot(*root, "*", color="black", ms=13, zorder=5)
        text = f"gain {optimum.gain:.4g}: damping {optimum.damping_ratio:.3g} at {optimum.frequency:.4g} Hz"
        handles.append(Line2D([], [], ls="", marker="*", color="black", ms=10, label=text))
    ax.set(xlim=(-1.1 * frequency, right), ylim=(-0.03 * frequency, 1.1 * frequency), aspect="equal")
    ax.set(xlabel="Re s / 2π [Hz]", ylabel="Im s / 2π [Hz]")
    ax.axhline(0, color="0.6", lw=0.7, zorder=0)
    ax.axvline(0, color="0.4", lw=0.8, zorder=0)
    ax.legend(handles=handles, fontsize=8, loc="upper left")
    return ax
