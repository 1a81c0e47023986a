"""Noise spectra: one-sided power spectral densities as functions of frequency."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.signal

from nassim.base.checks import Array, finite, finite_array, freeze, not_negative, positive, whole_number
from nassim.base.field_types import ArrayField, ArrayLike, data_class
from nassim.base.short_repr import short_repr
from nassim.signals.time_history import TimeHistory

STEEPEST = 20.0
"""Exponent of frequency up to which a table follows a power law: beyond, one of its points is a line."""
FEWEST_SAMPLES = 4
"""Samples of a segment from which on it has two frequencies above zero."""
Spectrum = Callable[[Array], Array]
"""One-sided power spectral density [unit^2/Hz] at frequencies, shape (n,) [Hz]; its integral is the mean square."""


def amplifier_noise(density: float, *, corner_frequency: float = 0.0) -> Spectrum:
    """Return the noise spectrum density^2 (1 + corner_frequency / f), as given in data sheets of amplifiers.

    Args:
        density: noise density far above the corner [unit/sqrt(Hz)]
        corner_frequency: frequency at which 1/f noise and white noise are equal [Hz]
    """
    level = not_negative("density", density) ** 2
    corner = not_negative("corner_frequency", corner_frequency, "Hz")

    def spectrum(frequency: Array) -> Array:
        with np.errstate(divide="ignore"):
            return level * (1 + corner / np.asarray(frequency)) if corner else np.full(np.shape(frequency), level)

    return spectrum


def quantisation_noise(step: float, *, sample_rate: float) -> Spectrum:
    """Return the spectrum of quantisation: a variance of step^2 / 12, distributed evenly up to half the sample rate.

    The signal must change by several steps from sample to sample. A constant signal between two steps has no noise, and
    a slow one has spectral lines instead.

    Source: B. Widrow, I. Kollar, Quantization Noise (2008), ch. 5.

    Args:
        step: resolution, in the unit of the signal
        sample_rate: samples per second [Hz]
    """
    half = positive("sample_rate", sample_rate, "Hz") / 2
    level = not_negative("step", step) ** 2 / 12 / half

    def spectrum(frequency: Array) -> Array:
        return np.where(np.asarray(frequency) <= half * (1 + 1e-9), level, 0.0)

    return spectrum


@data_class
class TabulatedSpectrum:
    """A measured spectrum, such as that of floor vibration, interpolated by straight lines on logarithmic axes.

    The lines are straight on linear axes beside values of zero and where the spectrum is steeper than f^20 or f^-20: a
    line of an estimated spectrum has then the mean square of its bin. It is called as a function of frequency, as other
    spectra are.

    Attributes:
        frequency: ascending frequencies, shape (n,) [Hz]
        density: power spectral density, shape (n,) [unit^2/Hz]

    Raises:
        ValueError: for frequencies that do not ascend, a negative density, and calls with frequencies outside the table
    """

    frequency: ArrayField
    density: ArrayField
    __repr__ = short_repr

    def __post_init__(self) -> None:
        x = finite_array("frequency", self.frequency, (None,))
        y = finite_array("density", self.density, (len(x),))
        if len(x) < 2 or np.any(np.diff(x) <= 0) or x[0] < 0:
            raise ValueError("frequency must be ascending and not negative, at least two")
        if y.min() < 0:
            raise ValueError(f"density must not be negative, got {y.min():g} at {x[y.argmin()]:g} Hz")
        freeze(self, frequency=x, density=y)

    def __call__(self, frequency: Array) -> Array:
        """Return the density at frequencies, shape (n,) [unit^2/Hz]."""
        x, y = self.frequency, self.density
        low, high = float(np.min(frequency)), float(np.max(frequency))
        if low < x[0] * (1 - 1e-9) or high > x[-1] * (1 + 1e-9):
            raise ValueError(
                f"the table gives a spectrum from {x[0]:g} to {x[-1]:g} Hz, but is asked for {low:g} to {high:g} Hz; "
                "extend it as you know it, or take fewer frequencies"
            )
        before = np.clip(np.searchsorted(x, frequency, side="right") - 1, 0, len(x) - 2)
        x0, x1, y0, y1 = x[before], x[before + 1], y[before], y[before + 1]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            exponent = np.log(y1 / y0) / np.log(x1 / x0)
            power = y0 * (frequency / x0) ** exponent
        steady = (x0 > 0) & (np.abs(exponent) <= STEEPEST)  # the exponent of values of zero is not finite
        return np.where(steady, power, y0 + (y1 - y0) * (frequency - x0) / (x1 - x0))


def estimate_spectrum(record: TimeHistory, name: str, *, segment_duration: float) -> TabulatedSpectrum:
    """Estimate the spectrum of a recorded signal by Welch's method, such as that of floor vibration for a noise budget.

    Segments with Hann's window overlap by half. The standard deviation of each value is about 0.73
    sqrt(segment_duration / duration of the record) times the value. Shorter segments reduce it, and widen peaks.
    In white noise the first value is a sixth too low, because each segment is without its mean, and one at half the
    sample rate is half of the others.

    Args:
        record: the record.
        name: name of the signal.
        segment_duration: length of a segment, whose inverse is the frequency resolution [s].

    Returns:
        Spectrum from one resolution to half the sample rate [unit^2/Hz].

    Raises:
        ValueError: for an unknown name, and for a record without two segments.

    Source: P. D. Welch, The use of fast Fourier transform for the estimation of power spectra, IEEE Transactions on
        Audio and Electroacoustics 15 (1967) 70-73.
    """
    frequency, psd = welch(record.select([name]), segment_duration)
    return TabulatedSpectrum(frequency, psd[0])


def welch(record: TimeHistory, segment_duration: float) -> tuple[Array, Array]:
    """Return frequencies (n,) [Hz] and spectra (signals, n) of all signals of a record, see `estimate_spectrum`."""
    n = round(positive("segment_duration", segment_duration, "s") * record.sample_rate)
    if n < FEWEST_SAMPLES:
        raise ValueError(f"a segment of {segment_duration:g} s has {n} sample(s), at least {FEWEST_SAMPLES} are needed")
    if n > len(record.time) * 2 // 3:
        raise ValueError(
            f"a record of {record.duration:g} s holds fewer than two segments of {segment_duration:g} s that overlap "
            "by half; record longer or take shorter segments"
        )
    frequency, psd = scipy.signal.welch(record.values, record.sample_rate, nperseg=n)
    return frequency[1:], psd[:, 1:]


def differentiate_spectrum(spectrum: Spectrum, times: int = 1) -> Spectrum:
    """Return the spectrum of a signal's time derivative, which is (2 pi f)^2 times that of the signal.

    Args:
        spectrum: spectrum of the signal
        times: number of differentiations, for example 2 from displacement to acceleration. A negative number
            integrates; the result is infinite at 0 Hz.

    Raises:
        ValueError: if `times` is not a whole number, and for a spectrum that is not a function
    """
    times = whole_number("times", times)
    if not callable(spectrum):
        raise ValueError(
            f"spectrum must be a function of frequency, got {type(spectrum).__name__}; TabulatedSpectrum for a table, "
            "amplifier_noise for white noise"
        )

    return _Derivative(spectrum, times)


@dataclass(frozen=True)
class _Derivative:
    """Spectrum of a signal's time derivative, see `differentiate_spectrum`."""

    spectrum: Spectrum
    times: int

    def __call__(self, frequency: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            return (2 * np.pi * np.asarray(frequency)) ** (2.0 * self.times) * self.spectrum(frequency)


def table_frequencies(spectrum: Spectrum | ArrayLike) -> Array:
    """Return the frequencies of the table from which a spectrum is made, (n,) [Hz]; none of another spectrum."""
    while isinstance(spectrum, _Derivative):
        spectrum = spectrum.spectrum
    return spectrum.frequency if isinstance(spectrum, TabulatedSpectrum) else np.zeros(0)


def spectrum_values(name: str, spectrum: Spectrum | ArrayLike, given: Array, frequency: Array) -> Array:
    """Return values of a spectrum at frequencies, shape (n,) [unit^2/Hz].

    Args:
        name: name of the signal, for error messages
        spectrum: a function; one value per frequency of `given`, shape (n_given,); or a number, for white noise
        given: frequencies of the values, shape (n_given,) [Hz]
        frequency: frequencies of the result, within `given`, shape (n,) [Hz]

    Raises:
        ValueError: for a wrong number of values, and for negative, infinite or complex values
    """
    label = f"spectrum of {name!r}"
    if callable(spectrum):
        values = spectrum(frequency)
    elif np.ndim(spectrum) == 0:
        values = np.full(len(frequency), finite(label, spectrum))  # type: ignore[arg-type]
    elif np.shape(spectrum) == given.shape:
        checked = finite_array(label, spectrum, given.shape)
        _refuse_negative(label, given, checked)
        values = TabulatedSpectrum(given, checked)(frequency)
    else:
        raise ValueError(
            f"{label} has shape {np.shape(spectrum)}, but there are {len(given)} frequencies; one value for each, or "
            "TabulatedSpectrum for a table with frequencies of its own"
        )
    if np.shape(values) != frequency.shape:
        raise ValueError(f"{label} gives shape {np.shape(values)} at {len(frequency)} frequencies; one value for each")
    _refuse_infinite(label, frequency, values)
    values = finite_array(label, values, frequency.shape)
    _refuse_negative(label, frequency, values)
    return values


def _refuse_infinite(label: str, frequency: Array, values: Array) -> None:
    """Raise ValueError for infinite or undefined values."""
    if not np.isfinite(values[0]) and frequency[0] == 0:
        raise ValueError(f"{label} is infinite or undefined at 0 Hz; begin above")


def _refuse_negative(label: str, frequency: Array, values: Array) -> None:
    """Raise ValueError for negative values."""
    if values.min() < 0:
        raise ValueError(
            f"{label} is {values.min():g} at {frequency[values.argmin()]:g} Hz; a power spectral density is not "
            "negative: give unit^2/Hz, neither a response nor decibels"
        )
