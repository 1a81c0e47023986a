"""FRFs estimated from signals of systems that are known exactly."""

import numpy as np
import pytest
import scipy.signal

from nassim import FRF, TimeHistory, estimate_frf
from nassim.signals import band_limited_noise, multisine

RATE, N = 1000.0, 100_000
FILTERS = {  # second-order resonance, low-pass, delay, differentiator
    ("y1", "u1"): ([0.05], [1.0, -1.6, 0.8]),
    ("y1", "u2"): ([0.2], [1.0, -0.8]),
    ("y2", "u1"): ([0.0, 0.0, 1.0], [1.0]),
    ("y2", "u2"): ([1.0, -1.0], [1.0]),
}


def exact(entry, frequency):
    return scipy.signal.freqz(*FILTERS[entry], worN=frequency, fs=RATE)[1]


def history(**signals):
    n = len(next(iter(signals.values())))
    return TimeHistory(np.arange(n) / RATE, np.stack(list(signals.values())), tuple(signals))


def white(seed):
    return np.random.default_rng(seed).standard_normal(N)


def test_known_filter_is_recovered_from_noise():
    entry = ("y1", "u1")
    u = white(1)
    record = history(u1=u, y1=scipy.signal.lfilter(*FILTERS[entry], u))
    frf = estimate_frf(record, inputs=["u1"], outputs=["y1"], segment_duration=1.0, label="test")
    np.testing.assert_allclose(frf.frequency, np.arange(1.0, 501.0))
    np.testing.assert_allclose(frf.response(*entry), exact(entry, frf.frequency), rtol=0.02)
    assert frf.coherence.min() > 0.999
    assert frf.label == "test"


def test_periodic_excitation_has_no_leakage():
    entry = ("y1", "u1")
    excitation = multisine(5.0, RATE, lowest_frequency=2.0, highest_frequency=300.0, period=0.5, seed=2)
    u = excitation.values[0]
    record = history(u1=u, y1=scipy.signal.lfilter(*FILTERS[entry], u)).after(2.0)
    options = {"segment_duration": 0.5, "window": "boxcar", "overlap": 0.0}
    frf = estimate_frf(record, inputs=["u1"], outputs=["y1"], **options).band(2.0, 300.0)
    np.testing.assert_allclose(frf.response(*entry), exact(entry, frf.frequency), rtol=1e-9)
    np.testing.assert_allclose(frf.coherence, 1.0, rtol=1e-9)


def test_two_correlated_inputs_are_told_apart():
    u = {"u1": white(1), "u2": white(2)}
    u["u2"] = u["u2"] + 0.5 * u["u1"]
    y = {o: sum(scipy.signal.lfilter(*FILTERS[o, i], u[i]) for i in u) for o in ("y1", "y2")}
    frf = estimate_frf(history(**u, **y), inputs=["u1", "u2"], outputs=["y1", "y2"], segment_duration=1.0)
    assert frf.values.shape == (2, 2, 500)
    for entry in FILTERS:
        expected = exact(entry, frf.frequency)
        tolerance = 0.02 * np.abs(expected).max()
        np.testing.assert_allclose(frf.response(*entry), expected, rtol=0.05, atol=tolerance)
    assert frf.coherence.min() > 0.99


@pytest.mark.parametrize("noise", [0.0, 0.5, 1.0, 2.0])
def test_coherence_and_h1_with_noise_at_the_output(noise):
    u = white(1)
    record = history(u=u, y=u + noise * white(2))
    frf = estimate_frf(record, inputs=["u"], outputs=["y"], segment_duration=0.1)
    assert frf.values.mean() == pytest.approx(1.0, abs=0.02)
    assert frf.coherence.mean() == pytest.approx(1 / (1 + noise**2), abs=0.01)


def test_noise_at_the_input_biases_h1_but_not_h2():
    u = white(1)
    record = history(u=u + 0.5 * white(2), y=3.0 * u)
    h1, h2 = (
        estimate_frf(record, inputs=["u"], outputs=["y"], segment_duration=0.1, method=m).values.mean()
        for m in ("H1", "H2")
    )
    assert h1 == pytest.approx(3.0 / 1.25, rel=0.01)
    assert h2 == pytest.approx(3.0, rel=0.01)


