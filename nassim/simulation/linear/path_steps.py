"""Exact steps along the path of a drive: a sequence of models, each of which holds near an angle and a speed.

The path is the spline through the samples of its input. Its inertia forces, weights and readings are known functions of
time and act as inputs beside those of the scene; between samples they are linear as these are.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from scipy.interpolate import CubicSpline

from nassim.base.checks import Array
from nassim.base.progress import Advance, silent
from nassim.simulation.linear.exact_steps import ExactSteps, Piece, Stretch, collect, make_stretch, quasi_static_states
from nassim.simulation.linear.path_changes import path_changes
from nassim.simulation.linear.sample_blocks import BlockSteps, SampleBlocks, pieces
from nassim.simulation.linear.scene_state_space import state_space
from nassim.simulation.loaded.path_curves import PathSpline
from nassim.simulation.loaded.path_models import PathModels
from nassim.simulation.loaded.path_readings import path_readings
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.digital_controllers import samples_per_period
from nassim.systems.state_space import StateSpace

SPEED_CHANGE = 0.002
"""Change of the speed over the lowest angular frequency, and of the acceleration over its square, within a model."""
LONGEST = 64
"""Largest number of samples between which the model may change."""
MEMORY = 2**30
"""Memory of the models that a run keeps for when its path comes by again, about [bytes]."""
KEPT = 1e-9
"""Size of a known force over that of the largest below which it is left out."""


Key = tuple[int, int, int, int]
"""Angle of assembly and number of the model about it, see `PathModels.nearest`, numbers of speed and acceleration."""


@dataclass(frozen=True)
class Path:
    """The path of a drive at the samples of a run.

    Attributes:
        angle: angle, (n,) [rad].
        speed: its first derivative, (n,) [rad/s].
        acceleration: its second derivative, (n,) [rad/s2].
    """

    angle: Array
    speed: Array
    acceleration: Array

    @classmethod
    def of(cls, angle: Array, time_step: float) -> "Path":
        """Join the samples of a drive's input, (n,) [rad], by a cubic spline."""
        time = np.arange(len(angle)) * time_step
        spline = CubicSpline(time, angle)
        return cls(angle, spline(time, 1), spline(time, 2))


@dataclass(frozen=True)
class Passed:
    """State of a run where it passes from one model to another.

    Attributes:
        index: angle of assembly, whose modes the state is along.
        whole: states of `state_space` of the scene that changes, (n,), with those of quasi-static modes.
        others: states of controllers, (k,).
    """

    index: int
    whole: Array
    others: Array


