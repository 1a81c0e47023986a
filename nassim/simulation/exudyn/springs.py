"""Force laws of a scene as Exudyn's connectors: a table of faster items, by law and measure, and the general item.

Exudyn's spring along rotating directions has two traps. Along the axes of its first marker, it acts on either body at
that body's own marker, so that a displacement violates the balance of moments. Its intrinsic formulation acts on both
in the middle, along axes halfway, which is right for small relative rotations. In both formulations the dampers take
the difference of two velocities for the rate of a displacement, so that they brake common rotations. Python functions
correct this where both bodies move.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import axes_along
from nassim.scene.measures import BodyCoordinates, DirectionalMeasure, Displacement, Distance, Measure, PointVelocity
from nassim.scene.rotation_measures import MATRIX, VECTOR, RelativePose
from nassim.scene.scene import Scene
from nassim.scene.terms import ForceLaw, Spring
from nassim.simulation.exudyn.general_items import add_general_force
from nassim.simulation.exudyn.items import Items, on_coordinates

Vector = Sequence[float] | Array
Wrench = Callable[..., Vector]
Kind = exu.OutputVariableType
VIRTUAL_NODE_RADIUS = 0.05
"""Distance of the virtual nodes that define a point's rotation from that point, over the size of the flexible body."""


def extended_points(scene: Scene) -> list[tuple[str, Array]]:
    """Return points that carry springs at other places, and these places, world frame at the start."""
    found = []
    for law in scene.terms_of(ForceLaw):
        measure = law.measure
        if isinstance(measure, RelativePose) and measure.rotation != MATRIX:
            found.append((measure.a, scene.point_position(measure.b)))
        elif isinstance(measure, DirectionalMeasure) and measure.axes_of:
            found += [(measure.axes_of, scene.point_position(path)) for path, _ in measure.weights]
    return found


def add_force_law(items: Items, law: ForceLaw) -> None:
    """Add a force law by the faster item of its measure where there is one, else by the general item."""
    evaluate = items.evaluator(law.measure)
    if not evaluate.names:
        return
    faster = FASTER_FORCES.get((type(law), type(law.measure)))
    if faster is None or not faster(items, law, law.measure):
        add_general_force(items.mbs, evaluate, law)


def _add_within(items: Items, law: Spring, measure: Measure) -> bool:
    """Add a spring on coordinates of deformation."""
    nodes = on_coordinates(items, measure)
    if not nodes:
        return nodes is not None
    row = np.concatenate([piece for _, piece in nodes])
    stiffness, damping = law.scalars
    items.mbs.AddObject(
        eii.ObjectGenericODE2(
            nodeNumbers=[node for node, _ in nodes],
            stiffnessMatrix=stiffness * np.outer(row, row),
            dampingMatrix=damping * np.outer(row, row),
            forceVector=np.zeros(len(row)),
        )
    )
    return True


def _add_along_line(items: Items, law: Spring, measure: Distance) -> bool:
    """Add a spring along the line through two points."""
    if not items.has_markers(measure):
        return False
    a, b = measure.points
    stiffness, damping = law.scalars
    items.mbs.AddObject(
        eii.ObjectConnectorSpringDamper(
            markerNumbers=[items.marker(a), items.marker(b)],
            referenceLength=float(np.linalg.norm(items.scene.point_position(b) - items.scene.point_position(a))),
            stiffness=stiffness,
            damping=damping,
        )
    )
    return True


def _add_along(items: Items, law: Spring, measure: Displacement) -> bool:
    """Add a spring between two points along a direction of the world, or of one of the points."""
    ends = opposite_ends(measure)
    if ends is None or not items.has_markers(measure):
        return False
    a, b, along = ends
    stiffness, damping = law.scalars
    if not measure.axes_of and np.count_nonzero(along) == 1:
        items.mbs.AddObject(
            eii.ObjectConnectorCartesianSpringDamper(
                markerNumbers=[items.marker(a), items.marker(b)],
                stiffness=list(stiffness * along**2),
                damping=list(damping * along**2),
                offset=list(items.scene.point_position(b) - items.scene.point_position(a)),
            )
        )
        return True
    frame = measure.axes_of or next((path for path in (a, b) if not items.moves(path)), "")
    if frame not in (a, b):
        return False
    other = b if frame == a else a
    markers = items.marker(frame, at=items.scene.point_position(other)), items.marker(other)
    if items.moves(frame):
        pull, moment = _pulls_along(markers, along, stiffness, damping)
        world = items.mbs.AddMarker(eii.MarkerBodyRigid(bodyNumber=items.mbs.AddObject(eii.ObjectGround())))
        _connect(items, markers, springForceTorqueUserFunction=pull)
        _connect(items, (markers[0], world), springForceTorqueUserFunction=moment)
    else:
        six = np.zeros((6, 6))
        six[:3, :3] = np.outer(along, along)
        _connect(items, markers, stiffness=stiffness * six, damping=damping * six)
    return True


