"""Plant errors that an engineer could make, one at a time, and see whether the tests notice.

    python tests/planted_errors.py                         # all that tests/planted_errors/*.toml list
    python tests/planted_errors.py --sample 12 --seed 7    # a dozen of them, another dozen for another seed
    python tests/planted_errors.py --names weight-sign frame-origin-sign

The repository is copied to a temporary folder. Each error replaces a snippet of one file there, runs the tests that
must catch it, and is taken back. An error that its tests pass is a survivor: a test is missing. It is also a failure
when the planted code does not even run, and when the tests fail without any error. The exit status is 1 then, else 0.

An entry whose snippet is no longer in its file exactly once, or whose tests are gone, is stale: it is reported and
skipped. Mend it where the error can still be made, else delete it.

No module needs an entry. Add one where a wrong sign, frame, unit or sample would be easy to miss, to the file in
planted_errors/ that has the name of the sub-package:

    [name-of-the-error]
    file = "nassim/package/module.py"
    old = 'a short snippet, once in the file'
    new = 'what takes its place'
    means = "what that does to the physics, in one line"
    tests = ["package/test_module.py::test_that_must_catch_it"]

Mutation tools (mutmut, cosmic-ray, mutatest) change every operator and number there is and run the whole suite for
each. They know no frames, units or half samples, and of what they leave alive most is harmless. Here an engineer chose
the errors, each with its few tests, so that a survivor always means something.
"""

import argparse
import ast
import functools
import os
import queue
import random
import re
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
LISTS = Path(__file__).with_suffix("")
COPIED = ("nassim", "models", "scripts", "tests", "docs", "pyproject.toml", "README.md", "CHANGELOG.md")
PATIENCE = 600.0
"""Seconds after which a planted run counts as hanging."""
FAILED, USAGE = 1, 4
"""Exit statuses of pytest; the latter when there is no test of the name."""
NO_CODE = re.compile(r"\b(NameError|SyntaxError|IndentationError|ImportError|ModuleNotFoundError): .*")
"""Failures of planted code that no engineer could have left: names that have changed since."""
CAUGHT, STALE = "caught", "stale, skipped"


@dataclass(frozen=True)
class PlantedError:
    """One error: `new` in the place of `old` in a file; tests: ids below tests/ that must fail then."""

    name: str
    file: str
    old: str
    new: str
    means: str
    tests: tuple[str, ...]

    def stale(self, root: Path) -> str:
        """Why it cannot be planted below a root any more, or nothing."""
        path = root / self.file
        count = path.read_text(encoding="utf-8").count(self.old) if path.exists() else 0
        if count != 1:
            return f"its snippet occurs {count} times in {self.file}"
        gone = [test for test in self.tests if not _exists(test, root)]
        return f"tests that do not exist: {', '.join(gone)}" if gone else ""

    def plant(self, root: Path) -> str:
        """Change the file below a root; returns its text from before."""
        path = root / self.file
        text = path.read_text(encoding="utf-8")
        path.write_text(text.replace(self.old, self.new), encoding="utf-8")
        return text


@dataclass(frozen=True)
class Outcome:
    """What became of an error: CAUGHT, STALE, or why it was not caught; seconds that its tests took."""

    error: PlantedError
    text: str
    seconds: float


def read_errors(folder: Path = LISTS) -> list[PlantedError]:
    """All errors listed in a folder; ValueError for an entry that is not as the docstring of this file says."""
    errors: dict[str, PlantedError] = {}
    for path in sorted(folder.glob("*.toml")):
        for name, entry in tomllib.loads(path.read_text(encoding="utf-8")).items():
            try:
                error = PlantedError(name, **{key: tuple(v) if isinstance(v, list) else v for key, v in entry.items()})
            except TypeError as problem:
                raise ValueError(f"{path.name}, [{name}]: {problem}") from problem
            if not (error.tests and error.old) or error.old == error.new:
                raise ValueError(f"{path.name}, [{name}]: needs tests, and a new snippet that differs from the old one")
            if name in errors:
                raise ValueError(f"{path.name}, [{name}]: another file has an error of this name")
            errors[name] = error
    return list(errors.values())


def _exists(test: str, root: Path) -> bool:
    file, _, function = test.partition("::")
    return function.partition("[")[0] in _functions(root / "tests" / file)


@functools.cache
def _functions(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8") if path.exists() else "")
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


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


def try_error(place: Path, error: PlantedError) -> Outcome:
    """Run an error's tests in a copy, plant it, run them again, take it back."""
    start = time.monotonic()
    text = _tried(place, error)
    return Outcome(error, text, time.monotonic() - start)


def _tried(place: Path, error: PlantedError) -> str:
    status, output = run_tests(place, error.tests)
    if status:
        return f"{STALE}: no such tests" if status == USAGE else f"its tests fail without it:\n{output}"
    before = error.plant(place)
    try:
        status, output = run_tests(place, error.tests, "-x")
    except subprocess.TimeoutExpired:
        return f"its tests hang for more than {PATIENCE:g} s"
    finally:
        (place / error.file).write_text(before, encoding="utf-8")
    if broken := NO_CODE.search(output):
        return f"its tests do not run: {broken[0]}"
    if status == FAILED:
        return CAUGHT
    last = output.strip().splitlines()[-1] if output.strip() else ""
    return "SURVIVES" if status == 0 else f"its tests do not run (status {status}): {last}"


def try_errors(errors: Sequence[PlantedError], *, root: Path, jobs: int = 1) -> list[Outcome]:
    """Try all errors, `jobs` at a time, and print how each fares."""
    with copies(root, jobs) as places:
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
    parser.add_argument("--lists", type=Path, default=LISTS, help="another folder of lists")
    options = parser.parse_args(arguments)
    errors = read_errors(options.lists)
    unknown = set(options.names) - {error.name for error in errors}
    if unknown:
        parser.error(f"no such error: {', '.join(sorted(unknown))}")
    if options.names:
        errors = [error for error in errors if error.name in options.names]
    stale = {error.name: reason for error in errors if (reason := error.stale(ROOT))}
    for name, reason in stale.items():
        print(f"{STALE}: {name}: {reason}")
    errors = [error for error in errors if error.name not in stale]
    if options.sample is not None:
        errors = random.Random(options.seed).sample(errors, min(options.sample, len(errors)))
    outcomes = try_errors(errors, root=ROOT, jobs=max(1, options.jobs))
    tried = [outcome for outcome in outcomes if not outcome.text.startswith(STALE)]
    left = [outcome for outcome in tried if outcome.text != CAUGHT]
    print(f"{len(tried)} errors planted, {len(tried) - len(left)} caught, {len(left)} not")
    for outcome in left:
        print(f"  {outcome.error.name} ({outcome.error.file}): {outcome.text}\n    {outcome.error.means}")
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())
