"""Joints of scenes: which directions of one point's motion against another are free."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from nassim.base.checks import Array, freeze, instances, known, not_negative, unique
from nassim.base.rigid_motion import DIRECTIONS, axes_along, proper_rotation, unit_vector
from nassim.scene.bodies import FlexibleBody, RigidBody
from nassim.scene.measures import MATRIX, Axes, Displacement, Measure, Path, PointVelocity, RelativePose
from nassim.scene.mechanics import checked_axis
from nassim.scene.part import Connection
from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint, Spring

TOUCH_TOLERANCE = 1e-9
"""Largest gap [m] between the two points of a joint."""
ROUNDING = 1e-12
"""What rounding adds to a gap [m] where a scene is placed up to kilometres away; a gap at the tolerance stays one."""
Damping = float | Mapping[str, float] | tuple[float, ...]
PERPENDICULAR = 1e-9


@dataclass(frozen=True)
class Joint(Connection):
    """Connects two points that coincide at the start.

    a, b: the points, "body.point"
    free: directions in which b may move against a: "x" "y" "z" "rx" "ry" "rz"; none, the default, is a rigid
        connection
    axes: these directions at the start, as columns, world frame, (3, 3); they turn with the body of a from there on: a
        slide on a rail has the rail's point as a
    damping: viscous, of the free directions [N s/m], [N m s/rad]: one figure where one is free, or {direction: figure}.
        Of two free turns the second is about its axis in b, as of a universal joint; it holds in every position

    `fixed`, `revolute`, `prismatic`, `cylindrical`, `universal`, `spherical` and `planar` make the usual ones.
    """

    name: str
    a: Path
    b: Path
    free: tuple[str, ...] = ()
    axes: Axes = field(default_factory=lambda: np.eye(3))
    damping: Damping = 0.0

    def __post_init__(self) -> None:
        free = instances("free", (self.free,) if isinstance(self.free, str) else self.free, (str,))
        for direction in free:
            known("direction", direction, DIRECTIONS)
        freeze(
            self,
            free=unique(f"joint {self.name!r}: free direction", free),
            axes=proper_rotation(f"joint {self.name!r}: axes", self.axes),
        )
        freeze(self, damping=_figures(f"joint {self.name!r}: damping", self.damping, self.free))

    def terms(self, scene: Scene) -> tuple[Constraint | Spring, ...]:
        """Return the constraint of all directions that are not free, and dampers of those that are."""
        if self.a == self.b:
            raise ValueError(f"joint {self.name!r} connects {self.a!r} with itself")
        for path in (self.a, self.b):
            self._check_held(scene, path)
        body = scene.split(self.a)[0]
        if isinstance(body, RigidBody) and scene.split(self.b)[0] is body:
            raise ValueError(f"joint {self.name!r}: {self.a!r} and {self.b!r} belong to one rigid body")
        gap = float(np.linalg.norm(scene.point_position(self.b) - scene.point_position(self.a)))
        if gap > TOUCH_TOLERANCE + ROUNDING:
            raise ValueError(
                f"joint {self.name!r}: {self.a!r} and {self.b!r} are {gap:.3g} m apart; they must coincide to "
                f"{TOUCH_TOLERANCE:g} m: move one of the bodies"
            )
        held = tuple(d for d in DIRECTIONS if d not in self.free)
        return (Constraint(self.name, RelativePose(self.a, self.b, self.axes, MATRIX), held), *self._dampers())

    def describe(self) -> str:
        """Its points and what it leaves free."""
        free = f"free in {', '.join(self.free)}" if self.free else "rigid"
        turned = "" if np.array_equal(self.axes, np.eye(3)) or not self.free else " of its own axes"
        damped = ", ".join(f"{d} {c:g}" for d, c in self._figures.items() if c)
        return f"joint {self.name}: {self.a} to {self.b}, {free}{turned}{damped and '; damping ' + damped}"

    @property
    def _figures(self) -> dict[str, float]:
        return dict(zip(self.free, self.damping, strict=True))  # type: ignore[arg-type]  # set by __post_init__

    def _dampers(self) -> tuple[Spring, ...]:
        turns = [d for d in DIRECTIONS if d in self.free and d.startswith("r")]
        result = []
        for direction, figure in self._figures.items():
            # A universal joint's second arm turns with b.
            frame = self.b if len(turns) == 2 and direction == turns[1] else self.a
            axis = self.axes[:, "xyz".index(direction[-1])]
            measure: Measure = Displacement.between(self.a, self.b, axis, axes_of=frame)
            if direction in turns:
                measure = PointVelocity(((self.a, -axis), (self.b, axis)), frame, angular=True)
            if figure:
                result.append(Spring(measure, 0.0, figure))
        return tuple(result)

    def _check_held(self, scene: Scene, path: str) -> None:
        """A point that only moves along, as trimming leaves some, is no coordinate that a joint could hold."""
        body, point = scene.split(path)
        if not isinstance(body, FlexibleBody) or not body.deforms:
            return
        if point in [passive.name for passive in body.reduced.passive_points]:
            raise ValueError(
                f"joint {self.name!r}: {path!r} is a passive point, which moves along with the body but cannot be "
                "held: use the body before it was trimmed, or name the point in trim_body(points=...)"
            )


def _figures(label: str, damping: Damping, free: tuple[str, ...]) -> tuple[float, ...]:
    """One figure for each free direction, in their order."""
    if isinstance(damping, Mapping):
        for direction in damping:
            known(f"free direction of {label}", direction, free)
        given = [damping.get(direction, 0.0) for direction in free]
    elif isinstance(damping, tuple) and (len(damping) == len(free) or not any(damping)):
        given = list(damping) if any(damping) else [0.0] * len(free)
    elif not isinstance(damping, (int, float, np.number)) or (damping and len(free) != 1):
        raise ValueError(
            f"{label} must be one figure where one direction is free, or {{direction: figure}}; free are "
            f"{', '.join(free) or 'none'}, got {damping!r}"
        )
    else:
        given = [float(damping)] * len(free)
    return tuple(
        not_negative(f"{label} of {d}", value, "N m s/rad" if d.startswith("r") else "N s/m")
        for d, value in zip(free, given, strict=True)
    )


def _along(name: str, axis: str | ArrayLike) -> Array:
    return axes_along(checked_axis(f"joint {name!r}", axis))


def fixed(name: str, a: str, b: str) -> Joint:
    """A rigid connection."""
    return Joint(name, a, b)


def revolute(name: str, a: str, b: str, axis: str | ArrayLike = "z", *, damping: Damping = 0.0) -> Joint:
    """B turns about an axis of a; axis: "x", "y", "z" or a vector, world frame at the start, as of all joints here."""
    return Joint(name, a, b, ("rz",), _along(name, axis), damping)


def prismatic(name: str, a: str, b: str, axis: str | ArrayLike = "z", *, damping: Damping = 0.0) -> Joint:
    """B slides along an axis of a and does not turn."""
    return Joint(name, a, b, ("z",), _along(name, axis), damping)


def cylindrical(name: str, a: str, b: str, axis: str | ArrayLike = "z", *, damping: Damping = 0.0) -> Joint:
    """B slides along an axis of a and turns about it."""
    return Joint(name, a, b, ("z", "rz"), _along(name, axis), damping)


def universal(
    name: str, a: str, b: str, axis_a: str | ArrayLike, axis_b: str | ArrayLike, *, damping: Damping = 0.0
) -> Joint:
    """A cross whose one arm, "rx", turns in a, about axis_a, and whose other, "ry", in b, about axis_b (Hooke, Cardan).

    Raises ValueError for axes that are not perpendicular at the start.
    """
    first, second = (unit_vector(checked_axis(f"joint {name!r}", axis)) for axis in (axis_a, axis_b))
    if abs(first @ second) > PERPENDICULAR:
        raise ValueError(f"joint {name!r}: a universal joint's axes must be perpendicular, got {axis_a!r}, {axis_b!r}")
    return Joint(name, a, b, ("rx", "ry"), np.column_stack([first, second, np.cross(first, second)]), damping)


def spherical(name: str, a: str, b: str, *, damping: Damping = 0.0) -> Joint:
    """B turns freely about a point of a."""
    return Joint(name, a, b, ("rx", "ry", "rz"), damping=damping)


def planar(name: str, a: str, b: str, normal: str | ArrayLike = "z", *, damping: Damping = 0.0) -> Joint:
    """B slides in a plane of a, given by its normal, and turns about it."""
    return Joint(name, a, b, ("x", "y", "rz"), _along(name, normal), damping)
