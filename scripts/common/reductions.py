"""Routes from a mesh to a reduction, and their costs: the APA300ML, and a plate of many remote points."""

from dataclasses import dataclass, replace
from typing import Any

import exudyn.FEM as exudyn_fem
import netgen.occ as occ  # before ngsolve: loads the CAD kernel
import ngsolve as ng
import numpy as np
import scipy.sparse as sp

from common.costs import clocks, cpu_cost_since, cpu_time
from common.limits import held_unknowns
from models.apa300ml import make_apa300ml
from nassim import (
    Encoder,
    FEModel,
    FlexibleBody,
    Material,
    PointForce,
    RemotePoint,
    RigidBody,
    Scene,
    Solid,
    condense,
    craig_bampton,
    fixed,
    linearize,
)
from nassim.base import eigenmodes, peak_memory
from nassim.fem import assemble_mesh, full_eigenfrequencies, generate_mesh, make_coupling, threads
from nassim.fem.solver import factorize

N_MODES = 6
N_SOLVES = 108
"""Solves of the reduction to five RBE2 points and six modes: 24 static modes, 64 for seven modes by Lanczos in blocks
of eight, 19 for the truncation error, one trial."""
GRID = (12, 10)
"""Numbers of patches of a plate along x and y."""
N_SINGLE = 6
"""Columns that are solved one by one, for the time of one."""


@dataclass(frozen=True)
class ExudynReduction:
    """Exudyn's FE interface with its mode basis, bilinear forms of mass and stiffness, and interface nodes."""

    fem: Any
    forms: tuple[Any, Any]
    interfaces: list[list[int]]


def reduce_by_exudyn(mesh: ng.Mesh, solid: Solid, *, n_modes: int, by_ngsolve: bool) -> ExudynReduction:
    """Reduce a mesh to Exudyn's Hurty-Craig-Bampton basis, by its NGSolve variant or by SciPy."""
    materials = {
        name: {"youngsModulus": m.young_modulus, "poissonsRatio": m.poisson_ratio, "density": m.density}
        for name, m in solid.materials.items()
    }
    fem = exudyn_fem.FEMinterface()
    faces = sorted({face for point in solid.remote_points for face in point.faces})
    mass, stiffness, _ = fem.ImportMeshFromNGsolve(mesh, materials=materials, meshOrder=2, boundaryNamesList=faces)
    interfaces = [
        sorted({node for face in point.faces for node in fem.GetNodesOfNGsolveBoundary(mesh, face)})
        for point in solid.remote_points
    ]
    if by_ngsolve:
        fem.ComputeHurtyCraigBamptonModesNGsolve(mass, stiffness, interfaces, n_modes)
    else:
        fem.ComputeHurtyCraigBamptonModes(interfaces, n_modes, useSparseSolver=True)
    return ExudynReduction(fem, (mass, stiffness), interfaces)


def full_model(reduction: ExudynReduction, solid: Solid) -> FEModel:
    """Convert Exudyn's matrices to a model with the full eigenfrequencies."""
    positions = reduction.fem.GetNodePositionsAsArray()
    n = len(positions)
    fields = np.vstack([np.ones(n), positions.T])
    couplings = tuple(
        make_coupling(point, np.array(nodes), fields[:, nodes], fields[:, nodes])
        for point, nodes in zip(solid.remote_points, reduction.interfaces, strict=True)
    )
    mass, stiffness = (_to_scipy(form.mat) for form in reduction.forms)
    return FEModel(solid.name, stiffness=stiffness, scalar_mass_matrix=mass[:n, :n], fields=fields, couplings=couplings)


def clamped_eigenfrequencies(reduction: ExudynReduction, model: FEModel) -> np.ndarray:
    """Return eigenfrequencies of Exudyn's basis [Hz], which has no motions of the first interface, so it is clamped."""
    basis = reduction.fem.modeBasis["matrix"]
    # Exudyn counts x y z per node, nassim all nodes per direction.
    basis = basis.reshape(-1, 3, basis.shape[1]).transpose(1, 0, 2).reshape(model.n_dofs, -1)
    return eigenmodes(basis.T @ (model.stiffness @ basis), basis.T @ (model.mass_matrix @ basis))[0]


