"""Loaded state of a scene: the stiffness of gravity and of a spin, about the equilibrium under both.

Loads give small motion a stiffness of four kinds, all of first order in the loads:

- weights and centrifugal forces act on points that frames carry on circles, see `body_force_terms`;
- forces in joints and springs change their directions and arms, see `geometric_stiffness`;
- the stress inside flexible bodies acts on their deformation, see `body_stress`;
- centrifugal forces grow with the distance from the axis, see `spinning`.

Each kind depends on the choice of the bodies' floating frames, and only the sum does not.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from nassim.base.callers import outside
from nassim.base.checks import Array, finite_array, freeze
from nassim.base.rigid_motion import skew
from nassim.simulation.loaded.body_stress import estimated_stress, stress_of_bodies
from nassim.simulation.loaded.equilibrium import Balance, balance, check_small, spinning_rest
from nassim.simulation.loaded.geometric_stiffness import GeometricStiffness
from nassim.simulation.loaded.rotor_frame import FrameView, RotorPartition, other_frame_terms, rotating_damping
from nassim.simulation.loaded.spinning import body_force_terms, inertia_terms, integrals, warn_of_spinning_bodies
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.buckling import axial_forces, warn_of_buckling

NO_LOAD = (0.0, 0.0, 0.0)
"""Default: no gravity, no angular velocity, and the origin as axis point."""
UNSTABLE_ROUNDING = 1e-7
"""Share of the loads' largest stiffness in modes of unit mass below which a negative stiffness is rounding."""


