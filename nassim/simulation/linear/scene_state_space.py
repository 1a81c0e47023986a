"""State space of an assembled scene, and its state at rest."""

import numpy as np

from nassim.base.checks import Array
from nassim.scene.terms import Output
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.effect_of_loads import LoadedState
from nassim.simulation.model.prescribed_motion import cleared, product
from nassim.systems.state_space import StateSpace


def steady_state(assembly: Assembly, state: Array, by_known: Array) -> Array:
    """Find the state of a scene that has always been under its loads, with all inputs at zero, at the time 0.

    Under gravity across the axis of a steady rotation, the scene moves periodically. Motions that nothing holds rest in
    the reference configuration.

    Args:
        assembly: the assembled scene with the effect of its loads.
        state: A of `state_space`, (n, n).
        by_known: columns of B of its known functions, (n, known).

    Returns:
        The state, (n,).
    """
    result, n = np.zeros(len(state)), len(assembly.modal.frequency)
    if assembly.loads is not None:
        result[:n] = assembly.loads.equilibrium
    result[2 * n :] = np.linalg.solve(state[2 * n :, 2 * n :], -(state[2 * n :] @ result + by_known[2 * n :, 0]))
    if assembly.rotation and np.any(by_known[:, 1:3]):
        turning = 1j * assembly.rotation.rate * np.eye(len(state)) - state
        result += np.linalg.solve(turning, by_known[:, 1] - 1j * by_known[:, 2]).real
    return result


def released_state(assembly: Assembly, state: Array) -> Array:
    """Return the state, (n,), of a scene that is released in its reference configuration; state: A of `state_space`."""
    result, n = np.zeros(len(state)), len(assembly.modal.frequency)
    if assembly.rotation:
        result[n : 2 * n] = assembly.rotation.released
    return result


def state_space(assembly: Assembly) -> StateSpace:
    """Compute A, B, C and D of an assembled scene.

    The last columns of B and D are of known functions of time: of its constant loads, an input of one, and with a
    steady rotation those of `nassim.simulation.model.steady_rotation`.

    The states are modal amplitudes and their rates, then those of circuits, the outputs of amplifiers and of drives'
    servos, and the states of outputs' filters. With drives that follow inputs, amplitudes and rates are
    a and b of `nassim.simulation.model.prescribed_motion`.

    Args:
        assembly: the assembled scene, with or without the effect of loads.

    Returns:
        A (n, n), B (n, inputs + known), C (outputs, n) and D (outputs, inputs + known), of 1 or 4 known functions.

    Raises:
        ValueError: for outputs that would need a derivative of a prescribed motion's input.
    """
    modal, signals, prescribed = assembly.modal, assembly.signals, assembly.signals.prescribed
    omega, modes, rotation = modal.omega, modal.modes, assembly.rotation
    n, n_in, n_out = len(omega), signals.input_matrix.shape[1], len(signals.output_matrix)
    n_all = n_in + len(assembly.known[1])
    plain = 2 * n + len(signals.circuits) + len(signals.amplifiers) + len(prescribed.servos)
    size = plain + sum(len(system[0]) for system in signals.filters.values())
    state, drives = np.zeros((size, size)), np.zeros((size, n_all))
    readings, feedthrough = np.zeros((n_out, size)), np.zeros((n_out, n_all))
    velocity = slice(n, 2 * n)
    state[:n, velocity] = np.eye(n)
    state[velocity, :n] = -np.diag(omega**2)
    state[velocity, velocity] = -modal.damping.of_modes
    drives[velocity, :n_in], drives[velocity, n_in] = modes.T @ signals.input_matrix, modes.T @ signals.weight
    if (loads := assembly.loads) is not None:
        _refuse_inertial(assembly, loads)
        state[velocity, :n] -= loads.stiffness
        state[velocity, velocity] -= loads.gyroscopic
        drives[velocity, n_in] = loads.force
        for tangent in assembly.tangents:
            if not tangent.law.is_linear:
                drives[velocity, n_in] -= modes.T @ tangent.rows.T @ tangent.constant
    if rotation:
        drives[velocity, n_in + 1 : n_in + 3] = rotation.force
    _add_circuits(assembly, state, drives, readings)
    for j, k in enumerate(prescribed.servos, start=plain - len(prescribed.servos)):
        state[j, j], drives[j, prescribed.inputs[k]] = -prescribed.rates[k], prescribed.rates[k]
    _follow_drives(assembly, state, drives, readings, feedthrough, plain)
    feedthrough[:, :n_in] += signals.feedthrough
    if loads is not None:
        given = [loads.constant_input(name) for name in assembly.scene.inputs]
        feedthrough[:, n_in] += signals.feedthrough_at_rest[:, : len(given)] @ given
    feedthrough[:, n_in] += assembly.output_offsets
    if rotation:
        feedthrough[:, [n_in, n_in + 3]] += rotation.readings
    _filter(assembly, state, drives, readings, feedthrough)
    return state, drives, readings, feedthrough


