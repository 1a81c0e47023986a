"""Rigid motion of points: names of the directions, rotations, and motion of a point from the motion of its body."""

import math

import numpy as np

from nassim.base.checks import Array, finite_array, known
from nassim.base.field_types import ArrayLike

AXES = ("ux", "uy", "uz", "rx", "ry", "rz")
DIRECTIONS = {"x": "ux", "y": "uy", "z": "uz", "rx": "rx", "ry": "ry", "rz": "rz"}
IDENTITY = np.eye(3)
"""Kept for measures, which are evaluated many times a step; read-only."""
IDENTITY.setflags(write=False)
_SAME_MOTION = np.eye(6)


def direction_text(axis: ArrayLike) -> str:
    """Return a direction as text for reports: "x", "y", "z" where it is one of these, else its components, (3,)."""
    parts = np.asarray(axis, dtype=float)
    names = [name for name, column in zip("xyz", np.eye(3), strict=True) if np.array_equal(parts, column)]
    return names[0] if names else "(" + ", ".join(f"{x:g}" for x in parts) + ")"


def unit_vector(axis: str | ArrayLike) -> Array:
    """Return the unit vector along "x", "y", "z" or along a vector of any length, shape (3,).

    Raises:
        ValueError: for another name or a vector of zero length
    """
    if isinstance(axis, str):
        return np.eye(3)["xyz".index(known("axis", axis, ("x", "y", "z")))]
    vector = finite_array("axis", axis, (3,))
    length = float(np.linalg.norm(vector))
    if not length:
        raise ValueError("an axis must have a length, got (0, 0, 0)")
    return vector / length


def axes_along(z: str | ArrayLike, x: str | ArrayLike | None = None) -> Array:
    """Compute right-handed axes whose third axis is along z and whose first axis is in the plane of z and x.

    Args:
        z: direction of the third axis, a name or a vector (3,)
        x: direction in the plane of the first and third axes (default: the world axis closest to perpendicular to z)

    Returns:
        The axes as columns, shape (3, 3).

    Raises:
        ValueError: if z and x are parallel
    """
    third = unit_vector(z)
    given = np.eye(3)[int(np.argmin(np.abs(third)))] if x is None else unit_vector(x)
    first = given - (given @ third) * third
    length = float(np.linalg.norm(first))
    if length < 1e-9:
        raise ValueError(f"axes {z!r} and {x!r} are parallel and span no plane")
    first = first / length
    return np.column_stack([first, np.cross(third, first), third])


def proper_rotation(
    label: str, value: ArrayLike, shape: tuple[int | None, ...] = (3, 3), *, tolerance: float = 1e-9
) -> Array:
    """Return `value` as a read-only rotation matrix, shape (3, 3), or as several, shape (..., 3, 3).

    Raises:
        ValueError: if they are not rotation matrices
    """
    rotation = finite_array(label, value, shape)
    error = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max(initial=0.0)
    if error > tolerance or np.linalg.det(rotation).min(initial=1.0) < 0:
        kind = "a proper orthogonal matrix" if shape == (3, 3) else "proper orthogonal matrices"
        raise ValueError(f"{label} must be {kind}")
    return rotation


def skew(vector: Array) -> Array:
    """Return the cross-product matrix a~ with a~ b = a x b, shape (3, 3).

    Plain numbers, because measures call this and `rigid_transfer` many times a step.
    """
    x, y, z = np.asarray(vector).tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def quaternion(rotation: Array) -> tuple[float, Array]:
    """Return the unit quaternion of a rotation matrix (3, 3): scalar part, not negative, and vector part (3,).

    Plain numbers, because general items call this several times a step.

    Source: S. Shepperd, Quaternion from rotation matrix, J. Guidance and Control 1 (1978) 223-224.
    """
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    squares = (1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i)  # four times those of the four parts
    largest = squares.index(max(squares))
    parts = (
        (squares[0], h - f, c - g, d - b),
        (h - f, squares[1], b + d, c + g),
        (c - g, b + d, squares[2], f + h),
        (d - b, c + g, f + h, squares[3]),
    )[largest]
    size = math.copysign(math.sqrt(sum(part * part for part in parts)), parts[0])
    scalar, *vector = (part / size for part in parts)
    return scalar, np.array(vector)


def rotation_matrix(vector: Array) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector (3,) [rad], by Rodrigues' formula."""
    angle = math.hypot(*np.asarray(vector).tolist())
    if not angle:
        return np.eye(3)
    cross = skew(vector)
    result: Array = np.eye(3) + math.sin(angle) / angle * cross
    return result + 2 * (math.sin(angle / 2) / angle) ** 2 * cross @ cross


def rigid_transfer(offset: Array) -> Array:
    """Return the matrix (6, 6) from a rigid body's reference motion (6) to that of a point at `offset` (3,) [m]."""
    x, y, z = np.asarray(offset).tolist()
    result = _SAME_MOTION.copy()
    result[0, 4], result[0, 5] = z, -y
    result[1, 3], result[1, 5] = -z, x
    result[2, 3], result[2, 4] = y, -x
    return result


def rotated_motion(rotation: Array) -> Array:
    """Return the matrix (6, 6) that applies a matrix (3, 3) to the displacement and to the rotation of a motion (6)."""
    result = np.zeros((6, 6))
    result[:3, :3] = result[3:, 3:] = rotation
    return result


def rigid_motions(positions: Array, n: int) -> Array:
    """Return the six rigid motions about the origin as columns, shape (n, 6).

    Args:
        positions: of the r points whose motions are the first 6 r coordinates, shape (r, 3) [m]
        n: number of coordinates; those after the first 6 r do not move
    """
    result = np.zeros((n, 6))
    result[: 6 * len(positions)] = np.vstack([rigid_transfer(position) for position in positions])
    return result
