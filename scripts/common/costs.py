"""Costs of work: time, and memory in a process of its own."""

import json
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any, TypeVar

from nassim.base import peak_memory, stage

Result = TypeVar("Result")


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


def cost_since(start: float) -> dict[str, float]:
    """Return the time since a value of `time.perf_counter`, and the largest memory of the process."""
    return {"time_s": time.perf_counter() - start, "memory_B": peak_memory()}


def run_in_own_process(script: str, *arguments: object) -> dict[str, Any]:
    """Run a script with --child and arguments; return the JSON object in its last line of output.

    The script writes no results.

    Raises:
        RuntimeError: with the last line of the error output when the script fails
    """
    words = [str(argument) for argument in arguments]
    command = [sys.executable, script, "--child", *words, "--output", tempfile.gettempdir()]
    with stage(" ".join(words)):
        child = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = child.stdout.strip().splitlines()
    if child.returncode or not lines:
        said = (child.stderr.strip() or child.stdout.strip() or "nothing").splitlines()[-1]
        raise RuntimeError(f"{shlex.join(command)} failed ({child.returncode}), saying: {said}")
    result: dict[str, Any] = json.loads(lines[-1])
    return result
