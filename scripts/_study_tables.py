"""Figures of a study as rows by name, for summaries and tables."""

from typing import Any

import numpy as np


def labelled(figures: Any) -> dict[str, dict[str, float]]:
    """Rows by the labels of the first dimension, columns by those of the second, of an xarray.DataArray."""
    rows, columns = ([n if isinstance(n, str) else f"{n:g}" for n in figures[d].values.tolist()] for d in figures.dims)
    return {name: dict(zip(columns, row, strict=True)) for name, row in zip(rows, figures.values.tolist(), strict=True)}


def spread(study: Any, effects: Any) -> dict[str, dict[str, float]]:
    """Per result: mean, deviation, lowest and highest of the runs, and how much of the variance a plane explains."""
    rows = {}
    for name in effects.result.values.tolist():
        values = study[name].dropna("run").values
        rows[name] = {"mean": values.mean(), "deviation": values.std(), "lowest": values.min(), "highest": values.max()}
        rows[name]["explained"] = float(effects.explained.sel(result=name))
    return rows


SPREAD = {
    "mean": "mean:.4g",
    "deviation": "deviation:.2g",
    "lowest": "lowest:.4g",
    "highest": "highest:.4g",
    "a plane explains [%]": "explained*100:.1f",
}
"""Columns that print `spread`."""


def refinement(study: Any, fine: Any, names: Any) -> dict[str, dict[str, float]]:
    """Per result: means of both meshes compared, change on the fine one over that on the coarse one, what is left.

    fine: the first runs of a study repeated. Changes are against the mean of these runs, in proportion to it.
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
"""Columns that print `refinement`."""
