"""Elements of a mesh at points of its solid, and the nodes of elements, as points at which NGSolve evaluates fields."""

from collections.abc import Callable
from typing import Any, NamedTuple

import netgen.occ as occ
import ngsolve as ng
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nassim.base.checks import Array, known
from nassim.fem.cad_files import millimetres
from nassim.fem.solid import Solid, body_names

INSIDE: dict[Any, Callable[[int, int, int, int], bool]] = {
    ng.ET.TET: lambda i, j, k, p: i + j + k <= p,
    ng.ET.PRISM: lambda i, j, k, p: i + j <= p,
    ng.ET.PYRAMID: lambda i, j, k, p: max(i, j) + k <= p,
    ng.ET.HEX: lambda i, j, k, p: True,
}
"""Which nodes (i, j, k) / p of a unit cube belong to the reference element of each type, as NGSolve defines it.

The same exponents give the monomials x^i y^j z^k whose interpolation at these nodes is unique.
"""
NEAR = 1e-3
"""Distance from the solid, over the size of an element, up to which a point counts as one of it."""
NUDGES = (1e-6, 1e-4, 1e-2, 0.03, 0.1)
"""Distances, over the size of an element, at which elements around a point are looked for: a mesh is not the solid."""
ENLARGED = 1e3
"""Size to which a solid is enlarged. OpenCASCADE does not recognise points as inside that are less than 1e-3 units from
the surface."""
DIRECTIONS = 200
"""Number of directions in which they are looked for."""


class ElementPoints(NamedTuple):
    """Points in elements: coordinates in the reference element (k, 3), and numbers of the elements (k,)."""

    reference: Array
    elements: NDArray[np.int64]


