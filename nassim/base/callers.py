"""Who has called nassim: where warnings point."""

import sys
from pathlib import Path

PACKAGE_FOLDER = str(Path(__file__).resolve().parent.parent)


def outside() -> int:
    """Return the `stacklevel` with which a warning of the calling function points to the first line outside nassim."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back and frame.f_code.co_filename.startswith(PACKAGE_FOLDER):
        level, frame = level + 1, frame.f_back
    return level
