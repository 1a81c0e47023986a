"""Measures: kinematic quantities between the points of a scene, with value and Jacobian in any configuration.

A measure defines what is measured; a law on it (`nassim.scene.terms`) defines a force, an output or a constraint. An
engine evaluates a measure on the states of the bodies and needs no other knowledge of it.

To add a measure, write a frozen dataclass with the base class `PointMeasure` and its method `at`. It may be in any
module. All engines evaluate it.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array, known
from nassim.base.rigid_motion import DIRECTIONS, quaternion, skew
from nassim.base.short_repr import short_repr


class FieldKind(type):
    """Kind of a field of a part, a body, a term or a measure; `help` prints it as the type that a user gives.

    `placed` renames and rotates fields by their kind. A field may hold one of these, None, or a tuple of them.
    """


if TYPE_CHECKING:
    Path = str
    Signal = str
    Direction = Any
    AngularVelocity = Any
    Axes = Array
    Position = Array
else:

    def _kind(name: str, given: str) -> FieldKind:
        return FieldKind(name, (), {"__module__": "builtins", "__qualname__": given})

    Path = _kind("Path", "str")  # a point, port or body by name
    Signal = _kind("Signal", "str")  # an input or output by name
    Direction = _kind("Direction", "str | numpy.typing.ArrayLike")  # of the world's frame: "x", "y", "z" or a vector
    AngularVelocity = _kind("AngularVelocity", "numpy.typing.ArrayLike")  # in the world's frame
    Axes = _kind("Axes", "numpy.ndarray")  # columns, in the world's frame
    Position = _kind("Position", "numpy.ndarray")  # in the world's frame

Pose = tuple[Array, Array]
"""Position of a point, (3,) [m], and its rotation since the reference configuration, (3, 3); world frame."""
VECTOR, QUATERNION, MATRIX = ROTATIONS = "vector", "quaternion", "matrix"
"""Rotation parts of a relative pose."""
ROTATION_STEP = 5e-4
"""Rotation [rad], and displacement over the distance of points, of difference quotients of fourth order."""
STEP_ROTATIONS = {n: Rotation.from_rotvec(n * ROTATION_STEP * np.eye(3)).as_matrix() for n in (-2, -1, 1, 2)}
"""Rotations by so many steps about the three axes, (3, 3, 3)."""
SAME_POSE = 1e-9
"""Change of a relative pose, over its size, that is rounding."""
SMALL_HALF = 1e-4
"""Half of an angle [rad] below which a series replaces a quotient of differences."""


class BodyState(Protocol):
    """A body in some configuration, as measures see it."""

    @property
    def n_coordinates(self) -> int:
        """Number of the body's coordinates."""

    def reference(self, point: str) -> Array:
        """Return the position of a point in the reference configuration, world frame, (3,) [m]."""

    def pose(self, point: str) -> Pose:
        """Return the pose of a point."""

    def motion(self, point: str) -> Array:
        """Return velocity and angular velocity of a point, world axes, per unit rate of the coordinates, (6, n)."""

    def own(self, weights: Array) -> tuple[Array, Array]:
        """Return weighted sums, (k, n_reduced), of the reduced body's coordinates: value (k,) and rows (k, n)."""


class ReducedMotion(Protocol):
    """The part of a reduced body that gives the motion of its points."""

    def motion(self, name: str) -> Array:
        """Return the motion of a point along the body's axes per unit of its coordinates, (6, n)."""


class DeformableBody(Protocol):
    """A body of a scene that has a reduced body."""

    @property
    def name(self) -> str:
        """Name of the body in the scene."""

    @property
    def reduced(self) -> ReducedMotion:
        """The reduced body."""


States = Mapping[str, BodyState]
"""States of bodies, by name."""
Evaluation = tuple[Array, dict[str, Array]]
"""Value (k,) of a measure, and its Jacobian as rows (k, n) on the coordinates of each body, by name."""


