"""Bodies of a scene: rigid bodies, and reduced bodies with the fidelity of their model."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import field, replace
from functools import cached_property

import numpy as np

from nassim.base.checks import Array, finite_array, freeze, known, positive, unique
from nassim.base.field_types import ArrayLike, ClassArray, Field, OptionalArray, data_class, held
from nassim.base.modal import damping_ratios
from nassim.base.rigid_motion import proper_rotation, rigid_transfer, rotated_motion
from nassim.base.short_repr import short_repr
from nassim.bodies.reduced_body import ReducedBody
from nassim.bodies.strain import Strain
from nassim.scene.field_kinds import AngularVelocity, Axes, Position

FIDELITIES = ("rigid", "linear", "ffrf")
INERTIA_TOLERANCE = 2e-3
"""Relative excess of the largest principal moment that rounded inertias of a flat body may have."""


class Body(ABC):
    """A body of a scene: a set of linear equations about the reference configuration, with points.

    To add a formulation, write a frozen dataclass with this base class, in any module. Its coordinates are those of
    `mass_matrix`; all engines then assemble it. In large motion its points too move by `motion` and its coordinates.

    Attributes:
        name: name of the body in the scene.
        position: position of the body's own frame in the reference configuration, (3,) [m].
        rotation: rotation of the body's own frame in the reference configuration, (3, 3).
        angular_velocity: angular velocity at the start, world frame, (3,) [rad/s].
        damping_ratio: damping ratio of the body's own modes [-], see `FlexibleBody`.
    """

    name: str
    position: Array = held(ClassArray(np.zeros(3)))
    rotation: Array = held(ClassArray(np.eye(3)))
    angular_velocity: Array = held(ClassArray(np.zeros(3)))
    damping_ratio: ArrayLike | None = None

    @property
    def moves(self) -> bool:
        """Whether the body has coordinates."""
        return True

    @property
    def deforms(self) -> bool:
        """Whether the body is a reduced body that deforms."""
        return False

    @property
    def is_rigid(self) -> bool:
        """Whether engines treat the body as rigid, with six coordinates."""
        return False

    @property
    @abstractmethod
    def point_names(self) -> tuple[str, ...]:
        """Names of the body's points, passive points included."""

    @property
    @abstractmethod
    def mass_matrix(self) -> Array:
        """Mass matrix of the body's coordinates, (n, n), positive definite."""

    @property
    def strain(self) -> Strain | None:
        """Strains whose energy is that of the body's stiffness; None where the body has no stiffness."""
        return None

    @abstractmethod
    def weight(self, gravity: Array) -> Array:
        """Return the forces of a uniform gravity, world frame, (3,) [m/s2], on the coordinates, (n,)."""

    @abstractmethod
    def motion(self, point: str) -> Array:
        """Return the small motion of a point along the world's axes per unit of the coordinates, (6, n).

        Raises:
            ValueError: for an unknown point.
        """

    @abstractmethod
    def point_position(self, point: str) -> Array:
        """Return the position of a point in the reference configuration, world frame, (3,) [m]."""

    @property
    @abstractmethod
    def rigid_inertia(self) -> tuple[float, Array, Array]:
        """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m2], world frame."""


