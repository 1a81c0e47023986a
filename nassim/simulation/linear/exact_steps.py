"""Exact discrete-time solution of scenes in small motion about rest or a steady rotation, without step-size error.

With the inputs held or running straight between samples, the matrix exponential gives the state of the next sample.
Known functions of time, the constant one of loads and the sines of gravity in a frame that rotates, are states of their
own and exact too. Blocks of samples are computed by one product of matrices each. Loops are part of the blocks as long
as their controllers stay within limits, where they are linear. A block in which a value meets a limit continues sample
by sample from there. Scenes whose converters have a resolution or whose controllers are in Python are computed sample
by sample.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.progress import Advance, silent
from nassim.scene.scene import Scene
from nassim.simulation.linear.linearization import released_state, state_space, steady_state
from nassim.simulation.linear.sample_blocks import BlockSteps, SampleBlocks, pieces, take_samples
from nassim.simulation.linear.sampled_closed_loop import ClosedSteps, Plant, connect_loops
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.digital_controllers import BadCommand
from nassim.simulation.model.modal_model import ModalModel
from nassim.simulation.model.reach import find_reach
from nassim.simulation.model.runaway import runaway, see_runaway
from nassim.simulation.model.signals import Signals
from nassim.simulation.model.steady_rotation import KNOWN_AT_REST
from nassim.simulation.model.stopped_runs import Stopped, ValidSamples
from nassim.systems.state_space import discretize_generated, quasi_static, settling_response

CHECKS = 200
"""How often all coordinates of a run are checked, at the first samples of blocks."""
Pieces = Iterator[tuple[int, Array, Array]]
"""Pieces of a run, as `pieces` yields them."""


@np.errstate(over="ignore", invalid="ignore")  # where a loop runs away, which raises an error of its own
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
    """Find the response of an assembled scene from rest in its equilibrium under its loads, or released.

    Args:
        assembly: the scene, with the effect of its loads.
        inputs: shape (inputs, n_samples).
        time_step: [s].
        hold_order: 0 for inputs that keep each sample's value until the next, 1 for inputs that run straight.
        released: whether the scene starts unloaded.
        kept: numbers of samples, ascending, to return all coordinates of.
        advance: called with the number of steps done.

    Returns the outputs, shape (outputs, n_samples), the loops' commands, shape (commands, n_samples), and all
    coordinates at some 200 times and at the kept samples, shape (n_all, n_times) each.

    Raises:
        Stopped: when a loop runs away, and when a controller in Python fails.
    """
    plant, start, risen, all_coordinates = discrete_plant(assembly, time_step, hold_order, released)
    closed = connect_loops(plant, assembly.scene, time_step)
    n_samples, n_out = inputs.shape[1], len(plant.shown)
    due = 0.0
    # With inputs that run straight, a state less its share of their present value needs that of the next no more.
    start = start - risen @ inputs[:, 0]
    rows = np.empty((n_out + len(assembly.scene.commands), n_samples))
    read = _reader(assembly.scene, closed, risen, all_coordinates)
    seen, at_kept, valid = [], [], ValidSamples()
    reach = find_reach(assembly, inputs, time_step) if assembly.scene.loops else None
    for begin, states, found in _with_record(pieces(SampleBlocks(closed), start, inputs), rows, valid):
        end, block = min(n_samples, begin + len(found)), len(found) // len(states)
        rows[:, begin:end] = found[: end - begin].T
        checked = []
        for now in range(begin, end, block):
            if now >= due:
                due = now + n_samples / CHECKS
                checked.append(now)
        seen.append(read(states[(np.array(checked, dtype=int) - begin) // block], inputs[:, checked].T))
        if reach:
            for now, values in zip(checked, seen[-1], strict=True):
                happened, sound = see_runaway(assembly.coordinates, reach, values, now)
                valid.check(now, valid=sound)
                if happened:
                    said = runaway(assembly.scene, happened, rows[:n_out, : now + 1].T, time_step)
                    raise Stopped(said, rows[:, : now + 1], valid.last)
        wanted = [sample for sample in kept if begin <= sample < end]
        for k in sorted({(sample - begin) // block for sample in wanted}):
            now = begin + k * block
            places = [sample - now for sample in wanted if now <= sample < now + block]
            between = states[k, None]
            if places[-1]:
                between = closed.by_samples(states[k], take_samples(inputs, now, now + places[-1]), now)[0]
            at_kept.append(read(between[places], inputs[:, [now + place for place in places]].T))
        advance(end - max(begin, 1))  # to the first sample leads no step
    all_kept = np.vstack([np.zeros((0, assembly.coordinates.size)), *at_kept])
    return rows[:n_out], rows[n_out:], np.vstack(seen).T, all_kept.T


def _with_record(
    found: Iterator[tuple[int, Array, Array]], rows: Array, valid: ValidSamples
) -> Iterator[tuple[int, Array, Array]]:
    """Yield the pieces of a run; raise Stopped with the rows until then where a controller in Python fails."""
    try:
        yield from found
    except BadCommand as bad:
        rows[:, bad.sample - len(bad.rows) : bad.sample] = bad.rows.T
        raise Stopped(str(bad), rows[:, : bad.sample], valid.last) from bad.__cause__


class ExactSteps:
    """Exact steps of an assembled scene, one by one: the same to the last bit as by `exact_response`."""

    def __init__(self, assembly: Assembly, inputs: Array, time_step: float, *, hold_order: int, released: bool) -> None:
        """Start in equilibrium under gravity, or released.

        Args:
            assembly: the scene.
            inputs: at the start, shape (inputs,).
            time_step: [s].
            hold_order: see `exact_response`.
            released: see `exact_response`.
        """
        plant, start, risen, all_coordinates = discrete_plant(assembly, time_step, hold_order, released)
        closed = connect_loops(plant, assembly.scene, time_step)
        self._read = _reader(assembly.scene, closed, risen, all_coordinates)
        start = start - risen @ inputs
        try:
            self._steps = BlockSteps(SampleBlocks(closed), start, inputs)
        except BadCommand as bad:
            raise _stopped(bad) from bad.__cause__

    @property
    def row(self) -> Array:
        """Outputs and commands now, shape (outputs + commands,)."""
        return self._steps.row

    @property
    def count(self) -> int:
        """Number of steps done."""
        return self._steps.count

    def step(self, inputs: Array) -> None:
        """Go on by a step to these inputs, shape (inputs,)."""
        try:
            self._steps.step(inputs)
        except BadCommand as bad:
            raise _stopped(bad) from bad.__cause__

    def coordinates(self, *, now: bool) -> tuple[int, Array]:
        """Find all coordinates now, or at the last sample whose state is known without more steps.

        Returns:
            The number of the sample, and the coordinates, shape (n_all,).
        """
        steps = self._steps
        sample, state = (steps.count, steps.present_state()) if now else steps.last_state()
        return sample, self._read(state[None], steps.given(sample)[None])[0]

    @property
    def state(self) -> Any:
        """A copy of all that changes from step to step."""
        return self._steps.saved

    def restore(self, state: Any) -> None:
        """Go back to a state."""
        self._steps.restore(state)


def _stopped(bad: BadCommand) -> Stopped:
    """Make the exception of a run in which a controller in Python fails, without readings."""
    return Stopped(str(bad), np.zeros((0, 0)), 0)


def discrete_plant(
    assembly: Assembly, h: float, hold_order: int, released: bool
) -> tuple[Plant, Array, Array, tuple[Array, Array]]:
    """Discretise a scene without its loops.

    Known functions of time, such as the constant one of loads, are the last states: they obey z' = S z. For
    hold_order 1, where x_1 = P x_0 + G u_0 + H (u_1 - u_0), the state is x - H u. Quasi-static modes have no states:
    see `nassim.systems.sampled`.

    Args:
        assembly: the scene.
        h: time step [s].
        hold_order: see `exact_response`.
        released: see `exact_response`.

    Returns:
        The plant, the states x at the start, (n,), the matrix H, (n, inputs), and all coordinates per unit of the
        states, (n_all, n), and of the inputs, (n_all, inputs).
    """
    scene, modal, n_in = assembly.scene, assembly.modal, len(assembly.scene.inputs)
    state, drives, readings, feedthrough = state_space(assembly)
    generator, known = assembly.rotation.known if assembly.rotation else KNOWN_AT_REST
    start = released_state(assembly, state) if released else steady_state(assembly, state, drives[:, n_in:])
    by_states, by_inputs = _all_coordinates(modal, assembly.signals, *drives.shape)
    if not np.any(drives[:, n_in:]) and not np.any(feedthrough[:, n_in:]):
        generator, known = np.zeros((0, 0)), np.zeros(0)
        drives, feedthrough, by_inputs = drives[:, :n_in], feedthrough[:, :n_in], by_inputs[:, :n_in]
    n = 2 * len(modal.frequency)
    fast = np.zeros(len(state), dtype=bool)
    fast[:n] = np.tile(_quasi_static_modes(scene, modal, h), 2)
    start = start[~fast]
    state, drives, kept, taken = quasi_static(state, drives, fast)
    readings, settling = readings @ kept, readings @ taken
    by_states, by_inputs = by_states @ kept, by_inputs + by_states @ taken

    phi, held, risen = _discretize(state, drives, generator, h)
    readings = np.hstack([readings, feedthrough[:, n_in:] + settling[:, n_in:]])
    by_states, start = np.hstack([by_states, by_inputs[:, n_in:]]), np.concatenate([start, known])
    feedthrough, settling, by_inputs = feedthrough[:, :n_in], settling[:, :n_in], by_inputs[:, :n_in]
    driven = [scene.inputs.index(name) for loop in scene.loops for name in loop.driven]
    pushed, shown = held[:, driven], (feedthrough + settling)[:, driven]
    followed = np.where(feedthrough == 0, settling, 0.0)[:, driven]
    if hold_order == 1:
        matrices = phi, held - risen + phi @ risen, readings, feedthrough + settling + readings @ risen
    else:
        matrices = settling_response((phi, held, readings, feedthrough), settling)
        more = len(matrices[0]) - len(phi)
        start, pushed = np.pad(start, (0, more)), np.pad(pushed, ((0, more), (0, 0)))
        risen, by_states = np.zeros_like(matrices[1]), np.pad(by_states, ((0, 0), (0, more)))
    return Plant(matrices, pushed, shown, followed), start, risen, (by_states, by_inputs)


def _discretize(state: Array, drives: Array, generator: Array, h: float) -> tuple[Array, Array, Array]:
    """Discretise a system whose last inputs are known functions of time, which become its last states.

    Args:
        state: A, (n, n).
        drives: B, (n, inputs + known).
        generator: S of the known functions z' = S z, (known, known).
        h: time step [s].

    Returns:
        P, G and H of x_1 = P x_0 + G u_0 + H (u_1 - u_0) with the known functions among the states, of n + known rows.
    """
    n, n_known = len(state), len(generator)
    n_in = drives.shape[1] - n_known
    ramps = np.kron([[0.0, 1.0], [0.0, 0.0]], np.eye(n_in))
    given = np.hstack([drives[:, :n_in], np.zeros((n, n_in)), drives[:, n_in:]])
    phi, driven = discretize_generated(state, given, scipy.linalg.block_diag(ramps, h * generator), h)
    held, risen, by_known = np.split(driven, [n_in, 2 * n_in], axis=1)
    still = np.zeros((n_known, n_in))
    step = scipy.linalg.expm(h * generator) if n_known else generator  # SciPy before 1.14 takes no empty matrix
    whole = np.block([[phi, by_known], [np.zeros((n_known, n)), step]])
    return whole, np.vstack([held, still]), np.vstack([risen, still])


def _quasi_static_modes(scene: Scene, modal: ModalModel, time_step: float) -> Array:
    """Return the modes that the mesh does not support and that would alias at a sample rate of the run, bool (n,)."""
    rates = [1 / time_step, *(loop.controller.sample_rate for loop in scene.loops)]
    result: Array = modal.unsupported & (modal.frequency > min(rates) / 2)
    return result


def _all_coordinates(modal: ModalModel, signals: Signals, n_states: int, n_inputs: int) -> tuple[Array, Array]:
    """Return all coordinates per unit of the states of `state_space`, (n_all, n_states), and of its inputs."""
    modes, drives = modal.modes, signals.prescribed
    plain = n_states - sum(len(system[0]) for system in signals.filters.values())
    by_states = np.zeros((len(modes), n_states))
    by_states[:, :plain] = drives.residual @ drives.by_states(plain)
    by_states[:, : modes.shape[1]] += modes
    return by_states, drives.residual @ drives.by_inputs(n_inputs)


def _reader(
    scene: Scene, closed: ClosedSteps, risen: Array, all_coordinates: tuple[Array, Array]
) -> Callable[[Array, Array], Array]:
    """Return a function of k states, (k, n), and inputs there, (k, inputs), that gives all coordinates, (k, n_all)."""
    (by_scene, by_inputs), n = all_coordinates, len(risen)
    driven = [scene.inputs.index(name) for loop in scene.loops for name in loop.driven]
    by_states = np.zeros((len(by_scene), closed.n))
    by_states[:, :n], by_states[:, n : n + len(driven)] = by_scene, by_inputs[:, driven]  # commands that are held
    by_inputs = by_inputs + by_scene @ risen
    return lambda states, inputs: states @ by_states.T + inputs @ by_inputs.T
