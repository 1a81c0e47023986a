"""Excitations of a test bench: noise, chirps, multisines, steps, sine dwells."""

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy

from nassim.base.checks import (
    Array,
    below_nyquist,
    finite,
    finite_array,
    known,
    not_negative,
    positive,
    unique,
    whole_number,
)
from nassim.base.field_types import ArrayLike
from nassim.base.warning_log import warn
from nassim.signals.spectra import Spectrum, spectrum_values, table_frequencies
from nassim.signals.time_history import TimeHistory, sample_times

MOST_PROBES = 2_000_000
"""Number of frequencies up to which a spectrum is searched for changes between the lines of a signal."""
SAME_TIME = 1e-6
"""Difference of times that is rounding [samples]."""
RMS_ERROR_WARNED = 0.05
"""Relative error of the expected rms of noise above which a warning is given."""


def low_pass(values: ArrayLike, *, cutoff_frequency: float, sample_rate: float, order: int = 4) -> Array:
    """Filter samples along the last axis by a causal Butterworth low-pass filter.

    Args:
        values: samples, shape (..., n_samples)
        cutoff_frequency: -3 dB frequency, below half the sample rate [Hz]
        sample_rate: samples per second [Hz]
        order: order of the filter

    Raises:
        ValueError: if the cutoff frequency is not below half the sample rate, for an order that is not a whole number
            from 1 on, and for NaN among the samples
    """
    below_nyquist("cutoff_frequency", cutoff_frequency, sample_rate)
    samples = finite_array("values", values, (None,) * max(np.ndim(values), 1))
    sections = scipy.signal.butter(whole_number("order", order, 1), cutoff_frequency, fs=sample_rate, output="sos")
    return scipy.signal.sosfilt(sections, samples, axis=-1) if samples.size else samples


def band_limited_noise(
    duration: float,
    sample_rate: float,
    *,
    cutoff_frequency: float,
    rms: float = 1.0,
    seed: int = 0,
    name: str = "actuator_voltage",
    unit: str = "V",
) -> TimeHistory:
    """Make Gaussian noise with a fourth-order low-pass spectrum, the excitation of the paper's bench.

    Args:
        duration: duration [s]
        sample_rate: samples per second [Hz]
        cutoff_frequency: -3 dB frequency of the low-pass filter [Hz]
        rms: root mean square of the result, in `unit`
        seed: seed of the random numbers; the same seed gives the same signal
        name: name of the signal
        unit: unit of the signal
    """
    time = sample_times(duration, sample_rate)
    white = np.random.default_rng(seed).standard_normal(len(time))
    values = low_pass(white, cutoff_frequency=cutoff_frequency, sample_rate=sample_rate)
    return TimeHistory(time, _scale_to_rms(values, rms), (name,), (unit,))


