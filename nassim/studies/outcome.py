"""Outcome of one run: its result, or the reason why there is none."""

import time
import traceback
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from nassim.base.warning_log import collect_messages
from nassim.studies.results import Layout, flatten_result

OK, FAILED, DIVERGED, TIMED_OUT, LOST, OTHER_SHAPE = "ok", "failed", "diverged", "timed out", "lost", "other shape"
UNFINISHED = (FAILED, DIVERGED, TIMED_OUT, LOST)
"""States of a run other than "ok" that can be repeated."""
LONGEST_MESSAGE = 300
"""Largest number of characters of a message in the results; the folder has the full traceback."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run.

    Attributes:
        status: "ok"; "failed" (it raised an exception, or returned a type that studies do not accept); "diverged" (its
            result contains NaN); "timed out"; "lost" (its process ended repeatedly).
        message: reason in one line; for a run with the status "ok", nassim's warnings.
        details: the traceback.
        wall_time: duration of the function; 0 where it is unknown [s].
        layout: layout of the result, see `results`; None unless the function returned.
        data: numbers of the result; empty unless the function returned.
    """

    status: str
    message: str = ""
    details: str = ""
    wall_time: float = 0.0
    layout: Layout | None = None
    data: bytes = b""


@dataclass(frozen=True)
class Task:
    """Function of a study.

    Attributes:
        function: the function.
        taken: names that its results may not have.
    """

    function: Callable[..., Any]
    taken: Collection[str]

    def __call__(self, parameters: dict[str, Any]) -> Outcome:
        """Carry out a run; raise no exception except KeyboardInterrupt."""
        start = time.perf_counter()
        try:
            with collect_messages() as notices:
                result = self.function(**parameters)
            wall_time = time.perf_counter() - start
            layout, data = flatten_result(result, self.taken)
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
