"""Forces and stiffness of a Stewart platform whose joints are ideal and whose struts bear no load at rest.

Wrenches are force [N] and torque [Nm], motions translation [m] and small rotation [rad], of B and in F's axes; poses
as in `poses`. For another point than B: `dataclasses.replace(platform, point=...)`.
"""

import numpy as np
from numpy.typing import ArrayLike

from nassim.base.checks import Array, finite_array
from nassim.kinematics.poses import REST, UPRIGHT, jacobian
from nassim.kinematics.stewart import StewartPlatform


def stiffness_matrix(
    platform: StewartPlatform, stiffness: ArrayLike, position: ArrayLike = REST, rotation: ArrayLike = UPRIGHT
) -> Array:
    """Wrench at B by its motion, J^T diag(k) J, shape (6, 6) [N/m, N/rad, Nm/rad].

    stiffness: k of the struts along their lines, one number or six [N/m]

    Raises ValueError for stiffnesses that are not positive.
    """
    rates = jacobian(platform, position, rotation)
    return np.asarray(np.swapaxes(rates, -1, -2) @ (_six(stiffness)[:, None] * rates))


def compliance_matrix(
    platform: StewartPlatform, stiffness: ArrayLike, position: ArrayLike = REST, rotation: ArrayLike = UPRIGHT
) -> Array:
    """Motion of B by a wrench there, the inverse of `stiffness_matrix`, shape (6, 6) [m/N, rad/N, rad/Nm].

    Raises ValueError for a singular pose, in which the struts do not hold the platform.
    """
    rates = jacobian(platform, position, rotation)
    inverse = _inverse(rates)
    return np.asarray((inverse / _six(stiffness)) @ np.swapaxes(inverse, -1, -2))


def strut_forces(
    platform: StewartPlatform, wrench: ArrayLike, position: ArrayLike = REST, rotation: ArrayLike = UPRIGHT
) -> Array:
    """Forces with which the struts push the platform as a wrench at B does, J^-T w, shape (6,) [N].

    On a base that does not move, they move the platform as that wrench from outside would; on a flexible one, the
    struts push the base too and do not. Raises ValueError for a singular pose.
    """
    inverse = _inverse(jacobian(platform, position, rotation))
    return np.asarray(np.swapaxes(inverse, -1, -2) @ finite_array("wrench", wrench, (6,)))


def _inverse(rates: Array) -> Array:
    arm = np.abs(rates[..., 3:]).max()
    if not arm or np.linalg.cond(rates / [1, 1, 1, arm, arm, arm]).max() > 1e12:
        raise ValueError("the struts do not hold the platform in this pose, it is singular; change joints or pose")
    return np.asarray(np.linalg.inv(rates))


def _six(stiffness: ArrayLike) -> Array:
    value = np.asarray(stiffness, dtype=float)
    six = finite_array("stiffness", np.full(6, value) if value.ndim == 0 else value, (6,))
    if six.min() <= 0:
        raise ValueError(f"the struts' stiffness must be positive, got {six.min():g} N/m")
    return six
