"""Functions of tiny studies, in a module that every process can import soon: it imports no simulation."""

import os
import signal
import sys
import time

import numpy as np
from threadpoolctl import threadpool_info

import nassim
from nassim import FRF, TimeHistory
from nassim.base.warning_log import warn


def product(a, b=1.0):
    return a * b


def everything(a, gain=2.0):
    frequency = np.array([1.0, 2.0, 5.0])
    response = gain / (a - frequency**2 + 0.1j)
    return {
        "root": np.sqrt(a),
        "powers": np.array([[a, a**2], [a**3, a**4]]),
        "frf": FRF(frequency, response[None, None], ("encoder",), ("force",), np.full((1, 3), 0.5)),
        "history": TimeHistory([0.0, 0.1, 0.2], [[a, 0.0, 1.0], [0.0, a, 2.0]], ("u", "y"), ("V", "m")),
    }


def row(a):
    return a + np.arange(2000.0)


def noisy(a, seed):
    return a + np.random.default_rng(seed).normal()


def troublesome(n):
    """A tenth raises; one hangs, one returns other shapes, one NaN, one ends its process."""
    if n % 10 == 3:
        raise RuntimeError(f"run {n} does\nnot converge")
    if n == 4:
        time.sleep(1e3)
    if n == 5:
        return {"x": np.zeros(3)}
    if n == 6:
        return {"x": np.nan}
    if n == 7:
        os._exit(5)
    return {"x": float(n)}


def outspoken(n):
    """Writes to the terminal by all ways that there are, warns, and ends its process at last."""
    print("printed")
    print("printed too", file=sys.stderr)
    warn(f"run {n} is odd")
    os.write(1, b"written\n")
    os.write(2, b"written too\n\n")
    if n == 3:
        os._exit(5)
    return n


def count_calls(a, calls):
    """Writes a line per call to a file."""
    with open(calls, "a", encoding="utf-8") as file:
        file.write(f"{a}\n")
    return a


def slow(n, calls, duration=0.05):
    time.sleep(duration)
    return count_calls(n, calls) ** 2


def bench(mass, offset, body):
    """FRF of a load at the end of a flexible strut that is clamped, off its axis, and its first frequencies [Hz]."""
    inertia = mass * np.diag([1e-4, 2e-4, 3e-4])
    ground = nassim.RigidBody("ground", {"foot": [0.0, 0.01, 0.01]}, fixed=True)
    points = {"seat": [0.0, -offset, 0.0], "tip": [0.0, offset, 0.0]}
    load = nassim.RigidBody("load", points, mass, inertia, [0.03, 0.01 + offset, 0.01])
    left, right = (f"strut.{point.name}" for point in body.remote_points)
    scene = nassim.Scene(
        "bench",
        (ground, nassim.FlexibleBody("strut", body, fidelity="linear"), load),
        (nassim.Joint("clamp", "ground.foot", left), nassim.Joint("seat", right, "load.seat")),
        (nassim.PointForce("push", "load.tip", "y", "force"),),
        (nassim.Encoder("stroke", "ground.foot", "load.tip", "y"),),
        damping_ratio=0.01,
    )
    model = nassim.linearize(scene)
    response = nassim.frequency_response(model, np.geomspace(1.0, 1e3, 60))
    return {"response": response, "modes": nassim.systems.damping(model)[0][:4]}


def interrupted(n):
    """As if somebody pressed Ctrl-C."""
    if n == 2:
        raise KeyboardInterrupt
    return n


def hangs_in_a_fork(a):
    if os.fork() == 0:
        time.sleep(1e3)
    time.sleep(1e3)
    return a


def fails_at_first(a, calls):
    """Raises until it was called twice for every value."""
    count_calls(a, calls)
    with open(calls, encoding="utf-8") as file:
        if file.read().split().count(str(a)) < 2:
            raise RuntimeError("not yet")
    return a


def surroundings(a):
    """Who runs this, with how many threads of BLAS, and how many of six libraries are told to take one."""
    threads = max((pool["num_threads"] for pool in threadpool_info()), default=1)
    names = ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "VECLIB_MAXIMUM", "NUMEXPR_NUM", "NASSIM")
    limited = sum(os.environ.get(f"{name}_THREADS") == "1" for name in names)
    return {"process": os.getpid(), "parent": os.getppid(), "threads": threads, "limited": limited}


def sleepy(duration):
    time.sleep(duration)
    return duration


def interrupts_itself(a):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.1)
    return a


def talkative(a):
    print("so much to say")
    os.write(1, b"and more")
    assert os.read(0, 1) == b""
    return a
