"""Plant errors that an engineer could make, one at a time, and see whether the tests notice.

    python tests/planted_errors.py                         # all of planted_errors.toml
    python tests/planted_errors.py --sample 12 --seed 7    # a dozen of them, another dozen for another seed
    python tests/planted_errors.py --names weight-sign frame-origin-sign

The repository is copied to a temporary folder. Each error replaces a snippet of one file there, runs the tests that
must catch it, and is taken back. An error that its tests pass is a survivor: a test is missing. It is also a failure
when a snippet is no longer there exactly once, when the planted code does not even run, and when a named test does not
exist or fails without any error. The exit status is 1 then, else 0.

To add an error, append a table to planted_errors.toml:

    [name-of-the-error]
    file = "nassim/wing/module.py"
    old = 'a short snippet, once in the file'
    new = 'what takes its place'
    means = "what that does to the physics, in one line"
    tests = ["wing/test_module.py::test_that_must_catch_it"]
    needs = ["chromium"]  # programs without which its tests are skipped, and so is the error; they are also in CI

Mutation tools (mutmut, cosmic-ray, mutatest) change every operator and number there is and run the whole suite for
each. They know no frames, units or half samples, and of what they leave alive most is harmless. Here an engineer chose
the errors, each with its few tests, so that all take minutes and a survivor always means something.
"""

import argparse
import ast
import itertools
import os
import queue
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

try:
    import tomllib
except ImportError:  # Python 3.10, where pytest brings it
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_suffix(".toml")
COPIED = ("nassim", "models", "scripts", "tests", "docs", "pyproject.toml", "README.md", "CHANGELOG.md")
PATIENCE = 600.0
"""Seconds after which a planted run counts as hanging."""
FAILED, NO_TESTS = 1, 5
"""Exit statuses of pytest."""


@dataclass(frozen=True)
class PlantedError:
    """One error: `new` in the place of `old` in a file; tests: ids below tests/ that must fail then.

    needs: programs without which these are skipped
    """

    name: str
    file: str
    old: str
    new: str
    means: str
    tests: tuple[str, ...]
    needs: tuple[str, ...] = ()

    @property
    def can_be_tried(self) -> bool:
        """Whether its tests run here."""
        return not self.needs or ("CI" not in os.environ and all(map(shutil.which, self.needs)))

    def plant(self, root: Path) -> str:
        """Change the file below a root; returns its text from before. ValueError where the snippet does not fit."""
        path = root / self.file
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        if text.count(self.old) != 1:
            raise ValueError(f"the patch no longer applies: its snippet occurs {text.count(self.old)} times")
        path.write_text(text.replace(self.old, self.new), encoding="utf-8")
        return text


@dataclass(frozen=True)
class Outcome:
    """What became of an error: caught, or why not; seconds that its tests took."""

    error: PlantedError
    caught: bool
    text: str
    seconds: float


def read_errors(path: Path = LIST) -> list[PlantedError]:
    """All errors of a list, in order; ValueError for a table that is not as the docstring of this file says."""
    errors = []
    for name, entry in tomllib.loads(path.read_text(encoding="utf-8")).items():
        try:
            error = PlantedError(name, **{key: tuple(v) if isinstance(v, list) else v for key, v in entry.items()})
        except TypeError as problem:
            raise ValueError(f"{path.name}, [{name}]: {problem}") from problem
        if not (error.tests and error.old) or error.old == error.new:
            raise ValueError(f"{path.name}, [{name}]: needs tests, and a new snippet that differs from the old one")
        errors.append(error)
    return errors


def missing_tests(errors: Sequence[PlantedError], root: Path = ROOT) -> list[str]:
    """Named tests whose file or function does not exist."""
    known: dict[str, set[str]] = {}
    missing = []
    for test in dict.fromkeys(itertools.chain.from_iterable(error.tests for error in errors)):
        file, _, function = test.partition("::")
        path = root / "tests" / file
        if file not in known:
            tree = ast.parse(path.read_text(encoding="utf-8") if path.exists() else "")
            known[file] = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        if function.partition("[")[0] not in known[file]:
            missing.append(test)
    return missing


@contextmanager
def copies(root: Path, count: int) -> Iterator[list[Path]]:
    """Copies of a repository in temporary folders."""
    with tempfile.TemporaryDirectory(prefix="planted_") as folder:
        places = [Path(folder) / str(k) for k in range(count)]
        for place in places:
            place.mkdir()
            for name in COPIED:
                if (root / name).is_dir():
                    shutil.copytree(root / name, place / name, ignore=shutil.ignore_patterns("__pycache__", "results"))
                elif (root / name).exists():
                    shutil.copy(root / name, place / name)
        yield places


