"""A scene's matrices for small motion about its start: bodies, joints, damping and electrical ports put together."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from nassim.checks import Array
from nassim.floating_frame import FloatingFrame, floating_frame
from nassim.modal import elastic_ratios, modal_damping_matrix
from nassim.parts import (
    Actuator,
    Body,
    Encoder,
    FlexibleBody,
    GroundAcceleration,
    PointForce,
    RigidBody,
    StackActuator,
    VoltageDrive,
    VoltageSensor,
)
from nassim.rigid_motion import AXES, DIRECTIONS, rigid_transfer, unit_vector
from nassim.scene import Scene
from nassim.strain import joined, spring_strain, stiffness_root, strained_modes
from nassim.trim import open_circuit

LOST_DAMPING = 0.01
"""Share of a mode's damping whose loss is worth a warning."""
NO_EQUILIBRIUM = (
    "no static equilibrium: can a body move freely? Add joints, leave gravity out, or let the scene go as it is drawn "
    'by simulate(..., start="released")'
)
REDUNDANT = 1e-7
"""Constraints with less than this share of their own are implied by others."""


@dataclass(frozen=True)
class Circuit:
    """A resistance across an electrical port, whose charge is a state v = charge / capacitance [V] of its own.

    output: index of the sensor that measures it
    body: name of the flexible body; forces: on its coordinates per volt of v, (n,)
    capacitance [F]: of port and load; resistance [Ohm]; gain: output per volt [V/V]

    The voltage V = v - forces @ q / capacitance drives the current that discharges it:
    capacitance v' = -V / resistance.
    """

    output: int
    body: str
    forces: Array
    capacitance: float
    resistance: float
    gain: float


@dataclass(frozen=True)
class Amplifier:
    """A low-pass of first order between an input and forces: v' = rate (input - v).

    input: index; forces: on all coordinates per unit of v, (n_all,); rate [1/s]
    """

    input: int
    forces: Array
    rate: float


@dataclass(frozen=True)
class Assembly:
    """A scene's matrices for small motion: all bodies' coordinates, and the minimal ones that the joints leave.

    scene: what is modelled, after `Scene.trimmed`, with the stiffness that measured electrical ports have without
        charge
    slices: of each moving body's coordinates among all, by body name (flexible: the remote points' motions and
        the modes, in the body's frame; rigid: motion of the centre of mass in the world's frame)
    enforced: directions that each joint holds, by name, without those that other joints hold already
    basis: all coordinates from the minimal ones, shape (n_all, n), orthonormal columns
    mass, stiffness: in minimal coordinates, (n, n)
    frequency: eigenfrequencies of the undamped scene, ascending, exactly 0 for free motions only, (n,) [Hz]
    shapes: (n, n), unit modal mass
    damping_ratio: per mode, 0 for free motions, (n,) [-]
    input_matrix: forces on all coordinates per unit input, (n_all, inputs), but for those through amplifiers
    output_matrix: outputs per unit of all coordinates, (outputs, n_all)
    weight: forces of gravity on all coordinates, (n_all,)
    frames: floating frame of each flexible body, by name
    circuits: electrical ports whose charge leaks through a resistance
    amplifiers: actuators with a bandwidth
    damper_matrix: of the spring-dampers, beside modal damping, in minimal coordinates, (n, n)
    """

    scene: Scene
    slices: dict[str, slice]
    enforced: dict[str, tuple[str, ...]]
    basis: Array
    mass: Array
    stiffness: Array
    frequency: Array
    shapes: Array
    damping_ratio: Array
    input_matrix: Array
    output_matrix: Array
    weight: Array
    frames: dict[str, FloatingFrame]
    circuits: tuple[Circuit, ...]
    amplifiers: tuple[Amplifier, ...]
    damper_matrix: Array

    @property
    def free(self) -> Array:
        """Which modes are free motions, that strain no body and no spring, bool (n,)."""
        result: Array = self.frequency == 0
        return result

    @property
    def falls_into_modes(self) -> bool:
        """Whether nothing couples the undamped modes."""
        return not (self.circuits or self.amplifiers or np.any(self.damper_matrix))


