"""Estimate the same FRFs from noise, chirp and multisine with the same simulated time, and compare them.

Repeated chirps and the multisine are periodic. Their first period, which contains the transient, is left out, and they
need no window.
"""

import numpy as np

from common.arguments import parser, positive, run
from common.costs import timed
from common.report import print_table, rows_of, with_prefix, write_summary
from common.responses import COMPARED, compare_frf, plot_bode_pair, plot_error_pair
from models.bench import make_bench
from nassim import TimeHistory, estimate_frf, frequency_response, linearize, simulate
from nassim.plotting import save_figure
from nassim.signals import band_limited_noise, chirp, multisine

arguments = parser(__doc__, "excitation_study")
arguments.add_argument(
    "--duration", type=positive, default=12.0, help="length of each record, whole periods [s] (default: 12)"
)
arguments.add_argument(
    "--period", type=positive, default=4.0, help="period of the multisine, length of segments [s] (default: 4)"
)
arguments.add_argument(
    "--time-step", type=positive, default=1e-4, help="time step of the integrator [s] (default: 1e-4)"
)


def main() -> None:
    args = arguments.parse_args()
    rate = 1 / args.time_step
    bench = make_bench()
    linear = linearize(bench)
    excitations: dict[str, TimeHistory] = {
        "noise": band_limited_noise(args.duration, rate, cutoff_frequency=500.0, rms=0.1),
        "chirp": repeated(
            chirp(args.period, rate, start_frequency=5.0, end_frequency=600.0, amplitude=0.15), args.duration
        ),
        "multisine": multisine(
            args.duration, rate, lowest_frequency=5.0, highest_frequency=600.0, period=args.period, rms=0.1
        ),
    }
    frfs, summary = [], {"duration_s": args.duration, "period_s": args.period, "time_step_s": args.time_step}
    options = {"inputs": bench.inputs, "outputs": bench.outputs, "segment_duration": args.period}
    for name, excitation in excitations.items():
        print(name)
        record, wall = timed(simulate, bench, excitation, time_step=args.time_step)
        if name == "noise":
            estimated = estimate_frf(record, label=name, **options)
        else:
            estimated = estimate_frf(record.after(args.period), overlap=0.0, window="boxcar", label=name, **options)
        frfs.append(estimated.band(10, 500))
        summary |= with_prefix(name, {"wall_time_s": wall, **compare_frf(frfs[-1], linear)})

    for output in bench.outputs:
        columns = {heading: f"{output}_{figure}" for heading, figure in COMPARED.items()}
        title = f"{output} against the linear model, 10-500 Hz, coherence > 0.99"
        print_table(title, rows_of(summary, excitations), columns | {"wall time [s]": "wall_time_s:.1f"})
    if not args.no_plot:
        references = [frequency_response(linear, frf.frequency) for frf in frfs]
        save_figure(plot_bode_pair([*frfs, references[0]]), args.output / "frf.png")
        save_figure(plot_error_pair(frfs, references), args.output / "error.png")
    write_summary(args.output, summary)


def repeated(sweep: TimeHistory, duration: float) -> TimeHistory:
    """Repeat a sweep."""
    n = round(duration * sweep.sample_rate) + 1
    return TimeHistory(np.arange(n) / sweep.sample_rate, np.resize(sweep.values[0, :-1], n), sweep.names, sweep.units)


if __name__ == "__main__":
    run(main)
