"""Log of warnings and notes about how a result was made, to be kept with the result."""

import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

PASSED_OVER = ("nassim.", "contextlib", "dataclasses")
"""Beginnings of the names of modules that hold no line of the user; the latter two call nassim for users."""


@dataclass(frozen=True)
class WarningLog:
    """Log of messages.

    Attributes:
        warnings: messages of `warn`, in order
        notes: messages of `note`, in order
    """

    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


_collectors: ContextVar[tuple[WarningLog, ...]] = ContextVar("collectors", default=())
_muted: ContextVar[tuple[str, ...]] = ContextVar("muted", default=())


def warn(message: str) -> None:
    """Warn the user through Python's `warnings`, and add the message to all open logs.

    The warning names the line that called nassim, through however many functions, context managers and data classes.
    """
    if any(re.match(start, message) for start in _muted.get()):
        return
    for log in _collectors.get():
        log.warnings.append(message)
    frame, level = sys._getframe(1), 1
    while (above := frame.f_back) and frame.f_globals.get("__name__", "").startswith(PASSED_OVER):
        frame, level = above, level + 1
    warnings.warn(message, stacklevel=level + 1)


def note(message: str) -> None:
    """Add a message to all open logs without a warning, for a change of method that does not reduce accuracy."""
    for log in _collectors.get():
        log.notes.append(message)


@contextmanager
def collect_messages() -> Iterator[WarningLog]:
    """Open a log that collects the messages of this thread; logs may be nested, and each one gets all messages."""
    log = WarningLog()
    token = _collectors.set((*_collectors.get(), log))
    try:
        yield log
    finally:
        _collectors.reset(token)


@contextmanager
def mute_warnings(start: str = "") -> Iterator[None]:
    """Give no warnings whose text starts with a regular expression, those of other libraries included."""
    token = _muted.set((*_muted.get(), start))
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=start)
            yield
    finally:
        _muted.reset(token)
