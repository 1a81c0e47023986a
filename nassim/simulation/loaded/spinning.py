"""A scene that turns as a whole at a constant angular velocity, in the frame that turns with it.

With W the angular velocity, x the position of a particle from a point of the axis and psi_j its displacement per unit
of coordinate j, the kinetic energy in the turning frame adds to small motion, M q'' + K q = f,

    Coriolis forces       G_jk = 2 int rho psi_j . (W x psi_k), skew: they do no work
    centrifugal forces    f_j = int rho psi_j . a with a = -W x (W x x), at rest
    their change          K_jk = -int rho (W x psi_j) . (W x psi_k), negative, from the velocity field
    and their stiffness   -int rho a . (second derivatives of the displacement), see `finite_motion`

and where joints and springs bear the centrifugal forces, what they bear is stiffness too, as they turn with the bodies:
a pendulum hinged beside the axis swings as if it hung. All of it is of first order in the forces on the scene as it is
drawn: exact where its equilibrium is as drawn, and else off by a share like that of its rotations [rad] and of its
displacements over the arms and the distance from the axis, which stay as drawn. (A bar with a ball on either end, 0.3 %
longer under its spin: four frequencies within 0.25 % of those of a run in floating frames.)

The stress inside a reduced body stiffens nothing here, as in floating frames in time: a blade clamped at its root
bends in the plane of rotation as under the negative stiffness alone. A warning tells from where on that matters.

Source: G. Genta, Dynamics of Rotating Systems, Springer (2005); A. A. Shabana, Dynamics of Multibody Systems, 4th ed.
(2013), on floating frames.
"""

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from nassim.base.checks import Array, finite_array, freeze
from nassim.base.rigid_motion import skew
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.scene import Scene
from nassim.simulation.loaded.geometric_stiffness import Frame, GeometricStiffness, spring_forces
from nassim.simulation.loaded.rotor_frame import FrameView, RotorPartition, other_frame_terms, rotating_damping
from nassim.simulation.model.assembly import Assembly, motion_size
from nassim.simulation.model.buckling import axial_forces, warn_of_buckling

STIFFENING = 1e-3
"""Relative change of a frequency by centrifugal stiffening that may be left out without a word."""
GUESSED = 1 / 30
"""Spin over a body's first frequency from which on integrals that are a guess are worth a word."""
NOT_SMALL = 0.1
"""Rotation [rad], and deformation over size, up to which the equilibrium is small."""
WORTH_A_WORD = 0.01
"""Rotation [rad], and deformation over size, from which on a warning tells."""
HELD = 1e-9
"""Stiffness over a mode's own, and force over the largest, that are rounding."""


@dataclass(frozen=True)
class Spinning:
    """What spin adds to an assembly: M q'' + (C + gyroscopic) q' + (K + stiffness) q = f about the equilibrium.

    gyroscopic: 2 W G in minimal coordinates, (n, n), skew
    stiffness: centrifugal and geometric, in minimal coordinates, (n, n), symmetric; where a part of the scene stands,
        also what dampers drive, which is not
    equilibrium: minimal coordinates of the equilibrium, from the scene as drawn, (n,); charges that leak are drained
    drag, pull: the gyroscopic and the stiffness forces against the motion of d drives that follow inputs, (n, d)
    """

    gyroscopic: Array
    stiffness: Array
    equilibrium: Array
    drag: Array
    pull: Array

    def __post_init__(self) -> None:
        n = len(self.equilibrium)
        freeze(
            self,
            gyroscopic=finite_array("gyroscopic matrix", self.gyroscopic, (n, n)),
            stiffness=finite_array("stiffness of the spin", self.stiffness, (n, n)),
            equilibrium=finite_array("equilibrium", self.equilibrium, (n,)),
        )


