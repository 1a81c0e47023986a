"""Curved elements without folds.

Netgen curves the edges and faces of elements on curved CAD faces, and leaves their other edges straight. If an element
is flatter than the curvature of its face, the determinant of its Jacobian has both signs: the element is folded. Folded
elements count some of the volume twice, and other programs refuse them. Here the nodes inside the solid and those
within plane CAD faces move like nodes of an elastic body whose curved faces are displaced from flat to curved. The
geometry of the CAD remains. Where that is not enough, elements get quadratic edges, and at last straighter ones.

Source: P.-O. Persson, J. Peraire, Curved mesh generation and mesh refinement using Lagrangian solid mechanics, AIAA
2009-949.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import ngsolve as ng
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from nassim.base.checks import Array
from nassim.fem.solver import factorize, threads
from nassim.fem.sparse import symmetric_matrix

ORIENTATION = {ng.ET.TET: 1.0, ng.ET.PRISM: -1.0, ng.ET.PYRAMID: -1.0, ng.ET.HEX: -1.0}
"""Sign of the Jacobian's determinant in valid elements, with Netgen's order of the vertices."""
DIVISIONS = 4
"""Divisions of an element's edges by the sample points, which include vertices and midpoints of edges."""
SMALLEST_DETERMINANT = 0.01
"""Smallest determinant of a valid element relative to its mean, a margin for points between the samples."""
FLAT = 1e-7
"""Distance from a plane, relative to the extent of a face, below which the face is plane."""
RINGS = 2
"""Layers of neighbours that move with a folded element."""
SOFTEST = 0.05
STEPS = (1, 4)
"""Numbers of steps in which the curved faces are displaced, in the order of trial."""
QUADRATIC = 2
SMALLEST_CURVATURE = 0.2
"""Share of its curvature below which an edge of a folded element becomes straight."""
PLACES_TOLD = 3


