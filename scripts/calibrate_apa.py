"""Calibrate the APA300ML: fit parameters of the model to values of its data sheet.

The script prints the sensitivity of every figure to every parameter, which shows what data determine which parameter.
It fits the chosen parameters, with sensitivities from a coarse mesh and figures from the fine one. It then prints how
far the fit moves if another parameter is at one of its bounds (on the coarse mesh), and compares the figures that were
not fitted with published values. With --write, the fit becomes the default of the model.
"""

from common.arguments import parser, positive, run, whole
from common.report import across, print_report, print_table, write_summary
from models.apa300ml import CALIBRATION, STACK, calibration as apa
from nassim.identification import Target

arguments = parser(__doc__, "calibrate_apa")
names = {"choices": apa.PARAMETERS, "metavar": "NAME", "help": f"default: the first of {', '.join(apa.PARAMETERS)}"}
arguments.add_argument("--fit", nargs="+", default=["pzt_modulus"], **names)
arguments.add_argument(
    "--to",
    nargs="+",
    default=["axial_stiffness=1.79e6"],
    metavar="FIGURE=VALUE",
    help=f"targets in SI units, of {', '.join(apa.FIGURES)} (default: axial_stiffness=1.79e6)",
)
arguments.add_argument("--tolerance", type=positive, default=0.5, help="tolerance of the targets [%%] (default: 0.5)")
arguments.add_argument("--element-size", type=positive, default=5.0, help="size on the fine mesh [mm] (default: 5)")
arguments.add_argument("--order", type=whole(1), default=3, help="order of the fine mesh (default: 3)")
arguments.add_argument("--coarse-size", type=positive, default=5.0, help="size on the coarse mesh [mm] (default: 5)")
arguments.add_argument(
    "--circuit",
    default="shorted",
    choices=apa.CIRCUITS,
    help="circuit of all stacks for the targets (default: shorted)",
)
arguments.add_argument("--write", action="store_true", help="save the fit as default of the model")

FITTED = {"value": "parameters:.5g", "+- [%]": "relative_deviations*100:.2g", "started from": "started_from:g"}
COMPARED = {"value": "figures:.5g", "published": "published:.5g", "difference [%]": "differences_percent:+.2f"}
REPORT = """
frequency_5kg follows from stiffness and mass (exponents 1/2 and -1/2) and is no independent check
{moving_mass_kg:.3f} kg move with 5 kg: the paper's {published/frequency_5kg} Hz mean \
{stiffness_of_the_papers_frequency_N_per_m*1e-6:.3f} N/um, \
{stiffness_of_the_papers_frequency_over_vendors_percent:+.1f} % against the vendor's
"""


def main() -> None:
    args = arguments.parse_args()
    record = apa.fit(
        args.fit,
        [read_target(text, args.tolerance / 100) for text in args.to],
        circuit=args.circuit,
        element_size=1e-3 * args.element_size,
        order=args.order,
        coarse_size=1e-3 * args.coarse_size,
    )
    figures = record["figures"]
    summary = record | {
        "started_from": {name: apa.PARAMETERS[name].start for name in args.fit},
        "published": apa.PUBLISHED,
        "differences_percent": {name: 100 * (figures[name] / known - 1) for name, known in apa.PUBLISHED.items()},
        "stack_coupling_factor": STACK.coupling_factor,
        **apa.figures_with_5kg(figures),
    }

    title = "relative change of figures per relative change of parameters"
    print_table(title, summary["sensitivities"], {name: f"{name}:.3f" for name in apa.PARAMETERS})
    print_table("fit", across(summary, args.fit, ("parameters", "relative_deviations", "started_from")), FITTED)
    moved = {p: row for p, row in summary["relative_changes_with_others_at_their_bounds"].items() if p != "command"}
    ends = {"lowest": 0, "highest": 1}
    columns = {end: f"bounds/{k}:.3g" for end, k in ends.items()}
    columns |= {f"{name} at {end} [%]": f"{name}/{k}*100:+.1f" for name in args.fit for end, k in ends.items()}
    print_table("change of the fit with another parameter at its bounds", moved, columns)
    print_table("figures", across(summary, apa.FIGURES, ("figures", "published", "differences_percent")), COMPARED)
    print_report(REPORT, summary)
    write_summary(args.output, summary)
    if args.write:
        apa.make_default(record)
        print(f"written to {CALIBRATION}: the model's default from now on")


def read_target(text: str, tolerance: float) -> Target:
    name, _, value = text.partition("=")
    if name not in apa.FIGURES:
        arguments.error(f"unknown figure {name!r}; known: {', '.join(apa.FIGURES)}")
    try:
        return Target(name, float(value), tolerance)
    except ValueError as error:
        arguments.error(f"--to {text}: {error}")


if __name__ == "__main__":
    run(main)
