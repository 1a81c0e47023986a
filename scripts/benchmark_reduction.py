"""Reduce the APA300ML side by side with Exudyn's own reductions, and alone at the paper's size.

Every route runs in a process of its own from the same mesh of order 2 to its mode basis or reduced body, with rbe2 and
6 modes. Exudyn reduces by FEMinterface.ComputeHurtyCraigBamptonModes (SciPy) and by its NGSolve variant. Errors are
those of the first ten clamped eigenfrequencies against the full model of the same matrices. At the paper's size the
reduction stands beside assembly and bare factorisation of the stiffness matrix.
"""

import json
import time
from typing import Any

import exudyn.FEM as exudyn_fem
import netgen.occ  # noqa: F401  (before ngsolve: loads the CAD kernel)
import ngsolve as ng
import numpy as np
import scipy.sparse as sp
from _common import not_negative, parser, peak_memory, run, run_in_own_process, write_summary

from models.apa300ml import make_apa300ml
from nassim import FEModel, Solid, condense, craig_bampton
from nassim.base import eigenmodes
from nassim.fem import assemble_mesh, full_eigenfrequencies, generate_mesh, make_coupling, threads

SIZES = {"2.5k": (10.0, 0.1), "7.5k": (5.0, 0.5), "22k": (2.2, 0.5)}  # element size [mm], curvature
ROUTES = {"nassim": "nassim", "exudyn": "Exudyn (SciPy)", "exudyn_ngsolve": "Exudyn (NGSolve)"}
N_MODES = 6

arguments = parser(__doc__, "benchmark_reduction")
arguments.add_argument("--sizes", nargs="*", default=list(SIZES), choices=list(SIZES), help="(default: all)")
arguments.add_argument(
    "--paper-size", type=not_negative, default=0.92, help="element size of the last part [mm]; 0: skip"
)
arguments.add_argument("--child", nargs=3, metavar=("ROUTE", "SIZE", "CURVATURE"), help="for the script's own use")


def main() -> None:
    args = arguments.parse_args()
    if args.child:
        route, size, curvature = args.child
        child = alone if route in ("bare", "reduce") else beside_exudyn
        print("\n" + json.dumps(child(route, 1e-3 * float(size), float(curvature))))
        return
    summary: dict[str, Any] = {}
    for label in args.sizes:
        rows = {route: run_in_own_process(__file__, "--child", route, *SIZES[label]) for route in ROUTES}
        print(f"\n{rows['nassim']['nodes']} nodes      time [s]   memory [GB]   largest error of 10 eigenfrequencies")
        for route, row in rows.items():
            print(f"  {ROUTES[route]:<17}{row['time_s']:8.2f} {1e-9 * row['memory_B']:10.2f} {row['error']:18.2e}")
        for route in list(ROUTES)[1:]:
            ratio = rows[route]["time_s"] / rows["nassim"]["time_s"]
            print(f"  nassim is {ratio:.1f} times as fast as {ROUTES[route]}")
            summary[f"{label}_speed_ratio_to_{route}"] = ratio
        summary[label] = rows
    if args.paper_size:
        rows = {
            route: run_in_own_process(__file__, "--child", route, args.paper_size, 0.5) for route in ("bare", "reduce")
        }
        bare, ours = rows.values()
        print(f"\n{ours['nodes']} nodes, {3 * ours['nodes']} degrees of freedom, rbe3, {ours['size']} coordinates")
        print(f"  assembly and bare factorisation {bare['time_s']:7.1f} s {1e-9 * bare['memory_B']:6.2f} GB")
        print(f"  the whole reduction             {ours['time_s']:7.1f} s {1e-9 * ours['memory_B']:6.2f} GB")
        ratios = {"time": ours["time_s"] / bare["time_s"], "memory": ours["memory_B"] / bare["memory_B"]}
        print(f"  ratio                           {ratios['time']:7.2f}   {ratios['memory']:6.2f}")
        summary["paper"] = {"bare": bare, "nassim": ours, "ratios": ratios, "n_dofs": 3 * ours["nodes"]}
    write_summary(args.output, summary)


