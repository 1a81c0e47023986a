"""Routes from the APA300ML's mesh to its reduction, with what each costs, for benchmark_reduction.py."""

import time
from typing import Any

import netgen.occ  # noqa: F401  (before ngsolve: loads the CAD kernel)
import ngsolve as ng
import numpy as np
from _costs import cost_since
from _exudyn_reduction import clamped_eigenfrequencies, full_model, reduce_by_exudyn
from _limits import held_unknowns

from models.apa300ml import make_apa300ml
from nassim import Solid, condense, craig_bampton
from nassim.fem import assemble_mesh, full_eigenfrequencies, generate_mesh, threads
from nassim.fem.solver import factorize

N_MODES = 6
N_SOLVES = 78
"""What the reduction to five rbe2 points and six modes takes: 24 static modes, 34 for seven modes by Lanczos, 19 for
the truncation error, one trial."""


def measure(route: str, size: float, curvature: float) -> dict[str, Any]:
    """Time and memory of a route: "bare", "reduce", or one of those that stand side by side with their errors.

    "limit" is one of the latter: what nassim's route spends in the sparse solver alone.
    """
    if route in ("bare", "reduce"):
        solid = make_apa300ml()
        mesh = ng.Mesh(generate_mesh(solid, element_size=size, curvature=curvature))
        mesh.Curve(2)
        return bare_factorisation(mesh, solid) if route == "bare" else whole_reduction(mesh, solid)
    return solver_alone(size, curvature) if route == "limit" else beside_exudyn(route, size, curvature)


def whole_reduction(mesh: ng.Mesh, solid: Solid) -> dict[str, Any]:
    """Everything after meshing."""
    start = time.perf_counter()
    body = craig_bampton(assemble_mesh(mesh, solid, 2), n_modes=N_MODES)
    n = len(body.mass_matrix)
    return {"nodes": ng.H1(mesh, order=2).ndof, "size": n, **cost_since(start)}


def bare_factorisation(mesh: ng.Mesh, solid: Solid) -> dict[str, Any]:
    """Only assembly and factorisation of the stiffness matrix."""
    start = time.perf_counter()
    with threads():
        space = ng.VectorH1(mesh, order=2, dirichlet="bottom_pad")
        u, v = space.TnT()
        lame, mu = (mesh.MaterialCF({k: m.lame_parameters[i] for k, m in solid.materials.items()}) for i in (0, 1))
        stiffness = ng.BilinearForm(space, symmetric=True, symmetric_storage=True)
        stiffness += (
            2 * mu * ng.InnerProduct(ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))) + lame * ng.div(u) * ng.div(v)
        ) * ng.dx
        inverse = stiffness.Assemble().mat.Inverse(space.FreeDofs(), inverse="sparsecholesky")
    cost = cost_since(start)
    del inverse
    return {"nodes": space.ndof // 3, **cost}


def solver_alone(size: float, curvature: float) -> dict[str, Any]:
    """The factorisation and the solves that nassim's route makes, all columns known at once, and nothing else."""
    solid = make_apa300ml(coupling="rbe2", stack_coupling="rbe2")
    mesh = ng.Mesh(generate_mesh(solid, element_size=size, curvature=curvature))
    mesh.Curve(2)
    model = assemble_mesh(mesh, solid, 2)
    columns = np.random.default_rng(0).standard_normal((model.n_dofs, N_SOLVES))
    held = held_unknowns(model)
    start = time.perf_counter()
    factor = factorize(model.stiffness, held=held)
    factor.solve(columns)
    cost = cost_since(start)
    return {"nodes": model.n_dofs // 3, "factorisation_s": factor.seconds, "n_solves": N_SOLVES, **cost}


def beside_exudyn(route: str, size: float, curvature: float) -> dict[str, Any]:
    """One route from the mesh to its mode basis or reduced body, and its error."""
    solid = make_apa300ml(coupling="rbe2", stack_coupling="rbe2")
    mesh = ng.Mesh(generate_mesh(solid, element_size=size, curvature=curvature))
    start = time.perf_counter()
    if route == "nassim":
        mesh.Curve(2)
        model = assemble_mesh(mesh, solid, 2)
        body = craig_bampton(model, n_modes=N_MODES)
        cost = cost_since(start)
        found = body.eigenfrequencies(fixed=["bottom"])
    else:
        reduction = reduce_by_exudyn(mesh, solid, n_modes=N_MODES, by_ngsolve=route == "exudyn_ngsolve")
        cost = cost_since(start)
        model = full_model(reduction, solid)
        found = clamped_eigenfrequencies(reduction, model)
    full = full_eigenfrequencies(condense(model), fixed=["bottom"], n=10)
    errors = found[:10] / full - 1
    return {"nodes": model.n_dofs // 3, "error": float(np.abs(errors).max()), "errors": errors.tolist(), **cost}
