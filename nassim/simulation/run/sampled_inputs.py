"""An excitation at the time steps of a simulation: in the scene's units, with nothing of it lost between the steps."""

from dataclasses import replace

import numpy as np

from nassim.base.checks import Array, positive
from nassim.base.units import to_si
from nassim.scene.scene import Scene
from nassim.signals.time_history import TimeHistory, occupied_bandwidth

STEPS_PER_PERIOD = 8
"""Fewest time steps in the shortest period that an excitation holds."""
LOST_POWER = 0.02
"""Share of a signal's power that straight lines between the time steps may lose; a sine of 8 steps loses 0.003."""


def sample_excitation(
    scene: Scene,
    excitation: TimeHistory | None,
    *,
    time_step: float,
    duration: float | None,
    held: bool = False,
) -> TimeHistory:
    """Sample an excitation at the time steps of a run, in the units of the scene's inputs.

    Args:
        scene: the scene whose inputs it drives.
        excitation: its first sample becomes time 0; None for inputs that stay 0.
        time_step: [s].
        duration: a whole number of steps [s]; None: all that the excitation has room for. Without an excitation it must
            be given.
        held: whether inputs keep the value of each step until the next. Steps at all samples then lose nothing.

    Returns:
        The excitation at 0, time_step, ...

    Raises:
        TypeError: for an excitation that is neither a TimeHistory nor None.
        ValueError: for inputs that the scene does not know, for inputs that the excitation lacks and no loop drives,
            for other units, for a duration that does not fit, and for steps that are too long for the excitation.
    """
    looped = set(scene.commanded_inputs)
    if excitation is None:
        if duration is None:
            raise ValueError("a run without an excitation needs a duration [s]: give duration=...")
        names = tuple(name for name in scene.inputs if name not in looped)
        end = positive("duration", duration, "s")
        excitation = TimeHistory([0.0, end], np.zeros((len(names), 2)), names)
    if not isinstance(excitation, TimeHistory):
        raise TypeError(
            f"the excitation must be a TimeHistory of the inputs ({', '.join(scene.inputs) or 'none'}), or None for "
            f"inputs that stay 0; got {type(excitation).__name__}"
        )
    missing = set(scene.inputs) - set(excitation.names) - looped
    if missing:
        raise ValueError(
            f"the excitation lacks the input(s) {', '.join(sorted(missing))}; it has {excitation.names}: give each of "
            "them a signal; excitation.with_zeros(scene.inputs) adds zeros where nothing acts"
        )
    return sampled_signals(scene, excitation, time_step=time_step, duration=duration, held=held)


def sampled_signals(
    scene: Scene, excitation: TimeHistory, *, time_step: float, duration: float | None = None, held: bool = False
) -> TimeHistory:
    """Sample signals of some inputs; arguments, result and errors as of `sample_excitation`."""
    for name in excitation.names:
        if name not in scene.inputs:
            raise ValueError(
                f"unknown input {name!r}; known: {', '.join(scene.inputs) or 'none'}; signals take "
                "the name of their input, such as step(..., name=...)"
            )
    excitation = _in_units(scene, excitation)
    steps = np.arange(_n_steps(excitation, time_step, duration) + 1) * time_step
    acting = without_noise(scene, excitation)
    samples, rounding = (len(excitation.time) - 1) * time_step, float(np.spacing(np.abs(excitation.time).max()))
    if not (held and np.isclose(samples, excitation.duration, rtol=1e-9, atol=rounding)):
        _check_bandwidth(acting, time_step)
    _check_loss(acting, time_step, float(steps[-1]))
    elapsed = excitation.elapsed * max(1.0, steps[-1] / excitation.duration)  # rounding ends no record before its steps
    rows = [np.interp(steps, elapsed, row) for row in excitation.values]
    values = np.reshape(rows, (len(excitation.names), len(steps)))
    return replace(excitation, time=steps, values=values)


def without_noise(scene: Scene, excitation: TimeHistory) -> TimeHistory:
    """Return an excitation without what loops read as noise: at their samples alone, so that none of it can be lost."""
    noise = {name for loop in scene.loops for name in loop.noise}
    return excitation.select([name for name in excitation.names if name not in noise])


