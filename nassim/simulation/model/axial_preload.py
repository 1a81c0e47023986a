"""Estimate of the geometric stiffness of a preload, for runs in time and for bodies whose reduction does not hold it.

A body's preload is taken as axial forces along the lines between its remote points: those of least norm that balance
the forces at the points. Each line bends like a beam between two points, whose cubic shape an axial force N softens
(C. Felippa, Nonlinear Finite Element Methods, ch. 9; J. Przemieniecki, Theory of Matrix Structural Analysis, ch. 15).
A mode with all points held bends like a beam clamped at both ends, for which the integral of w'^2 is 12.3 / L^2 times
that of w^2. Against Euler's columns the estimate is right within 3 % where no end may rotate against its guide, 18 %
too low where both may and 33 % where one may; for a column under its own weight it is 58 % too high. It ignores forces
on other paths, as through an arch, and masses on top of a column.
"""

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import skew
from nassim.base.warning_log import warn
from nassim.bodies.reduced_body import ReducedBody
from nassim.scene.bodies import FlexibleBody
from nassim.simulation.model.assembly import Assembly

CLAMPED = 12.3
"""L^2 times the integral of w'^2 over that of w^2, of the first mode of a beam clamped at both ends."""
CUBIC = np.kron(np.array([[36, 3, 3], [3, 4, -1], [3, -1, 4]]) / 30, np.eye(3))
"""Integral of the square of a slope along a line, over its length: a beam's cubic with given slopes, in three axes."""
FACTOR = 1.6
"""Factor by which the estimated share may be wrong for slender columns."""
WARNED_SHARE = 0.1
"""Share of the buckling load above which a warning is given."""


def axial_forces(body: ReducedBody, coordinates: Array) -> Array:
    """Compute the tensions along the lines between every two remote points.

    Args:
        body: the reduced body.
        coordinates: its coordinates, (n, n_times).

    Returns:
        Tensions, (lines, n_times) [N].
    """
    return axial_rows(body) @ body.stiffness_matrix @ coordinates


def axial_forces_under(assembly: Assembly, body: FlexibleBody) -> tuple[Array, Array]:
    """Return a body's tensions under the loads of a scene: per unit of its coordinates, (lines, n), and constant part.

    The stiffness of the stress belongs to them: a strip that is bent far grows shorter without any tension.
    """
    rows, loads = axial_rows(body.reduced), assembly.loads
    if loads is None or body.name not in loads.stress:
        return rows @ body.reduced.stiffness_matrix, np.zeros(len(rows))
    frame, stress = assembly.coordinates.frames[body.name], loads.stress[body.name]
    stiffness = body.reduced.stiffness_matrix + stress.stiffness
    return rows @ stiffness[:, frame.flexible] @ frame.deformation(body.reduced), -rows @ stress.held


def axial_rows(body: ReducedBody) -> Array:
    """Return tensions along the lines between every two remote points per unit of a body's forces, (lines, n)."""
    places = 6 * np.arange(len(body.remote_points))[:, None] + [0, 1, 2]
    lines = _lines(body)
    balance = np.zeros((3 * len(body.remote_points), len(lines)))
    for k, (i, j) in enumerate(lines):
        _, along = _length_and_axis(body, i, j)
        balance[3 * i : 3 * i + 3, k], balance[3 * j : 3 * j + 3, k] = -along, along
    result = np.zeros((len(lines), len(body.stiffness_matrix)))
    result[:, places.ravel()] = np.linalg.pinv(balance, rcond=1e-9)
    return result


def buckling_share(assembly: Assembly, tensions: Mapping[str, Array]) -> tuple[float, str]:
    """Estimate the preload over the load at which the scene buckles, about its start.

    Rigid-body modes are left out: the effect of a weight on a mechanism is no buckling.

    Args:
        assembly: the assembled scene.
        tensions: tensions of each flexible body that deforms, along its lines in the order of `axial_forces`, (lines,)
            [N].

    Returns:
        The share [-], and the name of the body that contributes most.
    """
    modal, elastic = assembly.modal, ~assembly.modal.rigid_modes
    modes = modal.modes[:, elastic] / modal.omega[elastic]
    softening = {}
    for body in assembly.scene.deformable_bodies:
        part = modes[assembly.coordinates.slices[body.name]]
        softening[body.name] = -part.T @ estimated_stiffness(body.reduced, tensions[body.name]) @ part
    if not softening or not elastic.any():
        return 0.0, ""
    shares, shapes = np.linalg.eigh(sum(softening.values(), np.zeros((elastic.sum(),) * 2)))
    name = max(softening, key=lambda name: float(shapes[:, -1] @ softening[name] @ shapes[:, -1]))
    return max(0.0, float(shares[-1])), name


def warn_of_buckling(assembly: Assembly, tensions: Mapping[str, Array]) -> None:
    """Warn of preload near the buckling load; arguments as of `buckling_share`."""
    share, name = buckling_share(assembly, tensions)
    if share > WARNED_SHARE:
        does = (
            f"lower frequencies by up to some {100 * (1 - np.sqrt(1 - share)):.2g} %" if share < 1 else "let it buckle"
        )
        warn(
            f"the preload in body {name!r} is {share:.2g} of its buckling load (estimated, within a factor of "
            f"{FACTOR} for slender columns); it would {does}, of which runs and linear models have the share of the "
            "loads at their start"
        )


def estimated_stiffness(body: ReducedBody, tensions: Array) -> Array:
    """Estimate the stiffness that tensions along the lines between its points add to a body.

    Args:
        body: the reduced body.
        tensions: tensions in the order of `axial_forces`, (lines,) [N].

    Returns:
        Stiffness on the body's coordinates, (n, n).
    """
    result = np.zeros_like(body.stiffness_matrix)
    slack = 0.0
    for (i, j), tension in zip(_lines(body), tensions, strict=True):
        length, along = _length_and_axis(body, i, j)
        slack = min(slack, tension / length)
        turn, rows = skew(along), np.zeros((9, 12))
        # Vectors across the line: the mean slope and the slopes by the rotations of both ends.
        rows[:3, 6:9] = turn @ turn / length
        rows[:3, :3], rows[3:6, 3:6], rows[6:, 9:] = -rows[:3, 6:9], -turn, -turn
        places = np.r_[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]
        result[np.ix_(places, places)] += tension * length * rows.T @ CUBIC @ rows
    inner = np.arange(6 * len(body.remote_points), len(result))
    result[inner, inner] += CLAMPED * slack / body.mass * np.diag(body.mass_matrix)[inner]
    return result


def _lines(body: ReducedBody) -> list[tuple[int, int]]:
    size = float(np.ptp(body.positions, axis=0).max())
    pairs = combinations(range(len(body.remote_points)), 2)
    return [(i, j) for i, j in pairs if _length_and_axis(body, i, j)[0] > 1e-6 * size]


def _length_and_axis(body: ReducedBody, i: int, j: int) -> tuple[float, Array]:
    line = body.remote_points[j].position - body.remote_points[i].position
    length = float(np.linalg.norm(line))
    return length, line / length if length else line