def opposite_ends(measure: DirectionalMeasure) -> tuple[str, str, Array] | None:
    """Return the two points and the direction of a relative measure of two points; None for other measures."""
    if len(measure.weights) != 2:
        return None
    (a, along_a), (b, along_b) = measure.weights
    return None if np.any(np.add(along_a, along_b)) else (a, b, np.asarray(along_b))


def _add_rotation_damper(items: Items, law: Spring, measure: PointVelocity) -> bool:
    """Add a damper of rotations about an axis that rotates with one of two points, (3,)."""
    ends = opposite_ends(measure)
    if ends is None or not measure.angular or measure.axes_of not in ends[:2] or not items.has_markers(measure):
        return False
    axes, (a, b, about) = axes_along(ends[2]), ends
    items.mbs.AddObject(
        eii.ObjectConnectorTorsionalSpringDamper(
            markerNumbers=[
                items.marker(measure.axes_of, axes=axes),
                items.marker(b if measure.axes_of == a else a, axes=axes),
            ],
            damping=law.scalars[1] * float(about @ about),
        )
    )
    return True


def _add_bushing(items: Items, law: Spring, measure: RelativePose) -> bool:
    """Add a spring on a relative pose; the body of a is extended rigidly to the place of b."""
    if measure.rotation != VECTOR or not items.has_markers(measure):
        return False
    markers = (
        items.marker(measure.a, axes=measure.axes, at=items.scene.point_position(measure.b)),
        items.marker(measure.b, axes=measure.axes),
    )
    stiffness, damping = law.matrices
    options: dict[str, Any] = {"stiffness": stiffness, "damping": damping}
    if np.any(damping) and items.moves(measure.a) and items.moves(measure.b):
        options["springForceTorqueUserFunction"] = _pull_of_six(markers[0], stiffness, damping)
    _connect(items, markers, useIntrinsicFormulation=True, **options)
    return True


def _connect(items: Items, markers: tuple[int, int], **options: Any) -> None:
    items.mbs.AddObject(eii.ObjectConnectorRigidBodySpringDamper(markerNumbers=list(markers), **options))


def _pull_of_six(first: int, stiffness: Array, damping: Array) -> Wrench:
    """Return the function, for Exudyn, of the wrench at the first marker, (6,), for small relative motion.

    It takes displacement, rotation, and the differences of velocities and of angular velocities.
    """

    def pull(mbs: Any, _t: float, _n: int, displacement: Vector, turned: Vector, *more: Vector) -> Array:
        speed, turning = more[:2]
        spin = [w + t / 2 for w, t in zip(mbs.GetMarkerOutput(first, Kind.AngularVelocityLocal), turning, strict=True)]
        grows = [v - c for v, c in zip(speed, _cross(spin, displacement), strict=True)]
        return stiffness @ [*displacement, *turned] + damping @ [*grows, *turning]

    return pull


def _pulls_along(markers: tuple[int, int], along: Array, stiffness: float, damping: float) -> tuple[Wrench, Wrench]:
    """Return functions, for Exudyn, of the force along a direction of the first marker and of its moment there."""
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


FASTER_FORCES: Mapping[tuple[type[ForceLaw], type[Measure]], Callable[[Items, Any, Any], bool]] = {
    (Spring, BodyCoordinates): _add_within,
    (Spring, Distance): _add_along_line,
    (Spring, Displacement): _add_along,
    (Spring, PointVelocity): _add_rotation_damper,
    (Spring, RelativePose): _add_bushing,
}
"""Faster items, by law and measure; each returns False where it does not fit these points."""
