"""Storage of finished runs: in memory, or in a folder from which an interrupted study continues.

A folder contains `study.json` (identity of the study), `manifest.jsonl` (one line of JSON per layout and per finished
run) and `results.bin` (the numbers of all runs; the manifest has their positions). The numbers of a run are written
before its line. Even after a crash, a run is therefore stored completely or not at all. An incomplete last line is
removed.
"""

import io
import json
import os
import platform
import tempfile
import time
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

import psutil

from nassim.base.storage import code_fingerprint, write_atomically
from nassim.base.warning_log import warn
from nassim.studies.job import CLASS
from nassim.studies.outcome import Outcome
from nassim.studies.plan import Parameters
from nassim.studies.results import Axis, Layout, Quantity

FORMAT = 1
STUDY, MANIFEST, RESULTS, LOCK = "study.json", "manifest.jsonl", "results.bin", "in_use.json"
FLUSH_INTERVAL = 1.0
"""Shortest interval between two flushes of the files to the disk, which limits the loss by a power failure [s]."""


@dataclass(frozen=True)
class Record:
    """Finished run in memory.

    Attributes:
        status: see `Outcome`.
        message: see `Outcome`.
        wall_time: see `Outcome` [s].
        layout: hash of the layout; empty without a result.
        offset: position of the numbers in the results [bytes].
    """

    status: str
    message: str
    wall_time: float
    layout: str
    offset: int


class Records:
    """Finished runs of a study by name. Their numbers are in the file, or without a folder in one buffer.

    Args:
        results: file or buffer of the numbers.
        manifest: file of the manifest, or None.
    """

    def __init__(self, results: BinaryIO, manifest: BinaryIO | None = None) -> None:
        self.runs: dict[str, Record] = {}
        self.layouts: dict[str, Layout] = {}
        self._results, self._manifest = results, manifest
        self._forced = time.monotonic()

    def add(self, key: str, parameters: Parameters, outcome: Outcome) -> None:
        """Store the outcome of a run, in place of an earlier outcome.

        Args:
            key: name of the run.
            parameters: parameters of the run.
            outcome: outcome of the run.
        """
        layout = outcome.layout.digest() if outcome.layout else ""
        if outcome.layout and layout not in self.layouts:
            self.layouts[layout] = outcome.layout
            self._write({"layout": layout, **as_json(outcome.layout)})
        offset = self._results.seek(0, os.SEEK_END)
        self._results.write(outcome.data)
        self._results.flush()
        self.runs[key] = Record(outcome.status, outcome.message, outcome.wall_time, layout, offset)
        line = {"run": key, "parameters": parameters, "status": outcome.status, "wall_time_s": outcome.wall_time}
        place = {"of_layout": layout, "offset": offset, "crc32": zlib.crc32(outcome.data)}
        reasons = {"message": outcome.message, "details": outcome.details}
        self._write({**line, **{name: value for name, value in {**place, **reasons}.items() if value != ""}})

    def numbers(self, key: str) -> dict[str, Any]:
        """Return the numbers of a run with a result, by name.

        Args:
            key: name of the run.
        """
        record = self.runs[key]
        layout = self.layouts[record.layout]
        return layout.arrays(self._read(record.offset, layout))

    def resume(self) -> None:
        """Read the records of a folder; runs with incomplete numbers are ignored.

        Raises:
            ValueError: for an invalid line of the manifest, unless it is an incomplete last one.
        """
        assert self._manifest
        end = self._manifest.seek(0)
        for number, line in enumerate(self._manifest, 1):
            try:
                entry = json.loads(line) if line.endswith(b"\n") else None
                if entry is None:
                    break
                self._enter(entry)
            except (ValueError, LookupError, TypeError, AttributeError) as error:
                problem = f"line {number} of {self._manifest.name} is damaged ({error})"
                raise ValueError(f"{problem}; remove that line, and its run is repeated") from error
            end += len(line)
        self._manifest.truncate(end)

    def _enter(self, entry: dict[str, Any]) -> None:
        if "layout" in entry:
            self.layouts[entry["layout"]] = layout_of(entry)
            return
        name = entry.get("of_layout", "")
        data = self._read(entry["offset"], self.layouts[name]) if name else b""
        if zlib.crc32(data) != entry["crc32"]:
            self.runs.pop(entry["run"], None)
            return
        record = Record(entry["status"], entry.get("message", ""), entry["wall_time_s"], name, entry["offset"])
        self.runs[entry["run"]] = record

    def _read(self, offset: int, layout: Layout) -> bytes:
        self._results.seek(offset)
        return self._results.read(sum(quantity.size for quantity in layout.quantities.values()))

    def _write(self, entry: dict[str, Any]) -> None:
        if self._manifest is None:
            return
        self._manifest.seek(0, os.SEEK_END)
        self._manifest.write(json.dumps(entry).encode() + b"\n")
        self._manifest.flush()
        if time.monotonic() - self._forced > FLUSH_INTERVAL:
            self.force()

    def force(self) -> None:
        """Flush the files to the disk, the numbers before the lines that refer to them."""
        assert self._manifest
        for file in (self._results, self._manifest):
            os.fsync(file.fileno())
        self._forced = time.monotonic()


def as_json(layout: Layout) -> dict[str, Any]:
    """Return a layout as data for JSON."""
    return {
        "quantities": {name: asdict(quantity) for name, quantity in layout.quantities.items()},
        "axes": {name: asdict(axis) for name, axis in layout.axes.items()},
    }


