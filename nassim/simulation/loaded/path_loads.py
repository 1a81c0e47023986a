"""Inertia of a rotor along the path of its drive, on coordinates that turn with it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import skew
from nassim.simulation.loaded.first_order_equilibrium import balance
from nassim.simulation.loaded.geometric_stiffness import GeometricStiffness
from nassim.simulation.loaded.loaded_state import loaded_state
from nassim.simulation.loaded.rotor_frame import RotorPartition
from nassim.simulation.loaded.rotor_stator import rotation_about
from nassim.simulation.loaded.spinning import body_force_terms, inertia_terms, integrals
from nassim.simulation.model.assembly import Assembly


@dataclass(frozen=True)
class PathLoads:
    """Inertia of the rotor along its path, on all coordinates, which turn with it.

    Attributes:
        rotation: motion of all coordinates per radian, (n_all,).
        gyroscopic: Coriolis matrix G per unit of speed, (n_all, n_all).
        of_speed: stiffness K_s per square of the speed, (n_all, n_all), and force f_s, (n_all,).
        of_acceleration: stiffness K_a per unit of acceleration, (n_all, n_all), and force f_a, (n_all,).
        at_start: stiffness of gravity, preload and constant inputs in the reference configuration, (n_all, n_all).
        weight: force of gravity in the reference configuration, (n_all,).
    """

    rotation: Array
    gyroscopic: Array
    of_speed: tuple[Array, Array]
    of_acceleration: tuple[Array, Array]
    at_start: Array
    weight: Array

    @classmethod
    def of(cls, assembly: Assembly, partition: RotorPartition, inputs: Mapping[str, float]) -> "PathLoads":
        """Collect the inertia of a rotor; partition: of unit speed; inputs: constant values by name."""
        coordinates, scene = assembly.coordinates, assembly.scene
        geometric = GeometricStiffness.of(assembly)
        rotor = [name for name in coordinates.slices if name not in partition.stator]
        axis = partition.velocity
        rotation = rotation_about(coordinates, rotor, axis, partition.point)
        size = coordinates.size
        gyroscopic, by_speed, by_acceleration = np.zeros((3, size, size))
        centrifugal = np.zeros(size)
        for name in rotor:
            place, body = coordinates.slices[name], scene.body(name)
            frame = geometric.frames[name]
            terms = inertia_terms(body, frame, place, axis, partition.point)
            gyroscopic[place, place], by_speed[place, place] = terms.coriolis, terms.stiffness
            centrifugal[place] = terms.force
            turn, origin, _ = integrals(body)
            shift = np.hstack([-(turn.T @ (partition.point - origin))[:, None], np.eye(3)])
            euler = body_force_terms(body, frame, place, -skew(turn.T @ axis) @ shift)[1]
            by_acceleration[place, place] = 0.5 * terms.coriolis + euler
        pushed = -coordinates.mass @ rotation
        for force, stiffness in ((centrifugal, by_speed), (pushed, by_acceleration)):
            borne = balance(assembly, force)
            stiffness[:] += geometric.of_springs(borne.displacement) + geometric.of_joints(borne.borne)
        state = loaded_state(assembly, gravity=scene.gravity, inputs=inputs, checked=False)
        modes = coordinates.mass @ assembly.modal.modes
        return cls(
            rotation,
            gyroscopic,
            (by_speed, centrifugal),
            (by_acceleration, pushed),
            modes @ state.stiffness @ modes.T,
            assembly.signals.weight,
        )
