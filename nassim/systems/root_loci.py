"""Root loci: closed-loop poles over the gain, the gain that damps modes best, and the largest stable gain."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from nassim.base.checks import Array, finite_array, freeze, positive
from nassim.base.field_types import ArrayLike
from nassim.base.short_repr import short_repr
from nassim.base.warning_log import warn
from nassim.systems.controller_models import DELAY_ORDER, controller_model
from nassim.systems.controllers import Controller
from nassim.systems.feedback import close_loop
from nassim.systems.linear_model import (
    LinearModel,
    Names,
    frequency_and_damping,
    is_growing,
    s_plane,
    subsystem,
    zeros,
)
from nassim.systems.state_space import cascade

CRITICAL = 1 - 1e-12
RESOLUTION = 1e-7
"""Resolution of an optimum gain, relative to the next larger given gain."""
ZOOM = 21
"""Number of gains per refinement step of an optimum; each step narrows the interval tenfold."""
UNCHANGED = 1e-3
"""Relative rise of a damping ratio up to which a loop counts as without effect on it."""
GROWTH_STEP = 1e-3
"""Step for the derivative of a pole's growth with respect to the gain, relative to the distance of two given gains."""


@dataclass(frozen=True)
class RootLocus:
    """Poles of a closed loop over its gain.

    Attributes:
        gains: (n_gains,), ascending [-].
        poles: complex, (n_gains, n_poles), in the s-plane also for sampled loops; each column is one branch [rad/s].
        zeros: zeros of the open loop without its delay, where branches end, complex, (n_zeros,). With several loops
            they are the zeros of all loops together. There are none where a part of the controller has no effect
            [rad/s].
        time_step: of a sampled loop [s].
    """

    gains: Array
    poles: Array
    zeros: Array
    time_step: float | None = None
    __repr__ = short_repr

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
        """Damping ratio -Re s / |s|, (n_gains, n_poles) [-]; negative for a growing motion."""
        return frequency_and_damping(self.poles)[1]

    @property
    def stable(self) -> Array:
        """Whether no pole grows, bool, (n_gains,), see `unstable_poles`."""
        return np.logical_not(is_growing(self.poles, self.time_step).any(axis=1))

    def branch(self, frequency: float) -> int:
        """Return the column of the oscillation whose natural frequency at the first gain is nearest to a frequency.

        Args:
            frequency: wanted frequency [Hz].

        Raises:
            ValueError: when no pole oscillates.
        """
        return int(self.branches([frequency])[0])

    def branches(self, frequencies: ArrayLike) -> Array:
        """Return the columns of different oscillations whose natural frequencies at the first gain are nearest.

        Args:
            frequencies: wanted frequencies, (n,); name the frequency of a double mode twice [Hz].

        Returns:
            Columns, int, (n,).

        Raises:
            ValueError: when fewer poles oscillate.
        """
        wanted = finite_array("frequencies", frequencies, (None,))
        oscillating = np.flatnonzero(self.poles[0].imag > 0)
        if len(oscillating) < len(wanted):
            text = f"only {len(oscillating)} poles oscillate" if len(oscillating) else "no pole oscillates"
            raise ValueError(f"{text} at the first gain, asked for {len(wanted)}")
        distance = np.abs(wanted[:, None] - self.frequency[0, oscillating])
        return oscillating[scipy.optimize.linear_sum_assignment(distance)[1]]


@dataclass(frozen=True)
class Optimum:
    """Gain that gives a mode, or the least damped of several modes, its largest damping ratio.

    Attributes:
        gain: optimum gain [-], or in the unit that the formula states.
        damping_ratio: damping ratio at this gain [-].
        frequency: frequency of the (least damped) mode at this gain [Hz].
    """

    gain: float
    damping_ratio: float
    frequency: float
    __repr__ = short_repr


