"""What executors are given and what becomes of their answers, by executors that do nothing of their own."""

import functools
import os
import pickle
import queue
import warnings
from concurrent.futures import BrokenExecutor, Future
from types import SimpleNamespace

import numpy as np
import pytest
import tiny_functions
from threadpoolctl import threadpool_limits

from nassim.studies import executors, sweep, sweeping
from nassim.studies.outcome import Outcome
from nassim.studies.run_store import Records

quiet = functools.partial(sweep, progress=False)
THREADS = (
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS"),
    "NASSIM_THREADS",
)


class Executor:
    """Does at once what it is given, here, and notes what that was."""

    def __init__(self):
        self.given = []

    def submit(self, function, *given, **options):
        self.given.append((function, given, options))
        payload, _, request, _ = given
        return done(pickle.loads(payload)(pickle.loads(request)))


class DaskClient(Executor):
    scatter = None

    def nthreads(self):
        return {"worker": 1}

    def submit(self, function, *given, **options):
        if function is not bytes:
            shared, *rest = given
            return super().submit(function, shared.result(), *rest, **options)
        self.given.append((function, given, options))
        return done(*given)


def done(result):
    future = Future()
    future.set_result(result)
    return future


def failed(error):
    future = Future()
    future.set_exception(error)
    return future


def test_executors_get_the_function_its_name_and_the_time_limit():
    executor = Executor()
    for b in (2.0, 3.0):
        function = functools.partial(tiny_functions.product, b=b)
        found = quiet(function, grid={"a": [1.0, 5.0]}, executor=executor, time_limit=7.0)
        np.testing.assert_array_equal(found.result, [b, 5 * b])
    names = [given[1] for _, given, _ in executor.given]
    assert names[0] == names[1] != names[2] == names[3]
    assert [given[3] for _, given, _ in executor.given] == [7.0] * 4


def test_a_dask_client_gets_the_function_once():
    client = DaskClient()
    body = np.ones(100_000)
    found = quiet(functools.partial(tiny_functions.product, b=body), grid={"a": range(5)}, executor=client)
    assert found.result.shape == (5, 100_000)
    (_, sent, _), *runs = client.given
    assert len(sent[0]) > body.nbytes
    assert len(runs) == 5
    assert max(len(request) for _, (_, _, request, _), _ in runs) < 100
    assert all(options == {"pure": False} for _, _, options in client.given), "no result of an earlier call is taken"


def test_an_asynchronous_client_is_refused():
    with pytest.raises(ValueError, match="the Dask client is asynchronous"):
        quiet(tiny_functions.product, grid={"a": [1.0]}, executor=SimpleNamespace(submit=print, asynchronous=True))


class KilledWorker(Exception):
    """Named as Dask's."""


@pytest.mark.parametrize("error", [KilledWorker("two\nworkers"), BrokenExecutor("gone"), ImportError("no nassim")])
def test_workers_that_die_lose_a_run_and_broken_executors_the_others(error):
    waiting = []

    class Trouble(Executor):
        def submit(self, function, *given, **options):
            if pickle.loads(given[2])["a"] == 2.0:
                return failed(error)
            if isinstance(error, KilledWorker):
                return super().submit(function, *given, **options)
            waiting.append(Future())
            return waiting[-1]

    study = functools.partial(quiet, tiny_functions.product, grid={"a": [1.0, 2.0, 3.0]}, executor=Trouble())
    if isinstance(error, KilledWorker):
        found = study()
        assert found.status.values.tolist() == ["ok", "lost", "ok"]
        assert found.message.values[1] == "two workers"
    else:
        with pytest.raises(RuntimeError, match=r"(executor has broken|workers lack nassim).*; finished runs are in"):
            study()
        assert [future.cancelled() for future in waiting] == [True, True]


def test_the_serial_loop_has_one_thread_and_leaves_the_process_as_it_was(monkeypatch):
    for name in THREADS[1:]:
        monkeypatch.setenv(name, "2")
    monkeypatch.delenv(THREADS[0], raising=False)
    with threadpool_limits(2):
        found = quiet(tiny_functions.surroundings, grid={"a": [1.0, 2.0]}, executor="serial")
    assert (found.threads == 1).all()
    assert (found.limited == len(THREADS)).all()
    assert (found.process == os.getpid()).all()
    as_it_was = [None] + 5 * ["2"]
    assert [os.environ.get(name) for name in THREADS] == as_it_was

    def full(*run):
        raise OSError("no space left")

    monkeypatch.setattr(Records, "add", full)
    with pytest.raises(OSError, match="no space left") as stopped:
        quiet(tiny_functions.product, grid={"a": [1.0, 2.0]}, executor="serial")
    assert [os.environ.get(name) for name in THREADS] == as_it_was, stopped


@pytest.mark.parametrize(("workers", "told"), [({}, 1), ({"worker": 1}, 0)])
def test_a_cluster_without_workers_is_told_of_once(monkeypatch, workers, told):
    """Three results, of which one comes only once somebody has asked who works."""
    monkeypatch.setattr(executors, "POLL_INTERVAL", 0.01)
    monkeypatch.setattr(executors, "POLLS_BEFORE_WARNING", 4)

    class Slow(DaskClient):
        def submit(self, function, *given, **options):
            finished = super().submit(function, *given, **options)
            if function is bytes or len(self.given) != 3:
                return finished
            self.result, self.later = finished.result(), Future()
            return self.later

        def nthreads(self):
            self.later.set_result(self.result)
            return workers

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = quiet(tiny_functions.product, grid={"a": [1.0, 2.0, 3.0]}, executor=Slow())
    assert [str(one.message)[:28] for one in caught] == told * ["the study waits for workers,"]
    np.testing.assert_array_equal(found.result, [1.0, 2.0, 3.0])


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="systems without affinities")
def test_processes_are_as_many_as_there_are_processors_for_us(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 5, 7})
    started = []

    def nobody(payload, requests, time_limit, n_processes):
        started.append(n_processes)
        yield from ((key, Outcome("ok")) for key, _ in requests)

    monkeypatch.setattr(sweeping, "run_in_children", nobody)
    for count in (None, 2):
        quiet(tiny_functions.product, grid={"a": [1.0]}, n_processes=count)
    assert started == [3, 2]


def test_one_process_carries_out_all_runs():
    found = quiet(tiny_functions.surroundings, grid={"a": range(6)}, n_processes=1)
    assert len(set(found.process.values)) == 1
    assert (found.limited == len(THREADS)).all()


def test_workers_are_asked_for_once_after_thirty_seconds():
    """Within a wait in steps of a second."""
    for n_waits, n_asked in ((29, 0), (30, 1), (35, 1)):
        waits, asked = [], []

        def get(timeout, waits=waits, n_waits=n_waits):
            waits.append(timeout)
            if len(waits) <= n_waits:
                raise queue.Empty
            return "done"

        assert executors._next(SimpleNamespace(get=get), lambda asked=asked: asked.append(1) or True) == "done"
        assert len(asked) == n_asked
        assert sum(waits[:-1]) == n_waits
