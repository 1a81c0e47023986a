"""The linear model of a scene: small motion about its start, at rest or spinning, with loops open or closed."""

import numpy as np
from numpy.typing import ArrayLike

from nassim.base.checks import Array
from nassim.scene.part import Constraint, Force, Line, Reading, Row, SixSprings, Spring
from nassim.scene.scene import Scene
from nassim.simulation.following import product
from nassim.simulation.small_motion import Assembly, assemble
from nassim.simulation.spinning import Spinning, spinning
from nassim.systems.feedback import DELAY_ORDER, close_loop
from nassim.systems.linear_model import LinearModel, sampled, unstable_poles
from nassim.systems.state_space import StateSpace

STANDING = (0.0, 0.0, 0.0)
"""No angular velocity, and the origin."""


def linearize(scene: Scene, *, angular_velocity: ArrayLike = STANDING, axis_point: ArrayLike = STANDING) -> LinearModel:
    """The scene's linear model about its start, with the damping of its modes, bodies and dampers.

    A scene with a drive of constant speed in a joint to a fixed body is that of the turning table, at this speed.

    angular_velocity: constant, of a scene that turns as a whole, fixed bodies too, (3,) [rad/s]; axis_point: a point of
        its axis, (3,) [m]. The scene is then as seen from the table that turns: its axes turn, signals read motion
        against the table, the model is about the equilibrium under centrifugal forces, and damping is of the parts
        that turn. See `nassim.simulation.spinning` for what it holds and leaves out.

    The states are the minimal coordinates' modal amplitudes, of the scene at rest, and their rates, then the charges of
    ports that leak (as volts) and the outputs of amplifiers and drives with a bandwidth; with drives that follow
    inputs, amplitudes are those of `nassim.simulation.following`. The scene's loops are open. Gravity's
    effect on stiffness and a body's own angular_velocity are not part of it. Raises ValueError for a spin without an
    equilibrium near the start, and for outputs that would need an input's derivative.
    """
    assembly = assemble(scene)
    if scene.speeds:
        if np.any(angular_velocity):
            raise ValueError(f"scene {scene.name!r} has a drive that sets the spin; give no angular_velocity")
        angular_velocity, axis_point = spin_of_drive(scene)
    a, b, c, d = state_space(assembly, spinning(assembly, angular_velocity, axis_point))
    return LinearModel(a, b[:, :-1], c, d[:, :-1], scene.inputs, scene.outputs, scene.output_units)


def spin_of_drive(scene: Scene) -> tuple[Array, Array]:
    """Angular velocity of a scene's drive of constant speed, (3,) [rad/s], and a point of its axis, (3,) [m].

    Raises ValueError for several such drives, for one that shifts, and where not everything that moves turns with it:
    the model would change while it turns.
    """
    (word, *others) = scene.speeds
    joint = next(joint for joint in scene.said(Constraint) if joint.name == word.constraint)
    if others or not word.direction.startswith("r"):
        raise ValueError(f"scene {scene.name!r}: a linear model is about one drive that turns at constant speed")
    still = [body.name for body in scene.bodies if not body.moves]
    ends = [path.partition(".")[0] in still for path in (joint.a, joint.b)]
    if sum(ends) != 1:
        raise ValueError(f"joint {joint.name!r}: a drive of constant speed needs a fixed body on one side")
    axis = joint.axes[:, "xyz".index(word.direction[1])]
    for other in scene.words:
        if isinstance(other, Spring) and _about(axis, joint, other.row):
            continue
        if isinstance(other, (Constraint, SixSprings)):
            paths: tuple[str, ...] = (other.a, other.b)
        elif isinstance(other, (Spring, Reading, Force)):
            paths = other.row.paths
        else:
            continue
        if other is not joint and any(path.partition(".")[0] in still for path in paths):
            raise ValueError(
                f"{' and '.join(paths)}: a part between the ground and what turns at constant speed makes the model "
                "change as it turns; let it be on the turning table, or simulate in time"
            )
    sign = 1.0 if ends[0] else -1.0
    return sign * word.speed * axis, scene.point_position(joint.a)


def _about(axis: Array, joint: Constraint, row: Row | Line) -> bool:
    """Whether a row is the motion of a joint's points along or about an axis, wherever it has turned, as its damper."""
    if isinstance(row, Line) or set(row.paths) != {joint.a, joint.b}:
        return False
    return all(np.allclose(np.cross(weights.reshape(2, 3), axis), 0.0, atol=1e-9) for _, weights in row.points)


def spinning_equilibrium(
    scene: Scene, *, angular_velocity: ArrayLike, axis_point: ArrayLike = STANDING
) -> dict[str, float]:
    """Outputs of a scene at rest on a table that turns: what centrifugal forces do, without gravity and inputs.

    Arguments as of `linearize`; loops are open. Raises ValueError where there is no equilibrium within small motion,
    and where it is unstable.
    """
    assembly = assemble(scene)
    spin = spinning(assembly, angular_velocity, axis_point)
    state, _, readings, _ = state_space(assembly, spin)
    growing = unstable_poles(
        LinearModel(state, np.zeros((len(state), 0)), np.zeros((0, len(state))), np.zeros((0, 0)), (), ())
    )
    if growing:
        raise ValueError(f"the spinning equilibrium of scene {scene.name!r} is unstable: {growing[0]}; spin slower")
    at_rest = np.zeros(len(state))
    at_rest[: len(spin.equilibrium)] = np.linalg.solve(assembly.shapes, spin.equilibrium)
    for j, circuit in enumerate(assembly.circuits, start=2 * len(spin.equilibrium)):
        at_rest[j] = circuit.forces @ assembly.basis @ spin.equilibrium / circuit.capacitance
    # Accelerations of what rests vanish but for rounding.
    values: Array = readings @ at_rest * (np.array(assembly.derivatives) == 0)
    return dict(zip(scene.outputs, map(float, values), strict=True))


