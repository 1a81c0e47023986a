"""Child processes that carry out runs: reused between runs, killed at a time limit, and replaced after a crash.

Every run, except with the executor "serial", happens in a child process of this process or of a worker of a cluster.
All runs therefore have one thread and the same environment for every executor, and a run that hangs or crashes affects
no other process. Child processes are started anew (never forked, because NGSolve would hang) and get the function once.
They end with their parent, after a minute without a run, or when they are killed.
"""

import atexit
import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from typing import Any

import psutil

from nassim.studies.outcome import LOST, TIMED_OUT, Outcome

ATTEMPTS = 3
"""Number of processes that may end during a run before it counts as lost."""
IDLE_TIMEOUT = 60.0
"""Time without a run after which a child process ends [s]."""
TAIL_BYTES = 2000
"""Number of bytes at the end of a child's output that are searched for its last line."""
END_TIMEOUT = 5.0
"""Time for a child process to end after it has closed its pipes [s]."""
THREADS = {
    name: "1"
    for name in (
        *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"),
        *("NUMEXPR_NUM_THREADS", "NASSIM_THREADS"),
    )
}
"""Environment of a child, set before it imports NumPy.

One thread per process shares the processors evenly and keeps the order of summation.
"""
KEPT_MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(2**30), "MALLOC_TRIM_THRESHOLD_": str(2**31)}
"""Environment of a child for the C library of Linux.

Without it the library returns large arrays to the system after every use and gets them again with zeros, which takes a
quarter of the time of runs that simulate records.
"""


class CannotLoad(RuntimeError):
    """Error of a child process that cannot load the function."""


class Children:
    """Child processes with one function, as many as there are runs at a time.

    Args:
        payload: the pickled function.
    """

    def __init__(self, payload: bytes) -> None:
        self._payload = payload
        self._lock = threading.Lock()
        self._idle: list[_Child] = []
        self._all: set[_Child] = set()
        self._closed = False

    def run(self, request: bytes, time_limit: float | None) -> Outcome:
        """Carry out a run.

        Args:
            request: pickled parameters of the run.
            time_limit: time limit [s].

        Returns:
            Outcome of the run.

        Raises:
            CannotLoad: when every child process ends while it loads the function, with the reason.
        """
        why, loaded = "", False
        for _ in range(ATTEMPTS):
            try:
                child = self._take()
            except _Died as death:
                why = death.why
                continue
            loaded = True
            try:
                outcome = child.run(request, time_limit)
            except _Died as death:
                why = death.why
                self._remove(child)
                continue
            if outcome.status == TIMED_OUT:
                self._remove(child)
            else:
                with self._lock:
                    self._idle.append(child)
            return outcome
        if not loaded:
            raise CannotLoad(f"child processes end as they load it, the last one {why}")
        return Outcome(LOST, f"its process ended {ATTEMPTS} times, the last time {why}")

    def close(self) -> None:
        """Kill all child processes; active runs end as lost, and later ones are refused."""
        with self._lock:
            self._closed = True
            for child in self._all:
                child.kill()

    def _take(self) -> "_Child":
        with self._lock:
            if self._closed:
                raise RuntimeError("the study has ended")
            while self._idle:
                child = self._idle.pop()
                if child.alive():
                    return child
                self._all.discard(child)
        child = _Child(self._payload)
        with self._lock:
            self._all.add(child)
            if self._closed:
                child.kill()
        return child

    def _remove(self, child: "_Child") -> None:
        child.kill()
        with self._lock:
            self._all.discard(child)


class _Died(Exception):
    """Unexpected end of a child process; said: the last line that it wrote to standard error."""

    def __init__(self, code: int, said: str = "") -> None:
        super().__init__(code, said)
        self.why = _why(code) + (f", having written {said!r}" if said else "")


