"""Rigid motion of points: the names of its directions, and what a body's motion makes of a point's."""

import numpy as np
from numpy.typing import ArrayLike

from nassim.base.checks import Array, finite_array, known

AXES = ("ux", "uy", "uz", "rx", "ry", "rz")
DIRECTIONS = {"x": "ux", "y": "uy", "z": "uz", "rx": "rx", "ry": "ry", "rz": "rz"}


def unit_vector(axis: str | ArrayLike) -> Array:
    """The unit vector along "x", "y", "z" or a vector of any length, shape (3,).

    Raises ValueError for other names and for a vector of no length.
    """
    if isinstance(axis, str):
        return np.eye(3)["xyz".index(known("axis", axis, ("x", "y", "z")))]
    vector = finite_array("axis", axis, (3,))
    length = float(np.linalg.norm(vector))
    if not length:
        raise ValueError("an axis must have a length, got (0, 0, 0)")
    return vector / length


def axes_along(z: str | ArrayLike, x: str | ArrayLike | None = None) -> Array:
    """Right-handed axes whose third is along z and whose first lies in the plane of z and x, as columns, (3, 3).

    x: default: the world's axis that lies flattest to z. Raises ValueError for two that are parallel.
    """
    third = unit_vector(z)
    given = np.eye(3)[int(np.argmin(np.abs(third)))] if x is None else unit_vector(x)
    first = given - (given @ third) * third
    length = float(np.linalg.norm(first))
    if length < 1e-9:
        raise ValueError(f"axes {z!r} and {x!r} are parallel and span no plane")
    first = first / length
    return np.column_stack([first, np.cross(third, first), third])


def proper_rotation(label: str, value: ArrayLike) -> Array:
    """Return a rotation matrix, (3, 3), read-only; raises ValueError for a matrix that is none."""
    rotation = finite_array(label, value, (3, 3))
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-9 or np.linalg.det(rotation) < 0:
        raise ValueError(f"{label} must be a proper orthogonal matrix")
    return rotation


def skew(vector: Array) -> Array:
    """The matrix a~ with a~ b = a x b, shape (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rigid_transfer(offset: Array) -> Array:
    """Motion (6) of a point at `offset` (3,) from the motion (6) of a rigid body's reference point, shape (6, 6)."""
    result = np.eye(6)
    result[:3, 3:] = -skew(offset)
    return result


def rigid_motions(positions: Array, n: int) -> Array:
    """The six rigid motions about the origin in n coordinates: six for each of the positions (r, 3), others at rest."""
    result = np.zeros((n, 6))
    result[: 6 * len(positions)] = np.vstack([rigid_transfer(position) for position in positions])
    return result
