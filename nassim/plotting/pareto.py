"""Figures of error over cost."""

from collections.abc import Mapping, Sequence
from typing import Any

from nassim.plotting.figures import colors, plt


def plot_pareto(
    lines: Mapping[str, Sequence[tuple[float, float, str]]], xlabel: str, ylabel: str, *, ax: Any = None
) -> Any:
    """Plot error over cost on logarithmic axes.

    Args:
        lines: points (cost, error, label) by name of the line.
        xlabel: label of the cost.
        ylabel: label of the error.
        ax: Axes to plot in (default: new ones).

    Returns:
        The Axes.
    """
    ax = ax or plt.subplots(figsize=(8, 5.5), layout="constrained")[1]
    for color, (name, points) in zip(colors(len(lines)), lines.items(), strict=True):
        x, y, labels = zip(*sorted(points), strict=True)
        ax.loglog(x, y, "o-", color=color, markersize=5, linewidth=1.2, label=name)
        for a, b, text in zip(x, y, labels, strict=True):
            ax.annotate(text, (a, b), xytext=(4, 4), textcoords="offset points", fontsize=7, color=color)
    ax.set(xlabel=xlabel, ylabel=ylabel)
    ax.grid(visible=True, which="both", alpha=0.3)
    ax.legend(fontsize=8)
    return ax
