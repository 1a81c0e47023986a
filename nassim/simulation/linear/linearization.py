"""Linear models of scenes: small motion about the start, at rest or spinning, with loops open or closed."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from nassim.base.callers import outside
from nassim.base.checks import Array, finite_array, known, unique
from nassim.base.field_types import ArrayLike
from nassim.scene.loop import Loop
from nassim.scene.measures import body_of
from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint, Output, PrescribedMotion
from nassim.simulation.linear.folding import warn_of_folding
from nassim.simulation.loaded.loaded_state import loaded_state, warn_of_instability
from nassim.simulation.loaded.rest import about_rest
from nassim.simulation.loaded.rotating_signals import with_rates
from nassim.simulation.loaded.rotor_frame import FRAMES, FrameView, RotorPartition, check_constant, damps_both
from nassim.simulation.loaded.rotor_stator import stator_bodies
from nassim.simulation.loaded.settling import SteadyLoads
from nassim.simulation.model.assembly import Assembly, assemble
from nassim.simulation.model.effect_of_loads import LoadedState
from nassim.simulation.model.prescribed_motion import cleared, product
from nassim.simulation.model.steady_rotation import KNOWN_AT_REST
from nassim.systems.controllers import Controller
from nassim.systems.feedback import DELAY_ORDER, close_loop
from nassim.systems.linear_model import LinearModel, sampled, unstable_poles
from nassim.systems.state_space import StateSpace

NO_SPIN = (0.0, 0.0, 0.0)
"""Default: no angular velocity, and the origin as axis point."""


def linearize(
    scene: Scene,
    *,
    angular_velocity: ArrayLike = NO_SPIN,
    axis_point: ArrayLike = NO_SPIN,
    stator: Sequence[str] | None = None,
    frame: str = "rotor",
    loaded: bool = True,
    constant_inputs: Mapping[str, float] | None = None,
) -> LinearModel:
    """Compute the linear model of a scene about its equilibrium, with the damping of its modes, bodies and dampers.

    The equilibrium is that under gravity and spin, which give stiffness to rigid bodies, joints, springs and, where
    their reduction holds their geometric stiffness, flexible bodies, see `nassim.simulation.loaded.loaded_state`. In a
    rotating frame only the gravity along the axis is constant and counts.

    A drive of constant speed defines the rotor and its speed; all else is the stator, as is the ground.

    The states are the modal amplitudes that the scene has there without the stiffness of its loads, in minimal
    coordinates and from the reference configuration, and their rates, then the charges of ports with a resistance
    (as volts) and flux linkages of coils (as amperes), the outputs of amplifiers and drives with a bandwidth, and
    the states of sensors' filters. With drives that follow inputs, the amplitudes are those of
    `nassim.simulation.model.prescribed_motion`. The scene's loops are open. The model excludes a body's own
    angular_velocity, with a warning. A model may be unstable: `unstable_poles` finds its unstable poles.

    Args:
        scene: the scene.
        angular_velocity: constant angular velocity of a scene that rotates as a whole, fixed bodies included, (3,)
            [rad/s]. The scene is then described in the rotating frame: its axes rotate, outputs read motion relative to
            the frame, the model is about the equilibrium under centrifugal forces, and the damping belongs to the
            rotating parts. See `nassim.simulation.loaded.spinning` for what it includes.
        axis_point: a point of the axis, (3,) [m].
        stator: names of all bodies of the stator, fixed ones included, while the others rotate. None: with a drive,
            the bodies that are tied to the ground rather than to the drive's rotor; without a drive, no body.
        frame: frame in which the states describe motion, where there are a rotor and a stator: "rotor" for the
            rotor's, "stator" for the stator's. The world's axes stand still, those of a point rotate with its body;
            outputs of a rotation are its deviation from the steady rotation, and velocities are deviations of those
            against the ground, as in a run. The bodies of the other side must be rigid
            and equal in all directions across the axis, see `nassim.simulation.loaded.rotor_frame`. The scene's
            damping_ratio is then, as in floating frames, a damping of the bodies' deformation.
        loaded: whether gravity and the stress inside bodies change the stiffness. Without, the model is that of the
            reference configuration, in which a pendulum does not swing; a spin has its other terms.
        constant_inputs: constant values of inputs that load the scene too, by name: forces, voltages, accelerations of
            the base. In a spin they are constant in the frame that `frame` names. Inputs of the model are deviations
            from them, outputs those from the equilibrium.

    Returns:
        The linear model.

    Raises:
        ValueError: for loads without an equilibrium near the start, for inertial sensors in a spin, for a part (by
            name) that makes the model depend on the angle of the rotor, and for outputs that would need an input's
            derivative.

    Warns:
        UserWarning: for an equilibrium that is unstable under gravity, one beyond small motion, and bodies whose
            stress matters but is only estimated or left out.
    """
    if not scene.speeds and not np.any(angular_velocity):
        _warn_of_own_rotation(scene)
    assembly = loaded_assembly(
        scene, angular_velocity, axis_point, stator, frame, loaded=loaded, inputs=constant_inputs, rates=True
    )
    return linear_model(assembly)


def _warn_of_own_rotation(scene: Scene) -> None:
    """Warn of bodies whose own rotation a model about rest leaves out."""
    turning = [body.name for body in scene.bodies if np.any(body.angular_velocity)]
    if turning:
        warnings.warn(
            f"body {turning[0]!r} of scene {scene.name!r} has an angular_velocity, whose gyroscopic and centrifugal "
            "effects a linear model about rest leaves out: let a Drive(speed=...) turn its joint, or give linearize "
            "the angular_velocity of a scene that turns as a whole",
            stacklevel=outside(),
        )


def linear_model(assembly: Assembly) -> LinearModel:
    """Make the linear model of an assembled scene, see `state_space`, with the inputs of its actuators only."""
    a, b, c, d = state_space(assembly)
    scene, modal = assembly.scene, assembly.modal
    inputs = scene.inputs[: len(scene.inputs) - len(scene.references)]
    b, d = b[:, : len(inputs)], d[:, : len(inputs)]
    unsupported = np.tile(np.where(modal.unsupported, modal.frequency, 0.0), 2)
    return LinearModel(a, b, c, d, inputs, scene.outputs, scene.output_units, unsupported=unsupported)


def loaded_assembly(
    scene: Scene,
    angular_velocity: ArrayLike,
    axis_point: ArrayLike,
    stator: Sequence[str] | None,
    frame: str,
    *,
    loaded: bool = True,
    weight: bool = True,
    inputs: Mapping[str, float] | None = None,
    rates: bool = False,
) -> Assembly:
    """Assemble a scene with its damping at speed and the effect of its loads.

    Args:
        scene: the scene.
        angular_velocity: as of `linearize`, as are the following.
        axis_point: a point of the axis, (3,) [m].
        stator: names of the bodies of the stator.
        frame: "rotor" or "stator".
        loaded: whether gravity and the stress inside bodies change the stiffness.
        weight: whether gravity is one of the loads.
        inputs: constant values of inputs, by name.
        rates: whether velocities between a rotor and a stator are read with the part that the rotation adds.

    Returns:
        The assembly.

    Raises:
        ValueError: for several drives of constant speed, and for one that translates.
    """
    assembly = assemble(scene)
    known("frame", frame, FRAMES)
    if inputs and not loaded:
        raise ValueError("constant_inputs are loads: give them with loaded=True")
    names = frozenset(known("body", name, [body.name for body in scene.bodies]) for name in stator or ())
    if scene.speeds:
        if np.any(angular_velocity):
            raise ValueError(f"scene {scene.name!r} has a drive that sets the spin; give no angular_velocity")
        angular_velocity, axis_point, names = spin_of_drive(assembly, None if stator is None else names)
    velocity = finite_array("angular_velocity", np.asarray(angular_velocity, dtype=float), (3,))
    point = finite_array("axis_point", np.asarray(axis_point, dtype=float), (3,))
    gravity = np.asarray(scene.gravity) * (loaded and weight)
    rate = float(np.linalg.norm(velocity))
    if rate and not (names and frame == "stator"):
        axis = velocity / rate
        gravity = axis * (axis @ gravity)
    partition = RotorPartition(velocity, point, names, frame) if rate and names else None
    if partition is not None:
        view = FrameView(assembly, partition)
        check_constant(view)
        if damps_both(view):
            damping = assembly.modal.damping.of_deformation
            assembly = replace(assembly, modal=replace(assembly.modal, damping=damping))
    state = loaded_state(
        assembly,
        gravity=gravity,
        inputs=inputs,
        angular_velocity=velocity,
        axis_point=point,
        partition=partition,
        stress=loaded,
    )
    steady = SteadyLoads(gravity, velocity, point)
    result = about_rest(assembly, state, steady) if partition is None else assembly.under(state)
    if partition is not None and rates:
        result = with_rates(result, partition)
    if not rate and result.loads is not None:
        warn_of_instability(result, result.loads)
    return result


def spin_of_drive(assembly: Assembly, stator: frozenset[str] | None = None) -> tuple[Array, Array, frozenset[str]]:
    """Return the angular velocity [rad/s], a point of the axis and the stator of a scene with a drive of its speed.

    Args:
        assembly: the assembled scene.
        stator: names of the bodies of the stator; None: those that are tied to the ground.

    Raises:
        ValueError: for several drives of constant speed, for one that translates, and without a stator on one side.
    """
    (drive, *others) = assembly.scene.speeds
    turned = rotor_of_drive(assembly, drive, stator)
    if others or turned is None:
        raise ValueError(
            f"scene {assembly.scene.name!r}: a linear model is about one drive that turns at constant speed"
        )
    axis, point, stator = turned
    return drive.speed * axis, point, stator


def rotor_of_drive(
    assembly: Assembly, drive: PrescribedMotion, stator: frozenset[str] | None = None
) -> tuple[Array, Array, frozenset[str]] | None:
    """Return axis, a point of the axis [m] and the stator of what a drive turns; None for one that translates.

    Args:
        assembly: the assembled scene.
        drive: the drive.
        stator: names of the bodies of the stator; None: those that are tied to the ground.

    Raises:
        ValueError: for a drive without a stator on one side.
    """
    scene = assembly.scene
    joint = next(joint for joint in scene.terms_of(Constraint) if joint.name == drive.constraint)
    axis = joint.measure.rotation_axis(drive.component)
    if axis is None:
        return None
    stator = stator_bodies(assembly, joint, axis) if stator is None else stator
    ends = [body_of(path) in stator for path in joint.points[:2]]
    if sum(ends) != 1:
        raise ValueError(f"joint {joint.name!r}: a drive that turns far needs a stator on one of its two sides")
    return (1.0 if ends[0] else -1.0) * axis, scene.point_position(joint.points[0]), stator


def spinning_equilibrium(
    scene: Scene,
    *,
    angular_velocity: ArrayLike = NO_SPIN,
    axis_point: ArrayLike = NO_SPIN,
    stator: Sequence[str] | None = None,
    frame: str = "rotor",
) -> dict[str, float]:
    """Compute the outputs of a scene at rest in a rotating frame, under centrifugal forces without gravity and inputs.

    Loops are open.

    Args:
        scene: the scene.
        angular_velocity: as of `linearize`, as are the following.
        axis_point: a point of the axis, (3,) [m].
        stator: names of the bodies of the stator.
        frame: "rotor" or "stator".

    Returns:
        Values of the outputs, by name.

    Raises:
        ValueError: if there is no equilibrium within small motion, and if it is unstable.
    """
    assembly = loaded_assembly(scene, angular_velocity, axis_point, stator, frame, weight=False)
    state, *_ = state_space(assembly)
    growing = unstable_poles(
        LinearModel(state, np.zeros((len(state), 0)), np.zeros((0, len(state))), np.zeros((0, 0)), (), ())
    )
    if growing:
        raise ValueError(f"the spinning equilibrium of scene {scene.name!r} is unstable: {growing[0]}; spin slower")
    return steady_outputs(assembly)


def steady_outputs(assembly: Assembly) -> dict[str, float]:
    """Compute the outputs of a scene that has always been under its loads, by name, see `steady_state`; loops are open.

    Args:
        assembly: the assembled scene with the effect of its loads.
    """
    scene, n = assembly.scene, len(assembly.modal.frequency)
    state, drives, readings, feedthrough = state_space(assembly)
    of_known, known = slice(len(scene.inputs), None), KNOWN_AT_REST[1]
    if assembly.rotation:
        known = assembly.rotation.known[1]
    else:  # accelerations of what rests vanish but for rounding
        readings = readings - assembly.signals.acceleration_matrix @ assembly.modal.modes @ state[n : 2 * n]
    values = readings @ steady_state(assembly, state, drives[:, of_known]) + feedthrough[:, of_known] @ known
    return dict(zip(scene.outputs, values.tolist(), strict=True))


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
    omega, modes, rotation = 2 * np.pi * modal.frequency, modal.modes, assembly.rotation
    n, n_in, n_out = len(omega), signals.input_matrix.shape[1], len(signals.output_matrix)
    n_all = n_in + (len(rotation.known[1]) if rotation else 1)
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
    if rotation:
        drives[velocity, n_in + 1 : n_in + 3] = rotation.force
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
    for order, rows in enumerate((signals.output_matrix, signals.velocity_matrix, signals.acceleration_matrix)):
        size = np.linalg.norm(rows / scale, axis=1, keepdims=True)
        at_once = product(rows, prescribed.residual)
        seen, direct = at_once @ by_states, at_once @ by_inputs
        seen[:, :n] += rows @ modes
        for _ in range(order):
            _refuse_derivatives(assembly, direct)
            seen, direct = seen @ state, product(cleared(seen, size), cleared(drives, pushed))
        readings += seen
        feedthrough += direct


def _refuse_inertial(assembly: Assembly, loads: LoadedState) -> None:
    """Refuse inertial outputs in a rotating frame without the readings of its rotation, which they read too."""
    inertial = [term.name for term in assembly.terms if isinstance(term, Output) and term.inertial]
    if inertial and np.any(loads.gyroscopic) and assembly.rotation is None:
        raise ValueError(
            f"output {inertial[0]!r} reads motion against inertial space, which a linear model of a scene that spins "
            "does not include: simulate in time, or read velocity against the table (Vibrometer)"
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
                f"which no linear model of these inputs includes: {cure}; or simulate by generalized_alpha"
            )


def linearize_closed(
    scene: Scene,
    *,
    loops: Sequence[str] | None = None,
    noise: bool = False,
    continuous: bool = False,
    delay_order: int = DELAY_ORDER,
    angular_velocity: ArrayLike = NO_SPIN,
    axis_point: ArrayLike = NO_SPIN,
    stator: Sequence[str] | None = None,
    frame: str = "rotor",
    loaded: bool = True,
    constant_inputs: Mapping[str, float] | None = None,
) -> LinearModel:
    """Compute the linear model of a scene with its loops closed.

    Limits and quantisation of the loops' converters are left out.

    The model is sampled at the loops' rate: it is exactly what a simulation without saturation gives at its samples,
    with the excitation held between them. The sampled model warns of modes that are quasi-static in it and could make a
    loop unstable.

    Args:
        scene: the scene.
        loops: names of the loops to close (None: all); the others stay open, for design. With one loop left out,
            `nassim.systems.open_loop` of its controller is that loop while the others are closed.
        noise: whether to add inputs for the noise of the loops' measured outputs, see `nassim.systems.close_loop`.
        continuous: whether to return the continuous equivalent, with delay and hold as Pade approximations.
        delay_order: order of these approximations.
        angular_velocity: angular velocity of a scene that rotates, (3,) [rad/s], see `linearize`.
        axis_point: a point of the axis, (3,) [m].
        stator: names of the bodies of the stator, see `linearize`.
        frame: "rotor" or "stator", see `linearize`.
        loaded: whether gravity and the stress inside bodies change the stiffness, see `linearize`.
        constant_inputs: constant values of inputs that load the scene too, by name, see `linearize`.

    Returns:
        The linear model.

    Raises:
        ValueError: for a scene without loops, for an unknown loop, for one whose controller has no linear model, and
            for several sample rates unless continuous.
    """
    if not scene.loops:
        raise ValueError(f"scene {scene.name!r} has no loops; use linearize")
    known_loops = [loop.name for loop in scene.loops]
    wanted = known_loops if loops is None else [known("loop", n, known_loops) for n in unique("loop", loops)]
    closed = [loop for loop in scene.loops if loop.name in wanted]
    controllers = [loop.linear_controller for loop in closed]
    rates = {loop.controller.sample_rate for loop in closed or scene.loops}
    if len(rates) > 1 and not continuous:
        raise ValueError(
            f"the loops of scene {scene.name!r} have several sample rates; only the continuous model has all"
        )
    model = linearize(
        scene,
        angular_velocity=angular_velocity,
        axis_point=axis_point,
        stator=stator,
        frame=frame,
        loaded=loaded,
        constant_inputs=constant_inputs,
    )
    if not continuous:
        warn_of_folding(model, closed)
        model = sampled(model, rates.pop())
    for loop, controller in zip(closed, controllers, strict=True):
        model = close_loop(
            model,
            controller,
            measured=loop.measured,
            driven=loop.driven,
            reference=loop.reference,
            delay_order=delay_order,
            noise=noise,
        )
        if loop.feedforward is not None:
            model = _fed_forward(model, loop, loop.feedforward, delay_order)
    return model


def _fed_forward(model: LinearModel, loop: Loop, feedforward: Controller, delay_order: int) -> LinearModel:
    """Add the feedforward of a loop: a controller that reads references as outputs of the model."""
    n, names = len(model.outputs), tuple(f"{name} as the feedforward reads it" for name in loop.reference)
    direct = np.eye(len(model.inputs))[[model.inputs.index(name) for name in loop.reference]]
    both = replace(
        model,
        C=np.vstack([model.C, np.zeros((len(names), len(model.A)))]),
        D=np.vstack([model.D, direct]),
        outputs=(*model.outputs, *names),
        units=(),
    )
    closed = close_loop(both, feedforward, measured=names, driven=loop.driven, delay_order=delay_order)
    return replace(closed, C=closed.C[:n], D=closed.D[:n], outputs=model.outputs, units=model.units)