@dataclass(frozen=True)
class Curving:
    """Record of how a mesh was curved.

    Attributes:
        n_elements: number of elements
        n_folded: number of elements that folded on Netgen's curved faces
        left: indices of the elements that no motion of inner nodes could mend
        corners: their corners, one element after the other, shape (m, 3) [m]
        sizes: shortest edge of the element of each corner, shape (m,) [m]
        displacement: largest normal displacement of the faces by `reduce_curvature` [m]
        n_straightened: number of elements that this gave straighter edges
    """

    n_elements: int
    n_folded: int
    left: NDArray[np.int64]
    corners: Array
    sizes: Array
    displacement: float = 0.0
    n_straightened: int = 0

    def __str__(self) -> str:
        """Describe the folded elements and their mending; '' if no element folded."""
        if not self.n_folded:
            return ""
        mended = "all mended by moving inner nodes"
        if self.displacement:
            straighter = f" and straighter edges of {self.n_straightened}" if self.n_straightened else ""
            moves = f"which moves curved faces by up to {1e6 * self.displacement:.3g} um"
            mended = f"{len(self.left)} mended by quadratic edges of all elements{straighter}, {moves}"
        elif len(self.left):
            mended = f"{len(self.left)} are still folded"
        return f"{self.n_folded} of {self.n_elements} curved elements folded, {mended}"

    @property
    def places_text(self) -> str:
        """Places of some of the elements that could not be mended, as text."""
        corners = np.unique(self.corners, axis=0)
        told = ["({:.4g}, {:.4g}, {:.4g})".format(*corner) for corner in corners[:: len(corners) // PLACES_TOLD]]
        return ", ".join(told[:PLACES_TOLD]) + " m"


def folded_elements(mesh: Any) -> NDArray[np.bool_]:
    """Return which elements of an NGSolve mesh are folded or inverted.

    The determinant of the Jacobian is evaluated at vertices, edges, faces and inside, and where matrices are
    integrated. An element counts as folded if the smallest value is below 1 % of the mean.

    Args:
        mesh: NGSolve mesh of tetrahedra, prisms, pyramids and hexahedra, curved or not, also with a deformation

    Returns:
        True for folded elements, shape (n_elements,).
    """
    return _smallest_determinants(mesh, np.ones(mesh.ne, dtype=bool)) < SMALLEST_DETERMINANT


def curve_mesh(mesh: Any, order: int) -> Curving:
    """Curve the elements of a mesh along its CAD faces, and mend those that fold.

    Meshes with other elements than tetrahedra have straight elements and a deformation (`mesh.deformation`) that curves
    them; others have a deformation around mended elements only. To mesh anew where elements are still
    folded, with smaller elements there, use the corners and sizes of the record.

    Args:
        mesh: NGSolve mesh from CAD, which is changed
        order: polynomial order of the elements' edges

    Returns:
        How many elements folded and which are still folded.
    """
    _curve(mesh, order)
    folded = folded_elements(mesh)
    n_folded = int(folded.sum())
    if n_folded and order > 1:
        _mend(mesh, order, folded)
        folded = folded_elements(mesh)
    left = np.flatnonzero(folded)
    corners, sizes = [np.zeros((0, 3))], [np.zeros(0)]
    for number in left.tolist():
        corners.append(np.array([mesh[v].point for v in mesh[ng.ElementId(ng.VOL, number)].vertices]))
        sizes.append(np.full(len(corners[-1]), pdist(corners[-1]).min()))
    return Curving(mesh.ne, n_folded, left, np.vstack(corners), np.concatenate(sizes))


def reduce_curvature(mesh: Any, order: int, curving: Curving) -> Curving:
    """Unfold the elements that `curve_mesh` could not mend, by faces that are less curved than those of the CAD.

    First all elements get quadratic edges, of which far fewer fold. Elements that still fold get straighter edges.

    Args:
        mesh: NGSolve mesh, which is changed
        order: polynomial order of the elements' edges that `curve_mesh` used
        curving: record of `curve_mesh`

    Returns:
        The record with the displacement of the faces and the number of straightened elements.
    """
    if not len(curving.left):
        return curving
    _curve(mesh, order)
    wanted = _positions(mesh, order)
    curve_mesh(mesh, min(order, QUADRATIC))
    n_straightened = _straighten(mesh, min(order, QUADRATIC))
    change = _positions(mesh, order)
    change.vec.data -= wanted.vec
    return replace(curving, n_straightened=n_straightened, displacement=_largest_across_faces(mesh, change))


def _curve(mesh: Any, order: int) -> None:
    """Curve the elements of a mesh along its CAD faces, without a gap between them.

    With isoparametric elements or a lower curvature order, the unknowns represent rigid motions exactly.

    Where it maps several points at once, as for all matrices, NGSolve also bends faces of curved prisms that lie inside
    the solid, in one of their two elements only. Meshes with such elements get their positions point by point, and are
    then straight elements with a deformation.
    """
    mesh.UnsetDeformation()
    mesh.Curve(order)
    if order == 1 or all(element.type == ng.ET.TET for element in mesh.Elements(ng.VOL)):
        return
    space, scalar = ng.VectorH1(mesh, order=order), ng.H1(mesh, order=order)
    deformation = ng.GridFunction(space)
    values = deformation.vec.FV().NumPy().reshape(3, -1)
    points = {kind: _sample_points(kind, order) for kind in ORIENTATION}
    elements = [ng.ElementId(ng.VOL, number) for number in np.flatnonzero(_curved_elements(mesh)).tolist()]
    # The functions of a pyramid do not contain its mapping: on its faces, its neighbours decide.
    elements.sort(key=lambda one: mesh[one].type != ng.ET.PYRAMID)
    for element in elements:
        kind, mapping, functions = mesh[element].type, mesh.GetTrafo(element), scalar.GetFE(element)
        positions = np.array([mapping(*point).point for point in points[kind]])
        shapes = np.array([functions.CalcShape(*point) for point in points[kind]])
        corners = np.array([mesh[vertex].point for vertex in mesh[element].vertices])
        n = len(corners)  # the first functions, those of the vertices, are the straight element
        bend = np.linalg.lstsq(shapes[:, n:], positions - shapes[:, :n] @ corners, rcond=None)[0]
        values[:, list(scalar.GetDofNrs(element))[n:]] = bend.T
    mesh.Curve(1)
    mesh.SetDeformation(deformation)


def _curved_elements(mesh: Any) -> NDArray[np.bool_]:
    """Return which elements of a mesh are curved, shape (n_elements,)."""
    result = np.zeros(mesh.ne, dtype=bool)
    linear, vertices = ng.H1(mesh, order=1), np.array([vertex.point for vertex in mesh.vertices])
    members: dict[Any, list[Any]] = {}
    for element in mesh.Elements(ng.VOL):
        members.setdefault(element.type, []).append(element)
    for kind, elements in members.items():
        points = _sample_points(kind, mesh.GetCurveOrder())
        mapped = mesh.MapToAllElements(_rules(kind, points), ng.VOL).ravel()
        positions = ng.CoefficientFunction((ng.x, ng.y, ng.z))(mapped).reshape(-1, len(points), 3)
        functions = linear.GetFE(ng.ElementId(elements[0]))
        shapes = np.array([functions.CalcShape(*point) for point in points])
        corners = vertices[[[vertex.nr for vertex in element.vertices] for element in elements]]
        bend = np.abs(positions - shapes @ corners).max(axis=(1, 2))
        result[[element.nr for element in elements]] = bend > FLAT * np.ptp(corners, axis=1).max(axis=1)
    return result


def _positions(mesh: Any, order: int) -> Any:
    """Return the positions in the elements of a mesh, curved and deformed, as an NGSolve function of an order."""
    # One space of three components takes a fifth of the time of `VectorH1`.
    result = ng.GridFunction(ng.H1(mesh, order=order, dim=3))
    result.Set(ng.CoefficientFunction((ng.x, ng.y, ng.z)))
    return result


def _straighten(mesh: Any, order: int) -> int:
    """Halve the motion of folded elements from straight ones until none is folded, at last to zero.

    Returns:
        Number of elements that were folded.
    """
    folded = folded_elements(mesh)
    changed = folded.copy()
    if not folded.any():
        return 0
    scalar, space = ng.H1(mesh, order=order), ng.VectorH1(mesh, order=order)
    # The functions of the vertices are the straight element, but for vertices that `_mend` moved.
    motion = _positions(mesh, order).vec.FV().NumPy().reshape(-1, 3).T.copy()
    motion[:, : mesh.nv] -= np.array([vertex.point for vertex in mesh.vertices]).T
    deformation = ng.GridFunction(space)
    correction = deformation.vec.FV().NumPy().reshape(3, -1)
    before = mesh.deformation.vec.FV().NumPy().reshape(3, -1).copy() if mesh.deformation else 0 * motion
    share = np.ones(scalar.ndof)
    mesh.SetDeformation(deformation)
    while folded.any() and share[unknowns := _unknowns(mesh, scalar, folded)].any():
        share[unknowns] = np.where(share[unknowns] > SMALLEST_CURVATURE, 0.5 * share[unknowns], 0.0)
        correction[:] = before + (share - 1) * motion
        folded = folded_elements(mesh)
        changed |= folded
    return int(changed.sum())


def _largest_across_faces(mesh: Any, field: Any) -> float:
    """Return the largest normal component of a vector field on the faces of a mesh.

    Nodes that slide along a face do not change the geometry.
    """
    points = {kind: ng.IntegrationRule(kind, 2 * field.space.globalorder) for kind in (ng.ET.TRIG, ng.ET.QUAD)}
    mapped = mesh.MapToAllElements(points, ng.BND)
    return float(np.abs(np.sum(field(mapped) * ng.specialcf.normal(3)(mapped), axis=1)).max())


def _rules(kind: Any, points: Sequence[tuple[float, float, float]]) -> dict[Any, Any]:
    """Return integration rules without weights: these points in elements of one kind, none in others."""
    return dict.fromkeys(ORIENTATION, ng.IntegrationRule([], [])) | {
        kind: ng.IntegrationRule(list(points), [0.0] * len(points))
    }


def _sample_points(kind: Any, n: int = DIVISIONS) -> list[tuple[float, float, float]]:
    """Return the points of a lattice with all vertices in the reference element, without the apex of a pyramid.

    n: divisions of an edge
    """
    steps = np.arange(n + 1)
    lattice = np.array([(i, j, k) for i in steps for j in steps for k in steps]) / n
    x, y, z = lattice.T
    inside = {
        ng.ET.TET: x + y + z <= 1,
        ng.ET.PRISM: x + y <= 1,
        ng.ET.PYRAMID: z < 1,  # all of the top face is one point, where the Jacobian is singular
        ng.ET.HEX: z <= 1,
    }[kind]
    points = lattice[inside]
    if kind == ng.ET.PYRAMID:
        points[:, :2] *= 1 - points[:, 2:]
    return [tuple(point) for point in points.tolist()]


def _smallest_determinants(mesh: Any, chosen: NDArray[np.bool_]) -> Array:
    """Return the smallest determinant of the Jacobian in chosen elements, relative to its mean absolute value."""
    order = max(2, mesh.GetCurveOrder(), mesh.deformation.space.globalorder if mesh.deformation else 1)
    kinds = [element.type for element in mesh.Elements(ng.VOL)]
    result = np.empty(mesh.ne)
    for kind, sign in ORIENTATION.items():
        members = np.array([other == kind for other in kinds])
        if not members.any():
            continue
        points = [*_sample_points(kind), *ng.IntegrationRule(kind, 2 * order - 2).points]
        mapped = mesh.MapToAllElements(_rules(kind, points), ng.VOL).reshape(-1, len(points))[chosen[members]]
        values = sign * ng.Det(ng.specialcf.JacobianMatrix(3))(mapped.ravel()).reshape(mapped.shape)
        result[members & chosen] = values.min(axis=1) / np.abs(values).mean(axis=1)
    return result[chosen]


def _mend(mesh: Any, order: int, folded: NDArray[np.bool_]) -> None:
    """Move the nodes of folded elements and their neighbours by a deformation of the mesh."""
    patch = _with_neighbours(mesh, folded, RINGS)
    chosen = ng.BitArray(patch.tolist())
    space, scalar = ng.VectorH1(mesh, order=order), ng.H1(mesh, order=order)
    moved, deformation = ng.GridFunction(space), ng.GridFunction(space)
    moved.Set(ng.CoefficientFunction((ng.x, ng.y, ng.z)), definedonelements=chosen)
    displacement, correction = (field.vec.FV().NumPy() for field in (moved, deformation))
    base = mesh.deformation.vec.FV().NumPy().copy() if mesh.deformation else np.zeros(space.ndof)
    curved_order = mesh.GetCurveOrder()
    mesh.UnsetDeformation()
    # The functions of the vertices interpolate straight elements, and all others are zero in them.
    displacement.reshape(3, -1)[:, : mesh.nv] = 0.0
    curved = displacement.copy()
    mesh.Curve(1)  # geometry of the volumes and of the faces' normals
    motions = _free_motions(mesh, scalar, patch, curved.reshape(3, -1))
    volume = ng.GridFunction(ng.L2(mesh, order=0))
    volume.vec.FV().NumPy()[:] = ng.Integrate(1.0, mesh, ng.VOL, element_wise=True).NumPy()
    given = curved.copy()
    given[np.unique(motions.indices)] = 0.0
    best, fewest = base, int(folded.sum())
    whole = _elastic_displacement(_stiffness(mesh, space, volume, chosen), motions, given)
    for steps in STEPS:
        mesh.Curve(1)
        displacement[:] = whole / steps
        for _ in range(1, steps):
            mesh.SetDeformation(moved)
            stiffness = _stiffness(mesh, space, volume, chosen)
            mesh.UnsetDeformation()
            displacement += _elastic_displacement(stiffness, motions, given) / steps
        correction[:] = base + displacement - curved
        mesh.Curve(curved_order)
        mesh.SetDeformation(deformation)
        n_folded = int((_smallest_determinants(mesh, patch) < SMALLEST_DETERMINANT).sum())
        mesh.UnsetDeformation()
        if n_folded < fewest:
            best, fewest = correction.copy(), n_folded
        # If most remain, they are flatter than any motion can mend, and further trials only take time.
        if not n_folded or n_folded > 0.5 * folded.sum():
            break
    mesh.Curve(curved_order)
    correction[:] = best
    mesh.SetDeformation(deformation)


def _elastic_displacement(stiffness: sp.csr_matrix, motions: sp.csr_matrix, given: Array) -> Array:
    """Return the displacement of an elastic body whose unknowns are given but for some motions, shape (3 n,)."""
    if not motions.shape[0]:
        return given
    inner = symmetric_matrix(motions @ stiffness @ motions.T)
    return given - motions.T @ factorize(inner).solve(motions @ (stiffness @ given))


def _with_neighbours(mesh: Any, chosen: NDArray[np.bool_], rings: int) -> NDArray[np.bool_]:
    """Return chosen elements with layers of others that share a vertex with them."""
    vertices = [[vertex.nr for vertex in element.vertices] for element in mesh.Elements(ng.VOL)]
    element = np.repeat(np.arange(len(vertices)), [len(numbers) for numbers in vertices])
    vertex = np.concatenate(vertices)
    for _ in range(rings):
        touched = np.zeros(mesh.nv, dtype=bool)
        touched[vertex[chosen[element]]] = True
        chosen = np.bincount(element, weights=touched[vertex]) > 0
    return chosen


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
    around = _with_neighbours(mesh, patch, 1) & ~patch
    inside, outside = (_unknowns(mesh, scalar, elements) for elements in (patch, around))
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


def _unknowns(mesh: Any, scalar: Any, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
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


def _stiffness(mesh: Any, space: Any, volume: Any, chosen: Any) -> sp.csr_matrix:
    """Assemble the stiffness of an elastic body in some elements of a mesh, which may have a deformation.

    Small elements and those that are compressed already are stiffer.

    Args:
        mesh: NGSolve mesh with straight elements
        space: NGSolve's space of its displacements
        volume: volumes of the elements without the deformation
        chosen: elements
    """
    u, v = space.TnT()
    energy = 2 * ng.InnerProduct(ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))) + 2 * ng.div(u) * ng.div(v)
    determinant = ng.Det(ng.specialcf.JacobianMatrix(3))
    form = ng.BilinearForm(space, check_unused=False)
    form += volume / (determinant**2 + (SOFTEST * volume) ** 2) * energy * ng.dx(definedonelements=chosen)
    with threads():
        form.Assemble()
    values, columns, starts = (np.array(part, copy=True) for part in form.mat.CSR())
    return sp.csr_matrix((values, columns, starts), shape=(space.ndof, space.ndof))
