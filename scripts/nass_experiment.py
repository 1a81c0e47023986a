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
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid, trapezoid

from common.arguments import not_negative, parser, positive, run, several, whole
from common.report import print_report, print_table, write_summary
from common.station_scans import (
    SPINDLE,
    TILT,
    Scan,
    runout_amplitudes,
    step_and_turn_scan,
    synchronous_runout,
    tilt_scan,
    tomography,
    translation_scan,
)
from common.station_spectra import AIMS, Electronics, Spectrum, assumed_spectra, disturbance_of
from models.nass import DRIVES, FIXED_PAIRS, POSE_PAIRS, SIX, alike_across, make_nass
from models.nass_loops import CONVERTERS, POSE, SENSORS, TARGETS, VOLTAGES, hac_lac
from nassim import LinearModel, Loop, Scene, TimeHistory, linearize, simulate, simulate_motion
from nassim.plotting import plt, save_figure
from nassim.signals import sample_times, shortest_step, smooth_step, spectral_noise, turned
from nassim.simulation import linearize_closed
from nassim.systems import (
    NoiseBudget,
    close_loop,
    family_margins,
    frequency_response,
    recorded_budget,
    rotating_noise_budget,
    sampled,
)
from nassim.viewer import view_motion, write_page

MACHINES = ("open", "damped", "closed")
LABELS = {"ux": "Dx", "uy": "Dy", "uz": "Dz", "rx": "Rx", "ry": "Ry", "rz": "Rz"}
DISTURBANCES = ("floor", "runout", "synchronous", "path", "stages", "amplifiers", "converters", "metrology")
"""Shares of the errors. That of the path is what remains without noise in a scan at rest."""
SETTLING = 1.0
"""Beginning of a run that is left out, in which the synchronous runout starts [s]."""
LOWEST, HIGHEST = 0.5, 500.0
"""Band of the noise [Hz]."""
GUIDE_PERIOD = 0.2e-3
"""Period of the waviness of the translation's guide along its path [m], assumed."""
SPIN_UP, CALM, GROWTH = 0.6, 0.4, 0.02
"""In floating frames: duration in which the spindle comes up to speed, time until the noise, and its growth [s]."""
START_OF_PATH = 0.2
"""Angle of a path of the spindle whose start is read [rad]."""
SETTLED = 0.1
"""Share of the aims within which a step of the spindle has settled."""
COLORS = dict(zip(MACHINES, ("C0", "C2", "C1"), strict=True))
TURNS_ON_PAGE = 0.5
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


@dataclass(frozen=True)
class Experiment:
    """A scan with one payload and machine.

    Attributes:
        scan: the scan
        payload: mass of the payload [kg]
        machine: one of `MACHINES`
        errors: errors of the sample's pose along the axes of the beam, after `SETTLING`
        quiet: the same without noise; of a tomography over one turn, by the linear model
        budget: spectra of the errors by noise, along the axes of the beam, by the linear model
    """

    scan: Scan
    payload: float
    machine: str
    errors: TimeHistory
    quiet: TimeHistory
    budget: NoiseBudget

    @property
    def key(self) -> str:
        """Name of the experiment in the summary."""
        return f"{self.title}_{self.machine}"

    @property
    def title(self) -> str:
        """Name of the scan with its payload."""
        return f"{self.scan.name}_{self.payload:g}_kg"

    @property
    def rms(self) -> np.ndarray:
        """The rms of the errors while the sample is measured, (6,) [m], [rad]."""
        return self._rms(self.errors)

    @property
    def shares(self) -> dict[str, np.ndarray]:
        """The rms by each disturbance by the linear model, (6,) each [m], [rad]."""
        squares = {name: np.zeros(6) for name in DISTURBANCES}
        for name, rms in zip(self.budget.inputs, self.budget.rms().T, strict=True):
            squares[disturbance_of(name)] += rms**2
        squares["synchronous" if self.scan.rpm else "path"] = self._rms(self.quiet) ** 2
        return {name: np.sqrt(square) for name, square in squares.items()}

    @property
    def predicted(self) -> np.ndarray:
        """The rms by all disturbances by the linear model, (6,) [m], [rad]."""
        return np.sqrt(sum(rms**2 for rms in self.shares.values()))

    @property
    def scatter(self) -> np.ndarray:
        """Expected relative scatter of the rms of a run of this length, one sigma by the linear model, (6,) [-].

        The mean square of Gaussian noise of the spectrum S over a time T varies by sqrt(integral of S^2 / T), for a
        mode of the damping ratio z at w by 1 / sqrt(z w T) of itself. A sine of the mean square q adds 2 q S to the
        integral.
        """
        budget = self.budget.total
        period = 60 / self.scan.rpm if self.scan.rpm else self.quiet.duration
        lines = np.abs(np.fft.rfft(self.quiet.values)[:, 1:]) ** 2 * 2 / len(self.quiet.time) ** 2
        squares = trapezoid(budget.psd[:, 0] ** 2, budget.frequency, axis=1)
        for row, density in enumerate(budget.psd[:, 0]):
            at = np.interp((1 + np.arange(lines.shape[1])) / period, budget.frequency, density, 0.0, 0.0)
            squares[row] += 2 * lines[row] @ at
        measured = np.count_nonzero(self.scan.measured) / self.errors.sample_rate
        return np.sqrt(squares / measured) / (2 * self.predicted**2)

    def _rms(self, record: TimeHistory) -> np.ndarray:
        measured = self.scan.measured[-len(self.errors.time) :]
        chosen = measured if len(record.time) == len(measured) else slice(None)
        return np.sqrt((record.values[:, chosen] ** 2).mean(axis=1))

    def predicted_above(self, row: int) -> np.ndarray:
        """Return the predicted rms of all that lies above each frequency of the budget."""
        above = self.budget.total.cumulative()[row, 0] ** 2
        lines = np.abs(np.fft.rfft(self.quiet.values[row])) ** 2 * 2 / len(self.quiet.time) ** 2
        for order in range(1, len(lines)):
            above += lines[order] * (self.budget.frequency <= order * self.scan.rpm / 60)
        return np.sqrt(above)


