"""Exact discrete-time solution of scenes in small motion, without any step-size error.

With the inputs held or running straight between samples, each mode's equation q'' + 2 zeta w q' + w^2 q = p is solved
in closed form: q = Im(z) / w_d with z' = lambda z + p, a recursion of order one with complex coefficients. Where
circuits, bodies' own damping or dampers couple the modes, amplifiers add states or loops run, the whole state space
goes from sample to sample by its matrix exponential.
"""

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.modal import held_pole
from nassim.base.progress import Advance, silent
from nassim.simulation.linearization import state_space
from nassim.simulation.running_loops import check_runaway, start_loops
from nassim.simulation.small_motion import NO_EQUILIBRIUM, Assembly
from nassim.systems.state_space import discretize

CHECKS = 200
NEUTRAL = 1e-9
"""Share of all weight that a free motion may feel by rounding."""
CLOSE_TO_CRITICAL = 1e-10
"""Least |1 - zeta^2|: at critical damping the two solutions coincide, which the recursion does not cover."""


def exact_response(
    assembly: Assembly,
    inputs: Array,
    time_step: float,
    *,
    hold_order: int = 1,
    released: bool = False,
    advance: Advance = silent,
) -> tuple[Array, Array, Array]:
    """Outputs of an assembled scene from rest in its equilibrium under gravity, or released: unloaded at the start.

    inputs: shape (inputs, n_samples); hold_order: 0 for inputs that keep each sample's value until the next, 1 for
    inputs that run straight between them; advance: called with the number of steps done

    Returns the outputs (outputs, n_samples), the loops' commands (commands, n_samples), and all coordinates at some
    200 times, shape (n_all, n_times). Raises RuntimeError when gravity does work on a free motion and when a loop runs
    away.
    """
    if assembly.scene.loops or not assembly.falls_into_modes:
        return _coupled_response(assembly, inputs, time_step, hold_order, released, advance)
    modes = assembly.basis @ assembly.shapes
    drives = modes.T @ assembly.input_matrix
    readings = assembly.output_matrix @ modes
    weight = modes.T @ assembly.weight
    omega = 2 * np.pi * assembly.frequency
    if not released:
        _check_equilibrium(assembly)
    outputs = np.zeros((len(readings), inputs.shape[1]))
    seen = np.unique(np.linspace(0, inputs.shape[1] - 1, CHECKS).astype(int))
    amplitudes = np.zeros((len(omega), len(seen)))
    for k, frequency in enumerate(omega):
        if not (np.any(drives[k]) or weight[k]):
            continue
        force = drives[k] @ inputs + weight[k] * released
        damping = assembly.damping.ratio[k] * frequency
        if assembly.free[k]:
            amplitude = _free(force, time_step, hold_order)
        else:
            amplitude = weight[k] * (not released) / frequency**2 + _oscillator(
                force, frequency, damping, time_step, hold_order
            )
        outputs += readings[:, k : k + 1] * amplitude
        amplitudes[k] = amplitude[seen]
    return outputs, np.zeros((0, inputs.shape[1])), modes @ amplitudes


def _check_equilibrium(assembly: Assembly) -> None:
    """RuntimeError when gravity does work on a free motion; where it does none, equilibrium is neutral."""
    modes = (assembly.basis @ assembly.shapes)[:, assembly.free]
    moving = [body for body in assembly.scene.bodies if body.name in assembly.slices]
    mass = sum(body.rigid_inertia[0] for body in moving)
    # Of unit modal mass, no motion can feel more than all masses falling together.
    most = np.sqrt(mass) * float(np.linalg.norm(assembly.scene.gravity))
    if np.abs(modes.T @ assembly.weight).max(initial=0.0) > NEUTRAL * most:
        raise RuntimeError(NO_EQUILIBRIUM)


