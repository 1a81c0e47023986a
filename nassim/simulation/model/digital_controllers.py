"""What a digital controller does with every sample: convert, compute, saturate, wait, convert."""

import math
from collections import deque
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from nassim.base.checks import Array
from nassim.scene.loop import Loop
from nassim.scene.scene import Scene
from nassim.systems.python_controller import ControlLaw, PythonController

WHOLE = 1.5 * 2.0**52
"""Added and taken away, it rounds a number to the nearest whole one, ties to even, and lets infinite ones pass."""


def samples_per_period(loop: Loop, time_step: float) -> int:
    """Count the time steps in one sample period of a loop.

    Raises:
        ValueError: when that is not a whole number.
    """
    steps = 1 / (loop.controller.sample_rate * time_step)
    whole = round(steps)
    if whole < 1 or abs(steps - whole) > 1e-6 * whole:
        raise ValueError(
            f"loop {loop.name!r} samples at {loop.controller.sample_rate:g} Hz, every {steps:.6g} time steps of "
            f"{time_step:g} s; take time_step = {1 / loop.controller.sample_rate:g} s over a whole number"
        )
    return whole


class BadCommand(RuntimeError):
    """A controller in Python that raised an error or returned no finite commands.

    Attributes:
        rows: outputs and commands of the run's piece until then, shape (n_samples, outputs + commands); empty where
            the engine has them.
        sample: number of the sample at which the controller failed.
    """

    def __init__(self, message: str) -> None:
        super().__init__(message)
        self.rows, self.sample = np.zeros((0, 0)), 0


def ask(loop: Loop, law: ControlLaw, measured: Array, time: float) -> Array:
    """Ask a loop's object for its commands.

    Args:
        loop: whose object it is.
        law: the object, as the run has it.
        measured: behind the converters, shape (measured,).
        time: [s].

    Returns the commands, shape (driven,).

    Raises:
        BadCommand: when the object raises an error or returns what is no command.
    """
    said = f"loop {loop.name!r}: its controller, a {type(law).__name__} in Python,"
    n = len(loop.driven)
    try:
        found = np.atleast_1d(np.asarray(law.output(np.array(measured), time), dtype=float))
    except Exception as error:
        raise BadCommand(f"{said} raised {type(error).__name__} at t = {time:g} s: {error}") from error
    if found.shape != (n,):
        raise BadCommand(
            f"{said} returned an array of shape {found.shape} at t = {time:g} s; it must return one command for each "
            f"of the inputs {', '.join(loop.driven)}, shape ({n},)"
        )
    if not np.isfinite(found).all():
        raise BadCommand(f"{said} returned {found.tolist()} at t = {time:g} s; commands must be finite numbers")
    return found


class RunningControllers:
    """Controllers at rest of loops with one delay, all linear, or a single one in Python."""

    def __init__(self, *loops: Loop) -> None:
        controller = loops[0].controller
        self.loop, self.law = loops[0], None
        n_in, n_out = sum(len(loop.measured) for loop in loops), sum(len(loop.driven) for loop in loops)
        if isinstance(controller, PythonController):
            self.law, self.whole = deepcopy(controller.law), np.zeros((0, 0))
            self.now = np.zeros(0)
        else:
            linear = [loop.linear_controller for loop in loops]
            a, b, c, d = (block_diag(*(getattr(one, name) for one in linear)) for name in "ABCD")
            self.whole = np.block([[a, b], [c, d]])
            self.now = np.zeros(len(a) + n_in)  # states, then what is seen
        self.n = len(self.now) - n_in
        self.see = _converters([(loop.input_step, loop.input_limit) for loop in loops for _ in loop.measured])
        self.put_out = _converters([(loop.output_step, loop.controller.limit) for loop in loops for _ in loop.driven])
        self.waiting = deque(np.zeros((controller.delay, n_out)))

    def __call__(self, measured: Array, time: float = 0.0) -> tuple[Array, Array]:
        """Take a sample.

        Args:
            measured: what the loops measure, shape (measured,).
            time: of the sample [s].

        Returns what the loops then add to their inputs until the next sample, shape (driven,), and what from then on
        as far as that is known already: with a delay of at least one sample it is, without one it is taken as the same.
        """
        if self.law is None:
            self.now[self.n :] = self.see(measured)
            after = self.whole.dot(self.now)
            self.now[: self.n] = after[: self.n]
            computed = after[self.n :]
        else:
            computed = ask(self.loop, self.law, self.see(measured), time)
        self.waiting.append(self.put_out(computed))
        acting = self.waiting.popleft()
        return acting, self.waiting[0] if self.waiting else acting

    @property
    def state(self) -> Any:
        """A copy of all that changes from sample to sample."""
        return deepcopy((self.now, self.waiting, self.law))

    def restore(self, state: Any) -> None:
        """Go back to a state."""
        self.now, self.waiting, self.law = deepcopy(state)


