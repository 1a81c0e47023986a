"""Sensors of force, velocity and acceleration, with their own dynamics.

A direction is "x", "y", "z" or a vector along the world's axes. With `frame` "body.point" it is along axes that are the
world's at the start and rotate with the body at that point. Velocity and acceleration are those of the point itself;
the rotation of the axes adds nothing to them.
"""

from dataclasses import dataclass

import numpy as np

from nassim.base.checks import finite, freeze, known, not_negative, positive
from nassim.scene.axes_and_points import at_point, axis_text, check_any_moves, checked_axis
from nassim.scene.field_kinds import Direction, Path, Signal
from nassim.scene.measures import PointVelocity
from nassim.scene.part import Sensor
from nassim.scene.scene import Scene
from nassim.scene.terms import ForceLaw, Output, OutputFilter, SpringForce, Term


@dataclass(frozen=True)
class ForceSensor(Sensor):
    """A sensor of the force in a spring-damper or a bushing: stiffness by displacement plus damping by velocity of b.

    Attributes:
        name: name of the scene's output [N], positive where the spring pulls. A bushing has six outputs, "name.fx" ...
            [N] and "name.mx" ... [N m]: the force and moment with which b pulls at its place, along the bushing's axes.
        of: name of the spring.
    """

    name: str
    of: Signal

    def terms(self, scene: Scene) -> tuple[SpringForce, ...]:
        """Return the spring's force as one output for each component."""
        named = {part.name: part for part in scene.springs}
        part = named[known(f"spring of force sensor {self.name!r}", self.of, named)]
        springs = [term for term in part.terms(scene) if isinstance(term, ForceLaw)]
        if len(springs) != 1:
            raise ValueError(
                f"force sensor {self.name!r}: {self.of!r} consists of {len(springs)} springs, so it has no one force "
                "to read; name a spring-damper or a bushing"
            )
        components = springs[0].measure.components
        if len(components) == 1:
            return (SpringForce(self.name, "N", springs[0]),)
        names = ("fx", "fy", "fz", "mx", "my", "mz")
        return tuple(
            SpringForce(f"{self.name}.{force}", "N m" if component.startswith("r") else "N", springs[0], component)
            for force, component in zip(names, components, strict=True)
        )

    def describe(self) -> str:
        """Name the spring."""
        return f"force sensor {self.name} [N]: the pull of {self.of}"


@dataclass(frozen=True)
class Vibrometer(Sensor):
    """A laser vibrometer: the velocity of a point along a direction, against the ground.

    Attributes:
        name: name of the scene's output [m/s].
        point: "body.point".
        axis: a direction.
        frame: "" for the world's axes, or a point whose axes count.
    """

    name: str
    point: Path
    axis: Direction = "z"
    frame: Path = ""
    unit = "m/s"

    def __post_init__(self) -> None:
        freeze(self, axis=checked_axis(f"vibrometer {self.name!r}", self.axis))

    def terms(self, scene: Scene) -> tuple[Output]:
        """Return the velocity of the point as an output."""
        return (Output(self.name, self.unit, _velocity(scene, self), derivative=1),)

    def describe(self) -> str:
        """Name the point and the axis."""
        return f"vibrometer {self.name} [m/s]: {self.point} along {axis_text(self.axis, self.frame)}"