def layout_of(entry: dict[str, Any]) -> Layout:
    """Return the layout from data of `as_json`."""
    quantities = {
        name: Quantity(tuple(q["dims"]), tuple(q["shape"]), q["complex"]) for name, q in entry["quantities"].items()
    }
    axes = {name: Axis(a["along"], tuple(a["values"]), a["unit"]) for name, a in entry["axes"].items()}
    return Layout(quantities, axes)


@contextmanager
def open_records(folder: Path | None, study: dict[str, Any]) -> Iterator[Records]:
    """Open the records of a study: those in its folder, or empty ones.

    Args:
        folder: folder of the study; None for records in memory.
        study: identity that the folder must have, see `job.identity`.

    Returns:
        Context manager with the records.

    Raises:
        ValueError: for a folder of another study, with the differences, for a folder with other files, and for a folder
            in use.
        OSError: for a folder that cannot be written.
    """
    if folder is None:
        yield Records(io.BytesIO())
        return
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        stack.enter_context(_locked(folder / LOCK))
        _check_study(folder, study)
        files = []
        for name in (RESULTS, MANIFEST):
            (folder / name).touch()
            files.append(stack.enter_context((folder / name).open("r+b")))
        records = Records(*files)
        records.resume()
        try:
            yield records
        finally:
            records.force()


def _check_study(folder: Path, study: dict[str, Any]) -> None:
    """Write the identity of a study, or compare it; warn when another version of nassim began the study."""
    path = folder / STUDY
    code = code_fingerprint()[:16]
    if not path.exists():
        if others := sorted(p.name for p in folder.iterdir() if p.name != LOCK and not p.name.startswith("nassim-")):
            raise ValueError(f"{folder} is not the folder of a study: it holds {', '.join(others[:5])}; give a new one")
        with write_atomically(path) as temporary:
            text = json.dumps({"format": FORMAT, **study, "code": code}, indent=2)
            temporary.write_text(f"{text}\n", encoding="utf-8")
        return
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        differences = list(_differences(found, study))
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} is damaged ({error!r}); give the study a new folder") from error
    if differences:
        raise ValueError(f"{folder} holds another study: {'; '.join(differences)}. Give this one a folder of its own")
    if found.get("code") != code:
        warn(
            f"the runs in {folder} were computed by another version of nassim or of the libraries beneath; they are "
            "not repeated (a new folder would do so)"
        )


def _differences(found: dict[str, Any], study: dict[str, Any]) -> Iterator[str]:
    if found["format"] != FORMAT:
        yield f"its format is {found['format']}, this nassim writes {FORMAT}"
    for name, what in (("function", "its function"), ("seed", "its seed")):
        if found[name] != study[name]:
            yield f"{what} is {found[name]}, not {study[name]}"
    if found["function"] == study["function"] and found["source"] != study["source"]:
        yield "the function's source has changed"
    for name in sorted({*found["inputs"], *study["inputs"]}):
        here, there = study["inputs"].get(name), found["inputs"].get(name)
        if here != there and not (there is None and name.startswith(CLASS)):  # earlier versions left classes out
            yield f"{name!r}, which the function carries, " + (
                "is new" if there is None else "is gone" if here is None else "has changed"
            )


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Lock a folder for one study; the lock of a process that was killed is ignored."""
    process = psutil.Process()
    own = {"host": platform.node(), "process": process.pid, "begun": process.create_time()}
    handle, name = tempfile.mkstemp(prefix="nassim-lock-", dir=path.parent)
    with open(handle, "w", encoding="utf-8") as file:
        json.dump(own, file)
    # A file of mkstemp can be read by its owner only, but others who share the folder look at its lock.
    Path(name).chmod(0o644)
    try:
        _take(path, Path(name))
    finally:
        Path(name).unlink(missing_ok=True)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def _take(path: Path, own: Path) -> None:
    """Make a lock with the content of a file.

    Raises:
        ValueError: where another process holds it.
    """
    for _ in range(2):
        try:
            _place(path, own)
        except FileExistsError:
            holder = _holder(path)
        else:
            return
        if holder is not None:
            raise ValueError(
                f"{path.parent} is in use by process {holder['process']} on {holder['host']}; if that has ended, "
                f"remove {path}"
            )
        _remove_stale(path, own.with_name(f"{own.name}-stale"))
    raise ValueError(f"another study begins in {path.parent} at this moment; give this one a folder of its own")


def _place(path: Path, content: Path) -> None:
    """Make a file with the content of another in one step, so that nobody sees it empty, where links exist."""
    try:
        os.link(content, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links
        with path.open("xb") as file:
            file.write(content.read_bytes())


def _remove_stale(path: Path, aside: Path) -> None:
    """Remove the lock of a process that has ended, and no other that took its place since it was read."""
    with suppress(FileNotFoundError):
        path.rename(aside)
        if _holder(aside) is not None:
            with suppress(FileExistsError):
                _place(path, aside)
        aside.unlink()


def _holder(path: Path) -> dict[str, Any] | None:
    """Return the holder of a lock; None for a process of this computer that no longer exists."""
    try:
        holder: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if holder["host"] != platform.node():
            return holder
        alive = psutil.Process(holder["process"]).create_time() == holder["begun"]
    except (OSError, ValueError, LookupError, psutil.Error):
        return None
    return holder if alive else None
