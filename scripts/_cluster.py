"""A Dask cluster of this machine, started by its command lines as on any other."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil


@contextmanager
def cluster(n_workers: int) -> Iterator[tuple[Any, psutil.Process]]:
    """A client of `dask scheduler` and so many `dask worker`, and the scheduler's process; all end with it.

    Raises ImportError without dask, RuntimeError when the scheduler does not start.
    """
    from dask.distributed import Client  # noqa: PLC0415 -- an optional dependency

    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder, "scheduler.json")
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}

        def start(*words: str) -> Any:
            command = [sys.executable, "-m", "dask", *words, "--scheduler-file", str(where), "--no-dashboard"]
            return subprocess.Popen(command, cwd=folder, env=environment, stderr=subprocess.DEVNULL)

        processes = [start("scheduler", "--host", "127.0.0.1", "--port", "0")]
        try:
            while not where.exists():
                if processes[0].poll() is not None:
                    raise RuntimeError("the command dask scheduler ended at once; try it by hand")
                time.sleep(0.05)
            processes += [start("worker", "--nthreads", "1") for _ in range(n_workers)]
            with Client(scheduler_file=str(where)) as client:
                client.wait_for_workers(n_workers, timeout=120)
                yield client, psutil.Process(processes[0].pid)
        finally:
            for process in reversed(processes):
                process.terminate()
            for process in processes:
                process.wait()
