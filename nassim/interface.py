"""Naming of interface coordinates, and boundary conditions at remote points."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from nassim.checks import Array, known, not_negative

AXES = ("ux", "uy", "uz", "rx", "ry", "rz")
DIRECTIONS = {"x": "ux", "y": "uy", "z": "uz", "rx": "rx", "ry": "ry", "rz": "rz"}


def unit_vector(axis: str) -> Array:
    """The unit vector along "x", "y" or "z", shape (3,)."""
    return np.eye(3)["xyz".index(axis)]


def skew(vector: Array) -> Array:
    """The matrix a~ with a~ b = a x b, shape (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rigid_transfer(offset: Array) -> Array:
    """Motion (6) of a point at `offset` (3,) from the motion (6) of a rigid body's reference point, shape (6, 6)."""
    result = np.eye(6)
    result[:3, 3:] = -skew(offset)
    return result


def coordinate_names(points: Sequence[str]) -> tuple[str, ...]:
    """Names such as "top.uz" of the 6 r coordinates, per point ux uy uz rx ry rz."""
    return tuple(f"{point}.{axis}" for point in points for axis in AXES)


def free_coordinates(
    points: Sequence[str], *, fixed: Collection[str] = (), guided: Mapping[str, str] | None = None
) -> NDArray[np.int64]:
    """Indices of the coordinates of remote points that boundary conditions leave free.

    fixed: names of points that cannot move; guided: point -> the one direction left free ("x" ... "rz")

    Raises ValueError for unknown names and for a point that is both fixed and guided.
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
    """Diagonal of the mass matrix [kg] that point masses at remote points add, shape (6 r,)."""
    diagonal = np.zeros(6 * len(points))
    for point, mass in (masses or {}).items():
        index = list(points).index(known("remote point", point, points))
        diagonal[6 * index : 6 * index + 3] = not_negative(f"mass at {point!r}", mass, "kg")
    return diagonal


def coordinate_vector(points: Sequence[str], weights: Mapping[str, float]) -> Array:
    """Vector (6 r,) with the given weights at named coordinates, e.g. {"top.uz": 1.0}."""
    names = coordinate_names(points)
    vector = np.zeros(len(names))
    for name, weight in weights.items():
        vector[names.index(known("coordinate", name, names))] = weight
    return vector