Readings = Mapping[str, float]
Signals = Mapping[str, np.ndarray]


class Station:
    """The end-station with a payload, and what its experiments share, which is computed once."""

    def __init__(self, payload: float, args: argparse.Namespace) -> None:
        self.payload, self.args = payload, args

    @cache  # noqa: B019
    def scene(self, rpm: float = 0.0, follows: str = "", machine: str = "open", *, frame: str = "rotor") -> Scene:
        """Return the scene; follows: input that the angle of the spindle or the tilt stage follows, or ""."""
        if machine != "open":
            open_one = self.scene(rpm, follows, frame=frame)
            return replace(open_one, loops=self.loops[: MACHINES.index(machine)])
        middle = make_nass(payload_mass=self.payload).body("payload")
        made = make_nass(
            stages=alike_across(),
            payload_mass=self.payload,
            payload_centre=np.array([self.args.off_centre, 0.0, 0.0]) - middle.points["foot"],
            spindle_rpm=rpm,
            spindle_input=follows * (follows == SPINDLE),
            tilt_input=follows * (follows == TILT),
            frame=frame,
        )
        return replace(made, gravity=(0, 0, -9.81))

    @cached_property
    def loops(self) -> tuple[Loop, Loop]:
        """Force feedback and pose loops of the schedule, designed at rest."""
        return hac_lac(self.linear(), self.payload, sample_rate=self.args.sample_rate)

    @cache  # noqa: B019
    def linear(self, rpm: float = 0.0) -> LinearModel:
        """Return the linear model without loops."""
        return linearize(self.scene(rpm))

    @cache  # noqa: B019
    def at_rest(self, rpm: float = 0.0, follows: str = "", *, frame: str = "rotor", method: str = "exact") -> Readings:
        """Return all readings in equilibrium under gravity and centrifugal forces, by a method of `simulate`.

        Models along a path of the spindle have an equilibrium of their own, of first order: the run starts in it.
        """
        along_path = follows == SPINDLE and method == "exact"
        scene, at = self.scene(rpm, follows, frame=frame), 1e-3 * np.arange(101 if along_path else 3)
        values = np.zeros((len(scene.inputs), len(at)))
        if along_path:
            values[scene.inputs.index(follows)] = START_OF_PATH * smooth_step(at, 0.01, 0.09)
        still = TimeHistory(at, values, scene.inputs)
        record = simulate(scene, still, time_step=1e-3, method=method, progress=False)
        return {name: float(record[name][0]) for name in scene.outputs}

    @cache  # noqa: B019
    def prediction(self, rpm: float, machine: str) -> tuple[NoiseBudget, TimeHistory]:
        """Return the spectra of the errors by noise, and the errors by synchronous runout over a turn."""
        scene, rate = self.scene(rpm, machine=machine), self.args.sample_rate
        model = sampled(self.linear(rpm), rate) if machine == "open" else linearize_closed(scene)
        budget = rotating_noise_budget(
            model,
            self.spectra(scene),
            np.geomspace(LOWEST, HIGHEST, 150),
            rotation_frequency=rpm / 60,
            fixed_inputs=FIXED_PAIRS,
            fixed_outputs=POSE_PAIRS,
            outputs=POSE,
        )
        return budget, synchronous_errors(model, rpm, self.args.synchronous)

    def spectra(self, scene: Scene) -> dict[str, Spectrum]:
        """Return the assumed spectra of the inputs of a scene."""
        args = self.args
        electronics = Electronics(args.sample_rate, args.amplifier, args.bits, args.metrology)
        given = {"floor": args.floor, "runout": args.runout, "stage": args.stage}
        return assumed_spectra(scene.inputs, **given, electronics=electronics)

    def noise(self, scene: Scene, duration: float, lowest: float) -> TimeHistory:
        """Return noises of the inputs of a scene with their assumed spectra from a frequency [Hz] on."""
        rate, seed = self.args.sample_rate, self.args.seed
        return spectral_noise(self.spectra(scene), duration, rate, band=(lowest, HIGHEST), seed=seed)

    def excitation(
        self, scene: Scene, scan: Scan, noise: TimeHistory | None, zero: Readings, known: Signals | None = None
    ) -> TimeHistory:
        """Return a record of all inputs of the scene: set points, errors of the stages, and noise.

        Floor and stages have fixed axes, and the model of a constant speed has axes that turn.

        Args:
            scene: the scene.
            scan: the scan.
            noise: noise of inputs.
            zero: readings at which metrology and force sensors are zero.
            known: signals of inputs in place of the synchronous runout of the scan.
        """
        values = dict.fromkeys(scene.inputs, 0.0)
        parts = [scan.drives, synchronous_runout(scan.angle, self.args.synchronous) if known is None else known]
        parts += [{f"target.{six}": path for six, path in scan.targets.items()}]
        parts += [
            {new: zero[old] for new, old in zip((*TARGETS, *CONVERTERS), (*POSE, *SENSORS), strict=True) if old in zero}
        ]
        if "translation_y" in scan.drives:
            waves = 2 * np.pi * scan.drives["translation_y"] / GUIDE_PERIOD
            parts += [{"translation_z": self.args.waviness * np.sin(waves)}]
        if noise:
            parts += [{name: noise[name] for name in noise.names}]
        for part in parts:
            for name in values.keys() & part.keys():
                values[name] = values[name] + part[name]
        record = TimeHistory(scan.time, [row + np.zeros(len(scan.time)) for row in values.values()], scene.inputs)
        return turned(record, FIXED_PAIRS, -scan.angle) if scan.rpm else record

    def errors(
        self,
        scene: Scene,
        scan: Scan,
        noise: TimeHistory | None,
        zero: Readings,
        known: Signals | None = None,
        *,
        method: str = "exact",
        settling: float = SETTLING,
    ) -> TimeHistory:
        """Simulate a scan, see `excitation`; return the errors along the axes of the beam, after settling [s]."""
        given, step = self.excitation(scene, scan, noise, zero, known), 1 / self.args.sample_rate
        record = simulate(scene, given, time_step=step, method=method, outputs=POSE, progress=False).select(POSE)
        record = replace(record, values=record.values - [[zero[name]] for name in POSE])
        values = turned(record, POSE_PAIRS, scan.angle).values.copy()
        for six, path in scan.targets.items():
            values[SIX.index(six)] -= path
        return TimeHistory(record.time, values, POSE, record.units).after(settling)

    def run(self, scan: Scan, machine: str) -> Experiment:
        """Simulate a machine under the disturbances, and predict its errors."""
        frame = "stator" if scan.follows == TILT else "rotor"  # of the metrology's axes
        scene = self.scene(scan.rpm, scan.follows, machine, frame=frame)
        zero = self.at_rest(scan.rpm, scan.follows, frame=frame)
        budget, turn = self.prediction(scan.rpm, machine)
        errors = self.errors(scene, scan, self.noise(scene, scan.time[-1], LOWEST), zero)
        quiet = turn if scan.rpm else self.errors(scene, scan, None, zero)
        return Experiment(scan, self.payload, machine, errors, quiet, budget)


