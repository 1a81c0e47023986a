"""Warning of forces between moving bodies that turn both together, as no real part does."""

import numpy as np

from nassim.base.warning_log import warn
from nassim.scene.lever_arms import lever_arm
from nassim.scene.rotation_measures import RotationAngle
from nassim.simulation.model.constraints import Constraints

TURNS = 1e-6
"""Least rotation per unit of a motion [rad/m] that counts, on coordinates of unit length."""


def warn_of_lever_arms(constraints: Constraints) -> None:
    """Warn of springs and actuators whose two forces do not lie on one line, where joints let their bodies turn."""
    coordinates, scene = constraints.coordinates, constraints.coordinates.scene
    for part in (*scene.springs, *scene.actuators):
        moment, points = lever_arm(scene, part)
        arm = float(np.linalg.norm(moment))
        turns = [coordinates.jacobian(RotationAngle(path, moment / arm)) @ constraints.basis for path in points]
        if any(np.abs(rows).max(initial=0.0) > TURNS for rows in turns):
            warn(
                f"{type(part).__name__} {part.name!r} of scene {scene.name!r} acts at two points that lie "
                f"{1e3 * arm:.3g} mm apart across its axis, which does not rotate, so it turns both bodies together by "
                f"{arm:.3g} N m per N of its force, as no real part does: put both points on one line along the axis, "
                "or give one of them as its frame, with which the axis then rotates"
            )
