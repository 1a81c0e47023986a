"""Digital controllers in time: conversion of measured values, control law, limits, delay and hold."""

import math
from collections import deque
from collections.abc import Callable, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from nassim.base.checks import Array
from nassim.scene.loop import Loop
from nassim.scene.scene import Scene
from nassim.simulation.model.stopped_runs import Stopped
from nassim.systems.python_controller import ControlLaw, PythonController
from nassim.systems.step_program import steps_within

WHOLE = 1.5 * 2.0**52
"""Added to a number and subtracted again, it rounds to the nearest whole number, ties to even; infinity stays."""


def samples_per_period(loop: Loop, time_step: float) -> int:
    """Count the time steps in one sample period of a loop.

    Raises:
        ValueError: if the number is not whole.
    """
    steps = 1 / (loop.controller.sample_rate * time_step)
    whole = round(steps)
    if abs(steps - whole) > 1e-6 * whole:
        raise ValueError(
            f"loop {loop.name!r} samples at {loop.controller.sample_rate:g} Hz, every {steps:.6g} time steps of "
            f"{time_step:g} s; take time_step = {1 / loop.controller.sample_rate:g} s over a whole number"
        )
    return whole


class BadCommand(Stopped):
    """The end of a run in which a controller in Python raises an error or returns no finite commands.

    Attributes:
        rows: outputs and commands of the run's piece until then, shape (n_samples, outputs + commands); empty where
            the engine has them.
        sample: number of the sample at which the controller failed.
    """

    def __init__(self, message: str) -> None:
        super().__init__(message)
        self.rows, self.sample = np.zeros((0, 0)), 0


def ask(loop: Loop, law: ControlLaw, measured: Array, time: float) -> Array:
    """Compute the commands of a loop whose controller is a Python object.

    Args:
        loop: the loop.
        law: the object, in its present state.
        measured: measured values after the converters, (measured,).
        time: time [s].

    Returns:
        The commands, (driven,).

    Raises:
        BadCommand: if the object raises an error or returns no finite commands.
    """
    subject = f"loop {loop.name!r}: its controller, a {type(law).__name__} in Python,"
    n = len(loop.driven)
    try:
        found = np.atleast_1d(np.asarray(law.output(np.array(measured), time), dtype=float))
    except Exception as error:
        raise BadCommand(f"{subject} raised {type(error).__name__} at t = {time:g} s: {error}") from error
    if found.shape != (n,):
        raise BadCommand(
            f"{subject} returned an array of shape {found.shape} at t = {time:g} s; it must return one command for "
            f"each of the inputs {', '.join(loop.driven)}, shape ({n},)"
        )
    if not np.isfinite(found).all():
        raise BadCommand(f"{subject} returned {found.tolist()} at t = {time:g} s; commands must be finite numbers")
    return found


class RunningControllers:
    """Running controllers of linear loops with equal delays, or the running controller of one loop in Python."""

    def __init__(self, *loops: Loop) -> None:
        """Start at rest."""
        controller = loops[0].controller
        self.loop, self.law, self.winds = loops[0], None, False
        n_in, n_out = sum(loop.n_channels for loop in loops), sum(len(loop.driven) for loop in loops)
        if isinstance(controller, PythonController):
            self.law, self.matrix = deepcopy(controller.law), np.zeros((0, 0))
            self.values = np.zeros(0)
        else:
            linear = [loop.law for loop in loops]
            a, b, c, d = (block_diag(*(getattr(one, name) for one in linear)) for name in "ABCD")
            self.matrix = np.block([[a, b], [c, d]])
            self.values = np.zeros(len(a) + n_in)  # states, then converted inputs
            self.limits = np.repeat([c.limit for c in linear], [len(c.D) for c in linear])
            self.corrections = block_diag(*(c.corrections for c in linear))
            self.winds = any(c.anti_windup is not None and c.limit < math.inf for c in linear)
        self.n = len(self.values) - n_in
        inputs = [channel for loop in loops for channel in input_converters(loop)]
        outputs = [channel for loop in loops for channel in output_converters(loop)]
        self.convert_inputs, self.convert_outputs = _converters(inputs), _converters(outputs)
        self.delay_line = deque(np.zeros((controller.delay, n_out)))

    def __call__(self, measured: Array, time: float = 0.0, reference: Array | None = None) -> tuple[Array, Array]:
        """Take a sample.

        Args:
            measured: values of the loops' channels before the references, (channels,).
            time: time of the sample [s].
            reference: references that are subtracted, (channels,); None for none.

        Returns:
            Commands until the next sample, and commands after it, (driven,) each. The latter are known with a delay of
            at least one sample; without a delay they are those until the next sample.
        """
        read = self.convert_inputs(measured)
        if reference is not None:
            read = read - reference
        if self.law is None:
            self.values[self.n :] = read
            after = self.matrix.dot(self.values)
            self.values[: self.n] = after[: self.n]
            computed = after[self.n :]
            if self.winds:
                excess = np.clip(computed, -self.limits, self.limits) - computed
                self.values[: self.n] += self.corrections.dot(excess)
        else:
            computed = ask(self.loop, self.law, read, time)
        self.delay_line.append(self.convert_outputs(computed))
        acting = self.delay_line.popleft()
        return acting, self.delay_line[0] if self.delay_line else acting

    @property
    def state(self) -> Any:
        """Copy of the values that change from sample to sample."""
        return deepcopy((self.values, self.delay_line, self.law))

    def restore(self, state: Any) -> None:
        """Restore a state."""
        self.values, self.delay_line, self.law = deepcopy(state)


