"""Identify damping ratios and gains from a measured record or FRF, and write them into the bench.

RECORD is a CSV file with named columns and units, such as `time [s], actuator_voltage [V], sensor_voltage [V], encoder
[um]` (or an FRF with a `frequency [Hz]` column), or a UFF file. Without it the script identifies a blind record, see
make_blind_record.py, and compares what it finds with the truth.
"""

from pathlib import Path

import numpy as np
from _common import not_negative, parser, positive, run, whole, write_summary
from make_blind_record import make_blind_record

from models.apa300ml import reduced_apa300ml
from models.bench import make_bench
from nassim import TimeHistory, frequency_response, linearize, save
from nassim.identification import ModalFit, UpdateReport, apply_identification, identify_modes
from nassim.plotting import plot_modal_fit, plt, save_figure
from nassim.signals import read_measurement

UNITS = {"sensor_voltage": "V/V", "encoder": "m/V"}
arguments = parser(__doc__, "identify_damping")
arguments.add_argument("record", nargs="?", type=Path, metavar="RECORD", help="file (default: a blind demonstration)")
arguments.add_argument("--input", default="actuator_voltage", help="name of the input (default: actuator_voltage)")
arguments.add_argument("--outputs", nargs="+", default=list(UNITS), help=f"(default: {' '.join(UNITS)})")
arguments.add_argument("--band", nargs=2, type=positive, default=[20.0, 500.0], metavar=("LOW", "HIGH"), help="[Hz]")
arguments.add_argument("--modes", type=whole(1), help="how many resonances the band has (default: chosen by BIC)")
arguments.add_argument("--input-hold", choices=["dac", "none"], default="dac", help="of a record (default: dac)")
arguments.add_argument(
    "--payload-mass", type=positive, default=5.0, help="of the bench written back to [kg] (default: 5)"
)
arguments.add_argument("--seed", type=whole(0), default=0, help="of the blind demonstration (default: 0)")
arguments.add_argument(
    "--noise", type=not_negative, default=0.05, help="of the blind demonstration, rms (default: 0.05)"
)


def main() -> None:
    args = arguments.parse_args()
    if args.record is None and set(args.outputs) != set(UNITS):
        arguments.error("the blind demonstration has its own outputs; give a RECORD to choose others")
    path, truth = args.record, None
    if path is None:
        path, truth = make_blind_record(args.output, seed=args.seed, noise=args.noise, duration=16.0)
    measured = read_measurement(path)
    hold = 0 if isinstance(measured, TimeHistory) and args.input_hold == "dac" else None
    options = {"band": args.band, "n_modes": args.modes, "hold_order": hold}
    fit = identify_modes(measured, input=args.input, outputs=args.outputs, **options)
    print(f"\n{path}: {fit.how['data']}, {fit.how['band']}; ± one standard deviation")
    print(fit.summary())

    bench = make_bench(args.payload_mass, "linear", apa=reduced_apa300ml(element_size=8e-3, order=2, mesh={}))
    updated, report = apply_identification(bench, fit, trusted="encoder")
    print(f"\nwritten into the bench with {args.payload_mass:g} kg:")
    print(report.summary())

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
        summary |= {"truth": truth, **compare(fit, report, truth)}
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


def figures(fit: ModalFit, report: UpdateReport) -> dict[str, tuple[float, float]]:
    """Fitted parameters of the blind bench and their standard deviations, by their names in the truth."""
    rows = {}
    for k in range(min(2, len(fit.frequency))):
        rows[f"frequency_{k + 1}_Hz"] = fit.frequency[k], fit.frequency_std[k]
        rows[f"damping_ratio_{k + 1}"] = fit.damping_ratio[k], fit.damping_ratio_std[k]
        for name, unit in (("sensor_voltage", "V_per_V"), ("encoder", "m_per_V")):
            row = fit.outputs.index(name)
            rows[f"{name}_gain_{k + 1}_{unit}"] = fit.gains[row, k], fit.gains_std[row, k]
    for change in report.changes[-2:]:  # one actuator, one sensor besides the encoder
        kind = change.parameter.partition("_")[0]
        rows[f"{kind}_factor"] = change.after / change.before, change.std / abs(change.before)
    return rows


def compare(fit: ModalFit, report: UpdateReport, truth: dict[str, float]) -> dict[str, dict[str, float]]:
    """Print fitted against true parameters; returns them and their errors in percent and in standard deviations."""
    rows = figures(fit, report)
    print(f"\n{'':<32}{'fitted':>12}{'std':>10}{'true':>12}{'error [%]':>11}{'error/std':>11}")
    errors = {name: 100 * (value / truth[name] - 1) for name, (value, _) in rows.items()}
    scaled = {name: (value - truth[name]) / std for name, (value, std) in rows.items()}
    for name, (value, std) in rows.items():
        print(f"{name:<32}{value:>12.5g}{std:>10.1g}{truth[name]:>12.5g}{errors[name]:>11.3f}{scaled[name]:>11.2f}")
    fitted = {name: value for name, (value, _) in rows.items()}
    return {"fitted": fitted, "errors_in_percent": errors, "errors_over_std": scaled}


if __name__ == "__main__":
    run(main)