def assemble(scene: Scene) -> Assembly:
    """Assemble a scene's mass and stiffness for small motion, and find its undamped eigenmodes."""
    scene = _as_modelled(scene.trimmed())
    frames = {body.name: floating_frame(body.reduced, scene.frame_point(body)) for body in scene.flexible_bodies}
    slices: dict[str, slice] = {}
    blocks: list[Array] = []
    for body in scene.bodies:
        if isinstance(body, RigidBody) and body.fixed:
            continue
        start = sum(map(len, blocks))
        blocks.append(_body_mass(body))
        slices[body.name] = slice(start, start + len(blocks[-1]))
    mass_all = scipy.linalg.block_diag(*blocks)
    n_all = len(mass_all)

    def motion(path: str) -> Array:
        return _point_motion(scene, slices, n_all, path)

    rigid, strains = [], []
    for body in scene.flexible_bodies:
        own = np.eye(n_all)[slices[body.name]]
        if body.fidelity == "rigid":
            rigid.append(frames[body.name].deformation(body.reduced) @ own)
        else:
            strains.append(body.reduced.strain.within(own))
    dampers = np.zeros((n_all, n_all))
    for spring in scene.springs:
        row = unit_vector(spring.axis) @ (motion(spring.b) - motion(spring.a))[:3]
        strains.append(spring_strain(row, spring.stiffness, mass_all))
        dampers += spring.damping * np.outer(row, row)
    held, enforced = _independent(scene, motion, np.vstack([np.zeros((0, n_all)), *rigid]), mass_all)
    basis = _null_space(held, mass_all)
    mass, strain = basis.T @ mass_all @ basis, joined(strains, n_all).within(basis)
    frequency, shapes = strained_modes(strain, mass)
    ratio = elastic_ratios(frequency, scene.damping_ratio)
    input_matrix = np.zeros((n_all, len(scene.inputs)))
    amplifiers = []
    for actuator in scene.actuators:
        index, forces = scene.inputs.index(actuator.input), _forces(scene, actuator, slices, motion)
        if isinstance(actuator, (StackActuator, VoltageDrive)) and np.isfinite(actuator.bandwidth):
            amplifiers.append(Amplifier(index, forces, 2 * np.pi * actuator.bandwidth))
        else:
            input_matrix[:, index] += forces
    circuits = [
        _circuit(scene, sensor, k)
        for k, sensor in enumerate(scene.sensors)
        if isinstance(sensor, VoltageSensor) and np.isfinite(sensor.resistance)
    ]
    return Assembly(
        scene,
        slices,
        enforced,
        basis,
        mass,
        strain.stiffness,
        frequency,
        shapes,
        ratio,
        input_matrix,
        _output_matrix(scene, slices, motion),
        _weight(scene, slices, n_all, scene.gravity),
        frames,
        tuple(circuits),
        tuple(amplifiers),
        basis.T @ dampers @ basis,
    )


def motion_size(assembly: Assembly, name: str, coordinates: Array) -> Array:
    """Largest rotation [rad] of a body's points and largest displacement by deformation over its size [-], shape (2,).

    coordinates: of the body, at one or more times, shape (n, n_times); in a floating frame, those of deformation, so
    that the rotation is that by deformation only
    """
    body = next(body for body in assembly.scene.bodies if body.name == name)
    if isinstance(body, RigidBody):
        return np.array([np.abs(coordinates[3:]).max(), 0.0])
    n_points = len(body.reduced.remote_points)
    rotation = np.abs(coordinates[: 6 * n_points].reshape(n_points, 6, -1)[:, 3:]).max()
    deformation = assembly.frames[name].deformation(body.reduced) @ coordinates
    other_points = deformation[: 6 * n_points - 6].reshape(n_points - 1, 6, coordinates.shape[1])
    moved = np.abs(other_points[:, :3]).max(initial=0.0)
    middle = body.reduced.gram[1:4, 1:4] / body.reduced.mass - np.outer(*[body.reduced.center_of_mass] * 2)
    return np.array([rotation, moved / np.sqrt(np.trace(middle))])


def deformable_bodies(scene: Scene) -> tuple[FlexibleBody, ...]:
    """The flexible bodies that the scene lets deform, in order."""
    return tuple(body for body in scene.flexible_bodies if body.fidelity != "rigid")


