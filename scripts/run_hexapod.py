"""Six inputs at once: identify the nano-hexapod's FRFs from voltages to force sensors and encoders from one record.

Six multisines that can be told apart drive the six struts of the hexapod, whose actuators are reduced finite element
models with electrical ports. From the record of that time simulation come all 6 x 6 FRFs to force sensors and all
6 x 6 to encoders, which are compared with the linear model: each strut moves the sensors of all others.
"""

import math
from dataclasses import replace

import numpy as np
from _arguments import parser, positive, run, whole
from _costs import timed
from _hexapod import ENCODERS, METHODS, SAMPLE_RATE, SENSORS, VOLTAGES, add_machine, excite, hexapod, settling_time
from _hexapod_pictures import plot_entries
from _pages import hexapod_looks, last_frames, write_hexapod
from _report import print_report, print_table, rows_of, with_prefix
from _responses import COMPARED, frf_errors
from _results import write_summary
from _views import show

from nassim import estimate_frf, frequency_response, linearize, save, simulate_motion
from nassim.plotting import save_figure
from nassim.signals import orthogonal_multisines, remove_settling
from nassim.systems import damping
from nassim.viewer import view_scene

BAND = (10.0, 500.0)
LEAST_COHERENCE = 0.95
LEFT = 1e-4
"""Share of a transient that is left where the analysis begins."""

arguments = parser(__doc__, "run_hexapod")
add_machine(arguments)
arguments.add_argument("--period", type=positive, default=1.0, help="of the multisines [s] (default: 1)")
arguments.add_argument("--periods", type=whole(2), default=2, help="of each of six blocks, analysed (default: 2)")
arguments.add_argument("--settling", type=positive, help="time before these, left out [s] (default: as long as needed)")
arguments.add_argument("--voltage", type=positive, default=0.1, help="rms of each input [V] (default: 0.1)")
arguments.add_argument("--time-step", type=positive, default=1e-4, help="of the integrator [s] (default: 1e-4)")

REPORT = """
{simulated_time_s:g} s simulated in {wall_time_s:.0f} s, {us_per_step:.0f} us a step ({method})
six blocks, {settling_time_s:g} s of each left to transients
suspension modes [Hz]: {suspension_Hz/0:.1f}, {suspension_Hz/1:.1f}, {suspension_Hz/2:.1f}, {suspension_Hz/3:.1f}, \
{suspension_Hz/4:.1f}, {suspension_Hz/5:.1f}
lines of the FRFs: {frequency_resolution_Hz:g} Hz apart"""


def main() -> None:
    args = arguments.parse_args()
    scene = replace(hexapod(args), quasi_static_above=math.inf)  # the run has all modes, as the linear model has
    model = linearize(scene)
    settling = math.ceil((settling_time(model, LEFT) if args.settling is None else args.settling) / args.period)
    block = {"n_settling": settling, "n_periods": args.periods}
    band = dict(zip(("lowest_frequency", "highest_frequency"), BAND, strict=True))
    drive = orthogonal_multisines(VOLTAGES, SAMPLE_RATE, **band, period=args.period, **block, rms=args.voltage)
    excitation = excite(scene, drive.time, dict(zip(drive.names, drive.values, strict=True)))
    outputs, method = (*SENSORS, *ENCODERS), METHODS[args.method][1]
    steps = {"time_step": args.time_step, "duration": drive.duration, "frames": last_frames(drive.duration)}
    (record, motion), wall = timed(simulate_motion, scene, excitation, outputs=outputs, method=method, **steps)
    duration = (settling + args.periods) * args.period
    steady = remove_settling(record, duration=duration, settling=settling * args.period)
    periods = {"segment_duration": args.period, "overlap": 0.0, "window": "boxcar"}
    estimated = estimate_frf(steady, inputs=VOLTAGES, outputs=outputs, **periods, label="time simulation").band(*BAND)
    fine = frequency_response(model, np.geomspace(*BAND, 4000), label="linear model")
    frequency, _ = damping(model)
    compared = {
        title: frf_errors(estimated, model, names, least_coherence=LEAST_COHERENCE)
        for title, names in (("force sensors", SENSORS), ("encoders", ENCODERS))
    }
    summary = {
        "method": args.method,
        "payload_mass_kg": args.payload_mass,
        "simulated_time_s": record.duration,
        "settling_time_s": settling * args.period,
        "wall_time_s": wall,
        "us_per_step": 1e6 * wall / len(record.time),
        "time_step_s": args.time_step,
        "frequency_resolution_Hz": 1 / args.period,
        "suspension_Hz": frequency[frequency > 1][:6],
    }
    for title, figures in compared.items():
        summary |= with_prefix(title, figures)
    print_report(REPORT, summary)
    print_table(f"36 FRFs each, coherence > {LEAST_COHERENCE}", rows_of(summary, compared), COMPARED)
    save(record.select((*VOLTAGES, *outputs)), args.output / "record.h5")
    save(estimated, args.output / "frf.h5")
    if not args.no_plot:
        for name, rows, unit in (("sensor_voltage", SENSORS, "V/V"), ("encoder", ENCODERS, "m/V")):
            save_figure(plot_entries(fine, estimated, rows, unit), args.output / f"{name}.png")
        machine = hexapod(args, cutoff_frequency=None)
        side = {"camera": (0.3, -0.9, 0.05), "size": (1200, 600)}
        show(view_scene(machine, looks=hexapod_looks(machine)), args.output / "machine", **side)
        write_hexapod(machine, motion, args.output / "hexapod.html")
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