def synchronous_errors(model: LinearModel, rpm: float, amplitude: float) -> TimeHistory:
    """Return the errors by synchronous runout along the axes of the beam over a turn, by the linear model."""
    angle = 2 * np.pi * np.arange(64) / 64
    values = np.zeros((6, len(angle)))
    for (name, order), size in runout_amplitudes(amplitude).items():
        found = frequency_response(model, np.array([order * rpm / 60]))
        values += [(found.response(output, name)[0] * size * np.exp(1j * order * angle)).real for output in POSE]
    return turned(TimeHistory(angle, values, POSE), POSE_PAIRS, angle)


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
            station.errors(scene, scan, noise, station.at_rest(method=m, **place), method=m, settling=0.0)
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
    zero, result = station.at_rest(rpm), []
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


def figures(rms: np.ndarray) -> dict[str, float | None]:
    """Return six figures in nm and nrad by their keys; None for NaN."""
    keys = [f"rms_{LABELS[six]}_{unit(six)}" for six in SIX]
    return {key: None if np.isnan(value) else 1e9 * float(value) for key, value in zip(keys, rms, strict=True)}


def unit(six: str) -> str:
    """Return the unit of figures of a direction."""
    return "nm" if six[0] == "u" else "nrad"


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


def plot_tomography(experiments: list[Experiment], path: Path) -> None:
    """Plot the errors across and along the axis over the angle of the spindle, open and closed."""
    rows = sorted({(e.scan.rpm, e.payload) for e in experiments})
    axes = plt.subplots(len(rows), 2, figsize=(11, 2.2 * len(rows) + 1), squeeze=False, layout="constrained")[1]
    for row, case in zip(axes, rows, strict=True):
        for ax, six in zip(row, ("uy", "uz"), strict=True):
            for e in experiments:
                if (e.scan.rpm, e.payload) == case and e.machine != "damped":
                    draw_error(ax, e, six, e.scan.rpm / 60 * e.errors.time)
            title_and_legend(ax, f"{LABELS[six]}, {case[0]:g} rpm, {case[1]:g} kg")
    for ax in axes[-1]:
        ax.set_xlabel("turns of the spindle")
    save_figure(axes.flat, path)


