"""Blocks of samples of a plant with its loops against the same sample by sample, loop by loop."""

import tracemalloc
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from nassim.scene.loop import Loop
from nassim.simulation.linear import sample_blocks
from nassim.simulation.linear.sample_blocks import TOGETHER, BlockSteps, SampleBlocks, pieces
from nassim.simulation.linear.sampled_closed_loop import Plant, connect_loops
from nassim.simulation.model.digital_controllers import RunningControllers
from nassim.systems.controllers import Controller

RATE = 1000.0
OUTPUTS = ("a", "b", "c")


def plant(seed=0, n=5, n_in=2, size=0.97):
    """A stable sampled plant with three outputs that all show the inputs; commands drive the inputs."""
    random = np.random.default_rng(seed)
    a = random.normal(size=(n, n))
    a *= size / np.abs(np.linalg.eigvals(a)).max()
    matrices = a, random.normal(size=(n, n_in)), random.normal(size=(3, n)), random.normal(size=(3, n_in))
    pushed, shown = random.normal(size=(n, n_in)), 0.1 * random.normal(size=(3, n_in))
    return Plant(matrices, pushed, shown, np.zeros_like(shown))


def controller(seed, n, n_out=1, n_in=1, *, every=1, **options):
    random = np.random.default_rng(seed)
    a = np.diag(random.uniform(-0.5, 0.9, n))
    gains = (0.02 * random.normal(size=shape) for shape in ((n, n_in), (n_out, n), (n_out, n_in)))
    return Controller(a, *gains, RATE / every, **options)


def scene(*loops):
    driven = tuple(name for loop in loops for name in loop.driven)
    return SimpleNamespace(loops=loops, inputs=(), outputs=OUTPUTS, commands=driven)


def sample_by_sample(plant, loops, inputs, start):
    """As the docstring of `Plant` says, each controller for itself."""
    (a, b, c, d), x = plant.matrices, start
    before = np.zeros(plant.pushed.shape[1])
    controllers, held, rows = [RunningControllers(loop) for loop in loops], np.zeros(plant.pushed.shape[1]), []
    for k, u in enumerate(inputs.T):
        settled = c @ x + d @ u + plant.shown @ held
        changes, commands, place = plant.settling * (held - before) / 2, held.copy(), 0
        y, seen = settled.copy(), settled + changes.sum(axis=1)
        for loop, step in zip(loops, controllers, strict=True):
            own = slice(place, place := place + len(loop.driven))
            if k % round(RATE / loop.controller.sample_rate) == 0:
                y += changes[:, own].sum(axis=1)
                commands[own] = step(seen[[OUTPUTS.index(name) for name in loop.measured]])[0]
                before[own] = held[own]
        held = commands
        rows.append(np.concatenate([y, held]))
        x = a @ x + b @ u + plant.pushed @ held
    return np.array(rows)


def run(plant, loops, inputs, start, block):
    """In blocks that grow up to a length, which are the same one by one to the last bit."""
    closed = connect_loops(plant, scene(*loops), 1 / RATE)
    blocks, rows, begins = SampleBlocks(closed, block, growth=2), [], []
    for begin, (*before, _), found in pieces(blocks, start, inputs):  # the last state is after the piece
        states = np.array(before)
        block = len(found) // len(states)
        assert len(found) == block * len(states)
        begins.append(begin)
        rows.append(found)
        if plant.settling.any():
            continue
        # A block's first sample follows from the state when it begins.
        outputs = states[:, : len(start)] @ plant.matrices[2].T
        outputs += states[:, len(start) : len(start) + plant.pushed.shape[1]] @ plant.shown.T
        firsts = np.array([inputs[:, k] for k in range(begin, begin + len(found), block) if k < inputs.shape[1]])
        np.testing.assert_allclose(
            found[::block, :3][: len(firsts)], outputs[: len(firsts)] + firsts @ plant.matrices[3].T, atol=1e-10
        )
    assert begins == [0, *np.cumsum([len(found) for found in rows])[:-1]]
    found = np.concatenate(rows)[: inputs.shape[1]]
    steps = BlockSteps(SampleBlocks(closed, block, growth=2), start, inputs[:, 0])
    one_by_one = [steps.row]
    for now in inputs.T[1:]:
        steps.step(now)
        one_by_one.append(steps.row)
    np.testing.assert_array_equal(one_by_one, found)
    return found


def compare(loops, n_samples, block=8, *, size=1.0, start=True, seed=0, settling=0.0):
    here, n = plant(seed), len(scene(*loops).commands)
    shown = here.shown[:, :n]
    here = replace(here, pushed=here.pushed[:, :n], shown=shown, settling=settling * shown)
    random = np.random.default_rng(9)
    inputs, at_start = size * random.normal(size=(2, n_samples)), start * random.normal(size=5)
    expected = sample_by_sample(here, loops, inputs, at_start)
    found = run(here, loops, inputs, at_start, block)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-11 * np.abs(expected).max())
    return expected


TWO = (
    Loop("slow", controller(1, 2, every=2, delay=1), "a", "u"),
    Loop("fast", controller(2, 1, n_in=2, every=1, delay=3), ("b", "c"), "v"),
)


@pytest.mark.parametrize("n_samples", [1, 7, 8, 9, 64, 8 * TOGETHER, 8 * TOGETHER + 1, 8 * TOGETHER + 37])
@pytest.mark.parametrize("loops", [(), TWO])
def test_blocks_are_their_samples(loops, n_samples):
    compare(loops, n_samples)


