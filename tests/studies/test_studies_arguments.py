"""What every optional argument of studies does."""

import os
from functools import partial

import numpy as np
import pytest
import tiny_functions
import xarray as xr
from arguments import assert_all_tried, table
from scipy import stats

import nassim.studies
from nassim.studies import (
    Samples,
    correlations,
    linear_effects,
    saltelli_points,
    sobol_indices,
    sweep,
    sweeping,
)

POINTS = saltelli_points({"u": stats.uniform(), "v": stats.uniform(2.0, 3.0)}, 32, seed=0)
DATA = xr.Dataset(
    {"f": ("run", POINTS["u"] ** 2 + 5 * POINTS["v"]), "g": ("run", 3 * POINTS["u"] - POINTS["v"] ** 2)},
    {name: ("run", POINTS[name]) for name in POINTS.names},
)


def analysis(verb, *names, **fixed):
    """Names of results, then figures of an analysis."""

    def call(**options):
        found = verb(DATA, **{**fixed, **options})
        return (*found.result.values.tolist(), *(found[name].values for name in names))

    return call


def named(before, after):
    return before[:2] == ("f", "g") and after[0] == "g" and np.allclose(after[1], before[2][1:], rtol=1e-9)


def width(found):
    return np.diff(found[-1], axis=-1)


def narrower(before, after):
    """Between two resamples an interval is as wide as its confidence is high."""
    return np.all(width(before) > 0) and np.allclose(0.95 * width(after), 0.5 * width(before))


def other_range(before, after):
    """Of all values, or of those that the ninth of ten lies between."""
    whole, tenths = (np.ptp(np.quantile(POINTS.values, tails, axis=0), axis=0) for tails in ([0, 1], [0.05, 0.95]))
    return np.allclose(before[-1] * whole, after[-1] * tenths)


ARGUMENTS = table(
    {
        "Samples": partial(Samples, ("a",), [[1.0]]),
        "sobol_indices": analysis(sobol_indices, "total_interval"),
        "correlations": analysis(correlations, "pearson"),
        "linear_effects": analysis(linear_effects, "effect"),
    },
    [
        ("Samples", "plan", "", "by hand", lambda before, after: (before.plan, after.plan) == ("", "by hand")),
        ("correlations", "results", None, ["g"], named),
        ("linear_effects", "results", None, ["g"], named),
        ("linear_effects", "coverage", 0.9, 1.0, other_range),
        (
            "sobol_indices",
            "n_resamples",
            500,
            1,
            lambda _, after: not np.any(width(after)),
        ),
        ("sobol_indices", "seed", 0, 7, lambda before, after: not np.any(before[-1] == after[-1])),
    ],
) | table(
    {"sobol_indices": analysis(sobol_indices, "total_interval", n_resamples=2)},
    [
        ("sobol_indices", "results", None, ["g"], named),
        ("sobol_indices", "confidence", 0.95, 0.5, narrower),
    ],
)
SWEEPS, HERE = "studies/test_sweeping.py", "studies/test_studies_arguments.py"
ELSEWHERE = {
    "sweep: grid": f"{SWEEPS}::test_a_grid_has_a_dimension_per_parameter_and_units",
    "sweep: units": f"{SWEEPS}::test_a_grid_has_a_dimension_per_parameter_and_units",
    "sweep: samples": f"{SWEEPS}::test_samples_have_one_dimension",
    "sweep: seed": f"{SWEEPS}::test_seeds_depend_on_neither_order_nor_company",
    "sweep: retry": f"{HERE}::test_runs_in_a_folder_are_repeated_only_when_asked",
    "sweep: folder": f"{SWEEPS}::test_only_what_a_folder_does_not_hold_is_run",
    "sweep: executor": f"{HERE}::test_runs_get_the_limits_asked_for_and_as_many_processors_as_there_are",
    "sweep: time_limit": f"{HERE}::test_runs_get_the_limits_asked_for_and_as_many_processors_as_there_are",
    "sweep: n_processes": f"{HERE}::test_runs_get_the_limits_asked_for_and_as_many_processors_as_there_are",
    "sweep: progress": f"{HERE}::test_progress_is_told_unless_it_is_not_wanted",
}


@pytest.mark.parametrize("case", ARGUMENTS)
def test_an_optional_argument_does_what_it_should(case):
    ARGUMENTS[case].check()


def test_every_optional_argument_is_tried():
    assert_all_tried(nassim.studies, ARGUMENTS, ELSEWHERE)


def test_runs_get_the_limits_asked_for_and_as_many_processors_as_there_are(monkeypatch):
    """Where nothing else is asked for, runs happen in children, all that there can be, for as long as they take."""
    asked = []

    def run_here(_payload, requests, *options):
        asked.append(options)
        yield from sweeping.run_serially(sweeping.make_job(tiny_functions.product, ("a", "b"), None).task, requests)

    monkeypatch.setattr(sweeping, "run_in_children", run_here)
    monkeypatch.setattr(sweeping, "run_on_executor", run_here)
    study, elsewhere = (
        partial(sweep, tiny_functions.product, grid={"a": [1.0], "b": [2.0]}, progress=False),
        Elsewhere(),
    )
    for options in (
        {},
        {"executor": None, "time_limit": None, "n_processes": None},
        {"time_limit": 5, "n_processes": 3},
        {"executor": elsewhere},
        {"executor": elsewhere, "time_limit": 7},
    ):
        assert study(**options).result.item() == 2.0
    there_are = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    assert asked == [(None, there_are), (None, there_are), (5.0, 3), (None, elsewhere), (7.0, elsewhere)]


class Elsewhere:
    """An executor that has nothing to do."""

    def submit(self):
        """Never called."""


def test_runs_in_a_folder_are_repeated_only_when_asked(tmp_path):
    """A run that fails at first is not tried again by the same call."""
    function = partial(tiny_functions.fails_at_first, calls=str(tmp_path / "calls"))
    study = partial(sweep, function, grid={"a": [1.0]}, folder=tmp_path / "study", executor="serial", progress=False)
    for options in {}, {}, {"retry": ()}:
        with pytest.warns(UserWarning, match="no run"):
            assert study(**options).status.item() == "failed"
    assert study(retry=["failed"]).status.item() == "ok"


def test_progress_is_told_unless_it_is_not_wanted(capfd, tmp_path, monkeypatch):
    """And without a folder no file is written."""
    monkeypatch.chdir(tmp_path)
    for options in {}, {"progress": True}, {"progress": False}:
        sweep(tiny_functions.product, grid={"a": [1.0], "b": [2.0]}, executor="serial", **options)
        told = "".join(capfd.readouterr())
        assert ("study" in told) == options.get("progress", True)
    assert not list(tmp_path.iterdir())