class PathRun:
    """A run along a path: its models, known inputs and state at the start."""

    def __init__(self, models: PathModels, angle: Array, time_step: float, *, hold_order: int, released: bool) -> None:
        """Prepare a run.

        Args:
            models: models along the path.
            angle: samples of the path, (n,) [rad].
            time_step: [s].
            hold_order: 0 or 1, see `nassim.simulation.linear.exact_steps.exact_response`.
            released: whether the scene starts unloaded.
        """
        self.models, self.path, self.time_step = models, Path.of(angle, time_step), time_step
        self._hold_order, self._released = hold_order, released
        self._made: dict[Key, tuple[Stretch, SampleBlocks]] = {}
        self._changes: dict[Key, Array] = {}
        self._systems: dict[Key, StateSpace] = {}
        self._assemblies: dict[tuple[int, int, int], Assembly] = {}
        lowest = 2 * np.pi * float(models.knots[0].assembly.modal.frequency[0])
        self._steps = SPEED_CHANGE * lowest, SPEED_CHANGE * lowest**2

    @cached_property
    def _courses(self) -> Array:
        """Factors of the three static displacements at the samples, (n, 3): one, squared speed and acceleration."""
        return np.column_stack([np.ones_like(self.path.speed), self.path.speed**2, self.path.acceleration])

    @cached_property
    def bent(self) -> tuple[Array, Array, Array]:
        """Amplitudes of the static displacement x0 at the samples, and two derivatives in time, (n, r) each."""
        value = np.einsum("tj,tjr->tr", self._courses, self.models.bent[1].at(self.path.angle))
        first = np.gradient(value, self.time_step, axis=0)
        second = np.zeros_like(value)
        second[1:-1] = np.diff(value, 2, axis=0) / self.time_step**2
        second[[0, -1]] = second[[1, -2]]
        return value, first, second

    @cached_property
    def known(self) -> tuple[Array, Array]:
        """Fields of the known forces on all coordinates and circuits, (n_all + circuits, k), and their values (n, k).

        They are what the motion about the static displacement x0 needs.
        """
        models, loads, shapes = self.models, self.models.loads, self.models.bent[0]
        mass, circuits = models.start.coordinates.mass, models.start.signals.circuits
        (value, first, second), (_, square, acceleration) = self.bent, self._courses.T[:, :, None]
        speed = self.path.speed[:, None]
        resisted, amplitudes = models.resisted
        stored = np.array([circuit.forces / circuit.storage for circuit in circuits]).reshape(len(circuits), len(mass))
        no_rate, no_force = np.zeros((len(circuits), shapes.shape[1])), np.zeros_like(shapes)
        terms = [  # forces on coordinates, rates of circuits, and their course in time
            (-mass @ shapes, no_rate, second),
            (no_force, -stored @ shapes, first),
            (-loads.gyroscopic @ shapes, no_rate, speed * first),
            (-loads.of_speed[0] @ shapes, no_rate, square * value),
            (-loads.of_acceleration[0] @ shapes, no_rate, acceleration * value),
            (
                -resisted,
                np.zeros((len(circuits), resisted.shape[1])),
                np.einsum("tjp,tj->tp", amplitudes.at(self.path.angle), np.hstack([first, speed * value])),
            ),
        ]
        forces, rates, courses = (np.hstack(parts) for parts in zip(*terms, strict=True))
        weights = np.concatenate([1 / models.start.coordinates.scale, np.ones(len(circuits))])
        return _compressed(np.vstack([forces, rates]), courses, weights)

    @cached_property
    def readings(self) -> Array:
        """Readings of the path and of the static displacement by the outputs, (n, outputs)."""
        models, path = self.models, self.path
        spline, slopes = path_readings(models)
        bent = np.array([knot.bent_readings for knot in models.knots])
        read = PathSpline.of(models.angles, bent, closed=models.closed).at(path.angle)
        rates = self.bent[1] @ (models.start.signals.velocity_matrix @ models.bent[0]).T
        result: Array = spline.at(path.angle) + np.outer(path.angle, slopes)
        return result + np.einsum("tj,tjo->to", self._courses, read) + rates

    @property
    def shown(self) -> list[int]:
        """Outputs that read the path or the static displacement."""
        return np.flatnonzero(np.any(self.readings, axis=0)).tolist()

    @cached_property
    def _courses_of_known(self) -> Array:
        """Values of the known inputs of the models, (known inputs, n)."""
        return np.vstack([self.known[1].T, self.readings[:, self.shown].T])

    def inputs(self, given: Array, begin: int = 0) -> Array:
        """Return all inputs of the models: those given, (inputs, n), without the drive of the path, and known ones.

        Args:
            given: inputs of the scene from a sample on.
            begin: number of that sample.
        """
        given = given.copy()
        prescribed = self.models.start.signals.prescribed
        given[prescribed.inputs[self.models.drive]] = 0.0
        return np.vstack([given, self._courses_of_known[:, begin : begin + given.shape[1]]])

    def displacement(self, samples: Array) -> Array:
        """Return static displacements at samples, (k,), on all coordinates, (k, n_all)."""
        return self.bent[0][samples] @ self.models.bent[0].T

    def model(self, key: Key) -> tuple[Stretch, SampleBlocks]:
        """Return the discrete-time system of a model, and its blocks; those used last are kept, see `MEMORY`."""
        self._made[key] = found = self._made.pop(key) if key in self._made else self._make(key)
        oldest = next(iter(self._made))
        if oldest != key and len(self._made) * self._made[oldest][1].memory > MEMORY:
            del self._made[oldest], self._changes[oldest]
        return found

    def _make(self, key: Key) -> tuple[Stretch, SampleBlocks]:
        index, step, speed, acceleration = key
        a, b, c, d = self._combined(key, self.models.weights(index, step))
        *slopes, turned_c, turned_d = self._combined(key, self.models.weight_slopes(index, step))
        assembly = self._assembly(index, speed, acceleration)
        self._changes[key] = changes = self._find_changes(key, (a, b), (slopes[0], slopes[1]))
        by_states, by_inputs = np.split(c @ changes, [len(a)], axis=1)
        c, d = np.vstack([c, turned_c + by_states]), np.vstack([d, turned_d + by_inputs])
        made = make_stretch(assembly, self.time_step, self._hold_order, system=(a, b, c, d))
        made = replace(made, reference=self.displacement)
        return made, SampleBlocks(made.closed, longest=self._block, growth=0)

    def _find_changes(self, key: Key, system: tuple[Array, Array], slopes: tuple[Array, Array]) -> Array:
        """Return `path_changes` of a model; quasi-static modes have no states that could ring."""
        (a, b), (index, _, speed, acceleration) = system, key
        result = np.zeros((len(a), len(a) + b.shape[1]))
        if not self.models.is_one:
            assembly = self._assembly(index, speed, acceleration)
            kept = np.flatnonzero(~quasi_static_states(assembly, self.time_step, len(a)))
            n = int(np.count_nonzero(kept < len(assembly.modal.frequency)))
            slowest = max(abs(speed), 0.5) * self._steps[0]
            duration = max(self.models.distance / slowest, self._block * self.time_step)
            within, driven = np.ix_(kept, kept), [*kept, *range(len(a), len(a) + b.shape[1])]
            changed = path_changes((a[within], b[kept]), (slopes[0][within], slopes[1][kept]), n, duration)
            result[np.ix_(kept, driven)] = changed
        return result

    def _combined(self, key: Key, weights: Mapping[int, float]) -> StateSpace:
        """Return the weighted sum of A, B, C and D at angles of assembly, along the modes of that of a model."""
        index, _, speed, acceleration = key
        parts = [(weight, self._system(k, index, speed, acceleration)) for k, weight in weights.items()]
        a, b, c, d = (np.sum([weight * system[k] for weight, system in parts], axis=0) for k in range(4))
        return a, b, c, d

    def _system(self, index: int, other: int, speed: int, acceleration: int) -> StateSpace:
        """Return A, B, C and D at an angle of assembly, along the modes of another one."""
        key = index, other, speed, acceleration
        if key not in self._systems:
            a, b, c, d = state_space(self._assembly(index, speed, acceleration))
            turn = self.models.transition(index, other)
            change = scipy.linalg.block_diag(turn, turn, np.eye(len(a) - 2 * len(turn)))
            self._systems[key] = change @ a @ change.T, change @ b, c @ change.T, d
        return self._systems[key]

    def _assembly(self, index: int, speed: int, acceleration: int) -> Assembly:
        """Return an assembly at an angle, a speed and an acceleration by their numbers, with the known inputs."""
        key = index, speed, acceleration
        if key not in self._assemblies:
            found = self.models.assembly(index, speed * self._steps[0], acceleration * self._steps[1])
            self._assemblies[key] = self._with_known(found)
        return self._assemblies[key]

    def _with_known(self, assembly: Assembly) -> Assembly:
        """Return an assembly whose signals have the known inputs too."""
        signals, (fields, _), shown = assembly.signals, self.known, self.shown
        size, n_known = assembly.coordinates.size, fields.shape[1] + len(shown)
        forces, charges = np.zeros((size, n_known)), np.zeros((len(signals.circuits), n_known))
        read = np.zeros((len(signals.output_matrix), n_known))
        forces[:, : fields.shape[1]], charges[:, : fields.shape[1]] = fields[:size], fields[size:]
        read[shown, fields.shape[1] + np.arange(len(shown))] = 1.0
        signals = replace(
            signals,
            input_matrix=np.hstack([signals.input_matrix, forces]),
            circuit_matrix=np.hstack([signals.circuit_matrix, charges]),
            feedthrough=np.hstack([signals.feedthrough, read]),
        )
        return replace(assembly, signals=signals)

    @cached_property
    def _block(self) -> int:
        """Number of samples between which the model may change: in fewer, no course passes more than one model."""
        path, models = self.path, self.models
        distance = np.inf if models.is_one else models.distance
        jerk = np.diff(path.acceleration, append=path.acceleration[-1]) / self.time_step
        courses = zip((path.speed, path.acceleration, jerk), (distance, *self._steps), strict=True)
        most = min(step / max(float(np.abs(rate).max()) * self.time_step, 1e-300) for rate, step in courses)
        block = math.lcm(*(samples_per_period(loop, self.time_step) for loop in models.start.scene.loops))
        while 2 * block <= min(LONGEST, most):
            block *= 2
        return block

    def _keys(self, n: int, block: int) -> list[tuple[int, int, Key]]:
        """Return the stretches of a run of n samples: first sample, end and model; starts are multiples of a block."""
        begins = np.arange(0, n, block)
        ends = np.minimum(begins + block, n - 1)
        angle, speed, acceleration = (
            0.5 * (course[begins] + course[ends])
            for course in (self.path.angle, self.path.speed, self.path.acceleration)
        )
        numbers = np.rint(speed / self._steps[0]), np.rint(acceleration / self._steps[1])
        bins = np.column_stack([*self.models.nearest(angle), *numbers]).astype(int)
        starts = np.flatnonzero(np.any(np.diff(bins, axis=0, prepend=bins[:1] - 1), axis=1))
        until = [*(starts[1:] * block).tolist(), n]
        return [(s * block, e, tuple(bins[s].tolist())) for s, e in zip(starts.tolist(), until, strict=True)]

    @cached_property
    def stretches(self) -> list[tuple[int, int, Key]]:
        """First sample, end and model of each stretch of the run."""
        return self._keys(len(self.path.angle), self._block)

    def pieces(self, inputs: Array) -> Iterator[Piece]:
        """Run through all inputs of the models, (all inputs, n), model by model."""
        passed = self.start(inputs[:, 0])
        for begin, end, key in self.stretches:
            model, blocks = self.model(key)
            state = self.enter(key, passed, inputs[:, begin], begin)
            for place, states, rows in pieces(blocks, state, inputs[:, :end], begin=begin):
                yield Piece(place, states, self.read(key, place, rows), model)
                state = states[-1]
            if end < inputs.shape[1]:
                passed = self.leave(key, state, inputs[:, end], end)

    def read(self, key: Key, begin: int, rows: Array) -> Array:
        """Return outputs and commands at the angles of the path, to first order about the angle of the model.

        Args:
            key: the model.
            begin: number of the first sample.
            rows: outputs, their derivatives with respect to the angle, and commands, (k, rows); those after the end of
                the path stay as they are.
        """
        angle = self.path.angle[begin : begin + len(rows)]
        apart = np.zeros((len(rows), 1))
        apart[: len(angle), 0] = self._apart(key, angle)
        n = len(self.models.start.scene.outputs)
        return np.hstack([rows[:, :n] + apart * rows[:, n : 2 * n], rows[:, 2 * n :]])

    def _apart(self, key: Key, angle: Array) -> Array:
        """Return by how much angles, (k,), exceed that of a model [rad]."""
        return (angle - self.models.angle(*key[:2]) + np.pi) % (2 * np.pi) - np.pi

    def _changed(self, key: Key, sample: int, inputs: Array) -> tuple[Array, Array]:
        """Return states of the scene at a sample per unit of those of a model, (n, n), and what inputs add, (n,)."""
        changes = self._apart(key, self.path.angle[sample]) * self._changes[key]
        by_states, by_inputs = np.split(changes, [len(changes)], axis=1)
        return np.eye(len(by_states)) + by_states, by_inputs[:, :-1] @ inputs

    def enter(self, key: Key, passed: Passed, inputs: Array, sample: int) -> Array:
        """Return the state of a model, (n,), from that between models.

        Args:
            key: the model.
            passed: state between models.
            inputs: all of the models at that sample, (all inputs,).
            sample: number of the sample.
        """
        (model, _), whole = self.model(key), passed.whole
        if key[0] != passed.index:
            turn = self.models.transition(passed.index, key[0])
            n, whole = len(turn), whole.copy()
            whole[:n], whole[n : 2 * n] = turn @ whole[:n], turn @ whole[n : 2 * n]
        turned, added = self._changed(key, sample, inputs)
        whole = np.linalg.solve(turned, whole - added)
        own = np.count_nonzero(model.kept)
        return np.concatenate([whole[model.kept] - model.risen[:own] @ inputs, passed.others])

    def leave(self, key: Key, state: Array, inputs: Array, sample: int) -> Passed:
        """Return the state between models from that of one; arguments as of `enter`."""
        model, _ = self.model(key)
        own, whole = np.count_nonzero(model.kept), np.zeros(len(model.kept))
        whole[model.kept] = state[:own] + model.risen[:own] @ inputs
        turned, added = self._changed(key, sample, inputs)
        return Passed(key[0], turned @ whole + added, state[own:])

    def start(self, inputs: Array) -> Passed:
        """Return the state at the start; inputs: all of the models, (all inputs,), whose values filters hold."""
        key = self.stretches[0][2]
        models, speed, mass = self.models, self.path.speed[0], self.models.start.coordinates.mass
        modes = models.knots[key[0]].modes
        a, b, *_ = state_space(self._assembly(key[0], *key[2:]))
        n, shapes, shown = modes.shape[1], models.bent[0], b.shape[1] - 1 - len(self.shown)
        at_rest = np.zeros(b.shape[1])
        at_rest[shown:-1] = inputs[shown:]
        # About the static displacement, the rotor's spin and dampers against the stator add to the stiffness; an
        # acceleration has not acted yet.
        steady = self._courses[0] * [1.0, 1.0, 0.0] @ models.bent[1].at(self.path.angle[:1])[0]
        push = b @ at_rest
        resisted = speed**2 * models.loads.of_speed[0] + speed * models.knots[key[0]].rotating_damping
        push[n : 2 * n] -= modes.T @ resisted @ shapes @ steady
        result: Array = -np.linalg.solve(a, push)
        held = shapes @ (steady * (not self._released) - self.bent[0][0])
        result[:n] = result[:n] * (not self._released) + modes.T @ mass @ held
        result[n : 2 * n] = -modes.T @ mass @ shapes @ self.bent[1][0]
        return Passed(key[0], result, np.zeros(0))


