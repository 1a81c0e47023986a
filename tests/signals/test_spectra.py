"""Spectra of noise against their definitions and recorded noise, and bad input."""

import numpy as np
import pytest
import scipy.signal

from nassim.signals.spectra import (
    TabulatedSpectrum,
    amplifier_noise,
    differentiate_spectrum,
    estimate_spectrum,
    quantisation_noise,
    spectrum_values,
)
from nassim.signals.time_history import TimeHistory

FREQUENCY = np.array([0.5, 3.0, 40.0, 900.0])


def test_amplifier_noise_rises_below_its_corner():
    spectrum = amplifier_noise(2e-9, corner_frequency=40.0)
    assert spectrum(FREQUENCY) == pytest.approx(4e-18 * np.array([81.0, 43 / 3, 2.0, 940 / 900]), rel=1e-12, abs=0)
    assert amplifier_noise(3.0)(np.array([0.0, 7.0])) == pytest.approx([9.0, 9.0])
    assert amplifier_noise(3.0)(7.0) == 9.0
    listed = amplifier_noise(3.0, corner_frequency=7.0)
    assert listed([7.0, 14.0]) == pytest.approx([18.0, 13.5])
    assert differentiate_spectrum(listed)([7.0]) == pytest.approx([18.0 * (14 * np.pi) ** 2])
    assert quantisation_noise(12.0, sample_rate=6.0)([3.0, 4.0]) == pytest.approx([4.0, 0.0])


@pytest.mark.parametrize("step", [0.01, 0.3])
def test_quantisation_noise_is_what_rounding_does(step):
    rate = 800.0
    signal = 40 * step * np.random.default_rng(5).normal(size=200_000)
    error = step * np.round(signal / step) - signal
    frequency, density = scipy.signal.welch(error, fs=rate, nperseg=512)
    inside = slice(5, -5)
    spectrum = quantisation_noise(step, sample_rate=rate)
    assert spectrum(frequency)[inside].mean() == pytest.approx(density[inside].mean(), rel=0.02)
    assert np.var(error) == pytest.approx(spectrum(np.array([1.0]))[0] * rate / 2, rel=0.02)
    assert spectrum(np.array([399.0, 400.0, 400.1, 1e5])) == pytest.approx(
        step**2 / 12 / 400.0 * np.array([1, 1, 0, 0])
    )


def test_tables_follow_power_laws_and_pass_through_zeros():
    table = TabulatedSpectrum([1.0, 10.0, 100.0, 200.0, 300.0], [1e-6, 1e-10, 1e-10, 0.0, 2e-10])
    found = table(np.array([1.0, 2.0, 10.0, 50.0, 150.0, 200.0, 250.0, 300.0]))
    assert found == pytest.approx([1e-6, 1e-6 / 16, 1e-10, 1e-10, 5e-11, 0.0, 1e-10, 2e-10], rel=1e-9, abs=0)
    from_zero = TabulatedSpectrum([0.0, 2.0], [3.0, 5.0])
    assert from_zero(np.array([0.0, 1.0, 2.0])) == pytest.approx([3.0, 4.0, 5.0])
    line = TabulatedSpectrum([1.0, 49.0, 50.0, 60.0], [1.0, 1.0, 7.0, 1.0])
    assert line(np.array([49.5, 55.0])) == pytest.approx([4.0, 7.0 * 1.1 ** (np.log(7) / np.log(5 / 6))])
    with pytest.raises(ValueError, match=r"from 1 to 300 Hz, but is asked for 0\.5 to 900 Hz; extend"):
        table(FREQUENCY)


def test_rates_of_signals():
    omega = 2 * np.pi * FREQUENCY
    assert differentiate_spectrum(lambda f: f**-4.0, 2)(FREQUENCY) == pytest.approx(np.full(4, (2 * np.pi) ** 4))
    assert differentiate_spectrum(amplifier_noise(3.0))(FREQUENCY) == pytest.approx(9 * omega**2)
    back = differentiate_spectrum(differentiate_spectrum(amplifier_noise(3.0), -1), 1)
    assert back(FREQUENCY) == pytest.approx([9.0] * 4)


def test_values_of_every_kind():
    between = np.array([0.5, 1.0, 30.0])
    assert spectrum_values("u", 4.0, FREQUENCY, between) == pytest.approx([4.0] * 3)
    assert spectrum_values("u", FREQUENCY**-2, FREQUENCY, between) == pytest.approx(between**-2)
    assert spectrum_values("u", np.sqrt, FREQUENCY, between) == pytest.approx(np.sqrt(between))


