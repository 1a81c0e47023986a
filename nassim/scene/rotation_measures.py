"""Measures of rotation: the angle about an axis, the deviation from a joint's turn, the relative pose of two points."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array, finite_array, freeze, known
from nassim.base.rigid_motion import DIRECTIONS, IDENTITY, quaternion, skew
from nassim.scene.field_kinds import Axes, Direction, Path
from nassim.scene.measures import Measure, PointMeasure, PointVelocity, Pose

VECTOR, TILT, MATRIX = ROTATIONS = "vector", "tilt", "matrix"
"""Rotation parts of a relative pose."""
SAME_POSE = 1e-9
"""Change of a relative pose, over its size, that is rounding."""
FREE = 1e-12
"""Moment about the free rotation of a bearing, over all of the moment, that is rounding."""
SMALL_HALF = 1e-4
"""Half of an angle [rad] below which a series replaces a quotient of differences."""


@dataclass(frozen=True)
class RotationAngle(PointMeasure):
    """Rotation of point b against point a about an axis fixed in a.

    It is the twist of the swing-twist decomposition of the relative rotation: the whole angle where the axis of b stays
    parallel to that of a. Engines unwrap it beyond half a turn.

    Attributes:
        b: second point, "body.point".
        axis: axis in the world's axes of the reference configuration, (3,); the angle is multiplied by its length.
        a: first point, "body.point"; "" for the world's axes.
    """

    b: Path
    axis: Direction
    a: Path = ""

    def __post_init__(self) -> None:
        freeze(self, axis=finite_array("axis of an angle", self.axis, (3,)))

    @property
    def points(self) -> tuple[str, ...]:
        """Point b, then point a."""
        return (self.b, self.a) if self.a else (self.b,)

    @property
    def deviation(self) -> Measure:
        """The component of the relative angular velocity about the axis; its value excludes the steady rotation."""
        against = ((self.a, -self.axis),) if self.a else ()
        return PointVelocity(((self.b, self.axis), *against), self.a, angular=True)

    @property
    def period(self) -> float | None:
        """A full turn."""
        return float(2 * np.pi * np.linalg.norm(self.axis))

    def at(self, poses: Sequence[Pose], reference: Sequence[Array]) -> tuple[Array, Array]:
        """Evaluate the measure, see `PointMeasure.at`."""
        a = poses[1][1] if self.a else IDENTITY
        size = float(np.linalg.norm(self.axis))
        n = self.axis / size
        c, v = quaternion(a.T @ poses[0][1])
        s = n @ v
        row = size * (a @ (c * (c * n + skew(v) @ n) + s * v)) / (c * c + s * s)
        rows = np.zeros((1, 6 * len(poses)))
        rows[0, 3:6] = row
        if self.a:
            rows[0, 9:12] = -row
        return np.array([2 * size * np.arctan2(s, c)]), rows

    def geometric_stiffness(self, force: Array, reference: Sequence[Array]) -> Array:
        """Compute `PointMeasure.geometric_stiffness` in closed form: the moment rotates with an axis halfway."""
        signs = np.array([1.0, -1.0])[: len(reference)]
        rotation = np.kron(np.outer(signs, np.ones(len(signs))), np.diag([0.0, 1.0]))
        return np.kron(rotation, -0.5 * skew(force[0] * self.axis))


@dataclass(frozen=True)
class RotationDeviation(PointMeasure):
    """Component of the rotation of point b against a beside the turn of a joint, such as that of a spindle.

    The turn of the joint between c and d is the twist of its rotation about an axis. What remains of the rotation of b
    is a rotation vector, the deviation from an ideal body that turns with the joint and has no other rotation. It must
    stay below half a turn.

    Attributes:
        a: first point, "body.point".
        b: second point, "body.point".
        direction: direction of the component, in the world's axes of the reference configuration, (3,); the component
            is multiplied by its length.
        c: point of the joint on the side of a, "body.point".
        d: point of the joint on the side of b, "body.point".
        axis: axis of the joint in the world's axes of the reference configuration, (3,).
        turning: whether the direction turns with the ideal body, or stays with a.
    """

    a: Path
    b: Path
    direction: Direction
    c: Path
    d: Path
    axis: Direction
    turning: bool = True

    def __post_init__(self) -> None:
        freeze(
            self,
            direction=finite_array("direction of a deviation", self.direction, (3,)),
            axis=finite_array("axis of a deviation", self.axis, (3,)),
        )

    @property
    def points(self) -> tuple[str, ...]:
        """The four points."""
        return self.a, self.b, self.c, self.d

    def vectors(self, a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array]:
        """Return rotation vectors of the deviation, (..., 3) [rad], and rotations of the ideal body against a.

        Args:
            a: rotation of point a since the reference configuration, (..., 3, 3).
            b: that of point b.
            c: that of point c.
            d: that of point d.
        """
        axis = self.axis / np.linalg.norm(self.axis)
        joint = Rotation.from_matrix(np.swapaxes(c, -1, -2) @ d).as_quat()
        angle = 2 * np.arctan2(joint[..., :3] @ axis, joint[..., 3])
        ideal = Rotation.from_rotvec(angle[..., None] * axis).as_matrix()
        whole, back = np.swapaxes(a, -1, -2) @ b, np.swapaxes(ideal, -1, -2)
        return Rotation.from_matrix(back @ whole if self.turning else whole @ back).as_rotvec(), ideal

    def at(self, poses: Sequence[Pose], reference: Sequence[Array]) -> tuple[Array, Array]:
        """Evaluate the measure, see `PointMeasure.at`."""
        deviation, ideal = self.vectors(*(rotation for _, rotation in poses))
        axis, direction = self.axis / np.linalg.norm(self.axis), self.direction
        turn = RotationAngle(self.d, axis, self.c).at(poses[:1:-1], reference[:1:-1])[1][0]
        # Rates of the rotation vector by a rotation before it and by one after it.
        before, after = (direction @ inverse_right_jacobian(sign * deviation) for sign in (-1, 1))
        row, rows = poses[0][1] @ (ideal @ before if self.turning else before), np.zeros((1, 24))
        rows[0, 3:6], rows[0, 9:12] = -row, row
        rows[0, 12:] = -((before if self.turning else after) @ axis) * np.concatenate([turn[6:], turn[:6]])
        return np.array([direction @ deviation]), rows


@dataclass(frozen=True)
class RelativePose(PointMeasure):
    """Displacement and rotation of point b against point a: six components x, y, z, rx, ry, rz.

    Where the points are apart, the body of a is extended rigidly to the place of b.

    Attributes:
        a: first point, "body.point".
        b: second point, "body.point".
        axes: axes of the six components in the reference configuration, as columns, world frame, (3, 3).
        rotation: parametrisation of the rotation. "vector": the rotation vector, along axes halfway between a and b,
            for bushings and rotations below half a turn. "tilt": the vector product of the `shaft` of a and that of
            b, along axes fixed in a, for bearings, at any angle of the shaft; of the free rotation, it has the angular
            velocity without a value. "matrix": entries -y.z', x.z', -x.y' of
            the relative rotation matrix, along axes fixed in a, for joints.
        shaft: for a tilt, the unit vector about which b turns freely, components along the axes, (3,); zero where b
            turns freely about all.
    """

    a: Path
    b: Path
    axes: Axes = field(default_factory=lambda: np.eye(3))
    rotation: str = VECTOR
    shaft: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        known("rotation of a relative pose", self.rotation, ROTATIONS)
        freeze(
            self,
            axes=finite_array("axes of a relative pose", self.axes, (3, 3)),
            shaft=finite_array("shaft of a relative pose", self.shaft, (3,)),
        )

    @property
    def points(self) -> tuple[str, ...]:
        """The two points."""
        return (self.a, self.b)

    @property
    def components(self) -> tuple[str, ...]:
        """The six directions."""
        return tuple(DIRECTIONS)

    @property
    def _free(self) -> Array:
        """Projector on the free rotations of a tilt, (3, 3)."""
        free: Array = np.outer(self.shaft, self.shaft) + (1 - self.shaft @ self.shaft) * IDENTITY
        return free

    def has_energy(self, force: Array) -> bool:
        """Return whether a constant force (6,) has an energy; a moment about a free rotation has none."""
        return self.rotation != TILT or bool(np.abs(self._free @ force[3:]).max() <= FREE * np.abs(force[3:]).max())

    def rotation_axis(self, component: str) -> Array | None:
        """Return the axis (3,) of a rotation component; None for a displacement."""
        return self.axes[:, "xyz".index(component[1])] if component.startswith("r") else None

    def at(self, poses: Sequence[Pose], reference: Sequence[Array]) -> tuple[Array, Array]:
        """Evaluate the measure, see `PointMeasure.at`."""
        (p, a), (q, b) = poses
        gap = q - p - a @ (reference[1] - reference[0])
        first, second = a @ self.axes, b @ self.axes
        if self.rotation == MATRIX:
            x, y, _ = first.T
            pairs = ((-1, y, second[:, 2]), (1, x, second[:, 2]), (-1, x, second[:, 1]))
            rotation = np.array([sign * u @ v for sign, u, v in pairs])
            rates = np.array([sign * skew(v) @ u for sign, u, v in pairs])
            axes, of_b = first, np.zeros((3, 3))
        elif self.rotation == TILT:
            own, other = skew(self.shaft), first.T @ second @ self.shaft
            rotation, rates = own @ other, (self._free - own @ skew(other)) @ first.T
            axes, of_b = first, np.zeros((3, 3))
        else:
            c, v = quaternion(first.T @ second)
            cross, sine = skew(v), math.sqrt(v @ v)
            axes = first @ (IDENTITY + cross + (cross @ cross) / (1 + c))
            half = math.atan2(sine, c)  # of the angle
            size = half / sine if sine else 1.0
            along = (1 - size) / (sine * sine) if half > SMALL_HALF else -1 / 6
            rotation, rates = 2 * size * v, (size * IDENTITY + along * v[:, None] * v) @ axes.T
            of_b = (IDENTITY - axes @ (cross / (1 + c)) @ axes.T) / 2  # share of b's rate in that of the axes halfway
        rows = np.zeros((6, 12))
        rows[:3, :3], rows[:3, 6:9] = -axes.T, axes.T
        lever = skew(gap)
        rows[:3, 3:6] = axes.T @ (skew(q - p - gap) + lever @ (IDENTITY - of_b))
        rows[:3, 9:] = axes.T @ lever @ of_b
        rows[3:, 3:6], rows[3:, 9:] = -rates, rates
        return np.concatenate([axes.T @ gap, rotation]), rows

    def stiffness_at(self, force: Array, poses: Sequence[Pose], reference: Sequence[Array]) -> Array:
        """Compute `PointMeasure.stiffness_at`, in closed form along axes of a and in the reference's relative pose."""
        (p, a), (q, b) = poses
        gap = q - p - a @ (reference[1] - reference[0])
        size = np.linalg.norm(q - p) + np.linalg.norm(gap)
        same = np.abs(a - b).max() < SAME_POSE and np.abs(gap).max() <= SAME_POSE * size
        if same or self.rotation != VECTOR:
            return self._closed_form(force, a @ self.axes, b @ self.axes, q - p)
        return super().stiffness_at(force, poses, reference)

    def geometric_stiffness(self, force: Array, reference: Sequence[Array]) -> Array:
        """Compute `PointMeasure.geometric_stiffness` in closed form."""
        return self._closed_form(force, self.axes, self.axes, reference[1] - reference[0])

    def _closed_form(self, force: Array, first: Array, second: Array, arm: Array) -> Array:
        """Compute the stiffness of a force (6,), as the axes rotate, and so do rotation components, (12, 12).

        Args:
            force: the force.
            first: the axes in the body of a, as columns, (3, 3).
            second: those in the body of b; the same but along axes of a.
            arm: from a to b, (3,) [m].
        """
        eye, none = np.eye(3), np.zeros((3, 3))
        of_a, of_b = np.hstack([none, eye, none, none]), np.hstack([none, none, none, eye])
        pull, lever = skew(first @ force[:3]), skew(arm)
        gap = np.hstack([-eye, lever, eye, none])
        if self.rotation == MATRIX:
            spin = of_a
            x, y, _ = map(skew, first.T)
            _, v, w = map(skew, second.T)
            pairs = ((-y, w), (x, w), (-x, v))
            by_b = sum(f * one @ other for f, (one, other) in zip(force[3:], pairs, strict=True))
            by_a = sum(f * other @ one for f, (one, other) in zip(force[3:], pairs, strict=True))
            rotation = by_b @ of_b - by_a @ of_a
        elif self.rotation == TILT:
            spin = of_a
            own, other = first @ self.shaft, skew(second @ self.shaft)
            moment = skew(np.cross(own, first @ force[3:]))
            rotation = (other @ moment - skew(first @ self._free @ force[3:])) @ of_a - moment @ other @ of_b
        else:
            spin = 0.5 * (of_a + of_b)
            rotation = -skew(first @ force[3:]) @ spin
        across = spin.T @ pull @ gap
        return across + across.T - of_a.T @ pull @ lever @ of_a + (of_b - of_a).T @ rotation


def inverse_right_jacobian(vector: Array) -> Array:
    """Return J with v' = J omega for a rotation vector v and the angular velocity omega along rotating axes.

    Args:
        vector: the rotation vector v, (3,) [rad].

    Returns:
        J, (3, 3). Source: T. Barfoot, State Estimation for Robotics (2017), equation 7.75 with the sign of the right
            Jacobian.
    """
    square, cross = float(vector @ vector), skew(vector)
    angle = np.sqrt(square)
    third = 1 / 12 + square / 720 if angle < 1e-2 else 1 / square - (1 + np.cos(angle)) / (2 * angle * np.sin(angle))
    return np.eye(3) + cross / 2 + third * cross @ cross
