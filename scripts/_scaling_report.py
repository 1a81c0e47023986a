"""How costs grow with sizes: exponents, a table, a picture, for benchmark_scaling.py."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from _report import print_table
from matplotlib.ticker import EngFormatter

from nassim.plotting import COLORS, plt, save_figure

Rows = Mapping[str, Mapping[str, float]]
"""Figures by what the size was called."""
TITLES = {
    "nodes": "nodes of the FE model",
    "samples": "samples of the record",
    "struts": "struts",
    "states": "states",
}
CURVES = {
    "nodes": {"reduction_s": "reduction", "solves_s": "of it 78 solves", "factorisation_s": "of it factorisation"},
    "samples": {
        "simulate_s": "simulate, exact",
        "estimate_frf_s": "estimate_frf",
        "identify_modes_s": "identify_modes",
    },
    "struts": {"ffrf_us_per_step": "ffrf", "linear_us_per_step": "linear", "exact_us_per_step": "exact"},
    "states": {"response_us": "frequency_response, a line", "exact_us_per_step": "exact, a step"},
}
MEMORY = {"grown_B": "memory beyond the start"}
"""That of struts and states is mostly of what is loaded."""
PANELS = (
    ("nodes", "CPU time [s]", CURVES["nodes"], 1.0),
    ("samples", "CPU time [s]", CURVES["samples"], 1.0),
    ("struts", "CPU time a step [us]", CURVES["struts"], 1.0),
    ("nodes", "memory [GB]", MEMORY, 1e-9),
    ("samples", "memory [GB]", MEMORY, 1e-9),
    ("states", "CPU time [us]", CURVES["states"], 1.0),
)


def exponent(sizes: Any, costs: Any) -> dict[str, float]:
    """Of cost ~ size^exponent: by least squares of the logarithms, with its standard error; three sizes at least."""
    fit = scipy.stats.linregress(np.log(sizes), np.log(costs))
    return {"exponent": float(fit.slope), "std": float(fit.stderr), "cost_of_1": float(np.exp(fit.intercept))}


def exponents(rows: Rows) -> dict[str, dict[str, float]]:
    """Of all costs that are there at every size."""
    columns = {key: [row[key] for row in rows.values()] for key in next(iter(rows.values()), {})}
    sizes = columns.pop("size", [])
    return {key: exponent(sizes, costs) for key, costs in columns.items() if len(costs) >= 3 and min(costs) > 0}


def print_growth(kind: str, rows: Rows, fits: Mapping[str, Mapping[str, float]]) -> None:
    """Print the costs by size, below them the exponents."""
    units = {"_s": ("[s]", ":.3g"), "ep": ("[us]", ":.3g"), "us": ("[us]", ":.3g")}
    columns = {f"{name} {units[key[-2:]][0]}": key + units[key[-2:]][1] for key, name in CURVES[kind].items()}
    columns |= {"memory [GB]": "memory_B*1e-9:.2f", "grown by [GB]": "grown_B*1e-9:.3f"}
    print_table(TITLES[kind], {f"{row['size']:,.0f}": row for row in rows.values()}, columns)
    for key, name in (CURVES[kind] | MEMORY).items():
        if key in fits and (key not in MEMORY or kind in ("nodes", "samples")):
            print(f"  {name}: exponent {fits[key]['exponent']:.2f} +- {fits[key]['std']:.2f}")


def save_picture(path: Path, rows: Mapping[str, Rows], fits: Mapping[str, Mapping[str, Any]]) -> None:
    """Costs over sizes on logarithmic axes, with the fitted lines, and beside them what grows in proportion."""
    figure = plt.figure(figsize=(13, 7.5), layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    for ax, (kind, label, curves, factor) in zip(axes, PANELS, strict=True):
        for (key, name), color, marker in zip(curves.items(), COLORS, "os^", strict=False):
            shown = [(row["size"], factor * row[key]) for row in rows[kind].values() if row[key] > 0]
            size, cost = np.reshape(shown, (-1, 2)).T
            fit = fits[kind].get(key)
            text = f"{name}, p = {fit['exponent']:.2f} ± {fit['std']:.2f}" if fit else name
            ax.loglog(size, cost, marker, ms=5, color=color, label=text)
            if fit:
                ax.loglog(size, factor * fit["cost_of_1"] * size ** fit["exponent"], lw=1.2, color=color)
                ax.loglog(size, cost[0] * size / size[0], ls=":", lw=0.9, color="0.55")
            ax.set_xticks(size)
        ax.xaxis.set_major_formatter(EngFormatter(places=0, sep=""))
        ax.minorticks_off()
        low, high = ax.get_ylim()
        ax.set(xlabel=TITLES[kind], ylabel=label, ylim=(low, high * (high / low) ** 0.3))  # room for the legend
        ax.grid(visible=True, alpha=0.25)
        ax.legend(fontsize=9, loc="upper left")
    figure.suptitle("cost ~ size$^p$; dotted: in proportion to the size", fontsize=11)
    save_figure(axes, path)
