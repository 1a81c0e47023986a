"""Run experiments on the end-station: its stages move a sample, and the nano-hexapod holds it at the beam.

Four scans: a tomography, in which the spindle turns at constant speed; a translation scan, back and forth through the
beam; a tilt scan, back and forth about the point of interest; and a step-and-turn scan, measured while the spindle
stands between two steps. The open machine is compared with one damped by force feedback in each strut, and with the
damped one within six loops of the sample's pose (HAC-LAC), designed at rest by H-infinity synthesis and scheduled by
payload. Errors are along the axes of the beam. Runs use exact steps about the rotation or along the path of a drive.
The linear model predicts the rms by the same spectra, its scatter in a run of this length, and the share of each
disturbance. Spectra are ASSUMED and describe no real floor, spindle, stage or amplifier, and most
values of the stages are assumed too (`models.nass`): whether aims are met says nothing about the real machine. The
stages have equal properties in all directions across the axis. Models are about the equilibrium under gravity and
centrifugal forces, in which metrology and force sensors read zero.
"""

import argparse
import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.integrate import cumulative_trapezoid

from common.arguments import not_negative, parser, positive, run, several, whole
from common.report import print_report, print_table, write_summary
from common.station_experiments import MACHINES, SETTLING, Experiment, Station
from common.station_plots import LABELS, plot_scan, plot_shares, plot_spectra, plot_tomography, unit, write_motion
from common.station_scans import (
    SPINDLE,
    Scan,
    step_and_turn_scan,
    synchronous_runout,
    tilt_scan,
    tomography,
    translation_scan,
)
from common.station_spectra import AIMS
from models.nass import DRIVES, SIX
from models.nass_loops import POSE, SENSORS, VOLTAGES
from nassim import TimeHistory
from nassim.signals import sample_times, shortest_step, smooth_step
from nassim.systems import close_loop, family_margins

SPIN_UP, CALM, GROWTH = 0.6, 0.4, 0.02
"""In floating frames: duration in which the spindle comes up to speed, time until the noise, and its growth [s]."""
SETTLED = 0.1
"""Share of the aims within which a step of the spindle has settled."""
arguments = parser(__doc__, "nass_experiment")
arguments.add_argument(
    "--payloads", type=several(positive), default=[1.0, 10.0, 50.0], help="masses in tomography [kg] (default: 1,10,50)"
)
arguments.add_argument("--speeds", type=several(positive), default=[30.0, 60.0], help="speeds [rpm] (default: 30,60)")
arguments.add_argument(
    "--scan-payloads", type=several(positive), default=[10.0], help="masses in the other scans [kg] (default: 10)"
)
for name, kind, default, text in (
    ("--amplitude", positive, 0.4e-3, "amplitude of the translation scan, up to 0.5e-3 [m]"),
    ("--scan-speed", positive, 1e-3, "speed of the translation scan [m/s]"),
    ("--tilt", positive, 8e-3, "amplitude of the tilt scan, up to 51e-3 [rad]"),
    ("--tilt-speed", positive, 5e-3, "speed of the tilt scan [rad/s]"),
    ("--step", positive, 10.0, "angle of a step of the spindle [deg]"),
    ("--stand", positive, 1.5, "time between two steps [s]"),
    ("--floor", not_negative, 0.2e-6, "rms velocity of the floor per third of an octave below 20 Hz, assumed [m/s]"),
    ("--runout", not_negative, 50e-9, "rms of the spindle's asynchronous runout, mostly below 5 Hz, assumed [m]"),
    ("--synchronous", not_negative, 100e-9, "amplitude of its synchronous runout, order 2, falling, assumed [m]"),
    ("--stage", not_negative, 20e-9, "rms of the noise of translation and tilt, mostly below 5 Hz, assumed [m]"),
    ("--waviness", not_negative, 100e-9, "amplitude of the waviness of the translation's guide, assumed [m]"),
    ("--amplifier", not_negative, 5e-6, "noise density of an amplifier, assumed [V/sqrt(Hz)]"),
    ("--metrology", not_negative, 1e-9, "rms of the noise of a length of the metrology, assumed [m]"),
    ("--off-centre", not_negative, 2e-3, "distance of the payload's centre of mass from the axis [m]"),
    ("--duration", positive, 10.0, "duration of a run after settling [s]"),
    ("--piece", positive, 0.1, "duration of the comparison with floating frames [s]"),
    ("--sample-rate", positive, 10e3, "sample rate of all loops [Hz]"),
):
    arguments.add_argument(name, type=kind, default=default, help=f"{text} (default: {default:g})")
