"""Discrete-time controllers in state space, and formulas for the usual kinds.

The output of a controller is added to the input of the scene, u = excitation + K y. A positive K is positive feedback.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import scipy

from nassim.base.checks import (
    Array,
    above_zero,
    below_nyquist,
    finite,
    finite_array,
    freeze,
    not_negative,
    of_kind,
    positive,
    several,
    whole_number,
)
from nassim.base.field_types import ArrayField, ArrayLike, OptionalArray, data_class, held
from nassim.base.short_repr import short_repr
from nassim.signals.frf import FRF
from nassim.systems.state_space import StateSpace, cascade, tustin
from nassim.systems.transfer_matrices import refuse_infinite, transfer_matrix, warn_above_nyquist


@data_class
class Controller:
    """Sampled controller x_(k+1) = A x_k + B y_k, u_k = C x_k + D y_k, evaluated once per sample period.

    Attributes:
        A: state matrix, (n, n).
        B: input matrix, (n, inputs).
        C: output matrix, (outputs, n).
        D: feedthrough matrix, (outputs, inputs).
        sample_rate: samples per second [Hz].
        delay: number of whole sample periods between a sample and the output computed from it. The output is held for
            one period.
        limit: largest magnitude of an output, in the unit of the output. A larger output saturates.
        anti_windup: change of the states at a sample per unit by which the limit changes the outputs, limited minus
            computed, (n, outputs), such as the back-calculation of `pid`; None for none.

    Raises:
        ValueError: for matrices whose shapes do not agree, a delay that is not a whole number, or a limit that is not
            positive.
    """

    A: ArrayField
    B: ArrayField
    C: ArrayField
    D: ArrayField
    sample_rate: float
    delay: int = 1
    limit: float = math.inf
    anti_windup: OptionalArray = held(None)
    __repr__ = short_repr

    def __post_init__(self) -> None:
        direct = finite_array("controller: D", self.D, (None, None))
        n_out, n_in = direct.shape
        state = finite_array("controller: A", self.A, (None, None))
        n = len(state)
        if not direct.size:
            raise ValueError("controller: D must have a row for each output and a column for each input, got none")
        freeze(
            self,
            A=finite_array("controller: A", state, (n, n)),
            B=finite_array("controller: B", self.B, (n, n_in)),
            C=finite_array("controller: C", self.C, (n_out, n)),
            D=direct,
            sample_rate=positive("controller: sample_rate", self.sample_rate, "Hz"),
            delay=whole_number("controller: delay", self.delay, 0),
            limit=above_zero("controller: limit", self.limit),
        )
        if self.anti_windup is not None:
            freeze(self, anti_windup=finite_array("controller: anti_windup", self.anti_windup, (n, n_out)))

    @property
    def corrections(self) -> Array:
        """The matrix `anti_windup`, of zeros where there is none, (n, outputs)."""
        return np.zeros(self.C.T.shape) if self.anti_windup is None else self.anti_windup

    @property
    def matrices(self) -> StateSpace:
        """The matrices A, B, C and D, without delay and limit."""
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
    """Return the integral force feedback K(s) = -gain / (s + w_c) * s / (s + w_h), sampled by Tustin's rule.

    A positive gain damps when the sensor is in phase with the drive far above the resonance. A force sensor in line
    with its actuator is in phase there, because its zero lies below its pole. Such a loop needs negative feedback, and
    the minus sign of K provides it under u = excitation + K y.

    Args:
        gain: [output unit / (input unit s)].
        sample_rate: see `Controller` [Hz].
        corner_frequency: w_c / 2 pi of the leaky integrator [Hz]; 0 for a pure integrator, which drifts with the offset
            of the sensor.
        high_pass: w_h / 2 pi of an additional high-pass [Hz]; 0 for none.
        delay: see `Controller`.
        limit: see `Controller`.

    Source: A. Preumont, Vibration Control of Active Structures, 4th ed. (2018), chapter on collocated force feedback.
    """
    leak = 2 * np.pi * below_nyquist("corner_frequency", corner_frequency, sample_rate, zero=True)
    high = 2 * np.pi * below_nyquist("high_pass", high_pass, sample_rate, zero=True)
    gain = finite("gain", gain)
    if high and leak:
        numerator, denominator = [-gain, 0.0], [1.0, leak + high, leak * high]
    else:  # the high-pass cancels the pole of the pure integrator, and no hidden pole remains
        numerator, denominator = [-gain], [1.0, leak + high]
    return by_tustin(numerator, denominator, sample_rate, delay, limit)


def proportional(gain: ArrayLike, *, sample_rate: float, delay: int = 1, limit: float = math.inf) -> Controller:
    """Return the proportional feedback u = excitation + gain * y.

    Args:
        gain: a number, or a matrix (outputs, inputs).
        sample_rate: see `Controller` [Hz].
        delay: see `Controller`.
        limit: see `Controller`.
    """
    direct = finite_array("gain", np.atleast_2d(np.asarray(gain)), (None, None))
    n_out, n_in = direct.shape
    return Controller(
        np.zeros((0, 0)), np.zeros((0, n_in)), np.zeros((n_out, 0)), direct, sample_rate, delay=delay, limit=limit
    )


def pid(
    kp: float,
    ki: float = 0.0,
    kd: float = 0.0,
    *,
    sample_rate: float,
    derivative_bandwidth: float | None = None,
    anti_windup_time: float | None = None,
    delay: int = 1,
    limit: float = math.inf,
) -> Controller:
    """Return the PID controller K(s) = -(kp + ki / s + kd s / (1 + s / w)), sampled by Tustin's rule.

    Positive gains give negative feedback under u = excitation + K y, and follow a set point by a loop's `reference`.
    `crossover_controller` finds the gains of a similar controller for a crossover and a phase margin.

    While the output is limited, the integrator is corrected by back-calculation, so that it does not wind up.

    Args:
        kp: proportional gain [output unit / input unit].
        ki: integral gain [output unit / (input unit s)].
        kd: derivative gain [output unit s / input unit].
        sample_rate: see `Controller` [Hz].
        derivative_bandwidth: w / 2 pi, above which the derivative is constant [Hz] (default: a tenth of the sample
            rate).
        anti_windup_time: time constant of the back-calculation [s] (default: sqrt(kd / ki), kp / ki without a
            derivative), at least one sample; math.inf for none.
        delay: see `Controller`.
        limit: see `Controller`.

    Source: K. J. Astrom, R. M. Murray, Feedback Systems, 2nd ed. (2021), ch. 11.
    """
    kp, ki, kd = finite("kp", kp), finite("ki", ki), finite("kd", kd)
    period = 1 / positive("sample_rate", sample_rate, "Hz")
    corner = sample_rate / 10 if derivative_bandwidth is None else derivative_bandwidth
    omega = 2 * np.pi * below_nyquist("derivative_bandwidth", corner, sample_rate)
    parts = [proportional(-kp, sample_rate=sample_rate, delay=delay)]
    if ki:
        usual = math.sqrt(abs(kd / ki)) if kd else abs(kp / ki)
        time = usual if anti_windup_time is None else above_zero("anti_windup_time", anti_windup_time, "s")
        integrator = by_tustin([-ki], [1.0, 0.0], sample_rate, delay, math.inf)
        # The state is scaled so that the output changes by the excess times period / time in one sample.
        parts.append(replace(integrator, anti_windup=period / max(time, period) / integrator.C))
    if kd:
        parts.append(by_tustin([-kd, 0.0], [1 / omega, 1.0], sample_rate, delay, math.inf))
    return replace(parallel(*parts), limit=limit)


def lead(
    frequency: float,
    *,
    phase: float,
    sample_rate: float,
    gain: float = 1.0,
    delay: int = 1,
    limit: float = math.inf,
) -> Controller:
    """Return the lead K(s) = gain / sqrt(a) * (1 + s sqrt(a) / w) / (1 + s / (w sqrt(a))), sampled by Tustin's rule.

    The sampled lead is prewarped at w. Its corner frequencies have the ratio a = (1 + sin phase) / (1 - sin phase), and
    so have its gains far above and far below w.

    Args:
        frequency: w / 2 pi, where the phase is largest and the magnitude is `gain` [Hz].
        phase: phase lead at w, within -90 ... 90; a negative value gives a lag [deg].
        sample_rate: see `Controller` [Hz].
        gain: magnitude at w.
        delay: see `Controller`.
        limit: see `Controller`.

    Source: G. F. Franklin, J. D. Powell, A. Emami-Naeini, Feedback Control of Dynamic Systems, 7th ed. (2015), sec.
        6.7.
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
    """Return the notch K(s) = (s^2 + 2 z_z w s + w^2) / (s^2 + 2 z_p w s + w^2), sampled by Tustin's rule.

    The sampled notch is prewarped at w. Its magnitude is z_z / z_p at w, and 1 at zero frequency and far above w. Its
    width is about 2 z_p w.

    Args:
        frequency: w / 2 pi [Hz].
        zero_damping: z_z [-].
        pole_damping: z_p [-].
        sample_rate: see `Controller` [Hz].
        delay: see `Controller`.
        limit: see `Controller`.
    """
    omega = _centre(frequency, sample_rate)
    top = 2 * not_negative("zero_damping", zero_damping) * omega
    bottom = 2 * positive("pole_damping", pole_damping) * omega
    return by_tustin([1.0, top, omega**2], [1.0, bottom, omega**2], sample_rate, delay, limit, prewarp=omega)


