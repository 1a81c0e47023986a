"""Damp the nano-hexapod by six equal loops, each from the force sensor of a strut to its own actuator.

One root locus of all six loops gives the gain for which the least damping ratio of the six suspension modes is largest.
For shares of that gain, the script compares damping in time simulations after pulses on the payload with the linear
prediction, and the damped plants with the undamped one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from common.arguments import not_negative, parser, positive, run, whole
from common.costs import timed
from common.hexapod import METHODS, SAMPLE_RATE, SENSORS, VOLTAGES, add_machine, excite, hexapod
from common.report import print_report, print_table, write_summary
from nassim import FRF, Controller, LinearModel, Loop, Scene, TimeHistory, frequency_response, linearize, simulate
from nassim.base import decay_poles, stage
from nassim.plotting import COLORS, plot_root_locus, plt, save_figure
from nassim.simulation import linearize_closed
from nassim.systems import RootLocus, decentralised, integral_force_feedback, optimum_gain, root_locus, sampled

WIRES = {"measured": SENSORS, "driven": VOLTAGES}
POSE = tuple(f"pose.{axis}" for axis in ("ux", "uy", "uz", "rx", "ry", "rz"))
PULSES = ({"payload_force_x": 1.0, "payload_torque_z": 0.1}, {"payload_force_y": 1.0, "payload_force_z": 1.0})
"""Pulses on the payload [N], [N m] that together excite all modes, also both modes of each symmetric pair."""
PULSE_TIME, PULSE_WIDTH, PULSE_END = 0.01, 0.002, 0.02
"""Time of the pulses' maximum, their width, and time from which on they are over [s]."""
EVERY, N_POLES = 8, 40
"""Every how many samples of decays are used to find poles, and number of poles."""
TRIALS = {
    "least predicted": "least_predicted:.4f",
    "simulated": "least_simulated:.4f",
    "most predicted": "most_predicted:.4f",
    "simulated ": "most_simulated:.4f",
    "largest difference [%]": "largest_difference_percent:.2f",
    "us a step": "us_per_step:.0f",
}
"""Columns of the table of `trial`: least and most damped of six modes, and the largest difference."""

SHARES = (0.1, 0.3, 0.6)
"""Gains of the trials as shares of the optimum."""
arguments = parser(__doc__, "hexapod_damping")
add_machine(arguments)
arguments.add_argument("--corner", type=not_negative, default=2.0, help="corner of the integrators [Hz] (default: 2)")
arguments.add_argument("--delay", type=whole(0), default=1, help="delay of the loops [samples] (default: 1)")
arguments.add_argument("--spindle-rpm", type=not_negative, default=0.0, help="speed of the base [rpm] (default: 0)")
arguments.add_argument("--duration", type=positive, default=0.3, help="length of simulated decays [s] (default: 0.3)")
arguments.add_argument("--steps", type=whole(1), default=1, help="time steps per sample of the loops (default: 1)")
arguments.add_argument(
    "--largest-gain", type=positive, default=500.0, help="largest gain of the locus [1/s] (default: 500)"
)
REPORT = """
suspension modes: {suspension_Hz/0:.1f}, {suspension_Hz/1:.1f}, {suspension_Hz/2:.1f}, {suspension_Hz/3:.1f}, \
{suspension_Hz/4:.1f}, {suspension_Hz/5:.1f} Hz, damping ratios from {least_damping_ratio:.4f}
largest common damping ratio: {optimum_damping_ratio:.2f}, at a gain of {optimum_gain_per_s:.0f}/s
design took {design_time_s:.0f} s, {n_trials} simulated decays of {duration_s:g} s {trials_time_s:.0f} s ({method})"""


@dataclass(frozen=True)
class Design:
    """Models for the design of six equal loops.

    Attributes:
        plant: linear model, sampled at the sample rate of the loops
        unit: controller with gain 1
    """

    plant: LinearModel
    unit: Controller

    @property
    def frequency(self) -> np.ndarray:
        """Return the frequencies of the six suspension modes without loops, (6,) [Hz]."""
        poles = self.plant.poles()
        return np.sort(np.abs(poles[poles.imag > 0]))[:6] / (2 * np.pi)

    @property
    def six(self) -> Controller:
        """Return one controller of all six struts."""
        return decentralised(*[self.unit] * 6)

    def modes(self, locus: RootLocus, gain: float) -> np.ndarray:
        """Return the poles of the suspension modes at one gain of a root locus, whose first gain is 0, (6,) [rad/s]."""
        return locus.poles[np.searchsorted(locus.gains, gain), locus.branches(self.frequency)]


def with_loops(scene: Scene, six: Controller, gain: float) -> Scene:
    """Return the scene with a controller of all struts times a gain."""
    return replace(scene, loops=(Loop("iff", replace(six, C=gain * six.C, D=gain * six.D), **WIRES),))


def damped_plants(scene: Scene, six: Controller, gains: Sequence[float], frequency: np.ndarray) -> list[FRF]:
    """Return FRFs of a scene in linear motion without loops and with loops of several gains [1/s]."""
    models = {"no loops": linearize(scene)}
    for gain in gains:
        models[f"gain {gain:.0f}/s"] = linearize_closed(with_loops(scene, six, gain), continuous=True)
    return [frequency_response(model, frequency, label=name) for name, model in models.items()]


