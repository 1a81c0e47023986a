"""Springs of scenes: spring-dampers and bushings."""

from dataclasses import dataclass, field

import numpy as np

from nassim.base.checks import Array, finite, finite_array, freeze, not_negative
from nassim.base.field_types import ArrayField, ArrayLike, Field, data_class, held
from nassim.base.rigid_motion import proper_rotation
from nassim.scene.axes_and_points import axis_text, between, check_apart, check_two_points, checked_axis
from nassim.scene.field_kinds import Axes, Direction, Path
from nassim.scene.measures import Measure
from nassim.scene.part import ForceElement
from nassim.scene.rotation_measures import TILT, VECTOR, RelativePose
from nassim.scene.scene import Scene
from nassim.scene.terms import ForceLaw, NonlinearSpring, Spring

SYMMETRIC = 1e-9
"""Relative asymmetry, and relative negative eigenvalue, that rounding may leave in a matrix."""


@dataclass(frozen=True)
class SpringDamper(ForceElement):
    """A spring and a viscous damper in parallel between two points.

    Attributes:
        name: name of the spring-damper.
        a: first point, "body.point".
        b: second point, "body.point".
        axis: a direction or "line".
        stiffness: stiffness [N/m].
        damping: damping [N s/m].
        frame: "" for the world's axes, or a point whose axes count, usually a or b. The axis then turns with the body
            of that point, which bears the moment of the two forces where a and b lie apart across the axis.
        preload: force in the reference configuration, positive where it pulls b back along the axis, as tension along
            the "line" does [N]. Springs with a preload are laws of their own in time: general items of Exudyn, which
            are slower, and refused by exact steps.
    """

    name: str
    a: Path
    b: Path
    axis: Direction = "z"
    stiffness: float = 0.0
    damping: float = 0.0
    frame: Path = ""
    preload: float = 0.0

    def __post_init__(self) -> None:
        label = f"spring-damper {self.name!r}"
        check_two_points(label, self.a, self.b)
        freeze(
            self,
            axis=checked_axis(label, self.axis, line=True),
            stiffness=not_negative(f"{label}: stiffness", self.stiffness, "N/m"),
            damping=not_negative(f"{label}: damping", self.damping, "N s/m"),
            preload=finite(f"{label}: preload", self.preload),
        )
        if not self.stiffness and not self.damping:
            raise ValueError(f"{label} has neither stiffness nor damping")

    def terms(self, scene: Scene) -> tuple[ForceLaw]:
        """Return a spring on the motion of b against a."""
        check_apart(scene, f"spring {self.name!r}", self.a, self.b)
        return (_spring(between(scene, self.a, self.b, self.axis, self.frame), self),)

    def describe(self) -> str:
        """Describe the points, the axis, the stiffness, the damping and the preload."""
        figures = f"{self.stiffness:g} N/m, {self.damping:g} N s/m"
        if self.preload:
            figures += f", preload {self.preload:g} N"
        return f"spring {self.name}: {self.a} to {self.b} along {axis_text(self.axis, self.frame)}, {figures}"


@data_class
class Bushing(ForceElement):
    """A spring and a viscous damper in all six directions between two points.

    Relative rotations of a and b are small; common rotations may have any size. In large motion, displacements under
    given forces differ from those of this law by up to about half of the square of the relative rotation [rad], as
    Exudyn's connector turns its axes. A bushing without stiffness of the rotation about one axis or about all axes is a
    bearing: b may turn in it by any angle, braked by its damping, and the axes of the bearing are those of a, its
    housing. In large motion a bearing is a general item of Exudyn, which takes a millisecond a step; its damping in
    linear models of rotors must be in dampers with a `frame`.

    Attributes:
        name: name of the bushing.
        a: first point, "body.point". Where the points are apart, the body of a is extended rigidly to the place of b.
        b: second point, "body.point".
        stiffness: forces [N] and moments [N m] on b per displacement [m] and rotation [rad] of b against a, in the
            order ux uy uz rx ry rz, (6, 6), symmetric; or the six values of a diagonal.
        damping: the same per velocity [m/s] and angular velocity [rad/s], (6, 6) or (6,).
        axes: axes of the six components at the start, as columns, world frame, (3, 3). They rotate with the mean
            rotation of a and b, those of a bearing with a.
        preload: forces [N] and moments [N m] in the reference configuration with which b pulls back along these axes,
            (6,), see `SpringDamper`.
    """

    name: str
    a: Path
    b: Path
    stiffness: ArrayField
    damping: ArrayField = field(default_factory=held(lambda: np.zeros(6)))
    axes: Field[ArrayLike, Axes] = field(default_factory=held(lambda: np.eye(3)))
    preload: ArrayField = field(default_factory=held(lambda: np.zeros(6)))

    def __post_init__(self) -> None:
        label = f"bushing {self.name!r}"
        check_two_points(label, self.a, self.b)
        freeze(
            self,
            stiffness=_six(f"{label}: stiffness", self.stiffness),
            damping=_six(f"{label}: damping", self.damping),
            axes=proper_rotation(f"{label}: axes", self.axes),
            preload=finite_array(f"{label}: preload", self.preload, (6,)),
        )

    def terms(self, scene: Scene) -> tuple[ForceLaw]:
        """Return a spring on the relative pose of a and b."""
        check_apart(scene, f"bushing {self.name!r}", self.a, self.b)
        shaft = self._shaft
        kind = (VECTOR,) if shaft is None else (TILT, shaft)
        return (_spring(RelativePose(self.a, self.b, self.axes, *kind), self),)

    @property
    def _shaft(self) -> Array | None:
        """Axis (3,) of a bearing, about which rotation has no stiffness while tilt has; zero where none has."""
        rank = int(np.linalg.matrix_rank(self.stiffness[3:]))
        if rank == 2:
            shaft: Array = np.linalg.svd(self.stiffness[3:])[0][:, 2]
            return shaft
        return None if rank else np.zeros(3)

    def describe(self) -> str:
        """Describe the points and the diagonals of stiffness and damping."""
        figures, damping = (" ".join(f"{k:.6g}" for k in np.diag(m)) for m in (self.stiffness, self.damping))
        damped = f"; damping {damping} N s/m and N m s/rad" if np.any(self.damping) else ""
        return f"bushing {self.name}: {self.a} to {self.b}, diagonal {figures} N/m and N m/rad{damped}"


def _spring(measure: Measure, part: SpringDamper | Bushing) -> ForceLaw:
    """Return the law of a spring and a damper on a measure; with a preload it does not vanish at zero."""
    if not np.any(part.preload):
        return Spring(measure, part.stiffness, part.damping)
    stiffness, damping = np.atleast_2d(part.stiffness), np.atleast_2d(part.damping)

    def force(value: Array, rate: Array) -> Array:
        return part.preload + stiffness @ value + damping @ rate

    return NonlinearSpring(measure, force=force, tangent=lambda _value, _rate: (stiffness, damping))


def _six(label: str, value: ArrayLike) -> Array:
    """Return a checked matrix (6, 6) from a matrix or a diagonal."""
    matrix = finite_array(label, np.diag(value) if np.ndim(value) == 1 else value, (6, 6))
    size = np.abs(np.diag(matrix))
    scale = 1 / np.sqrt(np.where(size > 0, size, 1.0))
    scaled = scale[:, None] * matrix * scale
    if np.abs(scaled - scaled.T).max() > SYMMETRIC or np.linalg.eigvalsh(scaled)[0] < -SYMMETRIC:
        raise ValueError(f"{label} must be symmetric and not negative in any direction")
    return matrix
