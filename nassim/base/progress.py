"""Progress of long work: a bar or a counter on a terminal, a line per stage elsewhere."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm

Advance = Callable[..., None]
"""Called as advance(n=1) when n more units of a stage are done."""

BAR = "  {desc:<26}{percentage:3.0f}% |{bar:24}| {n_fmt}/{total_fmt} {unit} [{elapsed}<{remaining}]"
COUNTER = "  {desc:<26}{n_fmt} {unit} [{elapsed}]"


def silent(n: int = 1) -> None:
    """An `Advance` that shows nothing."""


@contextmanager
def stage(label: str, *, total: int | None = None, unit: str = "", enabled: bool = True) -> Iterator[Advance]:
    """Show one stage of long work and how long it took.

    label: what is being done; unit: what is counted, if anything; total: how many of them, where known
    enabled: False shows nothing

    Yields a function advance(n=1) that moves the bar.
    """
    if not enabled:
        yield silent
    elif unit and sys.stderr.isatty():
        layout = COUNTER if total is None else BAR
        with tqdm(total=total, desc=label, unit=unit, bar_format=layout, mininterval=0.2) as bar:
            yield bar.update
    else:
        start = time.perf_counter()
        print(f"  {label:<26}", end="", flush=True)
        try:
            yield silent
        except BaseException:
            print("stopped", flush=True)
            raise
        print(f"{time.perf_counter() - start:7.1f} s", flush=True)
