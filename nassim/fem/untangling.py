"""Untangling of folded elements by motions of their nodes that keep the geometry.

The nodes inside the solid and those within plane CAD faces move until no element is folded. The map from each straight
element to its curved form has the Jacobian J. The nodes minimise, over points of all elements that may move,

    sum  |J|^2 / (3 chi^(2/3)) + (det(J)^2 + 1) / (2 chi),    chi = (det(J) + sqrt(det(J)^2 + eps^2)) / 2

The sum is smallest for straight elements. It is finite for folded ones, and for eps to zero it is infinite for these.

Source: V. Garanzha, I. Kaporin, L. Kudryavtseva, F. Protais, N. Ray, D. Sokolov, Foldover-free maps in 50 lines of
code, ACM Transactions on Graphics 40 (2021), no. 102.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import ngsolve as ng
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.optimize import minimize

from nassim.base.checks import Array
from nassim.fem.native_threads import share

Points = Mapping[Any, Sequence[tuple[float, float, float]]]
FLAT = 1e-7
"""Distance from a plane, relative to the extent of a face, below which the face is plane."""
AIM = 0.05
"""Smallest determinant relative to that of the straight element at which the motion ends."""
PIECES = 4
"""Number of pieces of the work."""
ROUNDS, STEPS = 12, 20
"""Largest number of values of eps, and of steps with each of them."""
SHARPNESS, SMALLEST_EPSILON = 0.2, 1e-3
"""Share of the most negative determinant that eps is, and its smallest value."""


def untangle(mesh: Any, order: int, folded: NDArray[np.bool_], points: Points) -> None:
    """Move the nodes of folded elements and their neighbours by a deformation of the mesh.

    Args:
        mesh: NGSolve mesh, curved or with a deformation, which gets another deformation
        order: polynomial order of the elements' edges
        folded: which elements are folded, shape (n_elements,)
        points: points of the reference element of each kind at which the determinants count
    """
    patch = _with_neighbours(mesh, folded)
    space, scalar = ng.VectorH1(mesh, order=order), ng.H1(mesh, order=order)
    field, deformation = ng.GridFunction(space), ng.GridFunction(space)
    field.Set(ng.CoefficientFunction((ng.x, ng.y, ng.z)), definedonelements=ng.BitArray(patch.tolist()))
    positions = field.vec.FV().NumPy().reshape(3, -1)
    before = mesh.deformation.vec.FV().NumPy() if mesh.deformation else 0.0
    # The functions of the vertices interpolate straight elements, and all others are zero in them.
    bends = positions.copy()
    bends[:, : mesh.nv] = 0.0
    motions = _free_motions(mesh, scalar, patch, bends)
    moving = np.unique(motions.indices % scalar.ndof)
    motions = motions[:, (moving + scalar.ndof * np.arange(3)[:, None]).ravel()]
    elements = np.array_split(np.flatnonzero(patch), PIECES)
    pieces = [_Slopes.of(mesh, scalar, part, points, positions, moving) for part in elements if len(part)]
    motion = np.zeros_like(positions)
    motion[:, moving] = (motions.T @ _amplitudes(pieces, motions)).reshape(3, -1)
    deformation.vec.FV().NumPy()[:] = before + motion.ravel()
    mesh.SetDeformation(deformation)


@dataclass(frozen=True)
class _Slopes:
    """Jacobians of the maps from straight elements at q points of some elements, by the motions of f scalar unknowns.

    Attributes:
        matrix: gradients along x, y and z of the moving functions at each point, sparse, shape (3 q, f) [1/m]
        still: Jacobians without motion, shape (q, 3, 3)
        weights: inverse number of the points of the element, shape (q,)
        determinants: of the Jacobian of the straight element, shape (q,) [m3]
        starts: first point of each element
    """

    matrix: sp.csr_matrix
    still: Array
    weights: Array
    determinants: Array
    starts: NDArray[np.int64]

    @staticmethod
    def of(
        mesh: Any,
        scalar: Any,
        elements: NDArray[np.int64],
        points: Points,
        positions: Array,
        moving: NDArray[np.int64],
    ) -> "_Slopes":
        """Evaluate the gradients in elements; positions without motion: shape (3, n) [m]; moving: their unknowns."""
        corners = np.array([vertex.point for vertex in mesh.vertices])
        linear = ng.H1(mesh, order=1)
        known: dict[Any, list[Array]] = {}
        values, unknowns, determinants = [], [], []
        for number in (ng.ElementId(ng.VOL, k) for k in elements.tolist()):
            vertices = [vertex.nr for vertex in mesh[number].vertices]
            # Elements whose vertices are numbered in the same sequence have the same shape functions.
            kind = (mesh[number].type, *np.argsort(vertices).tolist())
            if kind not in known:
                functions = [space.GetFE(number) for space in (scalar, linear)]
                known[kind] = [np.array([f.CalcDShape(*p).NumPy().T for p in points[kind[0]]]) for f in functions]
            slopes, straight = known[kind]
            jacobian = straight @ corners[vertices]
            values.append(np.linalg.inv(jacobian) @ slopes)
            unknowns.append(np.broadcast_to(list(scalar.GetDofNrs(number)), values[-1].shape))
            determinants.append(np.linalg.det(jacobian))
        counts = [len(part) for part in values]
        ends = np.cumsum([0, *np.concatenate([np.full(3 * len(part), part.shape[2]) for part in values])])
        entries = (np.concatenate([part.ravel() for part in group]) for group in (values, unknowns))
        matrix = sp.csr_matrix((*entries, ends), shape=(len(ends) - 1, scalar.ndof))
        return _Slopes(
            matrix[:, moving],
            (matrix @ positions.T).reshape(-1, 3, 3),
            np.repeat(1 / np.array(counts), counts),
            np.abs(np.concatenate(determinants)),
            np.cumsum([0, *counts[:-1]]),
        )

    def jacobians(self, motion: Array) -> Array:
        """Return the Jacobians, shape (q, 3, 3); motion: shape (f, 3) [m]."""
        result: Array = self.still + (self.matrix @ motion).reshape(-1, 3, 3)
        return result

    def energy(self, motion: Array, epsilon: float) -> tuple[float, Array]:
        """Return the sum to minimise, and its derivatives by the motion, shape (f, 3)."""
        values, derivatives = _distortion(self.jacobians(motion), epsilon)
        derivatives *= self.weights[:, None, None]
        return float(self.weights @ values), self.matrix.T @ derivatives.reshape(-1, 3)

    def smallest(self, motion: Array) -> Array:
        """Return the smallest determinant in each element, relative to its mean absolute value."""
        values = np.linalg.det(self.jacobians(motion)) * self.determinants
        return np.minimum.reduceat(values, self.starts) / np.add.reduceat(np.abs(values) * self.weights, self.starts)


def _amplitudes(pieces: Sequence[_Slopes], motions: sp.csr_matrix) -> Array:
    """Return the amplitudes of the motions that leave the fewest elements with a small determinant, shape (m,).

    Args:
        pieces: the elements
        motions: motions of the f moving unknowns, all along x, y and z in turn, shape (m, 3 f)
    """
    result = best = np.zeros(motions.shape[0])
    if not len(result):
        return result
    size = sum(piece.matrix.multiply(piece.matrix).T @ np.repeat(piece.weights, 3) for piece in pieces)
    scale = 1 / np.sqrt(motions.multiply(motions) @ np.tile(size, 3))

    def moved(amplitudes: Array) -> Array:
        return (motions.T @ amplitudes).reshape(3, -1).T

    fewest = sum(len(piece.starts) for piece in pieces) + 1
    for _ in range(ROUNDS):
        motion = moved(result)
        n_small = sum(int(np.sum(piece.smallest(motion) < AIM)) for piece in pieces)
        if n_small < fewest:
            best, fewest = result, n_small
        if not n_small:
            break
        lowest = min(np.linalg.det(piece.jacobians(motion)).min() for piece in pieces)
        epsilon = max(SMALLEST_EPSILON, -SHARPNESS * lowest)

        def energy(amplitudes: Array, epsilon: float = epsilon) -> tuple[float, Array]:
            motion = moved(scale * amplitudes)
            parts = share(partial(_Slopes.energy, motion=motion, epsilon=epsilon), pieces)
            values, forces = zip(*parts, strict=True)
            return sum(values), scale * (motions @ sum(forces).T.ravel())

        found = minimize(energy, result / scale, jac=True, method="L-BFGS-B", options={"maxiter": STEPS})
        result = scale * found.x
    return best


def _distortion(jacobians: Array, epsilon: float) -> tuple[Array, Array]:
    """Return the distortion of maps with some Jacobians, shape (q,), and its derivatives by these, (q, 3, 3)."""
    a, b, c = jacobians.swapaxes(0, 1)
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    determinant = np.einsum("qi,qi->q", a, cofactors[:, 0])
    root = np.sqrt(determinant**2 + epsilon**2)
    chi = 0.5 * (determinant + root)
    shape = np.einsum("qij,qij->q", jacobians, jacobians) / (3 * chi ** (2 / 3))
    volume = (determinant**2 + 1) / (2 * chi)
    # The derivative of chi by the determinant is chi / root.
    by_determinant = determinant / chi - (2 / 3 * shape + volume) / root
    derivatives = (2 / 3 / chi ** (2 / 3))[:, None, None] * jacobians + by_determinant[:, None, None] * cofactors
    return shape + volume, derivatives


def _with_neighbours(mesh: Any, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return chosen elements and all others that share a vertex with them."""
    vertices = [[vertex.nr for vertex in element.vertices] for element in mesh.Elements(ng.VOL)]
    element = np.repeat(np.arange(len(vertices)), [len(numbers) for numbers in vertices])
    vertex = np.concatenate(vertices)
    touched = np.zeros(mesh.nv, dtype=bool)
    touched[vertex[chosen[element]]] = True
    return np.bincount(element, weights=touched[vertex]) > 0


