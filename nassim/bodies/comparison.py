"""Comparison of two reduced bodies: mass, stiffness between points, eigenfrequencies and mode shapes."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from nassim.base.checks import Array, finite_array, freeze, known, unique
from nassim.base.modal import mac
from nassim.base.rigid_motion import AXES
from nassim.base.short_repr import short_repr
from nassim.base.tables import text_table
from nassim.bodies.reduced_body import ReducedBody


@dataclass(frozen=True)
class Comparison:
    """Two bodies a and b, side by side.

    Attributes:
        names: their names
        points: the remote points that they are compared at, m of them
        distance: largest distance between points of one name in the bodies' frames [m]
        mass: masses, shape (2,) [kg]
        center_of_mass: centres of mass in the bodies' frames, shape (2, 3) [m]
        stiffness: force over displacement and moment over rotation at each point but the first, along each axis, with
            the first point held and all others free, shape (2, m - 1, 6) [N/m, N m/rad]
        frequency: eigenfrequencies of paired modes, shape (2, n) [Hz], in the order of those of a. The pairs have the
            largest sum of the criterion times the ratio of the lower to the higher frequency
        mac: modal assurance criterion of each pair, from the motions of the points, shape (n,) [-]; rotations count
            times the root mean square distance of the points from their centre, those of one point times 1 m. Few
            points do not tell all shapes apart. Modes of nearly one frequency mix, so that their shapes may differ
            between equal bodies
        fixed: points that are held in these modes
    """

    names: tuple[str, str]
    points: tuple[str, ...]
    distance: float
    mass: Array
    center_of_mass: Array
    stiffness: Array
    frequency: Array
    mac: Array
    fixed: tuple[str, ...] = ()
    __repr__ = short_repr

    def __post_init__(self) -> None:
        m = len(self.points)
        freeze(
            self,
            names=tuple(self.names),
            points=unique("remote point", self.points),
            mass=finite_array("masses", self.mass, (2,)),
            center_of_mass=finite_array("centres of mass", self.center_of_mass, (2, 3)),
            stiffness=finite_array("stiffness", self.stiffness, (2, m - 1, 6)),
            frequency=finite_array("frequencies", self.frequency, (2, None)),
            mac=finite_array("modal assurance criteria", self.mac, (None,)),
            fixed=tuple(self.fixed),
        )

    def __str__(self) -> str:
        a, b = self.names if self.names[0] != self.names[1] else ("a", "b")
        rows = [("", a, b, "b / a - 1", "MAC")]
        rows.append(("mass [kg]", *_compared(*self.mass), ""))
        for point, pair in zip(self.points[1:], self.stiffness.transpose(1, 2, 0), strict=True):
            for direction, values in zip(AXES, pair, strict=True):
                unit = "N m/rad" if direction.startswith("r") else "N/m"
                rows.append((f"stiffness {point}.{direction} [{unit}]", *_compared(*values), ""))
        for k, (values, same) in enumerate(zip(self.frequency.T, self.mac, strict=True), start=1):
            rows.append((f"mode {k} [Hz]", *_compared(*values), f"{same:.2f}"))
        held = f"Stiffness: {self.points[0]} held. " if len(self.points) > 1 else ""
        modes = f"Modes: {', '.join(self.fixed)} held." if self.fixed else "Modes: free, without rigid-body modes."
        where = np.linalg.norm(self.center_of_mass[1] - self.center_of_mass[0])
        places = f"Centres of mass differ by {1e3 * where:.3f} mm, points by up to {1e3 * self.distance:.3f} mm."
        return f"{text_table(rows)}\n{held}{modes}\n{places}"


def compare(
    a: ReducedBody, b: ReducedBody, *, points: Sequence[str] | None = None, fixed: Collection[str] = (), n: int = 6
) -> Comparison:
    """Compare two bodies at remote points of the same names; print the result to read it as a table.

    Args:
        a: the first body
        b: the second body, in the same frame
        points: names of remote points to compare at (default: all that both bodies have, in the order of a)
        fixed: those of them that are held in the modes
        n: largest number of modes to compare; rigid-body modes are left out

    Returns:
        The comparison.

    Raises:
        ValueError: for bodies without common points, and for unknown points
    """
    shared = [name for name in a.point_names if name in b.point_names] if points is None else list(points)
    if not shared:
        raise ValueError(
            f"bodies {a.name!r} and {b.name!r} have no remote point of the same name: {', '.join(a.point_names)} "
            f"against {', '.join(b.point_names)}"
        )
    for body in (a, b):
        for name in (*shared, *fixed):
            known(f"remote point of body {body.name!r}", name, body.point_names)
    places = np.array([[body.point(name).position for name in shared] for body in (a, b)])
    arm = float(np.sqrt(np.mean(np.sum((places[0] - places[0].mean(axis=0)) ** 2, axis=1)))) or 1.0
    (first, shapes_a), (second, shapes_b) = (_modes(body, shared, fixed, n, arm) for body in (a, b))
    with np.errstate(invalid="ignore"):
        alike = np.nan_to_num(mac(shapes_a, shapes_b))  # 0 where a mode moves none of the points
    nearness = np.exp(-np.abs(np.log(first[:, None] / second)))
    rows, columns = scipy.optimize.linear_sum_assignment(-alike * nearness)
    return Comparison(
        names=(a.name, b.name),
        points=tuple(shared),
        distance=float(np.linalg.norm(places[1] - places[0], axis=1).max()),
        mass=np.array([a.mass, b.mass]),
        center_of_mass=np.array([a.center_of_mass, b.center_of_mass]),
        stiffness=np.array([_stiffness(body, shared) for body in (a, b)]),
        frequency=np.array([first[rows], second[columns]]),
        mac=alike[rows, columns],
        fixed=tuple(fixed),
    )


def _stiffness(body: ReducedBody, points: Sequence[str]) -> Array:
    """Return the stiffness at each point but the first along each axis, the first held, shape (m - 1, 6)."""
    held = np.flatnonzero(body.motion(points[0]).any(axis=0))
    free = np.setdiff1d(np.arange(len(body.stiffness_matrix)), held)
    moved = np.vstack([np.zeros((0, len(free))), *(body.motion(name)[:, free] for name in points[1:])])
    compliance = np.linalg.solve(body.stiffness_matrix[np.ix_(free, free)], moved.T)
    return np.reshape(1 / np.einsum("ij,ji->i", moved, compliance), (-1, 6))


def _modes(body: ReducedBody, points: Sequence[str], fixed: Collection[str], n: int, arm: float) -> tuple[Array, Array]:
    """Return frequencies and the motions of the points in elastic modes, shape (6 m, n), rotations times an arm."""
    frequency, shapes = body.eigenmodes(fixed=fixed)
    elastic = np.flatnonzero(frequency)[:n]
    motions = np.vstack([body.motion(name) for name in points]) @ shapes[:, elastic]
    return frequency[elastic], motions * np.tile(np.repeat([1.0, arm], 3), len(points))[:, None]


def _compared(a: float, b: float) -> tuple[str, str, str]:
    return f"{a:.4g}", f"{b:.4g}", f"{100 * (b / a - 1):+.2f} %"
