"""Node coordinates derived from the matrices of a free body, and reasons why given coordinates differ from them.

A free body offers no resistance to its six rigid-body motions. The rigid-body motion of one node relative to another
gives their relative position: u_k = u_0 + r x (p_k - p_0). The derivation uses no given coordinates.
"""

from dataclasses import replace

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.exchange.row_order import FITS, order_misfit
from nassim.exchange.superelements import HUGE, Superelement

COORDINATE_UNITS = {1e-3: "mm", 1e3: "m, and the matrices' length mm", 0.0254: "inches", 1 / 0.0254: "m, not inches"}
DEGREE = np.pi / 180
RIGID_FREQUENCY_RATIO = 0.1
"""Highest frequency of the six rigid-body motions over the lowest elastic one, up to which K determines them."""
POSITION_TOLERANCE = 0.01
"""Distance of a node from its position by the matrices, over the body's size, above which its coordinates are wrong.

Matrices of four digits determine positions to some 0.3 %.
"""
LARGEST_ROTATION_ERROR = 0.1
"""Deviation of rigid rotations between nodes above which the rows are not ux ... rz of nodes [rad/rad]."""


def motions_without_stiffness(stiffness: Array, mass: Array) -> Array | None:
    """Return the six motions of least stiffness of a symmetric K, (n, 6); None unless they are rigid-body motions."""
    if len(stiffness) <= 6:
        return None
    scale = 1.0 / np.sqrt(np.diag(mass))
    squares, vectors = scipy.linalg.eigh(scale[:, None] * stiffness * scale, scale[:, None] * mass * scale)
    order = np.argsort(np.abs(squares))
    sizes = np.sqrt(np.abs(squares[order]))
    motions: Array = scale[:, None] * vectors[:, order[:6]]
    return motions if sizes[5] <= RIGID_FREQUENCY_RATIO * sizes[6] else None


def positions_from_motions(motions: Array, n_nodes: int) -> Array | None:
    """Return the positions of the nodes relative to the first one, derived from the six motions without stiffness.

    Args:
        motions: (n, 6), from `motions_without_stiffness`.
        n_nodes: number of nodes r.

    Returns:
        Positions, (r, 3) [m]; None where the rows are not ux uy uz rx ry rz of node after node along common axes.
    """
    first = motions[:6]
    if np.linalg.matrix_rank(first / np.maximum(np.abs(first).max(axis=1, keepdims=True), 1e-300)) < 6:
        return None
    from_first = motions[: 6 * n_nodes].reshape(n_nodes, 6, 6) @ np.linalg.inv(first)
    for block in (slice(0, 3), slice(3, 6)):
        if np.abs(from_first[:, block, block] - np.eye(3)).max() > LARGEST_ROTATION_ERROR:
            return None
    arms = from_first[:, :3, 3:]  # -skew(p_k - p_0)
    return 0.5 * np.stack([arms[:, a, b] - arms[:, b, a] for a, b in ((1, 2), (2, 0), (0, 1))], axis=-1)


def explain_misfit(body: Superelement, derived: Array, size: float) -> str:
    """Describe why given coordinates differ from those that the matrices determine.

    Args:
        body: superelement with the given coordinates.
        derived: coordinates relative to the first node according to the matrices, (r, 3) [m].
        size: size of the body [m].

    Returns:
        Text for a report; empty where the coordinates agree within `POSITION_TOLERANCE`.
    """
    given, names, near = body.positions, body.names, POSITION_TOLERANCE * size
    away = np.linalg.norm((given - derived)[:, None] - (given - derived), axis=-1)
    witness = int(np.argmin(np.sum(away > near, axis=0)))  # the node with which most nodes agree
    wrong = np.flatnonzero(away[:, witness] > near)
    if not len(wrong):
        return ""
    for start in given:
        apart = np.linalg.norm((derived + start)[:, None] - given, axis=-1)
        order = apart.argmin(axis=1)
        if apart.min(axis=1).max() <= near and len(set(order)) == len(order):
            return f"the coordinates are shuffled; they fit in the order {' '.join(names[k] for k in order)}"
    if len(wrong) <= max(1, len(given) // 2):
        places = 1e3 * (given[witness] + derived[wrong] - derived[witness])
        return "; ".join(
            f"{names[k]} is given {1e3 * away[k, witness]:.3g} mm from ({', '.join(f'{x:.3f}' for x in place)}) mm, "
            f"its position by the matrices relative to {names[witness]}"
            for k, place in zip(wrong[:3], places, strict=False)
        )
    distances = [np.linalg.norm(points[:, None] - points, axis=-1) for points in (given, derived)]
    if np.abs(distances[0] - distances[1]).max() <= near:
        return "the coordinates are turned or mirrored: along other axes than the rows"
    return "the coordinates are of other nodes or of another body"


def other_units(body: Superelement, misfit: float) -> tuple[str, dict[str, float]] | None:
    """Return units of coordinates or rotations that fit the matrices, as a text and the factor as a figure."""
    for factor, unit in COORDINATE_UNITS.items():
        scaled = factor * body.positions
        if np.abs(scaled).max() <= HUGE and _fit(replace(body, positions=scaled), misfit):
            text = f"the coordinates seem to be in {unit}: they fit when multiplied by {factor:g}"
            return text, {"coordinate_factor": factor}
    if _fit(from_degrees(body), misfit):
        return f"rotations seem to be in degrees: they fit when multiplied by {DEGREE:.5g}", {}
    return None


def _fit(body: Superelement, misfit: float) -> bool:
    """Return whether a body in other units passes the rigid-body test, with a much smaller misfit than as given."""
    return order_misfit(body) <= min(FITS, 0.2 * misfit)


def from_degrees(body: Superelement) -> Superelement:
    """Return the body in radians, on the assumption that its matrices are given for rotations in degrees."""
    unit = np.ones(len(body.mass_matrix))
    unit[: 6 * len(body.positions)] = np.tile([1.0] * 3 + [DEGREE] * 3, len(body.positions))
    scale = np.outer(unit, unit)
    return replace(body, stiffness_matrix=body.stiffness_matrix / scale, mass_matrix=body.mass_matrix / scale)
