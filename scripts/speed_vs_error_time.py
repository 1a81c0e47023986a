"""Compare speed and error of time simulations over fidelity, time step, numerical damping and cut-off frequency.

The bench is excited by noise for 1 s. Errors of V_s(t) and d_e(t) are relative to the exact solution of all
coordinates. For the first mode, theory gives the frequency shift that remains after period correction, and the
numerical damping of a spectral radius below 1.
"""

import itertools

import numpy as np

from common.arguments import parser, positive, run
from common.costs import timed
from common.report import print_table, write_summary
from common.variants import by_name, save_pareto, write_rows
from models.apa300ml import reduced_apa300ml
from models.bench import make_bench
from nassim import TimeHistory, simulate, trim_scene
from nassim.signals import band_limited_noise
from nassim.simulation import assemble, integrator_error, period_errors

CUTOFFS = {"all": None, "1500 Hz": 1500.0, "500 Hz": 500.0}
VARIED = ("fidelity", "method", "time_step_s", "spectral_radius", "cutoff")

arguments = parser(__doc__, "speed_vs_error_time")
arguments.add_argument("--duration", type=positive, default=1.0, help="length of the record [s] (default: 1)")
arguments.add_argument("--quick", action="store_true", help="few variants, for a quick look at the report")

COLUMNS = {
    "coordinates": "n_coordinates",
    "steps/s": "steps_per_s:.0f",
    "real time": "real_time_factor:.2f",
    "V_s [%]": "sensor_error*100:.3g",
    "d_e [%]": "encoder_error*100:.3g",
    "frequency [%]": "first_mode_frequency_error*100:.2g",
    "damping [%]": "first_mode_numerical_damping*100:.2g",
}


def main() -> None:
    args = arguments.parse_args()
    apa = reduced_apa300ml()
    finest = 2.5e-5
    noise = band_limited_noise(args.duration, 1 / finest, cutoff_frequency=300.0, rms=0.01)
    exact = simulate(make_bench(apa=apa, fidelity="linear"), noise, time_step=finest, method="exact", progress=False)
    first = float(assemble(make_bench(apa=apa)).modal.frequency[0])

    steps = (1e-4, 2e-4) if args.quick else (2.5e-5, 5e-5, 1e-4, 2e-4)
    variants = [
        (fidelity, "generalized_alpha", step, radius, cutoff)
        for fidelity, step, radius, cutoff in itertools.product(("linear", "ffrf"), steps, (1.0, 0.8), CUTOFFS)
        if (radius == 1.0 or cutoff == "all") and (fidelity == "linear" or step >= 1e-4)
    ]
    variants += [("linear", "exact", step, 1.0, cutoff) for step in steps for cutoff in CUTOFFS]
    rows = []
    for variant in variants:
        fidelity, method, step, radius, cutoff = variant
        bench = make_bench(apa=apa, fidelity=fidelity, cutoff_frequency=CUTOFFS[cutoff])
        options = {} if method == "exact" else {"spectral_radius": radius}
        shift = period_errors(bench, step, **options)[0] if options else 0.0
        damping = integrator_error(first, step, **options)[1] if options else 0.0
        record, wall = timed(simulate, bench, noise, time_step=step, method=method, progress=False, **options)
        row = {
            "name": f"{fidelity}, {method}, {1e6 * step:g} us, radius {radius:g}, {cutoff}",
            **dict(zip(VARIED, variant, strict=True)),
            "n_coordinates": len(trim_scene(bench).flexible_bodies[0].reduced.mass_matrix),
            "steps_per_s": (len(record.time) - 1) / wall,
            "real_time_factor": args.duration / wall,
            "sensor_error": error(record, exact, "sensor_voltage"),
            "encoder_error": error(record, exact, "encoder"),
            "first_mode_frequency_error": shift,
            "first_mode_numerical_damping": damping,
        }
        rows.append(row)
    print_table("error of signals, of the first mode's frequency and damping", by_name(rows), COLUMNS)
    write_rows(args.output / "variants.csv", rows, list(rows[0]))
    if not args.no_plot:
        # The exact solution of all coordinates is the reference, whose error is zero.
        save_pareto(
            args.output / "pareto.png",
            [row for row in rows if row["spectral_radius"] == 1.0 and row["encoder_error"] > 1e-9],
            ("wall time per simulated time [-]", "error of the encoder's signal [-]"),
            line=lambda r: f"{r['fidelity']}, {r['method'].replace('_', '-')}, {r['n_coordinates']} coordinates",
            point=lambda r: (1 / r["real_time_factor"], r["encoder_error"], f"{1e6 * r['time_step_s']:.0f} us"),
        )
    write_summary(args.output, {"first_mode_Hz": first, "variants": rows})


def error(record: TimeHistory, exact: TimeHistory, name: str) -> float:
    """Return the root mean square of the difference over that of the exact signal [-]."""
    expected = np.interp(record.time, exact.time, exact[name])
    return float(np.linalg.norm(record[name] - expected) / np.linalg.norm(expected))


if __name__ == "__main__":
    run(main)
