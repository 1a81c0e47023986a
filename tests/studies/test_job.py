import functools
import math
import pickle
import threading

import numpy as np
import pytest
import tiny_functions

from nassim import TimeHistory
from nassim.studies.job import identity, label, make_job, packed

LOCK = threading.Lock()
FACTOR = 2.0


def uses_a_lock(a):
    with LOCK:
        return a


def scaled(a):
    return helped(a) * FACTOR


def helped(a):
    return a + 1


@pytest.mark.parametrize(
    ("function", "names", "seed", "message"),
    [
        (5, ("a",), None, "needs a function, got 5, a int"),
        (
            tiny_functions.product,
            ("a", "c", "d"),
            None,
            r"unknown parameters c, d: tiny_functions\.product takes a, b$",
        ),
        (tiny_functions.product, ("b",), None, "needs values of a beside what the study gives"),
        (tiny_functions.noisy, ("a",), None, "needs values of seed"),
        (
            tiny_functions.product,
            ("a",),
            1,
            "seed is given to the function's parameter of that name, but .* takes a, b",
        ),
        (tiny_functions.noisy, ("a", "seed"), 1, "but the study varies it"),
        (tiny_functions.noisy, ("a",), -1, "whole number of at least 0, got -1"),
        (tiny_functions.noisy, ("a",), 1.5, "whole number of at least 0, got 1.5"),
        (math.hypot, ("a",), None, "math.hypot"),
    ],
)
def test_functions_that_do_not_fit_the_study_are_refused(function, names, seed, message):
    with pytest.raises(ValueError, match=message):
        make_job(function, names, seed)


def test_any_keyword_is_known_to_a_function_that_takes_any():
    job = make_job(lambda **parameters: sum(parameters.values()), ("a", "b"), None)
    assert job.arguments({"a": 1, "b": 2}, "00" * 16) == {"a": 1, "b": 2}


def test_fixed_arguments_need_no_value():
    make_job(functools.partial(tiny_functions.count_calls, calls="file"), ("a",), None)
    assert label(functools.partial(tiny_functions.product, b=3.0)) == "tiny_functions.product"


def test_functions_travel_by_value_where_they_have_no_module():
    factor = np.arange(3.0)
    job = make_job(lambda a: a * factor, ("a",), None)
    outcome = pickle.loads(packed(job))({"a": 2.0})
    np.testing.assert_array_equal(outcome.layout.arrays(outcome.data)["result"], [0.0, 2.0, 4.0])


@pytest.mark.parametrize("fixed", [False, True], ids=["around it", "fixed"])
def test_what_cannot_travel_is_named(fixed, tmp_path):
    with (tmp_path / "log").open("w") as log:
        function = functools.partial(lambda a, log: a, log=log) if fixed else lambda a: log.write(str(a))
        with pytest.raises(
            ValueError, match=r"cannot be sent .* because of log, a TextIOWrapper .*executor=\"serial\""
        ):
            packed(make_job(function, ("a",), None))


def test_functions_of_modules_travel_by_name_whatever_they_use():
    assert identity(make_job(uses_a_lock, ("a",), None))["inputs"] == {"LOCK": "lock"}
    assert len(packed(make_job(uses_a_lock, ("a",), None))) < 500


def makes(values, text="x"):
    def function(a, shift=1.0):
        return a + values[0] + len(text) + shift

    return function


def known_by(function, seed=None):
    return identity(make_job(function, ("a",), seed))


def test_a_study_is_known_by_its_function_and_all_that_this_carries(monkeypatch):
    record = TimeHistory([0.0, 1.0], [[1.0, 2.0]], ("u",), ("V",))
    other = TimeHistory([0.0, 1.0], [[1.0, 3.0]], ("u",), ("V",))
    assert known_by(makes(np.ones(3))) == known_by(makes(np.ones(3)))
    assert known_by(makes(np.ones(3))) != known_by(makes(np.zeros(3)))
    for one, two in ((record, other), (np.ones(2), np.zeros(2)), ({"k": 1.0}, {"k": 2.0}), ({3, 4}, {3, 5})):
        first, second = (known_by(functools.partial(tiny_functions.product, b=value)) for value in (one, two))
        assert first == known_by(functools.partial(tiny_functions.product, b=one))
        assert {key for key in first if first[key] != second[key]} == {"inputs"}
    before = known_by(scaled)
    assert {"FACTOR", "helped"} <= set(before["inputs"])
    monkeypatch.setattr(f"{__name__}.FACTOR", 3.0)
    assert known_by(scaled)["inputs"]["FACTOR"] != before["inputs"]["FACTOR"]
    assert known_by(scaled)["inputs"]["helped"] == before["inputs"]["helped"]


def test_sources_are_compared_without_their_comments():
    one, two, three = {}, {}, {}
    exec("def f(a):\n    return a + 1\n", one)
    exec("def f(a):\n\n    return a + 1\n", two)
    exec("def f(a):\n    return a + 2\n", three)
    first, second, third = (known_by(found["f"])["source"] for found in (one, two, three))
    assert first == second != third
