"""Figures of feedback loops: Nyquist plots, singular values."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from nassim.base.checks import positive
from nassim.plotting.figures import colors, label_frequencies, plt
from nassim.plotting.responses import STYLES, at_least_one, legend_labels
from nassim.signals.frf import FRF
from nassim.systems.feedback import singular_values


def plot_nyquist(loops: Sequence[FRF], *, modulus: float = 0.5, ax: Any = None) -> Any:
    """Plot open loops of one signal as curves in the complex plane, thin for negative frequencies.

    A curve that stays outside the circle about the critical point has at least its modulus margin, and amplifies no
    disturbance by more than 1 / modulus. What lies farther than 2.5 from the origin is outside the figure.

    Args:
        loops: open loops, see `nassim.systems.open_loop`; of several signals, see `nassim.systems.loop_at_a_time`.
            Resonances become circles where the frequencies are close enough.
        modulus: radius of the circle [-].
        ax: Axes to plot in (default: new ones).

    Returns:
        The Axes.

    Raises:
        ValueError: for no loop, for one that is not in a list, and for one of several signals.
    """
    loops, modulus = at_least_one("loops", loops), positive("modulus", modulus)
    for loop in loops:
        if loop.values.shape[:2] != (1, 1):
            raise ValueError(f"a Nyquist plot is of one signal, got {len(loop.outputs)}: loop_at_a_time gives one")
    ax = ax or plt.subplots(figsize=(6, 6), layout="constrained")[1]
    turn = np.exp(2j * np.pi * np.linspace(0, 1, 200))
    ax.plot(turn.real, turn.imag, color="0.75", lw=0.8, zorder=0)
    circle = -1 + modulus * turn
    ax.fill(circle.real, circle.imag, color="#d62728", alpha=0.08, lw=0, label=f"modulus margin below {modulus:g}")
    styles = itertools.cycle(STYLES)
    for color, style, loop, label in zip(colors(len(loops)), styles, loops, legend_labels(loops), strict=False):
        values = loop.values[0, 0]
        ax.plot(values.real, values.imag, color=color, ls=style, lw=1.4, label=label)
        ax.plot(values.real, -values.imag, color=color, ls=style, lw=0.5)
    ax.plot(-1, 0, "+", color="#d62728", ms=10)
    ax.set(xlim=(-2.5, 2.5), ylim=(-2.5, 2.5), aspect="equal", xlabel="real part [-]", ylabel="imaginary part [-]")
    ax.legend(fontsize=9, loc="upper right")
    ax.grid(True, alpha=0.25)
    return ax


def plot_singular_values(frfs: Sequence[FRF], *, unit: str, ax: Any = None) -> Any:
    """Plot the largest singular values of FRF matrices over frequency, and dashed the smallest ones.

    Args:
        frfs: the FRFs, such as S and T of `nassim.systems.sensitivity`; signals of one kind, see
            `nassim.systems.singular_values`.
        unit: unit of the values, for the label; nothing is converted.
        ax: Axes to plot in (default: new ones).

    Returns:
        The Axes.

    Raises:
        ValueError: for no FRF, and for one that is not in a list.
    """
    frfs = at_least_one("frfs", frfs)
    ax = ax or plt.subplots(figsize=(7, 4.5), layout="constrained")[1]
    for color, frf, label in zip(colors(len(frfs)), frfs, legend_labels(frfs), strict=True):
        sizes = singular_values(frf)
        ax.loglog(frf.frequency, sizes[0], color=color, lw=1.4, label=label)
        if len(sizes) > 1:
            ax.loglog(frf.frequency, sizes[-1], color=color, lw=0.9, ls="--")
    label_frequencies(ax)
    ax.set(ylabel=f"singular values [{unit}]")
    ax.legend(fontsize=9)
    ax.grid(True, which="both", alpha=0.25)
    return ax
