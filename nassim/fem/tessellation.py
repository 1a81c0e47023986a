"""Faces of a CAD object as triangles, for images without a mesh."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from nassim.base.checks import Array
from nassim.base.library_lock import hold_library_lock
from nassim.bodies.readouts import Surface
from nassim.fem.faces import list_faces, occ_faces, solid_triangles
from nassim.fem.solid import Solid

SAME_CORNER = 1e-6
"""Share of the size within which two corners of faces are the same, because coordinates are in single precision."""
SAME_FACE = 1e-9
"""Largest distance between the centres of one face as seen from the CAD bodies on its two sides [m]."""


def solid_surface(solid: Solid) -> Surface:
    """Return the outer faces of a solid as triangles, with the same labels as a mesh: CAD body or remote point.

    OpenCASCADE chooses the fineness of curved faces. Faces between CAD bodies are omitted.

    Args:
        solid: the solid
    """
    owner = {face: point.name for point in solid.remote_points for face in point.faces}
    with hold_library_lock():
        bodies = list(solid.shape.solids)
        return _surface(bodies, [owner.get(face.name, body.name or "") for body in bodies for face in body.faces])


def face_surface(shape: Any) -> Surface:
    """Return the outer faces of a shape as triangles, labelled with the description of each face.

    Args:
        shape: OpenCASCADE shape in metres
    """
    with hold_library_lock():
        labels = dict(zip(occ_faces(shape), map(str, list_faces(shape)), strict=True))
        bodies = list(shape.solids) or [shape]
        return _surface(bodies, [labels[face] for body in bodies for face in body.faces])


def _surface(bodies: Sequence[Any], labels: Sequence[str]) -> Surface:
    """Return the outer faces of CAD bodies as triangles, given the labels of all faces of all bodies."""
    corners: list[Array] = []
    numbers: list[Array] = []
    middles: list[tuple[float, ...]] = []
    for body in bodies:
        triangles, _, owner = solid_triangles(body)
        corners.append(triangles.reshape(-1, 3))
        numbers.append(owner + len(middles))
        middles += [(*face.center, face.mass) for face in body.faces]
    places = np.array(middles)
    outer = np.sum(np.all(np.abs(places[:, None] - places) < SAME_FACE, axis=2), axis=1) == 1
    face = np.concatenate(numbers)
    points = np.concatenate(corners)
    grid = np.round(points / (SAME_CORNER * np.ptp(points, axis=0).max()))
    _, first, number = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    triangles = number.reshape(-1, 3)[outer[face]]
    edges = np.unique(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return Surface(points[first], triangles, edges, tuple(labels[k] for k in face[outer[face]]))
