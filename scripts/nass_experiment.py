"""Run a tomography on the end-station: the spindle turns a sample, and the nano-hexapod holds it at the beam.

For each payload and speed there are three machines: the open one, one damped by force feedback in each strut, and the
damped one within six loops of the sample's pose (HAC-LAC), designed at rest by H-infinity synthesis and scheduled by
payload. Runs use exact steps about the rotation. The rms of the errors is compared with the prediction by the linear
model for the same spectra. Spectra are ASSUMED and describe no real floor, spindle or stage, and most values of the
stages are assumed too (`models.nass`): whether aims are met says nothing about the real machine. The stages have equal
properties in all directions across the axis. The sample is centred while it turns: constant displacements along the
rotor's axes, by centrifugal forces, are taken off. Noise of the floor and of the stages across the axis, whose
direction is fixed while the machine turns, is left out.
"""

import argparse
import itertools
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from common.arguments import not_negative, parser, positive, run, several, whole
from common.report import print_report, print_table, write_summary
from common.station_spectra import AIMS, Spectrum, assumed_spectra
from models.nass import SIX, alike_across, make_nass
from models.nass_loops import POSE, SENSORS, VOLTAGES, hac_lac
from nassim import Loop, Scene, TimeHistory, linearize, simulate, simulate_motion
from nassim.base.progress import stage
from nassim.plotting import plt, save_figure
from nassim.signals import spectral_noise
from nassim.simulation import linearize_closed
from nassim.systems import (
    NoiseBudget,
    close_loop,
    family_margins,
    frequency_response,
    noise_budget,
    recorded_budget,
    sampled,
)
from nassim.viewer import view_motion, write_page

Stations = Mapping[tuple[float, float], Mapping[str, Scene]]
"""Scenes by speed [1/min] and payload [kg], then by machine."""
MACHINES = ("open", "damped", "closed")
LABELS = {"ux": "Dx", "uy": "Dy", "uz": "Dz", "rx": "Rx", "ry": "Ry", "rz": "Rz"}
HARMONICS = (2, 3, 5)
"""Orders of the synchronous runout; order 1 along the rotor's axes is a constant displacement across the axis."""
SETTLING = 1.0
"""Beginning of a run that is left out, in which the synchronous runout starts [s]."""
LOWEST, HIGHEST = 0.5, 500.0
"""Band of the noise [Hz]."""
TURNS_ON_PAGE = 0.5
arguments = parser(__doc__, "nass_experiment")
arguments.add_argument(
    "--payloads", type=several(positive), default=[1.0, 10.0, 50.0], help="masses [kg] (default: 1,10,50)"
)
arguments.add_argument("--speeds", type=several(positive), default=[30.0, 60.0], help="speeds [rpm] (default: 30,60)")
for name, default, text in (
    ("--floor", 0.2e-6, "rms velocity of the floor per third of an octave below 20 Hz, assumed [m/s]"),
    ("--runout", 50e-9, "rms of the spindle's asynchronous runout, mostly below 5 Hz, assumed [m]"),
    ("--synchronous", 100e-9, "amplitude of the synchronous runout of order 2, falling with the order, assumed [m]"),
    ("--stage", 20e-9, "rms of the translation's noise, mostly below 5 Hz, assumed [m]"),
):
    arguments.add_argument(name, type=not_negative, default=default, help=f"{text} (default: {default:g})")
arguments.add_argument("--duration", type=positive, default=10.0, help="duration of a run after settling [s]")
arguments.add_argument("--sample-rate", type=positive, default=10e3, help="sample rate of all loops [Hz]")
arguments.add_argument("--seed", type=whole(0), default=0, help="seed of the noise (default: 0)")
REPORT = """
spectra: {spectra}
loops at {sample_rate_Hz:g} Hz with a sample of delay; {runs:g} runs of {duration_s:g} s in {runs_s:.0f} s
least modulus margin over payloads and speeds, one loop at a time: {least_modulus_margin:.2f} ({worst_plant})
controller of {wrong_schedule/controller} on {wrong_schedule/payload}: {wrong_schedule/result}
rms of runs over that of the linear model for the same spectra: {least_ratio:.3f} to {largest_ratio:.3f}"""
AXES = {"Dx [nm]": "rms_Dx_nm:.1f", "Dy [nm]": "rms_Dy_nm:.1f", "Dz [nm]": "rms_Dz_nm:.1f"}
AXES |= {f"{name} [nrad]": f"rms_{name}_nrad:.0f" for name in ("Rx", "Ry", "Rz")}


