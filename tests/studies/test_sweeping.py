"""Sweeps on this machine: the same numbers wherever they run, failure as data, and a folder to go on from."""

import functools
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import psutil
import pytest
import tiny_functions
import xarray as xr
from conftest import lattice

from nassim import craig_bampton
from nassim.studies import Samples, executors, sweep
from nassim.studies.child_processes import THREADS

HERE = Path(__file__).parent
quiet = functools.partial(sweep, progress=False)


def same(one, other):
    return one.drop_vars("wall_time").identical(other.drop_vars("wall_time"))


def children():
    return [child for child in psutil.Process().children() if "serve()" in " ".join(child.cmdline())]


def test_a_grid_has_a_dimension_per_parameter_and_units():
    found = quiet(
        tiny_functions.product,
        grid={"a": [1, 2, 3], "b": [0.5, 7.0]},
        executor="serial",
        units={"a": "kg", "result": "N"},
    )
    assert found.result.dims == ("a", "b")
    np.testing.assert_array_equal(found.result, np.outer([1, 2, 3], [0.5, 7.0]))
    assert float(found.result.sel(a=2, b=7.0)) == 14.0
    assert (found.a.attrs["units"], found.result.attrs["units"], found.wall_time.attrs["units"]) == ("kg", "N", "s")
    assert found.attrs["function"] == "tiny_functions.product"


def test_samples_have_one_dimension():
    samples = Samples(("a", "b"), [[1.0, 2.0], [3.0, 4.0], [1.0, 2.0]], "by hand")
    found = quiet(tiny_functions.product, samples=samples, executor="serial")
    assert found.result.dims == ("run",)
    np.testing.assert_array_equal(found.result, [2.0, 12.0, 2.0])
    np.testing.assert_array_equal(found.coords["b"], [2.0, 4.0, 2.0])
    assert found.attrs["plan"] == "by hand"


