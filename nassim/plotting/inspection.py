"""Figures of imported bodies before and after repair."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.ticker import MultipleLocator

from nassim.exchange.inspection import signed_frequencies
from nassim.exchange.row_order import rigid_residual
from nassim.exchange.superelements import Superelement
from nassim.plotting.figures import colors, plt

LOWEST = 1e-6
"""Value in the figure for eigenfrequencies of zero [Hz]."""


def plot_inspection(bodies: Mapping[str, Superelement], *, figure: Any = None) -> Sequence[Any]:
    """Plot eigenfrequencies and rigid-body residuals of labelled versions of a body.

    Args:
        bodies: superelements by label.
        figure: matplotlib figure or subfigure to plot in (default: a new one).

    Returns:
        The Axes of the eigenfrequencies (open markers: unstable) and of the forces that the six rigid-body motions
        cause, over their terms.

    Raises:
        ValueError: for no body.
    """
    if not bodies:
        raise ValueError("give at least one superelement by its label")
    figure = figure or plt.figure(figsize=(11, 4.5), layout="constrained")
    axes = list(figure.subplots(1, 2, gridspec_kw={"width_ratios": [3, 2]}))
    width = 0.8 / len(bodies)
    for k, (color, (label, body)) in enumerate(zip(colors(len(bodies)), bodies.items(), strict=True)):
        stiffness, mass = (0.5 * (m + m.T) for m in (body.stiffness_matrix, body.mass_matrix))
        frequency = signed_frequencies(stiffness, mass)
        number = np.arange(1, len(frequency) + 1)
        shift = 0.15 * (k - 0.5 * (len(bodies) - 1))
        for kind, face in ((frequency > 0, color), (frequency <= 0, "none")):
            size = np.maximum(np.abs(frequency[kind]), LOWEST)
            axes[0].semilogy(number[kind] + shift, size, "os"[k % 2], color=color, mfc=face, ms=6)
        axes[0].plot([], [], "os"[k % 2], color=color, label=label)
        residual = np.maximum(rigid_residual(stiffness, body.rigid_motions), 1e-18)
        axes[1].bar(np.arange(6) + (k + 0.5) * width - 0.4, residual, width, color=color, label=label)
    axes[0].axvspan(0.5, 6.5, color="0.92", zorder=0)
    axes[0].text(
        3.5, 0.97, "rigid-body motions", ha="center", va="top", transform=axes[0].get_xaxis_transform(), fontsize=9
    )
    axes[0].set(xlabel="mode (open: unstable)", ylabel="eigenfrequency [Hz]", xlim=(0.5, None))
    axes[0].xaxis.set_major_locator(MultipleLocator(2))
    axes[1].set(yscale="log", ylim=(1e-18, 1e3), ylabel="residual force over its terms [-]", xlabel="rigid-body motion")
    axes[1].set_xticks(range(6), ["x", "y", "z", "rx", "ry", "rz"])
    for ax in axes:
        ax.grid(visible=True, alpha=0.3)
        ax.legend(fontsize=9)
    return axes
