"""Speed against error of reductions: which elements, how many modes and which coupling pay.

Every variant runs in a process of its own. Errors are those of the first five eigenfrequencies, clamped at the bottom
and free, and of the axial stiffness, against the finest variant, whose own convergence stands above the table; they
hold no error of truncation. The errors by number of modes kept are those of truncation alone.
"""

import json

from _arguments import parser, run
from _costs import run_in_own_process
from _reduction_errors import PRISMS, TETS, Variant, compare_modes, described, errors_against, measure
from _report import print_table
from _results import write_summary
from _variants import by_name, save_pareto, write_rows

REFERENCE: list[Variant] = [(PRISMS, order, 5.0, "rbe3") for order in (3, 4, 5)]
VARIANTS: list[Variant] = [
    *((TETS, 1, size, "rbe3") for size in (5.0, 2.0)),
    *((TETS, 2, size, "rbe3") for size in (8.0, 5.0, 2.0)),
    *((TETS, 3, size, "rbe3") for size in (8.0, 5.0, 3.0)),
    *((TETS, 4, size, "rbe3") for size in (8.0, 5.0)),
    *((PRISMS, 2, size, "rbe3") for size in (5.0, 3.0)),
    *((PRISMS, 3, size, "rbe3") for size in (8.0, 5.0, 3.0)),
    (PRISMS, 4, 5.0, "rbe3"),
    (PRISMS, 3, 5.0, "rbe2"),
]
QUICK_REFERENCE: list[Variant] = [(TETS, 1, 5.0, "rbe3"), (TETS, 2, 5.0, "rbe3")]
QUICK: list[Variant] = [(TETS, 1, 8.0, "rbe3"), (TETS, 2, 8.0, "rbe2")]
ANSWERS = {
    "DoF": "n_dofs",
    **{f"{k + 1} [Hz]": f"clamped_Hz/{k}:.2f" for k in range(5)},
    "stiffness [N/um]": "stiffness_N_per_m*1e-6:.4f",
}
ERRORS = {
    "DoF": "n_dofs",
    **{f"{kind} [%]": f"{kind}_error*100:.3f" for kind in ("clamped", "free", "stiffness")},
    "time [s]": "time_s:.1f",
    "memory [GB]": "memory_B*1e-9:.2f",
}
TRUNCATION = {
    "coordinates": "n_coordinates",
    "clamped [%]": "clamped*100:.5f",
    "estimate": "clamped_estimate*100:.5f",
    "free [%]": "free*100:.5f",
    "its estimate": "free_estimate*100:.5f",
}

arguments = parser(__doc__, "speed_vs_error")
arguments.add_argument("--quick", action="store_true", help="few coarse variants, to see the report's form")
arguments.add_argument(
    "--child", nargs=4, metavar=("KIND", "ORDER", "SIZE", "COUPLING"), help="for the script's own use"
)


def main() -> None:
    args = arguments.parse_args()
    if args.child:
        kind, order, size, coupling = args.child
        print("\n" + json.dumps(measure((kind, int(order), float(size), coupling))))
        return
    references, variants = (QUICK_REFERENCE, QUICK) if args.quick else (REFERENCE, VARIANTS)
    reference = [described(variant) | run_in_own_process(__file__, *variant) for variant in references]
    rows = [described(variant) | run_in_own_process(__file__, *variant) for variant in variants]
    rows = [row | errors_against(reference[-1], row) for row in rows]
    summary = {"reference": reference, "variants": rows, "modes": compare_modes(references[0])}

    print_table("convergence of the reference, clamped", by_name(reference), ANSWERS)
    print_table("largest error of five frequencies", by_name(rows), ERRORS)
    print_table("modes kept: largest truncation error of five frequencies", by_name(summary["modes"]), TRUNCATION)
    columns = ["name", "n_dofs", "clamped_error", "free_error", "stiffness_error", "time_s", "memory_B"]
    write_rows(args.output / "variants.csv", rows, columns)
    if not args.no_plot:
        save_pareto(
            args.output / "pareto.png",
            [row for row in rows if row["coupling"] == "rbe3"],
            ("time, mesh included [s]", "largest error of five clamped eigenfrequencies [-]"),
            line=lambda row: f"{row['kind']}, order {row['order']}",
            point=lambda row: (row["time_s"], row["clamped_error"], f"{row['size_mm']:g} mm"),
        )
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
