"""Sizes of motion that small motion and reduced bodies bear: rotations, and displacements by deformation over size."""

import numpy as np

from nassim.base.checks import Array
from nassim.simulation.model.coordinates import Coordinates

SMALL_MOTION = 0.01
"""Rotation [rad], and deformation over size, up to which small motion holds: the error of displacements is about half
of its square. Forces in springs that are stiff along an arm that turns may have a far larger one."""


def motion_sizes(coordinates: Coordinates, values: Array) -> dict[str, Array]:
    """Compute each body's largest rotation [rad] and its largest displacement by deformation over its size [-].

    Args:
        coordinates: coordinates of the scene.
        values: values of all coordinates at one or more times, (n_all, n_times); in a floating frame those of
            deformation, so that the rotation is by deformation only.

    Returns:
        Rotation and relative displacement of each moving body, (2,), by name.
    """
    if not coordinates.slices:
        return {}
    rows, starts = coordinates.stacked_size_rows
    largest = np.maximum.reduceat(np.abs(rows @ values).max(axis=1, initial=0.0), starts)
    return dict(zip(coordinates.slices, largest.reshape(-1, 2), strict=True))
