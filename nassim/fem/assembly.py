"""Finite element models made by NGSolve: mesh, stiffness and mass of any element order, remote points."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import ngsolve as ng
import numpy as np
import scipy.sparse as sp

from nassim.base.checks import Array
from nassim.base.library_lock import hold_library_lock
from nassim.base.progress import stage, tell
from nassim.base.warning_log import collect_messages, note
from nassim.bodies.interface import RemotePoint
from nassim.fem.curving import Curving, curve_mesh
from nassim.fem.fe_model import Coupling, FEModel, Refinement, make_coupling
from nassim.fem.materials import Material
from nassim.fem.mesh_checks import check_folds, check_memory, check_volume, warn_of_thin_walls
from nassim.fem.meshing import generate_mesh
from nassim.fem.ports import couple_port
from nassim.fem.regions import by_body, faces
from nassim.fem.skin import outer_surface
from nassim.fem.solid import Solid
from nassim.fem.solver import threads
from nassim.fem.sparse import SymmetricMatrix, symmetric_matrix

MAX_ORDER = 6
FURTHER_MESHES = 3
"""Largest number of further meshes that replace one with folded elements."""
SMALLER = 0.7
"""Size of their elements relative to the shortest edge of the folded element there."""
LARGEST_GROWTH, SMALL_MESH = 2.0, 3000
"""A further mesh has at most so many times the elements of the first one, unless it is small."""
ELEMENTS = {ng.ET.TET: "tetrahedra", ng.ET.PRISM: "prisms", ng.ET.PYRAMID: "pyramids", ng.ET.HEX: "hexahedra"}


def build_fe_model(
    solid: Solid,
    *,
    element_size: float,
    order: int = 3,
    curvature: float = 0.5,
    local_sizes: Mapping[str, float] | None = None,
    extrude: str | None = None,
    layer_thickness: float | None = None,
    progress: bool = True,
) -> FEModel:
    """Mesh a solid and assemble its stiffness and mass.

    Args:
        solid: the solid
        element_size: largest edge length of the elements [m]; see `meshing.generate_mesh` for this and the other
            arguments of the mesh
        order: polynomial order of the displacements, 1 to 6; order 1 is far too stiff in thin walls
        curvature: elements per radius of curvature of curved edges and faces
        local_sizes: largest edge length on faces, by the names of the faces [m]
        extrude: axis "x", "y" or "z" along which CAD bodies are extruded and meshed with prisms; None for tetrahedra
        layer_thickness: largest height of the prisms [m] (default: element_size)
        progress: show the stages and their times

    Raises:
        ValueError: for invalid arguments, for a solid whose CAD bodies are not connected, and for a mesh that does not
            fit in memory

    Warns:
        UserWarning: for folded elements, a wrong volume, and thin walls in elements of order 1
    """
    if not 1 <= order <= MAX_ORDER or int(order) != order:
        raise ValueError(f"order must be a whole number from 1 to {MAX_ORDER}, got {order!r}")
    with hold_library_lock(), collect_messages() as log:
        with stage("mesh", enabled=progress):
            mesh, curving = _curved_mesh(
                solid,
                order,
                element_size=element_size,
                curvature=curvature,
                local_sizes=local_sizes,
                extrude=extrude,
                layer_thickness=layer_thickness,
            )
            check_memory(mesh, solid, order, element_size)
        check_folds(curving, solid)
        check_volume(mesh, solid)
        if order == 1:
            warn_of_thin_walls(mesh, solid)
        with stage("assemble", enabled=progress):
            model = assemble_mesh(mesh, solid, order)
    description = "; ".join([model.description, *log.notes])
    model = replace(model, description=description, warnings=tuple(log.warnings))
    if progress:
        tell(model.description)
    return model


def _curved_mesh(solid: Solid, order: int, **options: Any) -> tuple[Any, Curving]:
    """Mesh a solid and curve the mesh; mesh it anew, with smaller elements there, where elements stay folded."""
    mesh = ng.Mesh(generate_mesh(solid, **options))
    curving = found = curve_mesh(mesh, order)
    largest = max(LARGEST_GROWTH * mesh.ne, SMALL_MESH)
    points, sizes = np.zeros((0, 3)), np.zeros(0)
    for _ in range(FURTHER_MESHES):
        if not len(found.left):
            break
        points = np.vstack([points, found.corners])
        sizes = np.concatenate([sizes, SMALLER * found.sizes])
        finer = ng.Mesh(generate_mesh(solid, **options, point_sizes=(points, sizes)))
        if finer.ne > largest:
            break
        found = curve_mesh(finer, order)
        if len(found.left) < len(curving.left):
            note(f"meshed anew with smaller elements where {len(curving.left)} elements were folded")
            mesh, curving = finer, found
    return mesh, curving


def assemble_mesh(mesh: Any, solid: Solid, order: int) -> FEModel:
    """Assemble the FE model of a solid on an NGSolve mesh whose curvature order is at most the element order.

    Args:
        mesh: NGSolve mesh of the solid
        solid: the solid
        order: polynomial order of the displacements

    Raises:
        ValueError: if the CAD bodies of the solid are not connected
    """
    with threads():
        scalar = ng.H1(mesh, order=order)
        mass = _scalar_mass(mesh, solid, scalar)
        pieces, _ = sp.csgraph.connected_components(mass, directed=False)
        if pieces > 1:
            raise ValueError(f"solid {solid.name!r} consists of {pieces} pieces that do not touch; join its CAD bodies")
        fields = _position_fields(scalar)
        stiffness = _stiffness(mesh, solid, order)
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

    Raises:
        ValueError: for a model that was not made from a mesh
    """
    mesh, solid = mesh_and_solid(fe_model)
    changed = replace(solid, materials={**solid.materials, **materials})
    model = assemble_mesh(mesh, changed, fe_model.order)
    return replace(model, description=fe_model.description, warnings=fe_model.warnings)


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
        trial, test = ng.VectorH1(mesh, order=order), ng.VectorH1(mesh, order=order + 1)
        stiffness = ng.BilinearForm(trialspace=trial, testspace=test)
        stiffness += _elastic_energy(mesh, solid, trial.TrialFunction(), test.TestFunction()) * ng.dx
        mass = ng.BilinearForm(trialspace=scalar, testspace=fine_scalar)
        mass += _density(mesh, solid) * scalar.TrialFunction() * fine_scalar.TestFunction() * ng.dx(bonus_intorder=2)
        fields = _position_fields(fine_scalar)
        return Refinement(
            _stiffness(mesh, solid, order + 1),
            np.flatnonzero(np.tile(held, 3)),
            _to_scipy(stiffness.Assemble().mat),
            _to_scipy(mass.Assemble().mat),
            tuple(_couple(mesh, fine_scalar, fields, point) for point in solid.remote_points),
        )


