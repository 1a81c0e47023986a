"""Calibrate the APA300ML: fit parameters of the model to figures of its data sheet.

Prints how every figure depends on every parameter, so which data can determine what, fits the chosen ones
(sensitivities from a coarse mesh, every step on the fine one), says how far they would move were the other parameters
at their bounds (fitted anew on the coarse mesh), and compares what was not fitted with what is published.
With --write, the fit becomes the model's default.
"""

import json

import numpy as np
from _common import parser, positive, run, whole, write_summary

from models.apa300ml import CALIBRATION, PAPER_FREQUENCY_FE, PRISMS, STACK, VENDOR_STIFFNESS
from models.apa300ml.calibration import CIRCUITS, FIGURES, PARAMETERS, PUBLISHED, make_model
from nassim.base import stage, written_whole
from nassim.identification import Target, at_bounds, calibrate, check_determined, sensitivities

arguments = parser(__doc__, "calibrate_apa")
arguments.add_argument("--fit", nargs="+", default=["pzt_modulus"], choices=PARAMETERS, help="(default: pzt_modulus)")
arguments.add_argument(
    "--to",
    nargs="+",
    default=["axial_stiffness=1.79e6"],
    metavar="FIGURE=VALUE",
    help=f"targets in SI units, of {', '.join(FIGURES)} (default: axial_stiffness=1.79e6)",
)
arguments.add_argument("--tolerance", type=positive, default=0.5, help="of the targets [%%] (default: 0.5)")
arguments.add_argument("--element-size", type=positive, default=5.0, help="of the fine mesh [mm] (default: 5)")
arguments.add_argument("--order", type=whole(1), default=3, help="of the fine mesh (default: 3)")
arguments.add_argument("--coarse-size", type=positive, default=5.0, help="mesh of the sensitivities [mm] (default: 5)")
arguments.add_argument(
    "--circuit", default="shorted", choices=CIRCUITS, help="of all stacks, where the targets hold (default: shorted)"
)
arguments.add_argument("--write", action="store_true", help="make the fit the model's default")


