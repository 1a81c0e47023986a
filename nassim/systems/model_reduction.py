"""Balanced truncation of linear models and controllers, with its error bound."""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from nassim.base.checks import Array, positive, whole_number
from nassim.base.short_repr import short_repr
from nassim.systems.linear_model import LinearModel
from nassim.systems.norms import covariance
from nassim.systems.state_space import comparable_states

KEPT = 1e-7
"""Motions that decay by less than this fraction of the fastest pole's rate are kept: rounding splits double poles at
the origin by some 1e-8."""
SMALLEST = 1e-12
"""Hankel singular values below this fraction of the largest are rounding."""


@dataclass(frozen=True)
class BalancedTruncation:
    """Result of a balanced truncation.

    Attributes:
        model: the model with fewer states.
        error_bound: bound on the H-infinity norm of the difference.
        hankel_singular_values: of the stable part of the given model, the largest first, (n,).
        n_kept: number of states of the part that was not reduced: growing and undamped motions.
    """

    model: LinearModel
    error_bound: float
    hankel_singular_values: Array
    n_kept: int
    __repr__ = short_repr


def balanced_truncation(
    model: LinearModel, n_states: int | None = None, *, error: float | None = None
) -> BalancedTruncation:
    """Remove the states that contribute least between the inputs and the outputs.

    Growing and undamped motions, such as rigid-body modes and integrators, are kept as they are. Inputs and outputs
    count by their units: scale them to comparable sizes first (`with_inputs`, `with_outputs`).

    Args:
        model: continuous or sampled model.
        n_states: number of states of the result.
        error: largest admitted `error_bound`; give either this or `n_states`.

    Returns:
        The model with fewer states and the bound on its error.

    Raises:
        ValueError: unless exactly one of n_states and error is given, and for fewer states than those that are kept.

    Source: K. Glover, All optimal Hankel-norm approximations of linear multivariable systems and their error bounds,
        International Journal of Control 39 (1984) 1115-1193.
    """
    if (n_states is None) == (error is None):
        raise ValueError("give either n_states or error")
    left, right, kept = _split(model)
    a, b, c = left @ model.A @ right, left @ model.B, model.C @ right
    own = slice(kept, None)
    values, into, back = _balance(a[own, own], b[own], c[:, own], sampled=model.time_step is not None)
    bounds = 2 * np.concatenate([np.cumsum(values[::-1])[::-1], [0.0]])
    usable = int(np.sum(values > SMALLEST * values.max(initial=0.0)))
    if n_states is not None:
        n = whole_number("n_states", n_states, 1) - kept
        if n < 0:
            raise ValueError(f"{kept} states belong to growing or undamped motions and are kept; give at least as many")
    else:
        n = int(np.argmax(bounds <= positive("error", error or 0.0)))
    n = min(n, usable)
    left = scipy.linalg.block_diag(np.eye(kept), into[:n]) @ left
    right = right @ scipy.linalg.block_diag(np.eye(kept), back[:, :n])
    reduced = replace(model, A=left @ model.A @ right, B=left @ model.B, C=model.C @ right, unsupported=np.zeros(0))
    return BalancedTruncation(reduced, float(bounds[n]), values, kept)


def _split(model: LinearModel) -> tuple[Array, Array, int]:
    """Return changes of state that separate growing and undamped motions from the others, and the number of the first.

    left @ A @ right is block-diagonal, with left @ right = 1.
    """
    balanced, scale = comparable_states(model.A, model.B, model.C)
    fastest = np.abs(np.linalg.eigvals(balanced)).max(initial=0.0)

    def slow(re: float, im: float) -> bool:
        return bool(np.hypot(re, im) >= 1 - KEPT if model.time_step is not None else re >= -KEPT * fastest)

    schur, vectors, kept = scipy.linalg.schur(balanced, output="real", sort=slow)
    into, back = vectors.T / scale, scale[:, None] * vectors
    n = len(model.A)
    if kept in (0, n):
        return into, back, int(kept)
    first, second, between = schur[:kept, :kept], schur[kept:, kept:], schur[:kept, kept:]
    x = scipy.linalg.solve_sylvester(first, -second, -between)
    change = np.eye(n)
    change[:kept, kept:] = x
    undo = np.eye(n)
    undo[:kept, kept:] = -x
    return undo @ into, back @ change, int(kept)


def _balance(a: Array, b: Array, c: Array, *, sampled: bool) -> tuple[Array, Array, Array]:
    """Return the Hankel singular values, and the changes of a stable model to balanced states and back."""
    if not len(a):
        return np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0))
    reach, show = (_root(covariance(m, w, sampled=sampled)) for m, w in ((a, b), (a.T, c.T)))
    u, values, v = np.linalg.svd(show.T @ reach)
    scale = 1 / np.sqrt(np.maximum(values, SMALLEST * values.max(initial=0.0) or 1.0))
    return values, (u * scale).T @ show.T, reach @ (v.T * scale)


def _root(gramian: Array) -> Array:
    """Return a square root of a Gramian, whose small eigenvalues may be negative by rounding."""
    eigenvalues, vectors = np.linalg.eigh((gramian + gramian.T) / 2)
    return vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