def _in_units(scene: Scene, excitation: TimeHistory) -> TimeHistory:
    values, units = excitation.values.copy(), [scene.input_unit(name) for name in excitation.names]
    for k, (name, given) in enumerate(zip(excitation.names, excitation.units, strict=True)):
        if given in ("", units[k]):
            continue
        try:
            factor, unit = to_si(given)
        except ValueError as error:
            raise ValueError(f"input {name!r} is in {units[k]}, the excitation in {given!r}: {error}") from error
        if unit != units[k]:
            raise ValueError(
                f"input {name!r} is in {units[k]}, the excitation in {given!r}; convert it, or name no unit"
            )
        values[k] *= factor
    return replace(excitation, values=values, units=tuple(units))


def _n_steps(excitation: TimeHistory, time_step: float, duration: float | None) -> int:
    step = positive("time_step", time_step, "s")
    # Times far from zero are rounded, seconds since 1970 to 2e-7 s.
    longest = excitation.duration * (1 + 1e-9) + float(np.spacing(np.abs(excitation.time).max()))
    length = longest if duration is None else positive("duration", duration, "s")
    if length > longest:
        raise ValueError(f"duration {length:g} s is longer than the excitation ({excitation.duration:g} s)")
    n_steps = int(np.floor(length / step * (1 + 1e-9)))
    if n_steps < 1:
        raise ValueError(f"time_step {step:g} s is longer than the duration {length:g} s")
    if duration is not None and abs(length / step - n_steps) > 1e-6 * n_steps:
        raise ValueError(
            f"duration {length:g} s is {length / step:.6g} time steps of {step:g} s; take {n_steps * step:.9g} s or "
            f"another whole number of steps"
        )
    return n_steps


def _check_bandwidth(excitation: TimeHistory, time_step: float) -> None:
    highest = occupied_bandwidth(excitation)
    if highest * time_step * STEPS_PER_PERIOD > 1.0:
        raise ValueError(
            f"time_step {time_step:g} s is too long: the excitation holds frequencies up to {highest:.4g} Hz; take at "
            f"most {1 / (STEPS_PER_PERIOD * highest):.3g} s ({STEPS_PER_PERIOD} steps per period) or filter it"
        )


def _check_loss(excitation: TimeHistory, time_step: float, end: float) -> None:
    """Refuse steps between which a pulse is lost: straight lines through the steps must follow the samples."""
    time = excitation.elapsed
    until = time <= end * (1 + 1e-9)
    shares = _lost_power(time[until], excitation.values[:, until], time_step)
    worst = int(np.argmax(shares)) if len(shares) else 0
    if not len(shares) or shares[worst] <= LOST_POWER:
        return
    good = _longest_step(time[until], excitation.values[:, until], time_step)
    raise ValueError(
        f"time_step {time_step:g} s is too long: straight lines between the steps lose {100 * shares[worst]:.3g} % "
        f"of the power of {excitation.names[worst]!r}, as of a pulse that falls between two; take at most {good:.4g} s "
        "or filter it"
    )


def _lost_power(time: Array, values: Array, time_step: float) -> Array:
    """Return the share of each signal's power, without its mean, that linear interpolation between time steps loses."""
    steps = np.append(np.arange(0.0, time[-1], time_step), time[-1])
    lost = np.array([np.sum((row - np.interp(time, steps, np.interp(steps, time, row))) ** 2) for row in values])
    power = np.sum((values - values.mean(axis=1, keepdims=True)) ** 2, axis=1)
    return np.divide(lost, power, out=np.zeros(len(values)), where=lost > 1e-20 * power)


def _longest_step(time: Array, values: Array, time_step: float) -> float:
    """Return the longest step with an allowed loss: a whole multiple of the sample time, or a whole fraction of it."""
    sample = float(time[1] - time[0])
    if time_step <= sample:
        return sample / np.ceil(sample / time_step)
    good, bad = 1, int(np.ceil(time_step / sample))
    while bad - good > 1:
        middle = (good + bad) // 2
        if np.all(_lost_power(time, values, middle * sample) <= LOST_POWER):
            good = middle
        else:
            bad = middle
    return good * sample
