"""Lock for NGSolve, Netgen and OpenCASCADE, whose global state is not safe with threads and forked processes."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_lock = threading.RLock()
_user: int | None = None  # process that has used NGSolve's threads


@contextmanager
def hold_library_lock(*, forkable: bool = False) -> Iterator[None]:
    """Reserve the three libraries for this thread while other threads wait; the lock may be nested.

    Args:
        forkable: the work starts no threads of these libraries, so the process may be forked afterwards

    Raises:
        RuntimeError: in a process that was forked after its parent had used threads of these libraries. The threads do
            not survive the fork, so the work would wait for them forever.
    """
    global _user  # noqa: PLW0603 (it represents global state of the libraries)
    if not forkable and _user not in (None, os.getpid()):
        raise RuntimeError(
            "this process was forked after its parent had used NGSolve or OpenCASCADE, whose threads do not survive "
            'that: start processes by "spawn", as in multiprocessing.get_context("spawn").Pool()'
        )
    with _lock:
        if not forkable:
            _user = os.getpid()
        yield


def _renew() -> None:
    """Replace the lock in a forked process: the thread that held it does not exist there and would never release it."""
    global _lock  # noqa: PLW0603
    _lock = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew)
