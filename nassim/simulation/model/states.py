"""States of bodies: poses and motions of their points, in the coordinates of each engine.

The linear engine works in the reference configuration; the start of a run finds rigid motions. Exudyn has frames that
rotate and carry small deformation (rigid bodies and floating frames), and bodies whose points move linearly.

In a frame with position p and rotation R, a point at r from the frame's origin, with displacement d and rotation vector
e by deformation, has the position p + R (r + d) and the rotation R exp(e).
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_transfer, rotated_motion, rotation_matrix
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.measures import Pose
from nassim.scene.rotation_measures import inverse_right_jacobian


@dataclass(frozen=True)
class ReferenceState:
    """A body in the reference configuration, in the coordinates of `Body.mass_matrix`; a fixed body has no coordinates.

    Attributes:
        body: the body; with `rotated_from`, moved to another angle of its rotor.
        rotated_from: the body in the reference configuration; None: `body` is there.
        view: rotation (3, 3) about `origin` of the axes in which positions and motions are written; None: the world's.
        origin: centre of that rotation, (3,) [m].
    """

    body: Body
    rotated_from: Body | None = None
    view: Array | None = None
    origin: Array = field(default_factory=lambda: np.zeros(3))

    @cached_property
    def n_coordinates(self) -> int:
        """Number of the body's coordinates."""
        return len(self.body.mass_matrix) if self.body.moves else 0

    def reference(self, point: str) -> Array:
        """Return the position of a point in the reference configuration, (3,) [m]."""
        return (self.rotated_from or self.body).point_position(point)

    def pose(self, point: str) -> Pose:
        """Return the pose of a point."""
        position, rotation = self.body.point_position(point), np.eye(3)
        if self.rotated_from is not None:
            rotation = self.body.rotation @ self.rotated_from.rotation.T
        if self.view is None:
            return position, rotation
        return self.origin + self.view @ (position - self.origin), self.view @ rotation

    def motion(self, point: str) -> Array:
        """Return velocity and angular velocity of a point per unit rate of the coordinates, (6, n)."""
        motion = self.body.motion(point)
        return motion if self.view is None else rotated_motion(self.view) @ motion

    def own(self, weights: Array) -> tuple[Array, Array]:
        """Return weighted sums of the body's own coordinates: value (k,) and rows (k, n)."""
        return np.zeros(len(weights)), weights

    def weight(self, gravity: Array) -> Array:
        """Return the forces of a uniform gravity, (3,) along the world's axes, on the coordinates, (n,)."""
        return self.body.weight(gravity if self.view is None else self.view.T @ gravity)


@dataclass(frozen=True)
class RigidState:
    """A body moved as a rigid body; its coordinates are the motion (6,) of its point at the world's origin.

    Attributes:
        body: the body.
        twist: finite motion, (6,): it moves a point at x to exp(twist[3:]) x + twist[:3].
    """

    body: Body
    twist: Array = field(default_factory=lambda: np.zeros(6))

    @property
    def n_coordinates(self) -> int:
        """Number of the body's coordinates."""
        return 6 if self.body.moves else 0

    def reference(self, point: str) -> Array:
        """Return the position of a point in the reference configuration, (3,) [m]."""
        return self.body.point_position(point)

    def pose(self, point: str) -> Pose:
        """Return the pose of a point."""
        rotation = rotation_matrix(self.twist[3:])
        return rotation @ self.body.point_position(point) + self.twist[:3], rotation

    def motion(self, point: str) -> Array:
        """Return velocity and angular velocity of a point per unit rate of the coordinates, (6, 6)."""
        return rigid_transfer(self.pose(point)[0])

    def own(self, weights: Array) -> tuple[Array, Array]:
        """Return zeros: a rigid motion does not change the body's own coordinates."""
        return np.zeros(len(weights)), np.zeros((len(weights), self.n_coordinates))


@dataclass(frozen=True)
class LinearState:
    """A body whose points move linearly with its coordinates.

    Attributes:
        body: the body.
        coordinates: the coordinates x, (n,).
        change: coordinates of `Body.mass_matrix` per unit of x, (n_body, n); None: they are x.
    """

    body: Body
    coordinates: Array
    change: Array | None = None

    @property
    def n_coordinates(self) -> int:
        """Number of the coordinates."""
        return len(self.coordinates)

    def reference(self, point: str) -> Array:
        """Return the position of a point in the reference configuration, (3,) [m]."""
        return self.body.point_position(point)

    def pose(self, point: str) -> Pose:
        """Return the pose of a point."""
        moved = self.motion(point) @ self.coordinates
        return self.body.point_position(point) + moved[:3], rotation_matrix(moved[3:])

    def motion(self, point: str) -> Array:
        """Return velocity and angular velocity of a point per unit rate of the coordinates, (6, n)."""
        motion = self.body.motion(point)
        return motion if self.change is None else motion @ self.change

    def own(self, weights: Array) -> tuple[Array, Array]:
        """Return weighted sums of the body's own coordinates: value (k,) and rows (k, n)."""
        rows = weights if self.change is None else weights @ self.change
        return rows @ self.coordinates, rows

    def weight(self, gravity: Array) -> Array:
        """Return the forces of a uniform gravity, (3,) along the world's axes, on the coordinates, (n,)."""
        forces = self.body.weight(gravity)
        return forces if self.change is None else self.change.T @ forces


