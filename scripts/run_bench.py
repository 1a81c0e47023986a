"""The main job: excite the bench with low-pass filtered noise and identify its two frequency responses.

Simulates the flexible APA300ML between base and payload in the time domain, its stacks as electrical ports and the
sensor loaded, estimates V_s/V_a and d_e/V_a from the record, and compares them with the linear model, with the full FE
model and with the paper.
"""

import math
import time

import numpy as np
from _common import (
    compare_frf,
    fraction,
    parser,
    plot_bode_pair,
    pole_and_zero,
    pole_and_zero_of,
    positive,
    run,
    write_summary,
)

from models.apa300ml import (
    PAPER_FREQUENCY_FE,
    PORTS,
    PRISMS,
    make_apa300ml,
    reduced_apa300ml,
)
from models.bench import BENCH_CONDITIONS, SENSOR_RESISTANCE, formula_frequency, full_bench_response, make_bench
from nassim import build_fe_model, condense, estimate_frf, frequency_response, linearize, open_circuit, save, simulate
from nassim.plotting import plot_time_history, save_figure
from nassim.signals import band_limited_noise

arguments = parser(__doc__, "run_bench")
arguments.add_argument("--payload-mass", type=positive, default=5.0, help="mass on top [kg] (default: 5)")
arguments.add_argument(
    "--damping-ratio", type=fraction, default=0.01, help="of every mode [-] (default: 0.01, assumed)"
)
arguments.add_argument(
    "--resistance",
    type=positive,
    default=SENSOR_RESISTANCE,
    help="across the sensor stack [Ohm] (default: %(default)g, assumed)",
)
arguments.add_argument("--duration", type=positive, default=16.0, help="of the record [s] (default: 16)")
arguments.add_argument("--time-step", type=positive, default=1e-4, help="of the integrator [s] (default: 1e-4)")
arguments.add_argument("--gravity", action="store_true", help="start in static equilibrium under gravity")
arguments.add_argument("--no-full-model", action="store_true", help="leave out the full FE model (15 s)")


def main() -> None:
    args = arguments.parse_args()
    start = time.perf_counter()
    apa = reduced_apa300ml(ports=PORTS)
    reduction = time.perf_counter() - start
    options = {"damping_ratio": args.damping_ratio, "gravity": args.gravity, "apa": apa}
    bench = make_bench(args.payload_mass, resistance=args.resistance, **options)
    print(f"damping: {100 * args.damping_ratio:g} % of critical in every mode of the bench, an assumption")

    excitation = band_limited_noise(args.duration, 1 / args.time_step, cutoff_frequency=500.0, rms=0.1)
    start = time.perf_counter()
    record = simulate(bench, excitation, time_step=args.time_step)
    wall = time.perf_counter() - start
    print(f"simulated {args.duration:g} s in {wall:.1f} s, {1e6 * wall / len(record.time):.0f} us a step")

    segment = min(4.0, args.duration / 4)
    measured = estimate_frf(
        record, inputs=bench.inputs, outputs=bench.outputs, segment_duration=segment, label="time simulation, H1"
    ).band(10, 900)
    linear = linearize(bench)
    fine = np.geomspace(10, 900, 8000)
    frfs = {"time simulation": measured, "linear model": frequency_response(linear, fine)}
    shown = list(frfs.values())
    if not args.no_full_model:
        print("full FE model, no reduction:")
        condensed = condense(build_fe_model(make_apa300ml(ports=PORTS), element_size=5e-3, **PRISMS))
        for name, frequency in (("full FE model", fine), ("shown", np.geomspace(10, 900, 48))):
            frfs[name] = full_bench_response(
                condensed,
                frequency,
                payload_mass=args.payload_mass,
                damping_ratio=args.damping_ratio,
                resistance=args.resistance,
            )
        shown.append(frfs.pop("shown"))

    opened = linearize(make_bench(args.payload_mass, resistance=math.inf, **options))
    gains = np.abs(frequency_response(opened, np.array([1e-3])).values[:, 0, 0])
    conditions = BENCH_CONDITIONS | {"masses": {"top": args.payload_mass}}
    bodies = {"shorted": apa, "open": open_circuit(apa, {"sensor": 0.0})}
    stiffness = {state: 1 / body.compliance(fixed=["bottom"])[8, 8] for state, body in bodies.items()}
    first = {state: body.eigenfrequencies(**conditions)[0] for state, body in bodies.items()}
    formula = formula_frequency(args.payload_mass)
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
        "formula_Hz": formula,
        "static_gain_V_per_V": gains[0],
        "static_gain_m_per_V": gains[1],
        "open_sensor_zero_Hz": pole_and_zero_of(opened)[1],
    }
    summary |= {f"axial_stiffness_{state}_N_per_m": value for state, value in stiffness.items()}
    summary |= {f"first_eigenfrequency_{state}_Hz": value for state, value in first.items()}
    summary["open_over_shorted_pole_percent"] = 100 * (first["open"] / first["shorted"] - 1)
    print("\nV_s/V_a               zero [Hz]   pole [Hz]")
    for name, frf in frfs.items():
        pole, zero = pole_and_zero(frf)
        print(f"  {name:<18}{zero:10.2f}  {pole:10.2f}")
        summary |= {f"{name.replace(' ', '_')}_zero_Hz": zero, f"{name.replace(' ', '_')}_pole_Hz": pole}
    print(f"  (the time simulation's FRF has lines {1 / segment:g} Hz apart)")
    print("electrical state of the sensor stack, which an open one stiffens; damping left out:")
    for state in bodies:
        print(f"  {state:<8} {1e-6 * stiffness[state]:.3f} N/um, first eigenfrequency {first[state]:.2f} Hz")
    print(f"  paper, with 5 kg: {PAPER_FREQUENCY_FE} Hz by FE; sqrt(k/m) of the vendor's stiffness: {formula:.1f} Hz")
    band = measured.band(10, 500)
    errors = compare_frf(band, frequency_response(linear, band.frequency))
    print("time simulation against linear model, 10-500 Hz, where coherence > 0.99:")
    for output in bench.outputs:
        decibel, degrees = errors[f"{output}_magnitude_error_dB"], errors[f"{output}_phase_error_deg"]
        share = 100 * errors[f"{output}_coherent_share"]
        print(f"  {output:<16} within {decibel:.2f} dB and {degrees:.2f} deg, in {share:.0f} % of the lines")
    print(f"static gains, sensor open: {gains[0]:.3f} V/V, {1e6 * gains[1]:.2f} um/V")

    save(record, args.output / "record.h5")
    save(measured, args.output / "frf.h5")
    if not args.no_plot:
        save_figure(plot_bode_pair(shown, markers=["full FE model"]), args.output / "frf.png")
        save_figure(plot_time_history(record), args.output / "record.png")
    write_summary(args.output, summary | errors)


if __name__ == "__main__":
    run(main)
