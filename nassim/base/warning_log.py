"""What a result must remember of its making: warnings, given at once too, and notes of what was done otherwise."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Notices:
    """Messages of `warn` and of `note`, in order."""

    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


_collectors: ContextVar[tuple[Notices, ...]] = ContextVar("collectors", default=())


def warn(message: str, *, stacklevel: int = 1) -> None:
    """Warn the user, by Python's `warnings`, and tell whoever collects.

    stacklevel: as in `warnings.warn`, counted from the caller
    """
    for notices in _collectors.get():
        notices.warnings.append(message)
    warnings.warn(message, stacklevel=stacklevel + 1)


def note(message: str) -> None:
    """Tell whoever collects, without a warning: for what leaves the result as good as what was asked for."""
    for notices in _collectors.get():
        notices.notes.append(message)


@contextmanager
def collected() -> Iterator[Notices]:
    """Collect what is told within, by this thread only; may be nested, all collectors hear it."""
    notices = Notices()
    token = _collectors.set((*_collectors.get(), notices))
    try:
        yield notices
    finally:
        _collectors.reset(token)