def _converters(each: list[tuple[float, float]]) -> Callable[[Array], Array]:
    """Make a function that quantises and limits values like converters of given resolutions and ranges."""
    if not any(step or limit < math.inf for step, limit in each):
        return lambda values: values
    converters = [converter(step, limit) for step, limit in each]
    return lambda values: np.array([of(value) for of, value in zip(converters, values.tolist(), strict=True)])


def converter(step: float, limit: float) -> Callable[[float], float]:
    """Make a function that quantises and limits a value like a converter of a resolution (0: none) and range.

    It takes numbers, not arrays: for the few values of a sample, NumPy's functions would be several times slower.
    """
    if not step:
        return lambda value: min(max(value, -limit), limit)
    most = steps_within(limit, step)
    return lambda value: step * min(max(value / step + WHOLE - WHOLE, -most), most)


class RunningLoops:
    """Running loops of a scene, to be called at every time step n = 0, 1, ..."""

    def __init__(self, scene: Scene, time_step: float) -> None:
        """Start all loops of a scene at rest; time_step [s]."""
        inputs, outputs, driven = scene.inputs, scene.outputs, scene.commanded_inputs
        self.time_step = time_step
        self.command_matrix = np.zeros((len(driven), len(inputs)))
        self.command_matrix[np.arange(len(driven)), [inputs.index(name) for name in driven]] = 1.0
        periods = [samples_per_period(loop, time_step) for loop in scene.loops]
        ends = np.cumsum([0, *(len(loop.driven) for loop in scene.loops)])
        alike: dict[tuple[int, int, int], list[int]] = {}
        for k, (loop, period) in enumerate(zip(scene.loops, periods, strict=True)):
            alone = k if isinstance(loop.controller, PythonController) else -1
            alike.setdefault((period, loop.controller.delay, alone), []).append(k)
        self.groups = [
            (
                period,
                delay == 0,
                RunningControllers(*(scene.loops[k] for k in chosen)),
                np.array([place for k in chosen for place in channels(scene.loops[k], outputs)]),
                _stacked(reference_matrix, scene, [scene.loops[k] for k in chosen]),
                _stacked(noise_matrix, scene, [scene.loops[k] for k in chosen]),
                span([place for k in chosen for place in range(ends[k], ends[k + 1])]),
            )
            for (period, delay, _), chosen in alike.items()
        ]
        self.n_outputs, self.feeds_forward = len(outputs), any(loop.feedforward for loop in scene.loops)
        n = len(driven)
        self.held, self.next_commands, self.both = np.zeros(n), np.zeros(n), np.zeros((2, n))

    def __call__(self, n: int, measure: Callable[[], Array], inputs: Array) -> tuple[Array, Array, Array]:
        """Take the samples that are due at a time step.

        An implicit rule evaluates forces at both ends of a step. Where a command jumps, it takes the mean of the values
        before and after the jump. Without a delay the jump is not known in time; half of it is then added one step
        later.

        Args:
            n: number of the time step.
            measure: function that returns the scene's present outputs, (outputs,); called only where a sample is due.
            inputs: the scene's present inputs, (inputs,), of which the loops take their references and noise.

        Returns:
            What the loops add to the scene's inputs until the next step, and at the end of that step, (inputs,) each;
            and the commands in the order of `Scene.commands`, an array that the next call changes.
        """
        held, next_commands, found, end = self.held, self.next_commands, None, self.both[1]
        for period, at_once, control, measured, reference, noise, places in self.groups:
            jump = None
            if n % period == 0:
                found = self._read(measure) if found is None else found
                wanted = None if reference is None else reference.dot(inputs)
                read = found[measured] if noise is None else found[measured] + noise.dot(inputs)
                now, next_commands[places] = control(read, n * self.time_step, wanted)
                jump = now - held[places] if at_once else None
                held[places] = now
            # 0.5 as a factor: for few numbers a quotient takes NumPy twice as long.
            now = held[places]
            ending = 0.5 * (now + next_commands[places]) if (n + 1) % period == 0 else now
            end[places] = ending if jump is None else ending + 0.5 * jump
        self.both[0] = held
        added = self.both.dot(self.command_matrix)
        return added[0], added[1], held

    def _read(self, measure: Callable[[], Array]) -> Array:
        """Return the present outputs, and beyond them the zero that channels of a feedforward measure."""
        return np.append(measure(), 0.0) if self.feeds_forward else measure()

    @property
    def state(self) -> Any:
        """Copy of the values that change from step to step."""
        return self.held.copy(), self.next_commands.copy(), [control.state for _, _, control, *_ in self.groups]

    def restore(self, state: Any) -> None:
        """Restore a state."""
        held, next_commands, controls = state
        self.held[:], self.next_commands[:] = held, next_commands
        for (_, _, control, *_), own in zip(self.groups, controls, strict=True):
            control.restore(own)


