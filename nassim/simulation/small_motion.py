"""A scene's matrices for small motion about its start: bodies and what the parts say put together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.modal import elastic_ratios
from nassim.base.rigid_motion import DIRECTIONS
from nassim.bodies.floating_frame import FloatingFrame, floating_frame
from nassim.bodies.strain import Strain, joined, spring_strain, stiffness_root, strained_modes
from nassim.scene.bodies import Body, RigidBody
from nassim.scene.part import (
    Field,
    Force,
    Leak,
    Line,
    Reading,
    Row,
    SixSprings,
    Spring,
    Tension,
    Word,
    unknown_word,
)
from nassim.scene.scene import Scene
from nassim.simulation.constraints import constraint_rows, null_space
from nassim.simulation.damping import Damping, own_damping
from nassim.simulation.filters import ground_accelerations, output_filters
from nassim.simulation.folding import unsupported_modes
from nassim.simulation.following import Following, follow, followed_motion
from nassim.simulation.rows import bushing_rows, shares
from nassim.simulation.trimming import trim_scene, undrawn
from nassim.systems.state_space import StateSpace

NO_EQUILIBRIUM = (
    "no static equilibrium: can a body move freely? Add joints, leave gravity out, or let the scene go as it is drawn "
    'by simulate(..., start="released")'
)


@dataclass(frozen=True)
class Circuit:
    """A resistance across an electrical port, whose charge is a state v = charge / capacitance [V] of its own.

    forces: on all coordinates per volt of v, (n_all,); the others: see `nassim.scene.part.Leak`

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
    words: what the parts say but for these springs
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
    filters: by output that passes one, or to which that adds, see `nassim.simulation.filters`
    weight: forces of gravity on all coordinates, (n_all,)
    frames: floating frame of each flexible body, by name
    circuits: electrical ports whose charge leaks through a resistance
    amplifiers: actuators with a bandwidth
    following: what drives that follow inputs do; the minimal coordinates are those of motion with these at rest
    unsupported: modes beyond what the bodies' reductions hold, quasi-static in sampled models, bool (n,)
    """

    scene: Scene
    words: tuple[Word, ...]
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
    frames: dict[str, FloatingFrame]
    circuits: tuple[Circuit, ...]
    amplifiers: tuple[Amplifier, ...]
    following: Following
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
    def falls_into_modes(self) -> bool:
        """Whether nothing couples the undamped modes, outputs read displacements only, and inputs push only."""
        coupled = self.circuits or self.amplifiers or self.following.inputs or np.any(self.damping.beside)
        return not (coupled or self.filters or np.any(self.velocity_matrix) or np.any(self.acceleration_matrix))


@dataclass(frozen=True)
class _Coordinates:
    """All coordinates of a scene's moving bodies, and what rows and gravity are in them."""

    scene: Scene
    slices: dict[str, slice]
    mass: Array

    @classmethod
    def of(cls, scene: Scene) -> "_Coordinates":
        bodies = [body for body in scene.bodies if body.moves]
        blocks = [body.mass_matrix for body in bodies]
        ends = np.cumsum([0, *map(len, blocks)])
        places = {body.name: slice(ends[k], ends[k + 1]) for k, body in enumerate(bodies)}
        return cls(scene, places, scipy.linalg.block_diag(*blocks))

    def vector(self, row: Row | Line, *, derivative: int = 0) -> Array:
        """A row on all coordinates, (n_all,)."""
        result = np.zeros(len(self.mass))
        for name, share in shares(self.scene, row, derivative=derivative).items():
            result[self.slices[name]] = share
        return result

    def motion(self, path: str) -> Array:
        """Small motion of a point in the world's frame, (6, n_all)."""
        body, point = self.scene.split(path)
        rows = np.zeros((6, len(self.mass)))
        if body.moves:
            rows[:, self.slices[body.name]] = body.motion(point)
        return rows

    def weight(self, gravity: Array) -> Array:
        """Forces of a uniform gravity, world frame, (n_all,)."""
        result = np.zeros(len(self.mass))
        for name, place in self.slices.items():
            result[place] = self.scene.split(f"{name}.")[0].weight(gravity)
        return result


