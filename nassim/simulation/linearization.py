"""The linear model of a scene: small motion about its start, in minimal coordinates; loops open or closed."""

import numpy as np

from nassim.scene.scene import Scene
from nassim.simulation.small_motion import Assembly, assemble
from nassim.systems.feedback import DELAY_ORDER, close_loop
from nassim.systems.linear_model import LinearModel, sampled
from nassim.systems.state_space import StateSpace


def linearize(scene: Scene) -> LinearModel:
    """The scene's linear model about its start, with the damping of its modes, bodies and dampers.

    The states are the minimal coordinates' modal amplitudes and their rates, then the charges of ports that leak (as
    volts) and the outputs of amplifiers with a bandwidth. The scene's loops are open. Gravity's effect on stiffness and
    gyroscopic terms of a spinning body are not part of it.
    """
    a, b, c, d = state_space(assemble(scene))
    return LinearModel(a, b[:, :-1], c, d[:, :-1], scene.inputs, scene.outputs, scene.output_units)


def state_space(assembly: Assembly) -> StateSpace:
    """A, B, C and D of an assembled scene; the last column of B and D is gravity, a constant input of one.

    States: modal amplitudes and their rates, then the charges of circuits (as volts) and the amplifiers' outputs.
    """
    a = assembly
    omega = 2 * np.pi * a.frequency
    n, n_in, n_out = len(omega), a.input_matrix.shape[1], len(a.output_matrix)
    modes = a.basis @ a.shapes
    size = 2 * n + len(a.circuits) + len(a.amplifiers)
    state, drives = np.zeros((size, size)), np.zeros((size, n_in + 1))
    readings, feedthrough = np.zeros((n_out, size)), np.zeros((n_out, n_in + 1))
    velocity = slice(n, 2 * n)
    state[:n, velocity] = np.eye(n)
    state[velocity, :n] = -np.diag(omega**2)
    state[velocity, velocity] = -a.damping.of_modes
    drives[velocity, :n_in], drives[velocity, n_in] = modes.T @ a.input_matrix, modes.T @ a.weight
    for j, circuit in enumerate(a.circuits, start=2 * n):
        pull = modes.T @ circuit.forces
        rate = 1 / (circuit.resistance * circuit.capacitance)
        state[velocity, j] = pull
        state[j, :n] = rate * pull / circuit.capacitance
        state[j, j] = -rate
        readings[a.scene.outputs.index(circuit.output), j] = circuit.gain
    for j, amplifier in enumerate(a.amplifiers, start=2 * n + len(a.circuits)):
        state[velocity, j] = modes.T @ amplifier.forces
        state[j, j] = -amplifier.rate
        drives[j, amplifier.input] = amplifier.rate
    for k, (row, derivative) in enumerate(zip(a.output_matrix @ modes, a.derivatives, strict=True)):
        if derivative == 2:
            readings[k] += row @ state[velocity]
            feedthrough[k] = row @ drives[velocity]
        else:
            readings[k, derivative * n : (derivative + 1) * n] += row
    return state, drives, readings, feedthrough


def linearize_closed(scene: Scene, *, continuous: bool = False, delay_order: int = DELAY_ORDER) -> LinearModel:
    """The linear model of a scene with all its loops closed, their converters and limits left out.

    The model is sampled at the loops' rate: what a simulation without saturation does at its samples, exactly, with the
    excitation held between them. continuous: the continuous equivalent instead, with delay and hold by Pade's
    approximation of delay_order. Raises ValueError for a scene without loops, and for several rates unless continuous.
    """
    rates = {loop.controller.sample_rate for loop in scene.loops}
    if not rates:
        raise ValueError(f"scene {scene.name!r} has no loops; linearize serves")
    if len(rates) > 1 and not continuous:
        raise ValueError(
            f"the loops of scene {scene.name!r} have several sample rates; only the continuous model has all"
        )
    model = linearize(scene)
    if not continuous:
        model = sampled(model, rates.pop())
    for loop in scene.loops:
        model = close_loop(model, loop.controller, measured=loop.measured, driven=loop.driven, delay_order=delay_order)
    return model