@dataclass(frozen=True)
class FrameState:
    """A body whose frame moves far and carries small deformation.

    Attributes:
        body: the body.
        frame: position of the frame in the reference configuration, (3,) [m].
        position: present position of the frame, (3,) [m].
        rotation: rotation of the frame since the reference configuration, (3, 3).
        frame_motion: velocity and angular velocity of the frame per unit rate of the coordinates, (6, n).
        deformed: coordinates of the reduced body by deformation relative to the frame, (n_reduced,); None where rigid.
        deforms: derivative of `deformed` with respect to the coordinates, (n_reduced, n).
    """

    body: Body
    frame: Array
    position: Array
    rotation: Array
    frame_motion: Array
    deformed: Array | None = None
    deforms: Array | None = None
    _arms: dict[str, tuple[Array, Array]] = field(default_factory=dict, init=False, compare=False)
    _motions: dict[str, Array] = field(default_factory=dict, init=False, compare=False)

    @property
    def n_coordinates(self) -> int:
        """Number of the coordinates."""
        return self.frame_motion.shape[1]

    def reference(self, point: str) -> Array:
        """Return the position of a point in the reference configuration, (3,) [m]."""
        return self.body.point_position(point)

    def pose(self, point: str) -> Pose:
        """Return the pose of a point."""
        arm, bent = self._local(point)
        rotation = self.rotation
        if bent[3:].any():
            rotation = rotation @ rotation_matrix(bent[3:])
        return self.position + self.rotation @ (arm + bent[:3]), rotation

    def motion(self, point: str) -> Array:
        """Return velocity and angular velocity of a point per unit rate of the coordinates, (6, n), read-only."""
        if point not in self._motions:
            self._motions[point] = self._motion(point)
            self._motions[point].setflags(write=False)
        return self._motions[point]

    def _motion(self, point: str) -> Array:
        arm, bent = self._local(point)
        result: Array = rigid_transfer(self.rotation @ (arm + bent[:3])) @ self.frame_motion
        if self.deforms is not None:
            rows = self.body.motion(point) @ self.deforms
            left = np.linalg.inv(inverse_right_jacobian(-bent[3:]))  # omega = J_left e'
            result = result + np.vstack([self.rotation @ rows[:3], self.rotation @ left @ rows[3:]])
        return result

    def own(self, weights: Array) -> tuple[Array, Array]:
        """Return weighted sums of the body's own coordinates, by deformation: value (k,) and rows (k, n)."""
        if self.deformed is None or self.deforms is None:
            return np.zeros(len(weights)), np.zeros((len(weights), self.n_coordinates))
        return weights @ self.deformed, weights @ self.deforms

    def weight(self, gravity: Array) -> Array:
        """Return the forces of a uniform gravity, (3,) along the world's axes, on the coordinates, (n,)."""
        along = self.rotation.T @ gravity
        result: Array = self.body.weight(along)
        if isinstance(self.body, FlexibleBody):
            moved = self.body.rotation @ self.body.reduced.gram[0, 4:].reshape(-1, 3).T @ self.deformed
            result = result + self.frame_motion[3:].T @ self.rotation @ np.cross(moved, along)
        return result

    def _local(self, point: str) -> tuple[Array, Array]:
        """Return a point's arm from the frame, (3,), and its motion by deformation, (6,), in the reference axes."""
        if point not in self._arms:
            bent = np.zeros(6) if self.deformed is None else self.body.motion(point) @ self.deformed
            self._arms[point] = self.body.point_position(point) - self.frame, bent
        return self._arms[point]


SceneState = ReferenceState | LinearState | FrameState
"""State of a body about which small motion is: in the reference configuration, turned by a drive, or under loads."""


def euler_state(
    body: Body,
    frame: Array,
    coordinates: Array,
    *,
    start: Array,
    deforms: Array | None = None,
) -> FrameState:
    """Make the state of a body whose frame is a node with Euler parameters.

    Args:
        body: a rigid or reduced body.
        frame: position of the node in the reference configuration, (3,) [m].
        coordinates: change of position (3,) and of the Euler parameters (4,) since the reference, then of m modal
            coordinates, (7 + m,).
        start: Euler parameters in the reference, (4,), e0 first.
        deforms: reduced coordinates per unit of the modal ones, (n_reduced, m); None where rigid.

    Returns:
        The state.
    """
    e = coordinates[3:7] + start
    before, _ = _euler(start)
    now, rate = _euler(e)
    n = len(coordinates)
    motion = np.zeros((6, n))
    motion[[0, 1, 2], [0, 1, 2]], motion[3:, 3:7] = 1.0, 2 * rate
    deformed, rows = None, None
    if deforms is not None:
        rows = np.hstack([np.zeros((len(deforms), 7)), deforms])
        deformed = deforms @ coordinates[7:]
    return FrameState(body, frame, frame + coordinates[:3], now @ before.T, motion, deformed, rows)


def _euler(e: Array) -> tuple[Array, Array]:
    """Return the rotation matrix of Euler parameters (4,), and E (3, 4) with omega = 2 E e' along the world's axes.

    Written out in plain numbers, because general items call this at every step.
    """
    w, x, y, z = e.tolist()
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rotation), np.array([[-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]])
