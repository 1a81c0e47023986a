"""A scene from sample to sample, its digital controllers included: one system that is linear but for the converters.

Its states are the scene's, then the commands that are held, then of each loop the controller's own and the commands
that wait, and where modes are quasi-static the commands that were held before. Ahead of the converters stand the *raw*
values: the outputs that all loops measure, then what their controllers compute of their states. A sample is then a
conversion of these and one product with a matrix; without converters it is linear, and so are many samples at once.
"""

import math
from collections.abc import Iterable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import pairwise

import numpy as np

from nassim.base.checks import Array
from nassim.scene.loop import Loop
from nassim.scene.scene import Scene
from nassim.simulation.model.digital_controllers import BadCommand, ask, converter, samples_per_period
from nassim.systems.controllers import Controller
from nassim.systems.python_controller import ControlLaw, PythonController
from nassim.systems.state_space import EARLIER, StateSpace, combine_steps


@dataclass(frozen=True)
class Plant:
    """A scene without its controllers: x_1 = A x_0 + B u_0 + G c_0 and y_0 = C x_0 + D u_0 + E c_(-1).

    matrices: A, B, C and D, for all that acts but commands
    pushed, shown: G (n, commands) and E (outputs, commands); outputs show the commands that are held until the sample
    settling: the part of E that quasi-static modes add, which a sample of the command's own loop shows as
        `nassim.systems.state_space.settling_response` does
    """

    matrices: StateSpace
    pushed: Array
    shown: Array
    settling: Array


@dataclass(frozen=True)
class _Wiring:
    """Places of a loop's signals: of measured signals among the outputs, of others among states and raw values.

    controller: the loop's, without states and gains where that is in Python; law: what is asked there, of this run
    period: in time steps; held, own, waiting, before: states; seen, computed: raw values
    """

    loop: Loop
    controller: Controller
    law: ControlLaw | None
    period: int
    measured: list[int]
    held: slice
    own: slice
    waiting: slice
    before: slice
    seen: slice
    computed: slice