arguments.add_argument("--turn-time", type=positive, help="duration of a step [s] (default: as short as the drive can)")
arguments.add_argument("--bits", type=whole(8), default=16, help="bits of the converters, assumed (default: 16)")
arguments.add_argument("--seed", type=whole(0), default=0, help="seed of the noise (default: 0)")
REPORT = """
spectra: {spectra}
loops at {sample_rate_Hz:g} Hz with a sample of delay; {runs:g} runs of {duration_s:g} s in {runs_s:.0f} s
least modulus margin over payloads and speeds, one loop at a time: {least_modulus_margin:.2f} ({worst_plant})
controller of {wrong_schedule/controller} on {wrong_schedule/payload}: {wrong_schedule/result}
rms of runs over that of the linear model, of five axes each:
closed: {closed_runs_over_budget/text}
open or damped: {other_runs_over_budget/text}
exact steps against floating frames, in {piece_s:g} s: up to {floating_difference*100:.1f} % of the rms of the errors
settling time after a step of the spindle, closed, without noise, to a tenth of the aims: {settling}"""
AXES = {"Dx [nm]": "rms_Dx_nm:.1f", "Dy [nm]": "rms_Dy_nm:.1f", "Dz [nm]": "rms_Dz_nm:.1f"}
AXES |= {f"{name} [nrad]": f"rms_{name}_nrad:.0f" for name in ("Rx", "Ry", "Rz")}


def run_all(stations: Mapping[float, Station], args: argparse.Namespace) -> list[Experiment]:
    """Run all scans with their payloads on their machines."""
    at = sample_times(SETTLING + args.duration, args.sample_rate)
    turning = [tomography(at, rpm, SETTLING) for rpm in args.speeds]
    others = [
        translation_scan(at, args.amplitude, args.scan_speed, SETTLING),
        tilt_scan(at, args.tilt, args.tilt_speed, SETTLING),
        step_and_turn_scan(at, np.radians(args.step), args.stand, args.turn_time, SETTLING),
    ]
    cases = [(scan, payload, machine) for scan in turning for payload in args.payloads for machine in MACHINES]
    cases += [(scan, payload, m) for scan in others for payload in args.scan_payloads for m in ("open", "closed")]
    found = []
    for number, (scan, payload, machine) in enumerate(cases, start=1):
        print(f"  run {number} of {len(cases)}: {scan.name.replace('_', ' ')}, {payload:g} kg, {machine}", flush=True)
        found.append(stations[payload].run(scan, machine))
    return found


def floating_frame_differences(station: Station) -> dict[str, dict[str, float]]:
    """Return the rms of the difference of exact steps from floating frames over that of the errors, in short pieces.

    All are closed, with the same set points for both methods.
    """
    args = station.args
    turn = args.turn_time or shortest_step(np.radians(args.step), DRIVES[SPINDLE])
    at, later = (sample_times(end, args.sample_rate) for end in (args.piece, turn + args.piece))
    scans = (
        translation_scan(at, args.amplitude, args.scan_speed, 0.0),
        tilt_scan(at, args.tilt, args.tilt_speed, 0.0),
        step_and_turn_scan(later, np.radians(args.step), 0.99 * args.piece, turn, 0.0),
    )
    pairs = {f"tomography_{max(args.speeds):g}_rpm": turning_pair(station, max(args.speeds))}
    for scan in scans:
        # Only a spindle that moves has axes that turn: floating frames have no acceleration of a floor along others.
        place = {"follows": scan.follows, "frame": "rotor" if scan.follows == SPINDLE else "stator"}
        scene = station.scene(machine="closed", **place)
        noise = station.noise(scene, scan.time[-1], 1 / args.piece)
        pairs[scan.name] = tuple(
            station.errors(scene, scan, noise, station.equilibrium(method=m, **place), method=m, settling=0.0)
            for m in ("exact", "generalized_alpha")
        )
    result = {}
    for name, (exact, floating) in pairs.items():
        rms = (exact.values - floating.values).std(axis=1) / exact.values.std(axis=1)
        result[f"{name}_closed"] = {LABELS[six]: float(value) for six, value in zip(SIX, rms, strict=True)}
    return result


