"""A scene's matrices for small motion about its start: bodies and what the parts say put together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.modal import elastic_damping_ratios
from nassim.bodies.floating_frame import FloatingFrame, floating_frame
from nassim.bodies.strain import Strain, combine_strains, spring_strain, stiffness_root, strain_eigenmodes
from nassim.scene.bodies import Body, FlexibleBody, RigidBody
from nassim.scene.measures import Measure
from nassim.scene.scene import Scene
from nassim.scene.terms import (
    AppliedForce,
    BaseAcceleration,
    ForceLaw,
    Output,
    Shunt,
    Spring,
    SpringForce,
    Term,
)
from nassim.simulation.model.constraints import constraint_rows, null_space
from nassim.simulation.model.damping import Damping, own_damping
from nassim.simulation.model.filters import ground_accelerations, output_filters
from nassim.simulation.model.prescribed_motion import PrescribedMotions, follow, prescribed_motion_of
from nassim.simulation.model.states import ReferenceState
from nassim.simulation.model.trimming import trim_scene, undrawn
from nassim.simulation.model.unsupported_modes import unsupported_modes
from nassim.systems.state_space import StateSpace

NO_EQUILIBRIUM = (
    "no static equilibrium: can a body move freely? Add joints, leave gravity out, or let the scene go as it is drawn "
    'by simulate(..., start="released")'
)
ITERATIONS = 100
LEFT_OVER = 1e-11
"""Share of the weight by which forces may be out of balance in static equilibrium."""


@dataclass(frozen=True)
class Circuit:
    """A resistance across an electrical port, whose charge is a state v = charge / capacitance [V] of its own.

    forces: on all coordinates per volt of v, (n_all,); the others: see `nassim.scene.terms.Shunt`

    The voltage V = v - forces @ q / capacitance drives the current that discharges it:
    capacitance v' = -V / resistance.
    """

    output: str
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

    scene: what is modelled, after `trim_scene`; its bodies have the stiffness of springs within them, as of electrical
        ports that keep their charge
    terms: of the parts, but for these springs
    coordinates: all coordinates, and measures on them
    slices: of each moving body's coordinates among all, by body name (flexible: the remote points' motions and
        the modes, in the body's frame; rigid: motion of the centre of mass in the world's frame)
    enforced: directions that each joint holds, by name, without those that other joints hold already
    basis: all coordinates from the minimal ones, shape (n_all, n), orthonormal columns
    mass, stiffness: in minimal coordinates, (n, n)
    frequency: eigenfrequencies of the undamped scene, ascending, exactly 0 for free motions only, (n,) [Hz]
    shapes: (n, n), unit modal mass
    damping: of the modes, of bodies and of dampers
    input_matrix: forces on all coordinates per unit input, (n_all, inputs), but for those through amplifiers
    output_matrix, velocity_matrix, acceleration_matrix: outputs per unit of all coordinates and of their derivatives,
        before the filters, (outputs, n_all) each
    ground_matrix: acceleration along what inertial outputs read, of the ground, per unit input, (outputs, inputs)
    filters: by output that passes one, or to which that adds, see `nassim.simulation.model.filters`
    weight: forces of gravity on all coordinates, (n_all,)
    tangents: force laws about the static equilibrium
    frames: floating frame of each flexible body, by name
    circuits: electrical ports whose charge leaks through a resistance
    amplifiers: actuators with a bandwidth
    following: what drives that follow inputs do; the minimal coordinates are those of motion with these at rest
    unsupported: modes beyond what the bodies' reductions hold, quasi-static in sampled models, bool (n,)
    """

    scene: Scene
    terms: tuple[Term, ...]
    coordinates: "Coordinates"
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
    tangents: tuple["Tangent", ...]
    frames: dict[str, FloatingFrame]
    circuits: tuple[Circuit, ...]
    amplifiers: tuple[Amplifier, ...]
    following: PrescribedMotions
    unsupported: Array

    @property
    def free(self) -> Array:
        """Which modes are free motions, that strain no body and no spring, bool (n,)."""
        result: Array = self.frequency == 0
        return result

    @property
    def scale(self) -> Array:
        """Roots of the masses of all coordinates, (n_all,)."""
        moving = [body for body in self.scene.bodies if body.moves]
        return np.sqrt(np.concatenate([np.zeros(0), *(np.diag(body.mass_matrix) for body in moving)]))

    @property
    def modes_uncoupled(self) -> bool:
        """Whether nothing couples the undamped modes, outputs read displacements only, and inputs push only."""
        coupled = self.circuits or self.amplifiers or self.following.inputs or np.any(self.damping.beside)
        return not (coupled or self.filters or np.any(self.velocity_matrix) or np.any(self.acceleration_matrix))


