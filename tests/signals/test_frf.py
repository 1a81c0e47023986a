"""FRFs estimated from signals of systems that are known exactly."""

import numpy as np
import pytest
import scipy.signal

import nassim.signals.frf
from nassim import FRF, TimeHistory, estimate_frf
from nassim.signals.excitations import band_limited_noise, multisine

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


def two_inputs(share, *, weak=1.0):
    """Inputs whose ordinary coherence is 1 - share: the second holds that share of its power for itself."""
    first, own = white(1), white(2)
    return {"u1": first, "u2": weak * (np.sqrt(1 - share) * first + np.sqrt(share) * own)}


def respond(u, weak):
    """y1 of FILTERS, to which both inputs contribute alike."""
    first, second = (scipy.signal.lfilter(*FILTERS["y1", name], u[name]) for name in ("u1", "u2"))
    return first + second / weak


@pytest.mark.parametrize("order", [["u1", "u2"], ["u2", "u1"]])
@pytest.mark.parametrize("weak", [1.0, 1e-12, 1e9])
def test_inputs_of_any_size_count_alike(weak, order):
    """1 V beside 1e-12 m: powers 24 decades apart, responses of equal size."""
    u = two_inputs(1.0, weak=weak)
    frf = estimate_frf(history(**u, y1=respond(u, weak)), inputs=order, outputs=["y1"], segment_duration=1.0)
    for name, scale in (("u1", 1.0), ("u2", 1 / weak)):
        expected = scale * exact(("y1", name), frf.frequency)
        np.testing.assert_allclose(frf.response("y1", name), expected, atol=0.02 * np.abs(expected).max())
    assert frf.coherence.min() > 0.99


@pytest.mark.parametrize("share", [0.5, 0.1, 1e-2, 1e-3])
def test_correlated_inputs_keep_their_own_responses(share):
    """Gains without memory leave nothing to leak, so the answer is exact at any correlation that is not refused."""
    u = two_inputs(share, weak=1e-7)
    record = history(**u, y=3.0 * u["u1"] - 4e7 * u["u2"])
    frf = estimate_frf(record, inputs=["u1", "u2"], outputs=["y"], segment_duration=1.0)
    np.testing.assert_allclose(frf.response("y", "u1"), 3.0, rtol=1e-9)
    np.testing.assert_allclose(frf.response("y", "u2"), -4e7, rtol=1e-9)
    np.testing.assert_allclose(frf.coherence, 1.0, rtol=1e-9)


@pytest.mark.parametrize("share", [1.0, 0.2])
def test_multiple_coherence_is_the_share_of_both_inputs(share):
    """y = a u1 + b u2 + n: what the inputs explain over all, with their correlation."""
    u, gains = two_inputs(share), np.array([1.0, -2.0])
    explained = gains @ np.array([[1.0, np.sqrt(1 - share)], [np.sqrt(1 - share), 1.0]]) @ gains
    record = history(**u, y=gains[0] * u["u1"] + gains[1] * u["u2"] + 1.5 * white(3))
    frf = estimate_frf(record, inputs=["u1", "u2"], outputs=["y"], segment_duration=0.1)
    assert frf.coherence.mean() == pytest.approx(explained / (explained + 1.5**2), abs=0.01)


@pytest.mark.parametrize("own", [0.0, 1e-3])
def test_inputs_that_cannot_be_told_apart_are_refused(own):
    u = white(1)
    record = history(u1=u, other=white(5), u2=3e-6 * (u + own * white(2)), y=u)
    message = (
        r"cannot be separated at \d+ of 500 lines in 1 ... 500 Hz; their ordinary coherence there: "
        r"u1 and u2 (1.000000|0.99999.), u1 and other 0.0\d*, u2 and other 0.0\d*: drive them independently"
    )
    with pytest.raises(ValueError, match=message):
        estimate_frf(record, inputs=["u1", "u2", "other"], outputs=["y"], segment_duration=1.0)
    alone = estimate_frf(record, inputs=["u1", "other"], outputs=["y"], segment_duration=1.0)
    np.testing.assert_allclose(alone.response("y", "u1"), 1.0, rtol=1e-9)


def test_an_input_that_two_others_make_up_is_refused():
    record = history(a=white(1), b=white(2), c=white(1) + 1e-5 * white(2), d=white(3), y=white(4))
    with pytest.raises(ValueError, match=r"separated .* a and c 1\.000000"):
        estimate_frf(record, inputs=["a", "b", "c"], outputs=["y"], segment_duration=1.0)
    total = history(a=white(1), b=white(2), c=white(1) + white(2), y=white(4))
    with pytest.raises(ValueError, match=r"separated at 500 of 500 lines"):
        estimate_frf(total, inputs=["a", "b", "c"], outputs=["y"], segment_duration=1.0)


