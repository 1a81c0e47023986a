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
from nassim.scene.terms import AppliedForce, Output, Shunt, Spring

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

    def describe(self) -> str:
        """Name the gauge."""
        return f"strain gauge {self.name} [{self.unit}]: {self.gauge}"


@dataclass(frozen=True)
class StressAt(Sensor):
    """The stress at a point of a flexible body, along the axes of the body's own frame.

    In a piezo stack it includes the stress of the voltage of a port in open circuit; a port that is driven, or has a
    resistance, is refused there.

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

    def terms(self, scene: Scene) -> tuple[Output, ...]:
        """Return an output for each component."""
        body, name = _flexible(scene, self.name, self.point)
        fields = {part.name: part for part in of_kind(body.reduced.readouts, StressField) if len(part.positions) == 1}
        stress = fields[known(f"stress point of body {body.name!r} ({CURE})", name, fields)]
        rows = stress.rows[0].copy()
        for port, per_volt in stress.voltages.items():
            rows += np.outer(per_volt[0], _voltage_row(scene, self, body, port))
        named = dict(zip(COMPONENTS, rows, strict=True))
        if self.component:
            return (Output(self.name, self.unit, BodyCoordinates(body.name, named[self.component])),)
        return tuple(
            Output(f"{self.name}.{component}", self.unit, BodyCoordinates(body.name, row))
            for component, row in named.items()
        )

    def describe(self) -> str:
        """Name the point and the component."""
        which = f"{self.component} " if self.component else ""
        return f"stress sensor {self.name} [Pa]: {which}at {self.point}, along the axes of the body"


def _voltage_row(scene: Scene, sensor: StressAt, body: FlexibleBody, port: str) -> Array:
    """Return the voltage of a port per unit of the coordinates, (n,): zero, or that of an open circuit.

    Raises:
        ValueError: for a port whose voltage does not follow from the coordinates.
    """
    for part in scene.parts:
        if f"{body.name}.{port}" not in part.claims:
            continue
        terms = part.terms(scene)
        springs = [term for term in terms if isinstance(term, Spring)]
        if len(springs) == 1 and not any(isinstance(term, (AppliedForce, Shunt)) for term in terms):
            stiffness = springs[0].matrices[0]
            result: Array = -stiffness[0, 0] * body.reduced.port(port).forces
            return result
        raise ValueError(
            f"stress sensor {sensor.name!r}: {sensor.point!r} lies in a stack, and part {part.name!r} drives its port "
            f"{port!r} or discharges it: that voltage stresses the stack directly, which the coordinates do not tell. "
            "Take a point outside the stack, or `peak_stress` with the voltages"
        )
    return np.zeros(body.reduced.port(port).n_coordinates)


def _flexible(scene: Scene, sensor: str, path: str) -> tuple[FlexibleBody, str]:
    """Return the flexible body of a path "body.place", and the name of the place."""
    body, place = scene.split(path)
    if not isinstance(body, FlexibleBody):
        raise ValueError(f"sensor {sensor!r}: body {body.name!r} is rigid, so it has no stress")
    return body, place