class PathSteps(ExactSteps):
    """Exact steps along a path, one by one: the same to the last bit as by `path_response`."""

    def __init__(self, run: PathRun, inputs: Array) -> None:
        """Start a run; inputs: of the scene at its start, (inputs,)."""
        self._run, self._place = run, 0
        known = self._known(inputs, 0)
        self._begin(run.start(known), known)

    def _known(self, inputs: Array, sample: int) -> Array:
        return self._run.inputs(inputs[:, None], sample)[:, 0]

    def _begin(self, passed: Passed, inputs: Array) -> None:
        """Begin the present stretch."""
        begin, _, key = self._run.stretches[self._place]
        self._model, blocks = self._run.model(key)
        self._steps = BlockSteps(blocks, self._run.enter(key, passed, inputs, begin), inputs, begin=begin)

    @property
    def row(self) -> Array:
        """Outputs and commands now, shape (outputs + commands,)."""
        key = self._run.stretches[self._place][2]
        return self._run.read(key, self.count, self._steps.row[None])[0]

    def step(self, inputs: Array) -> None:
        """Go on by a step to these inputs of the scene, shape (inputs,), until the end of the path."""
        sample, (_, end, key) = self.count + 1, self._run.stretches[self._place]
        known = self._known(inputs, sample)
        if sample < end:
            self._steps.step(known)
        else:
            passed = self._run.leave(key, self._steps.following_state(), known, sample)
            self._place += 1
            self._begin(passed, known)

    @property
    def state(self) -> Any:
        """A copy of all that changes from step to step."""
        return self._place, self._model, copy(self._steps), self._steps.saved

    def restore(self, state: Any) -> None:
        """Go back to a state."""
        self._place, self._model, steps, saved = state
        self._steps = copy(steps)
        self._steps.restore(saved)