@dataclass(frozen=True)
class Measure(ABC):
    """A kinematic quantity of k components, zero in the reference configuration."""

    axes_of = ""
    """Point whose axes carry the directions of the measure; "" for the world's axes."""
    angular = False
    """Whether the measure is of angular velocities."""

    def __init_subclass__(cls) -> None:
        if "__repr__" not in vars(cls):
            cls.__repr__ = short_repr  # type: ignore[method-assign]  # which `dataclass` then keeps

    @property
    def components(self) -> tuple[str, ...]:
        """Names of its k components."""
        return ("value",)

    @property
    @abstractmethod
    def points(self) -> tuple[str, ...]:
        """Points that the measure depends on, as "body.point"."""

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies that the measure depends on."""
        return tuple(dict.fromkeys(body_of(path) for path in self.points))

    @property
    def within(self) -> str | None:
        """Name of the one body on whose own coordinates alone the measure depends; None where there is no such body."""
        return None

    @property
    def has_value(self) -> bool:
        """Whether the measure has a value; a quasi-velocity has rates only."""
        return True

    @property
    def period(self) -> float | None:
        """Increase of the value by a full rotation, by which engines unwrap it; None where it does not wrap."""
        return None

    @property
    def deviation(self) -> "Measure":
        """Measure of small deviations from a steady relative rotation of the bodies."""
        return self

    def rotation_axis(self, component: str) -> Array | None:
        """Return the axis (3,) of a component that is a rotation of the second point against the first, else None."""
        return None

    @property
    def point_measures(self) -> "tuple[tuple[float, PointMeasure], ...]":
        """Factors and point measures whose sum is the part of the measure that is not linear in the coordinates."""
        return ()

    @abstractmethod
    def evaluate(self, states: States) -> Evaluation:
        """Evaluate value and Jacobian in a configuration; the value of a quasi-velocity is zero."""


@dataclass(frozen=True)
class PointMeasure(Measure):
    """A measure of the poses of points."""

    @property
    def point_measures(self) -> "tuple[tuple[float, PointMeasure], ...]":
        """The measure itself, with the factor 1."""
        return ((1.0, self),)

    @abstractmethod
    def at(self, poses: Sequence[Pose], reference: Sequence[Array]) -> tuple[Array, Array]:
        """Evaluate the measure.

        Args:
            poses: of `points`, in their order.
            reference: positions of the points in the reference configuration, (3,) each [m].

        Returns:
            Value (k,), and rows (k, 6 points) on the velocities and angular velocities of the points, world axes.
        """

    def geometric_stiffness(self, force: Array, reference: Sequence[Array]) -> Array:
        """Compute `stiffness_at` in the reference configuration; a frequent measure has a closed form.

        Args:
            force: the force, (k,).
            reference: positions of the points in the reference configuration, (3,) each [m].

        Returns:
            The derivative, (6 points, 6 points).
        """
        return self.stiffness_at(force, [(place, np.eye(3)) for place in reference], reference)

    def stiffness_at(self, force: Array, poses: Sequence[Pose], reference: Sequence[Array]) -> Array:
        """Compute how forces and moments of a constant force in the measure change, by difference quotients.

        Args:
            force: the force, (k,).
            poses: of `points`, in their order.
            reference: positions of the points in the reference configuration, (3,) each [m].

        Returns:
            Derivative of rows^T force with respect to displacements and rotations of the points, world axes, (6 points,
            6 points).
        """
        size = max(float(np.ptp([place for place, _ in poses], axis=0).max()), 1e-3)

        def forces(point: int, axis: int, steps: int) -> Array:
            now, (place, turn) = list(poses), poses[point]
            shift = steps * ROTATION_STEP * size * np.eye(3)[axis % 3]
            now[point] = (place + shift, turn) if axis < 3 else (place, STEP_ROTATIONS[steps][axis - 3] @ turn)
            return force @ self.at(now, reference)[1]

        slopes = []
        for point, axis in np.ndindex(len(poses), 6):
            near, far = (forces(point, axis, m) - forces(point, axis, -m) for m in (1, 2))
            slopes.append((8 * near - far) / (12 * ROTATION_STEP * (size if axis < 3 else 1.0)))
        return np.array(slopes).T

    def evaluate(self, states: States) -> Evaluation:
        """Evaluate value and Jacobian in a configuration."""
        named = [(states[body_of(path)], point_of(path)) for path in self.points]
        value, rows = self.at([s.pose(point) for s, point in named], [s.reference(point) for s, point in named])
        result = {name: np.zeros((len(rows), states[name].n_coordinates)) for name in self.bodies}
        for k, (path, (state, point)) in enumerate(zip(self.points, named, strict=True)):
            if state.n_coordinates:
                result[body_of(path)] += rows[:, 6 * k : 6 * k + 6] @ state.motion(point)
        return value, result


@dataclass(frozen=True)
class Displacement(PointMeasure):
    """Weighted sum of the displacements of points along directions.

    Attributes:
        weights: points and their directions, (3,) each, in the world's axes of the reference configuration.
        axes_of: a point whose axes carry the directions, "body.point"; "" for the world's axes, which do not rotate.
            With such a point, a common rotation of all bodies gives no displacement.
    """

    weights: tuple[tuple[Path, Direction], ...]
    axes_of: Path = ""

    @classmethod
    def between(cls, a: str, b: str, direction: Array, *, axes_of: str = "") -> "Displacement":
        """Make the displacement of point b against point a along a direction, (3,)."""
        return cls(((a, -np.asarray(direction)), (b, np.asarray(direction))), axes_of)

    @property
    def points(self) -> tuple[str, ...]:
        """The weighted points, then the point of the axes."""
        return _with_axes(self.weights, self.axes_of)

    def at(self, poses: Sequence[Pose], reference: Sequence[Array]) -> tuple[Array, Array]:
        """Evaluate the measure, see `PointMeasure.at`."""
        axes, rows, value = poses[-1][1] if self.axes_of else np.eye(3), np.zeros((1, 6 * len(poses))), 0.0
        for k, (_, weights) in enumerate(self.weights):
            along = axes @ weights
            value += along @ poses[k][0] - np.dot(weights, reference[k])
            rows[0, 6 * k : 6 * k + 3] += along
            if self.axes_of:
                rows[0, -3:] += skew(along) @ poses[k][0]
        return np.array([value]), rows

    def stiffness_at(self, force: Array, poses: Sequence[Pose], reference: Sequence[Array]) -> Array:
        """Compute `PointMeasure.stiffness_at` in closed form: the directions rotate with their axes."""
        result = np.zeros((6 * len(poses),) * 2)
        if self.axes_of:
            for k, (_, weights) in enumerate(self.weights):
                along = skew(force[0] * poses[-1][1] @ weights)
                result[6 * k : 6 * k + 3, -3:] -= along
                result[-3:, 6 * k : 6 * k + 3] += along
                result[-3:, -3:] += skew(poses[k][0]) @ along
        return result


@dataclass(frozen=True)
class PointVelocity(PointMeasure):
    """Weighted sum of velocities, or angular velocities, of points along directions: a quasi-velocity.

    In large motion it has no value. In small motion its value is the displacement, or the rotation, of the points.

    Attributes:
        weights: points and their directions, (3,) each, in the world's axes of the reference configuration.
        axes_of: a point whose axes carry the directions, "body.point"; "" for the world's axes.
        angular: whether it measures angular velocities.
    """

    weights: tuple[tuple[Path, Direction], ...]
    axes_of: Path = ""
    angular: bool = False

    @property
    def points(self) -> tuple[str, ...]:
        """The weighted points, then the point of the axes."""
        return _with_axes(self.weights, self.axes_of)

    @property
    def has_value(self) -> bool:
        """False."""
        return False

    def at(self, poses: Sequence[Pose], reference: Sequence[Array]) -> tuple[Array, Array]:
        """Evaluate the measure, see `PointMeasure.at`."""
        axes, rows = poses[-1][1] if self.axes_of else np.eye(3), np.zeros((1, 6 * len(poses)))
        for k, (_, weights) in enumerate(self.weights):
            first = 6 * k + 3 * self.angular
            rows[0, first : first + 3] += axes @ weights
        return np.zeros(1), rows

    def geometric_stiffness(self, force: Array, reference: Sequence[Array]) -> Array:
        """Compute `PointMeasure.geometric_stiffness` in closed form: the directions rotate with their axes."""
        result = np.zeros((6 * len(reference),) * 2)
        if self.axes_of:
            for k, (_, weights) in enumerate(self.weights):
                first = 6 * k + 3 * self.angular
                result[first : first + 3, -3:] -= skew(force[0] * np.asarray(weights))
        return result


@dataclass(frozen=True)
class Distance(PointMeasure):
    """Change of the distance of two points since the reference configuration.

    Attributes:
        a: first point, "body.point".
        b: second point, "body.point".
    """

    a: Path
    b: Path

    @property
    def points(self) -> tuple[str, ...]:
        """The two points."""
        return (self.a, self.b)

    def at(self, poses: Sequence[Pose], reference: Sequence[Array]) -> tuple[Array, Array]:
        """Evaluate the measure, see `PointMeasure.at`.

        Raises:
            ValueError: for points that coincide.
        """
        apart, length = poses[1][0] - poses[0][0], float(np.linalg.norm(poses[1][0] - poses[0][0]))
        if not length:
            raise ValueError(f"{self.a!r} and {self.b!r} lie in one place: no line joins them")
        along, still = apart / length, np.zeros(3)
        value = length - np.linalg.norm(reference[1] - reference[0])
        return np.array([value]), np.concatenate([-along, still, along, still])[None]

    def stiffness_at(self, force: Array, poses: Sequence[Pose], reference: Sequence[Array]) -> Array:
        """Compute `PointMeasure.stiffness_at` in closed form: the line between the points rotates."""
        apart = poses[1][0] - poses[0][0]
        square = float(apart @ apart)
        across = force[0] / np.sqrt(square) * (np.eye(3) - np.outer(apart, apart) / square)
        return np.kron([[1.0, -1.0], [-1.0, 1.0]], np.kron(np.diag([1.0, 0.0]), across))


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

    @property
    def points(self) -> tuple[str, ...]:
        """Point b, then point a."""
        return (self.b, self.a) if self.a else (self.b,)

    @property
    def deviation(self) -> Measure:
        """The component of the relative angular velocity about the axis; its value excludes the steady rotation."""
        against = ((self.a, -np.asarray(self.axis)),) if self.a else ()
        return PointVelocity(((self.b, np.asarray(self.axis)), *against), self.a, angular=True)

    @property
    def period(self) -> float | None:
        """A full turn."""
        return float(2 * np.pi * np.linalg.norm(self.axis))

    def at(self, poses: Sequence[Pose], reference: Sequence[Array]) -> tuple[Array, Array]:
        """Evaluate the measure, see `PointMeasure.at`."""
        a = poses[1][1] if self.a else np.eye(3)
        size = float(np.linalg.norm(self.axis))
        n = np.asarray(self.axis) / size
        c, v = quaternion(a.T @ poses[0][1])
        s = n @ v
        row = size * (a @ (c * (c * n + np.cross(v, n)) + s * v)) / (c * c + s * s)
        rows = np.zeros((1, 6 * len(poses)))
        rows[0, 3:6] = row
        if self.a:
            rows[0, 9:12] = -row
        return np.array([2 * size * np.arctan2(s, c)]), rows

    def geometric_stiffness(self, force: Array, reference: Sequence[Array]) -> Array:
        """Compute `PointMeasure.geometric_stiffness` in closed form: the moment rotates with an axis halfway."""
        signs = np.array([1.0, -1.0])[: len(reference)]
        rotation = np.kron(np.outer(signs, np.ones(len(signs))), np.diag([0.0, 1.0]))
        return np.kron(rotation, -0.5 * skew(force[0] * np.asarray(self.axis)))


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
        axis = np.asarray(self.axis) / np.linalg.norm(self.axis)
        joint = Rotation.from_matrix(np.swapaxes(c, -1, -2) @ d).as_quat()
        angle = 2 * np.arctan2(joint[..., :3] @ axis, joint[..., 3])
        ideal = Rotation.from_rotvec(angle[..., None] * axis).as_matrix()
        whole, back = np.swapaxes(a, -1, -2) @ b, np.swapaxes(ideal, -1, -2)
        return Rotation.from_matrix(back @ whole if self.turning else whole @ back).as_rotvec(), ideal

    def at(self, poses: Sequence[Pose], reference: Sequence[Array]) -> tuple[Array, Array]:
        """Evaluate the measure, see `PointMeasure.at`."""
        deviation, ideal = self.vectors(*(rotation for _, rotation in poses))
        axis, direction = np.asarray(self.axis) / np.linalg.norm(self.axis), np.asarray(self.direction)
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
            for bushings and rotations below half a turn. "quaternion": twice the vector part of the relative
            quaternion, along the same axes: the tilt of a bearing at any angle of its shaft, where a rotation vector
            grows with that angle. "matrix": entries -y.z', x.z', -x.y' of the relative rotation matrix, along axes
            fixed in a, for joints.
    """

    a: Path
    b: Path
    axes: Axes = field(default_factory=lambda: np.eye(3))
    rotation: str = VECTOR

    def __post_init__(self) -> None:
        known("rotation of a relative pose", self.rotation, ROTATIONS)

    @property
    def points(self) -> tuple[str, ...]:
        """The two points."""
        return (self.a, self.b)

    @property
    def components(self) -> tuple[str, ...]:
        """The six directions."""
        return tuple(DIRECTIONS)

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
        else:
            c, v = quaternion(first.T @ second)
            cross, tilt = skew(v), np.outer(v, v) / (1 + c)
            axes = first @ (np.eye(3) + cross + (cross @ cross) / (1 + c))
            if self.rotation == QUATERNION:
                rotation, rates = 2 * v, (np.eye(3) - tilt) @ axes.T
            else:
                sine = math.sqrt(v @ v)
                half = math.atan2(sine, c)  # of the angle
                size = half / sine if sine else 1.0
                along = (1 - size) / (sine * sine) if half > SMALL_HALF else -1 / 6
                rotation, rates = 2 * size * v, (size * np.eye(3) + along * np.outer(v, v)) @ axes.T
            of_b = (np.eye(3) - axes @ (cross / (1 + c)) @ axes.T) / 2  # share of b's rate in that of the axes halfway
        rows = np.zeros((6, 12))
        rows[:3, :3], rows[:3, 6:9] = -axes.T, axes.T
        lever = skew(gap)
        rows[:3, 3:6] = axes.T @ (skew(q - p - gap) + lever @ (np.eye(3) - of_b))
        rows[:3, 9:] = axes.T @ lever @ of_b
        rows[3:, 3:6], rows[3:, 9:] = -rates, rates
        return np.concatenate([axes.T @ gap, rotation]), rows

    def stiffness_at(self, force: Array, poses: Sequence[Pose], reference: Sequence[Array]) -> Array:
        """Compute `PointMeasure.stiffness_at`, in closed form where the relative pose is that of the reference."""
        (p, a), (q, b) = poses
        gap = q - p - a @ (reference[1] - reference[0])
        size = np.linalg.norm(q - p) + np.linalg.norm(gap)
        if np.abs(a - b).max() < SAME_POSE and np.abs(gap).max() <= SAME_POSE * size:
            return replace(self, axes=a @ self.axes).geometric_stiffness(force, [p, q])
        return super().stiffness_at(force, poses, reference)

    def geometric_stiffness(self, force: Array, reference: Sequence[Array]) -> Array:
        """Compute `PointMeasure.geometric_stiffness` in closed form: the axes rotate, and so do rotation components."""
        eye, none = np.eye(3), np.zeros((3, 3))
        of_a, of_b = np.hstack([none, eye, none, none]), np.hstack([none, none, none, eye])
        pull, arm = skew(self.axes @ force[:3]), skew(reference[1] - reference[0])
        gap = np.hstack([-eye, arm, eye, none])
        if self.rotation == MATRIX:
            spin = of_a
            x, y, z = map(skew, self.axes.T)
            first, second = (
                sum(f * u @ v for f, (u, v) in zip(force[3:], pairs, strict=True))
                for pairs in (((-z, y), (z, x), (-y, x)), ((-y, z), (x, z), (-x, y)))
            )
            rotation = second @ of_b - first @ of_a
        else:
            spin = 0.5 * (of_a + of_b)
            rotation = -skew(self.axes @ force[3:]) @ spin
        across = spin.T @ pull @ gap
        return across + across.T - of_a.T @ pull @ arm @ of_a + (of_b - of_a).T @ rotation