def _to_scipy(matrix: Any) -> sp.csr_matrix:
    values, columns, starts = (np.array(part) for part in matrix.CSR())
    return sp.csr_matrix((values, columns, starts), shape=(matrix.height, matrix.width))


def measure(route: str, size: float, curvature: float) -> dict[str, Any]:
    """Measure time and memory of a route: "bare", "reduce", "limit", or a route of the comparison, with its error.

    "limit" is the time that nassim's route spends in the sparse solver.
    """
    if route in ("bare", "reduce"):
        solid = make_apa300ml()
        mesh = ng.Mesh(generate_mesh(solid, element_size=size, curvature=curvature))
        mesh.Curve(2)
        return bare_factorisation(mesh, solid) if route == "bare" else whole_reduction(mesh, solid)
    return solver_alone(size, curvature) if route == "limit" else beside_exudyn(route, size, curvature)


def whole_reduction(mesh: ng.Mesh, solid: Solid) -> dict[str, Any]:
    """Run everything after meshing."""
    start = clocks()
    body = craig_bampton(assemble_mesh(mesh, solid, 2), n_modes=N_MODES, discretization=False)
    n = len(body.mass_matrix)
    return {"nodes": ng.H1(mesh, order=2).ndof, "size": n, **cpu_cost_since(start)}


