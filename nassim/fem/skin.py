"""Outer surface of a mesh as triangles, for images of bodies and modes."""

from typing import Any

import ngsolve as ng
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from nassim.base.checks import Array
from nassim.bodies.readouts import Surface
from nassim.fem.solid import Solid

EDGES_AROUND = {3: (2, 1, 0), 4: (0, 3, 1, 2)}
"""Indices of a triangle's or quadrilateral's edges, as NGSolve lists them, in the order around the element."""


def outer_surface(mesh: Any, scalar: Any, fields: Array, solid: Solid) -> tuple[Surface, sp.csr_matrix]:
    """Triangulate the outer faces of a mesh. The midpoints of edges are corners too and show the curvature.

    Args:
        mesh: NGSolve mesh of `solid`
        scalar: its H1 space
        fields: coefficients of 1, x, y, z in this space, shape (4, n)
        solid: the solid

    Returns:
        The surface, and the sparse matrix (n_points, n) that evaluates a scalar field at its points.
    """
    owner = {face: point.name for point in solid.remote_points for face in point.faces}
    materials = mesh.GetMaterials()
    descriptors = [mesh.ngmesh.FaceDescriptor(k + 1) for k in range(mesh.ngmesh.GetNFaceDescriptors())]
    between = [face.domin and face.domout for face in descriptors]
    label_of = [owner.get(face.bcname, materials[max(face.domin, face.domout) - 1]) for face in descriptors]
    outer = [element for element in mesh.Elements(ng.BND) if not between[element.index]]
    n_corners = np.array([len(element.vertices) for element in outer])
    n_pieces = 2 * n_corners - 2
    corner = np.concatenate([[vertex.nr for vertex in element.vertices] for element in outer])
    passed = np.concatenate([[edge.nr for edge in element.edges] for element in outer])
    vertex, edge = np.unique(corner), np.unique(passed)
    triangles = np.empty((n_pieces.sum(), 3), dtype=np.int64)
    halves, ends = [], np.empty((len(edge), 2), dtype=np.int64)
    for sides, order in EDGES_AROUND.items():
        alike = n_corners == sides
        corners, edges = (part[np.repeat(alike, n_corners)].reshape(-1, sides) for part in (corner, passed))
        edges = edges[:, order]
        following = np.roll(corners, -1, axis=1)
        ends[np.searchsorted(edge, edges)] = np.stack([corners, following], axis=2)
        corners, following = np.searchsorted(vertex, corners), np.searchsorted(vertex, following)
        middles = len(vertex) + np.searchsorted(edge, edges)
        pieces = [np.stack([corners[:, k], middles[:, k], middles[:, k - 1]], axis=1) for k in range(sides)]
        pieces += [middles[:, [0, k, k + 1]] for k in range(1, sides - 1)]
        triangles[np.repeat(alike, n_pieces)] = np.stack(pieces, axis=1).reshape(-1, 3)
        halves += [np.stack([corners, middles], axis=2), np.stack([middles, following], axis=2)]
    at_midpoints = _at_midpoints(scalar, edge, ends)
    evaluation = sp.vstack([_at_vertices(scalar, vertex), at_midpoints], format="csr")
    surface = Surface(
        points=(evaluation @ fields[1:].T),
        triangles=triangles,
        edges=np.unique(np.sort(np.vstack([half.reshape(-1, 2) for half in halves]), axis=1), axis=0),
        labels=tuple(
            label_of[element.index] for element, count in zip(outer, n_pieces, strict=True) for _ in range(count)
        ),
    )
    return surface, evaluation


def triangle_faces(mesh: Any) -> tuple[NDArray[np.str_], NDArray[np.str_]]:
    """Return the CAD body and the face, by name, of every triangle of `outer_surface`, in its order.

    Args:
        mesh: NGSolve mesh
    """
    materials = mesh.GetMaterials()
    descriptors = [mesh.ngmesh.FaceDescriptor(k + 1) for k in range(mesh.ngmesh.GetNFaceDescriptors())]
    bodies, faces = [], []
    for element in mesh.Elements(ng.BND):
        face = descriptors[element.index]
        if not (face.domin and face.domout):
            pieces = 2 * len(element.vertices) - 2
            bodies += [materials[max(face.domin, face.domout) - 1]] * pieces
            faces += [face.bcname] * pieces
    return np.array(bodies), np.array(faces)


def _at_vertices(scalar: Any, vertices: NDArray[np.int64]) -> sp.csr_matrix:
    """Return the sparse matrix that evaluates a scalar field at vertices."""
    n = len(vertices)
    return sp.csr_matrix((np.ones(n), (np.arange(n), vertices)), shape=(n, scalar.ndof))


def _at_midpoints(scalar: Any, edges: NDArray[np.int64], ends: NDArray[np.int64]) -> sp.csr_matrix:
    """Return the sparse matrix for midpoints of edges: mean of the end values plus the edge's own functions."""
    order = scalar.globalorder
    own = scalar.mesh.nv + edges[:, None] * (order - 1) + np.arange(order - 1)
    columns = np.hstack([ends, own])
    values = np.tile(np.concatenate([[0.5, 0.5], _edge_functions_at_midpoint(order)]), (len(edges), 1))
    rows = np.repeat(np.arange(len(edges)), order + 1)
    return sp.csr_matrix((values.ravel(), (rows, columns.ravel())), shape=(len(edges), scalar.ndof))


def _edge_functions_at_midpoint(order: int) -> Array:
    """Return the values of NGSolve's order - 1 edge functions at the midpoint of their edge."""
    mesh = ng.Mesh(ng.unit_square.GenerateMesh(maxh=2.0))
    probe = ng.GridFunction(ng.H1(mesh, order=order))
    ends = [mesh[v].point for v in mesh.edges[0].vertices]
    middle = mesh(*(0.5 * (p + q) for p, q in zip(*ends, strict=True)))
    values = []
    for dof in probe.space.GetDofNrs(ng.NodeId(ng.EDGE, 0)):
        probe.vec[:] = 0.0
        probe.vec[dof] = 1.0
        values.append(probe(middle))
    return np.array(values)
