"""Forces and stiffness of a Stewart platform with ideal joints and struts without preload.

A wrench is a force [N] and a torque [Nm] at B; a motion is a translation [m] and a small rotation [rad] of B; both are
in the axes of F. Poses are those of `poses`. For another point, use `dataclasses.replace(platform, point=...)`.
"""

import numpy as np

from nassim.base.checks import Array, finite_array
from nassim.base.field_types import ArrayLike
from nassim.base.rigid_motion import IDENTITY
from nassim.kinematics.poses import REST, jacobian, jacobian_condition
from nassim.kinematics.stewart import StewartPlatform


def stiffness_matrix(
    platform: StewartPlatform, stiffness: ArrayLike, position: ArrayLike = REST, rotation: ArrayLike = IDENTITY
) -> Array:
    """Compute the stiffness J^T diag(k) J from the motion of B to the wrench at B.

    Args:
        platform: the Stewart platform
        stiffness: axial stiffness k of the struts, one number or six [N/m]
        position: displacement of B from rest in the axes of F, shape (3,) [m]
        rotation: rotation matrix of the platform, shape (3, 3)

    Returns:
        Stiffness matrix, shape (6, 6) [N/m, N/rad, Nm/rad].

    Raises:
        ValueError: if a stiffness is not positive
    """
    rates = jacobian(platform, position, rotation)
    return np.asarray(np.swapaxes(rates, -1, -2) @ (_strut_stiffness(stiffness)[:, None] * rates))


def compliance_matrix(
    platform: StewartPlatform, stiffness: ArrayLike, position: ArrayLike = REST, rotation: ArrayLike = IDENTITY
) -> Array:
    """Compute the motion of B per unit wrench at B, the inverse of `stiffness_matrix`.

    Args:
        platform: the Stewart platform
        stiffness: axial stiffness k of the struts, one number or six [N/m]
        position: displacement of B from rest in the axes of F, shape (3,) [m]
        rotation: rotation matrix of the platform, shape (3, 3)

    Returns:
        Compliance matrix, shape (6, 6) [m/N, rad/N, rad/Nm].

    Raises:
        ValueError: for a singular pose, in which the struts do not hold the platform
    """
    rates = jacobian(platform, position, rotation)
    inverse = _inverse(rates)
    return np.asarray((inverse / _strut_stiffness(stiffness)) @ np.swapaxes(inverse, -1, -2))


def strut_forces(
    platform: StewartPlatform, wrench: ArrayLike, position: ArrayLike = REST, rotation: ArrayLike = IDENTITY
) -> Array:
    """Compute the strut forces J^-T w that exert a given wrench on the platform.

    If the base does not move, the platform moves as under the same wrench from outside. On a flexible base the two
    differ, because the struts push the base too.

    Args:
        platform: the Stewart platform
        wrench: force and torque w at B, shape (6,) [N, Nm]
        position: displacement of B from rest in the axes of F, shape (3,) [m]
        rotation: rotation matrix of the platform, shape (3, 3)

    Returns:
        Forces of the struts, shape (6,) [N].

    Raises:
        ValueError: for a singular pose
    """
    inverse = _inverse(jacobian(platform, position, rotation))
    return np.asarray(np.swapaxes(inverse, -1, -2) @ finite_array("wrench", wrench, (6,)))


def _inverse(rates: Array) -> Array:
    """Return the inverse of a Jacobian, after checking its condition."""
    if jacobian_condition(rates).max() > 1e12:
        raise ValueError("the struts do not hold the platform in this pose, it is singular; change joints or pose")
    return np.asarray(np.linalg.inv(rates))


def _strut_stiffness(stiffness: ArrayLike) -> Array:
    """Return the stiffness of the six struts, shape (6,) [N/m]."""
    value = np.asarray(stiffness, dtype=float)
    six = finite_array("stiffness", np.full(6, value) if value.ndim == 0 else value, (6,))
    if six.min() <= 0:
        raise ValueError(f"the struts' stiffness must be positive, got {six.min():g} N/m")
    return six
