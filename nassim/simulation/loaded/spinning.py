"""A scene that rotates as a whole at a constant angular velocity, in the rotating frame.

With W the angular velocity, x the position of a particle from a point of the axis and psi_j its displacement per unit
of coordinate j, the kinetic energy in the rotating frame adds to small motion, M q'' + K q = f,

    Coriolis forces           G_jk = 2 int rho psi_j . (W x psi_k), skew: they do no work
    centrifugal forces        f_j = int rho psi_j . a with a = -W x (W x x), at rest
    their first-order change  K_jk = -int rho (W x psi_j) . (W x psi_k), negative, from the velocity field
    geometric stiffness       -int rho a . (second derivatives of the displacement), see `geometric_stiffness`

Forces by which joints and springs bear the centrifugal forces add stiffness too, as they rotate with the bodies: a
pendulum hinged beside the axis swings as if it hung. All terms are of first order in the forces on the scene in its
reference configuration. A scene that rotates as a whole is modelled in equilibrium, see `newton_equilibrium`; so is
a rotor that only joints tie to fixed bodies, see `rotor_frame.turns_as_whole`. Beside other stators the terms are exact
where the reference configuration is the equilibrium, and else wrong by a share like that of its rotations [rad] and of
its displacements over the arms and the distance from the axis.

The stress inside a reduced body stiffens it if the body has its geometric stiffness
(`craig_bampton(..., geometric_stiffness=True)`), see `loaded_state`. Otherwise a blade clamped at its root bends in the
plane of rotation as under the negative stiffness alone. A warning is given where this matters.

Source: G. Genta, Dynamics of Rotating Systems, Springer (2005); A. A. Shabana, Dynamics of Multibody Systems, 4th ed.
(2013), on floating frames.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import skew
from nassim.base.warning_log import warn
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.scene import Scene
from nassim.simulation.loaded.geometric_stiffness import Frame
from nassim.simulation.loaded.rotor_frame import RotorPartition
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.effect_of_loads import ConstantLoads
from nassim.simulation.model.moved_coordinates import MovedCoordinates
from nassim.simulation.model.states import FrameState

STIFFENING = 1e-3
"""Relative change of a frequency by centrifugal stiffening above which a warning is given."""
GUESSED = 1 / 30
"""Spin over a body's first frequency above which a warning of estimated integrals is given."""


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
        body_force: centrifugal body force per mass as coefficients of 1, x, y, z along the body's axes, (3, 4).
    """

    force: Array
    coriolis: Array
    stiffness: Array
    moment: float
    body_force: Array


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
    rotation, origin, gram = integrals(body)
    n = (len(gram) - 4) // 3
    w, axis = rotation.T @ velocity, rotation.T @ (axis_point - origin)
    pull = w @ w * np.eye(3) - np.outer(w, w)  # a = pull @ (x - axis)
    shift = np.hstack([-axis[:, None], np.eye(3)])
    pairs = gram[4:, 4:].reshape(n, 3, n, 3)
    force, stiffness = body_force_terms(body, frame, place, pull @ shift)
    return InertiaTerms(
        force=force,
        coriolis=2 * np.einsum("jakb,ab->jk", pairs, skew(w)),
        stiffness=stiffness - np.einsum("jakb,ab->jk", pairs, pull),
        moment=float(np.einsum("ab,ab", pull, shift @ gram[:4, :4] @ shift.T)) / float(w @ w),
        body_force=pull @ shift,
    )


def body_loads(
    moved: MovedCoordinates, frames: Mapping[str, Frame], loads: ConstantLoads
) -> tuple[Array, Array, dict[str, Array]]:
    """Compute the weights and the centrifugal forces of a scene whose bodies have moved, and their stiffness.

    As a body sees it, gravity and the axis have turned, and the body has not. Deformation is of first order.

    Args:
        moved: coordinates about the configuration.
        frames: frames of the bodies in the reference configuration, by name.
        loads: gravity, and the spin of the whole scene.

    Returns:
        Forces (n_all,) and stiffness (n_all, n_all) along axes that turn with the bodies, and the body force per mass
        of each body, by name, see `body_force_terms`.
    """
    gravity, velocity = loads.gravity, loads.velocity
    force, stiffness, fields = moved.weight(gravity), np.zeros((moved.size,) * 2), {}
    for name, place in moved.slices.items():
        state = moved.moved[name]
        if not isinstance(state, FrameState):
            continue  # its points move linearly with its coordinates, so its weight has no stiffness
        back, frame, rotation = state.rotation.T, frames[name], integrals(state.body)[0]
        fields[name] = np.outer(rotation.T @ back @ gravity, [1.0, 0, 0, 0])
        stiffness[place, place] = body_force_terms(state.body, frame, place, fields[name])[1]
        if velocity.any():
            point = state.frame + back @ (loads.axis_point - state.position)
            terms = inertia_terms(state.body, frame, place, back @ velocity, point)
            force[place] += terms.force
            stiffness[place, place] += terms.stiffness
            fields[name] += terms.body_force
            if state.deformed is not None:
                force[place] -= terms.stiffness @ state.deformed
    return force, stiffness, fields


def body_force_terms(body: Body, frame: Frame, place: slice, field: Array) -> tuple[Array, Array]:
    """Compute the forces of a constant body force on one body, and their stiffness as its frame rotates.

    Args:
        body: the body.
        frame: its frame.
        place: slice of its coordinates among all.
        field: body force per mass as coefficients of 1, x, y, z along the body's axes, (3, 4) [m/s2, 1/s2].

    Returns:
        Forces on the body's coordinates, (n,), and stiffness, (n, n).
    """
    rotation, origin, gram = integrals(body)
    n, arm = (len(gram) - 4) // 3, rotation.T @ (frame.position - origin)
    along, around = rotation.T @ frame.motion[:3, place], rotation.T @ frame.rotation[:, place]
    whole = field @ gram[:4, 0]
    dyad = field @ gram[:4, 1:4] - np.outer(whole, arm)
    moments = (field @ gram[:4, 4:]).reshape(3, n, 3).transpose(0, 2, 1)  # a_d psi_jb
    crossed = np.array([moments[(k + 2) % 3, (k + 1) % 3] - moments[(k + 1) % 3, (k + 2) % 3] for k in range(3)])
    # Work of a on theta x (psi q - u_frame) - theta x (theta x r) / 2.
    half = around.T @ (crossed + skew(whole) @ along + 0.5 * (np.trace(dyad) * np.eye(3) - dyad) @ around)
    return np.einsum("bbj->j", moments), -half - half.T


def integrals(body: Body) -> tuple[Array, Array, Array]:
    """Return rotation (3, 3), origin (3,) [m] and Gram matrix, see `ReducedBody.gram`, of a body's coordinates."""
    if isinstance(body, FlexibleBody):
        return body.rotation, body.position, body.reduced.gram
    return np.eye(3), body.position, _rigid_gram(*body.rigid_inertia)


