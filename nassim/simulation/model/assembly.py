"""Assembly of a scene: the matrices of its bodies and terms for small motion about its start."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.modal import elastic_damping_ratios
from nassim.bodies.floating_frame import FloatingFrame, floating_frame
from nassim.bodies.strain import Strain, combine_strains, spring_strain, stiffness_root, strain_eigenmodes
from nassim.scene.bodies import Body, FlexibleBody, RigidBody
from nassim.scene.scene import Scene
from nassim.scene.terms import (
    AppliedForce,
    BaseAcceleration,
    Output,
    Shunt,
    Spring,
    SpringForce,
    Term,
)
from nassim.simulation.model.constraints import constraint_rows, null_space
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.damping import Damping, own_damping
from nassim.simulation.model.filters import ground_accelerations, output_filters
from nassim.simulation.model.prescribed_motion import PrescribedMotions, prescribed_motion_of, prescribed_motions
from nassim.simulation.model.states import ReferenceState
from nassim.simulation.model.tangents import Tangent, law_tangents, tangent_of
from nassim.simulation.model.trimming import trim_scene, without_pictures
from nassim.simulation.model.unsupported_modes import unsupported_modes
from nassim.systems.state_space import StateSpace


@dataclass(frozen=True)
class Circuit:
    """A resistance across an electrical port, whose charge is a state v = charge / capacitance [V].

    The port's voltage V = v - forces @ q / capacitance drives the current that discharges it:
    capacitance v' = -V / resistance.

    Attributes:
        output: name of the output to which the voltage adds.
        forces: forces on all coordinates q per volt of v, (n_all,).
        capacitance: capacitance of port and load [F].
        resistance: resistance [Ohm].
        gain: output per volt.
    """

    output: str
    forces: Array
    capacitance: float
    resistance: float
    gain: float


@dataclass(frozen=True)
class Amplifier:
    """A low-pass of first order between an input and forces: v' = rate (input - v).

    Attributes:
        input: index of the input.
        forces: forces on all coordinates per unit of v, (n_all,).
        rate: rate of the low-pass [1/s].
    """

    input: int
    forces: Array
    rate: float


@dataclass(frozen=True)
class Assembly:
    """Matrices of a scene for small motion: in all bodies' coordinates, and in the minimal ones that the joints leave.

    Attributes:
        scene: the modelled scene, after `trim_scene`. Its bodies include the stiffness of springs within them, such as
            electrical ports that keep their charge.
        terms: terms of the parts, except these springs.
        coordinates: all coordinates, and measures on them.
        slices: slice of each moving body's coordinates among all, by body name (flexible: motions of the remote points
            and modes, in the body's frame; rigid: motion of the centre of mass in the world's frame).
        enforced: directions that each joint holds, by name, without those that other joints hold already.
        basis: all coordinates per unit of the minimal coordinates, (n_all, n), orthonormal columns.
        mass: mass matrix in minimal coordinates, (n, n).
        stiffness: stiffness matrix in minimal coordinates, (n, n).
        frequency: eigenfrequencies of the undamped scene, ascending, exactly 0 for rigid-body modes only, (n,) [Hz].
        shapes: eigenmodes in minimal coordinates, (n, n), unit modal mass.
        damping: damping of the modes, of bodies and of dampers.
        input_matrix: forces on all coordinates per unit input, (n_all, inputs), without those through amplifiers.
        output_matrix: outputs before the filters per unit of all coordinates, (outputs, n_all).
        velocity_matrix: outputs per unit of the coordinates' first derivatives, (outputs, n_all).
        acceleration_matrix: outputs per unit of the coordinates' second derivatives, (outputs, n_all).
        ground_matrix: the ground's acceleration along the directions of inertial outputs, per unit input, (outputs,
            inputs).
        filters: filters by output, including outputs to which the ground's acceleration adds, see
            `nassim.simulation.model.filters`.
        weight: forces of gravity on all coordinates, (n_all,).
        tangents: force laws about the static equilibrium.
        frames: floating frame of each flexible body, by name.
        circuits: electrical ports with a resistance.
        amplifiers: actuators with a bandwidth.
        prescribed: effect of drives that follow inputs; the minimal coordinates are those of motion with these at rest.
        unsupported: modes beyond the valid frequency of the bodies' reductions, quasi-static in sampled models, bool
            (n,).
    """

    scene: Scene
    terms: tuple[Term, ...]
    coordinates: Coordinates
    slices: dict[str, slice]
    enforced: dict[str, tuple[str, ...]]
    basis: Array
    mass: Array
    stiffness: Array
    frequency: Array
    shapes: Array
    damping: Damping
    input_matrix: Array
    output_matrix: Array
    velocity_matrix: Array
    acceleration_matrix: Array
    ground_matrix: Array
    filters: dict[str, StateSpace]
    weight: Array
    tangents: tuple[Tangent, ...]
    frames: dict[str, FloatingFrame]
    circuits: tuple[Circuit, ...]
    amplifiers: tuple[Amplifier, ...]
    prescribed: PrescribedMotions
    unsupported: Array

    @property
    def rigid_modes(self) -> Array:
        """Whether each mode is a rigid-body mode, which strains no body and no spring, bool (n,)."""
        result: Array = self.frequency == 0
        return result

    @property
    def scale(self) -> Array:
        """Square roots of the masses of all coordinates, (n_all,)."""
        moving = [body for body in self.scene.bodies if body.moves]
        return np.sqrt(np.concatenate([np.zeros(0), *(np.diag(body.mass_matrix) for body in moving)]))

    @property
    def modes_uncoupled(self) -> bool:
        """Whether the undamped modes are uncoupled, outputs read displacements only and inputs act as forces only."""
        coupled = self.circuits or self.amplifiers or self.prescribed.inputs or np.any(self.damping.non_modal)
        return not (coupled or self.filters or np.any(self.velocity_matrix) or np.any(self.acceleration_matrix))


def assemble(scene: Scene) -> Assembly:
    """Assemble a scene's matrices for small motion and find its undamped eigenmodes.

    Args:
        scene: the scene; it is trimmed if it has a cut-off frequency.

    Returns:
        The assembly.

    Raises:
        ValueError: for a scene without static equilibrium, and for a drive whose motion other joints or drives hold.
    """
    scene = trim_scene(without_pictures(scene) if scene.cutoff_frequency else scene)
    valid = {body.name: body.reduced.valid_frequency for body in scene.flexible_bodies}  # without springs in ports
    scene, terms = _as_modelled(scene)
    frames = {body.name: floating_frame(body.reduced, scene.frame_point(body)) for body in scene.flexible_bodies}
    coordinates = Coordinates.of(scene)
    held, moved, enforced = constraint_rows(
        scene, coordinates.jacobian, coordinates.mass, _undeformed(coordinates, frames)
    )
    basis = null_space(held, coordinates.mass)
    tangents = law_tangents(coordinates, terms, basis)
    strains, dampers = _strains(coordinates, tangents)
    strain = combine_strains(strains, len(coordinates.mass))
    mass, stiffness = basis.T @ coordinates.mass @ basis, strain.within(basis).stiffness
    frequency, shapes = strain_eigenmodes(strain.within(basis), mass)
    modes = basis @ shapes
    followed = prescribed_motion_of(held, moved, modes, 2 * np.pi * frequency, strain, coordinates.mass)
    deformation, root, own = _deformation(coordinates, frames)
    damping = Damping(
        mass,
        frequency,
        shapes,
        elastic_damping_ratios(frequency, scene.mode_ratios),
        deformation @ basis,
        root,
        own,
        basis.T @ dampers @ basis,
    )
    dragged = deformation.T @ (own @ (deformation @ followed)) + dampers @ followed
    input_matrix, amplifiers = _actions(coordinates, terms)
    readings, drives = _readings(coordinates, terms, tangents), scene.prescribed
    return Assembly(
        scene=scene,
        terms=terms,
        coordinates=coordinates,
        slices=coordinates.slices,
        enforced=enforced,
        basis=basis,
        mass=mass,
        stiffness=stiffness,
        frequency=frequency,
        shapes=shapes,
        damping=damping,
        input_matrix=input_matrix,
        output_matrix=readings[0],
        velocity_matrix=readings[1],
        acceleration_matrix=readings[2],
        ground_matrix=ground_accelerations(scene),
        filters=output_filters(scene),
        weight=coordinates.weight(scene.gravity),
        tangents=tuple(tangents),
        frames=frames,
        circuits=_circuits(coordinates, terms),
        amplifiers=amplifiers,
        prescribed=prescribed_motions(
            [scene.inputs.index(term.input) for term in drives],
            [2 * np.pi * term.bandwidth for term in drives],
            followed,
            modes,
            coordinates.mass,
            dragged,
        ),
        unsupported=unsupported_modes(scene, valid, strains, frequency, modes),
    )


def motion_size(assembly: Assembly, name: str, coordinates: Array) -> Array:
    """Compute a body's largest rotation [rad] and its largest displacement by deformation over its size [-].

    Args:
        assembly: the assembled scene.
        name: name of the body.
        coordinates: coordinates of the body at one or more times, (n, n_times); in a floating frame those of
            deformation, so that the rotation is by deformation only.

    Returns:
        Rotation and relative displacement, (2,).
    """
    return np.array([np.abs(rows @ coordinates).max(initial=0.0) for rows in motion_rows(assembly, name)])


def motion_rows(assembly: Assembly, name: str) -> tuple[Array, Array]:
    """Return rotations of a body's points [rad] and their displacements by deformation over its size [-].

    Args:
        assembly: the assembled scene.
        name: name of the body.

    Returns:
        Rows on the body's coordinates, (k, n) each.
    """
    body = next(body for body in assembly.scene.bodies if body.name == name)
    if isinstance(body, RigidBody):
        return np.eye(6)[3:], np.zeros((0, 6))
    if not isinstance(body, FlexibleBody):
        return np.vstack([body.motion(point)[3:] for point in body.point_names]), np.zeros((0, len(body.mass_matrix)))
    n_points = len(body.reduced.remote_points)
    rotations, displacements = (
        6 * np.arange(n_points)[:, None] + [3, 4, 5],
        6 * np.arange(n_points - 1)[:, None] + [0, 1, 2],
    )
    middle = body.reduced.gram[1:4, 1:4] / body.reduced.mass - np.outer(*[body.reduced.center_of_mass] * 2)
    deformation = assembly.frames[name].deformation(body.reduced)[displacements.ravel()]
    return np.eye(len(body.reduced.mass_matrix))[rotations.ravel()], deformation / np.sqrt(np.trace(middle))


def _as_modelled(scene: Scene) -> tuple[Scene, tuple[Term, ...]]:
    """Move springs within bodies into the bodies; return the scene and its other terms.

    A floating body that has only six rigid-body coordinates left becomes rigid.
    """
    added: dict[str, Array] = {}
    terms = []
    for term in scene.terms:
        name = term.measure.within if isinstance(term, Spring) and not np.any(term.damping) else None
        if isinstance(term, Spring) and name is not None:
            rows = term.measure.evaluate({name: ReferenceState(scene.split(f"{name}.")[0])})[1][name]
            added[name] = added.get(name, 0.0) + rows.T @ term.matrices[0] @ rows
        else:
            terms.append(term)
    bodies: list[Body] = []
    for body in scene.bodies:
        if not isinstance(body, FlexibleBody):
            bodies.append(body)
            continue
        reduced = body.reduced
        if body.name in added:
            reduced = replace(reduced, stiffness_matrix=reduced.stiffness_matrix + added[body.name])
        stiff = body.fidelity == "ffrf" and len(reduced.mass_matrix) == 6
        bodies.append(replace(body, reduced=reduced, fidelity="rigid" if stiff else body.fidelity))
    return replace(scene, bodies=tuple(bodies)), tuple(terms)


def _strains(coordinates: Coordinates, tangents: Sequence[Tangent]) -> tuple[list[Strain], Array]:
    """Return the strains of bodies and springs, and the damping matrix of dampers, in all coordinates."""
    strains = []
    for body in coordinates.scene.bodies:
        if body.moves and body.strain is not None:
            strains.append(body.strain.within(np.eye(len(coordinates.mass))[coordinates.slices[body.name]]))
    dampers = np.zeros_like(coordinates.mass)
    for tangent in tangents:
        rows, (sizes, directions) = tangent.rows, np.linalg.eigh(tangent.stiffness)
        strains += [spring_strain(d @ rows, k, coordinates.mass) for k, d in zip(sizes, directions.T, strict=True)]
        dampers += rows.T @ tangent.damping @ rows
    return strains, dampers


def _deformation(coordinates: Coordinates, frames: Mapping[str, FloatingFrame]) -> tuple[Array, Array, Array]:
    """Return deformation by coordinates, its scale and own damping of all bodies that deform, see `Damping`."""
    n_all = len(coordinates.mass)
    deformation, roots, own = [np.zeros((0, n_all))], [np.zeros((0, 0))], [np.zeros((0, 0))]
    for body in coordinates.scene.deformable_bodies:
        frame = frames[body.name]
        deformation.append(frame.deformation(body.reduced) @ np.eye(n_all)[coordinates.slices[body.name]])
        roots.append(stiffness_root(frame.stiffness_matrix, n_points=6 * len(body.reduced.remote_points) - 6)[1])
        own.append(own_damping(coordinates.scene, body, frame))
    return np.vstack(deformation), scipy.linalg.block_diag(*roots), scipy.linalg.block_diag(*own)


def _undeformed(coordinates: Coordinates, frames: Mapping[str, FloatingFrame]) -> Array:
    """Return rows that vanish while the bodies of fidelity "rigid" do not deform, (m, n_all)."""
    rows = [np.zeros((0, len(coordinates.mass)))]
    for body in coordinates.scene.flexible_bodies:
        if not body.deforms:
            own = np.eye(len(coordinates.mass))[coordinates.slices[body.name]]
            rows.append(frames[body.name].deformation(body.reduced) @ own)
    return np.vstack(rows)


def _actions(coordinates: Coordinates, terms: Sequence[Term]) -> tuple[Array, tuple[Amplifier, ...]]:
    """Return forces on all coordinates per unit input, (n_all, inputs), and amplifiers with a bandwidth."""
    inputs = coordinates.scene.inputs
    matrix, amplifiers = np.zeros((len(coordinates.mass), len(inputs))), []
    for term in terms:
        if isinstance(term, BaseAcceleration):
            matrix[:, inputs.index(term.input)] -= coordinates.weight(term.direction)
        elif isinstance(term, AppliedForce):
            index, forces = inputs.index(term.input), term.gain * coordinates.jacobian(term.measure)[0]
            if np.isfinite(term.bandwidth):
                amplifiers.append(Amplifier(index, forces, 2 * np.pi * term.bandwidth))
            else:
                matrix[:, index] += forces
    return matrix, tuple(amplifiers)


def _readings(coordinates: Coordinates, terms: Sequence[Term], tangents: Sequence[Tangent]) -> Array:
    """Return outputs per unit of all coordinates and of their first and second derivatives, (3, outputs, n_all)."""
    outputs = coordinates.scene.outputs
    result = np.zeros((3, len(outputs), len(coordinates.mass)))
    for term in terms:
        if isinstance(term, Output):
            result[term.derivative, outputs.index(term.name)] += term.gain * coordinates.jacobian(term.measure)[0]
        elif isinstance(term, SpringForce):
            tangent = tangent_of(coordinates, term.spring, tangents)
            k = term.spring.measure.components.index(term.component)
            pulls = np.stack([tangent.stiffness[k], tangent.damping[k]])
            result[:2, outputs.index(term.name)] += pulls @ tangent.rows
    return result


def _circuits(coordinates: Coordinates, terms: Sequence[Term]) -> tuple[Circuit, ...]:
    return tuple(
        Circuit(term.output, coordinates.jacobian(term.measure)[0], term.capacitance, term.resistance, term.gain)
        for term in terms
        if isinstance(term, Shunt)
    )