def series(*controllers: Controller) -> Controller:
    """Connect controllers in series: the outputs of each one are the inputs of the next.

    One computer evaluates all controllers within a sample period. Their sample rates and delays must therefore agree,
    and the delay counts once.

    Args:
        controllers: in the order of the signal flow. Only the last one may have a limit, which becomes the limit of the
            result.

    Returns:
        Controller with the inputs of the first controller and the outputs of the last.

    Raises:
        ValueError: for different sample rates or delays, numbers of signals that do not fit, or a limit before the last
            controller.
    """
    rate, delay = _agreed(controllers)
    for before, after in pairwise(controllers):
        if len(before.D) != after.D.shape[1]:
            raise ValueError(f"series: {len(before.D)} output(s) cannot be the next one's {after.D.shape[1]} input(s)")
    _unlimited("series", controllers[:-1])
    system = controllers[0].matrices
    for controller in controllers[1:]:
        system = cascade(system, controller.matrices)
    last = controllers[-1]
    for controller in controllers[:-1]:
        if controller.anti_windup is not None and len(controller.D) != len(last.D):
            raise ValueError(
                f"series: a controller with {len(controller.D)} output(s) and anti_windup cannot know what the limit "
                f"takes from {len(last.D)} output(s)"
            )
    given = [c.corrections if c.anti_windup is not None else np.zeros((len(c.A), len(last.D))) for c in controllers]
    return Controller(*system, rate, delay=delay, limit=last.limit, anti_windup=_any(controllers, np.vstack(given)))