def assemble(scene: Scene) -> Assembly:
    """Assemble a scene's mass and stiffness for small motion, and find its undamped eigenmodes."""
    scene = trim_scene(undrawn(scene) if scene.cutoff_frequency else scene)
    valid = {body.name: body.reduced.valid_frequency for body in scene.flexible_bodies}  # without springs in ports
    scene, words = _as_modelled(scene)
    frames = {body.name: floating_frame(body.reduced, scene.frame_point(body)) for body in scene.flexible_bodies}
    coordinates = _Coordinates.of(scene)
    strains, dampers = _strains(coordinates, words)
    held, moved, enforced = constraint_rows(
        scene, coordinates.motion, coordinates.mass, _undeformed(coordinates, frames)
    )
    basis = null_space(held, coordinates.mass)
    strain = joined(strains, len(coordinates.mass))
    mass, stiffness = basis.T @ coordinates.mass @ basis, strain.within(basis).stiffness
    frequency, shapes = strained_modes(strain.within(basis), mass)
    modes = basis @ shapes
    followed = followed_motion(held, moved, modes, 2 * np.pi * frequency, strain, coordinates.mass)
    deformation, root, own = _deformation(coordinates, frames)
    damping = Damping(
        mass,
        frequency,
        shapes,
        elastic_ratios(frequency, scene.mode_ratios),
        deformation @ basis,
        root,
        own,
        basis.T @ dampers @ basis,
    )
    dragged = deformation.T @ (own @ (deformation @ followed)) + dampers @ followed
    input_matrix, amplifiers = _actions(coordinates, words)
    readings, drives = _readings(coordinates, words), scene.follows
    return Assembly(
        scene=scene,
        words=words,
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
        frames=frames,
        circuits=_circuits(coordinates, words),
        amplifiers=amplifiers,
        following=follow(
            [scene.inputs.index(word.input) for word in drives],
            [2 * np.pi * word.bandwidth for word in drives],
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
    n_points = len(body.reduced.remote_points)
    turns, shifts = 6 * np.arange(n_points)[:, None] + [3, 4, 5], 6 * np.arange(n_points - 1)[:, None] + [0, 1, 2]
    middle = body.reduced.gram[1:4, 1:4] / body.reduced.mass - np.outer(*[body.reduced.center_of_mass] * 2)
    deformation = assembly.frames[name].deformation(body.reduced)[shifts.ravel()]
    return np.eye(len(body.reduced.mass_matrix))[turns.ravel()], deformation / np.sqrt(np.trace(middle))


def _as_modelled(scene: Scene) -> tuple[Scene, tuple[Word, ...]]:
    """The scene with springs within bodies made part of these, and what its parts say but for them.

    Bodies of which nothing but six rigid motions is left are rigid.
    """
    added: dict[str, Array] = {}
    words = []
    for word in scene.words:
        if not isinstance(word, Word):
            raise unknown_word(word, "the model of small motion")
        name = word.row.within if isinstance(word, Spring) and not word.damping else None
        if isinstance(word, Spring) and name is not None:
            row = shares(scene, word.row)[name]
            added[name] = added.get(name, 0.0) + word.stiffness * np.outer(row, row)
        else:
            words.append(word)
    bodies: list[Body] = []
    for body in scene.bodies:
        if isinstance(body, RigidBody):
            bodies.append(body)
            continue
        reduced = body.reduced
        if body.name in added:
            reduced = replace(reduced, stiffness_matrix=reduced.stiffness_matrix + added[body.name])
        stiff = body.fidelity == "ffrf" and len(reduced.mass_matrix) == 6
        bodies.append(replace(body, reduced=reduced, fidelity="rigid" if stiff else body.fidelity))
    return replace(scene, bodies=tuple(bodies)), tuple(words)


def _strains(coordinates: _Coordinates, words: Sequence[Word]) -> tuple[list[Strain], Array]:
    """What strains, and the damping of spring-dampers, both in all coordinates."""
    strains = []
    for body in coordinates.scene.deformable_bodies:
        own = np.eye(len(coordinates.mass))[coordinates.slices[body.name]]
        strains.append(body.reduced.strain.within(own))
    dampers = np.zeros_like(coordinates.mass)
    for word in words:
        if isinstance(word, Spring):
            row = coordinates.vector(word.row)
            strains.append(spring_strain(row, word.stiffness, coordinates.mass))
            dampers += word.damping * np.outer(row, row)
        elif isinstance(word, SixSprings):
            rows = np.array([coordinates.vector(row) for row in bushing_rows(word)])
            sizes, directions = np.linalg.eigh(word.stiffness)
            strains += [spring_strain(d @ rows, k, coordinates.mass) for k, d in zip(sizes, directions.T, strict=True)]
            dampers += rows.T @ word.damping @ rows
    return strains, dampers


def _deformation(coordinates: _Coordinates, frames: Mapping[str, FloatingFrame]) -> tuple[Array, Array, Array]:
    """Of all bodies that deform, in order: deformation by coordinates, its scale and own damping, as `Damping` says."""
    n_all = len(coordinates.mass)
    deformation, roots, own = [np.zeros((0, n_all))], [np.zeros((0, 0))], [np.zeros((0, 0))]
    for body in coordinates.scene.deformable_bodies:
        frame = frames[body.name]
        deformation.append(frame.deformation(body.reduced) @ np.eye(n_all)[coordinates.slices[body.name]])
        roots.append(stiffness_root(frame.stiffness_matrix, n_points=6 * len(body.reduced.remote_points) - 6)[1])
        own.append(own_damping(coordinates.scene, body, frame))
    return np.vstack(deformation), scipy.linalg.block_diag(*roots), scipy.linalg.block_diag(*own)


def _undeformed(coordinates: _Coordinates, frames: Mapping[str, FloatingFrame]) -> Array:
    """Rows that vanish while the bodies of fidelity "rigid" keep their shape, (m, n_all)."""
    rows = [np.zeros((0, len(coordinates.mass)))]
    for body in coordinates.scene.flexible_bodies:
        if not body.deforms:
            own = np.eye(len(coordinates.mass))[coordinates.slices[body.name]]
            rows.append(frames[body.name].deformation(body.reduced) @ own)
    return np.vstack(rows)


def _actions(coordinates: _Coordinates, words: Sequence[Word]) -> tuple[Array, tuple[Amplifier, ...]]:
    """Forces on all coordinates per unit input, (n_all, inputs), and those behind amplifiers with a bandwidth."""
    inputs = coordinates.scene.inputs
    matrix, amplifiers = np.zeros((len(coordinates.mass), len(inputs))), []
    for word in words:
        if isinstance(word, Field):
            matrix[:, inputs.index(word.input)] += coordinates.weight(word.direction)
        elif isinstance(word, Force):
            # A force's power is that on velocities: the turn of its axes does none.
            index, forces = inputs.index(word.input), word.gain * coordinates.vector(word.row, derivative=1)
            if np.isfinite(word.bandwidth):
                amplifiers.append(Amplifier(index, forces, 2 * np.pi * word.bandwidth))
            else:
                matrix[:, index] += forces
    return matrix, tuple(amplifiers)


def _readings(coordinates: _Coordinates, words: Sequence[Word]) -> Array:
    """Outputs per unit of all coordinates and of their first and second derivatives, (3, outputs, n_all)."""
    outputs = coordinates.scene.outputs
    result = np.zeros((3, len(outputs), len(coordinates.mass)))
    for word in words:
        if isinstance(word, Reading):
            row = coordinates.vector(word.row, derivative=word.derivative)
            result[word.derivative, outputs.index(word.output)] += word.gain * row
        elif isinstance(word, Tension):
            k, spring = outputs.index(word.output), word.spring
            if isinstance(spring, Spring):
                row = coordinates.vector(spring.row)
                result[:2, k] += np.outer((spring.stiffness, spring.damping), row)
            else:
                rows = np.array([coordinates.vector(row) for row in bushing_rows(spring)])
                pulls = np.stack([spring.stiffness, spring.damping])[:, list(DIRECTIONS).index(word.direction)]
                result[:2, k] += pulls @ rows
    return result


def _circuits(coordinates: _Coordinates, words: Sequence[Word]) -> tuple[Circuit, ...]:
    return tuple(
        Circuit(word.output, coordinates.vector(word.row), word.capacitance, word.resistance, word.gain)
        for word in words
        if isinstance(word, Leak)
    )