def deformation_damping(assembly: Assembly) -> Array:
    """Damping matrix on the flexible coordinates of all bodies that deform, in order, that realises the modal ratios.

    With D the map from minimal to flexible coordinates, the damping C of the modes is D^T C_f D for
    C_f = D^+T C D^+: exact where motion without deformation has no damped mode. Modes of bodies that only springs hold
    lose damping, of which a warning tells.
    """
    bodies = deformable_bodies(assembly.scene)
    if not bodies:
        _warn_of_lost_damping(assembly, np.zeros_like(assembly.mass))
        return np.zeros((0, 0))
    rows = []
    for body in bodies:
        part = assembly.basis[assembly.slices[body.name]]
        rows.append(assembly.frames[body.name].deformation(body.reduced) @ part)
    deformation = np.vstack(rows)
    damping = modal_damping_matrix(assembly.mass, assembly.frequency, assembly.shapes, assembly.damping_ratio)
    # Coordinates in metres, radians and modal units: scale to comparable energy before the pseudo-inverse.
    roots = [
        stiffness_root(assembly.frames[b.name].stiffness_matrix, n_points=6 * len(b.reduced.remote_points) - 6)[1]
        for b in bodies
    ]
    root = scipy.linalg.block_diag(*roots)
    inverse = np.linalg.pinv(root @ deformation, rcond=1e-9) @ root
    result: Array = inverse.T @ damping @ inverse
    _warn_of_lost_damping(assembly, deformation.T @ result @ deformation)
    return result


def _as_modelled(scene: Scene) -> Scene:
    """The scene with the stiffness that bodies have while their measured electrical ports keep their charge.

    Bodies of which nothing but six rigid motions is left are rigid.
    """
    bodies: list[Body] = []
    for body in scene.bodies:
        if isinstance(body, FlexibleBody):
            measured = [s for s in scene.sensors if isinstance(s, VoltageSensor) and scene.split(s.port)[0] is body]
            loads = {sensor.port.partition(".")[2]: sensor.capacitance for sensor in measured}
            reduced = open_circuit(body.reduced, loads) if measured else body.reduced
            stiff = body.fidelity == "ffrf" and len(reduced.mass_matrix) == 6
            bodies.append(replace(body, reduced=reduced, fidelity="rigid" if stiff else body.fidelity))
        else:
            bodies.append(body)
    return replace(scene, bodies=tuple(bodies))


def _circuit(scene: Scene, sensor: VoltageSensor, output: int) -> Circuit:
    body, port = scene.split(sensor.port)
    assert isinstance(body, FlexibleBody)
    coupling = body.reduced.port(port)
    capacitance = coupling.blocked_capacitance + sensor.capacitance
    return Circuit(output, body.name, coupling.forces, capacitance, sensor.resistance, sensor.gain)


def _body_mass(body: Body) -> Array:
    if isinstance(body, FlexibleBody):
        return body.reduced.mass_matrix
    assert body.mass is not None
    assert body.inertia is not None
    result: Array = scipy.linalg.block_diag(body.mass * np.eye(3), body.inertia)
    return result


def _forces(scene: Scene, actuator: Actuator, slices: dict[str, slice], motion: Callable[[str], Array]) -> Array:
    """Forces of an actuator on all coordinates per unit of its input."""
    n_all = max(place.stop for place in slices.values())
    if isinstance(actuator, PointForce):
        result: Array = unit_vector(actuator.axis) @ motion(actuator.point)[:3]
        return result
    if isinstance(actuator, GroundAcceleration):
        return _weight(scene, slices, n_all, -unit_vector(actuator.axis))
    forces = np.zeros(n_all)
    body, row = scene.body_row(actuator)
    forces[slices[body.name]] = row
    return forces


def _output_matrix(scene: Scene, slices: dict[str, slice], motion: Callable[[str], Array]) -> Array:
    """Outputs per unit of all coordinates, at ports without charge."""
    result = np.zeros((len(scene.sensors), max(place.stop for place in slices.values())))
    for k, sensor in enumerate(scene.sensors):
        if isinstance(sensor, Encoder):
            result[k] = unit_vector(sensor.axis) @ (motion(sensor.b) - motion(sensor.a))[:3]
        else:
            body, row = scene.body_row(sensor)
            result[k, slices[body.name]] = row
    return result


