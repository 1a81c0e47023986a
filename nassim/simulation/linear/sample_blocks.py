"""Blocks of samples: a scene with its loops over several samples as one linear system, and steps beyond its limits.

A block's outputs are the product of a matrix with the state at its start and all its inputs. Each sample has rows of
its own in that matrix, whose entries for later inputs are zero. So a sample has the same value to the last bit whether
later inputs of its block are known or not, and a run in blocks equals its steps one by one.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.simulation.linear.sampled_closed_loop import ClosedSteps, each
from nassim.systems.state_space import StateSpace, repeat_step

BLOCK = 64
"""Largest number of samples in a block; up to 4 times as many for loops with a longer common period."""
GROWTH = 64
"""Least ratio of the samples before a block to its length, so runs of any length have many blocks."""
TOGETHER = 64
"""Largest number of blocks that are computed together. Short linear blocks may be more, with `SAMPLES` samples."""
SAMPLES = 4096
"""Number of samples of short blocks that are computed together."""
ROWS = 24
"""Largest number of rows of a product that gives the outputs of several samples."""
MATRICES = 10
"""Matrices of all states that a scene with its controllers keeps, about."""
CALLS = 16_000
"""Number of multiplications that take as long as the function calls per block."""
SPARSE_STATES, SPARSE = 200, 0.1
"""A matrix with this number of states or more and a smaller share of nonzero entries is stored as sparse."""


@dataclass(frozen=True)
class SampleBlock:
    """Linear system of several samples.

    Attributes:
        size: number of samples.
        state: state after the block per unit of the state before, (n, n), dense or sparse.
        inputs: the same per unit of the inputs of all samples, (n, size * inputs).
        rows: outputs and commands per unit of the state and these inputs, (size / m, m rows, n + size inputs), for m
            samples at a time: one product of a small matrix takes hardly longer than its call.
    """

    size: int
    state: Array
    inputs: Array
    rows: Array

    def after(self, state: Array, inputs: Array) -> Array:
        """Find the state after the block, (n,), from that before, (n,), and all its inputs, (size, inputs)."""
        result: Array = each(self.inputs, inputs.reshape(1, -1))[0]
        result += self.state @ state
        return result

    def sample(self, k: int, begin: Array) -> Array:
        """Find outputs and commands of sample k, (rows,).

        Args:
            k: number of the sample in the block.
            begin: state before the block and all its inputs, (n + size inputs,); inputs after sample k do not count.
        """
        together = self.size // len(self.rows)
        rows = np.matmul(self.rows[k // together], begin[:, None])
        return rows.reshape(together, -1)[k % together]

    def several(self, state: Array, inputs: Array) -> tuple[Array, Array]:
        """Run several of these blocks.

        Args:
            state: before the first, (n,).
            inputs: shape (blocks, size, inputs).

        Returns:
            States before the blocks and after them, (blocks + 1, n); outputs and commands, (blocks, size, rows).
        """
        given = inputs.reshape(len(inputs), -1)
        states = np.empty((len(inputs) + 1, len(state)))
        states[0], states[1:] = state, each(self.inputs, given)
        for k in range(len(inputs)):
            states[k + 1] += self.state @ states[k]
        begins = np.hstack([states[:-1], given])
        rows = np.matmul(self.rows, begins[:, None, :, None])
        return states, rows.reshape(len(inputs), self.size, -1)


class SampleBlocks:
    """The blocks of a run: at which sample which length, and each length as a linear system.

    Attributes:
        closed: the scene with its controllers.
        first: length of the first blocks.
        longest: length of the longest.
    """

    def __init__(self, closed: ClosedSteps, longest: int = BLOCK, growth: int = GROWTH) -> None:
        """Make the blocks of a run.

        Args:
            closed: the scene with its controllers.
            longest: most samples in a block, but for loops that are due together more rarely.
            growth: see `GROWTH`.
        """
        outputs, n_in = len(closed.plant.matrices[3]) + closed.plant.pushed.shape[1], closed.through.shape[1]
        self.closed, self._growth = closed, growth
        self.first = closed.period if closed.period <= 4 * BLOCK else 1
        # The longer a block, the more inputs act on each of its samples, and the fewer calls and products of states.
        self.longest = min(longest, int(np.sqrt((CALLS + closed.n**2) / (outputs * n_in + 1))))
        if closed.by_law:  # so no controller is called twice for one sample
            self.first = self.longest = 1
        self._systems: dict[int, StateSpace] = {}
        self._blocks: dict[int, SampleBlock | None] = {}

    @property
    def memory(self) -> int:
        """Memory of the blocks made so far and of the matrices of which they are made, about [bytes]."""
        blocks = [block for block in self._blocks.values() if block]
        return 8 * MATRICES * self.closed.n**2 + sum(block.inputs.nbytes + block.rows.nbytes for block in blocks)

    def size(self, sample: int) -> int:
        """Return the length of the block that begins at a sample."""
        size = self.first
        while 2 * size <= self.longest and self._growth * 2 * size <= sample:
            size *= 2
        return size

    def alike(self, sample: int) -> int:
        """Count the blocks from a sample on that are as long as the one that begins there, as many as go together."""
        size = self.size(sample)
        most = TOGETHER if self.closed.nonlinear else max(TOGETHER, SAMPLES // size)
        last = self._growth * 2 * size
        return most if 2 * size > self.longest else min(most, -(-(last - sample) // size))

    @np.errstate(over="ignore", invalid="ignore")
    def system(self, size: int) -> SampleBlock | None:
        """Return the linear system of a block; None where it is not linear, and where loops make numbers overflow."""
        if size not in self._blocks:
            closed = self.closed
            linear = not closed.nonlinear and size % closed.period == 0
            self._blocks[size] = _as_block(size, self._system(size)) if linear else None
        return self._blocks[size]

    def _system(self, size: int) -> StateSpace:
        if size not in self._systems:
            once = size == self.first
            self._systems = {size: self.closed.linear() if once else repeat_step(self._system(size // 2), 2)}
        return self._systems[size]


def _as_block(size: int, system: StateSpace) -> SampleBlock | None:
    a, b, c, d = system
    if not all(np.isfinite(part).all() for part in system):
        return None
    sparse = len(a) >= SPARSE_STATES and np.count_nonzero(a) < SPARSE * a.size
    n_rows = len(c) // size
    most = max(1, ROWS // max(1, n_rows))
    together = math.gcd(size, 2 ** (most.bit_length() - 1))
    rows = np.hstack([c, d]).reshape(size // together, together * n_rows, len(a) + b.shape[1])
    return SampleBlock(size, scipy.sparse.csr_matrix(a) if sparse else a, b, rows)


def take_samples(inputs: Array, begin: int, end: int) -> Array:
    """Return samples of inputs, (end - begin, inputs): those given, then zeros."""
    result = np.zeros((end - begin, len(inputs)))
    part = inputs[:, begin:end].T
    result[: len(part)] = part
    return result


def pieces(blocks: SampleBlocks, start: Array, inputs: Array, *, begin: int = 0) -> Iterator[tuple[int, Array, Array]]:
    """Run through given inputs piece by piece, each of blocks of one length.

    Args:
        blocks: of the run.
        start: state of the scene at the first sample; controllers whose states it lacks are at rest.
        inputs: shape (inputs, n_samples).
        begin: number of the first sample, a multiple of the loops' common period.

    Yields:
        The number of a piece's first sample; states when its blocks begin and after the last, (blocks + 1, n); outputs
        and commands, (k, rows).
    """
    closed = blocks.closed
    state = np.concatenate([start, np.zeros(closed.n - len(start))])
    together, n_samples = SAMPLES, inputs.shape[1]
    while begin < n_samples:
        size = blocks.size(begin)
        count = min(together, blocks.alike(begin), -(-(n_samples - begin) // size))
        pushes = take_samples(inputs, begin, begin + count * size).reshape(count, size, len(inputs))
        system, good = blocks.system(size), 0
        if system:
            states, rows = system.several(state, pushes)
            within = closed.within_limits(rows)
            whole = np.all(within, axis=1) & closed.waits_within_limits(states[1:])
            good = count if whole.all() else int(np.argmin(whole))
            if good:
                yield begin, states[: good + 1], rows[:good].reshape(good * size, -1)
                state, begin = states[good], begin + good * size
        if good < count:
            again = pushes.reshape(count * size, -1) if system is None else pushes[good]
            after, found = closed.by_samples(state, again, begin)
            if system:  # until a limit is met the block's samples stay, as steps one by one have them
                linear = size if within[good].all() else int(np.argmin(within[good]))
                found[:linear] = rows[good, :linear]
            yield begin, after[::size], found
            state, begin = after[-1], begin + len(again)
        together = SAMPLES if system is None else 1 if good < count else 2 * together


class BlockSteps:
    """A run in blocks whose inputs come one by one, with the same values as by `pieces`.

    Attributes:
        count: number of the present sample.
        row: outputs and commands now, (rows,).
    """

    def __init__(self, blocks: SampleBlocks, start: Array, inputs: Array, *, begin: int = 0) -> None:
        """Begin a run.

        Args:
            blocks: of the run.
            start: state of the scene at the first sample; controllers whose states it lacks are at rest.
            inputs: those at the first sample, (inputs,).
            begin: number of the first sample, a multiple of the loops' common period.
        """
        self.closed, self._blocks = blocks.closed, blocks
        self.count = begin
        self._begin(np.concatenate([start, np.zeros(self.closed.n - len(start))]))
        self._sample(inputs)

    def _begin(self, state: Array) -> None:
        """Begin a block in a state."""
        size, n_in = self._blocks.size(self.count), self.closed.through.shape[1]
        self._first, self._state, self._system = self.count, state, self._blocks.system(size)
        self._hold(np.concatenate([state, np.zeros(size * n_in)]))
        self._now: Array | None = None if self._system else state  # where samples are not those of a linear block
        self._next = state

    def _hold(self, values: Array) -> None:
        """Keep the state before the present block and its inputs, (n + size inputs,)."""
        self._values = values
        self._inputs = values[self.closed.n :].reshape(-1, self.closed.through.shape[1])

    def step(self, inputs: Array) -> None:
        """Go on by a step to these inputs, (inputs,)."""
        k = self.count - self._first
        self.count += 1
        if k + 1 == len(self._inputs):
            self._begin(self.following_state())
        else:
            self._now = None if self._now is None else self._next
        self._sample(inputs)

    def following_state(self) -> Array:
        """Return the state after the present block, (n,), at its last sample."""
        if self._now is not None:
            return self._next
        assert self._system
        after = self._system.after(self._state, self._inputs)
        if not self.closed.waits_within_limits(after):
            after = self.closed.by_samples(self._state, self._inputs, self._first)[0][-1]
        return after

    def _sample(self, inputs: Array) -> None:
        k, closed = self.count - self._first, self.closed
        self._inputs[k] = inputs
        if self._system and self._now is None:
            self.row = self._system.sample(k, self._values)
            if not closed.limited or closed.within_limits(self.row):
                return
        begin = 0 if self._now is None else k
        state = self._state if self._now is None else self._now
        states, rows = closed.by_samples(state, self._inputs[begin : k + 1], self._first + begin)
        self._now, self._next, self.row = states[-2], states[-1], rows[-1]

    def last_state(self) -> tuple[int, Array]:
        """Return the last sample whose state is known without more steps, in a linear block its first, and the state.

        The state has the shape (n,).
        """
        return (self._first, self._state) if self._now is None else (self.count, self._now)

    def given(self, sample: int) -> Array:
        """Return the inputs given at a sample of the present block, (inputs,)."""
        return self._inputs[sample - self._first]

    def present_state(self) -> Array:
        """Return the state now, (n,), found again from the start of the block."""
        if self._now is not None:
            return self._now
        k = self.count - self._first
        return self.closed.by_samples(self._state, self._inputs[:k], self._first)[0][-1] if k else self._state

    @property
    def saved(self) -> Any:
        """A copy of all that changes from step to step."""
        block = self._first, self._state, self._system, self._values.copy(), self._now, self._next
        return self.count, self.row, block, self.closed.laws

    def restore(self, saved: Any) -> None:
        """Go back to a state."""
        self.count, self.row, block, laws = saved
        self._first, self._state, self._system, values, self._now, self._next = block
        self._hold(values.copy())
        if laws:
            self.closed = self.closed.with_laws(laws)