def alone(route: str, size: float, curvature: float) -> dict[str, Any]:
    """Time and memory of everything after meshing: the reduction, or assembly and factorisation only."""
    solid = make_apa300ml()
    mesh = ng.Mesh(generate_mesh(solid, element_size=size, curvature=curvature))
    mesh.Curve(2)
    if route == "reduce":
        start = time.perf_counter()
        body = craig_bampton(assemble_mesh(mesh, solid, 2), n_modes=N_MODES)
        n = len(body.mass_matrix)
        return {"nodes": ng.H1(mesh, order=2).ndof, "size": n, **_cost(start)}
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
    cost = _cost(start)
    del inverse
    return {"nodes": space.ndof // 3, **cost}


def beside_exudyn(route: str, size: float, curvature: float) -> dict[str, Any]:
    """One route from the mesh to its mode basis or reduced body, and its error."""
    solid = make_apa300ml(coupling="rbe2", stack_coupling="rbe2")
    mesh = ng.Mesh(generate_mesh(solid, element_size=size, curvature=curvature))
    start = time.perf_counter()
    if route == "nassim":
        mesh.Curve(2)
        model = assemble_mesh(mesh, solid, 2)
        body = craig_bampton(model, n_modes=N_MODES)
        cost = _cost(start)
        found = body.eigenfrequencies(fixed=["bottom"])
    else:
        fem, forms = _import_by_exudyn(mesh, solid)
        interfaces = _interfaces(fem, mesh, solid)
        if route == "exudyn":
            fem.ComputeHurtyCraigBamptonModes(interfaces, N_MODES, useSparseSolver=True)
        else:
            fem.ComputeHurtyCraigBamptonModesNGsolve(*forms, interfaces, N_MODES)
        cost = _cost(start)
        model = _as_fe_model(fem, forms, interfaces, solid)
        # Exudyn leaves out the first interface's motions, which amounts to clamping it; x y z per node.
        basis = fem.modeBasis["matrix"].reshape(-1, 3, fem.modeBasis["matrix"].shape[1]).transpose(1, 0, 2)
        basis = basis.reshape(model.n_dofs, -1)
        found = eigenmodes(basis.T @ (model.stiffness @ basis), basis.T @ (model.mass_matrix @ basis))[0]
    full = full_eigenfrequencies(condense(model), fixed=["bottom"], n=10)
    return {"nodes": model.n_dofs // 3, "error": float(np.abs(found[:10] / full - 1).max()), **cost}


def _cost(start: float) -> dict[str, float]:
    return {"time_s": time.perf_counter() - start, "memory_B": peak_memory()}


def _import_by_exudyn(mesh: ng.Mesh, solid: Solid) -> tuple[Any, tuple[Any, Any]]:
    """Exudyn's FE interface with its bilinear forms of mass and stiffness."""
    materials = {
        name: {"youngsModulus": m.young_modulus, "poissonsRatio": m.poisson_ratio, "density": m.density}
        for name, m in solid.materials.items()
    }
    fem = exudyn_fem.FEMinterface()
    faces = sorted({face for point in solid.remote_points for face in point.faces})
    mass, stiffness, _ = fem.ImportMeshFromNGsolve(mesh, materials=materials, meshOrder=2, boundaryNamesList=faces)
    return fem, (mass, stiffness)


def _interfaces(fem: Any, mesh: ng.Mesh, solid: Solid) -> list[list[int]]:
    """The nodes of each remote point's faces."""
    return [
        sorted({node for face in point.faces for node in fem.GetNodesOfNGsolveBoundary(mesh, face)})
        for point in solid.remote_points
    ]


def _as_fe_model(fem: Any, forms: tuple[Any, Any], interfaces: list[list[int]], solid: Solid) -> FEModel:
    """Exudyn's own matrices in the form of which nassim knows the full eigenfrequencies."""
    positions = fem.GetNodePositionsAsArray()
    n = len(positions)
    fields = np.vstack([np.ones(n), positions.T])
    couplings = tuple(
        make_coupling(point, np.array(nodes), fields[:, nodes], fields[:, nodes])
        for point, nodes in zip(solid.remote_points, interfaces, strict=True)
    )
    mass, stiffness = (_to_scipy(form.mat) for form in forms)
    return FEModel(solid.name, stiffness=stiffness, scalar_mass_matrix=mass[:n, :n], fields=fields, couplings=couplings)


def _to_scipy(matrix: Any) -> sp.csr_matrix:
    values, columns, starts = (np.array(part) for part in matrix.CSR())
    return sp.csr_matrix((values, columns, starts), shape=(matrix.height, matrix.width))


if __name__ == "__main__":
    run(main)
