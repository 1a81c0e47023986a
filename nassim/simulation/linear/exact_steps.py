"""Exact discrete-time solution of scenes in small motion, without any step-size error.

With the inputs held or running straight between samples, the state goes from sample to sample by its matrix
exponential. Blocks of samples go by one product of matrices each, with loops too as long as their controllers stay
within limits, where they are linear. A block in which a limit is met goes sample by sample, and so does all where a
converter has a resolution or a controller is in Python.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.progress import Advance, silent
from nassim.scene.scene import Scene
from nassim.simulation.linear.digital_controllers import BadCommand, runaway, see_runaway
from nassim.simulation.linear.linearization import state_space
from nassim.simulation.linear.sampled_closed_loop import ClosedSteps, Plant, closed_steps
from nassim.simulation.linear.stopped_runs import Stopped, Trust
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.modal_model import ModalModel
from nassim.simulation.model.reach import find_reach
from nassim.simulation.model.signals import Signals
from nassim.simulation.model.tangents import NO_EQUILIBRIUM
from nassim.systems.state_space import StateSpace, discretize, quasi_static, repeat_step, settling_response

CHECKS = 200
"""Blocks at least, where the run has so many samples: all coordinates are looked at when one begins."""
BLOCK = 64
"""Most samples in a block, but for loops that are due together more rarely, up to 4 times as many."""
TOGETHER = 64
"""Most blocks that one product of matrices takes."""
ENTRIES = 2_000_000
"""Most entries of the matrix that takes a block's inputs to its outputs."""
MANY, SPARSE = 200, 0.1
"""States from which on, and share of entries below which a matrix is held as sparse, as that of uncoupled modes."""
NEUTRAL = 1e-9
"""Share of all weight that a free motion may feel by rounding."""


