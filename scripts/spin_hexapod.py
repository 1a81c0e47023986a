"""The nano-hexapod on its spindle: what speed does to its modes and to six loops of integral force feedback.

Poles over speed, stability and damping over speed and gain, for pure integrators, for leaky ones, and for pure ones
with stiffness in parallel to the sensors; first of a published hexapod (50 kg on springs), then of our own struts.
Three points are confirmed by runs in time, of bodies that turn with the spindle: a pure integrator is unstable while it
turns, a leak and stiffness in parallel each make up for that.
"""

import numpy as np
from _arguments import fraction, parser, positive, run, whole
from _pages import write_spinning
from _report import print_report, print_table
from _results import write_summary
from _spin_pictures import plot_maps, plot_speeds, plot_trials
from _spin_trials import TRIALS, frequencies, growth_and_damping, trial
from _spinning import own_machine, published_machine

from nassim.systems import zeros

arguments = parser(__doc__, "spin_hexapod")
arguments.add_argument("--payload-mass", type=positive, default=50.0, help="on either machine [kg] (default: 50)")
arguments.add_argument("--speed", type=positive, default=60.0, help="of the trials [rpm] (default: 60)")
arguments.add_argument("--gain", type=positive, default=100.0, help="of the trials [1/s] (default: 100)")
arguments.add_argument("--own-gain", type=positive, default=20.0, help="of our own struts' loops [1/s] (default: 20)")
arguments.add_argument("--own-speed", type=positive, default=200.0, help="of their trials [rpm] (default: 200)")
arguments.add_argument("--leak", type=positive, default=1.0, help="corner of leaky integrators [Hz] (default: 1)")
arguments.add_argument("--share", type=fraction, default=0.05, help="of stiffness in parallel (default: 0.05)")
arguments.add_argument("--sample-rate", type=positive, default=10e3, help="of the loops [Hz] (default: 10000)")
arguments.add_argument("--trial-rate", type=positive, default=1000.0, help="of the trials' loops [Hz] (default: 1000)")
arguments.add_argument("--duration", type=positive, default=1.5, help="of a trial [s] (default: 1.5)")
arguments.add_argument("--points", type=whole(4), default=12, help="speeds and gains of a map (default: 12)")
arguments.add_argument("--own-trials", action="store_true", help="simulate our own struts too (minutes)")

REPORT = """
{title}, {payload_mass_kg:g} kg, 6 loops at {sample_rate_Hz:g} Hz
suspension modes at rest: {standing_modes_Hz/0:.2f}, {standing_modes_Hz/1:.2f}, {standing_modes_Hz/2:.2f}, \
{standing_modes_Hz/3:.2f}, {standing_modes_Hz/4:.2f}, {standing_modes_Hz/5:.2f} Hz
lowest zero, of the payload on what holds it when no sensor feels a force: {zero_without_Hz:.2f} Hz without stiffness in
parallel, {zero_with_Hz:.2f} Hz with it; pure integrators are unstable from about that speed on: \
{zero_without_Hz*60:.0f} and {zero_with_Hz*60:.0f} rpm"""


def examine(machine, title, speeds, gains, *, gain, args):
    """Figures of one machine over speed and gain, for report and pictures."""
    variants = {"pure": (False, 0.0), "leaky": (False, args.leak), "parallel stiffness": (True, 0.0)}
    options = {name: {"parallel": parallel, "leak": leak} for name, (parallel, leak) in variants.items()}
    found = {"title": title, "payload_mass_kg": args.payload_mass, "sample_rate_Hz": args.sample_rate}
    found |= {"frequency_Hz": frequencies(machine, speeds), "gain_per_s": gain, "gains_per_s": gains}
    found["standing_modes_Hz"] = frequencies(machine, [0.0])[0]
    for name, parallel in (("zero_without_Hz", False), ("zero_with_Hz", True)):
        wires = machine.wires
        dips = zeros(machine.plant(0.0, parallel), inputs=wires["driven"], outputs=wires["measured"])
        found[name] = np.abs(dips).min() / (2 * np.pi)
    rate = {"sample_rate": args.sample_rate}
    maps = {name: growth_and_damping(machine, speeds, gains, **option, **rate) for name, option in options.items()}
    lines = {
        name: growth_and_damping(machine, speeds, [gain], **option, **rate)[0][:, 0] for name, option in options.items()
    }
    found |= {"growth_map": {name: m[0] for name, m in maps.items()}, "growth_per_s": lines}
    return found | {"ratio_map": {name: m[1] for name, m in maps.items()}}, options


def main() -> None:
    args = arguments.parse_args()
    speeds = np.unique(np.append(np.geomspace(1.0, 600.0, args.points), [60.0, args.speed, args.own_speed]))
    machines = {
        "published": (published_machine(args.payload_mass, args.share), args.gain, args.speed, True, 1000.0),
        "own struts": (own_machine(args.payload_mass), args.own_gain, args.own_speed, args.own_trials, 200.0),
    }
    results, motions, machines_seen = {}, {}, {}
    for title, (machine, gain, speed, tried, largest) in machines.items():
        gains = np.geomspace(1.0, largest, args.points)
        found, options = examine(machine, title, speeds, gains, gain=gain, args=args)
        common = {"speed": speed, "gain": gain, "duration": args.duration}
        common["sample_rate"] = args.trial_rate if title == "published" else 2 * args.trial_rate
        trials = {name: trial(machine, **option, **common) for name, option in options.items() if tried}
        found["trials"] = {name: figures for name, (figures, *_) in trials.items()}
        motions[title] = {name: (record, distance) for name, (_, record, distance, _) in trials.items()}
        machines_seen[title] = {name: seen for name, (*_, seen) in trials.items()}
        results[title] = found
        print_report(REPORT, found)
        if tried:
            print_table(f"{title}, slowest pole", found["trials"], TRIALS)
    if not args.no_plot:
        plot_speeds(speeds, results, args.output / "poles.png")
        plot_maps(speeds, results, args.output / "maps.png")
        for title, found in results.items():
            if found["trials"]:
                plot_trials(found["trials"], motions[title], args.output / f"trials_{title.replace(' ', '_')}.png")
                write_spinning(machines_seen[title], args.output, title)
    write_summary(args.output, {"speeds_rpm": speeds, **results})


if __name__ == "__main__":
    run(main)