def spinning(
    assembly: Assembly, angular_velocity: ArrayLike, point: ArrayLike, parted: RotorPartition | None = None
) -> Spinning:
    """What it adds to an assembled scene that all of it turns at a constant angular velocity, fixed bodies included.

    angular_velocity: (3,) [rad/s], and a point of the axis, (3,) [m], along the axes of the scene, which turn along
    parted: what stands while all else turns, at the same velocity about the same axis; None for nothing

    Warns of an equilibrium beyond small motion, of stiffening within bodies and of preload near buckling, which are
    left out. Raises ValueError where there is no equilibrium within some 0.1 rad of the scene as it is drawn: about
    that, no linear model holds.
    """
    velocity = finite_array("angular_velocity", np.asarray(angular_velocity, dtype=float), (3,))
    axis_point = finite_array("axis_point", np.asarray(point, dtype=float), (3,))
    n, size = len(assembly.frequency), len(assembly.basis)
    if not velocity.any():
        still = np.zeros((n, len(assembly.prescribed.inputs)))
        return Spinning(np.zeros((n, n)), np.zeros((n, n)), np.zeros(n), still, still)
    geometric = GeometricStiffness.of(assembly)
    force, gyroscopic, stiffness = np.zeros(size), np.zeros((size, size)), np.zeros((size, size))
    moment = 0.0
    for name, place in assembly.slices.items():
        body, _ = assembly.scene.split(f"{name}.")
        if parted is None or name not in parted.standing:
            terms = inertia_terms(body, geometric.frames[name], place, velocity, axis_point)
            gyroscopic[place, place], stiffness[place, place] = terms.coriolis, terms.stiffness
            force[place], moment = terms.force, moment + terms.moment
    if parted is not None:
        view = FrameView(assembly, parted)
        for name in filter(parted.in_other_frame, assembly.slices):
            own = (assembly.slices[name],) * 2
            gyroscopic[own], stiffness[own] = other_frame_terms(view, name, gyroscopic[own], stiffness[own])
        stiffness += rotating_damping(view)
    rate = float(np.linalg.norm(velocity))
    elastic, borne = _borne(assembly, force)
    stiffness += geometric.of_springs(elastic) + geometric.of_joints(borne)
    # By Cauchy and Schwarz, no mode of unit mass is pushed by more than W^2 times the root of the moment of inertia.
    found = _rest(assembly, stiffness, force, rate, rate**2 * np.sqrt(moment))
    coordinates = assembly.basis @ found
    _check_small(assembly, coordinates)
    _warn_of_stress(assembly, coordinates, rate / (2 * np.pi), parted)
    basis, followed = assembly.basis, assembly.prescribed.motion
    gyroscopic, stiffness = basis.T @ gyroscopic, basis.T @ stiffness
    return Spinning(gyroscopic @ basis, stiffness @ basis, found, gyroscopic @ followed, stiffness @ followed)


def stiffening(scene: Scene, body: FlexibleBody, rate: float) -> tuple[float, float]:
    """First frequency [Hz] of a body held at its frame, and by what share stress from a spin at a rate [Hz] raises it.

    An estimate: as of a blade whose frequency is the root of f^2 + rate^2, R. Southwell's law with the coefficient 1.
    """
    first = float(body.reduced.eigenfrequencies(fixed=[scene.frame_point(body)])[0])
    return first, float(np.hypot(1.0, rate / first)) - 1 if first else np.inf


@dataclass(frozen=True)
class InertiaTerms:
    """Of one body, on its own coordinates: see the module; moment: of inertia about the axis [kg m2]."""

    force: Array
    coriolis: Array
    stiffness: Array
    moment: float


def inertia_terms(body: Body, frame: Frame, place: slice, velocity: Array, axis_point: Array) -> InertiaTerms:
    """Of a body whose coordinates stand at a place among all, under an angular velocity about a point's axis."""
    if isinstance(body, FlexibleBody):
        turn, origin, gram = body.rotation, body.position, body.reduced.gram
    else:
        turn, origin, gram = np.eye(3), body.position, _rigid_gram(*body.rigid_inertia)
    n = (len(gram) - 4) // 3
    w, axis, arm = turn.T @ velocity, turn.T @ (axis_point - origin), turn.T @ (frame.position - origin)
    pull = w @ w * np.eye(3) - np.outer(w, w)  # a = pull @ (x - axis)
    along, around = turn.T @ frame.motion[:3, place], turn.T @ frame.turn[:, place]
    # Integrals over the body of rho (x - axis) times 1, x and psi_j.
    beside = np.hstack([-axis[:, None], np.eye(3)])
    first, second = beside @ gram[:4, 0], beside @ gram[:4, 1:4] - np.outer(beside @ gram[:4, 0], arm)
    fields = (beside @ gram[:4, 4:]).reshape(3, n, 3)
    pairs = gram[4:, 4:].reshape(n, 3, n, 3)
    whole, dyad = pull @ first, pull @ second
    moments = np.einsum("da,ajb->dbj", pull, fields)  # a_d psi_jb
    crossed = np.array([moments[(k + 2) % 3, (k + 1) % 3] - moments[(k + 1) % 3, (k + 2) % 3] for k in range(3)])
    # Work of a on theta x (psi q - u_frame) - theta x (theta x r) / 2.
    half = around.T @ (crossed + skew(whole) @ along + 0.5 * (np.trace(dyad) * np.eye(3) - dyad) @ around)
    return InertiaTerms(
        force=np.einsum("bbj->j", moments),
        coriolis=2 * np.einsum("jakb,ab->jk", pairs, skew(w)),
        stiffness=-np.einsum("jakb,ab->jk", pairs, pull) - half - half.T,
        moment=float(np.einsum("ab,ab", pull, beside @ gram[:4, :4] @ beside.T)) / float(w @ w),
    )


def _rigid_gram(mass: float, centre: Array, inertia: Array) -> Array:
    """As `ReducedBody.gram`, of a rigid body about its centre of mass, (22, 22)."""
    moments = np.zeros((4, 4))
    moments[0, 0], moments[1:, 1:] = mass, 0.5 * np.trace(inertia) * np.eye(3) - inertia
    fields = np.zeros((4, 22))
    fields[:, :4] = np.eye(4)
    for j in range(3):
        fields[0, 4 + 3 * j + j] = 1.0
        fields[1:, 13 + 3 * j : 16 + 3 * j] = skew(np.eye(3)[j]).T
    result: Array = fields.T @ moments @ fields
    return result


