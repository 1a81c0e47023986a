"""Controllers as data: discrete-time state space as a digital controller runs it, and the formulas of their field.

A controller's output is added to the scene's input, u = excitation + K y: a positive K is positive feedback.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import ArrayLike

from nassim.base.checks import Array, finite, finite_array, freeze, not_negative, positive
from nassim.signals.frf import FRF
from nassim.systems.state_space import StateSpace, cascade, transfer_matrix, tustin


@dataclass(frozen=True)
class Controller:
    """A sampled controller: x_(k+1) = A x_k + B y_k, u_k = C x_k + D y_k, once per sample period.

    A: (n, n); B: (n, inputs); C: (outputs, n); D: (outputs, inputs)
    sample_rate: [Hz]
    delay: whole sample periods from a sample to the time at which its output appears, held for a period
    limit: largest magnitude of an output, in its unit; beyond, it saturates
    """

    A: Array
    B: Array
    C: Array
    D: Array
    sample_rate: float
    delay: int = 1
    limit: float = math.inf

    def __post_init__(self) -> None:
        direct = finite_array("controller: D", self.D, (None, None))
        n_out, n_in = direct.shape
        state = finite_array("controller: A", self.A, (None, None))
        n = len(state)
        if not direct.size:
            raise ValueError("controller: D must have a row for each output and a column for each input, got none")
        if not finite("controller: delay", self.delay).is_integer() or self.delay < 0:
            raise ValueError(f"controller: delay must be a whole number of samples from 0 on, got {self.delay!r}")
        if not self.limit > 0:
            raise ValueError(f"controller: limit must be positive, got {self.limit!r}; inf for none")
        freeze(
            self,
            A=finite_array("controller: A", state, (n, n)),
            B=finite_array("controller: B", self.B, (n, n_in)),
            C=finite_array("controller: C", self.C, (n_out, n)),
            D=direct,
            sample_rate=positive("controller: sample_rate", self.sample_rate, "Hz"),
            delay=int(self.delay),
            limit=float(self.limit),
        )

    @property
    def matrices(self) -> StateSpace:
        """A, B, C and D: without delay and limit."""
        return self.A, self.B, self.C, self.D


def integral_force_feedback(
    gain: float,
    *,
    sample_rate: float,
    corner_frequency: float = 0.0,
    high_pass: float = 0.0,
    delay: int = 1,
    limit: float = math.inf,
) -> Controller:
    """Integral force feedback K(s) = -gain / (s + w_c) * s / (s + w_h), by Tustin's rule.

    gain: [output unit / (input unit s)]; a positive one damps where the sensor is in phase with the drive far above
        the resonance, as a force sensor in line with its actuator is (its zero lies below its pole). In phase there,
        the feedback has to be negative, which the minus sign of K does under u = excitation + K y.
    corner_frequency: w_c / 2 pi [Hz] of the leaky integrator; 0 for a pure one, which drifts with the sensor's offset
    high_pass: w_h / 2 pi [Hz] of an additional high-pass; 0 for none
    sample_rate [Hz], delay, limit: see `Controller`

    Source: A. Preumont, Vibration Control of Active Structures, 4th ed. (2018), chapter on collocated force feedback.
    """
    leak = (
        2 * np.pi * _below_nyquist("corner_frequency", not_negative("corner_frequency", corner_frequency), sample_rate)
    )
    high = 2 * np.pi * _below_nyquist("high_pass", not_negative("high_pass", high_pass), sample_rate)
    gain = finite("gain", gain)
    if high and leak:
        numerator, denominator = [-gain, 0.0], [1.0, leak + high, leak * high]
    else:  # the high-pass cancels the pure integrator's pole, and must leave no hidden one
        numerator, denominator = [-gain], [1.0, leak + high]
    return by_tustin(numerator, denominator, sample_rate, delay, limit)


def proportional(gain: ArrayLike, *, sample_rate: float, delay: int = 1, limit: float = math.inf) -> Controller:
    """Proportional feedback u = excitation + gain * y; gain: a number, or a matrix (outputs, inputs)."""
    direct = finite_array("gain", np.atleast_2d(np.asarray(gain)), (None, None))
    n_out, n_in = direct.shape
    return Controller(
        np.zeros((0, 0)), np.zeros((0, n_in)), np.zeros((n_out, 0)), direct, sample_rate, delay=delay, limit=limit
    )


def lead(
    frequency: float,
    *,
    phase: float,
    sample_rate: float,
    gain: float = 1.0,
    delay: int = 1,
    limit: float = math.inf,
) -> Controller:
    """Lead K(s) = gain / sqrt(a) * (1 + s sqrt(a) / w) / (1 + s / (w sqrt(a))), by Tustin's rule, prewarped at w.

    frequency: w / 2 pi [Hz], where the phase is largest and the magnitude is `gain`
    phase: its lead there [deg], within -90 ... 90; negative: a lag. a = (1 + sin phase) / (1 - sin phase) is the
        ratio of the corner frequencies, and of the gains far above and far below.
    sample_rate [Hz], delay, limit: see `Controller`

    Source: G. F. Franklin, J. D. Powell, A. Emami-Naeini, Feedback Control of Dynamic Systems, 7th ed.
    (2015), sec. 6.7.
    """
    if not abs(finite("phase", phase)) < 90:
        raise ValueError(f"phase must lie within -90 ... 90 deg, got {phase:g}; take two leads in series for more")
    sine = math.sin(math.radians(phase))
    root = math.sqrt((1 + sine) / (1 - sine))
    omega = _centre(frequency, sample_rate)
    numerator = [finite("gain", gain) / omega, gain / root]
    return by_tustin(numerator, [1 / (omega * root), 1.0], sample_rate, delay, limit, prewarp=omega)


def notch(
    frequency: float,
    *,
    zero_damping: float,
    pole_damping: float,
    sample_rate: float,
    delay: int = 1,
    limit: float = math.inf,
) -> Controller:
    """Notch K(s) = (s^2 + 2 z_z w s + w^2) / (s^2 + 2 z_p w s + w^2), by Tustin's rule, prewarped at w.

    frequency: w / 2 pi [Hz]
    zero_damping, pole_damping: z_z and z_p [-]; the magnitude at w is z_z / z_p, at rest and far above it is 1, and
        the width is about 2 z_p w
    sample_rate [Hz], delay, limit: see `Controller`
    """
    omega = _centre(frequency, sample_rate)
    top = 2 * not_negative("zero_damping", zero_damping) * omega
    bottom = 2 * positive("pole_damping", pole_damping) * omega
    return by_tustin([1.0, top, omega**2], [1.0, bottom, omega**2], sample_rate, delay, limit, prewarp=omega)


def series(*controllers: Controller) -> Controller:
    """Controllers one after the other, the first one's outputs being the second one's inputs, and so on.

    One computer evaluates them all within a sample period: sample rate and delay must agree, and the delay counts
    once. Only the last may have a limit, which is the result's. Raises ValueError otherwise.
    """
    rate, delay = _agreed(controllers)
    for before, after in pairwise(controllers):
        if len(before.D) != after.D.shape[1]:
            raise ValueError(f"series: {len(before.D)} output(s) cannot be the next one's {after.D.shape[1]} input(s)")
    _unlimited("series", controllers[:-1])
    system = controllers[0].matrices
    for controller in controllers[1:]:
        system = cascade(system, controller.matrices)
    return Controller(*system, rate, delay=delay, limit=controllers[-1].limit)


def parallel(*controllers: Controller) -> Controller:
    """Controllers side by side on the same inputs, whose outputs add.

    One computer evaluates them all within a sample period: sample rate and delay must agree. None may have a limit;
    give the result one by `dataclasses.replace`. Raises ValueError otherwise, and for different numbers of signals.
    """
    rate, delay = _agreed(controllers)
    shapes = {c.D.shape for c in controllers}
    if len(shapes) > 1:
        raise ValueError(f"parallel: numbers of outputs and inputs must agree, got {sorted(shapes)}")
    _unlimited("parallel", controllers)
    return Controller(
        scipy.linalg.block_diag(*(c.A for c in controllers)),
        np.vstack([c.B for c in controllers]),
        np.hstack([c.C for c in controllers]),
        np.sum([c.D for c in controllers], axis=0),
        rate,
        delay=delay,
    )


def decentralised(*controllers: Controller) -> Controller:
    """Controllers side by side, each with inputs and outputs of its own, one after the other: several loops as one.

    Six equal ones, as on the struts of a hexapod: `decentralised(*6 * [controller])`, whose measured and driven names
    then stand in the same order. Closed around a model, all loops share one gain. Sample rates, delays and limits must
    agree, else ValueError.
    """
    rate, delay = _agreed(controllers)
    limits = sorted({c.limit for c in controllers})
    if len(limits) > 1:
        text = ", ".join(f"{limit:g}" for limit in limits)
        raise ValueError(f"decentralised: limits must agree, got {text}; close such loops one after the other")
    a, b, c, d = (scipy.linalg.block_diag(*part) for part in zip(*(k.matrices for k in controllers), strict=True))
    return Controller(a, b, c, d, rate, delay, limits[0])


def decoupled(*controllers: Controller, measure: ArrayLike, drive: ArrayLike, limit: float = math.inf) -> Controller:
    """Controllers in coordinates of their own between sensors and actuators: u = drive K (measure y).

    controllers: as in `decentralised`, one after the other, one per coordinate
    measure: coordinates from what is measured, (coordinates, measured); drive: what is driven from the controllers'
        outputs, (driven, coordinates)
    limit: of what is driven, see `Controller`

    A hexapod with Jacobian J (strut lengths from motions) in Cartesian coordinates: measure = J^-1, which makes motions
    of encoders' readings, and drive = J^-T, which makes strut forces of forces. In strut coordinates of sensors that
    read Cartesian motions: measure = J. One computer evaluates all within a sample period, and the delay counts once.
    Raises ValueError for matrices of other shapes, and for controllers with limits, which would act on coordinates.
    """
    _unlimited("decoupled", controllers)
    inside = decentralised(*controllers)
    n_out, n_in = inside.D.shape
    left, right = finite_array("drive", drive, (None, n_out)), finite_array("measure", measure, (n_in, None))
    return Controller(
        inside.A,
        inside.B @ right,
        left @ inside.C,
        left @ inside.D @ right,
        inside.sample_rate,
        delay=inside.delay,
        limit=limit,
    )


def controller_response(
    controller: Controller,
    frequency: Array,
    *,
    hold: bool = False,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    label: str = "controller",
) -> FRF:
    """FRF of a controller with its delay at the given frequencies, shape (n,) [Hz]; its limit is no part of it.

    hold: include the zero-order hold of its output, (1 - exp(-s T)) / (s T), as a continuous plant sees it
    inputs, outputs: names (default: input_1, ..., output_1, ...)

    Raises ValueError at a pole, as of a pure integrator at 0 Hz.
    """
    frequency = finite_array("frequency", frequency, (None,))
    turn = 2j * np.pi * frequency / controller.sample_rate
    values = transfer_matrix(controller.matrices, np.exp(turn)) * np.exp(-controller.delay * turn)
    if hold:
        values = values * np.exp(-turn / 2) * np.sinc(frequency / controller.sample_rate)
    n_out, n_in = controller.D.shape
    inputs = tuple(inputs) or tuple(f"input_{k + 1}" for k in range(n_in))
    outputs = tuple(outputs) or tuple(f"output_{k + 1}" for k in range(n_out))
    return FRF(frequency, values, outputs, inputs, None, label)


def by_tustin(
    numerator: Sequence[float],
    denominator: Sequence[float],
    sample_rate: float,
    delay: int,
    limit: float,
    *,
    prewarp: float = 0.0,
) -> Controller:
    """Controller from a transfer function of first order or higher by powers of s, the highest first.

    prewarp: where both frequency responses agree exactly [rad/s], see `tustin`
    """
    system = scipy.signal.tf2ss(numerator, denominator)
    return Controller(*tustin(system, 1 / sample_rate, prewarp=prewarp), sample_rate, delay=delay, limit=limit)


def _centre(frequency: float, sample_rate: float) -> float:
    return 2 * np.pi * _below_nyquist("frequency", positive("frequency", frequency, "Hz"), sample_rate)


def _below_nyquist(name: str, frequency: float, sample_rate: float) -> float:
    if frequency >= positive("sample_rate", sample_rate, "Hz") / 2:
        raise ValueError(f"{name} must lie below half the sample rate, {sample_rate / 2:g} Hz, got {frequency:g} Hz")
    return frequency


def _agreed(controllers: Sequence[Controller]) -> tuple[float, int]:
    """Sample rate and delay that all controllers have."""
    if not controllers:
        raise ValueError("name at least one controller")
    both = {(c.sample_rate, c.delay) for c in controllers}
    if len(both) > 1:
        text = ", ".join(f"{rate:g} Hz with {delay} samples" for rate, delay in sorted(both))
        raise ValueError(f"sample rates and delays of connected controllers must agree, got {text}")
    return both.pop()


def _unlimited(kind: str, controllers: Sequence[Controller]) -> None:
    limits = [c.limit for c in controllers if math.isfinite(c.limit)]
    if limits:
        raise ValueError(
            f"{kind}: a limit of {limits[0]:g} inside cannot be expressed; give the result a limit instead"
        )
