"""Assignment of the rows of foreign matrices to the coordinates of nodes by the rigid-body test.

A free body has no stiffness against rigid-body motions, and its mass in these motions is that of a rigid body. Both
conditions hold for only one order of the rows, unless nodes coincide or the body is symmetric.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray

from nassim.base.checks import Array
from nassim.base.short_repr import short_repr
from nassim.bodies.inertia import rigid_inertia
from nassim.exchange.superelements import Superelement

FITS = 0.02
"""Largest misfit of a right order, for matrices of three digits or more."""
MANY_NODES = 4
ROWS_AT_ONCE = 200_000
"""Number of rows tested at a time."""


@dataclass(frozen=True)
class OrderGuess:
    """Order of rows that fits better than the given one.

    Attributes:
        rows: argument for `Superelement.reordered`.
        text: description of the order.
        misfit: misfit of this order [-].
        given_misfit: misfit of the given order [-].
        alternatives: number of other orders that fit equally well.
    """

    rows: tuple[int, ...]
    text: str
    misfit: float
    given_misfit: float
    alternatives: int = 0
    __repr__ = short_repr


def rigid_residual(stiffness: Array, motions: Array) -> Array:
    """Compute the forces K R that rigid-body motions cause, over the sum of the magnitudes of their terms; 0 for a free
    body.

    Args:
        stiffness: K, (n, n).
        motions: R, (..., n, 6).

    Returns:
        Residual of each motion, (..., 6) [-].
    """
    diagonal = np.abs(np.diag(stiffness))
    scale = 1.0 / np.sqrt(np.maximum(diagonal, max(1e-12 * diagonal.max(), 1e-100)))
    scaled = scale[:, None] * stiffness * scale
    amplitudes = motions / scale[:, None]
    force = np.linalg.norm(scaled @ amplitudes, axis=-2)
    size = np.linalg.norm(np.abs(scaled) @ np.abs(amplitudes), axis=-2)
    return force / np.where(size > 0, size, 1.0)


def order_misfit(body: Superelement) -> float:
    """Return the misfit of the rigid-body test for the given order: near 0 (rounding) if right, 0.1 to 1 if wrong.

    Args:
        body: the superelement.
    """
    residual = float(rigid_residual(body.stiffness_matrix, body.rigid_motions).max())
    return max(residual, rigid_inertia(body.mass_matrix, body.rigid_motions).misfit)


def guess_order(body: Superelement) -> OrderGuess | None:
    """Find an order of rows that passes the rigid-body test.

    The search includes rotations first, alternating coordinates, all translations first, direction by direction,
    permuted axes, modal rows first, and the nodes in any order (more than four nodes: all reversed, or two of the first
    eight swapped).

    Args:
        body: the superelement.

    Returns:
        The order; None where the given order passes, or no order does.
    """
    given = order_misfit(body)
    if given <= FITS:
        return None
    r, n = len(body.positions), len(body.mass_matrix)
    orders, texts = zip(*_orders(r, n), strict=True)
    rows = np.array(orders)
    chunk = max(1, ROWS_AT_ONCE // n)
    stiff = np.concatenate(
        [
            rigid_residual(body.stiffness_matrix, _motions(body, rows[start : start + chunk])).max(axis=-1)
            for start in range(0, len(rows), chunk)
        ]
    )
    candidates = np.argsort(stiff, kind="stable")[: int(np.sum(stiff <= FITS))]
    misfits = np.array(
        [max(stiff[k], rigid_inertia(body.mass_matrix, _motions(body, rows[[k]])[0]).misfit) for k in candidates]
    )
    good = [k for k, misfit in zip(candidates, misfits, strict=True) if misfit <= max(FITS / 10, 3 * misfits.min())]
    if not good or misfits.min() > min(FITS, 0.2 * given):
        return None
    chosen = min(good)
    order = tuple(rows[chosen].tolist())
    nodes = texts[chosen].format(*body.names)
    rest = tuple(k for k in range(n) if k not in order)
    return OrderGuess(order + rest, nodes, float(misfits.min()), given, len(good) - 1)


def _motions(body: Superelement, rows: NDArray[np.int64]) -> Array:
    """Return rigid-body motions in coordinates at the given rows, (m, n, 6) for rows (m, 6 r)."""
    standard = body.rigid_motions[: rows.shape[1]]
    result = np.zeros((len(rows), len(body.mass_matrix), 6))
    np.put_along_axis(result, rows[:, :, None], np.broadcast_to(standard, (len(rows), *standard.shape)), 1)
    return result


def _orders(r: int, n: int) -> Iterator[tuple[NDArray[np.int64], str]]:
    """Yield the row of each coordinate (6 r,) in every order of the search, and its description, the simplest first."""
    i, d = (index.ravel() for index in np.divmod(np.arange(6 * r), 6))
    place, is_rotation = d % 3, d // 3
    layouts = {
        "": 6 * i + d,
        "rotations before translations at each node": 6 * i + (d + 3) % 6,
        "ux rx uy ry uz rz at each node": 6 * i + 2 * place + is_rotation,
        "the translations of all nodes, then all rotations": 3 * r * is_rotation + 3 * i + place,
        "the rotations of all nodes, then all translations": 3 * r * (1 - is_rotation) + 3 * i + place,
        "direction by direction, ux of all nodes first": r * d + i,
        "direction by direction, rx of all nodes first": r * ((d + 3) % 6) + i,
    }
    seen = set()
    starts = [0] if n == 6 * r else [0, n - 6 * r]
    for start in starts:
        for layout, rows in layouts.items():
            for axes in permutations(range(3)):
                for nodes in _node_orders(r):
                    # Coordinate (i, d) has the row of node nodes.index(i), direction axes.index(d) in the layout.
                    swapped = 6 * np.argsort(nodes)[i] + 3 * is_rotation + np.argsort(axes)[place]
                    order = start + rows[swapped]
                    if order.tobytes() in seen:
                        continue
                    seen.add(order.tobytes())
                    parts = [
                        "modal rows first" if start else "",
                        layout,
                        "" if axes == (0, 1, 2) else f"the axes in the order {' '.join('xyz'[a] for a in axes)}",
                        "" if nodes == tuple(range(r)) else f"the nodes in the order {_describe_nodes(nodes)}",
                    ]
                    yield order, "; ".join(part for part in parts if part)


def _describe_nodes(nodes: tuple[int, ...]) -> str:
    """Describe the moved nodes as fields that a format fills with the names."""
    if len(nodes) > MANY_NODES:
        moved = [k for k, node in enumerate(nodes) if k != node]
        if len(moved) > 2:
            return "last to first"
        return f"given, but {{{moved[0]}}} and {{{moved[1]}}} swapped"
    return " ".join(f"{{{node}}}" for node in nodes)


def _node_orders(r: int) -> Iterator[tuple[int, ...]]:
    if r <= MANY_NODES:
        yield from permutations(range(r))
        return
    yield tuple(range(r))
    yield tuple(reversed(range(r)))
    for a, b in combinations(range(min(r, 8)), 2):
        nodes = list(range(r))
        nodes[a], nodes[b] = b, a
        yield tuple(nodes)