def _weight(scene: Scene, slices: dict[str, slice], n_all: int, gravity: Array) -> Array:
    """Forces of a uniform gravity, world frame, on all coordinates."""
    result = np.zeros(n_all)
    for body in scene.bodies:
        if body.name in slices:
            result[slices[body.name]] = body_weight(body, gravity)
    return result


def _warn_of_lost_damping(assembly: Assembly, realised: Array) -> None:
    """Warn of modes that a damping matrix in minimal coordinates, (n, n), damps less than they should be."""
    wanted = 4 * np.pi * assembly.damping_ratio * assembly.frequency
    lost = wanted - np.einsum("ik,ij,jk->k", assembly.shapes, realised, assembly.shapes)
    modes = (lost > LOST_DAMPING * wanted) & ~assembly.free
    if modes.any():
        listed = ", ".join(f"{f:.4g}" for f in assembly.frequency[modes][:5])
        warnings.warn(
            f"damping_ratio acts through deformation only, so the modes at {listed} Hz, in which springs rather than "
            "bodies deform, lose damping in this simulation: give the spring-dampers a damping of their own and such "
            "modes a ratio of 0",
            stacklevel=2,
        )


def body_weight(body: Body, gravity: Array) -> Array:
    """Forces of gravity on a body's coordinates."""
    if isinstance(body, RigidBody):
        assert body.mass is not None
        return np.concatenate([body.mass * gravity, np.zeros(3)])
    fall = np.zeros(len(body.reduced.mass_matrix))
    fall[: 6 * len(body.reduced.remote_points)] = np.tile(
        [*(body.rotation.T @ gravity), 0, 0, 0], len(body.reduced.remote_points)
    )
    result: Array = body.reduced.mass_matrix @ fall
    return result


def _point_motion(scene: Scene, slices: dict[str, slice], n_all: int, path: str) -> Array:
    """Small motion of a point in the world's frame from all coordinates, shape (6, n_all)."""
    body, point = scene.split(path)
    rows = np.zeros((6, n_all))
    if isinstance(body, FlexibleBody):
        rows[:, slices[body.name]] = scipy.linalg.block_diag(body.rotation, body.rotation) @ body.reduced.motion(point)
    elif not body.fixed:
        rows[:, slices[body.name]] = rigid_transfer(body.points[point])
    return rows


def _independent(
    scene: Scene, motion: Callable[[str], Array], rows: Array, mass: Array
) -> tuple[Array, dict[str, tuple[str, ...]]]:
    """Constraints of all joints after the given ones, less those that earlier ones imply, and what each joint holds."""
    scale = 1.0 / np.sqrt(np.diag(mass))
    basis = scipy.linalg.orth((rows * scale).T).T if len(rows) else rows  # SciPy before 1.14 takes no empty matrix
    kept = [rows]
    enforced: dict[str, tuple[str, ...]] = {}
    for joint in scene.joints:
        relative = motion(joint.b) - motion(joint.a)
        holds = []
        for direction, axis in DIRECTIONS.items():
            if direction in joint.free:
                continue
            row = relative[AXES.index(axis)]
            rest = row * scale
            size = np.linalg.norm(rest)
            for _ in range(2):  # twice is enough for orthogonality to the last digit
                rest = rest - basis.T @ (basis @ rest)
            if np.linalg.norm(rest) > REDUNDANT * size:
                basis = np.vstack([basis, rest / np.linalg.norm(rest)])
                kept.append(row[None])
                holds.append(direction)
        enforced[joint.name] = tuple(holds)
    return np.vstack(kept), enforced


def _null_space(constraints: Array, mass: Array) -> Array:
    """Orthonormal basis of the motions that satisfy the constraints; redundant constraints do no harm."""
    n = len(mass)
    if len(constraints) == 0:
        return np.eye(n)
    # The scale turns metres, radians and modal amplitudes into comparable square roots of energy.
    scale = 1.0 / np.sqrt(np.diag(mass))
    scaled = constraints * scale
    scaled = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
    return scale[:, None] * scipy.linalg.null_space(scaled, rcond=1e-9)