def test_blocks_of_more_outputs_than_go_in_one_product_are_their_samples(monkeypatch):
    monkeypatch.setattr(sample_blocks, "ROWS", 2)
    compare(TWO, 37)


@pytest.mark.parametrize("delay", [0, 1, 4])
@pytest.mark.parametrize("every", [(1, 1), (1, 4), (2, 3)])
def test_loops_of_several_rates_and_delays(every, delay):
    """Blocks hold a whole number of periods after which all loops are due together."""
    loops = (
        Loop("one", controller(3, 0, every=every[0], delay=delay), "a", "u"),
        Loop("two", controller(4, 3, every=every[1], delay=0), "b", "v"),
    )
    compare(loops, 101, block=12)


@pytest.mark.parametrize("limit", [np.inf, 1e-3])
@pytest.mark.parametrize("every", [(1, 1), (2, 1), (2, 6)])
def test_samples_show_what_quasi_static_modes_make_of_the_last_two_commands(every, limit):
    """At its own samples 3/2 of the last command less 1/2 of the one before, between them the last."""
    loops = (
        Loop("slow", controller(1, 2, every=every[0], delay=1, limit=limit), "a", "u"),
        Loop("fast", controller(2, 1, n_in=2, every=every[1]), ("b", "c"), "v"),
    )
    compare(loops, 101, block=12, settling=np.array([[0.7], [1.0], [0.4]]))


@pytest.mark.parametrize("every", [(7, 1), (17, 19)])
def test_loops_keep_their_turn_from_piece_to_piece(every):
    """Periods longer than a block, and pieces without a whole period: of 323 samples, too many to go in blocks."""
    loops = (
        replace(TWO[0], controller=controller(1, 2, every=every[0])),
        replace(TWO[1], controller=controller(2, 1, n_in=2, every=every[1])),
    )
    compare(loops, 190, block=5)


@pytest.mark.parametrize("kind", ["input", "command", "waiting"])
@pytest.mark.parametrize("size", [0.3, 1.0, 30.0])
def test_limits_met_inside_blocks(kind, size):
    """Rarely, now and then, and nearly always; a command beyond its limit may still wait when the block ends."""
    delay = {"input": 0, "command": 0, "waiting": 5}[kind]
    first = controller(1, 2, every=2, delay=delay, limit=np.inf if kind == "input" else 0.05)
    loops = (replace(TWO[0], controller=first, input_limit=4.0 if kind == "input" else np.inf), TWO[1])
    rows = compare(loops, 600, size=size)
    most, bound = (np.abs(rows[:, 0]), 4.0) if kind == "input" else (np.abs(rows[:, 3]), 0.05 * (1 - 1e-9))
    assert (most >= bound).any() == (size > 0.3)


def test_a_limit_met_at_one_sample_only():
    """The input is struck once, in the midst of a block; what was before and after is as linear as ever."""
    here = plant()
    loop = Loop("p", controller(5, 1, delay=2, limit=1e-3), "a", "u", input_limit=3.0)
    here = replace(here, pushed=here.pushed[:, :1], shown=here.shown[:, :1])
    for struck in (0, 7, 8, 12, 15, 16, 39):
        inputs = np.zeros((2, 40))
        inputs[:, struck] = 50.0
        expected = sample_by_sample(here, (loop,), inputs, np.zeros(5))
        assert np.isclose(np.abs(expected[:, 3]).max(initial=0.0), 1e-3) == (struck < 38)
        np.testing.assert_allclose(run(here, (loop,), inputs, np.zeros(5), 8), expected, atol=1e-11)


@pytest.mark.parametrize("every", [1, 3])
def test_converters_with_a_resolution(every):
    """Those of one loop only: the other goes on as if it had none."""
    coarse = replace(TWO[0], controller=controller(1, 2, every=every, limit=0.02), input_step=0.3, input_limit=2.0)
    rows = compare((replace(coarse, output_step=1e-3), TWO[1]), 200)
    assert np.allclose(rows[:, 3] / 1e-3, np.round(rows[:, 3] / 1e-3), atol=1e-9)
    assert np.ptp(rows[:, 4]) > 0


def test_loops_that_overflow_do_so_in_time():
    """A gain of 1e30 takes a block's matrices beyond all numbers, but not the samples before."""
    here = plant(size=0.5)
    loop = Loop("p", Controller(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1e30]], RATE), "a", "u")
    here = replace(here, pushed=here.pushed[:, :1], shown=0 * here.shown[:, :1])
    closed = connect_loops(here, scene(loop), 1 / RATE)
    with np.errstate(all="ignore"):
        _, _, rows = next(pieces(SampleBlocks(closed, growth=0), np.zeros(5), np.eye(2, 64)))
        expected = sample_by_sample(here, (loop,), np.eye(2, 64), np.zeros(5))
    np.testing.assert_allclose(rows[:5], expected[:5], rtol=1e-9)
    assert np.isfinite(rows[:5]).all()


def test_memory_does_not_grow_with_the_run():
    """Beside its inputs and outputs a run holds a piece of itself."""
    closed, inputs = connect_loops(plant(size=0.9), scene(*TWO), 1 / RATE), np.ones((2, 400_000))
    tracemalloc.start()
    last = sum(len(rows) for *_, rows in pieces(SampleBlocks(closed), np.zeros(5), inputs))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert last >= 400_000
    assert peak < inputs.nbytes
