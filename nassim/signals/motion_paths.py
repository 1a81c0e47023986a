"""Paths of motion stages: set points that respect what a drive can do, and signals along axes that turn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nassim.base.checks import Array, above_zero, axis_pairs, finite, finite_array, freeze, known, positive
from nassim.base.field_types import ArrayLike
from nassim.base.short_repr import short_repr
from nassim.signals.time_history import TimeHistory

RISE = 2.1875, 7.5132
"""Largest first and second derivative of `smooth_step` over a unit of time."""
HALF_STEP = 0.068359375
"""Integral of the first half of `smooth_step` over a unit of time."""
ROUNDING = 1e-3
"""Share by which a path may exceed a limit."""


@dataclass(frozen=True)
class DriveLimits:
    """Limits of a drive's travel, speed and acceleration, in the unit of its path.

    Attributes:
        travel: largest distance from the start.
        speed: largest speed [unit/s].
        acceleration: largest acceleration [unit/s2].
    """

    travel: float
    speed: float
    acceleration: float
    __repr__ = short_repr

    def __post_init__(self) -> None:
        names = ("travel", "speed", "acceleration")
        freeze(self, **{name: above_zero(f"{name} of a drive", getattr(self, name)) for name in names})


def smooth_step(time: ArrayLike, start: float, duration: float) -> Array:
    """Return a step from 0 to 1 with three derivatives that vanish at both ends.

    Args:
        time: times, (n,) [s].
        start: start of the step [s].
        duration: its duration [s].
    """
    x = np.clip((np.asarray(time, dtype=float) - start) / positive("duration", duration, "s"), 0.0, 1.0)
    return x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3)


def back_and_forth(time: ArrayLike, *, amplitude: float, speed: float, acceleration: float) -> Array:
    """Return a path that begins at time 0 and goes back and forth between two ends, at constant speed between turns.

    Args:
        time: times, (n,), in any steps [s].
        amplitude: distance of the ends from 0.
        speed: speed between the ends [unit/s].
        acceleration: largest acceleration [unit/s2].

    Raises:
        ValueError: where the turns at both ends would overlap.
    """
    times = finite_array("time", time, (None,))
    size, fast = positive("amplitude", amplitude), positive("speed", speed)
    turn = 2 * RISE[0] * fast / positive("acceleration", acceleration)
    half = 2 * size / fast + 4 * HALF_STEP * turn
    first = size / fast + turn / 4 + 2 * HALF_STEP * turn
    if first < turn:  # the later turns lie farther apart
        raise ValueError(
            f"a path of amplitude {size:g} at speed {fast:g} turns within {turn:.3g} s by an acceleration of "
            f"{acceleration:g}, which leaves no line at constant speed: go farther, slower, or accelerate more"
        )
    way = _smooth_ramp(times, 0.0, turn / 2)
    for k in range(int(np.ceil((times.max() - first) / half)) + 1):
        way -= (-1) ** k * 2 * _smooth_ramp(times, first + k * half - turn / 2, turn)
    return fast * way


def _smooth_ramp(time: Array, start: float, duration: float) -> Array:
    """Return the integral of `smooth_step` from the start on, (n,) [s]."""
    x = np.maximum((time - start) / duration, 0.0)
    y = np.minimum(x, 1.0)
    return duration * (y**5 * (7 - 14 * y + 10 * y**2 - 2.5 * y**3) + x - y)


def shortest_step(distance: float, limits: DriveLimits) -> float:
    """Return the shortest duration [s] of a `smooth_step` over a distance that a drive can follow.

    Raises:
        ValueError: for a distance beyond twice the travel, which lies between its two ends.
    """
    size = abs(finite("distance", distance))
    if size > 2 * limits.travel * (1 + ROUNDING):
        raise ValueError(
            f"the drive travels {limits.travel:g} to either side, got a distance of {distance:g}; go less far"
        )
    return max(RISE[0] * size / limits.speed, float(np.sqrt(RISE[1] * size / limits.acceleration)))


def check_path(path: TimeHistory, limits: Mapping[str, DriveLimits]) -> None:
    """Check that drives can follow their paths.

    Args:
        path: record of the paths.
        limits: limits of drives, by the name of their signal.

    Raises:
        ValueError: for unknown names, and for a path that is longer, faster or steeper than its drive, by name.
    """
    for name, drive in limits.items():
        values = path[known("path", name, path.names)]
        unit = path.units[path.names.index(name)] or "units"
        speed = np.gradient(values, path.elapsed)
        found = {
            "travel": (values - values[0], unit),
            "speed": (speed, f"{unit}/s"),
            "acceleration": (np.gradient(speed, path.elapsed), f"{unit}/s2"),
        }
        for what, (course, of) in found.items():
            most, allowed = float(np.abs(course).max()), float(getattr(drive, what))
            if most > allowed * (1 + ROUNDING):
                raise ValueError(
                    f"path {name!r}: its {what} reaches {most:.3g} {of}, but its limit is {allowed:.3g} {of}; take a "
                    "shorter or a slower path"
                )


def turned(record: TimeHistory, pairs: Sequence[tuple[str, str]], angle: ArrayLike) -> TimeHistory:
    """Return a record whose pairs of signals along x and y are turned about z by an angle.

    With the angle of a rotor, it converts signals along the rotor's axes to those along fixed axes; with its negative,
    the other way.

    Args:
        record: the record.
        pairs: names of signals along x and along y.
        angle: angle at each sample, (n_samples,) [rad].

    Raises:
        ValueError: for unknown names, a name in two pairs, and another number of angles.
    """
    angle = finite_array("angle", angle, (len(record.time),))
    values, c, s = record.values.copy(), np.cos(angle), np.sin(angle)
    for pair in axis_pairs("signal", pairs, record.names):
        i, j = map(record.names.index, pair)
        x, y = record.values[[i, j]]
        values[i], values[j] = c * x - s * y, s * x + c * y
    return replace(record, values=values)
