"""Mechanical parts of scenes: joints, spring-dampers, point forces, the ground's acceleration, encoders."""

from dataclasses import dataclass, field

import numpy as np

from nassim.base.checks import freeze, instances, known, not_negative, unique
from nassim.base.rigid_motion import DIRECTIONS, unit_vector
from nassim.scene.bodies import FlexibleBody, RigidBody
from nassim.scene.part import Actuator, Connection, Constraint, Field, Force, ForceElement, Reading, Row, Sensor, Spring
from nassim.scene.scene import Scene

WORLD_AXES = ("x", "y", "z")
TOUCH_TOLERANCE = 1e-9
"""Largest gap [m] between the two points of a joint."""


@dataclass(frozen=True)
class Joint(Connection):
    """Connects two points that coincide at the start.

    a, b: the points, "body.point"
    free: directions in which b may move against a: "x" "y" "z" "rx" "ry" "rz"; none, the default, is a rigid
        connection. They are the world's at the start and turn with the body of a from there on: a slide on a rail
        has the rail's point as a.
    """

    name: str
    a: str
    b: str
    free: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        free = instances("free", (self.free,) if isinstance(self.free, str) else self.free, (str,))
        for direction in free:
            known("direction", direction, DIRECTIONS)
        freeze(self, free=unique(f"joint {self.name!r}: free direction", free))

    def says(self, scene: Scene) -> tuple[Constraint]:
        """It holds all directions that are not free."""
        if self.a == self.b:
            raise ValueError(f"joint {self.name!r} connects {self.a!r} with itself")
        for path in (self.a, self.b):
            self._check_held(scene, path)
        gap = float(np.linalg.norm(scene.point_position(self.b) - scene.point_position(self.a)))
        if gap > TOUCH_TOLERANCE:
            raise ValueError(
                f"joint {self.name!r}: {self.a!r} and {self.b!r} are {gap:.3g} m apart; they must coincide to "
                f"{TOUCH_TOLERANCE:g} m: move one of the bodies"
            )
        return (Constraint(self.name, self.a, self.b, tuple(d for d in DIRECTIONS if d not in self.free)),)

    def describe(self) -> str:
        """Its points and what it leaves free."""
        return f"joint {self.name}: {self.a} to {self.b}, " + (
            f"free in {', '.join(self.free)}" if self.free else "rigid"
        )

    def _check_held(self, scene: Scene, path: str) -> None:
        """A point that only moves along, as trimming leaves some, is no coordinate that a joint could hold."""
        body, point = scene.split(path)
        if not isinstance(body, FlexibleBody) or not body.deforms:
            return
        if point in [passive.name for passive in body.reduced.passive_points]:
            raise ValueError(
                f"joint {self.name!r}: {path!r} is a passive point, which moves along with the body but cannot be "
                "held: use the body before it was trimmed, or name the point in trim_body(points=...)"
            )


@dataclass(frozen=True)
class SpringDamper(ForceElement):
    """A spring and a viscous damper in parallel between two points of rigid bodies, along an axis of the world's frame.

    a, b: "body.point"; axis: "x", "y" or "z"; stiffness [N/m]; damping [N s/m]
    """

    name: str
    a: str
    b: str
    axis: str = "z"
    stiffness: float = 0.0
    damping: float = 0.0

    def __post_init__(self) -> None:
        label = f"spring-damper {self.name!r}"
        known("axis", self.axis, WORLD_AXES)
        _two_points(label, self.a, self.b)
        freeze(
            self,
            stiffness=not_negative(f"{label}: stiffness", self.stiffness, "N/m"),
            damping=not_negative(f"{label}: damping", self.damping, "N s/m"),
        )
        if not self.stiffness and not self.damping:
            raise ValueError(f"{label} has neither stiffness nor damping")

    def says(self, scene: Scene) -> tuple[Spring]:
        """The motion of b against a along the axis is stiff and damped."""
        if rigid_body(scene, self.name, self.a) is rigid_body(scene, self.name, self.b):
            raise ValueError(f"spring {self.name!r}: {self.a!r} and {self.b!r} belong to one rigid body")
        return (Spring(Row.between(self.a, self.b, unit_vector(self.axis)), self.stiffness, self.damping),)

    def describe(self) -> str:
        """Its points, its axis and its figures."""
        figures = f"{self.stiffness:g} N/m, {self.damping:g} N s/m"
        return f"spring {self.name}: {self.a} to {self.b} along {self.axis}, {figures}"


@dataclass(frozen=True)
class PointForce(Actuator):
    """A force on a point of a rigid body, along an axis of the world's frame.

    point: "body.point"; axis: "x", "y" or "z"; input: name of the scene's input [N]
    """

    name: str
    point: str
    axis: str
    input: str
    unit: str = field(default="N", init=False)

    def __post_init__(self) -> None:
        known("axis", self.axis, WORLD_AXES)

    def says(self, scene: Scene) -> tuple[Force]:
        """The input pushes the point."""
        if rigid_body(scene, self.name, self.point).fixed:
            raise ValueError(f"{self.name!r}: {self.point!r} belongs to a fixed body, which no force moves")
        return (Force(self.input, self.unit, Row.of_point(self.point, unit_vector(self.axis))),)


@dataclass(frozen=True)
class GroundAcceleration(Actuator):
    """Acceleration of the ground with all fixed bodies, along an axis; motions are then relative to the ground.

    In the ground's frame it acts as an opposite, uniform gravity. axis: "x", "y" or "z"
    input: name of the scene's input [m/s2]
    """

    name: str
    axis: str
    input: str
    unit: str = field(default="m/s2", init=False)

    def __post_init__(self) -> None:
        known("axis", self.axis, WORLD_AXES)

    def says(self, scene: Scene) -> tuple[Field]:
        """Everything falls the other way."""
        return (Field(self.input, self.unit, -unit_vector(self.axis)),)


@dataclass(frozen=True)
class Encoder(Sensor):
    """Displacement of point b against point a along one axis of the world's frame, zero at the unloaded start.

    name: of the scene's output [m]; a, b: "body.point" of rigid bodies; axis: "x", "y" or "z"
    """

    name: str
    a: str
    b: str
    axis: str = "z"
    unit: str = field(default="m", init=False)

    def __post_init__(self) -> None:
        _two_points(f"encoder {self.name!r}", self.a, self.b)
        known("axis", self.axis, WORLD_AXES)

    def says(self, scene: Scene) -> tuple[Reading]:
        """It reads the motion of b against a."""
        for path in (self.a, self.b):
            rigid_body(scene, self.name, path)
        return (Reading(self.name, self.unit, Row.between(self.a, self.b, unit_vector(self.axis))),)


def rigid_body(scene: Scene, part: str, path: str) -> RigidBody:
    """The rigid body of a point that a part names; raises ValueError for another body and for an unknown point."""
    body, _ = scene.split(path)
    if not isinstance(body, RigidBody):
        raise ValueError(f"{part!r}: {path!r} must be a point of a rigid body")
    scene.point_position(path)
    return body


def _two_points(label: str, a: str, b: str) -> None:
    if a == b:
        raise ValueError(f"{label} connects {a!r} with itself")