@dataclass(frozen=True)
class Experiment:
    """A tomography with one payload, speed and machine.

    Attributes:
        rpm: speed of the spindle [1/min]
        payload: mass of the payload [kg]
        machine: one of `MACHINES`
        errors: errors of the sample's pose along the axes of the beam
        recorded: spectra of the errors along the rotor's axes
        predicted: spectra of the noise by the linear model
        lines: mean square along the rotor's axes of the synchronous errors by the linear model, by frequency
        rms: rms by direction along the axes of the beam [m], [rad]
        rms_predicted: the same by the linear model
    """

    rpm: float
    payload: float
    machine: str
    errors: TimeHistory
    recorded: NoiseBudget
    predicted: NoiseBudget
    lines: dict[float, np.ndarray]
    rms: dict[str, float]
    rms_predicted: dict[str, float]

    @property
    def key(self) -> str:
        """Name of the experiment in the summary."""
        return f"tomography_{self.rpm:g}_rpm_{self.payload:g}_kg_{self.machine}"

    def predicted_above(self, row: int) -> np.ndarray:
        """Return the predicted rms of all that lies above each frequency of `predicted`."""
        above = self.predicted.total.cumulative()[row, 0] ** 2
        for frequency, variances in self.lines.items():
            above += variances[row] * (self.predicted.frequency <= frequency)
        return np.sqrt(above)


def station(rpm: float, payload: float) -> Scene:
    """Return the end-station without loops."""
    return make_nass(payload_mass=payload, spindle_rpm=rpm, stages=alike_across(), frame="rotor")


def machines(rpm: float, payload: float, loops: tuple[Loop, Loop]) -> dict[str, Scene]:
    """Return the end-station at a speed, without loops, with the first one, and with both."""
    scene = station(rpm, payload)
    return {"open": scene, "damped": replace(scene, loops=loops[:1]), "closed": replace(scene, loops=loops)}


def lines(rpm: float, amplitude: float) -> list[tuple[str, float, complex]]:
    """Return input, frequency [Hz] and complex amplitude [m] of the synchronous runout; directions differ in phase."""
    inputs = {"runout_x": 0.0, "runout_y": 2.1, "runout_z": 4.4}
    return [
        (name, order * rpm / 60, 2 * amplitude / order * np.exp(1j * (phase + order)))
        for name, phase in inputs.items()
        for order in HARMONICS
    ]


def disturbances(scene: Scene, noise: TimeHistory, synchronous: list[tuple[str, float, complex]]) -> TimeHistory:
    """Return a record of all inputs of the scene from noise and lines."""
    values = np.zeros((len(scene.inputs), len(noise.time)))
    for name in noise.names:
        values[scene.inputs.index(name)] += noise[name]
    for name, frequency, amplitude in synchronous:
        values[scene.inputs.index(name)] += (amplitude * np.exp(2j * np.pi * frequency * noise.time)).real
    return TimeHistory(noise.time, values, scene.inputs)


def along_beam(record: TimeHistory, rpm: float) -> TimeHistory:
    """Return the pose errors along the axes of the beam, which the rotor's axes pass once a turn."""
    angle = 2 * np.pi * rpm / 60 * record.time
    errors = {six: record[f"metrology.{six}"] for six in SIX}
    for x, y in (("ux", "uy"), ("rx", "ry")):
        u, v = errors[x], errors[y]
        errors[x], errors[y] = u * np.cos(angle) - v * np.sin(angle), u * np.sin(angle) + v * np.cos(angle)
    units = ["m" if six[0] == "u" else "rad" for six in SIX]
    return TimeHistory(record.time, np.array(list(errors.values())), [LABELS[six] for six in SIX], units)


