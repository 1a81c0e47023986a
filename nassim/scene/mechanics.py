"""Mechanical parts of scenes: springs and bushings, forces and torques, sensors of motion.

A direction is "x", "y", "z" or a vector along the world's axes, which do not rotate. With `frame` "body.point" it is
along axes that are the world's at the start and rotate with the body at that point. Between two points, "line" is the
present direction of the line through them.
"""

from dataclasses import dataclass, field

import numpy as np

from nassim.base.checks import Array, finite, finite_array, freeze, known, not_negative
from nassim.base.field_types import ArrayField, ArrayLike, Field, data_class, held
from nassim.base.rigid_motion import direction_text, proper_rotation, unit_vector
from nassim.scene.measures import (
    QUATERNION,
    VECTOR,
    Axes,
    Direction,
    Displacement,
    Distance,
    Measure,
    Path,
    PointVelocity,
    RelativePose,
    RotationAngle,
    Signal,
)
from nassim.scene.part import Actuator, ForceElement, Sensor
from nassim.scene.scene import Scene
from nassim.scene.terms import AppliedForce, BaseAcceleration, ForceLaw, NonlinearSpring, Output, Spring

LINE = "line"
SYMMETRIC = 1e-9
"""Relative asymmetry, and relative negative eigenvalue, that rounding may leave in a matrix."""


@dataclass(frozen=True)
class SpringDamper(ForceElement):
    """A spring and a viscous damper in parallel between two points.

    Attributes:
        name: name of the spring-damper.
        a: first point, "body.point".
        b: second point, "body.point".
        axis: a direction or "line".
        stiffness: stiffness [N/m].
        damping: damping [N s/m].
        frame: "" for the world's axes, or a point whose axes count, usually a or b. The axis then turns with the body
            of that point, which bears the moment of the two forces where a and b lie apart across the axis.
        preload: force in the reference configuration, positive where it pulls b back along the axis, as tension along
            the "line" does [N]. Springs with a preload are laws of their own in time: general items of Exudyn, which
            are slower, and refused by exact steps.
    """

    name: str
    a: Path
    b: Path
    axis: Direction = "z"
    stiffness: float = 0.0
    damping: float = 0.0
    frame: Path = ""
    preload: float = 0.0

    def __post_init__(self) -> None:
        label = f"spring-damper {self.name!r}"
        two_points(label, self.a, self.b)
        freeze(
            self,
            axis=checked_axis(label, self.axis, line=True),
            stiffness=not_negative(f"{label}: stiffness", self.stiffness, "N/m"),
            damping=not_negative(f"{label}: damping", self.damping, "N s/m"),
            preload=finite(f"{label}: preload", self.preload),
        )
        if not self.stiffness and not self.damping:
            raise ValueError(f"{label} has neither stiffness nor damping")

    def terms(self, scene: Scene) -> tuple[ForceLaw]:
        """Return a spring on the motion of b against a."""
        check_apart(scene, f"spring {self.name!r}", self.a, self.b)
        return (_spring(between(scene, self.a, self.b, self.axis, self.frame), self),)

    def describe(self) -> str:
        """Describe the points, the axis, the stiffness, the damping and the preload."""
        figures = f"{self.stiffness:g} N/m, {self.damping:g} N s/m"
        if self.preload:
            figures += f", preload {self.preload:g} N"
        return f"spring {self.name}: {self.a} to {self.b} along {axis_text(self.axis, self.frame)}, {figures}"