def root_locus(
    model: LinearModel,
    controller: Controller,
    gains: ArrayLike,
    *,
    measured: Names,
    driven: Names,
    delay_order: int = DELAY_ORDER,
) -> RootLocus:
    """Compute the poles of `close_loop` over a gain on the whole controller, as continuous branches.

    Small steps of the gain separate branches that pass near each other. Several loops with one gain need one controller
    with as many inputs and outputs (`nassim.systems.decentralised`), and the names in its order.

    Args:
        model: see `close_loop`.
        controller: see `close_loop`.
        gains: (n_gains,), ascending; a first gain of 0 gives the poles of the open loop [-].
        measured: see `close_loop`.
        driven: see `close_loop`.
        delay_order: see `close_loop`.

    Returns:
        Root locus with its branches and the zeros of the open loop.
    """
    gains = _ascending(gains)
    rows = _branches(_poles_at(model, controller, measured, driven, delay_order), gains)
    ends = _loop_zeros(model, controller, measured, driven)
    return RootLocus(gains, s_plane(rows, model.time_step), ends, model.time_step)


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
    """Find the gain of a controller that gives a mode its largest damping ratio while the whole loop is stable.

    With several modes, the smallest of their damping ratios counts. When a mode becomes aperiodic (a ratio of 1), the
    smallest such gain is returned. When another motion becomes unstable first, the gain at this stability limit is
    returned, with a warning.

    Args:
        model: see `close_loop`.
        controller: see `close_loop`.
        gains: gains to search, (n_gains,), ascending. The best gain of the root locus is refined between its neighbours
            [-].
        measured: see `close_loop`.
        driven: see `close_loop`.
        frequency: frequency of the mode, or of each of several modes, at the first gain; the nearest ones count, see
            `RootLocus.branches` [Hz].
        delay_order: see `close_loop`.

    Returns:
        Gain with the damping ratio and the frequency of the mode.

    Warns:
        UserWarning: where no gain changes the mode's damping, because the loop hardly measures or drives that mode; and
            where the gain is at the stability limit.

    Raises:
        ValueError: when no gain is stable, and when the damping still grows at the last gain.
    """
    gains = _ascending(gains)
    poles = _poles_at(model, controller, measured, driven, delay_order)
    rows = _branches(poles, gains)
    locus = RootLocus(gains, s_plane(rows, model.time_step), np.zeros(0), model.time_step)
    if not locus.stable.any():
        raise ValueError("the loop is unstable at every gain; check the controller's sign and delay")
    columns = locus.branches(np.atleast_1d(frequency))
    best, undamped = _best(locus, columns), float(locus.damping_ratio[0, columns].min())
    if best == len(gains) - 1 and locus.damping_ratio[best, columns].min() < CRITICAL:
        raise ValueError(f"the damping still grows at the largest gain, {gains[-1]:g}; give larger gains")
    resolution = RESOLUTION * gains[min(best + 1, len(gains) - 1)]
    while True:
        low, high = max(best - 1, 0), min(best + 1, len(locus.gains) - 1)
        if locus.gains[high] - locus.gains[low] <= resolution:
            break
        start = rows[low, columns]
        closer = np.linspace(locus.gains[low], locus.gains[high], ZOOM)
        rows = _branches(poles, closer)
        locus = RootLocus(closer, s_plane(rows, model.time_step), np.zeros(0), model.time_step)
        columns = _nearest(start, rows[0])
        best = _best(locus, columns)
    least = columns[np.argmin(locus.damping_ratio[best, columns])]
    if locus.damping_ratio[best, least] < (1 + UNCHANGED) * undamped:
        warn(
            f"no gain raises the damping ratio of the mode at {locus.frequency[best, least]:.4g} Hz above "
            f"{undamped:.3g}, which it has at the smallest gain: the loop hardly measures or drives this mode, or "
            "destabilises it; give the frequency of a mode between its poles and zeros"
        )
    elif best + 1 < len(locus.gains) and not locus.stable[best + 1]:
        growing = locus.frequency[best + 1, np.argmax(locus.poles[best + 1].real)]
        warn(
            f"the gain {locus.gains[best]:.4g} is at the limit of stability, where a motion of {growing:.4g} Hz begins "
            "to grow before the damping is largest: take a part of it, and look at its margins"
        )
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
    """Find the gain of a controller up to which the closed loop is stable.

    Args:
        model: see `close_loop`.
        controller: see `close_loop`.
        gains: gains to search, (n_gains,), ascending. The limit is refined between the first unstable gain and the one
            before it. An unstable interval between two stable gains is not found [-].
        measured: see `close_loop`.
        driven: see `close_loop`.
        delay_order: see `close_loop`.

    Returns:
        Gain [-]; inf when all given gains are stable, and the first one, such as 0, for a pole at the origin that grows
        with any gain.

    Raises:
        ValueError: when the first gain is unstable.
    """
    gains = _ascending(gains)
    at = _poles_at(model, controller, measured, driven, delay_order)

    def poles(gain: float) -> Array:
        return s_plane(at(gain), model.time_step)

    def grows(gain: float) -> bool:
        return bool(is_growing(poles(gain), model.time_step).any())

    first = next((k for k, gain in enumerate(gains) if grows(gain)), None)
    if first is None:
        return math.inf
    if first == 0:
        raise ValueError(f"the loop is unstable at the first gain, {gains[0]:g}; check the controller's sign and delay")
    low, high = start, end = float(gains[first - 1]), float(gains[first])
    while high - low > RESOLUTION * (end - start):
        middle = (low + high) / 2
        low, high = (low, middle) if grows(middle) else (middle, high)
    # A pole that just counts as growing grew before by less than the rounding threshold: find where its growth is zero.
    growing = max(poles(high), key=lambda pole: pole.real)

    def followed(gain: float, pole: complex) -> complex:
        found = poles(gain)
        return complex(found[np.argmin(np.abs(found - pole))])

    step = GROWTH_STEP * (end - start)
    edge, search = scipy.optimize.newton(
        lambda gain: followed(gain, growing).real, high, x1=high + step, full_output=True, disp=False
    )
    if search.converged and abs(edge - high) < end - start:
        return float(np.clip(edge, start, high))
    if (pole := followed(start, growing)).real <= 0:
        return low
    for before, after in zip(gains[:first][-2::-1], gains[:first][::-1], strict=False):
        later, pole = pole, followed(before, pole)
        if pole.real <= 0:
            return float(np.interp(0.0, [pole.real, later.real], [before, after]))
    return float(gains[0])


