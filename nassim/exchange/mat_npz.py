"""Readers for MATLAB's .mat and NumPy's .npz files that may be damaged or malicious.

Memory is allocated only after its size has been checked, nothing is unpickled, and every defect raises a ValueError
that names its location. Sources: MathWorks, MAT-File Format (level 4 and 5); NumPy Enhancement Proposal 1.
"""

import io
import math
import struct
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nassim.base.checks import Array

LARGEST_FILE = 128 * 2**20
"""Largest size of a file and of an unpacked variable [bytes]."""
LARGEST_TOTAL = 4 * LARGEST_FILE
"""Largest total size of all variables of a file [bytes]."""
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _COMPRESSED = 14, 15
_CELL_CLASS, _TEXT_CLASS, _SPARSE_CLASS, _NUMERIC_CLASSES, _COMPLEX = 1, 4, 5, range(6, 16), 0x08
_CODES = _NUMBERS | {16: "u1", 17: "u2"}
_LEVEL_4 = {0: "f8", 1: "f4", 2: "i4", 3: "i2", 4: "u2", 5: "u1"}


class _Element(NamedTuple):
    kind: int
    data: bytes


def read_bytes(path: Path) -> bytes:
    """Return the content of a file; raise ValueError when it cannot be read or is larger than `LARGEST_FILE`."""
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from error
    if len(data) > LARGEST_FILE:
        raise ValueError(f"{path}: larger than {LARGEST_FILE >> 20} MB, the most that is read")
    return data


def read_arrays(path: str | Path) -> dict[str, Array]:
    """Read arrays of numbers and of text from a .mat (levels 4, 5, 7) or .npz file.

    Variables of other kinds (structures, tables, cells of other things than text) are omitted.

    Args:
        path: the file.

    Returns:
        Arrays by name; an array of text has one string per row, or per cell.

    Raises:
        ValueError: naming the file and the variable, for damaged files, pickled objects, complex numbers, a variable
            larger than `LARGEST_FILE`, and variables that are together larger than `LARGEST_TOTAL`.
    """
    source = Path(path)
    data = read_bytes(source)
    try:
        variables = _npz(data) if source.suffix.lower() == ".npz" else _mat(data)
        return dict(_within_total(variables))
    except _SIGNS_OF_DAMAGE as error:
        raise ValueError(f"{source}: damaged or of another format: {error or type(error).__name__}") from error


_SIGNS_OF_DAMAGE = (
    ValueError,  # also UnicodeError
    KeyError,
    IndexError,
    EOFError,
    OSError,
    OverflowError,
    RuntimeError,  # zipfile: encrypted, also NotImplementedError
    SyntaxError,
    TypeError,
    struct.error,
    zlib.error,
    zipfile.BadZipFile,
)


def _within_total(variables: Iterator[tuple[str, Array]]) -> Iterator[tuple[str, Array]]:
    total = 0
    for name, array in variables:
        total += array.nbytes
        if total > LARGEST_TOTAL:
            raise ValueError(f"all variables up to {name!r} hold more than {LARGEST_TOTAL >> 20} MB, the most together")
        yield name, array


def _npz(data: bytes) -> Iterator[tuple[str, Array]]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for member in archive.infolist():
            if not member.filename.endswith(".npy"):
                continue
            name = member.filename.removesuffix(".npy")
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ValueError(f"variable {name!r} is compressed in another way than NumPy does")
            with archive.open(member) as stream:
                content = stream.read(LARGEST_FILE + 1)
            _limit(name, len(content))
            yield name, _npy(name, content)


def _npy(name: str, content: bytes) -> Array:
    stream = io.BytesIO(content)
    version = np.lib.format.read_magic(stream)
    read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
    shape, columns_first, dtype = read_header(stream)
    if dtype.kind not in "fiuU":
        raise ValueError(f"variable {name!r} holds {dtype}, not real numbers or text")
    if any(n < 0 for n in shape) or math.prod(shape) * dtype.itemsize != len(content) - stream.tell():
        raise ValueError(f"variable {name!r} says it has shape {shape}, which is not the length of its data")
    flat = np.frombuffer(content, dtype, offset=stream.tell()) if math.prod(shape) else np.zeros(0, dtype)
    return _plain(flat.reshape(shape, order="F" if columns_first else "C"))


def _mat(data: bytes) -> Iterator[tuple[str, Array]]:
    if data[:10] == b"MATLAB 7.3" or data[:8] == b"\x89HDF\r\n\x1a\n":
        raise ValueError("a .mat file of version 7.3 (HDF5); save it again in MATLAB with the option '-v7'")
    if data[126:128] not in (b"IM", b"MI"):
        yield from _level_4(data)
        return
    order = "<" if data[126:128] == b"IM" else ">"
    for element in _elements(data[128:], order):
        variable = element
        if element.kind == _COMPRESSED:
            stream = zlib.decompressobj()
            unpacked = stream.decompress(element.data, LARGEST_FILE + 1)
            _limit("", len(unpacked))
            variable = next(_elements(unpacked, order))
        if variable.kind == _MATRIX:
            yield from _level_5(variable.data, order)


