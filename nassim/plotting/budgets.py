"""Figures of noise budgets: contributions of the disturbances to the density and to the cumulative amplitude."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from nassim.base.checks import known
from nassim.plotting.figures import COLORS, label_frequencies, plt, unit_prefix
from nassim.systems.noise_budgets import NoiseBudget


def plot_noise_budget(
    budget: NoiseBudget, *, output: str, limit: float | None = None, figure: Any = None
) -> Sequence[Any]:
    """Plot the amplitude spectral density and the cumulative amplitude of one output; small ones in um, nm and so on.

    The cumulative amplitude is summed from high to low frequencies. Both show each disturbance, those with the largest
    rms first, and the total.

    Args:
        budget: the noise budget.
        output: name of the output.
        limit: limit of the rms, a line in the second Axes [output unit].
        figure: matplotlib figure or subfigure to plot in (default: a new one).

    Returns:
        The Axes of the density and of the cumulative amplitude.
    """
    row = budget.outputs.index(known("output", output, budget.outputs))
    figure = figure or plt.figure(figsize=(7.5, 7), layout="constrained")
    axes = list(figure.subplots(2, 1, sharex=True))
    order = np.argsort(-budget.rms()[row])
    black: dict[str, Any] = {"color": "black", "lw": 2.8, "zorder": 1}  # behind: one disturbance may be nearly all
    curves = [(budget, k, {"color": COLORS[n % len(COLORS)], "lw": 1.2}) for n, k in enumerate(order)]
    total = budget.total.rms()[row, 0]
    factor, prefix = unit_prefix(total, budget.units[row])
    unit = prefix + budget.units[row]
    for part, k, style in [*curves, (budget.total, 0, black)]:
        amplitude = part.cumulative()[row, k] / factor
        shown = amplitude > 0
        axes[0].loglog(part.frequency, np.sqrt(part.psd[row, k]) / factor, **style)
        label = f"{part.inputs[k]}: {amplitude[0]:.3g} {unit}".replace("_", " ").rstrip()
        axes[1].loglog(part.frequency[shown], amplitude[shown], label=label, **style)
    if limit is not None:
        drawn = limit / factor
        axes[1].axhline(drawn, color="0.4", ls="--", lw=1.2, label=f"limit: {drawn:.3g} {unit}".rstrip())
    if total > 0:
        top, peak = (2 * size / factor for size in (max(total, limit or 0.0), np.sqrt(budget.total.psd[row, 0].max())))
        axes[1].set_ylim(1e-4 * top, top)
        axes[0].set_ylim(1e-8 * peak, peak)
    axes[0].set_title(output.replace("_", " "), fontsize=11)
    axes[0].set_ylabel(f"amplitude density [{unit or '-'}/√Hz]")
    label_frequencies(axes[1])
    axes[1].set(ylabel=f"rms above the frequency [{unit or '-'}]")
    axes[1].legend(fontsize=8)
    for ax in axes:
        ax.grid(True, which="both", alpha=0.25)
    return axes
