"""Coordinates of a scene whose rotor a drive has turned, along axes that turn with the rotor.

The coordinates are those of the reference configuration as seen by axes that turn with each body's side, so that mass,
stiffness and damping of every body stay as they are. What changes with the angle are the rows of measures between the
two sides.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from nassim.base.checks import Array
from nassim.scene.measures import Measure, PointVelocity, RelativePose
from nassim.scene.terms import Constraint
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.states import ReferenceState


@dataclass(frozen=True)
class MovedCoordinates(Coordinates):
    """Coordinates of a scene at an angle of its rotor.

    Attributes:
        moved: states of all bodies at this angle, by name.
        turned: coordinates of the moved bodies per unit of these, (n_all, n_all), a rotation.
        joint: the driven joint.
        component: its driven component, a rotation.
    """

    moved: Mapping[str, ReferenceState]
    turned: Array
    joint: Constraint
    component: str

    @cached_property
    def states(self) -> dict[str, ReferenceState]:
        """States of all bodies at this angle, by name."""
        return dict(self.moved)

    def jacobian(self, measure: Measure, states: Mapping[str, ReferenceState] | None = None) -> Array:
        """Evaluate a measure's rows, of deviations from the rotor's turn, on all coordinates, (k, n_all)."""
        rows = super().jacobian(measure.deviation, states)
        if isinstance(measure, RelativePose) and measure is self.joint.measure:
            # Its own row vanishes after a quarter of a turn: the entry of a rotation matrix is a sine.
            axis = measure.rotation_axis(self.component)
            assert axis is not None
            spin = PointVelocity(((measure.a, -axis), (measure.b, axis)), angular=True)
            rows[self.joint.rows((self.component,))] = super().jacobian(spin, states)
        result: Array = rows @ self.turned
        return result

    def motion(self, path: str) -> Array:
        """Return the small motion of a point in the world's frame, (6, n_all)."""
        body, point = self.scene.split(path)
        rows = super().motion(path)
        if body.moves:
            rows[:, self.slices[body.name]] = self.moved[body.name].motion(point)
        result: Array = rows @ self.turned
        return result

    def weight(self, gravity: Array, states: Mapping[str, ReferenceState] | None = None) -> Array:
        """Return the forces of a uniform gravity, world frame, (3,) [m/s2], on all coordinates, (n_all,)."""
        result: Array = self.turned.T @ super().weight(gravity, states)
        return result
