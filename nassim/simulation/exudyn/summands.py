"""Summands of outputs: sums of the columns of Exudyn's sensors, whose samples do not depend on each other."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array


@dataclass(frozen=True)
class Summand:
    """One summand of an output.

    Attributes:
        sensors: Exudyn's sensor numbers.
        value: function of their columns, (n_samples, k) each, that returns the summand, (n_samples,).
        weights: weights of the columns of one sensor, where the summand is their weighted sum.
        period: increase of an unwrapped summand by a full turn, the ambiguity of single samples; 0 without unwrapping.
    """

    sensors: tuple[int, ...]
    value: Callable[..., Array]
    weights: Array | None = None
    period: float = 0.0

    @classmethod
    def linear(cls, sensor: int, weights: Array) -> "Summand":
        """Make a weighted sum of one sensor's columns."""
        column = np.reshape(weights, (-1, 1))
        return cls((sensor,), lambda columns: np.matmul(columns[:, None, :], column)[:, 0, 0], weights)


def weighted(rows: Array, columns: Array) -> Array:
    """Multiply weights, (m, k), with one sample of k columns, (k,), or with each of several, (n, k).

    No digit of a sample depends on the others.

    Returns:
        The weighted sums, (m,) or (n, m).
    """
    return np.matmul(rows, columns[..., None])[..., 0]


def dot(a: Array, b: Array) -> Array:
    """Sum of products over the last axis of two arrays, one by one: no digit of a sample depends on the others."""
    result: Array = a[..., 0] * b[..., 0]
    for k in range(1, a.shape[-1]):
        result = result + a[..., k] * b[..., k]
    return result


def unwrapped(term: Summand, values: Array) -> Array:
    """Return a summand's samples, (n_samples,), unwrapped by whole turns from each sample to the next."""
    if not term.period:
        return values
    turns = np.append(0.0, np.cumsum(np.round((values[:-1] - values[1:]) / term.period)))
    return values + term.period * turns