def start_controller(*loops: Loop) -> RunningControllers:
    """Start controllers at rest, of loops with one delay that are linear, or of one loop."""
    return RunningControllers(*loops)


def _converters(each: list[tuple[float, float]]) -> Callable[[Array], Array]:
    """Make a function that quantises and limits values as converters of these resolutions and ranges do."""
    if not any(step or limit < math.inf for step, limit in each):
        return lambda values: values
    converters = [converter(step, limit) for step, limit in each]
    return lambda values: np.array([of(value) for of, value in zip(converters, values.tolist(), strict=True)])


def converter(step: float, limit: float) -> Callable[[float], float]:
    """Make a function that quantises and limits a value as a converter of this resolution (0: none) and range does.

    For numbers, not arrays: a sample has few values, which NumPy's calls would take several times as long for.
    """
    if not step:
        return lambda value: min(max(value, -limit), limit)
    most = math.floor(limit / step) if limit < math.inf else math.inf
    return lambda value: step * min(max(value / step + WHOLE - WHOLE, -most), most)


class RunningLoops:
    """All loops of a scene at rest, to be called at every time step n = 0, 1, ..."""

    def __init__(self, scene: Scene, time_step: float) -> None:
        inputs, outputs, driven = scene.inputs, scene.outputs, [name for loop in scene.loops for name in loop.driven]
        self.time_step = time_step
        self.taken = np.zeros((len(driven), len(inputs)))
        self.taken[np.arange(len(driven)), [inputs.index(name) for name in driven]] = 1.0
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
                start_controller(*(scene.loops[k] for k in chosen)),
                np.array([outputs.index(name) for k in chosen for name in scene.loops[k].measured]),
                _span([place for k in chosen for place in range(ends[k], ends[k + 1])]),
            )
            for (period, delay, _), chosen in alike.items()
        ]
        self.held, self.next_one, self.both = np.zeros(len(driven)), np.zeros(len(driven)), np.zeros((2, len(driven)))

    def __call__(self, n: int, measure: Callable[[], Array]) -> tuple[Array, Array, Array]:
        """Take the samples that are due at a time step.

        Args:
            n: its number.
            measure: returns the scene's outputs at that time, shape (outputs,); called only where a sample is due.

        Returns what the loops add to the scene's inputs until the next step, shape (inputs,); what of it acts at the
        end of that step, for a rule that takes forces at both ends of one; and their commands in the order of
        `Scene.commands`. Where a command jumps, the rule has the mean of both its values there: known before by a
        delay, or else, as the rule has taken the old value there already, with the missing half of the jump a step
        later.
        """
        held, next_one, found, end = self.held, self.next_one, None, self.both[1]
        for period, at_once, control, measured, places in self.groups:
            late: Array | float = 0.0
            if n % period == 0:
                found = measure() if found is None else found
                now, next_one[places] = control(found[measured], n * self.time_step)
                late = (now - held[places]) / 2 if at_once else 0.0
                held[places] = now
            now = held[places]
            end[places] = late + ((now + next_one[places]) / 2 if (n + 1) % period == 0 else now)
        self.both[0] = held
        on_inputs = self.both.dot(self.taken)
        return on_inputs[0], on_inputs[1], held.copy()

    @property
    def state(self) -> Any:
        """A copy of all that changes from step to step."""
        return self.held.copy(), self.next_one.copy(), [control.state for _, _, control, _, _ in self.groups]

    def restore(self, state: Any) -> None:
        """Go back to a state."""
        held, next_one, controls = state
        self.held[:], self.next_one[:] = held, next_one
        for (_, _, control, _, _), own in zip(self.groups, controls, strict=True):
            control.restore(own)


def start_loops(scene: Scene, time_step: float) -> RunningLoops:
    """Start all loops of a scene at rest; time_step [s]."""
    return RunningLoops(scene, time_step)


def _span(places: list[int]) -> Array | slice:
    """Places in an array, as a slice where they follow each other: that costs less at every step."""
    whole = slice(places[0], places[-1] + 1)
    return whole if places == list(range(whole.start, whole.stop)) else np.array(places)
