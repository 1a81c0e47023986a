"""Voice coils of scenes: coils in magnetic fields that a voltage drives, and sensors of their currents."""

from dataclasses import dataclass

import numpy as np

from nassim.base.checks import finite, freeze, known, positive
from nassim.scene.axes_and_points import axis_text, between, check_apart, check_two_points, checked_axis
from nassim.scene.field_kinds import Direction, Path, Signal
from nassim.scene.part import Actuator, Sensor
from nassim.scene.scene import Scene
from nassim.scene.terms import CircuitState, CoilForce, Output


@dataclass(frozen=True)
class VoiceCoil(Actuator):
    """A voice coil that a voltage drives: it pushes two points apart along a direction or along their line.

    Its force is force_constant i on b, and the opposite on a. Its current i obeys
    inductance i' + resistance i = voltage - force_constant v, with v the velocity of b against a along the direction;
    force_constant v is the back-EMF. It has no mass: coil and magnet belong to the bodies. With a current amplifier,
    resistance and back-EMF do not matter: then take a `LinearActuator` or a pair of `PointForce`.

    Let both points lie in one place, or apart along the axis only; a rigid body can be the bracket that holds one of
    them there. Forces on points that lie apart across the axis are not on one line: they add a moment that no real coil
    makes.

    In large motion a coil is a general item of Exudyn, which takes some 0.3 ms a step. Small motion has no such cost.

    A coil at 0 V damps like a damper of force_constant^2 / resistance, below its electrical pole at
    resistance / (2 pi inductance) [Hz]. Modes of a scene, and their damping ratios, are those without current.

    Attributes:
        name: name of the coil.
        a: first point, "body.point", such as that of the magnet.
        b: second point, "body.point", such as that of the winding.
        axis: a direction or "line".
        force_constant: force per current [N/A], which is also the back-EMF per velocity [V s/m].
        resistance: resistance of the winding [Ohm].
        inductance: inductance of the winding [H].
        input: name of the scene's input, the voltage [V].
        frame: "" for the world's axes, or a point whose axes count, usually a or b, see `SpringDamper`.
        unit: unit of the input, "V".
    """

    name: str
    a: Path
    b: Path
    axis: Direction
    force_constant: float
    resistance: float
    inductance: float
    input: Signal
    frame: Path = ""
    unit = "V"

    def __post_init__(self) -> None:
        label = f"voice coil {self.name!r}"
        check_two_points(label, self.a, self.b)
        if not self.force_constant:
            raise ValueError(f"{label}: a force_constant of 0 N/A makes no force; leave the coil out")
        if not self.resistance:
            raise ValueError(
                f"{label} has no resistance, so its current would grow without end: give that of the winding, or take "
                "a LinearActuator for a coil with a current amplifier"
            )
        freeze(
            self,
            force_constant=finite(f"{label}: force_constant", self.force_constant),
            resistance=positive(f"{label}: resistance", self.resistance, "Ohm"),
            inductance=positive(f"{label}: inductance", self.inductance, "H"),
            axis=checked_axis(label, self.axis, line=True),
        )

    def terms(self, scene: Scene) -> tuple[CoilForce]:
        """Return the force of the coil on the motion of b against a."""
        check_apart(scene, f"voice coil {self.name!r}", self.a, self.b)
        measure = between(scene, self.a, self.b, self.axis, self.frame)
        return (CoilForce(self.name, self.input, measure, self.force_constant, self.resistance, self.inductance),)

    def describe(self) -> str:
        """Describe the points, the axis and the electrical pole."""
        pole = self.resistance / (2 * np.pi * self.inductance)
        return (
            f"voice coil {self.name}: {self.a} to {self.b} along {axis_text(self.axis, self.frame)}, "
            f"{self.force_constant:g} N/A, {self.resistance:g} Ohm, electrical pole at {pole:.4g} Hz"
        )


@dataclass(frozen=True)
class CurrentSensor(Sensor):
    """A sensor of the current of a voice coil.

    Attributes:
        name: name of the scene's output [A].
        of: name of the voice coil.
        unit: unit of the output, "A".
    """

    name: str
    of: Signal
    unit = "A"

    def terms(self, scene: Scene) -> tuple[Output, CircuitState]:
        """Return the output: the flux linkage less that by the motion, over the inductance."""
        coils = {
            part.name: term for part in scene.actuators for term in part.terms(scene) if isinstance(term, CoilForce)
        }
        coil = coils[known(f"coil of current sensor {self.name!r}", self.of, coils)]
        by_motion = Output(self.name, self.unit, coil.measure, -coil.force_constant / coil.inductance)
        return by_motion, CircuitState(self.name, coil.name)

    def describe(self) -> str:
        """Name the coil."""
        return f"current sensor {self.name} [A]: of {self.of}"
