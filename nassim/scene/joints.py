"""Joints of scenes: constraints on the relative motion of two points, with free directions."""

from collections.abc import Mapping
from dataclasses import field

import numpy as np

from nassim.base.checks import Array, freeze, instances, known, not_negative, unique
from nassim.base.field_types import ArrayLike, Field, Names, data_class, held
from nassim.base.rigid_motion import DIRECTIONS, axes_along, direction_text, proper_rotation, unit_vector
from nassim.scene.axes_and_points import check_two_points, checked_axis
from nassim.scene.bodies import FlexibleBody, RigidBody
from nassim.scene.field_kinds import Axes, Path
from nassim.scene.measures import Displacement, Measure, PointVelocity
from nassim.scene.part import Connection
from nassim.scene.rotation_measures import MATRIX, RelativePose
from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint, Spring

TOUCH_TOLERANCE = 1e-9
"""Largest gap [m] between the two points of a joint."""
PLACEMENT_ROUNDING = 1e-12
"""Gap [m] that rounding adds where a scene is placed up to kilometres away. It adds to the tolerance."""
PERPENDICULAR = 1e-9
"""Largest cosine of the angle between axes that count as perpendicular."""
Damping = float | Mapping[str, float] | tuple[float, ...]
"""Damping of a joint as a user gives it: of its only free direction, by direction, or of all free ones in order."""


@data_class
class Joint(Connection):
    """A connection of two points that coincide at the start.

    `fixed`, `revolute`, `prismatic`, `cylindrical`, `universal`, `spherical` and `planar` make the usual joints.

    Attributes:
        name: name of the joint.
        a: first point, "body.point".
        b: second point, "body.point".
        free: directions in which b may move against a: "x", "y", "z", "rx", "ry", "rz". The default, none, is a rigid
            connection.
        axes: the directions x, y and z at the start, as columns, world frame, (3, 3). They rotate with the body of a:
            for a slide on a rail, a is the rail's point.
        damping: viscous damping of the free directions [N s/m], [N m s/rad]: one number where one direction is free, or
            {direction: number}. Where two rotations are free, the axis of the second rotates with b, as in a universal
            joint. The damping holds in every position.
    """

    name: str
    a: Path
    b: Path
    free: Names = held(())
    axes: Field[ArrayLike, Axes] = field(default_factory=held(lambda: np.eye(3)))
    damping: Damping = 0.0

    def __post_init__(self) -> None:
        free = instances("free", (self.free,) if isinstance(self.free, str) else self.free, (str,))
        for direction in free:
            known("direction", direction, DIRECTIONS)
        freeze(
            self,
            free=unique(f"joint {self.name!r}: free direction", free),
            axes=proper_rotation(f"joint {self.name!r}: axes", self.axes),
        )
        freeze(self, damping=_damping_of_each(f"joint {self.name!r}: damping", self.damping, self.free))

    def terms(self, scene: Scene) -> tuple[Constraint | Spring, ...]:
        """Return the constraint of all directions that are not free, and the dampers of the free directions."""
        check_two_points(f"joint {self.name!r}", self.a, self.b)
        for path in (self.a, self.b):
            self._check_held(scene, path)
        body = scene.split(self.a)[0]
        if isinstance(body, RigidBody) and scene.split(self.b)[0] is body:
            raise ValueError(f"joint {self.name!r}: {self.a!r} and {self.b!r} belong to one rigid body")
        a, b = (scene.point_position(path) for path in (self.a, self.b))
        gap = float(np.linalg.norm(b - a))
        if gap > TOUCH_TOLERANCE + PLACEMENT_ROUNDING:
            way = ", ".join(f"{x:.9g}" for x in a - b)
            raise ValueError(
                f"joint {self.name!r}: {self.a!r} and {self.b!r} are {gap:.3g} m apart; they must coincide to "
                f"{TOUCH_TOLERANCE:g} m: add ({way}) m to the position of {scene.split(self.b)[0].name!r}, or move "
                f"{scene.split(self.a)[0].name!r} the other way"
            )
        held = tuple(d for d in DIRECTIONS if d not in self.free)
        return (Constraint(self.name, RelativePose(self.a, self.b, self.axes, MATRIX), held), *self._dampers())

    def describe(self) -> str:
        """Describe the points and the free directions."""
        own = not np.array_equal(self.axes, np.eye(3))
        damped = ", ".join(f"{d} {c:g}" for d, c in self._damping_by_direction.items() if c)
        free = f"free in {', '.join(self.free)}{' of its own axes' * own}" if self.free else "rigid"
        if len(self.free) == 1:
            does = "turns about" if self.free[0].startswith("r") else "slides along"
            axis = direction_text(self.axes[:, "xyz".index(self.free[0][-1])])
            free, damped = f"{does} {axis}", damped.partition(" ")[2]
        return f"joint {self.name}: {self.a} to {self.b}, {free}{damped and '; damping ' + damped}"

    @property
    def _damping_by_direction(self) -> dict[str, float]:
        return dict(zip(self.free, self.damping, strict=True))  # type: ignore[arg-type]  # set by __post_init__

    def _dampers(self) -> tuple[Spring, ...]:
        turns = [d for d in DIRECTIONS if d in self.free and d.startswith("r")]
        result = []
        for direction, damping in self._damping_by_direction.items():
            # A universal joint's second arm turns with b.
            frame = self.b if len(turns) == 2 and direction == turns[1] else self.a
            axis = self.axes[:, "xyz".index(direction[-1])]
            measure: Measure = Displacement.between(self.a, self.b, axis, axes_of=frame)
            if direction in turns:
                measure = PointVelocity(((self.a, -axis), (self.b, axis)), frame, angular=True)
            if damping:
                result.append(Spring(measure, 0.0, damping))
        return tuple(result)

    def _check_held(self, scene: Scene, path: str) -> None:
        """Refuse a passive point: it follows the body's motion, so it is no coordinate that a joint could hold."""
        body, point = scene.split(path)
        if not isinstance(body, FlexibleBody) or not body.deforms:
            return
        if point in [passive.name for passive in body.reduced.passive_points]:
            raise ValueError(
                f"joint {self.name!r}: {path!r} is a passive point, which moves along with the body but cannot be "
                "held: use the body before it was trimmed, or name the point in trim_body(points=...)"
            )


