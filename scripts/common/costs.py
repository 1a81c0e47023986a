"""Costs of work: time, and memory in a process of its own."""

import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from nassim.base import peak_memory, stage

Result = TypeVar("Result")
THREADS = ("NASSIM_THREADS", "NGS_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
ONE_THREAD = dict.fromkeys(THREADS, "1")
"""Environment of a process that computes on one thread."""
DEFAULT_THREADS = dict.fromkeys(THREADS)
"""Environment of a process that computes on as many threads as its libraries choose."""


def timed(work: Callable[..., Result], *given: Any, **options: Any) -> tuple[Result, float]:
    """Call a function; return its result and its wall time [s]."""
    start = time.perf_counter()
    result = work(*given, **options)
    return result, time.perf_counter() - start


def cpu_time(work: Callable[..., Result], *given: Any, **options: Any) -> tuple[Result, float]:
    """Call a function; return its result and its CPU time [s]."""
    start = time.process_time()
    result = work(*given, **options)
    return result, time.process_time() - start


def compared(without: Callable[[], Any], loaded: Callable[[], Any], count: int, turns: int) -> dict[str, float]:
    """Processor's times of two ways, in turns, for one of so many equal parts of the work, and their ratio."""
    with threadpool_limits(1):
        times = [[cpu_time(work)[1] / count for work in (without, loaded)] for _ in range(turns)]
    first, second = np.min(times, axis=0)
    return {"without_s": first, "with_s": second, "ratio": second / first}


def cost_since(start: float) -> dict[str, float]:
    """Return the time since a value of `time.perf_counter`, and the largest memory of the process."""
    return {"time_s": time.perf_counter() - start, "memory_B": peak_memory()}


def clocks() -> np.ndarray:
    """The processors' time of this process and the wall time [s]."""
    return np.array([time.process_time(), time.perf_counter()])


def cpu_cost_since(start: np.ndarray) -> dict[str, float]:
    """The processors' time and the wall time since a reading of `clocks`, and the process's largest memory."""
    cpu, wall = clocks() - start
    return {"time_s": cpu, "wall_s": wall, "memory_B": peak_memory()}


def run_in_own_process(
    script: str, *arguments: object, environment: Mapping[str, str | None] | None = None
) -> dict[str, Any]:
    """Run a script with --child and arguments; return the JSON object in its last line of output.

    The script writes no results. The variables of `environment` are set, or removed by None, in the new process only.

    Raises:
        RuntimeError: with the last line of the error output when the script fails
    """
    words = [str(argument) for argument in arguments]
    command = [sys.executable, script, "--child", *words, "--output", tempfile.gettempdir()]
    variables = {name: value for name, value in {**os.environ, **(environment or {})}.items() if value is not None}
    with stage(" ".join(words)):
        child = subprocess.run(command, capture_output=True, text=True, check=False, env=variables)
    lines = child.stdout.strip().splitlines()
    if child.returncode or not lines:
        said = (child.stderr.strip() or child.stdout.strip() or "nothing").splitlines()[-1]
        raise RuntimeError(f"{shlex.join(command)} failed ({child.returncode}), saying: {said}")
    result: dict[str, Any] = json.loads(lines[-1])
    return result
