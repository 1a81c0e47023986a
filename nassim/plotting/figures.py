"""Common parts of all figures: matplotlib's pyplot, colours, and writing a figure to a file."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

__all__ = ["COLORS", "colors", "plt", "save_figure"]

COLORS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")


def colors(n: int) -> list[str]:
    """Return n colours, which repeat after the last one.

    Args:
        n: number of colours.
    """
    return [COLORS[i % len(COLORS)] for i in range(n)]


def save_figure(axes: Any, path: str | Path) -> Path:
    """Write the figure of an Axes to a file, and close the figure.

    Args:
        axes: an Axes, a sequence of Axes, or rows of them.
        path: file to write; its folder is created.

    Returns:
        Path of the file.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure: Figure = np.ravel(np.array(axes, dtype=object))[0].get_figure(root=True)
    figure.savefig(target, dpi=150, bbox_inches="tight")
    plt.close(figure)
    return target
