"""Time histories and excitations."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from nassim import TimeHistory, estimate_frf
from nassim.signals.excitations import (
    band_limited_noise,
    chirp,
    low_pass,
    multisine,
    orthogonal_multisines,
    remove_settling,
    sine_dwell,
    spectral_noise,
    step,
)
from nassim.signals.spectra import TabulatedSpectrum, differentiate_spectrum
from nassim.signals.time_history import fast_length, occupied_bandwidth, sample_times

RATE = 1000.0
BAND = {"lowest_frequency": 10.0, "highest_frequency": 100.0, "period": 0.5}


def history():
    time = np.arange(5) / 10.0
    return TimeHistory(time, [time, time**2], ("x", "y"), ("m", "V"))


def test_time_history_knows_its_axis_and_its_signals():
    record = history()
    assert record.sample_rate == pytest.approx(10.0)
    assert record.duration == pytest.approx(0.4)
    np.testing.assert_array_equal(record["y"], record.time**2)
    assert TimeHistory([0.0, 1.0], [3.0, 4.0], ("x",)).units == ("",)


def test_select_and_after_keep_names_units_and_values():
    part = history().select(["y"]).after(0.2)
    assert (part.names, part.units) == (("y",), ("V",))
    np.testing.assert_allclose(part.time, [0.2, 0.3, 0.4])
    np.testing.assert_allclose(part["y"], part.time**2)


def test_signals_that_a_record_lacks_become_zeros():
    full = history().with_zeros(["a", "y", "b", "x"])
    assert (full.names, full.units) == (("a", "y", "b", "x"), ("", "V", "", history().units[0]))
    np.testing.assert_array_equal(full.values, [0 * full.time, history()["y"], 0 * full.time, history()["x"]])
    with pytest.raises(ValueError, match="unknown signal 'y'; known: x, a"):
        history().with_zeros(["x", "a"])


def test_a_part_begins_with_the_sample_of_its_start_to_a_billionth_of_the_record():
    for share in (0.9, 1.1):
        assert len(history().after(0.2 + share * 0.4e-9).time) == (3 if share < 1 else 2)


def test_arrays_are_read_only_copies():
    values = np.zeros((1, 3))
    record = TimeHistory([0.0, 1.0, 2.0], values, ("x",))
    values[:] = 7.0
    assert not record.values.any()
    with pytest.raises(ValueError, match="read-only"):
        record.values[0, 0] = 1.0


@pytest.mark.parametrize(
    ("time", "values", "names", "units", "message"),
    [
        ([0.0, np.nan], [1.0, 2.0], ("x",), (), "time holds 1 value.* NaN"),
        ([0.0, 1.0], [1.0, np.nan], ("x",), (), "values holds 1 value.* NaN"),
        ([0.0, 1.0], [-np.inf, np.nan], ("x",), (), "values holds 2 value.* infinite"),
        ([0.0], [1.0], ("x",), (), "at least 2 samples, got 1"),
        ([0.0, 1.0], [1.0, 2.0, 3.0], ("x",), (), r"shape 1 x 2 \(names x time\), got \(1, 3\)"),
        ([0.0, 1.0], [1.0, 2.0], ("x", "y"), (), "shape 2 x 2"),
        ([0.0, 1.0], [1.0, 2.0], ("x",), ("m", "V"), "got 2 units for 1 signals"),
        ([0.0, 1.0], [[1.0, 2.0]] * 2, ("x", "x"), (), "signal names must differ; used more than once: x"),
        ([0.0, 1.0], [1.0, 2.0], ("",), (), "signal names must be non-empty"),
        ([0.0, 1.0, 2.1], [1.0, 2.0, 3.0], ("x",), (), "equal steps, got steps from 1 s to 1.1 s; resample"),
        ([0.0, 0.0, 0.0], [1.0, 2.0, 3.0], ("x",), (), "must rise in equal steps"),
        ([2.0, 1.0, 0.0], [1.0, 2.0, 3.0], ("x",), (), "must rise in equal steps"),
        ([[0.0, 1.0]], [1.0, 2.0], ("x",), (), "time must have shape any, got 1 x 2"),
        ([0.0, 1.0], [[1.0, 2.0], [3.0]], ("x", "y"), (), "values must be numbers, in rows of equal length"),
        ([0.0, 1.0], np.ones((2, 1, 2)), ("x", "y"), (), "values must have shape any x any, got 2 x 1 x 2"),
        ([0.0, 1.0], 5.0, ("x",), (), "values must have shape any x any, got a number"),
        ([0.0, 1.0], [[1.0, 2.0]] * 2, ("x", "y"), "mV", "units must be a list of them, got the text 'mV'"),
        ([0.0, 1.0, 3.0], [1.0, 2.0, 3.0], ("x",), (), "resample first: .* numpy.interp"),
    ],
)
def test_time_history_checks_itself(time, values, names, units, message):
    with pytest.raises(ValueError, match=message):
        TimeHistory(time, values, names, units)


def test_unknown_signals_are_answered_with_the_known_ones():
    with pytest.raises(ValueError, match="unknown signal 'z'; known: x, y"):
        history()["z"]
    with pytest.raises(ValueError, match="unknown signal 'z'; known: x, y"):
        history().select(["x", "z"])
    with pytest.raises(ValueError, match="signal names must be a list of them, got the text 'xy'"):
        history().select("xy")
    with pytest.raises(
        ValueError, match=r"at least 2 samples, and 1 of this one, from 0 s to 0.4 s, are left from 0.4 s"
    ):
        history().after(0.4)


def test_sample_times():
    time = sample_times(0.5, RATE)
    assert len(time) == 501
    assert time[-1] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("duration", "rate", "message"),
    [
        (-1.0, RATE, "duration must be positive, got -1 s"),
        (np.nan, RATE, "duration holds 1 value.* NaN"),
        (1.0, 0.0, "sample_rate must be positive, got 0 Hz"),
        (1e-3, RATE, "0.001 s at 1000 Hz gives fewer than 2 steps"),
    ],
)
def test_sample_times_checks(duration, rate, message):
    with pytest.raises(ValueError, match=message):
        sample_times(duration, rate)


@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize("cutoff", [50.0, 200.0])
def test_low_pass_is_a_butterworth_filter(order, cutoff):
    impulse = np.zeros(2000)
    impulse[0] = 1.0
    gain = np.abs(np.fft.rfft(low_pass(impulse, cutoff_frequency=cutoff, sample_rate=RATE, order=order)))
    frequency = np.fft.rfftfreq(2000, 1 / RATE)
    warped = np.tan(np.pi * frequency[:-1] / RATE) / np.tan(np.pi * cutoff / RATE)  # bilinear transformation
    np.testing.assert_allclose(gain[:-1], 1 / np.sqrt(1 + warped ** (2 * order)), atol=1e-9)
    assert 20 * np.log10(gain[np.searchsorted(frequency, cutoff)]) == pytest.approx(-3.01, abs=0.01)


def test_low_pass_is_causal():
    late = np.zeros(100)
    late[50] = 1.0
    filtered = low_pass(late, cutoff_frequency=100.0, sample_rate=RATE)
    assert not filtered[:50].any()
    assert filtered[50] > 0


def test_noise_has_its_rms_and_its_band():
    noise = band_limited_noise(60.0, RATE, cutoff_frequency=100.0, rms=2.5, seed=3)
    assert np.sqrt(np.mean(noise.values**2)) == pytest.approx(2.5)
    frequency, density = scipy.signal.welch(noise["actuator_voltage"], fs=RATE, nperseg=500)
    plateau = density[(frequency > 5) & (frequency < 40)].mean()
    assert density[frequency == 100.0][0] / plateau == pytest.approx(0.5, rel=0.2)
    assert density[frequency > 250].max() < 1e-3 * plateau


def test_noise_follows_its_seed():
    first, again, other = (
        band_limited_noise(1.0, RATE, cutoff_frequency=100.0, seed=seed).values for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.1


def test_chirp_rises_exponentially():
    duration, start, end = 20.0, 1.0, 100.0
    sweep = chirp(duration, RATE, start_frequency=start, end_frequency=end, amplitude=3.0)
    growth = np.log(end / start) / duration
    phase = 2 * np.pi * start * np.expm1(growth * sweep.time) / growth  # integral of 2 pi f(t)
    np.testing.assert_allclose(sweep.values[0], 3.0 * np.sin(phase), atol=1e-8)


def test_chirp_instantaneous_frequency_and_equal_time_per_decade():
    sweep = chirp(20.0, RATE, start_frequency=1.0, end_frequency=100.0)
    phase = np.unwrap(np.angle(scipy.signal.hilbert(sweep.values[0])))
    frequency = np.gradient(phase, sweep.time) / (2 * np.pi)
    for time, expected in ((10.0, 10.0), (15.0, 10**1.5)):
        around = np.abs(sweep.time - time) < 0.2
        assert frequency[around].mean() == pytest.approx(expected, rel=0.01)


def test_multisine_is_periodic_flat_and_free_of_leakage():
    signal = multisine(1.5, RATE, lowest_frequency=10.0, highest_frequency=200.0, period=0.5, rms=2.0, seed=5)
    values = signal.values[0]
    np.testing.assert_array_equal(values[500:1000], values[:500])
    assert np.sqrt(np.mean(values[:500] ** 2)) == pytest.approx(2.0)
    amplitude = np.abs(np.fft.rfft(values[:1000])) / 500
    frequency = np.fft.rfftfreq(1000, 1 / RATE)
    excited = (frequency % 2.0 == 0) & (frequency >= 10) & (frequency <= 200)
    np.testing.assert_allclose(amplitude[excited], 2.0 * np.sqrt(2 / excited.sum()), rtol=1e-9)
    assert amplitude[~excited].max() < 1e-12
    # Random phases in all four quadrants: their directions nearly cancel.
    directions = np.fft.rfft(values[:1000])[excited] / amplitude[excited] / 500
    assert np.abs(directions.mean()) < 3 / np.sqrt(excited.sum())


def test_the_ends_of_a_band_belong_to_it_whatever_rounding_makes_of_them():
    """100 x 0.07 is above 7 in floating point, and 100 x 0.29 below 29."""
    values = multisine(100.0, 1.0, lowest_frequency=0.07, highest_frequency=0.29, period=100.0).values[0]
    amplitude = np.abs(np.fft.rfft(values[:100]))
    np.testing.assert_array_equal(np.flatnonzero(amplitude > 1e-9 * amplitude.max()), np.arange(7, 30))


def test_multisine_follows_its_seed():
    def make(seed):
        return multisine(1.0, RATE, **BAND, seed=seed).values

    np.testing.assert_array_equal(make(1), make(1))
    assert np.abs(make(1) - make(2)).max() > 0.1


def test_steps():
    sudden = step(1.0, RATE, amplitude=2.0, start=0.5)
    np.testing.assert_array_equal(sudden.values[0], 2.0 * (sudden.time >= 0.5))
    # 3 * 0.1 is the double after 0.3: the step is not a sample late.
    assert [np.argmax(step(1.0, RATE, start=n * 1e-3).values[0]) for n in range(999)] == list(range(999))
    assert np.argmax(step(1.0, 10.0, start=3 * 0.1).values[0]) == 3
    smooth = step(1.0, RATE, amplitude=2.0, start=0.2, rise_time=0.4).values[0]
    np.testing.assert_allclose(smooth[[0, 200, 300, 400, 600, 1000]], [0, 0, 1 - np.sqrt(0.5), 1, 2, 2])
    assert np.all(np.diff(smooth) >= 0)


def test_sine_dwell_grows_along_its_ramp():
    dwell = sine_dwell(1.0, RATE, frequency=25.0, amplitude=2.0, ramp_time=0.5)
    envelope = np.minimum(dwell.time / 0.5, 1.0)
    np.testing.assert_allclose(dwell.values[0], 2.0 * envelope * np.sin(2 * np.pi * 25.0 * dwell.time))
    steady = sine_dwell(1.0, RATE, frequency=25.0)
    np.testing.assert_allclose(steady.values[0], np.sin(2 * np.pi * 25.0 * steady.time))


def test_occupied_bandwidth():
    time = np.arange(1000) / RATE
    sines = TimeHistory(time, [5 + np.sin(2 * np.pi * 40 * time), np.cos(2 * np.pi * 90 * time)], ("a", "b"))
    # The window widens a line by one step of the spectrum.
    assert occupied_bandwidth(sines) == pytest.approx(90.0, abs=RATE / 1000)
    assert occupied_bandwidth(sines.select(["a"])) == pytest.approx(40.0, abs=RATE / 1000)
    assert occupied_bandwidth(TimeHistory(time, np.full(1000, 3.0), ("a",))) == 0.0
    # As a periodic signal a ramp has power 1 / k^2, and 0.6 / k of all above line k: 61 Hz without the window.
    assert occupied_bandwidth(TimeHistory(time, time, ("a",))) <= 3.0


@pytest.mark.parametrize(
    ("make", "options", "message"),
    [
        (band_limited_noise, {"cutoff_frequency": 500.0}, "below half the sample rate, 500 Hz, got 500 Hz"),
        (band_limited_noise, {"cutoff_frequency": 0.0}, "cutoff_frequency must be positive, got 0 Hz"),
        (band_limited_noise, {"cutoff_frequency": np.nan}, "cutoff_frequency holds 1 value.* NaN"),
        (band_limited_noise, {"cutoff_frequency": 100.0, "rms": -1.0}, "rms must not be negative, got -1"),
        (chirp, {"start_frequency": 1.0, "end_frequency": 600.0}, "end_frequency must .* got 600 Hz"),
        (chirp, {"start_frequency": 0.0, "end_frequency": 100.0}, "start_frequency must .*0"),
        (chirp, {"start_frequency": np.nan, "end_frequency": 100.0}, "start_frequency .*NaN"),
        (chirp, {"start_frequency": 1.0, "end_frequency": 100.0, "amplitude": np.nan}, "values holds .* NaN"),
        (multisine, {**BAND, "highest_frequency": 500.0}, "highest_frequency must lie below half"),
        (multisine, {**BAND, "period": -0.5}, "period must be positive"),
        (multisine, {**BAND, "period": 0.50003}, "0.50003 s must be a whole number of samples"),
        (multisine, {**BAND, "lowest_frequency": 100.5}, "no multiple of 1 / period = 2 Hz"),
        (multisine, {**BAND, "lowest_frequency": 0.0}, "no multiple of 1 / period .* 0 ... 100 Hz"),
        (multisine, {**BAND, "lowest_frequency": np.nan}, "NaN"),
        (multisine, {**BAND, "rms": np.nan}, "rms holds 1 value.* NaN"),
        (step, {"start": 1.5}, "starts at 1.5 s, after the end"),
        (step, {"rise_time": -0.1}, "rise_time must not be negative, got -0.1 s"),
        (step, {"amplitude": np.nan}, "values holds .* NaN"),
        (sine_dwell, {"frequency": 700.0}, "frequency must lie below half the sample rate, 500"),
        (sine_dwell, {"frequency": 10.0, "ramp_time": -1.0}, "ramp_time must not be negative"),
    ],
)
def test_excitations_check_their_figures(make, options, message):
    with pytest.raises(ValueError, match=message):
        make(1.0, RATE, **options)


def test_low_pass_checks():
    with pytest.raises(ValueError, match="sample_rate must be positive"):
        low_pass([1.0], cutoff_frequency=1.0, sample_rate=-RATE)
    with pytest.raises(ValueError, match="cutoff_frequency must lie below half"):
        low_pass([1.0], cutoff_frequency=500.0, sample_rate=RATE)
    for order in (0, 1.5):
        with pytest.raises(ValueError, match="order must be a whole number of at least 1"):
            low_pass([1.0], cutoff_frequency=50.0, sample_rate=RATE, order=order)
    for values, message in (([1.0, np.nan], "NaN"), ([1.0, 1j], "real numbers"), (1.0, "values must have shape any")):
        with pytest.raises(ValueError, match=message):
            low_pass(values, cutoff_frequency=50.0, sample_rate=RATE)
    assert low_pass(np.ones((2, 0)), cutoff_frequency=50.0, sample_rate=RATE).shape == (2, 0)


@pytest.mark.parametrize("share", [0.0, -0.5, 1.5, np.nan])
def test_a_bandwidth_holds_a_share_of_the_power(share):
    with pytest.raises(ValueError, match="power_fraction"):
        occupied_bandwidth(history(), power_fraction=share)


THREE = ("a", "b", "c")


def test_orthogonal_multisines_are_told_apart_without_error():
    """Three inputs, each to both outputs through resonances of its own: exact at lines where one response is faint."""
    excitation = orthogonal_multisines(THREE, RATE, **BAND, n_settling=2, n_periods=2, rms=0.3, seed=4)
    assert excitation.duration == pytest.approx(3 * 4 * 0.5)
    np.testing.assert_allclose(np.sqrt(np.mean(excitation.values[:, :-1] ** 2, axis=1)), 0.3, rtol=1e-12)
    filters = {
        (output, name): scipy.signal.butter(2, [20.0 + 7 * k, 40.0 + 11 * k], "bandpass", fs=RATE)
        for k, (output, name) in enumerate((o, n) for o in "yz" for n in THREE)
    }
    read = [
        sum(10.0 ** (-3 * THREE.index(n)) * scipy.signal.lfilter(*filters[o, n], excitation[n]) for n in THREE)
        for o in "yz"
    ]
    record = TimeHistory(excitation.time, [*excitation.values, *read], (*THREE, "y", "z"))
    steady = remove_settling(record, duration=2.0, settling=1.0)
    assert len(steady.time) == 3 * 1000
    frf = estimate_frf(
        steady, inputs=THREE, outputs=["y", "z"], segment_duration=0.5, overlap=0.0, window="boxcar"
    ).band(10, 100)
    for (output, name), system in filters.items():
        _, expected = scipy.signal.freqz(*system, worN=frf.frequency, fs=RATE)
        np.testing.assert_allclose(frf.response(output, name), 10.0 ** (-3 * THREE.index(name)) * expected, rtol=1e-4)
    assert frf.coherence.min() > 1 - 1e-9
    # With the beginnings of the blocks, transients leak and the coherence tells.
    rough = estimate_frf(record, inputs=THREE, outputs=["y", "z"], segment_duration=0.5, overlap=0.0, window="boxcar")
    assert rough.band(10, 100).coherence.min() < 0.9


def test_settled_blocks_of_a_record():
    time = 3.0 + np.arange(11) / 10.0
    record = TimeHistory(time, [np.arange(11.0)], ("x",), ("m",))
    kept = remove_settling(record, duration=0.5, settling=0.2)
    np.testing.assert_array_equal(kept["x"], [2, 3, 4, 7, 8, 9])
    np.testing.assert_allclose(kept.time, 3.0 + np.arange(6) / 10.0)
    assert kept.units == ("m",)
    assert remove_settling(replace(record, notes=("saturated",)), duration=0.5, settling=0.2).notes == ("saturated",)
    np.testing.assert_array_equal(remove_settling(record, duration=0.4, settling=0.0)["x"], np.arange(8))


@pytest.mark.parametrize(
    ("duration", "settling", "message"),
    [
        (0.25, 0.1, "duration 0.25 s must be a whole number of samples at 10 Hz"),
        (0.26, 0.1, "duration 0.26 s must be a whole number of samples at 10 Hz"),
        (0.5, 0.11, "settling 0.11 s must be a whole number"),
        (2.0, 0.1, "a record of 1 s with blocks of 2 s, 0.1 s of each left out, leaves no samples"),
        (0.5, 0.5, "leaves no samples"),
        (1e-9, 0.0, "leaves no samples"),
        (0.5, -0.1, "settling must not be negative"),
    ],
)
def test_blocks_that_do_not_fit(duration, settling, message):
    record = TimeHistory(np.arange(11) / 10.0, [np.arange(11.0)], ("x",))
    with pytest.raises(ValueError, match=message):
        remove_settling(record, duration=duration, settling=settling)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"names": ("a", "a")}, "input names must differ"),
        ({"n_periods": 0}, "n_periods must be a whole number of at least 1, got 0"),
        ({"n_settling": 0.5}, "n_settling must be a whole number of at least 0, got 0.5"),
        ({"period": 0.5005}, "whole number of samples"),
        ({"highest_frequency": 500.0}, "below half the sample rate"),
    ],
)
def test_orthogonal_multisines_check_their_arguments(change, message):
    arguments = {"names": THREE, "sample_rate": RATE, **BAND} | change
    with pytest.raises(ValueError, match=message):
        orthogonal_multisines(**arguments)


def test_an_offset_occupies_no_bandwidth():
    noise = band_limited_noise(2.0, RATE, cutoff_frequency=100.0)
    offset = TimeHistory(noise.time, [noise.values[0] + 1e3, noise.values[0]], ("offset", "noise"))
    assert occupied_bandwidth(offset) == pytest.approx(occupied_bandwidth(noise), rel=0.01)
    assert occupied_bandwidth(noise) > 50.0


def test_long_records_lose_their_last_samples_to_a_fast_transform():
    """Below a million none, even of a prime number; above so few that the number left has small factors only."""
    assert [fast_length(n) for n in (899_981, 1_000_000, 1_000_001)] == [899_981, 1_000_000, 1_000_000]
    assert fast_length(10_000_001) == 10_000_000
    for n in (1_234_567, 3_000_017):
        left = shorter = fast_length(n)
        assert 0.995 * n < left <= n
        for factor in (2, 3, 5, 7, 11):
            while shorter % factor == 0:
                shorter //= factor
        assert shorter == 1


def test_noise_whose_spectrum_changes_between_its_lines_is_told():
    """A line between two multiples of 0.1 Hz, one at a multiple, a steep fall."""
    flat, width = 1e-3, 0.004

    def peak(place):
        ends = np.arctan((np.array([0.1, 40.0]) - place) / width)
        total = 39.9 * flat + 5.0 * width * float(ends[1] - ends[0])
        return lambda f: flat + 5.0 / (1 + ((f - place) / width) ** 2), total

    lines = np.arange(1, 401) / 10
    for spectrum, true in (peak(23.35), peak(23.3), (lambda f: f**-4.0, (0.1**-3 - 40.0**-3) / 3)):
        sines = (np.sum(spectrum(lines)) - (spectrum(lines)[0] + spectrum(lines)[-1]) / 2) / 10
        off = float(100 * (np.sqrt(sines / true) - 1))
        with pytest.warns(UserWarning, match=re.escape(f"expect an rms that is {off:+.2g} % off")):
            spectral_noise({"a": spectrum}, 10.0, 100.0, band=(0.1, 40.0))
    table = TabulatedSpectrum([1.0, 23.3413, 23.3414, 23.3415, 40.0], [flat, flat, 500.0, flat, flat])
    for spectrum in (table, differentiate_spectrum(table)):
        with pytest.warns(UserWarning, match="changes much"):
            spectral_noise({"a": spectrum}, 10.0, 100.0, band=(1.0, 40.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        spectral_noise({"a": lambda f: f**-2.0}, 10.0, 100.0, band=(1.0, 40.0))
        outside = TabulatedSpectrum([0.5, 0.9, 41.0, 80.0], [1e3, 1.0, 1.0, 1e3])
        spectral_noise({"a": outside}, 10.0, 100.0, band=(1.0, 40.0))
        assert not np.any(spectral_noise({"a": np.zeros_like}, 10.0, 100.0, band=(1.0, 40.0)).values)


def test_noises_have_their_spectra_and_are_independent():
    """Of 30 000 lines, the mean of the squares over the densities is 1 within some hundredths."""

    def falling(frequency):
        return 3e-4 / (1 + (frequency / 40.0) ** 2)

    noise = spectral_noise({"a": falling, "b": lambda f: np.full(len(f), 0.02)}, 30.0, 2e3, units={"b": "m"}, seed=4)
    assert (noise.names, noise.units, len(noise.time)) == (("a", "b"), ("", "m"), 60_001)
    assert np.array_equal(noise.values[:, -1], noise.values[:, 0])
    lines = np.fft.rfft(noise.values[:, :-1])[:, 1:-1]
    frequency = np.arange(1, 30_000) / 30.0
    power = 2 * np.abs(lines) ** 2 / (2e3 * 60_000)
    for density, values in ((falling(frequency), power[0]), (0.02, power[1])):
        for part in np.array_split(values / density, 3):
            assert part.mean() == pytest.approx(1.0, abs=0.04)
    assert noise["a"].var() == pytest.approx(np.sum(falling(frequency)) / 30.0, rel=0.03)
    assert abs(np.mean(lines[0] * lines[1].conj())) < 0.03 * np.abs(lines[0]).mean() * np.abs(lines[1]).mean()
    alone = spectral_noise({"b": lambda f: np.full(len(f), 0.02)}, 30.0, 2e3, seed=4)
    assert np.array_equal(alone["b"], noise["b"])
    other = spectral_noise({"b": lambda f: np.full(len(f), 0.02)}, 30.0, 2e3, seed=5)
    assert abs(np.corrcoef(other["b"], noise["b"])[0, 1]) < 0.02
    banded = np.abs(np.fft.rfft(spectral_noise({"a": falling}, 2.0, 500.0, band=(20.0, 60.0))["a"][:-1]))
    assert np.array_equal(np.flatnonzero(banded > 1e-9 * banded.max()), np.arange(40, 121))
    with pytest.raises(ValueError, match="give at least one signal a spectrum"):
        spectral_noise({}, 2.0, 500.0)
    with pytest.raises(ValueError, match="unknown signal 'A'; known: a"):
        spectral_noise({"a": falling}, 2.0, 500.0, units={"A": "m"})
    with pytest.raises(ValueError, match=r"no multiple of 0\.5 Hz lies in the band of 0\.1 to 0\.3 Hz"):
        spectral_noise({"a": falling}, 2.0, 500.0, band=(0.1, 0.3))
    with pytest.raises(ValueError, match="spectrum of 'a' is -1 at"):
        spectral_noise({"a": lambda f: np.full(len(f), -1.0)}, 2.0, 500.0)
