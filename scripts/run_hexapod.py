"""Identify the nano-hexapod's FRFs from voltages to force sensors and encoders from one record with six inputs.

Six multisines that can be separated drive the six struts of the hexapod, whose actuators are reduced finite element
models with electrical ports. All 6 x 6 FRFs to force sensors and all 6 x 6 FRFs to encoders are estimated from the
record of one time simulation, and compared with the linear model. Each strut moves the sensors of all others.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.ticker import MultipleLocator

from common.arguments import parser, positive, run, whole
from common.costs import timed
from common.hexapod import (
    ENCODERS,
    METHODS,
    SAMPLE_RATE,
    SENSORS,
    VOLTAGES,
    add_machine,
    excite,
    hexapod,
    settling_time,
)
from common.report import print_report, print_table, rows_of, with_prefix, write_summary
from common.responses import COMPARED, frf_errors
from common.views import hexapod_looks, last_frames, show, write_hexapod
from nassim import FRF, estimate_frf, frequency_response, linearize, save, simulate_motion
from nassim.plotting import COLORS, plt, save_figure
from nassim.signals import orthogonal_multisines, remove_settling
from nassim.systems import damping
from nassim.viewer import view_scene

N_POINTS = 60
"""Number of markers on a curve."""

BAND = (10.0, 500.0)
LEAST_COHERENCE = 0.95
LEFT = 1e-4
"""Share of a transient that remains when the analysis begins."""
arguments = parser(__doc__, "run_hexapod")
add_machine(arguments)
arguments.add_argument("--period", type=positive, default=1.0, help="period of the multisines [s] (default: 1)")
arguments.add_argument(
    "--periods", type=whole(2), default=2, help="analysed periods of each of six blocks (default: 2)"
)
arguments.add_argument("--settling", type=positive, help="time before these periods [s] (default: by the slowest mode)")
arguments.add_argument("--voltage", type=positive, default=0.1, help="rms of each input [V] (default: 0.1)")
arguments.add_argument(
    "--time-step", type=positive, default=1e-4, help="time step of the integrator [s] (default: 1e-4)"
)
REPORT = """
{simulated_time_s:g} s simulated in {wall_time_s:.0f} s, {us_per_step:.0f} us a step ({method})
six blocks, of each {settling_time_s:g} s left out for transients
suspension modes [Hz]: {suspension_Hz/0:.1f}, {suspension_Hz/1:.1f}, {suspension_Hz/2:.1f}, {suspension_Hz/3:.1f}, \
{suspension_Hz/4:.1f}, {suspension_Hz/5:.1f}
lines of the FRFs: {frequency_resolution_Hz:g} Hz apart"""


def plot_entries(model: FRF, estimated: FRF, rows: Sequence[str], unit: str) -> Any:
    """Plot identified points over the curves of the model: the diagonal, and one output's FRFs from all inputs.

    Args:
        model: FRF of the linear model
        estimated: identified FRF
        rows: outputs, in the order of the inputs
        unit: unit of the magnitude

    Returns:
        The Axes, phases below magnitudes.
    """
    _, axes = plt.subplots(
        2, 2, figsize=(13, 7.5), sharex=True, sharey="row", height_ratios=[3, 2], layout="constrained"
    )
    kind = rows[0].partition("/")[2].replace("_", " ")
    groups = (list(zip(rows, estimated.inputs, strict=True)), [(rows[0], drive) for drive in estimated.inputs])
    titles = (f"{kind} of each strut for its own voltage", f"{kind} of strut 1 for the voltage of each strut")
    shown = np.unique(np.searchsorted(estimated.frequency, np.geomspace(*estimated.frequency[[0, -1]], N_POINTS)))
    for column, (pairs, title) in enumerate(zip(groups, titles, strict=True)):
        for color, pair in zip(COLORS, pairs, strict=False):
            curve, points = model.response(*pair), estimated.response(*pair)[shown]
            dots = {"ls": "", "marker": "o", "ms": 4, "mfc": "none", "color": color}
            label = pair[1].partition("/")[0].replace("_", " ")
            axes[0, column].loglog(model.frequency, np.abs(curve), color=color, lw=1.0, label=label)
            axes[0, column].loglog(estimated.frequency[shown], np.abs(points), **dots)
            axes[1, column].semilogx(model.frequency, _without_jumps(np.angle(curve, deg=True)), color=color, lw=0.8)
            axes[1, column].semilogx(estimated.frequency[shown], np.angle(points, deg=True), **dots)
        axes[0, column].set_title(title, fontsize=11)
        axes[0, column].legend(fontsize=8, ncols=2)
        axes[1, column].set_xlabel("frequency [Hz]")
        axes[1, column].yaxis.set_major_locator(MultipleLocator(90))
    axes[0, 0].set_ylabel(f"magnitude [{unit}]\n{model.label} (lines), {estimated.label} (points)")
    axes[1, 0].set_ylabel("phase [deg]")
    for ax in axes.flat:
        ax.grid(True, which="both", alpha=0.25)
    return list(axes.flat)


def _without_jumps(degrees: np.ndarray) -> np.ndarray:
    """Return a phase [deg] with gaps at its jumps by a full turn."""
    jumps = np.abs(np.diff(degrees, prepend=degrees[0])) > 180
    return np.where(jumps, np.nan, degrees)


def main() -> None:
    args = arguments.parse_args()
    scene = replace(hexapod(args), quasi_static_above=math.inf)  # the run has all modes of the linear model
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
