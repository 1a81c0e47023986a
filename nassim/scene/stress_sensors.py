"""Sensors of stress and strain: outputs of the places at which a reduced body keeps them."""

from dataclasses import dataclass

import numpy as np

from nassim.base.checks import finite, freeze, known
from nassim.base.warning_log import warn
from nassim.bodies.readouts import readouts_of
from nassim.bodies.stress import COMPONENTS, GaugeStrain, StressField
from nassim.scene.bodies import FlexibleBody
from nassim.scene.field_kinds import Path, point_of
from nassim.scene.measures import BodyCoordinates
from nassim.scene.part import Sensor
from nassim.scene.port_voltages import port_voltage
from nassim.scene.scene import Scene
from nassim.scene.terms import AppliedForce, Output, Term

CURE = "reduce the body by craig_bampton(..., stress=[...]) with it"
STACK_RADIUS = 0.25
"""Distance from the line between a stack's ends, over their distance, within which material counts as the stack."""


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
    unit = "1"
    factor = "gain"

    def __post_init__(self) -> None:
        freeze(self, gain=finite("gain", self.gain))

    def terms(self, scene: Scene) -> tuple[Output]:
        """Return the strain as an output."""
        body, name = _flexible(scene, self.name, self.gauge)
        gauges = {readout.name: readout for readout in readouts_of(body.reduced.readouts, GaugeStrain)}
        gauge = gauges[known(f"gauge of body {body.name!r} ({CURE})", name, gauges)]
        return (Output(self.name, self.unit, BodyCoordinates(body.name, gauge.row, of_strain=True), self.gain),)

    def describe(self) -> str:
        """Name the gauge."""
        return f"strain gauge {self.name} [{self.unit}]: {self.gauge}"


@dataclass(frozen=True)
class StressAt(Sensor):
    """The stress at a point of a flexible body, along the axes of the body's own frame.

    In a piezo stack the voltage itself stresses the material. The output includes this stress, whether the voltage is
    that of an amplifier (`VoltageDrive`), of an open circuit or of a resistance (`VoltageSensor`). A body of fidelity
    "rigid" has no other stress.

    Attributes:
        name: name of the scene's output [Pa], or of its six outputs "name.sxx", ... without a component.
        point: "body.point", a `StressPoint` of the body's reduction.
        component: one of "sxx", "syy", "szz", "sxy", "syz", "sxz"; "" for all six.
        unit: unit of the output, "Pa".
    """

    name: str
    point: Path
    component: str = ""
    unit = "Pa"

    def __post_init__(self) -> None:
        if self.component:
            known(f"component of stress sensor {self.name!r}", self.component, COMPONENTS)

    def terms(self, scene: Scene) -> tuple[Term, ...]:
        """Return an output for each component, and what voltages add to it."""
        body, name = _flexible(scene, self.name, self.point)
        every = readouts_of(body.reduced.readouts, StressField)
        fields = {field.name: field for field in every if len(field.positions) == 1}
        stress = fields[known(f"stress point of body {body.name!r} ({CURE})", name, fields)]
        voltages = {port: port_voltage(scene, body, port) for port in stress.voltages}
        result: list[Term] = []
        for component in (self.component,) if self.component else COMPONENTS:
            k, output = COMPONENTS.index(component), self.name if self.component else f"{self.name}.{component}"
            row = stress.rows[0, k].copy()
            for port, voltage in voltages.items():
                per_volt = stress.voltages[port][0, k]
                row += per_volt * voltage.row
                result += voltage.terms(output, per_volt) if per_volt else ()
            result.append(Output(output, self.unit, BodyCoordinates(body.name, row, of_strain=True)))
        return tuple(result)

    def describe(self) -> str:
        """Name the point and the component."""
        which = f"{self.component} " if self.component else ""
        return f"stress sensor {self.name} [Pa]: {which}at {self.point}, along the axes of the body"


def warn_of_pressed_stacks(scene: Scene) -> None:
    """Warn of stress sensors within stacks that pairs of forces press: the stress of the voltage itself is unknown."""
    pairs = [term.measure for term in scene.terms_of(AppliedForce) if isinstance(term.measure, BodyCoordinates)]
    for sensor in (part for part in scene.sensors if isinstance(part, StressAt)):
        body, name = _flexible(scene, sensor.name, sensor.point)
        (field_,) = (one for one in readouts_of(body.reduced.readouts, StressField) if one.name == name)
        for start, end in (pair.ends for pair in pairs if pair.body == body.name and len(pair.ends) == 2):
            ends = [body.reduced.point(point_of(path)).position for path in (start, end)]
            line, way = ends[1] - ends[0], field_.positions[0] - ends[0]
            share = float(way @ line / (line @ line))
            if 0 <= share <= 1 and np.linalg.norm(way - share * line) < STACK_RADIUS * np.linalg.norm(line):
                warn(
                    f"stress sensor {sensor.name!r} lies between {start!r} and {end!r}, which a pair of forces pushes "
                    "apart: within this stack the stress lacks the push over the cross-section; drive the stack by an "
                    "electrical port (`VoltageDrive`), whose stress is known"
                )


def _flexible(scene: Scene, sensor: str, path: str) -> tuple[FlexibleBody, str]:
    """Return the flexible body of a path "body.place", and the name of the place."""
    body, place = scene.split(path)
    if not isinstance(body, FlexibleBody):
        raise ValueError(f"sensor {sensor!r}: body {body.name!r} is rigid, so it has no stress")
    return body, place
