"""Design integral force feedback for the bench on the linear model, and test it in time simulations.

The loop leads from the force-sensor stack to the two driven stacks. It is sampled at 10 kHz with one sample of delay.
For several gains, the script compares the simulated damping with the linear prediction. It then compares the isolation
by the loop with that by a passive damper between ground and payload that damps the resonance as much.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq

from common.arguments import not_negative, parser, positive, run, whole
from common.report import print_report, print_table, rows_of, with_prefix, write_summary
from models.apa300ml import COARSE, PORTS, reduced_apa300ml
from models.bench import make_bench
from models.bench_figures import pole_zero_level
from nassim import (
    FRF,
    Controller,
    LinearModel,
    Loop,
    Scene,
    SpringDamper,
    TimeHistory,
    estimate_frf,
    frequency_response,
    linearize,
    simulate,
)
from nassim.base import decay_poles
from nassim.plotting import plot_frf, plot_root_locus, plot_time_history, plt, save_figure
from nassim.signals import band_limited_noise
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

ISOLATION = {
    "ground to payload, 500 Hz": "transmissibility_500_Hz:.5f",
    "compliance, 1 Hz [um/N]": "compliance_1_Hz_um_per_N:.3f",
    "largest [um/N]": "largest_compliance_um_per_N:.3f",
}
"""Columns of the table of `isolation_figures`."""
WIRES = {"measured": "sensor_voltage", "driven": "actuator_voltage"}
TRIALS = {
    "damping predicted": "damping_predicted:.5f",
    "simulated": "damping_simulated:.5f",
    "difference [%]": "damping_difference_percent:.4f",
    "frequency predicted [Hz]": "frequency_predicted_Hz:.2f",
    "simulated [Hz]": "frequency_simulated_Hz:.2f",
}
"""Columns of the table of `trial`."""

SHARES = (0.05, 0.1, 0.2, 0.35, 0.5, 0.7)
"""Gains of the trials as shares of the optimum."""
arguments = parser(__doc__, "active_damping")
arguments.add_argument("--payload-mass", type=positive, default=5.0, help="mass of the payload [kg] (default: 5)")
arguments.add_argument(
    "--sample-rate", type=positive, default=10e3, help="sample rate of the loop [Hz] (default: 10000)"
)
arguments.add_argument("--delay", type=whole(0), default=1, help="delay of the loop [samples] (default: 1)")
arguments.add_argument("--corner", type=not_negative, default=2.0, help="corner of the integrator [Hz] (default: 2)")
arguments.add_argument("--duration", type=positive, default=20.0, help="length of records for FRFs [s] (default: 20)")
arguments.add_argument("--coarse", action="store_true", help="mesh of 8 mm, for a quick look")
REPORT = """
V_s/V_a: pole {pole_Hz:.2f} Hz, zero {zero_Hz:.2f} Hz, {level_between_modes_V_per_V:.3f} V/V between the modes
optimum by closed form for one mode: gain {closed_form_gain_per_s:.1f}/s, damping ratio {closed_form_damping_ratio:.3f}
optimum of the sampled bench: gain {optimum_gain_per_s:.1f}/s, damping ratio {optimum_damping_ratio:.3f}, \
gain margin {gain_margin:.2f} at {gain_margin_frequency_Hz:.0f} Hz
first mode damped to {chosen_damping_ratio*100:.1f} % of critical, by IFF or by {passive_damper_N_s_per_m:.0f} N s/m"""


def responses(scenes: Mapping[str, Scene], frequency: np.ndarray) -> tuple[list[FRF], list[FRF]]:
    """Return FRFs of named benches with disturbances and closed loops, and their transmissibilities from the ground."""
    frfs = []
    for name, scene in scenes.items():
        model = linearize_closed(scene, continuous=True) if scene.loops else linearize(scene)
        frfs.append(frequency_response(model, frequency, label=name))
    return frfs, [transmissibility(frf, output="encoder", ground="ground_acceleration") for frf in frfs]


def isolation_figures(frf: FRF, way: FRF) -> dict[str, float]:
    """Return transmissibility at 500 Hz, compliance of the payload at the first line, and its maximum below 300 Hz."""
    compliance = 1e6 * np.abs(frf.response("encoder", "payload_force"))
    return {
        "transmissibility_500_Hz": abs(way.values[0, 0, np.argmin(np.abs(way.frequency - 500.0))]),
        "compliance_1_Hz_um_per_N": compliance[0],
        "largest_compliance_um_per_N": compliance[frf.frequency < 300].max(),
    }


def plot_isolation(frfs: list[FRF], isolation: list[FRF], path: Path) -> None:
    """Plot the transmissibility from the ground and the compliance of the payload side by side."""
    columns = plt.figure(figsize=(13, 7), layout="constrained").subfigures(1, 2)
    plot_frf(isolation, output="absolute motion", input="ground", unit="m/m", figure=columns[0])
    save_figure(plot_frf(frfs, output="encoder", input="payload_force", unit="m/N", figure=columns[1]), path)


def first_mode(model: LinearModel, near: float) -> tuple[float, float]:
    """Return frequency [Hz] and damping ratio of the slowest decaying oscillation below three times a frequency."""
    return _slowest(model.poles(), near)


def excite(duration: float, time_step: float, **signals: Any) -> TimeHistory:
    """Sample functions of time as signals of the bench's three inputs; inputs without a function are zero."""
    time = np.arange(round(duration / time_step) + 1) * time_step
    units = {"actuator_voltage": "V", "payload_force": "N", "ground_acceleration": "m/s2"}
    values = [signals[name](time) if name in signals else np.zeros_like(time) for name in units]
    return TimeHistory(time, values, tuple(units), tuple(units.values()))


