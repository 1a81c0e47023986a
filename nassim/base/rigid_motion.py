"""Rigid motion of points: the names of its directions, and what a body's motion makes of a point's."""

import numpy as np

from nassim.base.checks import Array

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


def rigid_motions(positions: Array, n: int) -> Array:
    """The six rigid motions about the origin in n coordinates: six for each of the positions (r, 3), others at rest."""
    result = np.zeros((n, 6))
    result[: 6 * len(positions)] = np.vstack([rigid_transfer(position) for position in positions])
    return result
