"""Progress of long work: a line per stage, or a bar where the amount of work is known."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm


@contextmanager
def stage(
    label: str, *, total: int | None = None, unit: str = "", enabled: bool = True
) -> Iterator[Callable[..., None]]:
    """Show one stage of long work and how long it took.

    label: what is being done; total: amount of work where known, in `unit`
    enabled: False shows nothing

    Yields a function advance(n=1) that moves the bar (it does nothing where no total is known).
    """
    if not enabled:
        yield lambda n=1: None
        return
    if total is not None:
        layout = "  {desc:<26}{percentage:3.0f}% |{bar:24}| {n_fmt}/{total_fmt} {unit} [{elapsed}<{remaining}]"
        with tqdm(total=total, desc=label, unit=unit, bar_format=layout, mininterval=0.2) as bar:
            yield bar.update
        return
    start = time.perf_counter()
    print(f"  {label:<26}", end="", flush=True)
    try:
        yield lambda n=1: None
    except BaseException:
        print("stopped")
        raise
    print(f"{time.perf_counter() - start:7.1f} s", flush=True)
