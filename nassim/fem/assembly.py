"""Finite element models made by NGSolve: mesh, stiffness and mass of any element order, remote points."""

import math
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import ngsolve as ng
import numpy as np
import scipy.sparse as sp

from nassim.base.checks import Array, whole_number
from nassim.base.library_lock import hold_library_lock
from nassim.base.progress import stage
from nassim.base.warning_log import collect_messages, note
from nassim.bodies.remote_points import RemotePoint
from nassim.fem.curving import Curving, curve_mesh, reduce_curvature
from nassim.fem.fe_model import Coupling, FEModel, MeshRound, Refinement, make_coupling
from nassim.fem.materials import Material
from nassim.fem.mesh_checks import check_folds, check_memory, check_volume, warn_of_thin_walls
from nassim.fem.meshing import PrismsFailedError, generate_mesh
from nassim.fem.native_threads import blas_threads, threads
from nassim.fem.ports import couple_port
from nassim.fem.regions import by_body, faces
from nassim.fem.skin import outer_surface
from nassim.fem.solid import Solid
from nassim.fem.sparse import SymmetricMatrix

MAX_ORDER = 6
FURTHER_MESHES = 3
"""Largest number of further meshes that replace one with folded elements."""
SMALLER = 0.7
"""Size of their elements relative to the shortest edge of the folded element there."""
LARGEST_GROWTH, SMALL_MESH = 2.0, 3000
"""A further mesh has at most so many times the elements of the first one, unless it is small."""
ELEMENTS = {ng.ET.TET: "tetrahedra", ng.ET.PRISM: "prisms", ng.ET.PYRAMID: "pyramids", ng.ET.HEX: "hexahedra"}


def build_by_size(
    solid: Solid,
    *,
    element_size: float,
    order: int,
    curvature: float,
    local_sizes: Mapping[str, float] | None,
    extrude: str | None,
    layer_thickness: float | None,
    progress: bool,
) -> FEModel:
    """Mesh a solid with elements of a given size and assemble its matrices; see `build_fe_model`."""
    start, order = time.perf_counter(), check_order(order)
    options: dict[str, Any] = {
        "element_size": element_size,
        "curvature": curvature,
        "local_sizes": local_sizes,
        "extrude": extrude,
        "layer_thickness": layer_thickness,
    }
    with hold_library_lock(), collect_messages() as log:
        with stage("mesh", enabled=progress):
            mesh, curving = _unfolded_mesh(partial(generate_mesh, solid, **options), order)
            check_memory(mesh, solid, order, element_size)
        check_folds(curving, solid)
        check_volume(mesh, solid)
        if order == 1:
            warn_of_thin_walls(mesh, solid)
        with stage("assemble", enabled=progress):
            model = assemble_mesh(mesh, solid, order)
    made = MeshRound(order, mesh.ne, model.n_dofs, seconds=time.perf_counter() - start)
    description = "; ".join([model.description, *log.notes])
    return replace(model, description=description, warnings=tuple(log.warnings), rounds=(made,))


def check_order(order: int) -> int:
    """Return the order of elements; raise ValueError for an impossible one."""
    return whole_number("order", order, 1, MAX_ORDER)


def curved_mesh(netgen_mesh: Any, order: int) -> tuple[Any, Curving]:
    """Return an NGSolve mesh with curved elements, on a copy of a Netgen mesh, and the record of its curving."""
    mesh = ng.Mesh(netgen_mesh.Copy())
    return mesh, curve_mesh(mesh, order)


def _unfolded_mesh(generate: Callable[..., Any], order: int) -> tuple[Any, Curving]:
    """Mesh a solid and curve the mesh; where elements stay folded, mesh it anew with smaller ones, then curve it less.

    Args:
        generate: function that makes a Netgen mesh; its arguments are as those of `generate_mesh`
        order: polynomial order of the curved elements

    Returns:
        The curved NGSolve mesh, and the record of its curving.
    """
    mesh, curving = curved_mesh(generate(), order)
    found, largest = curving, max(LARGEST_GROWTH * mesh.ne, SMALL_MESH)
    prisms = any(element.type == ng.ET.PRISM for element in mesh.Elements(ng.VOL))
    points, sizes = np.zeros((0, 3)), np.zeros(0)
    for _ in range(FURTHER_MESHES):
        if not len(found.left):
            break
        points = np.vstack([points, found.corners])
        sizes = np.concatenate([sizes, SMALLER * found.sizes])
        try:
            finer = generate(point_sizes=(points, sizes), tetrahedra_instead=not prisms)
        except PrismsFailedError:
            break
        if ng.Mesh(finer).ne > largest:
            break
        finer_mesh, found = curved_mesh(finer, order)
        if len(found.left) < len(curving.left):
            note(f"meshed anew with smaller elements where {len(curving.left)} elements were folded")
            mesh, curving = finer_mesh, found
    return mesh, reduce_curvature(mesh, order, curving)