@dataclass(frozen=True)
class BodyCoordinates(Measure):
    """Weighted sum of one body's own coordinates, independent of its rigid motion: ports, stacks, strain.

    Attributes:
        body: name of the body.
        weights: weights on the coordinates of `FlexibleBody.reduced`, (n,).
        ends: points between which the quantity lies, for reports and pictures; nothing is evaluated at them.
        of_strain: whether it is a stress or strain of the material, which a motion of second order, such as the
            shortening of a bent strip, does not cause.
        constant: value where the coordinates vanish.
    """

    body: Path
    weights: Array
    ends: tuple[Path, ...] = ()
    of_strain: bool = False
    constant: float = 0.0

    @classmethod
    def between(cls, body: "DeformableBody", a: str, b: str, direction: Array) -> "BodyCoordinates":
        """Make the displacement of point b of a reduced body against point a along an axis (3,) of the body.

        A rigid motion of the body contributes to first order only, and nothing along the line through the points.
        """
        apart = body.reduced.motion(b)[:3] - body.reduced.motion(a)[:3]
        return cls(body.name, np.asarray(direction) @ apart, (f"{body.name}.{a}", f"{body.name}.{b}"))

    @property
    def points(self) -> tuple[str, ...]:
        """Points between which the quantity lies."""
        return self.ends

    @property
    def bodies(self) -> tuple[str, ...]:
        """The body."""
        return (self.body,)

    @property
    def within(self) -> str | None:
        """The body."""
        return self.body

    def evaluate(self, states: States) -> Evaluation:
        """Evaluate value and Jacobian in a configuration."""
        value, rows = states[self.body].own(np.atleast_2d(self.weights))
        return value + self.constant, {self.body: rows}


