"""Parts of scenes: bodies, joints, actuators, sensors and loops as pure data, connected by name."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from nassim.body import ReducedBody
from nassim.checks import (
    Array,
    finite,
    finite_array,
    freeze,
    frozen_mapping,
    instances,
    known,
    not_negative,
    positive,
    unique,
)
from nassim.control import Controller
from nassim.rigid_motion import DIRECTIONS

FIDELITIES = ("rigid", "linear", "ffrf")
WORLD_AXES = ("x", "y", "z")
ROUNDED = 2e-3
"""Share by which rounded moments of a flat body may exceed what is possible."""


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
        if not isinstance(self.points, Mapping):
            raise ValueError(f'{label}: points must map names to positions, such as {{"top": (0, 0, 0.1)}}')
        if not isinstance(self.fixed, (bool, np.bool_)):
            raise ValueError(f"{label}: fixed must be True or False, got {self.fixed!r}")
        unique(f"{label}: point", self.points)
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
        moments = np.linalg.eigvalsh(inertia)
        if moments[2] > (1 + ROUNDED) * (moments[0] + moments[1]):
            raise ValueError(
                f"{label}: no body has the principal moments {', '.join(f'{m:.4g}' for m in moments)} kg m2: none "
                "can exceed the sum of the other two"
            )
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
    angular_velocity: at the start, world frame, shape (3,) [rad/s]; bodies jointed to this one move along, and what
        the joints do not allow is refused when a simulation starts; zero asks for nothing
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
        if not isinstance(self.reduced, ReducedBody):
            raise ValueError(f"{label}: reduced must be a ReducedBody, got a {type(self.reduced).__name__}")
        if not self.reduced.remote_points:
            raise ValueError(f"{label} needs at least one remote point, on which its frame rides")
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
        """How much the distance between two points grows per unit of the reduced coordinates, shape (n,).

        Raises ValueError for unknown points and for two in one place.
        """
        axis = self.reduced.point(end).position - self.reduced.point(start).position
        length = float(np.linalg.norm(axis))
        if not length:
            raise ValueError(f"{start!r} and {end!r} of body {self.name!r} lie in one place: no line joins them")
        axis = axis / length
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


@dataclass(frozen=True)
class StackActuator:
    """Piezo stacks that push two remote points of one flexible body apart.

    start, end: the remote points, "body.point"; the force acts along the line through them
    force_per_volt: blocked force per volt at the stack [N/V]; gain: amplifier, stack voltage per input [V/V]
    input: name of the scene's input [V]
    bandwidth: of the amplifier, a low-pass of first order, -3 dB [Hz]
    """

    name: str
    start: str
    end: str
    force_per_volt: float
    input: str
    gain: float = 1.0
    bandwidth: float = math.inf
    unit: str = field(default="V", init=False)

    def __post_init__(self) -> None:
        freeze(self, force_per_volt=finite("force_per_volt", self.force_per_volt), gain=finite("gain", self.gain))
        _above_zero(f"actuator {self.name!r}: bandwidth", self.bandwidth, "Hz")


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
        _two_points(f"encoder {self.name!r}", self.a, self.b)
        known("axis", self.axis, WORLD_AXES)


@dataclass(frozen=True)
class VoltageDrive:
    """An amplifier that drives an electrical port of a flexible body, whatever current that takes.

    port: "body.port"; input: name of the scene's input [V]; gain: amplifier, port voltage per input [V/V]
    bandwidth: of the amplifier, a low-pass of first order, -3 dB [Hz]
    """

    name: str
    port: str
    input: str
    gain: float = 1.0
    bandwidth: float = math.inf
    unit: str = field(default="V", init=False)

    def __post_init__(self) -> None:
        freeze(self, gain=finite("gain", self.gain))
        _above_zero(f"drive {self.name!r}: bandwidth", self.bandwidth, "Hz")


@dataclass(frozen=True)
class PointForce:
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


@dataclass(frozen=True)
class GroundAcceleration:
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


@dataclass(frozen=True)
class SpringDamper:
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
        _above_zero(f"{label}: resistance", self.resistance, "Ohm")
        freeze(
            self,
            resistance=float(self.resistance),
            capacitance=not_negative(f"{label}: capacitance", self.capacitance, "F"),
            gain=finite("gain", self.gain),
        )


Actuator = StackActuator | VoltageDrive | PointForce | GroundAcceleration
Sensor = StackSensor | VoltageSensor | Encoder


@dataclass(frozen=True)
class Loop:
    """A digital controller between named outputs and inputs of a scene; what it computes adds to the excitation.

    measured: outputs, in the order of the controller's inputs; driven: inputs, in the order of its outputs
    input_step, input_limit: resolution and range of the analogue-to-digital converters, in the outputs' units
    output_step: resolution of the digital-to-analogue converters, in the inputs' units; 0: none
    """

    name: str
    controller: Controller
    measured: tuple[str, ...]
    driven: tuple[str, ...]
    input_step: float = 0.0
    input_limit: float = math.inf
    output_step: float = 0.0

    def __post_init__(self) -> None:
        label = f"loop {self.name!r}"
        if not isinstance(self.controller, Controller):
            raise ValueError(f"{label}: controller must be a Controller, got a {type(self.controller).__name__}")
        measured, driven = ((n,) if isinstance(n, str) else tuple(n) for n in (self.measured, self.driven))
        n_out, n_in = self.controller.D.shape
        if (len(driven), len(measured)) != (n_out, n_in):
            raise ValueError(
                f"{label}: its controller has {n_in} input(s) and {n_out} output(s), but it measures {len(measured)} "
                f"and drives {len(driven)} signal(s)"
            )
        for name in ("input_step", "output_step"):
            not_negative(f"{label}: {name}", getattr(self, name))
        _above_zero(f"{label}: input_limit", self.input_limit)
        freeze(self, measured=unique(f"{label}: measured", measured), driven=unique(f"{label}: driven", driven))

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of its signals in records: its own for one driven input, else "name.input"."""
        return (self.name,) if len(self.driven) == 1 else tuple(f"{self.name}.{name}" for name in self.driven)


def _two_points(label: str, a: str, b: str) -> None:
    if a == b:
        raise ValueError(f"{label} connects {a!r} with itself")


def _above_zero(label: str, value: float, unit: str = "") -> None:
    if not isinstance(value, (int, float, np.number)) or not value > 0:
        raise ValueError(f"{label} must be positive, got {value!r} {unit}".rstrip() + "; inf for none")