def rms_along_beam(variances: np.ndarray) -> dict[str, float]:
    """Return the rms along the axes of the beam from the variances along the rotor's axes, (6,), over whole turns."""
    x, y, z, rx, ry, rz = variances
    across, tilt = (x + y) / 2, (rx + ry) / 2
    return dict(zip(LABELS.values(), np.sqrt([across, across, z, tilt, tilt, rz]), strict=True))


def predict(
    scene: Scene, spectra: Mapping[str, Spectrum], synchronous: list[tuple[str, float, complex]], sample_rate: float
) -> tuple[NoiseBudget, dict[float, np.ndarray]]:
    """Return the noise budget of the linear model, and the mean square of the synchronous errors by frequency."""
    model = linearize_closed(scene) if scene.loops else sampled(linearize(scene), sample_rate)
    budget = noise_budget(model, spectra, np.geomspace(LOWEST, HIGHEST, 400), outputs=POSE)
    variances = {}
    for frequency in sorted({at for _, at, _ in synchronous}):
        response = frequency_response(model, np.array([frequency]))
        inputs = [(u, amplitude) for u, at, amplitude in synchronous if at == frequency]
        total = sum(amplitude * np.array([response.response(y, u)[0] for y in POSE]) for u, amplitude in inputs)
        variances[frequency] = np.abs(total) ** 2 / 2
    return budget, variances


def run_experiment(rpm: float, payload: float, machine: str, scene: Scene, args: argparse.Namespace) -> Experiment:
    """Simulate a machine under the disturbances, and predict its errors."""
    spectra = assumed_spectra(scene.inputs, floor=args.floor, runout=args.runout, stage=args.stage)
    synchronous = lines(rpm, args.synchronous)
    noise = spectral_noise(spectra, SETTLING + args.duration, args.sample_rate, band=(LOWEST, HIGHEST), seed=args.seed)
    step = 1 / args.sample_rate
    excitation = disturbances(scene, noise, synchronous)
    record = simulate(scene, excitation, time_step=step, method="exact", outputs=POSE, progress=False).after(SETTLING)
    record = replace(record, values=record.values - record.values.mean(axis=1, keepdims=True))
    predicted, synchronous_errors = predict(scene, spectra, synchronous, args.sample_rate)
    rms_predicted = rms_along_beam(predicted.total.rms()[:, 0] ** 2 + sum(synchronous_errors.values()))
    errors = along_beam(record, rpm)
    recorded = recorded_budget(record, outputs=POSE, segment_duration=min(2.0, args.duration / 4))
    rms = {name: float(errors[name].std()) for name in errors.names}
    return Experiment(rpm, payload, machine, errors, recorded, predicted, synchronous_errors, rms, rms_predicted)


def all_experiments(
    stations: Mapping[tuple[float, float], Mapping[str, Scene]], args: argparse.Namespace
) -> list[Experiment]:
    """Run all machines at all speeds with all payloads."""
    cases = [(rpm, payload, machine) for rpm, payload in stations for machine in MACHINES]
    found = []
    with stage("runs", total=len(cases), unit="runs") as advance:
        for rpm, payload, machine in cases:
            found.append(run_experiment(rpm, payload, machine, stations[rpm, payload][machine], args))
            advance(1)
    return found


def schedule_figures(
    loops: Mapping[float, tuple[Loop, Loop]], speeds: list[float], sample_rate: float
) -> dict[str, object]:
    """Return the least margin of the pose loops at rest and at all speeds, and the effect of a wrong schedule.

    The wrong schedule is the lightest payload's controller on the machine with the heaviest one.
    """
    plants, schedule = {}, {}
    for payload, (force, pose) in loops.items():
        for rpm in (0.0, *speeds):
            case, plant = f"{payload:g} kg at {rpm:g} rpm", linearize(station(rpm, payload))
            plants[case] = close_loop(plant, force.linear_controller, measured=SENSORS, driven=VOLTAGES)
            schedule[case] = pose.linear_controller
    frequency, loop = np.geomspace(0.5, 0.45 * sample_rate, 1500), {"measured": POSE, "driven": VOLTAGES}
    family = family_margins(plants, schedule, frequency, **loop)
    case, worst = min(family.worst.values(), key=lambda found: found[1].modulus_margin)
    first, last = (f"{payload:g} kg at {speeds[-1]:g} rpm" for payload in (min(loops), max(loops)))
    wrong = family_margins({last: plants[last]}, schedule[first], frequency, **loop)
    return {
        "stable": family.stable,
        "least_modulus_margin": worst.modulus_margin,
        "worst_plant": case,
        "wrong_schedule": {
            "controller": first,
            "payload": last,
            "result": "stable" if wrong.stable else f"unstable, {wrong.unstable[last]}",
        },
    }