def test_all_kinds_of_results_survive_a_file(tmp_path):
    grid = {"a": [3.0, 5.0], "gain": [1.0, 2.0]}
    found = quiet(tiny_functions.everything, grid=grid, executor="serial")
    assert found.frf.dims == ("a", "gain", "output", "input", "frequency")
    assert found.history.dims == ("a", "gain", "signal", "time")
    expected = tiny_functions.everything(5.0, 2.0)
    one = found.sel(a=5.0, gain=2.0)
    np.testing.assert_array_equal(one.frf, expected["frf"].values)
    np.testing.assert_array_equal(one.history.sel(signal="y"), expected["history"]["y"])
    np.testing.assert_array_equal(one.powers, expected["powers"])
    assert found.frequency.attrs["units"] == "Hz"
    assert found.signal_unit.values.tolist() == ["V", "m"]
    found.to_netcdf(tmp_path / "study.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "study.nc", engine="h5netcdf") as loaded:
        assert loaded.identical(found)
        assert loaded.frf.dtype == complex


def test_seeds_depend_on_neither_order_nor_company():
    forth = quiet(tiny_functions.noisy, grid={"a": [1.0, 2.0, 3.0]}, seed=4, executor="serial")
    back = quiet(tiny_functions.noisy, samples={"a": [3.0, 1.0]}, seed=4, executor="serial")
    np.testing.assert_array_equal(forth.result.values[[2, 0]], back.result)
    other = quiet(tiny_functions.noisy, grid={"a": [1.0, 2.0, 3.0]}, seed=5, executor="serial")
    assert not (forth.result == other.result).any()
    noise = forth.result - forth.a
    assert len(set(noise.values)) == 3


def test_processes_give_what_the_serial_loop_gives_bit_for_bit():
    function = functools.partial(tiny_functions.bench, body=craig_bampton(lattice(), n_modes=6, progress=False))
    grid = {"mass": [0.5, 1.0, 2.0], "offset": [0.01, 0.02]}
    serial = quiet(function, grid=grid, executor="serial")
    assert (serial.status == "ok").all()
    assert same(serial, quiet(function, grid=grid, n_processes=1))
    heavier = serial.modes.isel(modes_0=0).values
    assert (np.diff(heavier, axis=0) < 0).all()


@pytest.mark.parametrize(
    "make",
    [lambda: ThreadPoolExecutor(2), lambda: ProcessPoolExecutor(1, get_context("spawn"))],
    ids=["threads", "processes"],
)
def test_any_executor_runs_them_in_children_with_one_thread(make, monkeypatch):
    for name in THREADS:
        monkeypatch.setenv(name, "2")
    with make() as executor:
        found = quiet(tiny_functions.surroundings, grid={"a": [1.0, 2.0]}, executor=executor, time_limit=60.0)
    assert (found.status == "ok").all()
    assert (found.threads == 1).all()
    assert (found.parent != os.getppid()).all()
    assert os.getpid() not in found.process.values


def test_trouble_is_rows_with_a_status():
    before = set(children())  # those of an executor's threads stay for a while
    found = quiet(tiny_functions.troublesome, grid={"n": range(20)}, n_processes=2, time_limit=2.0)
    states = dict.fromkeys(range(20), "ok") | {3: "failed", 13: "failed", 4: "timed out"}
    states |= {5: "other shape", 6: "diverged", 7: "lost"}
    assert found.status.values.tolist() == list(states.values())
    message = dict(enumerate(found.message.values))
    assert message[3] == "RuntimeError: run 3 does not converge"
    assert message[4] == "stopped at its time limit of 2 s"
    assert found.wall_time[4] == 2.0
    assert message[5] == "x is 3, in most runs a number"
    assert message[6] == "there is NaN in x"
    assert message[7] == "its process ended 3 times, the last time with status 5"
    good = found.status == "ok"
    np.testing.assert_array_equal(found.x.where(good, drop=True), [n for n in range(20) if states[n] == "ok"])
    assert np.isnan(found.x.where(~good, drop=True)).all()
    assert set(children()) <= before, "all children are gone"


def test_most_runs_say_what_shape_results_have():
    found = quiet(tiny_functions.troublesome, grid={"n": [5, 8, 9]}, executor="serial")
    assert found.status.values.tolist() == ["other shape", "ok", "ok"]
    np.testing.assert_array_equal(found.x, [np.nan, 8.0, 9.0])


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_run_is_stopped_with_all_that_it_started():
    with pytest.warns(UserWarning, match="no run of the study"):
        found = quiet(tiny_functions.hangs_in_a_fork, grid={"a": [1.0]}, n_processes=1, time_limit=0.5)
    assert found.status.values.tolist() == ["timed out"]


def test_a_study_without_any_result_warns():
    with pytest.warns(
        UserWarning, match="no run of the study gave a result; the first one: failed, RuntimeError: run 3"
    ):
        found = quiet(tiny_functions.troublesome, grid={"n": [3, 13]}, executor="serial")
    assert list(found.data_vars) == ["status", "message", "wall_time"]


def test_units_of_nothing_are_told():
    with pytest.warns(UserWarning, match="units of strokes are of no use; known: .*result"):
        quiet(tiny_functions.product, grid={"a": [1.0]}, executor="serial", units={"strokes": "m"})


def calls_in(path):
    return sorted(map(float, path.read_text().split()))


def test_only_what_a_folder_does_not_hold_is_run(tmp_path):
    calls = tmp_path / "calls"
    function = functools.partial(tiny_functions.count_calls, calls=str(calls))
    again = functools.partial(quiet, function, folder=tmp_path / "study", executor="serial")
    first = again(grid={"a": [1.0, 2.0]})
    assert calls_in(calls) == [1.0, 2.0]
    assert again(grid={"a": [1.0, 2.0]}).identical(first), "wall times included: nothing was run"
    more = again(grid={"a": [3.0, 2.0, 1.0, 4.0]})
    assert calls_in(calls) == [1.0, 2.0, 3.0, 4.0]
    np.testing.assert_array_equal(more.result, [3.0, 2.0, 1.0, 4.0])
    again(samples={"a": [4.0, 5.0, 5.0]})
    assert calls_in(calls) == [1.0, 2.0, 3.0, 4.0, 5.0]


def test_failed_runs_are_repeated_when_asked(tmp_path):
    calls = tmp_path / "calls"
    function = functools.partial(tiny_functions.fails_at_first, calls=str(calls))
    again = functools.partial(quiet, function, grid={"a": [1.0, 2.0]}, folder=tmp_path / "study", executor="serial")
    with pytest.warns(UserWarning, match="no run"):
        assert again().status.values.tolist() == ["failed", "failed"]
    with pytest.warns(UserWarning, match="no run"):
        again(retry=["timed out", "lost"])
    assert calls_in(calls) == [1.0, 2.0]
    assert again(retry="failed").status.values.tolist() == ["ok", "ok"]
    assert calls_in(calls) == [1.0, 1.0, 2.0, 2.0]
    with pytest.raises(ValueError, match="unknown state of a run 'bad'; known: failed, diverged, timed out, lost"):
        again(retry=["bad"])


def test_another_function_is_refused_its_folder(tmp_path):
    quiet(tiny_functions.product, grid={"a": [1.0]}, folder=tmp_path / "study", executor="serial")
    with pytest.raises(ValueError, match=r"its function is tiny_functions.product, not tiny_functions.noisy.*its seed"):
        quiet(tiny_functions.noisy, grid={"a": [1.0]}, seed=1, folder=tmp_path / "study", executor="serial")


def test_equal_rows_get_no_seeds_of_their_own():
    with pytest.raises(ValueError, match=r"3 rows of samples are 2 different runs.* add a parameter that numbers them"):
        quiet(tiny_functions.noisy, samples={"a": [1.0, 2.0, 1]}, seed=0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"executor": "serial", "time_limit": 1.0}, "leave out time_limit"),
        ({"executor": "parallel"}, "executor must be None"),
        ({"n_processes": 0}, "n_processes must be a whole number"),
        ({"n_processes": 1.5}, "n_processes must be a whole number"),
        ({"n_processes": 2, "executor": "serial"}, "executor must be None"),
        ({"time_limit": 0.0}, "time_limit must be positive"),
    ],
)
def test_wrong_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        quiet(tiny_functions.product, grid={"a": [1.0]}, **options)


