"""Identify damping ratios and gains from a record or an FRF, and apply them to the bench.

RECORD is a CSV file with named columns and units, such as `time [s], actuator_voltage [V], sensor_voltage [V], encoder
[um]` (or an FRF with a `frequency [Hz]` column), or a UFF file. Without RECORD, the script identifies a blind record
(see make_blind_record.py) and compares the result with the truth.
"""

from pathlib import Path

import numpy as np

from common.arguments import not_negative, parser, positive, run, whole
from common.blind import against_truth, make_blind_record
from common.report import across, print_table, write_summary
from models.apa300ml import COARSE, reduced_apa300ml
from models.bench import make_bench
from nassim import TimeHistory, frequency_response, linearize, save
from nassim.base.progress import tell
from nassim.identification import apply_identification, identify_modes
from nassim.plotting import plot_modal_fit, plt, save_figure
from nassim.signals import read_measurement

UNITS = {"sensor_voltage": "V/V", "encoder": "m/V"}
arguments = parser(__doc__, "identify_damping")
arguments.add_argument(
    "record", nargs="?", type=Path, metavar="RECORD", help="CSV or UFF file (default: a blind record)"
)
arguments.add_argument("--input", default="actuator_voltage", help="name of the input (default: actuator_voltage)")
arguments.add_argument("--outputs", nargs="+", default=list(UNITS), help=f"(default: {' '.join(UNITS)})")
arguments.add_argument(
    "--band",
    nargs=2,
    type=positive,
    default=[20.0, 500.0],
    metavar=("LOW", "HIGH"),
    help="frequency range of the fit [Hz]",
)
arguments.add_argument("--modes", type=whole(1), help="number of resonances (default: by BIC)")
arguments.add_argument(
    "--input-hold", choices=["dac", "none"], default="dac", help="how inputs act between samples (default: dac)"
)
arguments.add_argument(
    "--payload-mass", type=positive, default=5.0, help="payload of the identified bench [kg] (default: 5)"
)
arguments.add_argument("--seed", type=whole(0), default=0, help="seed of the blind record (default: 0)")
arguments.add_argument(
    "--noise", type=not_negative, default=0.05, help="relative rms noise of the blind record (default: 0.05)"
)

COLUMNS = {
    "fitted": "fitted:.5g",
    "truth": "truth:.5g",
    "error [%]": "errors_in_percent:.3f",
    "error/std": "errors_over_std:.2f",
}


def main() -> None:
    args = arguments.parse_args()
    if args.record is None and set(args.outputs) != set(UNITS):
        arguments.error("the blind demonstration has its own outputs; give a RECORD to choose others")
    path, truth = args.record, None
    if path is None:
        path, truth = make_blind_record(args.output, seed=args.seed, noise=args.noise, duration=16.0)
    recorded = read_measurement(path)
    hold = 0 if isinstance(recorded, TimeHistory) and args.input_hold == "dac" else None
    options = {"band": args.band, "n_modes": args.modes, "hold_order": hold}
    fit = identify_modes(recorded, input=args.input, outputs=args.outputs, **options)
    bench = make_bench(args.payload_mass, "linear", apa=reduced_apa300ml(**COARSE))
    updated, report = apply_identification(bench, fit, trusted="encoder")
    summary = {
        "frequency_Hz": fit.frequency,
        "frequency_std_Hz": fit.frequency_std,
        "damping_ratio": fit.damping_ratio,
        "damping_ratio_std": fit.damping_ratio_std,
        "unmodelled_Hz": report.unmodelled,
        "parameters": {c.parameter: {"before": c.before, "value": c.after, "std": c.std} for c in report.changes},
        "scene_Hz": report.scene,
        "how": fit.how,
    }
    for k, output in enumerate(fit.outputs):
        unit = UNITS.get(output, "").replace("/", "_per_")
        summary |= {f"{output}_gain_{unit}": fit.gains[k], f"{output}_gain_std_{unit}": fit.gains_std[k]}
    if truth is not None:
        summary |= {"truth": truth, **against_truth(fit, report, truth)}

    tell(f"\n{path}: {fit.how['data']}, {fit.how['band']}; ± one standard deviation\n{fit.summary()}", indent="")
    tell(f"\nwritten into the bench with {args.payload_mass:g} kg:\n{report.summary()}", indent="")
    if truth is not None:
        kinds = ("fitted", "truth", "errors_in_percent", "errors_over_std")
        print_table("blind", across(summary, summary["fitted"], kinds), COLUMNS)
    save(fit, args.output / "fit.h5")
    if not args.no_plot:
        fine = np.geomspace(*args.band, 4000)
        scenes = {"bench as assumed": bench, "bench as identified": updated}
        models = [frequency_response(linearize(scene), fine, label=label) for label, scene in scenes.items()]
        columns = plt.figure(figsize=(6.5 * len(fit.outputs), 8), layout="constrained").subfigures(1, len(fit.outputs))
        for column, output in zip(np.atleast_1d(columns), fit.outputs, strict=True):
            axes = plot_modal_fit(fit, models, output=output, unit=UNITS.get(output, "-"), figure=column)
        save_figure(axes, args.output / "fit.png")
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