def main() -> None:
    args = arguments.parse_args()
    targets = [read_target(text, args.tolerance / 100) for text in args.to]
    print(f"{STACK.consistency()}\n")
    with stage("sensitivities", total=2 * len(PARAMETERS), unit="evaluations") as advance:
        coarse = make_model(circuit=args.circuit, element_size=1e-3 * args.coarse_size, order=2)
        table = sensitivities(coarse, list(PARAMETERS.values()), FIGURES, advance=advance)
    print("\nrelative change of figures per relative change of parameters (tetrahedra, order 2)")
    print(f"{'':18}" + "".join(f"{name:>16}" for name in PARAMETERS))
    for name, row in zip(FIGURES, table, strict=True):
        print(f"  {name:<16}" + "".join(f"{value:16.3f}" for value in row))

    rows = [FIGURES.index(target.name) for target in targets]
    columns = list(PARAMETERS).index
    chosen = [PARAMETERS[name] for name in args.fit]
    sensitivity = table[np.ix_(rows, [columns(name) for name in args.fit])]
    check_determined(chosen, targets, sensitivity, largest_deviation=0.1)
    fixed = {name: p.start for name, p in PARAMETERS.items() if name not in args.fit}
    kinds = PRISMS if "arm_thickness" not in args.fit else {}
    fine = make_model(circuit=args.circuit, element_size=1e-3 * args.element_size, order=args.order, **kinds)
    print(f"\nfit of {', '.join(args.fit)} on the fine mesh:")
    result = calibrate(
        lambda values: fine(fixed | dict(values)),
        chosen,
        targets,
        sensitivity=sensitivity,
        report=lambda line: print(f"  {line}", flush=True),
    )
    for name, value in result.values.items():
        print(
            f"  {name} = {value:.5g} +- {100 * result.deviations[name]:.2g} %, started from {PARAMETERS[name].start:g}"
        )

    others = [p for name, p in PARAMETERS.items() if name not in args.fit]
    with stage("fits with others at their bounds", total=2 * len(others), unit="fits") as advance:
        moved = at_bounds(coarse, chosen, others, targets, sensitivity=sensitivity, advance=advance)
    print("\nthat is what the tolerance alone leaves open; with another parameter at its bounds the fit would need")
    for other in others:
        for name, (low, high) in moved[other.name].items():
            bounds = f"{other.lowest:.3g} ... {other.highest:.3g}"
            print(f"  {other.name} at {bounds}: {name} {100 * low:+.1f} ... {100 * high:+.1f} %")

    print("\nfigure                value        published   difference")
    for name in FIGURES:
        value, known = result.figures[name], PUBLISHED.get(name)
        label = "fitted" if name in [t.name for t in targets] else ""
        print(
            f"  {name:<16} {value:12.5g} "
            + (f"{known:12.5g} {100 * (value / known - 1):+9.2f} % {label}" if known else "")
        )
    half = table[FIGURES.index("frequency_5kg")] - 0.5 * table[FIGURES.index("axial_stiffness")]
    print(
        "frequency_5kg depends on every parameter half as the stiffness does "
        f"(to within {np.abs(half).max():.3f}): it follows from it and the mass, and confirms nothing more"
    )
    moving = result.figures["axial_stiffness"] / (2 * np.pi * result.figures["frequency_5kg"]) ** 2
    implied = (2 * np.pi * PAPER_FREQUENCY_FE) ** 2 * moving
    print(
        f"5 kg: {moving:.3f} kg move, so the paper's {PAPER_FREQUENCY_FE} Hz mean {1e-6 * implied:.3f} N/um, "
        f"{100 * (implied / VENDOR_STIFFNESS - 1):+.1f} % against the vendor's:\n"
        "the paper's own model, fitted to resonances too, was stiffer"
    )
    record = {
        "parameters": fixed | dict(result.values),
        "relative_deviations": dict(result.deviations),
        "targets": {t.name: t.value for t in targets},
        "target_tolerance": args.tolerance / 100,
        "circuit": args.circuit,
        "relative_changes_with_others_at_their_bounds": {
            "command": "python scripts/calibrate_apa.py",
            **{other.name: {"bounds": [other.lowest, other.highest], **moved[other.name]} for other in others},
        },
        "figures": dict(result.figures),
        "mesh": f"{args.element_size:g} mm, order {args.order}, {'prisms' if kinds else 'tetrahedra'}",
        "sensitivities": {
            name: dict(zip(PARAMETERS, row, strict=True)) for name, row in zip(FIGURES, table.tolist(), strict=True)
        },
    }
    differences = {name: 100 * (result.figures[name] / known - 1) for name, known in PUBLISHED.items()}
    further = {
        "started_from": {parameter.name: parameter.start for parameter in chosen},
        "published": PUBLISHED,
        "differences_percent": differences,
        "moving_mass_kg": moving,
        "stiffness_of_the_papers_frequency_N_per_m": implied,
        "stiffness_of_the_papers_frequency_over_vendors_percent": 100 * (implied / VENDOR_STIFFNESS - 1),
        "stack_coupling_factor": STACK.coupling_factor,
    }
    write_summary(args.output, record | further)
    if args.write:
        with written_whole(CALIBRATION) as temporary:
            temporary.write_text(json.dumps(record, indent=2) + "\n")
        print(f"written to {CALIBRATION}: the model's default from now on")


def read_target(text: str, tolerance: float) -> Target:
    name, _, value = text.partition("=")
    if name not in FIGURES:
        arguments.error(f"unknown figure {name!r}; known: {', '.join(FIGURES)}")
    try:
        return Target(name, float(value), tolerance)
    except ValueError as error:
        arguments.error(f"--to {text}: {error}")


if __name__ == "__main__":
    run(main)