def _elastic_energy(mesh: Any, solid: Solid, u: Any, v: Any) -> Any:
    """Return the elastic bilinear form of trial functions u and test functions v."""
    lame = {name: material.lame_parameters for name, material in solid.materials.items()}
    lambda_, mu = (by_body(mesh, {name: values[k] for name, values in lame.items()}) for k in range(2))
    strain_u, strain_v = ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))
    return 2 * mu * ng.InnerProduct(strain_u, strain_v) + lambda_ * ng.div(u) * ng.div(v)


def _density(mesh: Any, solid: Solid) -> Any:
    """Return the density as a function on the mesh [kg/m3]."""
    return by_body(mesh, {name: material.density for name, material in solid.materials.items()})


def _stiffness(mesh: Any, solid: Solid, order: int) -> SymmetricMatrix:
    """Assemble the stiffness matrix [N/m]."""
    space = ng.VectorH1(mesh, order=order)
    u, v = space.TnT()
    form = ng.BilinearForm(space, symmetric=True, symmetric_storage=True)
    form += _elastic_energy(mesh, solid, u, v) * ng.dx
    return symmetric_matrix(form.Assemble().mat)


def _scalar_mass(mesh: Any, solid: Solid, scalar: Any) -> sp.csr_matrix:
    """Assemble the scalar mass matrix [kg]."""
    density = _density(mesh, solid)
    u, v = scalar.TnT()
    # Two orders above the default integrate the Jacobian of curved elements exactly or nearly exactly.
    return _to_scipy(ng.BilinearForm(density * u * v * ng.dx(bonus_intorder=2)).Assemble().mat)


def _to_scipy(matrix: Any) -> sp.csr_matrix:
    """Convert an NGSolve matrix to SciPy."""
    values, columns, row_starts = (np.array(part, copy=True) for part in matrix.CSR())
    result = sp.csr_matrix((values, columns, row_starts), shape=(matrix.height, matrix.width))
    result.sort_indices()
    return result


def _position_fields(scalar: Any) -> Array:
    """Return the coefficients of 1, x, y, z in the scalar shape functions, shape (4, n)."""
    # One space with four components takes one sixth of the time of four functions.
    interpolated = ng.GridFunction(ng.H1(scalar.mesh, order=scalar.globalorder, dim=4))
    interpolated.Set(ng.CoefficientFunction((1.0, ng.x, ng.y, ng.z)))
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
