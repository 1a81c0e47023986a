"""What moves a study's results: Sobol' indices on `saltelli_points`, correlations and effects on any samples.

All take what `sweep` gives of samples: parameters as coordinates along "run", results of one number a run.
"""

from collections.abc import Hashable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from nassim.base.checks import Array, known
from nassim.base.warning_log import warn
from nassim.studies.results import OWN, RUN
from nassim.studies.samples import Samples

if TYPE_CHECKING:
    import xarray as xr

LITTLE = 0.1
"""Share of a parameter's variance of its own below which its effect scatters over three times as much: a warning."""
NONE = 1e-8
"""Share below which a parameter follows from the others, so that nothing tells their effects apart."""


def sobol_indices(
    dataset: "xr.Dataset",
    *,
    results: Sequence[str] | None = None,
    confidence: float = 0.95,
    n_resamples: int = 500,
    seed: int = 0,
) -> "xr.Dataset":
    """Which share of a result's variance each parameter brings, of a study on `saltelli_points`.

    results: names (default: all of one number a run); confidence: of the intervals, percentiles of a bootstrap of
        n_resamples, which follows from its seed

    Returns over (result, parameter): `first_order`, the share that would be gone were the parameter known, and `total`,
    the share that would be left were all others known; with "low" and "high" along `bound` `first_order_interval` and
    `total_interval`. Where effects of parameters add up, both shares are the same. Estimates scatter, so that small
    ones may come out below zero. A result that does not vary has no shares: NaN.

    Source: A. Saltelli et al., Comput. Phys. Commun. 181 (2010) 259-270, table 2 (b) and (f). The bootstrap takes
    points for random that fill the space evenly: its intervals are rather too wide.
    Raises ValueError for runs without a result, runs on other points and unknown results.
    """
    if not 0 < confidence < 1:
        raise ValueError(f"confidence must lie between 0 and 1, got {confidence:g}")
    if n_resamples < 1:
        raise ValueError(f"n_resamples must be at least 1, better some hundred, got {n_resamples}")
    parameters, values = _parameters(dataset), _results(dataset, results)
    found = np.stack(list(values.values()))
    missing = np.flatnonzero(~np.isfinite(found).all(axis=0))
    if len(missing):
        raise ValueError(
            f"{len(missing)} of {len(parameters)} runs lack a result (run {', '.join(map(str, missing[:5]))}"
            f"{' ...' if len(missing) > 5 else ''}); Sobol' indices need every run of their plan: mend what fails and "
            "call the study again, name results that all runs have, or take correlations, which leave runs out"
        )
    a, b, mixed = _blocks(parameters, found)
    generator, n = np.random.default_rng(seed), a.shape[-1]
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
    """How results go along with parameters: `pearson` in proportion, `spearman` by rank, over (result, parameter).

    Runs without a result are left out for that result; `n_runs` of them are counted, over result. What does not vary
    correlates with nothing: NaN. results: names (default: all of one number a run)

    Raises ValueError for unknown results, and where fewer than three runs have a result.
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
    """How far results move while one parameter goes through its range, by the plane that fits best.

    results: names (default: all of one number a run); coverage: share of a parameter's values that its range holds, as
        many left out below as above

    Returns over (result, parameter) `effect`, the change from the range's lower to its upper end, in the result's unit,
    and `own_share`, the share of the parameter's variance that follows from no other one's [-], 1 for independent ones;
    over result `mean`, of the runs, and `explained`, the share of the variance that the plane has too [-]: where it is
    far below one, look at `sobol_indices`. Runs without a result are left out for that result.

    Warns of parameters whose own share is below 0.1. Raises ValueError for unknown results, where fewer runs than two
    more than parameters have a result, and for parameters that follow from each other, of which none has an effect of
    its own.
    """
    if not 0 < coverage <= 1:
        raise ValueError(f"coverage must lie in 0 ... 1 (0 excluded), got {coverage:g}")
    parameters, values = _parameters(dataset), _results(dataset, results)
    low, high = np.quantile(parameters.values, [0.5 - 0.5 * coverage, 0.5 + 0.5 * coverage], axis=0)
    places = (parameters.values - low) / np.where(high > low, high - low, np.inf)
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
        figures["effect"].append(plane[1:])
        figures["mean"].append(value[there].mean())
        left = np.var(value[there] - columns @ plane)
        figures["explained"].append(1 - left / np.var(value[there]) if np.ptp(value[there]) > 0 else np.nan)
    axes = {"result": list(values), "parameter": list(parameters.names)}
    both = ("result", "parameter")
    dims = {"effect": both, "own_share": both, "mean": ("result",), "explained": ("result",)}
    return _labelled({key: (dims[key], np.array(rows)) for key, rows in figures.items()}, axes, coverage=coverage)


def _own_shares(values: Array) -> Array:
    """Share of each column's variance, (n, parameters), that no combination of the others has; NaN if there is none."""
    centred = values - values.mean(axis=0)
    sizes = np.where(np.ptp(values, axis=0) > 0, np.linalg.norm(centred, axis=0), np.nan)
    unit = np.nan_to_num(centred / sizes)
    shares = []
    for k, size in enumerate(sizes):
        others = np.delete(unit, k, axis=1)
        left = unit[:, k] - others @ np.linalg.lstsq(others, unit[:, k], rcond=None)[0]
        shares.append(float(left @ left) if np.isfinite(size) else np.nan)
    return np.array(shares)


