"""Sensitivity of results to parameters: Sobol' indices on `saltelli_points`, correlations and effects on any samples.

All functions take the dataset that `sweep` returns for samples: parameters are coordinates along "run", and results
have one number per run. Truth values count as 0 and 1. Texts are left out, with a
warning where several runs share one.
"""

from collections.abc import Hashable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from nassim.base.checks import Array, known, unique, whole_number
from nassim.base.warning_log import warn
from nassim.studies.results import OWN, RUN
from nassim.studies.samples import Samples

if TYPE_CHECKING:
    import xarray as xr

SMALL_OWN_SHARE = 0.1
"""Independent fraction of a parameter's variance below which its effect has three times the uncertainty: a warning."""
ZERO_OWN_SHARE = 1e-8
"""Independent fraction below which a parameter follows from the others, so that their effects cannot be separated."""


def sobol_indices(
    dataset: "xr.Dataset",
    *,
    results: Sequence[str] | None = None,
    confidence: float = 0.95,
    n_resamples: int = 500,
    seed: int = 0,
) -> "xr.Dataset":
    """Compute the contribution of each parameter to the variance of results, for a study on `saltelli_points`.

    The first-order index is the fraction of the variance that would disappear if the parameter were known. The total
    index is the fraction that would remain if all others were known. Both are equal where the effects of the parameters
    add up. The estimates have a statistical error, so that small indices may be negative. A result that does not vary
    has indices of NaN.

    Args:
        dataset: dataset of the study.
        results: names of results (default: all with one number per run).
        confidence: confidence level of the intervals [-].
        n_resamples: number of bootstrap resamples, whose percentiles give the intervals.
        seed: seed of the bootstrap.

    Returns:
        Dataset over (result, parameter) with `first_order` and `total`, and with `first_order_interval` and
        `total_interval`, whose ends are "low" and "high" along `bound`.

    Raises:
        ValueError: for runs without a result, runs on other points and unknown results.

    Source: A. Saltelli et al., Comput. Phys. Commun. 181 (2010) 259-270, table 2 (b) and (f). The bootstrap treats the
        evenly distributed points as random points, so that its intervals are rather too wide.
    """
    if not 0 < confidence < 1:
        raise ValueError(f"confidence must lie between 0 and 1, got {confidence:g}")
    n_resamples = whole_number("n_resamples", n_resamples, 1)
    parameters, values = _parameters(dataset), _results(dataset, results)
    found = np.stack(list(values.values()))
    missing = np.flatnonzero(~np.isfinite(found).all(axis=0))
    if len(missing):
        raise ValueError(
            f"{len(missing)} of {len(parameters)} runs lack a result (run {', '.join(map(str, missing[:5]))}"
            f"{' ...' if len(missing) > 5 else ''}); Sobol' indices need every run of their plan: correct the "
            "runs that fail and call the study again, name results that all runs have, or take correlations, which "
            "leave runs out"
        )
    a, b, mixed = _blocks(parameters, found)
    generator, n = np.random.default_rng(whole_number("seed", seed, 0)), a.shape[-1]
    drawn = (generator.integers(n, size=n) for _ in range(n_resamples))
    rounds = np.array([_shares(a[:, k], b[:, k], mixed[..., k]) for k in drawn])
    tails = [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence]
    intervals = np.moveaxis(np.quantile(rounds, tails, axis=0), 0, -1)
    variables: dict[str, tuple[tuple[str, ...], Array]] = {}
    for kind, estimate, interval in zip(("first_order", "total"), _shares(a, b, mixed), intervals, strict=True):
        variables[kind] = (("result", "parameter"), estimate)
        variables[f"{kind}_interval"] = (("result", "parameter", "bound"), interval)
    axes = {"result": list(values), "parameter": list(parameters.names), "bound": ["low", "high"]}
    return _labelled(variables, axes, confidence=confidence, n=n)


def correlations(dataset: "xr.Dataset", *, results: Sequence[str] | None = None) -> "xr.Dataset":
    """Compute the correlations of results with parameters: `pearson` (linear) and `spearman` (by rank).

    A run without a result is omitted for that result. The correlation of a quantity that does not vary is NaN.

    Args:
        dataset: dataset of the study.
        results: names of results (default: all with one number per run).

    Returns:
        Dataset with `pearson` and `spearman` over (result, parameter), and the number of runs `n_runs` over result.

    Raises:
        ValueError: for unknown results, and where fewer than three runs have a result.
    """
    parameters, values = _parameters(dataset), _results(dataset, results)
    rows: dict[str, list[Array]] = {"pearson": [], "spearman": []}
    counts = []
    for name, value in values.items():
        there = np.isfinite(value)
        counts.append(int(there.sum()))
        if counts[-1] < 3:
            raise ValueError(f"{counts[-1]} runs have a result {name!r}; a correlation needs at least three")
        x, y = parameters.values[there], value[there]
        rows["pearson"].append(_cosines(x, y))
        rows["spearman"].append(_cosines(scipy.stats.rankdata(x, axis=0), scipy.stats.rankdata(y)))
    variables = {kind: (("result", "parameter"), np.array(row)) for kind, row in rows.items()}
    axes = {"result": list(values), "parameter": list(parameters.names)}
    return _labelled({**variables, "n_runs": (("result",), np.array(counts))}, axes)