def _free_motions(mesh: Any, scalar: Any, patch: NDArray[np.bool_], curved: Array) -> sp.csr_matrix:
    """Return the motions of nodes that keep the geometry, as rows, shape (m, 3 n).

    Nodes inside move in all directions and nodes of one plane CAD face within it. Nodes of curved faces and of edges
    between faces do not move, nor do nodes that elements outside the patch share.

    Args:
        mesh: NGSolve mesh with straight elements
        scalar: its H1 space, of n unknowns
        patch: elements that may move
        curved: displacements from straight to curved elements, shape (3, n)
    """
    around = _with_neighbours(mesh, patch) & ~patch
    inside, outside = (unknowns_of(mesh, scalar, elements) for elements in (patch, around))
    n_faces = np.zeros(scalar.ndof, dtype=np.int64)
    normals = np.zeros((scalar.ndof, 3))
    for normal, unknowns in _faces(mesh, scalar, curved):
        n_faces[unknowns] += 1 if normal is not None else 2
        normals[unknowns] = 0.0 if normal is None else normal
    free = np.flatnonzero(inside & ~outside & (n_faces < 2))
    within = free[n_faces[free] == 1]
    anywhere = free[n_faces[free] == 0]
    # Two directions that are perpendicular to a normal and to each other: rows of the SVD of the normal as a matrix.
    tangents = np.linalg.svd(normals[within][:, None])[2][:, 1:]
    rows = np.concatenate([np.eye(3)[None].repeat(len(anywhere), axis=0).reshape(-1, 3), tangents.reshape(-1, 3)])
    unknowns = np.concatenate([np.repeat(anywhere, 3), np.repeat(within, 2)])
    columns = unknowns[:, None] + scalar.ndof * np.arange(3)
    starts = 3 * np.arange(len(rows) + 1)
    result = sp.csr_matrix((rows.ravel(), columns.ravel(), starts), shape=(len(rows), 3 * scalar.ndof))
    result.eliminate_zeros()
    return result


