"""Compare the reduction of the APA300ML with Exudyn's own reductions, and time it alone at the paper's size.

Every route runs in its own process, from the same mesh of order 2 to its mode basis or reduced body, with RBE2 coupling
and 6 modes. Exudyn reduces by FEMinterface.ComputeHurtyCraigBamptonModes (SciPy) and by its NGSolve variant. Errors are
those of the first ten clamped eigenfrequencies relative to the full model of the same matrices. The difference is the
largest difference between the errors of two routes. The limit is the time that nassim's route spends in the sparse
solver. At the paper's size, the table also has the times of assembly and factorisation of the stiffness matrix.
"""

import json
from typing import Any

import numpy as np

from common.arguments import not_negative, parser, run
from common.costs import run_in_own_process
from common.reductions import measure
from common.report import print_report, print_table, write_summary

SIZES = {"2.5k": (10.0, 0.1), "7.5k": (5.0, 0.5), "22k": (2.2, 0.5)}  # element size [mm], curvature
ROUTES = {"nassim": "nassim", "exudyn": "Exudyn (SciPy)", "exudyn_ngsolve": "Exudyn (NGSolve)"}

arguments = parser(__doc__, "benchmark_reduction")
arguments.add_argument("--sizes", nargs="*", default=list(SIZES), choices=list(SIZES), help="mesh sizes (default: all)")
arguments.add_argument(
    "--paper-size", type=not_negative, default=0.92, help="element size at the paper's size [mm]; 0: skip that part"
)
arguments.add_argument("--child", nargs=3, metavar=("ROUTE", "SIZE", "CURVATURE"), help="for the script's own use")
COSTS = {"time [s]": "time_s:.2f", "memory [GB]": "memory_B*1e-9:.2f"}
COLUMNS = {
    "limit [s]": "limit_s:.2f",
    "times nassim": "ratio:.1f",
    "error": "error:.2e",
    "difference": "difference:.1e",
}


def main() -> None:
    args = arguments.parse_args()
    if args.child:
        route, size, curvature = args.child
        print("\n" + json.dumps(measure(route, 1e-3 * float(size), float(curvature))))
        return
    summary: dict[str, Any] = {}
    for label in args.sizes:
        rows = {route: run_in_own_process(__file__, route, *SIZES[label]) for route in [*ROUTES, "limit"]}
        summary[label] = rows
        for route in list(ROUTES)[1:]:
            summary[f"{label}_speed_ratio_to_{route}"] = rows[route]["time_s"] / rows["nassim"]["time_s"]
            apart = np.subtract(rows["nassim"]["errors"], rows[route]["errors"])
            rows[route]["difference"] = np.abs(apart).max()
    if args.paper_size:
        bare, ours = (run_in_own_process(__file__, route, args.paper_size, 0.5) for route in ("bare", "reduce"))
        ratios = {"time": ours["time_s"] / bare["time_s"], "memory": ours["memory_B"] / bare["memory_B"]}
        summary["paper"] = {"bare": bare, "nassim": ours, "ratios": ratios, "n_dofs": 3 * ours["nodes"]}

    for label in args.sizes:
        rows = {title: dict.fromkeys(("limit_s", "ratio", "difference")) for title in ROUTES.values()}
        for route, title in ROUTES.items():
            rows[title] |= summary[label][route] | {"ratio": summary.get(f"{label}_speed_ratio_to_{route}")}
        rows["nassim"]["limit_s"] = summary[label]["limit"]["time_s"]
        print_table(f"{summary[label]['nassim']['nodes']} nodes", rows, COSTS | COLUMNS)
        limit = summary[label]["limit"]
        print_report(
            "limit: {time_s:.2f} s in the sparse solver alone, {factorisation_s:.2f} s to factorise and the rest for "
            "{n_solves} solves",
            limit,
        )
    if args.paper_size:
        title = f"{summary['paper']['n_dofs']} degrees of freedom, rbe3, {ours['size']} coordinates"
        rows = {"assembly and bare factorisation": bare, "the whole reduction": ours}
        print_table(title, rows, COSTS)
        print_report("ratio {time:.2f} in time, {memory:.2f} in memory", summary["paper"]["ratios"])
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