def run_tests(place: Path, tests: Sequence[str], *options: str) -> tuple[int, str]:
    """Exit status and output of pytest on a copy; TimeoutExpired when it hangs."""
    # The copy's own modules, and no bytecode: a patch may keep a file's size and time.
    own = {"PYTHONPATH": str(place), "PYTHONDONTWRITEBYTECODE": "1", "MPLBACKEND": "Agg"}
    ids = [f"tests/{test}" for test in dict.fromkeys(tests)]
    command = [sys.executable, "-m", "pytest", "-m", "", "-q", "-p", "no:cacheprovider", "--tb=line", *options, *ids]
    run = subprocess.run(
        command, cwd=place, env=os.environ | own, capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    return run.returncode, run.stdout + run.stderr


def check_tests(place: Path, errors: Sequence[PlantedError]) -> str:
    """What is wrong with the named tests before anything is planted, or nothing."""
    missing = missing_tests(errors, place)
    if missing:
        return f"tests that do not exist: {', '.join(missing)}"
    status, output = run_tests(place, [test for error in errors for test in error.tests])
    if status:
        return f"the tests fail without any planted error:\n{output}"
    return ""


def try_error(place: Path, error: PlantedError) -> Outcome:
    """Plant an error in a copy, run its tests, take it back."""
    start = time.monotonic()

    def outcome(caught: bool, text: str) -> Outcome:
        return Outcome(error, caught, text, time.monotonic() - start)

    try:
        before = error.plant(place)
    except ValueError as problem:
        return outcome(False, str(problem))
    try:
        status, output = run_tests(place, error.tests, "-x")
    except subprocess.TimeoutExpired:
        return outcome(False, f"its tests hang for more than {PATIENCE:g} s")
    finally:
        (place / error.file).write_text(before, encoding="utf-8")
    last = output.strip().splitlines()[-1] if output.strip() else ""
    if status == FAILED:
        return outcome(True, "caught")
    return outcome(False, "SURVIVES" if status == 0 else f"its tests do not run (status {status}): {last}")


def try_errors(errors: Sequence[PlantedError], *, root: Path = ROOT, jobs: int = 1) -> list[Outcome]:
    """Try all errors, `jobs` at a time, and print how each fares; ValueError where the tests themselves are wrong."""
    if not errors:
        return []
    with copies(root, jobs) as places:
        problem = check_tests(places[0], errors)
        if problem:
            raise ValueError(problem)
        idle: queue.SimpleQueue[Path] = queue.SimpleQueue()
        for place in places:
            idle.put(place)

        def one(error: PlantedError) -> Outcome:
            place = idle.get()
            try:
                return try_error(place, error)
            finally:
                idle.put(place)

        outcomes = []
        with ThreadPoolExecutor(jobs) as pool:
            for outcome in pool.map(one, errors):
                print(f"{outcome.seconds:6.1f} s  {outcome.error.name:40} {outcome.text}", flush=True)
                outcomes.append(outcome)
    return outcomes


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--names", nargs="+", default=[], help="only these errors")
    parser.add_argument("--sample", type=int, metavar="N", help="only so many of them, drawn at random")
    parser.add_argument("--seed", default="0", help="of the draw: any text, such as a commit's hash")
    parser.add_argument("--jobs", type=int, default=1, help="how many at a time")
    parser.add_argument("--list", type=Path, default=LIST, help="another list")
    options = parser.parse_args(arguments)
    errors = read_errors(options.list)
    unknown = set(options.names) - {error.name for error in errors}
    if unknown:
        parser.error(f"no such error: {', '.join(sorted(unknown))}")
    if options.names:
        errors = [error for error in errors if error.name in options.names]
    left_out = [error.name for error in errors if not error.can_be_tried]
    errors = [error for error in errors if error.can_be_tried]
    if left_out:
        print(f"{len(left_out)} left out, whose tests need programs that are not here: {', '.join(left_out)}")
    if options.sample is not None:
        errors = random.Random(options.seed).sample(errors, min(options.sample, len(errors)))
    try:
        outcomes = try_errors(errors, jobs=max(1, options.jobs))
    except ValueError as problem:
        print(problem)
        return 1
    left = [outcome for outcome in outcomes if not outcome.caught]
    print(f"{len(outcomes)} errors planted, {len(outcomes) - len(left)} caught, {len(left)} not")
    for outcome in left:
        print(f"  {outcome.error.name} ({outcome.error.file}): {outcome.text}\n    {outcome.error.means}")
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())
