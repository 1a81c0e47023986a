import numpy as np
import pytest

from nassim.studies import Samples
from nassim.studies.plan import make_plan, run_key, run_seed


def test_a_grid_is_all_combinations():
    plan = make_plan({"a": [1, 2], "b": np.array([0.5, 1.5, 2.5])}, None)
    assert (plan.dims, plan.shape, len(plan)) == (("a", "b"), (2, 3), 6)
    assert [(run["a"], run["b"]) for run in plan.runs()] == [(a, b) for a in (1, 2) for b in (0.5, 1.5, 2.5)]
    assert all(type(run["b"]) is float for run in plan.runs())


@pytest.mark.parametrize(
    "samples", [{"a": [1.0, 2.0], "b": (3.0, 4.0)}, Samples(("a", "b"), [[1.0, 3.0], [2.0, 4.0]], "plan")]
)
def test_samples_are_rows(samples):
    plan = make_plan(None, samples)
    assert (plan.dims, plan.shape) == (("run",), (2,))
    assert list(plan.runs()) == [{"a": 1.0, "b": 3.0}, {"a": 2.0, "b": 4.0}]


def test_a_run_is_known_by_its_values_alone():
    assert run_key({"a": 1, "b": 0.1}) == run_key({"b": np.float64(0.1).item(), "a": 1.0})
    assert run_key({"a": 0.0}) == run_key({"a": -0.0})
    different = [{"a": 1.0}, {"b": 1.0}, {"a": 1.0 + 2**-52}, {"a": True}, {"a": "1"}, {"a": 2**53}, {"a": 2**53 + 1}]
    assert len({run_key(parameters) for parameters in different}) == len(different)


def test_seeds_follow_from_study_and_run():
    keys = [run_key({"a": float(a)}) for a in range(100)]
    seeds = {run_seed(study, key) for study in (0, 1) for key in keys}
    assert len(seeds) == 200
    # By NumPy's documented hashing of words, on any machine.
    words = [int(keys[7][i : i + 8], 16) for i in (0, 8, 16, 24)]
    assert run_seed(3, keys[7]) == np.random.SeedSequence([3, *words]).generate_state(1, np.uint64)[0]


@pytest.mark.parametrize(
    ("grid", "samples", "message"),
    [
        (None, None, "either grid= or samples="),
        ({"a": [1]}, {"a": [1]}, "either grid= or samples="),
        ({}, None, "at least one parameter"),
        ({"a": [], "b": [1]}, None, "no run: there is no value of a"),
        (None, {"a": []}, "no run"),
        (None, {"a": [1, 2], "b": [1]}, r"as many as \{'a': 2, 'b': 1\}"),
        ({"a": 5.0}, None, r"write \[5.0\]"),
        ({"a": "text"}, None, r"write \['text'\]"),
        ({"a": [1, "x"]}, None, "all be numbers, or all texts"),
        ({"a": [None]}, None, "got NoneType"),
        ({"a": np.array(1.0)}, None, r"values of .a. must be a list or an array, got array\(1\.\); write"),
        ({"a": [1.0, np.inf]}, None, "must be finite, got inf"),
        ({"a": [1, 10**400]}, None, "must be finite, got 1000"),
        ({"a": [1, 2, 1]}, None, r"more than once in 'a': \[1\]"),
        ({"status": [1]}, None, r"no parameter can be called \['status'\]"),
        ([1, 2], None, "grid must be a mapping"),
        (None, [1, 2], "samples must be Samples or a mapping"),
    ],
)
def test_what_is_no_plan_is_refused(grid, samples, message):
    with pytest.raises(ValueError, match=message):
        make_plan(grid, samples)
