"""Remote points, the names of their coordinates, and their boundary conditions."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from nassim.base.checks import Array, finite_array, freeze, known, not_negative, unique
from nassim.base.field_types import ArrayField, Names, data_class
from nassim.base.rigid_motion import AXES, DIRECTIONS
from nassim.base.short_repr import short_repr

COUPLINGS = ("rbe2", "rbe3")


@data_class
class RemotePoint:
    """A point with six degrees of freedom, coupled to faces of a solid (ANSYS: remote point, Simscape: interface).

    Attributes:
        name: name of the point in scenes
        faces: names of the CAD faces of its interface; a single name may be given as a string
        position: position in the CAD's frame, shape (3,) [m]
        coupling: "rbe2": the faces move as a rigid body; "rbe3": the point follows the mean rigid motion of the faces
            (least squares over the area) and the faces stay deformable
    """

    name: str
    faces: Names
    position: ArrayField
    coupling: str = "rbe3"
    __repr__ = short_repr

    def __post_init__(self) -> None:
        faces = (self.faces,) if isinstance(self.faces, str) else tuple(self.faces)
        freeze(
            self,
            faces=unique(f"remote point {self.name!r}: face", faces),
            position=finite_array(f"remote point {self.name!r}: position", self.position, (3,)),
        )
        known("coupling", self.coupling, COUPLINGS)


def coordinate_names(points: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the 6 r coordinates, such as "top.uz", per point in the order ux uy uz rx ry rz."""
    return tuple(f"{point}.{axis}" for point in points for axis in AXES)


def free_coordinates(
    points: Sequence[str], *, fixed: Collection[str] = (), guided: Mapping[str, str] | None = None
) -> NDArray[np.int64]:
    """Return the indices of the coordinates of remote points that boundary conditions leave free.

    Args:
        points: names of the remote points
        fixed: names of points that cannot move
        guided: point -> its one free direction ("x", "y", "z", "rx", "ry" or "rz")

    Raises:
        ValueError: for unknown names and for a point that is both fixed and guided
    """
    guided = guided or {}
    if isinstance(fixed, str):
        raise ValueError(f"fixed must be a list of names, got the text {fixed!r}; write [{fixed!r}]")
    for point in [*fixed, *guided]:
        known("remote point", point, points)
    both = set(fixed) & set(guided)
    if both:
        raise ValueError(f"remote point(s) {', '.join(sorted(both))} cannot be both fixed and guided")
    free = []
    for name in coordinate_names(points):
        point, axis = name.rsplit(".", 1)
        if point in guided:
            free.append(axis == DIRECTIONS[known("direction", guided[point], DIRECTIONS)])
        else:
            free.append(point not in fixed)
    return np.flatnonzero(free)


def point_masses(points: Sequence[str], masses: Mapping[str, float] | None) -> Array:
    """Return the diagonal that point masses [kg] at remote points add to the mass matrix, shape (6 r,)."""
    diagonal = np.zeros(6 * len(points))
    for point, mass in (masses or {}).items():
        index = list(points).index(known("remote point", point, points))
        diagonal[6 * index : 6 * index + 3] = not_negative(f"mass at {point!r}", mass, "kg")
    return diagonal


def coordinate_vector(points: Sequence[str], weights: Mapping[str, float]) -> Array:
    """Return a vector (6 r,) with given weights at named coordinates, e.g. {"top.uz": 1.0}."""
    names = coordinate_names(points)
    vector = np.zeros(len(names))
    for name, weight in weights.items():
        vector[names.index(known("coordinate", name, names))] = weight
    return vector