def spectral_noise(
    spectra: Mapping[str, Spectrum],
    duration: float,
    sample_rate: float,
    *,
    band: tuple[float, float] | None = None,
    seed: int = 0,
    units: Mapping[str, str] | None = None,
) -> TimeHistory:
    """Make independent Gaussian noises with given spectra, such as the disturbances of a noise budget.

    Each signal is a sum of sines at all multiples of 1 / duration, with random amplitudes and phases. Its last
    sample repeats the first. The numbers of a signal depend on the seed and its name only.

    Args:
        spectra: one-sided power spectral density of each signal by name: a function of frequency [unit^2/Hz].
        duration: duration [s].
        sample_rate: samples per second [Hz].
        band: lowest and highest frequency of the noise (default: all multiples of 1 / duration up to half the sample
            rate) [Hz].
        seed: seed of the random numbers.
        units: units of the signals by name.

    Returns:
        Record with the signals in the order of `spectra`.

    Warns:
        UserWarning: where a spectrum has lines between or at these multiples, or falls so steeply from one to the next,
            that the expected rms of the signal is off by more than 5 %.

    Raises:
        ValueError: without a spectrum, for a band without a multiple of 1 / duration, for units of unknown signals, and
            for spectra as of `nassim.systems.noise_budget`.
    """
    if not spectra:
        raise ValueError("give at least one signal a spectrum")
    for name in units or {}:
        known("signal", name, spectra)
    time = sample_times(duration, sample_rate)
    n = len(time) - 1  # the last sample repeats the first
    frequency = np.fft.rfftfreq(n, 1 / sample_rate)
    low, high = (0.0, sample_rate / 2) if band is None else band
    lines = np.flatnonzero((frequency >= low) & (frequency <= high) & (frequency > 0) & (2 * frequency < sample_rate))
    if not len(lines):
        raise ValueError(f"no multiple of {sample_rate / n:g} Hz lies in the band of {low:g} to {high:g} Hz")
    values = []
    for name, spectrum in spectra.items():
        density = spectrum_values(name, spectrum, frequency[lines], frequency[lines])
        random = np.random.default_rng([seed, zlib.crc32(name.encode())]).standard_normal((2, len(lines)))
        amplitudes = np.zeros(len(frequency), dtype=complex)
        amplitudes[lines] = n / 2 * np.sqrt(density * sample_rate / n) * (random[0] - 1j * random[1])
        values.append(np.fft.irfft(amplitudes, n)[np.arange(n + 1) % n])
        _warn_of_change(name, spectrum, frequency[lines], density)
    return TimeHistory(time, np.array(values), tuple(spectra), tuple((units or {}).get(name, "") for name in spectra))


def chirp(
    duration: float,
    sample_rate: float,
    *,
    start_frequency: float,
    end_frequency: float,
    amplitude: float = 1.0,
    name: str = "actuator_voltage",
    unit: str = "V",
) -> TimeHistory:
    """Make a sine whose frequency rises exponentially over the duration.

    Every decade takes the same time, so low frequencies get enough cycles.

    Args:
        duration: duration [s]
        sample_rate: samples per second [Hz]
        start_frequency: frequency at the start [Hz]
        end_frequency: frequency at the end [Hz]
        amplitude: amplitude, in `unit`
        name: name of the signal
        unit: unit of the signal
    """
    below_nyquist("end_frequency", end_frequency, sample_rate)
    below_nyquist("start_frequency", start_frequency, sample_rate)
    time = sample_times(duration, sample_rate)
    values = amplitude * scipy.signal.chirp(
        time, start_frequency, duration, end_frequency, method="logarithmic", phi=-90
    )
    return TimeHistory(time, values, (name,), (unit,))


def multisine(
    duration: float,
    sample_rate: float,
    *,
    lowest_frequency: float,
    highest_frequency: float,
    period: float,
    rms: float = 1.0,
    seed: int = 0,
    name: str = "actuator_voltage",
    unit: str = "V",
) -> TimeHistory:
    """Make a random-phase multisine with equal amplitudes at every multiple of 1 / period in the band.

    The signal is periodic. An FRF estimated over whole periods, after the transient has died out, has no leakage.
    Source: R. Pintelon, J. Schoukens, System Identification, 2nd ed. (2012), ch. 5.

    Args:
        duration: duration [s]
        sample_rate: samples per second [Hz]
        lowest_frequency: lower end of the band [Hz]
        highest_frequency: upper end of the band [Hz]
        period: period [s]
        rms: root mean square, in `unit`
        seed: seed of the random phases
        name: name of the signal
        unit: unit of the signal
    """
    n_period, lines = _lines(lowest_frequency, highest_frequency, period, sample_rate)
    spectrum = np.zeros(n_period // 2 + 1, dtype=complex)
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, lines.stop - lines.start)
    spectrum[lines] = np.exp(1j * phase)
    one_period = _scale_to_rms(np.fft.irfft(spectrum, n_period), rms)
    time = sample_times(duration, sample_rate)
    return TimeHistory(time, np.resize(one_period, len(time)), (name,), (unit,))


