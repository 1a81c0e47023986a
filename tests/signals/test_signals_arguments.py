"""What every optional argument of the verbs of signals does, and limits a tenth below and above."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import scipy.signal
from arguments import assert_all_tried, is_now, table
from conftest import assert_limit

from nassim import signals
from nassim.signals import (
    FRF,
    TabulatedSpectrum,
    TimeHistory,
    amplifier_noise,
    band_limited_noise,
    chirp,
    differentiate_spectrum,
    estimate_frf,
    low_pass,
    multisine,
    occupied_bandwidth,
    orthogonal_multisines,
    read_frf,
    read_record,
    remove_settling,
    sine_dwell,
    step,
    write_record,
)

RATE = 200.0
F = np.array([2.0, 30.0, 70.0])
COHERENCE = np.full((1, 3), 0.5)
BAND = {"lowest_frequency": 1.0, "highest_frequency": 60.0, "period": 1.0}
IMPULSE = np.eye(1, 4000)[0]
WHITE = np.random.default_rng(1).normal(size=(2, 4001))
RECORD = TimeHistory(np.arange(4001) / RATE, [WHITE[0], np.roll(WHITE[0], 2) + 0.5 * WHITE[1]], ("u", "y"), ("V", "m"))


def scaled(factor):
    return lambda before, after: np.allclose(after.values, factor * before.values, rtol=1e-12)


def are(*expected, atol=0.0):
    return lambda *results: np.allclose(results, expected, rtol=1e-12, atol=atol)


def periods(*expected):
    return lambda *results: [len(record.time) for record in results] == [1 + round(RATE) * n for n in expected]


def half_a_cosine(_, after):
    rise = 0.5 + np.sqrt(0.125) * np.array([-1, 0, 1])
    return np.allclose(after.values[0, ::25][:6], [0, *rise, 1, 1])


def ramped_sine(time):
    return np.minimum(time / 0.5, 1) * np.sin(2 * np.pi * 7.0 * time)


def other_phases(before, after):
    return np.abs(after.values - before.values).max() > 0.1 * np.abs(before.values).max()


def butterworth(response, order):
    """Of the bilinear transform, by its impulse response."""
    at = np.exp(-2j * np.pi * np.outer(F, np.arange(len(response))) / RATE) @ response
    warped = np.tan(np.pi * F / RATE) / np.tan(np.pi * 30.0 / RATE)
    return np.allclose(np.abs(at), 1 / np.sqrt(1 + warped ** (2 * order)), rtol=1e-9)


def welch(frf, window="hann", overlap=50, method="H1"):
    """Whether an FRF is that of SciPy's spectra."""
    options = {"fs": RATE, "nperseg": 100, "noverlap": overlap, "window": window, "detrend": "constant"}
    yu, uu, yy = (scipy.signal.csd(*RECORD.values[pair], **options)[1][1:] for pair in ([0, 1], [0, 0], [1, 1]))
    return np.allclose(frf.values[0, 0], yu / uu if method == "H1" else yy / yu.conj(), rtol=1e-9)


