"""Integral force feedback on the bench: design on the linear model, trial in the time simulation, effect on isolation.

The loop goes from the force-sensor stack to the two driven stacks, sampled at 10 kHz with one sample of delay. For
several gains the damping that a simulation shows is compared with the linear prediction; then the loop is compared with
a passive damper between ground and payload that damps the resonance as much.
"""

from dataclasses import replace

import numpy as np
from _common import not_negative, parser, positive, run, whole, write_summary
from _damping_trials import (
    first_mode,
    plot_isolation,
    plot_steps,
    plot_trials,
    pole_zero_level,
    simulated_mode,
    with_damper,
)
from scipy.optimize import brentq

from models.apa300ml import PORTS, reduced_apa300ml
from models.bench import make_bench
from nassim import Loop, frequency_response, linearize
from nassim.plotting import plot_root_locus, save_figure
from nassim.simulation import linearize_closed
from nassim.systems import (
    iff_optimum,
    integral_force_feedback,
    margins,
    open_loop,
    optimum_gain,
    root_locus,
    sampled,
    transmissibility,
)

WIRES = {"measured": "sensor_voltage", "driven": "actuator_voltage"}
SHARES = (0.05, 0.1, 0.2, 0.35, 0.5, 0.7)
"""Gains of the trials over the optimum."""

arguments = parser(__doc__, "active_damping")
arguments.add_argument("--payload-mass", type=positive, default=5.0, help="mass on top [kg] (default: 5)")
arguments.add_argument("--sample-rate", type=positive, default=10e3, help="of the controller [Hz] (default: 10000)")
arguments.add_argument("--delay", type=whole(0), default=1, help="of the controller in samples (default: 1)")
arguments.add_argument("--corner", type=not_negative, default=2.0, help="of the leaky integrator [Hz] (default: 2)")
arguments.add_argument("--duration", type=positive, default=20.0, help="of a record for an FRF [s] (default: 20)")
arguments.add_argument("--coarse", action="store_true", help="tetrahedra of 8 mm, for a quick look")


def main() -> None:
    args = arguments.parse_args()
    mesh = {"element_size": 8e-3, "order": 2, "mesh": {}} if args.coarse else {}
    apa = reduced_apa300ml(ports=PORTS, **mesh)
    bench = make_bench(args.payload_mass, "linear", ports=True, disturbances=True, apa=apa)
    unit = integral_force_feedback(1.0, sample_rate=args.sample_rate, corner_frequency=args.corner, delay=args.delay)

    def with_gain(gain):
        return replace(bench, loops=(Loop("iff", replace(unit, C=gain * unit.C, D=gain * unit.D), **WIRES),))

    plant, digital = linearize(bench), sampled(linearize(bench), args.sample_rate)
    pole, zero, level = pole_zero_level(plant)
    closed_form = iff_optimum(pole, zero)
    gains = np.linspace(0.0, 1.6 * closed_form.gain / level, 240)
    best = optimum_gain(digital, unit, gains, **WIRES, frequency=pole)
    robust = margins(open_loop(digital, unit, np.geomspace(5, 0.49 * args.sample_rate, 40000), **WIRES, gain=best.gain))
    print(f"V_s/V_a: pole {pole:.2f} Hz, zero {zero:.2f} Hz, {level:.3f} V/V between the modes")
    print("optimum               gain [1/s]   damping ratio")
    print(f"  one mode, closed form {closed_form.gain / level:8.1f} {closed_form.damping_ratio:15.3f}")
    print(f"  bench, sampled        {best.gain:8.1f} {best.damping_ratio:15.3f}")
    print(f"  margins: gain {robust.gain_margin:.2f} at {robust.gain_margin_frequency:.0f} Hz")
    summary = {
        "pole_Hz": pole,
        "zero_Hz": zero,
        "level_between_modes_V_per_V": level,
        "closed_form_gain_per_s": closed_form.gain / level,
        "closed_form_damping_ratio": closed_form.damping_ratio,
        "optimum_gain_per_s": best.gain,
        "optimum_damping_ratio": best.damping_ratio,
        "gain_margin": robust.gain_margin,
        "gain_margin_frequency_Hz": robust.gain_margin_frequency,
    }

    print("\n                damping ratio                           frequency [Hz]")
    print("gain [1/s]   predicted   simulated   difference     predicted   simulated")
    summary["trials"] = []
    for gain in best.gain * np.array(SHARES):
        scene = with_gain(gain)
        predicted = first_mode(linearize_closed(scene), pole)
        found = simulated_mode(scene, 1 / args.sample_rate, pole)
        error = 100 * (found[1] / predicted[1] - 1)
        print(
            f"{gain:10.2f} {predicted[1]:11.5f} {found[1]:11.5f} {error:10.4f} % {predicted[0]:13.2f} {found[0]:11.2f}"
        )
        summary["trials"].append(
            {
                "gain_per_s": gain,
                "damping_predicted": predicted[1],
                "damping_simulated": found[1],
                "damping_difference_percent": error,
                "frequency_predicted_Hz": predicted[0],
                "frequency_simulated_Hz": found[0],
            }
        )

    chosen = with_gain(0.35 * best.gain)
    target = first_mode(linearize_closed(chosen), pole)[1]
    most = 1.5 * 2 * np.pi * pole * args.payload_mass
    rate = brentq(lambda c: first_mode(linearize(with_damper(bench, c)), pole)[1] - target, 1.0, most)
    scenes = {"no damping added": bench, "IFF": chosen, "passive damper": with_damper(bench, rate)}
    frequency, frfs = np.geomspace(1.0, 900.0, 3000), []
    for name, scene in scenes.items():
        model = linearize_closed(scene, continuous=True) if scene.loops else linearize(scene)
        frfs.append(frequency_response(model, frequency, label=name))
    isolation = [transmissibility(frf, output="encoder", ground="ground_acceleration") for frf in frfs]
    print(f"\nfirst mode damped to {100 * target:.1f} % of critical, by IFF or by a damper of {rate:.0f} N s/m")
    summary |= {"chosen_damping_ratio": target, "passive_damper_N_s_per_m": rate}
    print("                    ground to payload, 500 Hz   compliance, 1 Hz [um/N]   largest [um/N]")
    for frf, way in zip(frfs, isolation, strict=True):
        compliance = 1e6 * np.abs(frf.response("encoder", "payload_force"))
        passed = abs(way.values[0, 0, np.argmin(np.abs(frequency - 500.0))])
        print(f"{frf.label:<18}{passed:27.5f} {compliance[0]:25.3f} {compliance[frequency < 300].max():16.3f}")
        key = frf.label.replace(" ", "_")
        summary |= {f"{key}_transmissibility_500_Hz": passed, f"{key}_compliance_1_Hz_um_per_N": compliance[0]}
        summary[f"{key}_largest_compliance_um_per_N"] = compliance[frequency < 300].max()

    if not args.no_plot:
        locus = root_locus(digital, unit, gains, **WIRES)
        save_figure(plot_root_locus(locus, frequency=1.6 * pole, optimum=best), args.output / "root_locus.png")
        plot_isolation(frfs, isolation, args.output / "isolation.png")
        plot_steps(scenes, 1 / args.sample_rate, args.output / "step.png")
        trials = {f"{gain:.0f}/s": with_gain(gain) for gain in best.gain * np.array([0.0, 0.05, 0.2, 0.7])}
        options = {"duration": args.duration, "time_step": 1 / args.sample_rate}
        plot_trials(trials, **options, path=args.output / "frf.png")
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
