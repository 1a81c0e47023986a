"""Strokes that struts need for a box of motions, and the largest box that strokes and joint angles allow.

A box is given by six half widths: translations of B along the axes of F [m], then the components of the rotation vector
[rad].
"""

import itertools
import math

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array, above_zero, finite_array
from nassim.base.field_types import ArrayLike
from nassim.base.warning_log import warn
from nassim.kinematics.poses import inverse_kinematics, jacobian, joint_angles
from nassim.kinematics.stewart import StewartPlatform, strut_lengths

_SHARES = np.linspace(0.01, 1.0, 100)
"""Boxes that are searched for singular poses, over the largest one."""
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

    Every smaller box with these proportions is allowed too. A warning tells of singular poses in the box: there the
    struts do not hold the platform, and cannot bring it from one side to the other.

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
    factor = scipy.optimize.brentq(lambda factor: used(factor) - 1, inner, inner + step, xtol=1e-13 * step, rtol=1e-13)
    _warn_of_singular_poses(platform, factor * proportions)
    return np.asarray(factor * proportions)


def _warn_of_singular_poses(platform: StewartPlatform, box: Array) -> None:
    """Warn of a box in which the determinant of the Jacobian changes its sign."""
    places = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=int(np.count_nonzero(box)))))
    motions = np.zeros((len(places), 6))
    motions[:, box > 0] = places
    at_rest = np.linalg.det(jacobian(platform))
    for share in _SHARES:
        rates = jacobian(platform, *_poses(share * box * motions))
        if np.any(np.linalg.det(rates) * at_rest <= 0):
            warn(
                f"the workspace holds singular poses, where the struts do not hold the platform, in boxes from "
                f"{100 * share:.0f} % of its half widths on: give a smaller stroke or angle of bending, which keep the "
                "platform on this side of them"
            )
            return


def _half_widths(box: ArrayLike) -> Array:
    """Return the half widths of a box, shape (6,), after checking them."""
    half = finite_array("box", box, (6,))
    if half.min() < 0 or not half.any():
        raise ValueError(f"box must be six half widths of at least zero, not all zero, got {half}")
    return half


def _corners(half: Array) -> tuple[Array, Array]:
    """Return the poses at the corners of a box: positions (64, 3) [m] and rotation matrices (64, 3, 3)."""
    return _poses(_CORNERS * half)


def _poses(motions: Array) -> tuple[Array, Array]:
    """Return the poses of motions (n, 6): positions (n, 3) [m] and rotation matrices (n, 3, 3)."""
    return motions[:, :3], Rotation.from_rotvec(motions[:, 3:]).as_matrix()