def orthogonal_multisines(
    names: Sequence[str],
    sample_rate: float,
    *,
    lowest_frequency: float,
    highest_frequency: float,
    period: float,
    n_settling: int = 1,
    n_periods: int = 2,
    rms: float = 1.0,
    seed: int = 0,
    unit: str = "V",
) -> TimeHistory:
    """Make multisines for several inputs in one record, from which their responses separate exactly at every line.

    The record consists of n blocks for n inputs. From block to block, the phases of input k advance by k / n of a turn,
    so the inputs are orthogonal over the blocks. The periods of a block are equal if the machine is linear, without
    noise and has reached its steady state. The coherence shows their differences.

    Source: R. Pintelon, J. Schoukens, System Identification, 2nd ed. (2012), ch. 2.

    Args:
        names: names of the n inputs
        sample_rate: samples per second [Hz]
        lowest_frequency: lower end of the band [Hz]
        highest_frequency: upper end of the band [Hz]
        period: period [s]
        n_settling: periods at the start of each block in which transients die out
        n_periods: periods that follow in each block and are analysed, see `remove_settling`
        rms: root mean square of each input, in `unit`
        seed: seed of the random phases
        unit: unit of the signals
    """
    names = unique("input", names)
    n_in_all = whole_number("n_settling", n_settling, 0) + whole_number("n_periods", n_periods, 1)
    n_period, lines = _lines(lowest_frequency, highest_frequency, period, sample_rate)
    n = len(names)
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, (n, 1, lines.stop - lines.start))
    advance = 2 * np.pi / n * np.outer(range(n), range(n))
    spectrum = np.zeros((n, n, n_period // 2 + 1), dtype=complex)
    spectrum[..., lines] = np.exp(1j * (phase + advance[..., None]))
    blocks = np.tile(_scale_to_rms(np.fft.irfft(spectrum, n_period), rms), n_in_all)
    values = np.hstack([blocks.reshape(n, -1), blocks[:, -1, :1]])
    return TimeHistory(np.arange(values.shape[1]) / sample_rate, values, names, (unit,) * n)


def remove_settling(history: TimeHistory, *, duration: float, settling: float) -> TimeHistory:
    """Remove the beginning of each block from a record of blocks, and join the rest.

    An incomplete last block is removed. Segments for the analysis may not extend over two blocks. For
    `orthogonal_multisines`, the segments are periods:
    `estimate_frf(..., segment_duration=period, overlap=0, window="boxcar")`.

    Args:
        history: the record
        duration: duration of a block, a whole number of samples [s]
        settling: duration of its beginning that is removed, a whole number of samples [s]

    Raises:
        ValueError: if the record does not hold a complete block
    """
    sizes = []
    for label, time in (("duration", positive("duration", duration, "s")), ("settling", settling)):
        samples = not_negative(label, time, "s") * history.sample_rate
        if abs(samples - round(samples)) > 1e-6 * max(samples, 1.0):
            raise ValueError(f"{label} {time:g} s must be a whole number of samples at {history.sample_rate:g} Hz")
        sizes.append(round(samples))
    size, first = sizes
    n_blocks = len(history.time) // max(size, 1)
    if n_blocks == 0 or first >= size:
        raise ValueError(
            f"a record of {history.duration:g} s with blocks of {duration:g} s, {settling:g} s of each left out, "
            "leaves no samples"
        )
    blocks = history.values[:, : n_blocks * size].reshape(len(history.names), n_blocks, size)
    kept = blocks[:, :, first:].reshape(len(history.names), -1)
    time = history.time[0] + np.arange(kept.shape[1]) / history.sample_rate
    return replace(history, time=time, values=kept)


def step(
    duration: float,
    sample_rate: float,
    *,
    amplitude: float = 1.0,
    start: float = 0.0,
    rise_time: float = 0.0,
    name: str = "actuator_voltage",
    unit: str = "V",
) -> TimeHistory:
    """Make a step to `amplitude` at `start`, smoothed by half a cosine over `rise_time`.

    Args:
        duration: duration [s]
        sample_rate: samples per second [Hz]
        amplitude: final value, in `unit`
        start: time at which the signal begins to rise [s]
        rise_time: time from the start to the final value [s]
        name: name of the signal
        unit: unit of the signal

    Raises:
        ValueError: for a start behind the end of the record, which would be zero
    """
    not_negative("rise_time", rise_time, "s")
    time = sample_times(duration, sample_rate)
    if finite("start", start) > time[-1]:
        raise ValueError(f"the step starts at {start:g} s, after the end of the record at {time[-1]:g} s")
    if rise_time > 0:
        values: Array = 0.5 * amplitude * (1 - np.cos(np.pi * np.clip((time - start) / rise_time, 0.0, 1.0)))
    else:
        values = amplitude * (time >= start - SAME_TIME / sample_rate)
    return TimeHistory(time, values, (name,), (unit,))


def sine_dwell(
    duration: float,
    sample_rate: float,
    *,
    frequency: float,
    amplitude: float = 1.0,
    ramp_time: float = 0.0,
    name: str = "actuator_voltage",
    unit: str = "V",
) -> TimeHistory:
    """Make a sine of one frequency, whose amplitude rises linearly over `ramp_time`.

    Args:
        duration: duration [s]
        sample_rate: samples per second [Hz]
        frequency: frequency [Hz]
        amplitude: final amplitude, in `unit`
        ramp_time: time until the final amplitude [s]
        name: name of the signal
        unit: unit of the signal
    """
    below_nyquist("frequency", frequency, sample_rate)
    not_negative("ramp_time", ramp_time, "s")
    time = sample_times(duration, sample_rate)
    envelope = np.clip(time / ramp_time, 0.0, 1.0) if ramp_time > 0 else 1.0
    return TimeHistory(time, amplitude * envelope * np.sin(2 * np.pi * frequency * time), (name,), (unit,))


def _warn_of_change(name: str, spectrum: Spectrum, lines: Array, density: Array) -> None:
    """Warn of a spectrum that changes much between the lines of a signal, (n,) [Hz]; density: at the lines, (n,)."""
    each = int(np.clip(MOST_PROBES // len(lines), 4, 64))
    steps = np.arange(len(lines) * each - each + 1) / each
    fine = np.interp(steps, np.arange(len(lines)), lines)
    table = table_frequencies(spectrum)
    fine = np.union1d(fine, table[(table > lines[0]) & (table < lines[-1])])
    power = scipy.integrate.trapezoid(spectrum_values(name, spectrum, fine, fine), fine)
    if power <= 0:
        return
    off = math.sqrt(scipy.integrate.trapezoid(density, lines) / power) - 1
    if abs(off) > RMS_ERROR_WARNED:
        warn(
            f"the spectrum of {name!r} changes much between the multiples of {lines[1] - lines[0]:.3g} Hz, the inverse "
            f"of the duration: expect an rms that is {100 * off:+.2g} % off; make it longer, or begin its band higher"
        )


def _scale_to_rms(values: Array, rms: float) -> Array:
    """Return values scaled to a root mean square."""
    return values * (not_negative("rms", rms) / np.sqrt(np.mean(values**2)))


def _lines(lowest_frequency: float, highest_frequency: float, period: float, sample_rate: float) -> tuple[int, slice]:
    """Return the samples of a period and the multiples of 1 / period in a band; ValueError if there are none."""
    below_nyquist("highest_frequency", highest_frequency, sample_rate)
    finite("lowest_frequency", lowest_frequency)
    n_period = round(positive("period", period, "s") * sample_rate)
    if abs(n_period / sample_rate - period) > 1e-9 * period:
        raise ValueError(f"period {period:g} s must be a whole number of samples at {sample_rate:g} Hz")
    first, last = (
        int(np.ceil(lowest_frequency * period - 1e-9)),
        int(np.floor(highest_frequency * period + 1e-9)),
    )
    if not 1 <= first <= last:
        raise ValueError(
            f"no multiple of 1 / period = {1 / period:g} Hz lies in {lowest_frequency:g} ... {highest_frequency:g} Hz; "
            "lengthen the period or widen the band"
        )
    return n_period, slice(first, last + 1)