@data_class
class RigidBody(Body):
    """A rigid body.

    Attributes:
        name: name of the body in the scene.
        points: named points, relative to the centre of mass, along the body's axes, (3,) each [m].
        mass: mass [kg]; None for a fixed body.
        inertia: inertia about the centre of mass, along the body's axes, (3, 3) [kg m2]; None for a fixed body.
        position: position of the centre of mass at the start, world frame, (3,) [m].
        fixed: True for a body that does not move, such as a granite base.
        rotation: rotation from the body's to the world's frame at the start, (3, 3).
        angular_velocity: angular velocity at the start, world frame, (3,) [rad/s], see `FlexibleBody`.
    """

    name: str
    points: Field[Mapping[str, ArrayLike], Mapping[str, Array]]
    mass: float | None = None
    inertia: OptionalArray = held(None)
    position: Field[ArrayLike, Position] = field(default_factory=held(lambda: np.zeros(3)))
    fixed: bool = False
    rotation: Field[ArrayLike, Axes] = field(default_factory=held(lambda: np.eye(3)))
    angular_velocity: AngularVelocity = field(default_factory=lambda: np.zeros(3))
    __repr__ = short_repr

    def __post_init__(self) -> None:
        label = f"rigid body {self.name!r}"
        if not isinstance(self.points, Mapping):
            raise ValueError(f'{label}: points must map names to positions, such as {{"top": (0, 0, 0.1)}}')
        if not isinstance(self.fixed, (bool, np.bool_)):
            raise ValueError(f"{label}: fixed must be True or False, got {self.fixed!r}")
        unique(f"{label}: point", self.points)
        points = {k: finite_array(f"{label}: point {k!r}", v, (3,)) for k, v in self.points.items()}
        freeze(
            self,
            points=points,
            position=finite_array(f"{label}: position", self.position, (3,)),
            rotation=proper_rotation(f"{label}: rotation", self.rotation),
            angular_velocity=finite_array(f"{label}: angular_velocity", self.angular_velocity, (3,)),
        )
        if self.fixed:
            if np.any(self.angular_velocity):
                raise ValueError(f"{label} is fixed, so it cannot spin; leave out its angular_velocity")
            return
        if self.mass is None or self.inertia is None:
            raise ValueError(f"{label} can move, so it needs a mass and an inertia (or fixed=True)")
        mass = positive(f"{label}: mass", self.mass, "kg")
        inertia = finite_array(f"{label}: inertia", self.inertia, (3, 3))
        moments = np.linalg.eigvalsh(inertia)
        if np.abs(inertia - inertia.T).max() > 1e-9 * np.abs(inertia).max() or moments[0] <= 0:
            raise ValueError(f"{label}: inertia must be symmetric and positive definite")
        if moments[2] > (1 + INERTIA_TOLERANCE) * (moments[0] + moments[1]):
            raise ValueError(
                f"{label}: no body has the principal moments {', '.join(f'{m:.4g}' for m in moments)} kg m2: none "
                "can exceed the sum of the other two"
            )
        freeze(self, mass=mass, inertia=inertia)

    @property
    def moves(self) -> bool:
        """Whether the body has coordinates: the motion (6,) of its centre of mass along the world's axes."""
        return not self.fixed

    @property
    def is_rigid(self) -> bool:
        """True."""
        return True

    @property
    def point_names(self) -> tuple[str, ...]:
        """Names of the body's points."""
        return tuple(self.points)

    @cached_property
    def mass_matrix(self) -> Array:
        """Mass matrix of the coordinates, (6, 6), read-only."""
        assert self.mass is not None
        assert self.inertia is not None
        result = self.mass * np.eye(6)
        result[3:, 3:] = self.rotation @ self.inertia @ self.rotation.T
        result.setflags(write=False)
        return result

    def weight(self, gravity: Array) -> Array:
        """Return the forces of a uniform gravity, world frame, (3,) [m/s2], on the coordinates, (6,)."""
        assert self.mass is not None
        return np.concatenate([self.mass * gravity, np.zeros(3)])

    def motion(self, point: str) -> Array:
        """Return the small motion of a point along the world's axes per unit of the coordinates, (6, 6).

        Raises:
            ValueError: for an unknown point; the message lists the known ones.
        """
        return rigid_transfer(self._arm(point))

    def point_position(self, point: str) -> Array:
        """Return the position of a point at the start, world frame, (3,) [m]."""
        return self.position + self._arm(point)

    def _arm(self, point: str) -> Array:
        """Return the vector from the centre of mass to a point at the start, along the world's axes."""
        return self.rotation @ self.points[known(f"point of {self.name!r}:", point, self.points)]

    @property
    def along_world(self) -> "RigidBody":
        """The same body described along the world's axes at the start."""
        points = {name: self._arm(name) for name in self.points}
        inertia = None if self.inertia is None else self.rotation @ self.inertia @ self.rotation.T
        if inertia is not None:
            inertia = 0.5 * (inertia + inertia.T)
        return replace(self, points=points, inertia=inertia, rotation=np.eye(3))

    @property
    def rigid_inertia(self) -> tuple[float, Array, Array]:
        """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m2] at the start, world frame."""
        assert self.mass is not None
        assert self.inertia is not None
        return self.mass, self.position, self.rotation @ self.inertia @ self.rotation.T


