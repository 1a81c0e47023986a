"""The linear model of a scene: small motion about its start, in minimal coordinates."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from nassim.checks import Array, finite_array, freeze
from nassim.floating_frame import FloatingFrame, floating_frame
from nassim.frf import FRF
from nassim.interface import AXES, DIRECTIONS, rigid_transfer
from nassim.modal import eigenmodes, modal_damping_matrix
from nassim.scene import Body, Encoder, FlexibleBody, RigidBody, Scene, StackActuator, StackSensor

WELL_CONDITIONED = 1e8
REDUNDANT = 1e-7
"""Constraints with less than this share of their own are implied by others."""


@dataclass(frozen=True)
class LinearModel:
    """State space dx/dt = A x + B u, y = C x + D u with named inputs and outputs.

    A: (n, n); B: (n, inputs); C: (outputs, n); D: (outputs, inputs)
    units: of the outputs
    """

    A: Array
    B: Array
    C: Array
    D: Array
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n, n_in, n_out = len(self.A), len(self.inputs), len(self.outputs)
        freeze(
            self,
            A=finite_array("A", self.A, (n, n)),
            B=finite_array("B", self.B, (n, n_in)),
            C=finite_array("C", self.C, (n_out, n)),
            D=finite_array("D", self.D, (n_out, n_in)),
        )

    def poles(self) -> Array:
        """Eigenvalues of A, complex, shape (n,) [rad/s]."""
        result: Array = np.linalg.eigvals(self.A)
        return result


@dataclass(frozen=True)
class Assembly:
    """A scene's matrices for small motion: all bodies' coordinates, and the minimal ones that the joints leave.

    scene: what is modelled, after `Scene.trimmed`
    slices: of each moving body's coordinates among all, by body name (flexible: the remote points' motions and
        the modes, in the body's frame; rigid: motion of the centre of mass in the world's frame)
    enforced: directions that each joint holds, by name, without those that other joints hold already
    basis: all coordinates from the minimal ones, shape (n_all, n), orthonormal columns
    mass, stiffness: in minimal coordinates, (n, n)
    frequency: eigenfrequencies of the undamped scene, ascending, (n,) [Hz]; shapes: (n, n), unit modal mass
    damping_ratio: per mode, (n,) [-]
    input_matrix: forces on all coordinates per unit input, (n_all, inputs)
    output_matrix: outputs per unit of all coordinates, (outputs, n_all)
    weight: forces of gravity on all coordinates, (n_all,)
    frames: floating frame of each flexible body, by name
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


def assemble(scene: Scene) -> Assembly:
    """Assemble a scene's mass and stiffness for small motion, and find its undamped eigenmodes."""
    scene = scene.trimmed()
    frames = {body.name: floating_frame(body.reduced, scene.frame_point(body)) for body in scene.flexible_bodies}
    slices: dict[str, slice] = {}
    blocks: list[tuple[Array, Array]] = []
    for body in scene.bodies:
        if isinstance(body, RigidBody) and body.fixed:
            continue
        start = sum(len(m) for m, _ in blocks)
        blocks.append(_body_matrices(body))
        slices[body.name] = slice(start, start + len(blocks[-1][0]))
    mass_all, stiffness_all = (scipy.linalg.block_diag(*kind) for kind in zip(*blocks, strict=True))
    n_all = len(mass_all)

    def motion(path: str) -> Array:
        return _point_motion(scene, slices, n_all, path)

    rigid = []
    for body in scene.flexible_bodies:
        if body.fidelity == "rigid":
            rows = np.zeros((len(frames[body.name].flexible), n_all))
            rows[:, slices[body.name]] = frames[body.name].deformation(body.reduced)
            rigid.append(rows)
    held, enforced = _independent(scene, motion, np.vstack([np.zeros((0, n_all)), *rigid]), mass_all)
    basis = _null_space(held, mass_all)
    mass, stiffness = basis.T @ mass_all @ basis, basis.T @ stiffness_all @ basis
    frequency, shapes = eigenmodes(stiffness, mass)
    given = np.atleast_1d(np.asarray(scene.damping_ratio, dtype=float))
    ratio = given[np.minimum(np.arange(len(frequency)), len(given) - 1)]
    input_matrix = np.zeros((n_all, len(scene.inputs)))
    for actuator in scene.actuators:
        force = actuator.gain * actuator.force_per_volt
        input_matrix[:, scene.inputs.index(actuator.input)] += force * _elongation(scene, slices, n_all, actuator)
    outputs = np.zeros((len(scene.sensors), n_all))
    for row, sensor in enumerate(scene.sensors):
        if isinstance(sensor, Encoder):
            outputs[row] = (motion(sensor.b) - motion(sensor.a))["xyz".index(sensor.axis)]
        else:
            outputs[row] = -sensor.voltage_per_elongation * _elongation(scene, slices, n_all, sensor)
    weight = np.zeros(n_all)
    for body in scene.bodies:
        if body.name in slices:
            weight[slices[body.name]] = _weight(body, scene.gravity)
    return Assembly(
        scene, slices, enforced, basis, mass, stiffness, frequency, shapes, ratio, input_matrix, outputs, weight, frames
    )