def plot_errors(experiments: list[Experiment], path: Path) -> None:
    """Plot the errors across and along the axis over the angle of the spindle, open and closed."""
    rows = sorted({(e.rpm, e.payload) for e in experiments})
    axes = plt.subplots(len(rows), 2, figsize=(11, 2.2 * len(rows) + 1), squeeze=False, layout="constrained")[1]
    for row, case in zip(axes, rows, strict=True):
        for ax, name in zip(row, ("Dy", "Dz"), strict=True):
            for e in experiments:
                if (e.rpm, e.payload) == case and e.machine != "damped":
                    turns = e.rpm / 60 * e.errors.time
                    ax.plot(turns, 1e9 * e.errors[name], lw=0.7, label=f"{e.machine}, {1e9 * e.rms[name]:.1f} nm rms")
            ax.set_title(f"{name}, {case[0]:g} rpm, {case[1]:g} kg", fontsize=10)
            ax.set_ylabel("error [nm]")
            ax.legend(fontsize=8, loc="upper right")
            ax.grid(visible=True, alpha=0.25)
    for ax in axes[-1]:
        ax.set_xlabel("turns of the spindle")
    save_figure(axes.flat, path)


def plot_spectra(experiments: list[Experiment], path: Path) -> None:
    """Plot the cumulative rms of three directions along the rotor's axes, of the runs and of the linear models."""
    shown = {"ux": "x", "uz": "z", "ry": "ry"}
    case = max((e.rpm, -e.payload) for e in experiments)
    chosen = [e for e in experiments if (e.rpm, -e.payload) == case]
    figure, axes = plt.subplots(1, 3, figsize=(12, 4.2), layout="constrained")
    for ax, (six, letter) in zip(axes, shown.items(), strict=True):
        for k, e in enumerate(chosen):
            row = e.predicted.outputs.index(f"metrology.{six}")
            ax.loglog(
                e.recorded.frequency, 1e9 * e.recorded.cumulative()[row, 0], f"C{k}", lw=1.2, label=f"{e.machine}, run"
            )
            line = 1e9 * e.predicted_above(row)
            ax.loglog(e.predicted.frequency, line, f"C{k}--", lw=1.2, label=f"{e.machine}, linear model")
        unit = "nm" if six[0] == "u" else "nrad"
        ax.set(xlabel="frequency [Hz]", ylabel=f"{letter}, rms above a frequency [{unit}]", xlim=(LOWEST, HIGHEST))
        top = max(1e9 * e.recorded.rms()[e.recorded.outputs.index(f"metrology.{six}"), 0] for e in chosen)
        ax.set_ylim(1e-3 * top, 3 * top)
        ax.grid(visible=True, which="both", alpha=0.25)
    axes[0].legend(fontsize=8)
    figure.suptitle(f"tomography at {case[0]:g} rpm with {-case[1]:g} kg, along the rotor's axes", fontsize=10)
    save_figure(axes.flat, path)


