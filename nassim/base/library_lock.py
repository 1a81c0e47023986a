"""One at a time: NGSolve, Netgen and OpenCASCADE keep global state, which threads and forked processes would spoil."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_lock = threading.RLock()
_user: int | None = None  # process that has used NGSolve's threads


@contextmanager
def exclusive(*, forkable: bool = False) -> Iterator[None]:
    """Hold the three libraries for this thread, other threads wait; may be nested.

    forkable: the work starts none of their threads, so a process may be forked after it and go on

    Raises RuntimeError in a process that was forked after its parent had used their threads, which do not survive that:
    the work would wait for them for ever.
    """
    global _user  # noqa: PLW0603 (it stands for global state of the libraries)
    if not forkable and _user not in (None, os.getpid()):
        raise RuntimeError(
            "this process was forked after its parent had used NGSolve, whose threads do not survive that: start "
            'processes by "spawn", as in multiprocessing.get_context("spawn").Pool()'
        )
    with _lock:
        if not forkable:
            _user = os.getpid()
        yield


def _renew() -> None:
    """A thread that held the lock does not live on in a forked process and would never release it."""
    global _lock  # noqa: PLW0603
    _lock = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew)
