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
ONE_THREAD = dict.fromkeys(("NASSIM_THREADS", "NGS_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
"""Environment of a process that computes on one thread."""


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


def cpu_cost_since(start: float) -> dict[str, float]:
    """The processors' time since a reading of `time.process_time` and the process's largest memory."""
    return {"time_s": time.process_time() - start, "memory_B": peak_memory()}


def run_in_own_process(script: str, *arguments: object, environment: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Run a script with --child and arguments; return the JSON object in its last line of output.

    The script writes no results. The variables of `environment` are set in the new process only.

    Raises:
        RuntimeError: with the last line of the error output when the script fails
    """
    words = [str(argument) for argument in arguments]
    command = [sys.executable, script, "--child", *words, "--output", tempfile.gettempdir()]
    with stage(" ".join(words)):
        child = subprocess.run(
            command, capture_output=True, text=True, check=False, env={**os.environ, **(environment or {})}
        )
    lines = child.stdout.strip().splitlines()
    if child.returncode or not lines:
        said = (child.stderr.strip() or child.stdout.strip() or "nothing").splitlines()[-1]
        raise RuntimeError(f"{shlex.join(command)} failed ({child.returncode}), saying: {said}")
    result: dict[str, Any] = json.loads(lines[-1])
    return result
