"""Records: sampled signals on one time axis."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from nassim.base.checks import Array, finite_array, freeze, known, positive, unique

LONG = 1_000_000
"""Samples from which on a record's last ones are worth less than a fast transform."""


@dataclass(frozen=True)
class TimeHistory:
    """Sampled signals on one equidistant time axis.

    time: sample times, shape (n_samples,) [s]
    values: samples, shape (n_signals, n_samples)
    names, units: one of each per signal

    Raises ValueError for NaN, unequal sampling, or names and units that do not match the values.
    """

    time: Array
    values: Array
    names: tuple[str, ...]
    units: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        time = finite_array("time", self.time, (None,))
        values = finite_array("values", self.values if np.ndim(self.values) == 2 else [self.values], (None, None))
        names, units = unique("signal", self.names), tuple(self.units) or ("",) * len(self.names)
        if len(time) < 2:
            raise ValueError(f"a time history needs at least 2 samples, got {len(time)}")
        if values.shape != (len(names), len(time)):
            raise ValueError(f"values must have shape {len(names)} x {len(time)} (names x time), got {values.shape}")
        if len(units) != len(names):
            raise ValueError(f"one unit per signal: got {len(units)} units for {len(names)} signals")
        steps = np.diff(time)
        if steps.min() <= 0 or np.ptp(steps) > 1e-6 * steps.mean():
            raise ValueError(
                f"time must rise in equal steps, got steps from {steps.min():g} s to {steps.max():g} s; resample first"
            )
        freeze(self, time=time, values=values, names=names, units=units)

    @property
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""
        return (len(self.time) - 1) / float(self.time[-1] - self.time[0])

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.time[-1] - self.time[0])

    def __getitem__(self, name: str) -> Array:
        """Samples of one signal, shape (n_samples,); raises ValueError for an unknown name."""
        row: Array = self.values[self.names.index(known("signal", name, self.names))]
        return row

    def select(self, names: Sequence[str]) -> "TimeHistory":
        """Return the named signals as a time history of their own."""
        rows = [self.names.index(known("signal", name, self.names)) for name in names]
        return TimeHistory(self.time, self.values[rows], tuple(names), tuple(self.units[i] for i in rows))

    def after(self, start: float) -> "TimeHistory":
        """Return the stretch from `start` [s] on, for instance without the first transient."""
        keep = self.time >= start - 1e-9 * self.duration
        return TimeHistory(self.time[keep], self.values[:, keep], self.names, self.units)


def sample_times(duration: float, sample_rate: float) -> Array:
    """Sample times 0 ... duration, shape (duration * sample_rate + 1,) [s]."""
    n_steps = positive("duration", duration, "s") * positive("sample_rate", sample_rate, "Hz")
    if round(n_steps) < 2:
        raise ValueError(f"{duration:g} s at {sample_rate:g} Hz gives fewer than 2 steps; ask for a longer signal")
    return np.arange(round(n_steps) + 1) / sample_rate


def occupied_bandwidth(history: TimeHistory, *, power_fraction: float = 0.99) -> float:
    """Frequency below which the given fraction of every signal's power lies [Hz], mean value left out.

    A window keeps the jump from the last sample to the first out of it. A steady signal occupies 0 Hz. The largest
    figure over the signals is returned.
    """
    n = fast_length(len(history.time))
    moving = history.values[np.any(history.values != history.values[:, :1], axis=1), :n]
    if moving.size == 0:
        return 0.0
    windowed = (moving - moving.mean(axis=1, keepdims=True)) * np.hanning(n)
    cumulative = np.cumsum(np.abs(np.fft.rfft(windowed, axis=1)) ** 2, axis=1)
    last = np.argmax(cumulative >= power_fraction * cumulative[:, -1:], axis=1).max()
    return float(last * history.sample_rate / n)


def fast_length(n: int) -> int:
    """Most samples, of n, whose number has no large prime factor; all n of less than a million.

    With one, as 10^7 + 1 has, a transform takes ten times as long and twice the memory; half a per cent of the samples
    are lost at most.
    """
    while n > LONG and scipy.fft.next_fast_len(n, real=True) > n:
        n -= 1
    return n