def assemble_mesh(mesh: Any, solid: Solid, order: int) -> FEModel:
    """Assemble the FE model of a solid on an NGSolve mesh whose curvature order is at most the element order.

    Args:
        mesh: NGSolve mesh of the solid
        solid: the solid
        order: polynomial order of the displacements

    Raises:
        ValueError: if the CAD bodies of the solid are not connected
    """
    # The other forms are small: threads would wait for each other longer than they compute.
    with blas_threads(0):
        scalar = ng.H1(mesh, order=order)
        mass = _scalar_mass(mesh, solid, scalar)
        pieces, _ = sp.csgraph.connected_components(mass)
        if pieces > 1:
            raise ValueError(f"solid {solid.name!r} consists of {pieces} pieces that do not touch; join its CAD bodies")
        fields = _position_fields(scalar)
        stiffness = _stiffness(mesh, solid, scalar)
        couplings = tuple(_couple(mesh, scalar, fields, point) for point in solid.remote_points)
        surface, evaluation = outer_surface(mesh, scalar, fields, solid)
        kinds = Counter(ELEMENTS[element.type] for element in mesh.Elements(ng.VOL))
        counts = " + ".join(f"{count} {kind}" for kind, count in kinds.items())
        description = f"{counts} of order {order}, {mesh.nv} vertices, {3 * scalar.ndof} degrees of freedom"
        ports = tuple(couple_port(mesh, solid, order, port) for port in solid.ports)
        return FEModel(
            solid.name,
            stiffness=stiffness,
            scalar_mass_matrix=mass,
            fields=fields,
            couplings=couplings,
            surface=surface,
            surface_evaluation=evaluation,
            description=description,
            order=order,
            ports=ports,
            _source=(mesh, solid),
        )


def replace_materials(fe_model: FEModel, materials: Mapping[str, Material]) -> FEModel:
    """Return the FE model of the same solid and mesh with other materials, given by CAD body.

    The rounds of the mesh keep their costs. Their errors were those with the earlier materials and become unknown.

    Raises:
        ValueError: for a model that was not made from a mesh
    """
    mesh, solid = mesh_and_solid(fe_model)
    changed = replace(solid, materials={**solid.materials, **materials})
    model = assemble_mesh(mesh, changed, fe_model.order)
    rounds = tuple(replace(made, error=math.nan) for made in fe_model.rounds)
    return replace(model, description=fe_model.description, warnings=fe_model.warnings, rounds=rounds)


def mesh_and_solid(fe_model: FEModel) -> tuple[Any, Solid]:
    """Return NGSolve's mesh and the solid of an FE model.

    Raises:
        ValueError: for a model that was not made from a mesh
    """
    if fe_model._source is None:
        raise ValueError(
            f"FE model {fe_model.name!r} was not made from a mesh by build_fe_model, so its mesh is unknown"
        )
    return fe_model._source


def refine_order(fe_model: FEModel) -> Refinement:
    """Assemble elements one order higher for the same solid and mesh.

    Raises:
        ValueError: for a model that was not made from a mesh
    """
    mesh, solid = mesh_and_solid(fe_model)
    order = fe_model.order
    with threads():
        scalar, fine_scalar = ng.H1(mesh, order=order), ng.H1(mesh, order=order + 1)
        held = np.zeros(fine_scalar.ndof, dtype=bool)
        held[: mesh.nv] = True
        for edge in mesh.edges:
            held[list(fine_scalar.GetDofNrs(edge))[:-1]] = True
        mass = ng.BilinearForm(trialspace=scalar, testspace=fine_scalar)
        mass += density(mesh, solid) * scalar.TrialFunction() * fine_scalar.TestFunction() * ng.dx(bonus_intorder=2)
        fields = _position_fields(fine_scalar, only_faces=True)
        port_forces = [couple_port(mesh, solid, order + 1, port).forces for port in solid.ports]
        return Refinement(
            (scalar, fine_scalar),
            held,
            _to_scipy(mass.Assemble().mat),
            tuple(_couple(mesh, fine_scalar, fields, point) for point in solid.remote_points),
            np.column_stack([np.zeros((3 * fine_scalar.ndof, 0)), *port_forces]),
            _elements_by_unknown(mesh, fine_scalar),
        )


def _elements_by_unknown(mesh: Any, scalar: Any) -> sp.csr_matrix:
    """Return a matrix of ones where an element has an unknown, shape (n_elements, n)."""
    unknowns = [list(scalar.GetDofNrs(element)) for element in mesh.Elements(ng.VOL)]
    counts = [len(numbers) for numbers in unknowns]
    places = (np.repeat(np.arange(len(counts)), counts), np.concatenate(unknowns))
    return sp.csr_matrix((np.ones(sum(counts)), places), shape=(len(counts), scalar.ndof))


