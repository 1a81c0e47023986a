"""Feedback loops of controllers around linear models: the closed loop, the margins of the open loop, sensitivity.

A loop is sampled or continuous like its model. A loop around a sampled model (`nassim.systems.sampled`) is exact: it
predicts a simulation or a computer at that sample rate, except for saturation. In a loop around a continuous model, a
continuous equivalent replaces the controller. Such a loop serves for design, with the branches and zeros of textbooks,
and for FRFs between samples up to a tenth of the sample rate. A plant that responds to its input within one sample
(direct feedthrough, modes above half the sample rate) answers a held input in steps. Only the sampled model tells
whether a sample sees the new step or the old one. The continuous model is wrong by up to half a sample of delay in that
case.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from nassim.base.checks import Array, finite, known, positive
from nassim.base.field_types import ArrayLike
from nassim.base.short_repr import short_repr
from nassim.signals.frf import FRF, ComplexArray
from nassim.systems.controllers import Controller, controller_response
from nassim.systems.linear_model import LinearModel, Names, frequency_response, names
from nassim.systems.state_space import StateSpace, cascade, inverse_tustin, tustin

DELAY_ORDER = 4
RELATIVE_ROUNDING = 1e-9
SLOPE_SPAN = 1.5
"""Last over first frequency of those that tell the slope of a loop below them."""
SLOPE_ERROR = 0.25
"""Difference of that slope from a whole number up to which it counts as one."""
AXIS_PHASE, SLOPE_PHASE = 0.1, 0.5
"""Phase from that of K s^n up to which a constant loop and an integrating one count as K s^n [rad]."""


def controller_model(
    controller: Controller,
    *,
    inputs: Names,
    outputs: Names,
    time_step: float | None = None,
    delay_order: int = DELAY_ORDER,
) -> LinearModel:
    """Return a controller with its delay, and without its limit, as a linear model.

    Args:
        controller: the controller.
        inputs: names of the signals that the controller measures.
        outputs: names of the signals that the controller drives.
        time_step: time step of the controller, for a sampled model with the delay as states; None for the continuous
            equivalent by the inverse of Tustin's rule [s].
        delay_order: order of Pade's approximation to the delay plus half a sample of the hold in the continuous
            equivalent; 0 omits both.

    Raises:
        ValueError: when the number of names differs from the number of signals, when the time step is not that of the
            controller, and for a pole at z = -1 in the continuous case.
    """
    inputs, outputs = names("controller's input", inputs), names("controller's output", outputs)
    if controller.D.shape != (len(outputs), len(inputs)):
        n_out, n_in = controller.D.shape
        raise ValueError(
            f"the controller has {n_in} input(s) and {n_out} output(s), but is to measure {', '.join(inputs)} "
            f"and to drive {', '.join(outputs)}"
        )
    _check_time_step(time_step, controller)
    if not finite("delay_order", delay_order).is_integer() or delay_order < 0:
        raise ValueError(f"delay_order must be a whole number from 0 on, got {delay_order!r}")
    period = 1 / controller.sample_rate
    if time_step is not None:
        system, late = controller.matrices, _shift(controller.delay)
    else:
        system = inverse_tustin(controller.matrices, period)
        late = _pade((controller.delay + 0.5) * period, int(delay_order))
    each = np.eye(len(outputs))
    a, b, c, d = (np.kron(part, each) for part in late)
    return LinearModel(*cascade(system, (a, b, c, d)), inputs, outputs, time_step=time_step)


def controller_from_model(
    model: LinearModel, *, sample_rate: float, delay: int = 1, limit: float = math.inf
) -> Controller:
    """Return a linear model, such as the result of a synthesis, as a controller u = excitation + K y.

    Args:
        model: K; a continuous one is sampled by Tustin's rule, a sampled one must have the controller's time step.
        sample_rate: see `Controller` [Hz].
        delay: see `Controller`.
        limit: see `Controller`.

    Raises:
        ValueError: for another time step than that of `sample_rate`.
    """
    period = 1 / positive("sample_rate", sample_rate, "Hz")
    if model.time_step is None:
        matrices = tustin(model.matrices, period)
    elif abs(model.time_step / period - 1) > RELATIVE_ROUNDING:
        raise ValueError(f"the model's time step, {model.time_step:g} s, is not the sample rate's, {period:g} s")
    else:
        matrices = model.matrices
    return Controller(*matrices, sample_rate, delay=delay, limit=limit)


def close_loop(
    model: LinearModel,
    controller: Controller,
    *,
    measured: Names,
    driven: Names,
    gain: float = 1.0,
    delay_order: int = DELAY_ORDER,
    noise: bool = False,
    reference: Names = (),
) -> LinearModel:
    """Close the loop u = excitation + gain * K y, or K (y - r) with references r, around a linear model.

    The result has the inputs and outputs of the model, and the states of the model and of the controller. Several loops
    can be closed one after the other, or all at once with `nassim.systems.decentralised`.

    Args:
        model: the linear model.
        controller: the controller K.
        measured: output, or outputs, that the controller reads.
        driven: input, or inputs, to which the output of the controller is added.
        gain: factor on the whole controller [-].
        delay_order: see `controller_model`. It has no effect for a sampled model, whose delay is exact.
        noise: add an input "y noise" for each measured output y. It adds to the signal that the controller reads and
            not to the output itself, like the noise of sensors and converters. Loops that measure the same output share
            this input.
        reference: names of references, one for each measured output, or none; they become inputs, which loops may
            share.

    Returns:
        Model of the closed loop.

    Raises:
        ValueError: for unknown names, for a sampled model whose time step is not that of the controller, and when the
            direct feedthrough of an undelayed controller and of the model leave no solution.
    """
    if noise or reference:
        measured, reference = names("measured signal", measured), names("reference", reference) if reference else ()
        if reference and len(reference) != len(measured):
            raise ValueError(f"{len(measured)} measured signal(s) need as many references, got {len(reference)}")
        added = [(f"{name} noise", name, 1.0) for name in measured if noise]
        added += [(name, output, -1.0) for name, output in zip(reference, measured, strict=False)]
        return _closed_with_inputs(model, controller, added, measured, driven, gain, delay_order)
    rows, columns = loop_indices(model, measured, driven)
    k = controller_model(
        controller, inputs=measured, outputs=driven, time_step=model.time_step, delay_order=delay_order
    )
    a, b, c, d = model.matrices
    drive = np.zeros((len(model.inputs), len(columns)))
    drive[columns, range(len(columns))] = finite("gain", gain)
    loop = np.eye(len(rows)) - d[rows] @ drive @ k.D
    sizes = np.linalg.svd(loop, compute_uv=False)
    if sizes[-1] < RELATIVE_ROUNDING * max(1.0, sizes[0]):
        raise ValueError("the loop has no solution within a sample: direct feedthrough times gain is 1; add a delay")
    # Signals that the controller reads, y = y_x x + y_k x_k + y_u u, and inputs of the model including its outputs.
    y_x, y_k, y_u = (np.linalg.solve(loop, part) for part in (c[rows], d[rows] @ drive @ k.C, d[rows]))
    u_x, u_k, u_u = drive @ k.D @ y_x, drive @ (k.C + k.D @ y_k), np.eye(len(model.inputs)) + drive @ k.D @ y_u
    state = np.block([[a + b @ u_x, b @ u_k], [k.B @ y_x, k.A + k.B @ y_k]])
    return replace(
        model,
        A=state,
        B=np.vstack([b @ u_u, k.B @ y_u]),
        C=np.hstack([c + d @ u_x, d @ u_k]),
        D=d @ u_u,
    )


def _closed_with_inputs(
    model: LinearModel,
    controller: Controller,
    added: Sequence[tuple[str, str, float]],
    measured: tuple[str, ...],
    driven: Names,
    gain: float,
    delay_order: int,
) -> LinearModel:
    """Close the loop over the outputs plus further inputs, and keep only the outputs themselves.

    Args:
        model: as of `close_loop`, as are those not described here.
        controller: the controller.
        added: further inputs, each with the measured output that it adds to, and its factor.
        measured: names of outputs.
        driven: names of inputs.
        gain: factor on the controller.
        delay_order: see `controller_model`.
    """
    rows, _ = loop_indices(model, measured, driven)
    new = tuple(dict.fromkeys(name for name, _, _ in added if name not in model.inputs))
    quiet = np.zeros((len(model.outputs), len(new)))
    inputs, d = model.inputs + new, np.hstack([model.D, quiet])
    heard = np.zeros((len(rows), len(inputs)))
    for name, output, factor in added:
        heard[measured.index(output), inputs.index(name)] += factor
    readings = tuple(f"{name} as the controller reads it" for name in measured)
    n = len(model.outputs)
    both = replace(
        model,
        B=np.hstack([model.B, np.zeros((len(model.A), len(new)))]),
        C=np.vstack([model.C, model.C[rows]]),
        D=np.vstack([d, d[rows] + heard]),
        inputs=inputs,
        outputs=model.outputs + readings,
    )
    closed = close_loop(both, controller, measured=readings, driven=driven, gain=gain, delay_order=delay_order)
    return replace(closed, C=closed.C[:n], D=closed.D[:n], outputs=model.outputs)


def open_loop(
    model: LinearModel,
    controller: Controller,
    frequency: ArrayLike,
    *,
    measured: Names,
    driven: Names,
    gain: float = 1.0,
    label: str = "open loop",
) -> FRF:
    """Compute the FRF of the loop cut at the measured signals, L = -gain * G K.

    The minus sign follows textbooks: the critical point is L = -1. For a continuous model the delay and the zero-order
    hold are exact, and aliasing is neglected. `loop_response` takes the FRF of a plant, such as an estimated one, in
    place of a model.

    Args:
        model: the linear model G.
        controller: the controller K.
        frequency: (n,) [Hz].
        measured: see `close_loop`.
        driven: see `close_loop`.
        gain: see `close_loop`.
        label: label of the FRF.

    Returns:
        FRF with values (measured, measured, n).
    """
    loop_indices(model, measured, driven)
    _check_time_step(model.time_step, controller)
    plant = frequency_response(model, frequency)
    hold = model.time_step is None
    return loop_response(plant, controller, measured=measured, driven=driven, gain=gain, hold=hold, label=label)


def loop_response(
    plant: FRF,
    controller: Controller,
    *,
    measured: Names,
    driven: Names,
    gain: float = 1.0,
    hold: bool = True,
    label: str = "open loop",
) -> FRF:
    """Compute the open loop L = -gain * G K from the FRF of the plant, at the frequencies of that FRF.

    Args:
        plant: FRF of G, computed or estimated from records.
        controller: the controller K.
        measured: see `close_loop`.
        driven: see `close_loop`.
        gain: see `close_loop`.
        hold: include the zero-order hold of the controller; False when the FRF of the plant is from sample to sample.
        label: label of the FRF.

    Returns:
        FRF with values (measured, measured, n).
    """
    measured, driven = names("measured signal", measured), names("driven signal", driven)
    k = controller_response(controller, plant.frequency, hold=hold)
    if k.values.shape[:2] != (len(driven), len(measured)):
        n_out, n_in = k.values.shape[:2]
        raise ValueError(f"the controller has {n_in} input(s) and {n_out} output(s); name as many signals")
    g = np.array([[plant.response(y, u) for u in driven] for y in measured])
    return FRF(plant.frequency, -gain * np.einsum("yuf,uzf->yzf", g, k.values), measured, measured, None, label)


def sensitivity(loop: FRF) -> tuple[FRF, FRF]:
    """Compute the sensitivity S = (1 + L)^-1 and the complementary sensitivity T = 1 - S of an open loop L.

    S is the ratio of a disturbance at the measured signals with the loop closed to that with the loop open. The loop
    amplifies the disturbance where |S| > 1.

    Args:
        loop: open loop L, see `open_loop`.

    Returns:
        S and T, FRFs of the shape of L.

    Raises:
        ValueError: for an FRF whose inputs differ from its outputs, and where det(1 + L) = 0.
    """
    if loop.inputs != loop.outputs:
        raise ValueError("an open loop has the same inputs as outputs; see open_loop")
    one = np.eye(len(loop.outputs))
    difference = one + loop.values.transpose(2, 0, 1)
    critical = np.linalg.matrix_rank(difference) < len(one)
    if critical.any():
        raise ValueError(
            f"the loop oscillates at {loop.frequency[critical][0]:g} Hz, where det(1 + L) = 0: lower the gain"
        )
    s: ComplexArray = np.linalg.inv(difference).astype(complex)
    return (
        replace(loop, values=s.transpose(1, 2, 0), label="sensitivity"),
        replace(loop, values=(one - s).transpose(1, 2, 0), label="complementary sensitivity"),
    )


def loop_at_a_time(loop: FRF, signal: str) -> FRF:
    """Compute the open loop cut at one signal while all other loops are closed, 1 / S_ii - 1 of the sensitivity S.

    The `margins` of the result tell by how much this loop alone may change. The largest of the `singular_values` of the
    sensitivity covers changes in several loops at once.

    Args:
        loop: open loop with several signals, see `open_loop`.
        signal: name of the signal at which the loop is cut.

    Returns:
        FRF with values (1, 1, n).
    """
    row = loop.outputs.index(known("signal", signal, loop.outputs))
    own = sensitivity(loop)[0].values[row, row]
    return FRF(loop.frequency, (1 / own - 1)[None, None], (signal,), (signal,), None, f"{signal}, others closed")


def singular_values(frf: FRF) -> Array:
    """Compute the singular values of an FRF matrix at each frequency.

    The largest singular value of a sensitivity is the factor by which the loops amplify the worst combination of
    disturbances. Its inverse is the distance of all loops together from instability. Singular values depend on the
    units of the signals: compare signals of one kind, or scale them first (`nassim.systems.with_outputs`).

    Args:
        frf: FRF with n frequencies.

    Returns:
        Singular values, the largest first, (min(outputs, inputs), n).

    Source: S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2nd ed. (2005), sec. 3.3.
    """
    return np.linalg.svd(frf.values.transpose(2, 0, 1), compute_uv=False).T


@dataclass(frozen=True)
class Margins:
    """Stability margins of an open loop.

    Attributes:
        gain_margin: factor by which the gain may grow; inf where no factor destabilises the loop. An unstable loop has
            a value below 1: the factor that makes it stable; 0 where no factor is known within the frequencies [-].
        gain_margin_frequency: frequency of the gain margin; nan with a margin of inf or 0 [Hz].
        phase_margin: amount by which the phase may change where |L| = 1; inf where |L| never crosses 1. An unstable
            loop has a negative value: the phase that it lacks there [deg].
        phase_margin_frequency: frequency of the phase margin; nan with an infinite margin [Hz].
        modulus_margin: least distance |1 + L| from the critical point, which is the inverse of the largest sensitivity
            [-].
        modulus_margin_frequency: frequency of the modulus margin [Hz].
    """

    gain_margin: float
    gain_margin_frequency: float
    phase_margin: float
    phase_margin_frequency: float
    modulus_margin: float
    modulus_margin_frequency: float
    __repr__ = short_repr

    def __str__(self) -> str:
        """Return the margins in a line, with their units and frequencies."""
        decibels = f" ({20 * math.log10(self.gain_margin):.3g} dB)" if 0 < self.gain_margin < math.inf else ""
        parts = (
            (f"gain margin {self.gain_margin:.4g}{decibels}", self.gain_margin_frequency),
            (f"phase margin {self.phase_margin:.4g} deg", self.phase_margin_frequency),
            (f"modulus margin {self.modulus_margin:.3g}", self.modulus_margin_frequency),
        )
        return ", ".join(text + (f" at {at:.4g} Hz" if math.isfinite(at) else "") for text, at in parts)


def margins(loop: FRF) -> Margins:
    """Compute the margins of an open loop with one signal, the smallest of each kind within its frequencies.

    Crossings are interpolated between frequencies, and the modulus margin is the smallest value at the frequencies
    themselves. Choose close frequencies at resonances. Nyquist's criterion tells whether the closed loop is stable, for
    an open loop without growing poles. The frequencies should begin below the slowest dynamics and, for an integrating
    loop, where |L| > 1. Below the first frequency L goes on as there, if it is constant or integrates: a constant loop
    crosses the axis at 0 Hz, and an integrator of the wrong sign is unstable. A loop that begins elsewhere beyond -1
    with Im L >= 0 counts as having passed -180 deg before.

    Args:
        loop: open loop with one signal, see `open_loop`.

    Returns:
        Gain, phase and modulus margin.

    Raises:
        ValueError: for a loop with several signals. Close the other loops first.

    Source: K. J. Astrom, R. M. Murray, Feedback Systems, 2nd ed. (2021), sec. 10.2 and 10.3.
    """
    if loop.values.shape[:2] != (1, 1):
        raise ValueError(
            f"margins are defined for one signal, got {len(loop.outputs)}; close the other loops first, as "
            "loop_at_a_time does"
        )
    f, values = loop.frequency, loop.values[0, 0]
    gain_margin, gain_at, stable = _gain_margin(f, values)
    phase_margin, phase_at = _phase_margin(f, values, stable=stable)
    distance = np.abs(1 + values)
    nearest = int(np.argmin(distance))
    return Margins(
        gain_margin=gain_margin,
        gain_margin_frequency=gain_at,
        phase_margin=phase_margin,
        phase_margin_frequency=phase_at,
        modulus_margin=float(distance[nearest]),
        modulus_margin_frequency=float(f[nearest]),
    )


def _gain_margin(f: Array, values: Array) -> tuple[float, float, bool]:
    """Return the gain margin [-] of a loop, its frequency [Hz], and by Nyquist's criterion whether the loop is stable.

    The encirclements of -1 are counted by the crossings of the negative real axis beyond it.
    """
    order, gain = _low_end(f, values)
    on_axis = [(value.real, at, 1.0 if rises else -1.0) for at, value, rises in _crossings(f, values, values.imag)]
    before = 0.0
    if order == 0 and gain < 0:  # from the axis at 0 Hz
        after = values.imag[np.flatnonzero(values.imag)]
        on_axis = [(gain, 0.0, 0.5 if not len(after) or after[0] > 0 else -0.5), *(c for c in on_axis if c[1] > f[0])]
    elif order < 0 and gain and abs(values[0]) > 1:  # by arcs of quarter turns from the axis at infinity
        phase = 90.0 * order + math.degrees(np.angle(values[0] * 1j ** (-order) * np.sign(gain))) + 180.0 * (gain < 0)
        before = 0.5 * (gain < 0) + math.floor((180.0 - phase) / 360.0)
    elif values[0].real < -1 and values[0].imag >= 0:
        before = 1.0
    beyond = sorted(((-1 / real, at, turn) for real, at, turn in on_axis if real < -1), reverse=True)
    turns = before + sum(turn for *_, turn in beyond)
    if turns <= 0:
        growing = [(-1 / real, at) for real, at, _ in on_axis if -1 < real < 0]
        return *min(growing, default=(math.inf, math.nan)), True
    for factor, at, turn in beyond:  # a smaller gain takes the crossings nearest to -1 first
        turns -= turn
        if turns <= 0:
            return factor, at, False
    return 0.0, math.nan, False


def _phase_margin(f: Array, values: Array, *, stable: bool) -> tuple[float, float]:
    """Return the phase margin of a loop [deg] and its frequency [Hz]."""
    # Where |L| rises through 1, a phase lead destabilises. An unstable loop lacks up to 360 deg of phase.
    angles = [
        (math.degrees(np.angle(-value)) * (-1 if rises else 1), at)
        for at, value, rises in _crossings(f, values, np.abs(values) - 1)
    ]
    if stable:
        return min(((abs(a), at) for a, at in angles), default=(math.inf, math.nan))
    return max(((a if a < 0 else a - 360, at) for a, at in angles), default=(-math.inf, math.nan))


def _low_end(frequency: Array, values: Array) -> tuple[int, float]:
    """Return the order n and the real gain K with which L goes on as K s^n below the first frequency.

    K is 0 where slope and phase at the first frequencies are not those of one K s^n, as at a resonance.
    """
    sizes = np.abs(values)
    low = slice(0, max(2, int(np.sum(frequency <= SLOPE_SPAN * frequency[0]))))
    steep = frequency[0] > 0 and len(values) > 1 and sizes[low].min() > 0
    slope = float(np.polyfit(np.log(frequency[low]), np.log(sizes[low]), 1)[0]) if steep else 0.0
    order = round(slope)
    rest = complex(values[0]) * 1j ** (-order)
    phase = SLOPE_PHASE if order < 0 else AXIS_PHASE
    agree = abs(slope - order) <= SLOPE_ERROR and abs(rest.imag) <= math.tan(phase) * abs(rest.real)
    return order, float(rest.real) if agree else 0.0


def _crossings(frequency: Array, values: Array, level: Array) -> list[tuple[float, complex, bool]]:
    """Interpolate the sign changes of a real level: frequency, value there, and whether the level rises."""
    before = np.flatnonzero((level[:-1] < 0) != (level[1:] < 0))
    share = level[before] / (level[before] - level[before + 1])
    where = frequency[before] + share * np.diff(frequency)[before]
    crossing = values[before] + share * np.diff(values)[before]
    rises = level[before] < 0
    return [(float(f), complex(v), bool(up)) for f, v, up in zip(where, crossing, rises, strict=True)]


def loop_indices(model: LinearModel, measured: Names, driven: Names) -> tuple[list[int], list[int]]:
    """Return the indices of measured outputs and driven inputs of a model; raise ValueError for unknown names."""
    rows = [model.outputs.index(known("output", n, model.outputs)) for n in names("measured signal", measured)]
    columns = [model.inputs.index(known("input", n, model.inputs)) for n in names("driven signal", driven)]
    return rows, columns


def _check_time_step(time_step: float | None, controller: Controller) -> None:
    if time_step is not None and abs(time_step * controller.sample_rate - 1) > RELATIVE_ROUNDING:
        raise ValueError(
            f"the model is sampled at {1 / time_step:g} Hz and the controller at {controller.sample_rate:g} Hz; "
            "sample the model at the controller's rate"
        )


def _shift(delay: int) -> StateSpace:
    """Return the state space of a delay of whole samples, for one signal."""
    first, last = np.eye(1, delay), np.eye(1, delay, delay - 1)
    return np.eye(delay, k=-1), first.T, last, np.full((1, 1), float(delay == 0))


def _pade(delay: float, order: int) -> StateSpace:
    """Return Pade's approximation of equal orders to a delay [s], for one signal; order 0 is no delay.

    Source: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed. (2013), sec. 9.3.
    """
    if order == 0:
        return _shift(0)
    # Coefficients of rising powers of s times the delay, which keeps the numbers near 1.
    weights = [1.0]
    for k in range(order):
        weights.append(weights[-1] * (order - k) / ((2 * order - k) * (k + 1)))
    falling = np.array(weights[::-1])
    a, b, c, d = scipy.signal.tf2ss(falling * (-1.0) ** np.arange(order, -1, -1), falling)
    return a / delay, b / delay, c, d
