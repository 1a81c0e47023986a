"""Figures of studies: results over parameters run by run, and the parameters with the largest effects.

All functions take datasets of `nassim.studies`: those of a sweep, of its linear effects, or of its Sobol' indices.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from nassim.base.checks import known, unique
from nassim.plotting.figures import COLORS, plt


def plot_scatter(dataset: Any, correlations: Any, *, figure: Any = None) -> list[list[Any]]:
    """Plot each result over each parameter, one point per run, with their rank correlation.

    Args:
        dataset: dataset of a sweep over samples.
        correlations: dataset of `nassim.studies.correlations`, whose results and parameters are shown.
        figure: matplotlib figure or subfigure to plot in (default: a new one).

    Returns:
        The Axes, one row per result and one column per parameter.
    """
    results, parameters = correlations.result.values.tolist(), correlations.parameter.values.tolist()
    size = (1.7 * len(parameters) + 1.0, 1.5 * len(results) + 0.8)
    figure = figure or plt.figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(results), len(parameters), sharex="col", sharey="row", squeeze=False)
    for result, row in zip(results, grid, strict=True):
        for parameter, ax in zip(parameters, row, strict=True):
            rank = float(correlations.spearman.sel(result=result, parameter=parameter))
            strong = np.isfinite(rank) and abs(rank) >= 0.3
            ax.plot(dataset[parameter], dataset[result], ".", ms=3, color=COLORS[0] if strong else "0.55")
            ax.set_title(f"rank correlation {rank:+.2f}", fontsize=7, pad=2, fontweight="bold" if strong else None)
            ax.tick_params(labelsize=6)
            ax.locator_params(nbins=4)
            ax.ticklabel_format(scilimits=(-2, 4))
            for axis in (ax.xaxis, ax.yaxis):
                axis.get_offset_text().set_fontsize(6)
            ax.grid(visible=True, alpha=0.25)
        row[0].set_ylabel(_label(dataset, result), fontsize=8)
    for parameter, ax in zip(parameters, grid[-1], strict=True):
        ax.set_xlabel(_label(dataset, parameter), fontsize=8, labelpad=7)
    figure.align_ylabels(grid[:, 0])
    return [list(row) for row in grid]


def plot_tornado(effects: Any, *, result: str, unit: str = "", ax: Any = None) -> Any:
    """Plot the change of a result over the range of each parameter, with the longest bar on top.

    A bar begins at the low end of the parameter and ends, in its darker half, at the high end.

    Args:
        effects: dataset of `nassim.studies.linear_effects`.
        result: name of the result.
        unit: unit of the result.
        ax: Axes to plot in (default: new ones).

    Returns:
        The Axes.
    """
    known("result", result, effects.result.values.tolist())
    chosen = effects.sel(result=result)
    size = np.nan_to_num(chosen.effect.values)
    order = np.argsort(np.abs(size))
    names = [_plain(name) for name in effects.parameter.values[order]]
    ax = ax or plt.subplots(figsize=(6.5, 0.32 * len(names) + 1.4), layout="constrained")[1]
    mean = float(chosen["mean"])
    ax.barh(names, -size[order] / 2, left=mean, color="#9ecae1", label="parameter low")
    ax.barh(names, size[order] / 2, left=mean, color=COLORS[0], label="parameter high")
    ax.axvline(mean, color="black", lw=0.8)
    ax.set_xlabel(f"{_plain(result)} [{unit}]" if unit else _plain(result))
    told = f"mean {mean:.4g} {unit}".rstrip()
    ax.set_title(f"{told}, a linear fit explains {100 * float(chosen.explained):.0f} %", fontsize=9)
    ax.tick_params(labelsize=8)
    ax.ticklabel_format(axis="x", scilimits=(-2, 4))
    ax.grid(visible=True, axis="x", alpha=0.3)
    ax.legend(fontsize=7, loc="lower right")
    return ax


def plot_sobol(indices: Any, *, results: Sequence[str] | None = None, figure: Any = None) -> list[Any]:
    """Plot first-order and total Sobol' indices with their intervals, sorted by the largest total index.

    Args:
        indices: dataset of `nassim.studies.sobol_indices`.
        results: names of results (default: all).
        figure: matplotlib figure or subfigure to plot in (default: a new one).

    Returns:
        The Axes, one per result, side by side.

    Raises:
        ValueError: for no result, and for unknown ones.
    """
    given = indices.result.values.tolist()
    results = [known("result", name, given) for name in unique("result", given if results is None else results)]
    if not results:
        raise ValueError(f"name at least one result; known: {', '.join(given)}")
    order = np.argsort(np.nan_to_num(indices.total.sel(result=list(results)).values).max(axis=0))
    names = [_plain(name) for name in indices.parameter.values[order]]
    size = (2.6 * len(results) + 1.6, 0.3 * len(names) + 1.4)
    figure = figure or plt.figure(figsize=size, layout="constrained")
    axes = list(figure.subplots(1, len(results), sharey=True, sharex=True, squeeze=False)[0])
    place = np.arange(len(names))
    for result, ax in zip(results, axes, strict=True):
        chosen = indices.sel(result=result)
        for kind, shift, color in (("total", 0.18, COLORS[0]), ("first_order", -0.18, COLORS[4])):
            value = chosen[kind].values[order]
            ends = chosen[f"{kind}_interval"].values[order]
            # An interval may lie beside the estimate.
            errors = np.maximum([value - ends[:, 0], ends[:, 1] - value], 0.0)
            style: Any = {"color": color, "height": 0.34, "label": kind.replace("_", " ")}
            ax.barh(place + shift, value, xerr=errors, error_kw={"lw": 0.9, "ecolor": "0.25"}, **style)
        ax.set_title(_plain(result), fontsize=9)
        ax.set_yticks(place, names, fontsize=8)
        ax.margins(y=0.01)
        ax.tick_params(axis="x", labelsize=8)
        ax.axvline(0.0, color="black", lw=0.8)
        ax.grid(visible=True, axis="x", alpha=0.3)
    axes[0].legend(fontsize=7, loc="lower right")
    figure.supxlabel("share of the variance [-]", fontsize=9)
    return axes


def _label(dataset: Any, name: str) -> str:
    unit = dataset[name].attrs.get("units", "")
    return f"{_plain(name)}\n[{unit}]" if unit else _plain(name)


def _plain(name: str) -> str:
    return name.replace("_", " ")
