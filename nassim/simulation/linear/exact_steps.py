"""Exact discrete-time solution of scenes in small motion about rest or a steady rotation, without step-size error.

With inputs that are held or linear between samples, the matrix exponential gives the state of the next sample.
Known functions of time, the constant one of loads and the sines of gravity in a frame that rotates, are states of their
own and exact too. Blocks of samples are computed by one product of matrices each. Loops are part of the blocks as long
as their controllers stay within limits, where they are linear. A block in which a value meets a limit continues sample
by sample from there. Scenes whose converters have a resolution or whose controllers are in Python are computed sample
by sample.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.progress import Advance, silent
from nassim.simulation.linear.sample_blocks import BlockSteps, SampleBlocks, pieces, take_samples
from nassim.simulation.linear.sampled_closed_loop import ClosedSteps, Plant, connect_loops
from nassim.simulation.linear.scene_state_space import released_state, state_space, steady_state
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.digital_controllers import BadCommand
from nassim.simulation.model.modal_model import ModalModel
from nassim.simulation.model.reach import find_reach
from nassim.simulation.model.runaway import runaway, see_runaway
from nassim.simulation.model.signals import Signals
from nassim.simulation.model.stopped_runs import CHECKS, Stopped, ValidSamples
from nassim.systems.state_space import StateSpace, discretize_generated, quasi_static, settling_response


@dataclass(frozen=True)
class Stretch:
    """One model of a run with its loops, in discrete time.

    Attributes:
        closed: the scene with its controllers.
        start: states of the scene at the start, with those of known functions, (n,).
        risen: matrix H, (n, inputs), of inputs u that are linear between samples: the state is x - H u, so that a step
            needs no input of the next sample. Zero for inputs that are held.
        kept: whether each state of `state_space` is among these, bool; those of quasi-static modes are not.
        by_states: all coordinates per unit of all states, (n_all, closed.n).
        by_inputs: all coordinates per unit of the inputs, (n_all, inputs).
        reference: coordinates about which the motion is, (k, n_all), as a function of the numbers of k samples; None:
            zero.
    """

    closed: ClosedSteps
    start: Array
    risen: Array
    kept: Array
    by_states: Array
    by_inputs: Array
    reference: Callable[[Array], Array] | None = None

    def coordinates(self, states: Array, inputs: Array, samples: Array) -> Array:
        """Return all coordinates, (k, n_all), at states, (k, n), inputs, (k, inputs), and numbers of samples, (k,)."""
        result: Array = states @ self.by_states.T + inputs @ self.by_inputs.T
        return result if self.reference is None else result + self.reference(samples)


@dataclass(frozen=True)
class Piece:
    """Blocks of a run that have one length, as `pieces` yields them, with their model.

    Attributes:
        begin: number of the first sample.
        states: states when the blocks begin and after the last, (blocks + 1, n).
        rows: outputs and commands, (k, rows).
        model: the model.
    """

    begin: int
    states: Array
    rows: Array
    model: Stretch

    @property
    def block(self) -> int:
        """Number of samples in a block."""
        return len(self.rows) // (len(self.states) - 1)

    def coordinates_at_blocks(self, samples: Sequence[int], inputs: Array) -> Array:
        """Return all coordinates, (k, n_all), at samples where blocks begin.

        Args:
            samples: their numbers.
            inputs: all inputs of the run, (inputs, n_samples).
        """
        at = np.array(samples, dtype=int)
        return self.model.coordinates(self.states[(at - self.begin) // self.block], inputs[:, at].T, at)

    def coordinates_within(self, samples: Sequence[int], inputs: Array) -> Iterator[Array]:
        """Yield all coordinates, (k, n_all), at any ascending samples, block by block; arguments as above."""
        blocks = (np.array(samples, dtype=int) - self.begin) // self.block
        for k in np.unique(blocks).tolist():
            now, states = self.begin + k * self.block, self.states[k, None]
            at = np.array(samples)[blocks == k]
            if at[-1] > now:
                states = self.model.closed.by_samples(states[0], take_samples(inputs, now, int(at[-1])), now)[0]
            yield self.model.coordinates(states[at - now], inputs[:, at].T, at)


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
        hold_order: 0 for inputs that keep each sample's value until the next, 1 for inputs that are linear between.
        released: whether the scene starts unloaded.
        kept: numbers of samples, ascending, to return all coordinates of.
        advance: called with the number of steps done.

    Returns:
        Outputs, (outputs, n_samples); the loops' commands, (commands, n_samples); and all coordinates at some 200 times
        and at the kept samples, (n_all, n_times) each.

    Raises:
        Stopped: when a loop runs away, and when a controller in Python fails.
    """
    one = make_stretch(assembly, time_step, hold_order, released=released)
    start = one.start - one.risen @ inputs[:, 0]
    found = (Piece(*piece, one) for piece in pieces(SampleBlocks(one.closed), start, inputs))
    return collect(assembly, found, inputs, inputs, time_step, kept=kept, advance=advance)