CALLS = {
    "low_pass": partial(low_pass, IMPULSE, cutoff_frequency=30.0, sample_rate=RATE),
    "band_limited_noise": partial(band_limited_noise, 3.0, RATE, cutoff_frequency=30.0),
    "chirp": partial(chirp, 3.0, RATE, start_frequency=1.0, end_frequency=50.0),
    "multisine": partial(multisine, 3.0, RATE, **BAND),
    "orthogonal_multisines": partial(orthogonal_multisines, ("a", "b"), RATE, **BAND),
    "step": partial(step, 2.0, RATE),
    "sine_dwell": partial(sine_dwell, 2.0, RATE, frequency=7.0),
    "estimate_frf": partial(estimate_frf, RECORD, inputs=["u"], outputs=["y"], segment_duration=0.5),
    "occupied_bandwidth": lambda **options: occupied_bandwidth(multisine(20.0, RATE, **BAND), **options),
    "amplifier_noise": lambda **options: amplifier_noise(3.0, **options)(F),
    "differentiate_spectrum": lambda **options: differentiate_spectrum(amplifier_noise(1.0), **options)(F),
    "FRF": partial(FRF, F, np.ones((1, 1, 3)), ("y",), ("u",)),
    "TimeHistory": partial(TimeHistory, [0.0, 1.0], np.ones((1, 2)), ("y",)),
}
SINGLE = ("band_limited_noise", "chirp", "multisine", "step", "sine_dwell")
RANDOM = ("band_limited_noise", "multisine", "orthogonal_multisines")
ARGUMENTS = table(
    CALLS,
    [
        ("low_pass", "order", 4, 2, lambda before, after: butterworth(before, 4) and butterworth(after, 2)),
        ("step", "start", 0.0, 0.5, lambda _, after: np.array_equal(after["actuator_voltage"], after.time >= 0.5)),
        ("step", "rise_time", 0.0, 0.5, half_a_cosine),
        ("sine_dwell", "ramp_time", 0.0, 0.5, lambda _, after: np.allclose(after.values, ramped_sine(after.time))),
        ("orthogonal_multisines", "n_settling", 1, 3, periods(6, 10)),
        ("orthogonal_multisines", "n_periods", 2, 5, periods(6, 12)),
        ("estimate_frf", "overlap", 0.5, 0.2, lambda before, after: welch(before) and welch(after, overlap=20)),
        ("estimate_frf", "window", "hann", "boxcar", lambda before, after: welch(before) and welch(after, "boxcar")),
        ("estimate_frf", "method", "H1", "H2", lambda before, after: welch(before) and welch(after, method="H2")),
        ("estimate_frf", "label", "", "here", is_now("label", "here")),
        # Sixty lines of equal power.
        ("occupied_bandwidth", "power_fraction", 0.99, 0.5, are(60.0, 30.0, atol=0.6)),
        ("amplifier_noise", "corner_frequency", 0.0, 5.0, are(np.full(3, 9.0), 9 * (1 + 5 / F))),
        ("differentiate_spectrum", "times", 1, -2, are((2 * np.pi * F) ** 2, (2 * np.pi * F) ** -4.0)),
        ("FRF", "coherence", None, COHERENCE, lambda _, after: np.array_equal(after.coherence, COHERENCE)),
        ("FRF", "label", "", "here", is_now("label", "here")),
        ("TimeHistory", "units", ("",), ("m",), is_now("units", ("m",))),
        ("TimeHistory", "notes", (), ("loop",), is_now("notes", ("loop",))),
        *((verb, "amplitude", 1.0, -3.0, scaled(-3.0)) for verb in ("chirp", "step", "sine_dwell")),
        *((verb, "rms", 1.0, 3.0, scaled(3.0)) for verb in RANDOM),
        *((verb, "seed", 0, 7, other_phases) for verb in RANDOM),
        *((verb, "name", "actuator_voltage", "f", is_now("names", ("f",))) for verb in SINGLE),
        *((verb, "unit", "V", "N", is_now("units", ("N",))) for verb in SINGLE),
        ("orthogonal_multisines", "unit", "V", "N", is_now("units", ("N", "N"))),
    ],
)


@pytest.mark.parametrize("case", ARGUMENTS)
def test_an_optional_argument_does_what_it_should(case):
    ARGUMENTS[case].check()


def test_optional_arguments_of_files(tmp_path):
    path = write_record(RECORD, tmp_path / "record.csv")
    assert read_record(path).names == ("u", "y")
    assert np.allclose(read_record(path, names=["y"]).values, RECORD.values[1:])
    turned = read_record(path, names=["y", "u"])
    assert turned.names == ("y", "u")
    assert np.allclose(turned.values, RECORD.values[::-1])
    path.write_text("frequency [Hz],y/u real [m/V],y/u imag [m/V]\n1,2,3\n2,3,4\n")
    assert (read_frf(path).label, read_frf(path, label="here").label) == ("recorded", "here")


