"""Element sizes from CAD, before there is a mesh: from curvature, the thickness of walls, and interfaces.

A face with the radius of curvature R over a wall of thickness t bends like a notch or a shell: its strain changes over
lengths of about sqrt(R t), and nowhere within less than t. The thickness is the length of a ray from the face through
the CAD body to the opposite face.
The tractions of a remote point end at the outline of its interface, so strains change there over a share of its length.
Source: S. Timoshenko, S. Woinowsky-Krieger, Theory of Plates and Shells (1959), section 15, on the decay length.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nassim.base.checks import Array
from nassim.base.library_lock import hold_library_lock
from nassim.fem.faces import solid_triangles
from nassim.fem.solid import Solid

FINENESS = 0.5
"""Element size as a share of the length over which strains change."""
LARGEST_PER_RADIUS = 2.0
"""Largest element size as a multiple of the radius of curvature."""
LARGEST_PER_THICKNESS = 10.0
"""Largest element size as a multiple of the wall's thickness."""
ROUND_BAR = (1.8, 2.2)
"""Range of the thickness over the radius of curvature in which a wall counts as a round bar."""
LARGEST_PER_BAR = 0.7
"""Largest element size in a round bar as a share of its radius.

Where no vertex lies inside the bar, elements have two faces on its surface, and fold at the edge between these.
"""
LARGEST_PER_INTERFACE = 0.3
"""Largest element size on the faces of a remote point, as a share of the square root of their area."""
MOST_POINTS = 6000
"""Largest number of points per material at which the thickness is measured."""
RAYS_AT_ONCE = 100
PERPENDICULAR = 1e-6
"""Largest cosine of a right angle."""
THIN_SHARE = 0.25
"""Share of the sides of a body whose walls count as its thin ones."""


@dataclass(frozen=True)
class CADSizes:
    """Curvature and thickness at n points on the faces of a solid, which decide the sizes of elements there.

    Attributes:
        points: shape (n, 3) [m]
        normals: unit normals, shape (n, 3)
        radii: smallest radii of curvature, shape (n,) [m]
        thickness: lengths of the rays through the CAD body to the opposite face, shape (n,) [m]
        convex: whether the face curves around the material there, shape (n,)
    """

    points: Array
    normals: Array
    radii: Array
    thickness: Array
    convex: NDArray[np.bool_]

    def sizes(self, per_radius: float = LARGEST_PER_RADIUS, *, relaxed: float = 1.0) -> Array:
        """Return element sizes at the points.

        Args:
            per_radius: largest size as a multiple of the radius
            relaxed: factor on all sizes but those in round bars, which prevent folds

        Returns:
            Sizes, shape (n,) [m].
        """
        changes = np.maximum(np.sqrt(self.radii * self.thickness), self.thickness)
        limits = per_radius * self.radii, LARGEST_PER_THICKNESS * self.thickness
        sizes = relaxed * np.minimum(FINENESS * changes, np.minimum(*limits))
        thinnest, thickest = (share * self.radii for share in ROUND_BAR)
        bar = self.convex & (self.thickness > thinnest) & (self.thickness < thickest)
        return np.where(bar, np.minimum(sizes, LARGEST_PER_BAR * self.radii), sizes)

    def wall(self, k: int) -> float:
        """Return the thickness of the thin walls of a body that is extruded along axis k [m].

        A quarter of all points on the sides of the body have thinner walls.
        """
        sides = np.abs(self.normals[:, k]) < PERPENDICULAR
        return float(np.quantile(self.thickness[sides], THIN_SHARE))


def sizes_from_cad(solid: Solid) -> CADSizes:
    """Measure curvature and thickness at points on the faces of a solid.

    Faces between CAD bodies of one material, where nothing changes but the name, are left out.
    """
    groups: dict[str, list[Any]] = {}
    for body in solid.shape.solids:
        groups.setdefault(solid.materials[body.name].name, []).append(body)
    with hold_library_lock():
        parts = [_outside(bodies) for bodies in groups.values()]
    length = max(np.ptp(corners.reshape(-1, 3), axis=0).max() for corners, _ in parts)
    measured = [_measure(corners, normals, length) for corners, normals in parts]
    return CADSizes(*(np.concatenate(values) for values in zip(*measured, strict=True)))


def interface_sizes(solid: Solid) -> tuple[Array, Array]:
    """Return points on the faces of the remote points, shape (n, 3) [m], and element sizes there, shape (n,) [m]."""
    points, sizes = [np.zeros((0, 3))], [np.zeros(0)]
    with hold_library_lock():
        faces = dict.fromkeys(face for body in solid.shape.solids for face in body.faces)
        for point in solid.remote_points:
            interface = [face for face in faces if face.name in point.faces]
            size = LARGEST_PER_INTERFACE * np.sqrt(sum(face.mass for face in interface))
            grids = [_grid(corners, size) for face in interface for corners in solid_triangles(face)[0]]
            points += grids
            sizes += [np.full(len(grid), size) for grid in grids]
    return np.vstack(points), np.concatenate(sizes)


