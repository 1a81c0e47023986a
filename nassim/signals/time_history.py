"""Time histories: sampled signals on one time axis."""

from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np
import scipy

from nassim.base.checks import Array, finite, finite_array, freeze, known, positive, several, unique, units_of
from nassim.base.field_types import ArrayField, ArrayLike, NameList, data_class, held
from nassim.base.html_repr import html_repr
from nassim.base.short_repr import short_repr
from nassim.base.tables import text_table

LONG_RECORD = 1_000_000
"""Number of samples above which a record is shortened for a fast Fourier transform."""


@data_class
class TimeHistory:
    """Sampled signals on one equidistant time axis.

    Attributes:
        time: sample times, shape (n_samples,) [s]
        values: samples, shape (n_signals, n_samples)
        names: one name per signal
        units: one unit per signal
        notes: what a run has to tell about its loops: signals at the limits of their converters, and the resolution of
            these

    Raises:
        ValueError: for NaN, unequal sampling, or names and units that do not match the values
    """

    time: ArrayField
    values: ArrayField
    names: NameList
    units: NameList = held(())
    notes: NameList = field(default=held(()), kw_only=True)
    __repr__ = short_repr
    _repr_html_ = html_repr

    def __post_init__(self) -> None:
        time = finite_array("time", self.time, (None,))
        try:
            depth = np.ndim(self.values)
        except ValueError:  # rows of unequal length, which the check tells
            depth = 2
        values = finite_array("values", [self.values] if depth == 1 else self.values, (None, None))
        names = unique("signal", self.names)
        units = units_of("signal", self.units, names)
        if len(time) < 2:
            raise ValueError(f"a time history needs at least 2 samples, got {len(time)}")
        if values.shape != (len(names), len(time)):
            raise ValueError(f"values must have shape {len(names)} x {len(time)} (names x time), got {values.shape}")
        steps, rounding = np.diff(time), 4 * np.spacing(np.abs(time).max())  # of times far from zero
        if steps.min() <= 0 or np.ptp(steps) > 1e-6 * steps.mean() + rounding:
            raise ValueError(
                f"time must rise in equal steps, got steps from {steps.min():g} s to {steps.max():g} s; "
                "resample first: take the values at equal times, as numpy.interp gives them (of times that are only "
                "rounded, make equal ones by numpy.linspace)"
            )
        freeze(self, time=time, values=values, names=names, units=units, notes=several("notes", self.notes))

    def __str__(self) -> str:
        """Return a table of the signals with their units and ranges, and the notes."""
        rows = [("signal", "unit", "least", "largest", "last")]
        for name, unit, row in zip(self.names, self.units, self.values, strict=True):
            rows.append((name, unit or "-", f"{row.min():.4g}", f"{row.max():.4g}", f"{row[-1]:.4g}"))
        span = f"{len(self.time)} samples from {self.time[0]:g} s to {self.time[-1]:g} s, {self.sample_rate:g} Hz"
        return "\n".join([span, text_table(rows), *self.notes])

    @property
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""
        return (len(self.time) - 1) / float(self.time[-1] - self.time[0])

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def elapsed(self) -> Array:
        """Times since the first sample in exactly equal steps, shape (n_samples,) [s].

        Differences of times far from zero jitter by their rounding: by 2e-7 s of seconds since 1970.
        """
        return np.linspace(0.0, self.duration, len(self.time))

    def __getitem__(self, name: str) -> Array:
        """Return the samples of one signal, shape (n_samples,).

        Raises:
            ValueError: for an unknown name
        """
        return self.values[self.names.index(known("signal", name, self.names))]

    def select(self, names: Sequence[str]) -> "TimeHistory":
        """Return a time history of the named signals.

        Raises:
            ValueError: for unknown names, and for a text in place of a list of names
        """
        names = unique("signal", names)
        rows = [self.names.index(known("signal", name, self.names)) for name in names]
        return replace(self, values=self.values[rows], names=names, units=tuple(self.units[i] for i in rows))

    def with_zeros(self, names: Sequence[str]) -> "TimeHistory":
        """Return a time history of the named signals, in their order, with zeros for those that this one lacks.

        It makes the excitation of a scene from the inputs that act: `record.with_zeros(scene.inputs)`.

        Raises:
            ValueError: for a signal of this one that is not among the names
        """
        names = unique("signal", names)
        values, units = np.zeros((len(names), len(self.time))), [""] * len(names)
        for name, unit, row in zip(self.names, self.units, self.values, strict=True):
            place = names.index(known("signal", name, names))
            values[place], units[place] = row, unit
        return replace(self, values=values, names=names, units=tuple(units))

    def after(self, start: float) -> "TimeHistory":
        """Return the part from `start` [s] to the end, for example without the first transient.

        Raises:
            ValueError: for a start that leaves fewer than 2 samples
        """
        keep = self.time >= finite("start", start) - 1e-9 * self.duration
        if keep.sum() < 2:
            raise ValueError(
                f"a time history needs at least 2 samples, and {keep.sum()} of this one, from {self.time[0]:g} s to "
                f"{self.time[-1]:g} s, are left from {start:g} s on"
            )
        return replace(self, time=self.time[keep], values=self.values[:, keep])