BAD = {
    "negative number": (lambda: spectrum_values("u", -1.0, FREQUENCY, FREQUENCY), "'u' is -1 at 0.5 Hz; .*unit.2/Hz"),
    "negative array": (lambda: spectrum_values("u", [1, 1, -2, 1], FREQUENCY, FREQUENCY), "'u' is -2 at 40 Hz"),
    "negative function": (lambda: spectrum_values("u", np.negative, FREQUENCY, FREQUENCY), "'u' is -900 at 900 Hz"),
    "complex": (lambda: spectrum_values("u", [1j] * 4, FREQUENCY, FREQUENCY), "real numbers, got complex"),
    "not finite": (lambda: spectrum_values("u", np.nan, FREQUENCY, FREQUENCY), "NaN"),
    "length": (lambda: spectrum_values("u", [1.0, 2.0], FREQUENCY, FREQUENCY), r"shape \(2,\), but there are 4 freq"),
    "function of another shape": (
        lambda: spectrum_values("u", lambda f: 1.0, FREQUENCY, FREQUENCY),
        r"gives shape \(\) at 4 frequencies",
    ),
    "1/f at rest": (
        lambda: spectrum_values("u", amplifier_noise(1.0, corner_frequency=1.0), FREQUENCY, np.array([0.0, 1.0])),
        "infinite or undefined at 0 Hz; begin above",
    ),
    "table": (lambda: TabulatedSpectrum([1.0, 2.0], [1.0, -2.0]), "density must not be negative, got -2 at 2 Hz"),
    "table's lowest": (
        lambda: TabulatedSpectrum([1.0, 2.0, 3.0], [-1.0, -3.0, 1.0]),
        "density must not be negative, got -3 at 2 Hz",
    ),
    "table below 0 Hz": (lambda: TabulatedSpectrum([-1.0, 2.0], [1.0, 2.0]), "not negative"),
    "table's order within": (lambda: TabulatedSpectrum([1.0, 3.0, 2.0], [1.0, 2.0, 3.0]), "ascending"),
    "table's order": (lambda: TabulatedSpectrum([2.0, 1.0], [1.0, 2.0]), "ascending"),
    "short table": (lambda: TabulatedSpectrum([2.0], [1.0]), "at least two"),
    "step": (lambda: quantisation_noise(-1.0, sample_rate=1.0), "step must not be negative"),
    "rate": (lambda: quantisation_noise(1.0, sample_rate=0.0), "sample_rate must be positive"),
    "density": (lambda: amplifier_noise(-1.0), "density must not be negative"),
    "a number for a function": (lambda: differentiate_spectrum(2.0), "spectrum must be a function .* got float"),
    "times": (lambda: differentiate_spectrum(np.sqrt, 0.5), "times must be a whole number"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named(case):
    make, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        make()


def test_the_spectrum_of_a_record_scatters_as_stated():
    """A low-passed signal of known spectrum, from white samples by a difference equation."""
    rate, duration, segment = 200.0, 800.0, 2.0
    x = scipy.signal.lfilter([0.3], [1, -0.7], np.random.default_rng(1).normal(size=1 + round(rate * duration)))
    record = TimeHistory(9.0 + np.arange(len(x)) / rate, [0 * x, x], ["none", "floor"], ["m", "m"])
    found = estimate_spectrum(record, "floor", segment_duration=segment)
    f = found.frequency
    np.testing.assert_allclose(f, np.arange(1, 201) / segment)
    f, density = f[1:-1], found.density[1:-1]
    ratio = density / (2 / rate * np.abs(0.3 / (1 - 0.7 * np.exp(-2j * np.pi * f / rate))) ** 2)
    assert ratio.mean() == pytest.approx(1.0, abs=0.01)
    assert ratio.std() == pytest.approx(0.73 * np.sqrt(segment / duration), rel=0.1)
    with pytest.raises(ValueError, match="unknown signal 'roof'; known: none, floor"):
        estimate_spectrum(record, "roof", segment_duration=segment)
    with pytest.raises(ValueError, match=r"a segment of 0.015 s has 3 sample\(s\), at least 4 are needed"):
        estimate_spectrum(record, "floor", segment_duration=0.015)
