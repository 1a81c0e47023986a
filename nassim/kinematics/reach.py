"""Strokes that struts need for a box of motions, and the largest box that strokes and joint angles allow.

A box is given by six half widths: translations of B along the axes of F [m], then the components of the rotation vector
[rad].
"""

import itertools
import math

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array, above_zero, finite_array
from nassim.base.field_types import ArrayLike
from nassim.kinematics.poses import inverse_kinematics, joint_angles
from nassim.kinematics.stewart import StewartPlatform, strut_lengths

_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=6)))


def strut_strokes(platform: StewartPlatform, box: ArrayLike) -> Array:
    """Compute the smallest and largest change of each strut's length over the corners of a box of motions.

    The corners give the extreme changes as long as the changes are nearly linear in the motions.

    Args:
        platform: the Stewart platform
        box: half widths, shape (6,) [m, rad]; zero for a motion that is not made

    Returns:
        Smallest and largest changes, shape (6, 2) [m].

    Raises:
        ValueError: if a half width is negative or all are zero
    """
    change = inverse_kinematics(platform, *_corners(_half_widths(box))) - strut_lengths(platform)
    return np.column_stack([change.min(axis=0), change.max(axis=0)])


def workspace(platform: StewartPlatform, box: ArrayLike, *, stroke: float, bending: float = math.inf) -> Array:
    """Compute the largest box of motions, with given proportions, that strokes and joint angles allow.

    Every smaller box with these proportions is allowed too.

    Args:
        platform: the Stewart platform
        box: proportions, shape (6,). For example, (1, 0, 0, 0, 0, 0) asks for the largest motion along x alone; several
            nonzero values ask for combined motions.
        stroke: largest change of a strut's length in either direction [m]; inf for no limit
        bending: largest bending angle of the joints at both ends of the struts [rad]; inf for no limit

    Returns:
        Half widths of the box, shape (6,) [m, rad].

    Raises:
        ValueError: if nothing limits motions up to three times the struts' length and 3 rad
    """
    stroke, bending = above_zero("stroke", stroke, "m"), above_zero("bending", bending, "rad")
    proportions = _half_widths(box)
    rest = strut_lengths(platform)

    def used(factor: float) -> float:
        pose = _corners(factor * proportions)
        bent = max(angle.max() for angle in joint_angles(platform, *pose))
        return float(max(np.abs(inverse_kinematics(platform, *pose) - rest).max() / stroke, bent / bending))

    whole = 1 / max(np.linalg.norm(proportions[:3]) / rest.mean(), np.linalg.norm(proportions[3:]))
    # Steps of a twentieth of what nearly linear motions allow, not to step over the first crossing of a limit.
    step = 0.05 * whole / max(1.0, 1e6 * used(1e-6 * whole))
    inner = 0.0
    while used(inner + step) <= 1:
        inner += step
        if inner > 3 * whole:
            raise ValueError("nothing limits motions in these proportions; give a stroke or an angle of bending")
    outer = inner + step
    while outer - inner > 1e-13 * outer:
        middle = (inner + outer) / 2
        inner, outer = (middle, outer) if used(middle) <= 1 else (inner, middle)
    return np.asarray(inner * proportions)


def _half_widths(box: ArrayLike) -> Array:
    """Return the half widths of a box, shape (6,), after checking them."""
    half = finite_array("box", box, (6,))
    if half.min() < 0 or not half.any():
        raise ValueError(f"box must be six half widths of at least zero, not all zero, got {half}")
    return half


def _corners(half: Array) -> tuple[Array, Array]:
    """Return the poses at the corners of a box: positions (64, 3) [m] and rotation matrices (64, 3, 3)."""
    motions = _CORNERS * half
    return motions[:, :3], Rotation.from_rotvec(motions[:, 3:]).as_matrix()