def simulated_mode(scene: Scene, time_step: float, near: float) -> tuple[float, float]:
    """Return what `first_mode` does, from a simulated decay after a pulse of force on the payload."""
    pulse = excite(0.25, time_step, payload_force=lambda t: np.exp(-(((t - 0.01) / 0.002) ** 2)))
    record = simulate(scene, pulse, time_step=time_step, method="exact", progress=False).after(0.02)
    poles = decay_poles(record.select(["sensor_voltage", "encoder"]).values[:, ::5], 5 * time_step, n_poles=16)
    return _slowest(poles, near)


def _slowest(poles: np.ndarray, near: float) -> tuple[float, float]:
    candidates = poles[(poles.imag > 0) & (np.abs(poles) < 2 * np.pi * 3 * near)]
    pole = candidates[np.argmax(candidates.real)]
    return float(abs(pole) / (2 * np.pi)), float(-pole.real / abs(pole))


def with_loop(bench: Scene, unit: Controller, gain: float) -> Scene:
    """Return the bench with a loop, whose controller is one of unit gain times a gain."""
    return replace(bench, loops=(Loop("iff", replace(unit, C=gain * unit.C, D=gain * unit.D), **WIRES),))


def trial(scene: Scene, gain: float, *, time_step: float, near: float) -> dict[str, float]:
    """Compare the first mode of the bench with a loop by the linear model and by the time simulation."""
    predicted = first_mode(linearize_closed(scene), near)
    found = simulated_mode(scene, time_step, near)
    return {
        "gain_per_s": gain,
        "damping_predicted": predicted[1],
        "damping_simulated": found[1],
        "damping_difference_percent": 100 * (found[1] / predicted[1] - 1),
        "frequency_predicted_Hz": predicted[0],
        "frequency_simulated_Hz": found[0],
    }


def with_damper(bench: Scene, rate: float) -> Scene:
    """Return the bench with a passive damper between ground and payload [N s/m]."""
    damper = SpringDamper("damper", "base.guide", "payload.bottom", "z", damping=rate)
    return replace(bench, springs=(damper,))


def equal_damper(bench: Scene, damping_ratio: float, *, near: float, payload_mass: float) -> float:
    """Return the rate of the passive damper that damps the first mode as much as the loop [N s/m]."""
    most = 1.5 * 2 * np.pi * near * payload_mass
    return brentq(lambda rate: first_mode(linearize(with_damper(bench, rate)), near)[1] - damping_ratio, 1.0, most)


def plot_trials(scenes: dict[str, Scene], *, duration: float, time_step: float, path: Path) -> None:
    """Plot FRFs of the damped bench, estimated from simulated records of noise, over the linear prediction."""
    frequency = np.geomspace(5.0, 900.0, 3000)
    noise = band_limited_noise(duration, 1 / time_step, cutoff_frequency=600.0, rms=0.1).values[0]
    excitation = excite(duration, time_step, actuator_voltage=lambda _t: noise)
    frfs, markers = [], []
    for name, scene in scenes.items():
        frfs.append(frequency_response(linearize_closed(scene, continuous=True), frequency, label=f"{name}, linear"))
        record = simulate(scene, excitation, time_step=time_step, method="exact", progress=False)
        found = estimate_frf(
            record,
            inputs=["actuator_voltage"],
            outputs=["sensor_voltage", "encoder"],
            segment_duration=2.0,
            label=f"{name}, simulated",
        ).band(5, 600)
        chosen = np.searchsorted(found.frequency, np.geomspace(5, found.frequency[-1], 90))
        thin = np.unique(chosen.clip(max=len(found.frequency) - 1))
        values = found.values[:, :, thin]
        frfs.append(FRF(found.frequency[thin], values, found.outputs, found.inputs, None, found.label))
        markers.append(frfs[-1].label)
    columns = plt.figure(figsize=(13, 7), layout="constrained").subfigures(1, 2)
    for column, (output, unit) in zip(columns, (("sensor_voltage", "V/V"), ("encoder", "m/V")), strict=True):
        axes = plot_frf(frfs, output=output, input="actuator_voltage", unit=unit, markers=markers, figure=column)
        for ax in axes:
            for line, points in zip(ax.lines[::2], ax.lines[1::2], strict=False):
                points.set_color(line.get_color())
        axes[0].legend(fontsize=8)
    save_figure(axes, path)


def plot_steps(scenes: dict[str, Scene], time_step: float, path: Path) -> None:
    """Plot the responses to a step of 1 N on the payload over 0.15 s."""
    step = excite(0.15, time_step, payload_force=lambda t: 1.0 * (t > 0.005))
    records = [simulate(s, step, time_step=time_step, method="exact", progress=False) for s in scenes.values()]
    values = np.array([1e6 * record["encoder"] for record in records])
    axes = plot_time_history(TimeHistory(step.time, values, tuple(scenes), ("um",) * len(scenes)))
    save_figure(axes, path)


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
    robust = margins(open_loop(digital, unit, np.geomspace(5, 0.5 * args.sample_rate, 40000), **WIRES, gain=best.gain))
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
