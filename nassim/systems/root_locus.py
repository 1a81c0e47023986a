"""Root loci: where the closed loop's poles go with the gain, the gain that damps modes best, the largest stable one."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from nassim.base.checks import Array, finite_array, freeze, positive
from nassim.systems.controllers import Controller
from nassim.systems.feedback import DELAY_ORDER, close_loop, controller_model
from nassim.systems.linear_model import LinearModel, Names, frequency_and_damping, is_growing, names, s_plane, zeros
from nassim.systems.state_space import cascade

CRITICAL = 1 - 1e-12
RESOLUTION = 1e-7
"""Of an optimum gain, relative to the given gain above it."""
ZOOM = 21
"""Gains per step of refining an optimum, which narrows it tenfold."""
RESOLVED = 1e-3
"""Step in which a pole's growth with the gain is measured, relative to the distance of two given gains."""


@dataclass(frozen=True)
class RootLocus:
    """Poles of a closed loop over its gain.

    gains: (n_gains,), ascending [-]
    poles: complex, (n_gains, n_poles) [rad/s], in the plane of s also for sampled loops; a column is one branch
    zeros: of the open loop without its delay, complex, (n_zeros,) [rad/s], where branches end; of several loops those
        of all together; none where a part of the controller acts on nothing
    """

    gains: Array
    poles: Array
    zeros: Array

    def __post_init__(self) -> None:
        gains = _ascending(self.gains)
        poles, ends = (np.array(value, dtype=complex) for value in (self.poles, self.zeros))
        if poles.ndim != 2 or len(poles) != len(gains):
            raise ValueError(f"poles must have a row for each of {len(gains)} gains, got shape {poles.shape}")
        poles.setflags(write=False)
        ends.setflags(write=False)
        freeze(self, gains=gains, poles=poles, zeros=ends)

    @property
    def frequency(self) -> Array:
        """Natural frequency |s| / 2 pi, (n_gains, n_poles) [Hz]."""
        return frequency_and_damping(self.poles)[0]

    @property
    def damping_ratio(self) -> Array:
        """Damping ratio -Re s / |s|, (n_gains, n_poles) [-]; negative where it grows."""
        return frequency_and_damping(self.poles)[1]

    @property
    def stable(self) -> Array:
        """Whether no pole grows, bool, (n_gains,)."""
        result: Array = np.logical_not(is_growing(self.poles).any(axis=1))
        return result

    def branch(self, frequency: float) -> int:
        """Column of the oscillation whose natural frequency at the first gain is nearest [Hz].

        Raises ValueError when nothing oscillates there.
        """
        return int(self.branches([frequency])[0])

    def branches(self, frequencies: ArrayLike) -> Array:
        """Columns of as many different oscillations as frequencies [Hz], the nearest at the first gain, int, (n,).

        Of a double mode, name the frequency twice. Raises ValueError when fewer oscillate.
        """
        wanted = finite_array("frequencies", frequencies, (None,))
        oscillating = np.flatnonzero(self.poles[0].imag > 0)
        if len(oscillating) < len(wanted):
            text = f"only {len(oscillating)} poles oscillate" if len(oscillating) else "no pole oscillates"
            raise ValueError(f"{text} at the first gain, asked for {len(wanted)}")
        distance = np.abs(wanted[:, None] - self.frequency[0, oscillating])
        result: Array = oscillating[scipy.optimize.linear_sum_assignment(distance)[1]]
        return result


@dataclass(frozen=True)
class Optimum:
    """The gain that gives a mode, or the least damped of several, its largest damping ratio.

    gain: [-], or as the formula says; damping_ratio: reached [-]; frequency: of the (least damped) mode then [Hz]
    """

    gain: float
    damping_ratio: float
    frequency: float


def root_locus(
    model: LinearModel,
    controller: Controller,
    gains: ArrayLike,
    *,
    measured: Names,
    driven: Names,
    delay_order: int = DELAY_ORDER,
) -> RootLocus:
    """Poles of `close_loop` over factors on the whole controller, as branches that are continuous in the gain.

    gains: (n_gains,), ascending [-]; 0 first gives the open loop's poles. Close gains keep branches apart that pass
    near each other. The other arguments are those of `close_loop`. Several loops with one gain: a controller of as many
    inputs and outputs (`nassim.systems.decentralised`), with the names in its order.
    """
    gains = _ascending(gains)
    poles = _poles_at(model, controller, measured, driven, delay_order)
    rows = _branches(poles, gains)
    ends = _loop_zeros(model, controller, measured, driven)
    return RootLocus(gains, s_plane(rows, model.time_step), ends)


