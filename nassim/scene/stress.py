"""Sensors of stress and strain: outputs of the places at which a reduced body keeps them."""

from dataclasses import dataclass, field

import numpy as np

from nassim.base.checks import Array, finite, freeze, known
from nassim.bodies.readouts import of_kind
from nassim.bodies.stress import COMPONENTS, GaugeStrain, StressField
from nassim.scene.bodies import FlexibleBody
from nassim.scene.measures import BodyCoordinates, Path
from nassim.scene.part import Sensor
from nassim.scene.scene import Scene
from nassim.scene.terms import AppliedForce, CircuitState, Feedthrough, Output, OutputFilter, Shunt, Spring, Term

CURE = "reduce the body by craig_bampton(..., stress=[...]) with it"


@dataclass(frozen=True)
class StrainGauge(Sensor):
    """A strain gauge: the mean strain along a line on a flexible body, positive in tension.

    Attributes:
        name: name of the scene's output [-].
        gauge: "body.gauge", a `GaugeLine` of the body's reduction.
        gain: output per unit of strain.
        unit: unit of the output, "1".
    """

    name: str
    gauge: Path
    gain: float = 1.0
    unit: str = field(default="1", init=False)
    factor = "gain"

    def __post_init__(self) -> None:
        freeze(self, gain=finite("gain", self.gain))

    def terms(self, scene: Scene) -> tuple[Output]:
        """Return the strain as an output."""
        body, name = _flexible(scene, self.name, self.gauge)
        gauges = {readout.name: readout for readout in of_kind(body.reduced.readouts, GaugeStrain)}
        gauge = gauges[known(f"gauge of body {body.name!r} ({CURE})", name, gauges)]
        return (Output(self.name, self.unit, BodyCoordinates(body.name, gauge.row), self.gain),)


@dataclass(frozen=True)
class StressAt(Sensor):
    """The stress at a point of a flexible body, along the axes of the body's own frame.

    In a piezo stack the voltage itself stresses the material. The output includes this stress, whether the voltage is
    that of an amplifier (`VoltageDrive`), of an open circuit or of a resistance (`VoltageSensor`).

    Attributes:
        name: name of the scene's output [Pa], or of its six outputs "name.sxx", ... without a component.
        point: "body.point", a `StressPoint` of the body's reduction.
        component: one of "sxx", "syy", "szz", "sxy", "syz", "sxz"; "" for all six.
        unit: unit of the output, "Pa".
    """

    name: str
    point: Path
    component: str = ""
    unit: str = field(default="Pa", init=False)

    def __post_init__(self) -> None:
        if self.component:
            known(f"component of stress sensor {self.name!r}", self.component, COMPONENTS)

    def terms(self, scene: Scene) -> tuple[Term, ...]:
        """Return an output for each component, and what voltages add to it."""
        body, name = _flexible(scene, self.name, self.point)
        fields = {part.name: part for part in of_kind(body.reduced.readouts, StressField) if len(part.positions) == 1}
        stress = fields[known(f"stress point of body {body.name!r} ({CURE})", name, fields)]
        components = (self.component,) if self.component else COMPONENTS
        result: list[Term] = []
        for component in components:
            k, output = COMPONENTS.index(component), self.name if self.component else f"{self.name}.{component}"
            row = stress.rows[0, k].copy()
            for port, per_volt in stress.voltages.items():
                if gain := per_volt[0, k]:
                    by_coordinates, others = _voltage(scene, self, body, port, output, gain)
                    row += by_coordinates
                    result += others
            result.append(Output(output, self.unit, BodyCoordinates(body.name, row)))
        return tuple(result)


def _voltage(
    scene: Scene, sensor: StressAt, body: FlexibleBody, port: str, output: str, gain: float
) -> tuple[Array, list[Term]]:
    """Return what a port's voltage times a gain adds to an output.

    Returns:
        The share that follows the coordinates, per unit of them, (n,), and terms for the others: the output of an
        amplifier, the charge of a resistance. A port that no part uses has 0 V.

    Raises:
        ValueError: for a part that sets the voltage by another law.
    """
    row: Array = np.zeros(body.reduced.port(port).n_coordinates)
    terms: list[Term] = []
    users = [part for part in scene.parts if f"{body.name}.{port}" in part.claims]  # at most one
    for term in (term for user in users for term in user.terms(scene)):
        if isinstance(term, AppliedForce):
            terms.append(Feedthrough(output, term.input, gain * term.gain, term.bandwidth))
        elif isinstance(term, Shunt):
            terms.append(CircuitState(output, term.output, gain))
        elif isinstance(term, Spring):
            row -= gain * term.matrices[0][0, 0] * body.reduced.port(port).forces
        elif not isinstance(term, (Output, OutputFilter)):
            raise ValueError(
                f"stress sensor {sensor.name!r}: {sensor.point!r} lies in a stack, whose voltage stresses it, and how "
                f"the {type(term).__name__} of part {users[0].name!r} sets this voltage is unknown: take a point "
                "outside the stack, or `peak_stress` with the voltages"
            )
    return row, terms


def _flexible(scene: Scene, sensor: str, path: str) -> tuple[FlexibleBody, str]:
    """Return the flexible body of a path "body.place", and the name of the place."""
    body, place = scene.split(path)
    if not isinstance(body, FlexibleBody):
        raise ValueError(f"sensor {sensor!r}: body {body.name!r} is rigid, so it has no stress")
    return body, place
