"""Loads on a scene of first order: weights, constant inputs and the inertia of a spin, and how the scene bears them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import skew
from nassim.scene.bodies import FlexibleBody, RigidBody
from nassim.scene.terms import PrescribedMotion
from nassim.simulation.loaded.first_order_equilibrium import StaticBalance, balance
from nassim.simulation.loaded.geometric_stiffness import GeometricStiffness, applied_forces, gravity_felt
from nassim.simulation.loaded.rotor_frame import FrameView, RotorPartition, other_frame_terms, rotating_damping
from nassim.simulation.loaded.spinning import body_force_terms, inertia_terms, integrals
from nassim.simulation.model.assembly import Assembly


@dataclass
class Loads:
    """Loads of one kind on all coordinates, collected body by body.

    Attributes:
        force: forces, (n_all,).
        stiffness: stiffness that they add, (n_all, n_all).
        gyroscopic: Coriolis matrix, (n_all, n_all).
        body_forces: body force per mass of each body, see `body_force_terms`, by name, (3, 4).
        moment: moment of inertia about the axis of a spin [kg m2].
    """

    force: Array
    stiffness: Array
    gyroscopic: Array
    body_forces: dict[str, Array] = field(default_factory=dict)
    moment: float = 0.0

    @classmethod
    def none(cls, assembly: Assembly) -> "Loads":
        """Make loads that are zero."""
        size = assembly.coordinates.size
        fields = dict.fromkeys(assembly.coordinates.slices, np.zeros((3, 4)))
        return cls(np.zeros(size), np.zeros((size, size)), np.zeros((size, size)), fields)


def static_loads(
    assembly: Assembly,
    geometric: GeometricStiffness,
    gravity: Array,
    values: Mapping[str, float],
    moved: Array | float = 0.0,
) -> tuple[Loads, StaticBalance]:
    """Collect weights and forces of inputs, less the inertia forces of rigid-body modes, and how they are borne.

    Args:
        assembly: the assembled scene.
        geometric: its geometric stiffness.
        gravity: gravity, (3,) [m/s2].
        values: constant values of inputs, by name.
        moved: displacement by drives, (n_all,).

    Returns:
        The loads, and the equilibrium under them.
    """
    loads, coordinates = Loads.none(assembly), assembly.coordinates
    for term in assembly.terms:
        if isinstance(term, PrescribedMotion) and values.get(term.input):
            raise ValueError(
                f"input {term.input!r} moves a drive; only forces, voltages and accelerations are loads: for a stroke, "
                "let a force act there in place of the drive, and scale by the displacement that it causes; "
                "static_motion, load_limit and buckling_factors take strokes"
            )
    gravity = gravity_felt(assembly, gravity, values)
    for measure, force in applied_forces(assembly, values):
        loads.force += force * coordinates.jacobian(measure)[0]
        loads.stiffness += geometric.of_measure(measure, np.array([-force]))
    loads.force += coordinates.weight(gravity)
    hung = balance(assembly, loads.force, moved)
    for name, place in coordinates.slices.items():
        body, frame = assembly.scene.body(name), geometric.frames[name]
        if not isinstance(body, (RigidBody, FlexibleBody)):
            continue  # its points move linearly with its coordinates, so its weight has no stiffness
        rotation, origin, _ = integrals(body)
        fall = frame.motion @ hung.acceleration
        turning = rotation.T @ skew(fall[3:])
        at_origin = rotation.T @ (gravity - fall[:3]) - turning @ (origin - frame.position)
        loads.body_forces[name] = np.column_stack([at_origin, -turning @ rotation])
        loads.stiffness[place, place] += body_force_terms(body, frame, place, loads.body_forces[name])[1]
    return loads, hung


def spin_loads(
    assembly: Assembly,
    geometric: GeometricStiffness,
    velocity: Array,
    axis_point: Array,
    partition: RotorPartition | None,
) -> Loads:
    """Collect the centrifugal and Coriolis terms of all bodies and dampers, in the frame of the equations."""
    if not velocity.any():
        return Loads.none(assembly)
    loads, slices = inertia_loads(assembly, geometric, velocity, axis_point, partition), assembly.coordinates.slices
    if partition is not None:
        view = FrameView(assembly, partition)
        for name in filter(partition.in_other_frame, slices):
            own = (slices[name],) * 2
            gyroscopic, stiffness = loads.gyroscopic[own], loads.stiffness[own]
            loads.gyroscopic[own], loads.stiffness[own] = other_frame_terms(view, name, gyroscopic, stiffness)
        loads.stiffness += rotating_damping(view)
    return loads


def inertia_loads(
    assembly: Assembly,
    geometric: GeometricStiffness,
    velocity: Array,
    axis_point: Array,
    partition: RotorPartition | None,
) -> Loads:
    """Collect the centrifugal and Coriolis terms of all bodies that rotate."""
    loads, slices = Loads.none(assembly), assembly.coordinates.slices
    for name, place in slices.items():
        body = assembly.scene.body(name)
        if not isinstance(body, (RigidBody, FlexibleBody)):
            raise ValueError(f"body {name!r} is a {type(body).__name__}, whose centrifugal forces are not known")
        if partition is None or name not in partition.stator:
            terms = inertia_terms(body, geometric.frames[name], place, velocity, axis_point)
            loads.gyroscopic[place, place], loads.stiffness[place, place] = terms.coriolis, terms.stiffness
            loads.force[place], loads.moment = terms.force, loads.moment + terms.moment
            loads.body_forces[name] = terms.body_force
    return loads
