"""Poses of a Stewart platform: inverse and forward kinematics, Jacobian, joint angles.

A pose consists of `position`, the displacement of B from rest in the axes of F, shape (3,) [m], and `rotation`, the
rotation matrix of the platform, shape (3, 3). The defaults are the pose at rest. Where a docstring says so, both may
have further leading axes (...), for many poses at once.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array, finite_array
from nassim.base.field_types import ArrayLike
from nassim.base.rigid_motion import IDENTITY, proper_rotation
from nassim.base.warning_log import warn
from nassim.kinematics.stewart import StewartPlatform, strut_directions, strut_lengths, strut_vectors

REST = (0.0, 0.0, 0.0)
HARDLY_HELD = 1e6
"""Condition of the Jacobian above which lengths hardly determine a pose: Newton's method ends at 1e7 near a double one.
"""


def inverse_kinematics(platform: StewartPlatform, position: ArrayLike = REST, rotation: ArrayLike = IDENTITY) -> Array:
    """Compute the lengths of the struts in given poses.

    Args:
        platform: the Stewart platform
        position: displacements of B from rest in the axes of F, shape (..., 3) [m]
        rotation: rotation matrices of the platform, shape (..., 3, 3)

    Returns:
        Lengths, shape (..., 6) [m].

    Raises:
        ValueError: if `rotation` does not hold rotation matrices
    """
    return np.asarray(np.linalg.norm(_struts_in_pose(platform, position, _rotations(rotation)), axis=-1))


def forward_kinematics(
    platform: StewartPlatform, lengths: ArrayLike, *, position: ArrayLike = REST, rotation: ArrayLike = IDENTITY
) -> tuple[Array, Array]:
    """Compute the pose of the platform from the lengths of its struts, by Newton's method.

    There are up to forty poses for given lengths. The start determines which one is found. A warning tells of a
    singular pose, near which many poses have these lengths, almost or exactly.

    Args:
        platform: the Stewart platform
        lengths: lengths of the struts, shape (6,) [m]
        position: position of the start, shape (3,) [m]
        rotation: rotation matrix of the start, shape (3, 3)

    Returns:
        Position, shape (3,) [m], and rotation matrix, shape (3, 3).

    Raises:
        ValueError: if no pose is found, because no pose has these lengths or the start is too far away
    """
    wanted = finite_array("lengths", lengths, (6,))
    place, turn = finite_array("position", position, (3,)), _rotations(rotation)
    scale = float(strut_lengths(platform).mean())
    found: list[tuple[float, Array, Array]] = []
    for _ in range(60):
        short = inverse_kinematics(platform, place, turn) - wanted
        found.append((float(np.abs(short).max()), place, turn))
        if found[-1][0] < 1e-14 * scale:
            break
        step = np.linalg.lstsq(jacobian(platform, place, turn), -short, rcond=None)[0]
        step /= max(1.0, 2 * float(np.linalg.norm(step[3:])), 2 * float(np.linalg.norm(step[:3])) / scale)
        place, turn = place + step[:3], Rotation.from_rotvec(step[3:]).as_matrix() @ turn
    error, place, turn = min(found, key=lambda one: one[0])  # at the limits of the workspace, steps oscillate
    if error > 1e-9 * scale:
        raise ValueError(
            f"no pose found for the lengths {wanted} m (the nearest were {inverse_kinematics(platform, place, turn)}): "
            "start nearer, or change them"
        )
    if jacobian_condition(jacobian(platform, place, turn)) > HARDLY_HELD:
        warn(
            "the pose found is singular: the struts do not hold the platform there, so their lengths do not determine "
            "the pose; change the lengths or the joints"
        )
    return place, turn


def jacobian(platform: StewartPlatform, position: ArrayLike = REST, rotation: ArrayLike = IDENTITY) -> Array:
    """Compute the Jacobian from the platform's velocity to the rates of the struts' lengths.

    The velocity is that of B, followed by the platform's angular velocity, in the axes of F. The row of a strut is
    [s, b x s], with the unit vector s of the strut and its end b from B.

    Args:
        platform: the Stewart platform
        position: displacements of B from rest in the axes of F, shape (..., 3) [m]
        rotation: rotation matrices of the platform, shape (..., 3, 3)

    Returns:
        Jacobian, shape (..., 6, 6); its first three columns have no unit, the others [m].

    Raises:
        ValueError: if `rotation` does not hold rotation matrices
    """
    turn = _rotations(rotation)
    struts = _struts_in_pose(platform, position, turn)
    along = struts / np.linalg.norm(struts, axis=-1, keepdims=True)
    return np.concatenate([along, np.cross(_joint_vectors(platform, turn), along)], axis=-1)


def jacobian_condition(rates: Array) -> Array:
    """Compute the condition numbers of Jacobians, with rotations in units of the largest lever arm.

    Args:
        rates: Jacobians, shape (..., 6, 6)

    Returns:
        Condition numbers, shape (...); infinite for struts that all point at B.
    """
    arm = float(np.abs(rates[..., 3:]).max()) or 1.0
    return np.asarray(np.linalg.cond(rates / [1, 1, 1, arm, arm, arm]))


def joint_angles(
    platform: StewartPlatform, position: ArrayLike = REST, rotation: ArrayLike = IDENTITY
) -> tuple[Array, Array]:
    """Compute the angle by which each strut has turned from rest, relative to base and platform.

    Args:
        platform: the Stewart platform
        position: displacements of B from rest in the axes of F, shape (..., 3) [m]
        rotation: rotation matrices of the platform, shape (..., 3, 3)

    Returns:
        Bending angles of the joints at a (base) and at b (platform), shape (..., 6) each [rad].

    Raises:
        ValueError: if `rotation` does not hold rotation matrices
    """
    turn = _rotations(rotation)
    struts, rest = _struts_in_pose(platform, position, turn), strut_directions(platform)
    return _angles(struts, rest), _angles(struts @ turn, rest)


def _angles(vectors: Array, others: Array) -> Array:
    """Return the angles between vectors, shape (..., 6) [rad]; the arc tangent is also accurate for small angles."""
    across = np.linalg.norm(np.cross(vectors, others), axis=-1)
    return np.asarray(np.arctan2(across, np.sum(vectors * others, axis=-1)))


def _joint_vectors(platform: StewartPlatform, rotation: Array) -> Array:
    """Return the ends of the struts from B in the axes of F, shape (..., 6, 3) [m]."""
    return np.asarray((platform.platform_joints - platform.point) @ np.swapaxes(rotation, -1, -2))


def _struts_in_pose(platform: StewartPlatform, position: ArrayLike, rotation: Array) -> Array:
    """Return the vectors from a to b, shape (..., 6, 3) [m], as rest plus change, which keeps small motions exact."""
    moved = _joint_vectors(platform, rotation) - (platform.platform_joints - platform.point)
    place = np.asarray(position, dtype=float)
    if place.shape[-1:] != (3,) or not np.isfinite(place).all():
        raise ValueError(f"position must be finite and have shape (..., 3), got {place.shape}")
    return np.asarray(strut_vectors(platform) + place[..., None, :] + moved)


def _rotations(value: ArrayLike) -> Array:
    """Return rotation matrices as an array, shape (..., 3, 3), after checking them."""
    return proper_rotation("rotation", value, (*[None] * (np.ndim(value) - 2), 3, 3))