def test_every_optional_argument_is_here():
    here = "signals/test_signals_arguments.py::test_optional_arguments_of_files"
    noise = "signals/test_excitations.py::test_noises_have_their_spectra_and_are_independent"
    of_noise = {f"spectral_noise: {name}": noise for name in ("band", "seed", "units")}
    elsewhere = {"read_record: names": here, "read_frf: label": here, **of_noise}
    assert_all_tried(signals, ARGUMENTS, elsewhere)


def test_printed_times_may_be_off_by_a_hundredth_of_a_step(tmp_path):
    for share in (0.9, 1.1):
        path = tmp_path / f"{share}.csv"
        path.write_text(f"time [s],y [m]\n0,1\n1,2\n{2 + 0.01 * share},3\n3,4\n4,5\n")
        if share < 1:
            assert np.allclose(read_record(path).time, range(5))
        else:
            with pytest.raises(ValueError, match="unequal sampling"):
                read_record(path)


PLAIN = FRF(F, np.ones((1, 1, 3)), ("y",), ("u",))
TABLE = TabulatedSpectrum([1.0, 2.0], [1.0, 1.0])
LIMITS = {
    "unequal sampling": (lambda x: TimeHistory([0, 1, 2 + 1e-6 * x], np.ones((1, 3)), ("y",)), "equal steps"),
    "coherence above one": (lambda x: replace(PLAIN, coherence=np.full((1, 3), 1 + 1e-6 * x)), "coherence must lie"),
    "table's lower end": (lambda x: TABLE(np.array([1 - 1e-9 * x, 1.5])), "from 1 to 2 Hz"),
    "table's upper end": (lambda x: TABLE(np.array([1.5, 2 + 2e-9 * x])), "from 1 to 2 Hz"),
    "overlap": (
        lambda x: estimate_frf(RECORD, inputs=["u"], outputs=["y"], segment_duration=1.0, overlap=x),
        "overlap",
    ),
    "segments": (lambda x: CALLS["estimate_frf"](segment_duration=x * 4001 / 1.5 / RATE), "fewer than 2 segments"),
    "cutoff at Nyquist": (lambda x: low_pass(IMPULSE, cutoff_frequency=x * RATE / 2, sample_rate=RATE), "half the"),
    "chirp to Nyquist": (
        lambda x: chirp(1.0, RATE, start_frequency=1.0, end_frequency=x * RATE / 2),
        "end_frequency must",
    ),
    "chirp from Nyquist": (
        lambda x: chirp(1.0, RATE, start_frequency=x * RATE / 2, end_frequency=9.0),
        "start_frequency",
    ),
    "dwell at Nyquist": (lambda x: sine_dwell(1.0, RATE, frequency=x * RATE / 2), "half the"),
    "lines at Nyquist": (lambda x: multisine(2.0, RATE, **{**BAND, "highest_frequency": x * RATE / 2}), "half the"),
    "a period of samples": (lambda x: multisine(2.0, RATE, **{**BAND, "period": 1 + 1e-9 * x}), "whole number"),
    "no line in the band": (lambda x: multisine(2.0, RATE, **{**BAND, "highest_frequency": 1 / x}), "no multiple of"),
    "a block's samples": (lambda x: remove_settling(RECORD, duration=5 + 5e-6 * x, settling=1.0), "whole number"),
    "nothing left of a block": (lambda x: remove_settling(RECORD, duration=10.0, settling=10 * x), "leaves no samples"),
    "steps of a signal": (lambda x: step(1.5 / RATE / x, RATE), "fewer than 2 steps"),
}


@pytest.mark.parametrize("case", LIMITS)
def test_limits_lie_where_they_should(case):
    assert_limit(*LIMITS[case])
