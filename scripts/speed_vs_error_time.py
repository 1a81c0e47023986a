"""Speed against error of time simulations: which fidelity, step, damping of the integrator and cut-off pay.

The bench follows 1 s of noise. Errors of V_s(t) and d_e(t) are against the exact solution of all coordinates; the
numerical damping and period error of the bench's first mode are those of generalized-alpha by theory.
"""

import csv
import itertools
import time
from typing import Any

import numpy as np
from _common import parser, positive, run, write_summary

from models.apa300ml import reduced_apa300ml
from models.bench import make_bench
from nassim import TimeHistory, simulate
from nassim.plotting import plot_pareto, save_figure
from nassim.signals import band_limited_noise
from nassim.simulation import assemble, integrator_error

CUTOFFS = {"all": None, "1500 Hz": 1500.0, "500 Hz": 500.0}

arguments = parser(__doc__, "speed_vs_error_time")
arguments.add_argument("--duration", type=positive, default=1.0, help="of the record [s] (default: 1)")
arguments.add_argument("--quick", action="store_true", help="few variants, to see the report's form")


def main() -> None:
    args = arguments.parse_args()
    apa = reduced_apa300ml()
    finest = 2.5e-5
    noise = band_limited_noise(args.duration, 1 / finest, cutoff_frequency=300.0, rms=0.01)
    exact = simulate(make_bench(apa=apa, fidelity="linear"), noise, time_step=finest, method="exact", progress=False)
    first = float(assemble(make_bench(apa=apa)).frequency[0])

    steps = (1e-4, 2e-4) if args.quick else (2.5e-5, 5e-5, 1e-4, 2e-4)
    variants = [
        (fidelity, "generalized_alpha", step, radius, cutoff)
        for fidelity, step, radius, cutoff in itertools.product(("linear", "ffrf"), steps, (1.0, 0.8), CUTOFFS)
        if (radius == 1.0 or cutoff == "all") and (fidelity == "linear" or step >= 1e-4)
    ]
    variants += [("linear", "exact", step, 1.0, cutoff) for step in steps for cutoff in CUTOFFS]
    print("\n                             step                                        error of          first mode:")
    print(
        "fidelity method              [us] radius coordinates steps/s real time     V_s       d_e      period  damping"
    )
    rows: list[dict[str, Any]] = []
    for fidelity, method, step, radius, cutoff in variants:
        bench = make_bench(apa=apa, fidelity=fidelity, cutoff_frequency=CUTOFFS[cutoff])
        start = time.perf_counter()
        options: dict[str, Any] = {} if method == "exact" else {"spectral_radius": radius}
        record = simulate(bench, noise, time_step=step, method=method, progress=False, **options)
        wall = time.perf_counter() - start
        longer, damping = integrator_error(first, step, spectral_radius=radius) if method != "exact" else (0.0, 0.0)
        row: dict[str, Any] = {
            "name": f"{fidelity}, {method}, {1e6 * step:g} us, radius {radius:g}, {cutoff}",
            "fidelity": fidelity,
            "method": method,
            "time_step_s": step,
            "spectral_radius": radius,
            "cutoff": cutoff,
            "n_coordinates": len(bench.trimmed().flexible_bodies[0].reduced.mass_matrix),
            "steps_per_s": (len(record.time) - 1) / wall,
            "real_time_factor": args.duration / wall,
            "sensor_error": error(record, exact, "sensor_voltage"),
            "encoder_error": error(record, exact, "encoder"),
            "first_mode_period_error": longer,
            "first_mode_numerical_damping": damping,
        }
        print(
            f"{fidelity:<8} {method:<18}{1e6 * step:7.0f} {radius:6.1f} {row['n_coordinates']:8d} "
            f"{row['steps_per_s']:11.0f} {row['real_time_factor']:8.2f} {100 * row['sensor_error']:8.3g} % "
            f"{100 * row['encoder_error']:7.3g} % {100 * longer:8.2g} % {100 * damping:7.2g} %",
            flush=True,
        )
        rows.append(row)
    args.output.mkdir(parents=True, exist_ok=True)
    with (args.output / "variants.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    if not args.no_plot:
        lines: dict[str, list[tuple[float, float, str]]] = {}
        for row in rows:
            # The exact solution of all coordinates is the reference: it has no error to draw.
            if row["spectral_radius"] == 1.0 and row["encoder_error"] > 1e-9:
                label = f"{row['fidelity']}, {row['method'].replace('_', '-')}, {row['n_coordinates']} coordinates"
                point = (1 / row["real_time_factor"], row["encoder_error"], f"{1e6 * row['time_step_s']:.0f} us")
                lines.setdefault(label, []).append(point)
        ax = plot_pareto(lines, "wall time per simulated time [-]", "error of the encoder's signal [-]")
        save_figure(ax, args.output / "pareto.png")
    write_summary(args.output, {"first_mode_Hz": first, "variants": rows})


def error(record: TimeHistory, exact: TimeHistory, name: str) -> float:
    """Root mean square of the difference over that of the exact signal [-]."""
    expected = np.interp(record.time, exact.time, exact[name])
    return float(np.linalg.norm(record[name] - expected) / np.linalg.norm(expected))


if __name__ == "__main__":
    run(main)
