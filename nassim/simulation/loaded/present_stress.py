"""Geometric stiffness of the stress in bodies by the present direction of gravity and the present speed of a rotor.

The stress is of first order in the loads. As a rotor turns about a fixed axis, the loads on a body along its own axes
are gravity, whose direction turns, and centrifugal forces, which grow with the square of the speed.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from nassim.base.checks import Array
from nassim.simulation.loaded.loaded_state import stress_under
from nassim.simulation.loaded.rotor_frame import RotorPartition
from nassim.simulation.model.assembly import Assembly

UNITS = np.eye(3)


@dataclass(frozen=True)
class PresentStress:
    """Change of the geometric stiffness of bodies since the start.

    Attributes:
        axis: axis of the rotor, (3,).
        gravity: gravity, (3,) [m/s2].
        speed: speed of the rotor whose stress is in the stiffness of the start [rad/s].
        of_gravity: stiffness per unit of gravity along the world's axes at the start, on the coordinates of each body,
            by name, (3, n, n).
        of_spin: the same per unit of the squared speed, (n, n).
    """

    axis: Array
    gravity: Array
    speed: float
    of_gravity: Mapping[str, Array]
    of_spin: Mapping[str, Array]

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
        partition = RotorPartition(axis, point, stator)
        none = stress_under(assembly, 0 * axis)  # that of preload
        by_axis = [stress_under(assembly, unit) for unit in UNITS]
        spun = stress_under(assembly, 0 * axis, partition)
        of_gravity = {name: np.array([own[name] - none[name] for own in by_axis]) for name in names}
        of_spin = {name: spun[name] - none[name] for name in names}
        return cls(axis, np.asarray(assembly.scene.gravity, dtype=float), speed, of_gravity, of_spin)

    @property
    def changes(self) -> dict[str, Callable[[Array, Array], Array]]:
        """Function of rotation and angular velocity for each body, see `change`, by name."""
        return {name: partial(self.change, name) for name in self.of_spin}

    def change(self, name: str, rotation: Array, velocity: Array) -> Array:
        """Compute the change of a body's stiffness since the start.

        Args:
            name: name of the body.
            rotation: rotation of its frame since the start, (3, 3).
            velocity: angular velocity of its frame along the world's axes, (3,) [rad/s].

        Returns:
            Stiffness on the body's coordinates, (n, n).
        """
        squares = float(self.axis @ velocity) ** 2 - self.speed**2
        result: Array = squares * self.of_spin[name]
        if self.gravity.any():
            result += np.tensordot(rotation.T @ self.gravity - self.gravity, self.of_gravity[name], axes=1)
        return result