def _grid(corners: Array, distance: float) -> Array:
    """Return points of a triangle, shape (n, 3), no farther apart than a distance; corners: shape (3, 3)."""
    n = int(np.ceil(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max() / distance))
    i, j = (index.ravel() for index in np.indices((n + 1, n + 1)))
    inside = i + j <= n
    return np.column_stack([i, j, n - i - j])[inside] / n @ corners


def _outside(bodies: Sequence[Any]) -> tuple[Array, Array]:
    """Return the corners and normals of the triangles on faces of CAD bodies that do not lie between two of them."""
    n_bodies = Counter(face for body in bodies for face in body.faces)
    corners, normals = [], []
    for body in bodies:
        places, outward, face = solid_triangles(body)
        outside = np.array([n_bodies[face] == 1 for face in body.faces])[face]
        corners.append(places[outside])
        normals.append(outward[outside])
    return np.concatenate(corners), np.concatenate(normals)


def _measure(corners: Array, normals: Array, length: float) -> tuple[Array, Array, Array, Array, NDArray[np.bool_]]:
    """Return the fields of `CADSizes` on the triangles of CAD bodies of one material; length: that of the solid [m]."""
    edges = corners[:, [1, 2, 0]] - corners
    real = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) > 1e-14 * length**2
    corners, normals, edges = corners[real], normals[real], edges[real]
    extent = np.linalg.norm(edges, axis=2)
    turn = normals[:, [1, 2, 0]] - normals
    bend = np.max(np.linalg.norm(turn, axis=2) / np.maximum(extent, 1e-9 * length), axis=1)
    radius = np.copysign(1 / np.maximum(bend, 1e-3 / length), np.einsum("tij,tij->t", turn, edges))
    points, outward, radii = _samples(corners, normals, radius, length)
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    thickness = ray_lengths(points - 1e-6 * length * outward, -outward, corners)
    return points, outward, np.abs(radii), np.where(np.isfinite(thickness), thickness, length), radii > 0


def _samples(corners: Array, normals: Array, radius: Array, length: float) -> tuple[Array, Array, Array]:
    """Return points on triangles, their normals and radii of curvature; long triangles get several points.

    radius: of each triangle, negative where it is concave [m]
    """
    extent = np.linalg.norm(corners[:, [1, 2, 0]] - corners, axis=2)
    points, outward, radii = [], [], []
    for x, n, r, e in zip(corners, normals, radius, extent, strict=True):
        step = np.clip(0.35 * abs(r), 2e-3 * length, 0.05 * length)
        along = (np.arange(k := int(np.clip(np.ceil(e.max() / step), 1, 60))) + 0.5) / k
        across = [1 / 3] if e.min() < step else np.linspace(0.1, 0.9, int(min(np.ceil(e.min() / step) + 1, 30)))
        a, b, c = (np.arange(3) + np.argmax(e)) % 3  # from a to b is the longest edge
        points += [(1 - w) * (x[a] + along[:, None] * (x[b] - x[a])) + w * x[c] for w in across]
        outward += [(1 - w) * (n[a] + along[:, None] * (n[b] - n[a])) + w * n[c] for w in across]
        radii += [np.full(k * len(across), r)]
    result = np.vstack(points), np.vstack(outward), np.concatenate(radii)
    if len(result[2]) <= MOST_POINTS:
        return result
    chosen = np.random.default_rng(0).choice(len(result[2]), MOST_POINTS, replace=False)
    return result[0][chosen], result[1][chosen], result[2][chosen]


def ray_lengths(points: Array, directions: Array, corners: Array) -> Array:
    """Compute the distance from each point along its direction to the nearest triangle, inf where there is none.

    Args:
        points: shape (n, 3) [m]
        directions: unit vectors, shape (n, 3)
        corners: of the triangles, shape (m, 3, 3) [m]

    Returns:
        Distances, shape (n,) [m].

    Source: T. Möller, B. Trumbore, Fast, minimum storage ray-triangle intersection, J. Graphics Tools 2 (1997) 21-28.
    """
    a, e1, e2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(e1, e2)
    result = np.empty(len(points))
    for start in range(0, len(points), RAYS_AT_ONCE):
        part = slice(start, start + RAYS_AT_ONCE)
        d = directions[part]
        offset = points[part, None] - a[None]
        with np.errstate(all="ignore"):
            turned = np.cross(offset, d[:, None])
            volume = -(d @ across.T)
            u = np.einsum("ijk,jk->ij", turned, e2) / volume
            v = -np.einsum("ijk,jk->ij", turned, e1) / volume
            t = np.einsum("ijk,jk->ij", offset, across) / volume
            hit = (u > -1e-9) & (v > -1e-9) & (u + v < 1 + 1e-9) & (t > 0)
        result[part] = np.where(hit, t, np.inf).min(axis=1)
    return result
