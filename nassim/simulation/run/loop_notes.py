"""Notes on the loops of a run: signals at the limits of their converters, and the resolution of these."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array
from nassim.base.warning_log import warn
from nassim.scene.loop import Loop
from nassim.scene.scene import Scene
from nassim.simulation.model.digital_controllers import samples_per_period
from nassim.systems.step_program import steps_within

LONG = 0.1
"""Share of a run above which a saturated loop is warned of."""
ROUNDING = 1e-9
"""Share of a limit by which a signal at the limit may lie below it."""


@dataclass(frozen=True)
class Saturation:
    """A signal of a loop at the limit of a converter.

    Attributes:
        text: loop, signal and limit.
        share: share of the run.
        duration: time at the limit [s].
        first: time of the first sample at the limit [s].
    """

    text: str
    share: float
    duration: float
    first: float

    def __str__(self) -> str:
        """Describe the signal and how long it was at the limit."""
        return (
            f"{self.text} for {self.duration:.4g} s in all, {100 * self.share:.2g} % of the run, first at "
            f"t = {self.first:.6g} s"
        )


def find_saturations(scene: Scene, time: Array, signals: Mapping[str, Array]) -> list[Saturation]:
    """Find the signals of loops that were at the limits of their converters.

    Args:
        scene: the scene.
        time: times of the samples, (n,) [s].
        signals: inputs, outputs and commands by name, (n,) each.

    Returns:
        Those that were, in the order of the loops; of each, outputs first.
    """
    step, found = float(time[1] - time[0]), []
    for loop in scene.loops:
        period = samples_per_period(loop, step)
        read = zip(loop.measured, _readings(loop, signals), strict=True)
        ranges = [(name, values, loop.input_step, loop.input_limit, period) for name, values in read]
        ranges += [(name, signals[name], loop.output_step, loop.controller.limit, 1) for name in loop.commands]
        units = [*map(scene.output_unit, loop.measured), *map(scene.input_unit, loop.driven)]
        for (name, values, resolution, limit, every), unit in zip(ranges, units, strict=True):
            most = resolution * steps_within(limit, resolution) if resolution else limit
            reached = np.abs(values[::every]) >= most * (1 - ROUNDING)
            if np.any(reached):
                share, first = float(np.mean(reached)), float(time[every * int(np.argmax(reached))])
                text = f"loop {loop.name!r}: {name!r} was at its limit of {limit:g} {unit}"
                found.append(Saturation(text, share, share * len(time) * step, first))
    return found


def _readings(loop: Loop, signals: Mapping[str, Array]) -> list[Array]:
    """Return what the converters of a loop read, (n,) each: the measured outputs and their noise."""
    outputs = [signals[name] for name in loop.measured]
    if not loop.noise:
        return outputs
    return [output + signals[name] for output, name in zip(outputs, loop.noise, strict=True)]


def loop_notes(scene: Scene, time: Array, signals: Mapping[str, Array]) -> tuple[str, ...]:
    """Describe saturation and resolution of the loops of a run; arguments as of `find_saturations`."""
    return (*map(str, find_saturations(scene, time, signals)), *_resolutions(scene, signals))


def warn_of_saturation(saturations: Sequence[Saturation]) -> None:
    """Warn of loops that were at a limit for more than `LONG` of a run."""
    for saturation in saturations:
        if saturation.share > LONG:
            warn(
                f"{saturation}: the loop was open then, and linear models of it do not hold; a smaller excitation, a "
                "smoother set point, a lower gain or a larger limit"
            )


def _resolutions(scene: Scene, signals: Mapping[str, Array]) -> Iterator[str]:
    """Yield a note on each quantised signal; signals: as of `find_saturations`."""
    for loop in scene.loops:
        read = [
            ("reads", name, values, loop.input_step, scene.output_unit(name))
            for name, values in zip(loop.measured, _readings(loop, signals), strict=True)
        ]
        driven = [
            ("gives", name, signals[name], loop.output_step, scene.input_unit(of))
            for name, of in zip(loop.commands, loop.driven, strict=True)
        ]
        for verb, name, values, step, unit in (*read, *driven):
            if step:
                span = float(np.ptp(values)) / step
                rest = "" if span > 2 else f"; it moved by {span:.2g} steps only, so its error is no noise"
                yield (
                    f"loop {loop.name!r} {verb} {name!r} in steps of {step:g} {unit}, of an expected error of "
                    f"{step / math.sqrt(12):.3g} {unit} rms{rest}"
                )
