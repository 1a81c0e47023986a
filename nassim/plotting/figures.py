"""Common parts of all figures: matplotlib's pyplot, colours, and writing a figure to a file."""

import math
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from nassim.base.field_types import ArrayLike
from nassim.base.units import PREFIXES

__all__ = ["COLORS", "colors", "label_frequencies", "plt", "save_figure", "unit_prefix"]

COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#661100", "#332288")
"""Colours that readers with red-green blindness can tell apart: six of M. Okabe and K. Ito, two of P. Tol."""
SCALED = ("m", "m/s", "m/s2", "rad", "rad/s", "N", "N m", "V")
"""Units that may have a prefix."""
SMALL = 0.1
"""Largest value below which values are drawn in a smaller unit."""
FREQUENCY_LABELS = {10.0: (1, 2, 3, 4, 5, 6, 8), 1e4: (1, 2, 5), math.inf: (1,)}
"""Multiples of powers of ten with a label, for axes whose highest over lowest frequency is below the key."""


def colors(n: int) -> list[str]:
    """Return n colours, which repeat after the last one.

    Args:
        n: number of colours.
    """
    return [COLORS[i % len(COLORS)] for i in range(n)]


def unit_prefix(values: ArrayLike, unit: str) -> tuple[float, str]:
    """Return the factor and the prefix of the unit in which values are drawn.

    Args:
        values: the values.
        unit: their unit.
    """
    largest = float(np.max(np.abs(values)))
    if unit not in SCALED or not 0 < largest < SMALL:
        return 1.0, ""
    prefix = next((prefix for prefix in "mu" if largest >= PREFIXES[prefix]), "n")
    return PREFIXES[prefix], prefix


def label_frequencies(ax: Any) -> None:
    """Label a logarithmic axis of frequencies with plain numbers, as many as there is room for.

    Args:
        ax: Axes with all its lines.
    """
    low, high = ax.get_xlim()
    subs = next(subs for span, subs in FREQUENCY_LABELS.items() if high < span * low)
    ax.xaxis.set_major_locator(LogLocator(subs=subs, numticks=30))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel("frequency [Hz]")


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
