"""A scene that rotates as a whole at a constant angular velocity, in the rotating frame.

With W the angular velocity, x the position of a particle from a point of the axis and psi_j its displacement per unit
of coordinate j, the kinetic energy in the rotating frame adds to small motion, M q'' + K q = f,

    Coriolis forces           G_jk = 2 int rho psi_j . (W x psi_k), skew: they do no work
    centrifugal forces        f_j = int rho psi_j . a with a = -W x (W x x), at rest
    their first-order change  K_jk = -int rho (W x psi_j) . (W x psi_k), negative, from the velocity field
    geometric stiffness       -int rho a . (second derivatives of the displacement), see `geometric_stiffness`

Forces by which joints and springs bear the centrifugal forces add stiffness too, as they rotate with the bodies: a
pendulum hinged beside the axis swings as if it hung. All terms are of first order in the forces on the scene in its
reference configuration. They are exact where that is its equilibrium, and else wrong by a share like that of its
rotations [rad] and of its displacements over the arms and the distance from the axis. (A bar with a ball on either end,
0.3 % longer under its spin: four frequencies within 0.25 % of those of a run in floating frames.)

The stress inside a reduced body stiffens nothing here, as in floating frames in time: a blade clamped at its root
bends in the plane of rotation as under the negative stiffness alone. A warning tells where that matters.

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
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.buckling import axial_forces, warn_of_buckling
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.motion_size import motion_size

STIFFENING = 1e-3
"""Relative change of a frequency by centrifugal stiffening above which a warning is given."""
GUESSED = 1 / 30
"""Spin over a body's first frequency above which a warning of estimated integrals is given."""
NOT_SMALL = 0.1
"""Largest rotation [rad], and deformation over size, of an equilibrium in small motion."""
WARNED_MOTION = 0.01
"""Rotation [rad], and deformation over size, above which a warning is given."""
SPIN_ROUNDING = 1e-9
"""Stiffness over a mode's own, and force over the largest, that are rounding."""