def linear_effects(
    dataset: "xr.Dataset", *, results: Sequence[str] | None = None, coverage: float = 0.9
) -> "xr.Dataset":
    """Compute the change of results over the range of each parameter, by a linear regression.

    A run without a result is omitted for that result. Warns of parameters whose own share is below 0.1, and of those
    that vary, but not within their range.

    Args:
        dataset: dataset of the study.
        results: names of results (default: all with one number per run).
        coverage: fraction of the values of a parameter in its range, with equal fractions below and above it [-].

    Returns:
        Dataset over (result, parameter) with `effect`, the change from the lower to the upper end of the range in the
        unit of the result, and `own_share`, the fraction of the variance of the parameter that is independent of the
        others, which is 1 for independent parameters [-]. Over result it has `mean`, the mean of the runs, and
        `explained`, the fraction of the variance that the regression explains [-]; where it is far below one, use
        `sobol_indices`.

    Raises:
        ValueError: for unknown results, where fewer runs than the number of parameters plus two have a result, and for
            parameters that depend on each other, so that their effects cannot be separated.
    """
    if not 0 < coverage <= 1:
        raise ValueError(f"coverage must lie in 0 ... 1 (0 excluded), got {coverage:g}")
    parameters, values = _parameters(dataset), _results(dataset, results)
    low, high = np.quantile(parameters.values, [0.5 - 0.5 * coverage, 0.5 + 0.5 * coverage], axis=0)
    _check_ranges(parameters, high - low, coverage)
    spread = np.ptp(parameters.values, axis=0)
    spread = np.where(spread > 0, spread, np.inf)
    places = (parameters.values - parameters.values.mean(axis=0)) / spread
    figures: dict[str, list[Any]] = {"effect": [], "own_share": [], "mean": [], "explained": []}
    for name, value in values.items():
        there = np.isfinite(value)
        if there.sum() < len(parameters.names) + 2:
            raise ValueError(
                f"{there.sum()} runs have a result {name!r}; for {len(parameters.names)} parameters a plane needs "
                f"{len(parameters.names) + 2}"
            )
        figures["own_share"].append(_own_shares(places[there]))
        _check_own_shares(dict(zip(parameters.names, figures["own_share"][-1], strict=True)), name)
        columns = np.column_stack([np.ones(there.sum()), places[there]])
        plane = np.linalg.lstsq(columns, value[there], rcond=None)[0]
        figures["effect"].append(plane[1:] * (high - low) / spread)
        figures["mean"].append(value[there].mean())
        left = np.var(value[there] - columns @ plane)
        figures["explained"].append(1 - left / np.var(value[there]) if np.ptp(value[there]) > 0 else np.nan)
    axes = {"result": list(values), "parameter": list(parameters.names)}
    both = ("result", "parameter")
    dims = {"effect": both, "own_share": both, "mean": ("result",), "explained": ("result",)}
    return _labelled({key: (dims[key], np.array(rows)) for key, rows in figures.items()}, axes, coverage=coverage)


def _own_shares(values: Array) -> Array:
    """Return the fraction of each column's variance that is independent of the other columns; values: (n, parameters).

    A column that does not vary has a fraction of NaN.
    """
    centred = values - values.mean(axis=0)
    sizes = np.where(np.ptp(values, axis=0) > 0, np.linalg.norm(centred, axis=0), np.nan)
    unit = np.nan_to_num(centred / sizes)
    shares = []
    for k, size in enumerate(sizes):
        others = np.delete(unit, k, axis=1)
        left = unit[:, k] - others @ np.linalg.lstsq(others, unit[:, k], rcond=None)[0]
        shares.append(float(left @ left) if np.isfinite(size) else np.nan)
    return np.array(shares)


def _check_ranges(parameters: Samples, lengths: Array, coverage: float) -> None:
    """Warn of parameters that vary, but not within their ranges, whose lengths are given, (parameters,)."""
    varies = np.ptp(parameters.values, axis=0) > 0
    rare = [repr(name) for name, of in zip(parameters.names, varies & (lengths == 0), strict=True) if of]
    if rare:
        warn(
            f"parameters {', '.join(rare)} are the same in all but a few runs: their ranges of {coverage:g} of the "
            "values have no length, so their effects are 0; give a larger coverage, up to 1"
        )


