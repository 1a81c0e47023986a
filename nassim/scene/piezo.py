"""Piezoelectric parts of scenes: stacks as pairs of forces and elongations, or by the electrical ports of a body."""

import math
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import above_zero, finite, freeze, not_negative
from nassim.bodies.piezo import PortCoupling
from nassim.scene.bodies import FlexibleBody
from nassim.scene.field_kinds import Path, Signal
from nassim.scene.measures import BodyCoordinates
from nassim.scene.part import Actuator, Sensor
from nassim.scene.scene import Scene
from nassim.scene.terms import AppliedForce, Output, Shunt, Spring, Term

ONE_PLACE = 1e-9
"""Distance [m] up to which two points coincide."""


@dataclass(frozen=True)
class StackActuator(Actuator):
    """Piezo stacks that push two remote points of one flexible body apart.

    Attributes:
        name: name of the actuator.
        start: first remote point, "body.point"; the force acts along the line through both points.
        end: second remote point, "body.point".
        force_per_volt: blocked force per volt at the stack [N/V].
        input: name of the scene's input [V].
        gain: amplifier gain, stack voltage per input [V/V].
        bandwidth: -3 dB frequency of the amplifier, a low-pass of first order [Hz].
        unit: unit of the input, "V".
    """

    name: str
    start: Path
    end: Path
    force_per_volt: float
    input: Signal
    gain: float = 1.0
    bandwidth: float = math.inf
    unit = "V"
    factor = "gain"

    def __post_init__(self) -> None:
        freeze(self, force_per_volt=finite("force_per_volt", self.force_per_volt), gain=finite("gain", self.gain))
        above_zero(f"actuator {self.name!r}: bandwidth", self.bandwidth, "Hz")

    def terms(self, scene: Scene) -> tuple[AppliedForce]:
        """Return the pair of forces per unit of the input."""
        stretch = _elongation(scene, self.name, self.start, self.end)
        return (AppliedForce(self.input, self.unit, stretch, self.gain * self.force_per_volt, self.bandwidth),)

    def describe(self) -> str:
        """Name the points and the input."""
        return f"stack actuator {self.name}: pushes {self.start} and {self.end} apart, by {self.input} [V]"


@dataclass(frozen=True)
class StackSensor(Sensor):
    """A piezo stack as force sensor: its open-circuit voltage, positive in compression.

    Attributes:
        name: name of the scene's output [V].
        start: first remote point of a flexible body, "body.point".
        end: second remote point of the same body, "body.point".
        voltage_per_elongation: sensitivity [V/m].
        unit: unit of the output, "V".
    """

    name: str
    start: Path
    end: Path
    voltage_per_elongation: float
    unit = "V"
    factor = "voltage_per_elongation"

    def __post_init__(self) -> None:
        freeze(self, voltage_per_elongation=finite("voltage_per_elongation", self.voltage_per_elongation))

    def terms(self, scene: Scene) -> tuple[Output]:
        """Return the output: the voltage by the change of the distance of the two points."""
        stretch = _elongation(scene, self.name, self.start, self.end)
        return (Output(self.name, self.unit, stretch, -self.voltage_per_elongation),)

    def describe(self) -> str:
        """Name the points."""
        return f"stack sensor {self.name} [V]: between {self.start} and {self.end}"


@dataclass(frozen=True)
class VoltageDrive(Actuator):
    """A voltage amplifier that drives an electrical port of a flexible body and supplies any current.

    Attributes:
        name: name of the drive.
        port: "body.port".
        input: name of the scene's input [V].
        gain: amplifier gain, port voltage per input [V/V].
        bandwidth: -3 dB frequency of the amplifier, a low-pass of first order [Hz].
        unit: unit of the input, "V".
    """

    name: str
    port: Path
    input: Signal
    gain: float = 1.0
    bandwidth: float = math.inf
    unit = "V"
    factor = "gain"

    def __post_init__(self) -> None:
        freeze(self, gain=finite("gain", self.gain))
        above_zero(f"drive {self.name!r}: bandwidth", self.bandwidth, "Hz")

    def terms(self, scene: Scene) -> tuple[AppliedForce]:
        """Return the forces of the port per unit of the input."""
        body, port = _port(scene, self.port)
        charge = BodyCoordinates(body, port.forces)
        return (AppliedForce(self.input, self.unit, charge, self.gain, self.bandwidth),)

    @property
    def claims(self) -> tuple[str, ...]:
        """The port."""
        return (self.port,)

    def describe(self) -> str:
        """Name the input that drives the port."""
        return f"driven by {self.input}"


@dataclass(frozen=True)
class VoltageSensor(Sensor):
    """A sensor of the voltage of an electrical port of a flexible body, positive in compression.

    Attributes:
        name: name of the scene's output [V].
        port: "body.port".
        resistance: resistance R of the electronics and the cable, in parallel to the port [Ohm]. The sensor is then a
            high-pass with its corner at 1 / (2 pi R (c + capacitance)) [Hz], c the port's blocked capacitance. Default:
            open circuit.
        capacitance: capacitance of the electronics and the cable, in parallel to the port [F].
        gain: output per port voltage [V/V].
        unit: unit of the output, "V".
    """

    name: str
    port: Path
    resistance: float = math.inf
    capacitance: float = 0.0
    gain: float = 1.0
    unit = "V"
    factor = "gain"

    def __post_init__(self) -> None:
        label = f"voltage sensor {self.name!r}"
        above_zero(f"{label}: resistance", self.resistance, "Ohm")
        freeze(
            self,
            resistance=float(self.resistance),
            capacitance=not_negative(f"{label}: capacitance", self.capacitance, "F"),
            gain=finite("gain", self.gain),
        )

    def terms(self, scene: Scene) -> tuple[Term, ...]:
        """Return the voltage -b q / c of the charge b q, the equivalent spring 1 / c, and the resistance's shunt."""
        body, port = _port(scene, self.port)
        charge, capacitance = BodyCoordinates(body, port.forces), port.blocked_capacitance + self.capacitance
        terms: tuple[Term, ...] = (
            Output(self.name, self.unit, charge, -self.gain / capacitance),
            Spring(charge, 1 / capacitance),
        )
        if math.isfinite(self.resistance):
            terms += (Shunt(self.name, charge, capacitance, self.resistance, self.gain),)
        return terms

    @property
    def claims(self) -> tuple[str, ...]:
        """The port."""
        return (self.port,)

    def describe(self) -> str:
        """Describe the load across the port."""
        return "measured, " + ("open" if math.isinf(self.resistance) else f"{self.resistance:g} Ohm")


def _elongation(scene: Scene, part: str, start: str, end: str) -> BodyCoordinates:
    """Return the relative displacement of two points of a flexible body along their line, in the body's axes."""
    (body, first), (other, last) = scene.split(start), scene.split(end)
    if body is not other or not isinstance(body, FlexibleBody) or first == last:
        raise ValueError(f"stack {part!r}: {start!r} and {end!r} must be two points of one flexible body")
    line = body.reduced.point(last).position - body.reduced.point(first).position
    length = float(np.linalg.norm(line))
    if length < ONE_PLACE:
        raise ValueError(f"stack {part!r}: its ends {start!r} and {end!r} lie in one place: no line joins them")
    return BodyCoordinates.between(body, first, last, line / length)


def _port(scene: Scene, path: str) -> tuple[str, PortCoupling]:
    """Return the name of a port's body, and the port."""
    body, name = scene.split(path)
    if not isinstance(body, FlexibleBody):
        raise ValueError(f"electrical port {path!r}: body {body.name!r} is rigid and has none")
    return body.name, body.reduced.port(name)
