"""States of records and files that are rare: several signals, no units, comments, one sample."""

import numpy as np
import pytest

from nassim import FRF, TimeHistory, estimate_frf, read_record
from nassim.signals import DriveLimits, check_path, read_measurement, spectral_noise, write_record

TIME = np.arange(5) / 10.0
TWO = TimeHistory(TIME, [[0.0, 3.0, -1.0, 2.0, 1.0], [5.0, 6.0, -9.0, 8.0, -2.0]], ("a", "b"), ("V", ""))


def test_a_record_tells_the_range_of_every_signal():
    rows = [line.split() for line in str(TWO).splitlines()]
    assert ["a", "V", "-1", "3", "1"] in rows
    assert ["b", "-", "-9", "8", "-2"] in rows
    assert rows[0] == ["5", "samples", "from", "0", "s", "to", "0.4", "s,", "10", "Hz"]


def test_signals_without_units_and_comments_go_through_files(tmp_path):
    path = write_record(TWO, tmp_path / "two.csv")
    assert read_record(path).units[0] == "V"
    np.testing.assert_allclose(read_record(path).values, TWO.values)
    path.write_text("# made by hand\n\n" + path.read_text())
    np.testing.assert_allclose(read_measurement(path).values, TWO.values)
    path.write_text("# made by hand\n\nfrequency [Hz],y/u real [m/V],y/u imag [m/V]\n1,2,3\n2,3,4\n")
    assert isinstance(read_measurement(path), FRF)


def test_every_drive_is_checked_also_without_a_unit():
    fast, slow = DriveLimits(1e3, 1e4, 1e5), DriveLimits(9.0, 1e4, 1e5)
    check_path(TWO, {"a": fast, "b": fast})
    with pytest.raises(ValueError, match="path 'b': its travel reaches 14 units, but its limit is 9 units"):
        check_path(TWO, {"a": fast, "b": slow})


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: TimeHistory(TIME, [0.0, 1.0, np.nan, 3.0, 4.0], ("a",)), "NaN or infinite"),
        (lambda: TimeHistory([0.0, 0.1, 0.2, 0.15, 0.4], TWO.values, ("a", "b")), "from -0.05 s to 0.25 s"),
        (lambda: FRF([1.0, 2.0], [[[1.0, np.inf]]], ("y",), ("u",)), "NaN or infinite|finite"),
        (lambda: FRF([1.0, 2.0], [[[1.0, 1.0]]], ("y",), ("u",), [[0.5, -0.5]]), "coherence"),
        (lambda: estimate_frf(TWO, inputs=["a"], outputs=["b"], segment_duration=0.1), "fewer than 2 segments"),
        (
            lambda: spectral_noise({"a": 1.0, "b": 1.0}, 1.0, 100.0, units={"a": "V", "c": "m"}),
            "unknown signal 'c'; known: a, b",
        ),
    ],
    ids=["a value", "a time", "a response", "a coherence", "one sample a segment", "a unit"],
)
def test_what_only_a_later_entry_shows_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_units_of_noise_are_those_of_their_signals():
    noise = spectral_noise({"a": 1.0, "b": 1.0, "c": 1.0}, 1.0, 100.0, units={"c": "m", "a": "V"})
    assert noise.units == ("V", "", "m")
