"""Compute the effect of spindle speed on the modes of the nano-hexapod and on six loops of integral force feedback.

The script computes poles over speed, and stability and damping over speed and gain. It compares pure integrators, leaky
integrators, and pure integrators with stiffness parallel to the sensors, first for a published hexapod (50 kg on
springs), then for the struts of `models`. Time simulations with bodies in large motion on the spindle confirm three
points: a pure integrator is unstable while the spindle turns, and a leak or parallel stiffness stabilises it.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm

from common.arguments import fraction, parser, positive, run, whole
from common.report import print_report, print_table, write_summary
from common.spinning import HIGHEST, Machine, own_machine, published_machine
from common.views import FRAMES, write_spinning
from nassim import LinearModel, Scene, TimeHistory, simulate_motion
from nassim.base import decay_poles
from nassim.plotting import COLORS as PALETTE, plt, save_figure
from nassim.scene import Motion
from nassim.simulation import linearize_closed
from nassim.systems import sampled, zeros

TRIALS = {
    "speed [rpm]": "speed_rpm:.0f",
    "gain [1/s]": "gain_per_s:.0f",
    "predicted [1/s]": "growth_predicted_per_s:.4f",
    "simulated [1/s]": "growth_simulated_per_s:.4f",
    "difference [%]": "growth_difference_percent:.3f",
    "predicted [Hz]": "frequency_predicted_Hz:.4f",
    "simulated [Hz]": "frequency_simulated_Hz:.4f",
}
"""Columns of the table of `trial`."""
PUSHED = 0.2
"""Duration of a trial's pulse [s]."""
POLES, DECAY_RATE = 14, 100.0
"""Number of poles that are found from the decay after it, and its sample rate [Hz]."""
SHORTEST = PUSHED + 4 * POLES / DECAY_RATE
"""Shortest trial [s]."""
COLORS = dict(zip(("pure", "leaky", "parallel stiffness"), (PALETTE[k] for k in (1, 0, 2)), strict=True))
LEVELS = np.array([0, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5])

arguments = parser(__doc__, "spin_hexapod")
arguments.add_argument(
    "--payload-mass", type=positive, default=50.0, help="payload of both machines [kg] (default: 50)"
)
arguments.add_argument("--speed", type=positive, default=60.0, help="speed of the trials [rpm] (default: 60)")
arguments.add_argument("--gain", type=positive, default=100.0, help="gain of the trials [1/s] (default: 100)")
arguments.add_argument(
    "--own-gain", type=positive, default=20.0, help="gain with the struts of `models` [1/s] (default: 20)"
)
arguments.add_argument("--own-speed", type=positive, default=200.0, help="speed of their trials [rpm] (default: 200)")
arguments.add_argument("--leak", type=positive, default=1.0, help="corner of the leaky integrators [Hz] (default: 1)")
arguments.add_argument("--share", type=fraction, default=0.05, help="share of parallel stiffness (default: 0.05)")
arguments.add_argument(
    "--sample-rate", type=positive, default=10e3, help="sample rate of the loops [Hz] (default: 10000)"
)
arguments.add_argument(
    "--trial-rate", type=positive, default=1000.0, help="sample rate of the trials [Hz] (default: 1000)"
)
arguments.add_argument("--duration", type=positive, default=1.5, help="length of a trial [s] (default: 1.5)")
arguments.add_argument("--points", type=whole(4), default=12, help="speeds and gains per map (default: 12)")
arguments.add_argument("--own-trials", action="store_true", help="simulate the struts of `models` too (minutes)")
REPORT = """
{title}, {payload_mass_kg:g} kg, 6 loops at {sample_rate_Hz:g} Hz
suspension modes at rest: {modes_at_rest_Hz/0:.2f}, {modes_at_rest_Hz/1:.2f}, {modes_at_rest_Hz/2:.2f}, \
{modes_at_rest_Hz/3:.2f}, {modes_at_rest_Hz/4:.2f}, {modes_at_rest_Hz/5:.2f} Hz
lowest zero, of the payload on what holds it when no sensor feels a force: {zero_without_Hz:.2f} Hz without stiffness \
in parallel, {zero_with_Hz:.2f} Hz with it; pure integrators are unstable from about that speed on: \
{zero_without_Hz*60:.0f} and {zero_with_Hz*60:.0f} rpm"""


