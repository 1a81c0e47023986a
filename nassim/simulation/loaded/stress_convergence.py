"""Peaks of stress on two meshes: which stand, and which grow with the refinement because linear elasticity has no
finite stress there.

At a sharp re-entrant edge, and at the edge of a glued face between materials, the stress grows as r^-a with the
distance r from the edge. The peak of a mesh with elements of size h therefore grows as h^-a: by up to 37 % for elements
of half the size at an edge of 90 degrees in one material, where a is 0.46.
Source: M. L. Williams, Stress singularities resulting from various boundary conditions in angular corners of plates in
extension, Journal of Applied Mechanics 19 (1952) 526-528.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from nassim.base.checks import Array, known, positive
from nassim.base.field_types import ArrayLike
from nassim.base.short_repr import short_repr
from nassim.base.tables import text_table
from nassim.bodies.reduced_body import ReducedBody
from nassim.bodies.stress import StressField, von_mises
from nassim.scene.port_voltages import static_voltages
from nassim.scene.scene import Scene
from nassim.scene.stress_peaks import place_text, stress_fields, stressed_body
from nassim.simulation.loaded.loaded_state import NO_LOAD
from nassim.simulation.loaded.stress_limits import static_motion

LARGEST_MESH_ERROR = 0.3
"""Share of the stress above which the error of the finer mesh is too large for a peak to stand."""
NEIGHBOURHOOD = 2.0
"""Radius within which peaks of two meshes are the same place, over the longest edge of the coarser mesh there."""
WORSE = 2.0
"""Mesh error of the finer mesh over that of the coarser one from which it counts as the worse mesh at a place."""


@dataclass(frozen=True)
class StressSpot:
    """A peak of the von Mises stress on two meshes.

    Attributes:
        place: name of the stress surface or point
        position: the peak on the finer mesh, in the body's frame, shape (3,) [m]
        von_mises: von Mises stress on the finer mesh [Pa]
        coarse: largest von Mises stress around it on the coarser mesh [Pa]
        mesh_error: estimated error of the finer mesh, see `StressField.mesh_error` [Pa]
        verdict: "grows" or "falls" if the stress changes by more than the tolerance, and "stands" if it does not;
            "unresolved" where the finer mesh is worse there (its error is above the change, and above twice that of
            the coarser one), or where its error is above 30 % of a stress that hardly changes, as at a sharp edge
    """

    place: str
    position: Array
    von_mises: float
    coarse: float
    mesh_error: float
    verdict: str

    __repr__ = short_repr

    @property
    def change(self) -> float:
        """Change from the coarser to the finer mesh [Pa], a safe figure for the error of a peak that stands."""
        return self.von_mises - self.coarse


@dataclass(frozen=True)
class StressConvergence:
    """Peaks of the von Mises stress on two meshes, the highest first; see `stress_convergence`."""

    spots: tuple[StressSpot, ...]

    __repr__ = short_repr

    @property
    def standing(self) -> tuple[StressSpot, ...]:
        """Peaks that stand: their stress is a result."""
        return tuple(spot for spot in self.spots if spot.verdict == "stands")

    @property
    def growing(self) -> tuple[StressSpot, ...]:
        """Peaks that grow with the refinement: singular, or not resolved by the coarser mesh."""
        return tuple(spot for spot in self.spots if spot.verdict == "grows")

    def __str__(self) -> str:
        """Return a table of the peaks."""
        rows = [["place", "position", "coarser [MPa]", "finer [MPa]", "mesh error [MPa]", "verdict"]]
        for spot in self.spots:
            figures = (f"{1e-6 * x:.4g}" for x in (spot.coarse, spot.von_mises, spot.mesh_error))
            rows.append([spot.place, place_text(spot.position).strip(), *figures, spot.verdict])
        return text_table(rows)


def stress_convergence(
    scene: Scene,
    finer: ReducedBody,
    *,
    body: str,
    inputs: Mapping[str, float] | None = None,
    angular_velocity: ArrayLike = NO_LOAD,
    axis_point: ArrayLike = NO_LOAD,
    voltages: Mapping[str, float] | None = None,
    place: str | None = None,
    tolerance: float = 0.05,
    radius: float | None = None,
    n_spots: int = 5,
) -> StressConvergence:
    """Compare the peaks of the von Mises stress at rest under loads between two meshes of a body.

    A peak that stands is a result. One that grows is singular, or the coarser mesh does not resolve it: a third mesh
    decides, on which the stress at a singular edge grows by the same factor again. Refine where the peaks are
    (`local_sizes`), to half the size or less.

    Args:
        scene: the scene, with the body from the coarser mesh; its loops are open.
        finer: the same solid reduced from a finer mesh, with stress at places of the same names.
        body: name of the flexible body.
        inputs: constant values of inputs, by name.
        angular_velocity: constant angular velocity of the scene, (3,) [rad/s].
        axis_point: a point of the axis, (3,) [m].
        voltages: voltages of the body's electrical ports, by name [V], in place of those that the scene's amplifiers
            and open circuits give them: they stress the stacks themselves.
        place: name of a stress surface or point (default: all of them).
        tolerance: relative change up to which a peak stands [-].
        radius: distance within which the peaks of both meshes are the same place, and different peaks differ [m]
            (default: twice the longest edge of the coarser mesh at the peak).
        n_spots: largest number of peaks of each surface.

    Returns:
        The peaks, the highest first.

    Raises:
        ValueError: for a rigid body, for a body that keeps no stress, for a finer body without the place, and as
            `static_motion`.
    """
    allowed = positive("tolerance", tolerance)
    part = stressed_body(scene, body)
    fine_part = replace(part, reduced=finer)
    fields = stress_fields(part, place)
    fine_fields = {field.name: field for field in stress_fields(fine_part, place)}
    for field in fields:
        known(f"stress of the finer body {finer.name!r}", field.name, fine_fields)
    # The finer body need not have the places of sensors; those that hold a port are loads. Loops are open anyway.
    bare = replace(scene, sensors=tuple(sensor for sensor in scene.sensors if sensor.claims), loops=())
    states, volts = [], []
    for own in (part, fine_part):
        changed = replace(bare, bodies=tuple(own if other.name == body else other for other in scene.bodies))
        motion = static_motion(changed, inputs=inputs, angular_velocity=angular_velocity, axis_point=axis_point)
        states.append(motion.coordinates[body][0])
        volts.append(static_voltages(changed, own, states[-1], inputs or {}, voltages))
    spots = [
        spot
        for field in fields
        for spot in _spots(field, fine_fields[field.name], states, volts, allowed, radius)[:n_spots]
    ]
    return StressConvergence(tuple(sorted(spots, key=lambda spot: -spot.von_mises)))


def _spots(
    coarse: StressField,
    fine: StressField,
    states: Sequence[Array],
    voltages: Sequence[Mapping[str, float]],
    tolerance: float,
    radius: float | None,
) -> list[StressSpot]:
    """Return the local peaks of a field on the finer mesh, the highest first, beside those of the coarser mesh."""
    before, after = (
        von_mises(field.stress(q, volts)) for field, q, volts in zip((coarse, fine), states, voltages, strict=True)
    )
    errors_before, errors = coarse.mesh_error(states[0]), fine.mesh_error(states[1])
    reach = np.full(len(after), radius) if radius is not None else NEIGHBOURHOOD * _edges_near(coarse, fine.positions)
    trees = [cKDTree(field.positions) for field in (coarse, fine)]
    spots = []
    for k in np.argsort(-after):
        position = fine.positions[k]
        if after[k] <= 0 or after[trees[1].query_ball_point(position, reach[k])].max(initial=0.0) > after[k]:
            continue
        distance, nearest = trees[0].query(position)
        around = trees[0].query_ball_point(position, reach[k]) if distance <= reach[k] else [int(nearest)]
        found = float(before[around].max())
        change = after[k] / found - 1 if found > 0 else np.inf
        if abs(change) > tolerance:
            certain = errors[k] <= max(abs(after[k] - found), WORSE * float(errors_before[around].max()))
            verdict = ("grows" if change > 0 else "falls") if certain else "unresolved"
        else:
            verdict = "stands" if errors[k] <= LARGEST_MESH_ERROR * after[k] else "unresolved"
        spots.append(StressSpot(fine.name, position, float(after[k]), found, float(errors[k]), verdict))
    return spots


def _edges_near(field: StressField, positions: Array) -> Array:
    """Return the longest edge of a surface's mesh at its point next to each position, (n,) [m]; 0 without a surface."""
    longest = np.zeros(len(field.positions))
    if field.surface is not None:
        for a, b in ((0, 1), (1, 2), (2, 0)):
            ends = field.surface.triangles[:, [a, b]]
            length = np.linalg.norm(np.subtract(*field.positions[ends.T]), axis=1)
            np.maximum.at(longest, ends, length[:, None])
    return longest[cKDTree(field.positions).query(positions)[1]]
