"""Faces of a CAD object as triangles, for images without a mesh."""

import netgen.occ as occ
import numpy as np

from nassim.base.checks import Array
from nassim.base.library_lock import hold_library_lock
from nassim.bodies.readouts import Surface
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
    corners: list[Array] = []
    numbers: list[Array] = []
    labels: list[str] = []
    middles: list[tuple[float, ...]] = []
    with hold_library_lock(forkable=True):
        for body in solid.shape.solids:
            drawing, faces = occ.OCCGeometry(body)._visualizationData(), list(body.faces)
            corners.append(np.asarray(drawing["vertices"], dtype=float).reshape(-1, 3))
            numbers.append(np.asarray(drawing["indices"], dtype=int) + len(middles))
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