@dataclass(frozen=True)
class Coordinates:
    """All coordinates of a scene's moving bodies in the reference configuration, and measures on them.

    scene: its bodies; slices: of each moving body's coordinates among all, by name; mass: (n_all, n_all)
    """

    scene: Scene
    slices: dict[str, slice]
    mass: Array

    @classmethod
    def of(cls, scene: Scene) -> "Coordinates":
        """Number the coordinates of a scene."""
        bodies = [body for body in scene.bodies if body.moves]
        blocks = [body.mass_matrix for body in bodies]
        ends = np.cumsum([0, *map(len, blocks)])
        places = {body.name: slice(ends[k], ends[k + 1]) for k, body in enumerate(bodies)}
        return cls(scene, places, scipy.linalg.block_diag(*blocks))

    @cached_property
    def states(self) -> dict[str, ReferenceState]:
        """Of all bodies, by name."""
        return {body.name: ReferenceState(body) for body in self.scene.bodies}

    def jacobian(self, measure: Measure, states: Mapping[str, ReferenceState] | None = None) -> Array:
        """Evaluate a measure's rows on all coordinates, (k, n_all); states: other than of the reference."""
        _, parts = measure.evaluate(self.states if states is None else states)
        result = np.zeros((len(measure.components), len(self.mass)))
        for name, rows in parts.items():
            if name in self.slices:
                result[:, self.slices[name]] = rows
        return result

    def motion(self, path: str) -> Array:
        """Return the small motion of a point in the world's frame, (6, n_all)."""
        body, point = self.scene.split(path)
        rows = np.zeros((6, len(self.mass)))
        if body.moves:
            rows[:, self.slices[body.name]] = body.motion(point)
        return rows

    def weight(self, gravity: Array, states: Mapping[str, ReferenceState] | None = None) -> Array:
        """Return the forces of a uniform gravity, world frame, (n_all,)."""
        result = np.zeros(len(self.mass))
        for name, place in self.slices.items():
            result[place] = (states or self.states)[name].weight(gravity)
        return result


@dataclass(frozen=True)
class Tangent:
    """A force law about the static equilibrium of small motion.

    rows: of its measure on all coordinates, (k, n_all); value: of the measure, (k,)
    stiffness, damping: derivatives of the resistance, (k, k)
    """

    law: ForceLaw
    rows: Array
    value: Array
    stiffness: Array
    damping: Array

    @classmethod
    def of(cls, law: ForceLaw, rows: Array, coordinates: Array) -> "Tangent":
        """At given coordinates, (n_all,)."""
        value = rows @ coordinates
        return cls(law, rows, value, *law.tangents(value, np.zeros(len(value))))


def law_tangents(coordinates: Coordinates, terms: Sequence[Term], basis: Array) -> list[Tangent]:
    """Force laws about the static equilibrium under gravity, which is at zero where all laws are linear.

    basis: of the motions that constraints leave, (n_all, n)

    Raises ValueError where no equilibrium is found, and for a law that pushes away from it.
    """
    laws = [(term, coordinates.jacobian(term.measure)) for term in terms if isinstance(term, ForceLaw)]
    at_rest = np.zeros(len(coordinates.mass))
    if any(not law.is_linear for law, _ in laws):
        at_rest = _nonlinear_equilibrium(coordinates, laws, basis)
    result = [Tangent.of(law, rows, at_rest) for law, rows in laws]
    for tangent in result:
        least = float(np.linalg.eigvalsh(0.5 * (tangent.stiffness + tangent.stiffness.T))[0])
        if least < -LEFT_OVER * np.abs(tangent.stiffness).max():
            raise ValueError(
                f"the {type(tangent.law).__name__} between {', '.join(tangent.law.measure.points)} pushes away from "
                f"equilibrium, with a tangent of {least:.3g}: no model of small motion holds it; simulate in large "
                'motion (fidelity "ffrf", or rigid bodies alone)'
            )
    return result


def tangent_of(coordinates: Coordinates, law: ForceLaw, tangents: Sequence[Tangent]) -> Tangent:
    """That of a law, which another part states again as its own; of one within a body, about zero."""
    rows = coordinates.jacobian(law.measure)
    for tangent in tangents:
        if type(tangent.law) is type(law) and np.array_equal(tangent.rows, rows):
            return Tangent(law, rows, tangent.value, *law.tangents(tangent.value, np.zeros(len(rows))))
    return Tangent.of(law, rows, np.zeros(rows.shape[1]))