def _damping_of_each(label: str, damping: Damping, free: tuple[str, ...]) -> tuple[float, ...]:
    """Return the damping of each free direction, in their order."""
    if isinstance(damping, Mapping):
        for direction in damping:
            known(f"free direction of {label}", direction, free)
        given = [damping.get(direction, 0.0) for direction in free]
    elif isinstance(damping, tuple) and (len(damping) == len(free) or not any(damping)):
        given = list(damping) if any(damping) else [0.0] * len(free)
    elif not isinstance(damping, (int, float, np.number)) or (damping and len(free) != 1):
        raise ValueError(
            f"{label} must be one figure where one direction is free, or {{direction: figure}}; free are "
            f"{', '.join(free) or 'none'}, got {damping!r}"
        )
    else:
        given = [float(damping)] * len(free)
    return tuple(
        not_negative(f"{label} of {d}", value, "N m s/rad" if d.startswith("r") else "N s/m")
        for d, value in zip(free, given, strict=True)
    )


def _along(name: str, axis: str | ArrayLike) -> Array:
    return axes_along(checked_axis(f"joint {name!r}", axis))


def fixed(name: str, a: str, b: str) -> Joint:
    """Make a rigid connection of points a and b."""
    return Joint(name, a, b)


def revolute(name: str, a: str, b: str, axis: str | ArrayLike = "z", *, damping: Damping = 0.0) -> Joint:
    """Make a joint in which b rotates about an axis of a.

    Args:
        name: name of the joint.
        a: first point, "body.point".
        b: second point, "body.point".
        axis: "x", "y", "z" or a vector (3,), world frame at the start.
        damping: viscous damping of the rotation [N m s/rad].
    """
    return Joint(name, a, b, ("rz",), _along(name, axis), damping)


def prismatic(name: str, a: str, b: str, axis: str | ArrayLike = "z", *, damping: Damping = 0.0) -> Joint:
    """Make a joint in which b slides along an axis of a and does not rotate; arguments as `revolute`."""
    return Joint(name, a, b, ("z",), _along(name, axis), damping)


def cylindrical(name: str, a: str, b: str, axis: str | ArrayLike = "z", *, damping: Damping = 0.0) -> Joint:
    """Make a joint in which b slides along an axis of a and rotates about it; arguments as `revolute`."""
    return Joint(name, a, b, ("z", "rz"), _along(name, axis), damping)


def universal(
    name: str, a: str, b: str, axis_a: str | ArrayLike, axis_b: str | ArrayLike, *, damping: Damping = 0.0
) -> Joint:
    """Make a universal joint (Hooke, Cardan): a cross whose first arm rotates in a and whose second arm rotates in b.

    Args:
        name: name of the joint.
        a: first point, "body.point".
        b: second point, "body.point".
        axis_a: axis of the first arm, direction "rx", fixed in a; "x", "y", "z" or a vector (3,), world frame at the
            start.
        axis_b: axis of the second arm, direction "ry", fixed in b.
        damping: viscous damping of the two rotations [N m s/rad], see `Joint`.

    Raises:
        ValueError: if the axes are not perpendicular at the start.
    """
    first, second = (unit_vector(checked_axis(f"joint {name!r}", axis)) for axis in (axis_a, axis_b))
    if abs(first @ second) > PERPENDICULAR:
        raise ValueError(f"joint {name!r}: a universal joint's axes must be perpendicular, got {axis_a!r}, {axis_b!r}")
    return Joint(name, a, b, ("rx", "ry"), np.column_stack([first, second, np.cross(first, second)]), damping)


def spherical(name: str, a: str, b: str, *, damping: Damping = 0.0) -> Joint:
    """Make a joint in which b rotates freely about a point of a; arguments as `revolute`."""
    return Joint(name, a, b, ("rx", "ry", "rz"), damping=damping)


def planar(name: str, a: str, b: str, normal: str | ArrayLike = "z", *, damping: Damping = 0.0) -> Joint:
    """Make a joint in which b slides in a plane of a and rotates about its normal.

    Args:
        name: name of the joint.
        a: first point, "body.point".
        b: second point, "body.point".
        normal: normal of the plane: "x", "y", "z" or a vector (3,), world frame at the start.
        damping: viscous damping {direction: number} of "x", "y" [N s/m] and "rz" [N m s/rad].
    """
    return Joint(name, a, b, ("x", "y", "rz"), _along(name, normal), damping)
