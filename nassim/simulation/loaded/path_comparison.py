"""How far models at angles of a path differ, by their transfer functions and by the motions that constraints leave."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from nassim.base.checks import Array
from nassim.simulation.loaded.path_curves import parabola
from nassim.simulation.loaded.path_knots import Parts, PathKnot, transition
from nassim.simulation.loaded.path_loads import PathLoads

SMOOTHED = 0.05
"""Damping ratio that transfer functions are compared with: sharp resonances shift by more than they matter."""
COMPARED = 24
"""Number of frequencies at which transfer functions are compared."""
LEAST = 0.1
"""Least size of a transfer function over the geometric mean of those at its two ends."""
ASKEW = 0.37
"""Share of the spacing at which one more model is compared: a scene may repeat itself at all angles."""


@dataclass(frozen=True)
class PathDifferences:
    """Differences of the models at angles of assembly.

    Attributes:
        change: largest relative difference of transfer functions of neighbours, at least the error.
        error: largest relative error of transfer functions between every other angle.
        tilt: largest angle between the motions that constraints leave in neighbours [rad].
    """

    change: float
    error: float
    tilt: float


def compared_points(first: PathKnot, highest: float) -> Array:
    """Return the points s at which transfer functions are compared, complex (k,) [1/s].

    Args:
        first: a model of the path.
        highest: highest frequency that matters [Hz].
    """
    frequency = first.assembly.modal.frequency
    lowest = float(frequency[0])
    top = max(min(highest, 2 * float(frequency[-1])), 2 * lowest)
    return 2 * np.pi * np.geomspace(lowest / 3, top, COMPARED) * (1j - SMOOTHED)


def path_differences(
    knots: tuple[PathKnot, ...], beside: PathKnot, loads: PathLoads, points: Array, *, closed: bool
) -> PathDifferences:
    """Compare models at an even number of spaces between angles.

    Args:
        knots: the models.
        beside: a further one, `ASKEW` of twice the spacing beyond the first.
        loads: inertia of the rotor along the path.
        points: see `compared_points`.
        closed: whether the first angle follows the last.

    Returns:
        The differences.
    """
    parts = [one.parts(loads) for one in (*knots, beside)]
    exact = [_transfer(one, points) for one in parts]
    size = np.max([size for _, size in exact], axis=0)
    size[size == 0] = 1.0

    def difference(one: Array, other: Array) -> float:
        return float(np.max(np.abs(one - other) / size, initial=0.0))

    coarse = knots[::2]
    tested = [(k, 0.5, 2 * k + 1) for k in range(len(knots) // 2)] + [(0, ASKEW, len(knots))]
    error = 0.0
    for k, share, place in tested:
        middle = _joined(coarse, parts[:-1:2], parabola(k, share, len(coarse), closed=closed), k)
        error = max(error, difference(_transfer(middle, points)[0], exact[place][0]))
    around = [found for found, _ in (*exact[:-1], *exact[:1] * closed)]
    change = max(difference(one, other) for one, other in pairwise(around))
    tilt = max(transition(one, other)[1] for one, other in pairwise((*knots, *knots[:1] * closed)))
    return PathDifferences(max(change, error), error, tilt)


def _transfer(parts: Parts, points: Array) -> tuple[Array, Array]:
    """Compute transfer functions from the forces of a model to its readings, at points s, complex (k,) [1/s].

    Returns:
        The transfer functions, complex (k, outputs, inputs), and their sizes: the sum of the absolute shares of the
        modes, but at least `LEAST` of the geometric mean of the same for a motion that all modes have in phase.
    """
    stiffness, resistance, read, given = parts
    squares, shapes = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
    damping = shapes.T @ resistance @ shapes + 2 * SMOOTHED * np.diag(np.sqrt(np.abs(squares)))
    left, right = read @ shapes, shapes.T @ given
    dynamic = np.array([np.diag(squares + s**2) + s * damping for s in points])
    found = left @ np.linalg.solve(dynamic, right[None])
    alone = np.abs(1 / np.einsum("kmm->km", dynamic))
    shares = np.einsum("om,km,mi->koi", np.abs(left), alone, np.abs(right), optimize=True)
    seen, moved = alone @ left.T**2, alone @ right**2
    return found, np.maximum(shares, LEAST * np.sqrt(seen[:, :, None] * moved[:, None, :]))


def _joined(knots: Sequence[PathKnot], parts: Sequence[Parts], weights: Mapping[int, float], index: int) -> Parts:
    """Return a weighted sum of the matrices of models, along the modes of one of them, by its index."""
    result = [np.zeros_like(part) for part in parts[index]]
    for k, weight in weights.items():
        turn = transition(knots[k], knots[index])[0]
        stiffness, damping, read, given = parts[k]
        moved = turn @ stiffness @ turn.T, turn @ damping @ turn.T, read @ turn.T, turn @ given
        result = [total + weight * part for total, part in zip(result, moved, strict=True)]
    return tuple(result)