def _add_circuits(assembly: Assembly, state: Array, drives: Array, readings: Array) -> None:
    """Add the states of circuits and amplifiers, which follow amplitudes and rates."""
    signals, modes, loads = assembly.signals, assembly.modal.modes, assembly.loads
    n, n_in = modes.shape[1], signals.input_matrix.shape[1]
    velocity = slice(n, 2 * n)
    for j, circuit in enumerate(signals.circuits, start=2 * n):
        pull = modes.T @ circuit.forces
        state[velocity, j] = pull
        state[j, :n] = circuit.rate * pull / circuit.storage
        state[j, j] = -circuit.rate
        drives[j, :n_in] = signals.circuit_matrix[j - 2 * n]
        for output, gain in circuit.outputs:
            readings[assembly.scene.outputs.index(output), j] += gain
        if circuit.coil:
            state[velocity, :n] -= np.outer(pull, pull) / circuit.storage
            if loads is not None:  # a constant voltage is one of the circuit; the loads have its force on the modes
                constant = loads.constant_input(circuit.coil.input)
                drives[j, n_in] = constant / circuit.storage
                drives[velocity, n_in] -= constant * (modes.T @ circuit.at_rest)
    for j, amplifier in enumerate(signals.amplifiers, start=2 * n + len(signals.circuits)):
        state[velocity, j] = modes.T @ amplifier.forces
        state[j, j] = -amplifier.rate
        drives[j, amplifier.input] = amplifier.rate
        readings[:, j] = amplifier.readings


def _follow_drives(
    assembly: Assembly,
    state: Array,
    drives: Array,
    readings: Array,
    feedthrough: Array,
    plain: int,
) -> None:
    """Add the effect of drives that follow inputs on states and outputs.

    plain: number of states before those of filters.
    """
    modes, signals, scale = assembly.modal.modes, assembly.signals, assembly.coordinates.scale
    prescribed, n = signals.prescribed, modes.shape[1]
    by_states, by_inputs = np.zeros((len(prescribed.inputs), len(state))), prescribed.by_inputs(drives.shape[1])
    by_states[:, :plain] = prescribed.by_states(plain)
    moved = _moved_by_drives(assembly, state)
    state += moved @ by_states
    drives += moved @ by_inputs
    pushed = np.zeros(drives.shape[1])
    pushed[: signals.input_matrix.shape[1]] = np.linalg.norm(signals.input_matrix / scale[:, None], axis=0)
    driven = np.linalg.norm(scale[:, None] * prescribed.motion, axis=0)
    for order, rows in enumerate((signals.output_matrix, signals.velocity_matrix, signals.acceleration_matrix)):
        size = np.linalg.norm(rows / scale, axis=1, keepdims=True)
        at_once = cleared(product(rows, prescribed.residual), size * driven)
        seen, direct = at_once @ by_states, at_once @ by_inputs
        seen[:, :n] += rows @ modes
        for _ in range(order):
            _refuse_derivatives(assembly, direct)
            seen, direct = seen @ state, product(cleared(seen, size), cleared(drives, pushed))
        readings += seen
        feedthrough += direct