def state_space(assembly: Assembly, spin: Spinning | None = None) -> StateSpace:
    """A, B, C and D of an assembled scene; the last column of B and D is gravity, a constant input of one.

    spin: of a scene that turns, in whose frame gravity is constant along the axis only
    States: modal amplitudes and their rates, then the charges of circuits (as volts), the amplifiers' outputs and those
    of the drives' servos. With drives that follow inputs, amplitudes and rates are a and b of
    `nassim.simulation.following`. Raises ValueError for outputs that would need a derivative of such an input.
    """
    a = assembly
    omega = 2 * np.pi * a.frequency
    n, n_in, n_out = len(omega), a.input_matrix.shape[1], len(a.output_matrix)
    modes = a.basis @ a.shapes
    size = 2 * n + len(a.circuits) + len(a.amplifiers) + len(a.following.lags)
    state, drives = np.zeros((size, size)), np.zeros((size, n_in + 1))
    readings, feedthrough = np.zeros((n_out, size)), np.zeros((n_out, n_in + 1))
    velocity = slice(n, 2 * n)
    state[:n, velocity] = np.eye(n)
    state[velocity, :n] = -np.diag(omega**2)
    state[velocity, velocity] = -a.damping.of_modes
    if spin is not None:
        state[velocity, :n] -= a.shapes.T @ spin.stiffness @ a.shapes
        state[velocity, velocity] -= a.shapes.T @ spin.gyroscopic @ a.shapes
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
    lagging, taken = a.following.lagging(size), a.following.taken(n_in + 1)
    for j, k in enumerate(a.following.lags, start=size - len(a.following.lags)):
        state[j, j], drives[j, a.following.inputs[k]] = -a.following.rates[k], a.following.rates[k]
    moved = _moved_by_drives(a, spin, state)
    state += moved @ lagging
    drives += moved @ taken
    for order in range(3):
        rows = a.output_matrix * (np.array(a.derivatives) == order)[:, None]
        at_once = product(rows, a.following.beyond)
        seen, direct = at_once @ lagging, at_once @ taken
        seen[:, :n] += rows @ modes
        for step in range(order):
            _refuse_derivatives(a, direct, step)
            seen, direct = seen @ state, product(seen, drives)
        readings += seen
        feedthrough += direct
    return state, drives, readings, feedthrough


def _moved_by_drives(a: Assembly, spin: Spinning | None, state: Array) -> Array:
    """Rates of all states per unit of the drives' motions, (size, d), with the system matrix as it is without them."""
    n, following = len(a.frequency), a.following
    position, velocity = slice(n), slice(n, 2 * n)
    drag, pull = following.drag, np.zeros_like(following.drag)
    if spin is not None:
        drag, pull = drag + a.shapes.T @ spin.drag, a.shapes.T @ spin.pull
    result = np.zeros((len(state), drag.shape[1]))
    result[position] = slip = product(
        np.hstack([-state[velocity, velocity], -np.eye(n)]), np.vstack([following.momentum, drag])
    )
    result[velocity] = state[velocity, velocity] @ slip - state[velocity, position] @ following.momentum - pull
    for j, circuit in enumerate(a.circuits, start=2 * n):
        result[j] = circuit.forces @ following.beyond / (circuit.resistance * circuit.capacitance**2)
    return result


def _refuse_derivatives(a: Assembly, direct: Array, step: int) -> None:
    """ValueError where outputs read a derivative of what inputs make at once, direct, (outputs, inputs + 1)."""
    for output, row in zip(a.scene.outputs, direct, strict=True):
        if np.any(row):
            name = a.scene.inputs[int(np.argmax(np.abs(row)))]
            kind, given = (("a velocity", "derivative"), ("an acceleration", "derivatives"))[step]
            raise ValueError(
                f"output {output!r} reads {kind} that follows the {given} of input {name!r} at once, which no linear "
                "model of these inputs holds: give the drive a bandwidth, or read a displacement"
            )


def linearize_closed(
    scene: Scene,
    *,
    continuous: bool = False,
    delay_order: int = DELAY_ORDER,
    angular_velocity: ArrayLike = STANDING,
    axis_point: ArrayLike = STANDING,
) -> LinearModel:
    """The linear model of a scene with all its loops closed, their converters and limits left out.

    angular_velocity, axis_point: of a scene that turns as a whole, see `linearize`

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
    model = linearize(scene, angular_velocity=angular_velocity, axis_point=axis_point)
    if not continuous:
        model = sampled(model, rates.pop())
    for loop in scene.loops:
        model = close_loop(model, loop.controller, measured=loop.measured, driven=loop.driven, delay_order=delay_order)
    return model
