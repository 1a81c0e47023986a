"""Arguments of scripts, and their end after an error."""

import argparse
import math
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from common.report import command_line, folded
from nassim.base import show_time_left


class Arguments(argparse.ArgumentParser):
    """Argument parser that reports a wrong argument in one line."""

    def error(self, message: str) -> NoReturn:
        """Print what is wrong and exit with status 2."""
        self.exit(2, f"{self.prog}: {message}; see --help\n")


def parser(doc: str, name: str) -> Arguments:
    """Make an argument parser with the options of all scripts."""
    raw = argparse.RawDescriptionHelpFormatter
    result = Arguments(description=folded(doc), formatter_class=raw, allow_abbrev=False)
    told = {"metavar": "DIR", "help": f"folder of the results (default: results/{name})"}
    result.add_argument("--output", type=writable_folder, default=f"results/{name}", **told)
    result.add_argument("--no-plot", action="store_true", help="write no pictures")
    return result


def writable_folder(text: str) -> Path:
    """Convert an argument to a folder that is created later; refuse it at once if it cannot be written."""
    folder = Path(text)
    try:
        existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        if not existing.is_dir():
            raise argparse.ArgumentTypeError(f"{existing} is a file, not a folder")
        with tempfile.TemporaryFile(dir=existing):
            return folder
    except OSError as error:
        raise argparse.ArgumentTypeError(f"cannot write to {text} ({error.strerror})") from error


def _number(kind: type, wanted: str, allowed: Callable[[Any], bool]) -> Callable[[str], Any]:
    def read(text: str) -> Any:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and allowed(value)):
            raise argparse.ArgumentTypeError(f"must be {wanted}, got {text!r}")
        return value

    return read


positive = _number(float, "a number above 0", lambda x: x > 0)
not_negative = _number(float, "a number of at least 0", lambda x: x >= 0)
fraction = _number(float, "a number from 0 to below 1", lambda x: 0 <= x < 1)


def whole(least: int) -> Callable[[str], Any]:
    """Make the type of arguments that are whole numbers."""
    return _number(int, f"a whole number of at least {least}", lambda n: n >= least)


def several(kind: Callable[[str], Any]) -> Callable[[str], list[Any]]:
    """Make the type of arguments that are lists of numbers, separated by commas; an empty text is an empty list."""

    def read(text: str) -> list[Any]:
        try:
            return [kind(part) for part in text.split(",")] if text else []
        except argparse.ArgumentTypeError as error:
            raise argparse.ArgumentTypeError(f"must be a list, each of which {error}; all: {text!r}") from error

    return read


def run(main: Callable[[], None]) -> None:
    """Run a script with estimates of the time left; print an error in one line and exit with status 2.

    Ctrl-C exits with status 130. `python -X dev script.py` shows where an error occurred.
    """
    name = Path(sys.argv[0]).name
    try:
        with show_time_left(Path(name).stem, command_line(sys.argv)):
            main()
    except KeyboardInterrupt:
        print(f"\n{name}: interrupted", file=sys.stderr)
        sys.exit(130)
    except (OSError, RuntimeError, ValueError) as error:
        if sys.flags.dev_mode:
            raise
        print(f"{name}: {' '.join(str(error).split()) or type(error).__name__}", file=sys.stderr)
        sys.exit(2)