def _refuse_inertial(assembly: Assembly, loads: LoadedState) -> None:
    """Refuse inertial outputs in a rotating frame where outputs read motion relative to it."""
    inertial = [term.name for term in assembly.terms if isinstance(term, Output) and term.inertial]
    if inertial and np.any(loads.gyroscopic) and not assembly.signals.against_ground:
        raise ValueError(
            f"output {inertial[0]!r} reads motion against inertial space, which a linear model in the frame of an "
            "angular_velocity does not include: turn the scene by a Drive(speed=...), or read velocity against the "
            "table (Vibrometer)"
        )


def _filter(assembly: Assembly, state: Array, drives: Array, readings: Array, feedthrough: Array) -> None:
    """Add the filters of outputs, whose states are the last ones."""
    filters = assembly.signals.filters
    end = len(state) - sum(len(system[0]) for system in filters.values())
    for output, (fa, fb, fc, fd) in filters.items():
        k, place = assembly.scene.outputs.index(output), slice(end, end + len(fa))
        state[place], drives[place] = np.outer(fb[:, 0], readings[k]), np.outer(fb[:, 0], feedthrough[k])
        state[place, place] = fa
        readings[k] *= fd[0, 0]
        readings[k, place] = fc[0]
        feedthrough[k] *= fd[0, 0]
        end = place.stop


def _moved_by_drives(assembly: Assembly, state: Array) -> Array:
    """Return the rates of all states per unit of the drives' motions, (size, d)."""
    prescribed, n = assembly.signals.prescribed, len(assembly.modal.frequency)
    position, velocity = slice(n), slice(n, 2 * n)
    by_rate, by_motion = prescribed.damping, np.zeros_like(prescribed.damping)  # forces of the drives on the modes
    if assembly.loads is not None:
        by_rate, by_motion = by_rate + assembly.loads.drive_damping, assembly.loads.drive_stiffness
    result = np.zeros((len(state), by_rate.shape[1]))
    # Rounding mixes modes of independent machines a little, which must not look like a prescribed motion.
    sizes = np.linalg.norm(state[velocity, velocity], axis=0)
    damping = cleared(-state[velocity, velocity], np.maximum.outer(sizes, sizes))
    result[position] = slip = product(np.hstack([damping, -np.eye(n)]), np.vstack([prescribed.momentum, by_rate]))
    result[velocity] = -damping @ slip - state[velocity, position] @ prescribed.momentum - by_motion
    for j, circuit in enumerate(assembly.signals.circuits, start=2 * n):
        result[j] = circuit.rate / circuit.storage * circuit.forces @ prescribed.residual
        if circuit.coil:
            pulled = circuit.forces @ prescribed.motion / circuit.storage
            result[velocity] -= np.outer(assembly.modal.modes.T @ circuit.forces, pulled)
    return result


def _refuse_derivatives(assembly: Assembly, direct: Array) -> None:
    """Refuse outputs that read a derivative of the direct effect of inputs, direct, (outputs, inputs + known)."""
    scene, signals, prescribed = assembly.scene, assembly.signals, assembly.signals.prescribed
    servo_inputs = {prescribed.inputs[k] for k in prescribed.servos}
    for output, row, accelerations in zip(scene.outputs, direct, signals.acceleration_matrix, strict=True):
        if np.any(row):
            place = int(np.argmax(np.abs(row)))
            kind = "an acceleration" if np.any(accelerations) else "a velocity"
            cure = "give the drive a bandwidth, or read a displacement"
            if place in servo_inputs:
                cure = "the drive's bandwidth, of first order, smooths velocities: read one, or a displacement"
            raise ValueError(
                f"output {output!r} reads {kind} that follows a derivative of input {scene.inputs[place]!r} at once, "
                f"which no linear model of these inputs includes: {cure}; or simulate by generalized_alpha without "
                'bodies of fidelity "linear"'
            )
