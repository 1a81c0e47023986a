"""Discrete-time system of a scene with its digital controllers, linear except for the converters.

The states are, in this order: the states of the scene, the commands that are held, for each loop the states of its
controller and the commands in its delay line, and with quasi-static modes the commands that were held before. The *raw*
values are the inputs of the converters: the outputs that the loops measure, then the outputs of the controllers. A
sample converts the raw values and multiplies states and converted values by one matrix. Without converters a sample is
linear, and so is a block of several samples.
"""

import math
from collections.abc import Iterable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from itertools import pairwise

import numpy as np

from nassim.base.checks import Array
from nassim.scene.loop import Loop
from nassim.scene.scene import Scene
from nassim.simulation.model.digital_controllers import (
    BadCommand,
    ask,
    converter,
    input_converters,
    noise_matrix,
    output_converters,
    reference_matrix,
    samples_per_period,
)
from nassim.systems.controllers import Controller
from nassim.systems.python_controller import ControlLaw, PythonController
from nassim.systems.state_space import EARLIER, StateSpace, combine_steps
from nassim.systems.step_program import Converter, ProgramSignal, SampleMatrices, StepProgram


@dataclass(frozen=True)
class Plant:
    """A scene without its controllers: x_1 = A x_0 + B u_0 + G c_0 and y_0 = C x_0 + D u_0 + E c_(-1).

    Attributes:
        matrices: A, B, C and D, for all inputs except the commands c.
        pushed: G, (n, commands).
        shown: E, (outputs, commands): outputs contain the commands that are held until the sample.
        settling: part of E by quasi-static modes. At samples of the command's own loop, outputs contain it as in
            `nassim.systems.state_space.settling_response`.
    """

    matrices: StateSpace
    pushed: Array
    shown: Array
    settling: Array