@dataclass(frozen=True)
class ClosedSteps:
    """A scene with its controllers from sample to sample.

    time_step: [s]
    reading, through: raw values of the states, (raw, n), and of the inputs, (raw, inputs)
    direct: D of all controllers, (computed, seen)
    steps: what a sample does to states and raw values, by which loops are due; filled when used
    """

    plant: Plant
    wirings: tuple[_Wiring, ...]
    time_step: float
    reading: Array
    through: Array
    direct: Array
    steps: dict[tuple[bool, ...], Array] = field(default_factory=dict)

    @property
    def period(self) -> int:
        """Samples after which all loops are due together again."""
        return math.lcm(*(wiring.period for wiring in self.wirings))

    @property
    def by_law(self) -> bool:
        """Whether a controller is in Python, which every sample must ask once."""
        return any(wiring.law for wiring in self.wirings)

    @property
    def nonlinear(self) -> bool:
        """Whether a controller is in Python or a converter has a resolution; else all is linear within the limits."""
        return self.by_law or any(wiring.loop.input_step or wiring.loop.output_step for wiring in self.wirings)

    @property
    def n(self) -> int:
        """Number of states."""
        return self.reading.shape[1]

    def linear(self) -> StateSpace:
        """Without converters over a period: of the inputs, the outputs and then the commands, of all its samples."""
        return reduce(combine_steps, (self._linear(self._due(k)) for k in range(self.period)))

    def by_samples(self, state: Array, inputs: Array, first: int) -> tuple[Array, Array]:
        """Go through the converters, sample by sample. What a sample gives is the same alone as among others.

        Args:
            state: at the first sample, shape (n,).
            inputs: shape (k, inputs).
            first: number of the first sample since the start of the run.

        Returns states at all samples and after them, shape (k + 1, n), outputs and commands, shape (k, rows).

        Raises:
            BadCommand: when a controller in Python fails, with the rows until then.
        """
        n, split, period = self.n, self.n + self.direct.shape[1], self.period
        sees = [converter(w.loop.input_step, w.loop.input_limit) for w in self.wirings for _ in w.measured]
        puts = [converter(w.loop.output_step, w.controller.limit) for w in self.wirings for _ in w.loop.driven]
        values = np.empty((len(inputs) + 1, n + len(self.reading)))
        values[0, :n] = state
        pushes, through = _each(self._taken, inputs), _each(self.through, inputs)
        steps: dict[int, tuple[Array, bool]] = {}
        for k, row in enumerate(values[:-1]):
            phase = (first + k) % period
            if phase not in steps:
                due = self._due(phase)
                steps[phase] = self._step(due), any(due)
            step, busy = steps[phase]
            row[n:] = 0.0
            if busy:
                row[n:] = self.reading.dot(row[:n]) + through[k]
                row[n:split] = [see(value) for see, value in zip(sees, row[n:split].tolist(), strict=True)]
                computed = row[split:] + self.direct.dot(row[n:split])
                try:
                    self._ask(row, computed, first + k)
                except BadCommand as bad:
                    bad.rows, bad.sample = self._rows(values[: k + 1, :n], inputs[:k], first), first + k
                    raise
                row[split:] = [put(value) for put, value in zip(puts, computed.tolist(), strict=True)]
            values[k + 1, :n] = step.dot(row) + pushes[k]
        states = values[:, :n]
        return states, self._rows(states, inputs, first)

    def _ask(self, row: Array, computed: Array, sample: int) -> None:
        """Put the commands of controllers in Python that are due among the computed values, of a row of all values."""
        raw, start = row[self.n :], self.direct.shape[1]
        for wiring in self.wirings:
            if wiring.law and sample % wiring.period == 0:
                found = ask(wiring.loop, wiring.law, raw[wiring.seen], sample * self.time_step)
                computed[wiring.computed.start - start : wiring.computed.stop - start] = found

    def _rows(self, states: Array, inputs: Array, first: int) -> Array:
        """Outputs and commands of k samples, (k, rows), by states at them and after, (k + 1, n), and inputs."""
        outputs = _each(self._shown(()), states[:-1]) + _each(self.plant.matrices[3], inputs)
        for wiring in self.wirings:
            taken = slice(-first % wiring.period, None, wiring.period)
            outputs[taken] += _each(_earlier(self.plant, wiring, self.n), states[:-1][taken])
        return np.hstack([outputs, self._held(states[1:])])

    @property
    def laws(self) -> list[ControlLaw]:
        """Copies of the controllers in Python as they are now."""
        return [deepcopy(wiring.law) for wiring in self.wirings if wiring.law]

    def with_laws(self, laws: Sequence[ControlLaw]) -> "ClosedSteps":
        """The same with copies of these controllers in Python."""
        found = iter(laws)
        wirings = tuple(replace(w, law=deepcopy(next(found))) if w.law else w for w in self.wirings)
        return replace(self, wirings=wirings)

    def within_limits(self, states: Array, rows: Array) -> int:
        """How many blocks of samples come before the first in which a converter meets its limit.

        states: after each block, (blocks, n); rows: outputs and commands, (blocks, k, rows)
        """
        inside = np.ones(len(states), dtype=bool)
        commands = len(self.plant.shown) - len(self.plant.pushed)  # from a place among states to that in rows
        for wiring in self.wirings:
            limit = wiring.controller.limit
            own = slice(wiring.held.start + commands, wiring.held.stop + commands)
            for values, bound in (
                (rows[:, :, wiring.measured], wiring.loop.input_limit),
                (rows[:, :, own], limit),
                (states[:, None, wiring.waiting], limit),
            ):
                if bound < np.inf:  # not >, as what is no number meets every limit
                    inside &= np.all(np.abs(values) <= bound, axis=(1, 2))
        return len(inside) if inside.all() else int(np.argmin(inside))

    def _step(self, due: tuple[bool, ...]) -> Array:
        if due not in self.steps:
            self.steps[due] = self._moved(due)
        return self.steps[due]

    def _due(self, sample: int) -> tuple[bool, ...]:
        return tuple([sample % wiring.period == 0 for wiring in self.wirings])

    def _moved(self, due: tuple[bool, ...]) -> Array:
        """States after a sample, but for the inputs' effect, of those before and converted values, (n, n + raw)."""
        a, *_ = self.plant.matrices
        before = np.eye(self.n + len(self.reading))
        states, converted = before[: self.n], before[self.n :]
        after = states.copy()
        for wiring, now in zip(self.wirings, due, strict=True):
            if now:
                c = wiring.controller
                line = np.vstack([states[wiring.waiting], converted[wiring.computed]])
                after[wiring.before] = states[wiring.held][: wiring.before.stop - wiring.before.start]
                after[wiring.held], after[wiring.waiting] = line[: len(c.C)], line[len(c.C) :]
                after[wiring.own] = c.A @ states[wiring.own] + c.B @ converted[wiring.seen]
        after[: len(a)] = self.plant.pushed @ self._held(after.T).T
        after[: len(a), : len(a)] += a
        return after

    def _linear(self, due: tuple[bool, ...]) -> StateSpace:
        """One sample without converters."""
        ideal = np.eye(len(self.reading))
        ideal[len(ideal) - len(self.direct) :, : self.direct.shape[1]] = self.direct
        moved = self._moved(due)
        converted = moved[:, self.n :] @ ideal
        state, taken = moved[:, : self.n] + converted @ self.reading, self._taken + converted @ self.through
        shown = self._shown([wiring for wiring, now in zip(self.wirings, due, strict=True) if now])
        rows = np.vstack([shown, self._held(state.T).T])
        return state, taken, rows, np.vstack([self.plant.matrices[3], self._held(taken.T).T])

    def _held(self, states: Array) -> Array:
        """The commands that are held, of states (..., n)."""
        start, commands = self.plant.pushed.shape
        return states[..., start : start + commands]

    @property
    def _taken(self) -> Array:
        """Return the effect of the inputs on the states, (n, inputs)."""
        b = self.plant.matrices[1]
        return np.vstack([b, np.zeros((self.n - len(b), b.shape[1]))])

    def _shown(self, due: Iterable[_Wiring]) -> Array:
        """Return the outputs per unit of the states when some loops are due, (outputs, n)."""
        return _shown(self.plant, due, self.n)


