"""Elastic forces and stiffness matrices of single elements, by dense products and without a matrix of the whole mesh.

Elements of one kind whose vertices are numbered in the same sequence have the same shape functions on the reference
element. The displacements of an element are mapped to their gradients at the integration points, these by one matrix of
nine rows and columns to stresses, and these to forces. Integration orders are those of NGSolve's own matrices.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import ngsolve as ng
import numpy as np
from numpy.typing import NDArray

from nassim.base.checks import Array
from nassim.fem.native_threads import share, threads
from nassim.fem.solid import Solid

Numbers = NDArray[np.int64]
Floats = NDArray[np.float32]
CHUNK = 2**18
"""Number of entries of a product that is computed at once, few enough for the processor's cache."""
KINDS = (ng.ET.TET, ng.ET.PRISM, ng.ET.PYRAMID, ng.ET.HEX)


@dataclass(frozen=True)
class ElementGroup:
    """Elements with the same shape functions on the reference element, for displacements and for forces.

    Attributes:
        unknowns: scalar unknowns of the displacements and of the forces, shapes (e, n) and (e, m)
        slopes: gradients of the shape functions on the reference element, shapes (q, 3, n) and (q, 3, m)
        inverse: inverse Jacobians at the integration points, shape (e, q, 3, 3) [1/m]
        weights: weights of the integration points, shape (e, q) [m3]
        lame: both Lame parameters, shape (2, e) [Pa]
    """

    unknowns: tuple[Numbers, Numbers]
    slopes: tuple[Array, Array]
    inverse: Array
    weights: Array
    lame: Array

    def chunks(self, size: int) -> Iterator["ElementGroup"]:
        """Yield parts of the group, whose elements have arrays of a size."""
        count = max(1, CHUNK // size)
        for begin in range(0, len(self.weights), count):
            part = slice(begin, begin + count)
            yield ElementGroup(
                (self.unknowns[0][part], self.unknowns[1][part]),
                self.slopes,
                self.inverse[part],
                self.weights[part],
                self.lame[:, part],
            )


def element_groups(mesh: Any, solid: Solid, trial: Any, test: Any) -> Iterator[ElementGroup]:
    """Yield the groups of the elements of a mesh.

    Args:
        mesh: NGSolve mesh, curved or not, also with a deformation
        solid: the solid
        trial: NGSolve's scalar space of the displacements
        test: that of the forces
    """
    materials = [solid.materials[name].lame_parameters for name in mesh.GetMaterials()]
    spaces = (trial, test)
    for kind, members in elements_by_kind(mesh).items():
        order = sum(space.globalorder for space in spaces) - (2 if kind == ng.ET.TET else 0)
        rule = ng.IntegrationRule(kind, order)
        points = np.array(rule.points)
        jacobian = _jacobians(mesh, kind, rule)
        inverse = np.linalg.inv(jacobian)
        weights = np.abs(np.linalg.det(jacobian)) * np.array(rule.weights)
        lame = np.array([materials[element.index] for element in members]).T
        unknowns = [np.array([space.GetDofNrs(element) for element in members]) for space in spaces]
        vertices = np.array([[vertex.nr for vertex in element.vertices] for element in members])
        group = np.unique(np.argsort(vertices, axis=1), axis=0, return_inverse=True)[1].ravel()
        for chosen in (np.flatnonzero(group == k) for k in range(group.max() + 1)):
            first = members[chosen[0]]
            functions = (space.GetFE(ng.ElementId(first)) for space in spaces)
            slopes = [np.array([np.array(f.CalcDShape(*point)).T for point in points]) for f in functions]
            yield ElementGroup(
                (unknowns[0][chosen], unknowns[1][chosen]),
                (slopes[0], slopes[1]),
                inverse[chosen],
                weights[chosen],
                lame[:, chosen],
            )


def elements_by_kind(mesh: Any) -> dict[Any, list[Any]]:
    """Return the elements of a mesh, in order, by kind."""
    result: dict[Any, list[Any]] = {}
    for element in mesh.Elements(ng.VOL):
        result.setdefault(element.type, []).append(element)
    return result


def _jacobians(mesh: Any, kind: Any, rule: Any) -> Array:
    """Return the Jacobians of all elements of a kind at the q points of an integration rule, shape (e, q, 3, 3) [m]."""
    rules = dict.fromkeys(KINDS, ng.IntegrationRule([], [])) | {kind: rule}
    with threads():
        values: Array = ng.specialcf.JacobianMatrix(3)(mesh.MapToAllElements(rules, ng.VOL).ravel())
    return values.reshape(-1, len(rule.points), 3, 3)


def elastic_forces(
    mesh: Any,
    solid: Solid,
    trial: Any,
    test: Any,
    displacements: Array,
    inactive: NDArray[np.bool_],
    node: Numbers,
) -> Array:
    """Return the forces by which the elements resist displacements.

    Args:
        mesh: NGSolve mesh
        solid: the solid
        trial: NGSolve's scalar space of the displacements, of n unknowns
        test: that of the forces
        displacements: displacements, shape (3 n, k) [m]
        inactive: unknowns without forces, the same ones in every element of a kind
        node: rows of the result where the forces on each unknown of `test` are added; the last one takes all forces
            that are not wanted

    Returns:
        Forces, shape (node.max() + 1, 3, k) [N].
    """
    k = displacements.shape[1]
    given = np.ascontiguousarray(displacements.reshape(3, trial.ndof, k).transpose(1, 0, 2))
    result = np.zeros((node.max() + 1, 3, k))
    for group in element_groups(mesh, solid, trial, test):
        q = group.weights.shape[1]
        active = ~inactive[group.unknowns[1][0]]
        from_trial, to_test = group.slopes[0].reshape(3 * q, -1), group.slopes[1][:, :, active].reshape(3 * q, -1)
        parts = list(group.chunks(9 * q * k))
        forces = share(partial(_resisting_forces, given=given, from_trial=from_trial, to_test=to_test), parts)
        for part, by_element in zip(parts, forces, strict=True):
            for numbers, force in zip(node[part.unknowns[1][:, active]], by_element, strict=True):
                result[numbers] += force
    return result


def _resisting_forces(part: ElementGroup, *, given: Array, from_trial: Array, to_test: Array) -> Array:
    """Return the forces of elements, shape (e, m, 3, k).

    Args:
        part: the elements
        given: displacements, shape (n_all, 3, k) [m]
        from_trial: gradients of the functions of the displacements, shape (3 q, n)
        to_test: those of the functions of the forces, shape (3 q, m)
    """
    fields = given[part.unknowns[0]]
    (e, n, _, k), q = fields.shape, part.weights.shape[1]
    gradients = (from_trial @ fields.reshape(e, n, 3 * k)).reshape(e, q, 9, k)
    stresses = _elasticity(part) @ gradients
    return (to_test.T @ stresses.reshape(e, 3 * q, 3 * k)).reshape(e, -1, 3, k)


def _elasticity(group: ElementGroup) -> Array:
    """Return the map from gradients (reference direction, component) to stresses of the same kind, (e, q, 9, 9) [N]."""
    inverse = group.inverse
    first, second = (parameter[:, None] * group.weights for parameter in group.lame)
    result = np.einsum("eq,eqac,eqbd->eqacbd", first, inverse, inverse)
    shear = second[..., None, None] * inverse
    result += np.einsum("eqad,eqbc->eqacbd", shear, inverse)
    metric = shear @ inverse.swapaxes(-1, -2)
    for c in range(3):
        result[:, :, :, c, :, c] += metric
    return result.reshape(*group.weights.shape, 9, 9)


@dataclass(frozen=True)
class ElementStiffness:
    """Stiffness of elements in single precision, which takes half of the time to read.

    Unknowns are counted by nodes, three components each. The last node is fixed and stands for all that are fixed.

    Attributes:
        n_nodes: number m of free scalar unknowns
        blocks: for groups of e elements, their scalar unknowns, shape (e, f), and matrices, shape (e, 3 f, 3 f) [N/m]
    """

    n_nodes: int
    blocks: list[tuple[Numbers, Floats]]

    def __matmul__(self, columns: Floats) -> Floats:
        """Return the product with columns (3 m + 3, k), the last three rows of which are zero."""
        k = columns.shape[1]
        by_node = columns.reshape(-1, 3 * k)
        result = np.zeros_like(by_node)
        for unknowns, matrices in self.blocks:
            e, f = unknowns.shape
            size = max(1, CHUNK // (3 * f * k))
            for begin in range(0, e, size):
                numbers = unknowns[begin : begin + size]
                products = matrices[begin : begin + size] @ by_node[numbers].reshape(len(numbers), 3 * f, k)
                for places, product in zip(numbers, products.reshape(len(numbers), f, 3 * k), strict=True):
                    result[places] += product
        result[-1] = 0.0
        return result.reshape(columns.shape)

    def diagonal(self) -> Floats:
        """Return the diagonal, shape (3 m + 3,); ones for the fixed node."""
        result = np.zeros((self.n_nodes + 1, 3), dtype=np.float32)
        for unknowns, matrices in self.blocks:
            np.add.at(result, unknowns, np.einsum("eii->ei", matrices).reshape(*unknowns.shape, 3))
        result[-1] = 1.0
        return result.ravel()


def element_stiffness(
    mesh: Any, solid: Solid, space: Any, inactive: NDArray[np.bool_], node: Numbers
) -> ElementStiffness:
    """Return the stiffness of all elements among their free unknowns.

    Args:
        mesh: NGSolve mesh
        solid: the solid
        space: NGSolve's scalar space of the displacements
        inactive: unknowns that no element has, the same ones in every element of a kind
        node: place of each unknown of `space` among those that are free, or their number m if it is fixed
    """
    blocks: list[tuple[Numbers, Floats]] = []
    for group in element_groups(mesh, solid, space, space):
        active = ~inactive[group.unknowns[0][0]]
        slopes = np.ascontiguousarray(group.slopes[0][:, :, active])
        q, _, f = slopes.shape
        matrices = np.empty((len(group.weights), f, 3, f, 3), dtype=np.float32)
        parts = list(group.chunks(3 * q * f))
        ends = np.cumsum([len(part.weights) for part in parts])[:-1]
        share(partial(_fill_matrices, slopes=slopes), list(zip(parts, np.split(matrices, ends), strict=True)))
        blocks.append((node[group.unknowns[0][:, active]], matrices.reshape(-1, 3 * f, 3 * f)))
    return ElementStiffness(int(node.max()), blocks)


def _fill_matrices(piece: tuple[ElementGroup, Floats], *, slopes: Array) -> None:
    """Fill the stiffness matrices of elements, shape (e, f, 3, f, 3); slopes: of their functions, shape (q, 3, f)."""
    part, matrices = piece
    (e, q), f = part.weights.shape, slopes.shape[2]
    scaled = np.sqrt(part.weights)[..., None, None] * part.inverse.swapaxes(-1, -2)
    gradients = (scaled @ slopes).astype(np.float32).reshape(e, q, 3 * f)
    products = (gradients.swapaxes(1, 2) @ gradients).reshape(e, 3, f, 3, f)
    first, second = part.lame.astype(np.float32)[:, :, None, None]
    for i in range(3):
        for j in range(3):
            matrices[:, :, i, :, j] = first * products[:, i, :, j] + second * products[:, j, :, i]
        matrices[:, :, i, :, i] += second * sum(products[:, j, :, j] for j in range(3))
