"""Geometric stiffness of the stress in bodies by the present direction of gravity and the present speed of a rotor.

The stress is of first order in the loads. As a rotor turns about a fixed axis, the loads on a body along its own axes
are gravity, whose direction turns, and centrifugal forces, which grow with the square of the speed.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from nassim.base.checks import Array
from nassim.bodies.stress_stiffness import GeometricTerms
from nassim.simulation.loaded.body_stress import InnerForces, stress_of_bodies
from nassim.simulation.loaded.carried_bodies import stiffness_of_carried
from nassim.simulation.loaded.first_order_equilibrium import balance
from nassim.simulation.loaded.geometric_stiffness import GeometricStiffness
from nassim.simulation.loaded.loads import inertia_loads, static_loads
from nassim.simulation.loaded.rotor_frame import RotorPartition
from nassim.simulation.model.assembly import Assembly


@dataclass(frozen=True)
class PresentStress:
    """Change of the geometric stiffness of bodies since the start.

    The loads that change are gravity along the three axes of the world at the start, and the squared speed.

    Attributes:
        axis: axis of the rotor, (3,).
        gravity: gravity, (3,) [m/s2].
        speed: speed of the rotor whose stress is in the stiffness of the start [rad/s].
        first_order: stiffness of first order per unit of these four loads, on the coordinates of each body, by name,
            (4, n, n).
        turned: strains by change of shape at the start, and per unit of the loads, by name, (5, p, n); see
            `GeometricTerms.turned_strains`.
    """

    axis: Array
    gravity: Array
    speed: float
    first_order: Mapping[str, Array]
    turned: Mapping[str, Array]

    @classmethod
    def of(
        cls,
        assembly: Assembly,
        names: Sequence[str],
        axis: Array,
        point: Array,
        stator: frozenset[str],
        speed: float,
    ) -> "PresentStress":
        """Compute the stiffness per unit of each load.

        Args:
            assembly: the assembled scene.
            names: names of the bodies, which hold their geometric stiffness.
            axis: axis of the rotor, (3,).
            point: a point of the axis, (3,) [m].
            stator: names of the bodies that do not rotate.
            speed: speed of the rotor whose stress is in the stiffness of the start [rad/s].
        """
        gravity = np.asarray(assembly.scene.gravity, dtype=float)
        turning = RotorPartition(axis, point, stator)
        none = stress_under(assembly, 0 * axis)  # that of preload and constant inputs
        units = [*(stress_under(assembly, unit) for unit in np.eye(3)), stress_under(assembly, 0 * axis, turning)]
        amplitudes = np.append(gravity, speed**2)
        first_order, turned = {}, {}
        for name in names:
            strain = assembly.scene.body(name).strain
            assert strain is not None  # a flexible body
            changes = np.array([one[name].first_order - none[name].first_order for one in units])
            still = none[name].turned_strains(strain)
            strains = np.array([one[name].turned_strains(strain) - still for one in units])
            start = still + np.tensordot(amplitudes, strains, axes=1)
            first_order[name], turned[name] = changes, np.concatenate([start[None], strains])
        return cls(axis, gravity, speed, first_order, turned)

    @property
    def changes(self) -> dict[str, Callable[[Array, Array], Array]]:
        """Function of rotation and angular velocity for each body, see `change`, by name."""
        return {name: partial(self.change, name) for name in self.first_order}

    def change(self, name: str, rotation: Array, velocity: Array) -> Array:
        """Compute the change of a body's stiffness since the start.

        Args:
            name: name of the body.
            rotation: rotation of its frame since the start, (3, 3).
            velocity: angular velocity of its frame along the world's axes, (3,) [rad/s].

        Returns:
            Stiffness on the body's coordinates, (n, n).
        """
        loads = np.append(rotation.T @ self.gravity - self.gravity, float(self.axis @ velocity) ** 2 - self.speed**2)
        start, *strains = self.turned[name]
        change = np.tensordot(loads, strains, axes=1)
        result: Array = np.tensordot(loads, self.first_order[name], axes=1)
        result += start.T @ change + change.T @ start + change.T @ change
        return result


def stress_under(
    assembly: Assembly, gravity: Array, partition: RotorPartition | None = None
) -> dict[str, GeometricTerms]:
    """Compute the stiffness of the loads in and on the bodies that hold their stress.

    The loads are gravity, preload, a spin, and the constant inputs of the assembly's loads.

    Args:
        assembly: the assembled scene.
        gravity: gravity along the axes of the scene, (3,) [m/s2].
        partition: rotor, whose centrifugal forces count, and stator; None: nothing spins.

    Returns:
        Terms on the coordinates of each of these bodies, by name.
    """
    geometric = GeometricStiffness.of(assembly)
    inputs = assembly.loads.given.inputs if assembly.loads else {}
    weights, rest = static_loads(assembly, geometric, gravity, inputs)
    body_forces = weights.body_forces
    if partition is not None:
        spun = inertia_loads(assembly, geometric, partition.velocity, partition.point, partition)
        rest = balance(assembly, weights.force + spun.force)
        body_forces = {name: field + spun.body_forces[name] for name, field in body_forces.items()}
    terms = stress_of_bodies(assembly, rest.displacement, body_forces, InnerForces.of(assembly, inputs))
    if not assembly.bent_points_carry:
        return terms
    carried = stiffness_of_carried(assembly, geometric, rest.displacement, rest.borne, body_forces)
    return {name: replace(own, stress=own.stress + carried.get(name, 0.0)) for name, own in terms.items()}