class ElementFinder:
    """Finder of the elements at points of a mesh."""

    def __init__(self, mesh: Any, solid: Solid) -> None:
        self.mesh, self.solid = mesh, solid
        self.bodies = cad_bodies(mesh)
        self.scale = ENLARGED / np.ptp([tuple(c) for c in solid.shape.bounding_box], axis=0).max()
        self.enlarged = [(s.name, s.Scale(occ.Pnt(0, 0, 0), self.scale)) for s in solid.shape.solids]
        elements = list(mesh.Elements(ng.VOL))
        self.types = np.array([int(e.type) for e in elements])
        self.kinds = {int(e.type): e.type for e in elements}
        corners = [[v.nr for v in e.vertices] for e in elements]
        places = (np.repeat(np.arange(len(corners)), [len(c) for c in corners]), np.concatenate(corners))
        self.corners = sp.csr_matrix((np.ones(len(places[0])), places), shape=(len(corners), mesh.nv))
        self.vertices = np.array([mesh[ng.NodeId(ng.VERTEX, k)].point for k in range(mesh.nv)])
        self.tree = cKDTree(self.vertices)
        # Fibonacci's lattice spreads directions evenly over the sphere.
        k = np.arange(DIRECTIONS) + 0.5
        polar, turn = np.arccos(1 - 2 * k / DIRECTIONS), np.pi * (1 + np.sqrt(5)) * k
        self.around = np.column_stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)])

    def size(self, place: Array) -> float:
        """Return the size of the elements at the vertex nearest to a place [m]."""
        _, vertex = self.tree.query(place)
        element = self.corners[:, vertex].nonzero()[0][0]
        return float(np.linalg.norm(np.ptp(self.vertices[self.corners[element].indices], axis=0)))

    def find(self, label: str, place: Array, cad_body: str = "") -> ElementPoints:
        """Find a point in an element at or beside a place.

        Raises:
            ValueError: for a place outside the solid, and for one where several CAD bodies meet without a cad_body
        """
        if cad_body:
            known(f"CAD body of {label}", cad_body, body_names(self.solid.shape))
        size = self.size(place)
        self._check_inside(label, place, cad_body, NEAR * size)
        found = None
        for step in (0.0, *NUDGES):
            tried = place + step * size * (self.around if step else np.zeros((1, 3)))
            points = self.mesh(*np.ascontiguousarray(tried.T))
            elements = points["nr"].astype(np.int64)
            inside = elements >= 0
            names = np.unique(self.bodies[elements[inside]])
            if not cad_body and step <= NUDGES[1] and len(names) > 1:
                raise ValueError(
                    f"{label} at {millimetres(place)} lies where the CAD bodies {', '.join(names)} meet, whose "
                    "stresses differ: give its cad_body"
                )
            inside[inside] = self.bodies[elements[inside]] == cad_body if cad_body else True
            if inside.any() and found is None:
                k = np.flatnonzero(inside)[0]
                found = ElementPoints(np.array([[points[axis][k] for axis in "xyz"]]), elements[k : k + 1])
            if found is not None and (cad_body or len(self.solid.materials) == 1 or step >= NUDGES[1]):
                return found
        raise ValueError(
            f"{label} at {millimetres(place)} lies in no element of the mesh, which misses a part of the solid there: "
            "make the elements smaller there (local_sizes, curvature), or move the point"
        )

    def _check_inside(self, label: str, place: Array, cad_body: str, near: float) -> None:
        """Check that a place is no farther from the solid, or from one of its CAD bodies, than some distance [m]."""
        shapes = [shape for name, shape in self.enlarged if cad_body in ("", name)]
        apart = min(distance(shape, self.scale * place) for shape in shapes) / self.scale
        if apart <= near:
            return
        number = self.mesh(*map(float, place)).nr
        if number < 0 or cad_body not in ("", self.bodies[number]):
            of = f"CAD body {cad_body!r}" if cad_body else f"solid {self.solid.name!r}"
            raise ValueError(
                f"{label} at {millimetres(place)} lies outside {of}, {1e3 * apart:.3g} mm from it; give a point inside "
                "or on its surface, in metres and in the frame of its CAD"
            )

    def around_element(self, element: int) -> NDArray[np.int64]:
        """Return the elements of the same CAD body that share a vertex with an element, itself included."""
        neighbours = (self.corners @ self.corners[element].T).nonzero()[0]
        return neighbours[self.bodies[neighbours] == self.bodies[element]]

    def nodes(self, elements: NDArray[np.int64], order: int) -> ElementPoints:
        """Return the nodes of an order of elements as samples."""
        parts = []
        for number, kind in self.kinds.items():
            chosen = elements[self.types[elements] == number]
            local = lattice(kind, order) / order
            parts.append((np.tile(local, (len(chosen), 1)), np.repeat(chosen, len(local))))
        return ElementPoints(np.vstack([p for p, _ in parts]), np.concatenate([e for _, e in parts]))

    def positions(self, samples: ElementPoints) -> Array:
        """Return the positions of samples, shape (k, 3) [m]."""
        return ng.CoefficientFunction((ng.x, ng.y, ng.z))(mesh_points(self.mesh, samples))


def distance(shape: Any, place: Array) -> float:
    """Return the distance of a place from a CAD shape, 0 inside a solid [m]."""
    return float(shape.Distance(occ.Vertex(occ.Pnt(*map(float, place)))))


def lattice(kind: Any, order: int) -> NDArray[np.int64]:
    """Return the nodes of a reference element times the order, which are exponents of its monomials, shape (k, 3)."""
    inside, span = INSIDE[kind], range(order + 1)
    return np.array([(i, j, k) for i in span for j in span for k in span if inside(i, j, k, order)])


def cad_bodies(mesh: Any) -> NDArray[np.str_]:
    """Return the names of the elements' CAD bodies."""
    names = np.array(mesh.GetMaterials())
    return names[np.array([e.index for e in mesh.Elements(ng.VOL)])]


def mesh_points(mesh: Any, samples: ElementPoints) -> Any:
    """Return samples as NGSolve's array of points."""
    pattern = mesh.MapToAllElements(ng.IntegrationRule([(0.25, 0.25, 0.25)], [1.0]), ng.VOL)[:1]
    points = np.repeat(pattern, len(samples.elements))
    for k, axis in enumerate("xyz"):
        points[axis] = samples.reference[:, k]
    points["nr"] = samples.elements
    return points