def lame_parameters(mesh: Any, solid: Solid) -> tuple[Any, Any]:
    """Return both Lame parameters as functions on the mesh [Pa]."""
    lame = {name: material.lame_parameters for name, material in solid.materials.items()}
    first, second = (by_body(mesh, {name: values[k] for name, values in lame.items()}) for k in range(2))
    return first, second


def density(mesh: Any, solid: Solid) -> Any:
    """Return the density as a function on the mesh [kg/m3]."""
    return by_body(mesh, {name: material.density for name, material in solid.materials.items()})


def _stiffness(mesh: Any, solid: Solid, scalar: Any) -> SymmetricMatrix:
    """Assemble the stiffness matrix [N/m].

    NGSolve assembles the blocks of two components each in a third of the time of one space of vectors.
    """
    lambda_, mu = lame_parameters(mesh, solid)
    u, v = (ng.grad(function) for function in scalar.TnT())

    def forces(i: int, j: int) -> Any:
        """Return the matrix from displacements along j to forces along i, its lower triangle if i is j."""
        form = ng.BilinearForm(scalar, symmetric=i == j, symmetric_storage=i == j)
        form += (lambda_ * u[j] * v[i] + mu * u[i] * v[j] + (mu * u * v if i == j else 0.0)) * ng.dx
        return form.Assemble().mat

    with threads():
        blocks = [[forces(i, j) for j in range(i + 1)] for i in range(3)]
    return SymmetricMatrix(_join(blocks))


def _join(blocks: list[list[Any]]) -> sp.csr_matrix:
    """Join rows of square NGSolve matrices to one matrix; there is nothing on the right of shorter rows."""
    n = blocks[0][0].height
    rows = [[[np.asarray(part) for part in block.CSR()] for block in row] for row in blocks]
    starts = [[start.astype(np.int64) for *_, start in row] for row in rows]
    lengths = [[start[1:] - start[:-1] for start in row] for row in starts]
    row_starts = np.append(0, np.cumsum(np.concatenate([np.sum(row, axis=0) for row in lengths])))
    values, columns = np.empty(row_starts[-1]), np.empty(row_starts[-1], dtype=np.int32)
    for i, row in enumerate(rows):
        begin = row_starts[i * n : (i + 1) * n]
        for j, (entries, within, _) in enumerate(row):
            places = np.repeat(begin - starts[i][j][:-1], lengths[i][j]) + np.arange(len(entries))
            values[places], columns[places] = entries, within + j * n
            begin = begin + lengths[i][j]
    return sp.csr_matrix((values, columns, row_starts), shape=(len(rows) * n, len(rows) * n))


def _scalar_mass(mesh: Any, solid: Solid, scalar: Any) -> sp.csr_matrix:
    """Assemble the scalar mass matrix [kg]."""
    u, v = scalar.TnT()
    # Two orders above the default integrate the Jacobian of curved elements exactly or nearly exactly.
    form = ng.BilinearForm(density(mesh, solid) * u * v * ng.dx(bonus_intorder=2))
    with threads():
        return _to_scipy(form.Assemble().mat)


def _to_scipy(matrix: Any) -> sp.csr_matrix:
    """Convert an NGSolve matrix to SciPy."""
    values, columns, row_starts = (np.array(part, copy=True) for part in matrix.CSR())
    result = sp.csr_matrix((values, columns, row_starts), shape=(matrix.height, matrix.width))
    result.sort_indices()
    return result


def _position_fields(scalar: Any, *, only_faces: bool = False) -> Array:
    """Return the coefficients of 1, x, y, z in the scalar shape functions, or only those of faces, shape (4, n)."""
    # One space with four components takes one sixth of the time of four functions.
    interpolated = ng.GridFunction(ng.H1(scalar.mesh, order=scalar.globalorder, dim=4))
    region = faces(scalar.mesh, set(scalar.mesh.GetBoundaries())) if only_faces else None
    interpolated.Set(ng.CoefficientFunction((1.0, ng.x, ng.y, ng.z)), definedon=region)
    return np.ascontiguousarray(interpolated.vec.FV().NumPy().reshape(-1, 4).T)


def _couple(mesh: Any, scalar: Any, fields: Array, point: RemotePoint) -> Coupling:
    """Tie a remote point to the unknowns on its faces."""
    region = faces(mesh, point.faces)
    dofs = np.flatnonzero(np.array(scalar.GetDofs(region)))
    test = scalar.TestFunction()
    integrals = [
        ng.LinearForm(function * test * ng.ds(definedon=region, bonus_intorder=2)).Assemble().vec.FV().NumPy()[dofs]
        for function in (1.0, ng.x, ng.y, ng.z)
    ]
    return make_coupling(point, dofs, np.array(integrals), fields[:, dofs])