def parallel(*controllers: Controller) -> Controller:
    """Connect controllers in parallel: they read the same inputs, and their outputs are added.

    One computer evaluates all controllers within a sample period. Their sample rates and delays must therefore agree.

    Args:
        controllers: none may have a limit. Set a limit of the result with `dataclasses.replace`.

    Returns:
        Controller with the common inputs and the summed outputs.

    Raises:
        ValueError: for different sample rates, delays or numbers of signals, or for a controller with a limit.
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
        anti_windup=_any(controllers, np.vstack([c.corrections for c in controllers])),
    )


def decentralised(*controllers: Controller) -> Controller:
    """Combine controllers with separate inputs and outputs into one controller, for several loops at once.

    The signals of the result are those of the first controller, then those of the second, and so on. All loops share
    one gain when the result is closed around a model. `decentralised(*6 * [controller])` makes six equal loops, such as
    those of the struts of a hexapod. The measured and driven names must then be given in the order of the controllers.

    Args:
        controllers: with equal sample rates, delays and limits.

    Returns:
        Controller with the inputs and outputs of all controllers.

    Raises:
        ValueError: for different sample rates, delays or limits.
    """
    rate, delay = _agreed(controllers)
    limits = sorted({c.limit for c in controllers})
    if len(limits) > 1:
        text = ", ".join(f"{limit:g}" for limit in limits)
        raise ValueError(f"decentralised: limits must agree, got {text}; close such loops one after the other")
    a, b, c, d = (scipy.linalg.block_diag(*part) for part in zip(*(k.matrices for k in controllers), strict=True))
    back = _any(controllers, scipy.linalg.block_diag(*(k.corrections for k in controllers)))
    return Controller(a, b, c, d, rate, delay, limits[0], back)


def decoupled(*controllers: Controller, measure: ArrayLike, drive: ArrayLike, limit: float = math.inf) -> Controller:
    """Combine controllers in transformed coordinates into one controller, u = drive K (measure y).

    For a hexapod with Jacobian J (strut lengths from motions), Cartesian control uses measure = J^-1, which converts
    encoder readings to motions, and drive = J^-T, which converts forces on the platform to strut forces. Strut control
    of sensors that read Cartesian motions uses measure = J. One computer evaluates all controllers within a sample
    period, and the delay counts once.

    Args:
        controllers: one per coordinate, combined as in `decentralised`.
        measure: coordinates from measured signals, (coordinates, measured).
        drive: driven signals from the outputs of the controllers, (driven, coordinates).
        limit: limit of the driven signals, see `Controller`.

    Returns:
        Controller from the measured to the driven signals.

    Raises:
        ValueError: for matrices of other shapes, and for controllers with limits, which would act on the coordinates.
    """
    _unlimited("decoupled", controllers)
    inside = decentralised(*controllers)
    n_out, n_in = inside.D.shape
    left, right = finite_array("drive", drive, (None, n_out)), finite_array("measure", measure, (n_in, None))
    back = inside.corrections @ np.linalg.pinv(left)
    return Controller(
        inside.A,
        inside.B @ right,
        left @ inside.C,
        left @ inside.D @ right,
        inside.sample_rate,
        delay=inside.delay,
        limit=limit,
        anti_windup=_any(controllers, back),
    )


def controller_response(
    controller: Controller,
    frequency: ArrayLike,
    *,
    hold: bool = False,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    label: str = "controller",
) -> FRF:
    """Compute the FRF of a controller, including its delay and without its limit.

    Args:
        controller: the controller.
        frequency: (n,) [Hz].
        hold: include the zero-order hold of the output, (1 - exp(-s T)) / (s T), as a continuous plant sees it.
        inputs: names of the inputs (default: input_1, ...).
        outputs: names of the outputs (default: output_1, ...).
        label: label of the FRF.

    Returns:
        FRF with values (outputs, inputs, n).

    Raises:
        ValueError: at a pole, such as that of a pure integrator at 0 Hz.

    Warns:
        UserWarning: without the hold, for frequencies above half the sample rate, where the response only repeats.
    """
    of_kind("controller", controller, Controller, "of a Loop take its linear_controller")
    frequency = finite_array("frequency", frequency, (None,))
    turn = 2j * np.pi * frequency / controller.sample_rate
    values = transfer_matrix(controller.matrices, np.exp(turn))
    refuse_infinite(frequency, values)
    values = values * np.exp(-controller.delay * turn)
    if not hold:
        warn_above_nyquist("controller", frequency, 1 / controller.sample_rate)
    else:
        values = values * np.exp(-turn / 2) * np.sinc(frequency / controller.sample_rate)
    n_out, n_in = controller.D.shape
    inputs = several("inputs", inputs) or tuple(f"input_{k + 1}" for k in range(n_in))
    outputs = several("outputs", outputs) or tuple(f"output_{k + 1}" for k in range(n_out))
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
    """Sample a transfer function by Tustin's rule.

    Args:
        numerator: coefficients of the powers of s, the highest first.
        denominator: coefficients of the powers of s, the highest first, of first order or higher.
        sample_rate: see `Controller` [Hz].
        delay: see `Controller`.
        limit: see `Controller`.
        prewarp: angular frequency at which both frequency responses agree exactly [rad/s], see `tustin`.

    Returns:
        Controller with one input and one output.
    """
    system = scipy.signal.tf2ss(numerator, denominator)
    return Controller(*tustin(system, 1 / sample_rate, prewarp=prewarp), sample_rate, delay=delay, limit=limit)


def _any(controllers: Sequence[Controller], anti_windup: Array) -> Array | None:
    """Return the corrections of combined controllers, None where none of them has any."""
    return anti_windup if any(c.anti_windup is not None for c in controllers) else None


def _centre(frequency: float, sample_rate: float) -> float:
    return 2 * np.pi * below_nyquist("frequency", frequency, sample_rate)


def _agreed(controllers: Sequence[Controller]) -> tuple[float, int]:
    """Return the sample rate and the delay that all controllers have."""
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
