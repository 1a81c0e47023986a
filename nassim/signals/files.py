"""Files of measurements: time histories and FRFs, read from CSV and UFF files in SI units."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nassim.base.checks import Array, unique
from nassim.base.storage import write_atomically
from nassim.base.units import to_si
from nassim.base.warning_log import warn
from nassim.signals.frf import FRF
from nassim.signals.time_history import TimeHistory
from nassim.signals.uff import Curve, read_curves

SAME_STEP = 0.01
"""Deviation from equal sampling that is attributed to rounding of the printed times [steps]."""
OTHER_FILES = "`load` reads files of `save`; of other files, make a TimeHistory or an FRF from arrays"
"""What to do with a file of another kind."""
UFF_SUFFIXES = (".uff", ".unv", ".58")
NOT_CSV = {".mat", ".h5", ".hdf5", ".npz", ".npy", ".xls", ".xlsx", ".parquet", ".tdms", ".wav", ".pkl", ".zip", ".gz"}
"""Endings of files that are not CSV, besides UFF."""
HEADER = re.compile(r"^\s*(?P<name>[^\[\]]*?)\s*\[\s*(?P<unit>[^\[\]]+?)\s*\]\s*$")
FRF_COLUMN = re.compile(r"^(?P<pair>[^/]+(/[^/]+)*/[^/]*[^/\s]) (?P<part>real|imag|magnitude|phase)$")


def read_record(path: str | Path, *, names: Sequence[str] | None = None) -> TimeHistory:
    """Read signals that were recorded together, in SI units.

    Times that were printed with few digits are made equidistant if none deviates by more than a hundredth of a step, or
    by the rounding of seconds since 1970.
    UFF files need the package pyuff.

    Args:
        path: a CSV file whose first line gives its columns and their units, such as
            `time [s], actuator_voltage [V], encoder [um]`, after any lines that begin with "#"; or a UFF file (.uff,
            .unv) whose data sets 58 are time responses
        names: signals to keep (default: all)

    Raises:
        FileNotFoundError: if there is no such file
        ValueError: for an empty file, missing columns, a missing or unknown unit, text, gaps, NaN or unequal sampling;
            the message names file, line (data set) and cause
        RuntimeError: for a UFF file without the package pyuff
    """
    path = Path(path)
    if path.suffix.lower() in UFF_SUFFIXES:
        record = _record_of_curves(path, [curve for curve in read_curves(path) if curve.kind == "time"])
    else:
        table = _read_table(path)
        time = table.column("time", "s")
        signals = [name for name in table.names if name != "time"]
        if not signals:
            raise ValueError(f"{path}, line {table.header}: there is no signal besides the time")
        values = np.stack([table.column(name) for name in signals])
        units = tuple(table.units[name] for name in signals)
        record = TimeHistory(_equidistant(path, time, "line", table.lines), values, tuple(signals), units)
    if names is None:
        return record
    for name in unique("signal", names):
        _require(path, name, record.names)
    return record.select(names)


def write_record(history: TimeHistory, path: str | Path) -> Path:
    """Write a record as CSV that `read_record` reads, times with 16 digits, values with 12.

    The file is written completely or not at all.

    Args:
        history: the record
        path: of the file

    Returns:
        Path of the file.

    Raises:
        ValueError: for units and names that could not be read back, for a record without signals, and for the ending of
            another format
    """
    if (ending := Path(path).suffix.lower()) in {*NOT_CSV, *UFF_SUFFIXES}:
        raise ValueError(
            f"{path}: a record is written as CSV, which is no {ending} file; end the name with .csv, or `save` it as "
            ".h5, which `load` reads"
        )
    if not history.names:
        raise ValueError(f"{path}: a record without signals cannot be read back from CSV; `save` it as .h5")
    units = [unit or "-" for unit in history.units]
    for name, unit in zip(history.names, units, strict=True):
        to_si(unit)
        if set(name) & set(",[]") or not name.isprintable() or name != name.strip() or name == "time":
            raise ValueError(
                f"signal {name!r} cannot be a column's name: no commas, brackets, line breaks, tabs or blanks at its "
                "ends, and not 'time'"
            )
    header = ["time [s]", *(f"{name} [{unit}]" for name, unit in zip(history.names, units, strict=True))]
    with write_atomically(path) as temporary:
        table = np.vstack([history.time, history.values]).T
        formats = ["%.16g", *["%.12g"] * len(units)]
        np.savetxt(
            temporary, table, fmt=formats, delimiter=", ", header=", ".join(header), comments="", encoding="utf-8"
        )
    return Path(path)


def read_frf(path: str | Path, *, label: str = "recorded") -> FRF:
    """Read frequency response functions, in SI units. UFF files need the package pyuff.

    Args:
        path: a CSV file whose first line gives its columns and their units: real and imaginary part of every output
            over every input, and the coherence where it is known, such as `frequency [Hz], encoder/actuator_voltage
            real [um/V], encoder/actuator_voltage imag [um/V], encoder coherence [-]`; in place of both parts
            `encoder/actuator_voltage magnitude [um/V], encoder/actuator_voltage phase [deg]`; or a UFF file (.uff,
            .unv) whose data sets 58 are frequency response functions and coherences. Names may contain slashes, as in
            placed scenes (`strut_1/encoder/strut_1/voltage real [um/V]`). If it is ambiguous which slash separates
            output and input, write it with blanks: `encoder / strut_1/voltage real [um/V]`.
        label: text for legends

    Raises:
        FileNotFoundError: if there is no such file
        ValueError: as in `read_record`; the message names file, line (data set) and cause
        RuntimeError: for a UFF file without the package pyuff
    """
    path = Path(path)
    if path.suffix.lower() in UFF_SUFFIXES:
        return _frf_of_curves(path, read_curves(path), label)
    table = _read_table(path)
    frequency = table.column("frequency", "Hz")
    found = [match for name in table.names if (match := FRF_COLUMN.match(name))]
    if not found:
        raise ValueError(
            f"{path}, line {table.header}: no column is named like 'output/input real [unit]' or "
            "'output/input magnitude [unit]'; columns: " + ", ".join(table.names)
        )
    seen = {name.removesuffix(" coherence") for name in table.names if name.endswith(" coherence")}
    try:
        pairs = _pairs([match["pair"] for match in found], seen)
    except ValueError as error:
        raise ValueError(f"{path}, line {table.header}: {error}") from error
    outputs, inputs = (tuple(dict.fromkeys(pair[k] for pair in pairs)) for k in (0, 1))

    def response(output: str, input: str) -> Array:
        pair = pairs.get((output, input), f"{output}/{input}")
        real, imaginary, magnitude, phase = (f"{pair} {part}" for part in ("real", "imag", "magnitude", "phase"))
        if not {real, imaginary} & {*table.names} and {magnitude, phase} & {*table.names}:
            return table.column(magnitude) * np.exp(1j * table.column(phase, "rad"))
        if len({table.units[part] for part in (real, imaginary) if part in table.units}) > 1:
            raise ValueError(f"{path}, line {table.header}: {real!r} and {imaginary!r} have units of different kinds")
        return table.column(real) + 1j * table.column(imaginary)

    values = np.array([[response(output, input) for input in inputs] for output in outputs])
    coherence = None
    if any(name.endswith(" coherence") for name in table.names):
        coherence = np.stack([table.column(f"{output} coherence", "-") for output in outputs])
    return _frf(path, frequency, values, outputs, inputs, coherence, label, table.lines)


def _pairs(texts: Sequence[str], seen: set[str]) -> dict[tuple[str, str], str]:
    """Split texts "output/input" into output and input, whose names may contain slashes.

    A slash with blanks separates them. Otherwise three rules apply: every output has every input, a name with a
    coherence (`seen`) is an output, and the two names of the first text have the same number of slashes. ValueError is
    raised if several ways to split are left.
    """
    divided = {text: _splits(text) for text in texts}
    first = divided[texts[0]]
    readings = []
    for output, input in first:
        outputs = {pair[0] for pairs in divided.values() for pair in pairs if pair[1] == input}
        inputs = {pair[1] for pairs in divided.values() for pair in pairs if pair[0] == output}
        found = {
            pair: text for text, pairs in divided.items() for pair in pairs if pair[0] in outputs and pair[1] in inputs
        }
        if len(found) == len(divided) == len(outputs) * len(inputs):
            readings.append((len(outputs - seen) if seen else 0, _unevenness((output, input)), found))
    if not readings:  # the missing column is reported later
        return {min(pairs, key=_unevenness): text for text, pairs in divided.items()}
    best = min(reading[:2] for reading in readings)
    chosen = [reading[2] for reading in readings if reading[:2] == best]
    if len(chosen) > 1:
        choices = " or ".join(repr(" / ".join(next(iter(pairs)))) for pairs in chosen)
        raise ValueError(f"{texts[0]!r} may be {choices}: write the slash between output and input with blanks around")
    return chosen[0]


def _unevenness(pair: tuple[str, str]) -> int:
    """Return the difference of the numbers of slashes in two names."""
    return abs(pair[0].count("/") - pair[1].count("/"))


def _splits(text: str) -> list[tuple[str, str]]:
    """Return an (output, input) pair for every slash that may separate them, or only for slashes with blanks."""
    divider = " / " if " / " in text else "/"
    parts = text.split(divider)
    return [(divider.join(parts[:k]).strip(), divider.join(parts[k:]).strip()) for k in range(1, len(parts))]


def read_measurement(path: str | Path) -> TimeHistory | FRF:
    """Read a record or an FRF, depending on what the file holds.

    Args:
        path: a file for `read_record` or `read_frf`

    Raises:
        FileNotFoundError: if there is no such file
        ValueError: as in `read_record` and `read_frf`
        RuntimeError: for a UFF file without the package pyuff
    """
    path = Path(path)
    if path.suffix.lower() in UFF_SUFFIXES:
        is_frf = any(curve.kind == "frf" for curve in read_curves(path))
    else:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            header = next((line for line in file if line.strip() and not line.startswith("#")), "")
        columns = {cell.partition("[")[0].strip().lower() for cell in header.split(",")}
        is_frf = "frequency" in columns and "time" not in columns
    return read_frf(path) if is_frf else read_record(path)


@dataclass(frozen=True)
class _Table:
    """A CSV file in SI units.

    Attributes:
        path: of the file
        header: number of the line with the column names
        names: column names in order
        units: SI units by column name
        values: values in SI units
        lines: number of the line of each row
    """

    path: Path
    header: int
    names: tuple[str, ...]
    units: Mapping[str, str]
    values: Array
    lines: Array

    def column(self, name: str, unit: str | None = None) -> Array:
        """Return a column, after checking its unit."""
        _require(self.path, name, self.names, place=f", line {self.header}")
        if unit is not None and self.units[name] != unit:
            raise ValueError(f"{self.path}, line {self.header}: {name!r} must be in {unit}, not {self.units[name]}")
        return self.values[:, self.names.index(name)]


def _read_table(path: Path) -> _Table:
    """Read a CSV file into a table."""
    try:
        text = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: the file is not text in UTF-8 ({error.reason} at byte {error.start}); {OTHER_FILES}"
        ) from error
    header = next((k for k, line in enumerate(text) if line.strip() and not line.startswith("#")), None)
    if header is None:
        raise ValueError(f"{path}: the file is empty")
    while not text[-1].strip():
        text.pop()
    names, factors, units = [], [], {}
    for cell in text[header].split(","):
        match = HEADER.match(cell)
        if match is None or not match["name"]:
            raise ValueError(
                f"{path}, line {header + 1}: column {cell.strip()!r} must be written 'name [unit]'; {OTHER_FILES}"
            )
        try:
            factor, unit = to_si(match["unit"])
        except ValueError as error:
            raise ValueError(f"{path}, line {header + 1}: {error}") from error
        if match["name"] in units:
            raise ValueError(f"{path}, line {header + 1}: column {match['name']!r} occurs twice")
        names.append(match["name"])
        factors.append(factor)
        units[match["name"]] = unit
    rows = text[header + 1 :]
    if not rows:
        raise ValueError(f"{path}: the file ends after its header, it holds no data")
    try:
        values = np.loadtxt(rows, delimiter=",", ndmin=2, comments=None)
    except ValueError as error:
        raise _first_fault(path, rows, names, header) from error
    if values.shape != (len(rows), len(names)) or not np.all(np.isfinite(values)):
        raise _first_fault(path, rows, names, header)
    lines = np.arange(len(rows)) + header + 2
    return _Table(path, header + 1, tuple(names), units, values * np.array(factors), lines)


def _first_fault(path: Path, rows: Sequence[str], names: Sequence[str], header: int) -> ValueError:
    """Return an error for the first faulty row. The search is slow and is made for faulty files only."""
    for number, row in enumerate(rows, start=header + 2):
        cells = row.split(",")
        if not row.strip():
            return ValueError(f"{path}, line {number}: a gap, the line is empty")
        if len(cells) != len(names):
            return ValueError(f"{path}, line {number}: {len(cells)} cells, but the header names {len(names)} columns")
        for name, cell in zip(names, cells, strict=True):
            try:
                value = float(cell)
            except ValueError:
                cause = f"{cell.strip()!r} is no number" if cell.strip() else "a gap, the cell is empty"
                return ValueError(f"{path}, line {number}, column {name!r}: {cause}")
            if not np.isfinite(value):
                return ValueError(f"{path}, line {number}, column {name!r}: {cell.strip()} is not finite")
    return ValueError(f"{path}: the rows cannot be read as numbers")


def _equidistant(path: Path, time: Array, kind: str, places: Array) -> Array:
    """Return times in exactly equal steps if they are equal up to rounding; messages quote `places`."""
    if len(time) < 2:
        raise ValueError(f"{path}, {kind} {places[0]}: a record needs at least 2 samples")
    equal = np.linspace(time[0], time[-1], len(time))
    steps = np.diff(time)
    step = (time[-1] - time[0]) / (len(time) - 1)
    # Times far from zero have no more digits: seconds since 1970 are whole multiples of 2.4e-7 s.
    rounding = SAME_STEP * step + 4 * np.spacing(np.abs(time).max())
    if not step > 0 or np.abs(time - equal).max() > rounding:
        usual = float(np.median(steps))
        if usual <= 0:
            raise ValueError(f"{path}, {kind} {places[1]}: the time must rise from {kind} to {kind}")
        worst = int(np.argmax(np.abs(steps - usual)))
        raise ValueError(
            f"{path}, {kind} {places[worst + 1]}: unequal sampling, a step of {steps[worst]:.6g} s where {usual:.6g} s "
            "is usual; fill the gap or resample: take the values at equal times, as numpy.interp gives them"
        )
    return equal


def _frf(
    path: Path,
    frequency: Array,
    values: Array,
    outputs: Sequence[str],
    inputs: Sequence[str],
    coherence: Array | None,
    label: str,
    lines: Array | None,
) -> FRF:
    """Make an FRF and name the file and line in its errors."""
    falls = np.flatnonzero(np.diff(frequency) <= 0)
    if len(falls) and lines is not None:
        raise ValueError(f"{path}, line {lines[falls[0] + 1]}: the frequency must rise from line to line")
    try:
        return FRF(frequency, values, tuple(outputs), tuple(inputs), coherence, label)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _record_of_curves(path: Path, curves: Sequence[Curve]) -> TimeHistory:
    """Make a record from the time responses of a UFF file."""
    if not curves:
        raise ValueError(f"{path}: no data set 58 is a time response")
    for curve in curves[1:]:
        _same_axis(path, curve, curves[0])
    x = curves[0].x
    time = _equidistant(path, x, "sample", np.arange(len(x)) + 1)
    values = np.stack([curve.values.real for curve in curves])
    try:
        return TimeHistory(time, values, tuple(c.output for c in curves), tuple(c.unit for c in curves))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _frf_of_curves(path: Path, curves: Sequence[Curve], label: str) -> FRF:
    """Make an FRF from the curves of a UFF file."""
    responses: dict[tuple[str, str], Curve] = {}
    at_node: dict[str, set[str]] = {}
    for curve in curves:
        if curve.kind == "frf":
            if earlier := responses.get((curve.output, curve.input)):
                raise ValueError(
                    f"{path}, data set {curve.number}: {curve.output!r} is there already, in data set "
                    f"{earlier.number}; give each point an axis label, a node or a direction of its own"
                )
            responses[curve.output, curve.input] = curve
            at_node.setdefault(curve.node, set()).add(curve.output)
    if not responses:
        raise ValueError(f"{path}: no data set 58 is a frequency response function")
    first = next(iter(responses.values()))
    coherences = _coherences_of_curves(path, curves, {output for output, _ in responses}, at_node)
    for curve in (*responses.values(), *coherences.values()):
        _same_axis(path, curve, first)
    outputs, inputs = (tuple(dict.fromkeys(pair[k] for pair in responses)) for k in (0, 1))
    for output in outputs:
        for input in inputs:
            _require(path, f"{output}/{input}", [f"{o}/{i}" for o, i in responses])
    values = np.array([[responses[output, input].values for input in inputs] for output in outputs])
    coherence = np.stack([coherences[o].values.real for o in outputs]) if set(outputs) <= set(coherences) else None
    if coherences and (coherence is None or set(coherences) > set(outputs)):
        warn(
            f"{path}: its coherences are of {', '.join(coherences)}, its responses of {', '.join(outputs)}: those "
            "without a response are left out, and all of them if a response has none"
        )
    return _frf(path, first.x, values, outputs, inputs, coherence, label, None)


def _coherences_of_curves(
    path: Path, curves: Sequence[Curve], outputs: set[str], at_node: Mapping[str, set[str]]
) -> dict[str, Curve]:
    """Return the coherence of each output of a UFF file: the multiple one, else the only one; none with a warning.

    Args:
        path: of the file.
        curves: all curves.
        outputs: names of the responses.
        at_node: names of the responses at each node. A coherence may have another label than the only one there.
    """
    multiple = any(curve.kind == "multiple coherence" for curve in curves)
    found: dict[str, list[Curve]] = {}
    for curve in curves:
        if curve.kind == ("multiple coherence" if multiple else "coherence"):
            here = {curve.output} if curve.output in outputs else at_node.get(curve.node, {curve.output})
            found.setdefault(min(here) if len(here) == 1 else curve.output, []).append(curve)
    for output, several in found.items():
        if len(several) > 1:
            warn(
                f"{path}: {output!r} has {len(several)} coherences, in data sets "
                f"{', '.join(str(curve.number) for curve in several)}, such as one for each reference. An FRF has one "
                "multiple coherence of all references for each response: no coherence is read"
            )
            return {}
    return {output: several[0] for output, several in found.items()}


def _same_axis(path: Path, curve: Curve, first: Curve) -> None:
    """Check that two curves have the same axis."""
    if curve.x.shape != first.x.shape or not np.allclose(curve.x, first.x, rtol=1e-9, atol=0):
        raise ValueError(f"{path}, data set {curve.number}: its axis differs from that of data set {first.number}")


def _require(path: Path, name: str, names: Sequence[str], *, place: str = "") -> None:
    """Check that a name exists in a file."""
    if name not in names:
        raise ValueError(f"{path}{place}: there is no {name!r}; present: {', '.join(names)}")