@dataclass(frozen=True)
class LoadedState:
    """Effect of constant loads on an assembly: M q'' + (C + gyroscopic) q' + (K + stiffness) q = f.

    Small motion q is about the equilibrium under the loads.

    Attributes:
        gyroscopic: 2 W G of a spin in minimal coordinates, (n, n), skew.
        stiffness: stiffness that the loads add in minimal coordinates, (n, n), symmetric; with a stator also that of
            dampers along rotating rows, which is not symmetric.
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
            stiffness=finite_array("stiffness of the loads", self.stiffness, (n, n)),
            equilibrium=finite_array("equilibrium", self.equilibrium, (n,)),
        )


@dataclass
class _Loads:
    """Loads of one kind on all coordinates, collected body by body."""

    force: Array
    stiffness: Array
    gyroscopic: Array
    body_forces: dict[str, Array] = field(default_factory=dict)
    moment: float = 0.0

    @classmethod
    def none(cls, assembly: Assembly) -> "_Loads":
        size = assembly.coordinates.size
        fields = dict.fromkeys(assembly.coordinates.slices, np.zeros((3, 4)))
        return cls(np.zeros(size), np.zeros((size, size)), np.zeros((size, size)), fields)


def loaded_state(
    assembly: Assembly,
    *,
    gravity: ArrayLike = NO_LOAD,
    angular_velocity: ArrayLike = NO_LOAD,
    axis_point: ArrayLike = NO_LOAD,
    partition: RotorPartition | None = None,
    stress: bool = True,
) -> LoadedState:
    """Compute the effect of gravity and of a constant angular velocity on small motion.

    Warns of an equilibrium beyond small motion, of one that is unstable under gravity, and of bodies whose stress
    matters but is not known.

    Args:
        assembly: the assembled scene.
        gravity: constant gravity along the axes in which the scene is described, (3,) [m/s2].
        angular_velocity: angular velocity of a whole scene, fixed bodies included, along the axes of the scene, which
            rotate with it, (3,) [rad/s].
        axis_point: a point of the axis, (3,) [m].
        partition: rotor and stator, where only the rotor has this velocity; None: all rotates.
        stress: whether to include the geometric stiffness of the stress in flexible bodies.

    Returns:
        The loaded state.

    Raises:
        ValueError: if there is no equilibrium within some 0.1 rad of the reference configuration, about which a linear
            model would hold.
    """
    gravity = finite_array("gravity", np.asarray(gravity, dtype=float), (3,))
    velocity = finite_array("angular_velocity", np.asarray(angular_velocity, dtype=float), (3,))
    point = finite_array("axis_point", np.asarray(axis_point, dtype=float), (3,))
    modal, followed = assembly.modal, assembly.signals.prescribed.motion
    n = len(modal.frequency)
    if not velocity.any() and not gravity.any():
        still = np.zeros((n, followed.shape[1]))
        return LoadedState(np.zeros((n, n)), np.zeros((n, n)), np.zeros(n), still, still)
    geometric = GeometricStiffness.of(assembly)
    weights, hung = _weights(assembly, geometric, gravity)
    spun = _spin(assembly, geometric, velocity, point, partition)
    swung = balance(assembly, spun.force)
    displacement = hung.displacement + swung.displacement
    stiffness = weights.stiffness + spun.stiffness
    stiffness += geometric.of_springs(displacement) + geometric.of_joints(hung.borne + swung.borne)
    if stress:
        body_forces = {name: weights.body_forces[name] + spun.body_forces[name] for name in weights.body_forces}
        stiffness += stress_of_bodies(assembly, displacement, body_forces)
        stiffness += estimated_stress(assembly, hung.displacement)
    equilibrium = modal.shapes @ (modal.modes.T @ (assembly.coordinates.mass @ hung.displacement))
    if gravity.any():
        check_small(assembly.coordinates, hung.displacement, "its weight")
    if velocity.any():
        rate = float(np.linalg.norm(velocity))
        # Cauchy-Schwarz: the force on a mode of unit mass is at most W^2 times the root of the moment of inertia.
        found = spinning_rest(assembly, stiffness, spun.force, rate, rate**2 * np.sqrt(spun.moment))
        _warn_of_spin(assembly, modal.basis @ found, rate / (2 * np.pi), partition, stress)
        equilibrium = equilibrium + found
    elif gravity.any():
        _warn_of_instability(assembly, stiffness)
    basis = modal.basis
    gyroscopic, stiffness = basis.T @ spun.gyroscopic, basis.T @ stiffness
    return LoadedState(gyroscopic @ basis, stiffness @ basis, equilibrium, gyroscopic @ followed, stiffness @ followed)


def _weights(assembly: Assembly, geometric: GeometricStiffness, gravity: Array) -> tuple[_Loads, Balance]:
    """Collect the weights, less the inertia forces of free fall, and how the scene bears them."""
    loads = _Loads.none(assembly)
    loads.force = assembly.coordinates.weight(gravity)
    hung = balance(assembly, loads.force)
    for name, place in assembly.coordinates.slices.items():
        body, frame = assembly.scene.split(f"{name}.")[0], geometric.frames[name]
        rotation, origin, _ = integrals(body)
        fall = frame.motion @ hung.acceleration
        turning = rotation.T @ skew(fall[3:])
        at_origin = rotation.T @ (gravity - fall[:3]) - turning @ (origin - frame.position)
        loads.body_forces[name] = np.column_stack([at_origin, -turning @ rotation])
        loads.stiffness[place, place] = body_force_terms(body, frame, place, loads.body_forces[name])[1]
    return loads, hung


def _spin(
    assembly: Assembly,
    geometric: GeometricStiffness,
    velocity: Array,
    axis_point: Array,
    partition: RotorPartition | None,
) -> _Loads:
    """Collect the centrifugal and Coriolis terms of all bodies and dampers."""
    loads, slices = _Loads.none(assembly), assembly.coordinates.slices
    if not velocity.any():
        return loads
    for name, place in slices.items():
        body, _ = assembly.scene.split(f"{name}.")
        if partition is None or name not in partition.stator:
            terms = inertia_terms(body, geometric.frames[name], place, velocity, axis_point)
            loads.gyroscopic[place, place], loads.stiffness[place, place] = terms.coriolis, terms.stiffness
            loads.force[place], loads.moment = terms.force, loads.moment + terms.moment
            loads.body_forces[name] = terms.body_force
    if partition is not None:
        view = FrameView(assembly, partition)
        for name in filter(partition.in_other_frame, slices):
            own = (slices[name],) * 2
            gyroscopic, stiffness = loads.gyroscopic[own], loads.stiffness[own]
            loads.gyroscopic[own], loads.stiffness[own] = other_frame_terms(view, name, gyroscopic, stiffness)
        loads.stiffness += rotating_damping(view)
    return loads


def _warn_of_spin(
    assembly: Assembly, coordinates: Array, rate: float, partition: RotorPartition | None, stress: bool
) -> None:
    """Warn of a spinning equilibrium beyond small motion, of stress that is left out, and of preload near buckling."""
    check_small(assembly.coordinates, coordinates, "the spin")
    warn_of_spinning_bodies(assembly, rate, partition, stress)
    known = {body.name for body in assembly.scene.deformable_bodies if stress and body.reduced.stress_stiffness}
    tensions: Mapping[str, Array] = {
        body.name: axial_forces(body.reduced, coordinates[assembly.coordinates.slices[body.name], None])[:, 0]
        * (body.name not in known)
        for body in assembly.scene.deformable_bodies
    }
    warn_of_buckling(assembly, tensions)


def _warn_of_instability(assembly: Assembly, stiffness: Array) -> None:
    """Warn of an equilibrium that gravity makes unstable, with its pole."""
    modes = assembly.modal.modes
    added = modes.T @ stiffness @ modes
    squares = np.linalg.eigvalsh(np.diag((2 * np.pi * assembly.modal.frequency) ** 2) + 0.5 * (added + added.T))
    if squares[0] < -UNSTABLE_ROUNDING * np.abs(added).max():
        warnings.warn(
            f"the equilibrium of scene {assembly.scene.name!r} under its weight is unstable: it has the real pole "
            f"{np.sqrt(-squares[0]):+.5g} rad/s",
            stacklevel=outside(),
        )