@np.errstate(over="ignore", invalid="ignore")  # where a loop runs away, which is told in words
def exact_response(
    assembly: Assembly,
    inputs: Array,
    time_step: float,
    *,
    hold_order: int = 1,
    released: bool = False,
    kept: Sequence[int] = (),
    advance: Advance = silent,
) -> tuple[Array, Array, Array, Array]:
    """Find the response of an assembled scene from rest in its equilibrium under gravity, or released.

    Args:
        assembly: the scene.
        inputs: shape (inputs, n_samples).
        time_step: [s].
        hold_order: 0 for inputs that keep each sample's value until the next, 1 for inputs that run straight.
        released: whether the scene starts unloaded.
        kept: numbers of samples, ascending, to return all coordinates of.
        advance: called with the number of steps done.

    Returns the outputs, shape (outputs, n_samples), the loops' commands, shape (commands, n_samples), and all
    coordinates at some 200 times and at the kept samples, shape (n_all, n_times) each.

    Raises:
        RuntimeError: when gravity does work on a free motion.
        Stopped: when a loop runs away, and when a controller in Python fails.
    """
    plant, start, risen, all_coordinates = _plant(assembly, time_step, hold_order, released)
    closed = closed_steps(plant, assembly.scene, time_step)
    n_samples, n_out = inputs.shape[1], len(plant.shown)
    block = _block(closed, n_samples)
    stride = -(-n_samples // (block * CHECKS))
    # With inputs that run straight, a state less its share of their present value needs that of the next no more.
    n_in = risen.shape[1]
    start = start - risen @ _samples(inputs, 0, 1, n_in)[0]
    rows = np.empty((n_out + len(assembly.scene.commands), n_samples))
    read = _reader(assembly.scene, closed, risen, inputs, all_coordinates)
    seen, at_kept, trust = [], [], Trust()
    reach = find_reach(assembly, inputs, time_step) if assembly.scene.loops else None
    for begin, states, found in _told(pieces(closed, start, inputs, block), rows, trust):
        end = min(n_samples, begin + len(found))
        rows[:, begin:end] = found[: end - begin].T
        for k in range(-(begin // block) % stride, len(states), stride):
            now = begin + k * block
            seen.append(read(states[k, None], now)[0])
            if reach:
                happened, sound = see_runaway(assembly.coordinates, reach, seen[-1], now)
                trust.see(now, sound=sound)
                if happened:
                    said = runaway(assembly.scene, happened, rows[:n_out, : now + 1].T, time_step)
                    raise Stopped(said, rows[:, : now + 1], trust.sample)
        wanted = [sample for sample in kept if begin <= sample < end]
        for k in sorted({(sample - begin) // block for sample in wanted}):
            now = begin + k * block
            places = [sample - now for sample in wanted if now <= sample < now + block]
            between = states[k, None]
            if places[-1]:
                between = closed.by_samples(states[k], _samples(inputs, now, now + places[-1] + 1, n_in), now)[0][:-1]
            at_kept.append(read(between, now)[places])
        advance(end - max(begin, 1))  # to the first sample leads no step
    all_kept = np.vstack([np.zeros((0, assembly.coordinates.size)), *at_kept])
    return rows[:n_out], rows[n_out:], np.array(seen).T, all_kept.T


def _told(found: Iterator[tuple[int, Array, Array]], rows: Array, trust: Trust) -> Iterator[tuple[int, Array, Array]]:
    """Pieces of a run until a controller in Python fails, which raises Stopped with the rows until then."""
    try:
        yield from found
    except BadCommand as bad:
        rows[:, bad.sample - len(bad.rows) : bad.sample] = bad.rows.T
        raise Stopped(str(bad), rows[:, : bad.sample], trust.sample) from bad.__cause__


class ExactSteps:
    """Exact steps of an assembled scene, one by one.

    Attributes:
        row: outputs and commands now, shape (outputs + commands,).
        count: number of steps done.
    """

    def __init__(self, assembly: Assembly, inputs: Array, time_step: float, *, hold_order: int, released: bool) -> None:
        """Start in equilibrium under gravity, or released.

        Args:
            assembly: the scene.
            inputs: at the start, shape (inputs,).
            time_step: [s].
            hold_order: see `exact_response`.
            released: see `exact_response`.
        """
        plant, start, self._risen, every = _plant(assembly, time_step, hold_order, released)
        self.assembly, self._every, self.count = assembly, every, 0
        self._closed = closed_steps(plant, assembly.scene, time_step)
        start = start - self._risen @ self._beside(inputs)
        self._now = np.concatenate([start, np.zeros(self._closed.n - len(start))])
        self._sample(inputs)

    def _beside(self, inputs: Array) -> Array:
        """Inputs, and gravity's where there is one."""
        return np.append(inputs, np.ones(self._risen.shape[1] - len(inputs)))

    def _sample(self, inputs: Array) -> None:
        self._inputs = inputs
        try:
            states, rows = self._closed.by_samples(self._now, self._beside(inputs)[None], self.count)
        except BadCommand as bad:
            raise Stopped(str(bad), np.zeros((0, 0)), 0) from bad.__cause__
        self._next, self.row = states[1], rows[0]

    def step(self, inputs: Array) -> None:
        """Go on by a step to these inputs, shape (inputs,)."""
        self._now, self.count = self._next, self.count + 1
        self._sample(inputs)

    def coordinates(self) -> Array:
        """All coordinates now, shape (n_all,)."""
        read = _reader(self.assembly.scene, self._closed, self._risen, self._inputs[:, None], self._every)
        result: Array = read(self._now[None], 0)[0]
        return result

    @property
    def state(self) -> Any:
        """A copy of all that changes from step to step."""
        return self.count, self._now, self._next, self._inputs, self.row, self._closed.laws

    def restore(self, state: Any) -> None:
        """Go back to a state."""
        self.count, self._now, self._next, self._inputs, self.row, laws = state
        self._closed = self._closed.with_laws(laws)


def _plant(
    assembly: Assembly, h: float, hold_order: int, released: bool
) -> tuple[Plant, Array, Array, tuple[Array, Array]]:
    """A scene from sample to sample, its state at the start, and what the inputs' present value adds to a state.

    Gravity, where it acts, is the last input, of one. For hold_order 1, x_1 = P x_0 + G u_0 + H (u_1 - u_0), the state
    is x - H u. Quasi-static modes are no states: see `nassim.systems.sampled`.

    Returns also all coordinates per unit of the states x, (n_all, n), and of the inputs beside, (n_all, inputs).
    """
    scene, modal, weight = assembly.scene, assembly.modal, assembly.signals.weight
    state, drives, readings, feedthrough = state_space(assembly)
    by_states, by_inputs = _all_coordinates(modal, assembly.signals, *drives.shape)
    if not np.any(weight):
        drives, feedthrough, by_inputs = drives[:, :-1], feedthrough[:, :-1], by_inputs[:, :-1]
    n = 2 * len(modal.frequency)
    fast, held_by_stiffness = np.zeros(len(state), dtype=bool), np.ones(len(state), dtype=bool)
    fast[:n], held_by_stiffness[:n] = np.tile(_quasi_static_modes(scene, modal, h), 2), np.tile(~modal.rigid_modes, 2)
    state, drives, kept, taken = quasi_static(state, drives, fast)
    readings, settling = readings @ kept, readings @ taken
    by_states, by_inputs = by_states @ kept, by_inputs + by_states @ taken
    start = np.zeros(len(state))
    if np.any(weight) and not released:
        _check_equilibrium(assembly)
        part = held_by_stiffness[~fast]
        start[part] = np.linalg.solve(state[np.ix_(part, part)], -drives[part, -1])
    phi, held, risen = discretize(state, drives, h)
    driven = [scene.inputs.index(name) for loop in scene.loops for name in loop.driven]
    pushed, shown = held[:, driven], (feedthrough + settling)[:, driven]
    followed = np.where(feedthrough == 0, settling, 0.0)[:, driven]
    if hold_order == 1:
        matrices = phi, held - risen + phi @ risen, readings, feedthrough + settling + readings @ risen
    else:
        constant = np.arange(len(drives.T)) >= len(scene.inputs)
        at_once, late = np.where(constant, settling, 0.0), np.where(constant, 0.0, settling)
        matrices = settling_response((phi, held, readings, feedthrough + at_once), late)
        more = len(matrices[0]) - len(phi)
        start, pushed = np.pad(start, (0, more)), np.pad(pushed, ((0, more), (0, 0)))
        risen, by_states = np.zeros_like(matrices[1]), np.pad(by_states, ((0, 0), (0, more)))
    return Plant(matrices, pushed, shown, followed), start, risen, (by_states, by_inputs)


def _quasi_static_modes(scene: Scene, modal: ModalModel, time_step: float) -> Array:
    """Modes that nobody answers for and that would fold, at the time steps or at the samples of a loop, bool (n,)."""
    rates = [1 / time_step, *(loop.controller.sample_rate for loop in scene.loops)]
    result: Array = modal.unsupported & (modal.frequency > min(rates) / 2)
    return result


def _all_coordinates(modal: ModalModel, signals: Signals, n_states: int, n_inputs: int) -> tuple[Array, Array]:
    """All coordinates per unit of the states of `state_space`, (n_all, n_states), and of its inputs beside."""
    modes, following = modal.modes, signals.prescribed
    plain = n_states - sum(len(system[0]) for system in signals.filters.values())
    by_states = np.zeros((len(modes), n_states))
    by_states[:, :plain] = following.beyond @ following.lagging(plain)
    by_states[:, : modes.shape[1]] += modes
    return by_states, following.beyond @ following.taken(n_inputs)


def _reader(
    scene: Scene, closed: ClosedSteps, risen: Array, inputs: Array, all_coordinates: tuple[Array, Array]
) -> Callable[[Array, int], Array]:
    """A function of states (k, n), of the scene with its controllers, from a sample on: all coordinates, (k, n_all)."""
    (by_scene, by_inputs), (n, n_in) = all_coordinates, risen.shape
    driven = [scene.inputs.index(name) for loop in scene.loops for name in loop.driven]
    by_states = np.zeros((len(by_scene), closed.n))
    by_states[:, :n], by_states[:, n : n + len(driven)] = by_scene, by_inputs[:, driven]  # commands that are held
    by_inputs = by_inputs + by_scene @ risen
    return lambda states, first: states @ by_states.T + _samples(inputs, first, first + len(states), n_in) @ by_inputs.T


def _check_equilibrium(assembly: Assembly) -> None:
    """RuntimeError when gravity does work on a free motion; where it does none, equilibrium is neutral."""
    modes = assembly.modal.modes[:, assembly.modal.rigid_modes]
    moving = [body for body in assembly.scene.bodies if body.name in assembly.coordinates.slices]
    mass = sum(body.rigid_inertia[0] for body in moving)
    # Of unit modal mass, no motion can feel more than all masses falling together.
    most = np.sqrt(mass) * float(np.linalg.norm(assembly.scene.gravity))
    if np.abs(modes.T @ assembly.signals.weight).max(initial=0.0) > NEUTRAL * most:
        raise RuntimeError(NO_EQUILIBRIUM)


def _samples(inputs: Array, begin: int, end: int, n: int) -> Array:
    """Samples of n inputs, (end - begin, n): those given, zero after the last; beyond, gravity's one."""
    result = np.zeros((end - begin, n))
    part = inputs[:, begin:end].T
    result[: len(part), : len(inputs)], result[:, len(inputs) :] = part, 1.0
    return result


def _block(closed: ClosedSteps, n_samples: int) -> int:
    """Samples in a block: a whole number of periods, unless these are too long."""
    if closed.by_law:
        return 1  # every state is then seen without asking a controller twice
    rows = len(closed.plant.matrices[3]) + closed.plant.pushed.shape[1]
    longest = min(BLOCK, n_samples // CHECKS, int(np.sqrt(ENTRIES / (rows * closed.through.shape[1] + 1))))
    periods = max(1, longest // closed.period)
    return periods * closed.period if closed.period <= 4 * BLOCK else max(1, longest)


def pieces(closed: ClosedSteps, start: Array, inputs: Array, block: int) -> Iterator[tuple[int, Array, Array]]:
    """Pieces of a run: its first sample, states when its blocks begin, (blocks, n), outputs and commands, (k, rows)."""
    whole = _whole(closed, block)
    state = np.concatenate([start, np.zeros(closed.n - len(start))])
    begin, together = 0, TOGETHER
    while begin < inputs.shape[1]:
        together = min(together, -(-(inputs.shape[1] - begin) // block))
        pushes = _samples(inputs, begin, begin + together * block, closed.through.shape[1])
        good = 0
        if whole is not None:
            states, rows = _in_blocks(whole, state, pushes.reshape(together, -1))
            rows = rows.reshape(together, block, -1)
            good = closed.within_limits(states[1:], rows)
            if good:
                yield begin, states[:good], rows[:good].reshape(good * block, -1)
                state, begin = states[good], begin + good * block
        if good < together:
            again = pushes[good * block :] if whole is None else pushes[good * block : (good + 1) * block]
            states, rows = closed.by_samples(state, again, begin)
            yield begin, states[:-1:block], rows
            state, begin = states[-1], begin + len(again)
        together = TOGETHER if whole is None else 1 if good < together else min(2 * together, TOGETHER)


def _whole(closed: ClosedSteps, block: int) -> StateSpace | None:
    """A block of samples as one, None where that is not linear, and where loops make numbers overflow."""
    if closed.nonlinear or block % closed.period:
        return None
    a, b, c, d = whole = repeat_step(closed.linear(), block // closed.period)
    if not all(np.isfinite(part).all() for part in whole):
        return None
    sparse = len(a) >= MANY and np.count_nonzero(a) < SPARSE * a.size
    return scipy.sparse.csr_matrix(a) if sparse else a, b, c, d


def _in_blocks(whole: StateSpace, start: Array, pushes: Array) -> tuple[Array, Array]:
    """States at the starts of blocks and after them, (blocks + 1, n); all their outputs, (blocks, outputs of a block).

    pushes: the inputs of all samples, (blocks, inputs of a block)
    """
    a, b, c, d = whole
    states = np.empty((len(pushes) + 1, len(start)))
    states[0] = start
    states[1:] = pushes @ b.T
    for k in range(len(pushes)):
        states[k + 1] += a @ states[k]
    return states, states[:-1] @ c.T + pushes @ d.T
