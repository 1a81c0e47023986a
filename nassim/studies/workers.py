"""Child processes that carry out runs: kept from run to run, killed at a time limit, their death survived.

Every run but those of the executor "serial" happens in a child of whoever carries it out: this process, or a worker of
a cluster. So all have one thread and one environment, whatever the executor, and a run that hangs or crashes takes
nobody with it. Children are started anew (never forked: NGSolve would hang), are given the function once, and leave
when their parent does, when they have had nothing to do for a minute, or when they are killed.
"""

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
"""Processes that may end under a run before it counts as lost."""
IDLE = 60.0
"""Time without a run after which a child leaves [s]."""
LAST = 2000
"""Bytes at the end of what a child wrote in which its last line is looked for."""
PARTING = 5.0
"""Time that a child has to end after it has closed its pipes [s]."""
THREADS = {
    name: "1"
    for name in (
        *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"),
        *("NUMEXPR_NUM_THREADS", "NASSIM_THREADS"),
    )
}
"""Environment of a child, set before it imports NumPy: processes share the processors, and sums are in one order."""
KEPT_MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(2**30), "MALLOC_TRIM_THRESHOLD_": str(2**31)}
"""Also of a child, read by Linux' C library: else it gives large arrays back to the system after every use and has them
cleared again, a quarter of the time of runs that simulate records."""


class CannotLoad(RuntimeError):
    """A child cannot make the function from what it was sent."""


class Children:
    """The children of one process that know one function.

    payload: the function, pickled. As many children live as runs are carried out at a time.
    """

    def __init__(self, payload: bytes) -> None:
        self._payload = payload
        self._lock = threading.Lock()
        self._idle: list[_Child] = []
        self._all: set[_Child] = set()
        self._closed = False

    def run(self, request: bytes, time_limit: float | None) -> Outcome:
        """Carry out a run, `request` holding its parameters, pickled; time_limit [s].

        Raises CannotLoad where no child lives to load the function, saying why.
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
        """Kill all children; runs that are under way end as lost, later ones are refused."""
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
    """A child ended with an exit status; said: the last line that it wrote to standard error."""

    def __init__(self, code: int, said: str = "") -> None:
        super().__init__(code, said)
        self.why = _why(code) + (f", having written {said!r}" if said else "")


class _Child:
    """A process that carries out runs, one at a time, and the two pipes to it."""

    def __init__(self, payload: bytes) -> None:
        code = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve()"
        pipe = subprocess.PIPE
        environment = {**KEPT_MEMORY, **os.environ, **THREADS}
        # What libraries write of their own accord is not for the terminal; of a child that dies it tells why.
        self._written = tempfile.TemporaryFile("ab+")  # noqa: SIM115 -- closed with the pipes
        self._process = subprocess.Popen(
            [sys.executable, "-c", code], stdin=pipe, stdout=pipe, stderr=self._written, env=environment
        )
        if problem := self._ask(payload, None):
            self.kill()
            raise CannotLoad(problem)

    def run(self, request: bytes, time_limit: float | None) -> Outcome:
        """Carry out a run; raises _Died when the process ends."""
        outcome: Outcome = self._ask(request, time_limit)
        return outcome

    def alive(self) -> bool:
        """Whether the process still waits for runs."""
        return self._process.poll() is None

    def kill(self) -> None:
        """End the process with all that it started, and wait for its end."""
        self._strike()
        self._end()

    def _strike(self) -> None:
        # A process that a run forked would hold the pipe open, and its end would never be seen.
        with contextlib.suppress(psutil.Error):
            for process in psutil.Process(self._process.pid).children(recursive=True):
                process.kill()
        self._process.kill()

    def _last_line(self) -> str:
        with contextlib.suppress(OSError, ValueError):
            self._written.seek(max(0, self._written.seek(0, os.SEEK_END) - LAST))
            lines = [line.strip() for line in self._written.read().decode(errors="replace").splitlines()]
            return next((line for line in reversed(lines) if line), "")
        return ""

    def _end(self) -> int:
        code = self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._written):
            with contextlib.suppress(OSError):  # what was not sent yet has nowhere to go
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
                self._process.wait(PARTING)
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


KEPT = 4
"""Studies whose children a worker keeps; those of earlier ones leave."""
_known: dict[str, Children] = {}
_known_lock = threading.Lock()


def run_in_child(payload: bytes, digest: str, request: bytes, time_limit: float | None) -> Outcome:
    """Carry out a run in a child of this process, a worker of any executor; the children of a study are kept.

    digest: of the payload; others as in `Children`
    """
    with _known_lock:
        if digest not in _known:
            while len(_known) >= KEPT:
                _known.pop(next(iter(_known)))  # whose pipes close, so that they leave
            _known[digest] = Children(payload)
        children = _known[digest]
    return children.run(request, time_limit)


def serve() -> None:
    """The life of a child: load the function, then carry out runs, until the parent is gone or asks for no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent to answer
    requests: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    source, sink = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # What a run prints must not get between its results, nor may it read the next run's parameters.
    with open(os.devnull, "r+b", buffering=0) as nothing:
        os.dup2(nothing.fileno(), 0)
        os.dup2(nothing.fileno(), 1)

    def listen() -> None:
        with contextlib.suppress(EOFError, OSError, pickle.UnpicklingError):
            while True:
                requests.put(pickle.load(source))
        os._exit(0)  # the parent is gone: whoever hangs in a run is not to stay

    threading.Thread(target=listen, daemon=True).start()
    try:
        task, problem = pickle.loads(requests.get()), ""
    except BaseException as error:
        task, problem = None, f"{type(error).__name__}: {error}"
    _answer(sink, problem)
    while True:
        try:
            request = requests.get(timeout=IDLE)
        except queue.Empty:
            os._exit(0)
        _answer(sink, task(pickle.loads(request)))


def _answer(sink: Any, message: Any) -> None:
    pickle.dump(message, sink)
    sink.flush()