def linearize(scene: Scene) -> LinearModel:
    """The scene's linear model about its start, with the modal damping that the scene states.

    The states are the minimal coordinates' modal amplitudes and their rates. Gravity's effect on stiffness and
    gyroscopic terms of a spinning body are not part of it.
    """
    a = assemble(scene)
    omega = 2 * np.pi * a.frequency
    n = len(omega)
    modes = a.basis @ a.shapes
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(omega**2), -np.diag(2 * a.damping_ratio * omega)]])
    forces = np.vstack([np.zeros((n, len(scene.inputs))), modes.T @ a.input_matrix])
    readings = np.hstack([a.output_matrix @ modes, np.zeros((len(scene.outputs), n))])
    feedthrough = np.zeros((len(scene.outputs), len(scene.inputs)))
    units = tuple(sensor.unit for sensor in scene.sensors)
    return LinearModel(state, forces, readings, feedthrough, scene.inputs, scene.outputs, units)


def frequency_response(model: LinearModel, frequency: Array, *, label: str = "linear model") -> FRF:
    """FRF of a linear model at the given frequencies, shape (n,) [Hz].

    By the eigenvectors of A, which costs milliseconds; where they do not span (a double pole at one place, as of rigid
    motion without damping) by a solve per frequency.
    """
    frequency = finite_array("frequency", frequency, (None,))
    s = 2j * np.pi * frequency
    if not len(model.A):
        nothing = np.broadcast_to(model.D[:, :, None], (*model.D.shape, len(frequency))).astype(complex)
        return FRF(frequency, nothing, model.outputs, model.inputs, None, label)
    poles, vectors = np.linalg.eig(model.A)
    if np.linalg.cond(vectors / np.linalg.norm(vectors, axis=0)) < WELL_CONDITIONED:
        inputs = np.linalg.solve(vectors, model.B.astype(complex))
        values = np.einsum("ok,ki,kf->oif", model.C @ vectors, inputs, 1.0 / (s - poles[:, None])) + model.D[:, :, None]
    else:
        resolvent = s[:, None, None] * np.eye(len(model.A)) - model.A
        states = np.linalg.solve(resolvent, np.broadcast_to(model.B, (len(frequency), *model.B.shape)))
        values = (model.C @ states + model.D).transpose(1, 2, 0)
    return FRF(frequency, values, model.outputs, model.inputs, None, label)


def truncation_error(scene: Scene, frequency: Array) -> Array:
    """Estimated relative error of a scene's FRFs due to the modes that its flexible bodies leave out.

    frequency: (n,) [Hz]. Returns |H / H_enriched - 1|, shape (outputs, inputs, n) [-], where H_enriched is the FRF of
    the scene with every body in its `enriched` form. Raises ValueError where a body has none.
    """
    bodies: list[Body] = []
    for body in scene.bodies:
        if isinstance(body, FlexibleBody):
            if body.reduced.enriched is None:
                raise ValueError(f"body {body.name!r} carries no enriched form, so its truncation error is unknown")
            bodies.append(replace(body, reduced=body.reduced.enriched))
        else:
            bodies.append(body)
    better = frequency_response(
        linearize(replace(scene, bodies=tuple(bodies), cutoff_frequency=None)), frequency
    ).values
    result: Array = np.abs(frequency_response(linearize(scene), frequency).values / better - 1)
    return result


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
    C_f = D^+T C D^+: exact, because motion without deformation has no damped mode.
    """
    bodies = deformable_bodies(assembly.scene)
    if not bodies:
        return np.zeros((0, 0))
    rows = []
    for body in bodies:
        part = assembly.basis[assembly.slices[body.name]]
        rows.append(assembly.frames[body.name].deformation(body.reduced) @ part)
    deformation = np.vstack(rows)
    damping = modal_damping_matrix(assembly.mass, assembly.frequency, assembly.shapes, assembly.damping_ratio)
    # Coordinates in metres, radians and modal units: scale to comparable energy before the pseudo-inverse.
    stiffness = scipy.linalg.block_diag(*(assembly.frames[body.name].stiffness_matrix for body in bodies))
    factor = np.linalg.cholesky(stiffness)
    inverse = np.linalg.pinv(factor.T @ deformation, rcond=1e-9) @ factor.T
    result: Array = inverse.T @ damping @ inverse
    return result


def _body_matrices(body: Body) -> tuple[Array, Array]:
    if isinstance(body, FlexibleBody):
        return body.reduced.mass_matrix, body.reduced.stiffness_matrix
    assert body.mass is not None
    assert body.inertia is not None
    return scipy.linalg.block_diag(body.mass * np.eye(3), body.inertia), np.zeros((6, 6))


def _weight(body: Body, gravity: Array) -> Array:
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


def _elongation(scene: Scene, slices: dict[str, slice], n_all: int, stack: StackActuator | StackSensor) -> Array:
    """Row that gives a stack's elongation from all coordinates, shape (n_all,)."""
    axis = scene.point_position(stack.end) - scene.point_position(stack.start)
    axis = axis / np.linalg.norm(axis)
    ends = (_point_motion(scene, slices, n_all, path) for path in (stack.start, stack.end))
    first, last = (axis @ motion[:3] for motion in ends)
    result: Array = last - first
    return result


def _independent(
    scene: Scene, motion: Callable[[str], Array], rows: Array, mass: Array
) -> tuple[Array, dict[str, tuple[str, ...]]]:
    """Constraints of all joints after the given ones, less those that earlier ones imply, and what each joint holds."""
    scale = 1.0 / np.sqrt(np.diag(mass))
    basis = scipy.linalg.orth((rows * scale).T).T
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
