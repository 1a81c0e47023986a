"""Spectra of noise: one-sided power spectral densities, as functions of frequency."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from nassim.base.checks import Array, finite, finite_array, freeze, not_negative, positive

Spectrum = Callable[[Array], Array]
"""One-sided power spectral density [unit^2/Hz] over frequency, (n,) [Hz]; its integral is the mean square."""


def amplifier_noise(density: float, *, corner_frequency: float = 0.0) -> Spectrum:
    """Noise as data sheets give it: density^2 (1 + corner_frequency / f).

    density: far above the corner [unit/sqrt(Hz)]; corner_frequency: where 1/f noise is as strong as white [Hz]
    """
    level = not_negative("density", density) ** 2
    corner = not_negative("corner_frequency", corner_frequency, "Hz")

    def spectrum(frequency: Array) -> Array:
        with np.errstate(divide="ignore"):
            return level * (1 + corner / frequency) if corner else np.full(len(frequency), level)

    return spectrum


def quantisation_noise(step: float, *, sample_rate: float) -> Spectrum:
    """Noise of a converter that rounds: step^2 / 12, evenly spread up to half the sample rate, none above.

    step: resolution, in the signal's unit; sample_rate [Hz]. The signal has to move by several steps from sample to
    sample: a signal at rest between two steps makes no noise, and a slow one makes lines instead.

    Source: B. Widrow, I. Kollar, Quantization Noise (2008), ch. 5.
    """
    half = positive("sample_rate", sample_rate, "Hz") / 2
    level = not_negative("step", step) ** 2 / 12 / half

    def spectrum(frequency: Array) -> Array:
        result: Array = np.where(frequency <= half * (1 + 1e-9), level, 0.0)
        return result

    return spectrum


@dataclass(frozen=True)
class TabulatedSpectrum:
    """A measured spectrum, such as of a floor; straight lines on logarithmic axes between its points.

    frequency: (n,), ascending [Hz]; density: (n,) [unit^2/Hz]

    A function as the others. Asked for frequencies outside the table it raises ValueError: nobody knows what is there.
    """

    frequency: Array
    density: Array

    def __post_init__(self) -> None:
        x = finite_array("frequency", self.frequency, (None,))
        y = finite_array("density", self.density, (len(x),))
        if len(x) < 2 or np.any(np.diff(x) <= 0) or x[0] < 0:
            raise ValueError("frequency must be ascending and not negative, at least two")
        if y.min() < 0:
            raise ValueError(f"density must not be negative, got {y.min():g} at {x[y.argmin()]:g} Hz")
        freeze(self, frequency=x, density=y)

    def __call__(self, frequency: Array) -> Array:
        """Density at frequencies, (n,) [unit^2/Hz]."""
        x, y = self.frequency, self.density
        low, high = float(np.min(frequency)), float(np.max(frequency))
        if low < x[0] * (1 - 1e-9) or high > x[-1] * (1 + 1e-9):
            raise ValueError(
                f"the table gives a spectrum from {x[0]:g} to {x[-1]:g} Hz, but is asked for {low:g} to {high:g} Hz; "
                "extend it as you know it, or take fewer frequencies"
            )
        before = np.clip(np.searchsorted(x, frequency, side="right") - 1, 0, len(x) - 2)
        x0, x1, y0, y1 = x[before], x[before + 1], y[before], y[before + 1]
        usable = (x0 > 0) & (y0 > 0) & (y1 > 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            power = y0 * (frequency / x0) ** (np.log(y1 / y0) / np.log(x1 / x0))
        result: Array = np.where(usable, power, y0 + (y1 - y0) * (frequency - x0) / (x1 - x0))
        return result


def differentiated(spectrum: Spectrum, times: int = 1) -> Spectrum:
    """Spectrum of the signal's rate, (2 pi f)^2 as large; of the acceleration from a displacement's with times = 2.

    times: how often; negative: integrated, which is infinite at 0 Hz
    """
    if not finite("times", times).is_integer():
        raise ValueError(f"times must be a whole number, got {times!r}")

    def rate(frequency: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            return (2 * np.pi * frequency) ** (2.0 * times) * spectrum(frequency)

    return rate


def spectrum_values(name: str, spectrum: Spectrum | ArrayLike, given: Array, frequency: Array) -> Array:
    """Values of a spectrum at frequencies, (n,) [unit^2/Hz].

    spectrum: a function; one value per frequency of `given`, (n_given,); or a number, for white noise
    frequency: (n,) [Hz], within `given`; name: whose spectrum, for messages

    Raises ValueError for other numbers of values, for negative, infinite and complex ones.
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
    if not np.isfinite(values[0]) and frequency[0] == 0:
        raise ValueError(f"{label} is infinite or undefined at 0 Hz; begin above")


def _refuse_negative(label: str, frequency: Array, values: Array) -> None:
    if values.min() < 0:
        raise ValueError(
            f"{label} is {values.min():g} at {frequency[values.argmin()]:g} Hz; a power spectral density is not "
            "negative: give unit^2/Hz, neither a response nor decibels"
        )