def _elements(data: bytes, order: str) -> Iterator[_Element]:
    """Yield the tagged elements in order; each one is padded to eight bytes."""
    place = 0
    while place + 8 <= len(data):
        (tag,) = struct.unpack_from(order + "I", data, place)
        if tag >> 16:  # up to four bytes, inside the tag
            kind, size, start, step = tag & 0xFFFF, tag >> 16, place + 4, 8
            if size > 4:
                raise ValueError(f"a small element says it has {size} bytes, at byte {place}")
        else:
            kind, size, start = tag, struct.unpack_from(order + "I", data, place + 4)[0], place + 8
            step = 8 + (size if kind == _COMPRESSED else -(-size // 8) * 8)
        if start + size > len(data):
            raise ValueError(f"cut off: an element needs {size} bytes at byte {start}, {len(data) - start} are left")
        yield _Element(kind, data[start : start + size])
        place += step
    if place < len(data):
        raise ValueError(f"cut off: {len(data) - place} byte(s) left over at the end")


def _level_5(data: bytes, order: str) -> Iterator[tuple[str, Array]]:
    """Yield the variable of a matrix element if it is numeric, text, or cells of text."""
    parts = list(_elements(data, order)) if data else []
    if len(parts) < 3 or len(parts[0].data) < 4:
        return
    (flags,) = struct.unpack_from(order + "I", parts[0].data)
    kind, name = flags & 0xFF, parts[2].data.decode("latin-1")
    if kind == _CELL_CLASS:
        cells = [list(_elements(part.data, order)) for part in parts[3:]]
        kinds = {struct.unpack_from(order + "I", cell[0].data)[0] & 0xFF for cell in cells if cell}
        if kinds == {_TEXT_CLASS} and all(cells):
            texts = [text for part in parts[3:] for _, text in _level_5(part.data, order)]
            yield name, np.array(["".join(text.tolist()) for text in texts])
        return
    if kind not in (_TEXT_CLASS, _SPARSE_CLASS, *_NUMERIC_CLASSES):
        return
    if (flags >> 8) & _COMPLEX:
        raise ValueError(f"variable {name!r} is complex; it must be real")
    shape = tuple(_numbers(parts[1], order).astype(int).tolist())
    if any(n < 0 for n in shape):
        raise ValueError(f"variable {name!r} has a negative size, {shape}")
    if kind == _SPARSE_CLASS:
        yield name, _sparse(name, shape, [_numbers(part, order) for part in parts[3:6]])
        return
    flat = _characters(parts[3], order) if kind == _TEXT_CLASS else _numbers(parts[3], order)
    if math.prod(shape) != flat.size:
        raise ValueError(f"variable {name!r} says it has shape {shape}, which is not the length of its data")
    values = flat.reshape(shape, order="F")
    if kind == _TEXT_CLASS:
        rows = values.reshape(math.prod(shape[:-1]), shape[-1]).astype(int).tolist()
        yield name, np.array(["".join(chr(code) for code in row).rstrip() for row in rows], dtype=str)
    else:
        yield name, _plain(values)


def _characters(element: _Element, order: str) -> Array:
    """Return character codes of text, which is stored as numbers, UTF-8 or UTF-16."""
    codecs = {16: "utf-8", 17: "utf-16-le" if order == "<" else "utf-16-be"}
    if element.kind not in codecs:
        return _numbers(element, order)
    return np.array([ord(letter) for letter in element.data.decode(codecs[element.kind])], dtype=float)


def _sparse(name: str, shape: tuple[int, ...], parts: list[Array]) -> Array:
    rows, starts, values = parts
    _limit(name, 8 * math.prod(shape))
    n_rows, n_columns = shape
    starts = starts.astype(np.int64)
    count = int(starts[-1])
    if len(starts) != n_columns + 1 or starts[0] != 0 or np.any(np.diff(starts) < 0) or count > values.size:
        raise ValueError(f"variable {name!r}: the column indices of the sparse matrix are inconsistent")
    rows = rows[:count].astype(np.int64)
    if len(rows) != count or np.any(rows < 0) or np.any(rows >= n_rows):
        raise ValueError(f"variable {name!r}: the row indices of the sparse matrix are inconsistent")
    result = np.zeros(shape)
    result[rows, np.repeat(np.arange(n_columns), np.diff(starts))] = values[:count]
    return result


def _numbers(element: _Element, order: str) -> Array:
    if element.kind not in _CODES:
        raise ValueError(f"an element holds data of kind {element.kind}, not numbers")
    return np.frombuffer(element.data, order + _CODES[element.kind])


def _level_4(data: bytes) -> Iterator[tuple[str, Array]]:
    place = 0
    while place < len(data):
        # A header begins with a number below 100; big-endian files add 1000 to it.
        order = "<" if 0 <= struct.unpack_from("<i", data, place)[0] < 1000 else ">"
        code, n_rows, n_columns, is_complex, name_length = struct.unpack_from(order + "5i", data, place)
        thousands, precision, kind = code // 1000, code // 10 % 10, code % 10
        if thousands != (order == ">") or code // 100 % 10 or precision not in _LEVEL_4 or min(n_rows, n_columns) < 0:
            raise ValueError(f"no .mat header at its start and no variable of level 4 at byte {place}")
        if not 1 <= name_length <= 64:
            raise ValueError(f"a variable's name has {name_length} characters, at byte {place}")
        start = place + 20 + name_length
        name = data[place + 20 : start - 1].decode("latin-1")
        dtype = np.dtype(order + _LEVEL_4[precision])
        place = start + n_rows * n_columns * dtype.itemsize * (2 if is_complex else 1)
        if place > len(data):
            raise ValueError(f"cut off: variable {name!r} needs {place - start} bytes, {len(data) - start} are left")
        if is_complex:
            raise ValueError(f"variable {name!r} is complex; it must be real")
        if kind == 0:
            values = np.frombuffer(data, dtype, n_rows * n_columns, start)
            yield name, _plain(values.reshape((n_rows, n_columns), order="F"))


def _limit(name: str, size: int) -> None:
    if size > LARGEST_FILE:
        raise ValueError(f"variable {name!r} unpacks to more than {LARGEST_FILE >> 20} MB, the most that is read")


def _plain(array: Any) -> Array:
    """Return a copy in the byte order of the machine."""
    return np.array(array, dtype=array.dtype.newbyteorder("="))
