"""Hexapods on a spindle: damping and stability over payload, speed and gain, and what tolerances of their parts do.

First a grid: least damping ratio with six loops of integral force feedback, and the largest stable gain. Then the same
hexapod at rest, its 12 flexible joints and the directions of its six struts within tolerances: which of them brings how
much of the scatter. The same command goes on with a study that was stopped, and with more runs does the new ones only.
"""

from functools import partial

import numpy as np
from _arguments import parser, positive, run, whole
from _hexapod_runs import JOINTS, RESULTS, TILTS, damped, edge, nominal_push, toleranced
from _hexapod_study_pictures import plot_damping, plot_tolerances
from _report import print_report, print_table
from _results import write_summary
from _study_tables import group_shares, labelled, print_shares, print_spread, spread

from nassim.studies import linear_effects, saltelli_points, sobol_indices, sweep

arguments = parser(__doc__, "hexapod_study")
arguments.add_argument(
    "--runs", type=whole(2), default=32, help="points of the tolerances, a power of two; 26 runs each (default: 32)"
)
arguments.add_argument("--gains", type=whole(2), default=10, help="of the grid (default: 10)")
arguments.add_argument("--speeds", type=whole(2), default=5, help="of the grid, up to 500 rpm (default: 5)")
arguments.add_argument("--payload-mass", type=positive, default=10.0, help="of the tolerances [kg] (default: 10)")
arguments.add_argument("--gain", type=positive, default=50.0, help="of the tolerances' loops [1/s] (default: 50)")
arguments.add_argument("--sample-rate", type=positive, default=10e3, help="of the loops [Hz] (default: 10000)")
arguments.add_argument("--seed", type=whole(0), default=0, help="of the plan (default: 0)")

PAYLOADS = [1.0, 10.0, 25.0, 50.0]
GRID_UNITS = {"payload_mass": "kg", "spindle_rpm": "1/min", "gain": "1/s", "growth": "1/s"}
REPORT = """
{failed} of {grid_runs} runs of the grid failed; tolerances: {runs} runs on {points} points, {payload_mass_kg:g} kg, \
gain {gain_per_s:g}/s"""


def main() -> None:
    args = arguments.parse_args()
    rate = {"sample_rate": args.sample_rate}
    grid = {"payload_mass": PAYLOADS, "spindle_rpm": np.linspace(0.0, 500.0, args.speeds)}
    edges = sweep(partial(edge, **rate), grid=grid, folder=args.output / "edges", units={"spindle_rpm": "1/min"})
    gains = {"gain": np.geomspace(5.0, 5000.0, args.gains)}
    damping = sweep(partial(damped, **rate), grid=grid | gains, folder=args.output / "damping", units=GRID_UNITS)

    samples = saltelli_points(JOINTS | TILTS, args.runs, seed=args.seed)
    push = nominal_push(args.payload_mass)
    machine = partial(toleranced, payload_mass=args.payload_mass, gain=args.gain, push=push, **rate)
    study = sweep(machine, samples=samples, folder=args.output / "tolerances", units=RESULTS)
    indices, independent = sobol_indices(study), study.isel(run=slice(2 * args.runs))
    shares, uncertainties = group_shares(indices, {"12 joints": list(JOINTS), "directions of 6 struts": list(TILTS)})
    best = damping.damping_ratio.where(damping.growth < 0).max("gain")
    summary = {
        "failed": int((damping.status == "failed").sum()),
        "grid_runs": damping.status.size,
        "largest_stable_gain_per_s": labelled(edges.largest_stable_gain),
        "largest_damping_ratio": labelled(best),
        "runs": len(samples),
        "points": args.runs,
        "payload_mass_kg": args.payload_mass,
        "gain_per_s": args.gain,
        "tolerances": spread(independent, linear_effects(study)),
        "shares": shares,
        "share_uncertainties": uncertainties,
        "total_shares": labelled(indices.total.transpose()),
    }

    for title, key, form in (
        ("largest stable gain [1/s]", "largest_stable_gain_per_s", ":.0f"),
        ("damping ratio at the best gain", "largest_damping_ratio", ":.3f"),
    ):
        rows = {f"{payload} kg": row for payload, row in summary[key].items()}
        print_table(title, rows, {f"{speed:g} rpm": f"{speed:g}{form}" for speed in grid["spindle_rpm"]})
    print_report(REPORT, summary)
    print_spread("result", summary["tolerances"])
    print_shares(summary["shares"], summary["share_uncertainties"])
    if not args.no_plot:
        plot_damping(damping, edges, args.output / "damping.png")
        plot_tolerances(independent, indices, args.output)
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
