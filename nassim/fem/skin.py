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
    sides: list[list[tuple[int, int, int]]] = []  # per face, in the order around it: corner, edge, next corner
    labels = []
    for element in mesh.Elements(ng.BND):
        if between[element.index]:
            continue
        corners, edges = [v.nr for v in element.vertices], [e.nr for e in element.edges]
        passed = [edges[k] for k in EDGES_AROUND[len(corners)]]
        sides.append(list(zip(corners, passed, [*corners[1:], corners[0]], strict=True)))
        labels.append(label_of[element.index])
    around = np.array([side for face in sides for side in face])
    vertex = np.unique(around[:, 0])
    edge, first = np.unique(around[:, 1], return_index=True)
    vertex_row = dict(zip(vertex.tolist(), range(len(vertex)), strict=True))
    edge_row = dict(zip(edge.tolist(), range(len(vertex), len(vertex) + len(edge)), strict=True))
    triangles, triangle_labels, halves = [], [], []
    for face, label in zip(sides, labels, strict=True):
        ring = [(vertex_row[a], edge_row[e], vertex_row[b]) for a, e, b in face]
        middles = [e for _, e, _ in ring]
        pieces = [(a, e, middles[k - 1]) for k, (a, e, _) in enumerate(ring)]
        pieces += [(middles[0], middles[k], middles[k + 1]) for k in range(1, len(middles) - 1)]
        triangles += pieces
        triangle_labels += [label] * len(pieces)
        halves += [pair for a, e, b in ring for pair in ((a, e), (e, b))]
    at_midpoints = _at_midpoints(scalar, edge, around[first][:, [0, 2]])
    evaluation = sp.vstack([_at_vertices(scalar, vertex), at_midpoints], format="csr")
    surface = Surface(
        points=(evaluation @ fields[1:].T),
        triangles=np.array(triangles),
        edges=np.unique(np.sort(halves, axis=1), axis=0),
        labels=tuple(triangle_labels),
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
