"""Voltage of an electrical port in a scene: that of an amplifier, of an open circuit, or of a resistance.

It stresses the material of its stacks, so stress is that of the motion and of the voltages.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from nassim.base.checks import Array, known
from nassim.base.field_types import ArrayLike
from nassim.bodies.readouts import readouts_of
from nassim.bodies.reduced_body import ReducedBody
from nassim.bodies.stress import StressField
from nassim.scene.bodies import FlexibleBody
from nassim.scene.field_kinds import Path
from nassim.scene.measures import BodyCoordinates
from nassim.scene.part import Sensor
from nassim.scene.scene import Scene
from nassim.scene.terms import AppliedForce, CircuitState, Feedthrough, Output, OutputFilter, Shunt, Spring, Term


@dataclass(frozen=True)
class PortVoltage:
    """How the voltage of an electrical port follows from the terms of the part that uses it.

    Attributes:
        row: voltage per unit of the body's coordinates, of a port whose charge stays, (n,) [V]; zero for others.
        amplifiers: applied forces of an amplifier, whose gains are volts per unit of an input.
        shunts: resistances, whose charge over the capacitance adds to the voltage.
    """

    row: Array
    amplifiers: tuple[AppliedForce, ...]
    shunts: tuple[Shunt, ...]

    def terms(self, output: str, gain: float) -> list[Term]:
        """Return the terms by which an output reads what does not follow the coordinates, times a gain."""
        by_input = [Feedthrough(output, one.input, gain * one.gain, one.bandwidth) for one in self.amplifiers]
        return [*by_input, *(CircuitState(output, shunt.output, gain) for shunt in self.shunts)]

    def at_rest(self, coordinates: Array, inputs: Mapping[str, float]) -> float:
        """Return the voltage at rest under constant inputs, others are zero [V]; a resistance has discharged it."""
        if self.shunts:
            return 0.0
        return float(self.row @ coordinates) + sum(one.gain * inputs.get(one.input, 0.0) for one in self.amplifiers)


def port_voltage(scene: Scene, body: FlexibleBody, port: str) -> PortVoltage:
    """Find the voltage of a port of a body; a port that no part uses has 0 V.

    Raises:
        ValueError: for a part that sets the voltage by another law.
    """
    coupling = body.reduced.port(port)
    row, amplifiers, shunts = 0.0 * coupling.forces, [], []
    users = [part for part in scene.parts if f"{body.name}.{port}" in part.claims]  # at most one
    for term in (term for user in users for term in user.terms(scene)):
        if isinstance(term, AppliedForce) and isinstance(term.measure, BodyCoordinates):
            amplifiers.append(term)
        elif isinstance(term, Shunt):
            shunts.append(term)
        elif isinstance(term, Spring):
            row = row - term.scalars[0] * coupling.forces
        elif not isinstance(term, (Output, OutputFilter)):
            raise ValueError(
                f"the voltage of port {port!r} of body {body.name!r} stresses its stacks, and how the "
                f"{type(term).__name__} of part {users[0].name!r} sets this voltage is unknown: take a stress point "
                "outside the stacks, or `peak_stress` with the voltages"
            )
    return PortVoltage(row, tuple(amplifiers), tuple(shunts))


@dataclass(frozen=True)
class PortVoltageSensor(Sensor):
    """The voltage of an electrical port, whichever part sets it. Runs record it beside the motion.

    Attributes:
        name: name of the output [V].
        port: "body.port".
    """

    name: str
    port: Path

    def terms(self, scene: Scene) -> tuple[Term, ...]:
        """Return the voltage as an output, with what does not follow the coordinates."""
        body, port = scene.split(self.port)
        assert isinstance(body, FlexibleBody)
        voltage = port_voltage(scene, body, port)
        return (Output(self.name, "V", BodyCoordinates(body.name, voltage.row)), *voltage.terms(self.name, 1.0))


def stressing_ports(body: ReducedBody, fields: Sequence[StressField]) -> tuple[str, ...]:
    """Return the names of a body's electrical ports whose voltage adds to a stress of it."""
    return tuple(port.name for port in body.ports if any(port.name in field.voltages for field in fields))


