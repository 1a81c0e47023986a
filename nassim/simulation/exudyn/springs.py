"""Springs and dampers of a scene as Exudyn's connectors: within bodies, along lines and directions, in all six at once.

Exudyn's spring along directions that turn has two traps. Along the axes of its first marker it acts on either body at
its own marker, so that a displacement upsets the balance of moments; its intrinsic formulation acts on both in the
middle, along axes halfway, which is right for small turns of one against the other. And in both the dampers take the
difference of two velocities for the rate at which a displacement grows, so that they brake common turns. Functions of
Python put that right where both bodies move.
"""

from collections.abc import Callable, Sequence
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import axes_along
from nassim.scene.part import Line, Row, SixSprings, Spring
from nassim.scene.scene import Scene
from nassim.simulation.exudyn.items import Items, on_coordinates
from nassim.simulation.rows import bushing_rows, line_direction

Vector = Sequence[float] | Array
Wrench = Callable[..., Vector]
Kind = exu.OutputVariableType
PILOT_RADIUS = 0.05
"""Distance of pilots, by whose places a flexible body's points turn, from these, over the size of the body."""


def reaches(scene: Scene) -> list[tuple[str, Array]]:
    """Points that carry springs in the place of other points, and these places, world frame at the start."""
    found = [(word.a, scene.point_position(word.b)) for word in scene.said(SixSprings)]
    for word in scene.said(Spring):
        if isinstance(word.row, Row) and "." in word.row.frame:
            found += [(word.row.frame, scene.point_position(path)) for path, _ in word.row.points]
    return found


def rounding(scene: Scene) -> float:
    """Force [N] that rounded places and turns leave in a scene's springs: no equilibrium can be found nearer.

    What it is in each adds up, for places that lie alike round alike. Coordinates of deformation round as the forces
    do that cause them.
    """
    springs = [(np.array([[word.stiffness]]), [_as_row(scene, word.row)]) for word in scene.said(Spring)]
    springs += [(np.abs(word.stiffness), bushing_rows(word)) for word in scene.said(SixSprings)]
    total = 0.0
    for stiffness, rows in springs:
        ends = [[] if row.within else [(w, _sizes(scene, path)) for path, w in row.points] for row in rows]
        pushes = np.array([sum(np.linalg.norm(weights) for weights, _ in row) for row in ends])
        motions = np.array([sum(np.linalg.norm(weights * sizes) for weights, sizes in row) for row in ends])
        total += float(pushes @ stiffness @ motions)
    return float(np.finfo(float).eps) * total


def _as_row(scene: Scene, row: Row | Line) -> Row:
    return Row.between(row.a, row.b, line_direction(scene, row)) if isinstance(row, Line) else row


def _sizes(scene: Scene, path: str) -> Array:
    """What rounds of a point's place [m] and turn, (6,); turns of flexible bodies are found from places beside it."""
    return np.repeat([np.linalg.norm(scene.point_position(path)), 1 / PILOT_RADIUS], 3)


def add_spring(items: Items, word: Spring) -> None:
    """Add a spring-damper, relaxed at the start: within bodies, along a line, or along a direction."""
    nodes = on_coordinates(items, word.row) if word.row.within else []
    if nodes:
        row = np.concatenate([piece for _, piece in nodes])
        items.mbs.AddObject(
            eii.ObjectGenericODE2(
                nodeNumbers=[node for node, _ in nodes],
                massMatrix=np.zeros((0, 0)),
                stiffnessMatrix=word.stiffness * np.outer(row, row),
                dampingMatrix=word.damping * np.outer(row, row),
                forceVector=np.zeros(len(row)),
            )
        )
    elif isinstance(word.row, Line):
        a, b = word.row.paths
        length = float(np.linalg.norm(items.scene.point_position(b) - items.scene.point_position(a)))
        items.mbs.AddObject(
            eii.ObjectConnectorSpringDamper(
                markerNumbers=[items.marker(a), items.marker(b)],
                referenceLength=length,
                stiffness=word.stiffness,
                damping=word.damping,
            )
        )
    elif not word.row.within:
        _add_along(items, word, word.row)