@data_class
class FlexibleBody(Body):
    """A reduced body in a scene.

    Attributes:
        name: name of the body in the scene.
        reduced: the reduced body.
        position: position of the body's origin at the start, world frame, (3,) [m].
        rotation: rotation from the body's to the world's frame at the start, (3, 3).
        fidelity: "ffrf": a floating frame for large displacements and rotations. "linear": small motion about the start
            (rotations up to some 0.01 rad), several times as fast. "rigid": no deformation; the body's stacks then have
            no effect and no signal.
        frame: remote point that carries the floating frame (default: the first that a joint holds, else that a spring
            holds, else the first).
        angular_velocity: angular velocity at the start, world frame, (3,) [rad/s]. Bodies joined to this one move with
            it. A simulation refuses to start with a velocity that the joints do not allow. Zero requires nothing.
        damping_ratio: damping ratio of the elastic modes of the body alone [-], one number or one per mode from the
            lowest (the remaining modes then have the last). In these modes the remote point of the frame is clamped
            where a joint holds it, else the body is free; the electrical ports are as the scene wires them. The ratio
            becomes a viscous damping of the body's deformation, the same in every position. Masses on the body lower
            the frequencies and the ratios of its modes; a compression lowers the frequencies and raises the ratios. It
            adds to the damping that `reduced` has (`ReducedBody.damping_matrix`). None: no ratio.
    """

    name: str
    reduced: ReducedBody
    position: Field[ArrayLike, Position] = field(default_factory=held(lambda: np.zeros(3)))
    rotation: Field[ArrayLike, Axes] = field(default_factory=held(lambda: np.eye(3)))
    fidelity: str = "ffrf"
    frame: str | None = None
    angular_velocity: AngularVelocity = field(default_factory=lambda: np.zeros(3))
    damping_ratio: ArrayLike | None = None
    __repr__ = short_repr

    def __post_init__(self) -> None:
        label = f"flexible body {self.name!r}"
        if not isinstance(self.reduced, ReducedBody):
            raise ValueError(f"{label}: reduced must be a ReducedBody, got a {type(self.reduced).__name__}")
        if not self.reduced.remote_points:
            raise ValueError(f"{label} needs at least one remote point, on which its frame rides")
        rotation = proper_rotation(f"{label}: rotation", self.rotation)
        known("fidelity", self.fidelity, FIDELITIES)
        if self.frame is not None:
            known("remote point", self.frame, self.reduced.point_names)
        if self.fidelity == "linear" and np.any(self.angular_velocity):
            raise ValueError(f'{label} spins, so it needs fidelity "ffrf" or "rigid": "linear" is for small rotation')
        if self.damping_ratio is not None:
            freeze(self, damping_ratio=damping_ratios(f"{label}: damping_ratio", self.damping_ratio))
        freeze(
            self,
            position=finite_array(f"{label}: position", self.position, (3,)),
            rotation=rotation,
            angular_velocity=finite_array(f"{label}: angular_velocity", self.angular_velocity, (3,)),
        )

    @property
    def moves(self) -> bool:
        """True: the coordinates are those of `reduced`, along the body's axes at the start."""
        return True

    @property
    def deforms(self) -> bool:
        """Whether the fidelity includes deformation."""
        return self.fidelity != "rigid"

    @property
    def is_damped(self) -> bool:
        """Whether the body has damping of its own."""
        return self.damping_ratio is not None or self.reduced.damping_matrix is not None

    @property
    def is_rigid(self) -> bool:
        """Whether the fidelity excludes deformation."""
        return self.fidelity == "rigid"

    @property
    def point_names(self) -> tuple[str, ...]:
        """Names of the body's points, passive points included."""
        return self.reduced.all_point_names

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix of the coordinates, (n, n)."""
        return self.reduced.mass_matrix

    @property
    def strain(self) -> Strain | None:
        """Strains whose energy is that of the body's stiffness; None where the fidelity excludes deformation."""
        return self.reduced.strain if self.deforms else None

    def weight(self, gravity: Array) -> Array:
        """Return the forces of a uniform gravity, world frame, (3,) [m/s2], on the coordinates, (n,)."""
        r = len(self.reduced.remote_points)
        fall = np.zeros(len(self.mass_matrix))
        fall[: 6 * r] = np.tile([*(self.rotation.T @ gravity), 0, 0, 0], r)
        return self.mass_matrix @ fall

    def motion(self, point: str) -> Array:
        """Return the small motion of a point along the world's axes per unit of the coordinates, (6, n)."""
        return rotated_motion(self.rotation) @ self.reduced.motion(point)

    def point_position(self, point: str) -> Array:
        """Return the position of a remote point at the start, world frame, (3,) [m]."""
        place = self.reduced.point(known(f"point of {self.name!r}:", point, self.point_names)).position
        return self.position + self.rotation @ place

    @property
    def centre(self) -> Array:
        """Centre of mass at the start, world frame, (3,) [m]."""
        return self.position + self.rotation @ self.reduced.center_of_mass

    @property
    def rigid_inertia(self) -> tuple[float, Array, Array]:
        """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m2] at the start, world frame."""
        mass = self.reduced.mass
        about = self.reduced.gram[1:4, 1:4] - mass * np.outer(*[self.reduced.center_of_mass] * 2)
        # Slender bodies made by hand may have no inertia about their axis.
        spread = np.trace(about) * (1 + 1e-9) * np.eye(3) - about
        return mass, self.centre, self.rotation @ spread @ self.rotation.T