@data_class
class Bushing(ForceElement):
    """A spring and a viscous damper in all six directions between two points.

    Relative rotations of a and b are small; common rotations may have any size. In large motion, displacements under
    given forces differ from those of this law by up to about half of the square of the relative rotation [rad], as
    Exudyn's connector turns its axes. A bushing whose rotation about one axis
    or about all axes is free, without stiffness and damping, is a bearing: b may turn in it by any angle. In large
    motion a bearing is a general item of Exudyn, which takes a millisecond a step; its damping in linear models of
    rotors must be in dampers with a `frame`.

    Attributes:
        name: name of the bushing.
        a: first point, "body.point". Where the points are apart, the body of a is extended rigidly to the place of b.
        b: second point, "body.point".
        stiffness: forces [N] and moments [N m] on b per displacement [m] and rotation [rad] of b against a, in the
            order ux uy uz rx ry rz, (6, 6), symmetric; or the six values of a diagonal.
        damping: the same per velocity [m/s] and angular velocity [rad/s], (6, 6) or (6,).
        axes: axes of the six components at the start, as columns, world frame, (3, 3). They rotate with the mean
            rotation of a and b.
        preload: forces [N] and moments [N m] in the reference configuration with which b pulls back along these axes,
            (6,), see `SpringDamper`.
    """

    name: str
    a: Path
    b: Path
    stiffness: ArrayField
    damping: ArrayField = field(default_factory=held(lambda: np.zeros(6)))
    axes: Field[ArrayLike, Axes] = field(default_factory=held(lambda: np.eye(3)))
    preload: ArrayField = field(default_factory=held(lambda: np.zeros(6)))

    def __post_init__(self) -> None:
        label = f"bushing {self.name!r}"
        two_points(label, self.a, self.b)
        freeze(
            self,
            stiffness=_six(f"{label}: stiffness", self.stiffness),
            damping=_six(f"{label}: damping", self.damping),
            axes=proper_rotation(f"{label}: axes", self.axes),
            preload=finite_array(f"{label}: preload", self.preload, (6,)),
        )

    def terms(self, scene: Scene) -> tuple[ForceLaw]:
        """Return a spring on the relative pose of a and b."""
        check_apart(scene, f"bushing {self.name!r}", self.a, self.b)
        pose = RelativePose(self.a, self.b, self.axes, QUATERNION if self._is_bearing else VECTOR)
        return (_spring(pose, self),)

    @property
    def _is_bearing(self) -> bool:
        """Whether a shaft may rotate far in it: rotation about one axis is free and tilt is held, or all is free."""
        return int(np.linalg.matrix_rank(np.hstack([self.stiffness, self.damping])[3:])) in (0, 2)

    def describe(self) -> str:
        """Describe the points and the diagonal of the stiffness."""
        figures = " ".join(f"{k:g}" for k in np.diag(self.stiffness))
        return f"bushing {self.name}: {self.a} to {self.b}, diagonal {figures} N/m and N m/rad"


@dataclass(frozen=True)
class PointForce(Actuator):
    """A force on a point along a direction.

    Attributes:
        name: name of the actuator.
        point: "body.point".
        axis: a direction.
        input: name of the scene's input [N].
        frame: "" for the world's axes, or the point itself, for a force that rotates with its body.
        unit: unit of the input, "N".
    """

    name: str
    point: Path
    axis: Direction
    input: Signal
    frame: Path = ""
    unit = "N"

    def __post_init__(self) -> None:
        freeze(self, axis=checked_axis(f"force {self.name!r}", self.axis))

    def terms(self, scene: Scene) -> tuple[AppliedForce]:
        """Return the force on the point."""
        check_moves(scene, self.name, self.point)
        along = PointVelocity(((self.point, unit_vector(self.axis)),), checked_frame(scene, self.frame))
        return (AppliedForce(self.input, self.unit, along),)

    def describe(self) -> str:
        """Name the point, the axis and the input."""
        return f"force {self.name}: on {self.point} along {axis_text(self.axis, self.frame)}, by {self.input} [N]"


@dataclass(frozen=True)
class PointTorque(Actuator):
    """A torque on a body at a point, about a direction.

    Attributes:
        name: name of the actuator.
        point: "body.point".
        axis: a direction.
        input: name of the scene's input [N m].
        frame: "" for the world's axes, or the point itself, for a torque whose axis rotates with its body.
        unit: unit of the input, "N m".
    """

    name: str
    point: Path
    axis: Direction
    input: Signal
    frame: Path = ""
    unit = "N m"

    def __post_init__(self) -> None:
        freeze(self, axis=checked_axis(f"torque {self.name!r}", self.axis))

    def terms(self, scene: Scene) -> tuple[AppliedForce]:
        """Return the torque at the point."""
        check_moves(scene, self.name, self.point)
        about = PointVelocity(((self.point, unit_vector(self.axis)),), checked_frame(scene, self.frame), angular=True)
        return (AppliedForce(self.input, self.unit, about),)

    def describe(self) -> str:
        """Name the point, the axis and the input."""
        return f"torque {self.name}: on {self.point} about {axis_text(self.axis, self.frame)}, by {self.input} [N m]"


@dataclass(frozen=True)
class LinearActuator(Actuator):
    """An actuator that pushes two points apart along the line between them, such as the leg of a hexapod.

    Attributes:
        name: name of the actuator.
        a: first point, "body.point".
        b: second point, "body.point".
        input: name of the scene's input [N].
        unit: unit of the input, "N".
    """

    name: str
    a: Path
    b: Path
    input: Signal
    unit = "N"

    def __post_init__(self) -> None:
        two_points(f"actuator {self.name!r}", self.a, self.b)

    def terms(self, scene: Scene) -> tuple[AppliedForce]:
        """Return the force along the line."""
        check_apart(scene, f"actuator {self.name!r}", self.a, self.b)
        return (AppliedForce(self.input, self.unit, Distance(self.a, self.b)),)

    def describe(self) -> str:
        """Name the points and the input."""
        return f"linear actuator {self.name}: pushes {self.a} and {self.b} apart along their line, by {self.input} [N]"


