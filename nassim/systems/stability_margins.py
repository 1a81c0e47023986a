"""Stability margins of an open loop: gain, phase and modulus margin, by Nyquist's criterion."""

import math
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array, of_kind
from nassim.base.short_repr import short_repr
from nassim.base.warning_log import warn
from nassim.signals.frf import FRF

SLOPE_SPAN = 1.5
"""Last over first frequency of those that tell the slope of a loop below them."""
SLOPE_ERROR = 0.25
"""Difference of that slope from a whole number up to which it counts as one."""
AXIS_PHASE, SLOPE_PHASE = 0.1, 0.5
"""Phase from that of K s^n up to which a constant loop and an integrating one count as K s^n [rad]."""

REAL = 1e-9
"""Imaginary part over the size of a value that is real within rounding."""
AT_END = 1e-6
"""Share by which frequencies at the end of a loop may lie below the last one."""
LAST_GAIN = 0.1
"""Gain of a loop at its last frequency from which on a crossing above may matter."""


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
    loop, where |L| > 1. Those of a sampled loop should end at half of the sample rate, where it may cross the axis.
    Below the first frequency L goes on as there, if it is constant or integrates: a constant loop crosses the axis at
    0 Hz, and an integrator of the wrong sign is unstable. A loop that begins elsewhere beyond -1 with Im L >= 0 counts
    as having passed -180 deg before.

    Args:
        loop: open loop with one signal, see `open_loop`.

    Returns:
        Gain, phase and modulus margin.

    Raises:
        ValueError: for a loop with several signals: close the other loops first; for an FRF whose input differs from
            its output, such as that of a plant.

    Warns:
        UserWarning: for a loop that begins below 1 near the negative real axis, of which neither a constant nor an
            integrator tells how it goes on: it may cross this axis below its first frequency. For a loop that comes
            near this axis at its end with a gain above a tenth: it may cross it above its last frequency.

    Source: K. J. Astrom, R. M. Murray, Feedback Systems, 2nd ed. (2021), sec. 10.2 and 10.3.
    """
    of_kind("loop", loop, FRF, "open_loop computes one")
    if loop.values.shape[:2] != (1, 1):
        raise ValueError(
            f"margins are defined for one signal, got {len(loop.outputs)}; close the other loops first, as "
            "loop_at_a_time does"
        )
    if loop.inputs != loop.outputs:
        raise ValueError(
            f"an open loop has the same signal as input and output, got {loop.inputs[0]!r} and {loop.outputs[0]!r}: "
            "open_loop and loop_response make one from the response of a plant; give a measured one the same name twice"
        )
    f, values = loop.frequency, loop.values[0, 0]
    gain_margin, gain_at, stable = _gain_margin(f, values)
    _warn_of_low_end(f, values, gain_margin)
    _warn_of_high_end(f, values, gain_margin)
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
    if (off := _last_off_axis(f, values)) >= 0:  # it ends there, at half of a sample rate
        on_axis = [crossing for crossing in on_axis if crossing[1] <= f[off]]
        on_axis.append((values[-1].real, float(f[-1]), 0.5 if values[off].imag < 0 else -0.5))
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


def _warn_of_low_end(frequency: Array, values: Array, gain_margin: float) -> None:
    """Warn of a loop below 1 that may cross the negative real axis before its first frequency, with less margin."""
    first = complex(values[0])
    near = first.real < -abs(first.imag) and abs(first) < 1
    if not near or gain_margin * abs(first) <= 1 or _low_end(frequency, values)[1]:
        return
    warn(
        f"the loop begins at {frequency[0]:g} Hz, {180 - abs(math.degrees(np.angle(first))):.2g} deg from the negative "
        f"real axis with a gain of {abs(first):.3g}: it may cross this axis below, with a gain margin of "
        f"{1 / abs(first):.3g} or less; begin at a lower frequency"
    )


def _warn_of_high_end(frequency: Array, values: Array, gain_margin: float) -> None:
    """Warn of a loop that may cross the negative real axis behind its last frequency, with less margin."""
    last, away = complex(values[-1]), np.abs(np.angle(-values[-2:]))
    near = last.real < -abs(last.imag) and abs(last) > LAST_GAIN and away[-1] < away[0]
    if not near or gain_margin * abs(last) <= 1 or _last_off_axis(frequency, values) >= 0:
        return
    warn(
        f"the loop ends at {frequency[-1]:g} Hz, {180 - abs(math.degrees(np.angle(last))):.2g} deg from the negative "
        f"real axis with a gain of {abs(last):.3g}: it may cross this axis above, with a gain margin of about "
        f"{1 / abs(last):.3g}; go on to higher frequencies, of a sampled loop to half of its sample rate"
    )


def _last_off_axis(frequency: Array, values: Array) -> int:
    """Return the last place off the real axis of a loop that ends on it, as a sampled one at half of its rate; else -1.

    Frequencies beside the last one, where the loop is real within rounding too, are those that resonances need.
    """
    off = np.flatnonzero(np.abs(values.imag) > REAL * np.abs(values))
    last = int(off[-1]) if off.size else -1
    ends = last + 1 < len(values) and frequency[last + 1] >= (1 - AT_END) * frequency[-1]
    return last if ends else -1


def _crossings(frequency: Array, values: Array, level: Array) -> list[tuple[float, complex, bool]]:
    """Interpolate the sign changes of a real level: frequency, value there, and whether the level rises."""
    before = np.flatnonzero((level[:-1] < 0) != (level[1:] < 0))
    share = level[before] / (level[before] - level[before + 1])
    where = frequency[before] + share * np.diff(frequency)[before]
    crossing = values[before] + share * np.diff(values)[before]
    rises = level[before] < 0
    return [(float(f), complex(v), bool(up)) for f, v, up in zip(where, crossing, rises, strict=True)]
