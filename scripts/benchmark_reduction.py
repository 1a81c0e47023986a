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

With --turns, the routes also run in turns on one thread and on as many threads as their libraries choose, in wall time.
The ratios are those of Exudyn's time (SciPy) to a route's in the same turn: their median, the smallest and the largest.
The limit is here the assembly, the factorisation and the solves.

A last table shows how costs grow with remote points: the reduction of a plate, its errors and a linear model. The
exponents are least-squares fits of the logarithms.
"""

import json
from typing import Any

import numpy as np

from common.arguments import not_negative, parser, run, several, whole
from common.costs import DEFAULT_THREADS, ONE_THREAD, run_in_own_process
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
arguments.add_argument("--turns", type=whole(0), default=0, help="turns of the comparison of threads (default: none)")
arguments.add_argument("--child", nargs=3, metavar=("ROUTE", "SIZE", "CURVATURE"), help="for the script's own use")
COSTS = {"time [s]": "time_s:.2f", "memory [GB]": "memory_B*1e-9:.2f"}
COLUMNS = {
    "times nassim": "ratio:.1f",
    "error": "error:.2e",
    "difference": "difference:.1e",
}
THREAD_COLUMNS = {
    "wall [s]": "wall_s:.2f",
    "processors [s]": "time_s:.2f",
    "times as fast as Exudyn": "ratio:.1f",
    "smallest": "smallest_ratio:.1f",
    "largest": "largest_ratio:.1f",
    "by processors' time": "processor_ratio:.1f",
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


def in_turns(size: tuple[float, float], turns: int) -> dict[str, dict[str, dict[str, float]]]:
    """Costs of the routes and of their limits by environment and route, and Exudyn's times over them."""
    solvers = {"": EMBEDDED} | ({"_pardiso": "pardiso"} if SOLVERS["pardiso"].is_installed() else {})
    routes = {f"{kind}{end}": (kind, solver) for end, solver in solvers.items() for kind in ("nassim", "limit")}
    routes |= {route: (route, EMBEDDED) for route in list(ROUTES)[1:]}
    environments = {"one": ONE_THREAD, "default": DEFAULT_THREADS}
    costs: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for _ in range(turns):
        for label, variables in environments.items():
            for key, (route, solver) in routes.items():
                found = run_in_own_process(
                    __file__, route, *size, environment=dict(variables) | {"NASSIM_SOLVER": solver}
                )
                costs.setdefault((label, key), []).append(
                    (found["wall_s"], found.get("with_assembly_s", found["time_s"]))
                )
    result: dict[str, dict[str, dict[str, float]]] = {}
    for (label, key), times in costs.items():
        ratios = np.divide(costs[label, "exudyn"], times)
        result.setdefault(label, {})[key] = {
            "wall_s": np.median(times, axis=0)[0],
            "time_s": np.median(times, axis=0)[1],
            "ratio": np.median(ratios, axis=0)[0],
            "smallest_ratio": ratios[:, 0].min(),
            "largest_ratio": ratios[:, 0].max(),
            "processor_ratio": np.median(ratios, axis=0)[1],
        }
    return result


def exponents(rows: list[dict[str, float]]) -> dict[str, float]:
    """Exponents p of time ~ points^p, of each time of the plates; none for fewer than two plates."""
    if len(rows) < 2:
        return {}
    points = np.log([row["points"] for row in rows])
    return {key: np.polyfit(points, np.log([row[key] for row in rows]), 1)[0] for key in rows[0] if key.endswith("_s")}


def report(found: dict[str, Any], solvers: list[str]) -> None:
    """Print the tables of one size."""
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
    for threads, costs in found["threads"].items():
        print_table(f"threads: {threads}", costs, THREAD_COLUMNS)


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
        summary[label]["threads"] = in_turns(SIZES[label], args.turns)
    if args.paper_size:
        bare, ours = (measured(route, args.paper_size, 0.5) for route in ("bare", "reduce"))
        ratios = {"time": ours["time_s"] / bare["time_s"], "memory": ours["memory_B"] / bare["memory_B"]}
        summary["paper"] = {"bare": bare, "nassim": ours, "ratios": ratios, "n_dofs": 3 * ours["nodes"]}
    summary["points"] = {f"{count:g}": measured("points", count, 0.0) for count in args.points}
    summary["exponents"] = exponents(list(summary["points"].values()))

    for label in args.sizes:
        report(summary[label], solvers)
    if args.paper_size:
        title = f"{summary['paper']['n_dofs']} degrees of freedom, rbe3, {ours['size']} coordinates"
        rows = {"assembly and bare factorisation": bare, "the whole reduction": ours}
        print_table(title, rows, COSTS)
        print_report("ratio {time:.2f} in time, {memory:.2f} in memory", summary["paper"]["ratios"])
    print_table("remote points of a plate", summary["points"], POINT_COLUMNS)
    if summary["exponents"]:
        print_report(
            "exponents p of time ~ points^p: reduction {reduction_s:.1f}, its limit {limit_s:.1f}, truncation errors "
            "{errors_s:.1f}, linearize {linearize_s:.1f}",
            summary["exponents"],
        )
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
