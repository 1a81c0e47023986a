"""Actuators of scenes that apply forces: on points, between points, and on all bodies as the ground accelerates."""

from dataclasses import dataclass

from nassim.base.checks import freeze
from nassim.base.rigid_motion import unit_vector
from nassim.scene.axes_and_points import (
    at_point,
    axis_text,
    check_apart,
    check_moves,
    check_two_points,
    checked_axis,
    checked_frame,
)
from nassim.scene.field_kinds import Direction, Path, Signal
from nassim.scene.measures import Distance
from nassim.scene.part import Actuator
from nassim.scene.scene import Scene
from nassim.scene.terms import AppliedForce, BaseAcceleration


@dataclass(frozen=True)
class PointForce(Actuator):
    """A force on a point along a direction.

    Attributes:
        name: name of the actuator.
        point: "body.point".
        axis: a direction.
        input: name of the scene's input [N].
        frame: "" for the world's axes, or a point, often the same one, with whose body the force rotates.
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
        return (AppliedForce(self.input, self.unit, at_point(scene, self.point, self.axis, self.frame)),)

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
        frame: "" for the world's axes, or a point, often the same one, with whose body the axis rotates.
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
        about = at_point(scene, self.point, self.axis, self.frame, angular=True)
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
        check_two_points(f"actuator {self.name!r}", self.a, self.b)

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
