import numpy as np
import pytest

from nassim import load, save
from nassim.studies import Samples

SAMPLES = Samples(("mass", "gain"), [[1.0, 10.0], [2.0, 20.0], [3.0, 30.0]], "by hand")


def test_runs_are_keywords_in_order():
    assert list(SAMPLES.runs()) == [{"mass": m, "gain": 10 * m} for m in (1.0, 2.0, 3.0)]
    assert len(SAMPLES) == 3
    np.testing.assert_array_equal(SAMPLES["gain"], [10.0, 20.0, 30.0])
    with pytest.raises(ValueError, match="unknown parameter 'gian'; known: mass, gain"):
        SAMPLES["gian"]


def test_samples_are_frozen_and_saved(tmp_path):
    with pytest.raises(ValueError, match="read-only"):
        SAMPLES.values[0, 0] = 5.0
    found = load(save(SAMPLES, tmp_path / "samples.h5"))
    assert (found.names, found.plan) == (SAMPLES.names, "by hand")
    np.testing.assert_array_equal(found.values, SAMPLES.values)


@pytest.mark.parametrize(
    ("names", "values", "message"),
    [
        ((), np.zeros((3, 0)), "at least one parameter"),
        (("a",), np.zeros((0, 1)), "no run"),
        (("a", "b"), np.zeros((3, 1)), "shape any x 2, got 3 x 1"),
        (("a",), [[np.nan]], "NaN"),
        (("a", "a"), np.zeros((1, 2)), "used more than once: a"),
        (("a b", "lambda"), np.zeros((1, 2)), r"these are not: \['a b', 'lambda'\]"),
    ],
)
def test_what_is_no_plan_is_refused(names, values, message):
    with pytest.raises(ValueError, match=message):
        Samples(names, values)
