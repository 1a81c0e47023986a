"""Excite the bench with low-pass filtered noise and identify its two frequency responses.

The flexible APA300ML between base and payload is simulated in time, with its stacks as electrical ports and a
resistance across the sensor. The script estimates V_s/V_a and d_e/V_a from the record, and compares them with the
linear model, with the full FE model and with the paper. The simulation has the modes that the bench needs below 1500
Hz; the voltage has no content above 500 Hz.
"""

import math

import numpy as np

from common.arguments import fraction, parser, positive, run
from common.costs import timed
from common.report import print_report, print_table, rows_of, with_prefix, write_summary
from common.responses import COMPARED, compare_frf, plot_bode_pair
from common.views import last_frames, write_bench
from models.apa300ml import PAPER_FREQUENCY_FE, PORTS, PRISMS, make_apa300ml, reduced_apa300ml
from models.bench import SENSOR_RESISTANCE, formula_frequency, full_bench_response, make_bench
from models.bench_figures import figures_by_circuit, peak_and_dip, pole_and_zero, static_gains
from nassim import build_fe_model, condense, estimate_frf, frequency_response, linearize, save, simulate_motion
from nassim.plotting import plot_time_history, save_figure
from nassim.signals import band_limited_noise

arguments = parser(__doc__, "run_bench")
arguments.add_argument("--payload-mass", type=positive, default=5.0, help="mass of the payload [kg] (default: 5)")
arguments.add_argument(
    "--damping-ratio", type=fraction, default=0.01, help="damping ratio of every mode (default: 0.01, assumed)"
)
arguments.add_argument(
    "--resistance",
    type=positive,
    default=SENSOR_RESISTANCE,
    help="resistance across the sensor [Ohm] (default: %(default)g)",
)
arguments.add_argument("--duration", type=positive, default=16.0, help="length of the record [s] (default: 16)")
arguments.add_argument(
    "--time-step", type=positive, default=1e-4, help="time step of the integrator [s] (default: 1e-4)"
)
arguments.add_argument("--gravity", action="store_true", help="start in static equilibrium under gravity")
arguments.add_argument("--no-full-model", action="store_true", help="leave out the full FE model (5 s)")

REPORT = """
{simulated_time_s:g} s simulated in {wall_time_s:.1f} s, {us_per_step:.0f} us a step
damping: {damping_ratio*100:g} % of critical in every mode of the bench, an assumption
first undamped eigenfrequency by circuit of the sensor:
  shorted: {axial_stiffness_shorted_N_per_m*1e-6:.3f} N/um, {first_eigenfrequency_shorted_Hz:.2f} Hz
  open:    {axial_stiffness_open_N_per_m*1e-6:.3f} N/um, {first_eigenfrequency_open_Hz:.2f} Hz
  paper, with 5 kg: {paper_fe_Hz} Hz by FE; sqrt(k/m) of the vendor's stiffness: {formula_Hz:.1f} Hz
lines of the FRF: {frequency_resolution_Hz:g} Hz apart
static gains, sensor open: {static_gain_V_per_V:.3f} V/V, {static_gain_m_per_V*1e6:.2f} um/V
"""


def main() -> None:
    args = arguments.parse_args()
    condensed = None  # for the reduction and for the full model's response
    if not args.no_full_model:
        condensed = condense(build_fe_model(make_apa300ml(ports=PORTS), element_size=5e-3, **PRISMS))
    apa, reduction = timed(reduced_apa300ml, ports=PORTS, condensed=condensed)
    options = {"payload_mass": args.payload_mass, "damping_ratio": args.damping_ratio}
    given = {**options, "gravity": args.gravity, "apa": apa}
    bench = make_bench(**given, resistance=args.resistance, cutoff_frequency=1500.0)
    excitation = band_limited_noise(args.duration, 1 / args.time_step, cutoff_frequency=500.0, rms=0.1)
    steps = {"time_step": args.time_step, "frames": last_frames(args.duration)}
    (record, motion), wall = timed(simulate_motion, bench, excitation, **steps)
    segment, signals = min(4.0, args.duration / 4), {"inputs": bench.inputs, "outputs": bench.outputs}
    estimated = estimate_frf(record, **signals, segment_duration=segment, label="time simulation, H1").band(10, 900)
    fine = np.geomspace(10, 900, 8000)
    linear, opened = (linearize(make_bench(**given, resistance=each)) for each in (args.resistance, math.inf))
    frfs = {"time simulation": estimated, "linear model": frequency_response(linear, fine)}
    if condensed:
        frfs["full FE model"] = full_bench_response(condensed, fine, resistance=args.resistance, **options)
    summary = {
        "reduction_or_loading_time_s": reduction,
        "simulated_time_s": args.duration,
        "wall_time_s": wall,
        "us_per_step": 1e6 * wall / len(record.time),
        "frequency_resolution_Hz": 1 / segment,
        "time_step_s": args.time_step,
        "damping_ratio": args.damping_ratio,
        "payload_mass_kg": args.payload_mass,
        "resistance_Ohm": args.resistance,
        "paper_fe_Hz": PAPER_FREQUENCY_FE,
        "formula_Hz": formula_frequency(args.payload_mass),
        **static_gains(opened, frequency=1e-3),
        "open_sensor_zero_Hz": pole_and_zero(opened)["zero_Hz"],
        **figures_by_circuit(apa, payload_mass=args.payload_mass),
        **compare_frf(estimated.band(10, 500), linear),
    }
    for name, frf in frfs.items():
        summary |= with_prefix(name, peak_and_dip(frf))
    print_table("V_s/V_a", rows_of(summary, frfs), {"zero [Hz]": "zero_Hz:.2f", "pole [Hz]": "pole_Hz:.2f"})
    print_table("10-500 Hz, coherence > 0.99", rows_of(summary, bench.outputs), COMPARED)
    print_report(REPORT, summary)
    save(record, args.output / "record.h5")
    save(estimated, args.output / "frf.h5")
    if not args.no_plot:
        save_figure(plot_bode_pair([*frfs.values()], markers=["full FE model"]), args.output / "frf.png")
        save_figure(plot_time_history(record), args.output / "record.png")
        write_bench(bench, motion, args.output / "bench.html")
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
