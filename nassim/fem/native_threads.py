"""Threads of native libraries: of NGSolve, and of the BLAS of NumPy and SciPy.

Threads of OpenBLAS wait for each other at the end of each product, and meanwhile keep their processors busy. With
other work on the processors, each of many small products then waits for the operating system: a reduction on two
threads took up to six times as long as on one. So only large products are shared among threads of BLAS. Work that
consists of independent pieces has one thread of Python for each piece, with BLAS on one thread (`share`). The
environment variable NASSIM_THREADS overrides the number of threads.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import ngsolve
import scipy.linalg  # noqa: F401 (loads SciPy's own BLAS, so that _BLAS finds it)
from threadpoolctl import ThreadpoolController

from nassim.base.library_lock import hold_library_lock

LARGE_PRODUCT = 1e8
"""Number of multiplications from which a product is shared among threads; they take some 5 ms on one."""

Piece = TypeVar("Piece")
Result = TypeVar("Result")

_BLAS = ThreadpoolController().select(internal_api="openblas")
_running = False  # changed only by the thread that holds the lock of NGSolve, as the next
_sharing = False
_limit: int | None = None  # number of threads to which BLAS is limited now


def n_threads() -> int:
    """Return NASSIM_THREADS (environment variable), otherwise the number of processors that this process may use."""
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return int(os.environ.get("NASSIM_THREADS", available))


@contextmanager
def blas_threads(work: float) -> Iterator[None]:
    """Run NumPy and SciPy on `n_threads` threads for large products, otherwise and within `threads` and `share` on one.

    Args:
        work: number of multiplications in one product
    """
    if _sharing:
        yield
    else:
        with hold_library_lock(), _limit_blas(n_threads() if work >= LARGE_PRODUCT and not _running else 1):
            yield


def share(run: Callable[[Piece], Result], pieces: Sequence[Piece]) -> list[Result]:
    """Return the results of pieces of work by NumPy and SciPy, which run on `n_threads` threads, with BLAS on one each.

    Args:
        run: function of a piece; it must not use NGSolve
        pieces: the pieces, which do not depend on each other
    """
    global _sharing  # noqa: PLW0603 (changed only by the thread that holds the lock)
    with blas_threads(0):
        if _sharing or min(n_threads(), len(pieces)) < 2:
            return [run(piece) for piece in pieces]
        _sharing = True
        try:
            with ThreadPoolExecutor(n_threads()) as pool:
                return list(pool.map(run, pieces))
        finally:
            _sharing = False


@contextmanager
def _limit_blas(limit: int) -> Iterator[None]:
    """Limit the threads of BLAS; it costs a tenth of a millisecond where the limit changes, and nothing elsewhere."""
    global _limit  # noqa: PLW0603 (it represents global state of OpenBLAS)
    if limit == _limit:
        yield
        return
    before, _limit = _limit, limit
    try:
        with _BLAS.limit(limits=limit):
            yield
    finally:
        _limit = before


@contextmanager
def threads() -> Iterator[None]:
    """Run NGSolve on all processors that this process may use, or on NASSIM_THREADS of them (environment variable).

    NumPy's own threads are stopped meanwhile. They keep spinning after each product and would take the processors from
    the solver, which halves its speed. The context may be nested; the outermost one counts, and other threads of Python
    wait for its end.
    """
    global _running  # noqa: PLW0603 (it represents global state of NGSolve)
    with hold_library_lock():
        if _running:
            yield
            return
        ngsolve.SetNumThreads(n_threads())
        _running = True
        try:
            with _limit_blas(1), ngsolve.TaskManager():
                yield
        finally:
            _running = False
