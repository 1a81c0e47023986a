"""Integral force feedback on the bench: design on the linear model, trial in the time simulation, effect on isolation.

The loop goes from the force-sensor stack to the two driven stacks, sampled at 10 kHz with one sample of delay. For
several gains the damping that a simulation shows is compared with the linear prediction; then the loop is compared with
a passive damper between ground and payload that damps the resonance as much.
"""

import numpy as np
from _arguments import not_negative, parser, positive, run, whole
from _damping_pictures import plot_steps, plot_trials
from _damping_trials import TRIALS, WIRES, equal_damper, first_mode, trial, with_damper, with_loop
from _isolation import ISOLATION, isolation_figures, plot_isolation, responses
from _report import print_report, print_table, rows_of, with_prefix
from _results import write_summary

from models.apa300ml import COARSE, PORTS, reduced_apa300ml
from models.bench import make_bench
from models.bench_figures import pole_zero_level
from nassim import linearize
from nassim.plotting import plot_root_locus, save_figure
from nassim.simulation import linearize_closed
from nassim.systems import iff_optimum, integral_force_feedback, margins, open_loop, optimum_gain, root_locus, sampled

SHARES = (0.05, 0.1, 0.2, 0.35, 0.5, 0.7)
"""Gains of the trials over the optimum."""

arguments = parser(__doc__, "active_damping")
arguments.add_argument("--payload-mass", type=positive, default=5.0, help="mass on top [kg] (default: 5)")
arguments.add_argument("--sample-rate", type=positive, default=10e3, help="of the controller [Hz] (default: 10000)")
arguments.add_argument("--delay", type=whole(0), default=1, help="of the controller in samples (default: 1)")
arguments.add_argument("--corner", type=not_negative, default=2.0, help="of the leaky integrator [Hz] (default: 2)")
arguments.add_argument("--duration", type=positive, default=20.0, help="of a record for an FRF [s] (default: 20)")
arguments.add_argument("--coarse", action="store_true", help="tetrahedra of 8 mm, for a quick look")

REPORT = """
V_s/V_a: pole {pole_Hz:.2f} Hz, zero {zero_Hz:.2f} Hz, {level_between_modes_V_per_V:.3f} V/V between the modes
optimum by closed form for one mode: gain {closed_form_gain_per_s:.1f}/s, damping ratio {closed_form_damping_ratio:.3f}
optimum of the sampled bench: gain {optimum_gain_per_s:.1f}/s, damping ratio {optimum_damping_ratio:.3f}, \
gain margin {gain_margin:.2f} at {gain_margin_frequency_Hz:.0f} Hz
first mode damped to {chosen_damping_ratio*100:.1f} % of critical, by IFF or by {passive_damper_N_s_per_m:.0f} N s/m"""


def main() -> None:
    args = arguments.parse_args()
    apa = reduced_apa300ml(ports=PORTS, **(COARSE if args.coarse else {}))
    bench = make_bench(args.payload_mass, "linear", ports=True, disturbances=True, apa=apa)
    unit = integral_force_feedback(1.0, sample_rate=args.sample_rate, corner_frequency=args.corner, delay=args.delay)
    plant, step = linearize(bench), 1 / args.sample_rate
    found = pole_zero_level(plant)
    pole, zero, level = found.values()
    digital = sampled(plant, args.sample_rate)
    closed_form = iff_optimum(pole, zero)
    gains = np.linspace(0.0, 1.6 * closed_form.gain / level, 240)
    best = optimum_gain(digital, unit, gains, **WIRES, frequency=pole)
    robust = margins(open_loop(digital, unit, np.geomspace(5, 0.49 * args.sample_rate, 40000), **WIRES, gain=best.gain))
    tried = {gain: with_loop(bench, unit, gain) for gain in best.gain * np.array(SHARES)}
    trials = [trial(scene, gain, time_step=step, near=pole) for gain, scene in tried.items()]
    chosen = with_loop(bench, unit, 0.35 * best.gain)
    target = first_mode(linearize_closed(chosen), pole)[1]
    rate = equal_damper(bench, target, near=pole, payload_mass=args.payload_mass)
    scenes = {"no damping added": bench, "IFF": chosen, "passive damper": with_damper(bench, rate)}
    frfs, isolation = responses(scenes, np.geomspace(1.0, 900.0, 3000))
    summary = {
        **found,
        "closed_form_gain_per_s": closed_form.gain / level,
        "closed_form_damping_ratio": closed_form.damping_ratio,
        "optimum_gain_per_s": best.gain,
        "optimum_damping_ratio": best.damping_ratio,
        "gain_margin": robust.gain_margin,
        "gain_margin_frequency_Hz": robust.gain_margin_frequency,
        "trials": trials,
        "chosen_damping_ratio": target,
        "passive_damper_N_s_per_m": rate,
    }
    for frf, way in zip(frfs, isolation, strict=True):
        summary |= with_prefix(frf.label, isolation_figures(frf, way))

    print_report(REPORT, summary)
    print_table("first mode, gain", {f"{row['gain_per_s']:.2f}/s": row for row in summary["trials"]}, TRIALS)
    print_table("isolation", rows_of(summary, scenes), ISOLATION)
    if not args.no_plot:
        locus = root_locus(digital, unit, gains, **WIRES)
        save_figure(plot_root_locus(locus, frequency=1.6 * pole, optimum=best), args.output / "root_locus.png")
        plot_isolation(frfs, isolation, args.output / "isolation.png")
        plot_steps(scenes, step, args.output / "step.png")
        shown = {f"{gain:.0f}/s": with_loop(bench, unit, gain) for gain in best.gain * np.array([0.0, 0.05, 0.2, 0.7])}
        plot_trials(shown, duration=args.duration, time_step=step, path=args.output / "frf.png")
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