def _coupled_response(
    assembly: Assembly, inputs: Array, h: float, hold_order: int, released: bool, advance: Advance
) -> tuple[Array, Array, Array]:
    """As exact_response, for states that do not fall apart into modes, and for loops."""
    state, drives, readings, feedthrough = state_space(assembly)
    phi, held, risen = discretize(state, drives, h)
    x = np.zeros(len(state))
    if np.any(assembly.weight) and not released:
        _check_equilibrium(assembly)
        held_by_stiffness = np.ones(len(x), dtype=bool)
        held_by_stiffness[: 2 * len(assembly.frequency)] = np.tile(~assembly.free, 2)
        part = np.ix_(held_by_stiffness, held_by_stiffness)
        x[held_by_stiffness] = np.linalg.solve(state[part], -drives[held_by_stiffness, -1])
    n_in, n_samples = inputs.shape
    pushes = held[:, :-1] @ inputs + held[:, -1:]
    if hold_order:
        pushes[:, :-1] += risen[:, :-1] @ np.diff(inputs)
    through = feedthrough[:, :-1] @ inputs + feedthrough[:, -1:]
    added = np.zeros(n_in)
    loops = start_loops(assembly.scene, h)
    modes = assembly.basis @ assembly.shapes
    by_inputs = assembly.following.beyond @ assembly.following.taken(n_in)
    by_states = assembly.following.beyond @ assembly.following.lagging(len(x))
    by_states[:, : modes.shape[1]] += modes
    outputs = np.empty((n_samples, len(readings)))
    commands = np.empty((n_samples, len(assembly.scene.commands)))
    seen = np.unique(np.linspace(0, n_samples - 1, CHECKS).astype(int))
    coordinates = np.empty((len(modes), len(seen)))
    k = 0
    for n, push in enumerate(pushes.T):
        outputs[n] = readings @ x + through[:, n] + feedthrough[:, :-1] @ added
        added, _, commands[n] = loops(n, outputs[n].copy)
        if n == seen[k]:
            coordinates[:, k] = by_states @ x + by_inputs @ (inputs[:, n] + added)
            if assembly.scene.loops:
                check_runaway(assembly, coordinates[:, k], outputs[: n + 1], h)
            advance(int(n - (seen[k - 1] if k else 0)))
            k += 1
        x = phi @ x + push
        if commands.size:
            x += held[:, :n_in] @ added
    return outputs.T, commands.T, coordinates


def _oscillator(force: Array, omega: float, damping: float, h: float, hold_order: int) -> Array:
    """Response of q'' + 2 damping q' + omega^2 q = force from rest at every sample."""
    square = omega**2 - damping**2
    if abs(square) < CLOSE_TO_CRITICAL * omega**2:
        square = CLOSE_TO_CRITICAL * omega**2
    if square > 0:
        turn = np.sqrt(square)
        result: Array = _first_order(force.astype(complex), -damping + 1j * turn, h, hold_order).imag / turn
        return result
    half = np.sqrt(-square)
    slow, fast = (_first_order(force, -damping + sign * half, h, hold_order) for sign in (1.0, -1.0))
    return (slow - fast) / (2 * half)


def _first_order(force: Array, rate: complex, h: float, hold_order: int) -> Array:
    """Response of z' = rate z + force from rest at every sample."""
    now, before, decay = held_pole(rate, h, hold_order=hold_order)
    result: Array = scipy.signal.lfilter([now, before], [1.0, -decay], force)
    # From rest, so the first sample's own share, which stands for time before it, is not there.
    if hold_order:
        result = result - now * force[0] * np.exp(rate * h * np.arange(len(force)))
    return result


def _free(force: Array, h: float, hold_order: int) -> Array:
    """Response of q'' = force from rest at every sample."""
    before, after = force[:-1], force[1:] if hold_order else force[:-1]
    velocity = np.concatenate([[0.0], np.cumsum(h * (before + after) / 2)])
    steps = h * velocity[:-1] + h**2 * (before / 3 + after / 6)
    return np.concatenate([[0.0], np.cumsum(steps)])