def path_response(
    models: PathModels,
    inputs: Array,
    time_step: float,
    *,
    hold_order: int = 1,
    released: bool = False,
    kept: Sequence[int] = (),
    advance: Advance = silent,
) -> tuple[Array, Array, Array, Array]:
    """Find the response of a scene one of whose drives follows a path.

    Args:
        models: models along the path.
        inputs: shape (inputs, n_samples); the drive's is the path.
        time_step: [s].
        hold_order: see `nassim.simulation.linear.exact_steps.exact_response`.
        released: whether the scene starts unloaded.
        kept: numbers of samples, ascending, to return all coordinates of.
        advance: called with the number of steps done.

    Returns:
        Outputs, (outputs, n_samples); the loops' commands, (commands, n_samples); and all coordinates at some 200 times
        and at the kept samples, (n_all, n_times) each, along axes that turn with the rotor.

    Raises:
        Stopped: when a loop runs away.
    """
    place = models.start.signals.prescribed.inputs[models.drive]
    run = PathRun(models, inputs[place], time_step, hold_order=hold_order, released=released)
    whole = run.inputs(inputs)
    return collect(models.start, run.pieces(whole), whole, inputs, time_step, kept=kept, advance=advance)


def _compressed(fields: Array, values: Array, weights: Array) -> tuple[Array, Array]:
    """Return fewer fields, (m, k), and values, (n, k), with the same products; weights: of the fields' rows, (m,)."""
    largest = np.abs(values).max(axis=0, initial=0.0)
    left, sizes, right = np.linalg.svd(weights[:, None] * fields * largest, full_matrices=False)
    kept = sizes > KEPT * sizes.max(initial=0.0)
    scaled = np.divide(values, largest, out=np.zeros_like(values), where=largest > 0)
    return left[:, kept] * sizes[kept] / weights[:, None], scaled @ right[kept].T