@dataclass(frozen=True)
class GroundAcceleration(Actuator):
    """Acceleration of the ground with all fixed bodies along a direction; motions are then relative to the ground.

    In the ground's frame it acts as a uniform gravity in the opposite direction.

    Attributes:
        name: name of the actuator.
        axis: "x", "y", "z" or a vector (3,).
        input: name of the scene's input [m/s2].
        frame: "" for the world's axes, or a point "body.point", with whose body the axis turns, in small motion only;
            `nassim.signals.turned` converts records along the world's axes.
        unit: unit of the input, "m/s2".
    """

    name: str
    axis: Direction
    input: Signal
    frame: Path = ""
    unit = "m/s2"

    def __post_init__(self) -> None:
        freeze(self, axis=checked_axis(f"ground acceleration {self.name!r}", self.axis))

    def terms(self, scene: Scene) -> tuple[BaseAcceleration]:
        """Return the acceleration of the base."""
        return (BaseAcceleration(self.input, self.unit, unit_vector(self.axis), checked_frame(scene, self.frame)),)

    def describe(self) -> str:
        """Name the axis and the input."""
        return f"ground acceleration {self.name}: along {axis_text(self.axis, self.frame)}, by {self.input} [m/s2]"


@dataclass(frozen=True)
class Encoder(Sensor):
    """A displacement sensor: point b against point a along a direction or their line, zero at the unloaded start.

    Attributes:
        name: name of the scene's output [m].
        a: first point, "body.point".
        b: second point, "body.point".
        axis: a direction or "line".
        frame: "" for the world's axes, or a point whose axes count.
        unit: unit of the output, "m".
    """

    name: str
    a: Path
    b: Path
    axis: Direction = "z"
    frame: Path = ""
    unit = "m"

    def __post_init__(self) -> None:
        two_points(f"encoder {self.name!r}", self.a, self.b)
        freeze(self, axis=checked_axis(f"encoder {self.name!r}", self.axis, line=True))

    def terms(self, scene: Scene) -> tuple[Output]:
        """Return the displacement of b against a as an output."""
        check_seen(scene, self.name, self.a, self.b)
        return (Output(self.name, self.unit, between(scene, self.a, self.b, self.axis, self.frame)),)

    def describe(self) -> str:
        """Name the points and the axis."""
        return f"encoder {self.name} [m]: {self.b} against {self.a} along {axis_text(self.axis, self.frame)}"


@dataclass(frozen=True)
class AngleSensor(Sensor):
    """An angle sensor: rotation of b against a about a direction, unwrapped, zero at the unloaded start.

    Attributes:
        name: name of the scene's output [rad].
        a: first point, "body.point".
        b: second point, "body.point".
        axis: a direction at the start, which rotates with a.
        unit: unit of the output, "rad".
    """

    name: str
    a: Path
    b: Path
    axis: Direction = "z"
    unit = "rad"

    def __post_init__(self) -> None:
        two_points(f"angle sensor {self.name!r}", self.a, self.b)
        freeze(self, axis=checked_axis(f"angle sensor {self.name!r}", self.axis))

    def terms(self, scene: Scene) -> tuple[Output]:
        """Return the rotation of b against a as an output."""
        check_seen(scene, self.name, self.a, self.b)
        return (Output(self.name, self.unit, RotationAngle(self.b, unit_vector(self.axis), self.a)),)

    def describe(self) -> str:
        """Name the points and the axis."""
        return f"angle sensor {self.name} [rad]: {self.b} against {self.a} about {axis_text(self.axis, self.a)}"


@dataclass(frozen=True)
class Pose(Sensor):
    """A sensor of the pose of point b against point a: displacement and small rotation along axes that rotate with a.

    Attributes:
        name: outputs are "name.ux" ... [m] and "name.rx" ... [rad].
        a: first point, "body.point".
        b: second point, "body.point".
        axes: axes of the six components at the start, as columns, world frame, (3, 3).
    """

    name: str
    a: Path
    b: Path
    axes: Axes = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        two_points(f"pose {self.name!r}", self.a, self.b)
        freeze(self, axes=proper_rotation(f"pose {self.name!r}: axes", self.axes))

    def terms(self, scene: Scene) -> tuple[Output, ...]:
        """Return the six components of the motion of b against a as outputs."""
        check_seen(scene, self.name, self.a, self.b)
        along = [Displacement.between(self.a, self.b, axis, axes_of=self.a) for axis in self.axes.T]
        about = [RotationAngle(self.b, axis, self.a) for axis in self.axes.T]
        return (
            *(Output(f"{self.name}.u{axis}", "m", measure) for axis, measure in zip("xyz", along, strict=True)),
            *(Output(f"{self.name}.r{axis}", "rad", measure) for axis, measure in zip("xyz", about, strict=True)),
        )

    def describe(self) -> str:
        """Name the points and the axes."""
        turned = "" if np.array_equal(self.axes, np.eye(3)) else " and are not the world's at the start"
        return f"pose {self.name} [m], [rad]: {self.b} against {self.a}, along axes that rotate with {self.a}{turned}"


