"""Figures of signals over time."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from nassim.base.checks import known, of_kind, unique
from nassim.plotting.figures import plt, unit_prefix
from nassim.signals.time_history import TimeHistory


def plot_time_history(history: TimeHistory, *, names: Sequence[str] | None = None, figure: Any = None) -> Sequence[Any]:
    """Plot signals over time, one below the other; small ones in mm, um or nm in place of m, and so on.

    Args:
        history: the signals.
        names: names of the signals (default: all).
        figure: matplotlib figure or subfigure to plot in (default: a new one).

    Returns:
        One Axes per signal.

    Raises:
        ValueError: for no signal, and for unknown ones.
    """
    of_kind("history", history, TimeHistory, "plot_frf draws an FRF")
    names = [
        known("signal", name, history.names) for name in unique("signal", history.names if names is None else names)
    ]
    if not names:
        raise ValueError(f"name at least one signal; known: {', '.join(history.names)}")
    figure = figure or plt.figure(figsize=(7, 1.8 * len(names) + 0.6), layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(len(names), 1, sharex=True)))
    for ax, name in zip(axes, names, strict=True):
        unit = history.units[history.names.index(name)]
        factor, prefix = unit_prefix(history[name], unit)
        ax.plot(history.time, history[name] / factor, lw=0.7)
        ax.set_ylabel(f"{name}\n[{prefix}{unit or '-'}]".replace("_", " "))
        ax.grid(True, alpha=0.25)
    axes[-1].set_xlabel("time [s]")
    return axes