def closed_steps(plant: Plant, scene: Scene, time_step: float) -> ClosedSteps:
    """Wire a scene's loops to it, their controllers at rest.

    Args:
        plant: the scene without them.
        scene: whose loops are wired.
        time_step: [s].

    Raises:
        ValueError: for sample rates that do not fit the time step.
    """
    (a, _, _, d), loops = plant.matrices, scene.loops
    controllers = [_linear_part(loop) for loop in loops]
    laws = [deepcopy(k.controller.law) if isinstance(k.controller, PythonController) else None for k in loops]
    n_seen, n_driven = [len(loop.measured) for loop in loops], [len(loop.driven) for loop in loops]
    commands, raw = len(a) + sum(n_driven), sum(n_seen + n_driven)
    held, own = _slices(len(a), n_driven), _slices(commands, [len(controller.A) for controller in controllers])
    n_own = commands + sum(len(controller.A) for controller in controllers)
    lines = [controller.delay * len(loop.driven) for loop, controller in zip(loops, controllers, strict=True)]
    waiting, n_waiting = _slices(n_own, lines), n_own + sum(lines)
    n_before = [k * bool(plant.settling.any()) for k in n_driven]
    before, n = _slices(n_waiting, n_before), n_waiting + sum(n_before)
    rows = [[scene.outputs.index(name) for name in loop.measured] for loop in loops]
    periods = [samples_per_period(loop, time_step) for loop in loops]
    seen, computed = _slices(0, n_seen), _slices(sum(n_seen), n_driven)
    places = zip(loops, controllers, laws, periods, rows, held, own, waiting, before, seen, computed, strict=True)
    wirings = tuple(_Wiring(*place) for place in places)

    measured = [row for wiring in wirings for row in wiring.measured]
    reading, through = np.zeros((raw, n)), np.zeros((raw, d.shape[1]))
    reading[: len(measured)] = _shown(plant, wirings, n)[measured]
    through[: len(measured)] = d[measured]
    direct = np.zeros((sum(n_driven), sum(n_seen)))
    for wiring in wirings:
        controller = wiring.controller
        reading[wiring.computed, wiring.own] = controller.C
        direct[wiring.computed.start - sum(n_seen) : wiring.computed.stop - sum(n_seen), wiring.seen] = controller.D
    return ClosedSteps(plant, wirings, time_step, reading, through, direct)


def _linear_part(loop: Loop) -> Controller:
    """A loop's controller, without states and gains in place of one in Python."""
    given = loop.controller
    if isinstance(given, Controller):
        return given
    n_in, n_out = len(loop.measured), len(loop.driven)
    nothing = np.zeros((0, 0)), np.zeros((0, n_in)), np.zeros((n_out, 0)), np.zeros((n_out, n_in))
    return Controller(*nothing, given.sample_rate, given.delay, given.limit)


def _each(matrix: Array, rows: Array) -> Array:
    """Product of a matrix with each of some rows, (k, m), by itself: no digit of one depends on the others."""
    result: Array = np.matmul(matrix, rows[:, :, None])[:, :, 0]
    return result


def _shown(plant: Plant, due: Iterable[_Wiring], n: int) -> Array:
    """Return the outputs per unit of all n states when some loops are due, (outputs, n)."""
    c = np.hstack([plant.matrices[2], plant.shown])
    result = np.hstack([c, np.zeros((len(c), n - c.shape[1]))])
    for wiring in due:
        result += _earlier(plant, wiring, n)
    return result


def _earlier(plant: Plant, wiring: _Wiring, n: int) -> Array:
    """Return the share of a loop's last two commands in the outputs of a sample, per unit of n states, (outputs, n)."""
    result = np.zeros((len(plant.settling), n))
    if wiring.before.stop > wiring.before.start:
        first = len(plant.matrices[0])
        weights = EARLIER * plant.settling[:, wiring.held.start - first : wiring.held.stop - first]
        result[:, wiring.held], result[:, wiring.before] = weights, -weights
    return result


def _slices(start: int, sizes: Sequence[int]) -> list[slice]:
    """One behind the other."""
    return [slice(int(a), int(b)) for a, b in pairwise(start + np.cumsum([0, *sizes]))]
