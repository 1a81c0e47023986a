"""Experiments on the end-station: its runs with a payload, and their errors beside those of the linear model."""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from scipy.integrate import trapezoid

from common.station_scans import SPINDLE, TILT, Scan, runout_amplitudes, synchronous_runout
from common.station_spectra import Electronics, Spectrum, assumed_spectra, disturbance_of
from models.nass import FIXED_PAIRS, POSE_PAIRS, SIX, alike_across, make_nass
from models.nass_loops import CONVERTERS, POSE, SENSORS, TARGETS, hac_lac
from nassim import LinearModel, Loop, Scene, TimeHistory, linearize, simulate
from nassim.signals import smooth_step, spectral_noise, turned
from nassim.simulation import linearize_closed
from nassim.systems import NoiseBudget, frequency_response, rotating_noise_budget, sampled

MACHINES = ("open", "damped", "closed")
DISTURBANCES = ("floor", "runout", "synchronous", "path", "stages", "amplifiers", "converters", "metrology")
"""Shares of the errors. That of the path is what remains without noise in a scan at rest."""
SETTLING = 1.0
"""Beginning of a run that is left out, in which the synchronous runout starts [s]."""
LOWEST, HIGHEST = 0.5, 500.0
"""Band of the noise [Hz]."""
GUIDE_PERIOD = 0.2e-3
"""Period of the waviness of the translation's guide along its path [m], assumed."""
START_OF_PATH = 0.2
"""Angle of a path of the spindle whose start is read [rad]."""


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
    def equilibrium(
        self, rpm: float = 0.0, follows: str = "", *, frame: str = "rotor", method: str = "exact"
    ) -> Readings:
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
        zero = self.equilibrium(scan.rpm, scan.follows, frame=frame)
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
