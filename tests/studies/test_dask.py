"""The same study on a Dask cluster of this machine, started as users would: a scheduler and two workers."""

import functools
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import tiny_functions
from conftest import lattice

from nassim import craig_bampton
from nassim.studies import sweep

pytestmark = pytest.mark.slow
BENCHES = {"mass": np.linspace(0.5, 5.0, 10), "offset": np.linspace(0.01, 0.04, 4)}


HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def body():
    return craig_bampton(lattice(), n_modes=6, progress=False)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """(address of the scheduler, processes of two workers)."""
    folder = tmp_path_factory.mktemp("dask")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])}
    address_file = folder / "scheduler.json"

    def start(*words):
        command = [sys.executable, "-m", "dask", *words, "--scheduler-file", str(address_file)]
        with (folder / f"{words[0]}.log").open("a") as log:
            return subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log)

    processes = [start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")]
    try:
        while not address_file.exists():
            assert processes[0].poll() is None, (folder / "scheduler.log").read_text()
            time.sleep(0.05)
        processes += [start("worker", "--nthreads", "1", "--no-dashboard") for _ in range(2)]
        yield address_file, processes[1:]
    finally:
        for process in reversed(processes):
            process.terminate()
        for process in processes:
            process.wait(20)


@pytest.fixture
def client(cluster):
    from dask.distributed import Client

    with Client(scheduler_file=str(cluster[0])) as found:
        found.wait_for_workers(2, timeout=60)
        yield found


def same(one, other):
    return one.drop_vars("wall_time").identical(other.drop_vars("wall_time"))


def test_benches_are_bit_for_bit_those_of_the_serial_loop(client, body):
    function = functools.partial(tiny_functions.bench, body=body)
    serial = sweep(function, grid=BENCHES, executor="serial", progress=False)
    assert serial.status.size == 40
    assert (serial.status == "ok").all()
    assert same(serial, sweep(function, grid=BENCHES, n_processes=2, progress=False))
    assert same(serial, sweep(function, grid=BENCHES, executor=client, progress=False))


def test_troubles_are_rows_there_too(client):
    found = sweep(tiny_functions.troublesome, grid={"n": range(10)}, executor=client, time_limit=2.0, progress=False)
    states = ["ok"] * 3 + ["failed", "timed out", "other shape", "diverged", "lost", "ok", "ok"]
    assert found.status.values.tolist() == states


def test_a_killed_worker_takes_no_run_with_it(client, tmp_path):
    calls = tmp_path / "calls"
    victim = next(iter(client.run(os.getpid).values()))

    def kill():
        while not calls.exists() or len(calls.read_text().split()) < 10:
            time.sleep(0.01)
        os.kill(victim, signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    function = functools.partial(tiny_functions.slow, calls=str(calls))
    found = sweep(function, grid={"n": range(60)}, executor=client, progress=False)
    thread.join()
    assert (found.status == "ok").all()
    np.testing.assert_array_equal(found.result, np.arange(60.0) ** 2)


def test_a_module_that_workers_lack_is_told_before_the_first_run(client, tmp_path, monkeypatch):
    (tmp_path / "only_here.py").write_text("def one(a):\n    return a\n")
    monkeypatch.syspath_prepend(tmp_path)
    from only_here import one

    with pytest.raises(ValueError, match=r"cannot load the function: ModuleNotFoundError.*only_here.*PYTHONPATH"):
        sweep(one, grid={"a": [1.0]}, executor=client, progress=False)