def _rigid_gram(mass: float, centre: Array, inertia: Array) -> Array:
    """Return the counterpart of `ReducedBody.gram` for a rigid body about its centre of mass, (22, 22)."""
    moments = np.zeros((4, 4))
    moments[0, 0], moments[1:, 1:] = mass, 0.5 * np.trace(inertia) * np.eye(3) - inertia
    fields = np.zeros((4, 22))
    fields[:, :4] = np.eye(4)
    for j in range(3):
        fields[0, 4 + 3 * j + j] = 1.0
        fields[1:, 13 + 3 * j : 16 + 3 * j] = skew(np.eye(3)[j]).T
    return fields.T @ moments @ fields


def warn_of_spinning_bodies(assembly: Assembly, rate: float, partition: RotorPartition | None, stress: bool) -> None:
    """Warn of bodies whose stress stiffening by a spin is left out, or whose inertia integrals are estimates.

    Args:
        assembly: the assembled scene.
        rate: rate of the spin [Hz].
        partition: rotor and stator; None: all rotates.
        stress: whether the model includes the geometric stiffness that bodies know.
    """
    stator = partition.stator if partition else ()
    bodies = [body for body in assembly.scene.deformable_bodies if body.name not in stator]
    for body in bodies:
        first, rise = stiffening(assembly.scene, body, rate)
        if rise > STIFFENING and not (stress and body.reduced.stress_stiffness):
            warn(
                f"body {body.name!r} turns at {rate:.3g} Hz, its first frequency held at its frame is {first:.4g} Hz: "
                "stress stiffening within the body, which is left out, would change that by some "
                f"{100 * rise:.2g} % or more; reduce it by craig_bampton(..., geometric_stiffness=True)"
            )
        if not body.reduced.full_integrals and rate > GUESSED * first:
            warn(
                f"body {body.name!r} turns at {rate:.3g} Hz, and how its inertia is spread is a guess, as of all "
                f"imported matrices: its frequencies may be off by up to some {rate:.3g} Hz"
            )
