"""Faces of a CAD object as triangles, for images without a mesh."""

from typing import Any

import netgen.occ as occ
import numpy as np
from numpy.typing import NDArray

from nassim.base.checks import Array
from nassim.base.library_lock import hold_library_lock
from nassim.bodies.readouts import Surface
from nassim.fem.solid import Solid

SAME_CORNER = 1e-6
"""Share of the size within which two corners of faces are the same, because coordinates are in single precision."""
SAME_FACE = 1e-9
"""Largest distance between the centres of one face as seen from the CAD bodies on its two sides [m]."""


def body_triangles(body: Any) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return the triangles by which OpenCASCADE draws a CAD body.

    Args:
        body: OpenCASCADE shape [m]

    Returns:
        Corners and outward normals there, each of shape (n, 3, 3), and the number of each triangle's face, shape (n,).
    """
    drawing = occ.OCCGeometry(body)._visualizationData()
    corners, normals = (np.asarray(drawing[key], dtype=float).reshape(-1, 3, 3) for key in ("vertices", "normals"))
    return corners, normals, np.asarray(drawing["indices"], dtype=int)


def solid_surface(solid: Solid) -> Surface:
    """Return the outer faces of a solid as triangles, with the same labels as a mesh: CAD body or remote point.

    OpenCASCADE chooses the fineness of curved faces. Faces between CAD bodies are omitted.

    Args:
        solid: the solid
    """
    owner = {face: point.name for point in solid.remote_points for face in point.faces}
    corners: list[Array] = []
    numbers: list[Array] = []
    labels: list[str] = []
    middles: list[tuple[float, ...]] = []
    with hold_library_lock(forkable=True):
        for body in solid.shape.solids:
            (triangles_of_body, _, face_numbers), faces = body_triangles(body), list(body.faces)
            corners.append(triangles_of_body.reshape(-1, 3))
            numbers.append(face_numbers + len(middles))
            labels += [owner.get(face.name, body.name or "") for face in faces]
            middles += [(*face.center, face.mass) for face in faces]
    places = np.array(middles)
    outer = np.sum(np.all(np.abs(places[:, None] - places) < SAME_FACE, axis=2), axis=1) == 1
    face = np.concatenate(numbers)
    points = np.concatenate(corners)
    grid = np.round(points / (SAME_CORNER * np.ptp(points, axis=0).max()))
    _, first, number = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    triangles = number.reshape(-1, 3)[outer[face]]
    edges = np.unique(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return Surface(points[first], triangles, edges, tuple(labels[k] for k in face[outer[face]]))