def _nonlinear_equilibrium(coordinates: Coordinates, laws: Sequence[tuple[ForceLaw, Array]], basis: Array) -> Array:
    """Coordinates at rest under gravity, (n_all,), by Newton's method with halved steps; free motions stay at zero."""
    scene, scale = coordinates.scene, 1 / np.sqrt(np.einsum("ij,ij->j", basis, coordinates.mass @ basis))
    free, weight = basis * scale, coordinates.weight(scene.gravity)
    elastic = np.zeros_like(coordinates.mass)
    for body in scene.bodies:
        if body.moves and body.strain is not None:
            elastic[coordinates.slices[body.name], coordinates.slices[body.name]] = body.strain.stiffness

    def left(q: Array) -> Array:
        force = weight - elastic @ q
        for law, rows in laws:
            force = force - rows.T @ law.resistance(rows @ q, np.zeros(len(rows)))
        result: Array = free.T @ force
        return result

    q, size = np.zeros(len(coordinates.mass)), float(np.linalg.norm(free.T @ weight))
    for _ in range(ITERATIONS):
        now = left(q)
        stiffness = elastic + sum(t.rows.T @ t.stiffness @ t.rows for t in (Tangent.of(*law, q) for law in laws))
        step = free @ np.linalg.lstsq(free.T @ stiffness @ free, now, rcond=LEFT_OVER)[0]
        held = np.linalg.norm(free.T @ stiffness @ step)
        if held <= LEFT_OVER * max(size, 1e-300):
            return q
        share = 1.0
        while share > LEFT_OVER and np.linalg.norm(left(q + share * step)) >= np.linalg.norm(now):
            share /= 2
        q = q + share * step
    raise ValueError(f"scene {scene.name!r}: {NO_EQUILIBRIUM}")


def assemble(scene: Scene) -> Assembly:
    """Assemble a scene's mass and stiffness for small motion, and find its undamped eigenmodes."""
    scene = trim_scene(undrawn(scene) if scene.cutoff_frequency else scene)
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
        following=follow(
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
    """Largest rotation [rad] of a body's points and largest displacement by deformation over its size [-], shape (2,).

    coordinates: of the body, at one or more times, shape (n, n_times); in a floating frame, those of deformation, so
    that the rotation is that by deformation only
    """
    return np.array([np.abs(rows @ coordinates).max(initial=0.0) for rows in motion_rows(assembly, name)])


def motion_rows(assembly: Assembly, name: str) -> tuple[Array, Array]:
    """Rotations of a body's points [rad] and their displacements by deformation over its size [-], of its coordinates.

    Shape (k, n) each.
    """
    body = next(body for body in assembly.scene.bodies if body.name == name)
    if isinstance(body, RigidBody):
        return np.eye(6)[3:], np.zeros((0, 6))
    if not isinstance(body, FlexibleBody):
        return np.vstack([body.motion(point)[3:] for point in body.point_names]), np.zeros((0, len(body.mass_matrix)))
    n_points = len(body.reduced.remote_points)
    turns, shifts = 6 * np.arange(n_points)[:, None] + [3, 4, 5], 6 * np.arange(n_points - 1)[:, None] + [0, 1, 2]
    middle = body.reduced.gram[1:4, 1:4] / body.reduced.mass - np.outer(*[body.reduced.center_of_mass] * 2)
    deformation = assembly.frames[name].deformation(body.reduced)[shifts.ravel()]
    return np.eye(len(body.reduced.mass_matrix))[turns.ravel()], deformation / np.sqrt(np.trace(middle))


def _as_modelled(scene: Scene) -> tuple[Scene, tuple[Term, ...]]:
    """Make springs within bodies part of these; returns the scene and its other terms.

    Bodies of which nothing but six rigid motions is left are rigid.
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
    """What strains, and the damping of spring-dampers, both in all coordinates."""
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
    """Of all bodies that deform, in order: deformation by coordinates, its scale and own damping, as `Damping` says."""
    n_all = len(coordinates.mass)
    deformation, roots, own = [np.zeros((0, n_all))], [np.zeros((0, 0))], [np.zeros((0, 0))]
    for body in coordinates.scene.deformable_bodies:
        frame = frames[body.name]
        deformation.append(frame.deformation(body.reduced) @ np.eye(n_all)[coordinates.slices[body.name]])
        roots.append(stiffness_root(frame.stiffness_matrix, n_points=6 * len(body.reduced.remote_points) - 6)[1])
        own.append(own_damping(coordinates.scene, body, frame))
    return np.vstack(deformation), scipy.linalg.block_diag(*roots), scipy.linalg.block_diag(*own)


def _undeformed(coordinates: Coordinates, frames: Mapping[str, FloatingFrame]) -> Array:
    """Rows that vanish while the bodies of fidelity "rigid" keep their shape, (m, n_all)."""
    rows = [np.zeros((0, len(coordinates.mass)))]
    for body in coordinates.scene.flexible_bodies:
        if not body.deforms:
            own = np.eye(len(coordinates.mass))[coordinates.slices[body.name]]
            rows.append(frames[body.name].deformation(body.reduced) @ own)
    return np.vstack(rows)


def _actions(coordinates: Coordinates, terms: Sequence[Term]) -> tuple[Array, tuple[Amplifier, ...]]:
    """Forces on all coordinates per unit input, (n_all, inputs), and those behind amplifiers with a bandwidth."""
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
    """Outputs per unit of all coordinates and of their first and second derivatives, (3, outputs, n_all)."""
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
