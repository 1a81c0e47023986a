"""What a digital controller does with every sample: convert, compute, saturate, wait, convert."""

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from nassim.base.checks import Array
from nassim.scene.loop import Loop
from nassim.scene.scene import Scene
from nassim.simulation.small_motion import Assembly, motion_size

RUNAWAY = 0.1
"""A deformation of this share of a body's size, or this rotation [rad], means that a loop runs away."""
WHOLE = 1.5 * 2.0**52
"""Added and taken away, it rounds a number to the nearest whole one, ties to even, and lets infinite ones pass."""


def samples_per_period(loop: Loop, time_step: float) -> int:
    """Time steps in one sample period of a loop; ValueError when that is not a whole number."""
    steps = 1 / (loop.controller.sample_rate * time_step)
    whole = round(steps)
    if whole < 1 or abs(steps - whole) > 1e-6 * whole:
        raise ValueError(
            f"loop {loop.name!r} samples at {loop.controller.sample_rate:g} Hz, every {steps:.6g} time steps of "
            f"{time_step:g} s; take time_step = {1 / loop.controller.sample_rate:g} s over a whole number"
        )
    return whole


def start_controller(loop: Loop) -> Callable[[Array], tuple[Array, Array]]:
    """A controller at rest: a function that takes the measured outputs at a sample, (measured,).

    It returns what the loop then adds to its inputs until the next sample, (driven,), and what from then on as far as
    that is known already: with a delay of at least one sample it is, without one it is taken as the same.
    """
    c = loop.controller
    see, put_out = converter(loop.input_step, loop.input_limit), converter(loop.output_step, c.limit)
    state = np.zeros(len(c.A))
    waiting = deque(np.zeros((c.delay, len(loop.driven))))

    def step(measured: Array) -> tuple[Array, Array]:
        nonlocal state
        seen = np.array([see(value) for value in measured.tolist()])
        computed = np.array([put_out(value) for value in (c.C @ state + c.D @ seen).tolist()])
        state = c.A @ state + c.B @ seen
        waiting.append(computed)
        now = waiting.popleft()
        return now, waiting[0] if waiting else now

    return step


def converter(step: float, limit: float) -> Callable[[float], float]:
    """What a converter of this resolution (0: none) and range makes of a value.

    For numbers, not arrays: a sample has few values, which NumPy's calls would take several times as long for.
    """
    if not step:
        return lambda value: min(max(value, -limit), limit)
    most = math.floor(limit / step) if limit < math.inf else math.inf
    return lambda value: step * min(max(value / step + WHOLE - WHOLE, -most), most)


Step = Callable[[int, Callable[[], Array]], tuple[Array, Array, Array]]


def start_loops(scene: Scene, time_step: float) -> Step:
    """All loops of a scene at rest: a function step(n, measure) to be called at every time step n = 0, 1, ...

    measure: returns the scene's outputs at that time, (outputs,); called only where a loop takes a sample

    The function returns what the loops add to the scene's inputs until the next step, (inputs,); what of it acts at the
    end of that step, for a rule that takes forces at both ends of one; and their commands in the order of
    `Scene.commands`. Where a command jumps, the rule has the mean of both its values there: known before by a delay,
    or else, as the rule has taken the old value there already, with the missing half of the jump a step later.
    """
    loops = [
        (
            samples_per_period(loop, time_step),
            start_controller(loop),
            [scene.outputs.index(name) for name in loop.measured],
            [scene.inputs.index(name) for name in loop.driven],
            np.zeros((2, len(loop.driven))),
        )
        for loop in scene.loops
    ]

    delays = [loop.controller.delay for loop in scene.loops]

    def step(n: int, measure: Callable[[], Array]) -> tuple[Array, Array, Array]:
        due = [n % period == 0 for period, *_ in loops]
        outputs = measure() if any(due) else None
        held, end = np.zeros(len(scene.inputs)), np.zeros(len(scene.inputs))
        for now, delay, (period, control, measured, driven, command) in zip(due, delays, loops, strict=True):
            late = np.zeros(len(driven))
            if now:
                assert outputs is not None
                before = command[0].copy()
                command[:] = control(outputs[measured])
                late = (command[0] - before) / 2 * (delay == 0)
            held[driven] += command[0]
            end[driven] += late + (command.mean(axis=0) if (n + 1) % period == 0 else command[0])
        return held, end, np.concatenate([np.zeros(0), *(command[0] for *_, command in loops)])

    return step


def check_runaway(assembly: Assembly, coordinates: Array, outputs: Array, time_step: float) -> None:
    """Raise RuntimeError when a loop has driven a body beyond what it can bear.

    coordinates: of all bodies now, (n_all,); outputs: of the scene from the start until now, (n_samples, outputs)
    """
    for name, place in assembly.slices.items():
        if not np.all(motion_size(assembly, name, coordinates[place][:, None]) < RUNAWAY):
            raise RuntimeError(runaway(assembly.scene, name, outputs, time_step))


def runaway(scene: Scene, body: str, outputs: Array, time_step: float) -> str:
    """What to say of a loop that runs away: when, which of its signals has grown most, and by how much.

    outputs: of the scene from the start until now, (n_samples, outputs)
    """
    n = len(outputs)
    recent, before = outputs[-max(1, n // 8) :], outputs[: max(1, n // 2)]
    size = np.abs(recent).max(axis=0)
    growth = size / np.maximum(np.abs(before).max(axis=0), np.finfo(float).tiny)
    measured = [scene.outputs.index(name) for loop in scene.loops for name in loop.measured]
    worst = max(measured, key=lambda k: growth[k])
    names = ", ".join(repr(loop.name) for loop in scene.loops)
    return (
        f"the closed loop runs away: at t = {(n - 1) * time_step:g} s {scene.outputs[worst]!r} has grown to "
        f"{size[worst]:.3g} {scene.output_units[worst]} and body {body!r} is deformed by more than "
        f"{100 * RUNAWAY:g} % of its size. Unstable, unless the excitation is far too large: check the sign, gain and "
        f"delay of loop {names} on the linear model (linearize_closed, unstable_poles)"
    )
