"""The APA300ML within its tolerances: what moves pole, zero, axial stiffness, stroke and lateral modes.

Draws, meshes and reduces an actuator anew in every run, on coarse prisms; some runs are repeated with elements one
order higher, to tell how far the coarse ones bend the sensitivities. The same command goes on with a study that was
stopped, and with more runs does the new ones only.
"""

from functools import partial

from _arguments import parser, run, whole
from _report import print_report, print_table
from _results import write_summary
from _study_tables import REFINED, labelled, print_spread, refinement, spread
from _tolerances import COARSE, FIGURES, TOLERANCES, apa_figures, plot_all

from nassim.studies import correlations, linear_effects, sobol_points, sweep

arguments = parser(__doc__, "tolerance_study")
arguments.add_argument("--runs", type=whole(16), default=64, help="a power of two (default: 64)")
arguments.add_argument("--order", type=whole(1), default=3, help="of the coarse elements (default: 3)")
arguments.add_argument(
    "--refined", type=whole(0), default=6, help="runs repeated one order higher, 0 or some (default: 6)"
)
arguments.add_argument("--seed", type=whole(0), default=0, help="of the plan (default: 0)")

UNITS = FIGURES | {name: unit for name, (_, unit) in TOLERANCES.items()}
PERCENT = {name.replace("_", " "): f"{name}:+.2f" for name in FIGURES}
REPORT = """
{finished} of {runs} runs have figures; a plane through them says how far each figure moves, in per cent of its mean,
while one parameter goes from its lower to its upper end of 90 % of all parts"""


def main() -> None:
    args = arguments.parse_args()
    samples = sobol_points({name: law for name, (law, _) in TOLERANCES.items()}, args.runs, seed=args.seed)
    orders = (args.order, args.order + 1)
    coarse, fine = (partial(apa_figures, mesh=COARSE | {"order": order}) for order in orders)
    study = sweep(coarse, samples=samples, units=UNITS, folder=args.output / "study")
    effects, ranks = linear_effects(study), correlations(study)
    percent, rank = (100 * effects.effect / effects["mean"]).transpose(), ranks.spearman.transpose()
    summary = {
        "runs": args.runs,
        "finished": int((study.status == "ok").sum()),
        "figures": spread(study, effects),
        "effects_percent": labelled(percent),
        "rank_correlations": labelled(rank),
    }
    if args.refined:
        first = {name: samples[name][: args.refined] for name in samples.names}
        refined = sweep(fine, samples=first, units=UNITS, folder=args.output / "refined")
        summary["refined"] = refinement(study, refined, FIGURES)

    print_spread("figure [SI units]", summary["figures"])
    print_report(REPORT, summary)
    print_table("effect [%]", summary["effects_percent"], PERCENT)
    if args.refined:
        print_table(f"{args.refined} runs one order higher", summary["refined"], REFINED)
    if not args.no_plot:
        plot_all(study, effects, ranks, args.output)
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