def sample_times(duration: float, sample_rate: float) -> Array:
    """Return the sample times 0 ... duration, shape (duration * sample_rate + 1,) [s]."""
    n_steps = positive("duration", duration, "s") * positive("sample_rate", sample_rate, "Hz")
    if round(n_steps) < 2:
        raise ValueError(f"{duration:g} s at {sample_rate:g} Hz gives fewer than 2 steps; ask for a longer signal")
    return np.arange(round(n_steps) + 1) / sample_rate


def settling_time(history: TimeHistory, name: str, *, target: ArrayLike, tolerance: float, start: float) -> float:
    """Compute the time after which a signal stays within a tolerance of its target [s].

    Args:
        history: the signals
        name: name of the signal
        target: value to settle at, or a path, shape (n_samples,) [unit of the signal]
        tolerance: largest distance from the target [unit of the signal]
        start: time from which settling counts, such as that of a step or the end of a path [s]

    Returns:
        Time from the start to the first sample from which on all are within the tolerance; 0 where they are from the
        start on, inf where the last sample is outside.

    Raises:
        ValueError: for an unknown name, a target of another length, and a start outside the record
    """
    values, first = history[name], float(history.time[0])
    aim = finite_array("target", target, (len(values),) if np.ndim(target) else ())
    if not first <= finite("start", start) <= history.time[-1]:
        raise ValueError(f"start must lie in {first:g} ... {history.time[-1]:g} s, got {start:g} s")
    outside = np.flatnonzero(np.abs(values - aim) > positive("tolerance", tolerance))
    if not len(outside):
        return 0.0
    last = int(outside[-1])
    return float(max(history.time[last + 1] - start, 0.0)) if last + 1 < len(values) else np.inf


def occupied_bandwidth(history: TimeHistory, *, power_fraction: float = 0.99) -> float:
    """Compute the frequency below which a given share of every signal's power lies [Hz].

    The mean value is excluded, and a window suppresses the jump from the last sample to the first. A constant signal
    occupies 0 Hz.

    Args:
        history: the signals
        power_fraction: share of the power [-]

    Returns:
        The largest frequency over the signals [Hz].

    Raises:
        ValueError: for a share that is not above 0 and at most 1
    """
    if not 0 < finite("power_fraction", power_fraction) <= 1:
        raise ValueError(f"power_fraction must lie above 0 and up to 1, got {power_fraction:g}")
    n = fast_length(len(history.time))
    moving = history.values[np.any(history.values != history.values[:, :1], axis=1), :n]
    if moving.size == 0:
        return 0.0
    windowed = (moving - moving.mean(axis=1, keepdims=True)) * np.hanning(n)
    cumulative = np.cumsum(np.abs(np.fft.rfft(windowed, axis=1)) ** 2, axis=1)
    last = np.argmax(cumulative >= power_fraction * cumulative[:, -1:], axis=1).max()
    return float(last * history.sample_rate / n)


def fast_length(n: int) -> int:
    """Return the largest number of samples up to n without a large prime factor; n itself if it is below a million.

    A transform of a length with a large prime factor, such as 10^7 + 1, takes ten times as long and twice the memory.
    At most half a per cent of the samples are omitted.

    Args:
        n: number of samples
    """
    while n > LONG_RECORD and scipy.fft.next_fast_len(n, real=True) > n:
        n -= 1
    return n