def growth_and_damping(
    machine: Machine, speeds: np.ndarray, gains: np.ndarray, *, parallel: bool, leak: float, sample_rate: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return largest real part of all poles [1/s] and least damping ratio below `HIGHEST`, (speeds, gains) each."""
    growth, ratio = np.zeros((2, len(speeds), len(gains)))
    for k, rpm in enumerate(speeds):
        plant = sampled(machine.plant(rpm, parallel), sample_rate)
        for j, gain in enumerate(gains):
            poles = machine.closed(plant, gain, leak).poles()
            growth[k, j] = poles.real.max()
            counted = poles[(poles.imag > 0) & (np.abs(poles) < 2 * np.pi * HIGHEST)]
            ratio[k, j] = (-counted.real / np.abs(counted)).min()
    return growth, ratio


def frequencies(machine: Machine, speeds: np.ndarray) -> np.ndarray:
    """Return the frequencies of the six suspension modes in the rotor frame, loops open, (speeds, 6) [Hz]."""
    result = []
    for rpm in speeds:
        poles = machine.plant(rpm, parallel=True).poles()
        swinging = poles[(poles.imag > 0) & (-poles.real < 0.5 * np.abs(poles))]
        result.append(np.sort(swinging.imag)[:6] / (2 * np.pi))
    return np.array(result)


def trial(
    machine: Machine, *, speed: float, gain: float, parallel: bool, leak: float, sample_rate: float, duration: float
) -> tuple[dict[str, float], TimeHistory, np.ndarray, tuple[Scene, Motion]]:
    """Compare the least damped pole of a machine with its loops by the linear model and by a time simulation.

    The simulation has bodies in large motion that turn with the spindle after a pulse on the payload. The function also
    returns the record, the payload's distance from the axis by the linear model for the same pulse [m], and the motion
    of the machine.
    """
    scene = machine.looped(speed, parallel, gain, leak, sample_rate)
    model = linearize_closed(scene)
    poles = model.poles()
    expected = poles[np.argmax(poles.real + 1e-9 * poles.imag)]
    time = np.arange(round(duration * sample_rate) + 1) / sample_rate
    push = np.sin(np.pi * np.minimum(time / PUSHED, 1.0)) ** 2
    values = np.outer([1.0, 0.3], push)
    forces = TimeHistory(time, values, ("payload_force_x", "payload_force_y"), ("N", "N"))
    silent = [name for name in scene.inputs if name not in (*machine.wires["driven"], *forces.names)]
    quiet = TimeHistory(time, np.zeros((len(silent), len(time))), tuple(silent), tuple(map(scene.input_unit, silent)))
    names, units = forces.names + quiet.names, forces.units + quiet.units
    excitation = TimeHistory(time, np.vstack([values, quiet.values]), names, units)
    steps = {"time_step": 1 / sample_rate, "frames": np.linspace(0.0, time[-1], FRAMES)}
    record, motion = simulate_motion(scene, excitation, **steps, progress=False)
    distance = np.hypot(*responses(model, forces))
    after = record.after(PUSHED + 2 / sample_rate).select([f"pose.{c}" for c in ("ux", "uy", "rx", "ry")])
    every = max(1, round(sample_rate / DECAY_RATE))
    scaled = after.values / np.abs(after.values).max(axis=1, keepdims=True)
    found = decay_poles(scaled[:, ::every], every / sample_rate, n_poles=POLES)
    pole = found[np.argmin(np.abs(found - expected))]
    figures = {
        "speed_rpm": speed,
        "gain_per_s": gain,
        "growth_predicted_per_s": expected.real,
        "growth_simulated_per_s": pole.real,
        "growth_difference_percent": 100 * abs(pole.real / expected.real - 1),
        "frequency_predicted_Hz": abs(expected.imag) / (2 * np.pi),
        "frequency_simulated_Hz": abs(pole.imag) / (2 * np.pi),
    }
    return figures, record, distance, (scene, motion)


def responses(model: LinearModel, forces: TimeHistory) -> np.ndarray:
    """Return the displacement of the payload along x and y under forces, by a sampled model, (2, n) [m]."""
    columns, rows = [model.inputs.index(n) for n in forces.names], [model.outputs.index(f"pose.u{c}") for c in "xy"]
    state, result = np.zeros(len(model.A)), np.zeros((2, len(forces.time)))
    for k, force in enumerate(forces.values.T):
        result[:, k] = model.C[rows] @ state
        state = model.A @ state + model.B[:, columns] @ force
    return result


def plot_speeds(speeds: np.ndarray, machines: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """Plot frequencies of the suspension modes, and the largest growth rate with loops of one gain, by machine.

    machines: by title "frequency_Hz" (speeds, 6), "gain_per_s", and "growth_per_s" by variant (speeds,)
    """
    _, axes = plt.subplots(2, len(machines), figsize=(5.8 * len(machines), 7.5), sharex=True, layout="constrained")
    for (upper, lower), (title, found) in zip(axes.T, machines.items(), strict=True):
        upper.plot(speeds, found["frequency_Hz"], color="0.2", lw=1.3)
        upper.plot(speeds, speeds / 60, "--", color="0.6", lw=1)
        upper.annotate("spindle", (speeds[-1], speeds[-1] / 60), color="0.45", fontsize=8, ha="right", va="top")
        upper.set(title=title, ylabel="suspension modes, frame that turns [Hz]", ylim=(0, None))
        lower.axhspan(0, 100, color="#d62728", alpha=0.06, lw=0)
        for name, growth in found["growth_per_s"].items():
            lower.plot(speeds, growth, color=COLORS[name], lw=1.5, label=name)
        lower.set_yscale("symlog", linthresh=0.01, linscale=0.4)
        lower.set(xscale="log", xlabel="speed [rpm]", ylabel=f"largest real part, gain {found['gain_per_s']:g}/s [1/s]")
        lower.set_ylim(-30, 30)
        lower.legend(fontsize=8, loc="upper left", title="unstable above 0", title_fontsize=8)
        for ax in (upper, lower):
            ax.axvspan(1, 60, color="0.5", alpha=0.08, lw=0)
            ax.grid(visible=True, which="major", alpha=0.25)
    save_figure(axes.flat, path)


def plot_maps(speeds: np.ndarray, machines: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """Plot the least damping ratio over speed and gain, red where unstable, by machine and variant.

    machines: by title "gains_per_s" (gains,), by variant "growth_map" and "ratio_map" (speeds, gains), and "trials"
    """
    norm = BoundaryNorm(LEVELS, 256)
    figure, axes = plt.subplots(len(machines), 3, figsize=(13, 4 * len(machines)), sharex=True, layout="constrained")
    for row, (title, found) in zip(np.atleast_2d(axes), machines.items(), strict=True):
        gains = found["gains_per_s"]
        for ax, name in zip(row, COLORS, strict=True):
            growth, ratio = found["growth_map"][name].T, found["ratio_map"][name].T
            shown = np.ma.masked_where(growth > 0, np.clip(ratio, 0, LEVELS[-1] - 1e-9))
            ax.set_facecolor("#f4dada")
            mesh = ax.pcolormesh(speeds, gains, shown, norm=norm, cmap="viridis", shading="nearest", rasterized=True)
            if growth.min() < 0 < growth.max():
                ax.contour(speeds, gains, growth, levels=[0], colors="#d62728", linewidths=1.8)
            if growth.max() > 0:
                ax.text(0.97, 0.95, "unstable", transform=ax.transAxes, color="#a01c1c", ha="right", va="top")
            for trial in [found["trials"][name]] if name in found["trials"] else []:
                text = f"simulated: {trial['growth_simulated_per_s']:+.3f}/s"
                place = trial["speed_rpm"], trial["gain_per_s"]
                ax.plot(*place, "o", mfc="w", mec="k", ms=8)
                box = {"fc": "w", "ec": "0.5", "lw": 0.5, "alpha": 0.85, "pad": 2}
                ax.annotate(text, place, xytext=(-8, 12), textcoords="offset points", fontsize=8, ha="right", bbox=box)
            ax.axvline(60, color="0.4", ls=":", lw=1.2)
            ax.set(xlim=speeds[[0, -1]], ylim=gains[[0, -1]], xscale="log", yscale="log")
            ax.set(title=f"{title}, {name}", xlabel="speed [rpm]")
        row[0].set_ylabel("gain [1/s]")
        figure.colorbar(mesh, ax=row, label="least damping ratio", ticks=LEVELS)
    save_figure(np.ravel(axes), path)


def plot_trials(
    trials: Mapping[str, Mapping[str, float]], motions: Mapping[str, tuple[TimeHistory, np.ndarray]], path: Path
) -> None:
    """Plot the payload's distance from the axis in simulations and by the linear model; motions: both, by name."""
    ax = plt.subplots(figsize=(7.5, 4.5), layout="constrained")[1]
    for name, (record, predicted) in motions.items():
        distance = np.hypot(record["pose.ux"], record["pose.uy"])
        label = f"{name}, simulated: {trials[name]['growth_simulated_per_s']:+.3f}/s"
        ax.semilogy(record.time[1:], 1e6 * distance[1:], color=COLORS[name], lw=3, alpha=0.6, label=label)
        label = f"linear model: {trials[name]['growth_predicted_per_s']:+.3f}/s"
        ax.semilogy(record.time[1:], 1e6 * predicted[1:], "k--", lw=1, label=label)
    first = next(iter(trials.values()))
    ax.set(xlabel="time after a push begins [s]", ylabel="payload from the axis [um]", ylim=(1e-3, None))
    ax.set_title(f"{first['speed_rpm']:g} rpm, gain {first['gain_per_s']:g}/s")
    ax.legend(fontsize=8)
    ax.grid(visible=True, alpha=0.25)
    save_figure(ax, path)


def examine(machine, title, speeds, gains, *, gain, args):
    """Compute figures of one machine over speed and gain, for report and pictures."""
    variants = {"pure": (False, 0.0), "leaky": (False, args.leak), "parallel stiffness": (True, 0.0)}
    options = {name: {"parallel": parallel, "leak": leak} for name, (parallel, leak) in variants.items()}
    found = {"title": title, "payload_mass_kg": args.payload_mass, "sample_rate_Hz": args.sample_rate}
    found |= {"frequency_Hz": frequencies(machine, speeds), "gain_per_s": gain, "gains_per_s": gains}
    found["modes_at_rest_Hz"] = frequencies(machine, [0.0])[0]
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
    if args.duration < SHORTEST:
        arguments.error(f"--duration must be at least {SHORTEST:g} s: the decay after the pulse has {POLES} poles")
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