def _add_along(items: Items, word: Spring, row: Row) -> None:
    """A spring between two points along a direction of the world, or of one of the points."""
    if row.own or len(row.points) != 2:
        raise ValueError("in large motion a spring acts between two points, or within one body")
    (a, along_a), (b, along_b) = row.points
    if not (word.stiffness or np.any(along_b[:3]) or np.any(along_a + along_b)) and row.frame in (a, b):
        _add_turning(items, word, row.frame, b if row.frame == a else a, along_b[3:])
        return
    if np.any(along_b[3:]) or np.any(along_a + along_b):
        raise ValueError(f"between {a!r} and {b!r}: in large motion a spring acts on the distance along a direction")
    along = along_b[:3]
    if not row.frame and np.count_nonzero(along) == 1:
        items.mbs.AddObject(
            eii.ObjectConnectorCartesianSpringDamper(
                markerNumbers=[items.marker(a), items.marker(b)],
                stiffness=list(word.stiffness * along**2),
                damping=list(word.damping * along**2),
                offset=list(items.scene.point_position(b) - items.scene.point_position(a)),
            )
        )
        return
    frame = row.frame or next((path for path in (a, b) if not items.moves(path)), "")
    if frame not in (a, b):
        raise ValueError(
            f"between {a!r} and {b!r}: in large motion a spring acts along one of the world's axes, or along any "
            "direction of one of its points (frame=...), or of the ground that one of them belongs to"
        )
    other = b if frame == a else a
    markers = items.marker(frame, at=items.scene.point_position(other)), items.marker(other)
    if items.moves(frame):
        pull, moment = _pulls_along(markers, along, word.stiffness, word.damping)
        world = items.mbs.AddMarker(eii.MarkerBodyRigid(bodyNumber=items.mbs.AddObject(eii.ObjectGround())))
        _connect(items, markers, springForceTorqueUserFunction=pull)
        _connect(items, (markers[0], world), springForceTorqueUserFunction=moment)
    else:
        six = np.zeros((6, 6))
        six[:3, :3] = np.outer(along, along)
        _connect(items, markers, stiffness=word.stiffness * six, damping=word.damping * six)


def _add_turning(items: Items, word: Spring, frame: str, other: str, about: Array) -> None:
    """A damper of turns about an axis that turns with a frame's point, (3,)."""
    axes = axes_along(about)
    items.mbs.AddObject(
        eii.ObjectConnectorTorsionalSpringDamper(
            markerNumbers=[items.marker(frame, axes=axes), items.marker(other, axes=axes)],
            damping=word.damping * float(about @ about),
        )
    )


def add_six_springs(items: Items, word: SixSprings) -> None:
    """Add a bushing: where its points lie apart, a's body reaches rigidly to the place of b."""
    markers = (
        items.marker(word.a, axes=word.axes, at=items.scene.point_position(word.b)),
        items.marker(word.b, axes=word.axes),
    )
    options: dict[str, Any] = {"stiffness": word.stiffness, "damping": word.damping}
    if np.any(word.damping) and items.moves(word.a) and items.moves(word.b):
        options["springForceTorqueUserFunction"] = _pull_of_six(markers[0], word.stiffness, word.damping)
    _connect(items, markers, useIntrinsicFormulation=True, **options)


def _connect(items: Items, markers: tuple[int, int], **options: Any) -> None:
    items.mbs.AddObject(eii.ObjectConnectorRigidBodySpringDamper(markerNumbers=list(markers), **options))


def _pull_of_six(first: int, stiffness: Array, damping: Array) -> Wrench:
    """What pulls at the first marker, (6,), as Exudyn asks for it, for a small motion of the second against the first.

    It is given displacement, turn, and the differences of velocities and of angular velocities.
    """

    def pull(mbs: Any, _t: float, _n: int, displacement: Vector, turned: Vector, *more: Vector) -> Array:
        speed, turning = more[:2]
        spin = [w + t / 2 for w, t in zip(mbs.GetMarkerOutput(first, Kind.AngularVelocityLocal), turning, strict=True)]
        grows = [v - c for v, c in zip(speed, _cross(spin, displacement), strict=True)]
        result: Array = stiffness @ [*displacement, *turned] + damping @ [*grows, *turning]
        return result

    return pull


def _pulls_along(markers: tuple[int, int], along: Array, stiffness: float, damping: float) -> tuple[Wrench, Wrench]:
    """Along a direction of the first marker's axes: the force, and what moment it has there from the second's place."""
    first, second = markers
    direction = along.tolist()

    def force(mbs: Any, displacement: Vector, speed: Vector) -> Vector:
        common = _cross(mbs.GetMarkerOutput(first, Kind.AngularVelocityLocal), displacement)
        size = stiffness * _dot(direction, displacement) + damping * (_dot(direction, speed) - _dot(direction, common))
        return [size * d for d in direction]

    def pull(mbs: Any, _t: float, _n: int, displacement: Vector, _turned: Vector, speed: Vector, *_: Any) -> Vector:
        return [*force(mbs, displacement, speed), 0.0, 0.0, 0.0]

    def moment(mbs: Any, *_: Any) -> Vector:
        axes = np.reshape(mbs.GetMarkerOutput(first, Kind.RotationMatrix), (3, 3))
        displacement, speed = (
            (mbs.GetMarkerOutput(second, kind) - mbs.GetMarkerOutput(first, kind)) @ axes
            for kind in (Kind.Position, Kind.Velocity)
        )
        return [0.0, 0.0, 0.0, *_cross(displacement, force(mbs, displacement, speed))]

    return pull, moment


# Plain numbers: for three of them NumPy's functions take ten times as long, and these run at every step.


def _cross(a: Vector, b: Vector) -> Vector:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _dot(a: Vector, b: Vector) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