def bare_factorisation(mesh: ng.Mesh, solid: Solid) -> dict[str, Any]:
    """Run assembly and factorisation of the stiffness matrix only."""
    start = clocks()
    with threads():
        space = ng.VectorH1(mesh, order=2, dirichlet="bottom_pad")
        u, v = space.TnT()
        lame, mu = (mesh.MaterialCF({k: m.lame_parameters[i] for k, m in solid.materials.items()}) for i in (0, 1))
        stiffness = ng.BilinearForm(space, symmetric=True, symmetric_storage=True)
        stiffness += (
            2 * mu * ng.InnerProduct(ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))) + lame * ng.div(u) * ng.div(v)
        ) * ng.dx
        inverse = stiffness.Assemble().mat.Inverse(space.FreeDofs(), inverse="sparsecholesky")
    cost = cpu_cost_since(start)
    del inverse
    return {"nodes": space.ndof // 3, **cost}


def solver_alone(size: float, curvature: float) -> dict[str, Any]:
    """Run the assembly, the factorisation and the solves of nassim's route only, with all columns known at once.

    Also measure a single column, a column of a block, the memory of both, and the residual.
    """
    solid = make_apa300ml(coupling="rbe2", stack_coupling="rbe2")
    mesh = ng.Mesh(generate_mesh(solid, element_size=size, curvature=curvature))
    start = clocks()
    mesh.Curve(2)
    model = assemble_mesh(mesh, solid, 2)
    assembly = clocks() - start
    held = held_unknowns(model)
    columns = np.random.default_rng(0).standard_normal((model.n_dofs, N_SOLVES))
    columns[held] = 0.0
    before, start = peak_memory(), clocks()
    factor, factorisation = cpu_time(factorize, model.stiffness, held=held)
    solution, solving = cpu_time(factor.solve, columns)
    whole = assembly + clocks() - start
    grown = peak_memory() - before
    single = cpu_time(lambda: [factor.solve(columns[:, k]) for k in range(N_SINGLE)])[1]
    residual = model.stiffness @ solution - columns
    residual[held] = 0.0
    return {
        "nodes": model.n_dofs // 3,
        "n_solves": N_SOLVES,
        "time_s": factorisation + solving,
        "with_assembly_s": whole[0],
        "wall_s": whole[1],
        "factorisation_s": factorisation,
        "column_s": single / N_SINGLE,
        "column_of_block_s": solving / N_SOLVES,
        "solver_memory_B": grown,
        "residual": float(np.linalg.norm(residual) / np.linalg.norm(columns)),
    }


def beside_exudyn(route: str, size: float, curvature: float) -> dict[str, Any]:
    """Run one route from the mesh to its mode basis or reduced body; return its error."""
    solid = make_apa300ml(coupling="rbe2", stack_coupling="rbe2")
    mesh = ng.Mesh(generate_mesh(solid, element_size=size, curvature=curvature))
    start = clocks()
    if route == "nassim":
        mesh.Curve(2)
        model = assemble_mesh(mesh, solid, 2)
        assembly = cpu_cost_since(start)["time_s"]
        body = craig_bampton(model, n_modes=N_MODES, discretization=False)
        cost = {**cpu_cost_since(start), "assembly_s": assembly}
        found = body.eigenfrequencies(fixed=["bottom"])
    else:
        reduction = reduce_by_exudyn(mesh, solid, n_modes=N_MODES, by_ngsolve=route == "exudyn_ngsolve")
        cost = cpu_cost_since(start)
        model = full_model(reduction, solid)
        found = clamped_eigenfrequencies(reduction, model)
    full = full_eigenfrequencies(condense(model), fixed=["bottom"], n=10)
    errors = found[:10] / full - 1
    return {"nodes": model.n_dofs // 3, "error": float(np.abs(errors).max()), "errors": errors.tolist(), **cost}


def plate() -> FEModel:
    """Mesh a steel plate of 0.6 m whose 120 remote points, on patches of five vertices, cover its top."""
    nx, ny = GRID
    cell, thickness = 0.05, 0.01
    shape = occ.Box(occ.Pnt(0, 0, 0), occ.Pnt(nx * cell, ny * cell, thickness))
    shape.name = "plate"
    solid = Solid("plate", shape, {"plate": Material("steel", 200e9, 0.3, 7800.0)}, ())
    mesh = ng.Mesh(generate_mesh(solid, element_size=0.4 * cell))
    model = assemble_mesh(mesh, solid, 2)
    corners = np.array([vertex.point for vertex in mesh.vertices])  # the first unknowns
    top = np.flatnonzero(np.abs(corners[:, 2] - thickness) < 1e-6 * thickness)
    couplings = []
    for k in range(nx * ny):
        centre = np.array([(k // ny + 0.5) * cell, (k % ny + 0.5) * cell, thickness])
        nearest = np.sort(top[np.argsort(np.linalg.norm(corners[top] - centre, axis=1))[:5]])
        fields = model.fields[:, nearest]
        couplings.append(make_coupling(RemotePoint(f"p{k}", f"f{k}", centre), nearest, fields, fields))
    return replace(model, couplings=tuple(couplings))


def many_points(count: int) -> dict[str, float]:
    """Measure the reduction of the plate to its first `count` remote points, and what follows from it.

    The limit of the reduction is its solver and the integrals of its fields: a product of all vectors with each other.
    """
    model = plate()
    names = [f"p{k}" for k in range(count)]
    condensed, condensing = cpu_time(condense, model, remote_points=names, progress=False)
    body, reducing = cpu_time(craig_bampton, condensed, n_modes=N_MODES, discretization=False, progress=False)
    scene = Scene(
        "plate",
        (
            RigidBody("ground", {"end": body.remote_points[0].position}, fixed=True),
            FlexibleBody("plate", body, fidelity="linear"),
        ),
        (fixed("clamp", "ground.end", f"plate.{names[0]}"),),
        (PointForce("push", f"plate.{names[-1]}", "z", "force"),),
        (Encoder("height", "ground.end", f"plate.{names[-1]}", "z"),),
        damping_ratio=0.01,
    )
    vectors = 0 if body.enriched is None else len(body.enriched.mass_matrix) - N_MODES
    columns = np.random.default_rng(0).standard_normal((model.n_dofs, vectors))
    corners = np.add.outer(np.arange(3) * (model.n_dofs // 3), np.arange(3)).ravel()  # x, y and z of three vertices
    factor, factorisation = cpu_time(factorize, model.stiffness, held=corners)
    solving = cpu_time(factor.solve, columns)[1]
    rows = columns.T.reshape(-1, model.n_dofs // 3)
    return {
        "points": count,
        "nodes": model.n_dofs // 3,
        "reduction_s": condensing + reducing,
        "limit_s": factorisation + solving + 0.5 * cpu_time(np.matmul, rows, (model.scalar_mass_matrix @ rows.T))[1],
        "errors_s": cpu_time(body.truncation_errors, fixed=names[:1])[1],
        "linearize_s": cpu_time(linearize, scene)[1],
    }