@dataclass(frozen=True)
class _Wiring:
    """A loop and the indices of its signals.

    Attributes:
        loop: the loop.
        controller: its linear controller; one without states and gains for a controller in Python.
        law: controller in Python of this run; None for a linear one.
        period: sample period in time steps.
        measured: indices of the measured signals among the outputs.
        held: slice of the held commands among the states.
        own: slice of the controller's states.
        waiting: slice of the delay line among the states.
        before: slice of the commands held before among the states.
        seen: slice of the loop's channels among the raw values: the measured signals, then those of its feedforward.
        computed: slice of the controller's outputs among the raw values.
        outputs: slice of the controller's outputs among those of all controllers.
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
    outputs: slice


@dataclass(frozen=True)
class ClosedSteps:
    """Discrete-time system of a scene with its controllers.

    Attributes:
        plant: the scene without its controllers.
        wirings: its loops.
        time_step: [s].
        reading: raw values per unit of the states, (raw, n).
        through: raw values per unit of the inputs, (raw, inputs).
        reference: references per unit of the inputs, (seen, inputs), which the controllers subtract from the converted
            measured values.
        direct: feedthrough D of all controllers, (computed, seen).
        steps: matrices of a sample by the loops that are due, computed when used.
    """

    plant: Plant
    wirings: tuple[_Wiring, ...]
    time_step: float
    reading: Array
    through: Array
    reference: Array
    direct: Array
    steps: dict[tuple[bool, ...], Array] = field(default_factory=dict)

    @property
    def period(self) -> int:
        """Least common multiple of the sample periods, in time steps."""
        return math.lcm(*(wiring.period for wiring in self.wirings))

    @property
    def by_law(self) -> bool:
        """Whether a controller is in Python, which is called once at each of its samples."""
        return any(wiring.law for wiring in self.wirings)

    @property
    def nonlinear(self) -> bool:
        """Whether samples go one by one; else all is linear while outputs and commands are within limits."""
        return self.by_law or any(_by_samples(wiring.loop) for wiring in self.wirings)

    @property
    def limited(self) -> bool:
        """Whether a converter has a limit that outputs or commands can meet."""
        return len(self._limits[0][0]) > 0

    @property
    def n(self) -> int:
        """Number of states."""
        return self.reading.shape[1]

    def linear(self) -> StateSpace:
        """Combine the samples of a period without converters into one linear system.

        Returns:
            Its matrices; inputs, and outputs followed by commands, are those of all samples in order.
        """
        return reduce(combine_steps, (self._linear(self._due(k)) for k in range(self.period)))

    def by_samples(self, state: Array, inputs: Array, first: int) -> tuple[Array, Array]:
        """Simulate sample by sample, with converters. Results do not depend on how many samples a call has.

        Args:
            state: at the first sample, shape (n,).
            inputs: shape (k, inputs).
            first: number of the first sample since the start of the run.

        Returns:
            States at all samples and after them, shape (k + 1, n), and outputs and commands, shape (k, rows).

        Raises:
            BadCommand: when a controller in Python fails; it has the rows until then.
        """
        n, split, period = self.n, self.n + self.direct.shape[1], self.period
        sees = [converter(*channel) for w in self.wirings for channel in input_converters(w.loop)]
        puts = [converter(*channel) for w in self.wirings for channel in output_converters(w.loop)]
        values = np.empty((len(inputs) + 1, n + len(self.reading)))
        values[0, :n] = state
        pushes, through, wanted = (each(matrix, inputs) for matrix in (self._taken, self.through, self.reference))
        winding = [w for w in self.wirings if w.controller.anti_windup is not None and w.controller.limit < math.inf]
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
                row[n:split] -= wanted[k]
                computed = row[split:] + self.direct.dot(row[n:split])
                try:
                    self._ask(row, computed, first + k)
                except BadCommand as bad:
                    bad.rows, bad.sample = self._rows(values[: k + 1, :n], inputs[:k], first), first + k
                    raise
                row[split:] = [put(value) for put, value in zip(puts, computed.tolist(), strict=True)]
            values[k + 1, :n] = step.dot(row) + pushes[k]
            for wiring in winding:
                if (first + k) % wiring.period == 0:
                    command, limit = computed[wiring.outputs], wiring.controller.limit
                    cut_off = np.clip(command, -limit, limit) - command
                    values[k + 1, wiring.own] += wiring.controller.corrections.dot(cut_off)
        states = values[:, :n]
        return states, self._rows(states, inputs, first)

    def _ask(self, row: Array, computed: Array, sample: int) -> None:
        """Write the commands of controllers in Python that are due into the computed values.

        Args:
            row: states and raw values, (n + raw,).
            computed: computed values, which are changed, (computed,).
            sample: number of the sample.
        """
        raw = row[self.n :]
        for wiring in self.wirings:
            if wiring.law and sample % wiring.period == 0:
                computed[wiring.outputs] = ask(wiring.loop, wiring.law, raw[wiring.seen], sample * self.time_step)

    def _rows(self, states: Array, inputs: Array, first: int) -> Array:
        """Return outputs and commands of k samples, (k, rows).

        Args:
            states: at the samples and after them, (k + 1, n).
            inputs: shape (k, inputs).
            first: number of the first sample.
        """
        outputs = each(self._shown(()), states[:-1]) + each(self.plant.matrices[3], inputs)
        for wiring in self.wirings:
            taken = slice(-first % wiring.period, None, wiring.period)
            outputs[taken] += each(_earlier(self.plant, wiring, self.n), states[:-1][taken])
        return np.hstack([outputs, self._held(states[1:])])

    @property
    def laws(self) -> list[ControlLaw]:
        """Copies of the controllers in Python in their present state."""
        return [deepcopy(wiring.law) for wiring in self.wirings if wiring.law]

    def with_laws(self, laws: Sequence[ControlLaw]) -> "ClosedSteps":
        """Return the same system with copies of these controllers in Python."""
        found = iter(laws)
        wirings = tuple(replace(w, law=deepcopy(next(found))) if w.law else w for w in self.wirings)
        return replace(self, wirings=wirings)

    def program(
        self, inputs: tuple[ProgramSignal, ...], outputs: tuple[ProgramSignal, ...], start: Array, shift: Array
    ) -> StepProgram:
        """Return the same system as a program, which needs no object of a scene.

        Args:
            inputs: the inputs.
            outputs: the outputs, then the commands.
            start: state of the plant at the first sample for inputs of zero, (plant states,).
            shift: change of that state per unit of the inputs at the first sample, (plant states, inputs).

        Raises:
            ValueError: for a controller in Python.
        """
        for wiring in self.wirings:
            wiring.loop.linear_controller  # noqa: B018  # refuses by name
        dues = [self._due(k) for k in range(self.period)]
        kinds = list(dict.fromkeys(dues))
        more = self.n - len(start)
        first = self.plant.pushed.shape[0]
        loops = [wiring.loop for wiring in self.wirings]
        channels = [*map(input_converters, loops), *map(output_converters, loops)]
        return StepProgram(
            time_step=self.time_step,
            inputs=inputs,
            outputs=outputs,
            start=np.pad(start, (0, more)),
            start_by_inputs=np.pad(shift, ((0, more), (0, 0))),
            samples=tuple(self._matrices(due) for due in kinds),
            phases=tuple(map(kinds.index, dues)),
            taken=self._taken,
            feedthrough=self.plant.matrices[3],
            reading=self.reading,
            through=self.through,
            reference=self.reference,
            gains=self.direct,
            converters=tuple(Converter(*channel) for own in channels for channel in own),
            commands=slice(first, first + self.plant.pushed.shape[1]),
        )

    def _matrices(self, due: tuple[bool, ...]) -> SampleMatrices:
        """Return what a sample multiplies when some loops are due."""
        chosen = [wiring for wiring, now in zip(self.wirings, due, strict=True) if now]
        corrections = np.zeros((self.n, len(self.direct)))
        for wiring in chosen:
            corrections[wiring.own, wiring.outputs] = wiring.controller.corrections
        return SampleMatrices(any(due), self._moved(due), self._shown(chosen), corrections)

    def within_limits(self, rows: Array) -> Array:
        """Whether samples meet no converter's limit, by outputs and commands, (..., rows); shape (...)."""
        places, bounds = self._limits[0]
        return np.logical_and.reduce(np.abs(rows[..., places]) <= bounds, axis=-1)  # NaN meets every limit

    def waits_within_limits(self, states: Array) -> Array:
        """Whether the commands that wait meet no limit, by states, (..., n); shape (...)."""
        places, bounds = self._limits[1]
        return np.logical_and.reduce(np.abs(states[..., places]) <= bounds, axis=-1)

    @cached_property
    def _limits(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Places of limited signals among outputs and commands, and among the states, with their limits."""
        shift = len(self.plant.shown) - len(self.plant.pushed)  # from a command's place among states to that in rows
        rows: list[tuple[int, float]] = []
        waiting: list[tuple[int, float]] = []
        for wiring in self.wirings:
            limit = wiring.controller.limit
            rows += [(place, wiring.loop.input_limit) for place in wiring.measured]
            rows += [(place + shift, limit) for place in range(wiring.held.start, wiring.held.stop)]
            waiting += [(place, limit) for place in range(wiring.waiting.start, wiring.waiting.stop)]
        found = [[(place, bound) for place, bound in one if bound < np.inf] for one in (rows, waiting)]
        first, second = (
            (np.array([place for place, _ in one], dtype=int), np.array([bound for _, bound in one])) for one in found
        )
        return first, second

    def _step(self, due: tuple[bool, ...]) -> Array:
        if due not in self.steps:
            self.steps[due] = self._moved(due)
        return self.steps[due]

    def _due(self, sample: int) -> tuple[bool, ...]:
        return tuple([sample % wiring.period == 0 for wiring in self.wirings])

    def _moved(self, due: tuple[bool, ...]) -> Array:
        """Return the states after a sample per unit of states and converted values, without inputs, (n, n + raw)."""
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
        """Return one sample without converters as a linear system."""
        ideal = np.eye(len(self.reading))
        ideal[len(ideal) - len(self.direct) :, : self.direct.shape[1]] = self.direct
        moved = self._moved(due)
        converted = moved[:, self.n :] @ ideal
        state, taken = moved[:, : self.n] + converted @ self.reading, self._taken + converted @ self.through
        taken -= converted[:, : len(self.reference)] @ self.reference
        shown = self._shown([wiring for wiring, now in zip(self.wirings, due, strict=True) if now])
        rows = np.vstack([shown, self._held(state.T).T])
        return state, taken, rows, np.vstack([self.plant.matrices[3], self._held(taken.T).T])

    def _held(self, states: Array) -> Array:
        """Return the held commands of states, (..., n)."""
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


def connect_loops(plant: Plant, scene: Scene, time_step: float) -> ClosedSteps:
    """Connect a scene's loops to its plant, with all controllers at rest.

    Args:
        plant: the scene without its controllers.
        scene: the scene with its loops.
        time_step: [s].

    Returns:
        The discrete-time system.

    Raises:
        ValueError: for sample rates that do not fit the time step.
    """
    wirings, n = _place_signals(plant, scene, time_step)
    d, shown = plant.matrices[3], _shown(plant, wirings, n)
    n_seen, n_computed = sum(loop.n_channels for loop in scene.loops), sum(len(loop.driven) for loop in scene.loops)
    reading, through = np.zeros((n_seen + n_computed, n)), np.zeros((n_seen + n_computed, d.shape[1]))
    direct = np.zeros((n_computed, n_seen))
    for wiring in wirings:
        # Channels of a feedforward measure nothing.
        measured = slice(wiring.seen.start, wiring.seen.start + len(wiring.measured))
        reading[measured], through[measured] = shown[wiring.measured], d[wiring.measured]
        reading[wiring.computed, wiring.own] = wiring.controller.C
        direct[wiring.outputs, wiring.seen] = wiring.controller.D
    reference, n_given = np.zeros((n_seen, d.shape[1])), len(scene.inputs)
    for wiring in wirings:
        reference[wiring.seen, :n_given] = reference_matrix(scene, wiring.loop)
        through[wiring.seen, :n_given] += noise_matrix(scene, wiring.loop)
    return ClosedSteps(plant, wirings, time_step, reading, through, reference, direct)


def _by_samples(loop: Loop) -> bool:
    """Whether a converter has a resolution, or a limit that outputs alone do not tell as their noise is read too."""
    return bool(loop.input_step or loop.output_step or (loop.noise and loop.input_limit < math.inf))


def _place_signals(plant: Plant, scene: Scene, time_step: float) -> tuple[tuple[_Wiring, ...], int]:
    """Give the loops' signals their places among states and raw values; return the number of states too."""
    loops = scene.loops
    controllers = [_linear_part(loop) for loop in loops]
    n_driven = [len(loop.driven) for loop in loops]
    held, n = _slices(len(plant.matrices[0]), n_driven)
    own, n = _slices(n, [len(controller.A) for controller in controllers])
    waiting, n = _slices(n, [c.delay * driven for c, driven in zip(controllers, n_driven, strict=True)])
    before, n = _slices(n, [driven if plant.settling.any() else 0 for driven in n_driven])
    seen, n_seen = _slices(0, [loop.n_channels for loop in loops])
    computed, _ = _slices(n_seen, n_driven)
    outputs, _ = _slices(0, n_driven)
    wirings = [
        _Wiring(
            loop,
            controllers[k],
            law=deepcopy(loop.controller.law) if isinstance(loop.controller, PythonController) else None,
            period=samples_per_period(loop, time_step),
            measured=[scene.outputs.index(name) for name in loop.measured],
            held=held[k],
            own=own[k],
            waiting=waiting[k],
            before=before[k],
            seen=seen[k],
            computed=computed[k],
            outputs=outputs[k],
        )
        for k, loop in enumerate(loops)
    ]
    return tuple(wirings), n


def _linear_part(loop: Loop) -> Controller:
    """Return a loop's linear controller; one without states and gains for a controller in Python."""
    given = loop.controller
    if isinstance(given, Controller):
        return loop.law
    n_in, n_out = len(loop.measured), len(loop.driven)
    nothing = np.zeros((0, 0)), np.zeros((0, n_in)), np.zeros((n_out, 0)), np.zeros((n_out, n_in))
    return Controller(*nothing, given.sample_rate, given.delay, given.limit)


def each(matrix: Array, rows: Array) -> Array:
    """Multiply a matrix, (n, m), with each of some rows, (k, m), by itself: no digit of one depends on the others.

    Returns:
        The products, (k, n).
    """
    return np.matmul(matrix, rows[:, :, None])[:, :, 0]


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


def _slices(start: int, sizes: Sequence[int]) -> tuple[list[slice], int]:
    """Return consecutive slices of given sizes, and where they end."""
    bounds = [start, *(start + int(size) for size in np.cumsum(sizes))]
    return [slice(first, end) for first, end in pairwise(bounds)], bounds[-1]