def check_ports(body: ReducedBody, names: Iterable[str]) -> None:
    """Raise a ValueError for a name that is no electrical port of a body."""
    stressed = (name for field in readouts_of(body.readouts, StressField) for name in field.voltages)
    allowed = dict.fromkeys((*(port.name for port in body.ports), *stressed))
    for name in names:
        known(f"electrical port of body {body.name!r}", name, allowed)


def stressing_voltages(
    body: ReducedBody,
    fields: Sequence[StressField],
    given: Mapping[str, ArrayLike] | None,
    recorded: Mapping[str, Array],
) -> dict[str, ArrayLike]:
    """Return the voltages of a body's ports, those given before those recorded.

    Args:
        body: the body.
        fields: its stress that is looked at.
        given: voltages by name, as a user gives them [V].
        recorded: those that a motion knows, by name [V].

    Raises:
        ValueError: for unknown ports, and for ports that stress a place and whose voltage is unknown.
    """
    check_ports(body, given or {})
    result = {**recorded, **(given or {})}
    if missing := [port for port in stressing_ports(body, fields) if port not in result]:
        ports = ", ".join(f"{port!r}: ..." for port in missing)
        raise ValueError(
            f"body {body.name!r}: voltages at electrical ports stress the stacks, and those of {', '.join(missing)} "
            f"are unknown here: give voltages={{{ports}}} in volts, 0 for a port that is shorted; motions of "
            "simulate_motion and static_motion know the voltages of their scene"
        )
    return result


def known_voltages(scene: Scene) -> Iterator[tuple[FlexibleBody, str, PortVoltage]]:
    """Find the ports of a scene whose voltage stresses their body, but for those that parts use by an unknown law."""
    for body in scene.flexible_bodies:
        for port in stressing_ports(body.reduced, readouts_of(body.reduced.readouts, StressField)):
            try:
                voltage = port_voltage(scene, body, port)
            except ValueError:
                continue
            yield body, port, voltage


def with_voltage_sensors(scene: Scene) -> Scene:
    """Add outputs to a scene that are the voltages which stress its bodies; see `recorded_voltages`."""
    sensors = [
        PortVoltageSensor(f"voltage of {body.name}.{port}", f"{body.name}.{port}")
        for body, port, _ in known_voltages(scene)
    ]
    return replace(scene, sensors=(*scene.sensors, *sensors))


def recorded_voltages(scene: Scene, readings: Array) -> dict[str, dict[str, Array]]:
    """Return the voltages of a scene of `with_voltage_sensors` by body and port.

    Args:
        scene: the scene.
        readings: its outputs, and any rows after them, (outputs + ..., n).
    """
    result: dict[str, dict[str, Array]] = {}
    for sensor in scene.sensors:
        if isinstance(sensor, PortVoltageSensor):
            body, port = scene.split(sensor.port)
            result.setdefault(body.name, {})[port] = readings[scene.outputs.index(sensor.name)]
    return result


def static_voltages(
    scene: Scene,
    body: FlexibleBody,
    coordinates: Array,
    inputs: Mapping[str, float],
    given: Mapping[str, float] | None = None,
) -> dict[str, float]:
    """Return the voltages of all ports of a body at rest, by name [V].

    Args:
        scene: the scene.
        body: its flexible body.
        coordinates: coordinates of the body at rest, (n,).
        inputs: constant values of inputs, by name; others are zero.
        given: voltages in place of those of the scene, by name [V].

    Raises:
        ValueError: for unknown ports, and as `port_voltage`.
    """
    found = dict(given or {})
    check_ports(body.reduced, found)
    for port in body.reduced.ports:
        if port.name not in found:
            found[port.name] = port_voltage(scene, body, port.name).at_rest(coordinates, inputs)
    return found