@dataclass(frozen=True)
class Geophone(Sensor):
    """A geophone: the high-passed velocity of a point against inertial space.

    A magnet and a coil, one of which hangs on a spring, measure the velocity. The output is
    sensitivity s^2 / (s^2 + 2 damping_ratio w s + w^2) times the velocity, with w = 2 pi corner_frequency.
    The instrument responds to acceleration: along an axis that rotates, a steady velocity gives no output.

    Attributes:
        name: name of the scene's output [V].
        point: "body.point".
        axis: a direction.
        frame: "" for the world's axes, or a point whose axes count.
        corner_frequency: corner frequency [Hz].
        damping_ratio: damping ratio of the coil's motion, its shunt included [-].
        sensitivity: sensitivity [V s/m]; None: the output is in m/s.
    """

    name: str
    point: Path
    axis: Direction = "z"
    frame: Path = ""
    corner_frequency: float = 4.5
    damping_ratio: float = 0.7
    sensitivity: float | None = None

    def __post_init__(self) -> None:
        label = f"geophone {self.name!r}"
        freeze(
            self,
            axis=checked_axis(label, self.axis),
            corner_frequency=positive(f"{label}: corner_frequency", self.corner_frequency, "Hz"),
            damping_ratio=positive(f"{label}: damping_ratio", self.damping_ratio),
            sensitivity=_sensitivity(label, self.sensitivity),
        )

    @property
    def unit(self) -> str:
        """Unit of the output."""
        return "m/s" if self.sensitivity is None else "V"

    def terms(self, scene: Scene) -> tuple[Term, ...]:
        """Return the acceleration of the point through a band-pass, which is the velocity above the corner."""
        gain = (1.0 if self.sensitivity is None else self.sensitivity) / (2 * np.pi * self.corner_frequency)
        return (
            Output(self.name, self.unit, _velocity(scene, self), gain, derivative=2, inertial=True),
            OutputFilter(self.name, "band", self.corner_frequency, self.damping_ratio),
        )

    def describe(self) -> str:
        """Describe the point, the axis and the dynamics."""
        along = axis_text(self.axis, self.frame)
        return f"geophone {self.name} [{self.unit}]: {self.point} along {along} above {self.corner_frequency:g} Hz"


@dataclass(frozen=True)
class Accelerometer(Sensor):
    """An accelerometer: acceleration of a point against inertial space, without gravity, up to the mounted resonance.

    Attributes:
        name: name of the scene's output [V].
        point: "body.point".
        axis: a direction.
        frame: "" for the world's axes, or a point whose axes count.
        resonance: resonance of the mounted sensor, a low-pass of second order [Hz]; None: no low-pass.
        damping_ratio: damping ratio of the resonance [-].
        corner_frequency: corner of the electronics, a high-pass of first order [Hz]; 0: no high-pass.
        sensitivity: sensitivity [V s2/m]; None: the output is in m/s2.
    """

    name: str
    point: Path
    axis: Direction = "z"
    frame: Path = ""
    resonance: float | None = None
    damping_ratio: float = 0.02
    corner_frequency: float = 0.0
    sensitivity: float | None = None

    def __post_init__(self) -> None:
        label = f"accelerometer {self.name!r}"
        freeze(
            self,
            axis=checked_axis(label, self.axis),
            resonance=None if self.resonance is None else positive(f"{label}: resonance", self.resonance, "Hz"),
            damping_ratio=positive(f"{label}: damping_ratio", self.damping_ratio),
            corner_frequency=not_negative(f"{label}: corner_frequency", self.corner_frequency, "Hz"),
            sensitivity=_sensitivity(label, self.sensitivity),
        )

    @property
    def unit(self) -> str:
        """Unit of the output."""
        return "m/s2" if self.sensitivity is None else "V"

    def terms(self, scene: Scene) -> tuple[Term, ...]:
        """Return the acceleration of the point within the band of the sensor."""
        gain = 1.0 if self.sensitivity is None else self.sensitivity
        terms: list[Term] = [Output(self.name, self.unit, _velocity(scene, self), gain, derivative=2, inertial=True)]
        if self.resonance is not None:
            terms.append(OutputFilter(self.name, "low", self.resonance, self.damping_ratio))
        if self.corner_frequency:
            terms.append(OutputFilter(self.name, "high", self.corner_frequency))
        return tuple(terms)

    def describe(self) -> str:
        """Describe the point, the axis and the dynamics."""
        above = f" above {self.corner_frequency:g} Hz" if self.corner_frequency else ""
        below = "" if self.resonance is None else f", resonance {self.resonance:g} Hz"
        along = axis_text(self.axis, self.frame)
        return f"accelerometer {self.name} [{self.unit}]: {self.point} along {along}{above}{below}"


def _velocity(scene: Scene, sensor: Vibrometer | Geophone | Accelerometer) -> PointVelocity:
    """Return the measure of the velocity of a sensor's point along its axis."""
    check_any_moves(scene, sensor.name, sensor.point)
    return at_point(scene, sensor.point, sensor.axis, sensor.frame)


def _sensitivity(label: str, value: float | None) -> float | None:
    """Return a checked sensitivity; None stays None."""
    if value == 0:
        raise ValueError(f"{label}: a sensitivity of 0 shows nothing; leave it out for figures in SI")
    return None if value is None else finite(f"{label}: sensitivity", value)