def test_an_executor_that_breaks_keeps_what_was_done(tmp_path):
    calls = tmp_path / "calls"
    function = functools.partial(tiny_functions.slow, calls=str(calls))
    executor = ProcessPoolExecutor(1, get_context("spawn"))
    worker = executor.submit(os.getpid).result()
    thread = threading.Thread(target=kill_after, args=(calls, 3, worker))
    thread.start()
    with executor, pytest.raises(RuntimeError, match=r"the executor has broken .* goes on from there with a new one"):
        quiet(function, grid={"n": range(20)}, folder=tmp_path / "study", executor=executor)
    thread.join()
    found = quiet(function, grid={"n": range(20)}, folder=tmp_path / "study", executor="serial")
    assert (found.status == "ok").all()
    assert len(calls_in(calls)) <= 20 + 3, "at most those under way were run twice"


def kill_after(calls, count, *processes, how=signal.SIGKILL):
    while not calls.exists() or len(calls.read_text().split()) < count:
        time.sleep(0.005)
    for process in processes or [child.pid for child in children()]:
        os.kill(process, how)


def test_killed_children_are_replaced(tmp_path):
    calls = tmp_path / "calls"
    thread = threading.Thread(target=kill_after, args=(calls, 5))
    thread.start()
    function = functools.partial(tiny_functions.slow, calls=str(calls))
    found = quiet(function, grid={"n": range(20)}, n_processes=1)
    thread.join()
    assert (found.status == "ok").all()
    np.testing.assert_array_equal(found.result, np.arange(20.0) ** 2)
    assert len(calls_in(calls)) <= 21


@pytest.mark.parametrize("kept", [True, False])
def test_who_interrupts_a_study_is_told_how_to_go_on(tmp_path, kept):
    folder = tmp_path / "study" if kept else None
    said = f"goes on from {folder}" if kept else "without folder= they are lost"
    with pytest.raises(KeyboardInterrupt, match=f"stopped after 2 of 4 runs; .*{said}"):
        quiet(tiny_functions.interrupted, grid={"n": range(4)}, folder=folder, executor="serial")


def test_a_function_that_no_process_can_load_is_told_before_the_first_run(tmp_path, monkeypatch):
    (tmp_path / "nowhere_else.py").write_text("def one(a):\n    return a\n")
    with monkeypatch.context() as patch:
        patch.syspath_prepend(tmp_path)
        from nowhere_else import one
    with pytest.raises(ValueError, match=r"cannot load the function: ModuleNotFoundError.*nowhere_else"):
        quiet(one, grid={"a": [1.0]}, folder=tmp_path / "study", n_processes=1)
    assert (tmp_path / "study" / "manifest.jsonl").read_text() == ""


def test_what_runs_print_and_read_comes_between_nobody(capfd):
    found = quiet(tiny_functions.talkative, grid={"a": [1.0, 2.0]}, n_processes=1, time_limit=60.0)
    np.testing.assert_array_equal(found.result, [1.0, 2.0])
    assert capfd.readouterr().out == ""


STUDY = """
import sys, functools, signal
sys.path.insert(0, {here!r})
import tiny_functions
from nassim.studies import sweep
signal.signal(signal.SIGINT, signal.default_int_handler)  # which shells let what runs in the background ignore
function = functools.partial(tiny_functions.slow, calls={calls!r})
sweep(function, grid={{"n": range(24)}}, folder={folder!r}, n_processes=2, progress=False)
"""