def decay(scene: Scene, pulse: dict[str, float], *, method: str, duration: float, n_steps: int) -> TimeHistory:
    """Simulate the payload's pose after a pulse, at the sample rate of the loops.

    n_steps is the number of time steps per sample.
    """
    time = np.arange(round(duration * SAMPLE_RATE) + 1) / SAMPLE_RATE
    shape = np.exp(-(((time - PULSE_TIME) / PULSE_WIDTH) ** 2))
    excitation = excite(scene, time, {name: size * shape for name, size in pulse.items()})
    options = {"time_step": 1 / SAMPLE_RATE / n_steps, "method": METHODS[method][1]}
    record = simulate(scene, excitation, outputs=POSE, progress=False, **options).select(POSE)
    return TimeHistory(time, record.values[:, ::n_steps], record.names, record.units)


def trial(records: list[TimeHistory], predicted: np.ndarray) -> dict[str, Any]:
    """Compare predicted poles, (6,), with those of simulated decays: frequencies [Hz] and damping ratios."""
    decays = np.array([record.after(PULSE_END).values[:, ::EVERY] for record in records])
    poles = decay_poles(decays, EVERY / SAMPLE_RATE, n_poles=N_POLES)
    rows, columns = linear_sum_assignment(np.abs(predicted[:, None] - poles))
    found = poles[columns[np.argsort(rows)]]
    expected, simulated = (-poles.real / np.abs(poles) for poles in (predicted, found))
    return {
        "damping_predicted": expected,
        "damping_simulated": simulated,
        "frequency_predicted_Hz": np.abs(predicted) / (2 * np.pi),
        "frequency_simulated_Hz": np.abs(found) / (2 * np.pi),
        "least_predicted": expected.min(),
        "most_predicted": expected.max(),
        "least_simulated": simulated.min(),
        "most_simulated": simulated.max(),
        "largest_difference_percent": 100 * np.abs(simulated / expected - 1).max(),
    }


def plot_plants(frfs: Sequence[FRF]) -> Any:
    """Plot FRFs from the voltage of strut 1 to its own encoder and its neighbour's, by gain; return two Axes."""
    _, axes = plt.subplots(1, 2, figsize=(13, 5), sharey=True, layout="constrained")
    for ax, row in zip(axes, (1, 2), strict=True):
        for color, frf in zip(COLORS, frfs, strict=False):
            response = frf.response(f"strut_{row}/encoder", "strut_1/actuator_voltage")
            ax.loglog(frf.frequency, np.abs(response), color=color, lw=1.3, label=frf.label)
        ax.set_title(f"encoder of strut {row} for the voltage of strut 1", fontsize=11)
        ax.set_xlabel("frequency [Hz]")
        ax.grid(True, which="both", alpha=0.25)
    axes[0].set_ylabel("magnitude [m/V]")
    axes[0].legend(fontsize=9)
    return list(axes)


def plot_compliances(frfs: Sequence[FRF]) -> Any:
    """Plot the payload's motion per force and torque on it along and about each axis; return six Axes."""
    _, axes = plt.subplots(2, 3, figsize=(13, 7.5), sharex=True, sharey="row", layout="constrained")
    pairs = [("u", "force"), ("r", "torque")]
    for row, (motion, load) in enumerate(pairs):
        for column, axis in enumerate("xyz"):
            ax = axes[row, column]
            for color, frf in zip(COLORS, frfs, strict=False):
                response = frf.response(f"pose.{motion}{axis}", f"payload_{load}_{axis}")
                ax.loglog(frf.frequency, np.abs(response), color=color, lw=1.2, label=frf.label)
            ax.set_title(f"{load} {'along' if load == 'force' else 'about'} {axis}", fontsize=11)
            ax.grid(True, which="both", alpha=0.25)
            axes[1, column].set_xlabel("frequency [Hz]")
    axes[0, 0].set_ylabel("compliance [m/N]")
    axes[1, 0].set_ylabel("compliance [rad/(N m)]")
    axes[0, 0].legend(fontsize=9)
    return list(axes.flat)


def plot_decays(records: Mapping[float, Sequence[TimeHistory]]) -> Any:
    """Plot simulated poses after the pulses by gain [1/s]: along x after the first, along z after the last."""
    _, axes = plt.subplots(2, 1, figsize=(8, 6), sharex=True, layout="constrained")
    for color, (gain, decays) in zip(COLORS[1:], records.items(), strict=False):
        for ax, record, name in zip(axes, (decays[0], decays[-1]), ("pose.ux", "pose.uz"), strict=True):
            ax.plot(record.time, 1e6 * record[name], color=color, lw=1.2, label=f"gain {gain:.0f}/s")
            ax.set_ylabel(f"{name.removeprefix('pose.')} of the payload [um]")
    axes[0].set_title("simulated, after a push on the payload", fontsize=11)
    axes[0].legend(fontsize=9)
    axes[1].set_xlabel("time [s]")
    for ax in axes:
        ax.grid(True, alpha=0.25)
    return list(axes)


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
    how = {"method": args.method, "duration": args.duration, "n_steps": args.steps}
    for gain in tried:
        looped = with_loops(scene, design.six, gain)
        with stage(f"simulate with {gain:.0f}/s"):
            records[gain], wall = timed(lambda s: [decay(s, push, **how) for push in PULSES], looped)
        steps = args.steps * sum(len(record.time) for record in records[gain])
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
        frfs = damped_plants(linear, design.six, tried, np.geomspace(5.0, 500.0, 800))
        ax = plot_root_locus(locus, frequency=1.3 * design.frequency[-1], optimum=best)
        save_figure(ax, args.output / "root_locus.png")
        save_figure(plot_plants(frfs), args.output / "plants.png")
        save_figure(plot_compliances(frfs), args.output / "compliance.png")
        save_figure(plot_decays(records), args.output / "decays.png")
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