def draw_error(ax: plt.Axes, experiment: Experiment, six: str, places: np.ndarray) -> None:
    """Draw an error over places, with its rms."""
    k = SIX.index(six)
    rms = 1e9 * experiment.rms[k]
    label = f"{experiment.machine}, {rms:.{1 if rms < 100 else 0}f} {unit(six)} rms"
    ax.plot(places, 1e9 * experiment.errors.values[k], COLORS[experiment.machine], lw=0.7, label=label)
    ax.set_ylabel(f"error [{unit(six)}]")
    ax.grid(visible=True, alpha=0.25)


def title_and_legend(ax: plt.Axes, title: str) -> None:
    """Put a title and the legend above a plot, where no curve is."""
    ax.set_title(title, fontsize=10, loc="left")
    place = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.0}
    ax.legend(fontsize=8, ncols=2, frameon=False, **place)


def plot_scan(experiments: list[Experiment], path: Path) -> None:
    """Plot the set point of a scan over time, and three errors below it, open and closed."""
    scan = experiments[0].scan
    (name, drive), at = next(iter(scan.drives.items())), experiments[0].errors.time
    figure, axes = plt.subplots(4, 1, figsize=(10, 9), sharex=True, layout="constrained")
    units = {SPINDLE: (180 / np.pi, "deg"), TILT: (1e3, "mrad")}
    factor, unit_of_path = units.get(name, (1e3, "mm"))
    axes[0].plot(at, factor * drive[-len(at) :], "k", lw=1)
    axes[0].set_ylabel(f"{name.replace('_', ' ')} [{unit_of_path}]")
    axes[0].grid(visible=True, alpha=0.25)
    for ax, six in zip(axes[1:], ("ux" if scan.follows == TILT else "uy", "uz", "ry"), strict=True):
        for e in experiments:
            draw_error(ax, e, six, at)
        ax.axhspan(-1e9 * AIMS[six], 1e9 * AIMS[six], color="0.6", alpha=0.35, lw=0)
        title_and_legend(ax, f"{LABELS[six]}; grey: aim of the rms")
    for ax in axes:
        ax.fill_between(at, 0, 1, ~scan.measured[-len(at) :], transform=ax.get_xaxis_transform(), color="C3", alpha=0.1)
    axes[-1].set(xlabel="time [s]", xlim=(at[0], at[-1]))
    figure.suptitle(f"{scan.name.replace('_', ' ')}, {experiments[0].payload:g} kg; pink: not measured", fontsize=11)
    save_figure(axes, path)