def reference_matrix(scene: Scene, loop: Loop) -> Array:
    """Return what a loop's channels subtract per unit of the scene's inputs, (channels, inputs): its references."""
    return _selection(scene, loop, (2 * loop.reference)[: loop.n_channels])


def noise_matrix(scene: Scene, loop: Loop) -> Array:
    """Return what adds to a loop's channels before the converters per unit of the scene's inputs, (channels, inputs).

    That is the noise of what it measures.
    """
    return _selection(scene, loop, loop.noise)


def _selection(scene: Scene, loop: Loop, names: Sequence[str]) -> Array:
    """Return the matrix that selects an input for each of a loop's first channels, (channels, inputs)."""
    result = np.zeros((loop.n_channels, len(scene.inputs)))
    result[np.arange(len(names)), [scene.inputs.index(name) for name in names]] = 1.0
    return result


def channels(loop: Loop, outputs: Sequence[str]) -> list[int]:
    """Return the place of each channel of a loop among outputs; those of a feedforward are beyond the last one."""
    return [*map(outputs.index, loop.measured), *[len(outputs)] * (loop.n_channels - len(loop.measured))]


def input_converters(loop: Loop) -> list[tuple[float, float]]:
    """Return resolution and range of each channel of a loop; those of a feedforward have no converter."""
    measured = len(loop.measured)
    return [(loop.input_step, loop.input_limit)] * measured + [(0.0, math.inf)] * (loop.n_channels - measured)


def output_converters(loop: Loop) -> list[tuple[float, float]]:
    """Return resolution and range of each command of a loop."""
    return [(loop.output_step, loop.controller.limit)] * len(loop.driven)


def _stacked(matrix_of: Callable[[Scene, Loop], Array], scene: Scene, loops: list[Loop]) -> Array | None:
    """Return one matrix of several loops, (channels, inputs); None where it is zero, which takes no time at a step."""
    result = np.vstack([matrix_of(scene, loop) for loop in loops])
    return result if np.any(result) else None


def span(places: list[int]) -> Array | slice:
    """Return places in an array, as a slice where they are consecutive, which is faster at every step."""
    first = places[0] if places else 0
    whole = slice(first, first + len(places))
    return whole if places == list(range(whole.start, whole.stop)) else np.array(places)