def test_runs_write_nothing_to_the_terminal(capfd):
    """Warnings stand in the results; of a process that ends, so does its last line."""
    found = quiet(tiny_functions.outspoken, grid={"n": [1, 2, 3]}, n_processes=1)
    assert capfd.readouterr() == ("", "")
    assert found.status.values.tolist() == ["ok", "ok", "lost"]
    assert found.message.values.tolist()[:2] == ["warning: run 1 is odd", "warning: run 2 is odd"]
    assert found.message.values[2].endswith("the last time with status 5, having written 'written too'")


def orphans():
    """Children whose study was killed; they leave as soon as they notice."""
    commands = [
        " ".join(p.info["cmdline"] or ()) for p in psutil.process_iter(["cmdline", "ppid"]) if p.info["ppid"] == 1
    ]
    return [command for command in commands if "serve()" in command and str(HERE) in command]


@pytest.mark.parametrize("how", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_a_study_that_was_stopped_goes_on(tmp_path, how):
    calls, folder = tmp_path / "calls", tmp_path / "study"
    code = STUDY.format(here=str(HERE), calls=str(calls), folder=str(folder))
    with subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True) as study:
        kill_after(calls, 9, study.pid, how=how)
        said = study.communicate()[1]
    if how == signal.SIGINT:
        assert f"the same call goes on from {folder}" in said
    while orphans():
        time.sleep(0.01)
    before, kept = calls_in(calls), len((folder / "manifest.jsonl").read_text().splitlines()) - 1
    assert kept < 24
    function = functools.partial(tiny_functions.slow, calls=str(calls))
    found = quiet(function, grid={"n": range(24)}, folder=folder, executor="serial")
    assert (found.status == "ok").all()
    np.testing.assert_array_equal(found.result, np.arange(24.0) ** 2)
    assert len(calls_in(calls)) == len(before) + 24 - kept, "no finished run is repeated"


class Immediate:
    """An executor that does at once what it is given, and counts what it holds of runs that nobody has fetched."""

    def __init__(self):
        self.held = self.most = 0

    def submit(self, function, payload, digest, request, time_limit):
        self.held += 1
        self.most = max(self.most, self.held)
        future = Fetched()
        future.executor = self
        future.set_result(pickle.loads(payload)(pickle.loads(request)))
        return future


class Fetched(Future):
    def result(self, timeout=None):
        self.executor.held -= 1
        return super().result(timeout)


def test_a_bounded_number_of_runs_is_submitted_and_memory_is_that_of_the_results(tmp_path, monkeypatch):
    monkeypatch.setattr(executors, "IN_FLIGHT", 100)
    executor = Immediate()
    quiet(tiny_functions.row, grid={"a": [1.0]}, executor=executor)  # imports
    tracemalloc.start()
    found = quiet(tiny_functions.row, grid={"a": range(250)}, executor=executor, folder=tmp_path / "study")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert executor.most == 100
    assert found.result.shape == (250, 2000)
    assert peak < 1.3 * found.result.nbytes


@pytest.mark.slow
def test_memory_does_not_grow_with_the_number_of_runs():
    """Nor with what children and threads leave behind: some hundred bytes of records a run."""
    quiet(tiny_functions.product, samples={"a": range(1500)}, n_processes=2)
    before = psutil.Process().memory_info().rss
    found = quiet(tiny_functions.product, samples={"a": range(10_000)}, n_processes=2)
    assert (found.status == "ok").all()
    np.testing.assert_array_equal(found.result, np.arange(10_000.0))
    assert psutil.Process().memory_info().rss - before < 30e6


def test_without_the_extra_studies_it_is_named():
    code = (
        "import sys; sys.modules['xarray'] = None; from nassim.studies import Samples, executors, sweep; "
        "Samples(('a',), [[1.0]]); sweep(abs, grid={'a': [1.0]})"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert 'ImportError: studies need xarray: pip install "nassim[studies]"' in run.stderr


def test_runs_of_another_version_are_told_where_the_study_is_called(tmp_path, monkeypatch):
    quiet(tiny_functions.product, grid={"a": [1.0]}, folder=tmp_path, executor="serial")
    monkeypatch.setattr("nassim.studies.run_store.code_fingerprint", lambda: "another")
    with pytest.warns(UserWarning, match="another version of nassim") as caught:
        sweep(tiny_functions.product, grid={"a": [1.0]}, folder=tmp_path, executor="serial", progress=False)
    assert caught[0].filename == __file__
