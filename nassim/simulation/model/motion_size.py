"""Sizes of a scene, and of motion that small motion and reduced bodies bear: rotations and relative displacements."""

import numpy as np

from nassim.base.checks import Array
from nassim.scene.scene import Scene
from nassim.simulation.model.coordinates import Coordinates

SMALL_MOTION = 0.01
"""Rotation [rad], and deformation over size, up to which small motion holds: the error of displacements is about half
of its square. Forces in springs that are stiff along an arm that turns may have a far larger one."""


def scene_size(scene: Scene) -> float:
    """Return the size of a scene [m]: of the box around all its points and centres of mass, and of its largest body."""
    bodies = [body for body in scene.bodies if body.moves]
    places = [body.rigid_inertia[1] for body in bodies]
    for body in scene.bodies:
        places += [body.point_position(name) for name in body.point_names]
    radii = [np.sqrt(np.trace(inertia) / mass) for mass, _, inertia in (body.rigid_inertia for body in bodies)]
    return float(np.linalg.norm(np.ptp(places, axis=0)) + max(radii, default=0.0))


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
