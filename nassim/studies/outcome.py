"""One run carried out: what it gave, or why it gave nothing. Failure is data."""

import time
import traceback
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from nassim.base.warning_log import collect_messages
from nassim.studies.results import Layout, flattened

OK, FAILED, DIVERGED, TIMED_OUT, LOST, OTHER_SHAPE = "ok", "failed", "diverged", "timed out", "lost", "other shape"
UNFINISHED = (FAILED, DIVERGED, TIMED_OUT, LOST)
"""What may become of a run beside "ok", and be tried anew."""
LONGEST_MESSAGE = 300
"""Characters of a message in the results; the folder has the whole traceback."""


@dataclass(frozen=True)
class Outcome:
    """What became of a run.

    status: "ok"; "failed" (it raised, or returned what no study takes), "diverged" (there is NaN in what it returned),
        "timed out", "lost" (its process ended, time and again)
    message: why, in a line; of a run that is ok, nassim's warnings; details: the traceback
    wall_time: that the function took [s], 0 where nobody knows
    layout, data: of what it returned, see `results`; None and nothing unless it returned
    """

    status: str
    message: str = ""
    details: str = ""
    wall_time: float = 0.0
    layout: Layout | None = None
    data: bytes = b""


@dataclass(frozen=True)
class Task:
    """A study's function, and the names that its results may not have."""

    function: Callable[..., Any]
    taken: Collection[str]

    def __call__(self, parameters: dict[str, Any]) -> Outcome:
        """Carry out a run; raises nothing but KeyboardInterrupt."""
        start = time.perf_counter()
        try:
            with collect_messages() as notices:
                result = self.function(**parameters)
            wall_time = time.perf_counter() - start
            layout, data = flattened(result, self.taken)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            wall_time = time.perf_counter() - start
            text = "".join(traceback.format_exception(error))
            message = " ".join(f"{type(error).__name__}: {error}".split())[:LONGEST_MESSAGE]
            return Outcome(FAILED, message, text, wall_time)
        empty = [name for name, numbers in layout.arrays(data).items() if np.isnan(numbers).any()]
        status, message = OK, "; ".join(f"warning: {text}" for text in dict.fromkeys(notices.warnings))
        if empty:
            status, message = DIVERGED, f"there is NaN in {', '.join(empty)}"
        return Outcome(status, message[:LONGEST_MESSAGE], "", wall_time, layout, data)
