"""Damp the nano-hexapod: each strut's force sensor drives its own actuator, six loops alike with one gain.

The gain comes from one root locus of all six loops: the one that gives the six suspension modes the largest damping
ratio that they have in common. For shares of it, damping in time simulations after pushes on the payload is compared
with the linear prediction, and the damped plants with the undamped one.
"""

import numpy as np
from _arguments import not_negative, parser, positive, run, whole
from _costs import timed
from _hexapod import SAMPLE_RATE, add_machine, hexapod
from _hexapod_damping_pictures import plot_compliances, plot_decays, plot_plants
from _hexapod_loops import WIRES, Design, damped_plants, with_loops
from _hexapod_trials import PULSES, TRIALS, decay, trial
from _report import print_report, print_table
from _results import write_summary

from nassim import linearize
from nassim.base import stage
from nassim.plotting import plot_root_locus, save_figure
from nassim.systems import integral_force_feedback, optimum_gain, root_locus, sampled

SHARES = (0.1, 0.3, 0.6)
"""Gains of the trials over the optimum."""

arguments = parser(__doc__, "hexapod_damping")
add_machine(arguments)
arguments.add_argument("--corner", type=not_negative, default=2.0, help="of the leaky integrators [Hz] (default: 2)")
arguments.add_argument("--delay", type=whole(0), default=1, help="of the controllers in samples (default: 1)")
arguments.add_argument("--spindle-rpm", type=not_negative, default=0.0, help="speed of the base [rpm] (default: 0)")
arguments.add_argument("--duration", type=positive, default=0.3, help="of a simulated decay [s] (default: 0.3)")
arguments.add_argument("--largest-gain", type=positive, default=500.0, help="of the search [1/s] (default: 500)")

REPORT = """
suspension modes: {suspension_Hz/0:.1f}, {suspension_Hz/1:.1f}, {suspension_Hz/2:.1f}, {suspension_Hz/3:.1f}, \
{suspension_Hz/4:.1f}, {suspension_Hz/5:.1f} Hz, damping ratios from {least_damping_ratio:.4f}
largest damping ratio in common: {optimum_damping_ratio:.2f}, at a gain of {optimum_gain_per_s:.0f}/s
design took {design_time_s:.0f} s, {n_trials} simulated decays of {duration_s:g} s {trials_time_s:.0f} s ({method})"""


def main() -> None:
    args = arguments.parse_args()
    if args.spindle_rpm and args.method != "ffrf":
        arguments.error("argument --spindle-rpm: what turns is simulated in floating frames; add --method ffrf")
    scene, linear = (hexapod(args, method=m, spindle_rpm=args.spindle_rpm) for m in (args.method, "exact"))
    unit = integral_force_feedback(1.0, sample_rate=SAMPLE_RATE, corner_frequency=args.corner, delay=args.delay)
    design = Design(sampled(linearize(linear), SAMPLE_RATE), unit)
    with stage("root locus"):
        gains = np.linspace(0.0, args.largest_gain, 101)
        search = {**WIRES, "frequency": design.frequency}
        best, design_time = timed(optimum_gain, design.plant, design.six, gains, **search)
        tried = best.gain * np.array(SHARES)
        shown = np.unique([*np.linspace(0.0, 1.3 * best.gain, 60), *tried])
        locus = root_locus(design.plant, design.six, shown, **WIRES)

    trials, records, spent = {}, {}, 0.0
    for gain in tried:
        looped = with_loops(scene, design.six, gain)
        with stage(f"simulate with {gain:.0f}/s"):
            records[gain], wall = timed(
                lambda s: [decay(s, push, method=args.method, duration=args.duration) for push in PULSES], looped
            )
        steps = sum(len(record.time) for record in records[gain])
        figures = {"gain_per_s": gain, "us_per_step": 1e6 * wall / steps}
        trials[f"{gain:.0f}/s"] = figures | trial(records[gain], design.modes(locus, gain))
        spent += wall
    summary = {
        "payload_mass_kg": args.payload_mass,
        "spindle_rpm": args.spindle_rpm,
        "method": args.method,
        "suspension_Hz": design.frequency,
        "least_damping_ratio": locus.damping_ratio[0, locus.branches(design.frequency)].min(),
        "optimum_gain_per_s": best.gain,
        "optimum_damping_ratio": best.damping_ratio,
        "design_time_s": design_time,
        "trials_time_s": spent,
        "duration_s": args.duration,
        "n_trials": len(tried) * len(PULSES),
        "trials": trials,
    }
    print_report(REPORT, summary)
    print_table("damping ratio of six modes, gain", trials, TRIALS)
    if not args.no_plot:
        frfs = damped_plants(linear, design.six, tried, np.geomspace(5.0, 500.0, 1500))
        ax = plot_root_locus(locus, frequency=1.3 * design.frequency[-1], optimum=best)
        save_figure(ax, args.output / "root_locus.png")
        save_figure(plot_plants(frfs), args.output / "plants.png")
        save_figure(plot_compliances(frfs), args.output / "compliance.png")
        save_figure(plot_decays(records), args.output / "decays.png")
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