def turning_pair(station: Station, rpm: float) -> tuple[TimeHistory, TimeHistory]:
    """Return the errors of a piece of a closed tomography, by exact steps and in floating frames.

    In floating frames, no run can start in the steady state of a spindle on stages: the spindle comes up to speed
    first, and noise and runout begin later. The set points of both are the readings at speed: with those at standstill,
    centrifugal forces would shift the pose by a constant in the rotor's axes, which turns in those of the beam.
    """
    args, begin = station.args, SPIN_UP + CALM
    at = sample_times(begin + args.piece, args.sample_rate)
    speed = 2 * np.pi * rpm / 60
    angle = speed * cumulative_trapezoid(smooth_step(at, 0.0, SPIN_UP), at, initial=0.0)
    steady = Scan("tomography", at, angle[-1] + speed * (at - at[-1]), at >= begin, rpm)
    coming_up = Scan("spin_up", at, angle, at >= begin)
    grown = smooth_step(at, begin, GROWTH)
    disturbed = {name: grown * values for name, values in synchronous_runout(steady.angle, args.synchronous).items()}
    zero, result = station.equilibrium(rpm), []
    for scan, follows, method in ((steady, "", "exact"), (coming_up, SPINDLE, "generalized_alpha")):
        scene = station.scene(scan.rpm, follows, "closed")
        piece = station.noise(scene, args.piece, 1 / args.piece)
        values = grown * np.pad(piece.values, ((0, 0), (len(at) - len(piece.time), 0)))
        noise, known = replace(piece, time=at, values=values), disturbed | ({follows: angle} if follows else {})
        result.append(station.errors(scene, scan, noise, zero, known, method=method, settling=begin))
    return tuple(result)


def settling_time(experiment: Experiment) -> float | None:
    """Return the longest time after a step until the errors without noise stay within `SETTLED` [s]; None: never."""
    aims = SETTLED * np.array([AIMS[six] or np.inf for six in SIX])
    outside = np.any(np.abs(experiment.quiet.values) > aims[:, None], axis=0)
    measured = experiment.scan.measured[-len(outside) :]
    begins = np.flatnonzero(np.diff(measured.astype(int)) == 1) + 1
    longest = 0
    for begin, end in zip(begins, [*begins[1:], len(measured)], strict=True):
        stand = outside[begin:end][measured[begin:end]]
        if stand[-1]:
            return None
        longest = max(longest, len(stand) - int(np.argmax(stand[::-1])) if stand.any() else 0)
    return longest / experiment.quiet.sample_rate


def schedule_figures(
    stations: Mapping[float, Station], speeds: list[float], args: argparse.Namespace
) -> dict[str, object]:
    """Return the least margin of the pose loops at rest and at all speeds, and the effect of a wrong schedule.

    The wrong schedule is the lightest payload's controller on the machine with the heaviest one.
    """
    plants, schedule = {}, {}
    for payload, station in stations.items():
        force, pose = station.loops
        for rpm in (0.0, *speeds):
            case = f"{payload:g} kg at {rpm:g} rpm"
            plants[case] = close_loop(station.linear(rpm), force.linear_controller, measured=SENSORS, driven=VOLTAGES)
            schedule[case] = pose.linear_controller
    frequency, loop = np.geomspace(0.5, 0.45 * args.sample_rate, 1500), {"measured": POSE, "driven": VOLTAGES}
    family = family_margins(plants, schedule, frequency, **loop)
    if not family.margins:
        unstable = "; ".join(f"{name}, {pole}" for name, pole in family.unstable.items())
        raise ValueError(f"the loops are unstable on all plants, so no experiment is closed: {unstable}")
    case, worst = min(family.worst.values(), key=lambda found: found[1].modulus_margin)
    first, last = (f"{payload:g} kg at {speeds[-1]:g} rpm" for payload in (min(stations), max(stations)))
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