def _borne(assembly: Assembly, force: Array) -> tuple[Array, Array]:
    """Where elastic parts come to rest under forces, and what is left for constraints to bear, both (n_all,).

    Of first order in the forces only: then what follows is the same whichever way a scene is written, and a motion that
    costs nothing, as a turn about the axis, stays one that costs nothing. Free motions are let go: they take inertia.
    """
    modes, elastic = assembly.basis @ assembly.shapes, ~assembly.rigid_modes
    bent, loose = modes[:, elastic], modes[:, ~elastic]
    stiffness = np.diag((2 * np.pi * assembly.frequency[elastic]) ** 2)
    for circuit in assembly.circuits:
        stiffness -= np.outer(bent.T @ circuit.forces, bent.T @ circuit.forces) / circuit.capacitance
    q = bent @ np.linalg.solve(stiffness, bent.T @ force)
    left, accelerations = force - spring_forces(assembly, q), loose @ (loose.T @ force)
    for name, place in assembly.slices.items():
        body, _ = assembly.scene.split(f"{name}.")
        left[place] -= body.mass_matrix @ accelerations[place]
        if isinstance(body, FlexibleBody) and body.deforms:
            root = body.reduced.strain.root
            left[place] -= root.T @ (root @ q[place])
    for circuit in assembly.circuits:
        left += circuit.forces * (circuit.forces @ q) / circuit.capacitance
    return q, left


def _rest(assembly: Assembly, added: Array, force: Array, rate: float, largest: float) -> Array:
    """Minimal coordinates at rest under forces on all coordinates, with the stiffness of a spin added, (n,).

    rate: of the spin [rad/s]; largest: that a force on a mode of unit mass can be. Each mode is scaled to its own
    stiffness, free ones to that of the spin, which a stiff one would else drown in rounding.
    """
    modes, free = assembly.basis @ assembly.shapes, assembly.rigid_modes
    matrix = modes.T @ added @ modes
    for circuit in assembly.circuits:
        pull = modes.T @ circuit.forces
        matrix -= np.outer(pull, pull) / circuit.capacitance
    scale = 1 / np.where(free, rate, 2 * np.pi * assembly.frequency)
    axes, values, answers = np.linalg.svd(np.diag(np.where(free, 0.0, 1.0)) + scale[:, None] * matrix * scale)
    pushed = axes.T @ (scale * (modes.T @ force))
    held = values > HELD
    if np.any(np.abs(pushed[~held]) > HELD * largest / rate):
        raise ValueError(
            f"scene {assembly.scene.name!r} has no spinning equilibrium: centrifugal forces drive a motion that "
            "nothing holds, or that is at its critical speed; add a spring or a joint, put the centre of mass on the "
            "axis, or change the speed"
        )
    result: Array = assembly.shapes @ (scale * (answers[held].T @ (pushed[held] / values[held])))
    return result


def _check_small(assembly: Assembly, coordinates: Array) -> None:
    sizes = {name: motion_size(assembly, name, coordinates[place, None]) for name, place in assembly.slices.items()}
    name = max(sizes, key=lambda name: float(sizes[name].max()))
    rotation, deformation = sizes[name]
    found = (
        f"under the spin, body {name!r} comes to rest turned by {rotation:.2g} rad and deformed by "
        f"{100 * deformation:.2g} % of its size from how it is drawn"
    )
    if max(rotation, deformation) > NOT_SMALL:
        raise ValueError(f"{found}, which is no small motion: draw the scene nearer to its spinning equilibrium")
    if max(rotation, deformation) > WORTH_A_WORD:
        warnings.warn(
            f"{found}; the linear model is about that equilibrium, and off by a share of the same size", stacklevel=5
        )


def _warn_of_stress(assembly: Assembly, coordinates: Array, rate: float, parted: RotorPartition | None) -> None:
    standing = parted.standing if parted else ()
    bodies = [body for body in assembly.scene.deformable_bodies if body.name not in standing]
    for body in bodies:
        first, rise = stiffening(assembly.scene, body, rate)
        if rise > STIFFENING:
            warnings.warn(
                f"body {body.name!r} turns at {rate:.3g} Hz, its first frequency held at its frame is {first:.4g} Hz: "
                "stress stiffening within the body, which is left out, would change that by some "
                f"{100 * rise:.2g} % or more",
                stacklevel=5,
            )
        if not body.reduced.full_integrals and rate > GUESSED * first:
            warnings.warn(
                f"body {body.name!r} turns at {rate:.3g} Hz, and how its inertia is spread is a guess, as of all "
                f"imported matrices: its frequencies may be off by up to some {rate:.3g} Hz",
                stacklevel=5,
            )
    tensions = {
        body.name: axial_forces(body.reduced, coordinates[assembly.slices[body.name], None])[:, 0]
        for body in assembly.scene.deformable_bodies
    }
    warn_of_buckling(assembly, tensions)
