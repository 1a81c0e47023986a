"""Measures: kinematic quantities between the points of a scene, with value and Jacobian in any configuration.

A measure defines what is measured; a law on it (`nassim.scene.terms`) defines a force, an output or a constraint. An
engine evaluates a measure on the states of the bodies and needs no other knowledge of it.

To add a measure, write a frozen dataclass with the base class `PointMeasure` and its method `at`. It may be in any
module. All engines evaluate it. `nassim.scene.rotation_measures` has the measures of rotation.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array, finite_array, freeze
from nassim.base.rigid_motion import IDENTITY, skew
from nassim.base.short_repr import ShortRepr
from nassim.scene.field_kinds import Direction, Path, body_of, point_of

Pose = tuple[Array, Array]
"""Position of a point, (3,) [m], and its rotation since the reference configuration, (3, 3); world frame."""
ROTATION_STEP = 5e-4
"""Rotation [rad], and displacement over the distance of points, of difference quotients of fourth order."""
STEP_ROTATIONS = {n: Rotation.from_rotvec(n * ROTATION_STEP * np.eye(3)).as_matrix() for n in (-2, -1, 1, 2)}
"""Rotations by so many steps about the three axes, (3, 3, 3)."""


class BodyState(Protocol):
    """A body in some configuration, as measures see it."""

    @property
    def n_coordinates(self) -> int:
        """Number of the body's coordinates."""
        ...

    def reference(self, point: str) -> Array:
        """Return the position of a point in the reference configuration, world frame, (3,) [m]."""
        ...

    def pose(self, point: str) -> Pose:
        """Return the pose of a point."""
        ...

    def motion(self, point: str) -> Array:
        """Return velocity and angular velocity of a point, world axes, per unit rate of the coordinates, (6, n)."""
        ...

    def own(self, weights: Array) -> tuple[Array, Array]:
        """Return weighted sums, (k, n_reduced), of the reduced body's coordinates: value (k,) and rows (k, n)."""
        ...


class ReducedMotion(Protocol):
    """The part of a reduced body that gives the motion of its points."""

    def motion(self, name: str) -> Array:
        """Return the motion of a point along the body's axes per unit of its coordinates, (6, n)."""
        ...


class DeformableBody(Protocol):
    """A body of a scene that has a reduced body."""

    @property
    def name(self) -> str:
        """Name of the body in the scene."""
        ...

    @property
    def reduced(self) -> ReducedMotion:
        """The reduced body."""
        ...


States = Mapping[str, BodyState]
"""States of bodies, by name."""
Evaluation = tuple[Array, dict[str, Array]]
"""Value (k,) of a measure, and its Jacobian as rows (k, n) on the coordinates of each body, by name."""


@dataclass(frozen=True)
class Measure(ShortRepr, ABC):
    """A kinematic quantity of k components, zero in the reference configuration."""

    axes_of = ""
    """Point whose axes carry the directions of the measure; "" for the world's axes."""
    angular = False
    """Whether the measure is of angular velocities."""

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
    def constant(self) -> float:
        """Value where the bodies' own coordinates vanish, as of a strain under loads."""
        return 0.0

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

    def has_energy(self, force: Array) -> bool:
        """Return whether a constant force (k,) in the measure has an energy; one in a quasi-velocity has none."""
        return self.has_value

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
            shift = steps * ROTATION_STEP * size * IDENTITY[axis % 3]
            now[point] = (place + shift, turn) if axis < 3 else (place, STEP_ROTATIONS[steps][axis - 3] @ turn)
            return force @ self.at(now, reference)[1]

        slopes = []
        for point, axis in np.ndindex(len(poses), 6):
            near, far = (forces(point, axis, m) - forces(point, axis, -m) for m in (1, 2))
            slopes.append((8 * near - far) / (12 * ROTATION_STEP * (size if axis < 3 else 1.0)))
        return np.array(slopes).T

    def evaluate(self, states: States) -> Evaluation:
        """Evaluate value and Jacobian in a configuration."""
        value, rows = self.at_states(states)
        result = {body: np.zeros((len(rows), states[body].n_coordinates)) for body, _ in self._places}
        for k, (body, point) in enumerate(self._places):
            state = states[body]
            if state.n_coordinates:
                result[body] += rows[:, 6 * k : 6 * k + 6] @ state.motion(point)
        return value, result

    def at_states(self, states: States) -> tuple[Array, Array]:
        """Evaluate `at` in a configuration."""
        return self.at(*self.poses(states))

    def poses(self, states: States) -> tuple[list[Pose], list[Array]]:
        """Return the poses of the points in a configuration, and their positions in the reference configuration."""
        named = [(states[body], point) for body, point in self._places]
        return [state.pose(point) for state, point in named], [state.reference(point) for state, point in named]

    @cached_property
    def _places(self) -> tuple[tuple[str, str], ...]:
        """Bodies and names of the points."""
        return tuple((body_of(path), point_of(path)) for path in self.points)


