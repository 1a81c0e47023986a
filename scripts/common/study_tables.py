"""Figures of a study as rows by name, for summaries and tables."""

from typing import Any

import numpy as np

from common.report import print_table
from nassim.base.tables import rounded

STATISTICS = ("mean", "deviation", "lowest", "highest")


def labelled(figures: Any) -> dict[str, dict[str, float]]:
    """Return rows by labels of the first dimension, columns by labels of the second, of an xarray.DataArray."""
    rows, columns = ([n if isinstance(n, str) else f"{n:g}" for n in figures[d].values.tolist()] for d in figures.dims)
    return {name: dict(zip(columns, row, strict=True)) for name, row in zip(rows, figures.values.tolist(), strict=True)}


def spread(study: Any, effects: Any) -> dict[str, dict[str, float]]:
    """Return mean, deviation, minimum and maximum of each result, and the share of variance of a linear fit."""
    rows = {}
    for name in effects.result.values.tolist():
        values = study[name].dropna("run").values
        rows[name] = {"mean": values.mean(), "deviation": values.std(), "lowest": values.min(), "highest": values.max()}
        rows[name]["explained"] = float(effects.explained.sel(result=name))
    return rows


def print_spread(title: str, rows: dict[str, dict[str, float]]) -> None:
    """Print `spread`, with values rounded to two digits of the deviation."""
    told = {}
    for name, row in rows.items():
        told[name] = {key: rounded(row[key], row["deviation"], digits=2) for key in STATISTICS}
        told[name]["explained"] = f"{100 * row['explained']:.1f}"
    columns = {key: key for key in STATISTICS} | {"linear fit [%]": "explained"}
    print_table(title, told, columns)


def group_shares(indices: Any, groups: dict[str, list[str]]) -> tuple[dict[str, dict[str, float]], ...]:
    """Return total shares of the variance by group of parameters and result, and half of their intervals.

    The shares of all groups add up to one where the effects are additive.
    """
    shares, widths = {}, {}
    for group, members in groups.items():
        chosen = indices.sel(parameter=members)
        half = chosen.total_interval.diff("bound").squeeze("bound") / 2
        for told, values in ((shares, chosen.total.sum("parameter")), (widths, np.sqrt((half**2).sum("parameter")))):
            told[group] = dict(zip(indices.result.values.tolist(), values.values.tolist(), strict=True))
    return shares, widths


def print_shares(shares: dict[str, dict[str, float]], uncertainties: dict[str, dict[str, float]]) -> None:
    """Print `group_shares`."""
    told = {}
    for group, row in shares.items():
        known = {name: (share, uncertainties[group][name]) for name, share in row.items()}
        told[group] = {name: f"{rounded(*pair)} +- {pair[1]:.1g}" for name, pair in known.items()}
    print_table("share of the variance", told, {n.replace("_", " "): n for n in next(iter(shares.values()))})


def refinement(study: Any, fine: Any, names: Any) -> dict[str, dict[str, float]]:
    """Compare both meshes by result: means, ratio of changes on the fine and the coarse mesh, and residual.

    fine: the first runs of a study, repeated; changes are relative to the mean of these runs
    """
    rows = {}
    for name in names:
        pair = np.array([study[name].values[: len(fine.run)], fine[name].values])
        pair = pair[:, np.isfinite(pair).all(axis=0)]
        coarse, refined = pair / pair.mean(axis=1, keepdims=True) - 1
        slope = coarse @ refined / (coarse @ coarse)
        left = np.linalg.norm(refined - slope * coarse) / np.linalg.norm(refined)
        offset = 100 * (pair[1].mean() / pair[0].mean() - 1)
        rows[name] = {"offset_percent": offset, "slope": slope, "left_over_percent": 100 * left}
    return rows


REFINED = {
    "fine over coarse mean [%]": "offset_percent:+.2f",
    "fine over coarse change": "slope:.3f",
    "left over [%]": "left_over_percent:.0f",
}
"""Columns of the table of `refinement`."""
