"""Loaded state of a scene: the stiffness of gravity, constant inputs and a spin, about the equilibrium under them.

Loads give small motion a stiffness of four kinds, all of first order in the loads:

- weights, centrifugal and applied forces act on points that frames carry on circles, see `body_force_terms`;
- forces in joints and springs change their directions and arms, see `geometric_stiffness`;
- the stress inside flexible bodies acts on their deformation, see `body_stress`;
- centrifugal forces grow with the distance from the axis, see `spinning`.

Each kind depends on the choice of the bodies' floating frames, and only the sum does not.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from nassim.base.checks import Array, known
from nassim.base.field_types import ArrayLike
from nassim.bodies.stress_stiffness import GeometricTerms
from nassim.simulation.loaded.body_stress import (
    InnerForces,
    deformation,
    deformation_rows,
    estimated_stress,
    stress_of_bodies,
)
from nassim.simulation.loaded.carried_bodies import stiffness_of_carried
from nassim.simulation.loaded.deflection import Deflection, LoadedStiffness
from nassim.simulation.loaded.first_order_equilibrium import (
    StaticBalance,
    balance,
    check_small,
    is_at_equilibrium,
    spinning_amplitudes,
)
from nassim.simulation.loaded.geometric_stiffness import GeometricStiffness, is_preloaded
from nassim.simulation.loaded.loads import Loads, spin_loads, static_loads
from nassim.simulation.loaded.rotor_frame import RotorPartition
from nassim.simulation.loaded.spinning import warn_of_spinning_bodies
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.axial_preload import axial_forces, warn_of_buckling
from nassim.simulation.model.effect_of_loads import BodyStress, ConstantLoads, LoadedState
from nassim.simulation.model.tangents import Tangent

NO_LOAD = (0.0, 0.0, 0.0)
"""Default: no gravity, no angular velocity, and the origin as axis point."""


def loaded_state(
    assembly: Assembly,
    *,
    gravity: ArrayLike = NO_LOAD,
    inputs: Mapping[str, float] | None = None,
    angular_velocity: ArrayLike = NO_LOAD,
    axis_point: ArrayLike = NO_LOAD,
    partition: RotorPartition | None = None,
    moved: Array | None = None,
    stress: bool = True,
    shape: bool = True,
    checked: bool = True,
) -> LoadedState:
    """Compute the effect of gravity, constant inputs and a constant angular velocity on small motion.

    Args:
        assembly: the assembled scene.
        gravity: constant gravity along the axes in which the scene is described, (3,) [m/s2].
        inputs: constant values of inputs, by name; others are zero. Forces along axes of the world keep their
            direction, those along axes of a point follow it.
        angular_velocity: angular velocity of a whole scene, fixed bodies included, along the axes of the scene, which
            rotate with it, (3,) [rad/s].
        axis_point: a point of the axis, (3,) [m].
        partition: rotor and stator, where only the rotor has this velocity; None: all rotates.
        moved: elastic displacement by strokes of drives, which load a scene at rest too, in all coordinates, (n_all,);
            the equilibrium is that beside it.
        stress: whether to include the geometric stiffness of the stress in flexible bodies.
        shape: whether to include their change of shape.
        checked: whether to check that an equilibrium at rest is stable and within small motion.

    Returns:
        The loaded state.

    Warns:
        UserWarning: for an equilibrium beyond small motion, and for bodies whose stress matters but is not known.

    Raises:
        ValueError: if the equilibrium is beyond small motion, see `check_small`; for unknown inputs and those that a
            drive follows.
    """
    for name in inputs or {}:
        known("input", name, assembly.scene.inputs)
    given = ConstantLoads(gravity, inputs or {}, angular_velocity, axis_point)
    modes, followed = assembly.modal.modes, assembly.signals.prescribed.motion
    strokes = np.zeros(assembly.coordinates.size) if moved is None else moved
    spins = bool(given.velocity.any())
    constant = bool(given.gravity.any() or any(given.inputs.values()) or strokes.any())
    has_static_loads = stress and (constant or is_preloaded(assembly.tangents))
    if not spins and not has_static_loads:
        return LoadedState.none(modes.shape[1], followed.shape[1], modes.T @ assembly.signals.weight)
    acting = _acting_loads(assembly, given, strokes, partition)
    loaded, rest = _deflection(acting, given.inputs, stress=stress, shape=shape, at_rest=not spins)
    equilibrium = modes.T @ (assembly.coordinates.mass @ (acting.hung.displacement - strokes)) + rest.beyond
    force = modes.T @ (acting.weights.force + acting.spun.force) + rest.resisted + loaded.on_modes @ equilibrium
    if has_static_loads and checked:
        settled = is_at_equilibrium(assembly, partition)
        check_small(assembly.coordinates, modes @ equilibrium, "its loads", settled=settled)
    if spins:
        rate = float(np.linalg.norm(given.velocity))
        equilibrium = equilibrium + _amplitudes_by_spin(acting, loaded, rate, partition, stress)
    gyroscopic = modes.T @ acting.spun.gyroscopic
    stiffness = loaded.on_all
    return LoadedState(
        gyroscopic=gyroscopic @ modes,
        stiffness=loaded.on_modes,
        force=force,
        equilibrium=equilibrium,
        drive_damping=gyroscopic @ followed,
        drive_stiffness=modes.T @ stiffness @ followed,
        stress=_stress_at_rest(loaded, rest),
        carried=acting.on_carried_bodies if stress else {},
        given=given,
        on_all=stiffness,
    )


@dataclass(frozen=True)
class _ActingLoads:
    """Loads on a scene, and how it bears them to first order.

    Attributes:
        geometric: geometric stiffness of the scene's joints and springs.
        weights: weights and constant inputs.
        spun: centrifugal and Coriolis terms.
        hung: equilibrium under weights, constant inputs and strokes.
        whole: equilibrium under all loads.
        inner: constant forces within bodies.
    """

    geometric: GeometricStiffness
    weights: Loads
    spun: Loads
    hung: StaticBalance
    whole: StaticBalance
    inner: InnerForces

    @property
    def body_forces(self) -> dict[str, Array]:
        """Body force per mass of each body, see `body_force_terms`, by name, (3, 4)."""
        return {name: field + self.spun.body_forces[name] for name, field in self.weights.body_forces.items()}

    @property
    def on_carried_bodies(self) -> dict[str, Array]:
        """Stiffness of the loads on rigid bodies that floating bodies carry, see `LoadedState.carried`."""
        whole = self.whole
        assembly = self.geometric.assembly
        return stiffness_of_carried(assembly, self.geometric, whole.displacement, whole.borne, self.body_forces)


def _acting_loads(
    assembly: Assembly, given: ConstantLoads, strokes: Array, partition: RotorPartition | None
) -> _ActingLoads:
    """Collect the loads, and how the scene bears them; other arguments as of `loaded_state`."""
    geometric = GeometricStiffness.of(assembly)
    weights, hung = static_loads(assembly, geometric, given.gravity, given.inputs, strokes)
    spun = spin_loads(assembly, geometric, given.velocity, given.axis_point, partition)
    whole = balance(assembly, weights.force + spun.force) if given.velocity.any() else hung
    return _ActingLoads(geometric, weights, spun, hung, whole, InnerForces.of(assembly, given.inputs))


def _deflection(
    acting: _ActingLoads, values: Mapping[str, float], *, stress: bool, shape: bool, at_rest: bool
) -> tuple[LoadedStiffness, Deflection]:
    """Compute the stiffness that loads add, and how far the scene deflects under them.

    Args:
        acting: the loads.
        values: constant values of inputs, by name.
        stress: whether to include the stress in flexible bodies.
        shape: whether to include their change of shape.
        at_rest: whether the stiffness of the loads takes part in the deflection.
    """
    assembly, geometric, weights = acting.geometric.assembly, acting.geometric, acting.weights
    hung, whole = acting.hung, acting.whole
    of_springs, of_joints = geometric.of_springs(whole.displacement), geometric.of_joints(whole.borne)
    retuned = _retuned(assembly, hung.displacement, values)
    parts = [weights.stiffness, acting.spun.stiffness, of_springs, of_joints, retuned]

    def stress_at(displacement: Array) -> dict[str, GeometricTerms]:
        found = stress_of_bodies(assembly, displacement, acting.body_forces, acting.inner) if stress else {}
        return found if shape else {name: replace(own, shape=np.zeros_like(own.shape)) for name, own in found.items()}

    exact = LoadedStiffness(assembly, parts, stress_at(whole.displacement))
    if at_rest:
        farther = -(weights.stiffness + of_springs + of_joints) @ hung.displacement
        rest = Deflection.of(exact, hung.displacement, farther, acting.inner.stiffness_at_once(assembly))
        exact = exact.with_shapes(stress_at(rest.displacement))
    else:
        rest = Deflection.of_first_order(exact, whole.displacement)
    estimated = estimated_stress(assembly, hung.displacement, acting.inner) if stress else {}
    return replace(exact, terms={**exact.terms, **estimated}), rest


def _stress_at_rest(loaded: LoadedStiffness, rest: Deflection) -> dict[str, BodyStress]:
    """Return the stress of the bodies, by name. An estimate acts on the motion from the equilibrium alone."""
    assembly, result = loaded.assembly, {}
    for name, own in loaded.inside.items():
        held, strained = own @ deformation(assembly, name, rest.displacement), np.zeros((len(own), len(own) + 1))
        if name in rest.stiffness.terms:
            held, strain = held - rest.stress_force(name), assembly.scene.body(name).strain
            assert strain is not None  # a flexible body
            rows = loaded.terms[name].strained_beside(strain) @ deformation_rows(assembly, name)
            at_rest = rest.displacement[assembly.coordinates.slices[name]]
            strained = np.column_stack([rows, rest.strained_beside(name) - rows @ at_rest])
        result[name] = BodyStress(own, held, strained)
    return result


def _retuned(assembly: Assembly, displacement: Array, values: Mapping[str, float]) -> Array:
    """Return the change of the stiffness of nonlinear springs from gravity alone to all loads, (n_all, n_all)."""
    result = np.zeros((assembly.coordinates.size,) * 2)
    for tangent in assembly.tangents if any(values.values()) else ():
        now = Tangent.of(tangent.law, tangent.rows, displacement)
        result += tangent.rows.T @ (now.stiffness - tangent.stiffness) @ tangent.rows
    return result


def _amplitudes_by_spin(
    acting: _ActingLoads, loaded: LoadedStiffness, rate: float, partition: RotorPartition | None, stress: bool
) -> Array:
    """Return modal amplitudes in the equilibrium under the centrifugal forces of a spin, (n,); rate: of it [rad/s]."""
    assembly, spun = loaded.assembly, acting.spun
    # Cauchy-Schwarz: the force on a mode of unit mass is at most W^2 times the root of the moment of inertia.
    largest = rate**2 * np.sqrt(spun.moment)
    found = spinning_amplitudes(assembly, loaded.on_modes, spun.force, rate, largest)
    _warn_of_spin(assembly, assembly.modal.modes @ found, rate / (2 * np.pi), partition, stress)
    return found


def _warn_of_spin(
    assembly: Assembly, coordinates: Array, rate: float, partition: RotorPartition | None, stress: bool
) -> None:
    """Warn of a spinning equilibrium beyond small motion, of stress that is left out, and of preload near buckling."""
    check_small(assembly.coordinates, coordinates, "the spin", settled=is_at_equilibrium(assembly, partition))
    warn_of_spinning_bodies(assembly, rate, partition, stress)
    exact = {body.name for body in assembly.scene.deformable_bodies if stress and body.reduced.stress_stiffness}
    tensions: Mapping[str, Array] = {
        body.name: axial_forces(body.reduced, coordinates[assembly.coordinates.slices[body.name], None])[:, 0]
        * (body.name not in exact)
        for body in assembly.scene.deformable_bodies
    }
    warn_of_buckling(assembly, tensions)