@dataclass(frozen=True)
class Combination(Measure):
    """Weighted sum of scalar measures, as of a screw, a gear or a lever.

    Attributes:
        parts: factors and measures.
    """

    parts: tuple[tuple[float, Measure], ...]

    @property
    def points(self) -> tuple[str, ...]:
        """Points of the parts."""
        return tuple(dict.fromkeys(path for _, part in self.parts for path in part.points))

    @property
    def bodies(self) -> tuple[str, ...]:
        """Bodies of the parts."""
        return tuple(dict.fromkeys(name for _, part in self.parts for name in part.bodies))

    @property
    def within(self) -> str | None:
        """The body that is `within` of all parts; else None."""
        names = {part.within for _, part in self.parts}
        return names.pop() if len(names) == 1 else None

    @property
    def point_measures(self) -> tuple[tuple[float, PointMeasure], ...]:
        """Factors and point measures of the parts."""
        return tuple((f * g, of) for f, part in self.parts for g, of in part.point_measures)

    @property
    def has_value(self) -> bool:
        """Whether all parts have a value."""
        return all(part.has_value for _, part in self.parts)

    @property
    def period(self) -> float | None:
        """Period of the only part that has one.

        Raises:
            ValueError: for several parts with a period, whose turns cannot be told apart.
        """
        periods = [abs(factor) * part.period for factor, part in self.parts if part.period]
        if len(periods) > 1:
            raise ValueError("a combination of several angles cannot be unwrapped beyond half a turn: combine one")
        return periods[0] if periods else None

    def evaluate(self, states: States) -> Evaluation:
        """Evaluate value and Jacobian in a configuration."""
        value, rows = np.zeros(1), {name: np.zeros((1, states[name].n_coordinates)) for name in self.bodies}
        for factor, part in self.parts:
            more, of_bodies = part.evaluate(states)
            value = value + factor * more
            for name, row in of_bodies.items():
                rows[name] = rows[name] + factor * row
        return value, rows


def body_of(path: str) -> str:
    """Return the name of the body of a point "body.point"."""
    return path.partition(".")[0]


def point_of(path: str) -> str:
    """Return the name of the point in its body of a point "body.point"."""
    return path.partition(".")[2]


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


def _with_axes(weights: tuple[tuple[str, Any], ...], axes_of: str) -> tuple[str, ...]:
    """Return the points of weights, then the point of the axes."""
    return (*(path for path, _ in weights), *((axes_of,) if axes_of else ()))
