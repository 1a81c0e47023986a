"""Progress of long work: a bar or counter in a terminal, a line per stage elsewhere, and the time left of the run."""

import sys
import textwrap
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

from tqdm import tqdm

Advance = Callable[..., object]
"""Function to call as advance(n=1) when n more units of a stage are done."""
StageEnds = Sequence[tuple[str, float]]
"""Labels of the stages in order, each with the time of its end from the start of the run [s]."""

BAR = "  {desc:<26}{percentage:3.0f}% |{bar:24}| {n_fmt}/{total_fmt} {unit} [{elapsed}<{remaining}]{left}"
COUNTER = "  {desc:<26}{n_fmt} {unit} [{elapsed}]{left}"
WIDTH = 100
"""Assumed width of a terminal [characters]."""
SHORTEST_INTERVAL = 10.0
"""Shortest time between two progress messages when the output is not a terminal [s]."""


def silent(n: int = 1) -> None:
    """Do nothing: an `Advance` that shows no progress."""


def wrap_text(text: str, *, indent: str = "", next_indent: str = "    ") -> str:
    """Wrap one line of text into lines of at most `WIDTH` characters; longer words, such as paths, are not broken."""
    wrapper = textwrap.TextWrapper(
        WIDTH, initial_indent=indent, subsequent_indent=next_indent, break_long_words=False, break_on_hyphens=False
    )
    return wrapper.fill(text)


def tell(text: str, *, indent: str = "  ") -> None:
    """Print a note between the stages, in lines of at most `WIDTH` characters."""
    for line in text.splitlines():
        print(wrap_text(line, indent=indent, next_indent=indent + "    "), flush=True)


class RunProgress:
    """Progress of a run of several stages, and its time left according to an earlier run of the same work.

    Attributes:
        ends: stages of this run that have ended
        expected: stages of the earlier run; the last one is the end of that run
    """

    def __init__(self, expected: StageEnds) -> None:
        self.expected = expected
        self.ends: list[tuple[str, float]] = []
        self._start = time.perf_counter()
        self._passed = 0  # of the expected stages

    @property
    def elapsed(self) -> float:
        """Time since the start of the run [s]."""
        return time.perf_counter() - self._start

    def end(self, label: str) -> None:
        """Record the end of a stage; stages that the earlier run did not have do not change the pace."""
        self.ends.append((label, self.elapsed))
        later = [k for k, (name, _) in enumerate(self.expected) if k >= self._passed and name == label]
        if later:
            self._passed = later[0] + 1

    def left(self) -> float | None:
        """Return the time left [s] at the pace of the stages that have ended; None if no earlier run is known."""
        if not self.expected:
            return None
        whole = self.expected[-1][1]
        if not self._passed:
            return max(whole - self.elapsed, 0.0)
        reached, now = self.expected[self._passed - 1][1], self.ends[-1][1]
        pace = now / reached if reached > 0.1 * whole else 1.0
        return max(pace * (whole - reached) - (self.elapsed - now), 0.0)


_run: ContextVar[RunProgress | None] = ContextVar("run", default=None)


@contextmanager
def track_stages(expected: StageEnds) -> Iterator[RunProgress]:
    """Show the time left of the whole run in its stages, based on the durations of an earlier run."""
    token = _run.set(RunProgress(expected))
    try:
        current = _run.get()
        assert current is not None
        yield current
    finally:
        _run.reset(token)


@contextmanager
def stage(label: str, *, total: int | None = None, unit: str = "", enabled: bool = True) -> Iterator[Advance]:
    """Show one stage of long work and how long it took.

    Within `track_stages`, the time left of the whole run is shown too. Without a terminal, percentages are added to the
    line of a stage that takes minutes.

    Args:
        label: description of the stage
        total: number of units, if known
        unit: name of what is counted, if anything
        enabled: False shows nothing

    Yields:
        Function advance(n=1) that moves the bar.
    """
    if not enabled:
        yield silent
    elif unit and sys.stderr.isatty():
        layout = COUNTER if total is None else BAR
        with _Bar(total=total, desc=label, unit=unit, bar_format=layout, mininterval=0.2) as bar:
            yield bar.update
        _end(label)
    else:
        start = time.perf_counter()
        print(f"  {label:<26}", end="", flush=True)
        try:
            yield silent if total is None else _tenths(total)
        except BaseException:
            print("stopped", flush=True)
            raise
        _end(label)
        print(f"{time.perf_counter() - start:7.1f} s{_left()}", flush=True)


def _tenths(total: int) -> Advance:
    """Return an `Advance` that prints each tenth that is reached, at most one per `SHORTEST_INTERVAL`."""
    done, shown, last = 0, 0, time.perf_counter()

    def advance(n: int = 1) -> None:
        nonlocal done, shown, last
        done += n
        tenth, now = 10 * done // total, time.perf_counter()
        if shown < tenth < 10 and now - last >= SHORTEST_INTERVAL:
            print(f" {10 * tenth} %", end="", flush=True)
            shown, last = tenth, now

    return advance


class _Bar(tqdm):  # type: ignore[misc]
    @property
    def format_dict(self) -> dict[str, object]:
        return {**super().format_dict, "left": _left()}


def _end(label: str) -> None:
    current = _run.get()
    if current is not None:
        current.end(label)


def _left() -> str:
    current = _run.get()
    seconds = None if current is None else current.left()
    if seconds is None:
        return ""
    return f"   {seconds:.0f} s left" if seconds < 100 else f"   {seconds / 60:.0f} min left"
