"""What springs and dampers pull with, from the motions of their points, as their connectors do in large motion."""

from collections.abc import Sequence

import exudyn as exu
import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.base.rigid_motion import DIRECTIONS
from nassim.scene.part import Reading, Row, SixSprings, Spring, Tension
from nassim.simulation.exudyn.items import Items
from nassim.simulation.exudyn.readings import add_reading
from nassim.simulation.exudyn.state import Term

Kind = exu.OutputVariableType
MOTIONS = (Kind.Position, Kind.RotationMatrix, Kind.Velocity, Kind.AngularVelocity)


def add_tension(items: Items, word: Tension) -> list[Term]:
    """Add what an output reads the pull of a spring and its damper from."""
    spring = word.spring
    if isinstance(spring, SixSprings):
        return [_of_six(items, spring, list(DIRECTIONS).index(word.direction))]
    row = spring.row
    if isinstance(row, Row) and "." in row.frame and items.moves(row.frame):
        return [_along(items, spring, row)]
    pulls = enumerate((spring.stiffness, spring.damping))
    readings = [Reading(word.output, word.unit, row, gain, derivative) for derivative, gain in pulls if gain]
    return [term for reading in readings for term in add_reading(items, reading)]


def _along(items: Items, spring: Spring, row: Row) -> Term:
    """Along axes that turn with one of two points; the damper brakes what grows along these."""
    (a, _), (b, weights) = row.points
    along = weights[:3]
    markers = items.marker(a), items.marker(b)
    frame = (a, b).index(row.frame)
    start = along @ (items.scene.point_position(b) - items.scene.point_position(a))

    def value(*columns: Array) -> Array:
        apart, speed, axes, spins = _relative(columns)
        grows = speed - np.cross(spins[frame], apart)
        stretched = np.einsum("nji,nj,i->n", axes[frame], apart, along) - start
        rate = np.einsum("nji,nj,i->n", axes[frame], grows, along)
        result: Array = spring.stiffness * stretched + spring.damping * rate
        return result

    return Term(_sensors(items, markers), value)


def _of_six(items: Items, spring: SixSprings, k: int) -> Term:
    """One of six, along axes halfway between the two points, at the place of b."""
    axes = spring.axes
    markers = (
        items.marker(spring.a, axes=axes, at=items.scene.point_position(spring.b)),
        items.marker(spring.b, axes=axes),
    )
    both = items.moves(spring.a) and items.moves(spring.b)

    def value(*columns: Array) -> Array:
        apart, speed, (first, second), spins = _relative(columns)
        turned = Rotation.from_matrix(np.einsum("nji,njk->nik", first, second)).as_rotvec()
        halfway = first @ Rotation.from_rotvec(turned / 2).as_matrix()
        # As the connector: beside the ground it takes the difference of velocities as it is.
        grows = speed - both * np.cross((spins[0] + spins[1]) / 2, apart)
        moved, rates = (
            np.hstack([np.einsum("nji,nj->ni", halfway, shift), turn])
            for shift, turn in ((apart, turned), (grows, np.einsum("nji,nj->ni", halfway, spins[1] - spins[0])))
        )
        result: Array = moved @ spring.stiffness[k] + rates @ spring.damping[k]
        return result

    return Term(_sensors(items, markers), value)


def _sensors(items: Items, markers: Sequence[int]) -> tuple[int, ...]:
    return tuple(items.sensor(marker, kind) for marker in markers for kind in MOTIONS)


def _relative(columns: Sequence[Array]) -> tuple[Array, Array, tuple[Array, Array], tuple[Array, Array]]:
    """Of the second point against the first: place and velocity, (n, 3); axes (n, 3, 3) and spins (n, 3) of both."""
    (p, r, v, w), (q, s, u, x) = columns[:4], columns[4:]
    return q - p, u - v, (r.reshape(-1, 3, 3), s.reshape(-1, 3, 3)), (w, x)