@np.errstate(over="ignore", invalid="ignore")  # where a loop runs away, which raises an error of its own
def collect(
    assembly: Assembly,
    found: Iterator[Piece],
    inputs: Array,
    given: Array,
    time_step: float,
    *,
    kept: Sequence[int] = (),
    advance: Advance = silent,
) -> tuple[Array, Array, Array, Array]:
    """Collect the pieces of a run, and check that no loop runs away; arguments and returned values as `exact_response`.

    Args:
        assembly: the scene at the start.
        found: pieces of the run.
        inputs: all inputs of its models, (all inputs, n_samples).
        given: those of the scene, (inputs, n_samples).
        time_step: [s].
        kept: numbers of samples, ascending, to return all coordinates of.
        advance: called with the number of steps done.
    """
    n_samples, n_out, due = inputs.shape[1], len(assembly.scene.outputs), 0.0
    rows = np.empty((n_out + len(assembly.scene.commands), n_samples))
    seen: list[Array] = []
    at_kept: list[Array] = []
    valid = ValidSamples()
    reach = find_reach(assembly, given, time_step) if assembly.scene.loops else None
    for piece in _with_record(found, rows, valid):
        begin, end = piece.begin, min(n_samples, piece.begin + len(piece.rows))
        rows[:, begin:end] = piece.rows[: end - begin].T
        checked = []
        for now in range(begin, end, piece.block):
            if now >= due:
                due = now + n_samples / CHECKS
                checked.append(now)
        seen.append(piece.coordinates_at_blocks(checked, inputs))
        if reach:
            for now, coordinates in zip(checked, seen[-1], strict=True):
                happened, sound = see_runaway(assembly.coordinates, reach, coordinates, now)
                valid.check(now, valid=sound)
                if happened:
                    said = runaway(assembly.scene, happened, rows[:n_out, : now + 1].T, time_step)
                    raise Stopped(said, rows[:, : now + 1], valid.last)
        at_kept += piece.coordinates_within([sample for sample in kept if begin <= sample < end], inputs)
        advance(end - max(begin, 1))  # no step leads to the first sample
    all_kept = np.vstack([np.zeros((0, assembly.coordinates.size)), *at_kept])
    return rows[:n_out], rows[n_out:], np.vstack(seen).T, all_kept.T


def _with_record(found: Iterator[Piece], rows: Array, valid: ValidSamples) -> Iterator[Piece]:
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
        self._model = make_stretch(assembly, time_step, hold_order, released=released)
        start = self._model.start - self._model.risen @ inputs
        self._steps = BlockSteps(SampleBlocks(self._model.closed), start, inputs)

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
        self._steps.step(inputs)

    def coordinates(self, *, now: bool) -> tuple[int, Array]:
        """Find all coordinates now, or at the last sample whose state is known without more steps.

        Returns:
            The number of the sample, and the coordinates, shape (n_all,).
        """
        steps = self._steps
        sample, state = (steps.count, steps.present_state()) if now else steps.last_state()
        return sample, self._model.coordinates(state[None], steps.given(sample)[None], np.array([sample]))[0]

    @property
    def state(self) -> Any:
        """A copy of all that changes from step to step."""
        return self._steps.saved

    def restore(self, state: Any) -> None:
        """Go back to a state."""
        self._steps.restore(state)


def make_stretch(
    assembly: Assembly, h: float, hold_order: int, *, released: bool = False, system: StateSpace | None = None
) -> Stretch:
    """Discretise a scene and connect its loops.

    Known functions of time, such as the constant one of loads, are the last states: they obey z' = S z. For
    hold_order 1, where x_1 = P x_0 + G u_0 + H (u_1 - u_0), the state is x - H u. Quasi-static modes have no states:
    see `nassim.systems.sampled`.

    Args:
        assembly: the scene.
        h: time step [s].
        hold_order: see `exact_response`.
        released: see `exact_response`.
        system: A, B, C and D as of `state_space`; None: those of the assembly.

    Returns:
        The model.

    Raises:
        ValueError: for sample rates that do not fit the time step.
    """
    scene, modal, n_in = assembly.scene, assembly.modal, assembly.signals.input_matrix.shape[1]
    state, drives, readings, feedthrough = state_space(assembly) if system is None else system
    generator, known = assembly.known
    start = released_state(assembly, state) if released else steady_state(assembly, state, drives[:, n_in:])
    by_states, by_inputs = _all_coordinates(modal, assembly.signals, *drives.shape)
    by_inputs[:, n_in] += assembly.offset
    if not np.any(drives[:, n_in:]) and not np.any(feedthrough[:, n_in:]):
        generator, known = np.zeros((0, 0)), np.zeros(0)
        drives, feedthrough, by_inputs = drives[:, :n_in], feedthrough[:, :n_in], by_inputs[:, :n_in]
    fast = quasi_static_states(assembly, h, len(state))
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
    closed = connect_loops(Plant(matrices, pushed, shown, followed), scene, h)
    by_all = np.zeros((len(by_states), closed.n))
    by_all[:, : len(risen)] = by_states
    by_all[:, len(risen) : len(risen) + len(driven)] = by_inputs[:, driven]  # commands that are held
    return Stretch(closed, start, risen, ~fast, by_all, by_inputs + by_states @ risen)


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


def quasi_static_states(assembly: Assembly, time_step: float, n_states: int) -> Array:
    """Return the states of modes that the mesh does not support and that would alias at a sample rate of the run, bool.

    Args:
        assembly: the scene.
        time_step: [s]; infinite for all modes that the mesh does not support.
        n_states: number of states of `state_space`.
    """
    modal, result = assembly.modal, np.zeros(n_states, dtype=bool)
    rates = [1 / time_step, *(loop.controller.sample_rate for loop in assembly.scene.loops)]
    modes = modal.unsupported & (modal.frequency > min(rates) / 2)
    result[: 2 * len(modes)] = np.tile(modes, 2)
    return result


def _all_coordinates(modal: ModalModel, signals: Signals, n_states: int, n_inputs: int) -> tuple[Array, Array]:
    """Return all coordinates per unit of the states of `state_space`, (n_all, n_states), and of its inputs."""
    modes, drives = modal.modes, signals.prescribed
    plain = n_states - sum(len(system[0]) for system in signals.filters.values())
    by_states = np.zeros((len(modes), n_states))
    by_states[:, :plain] = drives.residual @ drives.by_states(plain)
    by_states[:, : modes.shape[1]] += modes
    return by_states, drives.residual @ drives.by_inputs(n_inputs)
