"""Voltage of an electrical port in a scene: that of an amplifier, of an open circuit, or of a resistance."""

from collections.abc import Mapping
from dataclasses import dataclass

from nassim.base.checks import Array
from nassim.scene.bodies import FlexibleBody
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
        if isinstance(term, AppliedForce):
            amplifiers.append(term)
        elif isinstance(term, Shunt):
            shunts.append(term)
        elif isinstance(term, Spring):
            row = row - term.matrices[0][0, 0] * coupling.forces
        elif not isinstance(term, (Output, OutputFilter)):
            raise ValueError(
                f"the voltage of port {port!r} of body {body.name!r} stresses its stacks, and how the "
                f"{type(term).__name__} of part {users[0].name!r} sets this voltage is unknown: take a stress point "
                "outside the stacks, or `peak_stress` with the voltages"
            )
    return PortVoltage(row, tuple(amplifiers), tuple(shunts))


def static_voltages(
    scene: Scene, body: FlexibleBody, coordinates: Array, inputs: Mapping[str, float]
) -> dict[str, float]:
    """Return the voltages of all ports of a body at rest, by name [V].

    Args:
        scene: the scene.
        body: its flexible body.
        coordinates: coordinates of the body at rest, (n,).
        inputs: constant values of inputs, by name; others are zero.
    """
    return {port.name: port_voltage(scene, body, port.name).at_rest(coordinates, inputs) for port in body.reduced.ports}