def optimum_gain(
    model: LinearModel,
    controller: Controller,
    gains: ArrayLike,
    *,
    measured: Names,
    driven: Names,
    frequency: ArrayLike,
    delay_order: int = DELAY_ORDER,
) -> Optimum:
    """The factor on a controller that gives a mode its largest damping ratio while the whole loop is stable.

    Of several modes, the least damped one counts: the largest damping ratio that they have in common.

    gains: where to look, (n_gains,), ascending [-]; the best of the root locus is refined between its neighbours
    frequency: of the mode, or of each of several, at the first gain [Hz]; the nearest count (`RootLocus.branches`)
    The other arguments are those of `close_loop`. Of a mode that becomes aperiodic (a ratio of 1), the least such gain
    is returned. Where another motion becomes unstable first, the gain at that edge is returned; its `margins` show it.

    Raises ValueError when no gain is stable, and when the damping still grows at the last one.
    """
    gains = _ascending(gains)
    poles = _poles_at(model, controller, measured, driven, delay_order)
    rows = _branches(poles, gains)
    locus = RootLocus(gains, s_plane(rows, model.time_step), np.zeros(0))
    if not locus.stable.any():
        raise ValueError("the loop is unstable at every gain; check the controller's sign and delay")
    columns = locus.branches(np.atleast_1d(frequency))
    best = _best(locus, columns)
    if best == len(gains) - 1 and locus.damping_ratio[best, columns].min() < CRITICAL:
        raise ValueError(f"the damping still grows at the largest gain, {gains[-1]:g}; look further")
    resolution = RESOLUTION * gains[min(best + 1, len(gains) - 1)]
    while True:
        low, high = max(best - 1, 0), min(best + 1, len(locus.gains) - 1)
        if locus.gains[high] - locus.gains[low] <= resolution:
            break
        start = rows[low, columns]
        closer = np.linspace(locus.gains[low], locus.gains[high], ZOOM)
        rows = _branches(poles, closer)
        locus = RootLocus(closer, s_plane(rows, model.time_step), np.zeros(0))
        columns = _nearest(start, rows[0])
        best = _best(locus, columns)
    least = columns[np.argmin(locus.damping_ratio[best, columns])]
    return Optimum(
        float(locus.gains[best]), float(locus.damping_ratio[best, least]), float(locus.frequency[best, least])
    )


def largest_stable_gain(
    model: LinearModel,
    controller: Controller,
    gains: ArrayLike,
    *,
    measured: Names,
    driven: Names,
    delay_order: int = DELAY_ORDER,
) -> float:
    """The factor on a controller up to which the closed loop is stable [-]; inf where it is at all given gains.

    gains: where to look, (n_gains,), ascending [-]; the edge is refined between the first unstable one and that before
        it. What is unstable only between two of them is not seen.
    The other arguments are those of `root_locus`. A pole that rests without the loop and grows with any gain gives 0.

    Raises ValueError when the first gain is unstable.
    """
    gains = _ascending(gains)
    at = _poles_at(model, controller, measured, driven, delay_order)

    def poles(gain: float) -> Array:
        return s_plane(at(gain), model.time_step)

    first = next((k for k, gain in enumerate(gains) if is_growing(poles(gain)).any()), None)
    if first is None:
        return math.inf
    if first == 0:
        raise ValueError(f"the loop is unstable at the first gain, {gains[0]:g}; check the controller's sign and delay")
    low, high = start, end = float(gains[first - 1]), float(gains[first])
    while high - low > RESOLUTION * (end - start):
        middle = (low + high) / 2
        low, high = (low, middle) if is_growing(poles(middle)).any() else (middle, high)
    # What just counts as growing grew already before, by less than rounding explains: go back to where it was at rest.
    growing = max(poles(high), key=lambda pole: pole.real)

    def growth(gain: float) -> float:
        found = poles(gain)
        return float(found[np.argmin(np.abs(found - growing))].real)

    step = RESOLVED * (end - start)
    edge, search = scipy.optimize.newton(growth, high, x1=high + step, full_output=True, disp=False)
    return float(np.clip(edge, start, high)) if search.converged and abs(edge - high) < end - start else low


