"""Compare the reduction of the APA300ML with Exudyn's own reductions, and time it alone at the paper's size.

Every route runs in its own process and on one thread, from the same mesh of order 2 to its mode basis or reduced body,
with RBE2 coupling and 6 modes. Times are the processor's, so other work on the machine matters little. nassim runs with
its own solver, which every installation has, then with each further one that is installed; a table compares the solvers
on the same matrix. Exudyn reduces by FEMinterface.ComputeHurtyCraigBamptonModes (SciPy) and by its NGSolve variant.
Errors are those of the first ten clamped eigenfrequencies relative to the full model of the same matrices. The
difference is the largest difference between the errors of two routes. The limit is the time of the factorisation and of
the solves alone, of as many columns as solvers of blocks need. The largest speed ratio is what a reduction of nothing
but assembly and this factorisation would reach. At the paper's size, the table also has the times of assembly and
factorisation of the stiffness matrix.

A last table shows how costs grow with remote points: the reduction of a plate, its errors and a linear model.
"""

import json
from typing import Any

import numpy as np

from common.arguments import not_negative, parser, run, several, whole
from common.costs import ONE_THREAD, run_in_own_process
from common.reductions import many_points, measure
from common.report import print_report, print_table, write_summary
from nassim.fem.solver import SOLVERS

SIZES = {"2.5k": (10.0, 0.1), "7.5k": (5.0, 0.5), "22k": (2.2, 0.5)}  # element size [mm], curvature
EMBEDDED = "multifrontal"
"""The solver that every installation uses if it has no other."""
ROUTES = {"nassim": "nassim", "exudyn": "Exudyn (SciPy)", "exudyn_ngsolve": "Exudyn (NGSolve)"}

arguments = parser(__doc__, "benchmark_reduction")
arguments.add_argument("--sizes", nargs="*", default=list(SIZES), choices=list(SIZES), help="mesh sizes (default: all)")
arguments.add_argument(
    "--paper-size", type=not_negative, default=0.92, help="element size at the paper's size [mm]; 0: skip that part"
)
arguments.add_argument(
    "--points",
    type=several(whole(1)),
    default="30,60,120",
    help="numbers of remote points of a plate, at most 120; '' skips that part (default: %(default)s)",
)
arguments.add_argument("--child", nargs=3, metavar=("ROUTE", "SIZE", "CURVATURE"), help="for the script's own use")
COSTS = {"time [s]": "time_s:.2f", "memory [GB]": "memory_B*1e-9:.2f"}
COLUMNS = {
    "times nassim": "ratio:.1f",
    "error": "error:.2e",
    "difference": "difference:.1e",
}
POINT_COLUMNS = {
    "reduction [s]": "reduction_s:.2f",
    "its limit [s]": "limit_s:.2f",
    "truncation errors [s]": "errors_s:.3f",
    "linearize [s]": "linearize_s:.3f",
}
SOLVER_COLUMNS = {
    "factorise [s]": "factorisation_s:.2f",
    "a column [ms]": "column_s*1e3:.1f",
    "a column of a block [ms]": "column_of_block_s*1e3:.1f",
    "memory [GB]": "solver_memory_B*1e-9:.2f",
    "residual": "residual:.0e",
    "whole reduction [s]": "reduction_s:.2f",
    "share of assembly and factorisation": "share_of_assembly_and_factorisation:.2f",
}


def measured(route: str, size: float, curvature: float, solver: str = EMBEDDED) -> dict[str, Any]:
    """What a route costs in a process of its own."""
    return run_in_own_process(__file__, route, size, curvature, environment=ONE_THREAD | {"NASSIM_SOLVER": solver})


def main() -> None:
    args = arguments.parse_args()
    if args.child:
        route, size, curvature = args.child
        work = (
            many_points(round(float(size)))
            if route == "points"
            else measure(route, 1e-3 * float(size), float(curvature))
        )
        print("\n" + json.dumps(work))
        return
    solvers = [name for name, solver in SOLVERS.items() if solver.is_installed()]
    summary: dict[str, Any] = {}
    for label in args.sizes:
        rows = {route: measured(route, *SIZES[label]) for route in ROUTES}
        alone = {name: measured("limit", *SIZES[label], name) for name in solvers}
        for name in solvers:
            whole = rows["nassim"] if name == EMBEDDED else measured("nassim", *SIZES[label], name)
            alone[name]["reduction_s"] = whole["time_s"]
            floor = whole["assembly_s"] + alone[name]["factorisation_s"]
            alone[name]["share_of_assembly_and_factorisation"] = floor / whole["time_s"]
            for route in list(ROUTES)[1:]:
                alone[name][f"speed_ratio_to_{route}"] = rows[route]["time_s"] / whole["time_s"]
                alone[name][f"largest_speed_ratio_to_{route}"] = rows[route]["time_s"] / floor
            if name != EMBEDDED:
                rows[f"nassim_{name}"] = whole
        summary[label] = rows | {"limit": alone[EMBEDDED], "solvers": alone}
        for route, row in rows.items():
            row["ratio"] = row["time_s"] / rows["nassim"]["time_s"]
            row["difference"] = float(np.abs(np.subtract(rows["nassim"]["errors"], row["errors"])).max())
            if route in ROUTES and route != "nassim":
                summary[f"{label}_speed_ratio_to_{route}"] = row["ratio"]
    if args.paper_size:
        bare, ours = (measured(route, args.paper_size, 0.5) for route in ("bare", "reduce"))
        ratios = {"time": ours["time_s"] / bare["time_s"], "memory": ours["memory_B"] / bare["memory_B"]}
        summary["paper"] = {"bare": bare, "nassim": ours, "ratios": ratios, "n_dofs": 3 * ours["nodes"]}
    summary["points"] = {f"{count:g}": measured("points", count, 0.0) for count in args.points}

    for label in args.sizes:
        found = summary[label]
        titles = ROUTES | {f"nassim_{name}": f"nassim, {name}" for name in solvers if name != EMBEDDED}
        print_table(
            f"{found['nassim']['nodes']} nodes", {title: found[key] for key, title in titles.items()}, COSTS | COLUMNS
        )
        print_table("solver", found["solvers"], SOLVER_COLUMNS)
        print_report(
            "limit of nassim: {time_s:.2f} s in the sparse solver alone, {factorisation_s:.2f} s to factorise and the "
            "rest for {n_solves} solves",
            found["limit"],
        )
    if args.paper_size:
        title = f"{summary['paper']['n_dofs']} degrees of freedom, rbe3, {ours['size']} coordinates"
        rows = {"assembly and bare factorisation": bare, "the whole reduction": ours}
        print_table(title, rows, COSTS)
        print_report("ratio {time:.2f} in time, {memory:.2f} in memory", summary["paper"]["ratios"])
    print_table("remote points of a plate", summary["points"], POINT_COLUMNS)
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