def agreement(experiments: list[Experiment]) -> dict[str, float | str]:
    """Compare the rms of runs with those of the linear model, without the rotation about the axis, hardly disturbed.

    Deviations are over the scatter that a run of this length has.
    """
    ratios = np.array([(e.rms / e.predicted)[:5] for e in experiments])
    scatter = np.array([e.scatter[:5] for e in experiments])
    worst = float(np.abs((ratios - 1) / scatter).max())
    found = {"least_ratio": ratios.min(), "largest_ratio": ratios.max(), "mean_ratio": ratios.mean()}
    found |= {"largest_scatter": scatter.max(), "largest_deviation_in_sigma": worst}
    text = "{least_ratio:.2f} to {largest_ratio:.2f}, mean {mean_ratio:.3f}; scatter of a run of this length up to "
    text += "{largest_scatter:.2f}, largest deviation {largest_deviation_in_sigma:.1f} times the scatter"
    return {**{name: float(value) for name, value in found.items()}, "text": text.format(**found)}


def figures(rms: np.ndarray) -> dict[str, float | None]:
    """Return six figures in nm and nrad by their keys; None for NaN."""
    keys = [f"rms_{LABELS[six]}_{unit(six)}" for six in SIX]
    return {key: None if np.isnan(value) else 1e9 * float(value) for key, value in zip(keys, rms, strict=True)}


def main() -> None:
    args = arguments.parse_args()
    stations = {payload: Station(payload, args) for payload in sorted({*args.payloads, *args.scan_payloads})}
    schedule = schedule_figures(stations, args.speeds, args)
    begin = time.monotonic()
    experiments = run_all(stations, args)
    runs_s = time.monotonic() - begin
    differences = floating_frame_differences(stations[args.scan_payloads[0]])
    settled = {e.key: settling_time(e) for e in experiments if e.scan.follows == SPINDLE}
    closed = agreement([e for e in experiments if e.machine == "closed"])
    others = agreement([e for e in experiments if e.machine != "closed"])
    names = ("floor", "runout", "synchronous", "stage", "waviness", "amplifier", "bits", "metrology")
    summary = {
        "spectra": "ASSUMED, in SI: " + ", ".join(f"{name} {getattr(args, name):g}" for name in names),
        "sample_rate_Hz": args.sample_rate,
        "duration_s": args.duration,
        "runs": len(experiments),
        "runs_s": runs_s,
        **schedule,
        "closed_runs_over_budget": closed,
        "other_runs_over_budget": others,
        "piece_s": args.piece,
        "floating_differences": differences,
        "floating_difference": max(value for found in differences.values() for value in found.values()),
        "settling": ", ".join(
            f"{'never' if value is None else f'{value:.2f} s'}" for key, value in settled.items() if "closed" in key
        ),
        **{f"{key}_settling_s": value for key, value in settled.items()},
        "aims": figures(np.array([AIMS[six] or np.nan for six in SIX])),
    }
    tables = {}
    for e in experiments:
        rows = tables.setdefault(e.title, {})
        rows[e.machine] = figures(e.rms)
        summary |= {f"{e.key}_{name}": value for name, value in rows[e.machine].items()}
        if e.machine == "closed":
            rows["aim"] = summary["aims"]
            rows["closed, linear model"] = figures(e.predicted)
            for name, rms in e.shares.items():
                rows[f"by {name}"] = figures(rms)
                summary |= {f"{e.key}_by_{name}_{key}": value for key, value in figures(rms).items()}
    print_report(REPORT, summary)
    for title, rows in tables.items():
        print_table(f"{title.replace('_', ' ')}, rms along the axes of the beam", rows, AXES)
    if not args.no_plot:
        turning = [e for e in experiments if e.scan.rpm]
        plot_tomography(turning, args.output / "tomography.png")
        plot_spectra(turning, args.output / "spectra.png")
        for title in dict.fromkeys(e.title for e in experiments if not e.scan.rpm):
            plot_scan([e for e in experiments if e.title == title], args.output / f"{title}.png")
        plot_shares(experiments, args.output / "shares.png")
        shown = next(e for e in turning if e.machine == "closed")
        write_motion(shown, stations[shown.payload], args.output / "tomography.html")
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