def test_few_lines_where_inputs_are_alike_are_set_to_zero_and_told():
    """Independent noise without content at 3 Hz, where two of three inputs hold the same small tone."""

    def but_at_3_hz(signal):
        lines = np.fft.rfft(signal.reshape(-1, int(RATE)))
        lines[:, 3] = 0.0
        return np.fft.irfft(lines).ravel()

    tone = 0.1 * np.cos(2 * np.pi * 3.0 * np.arange(N) / RATE)
    u1, u2 = (but_at_3_hz(white(seed)) + tone for seed in (1, 2))
    record = history(u1=u1, u2=u2, u3=white(3), y=2 * u1 + 5 * u2 + 7 * white(3))
    with pytest.warns(UserWarning, match=r"cannot be separated at 1 of 500 lines in 3 ... 3 Hz"):
        frf = estimate_frf(
            record, inputs=["u1", "u2", "u3"], outputs=["y"], segment_duration=1.0, window="boxcar", overlap=0.0
        )
    alike = frf.frequency == 3.0
    assert np.all(frf.values[..., alike] == 0)
    assert np.all(frf.coherence[:, alike] == 0)
    np.testing.assert_allclose(frf.response("y", "u2")[~alike], 5.0, rtol=1e-9)


def test_lines_without_power_are_zero_and_say_so():
    """Two periodic inputs: the one has 2 ... 300 Hz, the other 400 Hz; elsewhere is none."""
    options = {"period": 0.5, "rms": 1.0}
    u1 = multisine(5.0, RATE, lowest_frequency=2.0, highest_frequency=300.0, seed=2, **options).values[0]
    time = np.arange(len(u1)) / RATE
    u2 = 1e-6 * np.sin(2 * np.pi * 400.0 * time)
    record = history(u1=u1, u2=u2, y=2.0 * u1 + 3e6 * u2)
    frf = estimate_frf(record, inputs=["u1", "u2"], outputs=["y"], segment_duration=0.5, window="boxcar", overlap=0.0)
    first, second = frf.frequency <= 300.0, np.isclose(frf.frequency, 400.0)
    np.testing.assert_allclose(frf.response("y", "u1"), 2.0 * first, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(frf.response("y", "u2"), 3e6 * second, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(frf.coherence[0], first | second, rtol=1e-9)


def lines(*numbers):
    """A tenth of a second with lines of equal size at multiples of 10 Hz."""
    spectrum = np.zeros(51, dtype=complex)
    spectrum[list(numbers)] = np.exp(1j * np.arange(len(numbers)) ** 2)
    return np.fft.irfft(spectrum, 100)


def in_pieces(*inputs, method="H1"):
    """The response y = 2 u1 to inputs in pieces of a tenth of a second."""
    signals = {f"u{k + 1}": np.concatenate(pieces) for k, pieces in enumerate(inputs)}
    options = {"segment_duration": 0.1, "window": "boxcar", "overlap": 0.0, "method": method}
    record = history(**signals, y=2 * signals["u1"])
    return estimate_frf(record, inputs=list(signals), outputs=["y"], **options).response("y", "u1")


def test_inputs_are_told_apart_by_a_ten_thousandth_of_their_own():
    """The second input is the first, but for a share of its power that is orthogonal to it over three pieces."""
    w = lines(*range(1, 50))
    for share in (0.9e-4, 1.1e-4):
        common, own = np.sqrt(1 - share) * w, np.sqrt(1.5 * share) * w
        inputs = [w, w, w], [common + own, common - own, common]
        if share > 1e-4:
            assert in_pieces(*inputs)[:49] == pytest.approx(2.0, rel=1e-6)
        else:
            with pytest.raises(ValueError, match="cannot be separated at 49 of 50 lines"):
                in_pieces(*inputs)


def test_a_tenth_of_the_power_may_be_alike():
    """Four lines of forty are the same in both inputs."""
    for share in (0.09, 0.11):
        common, own = np.sqrt(9 * share / (1 - share)) * lines(1, 2, 3, 4), lines(*range(5, 41))
        inputs = [common + own] * 3, [common + own, common - own, common + own]
        if share < 0.1:
            with pytest.warns(UserWarning, match="cannot be separated at 4 of 50 lines in 10 ... 40 Hz"):
                assert in_pieces(*inputs)[:40] == pytest.approx([0.0] * 4 + [2.0] * 36)
        else:
            with pytest.raises(ValueError, match="cannot be separated at 4 of 50 lines"):
                in_pieces(*inputs)


@pytest.mark.parametrize("method", ["H1", "H2"])
def test_a_line_has_power_from_a_share_of_1e_20(method):
    """Of the power of the largest; a weaker line holds rounding errors, and the response there is zero."""
    for share in (0.9, 1.1):
        w = lines(1) + np.sqrt(share * 1e-20) * lines(2)
        assert in_pieces([w] * 2, method=method)[:2] == pytest.approx([2.0, 2.0 * (share > 1)], rel=1e-3)


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


@pytest.mark.parametrize("method", ["H1", "H2"])
def test_delay_is_a_linear_phase(method):
    u = white(4)
    record = history(u=u, y=np.roll(u, 3))
    frf = estimate_frf(record, inputs=["u"], outputs=["y"], segment_duration=1.0, method=method)
    np.testing.assert_allclose(frf.values[0, 0], np.exp(-2j * np.pi * frf.frequency * 3 / RATE), atol=0.02)


def estimate(**options):
    noise = band_limited_noise(1.0, RATE, cutoff_frequency=300.0, name="u")
    record = history(u=noise["u"], v=noise["u"][::-1], y=noise["u"], still=1 + 0 * noise["u"])
    return estimate_frf(record, **{"inputs": ["u"], "outputs": ["y"], "segment_duration": 0.1, **options})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inputs": ["w"]}, "unknown signal 'w'; known: u, v, y, still"),
        ({"outputs": ["w"]}, "unknown signal 'w'; known: u, v, y, still"),
        ({"method": "H3"}, "unknown method 'H3'; known: H1, H2"),
        ({"method": "H2", "inputs": ["u", "v"]}, "H2 needs exactly one input, got 2; take H1"),
        ({"segment_duration": 0.8}, "record of 1 s holds fewer than 2 segments of 0.8 s, .*record longer"),
        (
            {"inputs": ["u", "v"], "segment_duration": 0.6},
            r"fewer than 3 segments of 0.6 s, one more than inputs \(2\)",
        ),
        ({"segment_duration": 0.0}, "segment_duration must be positive"),
        ({"segment_duration": np.nan}, "NaN"),
        ({"overlap": 1.0}, r"overlap must lie in 0 ... 1 \(1 excluded\), got 1"),
        ({"overlap": -0.1}, "overlap must lie in 0"),
        ({"window": "hat"}, "window 'hat' is none of scipy.signal's"),
        ({"window": "kaiser"}, "window 'kaiser' is none of scipy.signal's: .*parameters"),
        ({"window": None}, "window None is none of scipy.signal's"),
        ({"overlap": 0.9999}, "overlap of 0.9999 leaves no new sample to a segment of 100"),
        ({"inputs": "u"}, r"input names must be a list of them, got the text 'u'; write \['u'\]"),
        ({"outputs": ["y", "y"]}, "output names must differ"),
        ({"inputs": []}, "name at least one input and one output; known signals: u, v, y"),
        ({"outputs": []}, "name at least one input and one output"),
        ({"inputs": ["still"]}, "input 'still' is constant"),
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
        ({"values": [[[1.0, 2.0, 3.0]], [[1.0, 2.0]]]}, "values must be complex numbers of shape"),
        ({"inputs": ("",)}, "input names must be non-empty"),
        ({"coherence": np.ones((1, 3))}, "coherence must have shape 2 x 3, got 1 x 3"),
        ({"coherence": np.full((2, 3), 1.1)}, r"coherence must lie in 0 ... 1, got 1.1 ... 1.1"),
        ({"coherence": np.full((2, 3), -0.1)}, r"coherence must lie in 0 ... 1"),
        ({"frequency": [1.0, 2.0, 3.0j]}, "frequency must be real numbers, got complex ones"),
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


def test_offsets_and_long_records_in_pieces(monkeypatch):
    """An offset is no response, and segments that are transformed in several goes give what they give in one."""
    u = np.random.default_rng(8).normal(size=7777)
    y = np.convolve(u, [0.5, 0.3, -0.2])[: len(u)]
    time, options = np.arange(len(u)) / 1e3, {"inputs": ["u"], "outputs": ["y"], "segment_duration": 0.123}
    plain = estimate_frf(TimeHistory(time, [u, y], ("u", "y")), **options)
    monkeypatch.setattr(nassim.signals.frf, "SAMPLES_PER_BLOCK", 300)
    pieces = estimate_frf(TimeHistory(time, [u + 1e3, y - 50.0], ("u", "y")), **options)
    np.testing.assert_allclose(pieces.values, plain.values, rtol=1e-9)
    np.testing.assert_allclose(pieces.coherence, plain.coherence, rtol=1e-9)
    # SciPy's own estimate: the same windows, mean values and averages.
    scipys = {"fs": 1e3, "nperseg": 123, "noverlap": 62, "detrend": "constant"}
    expected = scipy.signal.csd(u, y, **scipys)[1] / scipy.signal.welch(u, **scipys)[1]
    np.testing.assert_allclose(plain.response("y", "u"), expected[1:], rtol=1e-9)
