"""Sensors of force, velocity and acceleration, with what their own dynamics let through.

A direction is "x", "y", "z" or a vector, along the world's axes; with `frame` "body.point" along axes that are the
world's at the start and turn with the body there. Velocity and acceleration are those of the point itself, whichever
way the axes turn along which they are read.
"""

from dataclasses import dataclass

import numpy as np

from nassim.base.checks import finite, freeze, known, not_negative, positive
from nassim.base.rigid_motion import DIRECTIONS, unit_vector
from nassim.scene.mechanics import check_seen, checked_axis, checked_frame
from nassim.scene.part import Direction, Filter, Path, Reading, Row, Sensor, Signal, SixSprings, Spring, Tension, Word
from nassim.scene.scene import Scene


@dataclass(frozen=True)
class ForceSensor(Sensor):
    """The force in a spring or a bushing and its damper: stiffness by displacement and damping by velocity of b.

    name: of the scene's output [N], positive where the spring pulls; of a bushing six outputs, "name.fx" ... [N] and
        "name.mx" ... [N m], what b pulls with at its place along the bushing's axes
    of: name of the spring
    """

    name: str
    of: Signal

    def says(self, scene: Scene) -> tuple[Tension, ...]:
        """It reads what the spring pulls with."""
        named = {part.name: part for part in scene.springs}
        part = named[known(f"spring of force sensor {self.name!r}", self.of, named)]
        springs = [word for word in part.says(scene) if isinstance(word, (Spring, SixSprings))]
        if len(springs) != 1:
            raise ValueError(
                f"force sensor {self.name!r}: {self.of!r} consists of {len(springs)} springs, so it has no one force "
                "to read; name a spring-damper or a bushing"
            )
        if isinstance(springs[0], Spring):
            return (Tension(self.name, "N", springs[0]),)
        names = ("fx", "fy", "fz", "mx", "my", "mz")
        return tuple(
            Tension(f"{self.name}.{force}", "N m" if direction.startswith("r") else "N", springs[0], direction)
            for force, direction in zip(names, DIRECTIONS, strict=True)
        )


@dataclass(frozen=True)
class Vibrometer(Sensor):
    """Velocity of a point along a direction, as seen from the ground: that of a laser vibrometer.

    name: of the scene's output [m/s]; point: "body.point"; axis: a direction; frame: "" or a point's
    """

    name: str
    point: Path
    axis: Direction = "z"
    frame: Path = ""
    unit = "m/s"

    def __post_init__(self) -> None:
        freeze(self, axis=checked_axis(f"vibrometer {self.name!r}", self.axis))

    def says(self, scene: Scene) -> tuple[Reading]:
        """It reads the point's velocity."""
        return (Reading(self.name, self.unit, _of_point(scene, self), derivative=1),)


@dataclass(frozen=True)
class Geophone(Sensor):
    """A coil and a magnet, one of which hangs on a spring: velocity of a point against inertial space, high-passed.

    The output is sensitivity s^2 / (s^2 + 2 damping_ratio w s + w^2) times the velocity, w = 2 pi corner_frequency.
    What moves it is acceleration: along an axis that turns, a steady velocity gives nothing.
    name: of the scene's output [V]; point: "body.point"; axis: a direction; frame: "" or a point's
    corner_frequency [Hz]; damping_ratio: of the coil's motion, its shunt included [-]
    sensitivity [V s/m]; default: the output is in m/s
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
        """Of the output."""
        return "m/s" if self.sensitivity is None else "V"

    def says(self, scene: Scene) -> tuple[Word, ...]:
        """Acceleration through a band-pass is velocity above its corner."""
        gain = (1.0 if self.sensitivity is None else self.sensitivity) / (2 * np.pi * self.corner_frequency)
        return (
            Reading(self.name, self.unit, _of_point(scene, self), gain, derivative=2, inertial=True),
            Filter(self.name, "band", self.corner_frequency, self.damping_ratio),
        )

    def describe(self) -> str:
        """Its dynamics."""
        return f"geophone {self.name}: {self.point} above {self.corner_frequency:g} Hz"


@dataclass(frozen=True)
class Accelerometer(Sensor):
    """Acceleration of a point against inertial space, without gravity, up to the sensor's mounted resonance.

    name: of the scene's output [V]; point: "body.point"; axis: a direction; frame: "" or a point's
    resonance: of the mounted sensor, a low-pass of second order [Hz]; None: it follows at once
    damping_ratio: of the resonance [-]
    corner_frequency: of its electronics, a high-pass of first order [Hz]; 0: down to standstill
    sensitivity [V s2/m]; default: the output is in m/s2
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
        """Of the output."""
        return "m/s2" if self.sensitivity is None else "V"

    def says(self, scene: Scene) -> tuple[Word, ...]:
        """It reads the point's acceleration within its band."""
        gain = 1.0 if self.sensitivity is None else self.sensitivity
        words: list[Word] = [Reading(self.name, self.unit, _of_point(scene, self), gain, derivative=2, inertial=True)]
        if self.resonance is not None:
            words.append(Filter(self.name, "low", self.resonance, self.damping_ratio))
        if self.corner_frequency:
            words.append(Filter(self.name, "high", self.corner_frequency))
        return tuple(words)

    def describe(self) -> str:
        """Its dynamics."""
        above = f" above {self.corner_frequency:g} Hz" if self.corner_frequency else ""
        below = "" if self.resonance is None else f", resonance {self.resonance:g} Hz"
        return f"accelerometer {self.name}: {self.point}{above}{below}"


def _of_point(scene: Scene, sensor: Vibrometer | Geophone | Accelerometer) -> Row:
    check_seen(scene, sensor.name, sensor.point)
    return Row.of_point(sensor.point, unit_vector(sensor.axis), frame=checked_frame(scene, sensor.frame))


def _sensitivity(label: str, value: float | None) -> float | None:
    if value == 0:
        raise ValueError(f"{label}: a sensitivity of 0 shows nothing; leave it out for figures in SI")
    return None if value is None else finite(f"{label}: sensitivity", value)