@dataclass(frozen=True)
class DirectionalMeasure(PointMeasure):
    """Weighted sum of motions of points along directions.

    Attributes:
        weights: points and their directions, (3,) each, in the world's axes of the reference configuration.
        axes_of: a point whose axes carry the directions, "body.point"; "" for the world's axes, which do not rotate.
    """

    weights: tuple[tuple[Path, Direction], ...]
    axes_of: Path = ""

    def __post_init__(self) -> None:
        weights = ((path, finite_array(f"direction at {path!r}", along, (3,))) for path, along in self.weights)
        freeze(self, weights=tuple(weights))

    @property
    def points(self) -> tuple[str, ...]:
        """The weighted points, then the point of the axes."""
        return (*(path for path, _ in self.weights), *((self.axes_of,) if self.axes_of else ()))


@dataclass(frozen=True)
class Displacement(DirectionalMeasure):
    """Weighted sum of the displacements of points along directions; attributes are those of `DirectionalMeasure`.

    With a point in `axes_of`, a common rotation of all bodies gives no displacement.
    """

    @classmethod
    def between(cls, a: str, b: str, direction: Array, *, axes_of: str = "") -> "Displacement":
        """Make the displacement of point b against point a along a direction, (3,)."""
        return cls(((a, -np.asarray(direction)), (b, np.asarray(direction))), axes_of)

    def at(self, poses: Sequence[Pose], reference: Sequence[Array]) -> tuple[Array, Array]:
        """Evaluate the measure, see `PointMeasure.at`."""
        axes, rows, value = poses[-1][1] if self.axes_of else IDENTITY, np.zeros((1, 6 * len(poses))), 0.0
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
class PointVelocity(DirectionalMeasure):
    """Weighted sum of velocities, or angular velocities, of points along directions: a quasi-velocity.

    In large motion it has no value. In small motion its value is the displacement, or the rotation, of the points.

    Attributes:
        angular: whether it measures angular velocities; `weights` and `axes_of` are those of `DirectionalMeasure`.
    """

    angular: bool = False

    @property
    def has_value(self) -> bool:
        """False."""
        return False

    def at(self, poses: Sequence[Pose], reference: Sequence[Array]) -> tuple[Array, Array]:
        """Evaluate the measure, see `PointMeasure.at`."""
        axes, rows = poses[-1][1] if self.axes_of else IDENTITY, np.zeros((1, 6 * len(poses)))
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
                result[first : first + 3, -3:] -= skew(force[0] * weights)
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
        apart = poses[1][0] - poses[0][0]
        length = float(np.linalg.norm(apart))
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

    def __post_init__(self) -> None:
        freeze(self, weights=finite_array("weights of coordinates", self.weights, (None,)), ends=tuple(self.ends))

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
    def deviation(self) -> Measure:
        """The combination of the deviations of the parts."""
        return replace(self, parts=tuple((factor, part.deviation) for factor, part in self.parts))

    @property
    def has_value(self) -> bool:
        """Whether all parts have a value."""
        return all(part.has_value for _, part in self.parts)

    @property
    def constant(self) -> float:
        """Weighted sum of the constants of the parts."""
        return sum(factor * part.constant for factor, part in self.parts)

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
