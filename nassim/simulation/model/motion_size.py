"""Sizes of motion that small motion and reduced bodies bear: rotations, and displacements by deformation over size."""

import numpy as np

from nassim.base.checks import Array
from nassim.scene.bodies import FlexibleBody, RigidBody
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
    return np.array([np.abs(rows @ values).max(initial=0.0) for rows in motion_rows(coordinates, name)])


def motion_rows(coordinates: Coordinates, name: str) -> tuple[Array, Array]:
    """Return rotations of a body's points [rad] and their displacements by deformation over its size [-].

    Args:
        coordinates: coordinates of the scene.
        name: name of the body.

    Returns:
        Rows on the body's coordinates, (k, n) each.
    """
    body = next(body for body in coordinates.scene.bodies if body.name == name)
    if isinstance(body, RigidBody):
        return np.eye(6)[3:], np.zeros((0, 6))
    if not isinstance(body, FlexibleBody):
        return np.vstack([body.motion(point)[3:] for point in body.point_names]), np.zeros((0, len(body.mass_matrix)))
    points = np.arange(6 * len(body.reduced.remote_points)).reshape(-1, 6)
    rotations, displacements = points[:, 3:], points[:-1, :3]
    middle = body.reduced.gram[1:4, 1:4] / body.reduced.mass - np.outer(*[body.reduced.center_of_mass] * 2)
    deformation = coordinates.frames[name].deformation(body.reduced)[displacements.ravel()]
    return np.eye(len(body.reduced.mass_matrix))[rotations.ravel()], deformation / np.sqrt(np.trace(middle))
