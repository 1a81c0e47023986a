"""Sensors of motion between two points: displacement, angle and pose, without dynamics of their own."""

from dataclasses import dataclass, field

import numpy as np

from nassim.base.checks import freeze
from nassim.base.rigid_motion import proper_rotation, unit_vector
from nassim.scene.axes_and_points import axis_text, between, check_any_moves, check_two_points, checked_axis
from nassim.scene.field_kinds import Axes, Direction, Path
from nassim.scene.measures import Displacement
from nassim.scene.part import Sensor
from nassim.scene.rotation_measures import RotationAngle
from nassim.scene.scene import Scene
from nassim.scene.terms import Output


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
        check_two_points(f"encoder {self.name!r}", self.a, self.b)
        freeze(self, axis=checked_axis(f"encoder {self.name!r}", self.axis, line=True))

    def terms(self, scene: Scene) -> tuple[Output]:
        """Return the displacement of b against a as an output."""
        check_any_moves(scene, self.name, self.a, self.b)
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
        check_two_points(f"angle sensor {self.name!r}", self.a, self.b)
        freeze(self, axis=checked_axis(f"angle sensor {self.name!r}", self.axis))

    def terms(self, scene: Scene) -> tuple[Output]:
        """Return the rotation of b against a as an output."""
        check_any_moves(scene, self.name, self.a, self.b)
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
        check_two_points(f"pose {self.name!r}", self.a, self.b)
        freeze(self, axes=proper_rotation(f"pose {self.name!r}: axes", self.axes))

    def terms(self, scene: Scene) -> tuple[Output, ...]:
        """Return the six components of the motion of b against a as outputs."""
        check_any_moves(scene, self.name, self.a, self.b)
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