def _check_own_shares(shares: Mapping[str, float], result: str) -> None:
    """Raise ValueError for, or warn of, parameters that do not vary independently in the runs with a result."""
    dependent = [repr(name) for name, share in shares.items() if share < ZERO_OWN_SHARE]
    if dependent:
        raise ValueError(
            f"parameters {', '.join(dependent)} follow from each other in the runs with a result {result!r}, by own "
            f"shares of their variance below {ZERO_OWN_SHARE:g}: their effects cannot be separated; vary them "
            "independently, or leave all but one of them out of the dataset"
        )
    weak = {name: share for name, share in shares.items() if share < SMALL_OWN_SHARE}
    if weak:
        listed = ", ".join(f"{name!r} {100 * share:.2g} %" for name, share in weak.items())
        warn(
            f"parameters hardly vary independently in the runs with a result {result!r}; own shares of their variance: "
            f"{listed}. Their effects scatter {min(weak.values()) ** -0.5:.2g} times as much as they otherwise would"
        )


def _labelled(
    variables: Mapping[str, tuple[tuple[str, ...], Array]], axes: Mapping[str, list[str]], **attributes: float
) -> "xr.Dataset":
    import xarray as xr  # noqa: PLC0415 -- of the extra `studies`

    return xr.Dataset(variables, axes, attributes)


def _shares(a: Array, b: Array, mixed: Array) -> tuple[Array, Array]:
    """Return first-order and total indices, (n_results, n_parameters); `_blocks` describes the arguments."""
    both = np.concatenate([a, b], axis=1)
    variance = np.where(np.ptp(both, axis=1) > 0, np.var(both, axis=1), np.nan)[:, None]
    first = np.mean(b * (mixed - a), axis=-1).T / variance
    total = 0.5 * np.mean((a - mixed) ** 2, axis=-1).T / variance
    return first, total


def _blocks(parameters: Samples, results: Array) -> tuple[Array, Array, Array]:
    """Return centred results (n_results, n) of A, of B, and of A with a column of B (parameters, results, n)."""
    d = len(parameters.names)
    n, rest = divmod(len(parameters), d + 2)
    if not rest and n > 1:
        a, b, *mixed = np.split(parameters.values, d + 2)
        if all(np.array_equal(block, np.where(np.arange(d) == k, b, a)) for k, block in enumerate(mixed)):
            centred = results - results[:, : 2 * n].mean(axis=1, keepdims=True)
            a, b, *mixed = np.split(centred, d + 2, axis=1)
            return a, b, np.array(mixed)
    raise ValueError(f"the {len(parameters)} runs are not those of saltelli_points of at least two; take correlations")


def _cosines(x: Array, y: Array) -> Array:
    """Return Pearson's correlation of each column of x, (n, n_parameters), with y, (n,)."""
    directions = []
    for column in (y, *x.T):
        centred = column - column.mean()
        directions.append(centred / np.linalg.norm(centred) if np.ptp(column) > 0 else np.full(len(column), np.nan))
    return np.array(directions[1:]) @ directions[0]


def _parameters(dataset: "xr.Dataset") -> Samples:
    """Return the parameters along the runs, truth values as 0 and 1.

    Warns of texts that several runs share: they are parameters without a number. A text of each run's own is its name.
    """
    names = _along_runs(dataset.coords)
    texts = [str(name) for name, axis in dataset.coords.items() if axis.dims == (RUN,) and axis.dtype.kind in "OSU"]
    if varied := [name for name in texts if 1 < len(set(dataset[name].values.tolist())) < dataset.sizes[RUN]]:
        warn(
            f"parameters {', '.join(map(repr, varied))} are texts and left out: where others vary with them, these get "
            "their effect too; select the runs of one text, or vary a number in its place"
        )
    if not names:
        raise ValueError(
            "the study has no parameters along 'run': give a study of samples, or stack the dimensions of a grid"
        )
    return Samples(names, np.column_stack([dataset[name].values for name in names]))


def _results(dataset: "xr.Dataset", names: Sequence[str] | None) -> Mapping[str, Array]:
    """Return results of one number per run, (n_runs,), by name; None: all of them."""
    found = {name: dataset[name].values.astype(float) for name in _along_runs(dataset.data_vars)}
    if not found:
        raise ValueError("the study has no result of one number a run; let its function return numbers by name")
    chosen = unique("result", found if names is None else names)
    if not chosen:
        raise ValueError(f"name at least one result; known: {', '.join(found)}")
    return {name: found[known("result of one number a run", name, found)] for name in chosen}


def _along_runs(variables: "Mapping[Hashable, xr.DataArray]") -> tuple[str, ...]:
    """Return the names of parameters or results with one number or truth value per run."""
    numbers = {str(name) for name, axis in variables.items() if axis.dims == (RUN,) and axis.dtype.kind in "fiub"}
    return tuple(name for name in map(str, variables) if name in numbers - set(OWN))
