"""Sampling plans: parameters of the runs of a study from the distribution of each parameter.

A distribution is a frozen one of scipy.stats, such as norm(5.0, 0.1) or uniform(4.9, 0.2), which lies between 4.9 and
5.1. Parameters are independent of each other. The same seed gives the same plan.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.stats import qmc

from nassim.base.checks import Array, whole_number
from nassim.studies.samples import Samples, parameter_names

EDGE = 2.0**-53
"""Smallest distance of a probability from 0 and 1, where many distributions are infinite."""

BITS = 64
"""Number of bits of the coordinates of Sobol' points."""


def random_points(distributions: Mapping[str, Any], n: int, *, seed: int) -> Samples:
    """Draw n independent runs (plain Monte Carlo), whose mean has an error of the standard deviation over sqrt(n).

    Args:
        distributions: distributions by name of the parameter.
        n: number of runs.
        seed: seed of the plan.

    Returns:
        Samples of n runs.

    Raises:
        ValueError: for an empty mapping, for values that are not distributions, for n below 1, and for a seed that is
            not a whole number of at least 0.
    """
    names = parameter_names(tuple(distributions))
    n = whole_number("n", n, 1)
    shares = _generator(seed).random((n, len(names)))
    return _samples(distributions, shares, f"random points, n = {n}, seed {seed}")


def latin_hypercube(distributions: Mapping[str, Any], n: int, *, seed: int) -> Samples:
    """Draw a Latin hypercube: each parameter takes one value in each of n intervals of equal probability.

    It suits tens to hundreds of expensive runs. A larger plan contains no runs of a smaller one; `sobol_points` suits a
    study that may grow.

    Args:
        distributions: distributions by name of the parameter.
        n: number of runs.
        seed: seed of the plan.

    Returns:
        Samples of n runs.

    Raises:
        ValueError: in the cases of `random_points`.
    """
    names = parameter_names(tuple(distributions))
    n = whole_number("n", n, 1)
    shares = qmc.LatinHypercube(len(names), seed=_generator(seed)).random(n)
    return _samples(distributions, shares, f"latin hypercube, n = {n}, seed {seed}")


def sobol_points(distributions: Mapping[str, Any], n: int, *, seed: int) -> Samples:
    """Draw points of a scrambled Sobol' sequence, which fill the space evenly.

    A plan of twice as many runs begins with those of this one, so that a study can grow.

    Args:
        distributions: distributions by name of the parameter.
        n: number of runs, a power of two.
        seed: seed of the plan.

    Returns:
        Samples of n runs.

    Raises:
        ValueError: in the cases of `random_points`, and for an n that is not a power of two.
    """
    shares = _sobol_shares(len(parameter_names(tuple(distributions))), n, seed)
    return _samples(distributions, shares, f"sobol points, n = {len(shares)}, seed {seed}")


def saltelli_points(distributions: Mapping[str, Any], n: int, *, seed: int) -> Samples:
    """Draw the points for `sobol_indices`: n (d + 2) runs for d parameters.

    The rows are n of a matrix A, n of a matrix B, and for each parameter the n rows of A with the column of this
    parameter from B. Both matrices come from one Sobol' sequence.

    Args:
        distributions: distributions by name of the parameter.
        n: number of rows of A and of B, a power of two.
        seed: seed of the plan.

    Returns:
        Samples of n (d + 2) runs.

    Raises:
        ValueError: in the cases of `random_points`, and for an n that is not a power of two.

    Source: A. Saltelli et al., Comput. Phys. Commun. 181 (2010) 259-270.
    """
    d = len(parameter_names(tuple(distributions)))
    a, b = np.split(_sobol_shares(2 * d, n, seed), 2, axis=1)
    mixed = [np.where(np.arange(d) == k, b, a) for k in range(d)]
    return _samples(distributions, np.vstack([a, b, *mixed]), f"saltelli points, n = {len(a)}, seed {seed}")


def _generator(seed: int) -> np.random.Generator:
    return np.random.default_rng(whole_number("seed", seed, 0))


def _sobol_shares(d: int, n: int, seed: int) -> Array:
    n = whole_number("n", n, 1)
    if n & (n - 1):
        below = 2 ** (n.bit_length() - 1)
        raise ValueError(
            f"n must be a power of two for Sobol' points, got {n}; take {below} or {2 * below}, or "
            "latin_hypercube for any number"
        )
    return qmc.Sobol(d, bits=BITS, seed=_generator(seed)).random(n)


def _samples(distributions: Mapping[str, Any], shares: Array, plan: str) -> Samples:
    """Return parameters at given values of their distribution functions, (n_runs, n_parameters)."""
    inside = np.clip(shares, EDGE, 1 - EDGE)
    columns = [
        _quantiles(name, distribution, inside[:, k]) for k, (name, distribution) in enumerate(distributions.items())
    ]
    return Samples(tuple(distributions), np.column_stack(columns), plan)


def _quantiles(name: str, distribution: Any, shares: Array) -> Array:
    if not callable(getattr(distribution, "ppf", None)):
        raise ValueError(
            f"parameter {name!r} needs a frozen distribution of scipy.stats, such as norm(mean, deviation) or "
            f"uniform(lowest, width), got {distribution!r:.60}"
        )
    try:
        values = np.asarray(distribution.ppf(shares), dtype=float)
    except TypeError as error:
        raise ValueError(f"the distribution of {name!r} is not frozen, give it its parameters: {error}") from error
    if values.shape != shares.shape or not np.all(np.isfinite(values)):
        raise ValueError(f"the distribution of {name!r} gives no finite values; look at its parameters")
    return values