@dataclass(frozen=True)
class Spinning:
    """Effect of spin on an assembly: M q'' + (C + gyroscopic) q' + (K + stiffness) q = f about the equilibrium.

    Attributes:
        gyroscopic: 2 W G in minimal coordinates, (n, n), skew.
        stiffness: centrifugal and geometric stiffness in minimal coordinates, (n, n), symmetric; with a stator also
            that of dampers along rotating rows, which is not symmetric.
        equilibrium: minimal coordinates of the equilibrium, from the reference configuration, (n,); charges of ports
            with a resistance are zero.
        drag: gyroscopic forces per unit rate of d drives that follow inputs, (n, d).
        pull: stiffness forces per unit of these drives' motion, (n, d).
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
    assembly: Assembly, angular_velocity: ArrayLike, point: ArrayLike, partition: RotorPartition | None = None
) -> Spinning:
    """Compute the effect of a constant angular velocity of a whole scene, fixed bodies included.

    Warns of an equilibrium beyond small motion, and of stiffening within bodies and preload near buckling, which are
    left
    out.

    Args:
        assembly: the assembled scene.
        angular_velocity: angular velocity, along the axes of the scene, which rotate with it, (3,) [rad/s].
        point: a point of the axis, (3,) [m].
        partition: rotor and stator, where only the rotor has this velocity; None: all rotates.

    Returns:
        The effect of the spin.

    Raises:
        ValueError: if there is no equilibrium within some 0.1 rad of the reference configuration, about which a linear
            model would hold.
    """
    velocity = finite_array("angular_velocity", np.asarray(angular_velocity, dtype=float), (3,))
    axis_point = finite_array("axis_point", np.asarray(point, dtype=float), (3,))
    modal, slices = assembly.modal, assembly.coordinates.slices
    n, size = len(modal.frequency), assembly.coordinates.size
    if not velocity.any():
        still = np.zeros((n, len(assembly.signals.prescribed.inputs)))
        return Spinning(np.zeros((n, n)), np.zeros((n, n)), np.zeros(n), still, still)
    geometric = GeometricStiffness.of(assembly)
    force, gyroscopic, stiffness = np.zeros(size), np.zeros((size, size)), np.zeros((size, size))
    moment = 0.0
    for name, place in slices.items():
        body, _ = assembly.scene.split(f"{name}.")
        if partition is None or name not in partition.stator:
            terms = inertia_terms(body, geometric.frames[name], place, velocity, axis_point)
            gyroscopic[place, place], stiffness[place, place] = terms.coriolis, terms.stiffness
            force[place], moment = terms.force, moment + terms.moment
    if partition is not None:
        view = FrameView(assembly, partition)
        for name in filter(partition.in_other_frame, slices):
            own = (slices[name],) * 2
            gyroscopic[own], stiffness[own] = other_frame_terms(view, name, gyroscopic[own], stiffness[own])
        stiffness += rotating_damping(view)
    rate = float(np.linalg.norm(velocity))
    elastic, borne = _bear(assembly, force)
    stiffness += geometric.of_springs(elastic) + geometric.of_joints(borne)
    # Cauchy-Schwarz: the force on a mode of unit mass is at most W^2 times the root of the moment of inertia.
    found = _rest(assembly, stiffness, force, rate, rate**2 * np.sqrt(moment))
    coordinates = modal.basis @ found
    _check_small(assembly.coordinates, coordinates)
    _warn_of_stress(assembly, coordinates, rate / (2 * np.pi), partition)
    basis, followed = modal.basis, assembly.signals.prescribed.motion
    gyroscopic, stiffness = basis.T @ gyroscopic, basis.T @ stiffness
    return Spinning(gyroscopic @ basis, stiffness @ basis, found, gyroscopic @ followed, stiffness @ followed)


def stiffening(scene: Scene, body: FlexibleBody, rate: float) -> tuple[float, float]:
    """Estimate the stress stiffening of a body's first mode, held at its frame, by a spin.

    The estimate is that of a blade with the frequency sqrt(f^2 + rate^2): R. Southwell's law with the coefficient 1.

    Args:
        scene: the scene.
        body: the body.
        rate: rate of the spin [Hz].

    Returns:
        The first frequency [Hz], and the relative increase by stress [-].
    """
    first = float(body.reduced.eigenfrequencies(fixed=[scene.frame_point(body)])[0])
    return first, float(np.hypot(1.0, rate / first)) - 1 if first else np.inf


@dataclass(frozen=True)
class InertiaTerms:
    """Centrifugal and Coriolis terms of one body on its own coordinates.

    Attributes:
        force: centrifugal forces, (n,).
        coriolis: Coriolis matrix, (n, n).
        stiffness: stiffness, (n, n).
        moment: moment of inertia about the axis [kg m2].
    """

    force: Array
    coriolis: Array
    stiffness: Array
    moment: float


def inertia_terms(body: Body, frame: Frame, place: slice, velocity: Array, axis_point: Array) -> InertiaTerms:
    """Compute the centrifugal and Coriolis terms of one body.

    Args:
        body: the body.
        frame: its frame.
        place: slice of its coordinates among all.
        velocity: angular velocity, (3,) [rad/s].
        axis_point: a point of the axis, (3,) [m].

    Returns:
        The terms.
    """
    if isinstance(body, FlexibleBody):
        rotation, origin, gram = body.rotation, body.position, body.reduced.gram
    else:
        rotation, origin, gram = np.eye(3), body.position, _rigid_gram(*body.rigid_inertia)
    n = (len(gram) - 4) // 3
    w, axis, arm = rotation.T @ velocity, rotation.T @ (axis_point - origin), rotation.T @ (frame.position - origin)
    pull = w @ w * np.eye(3) - np.outer(w, w)  # a = pull @ (x - axis)
    along, around = rotation.T @ frame.motion[:3, place], rotation.T @ frame.rotation[:, place]
    # Integrals over the body of rho (x - axis) times 1, x and psi_j.
    shift = np.hstack([-axis[:, None], np.eye(3)])
    first, second = shift @ gram[:4, 0], shift @ gram[:4, 1:4] - np.outer(shift @ gram[:4, 0], arm)
    fields = (shift @ gram[:4, 4:]).reshape(3, n, 3)
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
        moment=float(np.einsum("ab,ab", pull, shift @ gram[:4, :4] @ shift.T)) / float(w @ w),
    )


def _rigid_gram(mass: float, centre: Array, inertia: Array) -> Array:
    """Return the counterpart of `ReducedBody.gram` for a rigid body about its centre of mass, (22, 22)."""
    moments = np.zeros((4, 4))
    moments[0, 0], moments[1:, 1:] = mass, 0.5 * np.trace(inertia) * np.eye(3) - inertia
    fields = np.zeros((4, 22))
    fields[:, :4] = np.eye(4)
    for j in range(3):
        fields[0, 4 + 3 * j + j] = 1.0
        fields[1:, 13 + 3 * j : 16 + 3 * j] = skew(np.eye(3)[j]).T
    result: Array = fields.T @ moments @ fields
    return result


def _bear(assembly: Assembly, force: Array) -> tuple[Array, Array]:
    """Return the elastic displacement under forces, and the forces that constraints bear, (n_all,) each.

    Both are of first order in the forces: the result then does not depend on how a scene is described, and a motion
    without
    stiffness, as a rotation about the axis, keeps none. Rigid-body modes accelerate: they bear no force.
    """
    modal, circuits = assembly.modal, assembly.signals.circuits
    modes, elastic = modal.modes, ~modal.rigid_modes
    bent, loose = modes[:, elastic], modes[:, ~elastic]
    stiffness = np.diag((2 * np.pi * modal.frequency[elastic]) ** 2)
    for circuit in circuits:
        stiffness -= np.outer(bent.T @ circuit.forces, bent.T @ circuit.forces) / circuit.capacitance
    q = bent @ np.linalg.solve(stiffness, bent.T @ force)
    left, accelerations = force - spring_forces(assembly.tangents, q), loose @ (loose.T @ force)
    for name, place in assembly.coordinates.slices.items():
        body, _ = assembly.scene.split(f"{name}.")
        left[place] -= body.mass_matrix @ accelerations[place]
        if isinstance(body, FlexibleBody) and body.deforms:
            root = body.reduced.strain.root
            left[place] -= root.T @ (root @ q[place])
    for circuit in circuits:
        left += circuit.forces * (circuit.forces @ q) / circuit.capacitance
    return q, left


def _rest(assembly: Assembly, added: Array, force: Array, rate: float, largest: float) -> Array:
    """Return minimal coordinates at rest under forces on all coordinates, with the stiffness of a spin added, (n,).

    Each mode is scaled by its own stiffness, a rigid-body mode by that of the spin, which rounding of a stiff mode
    would
    else hide. rate: of the spin [rad/s]; largest: largest force that a mode of unit mass can have.
    """
    modal, modes, free = assembly.modal, assembly.modal.modes, assembly.modal.rigid_modes
    matrix = modes.T @ added @ modes
    for circuit in assembly.signals.circuits:
        pull = modes.T @ circuit.forces
        matrix -= np.outer(pull, pull) / circuit.capacitance
    scale = 1 / np.where(free, rate, 2 * np.pi * modal.frequency)
    axes, values, answers = np.linalg.svd(np.diag(np.where(free, 0.0, 1.0)) + scale[:, None] * matrix * scale)
    pushed = axes.T @ (scale * (modes.T @ force))
    held = values > SPIN_ROUNDING
    if np.any(np.abs(pushed[~held]) > SPIN_ROUNDING * largest / rate):
        raise ValueError(
            f"scene {assembly.scene.name!r} has no spinning equilibrium: centrifugal forces drive a motion that "
            "nothing holds, or that is at its critical speed; add a spring or a joint, put the centre of mass on the "
            "axis, or change the speed"
        )
    result: Array = modal.shapes @ (scale * (answers[held].T @ (pushed[held] / values[held])))
    return result


def _check_small(coordinates: Coordinates, values: Array) -> None:
    sizes = {name: motion_size(coordinates, name, values[place, None]) for name, place in coordinates.slices.items()}
    name = max(sizes, key=lambda name: float(sizes[name].max()))
    rotation, deformation = sizes[name]
    found = (
        f"under the spin, body {name!r} comes to rest rotated by {rotation:.2g} rad and deformed by "
        f"{100 * deformation:.2g} % of its size from the reference configuration"
    )
    if max(rotation, deformation) > NOT_SMALL:
        raise ValueError(f"{found}, which is no small motion: start nearer to the spinning equilibrium")
    if max(rotation, deformation) > WARNED_MOTION:
        warnings.warn(
            f"{found}; the linear model is about that equilibrium, and off by a share of the same size", stacklevel=5
        )


def _warn_of_stress(assembly: Assembly, coordinates: Array, rate: float, partition: RotorPartition | None) -> None:
    stator = partition.stator if partition else ()
    bodies = [body for body in assembly.scene.deformable_bodies if body.name not in stator]
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
        body.name: axial_forces(body.reduced, coordinates[assembly.coordinates.slices[body.name], None])[:, 0]
        for body in assembly.scene.deformable_bodies
    }
    warn_of_buckling(assembly, tensions)
