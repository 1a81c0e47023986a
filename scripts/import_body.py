"""Inspect a body reduced elsewhere (MATLAB, NumPy, ANSYS, Nastran, Abaqus), repair it, put it on the bench.

The script prints one verdict per line. --repair corrects effects of rounding and prints the change of each figure. A
valid body with two ends then replaces the actuator on the bench, below a guided payload, in small and large motion.
"""

import numpy as np

from common.arguments import parser, positive, run
from common.report import print_table, rows_of, with_prefix, write_summary
from models.bench import make_passive_bench
from nassim import static_response
from nassim.exchange import check, export_body, read_superelement, repair, to_body
from nassim.plotting import plot_inspection, save_figure
from nassim.simulation import exudyn_eigenfrequencies

arguments = parser(__doc__, "import_body")
arguments.add_argument(
    "files", nargs="+", help="all files of one body: .mat or .npz, listings, .pch, .op4 with .asm, .mtx"
)
arguments.add_argument(
    "--units", help="units of the files: length-force-mass, e.g. mm-N-t (default: m-N-kg, for .mat, .npz and listings)"
)
arguments.add_argument("--repair", action="store_true", help="correct effects of rounding")
arguments.add_argument("--payload", type=positive, default=1.0, help="payload on the bench [kg] (default: 1)")

COLUMNS = {
    "1st eigenfrequency [Hz]": "Hz/0:.4f",
    "2nd": "Hz/1:.4f",
    "3rd": "Hz/2:.4f",
    "sag [um]": "sag_m*1e6:.5f",
}


def main() -> None:
    args = arguments.parse_args()
    body = read_superelement(*args.files, units=args.units)
    report = check(body)
    print(report)
    summary = {"verdict": report.verdict, "findings": {f.name: f.verdict for f in report.findings}}
    for finding in report.findings:
        summary |= {f"{finding.name}_{key}".replace(" ", "_"): value for key, value in finding.figures.items()}

    bodies = {"as read": body}
    if args.repair:
        print()
        mended = repair(body)
        bodies["repaired"] = body = mended.body
        report = mended.after
        summary |= {
            "repaired_verdict": report.verdict,
            "repaired_rigid_motions_highest_Hz": report["rigid motions"].figures["highest_Hz"],
            "repaired_rigid_motions_residual": report["rigid motions"].figures["residual"],
            "repair_steps": mended.steps,
            "elastic_before_Hz": mended.elastic_before,
            "elastic_after_Hz": mended.elastic_after,
            "elastic_shift_percent": 100 * mended.elastic_shift,
        }
    if not args.no_plot:
        save_figure(plot_inspection(bodies), args.output / "inspection.png")

    if report.faults:
        faults = ", ".join(finding.name for finding in report.faults)
        print(f"\nnot fit for the bench: {faults}" + ("" if args.repair else "; --repair may help, but against units"))
    else:
        accepted = to_body(body)
        print(f"\nmatrices in {export_body(accepted, args.output / f'{accepted.name}.mat')}")
        summary["free_Hz"] = accepted.eigenfrequencies()[6:]
        if len(accepted.point_names) == 2:
            summary |= on_bench(accepted, args.payload)
            print_table(f"bench with {args.payload:g} kg", rows_of(summary, ("bench linear", "bench ffrf")), COLUMNS)
        else:
            print(f"not on the bench: {len(accepted.point_names)} nodes, not two")
    write_summary(args.output, summary)


def on_bench(body, payload_mass):
    """Return first eigenfrequencies of the bench, and its static deflection in small and large motion."""
    summary = {"payload_kg": payload_mass}
    for fidelity in ("linear", "ffrf"):
        scene = make_passive_bench(body, payload_mass=payload_mass, fidelity=fidelity)
        figures = {"Hz": exudyn_eigenfrequencies(scene, n_modes=3), "sag_m": static_response(scene)["encoder"]}
        summary |= with_prefix(f"bench {fidelity}", figures)
    return summary


if __name__ == "__main__":
    np.set_printoptions(precision=4)
    run(main)