def _check_own_shares(shares: Mapping[str, float], result: str) -> None:
    """Raise ValueError or warn of parameters that do not vary independently in the runs with a result."""
    dependent = [repr(name) for name, share in shares.items() if share < NONE]
    if dependent:
        raise ValueError(
            f"parameters {', '.join(dependent)} follow from each other in the runs with a result {result!r}, by own "
            f"shares of their variance below {NONE:g}: no plane tells their effects apart; vary them independently, or "
            "leave all but one of them out of the dataset"
        )
    weak = {name: share for name, share in shares.items() if share < LITTLE}
    if weak:
        told = ", ".join(f"{name!r} {100 * share:.2g} %" for name, share in weak.items())
        warn(
            f"parameters hardly vary independently in the runs with a result {result!r}; own shares of their variance: "
            f"{told}. Their effects scatter {min(weak.values()) ** -0.5:.2g} times as much as they otherwise would",
            stacklevel=3,
        )


def _labelled(
    variables: Mapping[str, tuple[tuple[str, ...], Array]], axes: Mapping[str, list[str]], **attributes: float
) -> "xr.Dataset":
    import xarray as xr  # noqa: PLC0415 -- of the extra `studies`

    return xr.Dataset(variables, axes, attributes)


def _shares(a: Array, b: Array, mixed: Array) -> tuple[Array, Array]:
    """First-order and total shares, (n_results, n_parameters); for the shapes see `_blocks`."""
    both = np.concatenate([a, b], axis=1)
    variance = np.where(np.ptp(both, axis=1) > 0, np.var(both, axis=1), np.nan)[:, None]
    first = np.mean(b * (mixed - a), axis=-1).T / variance
    total = 0.5 * np.mean((a - mixed) ** 2, axis=-1).T / variance
    return first, total


def _blocks(parameters: Samples, results: Array) -> tuple[Array, Array, Array]:
    """Results against their mean (n_results, n) of A, of B, and of A with a column of B (parameters, results, n)."""
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
    """Pearson's correlation of each column of x, (n, n_parameters), with y, (n,)."""
    directions = []
    for column in (y, *x.T):
        centred = column - column.mean()
        directions.append(centred / np.linalg.norm(centred) if np.ptp(column) > 0 else np.full(len(column), np.nan))
    return np.array(directions[1:]) @ directions[0]


def _parameters(dataset: "xr.Dataset") -> Samples:
    names = _along_runs(dataset.coords)
    if not names:
        raise ValueError(
            "the study has no parameters along 'run', as sweep gives them of samples; of a grid, stack them"
        )
    return Samples(names, np.column_stack([dataset[name].values for name in names]))


def _results(dataset: "xr.Dataset", names: Sequence[str] | None) -> Mapping[str, Array]:
    """Results of one number a run, (n_runs,), by name; all of them for None."""
    found = {name: dataset[name].values.astype(float) for name in _along_runs(dataset.data_vars)}
    if not found:
        raise ValueError("the study has no result of one number a run; let its function return numbers by name")
    return {
        name: found[known("result of one number a run", name, found)] for name in (found if names is None else names)
    }


def _along_runs(variables: "Mapping[Hashable, xr.DataArray]") -> tuple[str, ...]:
    """Names of the numbers that a function took or gave, one a run."""
    numbers = {str(name) for name, axis in variables.items() if axis.dims == (RUN,) and axis.dtype.kind in "fiu"}
    return tuple(name for name in map(str, variables) if name in numbers - set(OWN))