def iff_optimum(pole_frequency: float, zero_frequency: float) -> Optimum:
    """Integral force feedback's largest damping of one mode without own damping, in closed form.

    pole_frequency: w_p / 2 pi [Hz] of the mode; zero_frequency: w_z / 2 pi [Hz] of the force sensor's zero below it,
        the mode without the actuator's stiffness

    For the loop g / s * (s^2 + w_z^2) / (s^2 + w_p^2): the damping ratio (w_p - w_z) / (2 w_z), reached at the gain
    g = w_p sqrt(w_p / w_z) [rad/s] and the frequency sqrt(w_p w_z). With the sensor's response tending to G far above
    the mode, the gain of `integral_force_feedback` is g / G. Eliminating the third, real pole from
    s^3 + g s^2 + w_p^2 s + g w_z^2 leaves (2 zeta)^2 = (w_p^2 - w^2)(w^2 - w_z^2) / (w w_z)^2, largest at
    w^2 = w_p w_z.

    Source: A. Preumont, Vibration Control of Active Structures, 4th ed. (2018), chapter on active trusses. Raises
    ValueError unless zero < pole <= 3 zero: beyond, the mode becomes aperiodic before.
    """
    pole, zero = positive("pole_frequency", pole_frequency, "Hz"), positive("zero_frequency", zero_frequency, "Hz")
    if not zero < pole <= 3 * zero:
        raise ValueError(f"the pole must lie between one and three times the zero, got {pole:g} and {zero:g} Hz")
    return Optimum(2 * math.pi * pole * math.sqrt(pole / zero), (pole - zero) / (2 * zero), math.sqrt(pole * zero))


def _poles_at(
    model: LinearModel, controller: Controller, measured: Names, driven: Names, delay_order: int
) -> Callable[[float], Array]:
    """Eigenvalues of the closed loop's A as a function of the gain; in the plane of z for a sampled loop."""

    def poles(gain: float) -> Array:
        closed = close_loop(model, controller, measured=measured, driven=driven, gain=gain, delay_order=delay_order)
        result: Array = np.linalg.eigvals(closed.A).astype(complex)
        return result

    return poles


def _branches(poles: Callable[[float], Array], gains: Array) -> Array:
    """Eigenvalues over gains, (n_gains, n_poles), each column continuing straight from gain to gain as best it can."""
    first = poles(gains[0])
    rows = [first[np.lexsort((first.imag, np.abs(first)))]]
    for k in range(1, len(gains)):
        expected = rows[-1]
        if k > 1:
            expected = expected + (rows[-1] - rows[-2]) * (gains[k] - gains[k - 1]) / (gains[k - 1] - gains[k - 2])
        found = poles(gains[k])
        rows.append(found[_nearest(expected, found)])
    return np.array(rows)


def _nearest(expected: Array, found: Array) -> Array:
    """Which of the poles found each expected one is, each another, int."""
    order: Array = scipy.optimize.linear_sum_assignment(np.abs(expected[:, None] - found))[1]
    return order


def _best(locus: RootLocus, columns: Array) -> int:
    """Index of the first gain with the largest damping ratio that branches have in common, among the stable ones."""
    ratio = np.where(locus.stable, locus.damping_ratio[:, columns].min(axis=1), -np.inf)
    return int(np.argmax(ratio >= min(ratio.max(), CRITICAL)))


def _loop_zeros(model: LinearModel, controller: Controller, measured: Names, driven: Names) -> Array:
    """Zeros of the loop cut where it has fewer signals; none where it is singular at every s."""
    rows = [model.outputs.index(name) for name in names("measured signal", measured)]
    columns = [model.inputs.index(name) for name in names("driven signal", driven)]
    a, b, c, d = model.matrices
    plant = a, b[:, columns], c[rows], d[np.ix_(rows, columns)]
    if model.time_step is None:
        k = controller_model(controller, inputs=measured, outputs=driven, delay_order=0).matrices
    else:
        k = controller.matrices
    pair = (plant, k) if len(columns) <= len(rows) else (k, plant)
    signals = tuple(str(n) for n in range(min(len(rows), len(columns))))
    try:
        return zeros(LinearModel(*cascade(*pair), signals, signals, time_step=model.time_step))
    except ValueError:
        return np.zeros(0, complex)


def _ascending(gains: ArrayLike) -> Array:
    result = finite_array("gains", gains, (None,))
    if len(result) < 2 or np.any(np.diff(result) <= 0):
        raise ValueError("gains must be ascending, at least two")
    return result
