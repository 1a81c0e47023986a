"""Coordinates of a scene in another configuration, along axes that turn with its bodies.

What changes are the rows of measures between bodies. The mass, stiffness and damping of every body stay as they are but
for the inertia of its deformation.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from nassim.base.checks import Array
from nassim.scene.measures import Measure, PointVelocity
from nassim.scene.rotation_measures import RelativePose
from nassim.scene.terms import Constraint
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.states import SceneState


@dataclass(frozen=True)
class MovedCoordinates(Coordinates):
    """Coordinates of a scene whose bodies have moved.

    Attributes:
        moved: states of all bodies in this configuration, by name.
    """

    moved: Mapping[str, SceneState]

    @cached_property
    def reference(self) -> Coordinates:
        """These coordinates in the reference configuration, with the mass of this one."""
        return Coordinates(self.scene, self.slices, self.mass)

    @cached_property
    def states(self) -> dict[str, SceneState]:
        """States of all bodies in this configuration, by name."""
        return dict(self.moved)

    def motion(self, path: str) -> Array:
        """Return the small motion of a point in the world's frame, (6, n_all)."""
        body, point = self.scene.split(path)
        rows = super().motion(path)
        if body.moves:
            rows[:, self.slices[body.name]] = self.moved[body.name].motion(point)
        return rows


@dataclass(frozen=True)
class DrivenCoordinates(MovedCoordinates):
    """Coordinates of a scene whose rotor a drive has turned; they are deviations from the turn.

    Attributes:
        turned: coordinates of the moved bodies per unit of these, (n_all, n_all), a rotation.
        joint: the driven joint.
        component: its driven component, a rotation.
    """

    turned: Array
    joint: Constraint
    component: str

    def jacobian(self, measure: Measure, states: Mapping[str, SceneState] | None = None) -> Array:
        """Evaluate a measure's rows where the rotor has turned, on all coordinates, (k, n_all)."""
        rows = super().jacobian(measure, states)
        if isinstance(measure, RelativePose) and measure is self.joint.measure:
            # Its own row vanishes after a quarter of a turn: the entry of a rotation matrix is a sine. Of a hinge about
            # its y axis, the other two are parallel there.
            turns = [c for c in measure.components if measure.rotation_axis(c) is not None]
            hinge = [c for c in turns if c not in self.joint.held] == [self.component]
            for component in turns if hinge else (self.component,):
                axis = measure.rotation_axis(component)
                assert axis is not None
                spin = PointVelocity(((measure.a, -axis), (measure.b, axis)), angular=True)
                rows[self.joint.rows((component,))] = super().jacobian(spin, states)
        return rows @ self.turned

    def motion(self, path: str) -> Array:
        """Return the small motion of a point in the world's frame, (6, n_all)."""
        return super().motion(path) @ self.turned

    def weight(self, gravity: Array, states: Mapping[str, SceneState] | None = None) -> Array:
        """Return the forces of a uniform gravity, world frame, (3,) [m/s2], on all coordinates, (n_all,)."""
        return self.turned.T @ super().weight(gravity, states)