def plot_spectra(experiments: list[Experiment], path: Path) -> None:
    """Plot the cumulative rms of three directions along the axes of the beam, of the runs and of the linear models."""
    case = max((e.scan.rpm, -e.payload) for e in experiments)
    chosen = [e for e in experiments if (e.scan.rpm, -e.payload) == case]
    figure, axes = plt.subplots(1, 3, figsize=(12, 4.2), layout="constrained")
    for ax, six in zip(axes, ("uy", "uz", "ry"), strict=True):
        row = SIX.index(six)
        for e in chosen:
            found = recorded_budget(e.errors, segment_duration=min(2.0, e.errors.duration / 4))
            ax.loglog(
                found.frequency, 1e9 * found.cumulative()[row, 0], COLORS[e.machine], lw=1.2, label=f"{e.machine}, run"
            )
            line = 1e9 * e.predicted_above(row)
            ax.loglog(e.budget.frequency, line, COLORS[e.machine], ls="--", lw=1.2, label=f"{e.machine}, linear model")
        ax.axhline(1e9 * AIMS[six], color="0.5", ls=":", lw=1.6, label="aim")
        label = f"{LABELS[six]}, rms above a frequency [{unit(six)}]"
        ax.set(xlabel="frequency [Hz]", ylabel=label, xlim=(LOWEST, HIGHEST))
        top = 1e9 * max(e.rms[row] for e in chosen)
        ax.set_ylim(1e-3 * top, 3 * top)
        ax.grid(visible=True, which="both", alpha=0.25)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=7, fontsize=9)
    figure.suptitle(f"tomography at {case[0]:g} rpm with {-case[1]:g} kg", fontsize=11)
    save_figure(axes.flat, path)


def plot_shares(experiments: list[Experiment], path: Path) -> None:
    """Plot the mean square of closed machines by disturbance over the square of the aim."""
    closed = [e for e in experiments if e.machine == "closed"]
    height = 0.35 * len(closed) + 1.6
    figure, axes = plt.subplots(1, 3, figsize=(13, height), sharey=True, layout="constrained")
    for ax, six in zip(axes, ("uy", "uz", "ry"), strict=True):
        k, left = SIX.index(six), np.zeros(len(closed))
        for color, name in enumerate(DISTURBANCES):
            widths = 100 * np.array([(e.shares[name][k] / AIMS[six]) ** 2 for e in closed])
            ax.barh(range(len(closed)), widths, left=left, color=f"C{color}", label=name)
            left += widths
        runs = [100 * (e.rms[k] / AIMS[six]) ** 2 for e in closed]
        ax.plot(runs, range(len(closed)), "kd", ms=5, label="run")
        ax.axvline(100.0, color="k", ls=":", lw=1.4)
        ax.set_xlim(0.0, 1.06 * max(100.0, *runs, *left))
        ax.set_xlabel(f"{LABELS[six]}: mean square over that of the aim [%]")
        ax.grid(visible=True, axis="x", alpha=0.25)
    axes[0].set_yticks(range(len(closed)), [e.title.replace("_", " ") for e in closed], fontsize=9)
    axes[0].invert_yaxis()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=9, fontsize=9)
    save_figure(axes, path)


def write_motion(experiment: Experiment, station: Station, path: Path) -> None:
    """Write a page on which the machine turns and its motion is magnified."""
    rpm, duration, rate = experiment.scan.rpm, TURNS_ON_PAGE * 60 / experiment.scan.rpm, station.args.sample_rate
    scene = station.scene(rpm, machine=experiment.machine)
    scan = tomography(sample_times(duration, rate), rpm, 0.0)
    given = station.excitation(scene, scan, station.noise(scene, duration, 2 / duration), station.at_rest(rpm))
    _, motion = simulate_motion(scene, given, time_step=1 / rate, method="exact", frames=150, progress=False)
    write_page(view_motion(scene, motion), path)


def main() -> None:
    args = arguments.parse_args()
    begin = time.monotonic()
    stations = {payload: Station(payload, args) for payload in sorted({*args.payloads, *args.scan_payloads})}
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
        **schedule_figures(stations, args.speeds, args),
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
