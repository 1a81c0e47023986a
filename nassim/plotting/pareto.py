"""Figures of error over cost."""

from collections.abc import Mapping, Sequence
from typing import Any

from nassim.plotting.figures import COLORS, colors, plt


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

    Raises:
        ValueError: for a line without points.
    """
    if empty := [name for name, points in lines.items() if not points]:
        raise ValueError(f"lines without a point: {', '.join(empty)}; leave them out")
    ax = ax or plt.subplots(figsize=(8, 5.5), layout="constrained")[1]
    for k, (color, (name, points)) in enumerate(zip(colors(len(lines)), lines.items(), strict=True)):
        x, y, labels = zip(*sorted(points), strict=True)
        marker = "os^D"[k // len(COLORS) % 4]
        ax.loglog(x, y, f"{marker}-", color=color, markersize=5, linewidth=1.2, label=name)
        for a, b, text in zip(x, y, labels, strict=True):
            ax.annotate(text, (a, b), xytext=(4, 4), textcoords="offset points", fontsize=7, color=color)
    ax.set(xlabel=xlabel, ylabel=ylabel)
    ax.grid(visible=True, which="both", alpha=0.3)
    ax.legend(fontsize=8, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))  # above, where no point is
    return ax