def unknowns_of(mesh: Any, scalar: Any, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which scalar unknowns belong to chosen elements."""
    result = np.zeros(scalar.ndof, dtype=bool)
    for number in np.flatnonzero(chosen).tolist():
        result[list(scalar.GetDofNrs(ng.ElementId(ng.VOL, number)))] = True
    return result


def _faces(mesh: Any, scalar: Any, curved: Array) -> list[tuple[Array | None, NDArray[np.int64]]]:
    """Return the normal of each CAD face, None for a curved one, and the scalar unknowns on it."""
    points = np.array([vertex.point for vertex in mesh.vertices])
    elements: dict[int, list[Any]] = {}
    for element in mesh.Elements(ng.BND):
        elements.setdefault(element.index, []).append(element)
    result: list[tuple[Array | None, NDArray[np.int64]]] = []
    for members in elements.values():
        unknowns = np.unique(np.concatenate([list(scalar.GetDofNrs(element)) for element in members]))
        corners = points[unknowns[unknowns < mesh.nv]]
        extents, directions = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)[1:]
        # The corners of a narrow cylinder lie in a plane; its curved edges do not.
        height = max(extents[2], np.abs(directions[2] @ curved[:, unknowns]).max())
        result.append((directions[2] if height < FLAT * extents[0] else None, unknowns))
    return result
