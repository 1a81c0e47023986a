"""Node coordinates that the matrices of a free body tell by themselves, and why those of a file do not fit them.

The motions that a free body does not resist are its rigid ones. How they move one node beside another tells where the
two lie: u_k = u_0 + r x (p_k - p_0). No coordinates of a file enter that.
"""

from dataclasses import replace

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.exchange.row_order import FITS, order_misfit
from nassim.exchange.superelement import Superelement

COORDINATE_UNITS = {1e-3: "mm", 1e3: "m, and the matrices' length mm", 0.0254: "inches", 1 / 0.0254: "m, not inches"}
DEGREE = np.pi / 180
FREE = 0.1
"""Highest frequency of the six rigid motions over the lowest elastic one, up to which K tells the rigid motions."""
AWAY = 0.01
"""Distance of a node from where the matrices put it, over the size of the body, from which its coordinates are wrong.
Matrices of four digits tell places to some 0.3 %."""
TURNED = 0.1
"""Deviation of rigid rotations from one node to the next [rad/rad] above which the rows are no node's ux ... rz."""


def unresisted_motions(stiffness: Array, mass: Array) -> Array | None:
    """The six motions that symmetric K resists least, (n, 6); None where it resists them, so that K is damaged."""
    if len(stiffness) <= 6:
        return None
    scale = 1.0 / np.sqrt(np.diag(mass))
    squares, vectors = scipy.linalg.eigh(scale[:, None] * stiffness * scale, scale[:, None] * mass * scale)
    order = np.argsort(np.abs(squares))
    sizes = np.sqrt(np.abs(squares[order]))
    motions: Array = scale[:, None] * vectors[:, order[:6]]
    return motions if sizes[5] <= FREE * sizes[6] else None


def told_positions(motions: Array, n_nodes: int) -> Array | None:
    """Positions of the nodes relative to the first that unresisted motions (n, 6) tell, (r, 3) [m].

    None where the rows are not ux uy uz rx ry rz of node after node along common axes.
    """
    first = motions[:6]
    if np.linalg.matrix_rank(first / np.maximum(np.abs(first).max(axis=1, keepdims=True), 1e-300)) < 6:
        return None
    from_first = motions[: 6 * n_nodes].reshape(n_nodes, 6, 6) @ np.linalg.inv(first)
    for block in (slice(0, 3), slice(3, 6)):
        if np.abs(from_first[:, block, block] - np.eye(3)).max() > TURNED:
            return None
    arms = from_first[:, :3, 3:]  # -skew(p_k - p_0)
    result: Array = 0.5 * np.stack([arms[:, a, b] - arms[:, b, a] for a, b in ((1, 2), (2, 0), (0, 1))], axis=-1)
    return result


def explain_misfit(body: Superelement, told: Array, size: float) -> str:
    """Say in words why given coordinates differ from told ones, (r, 3) [m]; empty where they fit within `AWAY`.

    size: of the body [m]
    """
    given, names, near = body.positions, body.names, AWAY * size
    away = np.linalg.norm((given - told)[:, None] - (given - told), axis=-1)
    witness = int(np.argmin(np.sum(away > near, axis=0)))  # most nodes agree with this one
    wrong = np.flatnonzero(away[:, witness] > near)
    if not len(wrong):
        return ""
    for start in given:
        apart = np.linalg.norm((told + start)[:, None] - given, axis=-1)
        order = apart.argmin(axis=1)
        if apart.min(axis=1).max() <= near and len(set(order)) == len(order):
            return f"the coordinates are shuffled; they fit in the order {' '.join(names[k] for k in order)}"
    if len(wrong) <= max(1, len(given) // 2):
        places = 1e3 * (given[witness] + told[wrong] - told[witness])
        return "; ".join(
            f"{names[k]} is given {1e3 * away[k, witness]:.3g} mm from ({', '.join(f'{x:.3f}' for x in place)}) mm, "
            f"where the matrices put it beside {names[witness]}"
            for k, place in zip(wrong[:3], places, strict=False)
        )
    distances = [np.linalg.norm(points[:, None] - points, axis=-1) for points in (given, told)]
    if np.abs(distances[0] - distances[1]).max() <= near:
        return "the coordinates are turned or mirrored: along other axes than the rows"
    return "the coordinates are of other nodes or of another body"


def other_units(body: Superelement, misfit: float) -> tuple[str, dict[str, float]] | None:
    """Units of coordinates or rotations in which these fit the matrices: in words, and the factor as a figure."""
    for factor, unit in COORDINATE_UNITS.items():
        if _fit(replace(body, positions=factor * body.positions), misfit):
            text = f"the coordinates seem to be in {unit}: they fit when multiplied by {factor:g}"
            return text, {"coordinate_factor": factor}
    if _fit(from_degrees(body), misfit):
        return f"rotations seem to be in degrees: they fit when multiplied by {DEGREE:.5g}", {}
    return None


def _fit(body: Superelement, misfit: float) -> bool:
    """Whether a body read otherwise passes the rigid-motion test, and much better than as given."""
    return order_misfit(body) <= min(FITS, 0.2 * misfit)


def from_degrees(body: Superelement) -> Superelement:
    """The body if its matrices are those of rotations in degrees."""
    unit = np.ones(len(body.mass_matrix))
    unit[: 6 * len(body.positions)] = np.tile([1.0] * 3 + [DEGREE] * 3, len(body.positions))
    scale = np.outer(unit, unit)
    return replace(body, stiffness_matrix=body.stiffness_matrix / scale, mass_matrix=body.mass_matrix / scale)