def checked_axis(label: str, axis: str | ArrayLike, *, line: bool = False) -> str | tuple[float, ...]:
    """Check an axis and return it as a part keeps it.

    Args:
        label: name of the part, for messages.
        axis: "x", "y", "z", or a vector (3,).
        line: whether "line" is allowed.

    Returns:
        The name, or the vector as a tuple.

    Raises:
        ValueError: for an unknown name, another shape, or a vector of no length.
    """
    if isinstance(axis, str):
        return known("axis", axis, ("x", "y", "z", LINE) if line else ("x", "y", "z"))
    vector = finite_array(f"{label}: axis", axis, (3,))
    if not np.any(vector):
        raise ValueError(f"{label}: an axis must have a length, got (0, 0, 0)")
    return tuple(vector.tolist())


def check_moves(scene: Scene, part: str, path: str) -> None:
    """Check that a point exists and belongs to a body that can move.

    Raises:
        ValueError: for an unknown point, and for a point of a fixed body.
    """
    scene.point_position(path)
    if not scene.split(path)[0].moves:
        raise ValueError(f"{part!r}: {path!r} belongs to a fixed body, which no force moves")


def check_seen(scene: Scene, part: str, *paths: str) -> None:
    """Check that points exist and that at least one belongs to a body that can move.

    Raises:
        ValueError: for unknown points, and where all belong to fixed bodies.
    """
    for path in paths:
        scene.point_position(path)
    if not any(scene.split(path)[0].moves for path in paths):
        raise ValueError(f"{part!r}: {' and '.join(map(repr, paths))} belong to fixed bodies, so it would read nothing")


def checked_frame(scene: Scene, frame: str) -> str:
    """Check that the point of a frame exists and return its path; "" is the world.

    Raises:
        ValueError: for an unknown point.
    """
    if frame:
        scene.point_position(frame)
    return frame


def between(scene: Scene, a: str, b: str, axis: str | ArrayLike, frame: str) -> Measure:
    """Return the measure of the motion of b against a along an axis."""
    if isinstance(axis, str) and axis == LINE:
        if np.allclose(scene.point_position(a), scene.point_position(b), rtol=0, atol=1e-12):
            raise ValueError(f"{a!r} and {b!r} lie in one place: no line joins them; give a direction")
        return Distance(a, b)
    return Displacement.between(a, b, unit_vector(axis), axes_of=checked_frame(scene, frame))


def check_apart(scene: Scene, label: str, a: str, b: str) -> None:
    """Refuse points of one rigid body and points of fixed bodies."""
    for path in (a, b):
        scene.point_position(path)
    first, second = scene.split(a)[0], scene.split(b)[0]
    if first is second and not first.deforms:
        raise ValueError(f"{label}: {a!r} and {b!r} belong to one rigid body")
    if not (first.moves or second.moves):
        raise ValueError(f"{label}: {a!r} and {b!r} belong to fixed bodies")


def _spring(measure: Measure, part: SpringDamper | Bushing) -> ForceLaw:
    """Return the law of a spring and a damper on a measure; with a preload it does not vanish at zero."""
    if not np.any(part.preload):
        return Spring(measure, part.stiffness, part.damping)
    stiffness, damping = np.atleast_2d(part.stiffness), np.atleast_2d(part.damping)

    def force(value: Array, rate: Array) -> Array:
        return part.preload + stiffness @ value + damping @ rate

    return NonlinearSpring(measure, force=force, tangent=lambda _value, _rate: (stiffness, damping))


def _six(label: str, value: ArrayLike) -> Array:
    """Return a checked matrix (6, 6) from a matrix or a diagonal."""
    matrix = finite_array(label, np.diag(value) if np.ndim(value) == 1 else value, (6, 6))
    size = np.abs(np.diag(matrix))
    scale = 1 / np.sqrt(np.where(size > 0, size, 1.0))
    scaled = scale[:, None] * matrix * scale
    if np.abs(scaled - scaled.T).max() > SYMMETRIC or np.linalg.eigvalsh(scaled)[0] < -SYMMETRIC:
        raise ValueError(f"{label} must be symmetric and not negative in any direction")
    return matrix


def axis_text(axis: str | ArrayLike, frame: str) -> str:
    """Return an axis as text for reports."""
    text = ("their line" if axis == LINE else axis) if isinstance(axis, str) else direction_text(axis)
    return f"{text} of {frame}" if frame else text


def two_points(label: str, a: str, b: str) -> None:
    """Refuse a part that connects a point with itself."""
    if a == b:
        raise ValueError(f"{label} connects {a!r} with itself")