def iff_optimum(pole_frequency: float, zero_frequency: float) -> Optimum:
    """Compute the largest damping of one undamped mode by integral force feedback, in closed form.

    For the loop g / s * (s^2 + w_z^2) / (s^2 + w_p^2) the damping ratio is (w_p - w_z) / (2 w_z), reached at the gain g
    = w_p sqrt(w_p / w_z) [rad/s] and the frequency sqrt(w_p w_z). If the response of the sensor tends to G far above
    the mode, the gain of `integral_force_feedback` is g / G. Elimination of the third, real pole from s^3 + g s^2 +
    w_p^2 s + g w_z^2 gives (2 zeta)^2 = (w_p^2 - w^2)(w^2 - w_z^2) / (w w_z)^2, which is largest at w^2 = w_p w_z.

    Args:
        pole_frequency: w_p / 2 pi of the mode [Hz].
        zero_frequency: w_z / 2 pi of the zero of the force sensor below it, which is the frequency of the mode without
            the stiffness of the actuator [Hz].

    Returns:
        Gain [rad/s] with the damping ratio and the frequency of the mode.

    Raises:
        ValueError: unless zero < pole <= 3 zero. Above this ratio the mode becomes aperiodic.

    Source: A. Preumont, Vibration Control of Active Structures, 4th ed. (2018), chapter on active trusses.
    """
    pole, zero = positive("pole_frequency", pole_frequency, "Hz"), positive("zero_frequency", zero_frequency, "Hz")
    if not zero < pole <= 3 * zero:
        raise ValueError(f"the pole must lie between one and three times the zero, got {pole:g} and {zero:g} Hz")
    return Optimum(2 * math.pi * pole * math.sqrt(pole / zero), (pole - zero) / (2 * zero), math.sqrt(pole * zero))


def _poles_at(
    model: LinearModel, controller: Controller, measured: Names, driven: Names, delay_order: int
) -> Callable[[float], Array]:
    """Return a function from the gain to the eigenvalues of the closed loop's A; in the z-plane for a sampled loop."""

    def poles(gain: float) -> Array:
        closed = close_loop(model, controller, measured=measured, driven=driven, gain=gain, delay_order=delay_order)
        return np.linalg.eigvals(closed.A).astype(complex)

    return poles


def _branches(poles: Callable[[float], Array], gains: Array) -> Array:
    """Return eigenvalues over gains, (n_gains, n_poles), matched to a linear extrapolation of each column."""
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
    """Return the index of the pole assigned to each expected pole, int; each index occurs once."""
    return scipy.optimize.linear_sum_assignment(np.abs(expected[:, None] - found))[1]


def _best(locus: RootLocus, columns: Array) -> int:
    """Return the index of the first stable gain with the largest minimum damping ratio of some branches."""
    ratio = np.where(locus.stable, locus.damping_ratio[:, columns].min(axis=1), -np.inf)
    return int(np.argmax(ratio >= min(ratio.max(), CRITICAL)))


def _loop_zeros(model: LinearModel, controller: Controller, measured: Names, driven: Names) -> Array:
    """Return the zeros of the loop, cut where it has fewer signals; none where it is singular at every s."""
    plant = subsystem(model, inputs=driven, outputs=measured).matrices
    if model.time_step is None:
        k = controller_model(controller, inputs=measured, outputs=driven, delay_order=0).matrices
    else:
        k = controller.matrices
    n_out, n_in = plant[3].shape
    pair = (plant, k) if n_in <= n_out else (k, plant)
    signals = tuple(str(n) for n in range(min(n_in, n_out)))
    try:
        return zeros(LinearModel(*cascade(*pair), signals, signals, time_step=model.time_step))
    except ValueError:
        return np.zeros(0, complex)


def _ascending(gains: ArrayLike) -> Array:
    result = finite_array("gains", gains, (None,))
    if len(result) < 2 or np.any(np.diff(result) <= 0):
        raise ValueError("gains must be ascending, at least two")
    return result