def plot_clouds(experiments: list[Experiment], path: Path) -> None:
    """Plot the point of interest in the plane across the beam, y and z, with the aims as an ellipse of 1 sigma."""
    rows = sorted({(e.rpm, e.payload) for e in experiments})
    axes = plt.subplots(1, len(rows), figsize=(3.4 * len(rows) + 0.6, 3.8), squeeze=False, layout="constrained")[1]
    angle = np.linspace(0, 2 * np.pi, 100)
    for ax, case in zip(axes[0], rows, strict=True):
        for e in experiments:
            if (e.rpm, e.payload) == case and e.machine != "damped":
                every = max(1, len(e.errors.time) // 4000)
                y, z = 1e9 * e.errors["Dy"][::every], 1e9 * e.errors["Dz"][::every]
                ax.plot(y, z, ".", ms=1.5, alpha=0.4, label=e.machine)
        aims = 1e9 * np.array([AIMS["uy"], AIMS["uz"]])
        ax.plot(aims[0] * np.cos(angle), aims[1] * np.sin(angle), "k", lw=1.4, label="aim, rms")
        ax.set(title=f"{case[0]:g} rpm, {case[1]:g} kg", xlabel="Dy [nm]", ylabel="Dz [nm]")
        ax.set_aspect("equal", adjustable="datalim")
        ax.grid(visible=True, alpha=0.25)
    axes[0, 0].legend(fontsize=8, markerscale=4)
    save_figure(axes.flat, path)


def write_motion(scene: Scene, experiment: Experiment, args: argparse.Namespace) -> None:
    """Write a page on which the machine turns and its motion is magnified."""
    duration = TURNS_ON_PAGE * 60 / experiment.rpm
    spectra = assumed_spectra(scene.inputs, floor=args.floor, runout=args.runout, stage=args.stage)
    noise = spectral_noise(spectra, duration, args.sample_rate, band=(2 / duration, HIGHEST), seed=args.seed)
    excitation = disturbances(scene, noise, lines(experiment.rpm, args.synchronous))
    _, motion = simulate_motion(
        scene, excitation, time_step=1 / args.sample_rate, method="exact", frames=150, progress=False
    )
    write_page(view_motion(scene, motion), args.output / "tomography.html")


def main() -> None:
    args = arguments.parse_args()
    begin = time.monotonic()
    loops = {
        payload: hac_lac(linearize(station(0.0, payload)), payload, sample_rate=args.sample_rate)
        for payload in args.payloads
    }
    pairs = itertools.product(args.speeds, args.payloads)
    stations = {(rpm, payload): machines(rpm, payload, loops[payload]) for rpm, payload in pairs}
    experiments = all_experiments(stations, args)
    runs_s = time.monotonic() - begin
    ratios = [
        run / model for e in experiments for run, model in zip(pooled(e.rms), pooled(e.rms_predicted), strict=True)
    ]
    label = (
        f"ASSUMED: floor {args.floor:g} m/s, runout {args.runout:g} m, synchronous {args.synchronous:g} m, "
        f"translation {args.stage:g} m"
    )
    summary = {
        "spectra": label,
        "sample_rate_Hz": args.sample_rate,
        "duration_s": args.duration,
        "runs": len(experiments),
        "runs_s": runs_s,
        **schedule_figures(loops, args.speeds, args.sample_rate),
        "least_ratio": min(ratios),
        "largest_ratio": max(ratios),
        "aims": {f"rms_{LABELS[six]}_{unit(six)}": aim and 1e9 * aim for six, aim in AIMS.items()},
    }
    tables = {}
    for e in experiments:
        figures = {f"rms_{LABELS[six]}_{unit(six)}": 1e9 * e.rms[LABELS[six]] for six in SIX}
        summary |= {f"{e.key}_{name}": value for name, value in figures.items()}
        tables.setdefault(f"{e.rpm:g} rpm, {e.payload:g} kg, rms along the axes of the beam", {})[e.machine] = figures
    print_report(REPORT, summary)
    for title, rows in tables.items():
        print_table(title, {**rows, "aim": summary["aims"]}, AXES)
    if not args.no_plot:
        plot_errors(experiments, args.output / "errors.png")
        plot_spectra(experiments, args.output / "spectra.png")
        plot_clouds(experiments, args.output / "clouds.png")
        closed = next(e for e in experiments if e.machine == "closed")
        write_motion(stations[closed.rpm, closed.payload]["closed"], closed, args)
    write_summary(args.output, summary)


def pooled(rms: Mapping[str, float]) -> tuple[float, float, float]:
    """Return the rms across the axis, along it and of the tilt.

    Synchronous errors differ between two axes of the beam, which the linear model, along the rotor's axes, does not
    tell. The rotation about the axis is hardly disturbed.
    """
    return float(np.hypot(rms["Dx"], rms["Dy"])), rms["Dz"], float(np.hypot(rms["Rx"], rms["Ry"]))


def unit(six: str) -> str:
    """Return the unit of figures of a direction."""
    return "nm" if six[0] == "u" else "nrad"


if __name__ == "__main__":
    run(main)
