"""Child processes: who leaves and when, what is kept of them, what is told of their end."""

import functools
import pickle
import signal
import subprocess
import sys
import time

import psutil
import pytest
import tiny_functions

from nassim.studies import child_processes as children
from nassim.studies.child_processes import CannotLoad, Children, _Died, _why
from nassim.studies.job import make_job, pickle_task
from nassim.studies.outcome import Outcome


@pytest.fixture
def child():
    """A process that serves a function which sleeps for some seconds, and leaves when idle for a tenth of one."""
    code = f"import sys; sys.path[:] = {sys.path!r}; from nassim.studies import child_processes as children; "
    code += "children.IDLE_TIMEOUT = 0.1; children.serve()"
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", code], stdin=pipe, stdout=pipe) as process:
        try:
            pickle.dump(pickle_task(make_job(tiny_functions.sleepy, ("duration",), None)), process.stdin)
            process.stdin.flush()
            assert pickle.load(process.stdout) == "", "the function is loaded"
            yield process
        finally:
            process.kill()


def test_children_without_work_leave(child):
    assert child.wait(20) == 0


def test_children_leave_their_run_when_nobody_waits_for_it(child):
    pickle.dump(pickle.dumps({"duration": 1e3}), child.stdin)
    child.stdin.close()
    assert child.wait(20) == 0


@pytest.mark.parametrize(
    ("code", "told"),
    [
        (0, "with status 0"),
        (5, "with status 5"),
        (-9, "by signal SIGKILL (as systems do when memory runs out)"),
        (-11, "by signal SIGSEGV"),
        (-250, "by signal 250"),
    ],
)
def test_how_a_process_ended_is_told(code, told):
    assert _why(code) == told


def lives(process):
    """Whether a process still runs; one that ended may remain as a zombie where nobody waits for it."""
    try:
        return process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def test_what_a_process_of_a_run_started_ends_too():
    """As a solver does that a shell started."""
    solver = "import time; print('on', flush=True); time.sleep(60)"
    shell = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {solver!r}])"
    run = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {shell!r}])"
    one = object.__new__(children._Child)
    with subprocess.Popen([sys.executable, "-c", run], stdout=subprocess.PIPE) as one._process:
        assert one._process.stdout.readline().strip() == b"on"
        below = psutil.Process(one._process.pid).children(recursive=True)
        one._strike()
        ends = time.monotonic() + 5
        while (left := [each for each in below if lives(each)]) and time.monotonic() < ends:
            time.sleep(0.01)
        for each in left:
            each.kill()
    assert (len(below), left) == (2, [])


class Stub:
    """A child that does what requests say: a status, or a number of the process's end."""

    made = 0

    def __init__(self, payload):
        Stub.made += 1
        self.killed = False

    def run(self, request, time_limit):
        if isinstance(request, int):
            raise _Died(request)
        return Outcome(request)

    def alive(self):
        return not self.killed

    def kill(self):
        self.killed = True


def test_children_are_used_again_and_forgotten_when_they_end(monkeypatch):
    monkeypatch.setattr(children, "_Child", Stub)
    monkeypatch.setattr(Stub, "made", 0)
    pool = Children(b"")
    assert [pool.run(status, None).status for status in ("ok", "failed", "ok")] == ["ok", "failed", "ok"]
    assert (Stub.made, len(pool._all)) == (1, 1)
    lost = pool.run(-9, None)
    assert (lost.status, lost.message[:44]) == ("lost", "its process ended 3 times, the last time by ")
    assert (Stub.made, pool._all) == (3, set())
    assert pool.run("timed out", None).status == "timed out"
    assert (Stub.made, pool._all) == (4, set())
    first, second = pool._take(), pool._take()
    pool._idle.extend([first, second])
    second.kill()  # as by the system when memory runs out between two runs
    assert pool._take() is first
    assert pool._all == {first}
    pool.close()
    assert all(stub.killed for stub in pool._all)
    with pytest.raises(RuntimeError, match="the study has ended"):
        pool.run("ok", None)


def test_a_child_that_is_made_while_the_study_ends_is_killed(monkeypatch):
    """Nobody else would: it was not among the children when they were."""
    pool = Children(b"")

    class Late(Stub):
        def __init__(self, payload):
            super().__init__(payload)
            pool.close()

    monkeypatch.setattr(children, "_Child", Late)
    pool.run("ok", None)
    assert [child.killed for child in pool._all] == [True]


def test_a_worker_keeps_the_children_of_a_few_studies(monkeypatch):
    class Study:
        def __init__(self, payload):
            self.payload = payload

        def run(self, request, time_limit):
            return Outcome("ok", f"{self.payload.decode()} {request} {time_limit}")

    monkeypatch.setattr(children, "Children", Study)
    monkeypatch.setattr(children, "_known", {})
    for number in range(6):
        for request in "ab":
            outcome = children.run_in_child(f"f{number}".encode(), f"{number}", request, 5.0)
            assert outcome.message == f"f{number} {request} 5.0"
    assert sorted(children._known) == ["2", "3", "4", "5"]


def test_children_that_end_as_they_load_are_told(monkeypatch):
    class Stillborn:
        def __init__(self, payload):
            raise _Died(-11)

    monkeypatch.setattr(children, "_Child", Stillborn)
    with pytest.raises(CannotLoad, match="child processes end as they load it, the last one by signal SIGSEGV"):
        Children(b"").run("ok", None)


def test_a_time_limit_ends_with_its_run(monkeypatch):
    timers = []

    class Timer:
        def __init__(self, interval, function):
            timers.append((interval, told := []))
            self.start, self.cancel = functools.partial(told.append, "start"), functools.partial(told.append, "cancel")

    monkeypatch.setattr(children.threading, "Timer", Timer)
    pool = Children(pickle_task(make_job(tiny_functions.product, ("a",), None)))
    try:
        pool.run(pickle.dumps({"a": 1.0}), 7.0)
    finally:
        pool.close()
    assert timers == [(7.0, ["start", "cancel"])]


def test_a_run_that_ctrl_c_reaches_goes_on():
    """The terminal sends it to all processes: it is for the study to answer."""
    heard = signal.signal(signal.SIGINT, signal.default_int_handler)  # in the background it may be ignored as it is
    pool = Children(pickle_task(make_job(tiny_functions.interrupts_itself, ("a",), None)))
    try:
        start = time.perf_counter()
        outcome = pool.run(pickle.dumps({"a": 1.0}), 60.0)
        assert outcome.status == "ok"
        assert 0.05 < outcome.wall_time < time.perf_counter() - start
        assert len(pool._all) == 1
    finally:
        pool.close()
        signal.signal(signal.SIGINT, heard)
