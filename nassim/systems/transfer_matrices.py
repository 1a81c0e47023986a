"""Frequency responses of state spaces: sums over modes, checked against direct solves."""

import contextlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nassim.base.checks import Array
from nassim.base.field_types import ArrayLike
from nassim.base.warning_log import warn
from nassim.systems.state_space import (
    EPSILON,
    WELL_CONDITIONED,
    StateSpace,
    balanced_system,
    checked_system,
    uncoupled,
)

CHECKED = 8
"""Number of poles of a part, the nearest to the points, at which its modal sum is checked."""

AGREED = 1e-9
"""Largest difference of the modal sum from a direct solve, relative to the response, with which the sum is used."""

RESPONSE_ROUNDING = 1e-14
"""Relative change of the rows of A; a response no larger than the effect of this change is rounding."""

AT_ONCE = 2**18
"""Numbers in the states, or in the matrices of direct solves, at all points of a block: larger ones leave the cache."""

ROUNDING = 1e-9
"""Share by which a frequency may exceed half of the sample rate."""

Parts = tuple[Array, Array, Array]
"""A, B and C of systems, with optional leading axes; or their poles, input factors and output factors."""


def transfer_matrix(system: StateSpace, points: ArrayLike) -> Array:
    """Compute C (s - A)^-1 B + D at complex points s or z.

    The response is a sum over the eigenvectors of the uncoupled parts of A, which takes milliseconds. The sum of each
    part is compared with a direct solve at the first and last point and near poles. Where it differs, as in responses
    that symmetry nearly cancels, the sum gets one step of iterative refinement and is compared again. A part that still
    differs, or whose eigenvectors are not independent (a double pole, as in rigid-body motion with little or no
    damping, or in delays), is solved directly at every point.

    Args:
        system: continuous or sampled system.
        points: complex, (n,) [rad/s], or points in the z-plane.

    Returns:
        Complex, (outputs, inputs, n); infinite at poles.

    Raises:
        ValueError: for matrices whose shapes do not agree, and for points that are no vector.
    """
    a, b, c, d = checked_system(system)
    points = np.array(points, dtype=complex)
    if points.ndim != 1:
        raise ValueError(f"points must be a vector, got the shape {points.shape}")
    if not (d.size and points.size):
        return np.zeros((*d.shape, len(points)), dtype=complex)
    balanced, b, c = balanced_system(a, b, c)
    result = np.broadcast_to(d.reshape(-1, 1), (d.size, len(points))).astype(complex)
    for index in uncoupled(a):
        parts = balanced[index[:, :, None], index[:, None]], b[index], c[:, index].swapaxes(0, 1)
        modes, spanned = _modes(parts)
        checks = _Checks.of(parts, modes[0], points)
        right = spanned & checks.agree(*_modal_sums(modes, checks.points))
        for k in np.flatnonzero(~right).tolist():
            a_k, b_k, c_k = part = parts[0][k], parts[1][k], parts[2][k]
            own = checks.of_part(k)
            if spanned[k] and own.agree(_refined_sum(part, own.points[0])[None], 0.0)[0]:
                found = _refined_sum(part, points)
            else:
                blocks = np.array_split(points[:, None, None], len(points) * a_k.size // AT_ONCE + 1)
                with np.errstate(invalid="ignore"):
                    found = np.concatenate([c_k @ _solved(a_k, b_k, s) for s in blocks])
            result += found.reshape(len(points), -1).T
        poles, drives, shows = (of[right] for of in modes)
        # Sums over all parts and their poles at once: (outputs * inputs, poles) times (poles, points).
        terms = np.einsum("pon,pni->oipn", shows, drives).reshape(d.size, -1)
        with np.errstate(divide="ignore", invalid="ignore"):
            result += terms @ (1.0 / (points - poles.reshape(-1, 1)))
    return result.reshape(*d.shape, len(points))


def refuse_infinite(frequency: Array, values: Array) -> None:
    """Raise ValueError for responses, (outputs, inputs, n), that are infinite at some of the frequencies, (n,) [Hz]."""
    infinite = frequency[~np.isfinite(values).all(axis=(0, 1))]
    if infinite.size:
        raise ValueError(
            f"the response is infinite at {', '.join(f'{f:g}' for f in infinite[:5])} Hz, where there is a pole "
            "without damping (at 0 Hz: an integrator, or a motion that nothing holds); take other frequencies"
        )


def warn_above_nyquist(what: str, frequency: Array, time_step: float | None) -> None:
    """Warn of frequencies above half the sample rate of what is sampled.

    Args:
        what: what is sampled, for the message.
        frequency: (n,) [Hz].
        time_step: its time step; None if it is not sampled [s].
    """
    if time_step is None or frequency.max(initial=0.0) <= 0.5 / time_step * (1 + ROUNDING):
        return
    warn(
        f"the {what} is sampled at {1 / time_step:g} Hz: above {0.5 / time_step:g} Hz its response mirrors that below; "
        f"the frequencies reach {frequency.max():g} Hz"
    )


def _modes(parts: Parts) -> tuple[Parts, NDArray[np.bool_]]:
    """Return the modes of p parts, and which are valid.

    The modes are poles (p, n), input factors (p, n, inputs) and output factors (p, outputs, n).
    The condition number of unit eigenvectors decides whether they are independent. After a scaling of their rows,
    parallel eigenvectors may look different.
    """
    a, b, c = parts
    poles, vectors = np.linalg.eig(a)
    spanned = np.linalg.cond(vectors) < WELL_CONDITIONED
    drives = np.zeros(b.shape, complex)
    drives[spanned] = np.linalg.solve(vectors[spanned], b[spanned].astype(complex))
    return (poles, drives, c @ vectors), spanned


@dataclass(frozen=True)
class _Checks:
    """Direct solves of p parts at both end points and at k of the points that are closest to poles.

    Attributes:
        points: complex, (p, k + 2).
        expected: responses there, (p, k + 2, outputs, inputs).
        rounding: responses no larger than these are rounding, same shape.
    """

    points: Array
    expected: Array
    rounding: Array

    @classmethod
    def of(cls, parts: Parts, poles: Array, points: Array) -> "_Checks":
        """Solve parts with poles, (p, n), at some of the points, (n,)."""
        a, b, c = parts
        distance = np.abs(points - poles[..., None])
        with np.errstate(divide="ignore", invalid="ignore"):
            closest = np.argsort(distance.min(axis=2) / np.abs(poles), axis=1)[:, :CHECKED]
        near = np.take_along_axis(distance.argmin(axis=2), closest, axis=1)
        at = points[np.hstack([np.broadcast_to([0, len(points) - 1], (len(a), 2)), near])]
        states = _solved(a[:, None], b[:, None], at[..., None, None])
        adjoint = _solved(a[:, None].swapaxes(2, 3), c[:, None].swapaxes(2, 3), at[..., None, None])
        with np.errstate(divide="ignore", invalid="ignore"):
            by_rows = np.abs(adjoint).swapaxes(2, 3) @ np.linalg.norm(a, axis=2)[:, None, :, None]
            rounding = RESPONSE_ROUNDING * by_rows * np.linalg.norm(states, axis=2, keepdims=True)
            return cls(at, c[:, None] @ states, rounding)

    def of_part(self, k: int) -> "_Checks":
        """Return the checks of one part, p = 1."""
        return _Checks(self.points[k, None], self.expected[k, None], self.rounding[k, None])

    def agree(self, found: Array, lost: Array | float) -> NDArray[np.bool_]:
        """Return which parts' responses equal the direct solves, bool, (p,).

        The tolerance is relative to each response, unless it is only rounding in both, as symmetry causes. The loss of
        digits by cancelling terms, lost, counts as a difference, because other points may round differently.
        """
        with np.errstate(invalid="ignore"):
            same = np.abs(found - self.expected) + lost <= AGREED * np.abs(self.expected)
            nothing = np.maximum(np.abs(found), np.abs(self.expected)) + lost <= self.rounding
        return np.all(same | nothing, axis=(1, 2, 3))


def _modal_sums(modes: Parts, at: Array) -> tuple[Array, Array]:
    """Return the modal sums of p parts at k points each, (p, k), and their loss by cancelling terms, (p, k, o, i)."""
    poles, drives, shows = modes
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = shows[:, None] / (at[..., None, None] - poles[:, None, None])
        return terms @ drives[:, None], EPSILON * (np.abs(terms) @ np.abs(drives[:, None]))


def _refined_sum(part: Parts, points: Array) -> Array:
    """Compute C (s - A)^-1 B of one part at points by the modal sum and one step of iterative refinement.

    Returns:
        The responses, (points, outputs, inputs).
    """
    a, b, c = part
    n, n_in = b.shape
    poles, vectors = np.linalg.eig(a)
    inverse, shows = np.linalg.inv(vectors), c @ vectors
    drives, pieces = inverse @ b, []
    for s in np.array_split(points, len(points) * n * n_in // AT_ONCE + 1):
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse_gaps = 1 / (s - poles[:, None])[:, :, None]
            states = vectors @ (drives[:, None] * inverse_gaps).reshape(n, -1)
            rates = (s[:, None] * states.reshape(n, -1, n_in)).reshape(n, -1)
            left = np.repeat(b[:, None], len(s), axis=1).reshape(n, -1) - rates + a @ states
            change = ((inverse @ left).reshape(n, -1, n_in) * inverse_gaps).reshape(n, -1)
            found = c @ states + shows @ change
        pieces.append(found.reshape(len(c), -1, n_in).swapaxes(0, 1))
    return np.concatenate(pieces)


def _solved(state: Array, inputs: Array, points: Array) -> Array:
    """Solve (s - A)^-1 B at each point, (..., n, inputs); infinite at poles.

    points: (..., 1, 1), whose leading axes are broadcast with those of A and B
    """
    matrices = points * np.eye(state.shape[-1]) - state
    forces = np.broadcast_to(inputs, (*matrices.shape[:-1], inputs.shape[-1])).astype(complex)
    try:
        result: Array = np.linalg.solve(matrices, forces)
    except np.linalg.LinAlgError:
        result = np.full(forces.shape, np.inf + 0j)
        for k in np.ndindex(matrices.shape[:-2]):
            with contextlib.suppress(np.linalg.LinAlgError):
                result[k] = np.linalg.solve(matrices[k], forces[k])
    return result
