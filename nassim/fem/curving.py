"""Curved elements without folds.

Netgen curves the edges and faces of elements on curved CAD faces, and leaves their other edges straight. If an element
is flatter than the curvature of its face, the determinant of its Jacobian has both signs: the element is folded. Folded
elements count some of the volume twice, and other programs refuse them. Here the nodes inside the solid and those
within plane CAD faces move, and the geometry of the CAD remains (`untangling`). Elements that this does not unfold get
straighter edges.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import ngsolve as ng
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from nassim.base.checks import Array
from nassim.fem.element_integrals import elements_by_kind
from nassim.fem.native_threads import threads
from nassim.fem.untangling import FLAT, unknowns_of, untangle

ORIENTATION = {ng.ET.TET: 1.0, ng.ET.PRISM: -1.0, ng.ET.PYRAMID: -1.0, ng.ET.HEX: -1.0}
"""Sign of the Jacobian's determinant in valid elements, with Netgen's order of the vertices."""
DIVISIONS = 2
"""Divisions of an element's edges by the sample points, beyond the order; they include the vertices."""
SMALLEST_DETERMINANT = 0.01
"""Smallest determinant of a valid element relative to its mean, a margin for points between the samples."""
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
        restoring: displacements that would bring the nodes back to the CAD, an NGSolve function [m]; None without
            straighter edges
    """

    n_elements: int
    n_folded: int
    left: NDArray[np.int64]
    corners: Array
    sizes: Array
    displacement: float = 0.0
    n_straightened: int = 0
    restoring: Any = None

    def __str__(self) -> str:
        """Describe the folded elements and their mending; '' if no element folded."""
        if not self.n_folded:
            return ""
        mended = "all mended by moving inner nodes"
        if self.n_straightened:
            moves = f"which moves curved faces by up to {1e6 * self.displacement:.3g} um"
            mended = f"{len(self.left)} mended by straighter edges of {self.n_straightened}, {moves}"
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
    return _smallest_determinants(mesh) < SMALLEST_DETERMINANT


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
        untangle(mesh, order, folded, {kind: _check_points(mesh, kind) for kind in ORIENTATION})
        folded = folded_elements(mesh)
    left = np.flatnonzero(folded)
    corners, sizes = [np.zeros((0, 3))], [np.zeros(0)]
    for number in left.tolist():
        corners.append(np.array([mesh[v].point for v in mesh[ng.ElementId(ng.VOL, number)].vertices]))
        sizes.append(np.full(len(corners[-1]), pdist(corners[-1]).min()))
    return Curving(mesh.ne, n_folded, left, np.vstack(corners), np.concatenate(sizes))


def reduce_curvature(mesh: Any, order: int, curving: Curving) -> Curving:
    """Unfold the elements that `curve_mesh` could not mend, by edges that are less curved than those of the CAD.

    Args:
        mesh: NGSolve mesh, which is changed
        order: polynomial order of the elements' edges that `curve_mesh` used
        curving: record of `curve_mesh`

    Returns:
        The record with the displacement of the faces, that which would restore them, and the number of straightened
        elements.
    """
    if not len(curving.left):
        return curving
    change = _positions(mesh, order)
    n_straightened = _straighten(mesh, order)
    change.vec.data -= _positions(mesh, order).vec
    displacement = _largest_across_faces(mesh, change)
    return replace(curving, n_straightened=n_straightened, displacement=displacement, restoring=change)


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
    for kind, elements in elements_by_kind(mesh).items():
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
    # The functions of the vertices are the straight element, but for vertices that `untangle` moved.
    motion = _positions(mesh, order).vec.FV().NumPy().reshape(-1, 3).T.copy()
    motion[:, : mesh.nv] -= np.array([vertex.point for vertex in mesh.vertices]).T
    deformation = ng.GridFunction(space)
    correction = deformation.vec.FV().NumPy().reshape(3, -1)
    before = mesh.deformation.vec.FV().NumPy().reshape(3, -1).copy() if mesh.deformation else 0 * motion
    share = np.ones(scalar.ndof)
    mesh.SetDeformation(deformation)
    while folded.any() and share[unknowns := unknowns_of(mesh, scalar, folded)].any():
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


def _sample_points(kind: Any, n: int) -> list[tuple[float, float, float]]:
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


def _check_points(mesh: Any, kind: Any) -> list[tuple[float, float, float]]:
    """Return the points of the reference element at which the determinant counts."""
    order = max(2, mesh.GetCurveOrder(), mesh.deformation.space.globalorder if mesh.deformation else 1)
    return [*_sample_points(kind, order + DIVISIONS), *ng.IntegrationRule(kind, 2 * order - 2).points]


def _smallest_determinants(mesh: Any) -> Array:
    """Return the smallest determinant of the Jacobian in each element, relative to its mean absolute value."""
    kinds = [element.type for element in mesh.Elements(ng.VOL)]
    result = np.empty(mesh.ne)
    for kind, sign in ORIENTATION.items():
        members = np.array([other == kind for other in kinds])
        if not members.any():
            continue
        points = _check_points(mesh, kind)
        mapped = mesh.MapToAllElements(_rules(kind, points), ng.VOL).reshape(-1, len(points))
        with threads():
            values = sign * ng.Det(ng.specialcf.JacobianMatrix(3))(mapped.ravel()).reshape(mapped.shape)
        result[members] = values.min(axis=1) / np.abs(values).mean(axis=1)
    return result
