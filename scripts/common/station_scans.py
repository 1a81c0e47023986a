"""Scans of the end-station: set points of its drives and of the sample, and the spindle's runout along them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from models.nass import DRIVES, METROLOGY_RANGE
from nassim import TimeHistory
from nassim.signals import back_and_forth, check_path, shortest_step, smooth_step

HARMONICS = (2, 3, 5)
"""Orders of the synchronous runout; order 1 along the rotor's axes is a constant displacement across the axis."""
DIRECTIONS = {"runout_x": 0.0, "runout_y": 2.1, "runout_z": 4.4}
"""Inputs of the synchronous runout, with their phases [rad]."""
SPINDLE, TILT = "spindle_angle", "tilt_angle"
TURNING_ACCELERATION = {"translation_y": 0.01, TILT: 0.05}
"""Acceleration with which a scan back and forth turns [m/s2], [rad/s2]: that of its drive would shake the sample."""


@dataclass(frozen=True)
class Scan:
    """An experiment: what moves along, and when the sample is measured.

    Attributes:
        name: name of the experiment in the summary
        time: times of the samples, (n,) [s]
        angle: angle of the spindle, (n,) [rad]
        measured: whether the sample is measured, (n,)
        rpm: constant speed of the spindle, 0 if it has none [1/min]
        drives: set points of drives, by input, (n,) each
        targets: set points of the sample, by direction, (n,) each
    """

    name: str
    time: np.ndarray
    angle: np.ndarray
    measured: np.ndarray
    rpm: float = 0.0
    drives: Mapping[str, np.ndarray] = field(default_factory=dict)
    targets: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        paths = {**self.drives, **{f"target.{six}": path for six, path in self.targets.items()}}
        units = ["rad" if name in (SPINDLE, TILT) or ".r" in name else "m" for name in paths]
        if paths:
            limits = {name: DRIVES.get(name, METROLOGY_RANGE) for name in paths if ".r" not in name}
            check_path(TimeHistory(self.time, list(paths.values()), list(paths), units), limits)

    @property
    def follows(self) -> str:
        """Name of the input that a joint follows, or ""."""
        return next((name for name in (SPINDLE, TILT) if name in self.drives), "")


def tomography(time: np.ndarray, rpm: float, settling: float) -> Scan:
    """Return a tomography: the spindle turns at constant speed."""
    return Scan(f"tomography_{rpm:g}_rpm", time, 2 * np.pi * rpm / 60 * time, time >= settling, rpm)


def translation_scan(time: np.ndarray, amplitude: float, speed: float, settling: float) -> Scan:
    """Return a scan of the sample through the beam: the translation goes back and forth between two ends [m]."""
    return _lines("translation_scan", time, amplitude, speed, settling, drive="translation_y", target="uy")


def tilt_scan(time: np.ndarray, amplitude: float, speed: float, settling: float) -> Scan:
    """Return a scan in which the sample tilts about the point of interest, back and forth between two ends [rad]."""
    return _lines("tilt_scan", time, amplitude, speed, settling, drive=TILT, target="ry")


def _lines(
    name: str, time: np.ndarray, amplitude: float, speed: float, settling: float, *, drive: str, target: str
) -> Scan:
    """Return a scan back and forth; the sample is measured on the lines of constant speed [unit/s]."""
    path, rest = np.zeros((2, len(time)))
    later = time >= settling
    acceleration = TURNING_ACCELERATION[drive]
    path[later] = back_and_forth(time[later] - settling, amplitude=amplitude, speed=speed, acceleration=acceleration)
    lines = later & (np.abs(np.gradient(path, time)) > speed * (1 - 1e-6))
    return Scan(name, time, rest, lines, drives={drive: path}, targets={target: path})


def step_and_turn_scan(time: np.ndarray, step: float, stand: float, turn: float | None, settling: float) -> Scan:
    """Return a scan in which the spindle turns by steps and stands between them, measured while it stands.

    Args:
        time: times of the samples, (n,) [s]
        step: angle of a step [rad]
        stand: time between two steps [s]
        turn: duration of a step [s]; None: as short as the drive allows
        settling: time before the first step [s]
    """
    turn = turn or shortest_step(step, DRIVES[SPINDLE])
    starts = np.arange(settling, time[-1] - (turn + stand) * (1 - 1e-9), turn + stand)
    if not len(starts):
        raise ValueError(
            f"a step of {turn:.3g} s and a stand of {stand:g} s do not fit into {time[-1] - settling:g} s: run longer, "
            "or stand for less"
        )
    angle = step * np.sum([smooth_step(time, start, turn) for start in starts], axis=0)
    turning = np.any([(time >= start) & (time < start + turn) for start in starts], axis=0)
    return Scan("step_and_turn_scan", time, angle, (time >= settling) & ~turning, drives={SPINDLE: angle})


def runout_amplitudes(amplitude: float) -> dict[tuple[str, int], complex]:
    """Return complex amplitudes of the synchronous runout by input and order; directions differ in phase."""
    return {
        (name, order): 2 * amplitude / order * np.exp(1j * (phase + order))
        for name, phase in DIRECTIONS.items()
        for order in HARMONICS
    }


def synchronous_runout(angle: np.ndarray, amplitude: float) -> dict[str, np.ndarray]:
    """Return the synchronous runout [m] at angles of the spindle, (n,) [rad], by input."""
    result = {name: np.zeros(len(angle)) for name in DIRECTIONS}
    for (name, order), size in runout_amplitudes(amplitude).items():
        result[name] += (size * np.exp(1j * order * angle)).real
    return result
