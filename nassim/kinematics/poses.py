"""Poses of a Stewart platform: lengths of its struts, the pose of given lengths, their derivative, angles of joints.

A pose is how far B moved from rest, `position`, in F's axes, shape (3,) [m], and how the platform turned, `rotation`,
a rotation matrix, shape (3, 3); left out, the platform is at rest. Where a docstring says so, both may have further
leading axes (...), for many poses at once.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array, finite_array
from nassim.kinematics.stewart import StewartPlatform, strut_directions, strut_lengths, strut_vectors

REST = (0.0, 0.0, 0.0)
UPRIGHT = np.eye(3)
UPRIGHT.setflags(write=False)


def inverse_kinematics(platform: StewartPlatform, position: ArrayLike = REST, rotation: ArrayLike = UPRIGHT) -> Array:
    """Lengths of the struts in poses (..., 3) and (..., 3, 3), shape (..., 6) [m].

    Raises ValueError for rotations that are none.
    """
    return np.asarray(np.linalg.norm(_posed_struts(platform, position, _rotations(rotation)), axis=-1))


def forward_kinematics(
    platform: StewartPlatform, lengths: ArrayLike, *, position: ArrayLike = REST, rotation: ArrayLike = UPRIGHT
) -> tuple[Array, Array]:
    """Position (3,) [m] and rotation (3, 3) of the platform whose struts have these lengths (6,) [m], by Newton.

    position, rotation: the pose from which to look; of the up to forty poses that some lengths have, the one found
        is that which this leads to

    Raises ValueError when no pose is found: struts of these lengths do not meet, or the start is too far.
    """
    wanted = finite_array("lengths", lengths, (6,))
    place, turn = finite_array("position", position, (3,)), _rotations(rotation)
    scale = float(strut_lengths(platform).mean())
    short = inverse_kinematics(platform, place, turn) - wanted
    for _ in range(60):
        if np.abs(short).max() < 1e-14 * scale:
            break
        step = np.linalg.lstsq(jacobian(platform, place, turn), -short, rcond=None)[0]
        step /= max(1.0, 2 * float(np.linalg.norm(step[3:])), 2 * float(np.linalg.norm(step[:3])) / scale)
        for _ in range(12):
            to, turned = place + step[:3], Rotation.from_rotvec(step[3:]).as_matrix() @ turn
            left = inverse_kinematics(platform, to, turned) - wanted
            if np.linalg.norm(left) < np.linalg.norm(short):
                break
            step /= 2
        else:
            break
        place, turn, short = to, turned, left
    if np.abs(short).max() > 1e-9 * scale:
        raise ValueError(
            f"no pose found for the lengths {wanted} m (nearest: {short + wanted}); start nearer, or change them"
        )
    return place, turn


def jacobian(platform: StewartPlatform, position: ArrayLike = REST, rotation: ArrayLike = UPRIGHT) -> Array:
    """Rates of the struts' lengths by the velocity of B and the platform's angular velocity, both in F's axes.

    Rows [s, b x s] with the strut's unit vector s and its end b from B, shape (6, 6) [-, m]; of poses (..., 3) and
    (..., 3, 3), shape (..., 6, 6). Raises ValueError for rotations that are none.
    """
    turn = _rotations(rotation)
    struts = _posed_struts(platform, position, turn)
    along = struts / np.linalg.norm(struts, axis=-1, keepdims=True)
    return np.concatenate([along, np.cross(_turned(platform, turn), along)], axis=-1)


def joint_angles(
    platform: StewartPlatform, position: ArrayLike = REST, rotation: ArrayLike = UPRIGHT
) -> tuple[Array, Array]:
    """How far each strut is bent against base and platform since rest: the angles at a and at b, each (..., 6) [rad].

    Of poses (..., 3) and (..., 3, 3). Raises ValueError for rotations that are none.
    """
    turn = _rotations(rotation)
    struts, rest = _posed_struts(platform, position, turn), strut_directions(platform)
    return _angles(struts, rest), _angles(struts @ turn, rest)


def _angles(vectors: Array, others: Array) -> Array:
    across = np.linalg.norm(np.cross(vectors, others), axis=-1)
    return np.asarray(np.arctan2(across, np.sum(vectors * others, axis=-1)))


def _turned(platform: StewartPlatform, rotation: Array) -> Array:
    """The struts' ends from B, in F's axes, (..., 6, 3)."""
    return np.asarray((platform.platform_joints - platform.point) @ np.swapaxes(rotation, -1, -2))


def _posed_struts(platform: StewartPlatform, position: ArrayLike, rotation: Array) -> Array:
    """From a to b in poses, (..., 6, 3); what moves is added to what is at rest, which keeps small motions exact."""
    moved = _turned(platform, rotation) - (platform.platform_joints - platform.point)
    place = np.asarray(position, dtype=float)
    if place.shape[-1:] != (3,) or not np.isfinite(place).all():
        raise ValueError(f"position must be finite and have shape (..., 3), got {place.shape}")
    return np.asarray(strut_vectors(platform) + place[..., None, :] + moved)


def _rotations(value: ArrayLike) -> Array:
    rotation = np.asarray(value, dtype=float)
    if rotation.shape[-2:] != (3, 3):
        raise ValueError(f"rotation must be rotation matrices of shape (..., 3, 3), got {rotation.shape}")
    wrong = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max(initial=0.0)
    if not wrong < 1e-9 or np.linalg.det(rotation).min(initial=1.0) < 0:
        raise ValueError("rotation must be proper orthogonal matrices")
    return rotation
