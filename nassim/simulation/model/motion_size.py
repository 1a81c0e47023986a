"""Sizes of motion that small motion and reduced bodies bear: rotations, and displacements by deformation over size."""

import numpy as np

from nassim.base.checks import Array
from nassim.simulation.model.coordinates import Coordinates

SMALL_MOTION = 0.01
"""Rotation [rad], and deformation over size, up to which small motion holds: the error is about half of its square."""


def motion_size(coordinates: Coordinates, name: str, values: Array) -> Array:
    """Compute a body's largest rotation [rad] and its largest displacement by deformation over its size [-].

    Args:
        coordinates: coordinates of the scene.
        name: name of the body.
        values: values of the body's coordinates at one or more times, (n, n_times); in a floating frame those of
            deformation, so that the rotation is by deformation only.

    Returns:
        Rotation and relative displacement, (2,).
    """
    return np.array([np.abs(rows @ values).max(initial=0.0) for rows in coordinates.size_rows[name]])
