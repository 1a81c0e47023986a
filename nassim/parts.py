"""Parts of scenes: bodies, joints, actuators and sensors as pure data, connected by name."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from nassim.body import ReducedBody
from nassim.checks import Array, finite, finite_array, freeze, frozen_mapping, known, not_negative, positive
from nassim.interface import DIRECTIONS

FIDELITIES = ("rigid", "linear", "ffrf")


@dataclass(frozen=True)
class RigidBody:
    """A rigid body.

    name: what the scene calls it
    mass: [kg]; inertia: about the centre of mass, shape (3, 3) [kg m2]; both may be None for a fixed body
    position: of the centre of mass at the start, in the world's frame [m]
    points: named points, relative to the centre of mass [m]
    fixed: True for a body that does not move, such as a granite base
    """

    name: str
    points: Mapping[str, Array]
    mass: float | None = None
    inertia: Array | None = None
    position: Array = field(default_factory=lambda: np.zeros(3))
    fixed: bool = False

    def __post_init__(self) -> None:
        label = f"rigid body {self.name!r}"
        points = {k: finite_array(f"{label}: point {k!r}", v, (3,)) for k, v in self.points.items()}
        freeze(
            self,
            points=frozen_mapping(points),
            position=finite_array(f"{label}: position", self.position, (3,)),
        )
        if self.fixed:
            return
        if self.mass is None or self.inertia is None:
            raise ValueError(f"{label} can move, so it needs a mass and an inertia (or fixed=True)")
        mass = positive(f"{label}: mass", self.mass, "kg")
        inertia = finite_array(f"{label}: inertia", self.inertia, (3, 3))
        if np.abs(inertia - inertia.T).max() > 1e-9 * np.abs(inertia).max() or np.linalg.eigvalsh(inertia)[0] <= 0:
            raise ValueError(f"{label}: inertia must be symmetric and positive definite")
        freeze(self, mass=mass, inertia=inertia)

    def point_position(self, point: str) -> Array:
        """Position of a named point at the start, world frame, shape (3,) [m]."""
        result: Array = self.position + self.points[known(f"point of {self.name!r}", point, self.points)]
        return result


@dataclass(frozen=True)
class FlexibleBody:
    """A reduced body in a scene.

    name: what the scene calls it; reduced: the body
    position: of the body's origin at the start, in the world's frame, shape (3,) [m]
    rotation: from the body's to the world's frame at the start, shape (3, 3)
    fidelity: "ffrf", a floating frame that may move far and turn; "linear", small motion about the start (rotations
        up to some 0.01 rad), twenty times as fast; "rigid", no deformation: its stacks then do and read nothing
    frame: remote point that the floating frame rides on (default: the first that a joint holds, else the first)
    angular_velocity: at the start, world frame, shape (3,) [rad/s]
    """

    name: str
    reduced: ReducedBody
    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))
    fidelity: str = "ffrf"
    frame: str | None = None
    angular_velocity: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        label = f"flexible body {self.name!r}"
        rotation = finite_array(f"{label}: rotation", self.rotation, (3, 3))
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-9 or np.linalg.det(rotation) < 0:
            raise ValueError(f"{label}: rotation must be a proper orthogonal matrix")
        known("fidelity", self.fidelity, FIDELITIES)
        if self.frame is not None:
            known("remote point", self.frame, self.reduced.point_names)
        if self.fidelity == "linear" and np.any(self.angular_velocity):
            raise ValueError(f'{label} spins, so it needs fidelity "ffrf" or "rigid": "linear" is for small rotation')
        freeze(
            self,
            position=finite_array(f"{label}: position", self.position, (3,)),
            rotation=rotation,
            angular_velocity=finite_array(f"{label}: angular_velocity", self.angular_velocity, (3,)),
        )

    def elongation(self, start: str, end: str) -> Array:
        """How much the distance between two points grows per unit of the reduced coordinates, shape (n,)."""
        axis = self.reduced.point(end).position - self.reduced.point(start).position
        axis = axis / np.linalg.norm(axis)
        result: Array = axis @ (self.reduced.motion(end) - self.reduced.motion(start))[:3]
        return result

    def point_position(self, point: str) -> Array:
        """Position of a remote point at the start, world frame, shape (3,) [m]."""
        result: Array = self.position + self.rotation @ self.reduced.point(point).position
        return result


Body = RigidBody | FlexibleBody


@dataclass(frozen=True)
class Joint:
    """Connects two points that coincide at the start.

    a, b: the points, "body.point"
    free: directions of the world's frame in which b may move against a: "x" "y" "z" "rx" "ry" "rz";
        none, the default, is a rigid connection
    """

    name: str
    a: str
    b: str
    free: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        free = (self.free,) if isinstance(self.free, str) else tuple(self.free)
        for direction in free:
            known("direction", direction, DIRECTIONS)
        freeze(self, free=free)


@dataclass(frozen=True)
class StackActuator:
    """Piezo stacks that push two remote points of one flexible body apart.

    start, end: the remote points, "body.point"; the force acts along the line through them
    force_per_volt: blocked force per volt at the stack [N/V]; gain: amplifier, stack voltage per input [V/V]
    input: name of the scene's input [V]
    """

    name: str
    start: str
    end: str
    force_per_volt: float
    input: str
    gain: float = 1.0

    def __post_init__(self) -> None:
        freeze(self, force_per_volt=finite("force_per_volt", self.force_per_volt), gain=finite("gain", self.gain))


@dataclass(frozen=True)
class StackSensor:
    """A piezo stack as force sensor: its open-circuit voltage, positive in compression.

    name: of the scene's output [V]; start, end: remote points of one flexible body, "body.point"
    voltage_per_elongation: [V/m]
    """

    name: str
    start: str
    end: str
    voltage_per_elongation: float
    unit: str = field(default="V", init=False)

    def __post_init__(self) -> None:
        freeze(self, voltage_per_elongation=finite("voltage_per_elongation", self.voltage_per_elongation))


@dataclass(frozen=True)
class Encoder:
    """Displacement of point b against point a along one axis of the world's frame, zero at the unloaded start.

    name: of the scene's output [m]; a, b: "body.point" of rigid bodies; axis: "x", "y" or "z"
    """

    name: str
    a: str
    b: str
    axis: str = "z"
    unit: str = field(default="m", init=False)

    def __post_init__(self) -> None:
        known("axis", self.axis, ("x", "y", "z"))


@dataclass(frozen=True)
class VoltageDrive:
    """An amplifier that drives an electrical port of a flexible body, whatever current that takes.

    port: "body.port"; input: name of the scene's input [V]; gain: amplifier, port voltage per input [V/V]
    """

    name: str
    port: str
    input: str
    gain: float = 1.0

    def __post_init__(self) -> None:
        freeze(self, gain=finite("gain", self.gain))


@dataclass(frozen=True)
class VoltageSensor:
    """The voltage of an electrical port of a flexible body, positive in compression.

    name: of the scene's output [V]; port: "body.port"
    resistance, capacitance: of the electronics and its cable, in parallel to the port [Ohm], [F]. With a resistance R
        the sensor is a high-pass of 1 / (2 pi R (c + capacitance)) [Hz]; default: open circuit
    gain: output per port voltage [V/V]
    """

    name: str
    port: str
    resistance: float = math.inf
    capacitance: float = 0.0
    gain: float = 1.0
    unit: str = field(default="V", init=False)

    def __post_init__(self) -> None:
        label = f"voltage sensor {self.name!r}"
        if not self.resistance > 0:
            raise ValueError(
                f"{label}: resistance must be positive, got {self.resistance:g} Ohm; inf for an open circuit"
            )
        freeze(
            self,
            resistance=float(self.resistance),
            capacitance=not_negative(f"{label}: capacitance", self.capacitance, "F"),
            gain=finite("gain", self.gain),
        )


Actuator = StackActuator | VoltageDrive
Sensor = StackSensor | VoltageSensor | Encoder