def test_coherence_without_a_relation_is_low():
    record = history(u=white(1), y=white(2))
    frf = estimate_frf(record, inputs=["u"], outputs=["y"], segment_duration=0.1)
    assert frf.coherence.max() < 0.05


def test_delay_is_a_linear_phase():
    u = white(4)
    record = history(u=u, y=np.roll(u, 3))
    frf = estimate_frf(record, inputs=["u"], outputs=["y"], segment_duration=1.0)
    np.testing.assert_allclose(frf.values[0, 0], np.exp(-2j * np.pi * frf.frequency * 3 / RATE), atol=0.02)


def estimate(**options):
    noise = band_limited_noise(1.0, RATE, cutoff_frequency=300.0, name="u")
    record = history(u=noise["u"], v=noise["u"][::-1], y=noise["u"])
    return estimate_frf(record, **{"inputs": ["u"], "outputs": ["y"], "segment_duration": 0.1, **options})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inputs": ["w"]}, "unknown signal 'w'; known: u, v, y"),
        ({"outputs": ["w"]}, "unknown signal 'w'; known: u, v, y"),
        ({"method": "H3"}, "unknown method 'H3'; known: H1, H2"),
        ({"method": "H2", "inputs": ["u", "v"]}, "H2 needs exactly one input, got 2; take H1"),
        ({"segment_duration": 0.8}, "record of 1 s holds fewer than two segments of 0.8 s; record longer"),
        ({"segment_duration": 0.0}, "segment_duration must be positive"),
        ({"segment_duration": np.nan}, "NaN"),
        ({"overlap": 1.0}, r"overlap must lie in 0 ... 1 \(1 excluded\), got 1"),
        ({"overlap": -0.1}, "overlap must lie in 0"),
        ({"window": "hat"}, "[Ww]indow"),
        ({"outputs": ["y", "y"]}, "output names must differ"),
    ],
)
def test_estimation_checks_its_arguments(options, message):
    with pytest.raises(ValueError, match=message):
        estimate(**options)


def make_frf(**change):
    names = {"outputs": ("a", "b"), "inputs": ("u",)}
    return FRF(**{"frequency": [1.0, 2.0, 3.0], "values": np.ones((2, 1, 3)), **names, **change})


def test_band_keeps_both_ends():
    frf = make_frf(coherence=np.full((2, 3), 0.5), label="x").band(2.0, 3.0)
    np.testing.assert_array_equal(frf.frequency, [2.0, 3.0])
    assert frf.values.shape == (2, 1, 2)
    assert frf.coherence.shape == (2, 2)
    assert (frf.outputs, frf.inputs, frf.label) == (("a", "b"), ("u",), "x")
    assert make_frf().band(0.0, 1.0).coherence is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frequency": [1.0, np.nan, 3.0]}, "frequency holds 1 value.* NaN"),
        ({"frequency": [1.0, 1.0, 3.0]}, "frequency must be ascending"),
        ({"frequency": [-1.0, 1.0, 3.0]}, "frequency must be ascending, not negative"),
        ({"values": np.ones((1, 2, 3))}, r"shape \(outputs, inputs, frequencies\), got \(1, 2, 3\)"),
        ({"outputs": ("a", "a")}, "output names must differ; used more than once: a"),
        ({"inputs": ("",)}, "input names must be non-empty"),
        ({"coherence": np.ones((1, 3))}, "coherence must have shape 2 x 3, got 1 x 3"),
        ({"coherence": np.full((2, 3), np.nan)}, "coherence holds 6 value.* NaN"),
    ],
)
def test_frf_checks_itself(change, message):
    with pytest.raises(ValueError, match=message):
        make_frf(**change)


def test_unknown_names_and_empty_bands():
    with pytest.raises(ValueError, match="unknown output 'c'; known: a, b"):
        make_frf().response("c", "u")
    with pytest.raises(ValueError, match="unknown input 'v'; known: u"):
        make_frf().response("a", "v")
    with pytest.raises(ValueError, match="no frequency between 10 and 20 Hz"):
        make_frf().band(10.0, 20.0)