class _Child:
    """Process that carries out runs, one at a time, and its two pipes."""

    def __init__(self, payload: bytes) -> None:
        code = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve()"
        pipe = subprocess.PIPE
        environment = {**KEPT_MEMORY, **os.environ, **THREADS}
        # Output of libraries is not shown in the terminal; its last line explains an unexpected end.
        self._written = tempfile.TemporaryFile("ab+")  # noqa: SIM115 -- closed with the pipes
        self._process = subprocess.Popen(
            [sys.executable, "-c", code], stdin=pipe, stdout=pipe, stderr=self._written, env=environment
        )
        if problem := self._ask(payload, None):
            self.kill()
            raise CannotLoad(problem)

    def run(self, request: bytes, time_limit: float | None) -> Outcome:
        """Carry out a run; raise _Died when the process ends."""
        return self._ask(request, time_limit)

    def alive(self) -> bool:
        """Return whether the process is still running."""
        return self._process.poll() is None

    def kill(self) -> None:
        """Kill the process and all processes that it started, and wait for its end."""
        self._strike()
        self._end()

    def _strike(self) -> None:
        # A process forked by the run would keep the pipe open, so that its end would not be detected.
        with contextlib.suppress(psutil.Error):
            for process in psutil.Process(self._process.pid).children(recursive=True):
                process.kill()
        self._process.kill()

    def _last_line(self) -> str:
        with contextlib.suppress(OSError, ValueError):
            self._written.seek(max(0, self._written.seek(0, os.SEEK_END) - TAIL_BYTES))
            lines = [line.strip() for line in self._written.read().decode(errors="replace").splitlines()]
            return next((line for line in reversed(lines) if line), "")
        return ""

    def _end(self) -> int:
        code = self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._written):
            with contextlib.suppress(OSError):  # unsent data cannot be delivered
                if pipe:
                    pipe.close()
        return code

    def _ask(self, message: bytes, time_limit: float | None) -> Any:
        late = threading.Event()

        def stop() -> None:
            late.set()
            self._strike()

        timer = threading.Timer(time_limit, stop) if time_limit else None
        assert self._process.stdin
        assert self._process.stdout
        try:
            pickle.dump(message, self._process.stdin)
            self._process.stdin.flush()
            if timer:
                timer.start()
            answer = pickle.load(self._process.stdout)
            self._written.truncate(0)
            return answer
        except (EOFError, OSError, pickle.UnpicklingError) as error:
            if late.is_set():
                return Outcome(TIMED_OUT, f"stopped at its time limit of {time_limit:g} s", wall_time=time_limit or 0.0)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(END_TIMEOUT)
            self._process.kill()
            said = self._last_line()
            raise _Died(self._end(), said) from error
        finally:
            if timer:
                timer.cancel()


def _why(code: int) -> str:
    if code >= 0:
        return f"with status {code}"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else str(-code)
    return f"by signal {name}" + (" (as systems do when memory runs out)" if name == "SIGKILL" else "")


KEPT_STUDIES = 4
"""Number of studies whose child processes a worker keeps; those of earlier studies end."""
_known: dict[str, Children] = {}
_known_lock = threading.Lock()


def run_in_child(payload: bytes, digest: str, request: bytes, time_limit: float | None) -> Outcome:
    """Carry out a run in a child of this process, a worker of any executor; the children of a study are reused.

    Args:
        payload: the pickled function.
        digest: hash of the payload.
        request: pickled parameters of the run.
        time_limit: time limit [s].

    Returns:
        Outcome of the run.
    """
    with _known_lock:
        if digest not in _known:
            while len(_known) >= KEPT_STUDIES:
                _known.pop(next(iter(_known)))  # its pipes close, so that its children end
            _known[digest] = Children(payload)
        children = _known[digest]
    return children.run(request, time_limit)


@atexit.register
def _end_all() -> None:
    for children in _known.values():
        children.close()


def serve() -> None:
    """Load the function and carry out runs until the parent ends or sends no more: the main loop of a child process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    requests: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    source, sink = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # Output of a run must not mix with its results, and it must not read the parameters of the next run.
    with open(os.devnull, "r+b", buffering=0) as nothing:
        os.dup2(nothing.fileno(), 0)
        os.dup2(nothing.fileno(), 1)

    def listen() -> None:
        with contextlib.suppress(EOFError, OSError, pickle.UnpicklingError):
            while True:
                requests.put(pickle.load(source))
        os._exit(0)  # the parent has ended: also end a run that hangs

    threading.Thread(target=listen, daemon=True).start()
    try:
        task, problem = pickle.loads(requests.get()), ""
    except BaseException as error:
        task, problem = None, f"{type(error).__name__}: {error}"
    _answer(sink, problem)
    while True:
        try:
            request = requests.get(timeout=IDLE_TIMEOUT)
        except queue.Empty:
            os._exit(0)
        _answer(sink, task(pickle.loads(request)))


def _answer(sink: Any, message: Any) -> None:
    pickle.dump(message, sink)
    sink.flush()
