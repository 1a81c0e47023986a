"""Executors of runs: this process, child processes on this machine, or the workers of any executor."""

import os
import pickle
import queue
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from hashlib import sha256
from itertools import islice
from typing import Any

from threadpoolctl import threadpool_limits

from nassim.base.warning_log import warn
from nassim.studies.child_processes import THREADS, CannotLoad, Children, run_in_child
from nassim.studies.outcome import LOST, Outcome, Task

POLL_INTERVAL, POLLS_BEFORE_WARNING = 1.0, 30
"""Interval between checks for results [s], and number of checks without a result before a warning."""
IN_FLIGHT = 1000
"""Number of submitted runs at a time: more than most clusters have workers, with little memory."""
Requests = Iterable[tuple[str, dict[str, Any]]]
"""Names of runs, and the arguments of the function."""
Outcomes = Generator[tuple[str, Outcome], None, None]


def run_serially(task: Task, requests: Requests) -> Outcomes:
    """Carry out runs one after the other in this process, with one thread as in child processes.

    Args:
        task: the function.
        requests: the runs.

    Returns:
        Iterator over names and outcomes of the runs.
    """
    before = {name: os.environ.get(name) for name in THREADS}
    try:
        os.environ.update(THREADS)
        with threadpool_limits(1):  # for libraries already loaded; the environment is for later ones
            for key, arguments in requests:
                yield key, task(arguments)
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            os.environ.update({} if value is None else {name: value})


def run_in_children(payload: bytes, requests: Requests, time_limit: float | None, n_processes: int) -> Outcomes:
    """Carry out runs in child processes on this machine.

    Args:
        payload: the pickled task.
        requests: the runs.
        time_limit: time limit of each run [s].
        n_processes: number of child processes.

    Returns:
        Iterator over names and outcomes of the runs, in the order in which they finish.
    """
    children = Children(payload)
    threads = ThreadPoolExecutor(n_processes, thread_name_prefix="study")
    try:
        yield from _submitted(lambda request: threads.submit(children.run, request, time_limit), requests)
    finally:
        children.close()
        threads.shutdown(cancel_futures=True)


def run_on_executor(payload: bytes, requests: Requests, time_limit: float | None, executor: Any) -> Outcomes:
    """Carry out runs in child processes of the workers of an executor.

    A Dask client gets the function as a separate task, whose result each worker fetches once. Other executors get the
    function with each run.

    Args:
        payload: the pickled task.
        requests: the runs.
        time_limit: time limit of each run [s].
        executor: Dask client, or an object with a method `submit`.

    Returns:
        Iterator over names and outcomes of the runs, in the order in which they finish.
    """
    digest = sha256(payload).hexdigest()
    dask = hasattr(executor, "scatter")
    options = {"pure": False} if dask else {}
    staffed = (lambda: bool(executor.nthreads())) if dask else (lambda: True)
    # A task in place of scattered data, which would be lost with the worker that holds them.
    shared = executor.submit(bytes, payload, **options) if dask else payload
    yield from _submitted(
        lambda request: executor.submit(run_in_child, shared, digest, request, time_limit, **options), requests, staffed
    )


def _submitted(
    submit: Callable[[bytes], Any], requests: Requests, staffed: Callable[[], bool] = lambda: True
) -> Outcomes:
    """Submit runs, a bounded number at a time, and yield outcomes as they finish; staffed: whether workers exist."""
    coming = iter(requests)
    pending: dict[Any, str] = {}
    done: queue.SimpleQueue[Any] = queue.SimpleQueue()
    try:
        while True:
            for key, arguments in islice(coming, IN_FLIGHT - len(pending)):
                with _explained_errors():
                    future = submit(pickle.dumps(arguments))
                pending[future] = key
                future.add_done_callback(done.put)
            if not pending:
                return
            future = _next(done, staffed)
            with _explained_errors():
                outcome = _outcome(future)
            yield pending.pop(future), outcome
    finally:
        for future in pending:
            future.cancel()


def _next(done: "queue.SimpleQueue[Any]", staffed: Callable[[], bool]) -> Any:
    waited = 0
    while True:
        try:
            return done.get(timeout=POLL_INTERVAL)  # without a timeout, Windows would not receive Ctrl-C
        except queue.Empty:
            waited += 1
        if waited == POLLS_BEFORE_WARNING and not staffed():
            warn(
                "the study waits for workers, because the cluster has none: check that they started and that their "
                "time limit has not expired. It continues with new workers, or after Ctrl-C by the same call from its "
                "folder"
            )


def _outcome(future: Any) -> Outcome:
    try:
        outcome: Outcome = future.result()
    except Exception as error:
        # Dask's exception, by name because Dask is optional: workers ended during the run or a task that it needs.
        if type(error).__name__ != "KilledWorker":
            raise
        return Outcome(LOST, " ".join(str(error).split()))
    return outcome


@contextmanager
def _explained_errors() -> Iterator[None]:
    """Replace errors of an executor by messages with their consequence and cure."""
    again = "finished runs are in the study's folder, if it has one: the same call goes on from there"
    try:
        yield
    except CannotLoad as error:
        raise ValueError(
            f"workers cannot load the function: {error}. Its modules must be installed where they run, or lie on their "
            "PYTHONPATH"
        ) from error
    except (BrokenExecutor, CancelledError) as error:
        raise RuntimeError(f"the executor has broken ({error!r}); {again} with a new one") from error
    except ImportError as error:
        raise RuntimeError(f"the executor's workers lack nassim or what it needs: {error}; {again}") from error
