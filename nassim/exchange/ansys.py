"""ANSYS text listings of a superelement: its matrices, its nodes, and the node of each row.

The parser accepts the usual variations of such listings: the title of the matrix, blanks inside [ 1, 2], numbers that
follow without a blank, missing line breaks, banners and headings between rows, node tables with and without rotations,
and tables in any order and in any number of files.
"""

import re
from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nassim.base.checks import Array
from nassim.base.field_types import ArrayLike
from nassim.exchange.mat_npz import read_bytes
from nassim.exchange.nodal_matrices import MOST_COORDINATES, NodalMatrices, given_dofs, given_positions

LONGEST_TEXT = 64 * 2**20
"""Largest number of characters in the texts of one superelement, enough for the largest number of coordinates."""
DOFS = ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ")
_TITLE = r"(?P<title>\b[A-Za-z]+_(?P<letter>[KMCD])\s*:)"
_ENTRY = r"\[\s*(?P<row>\d{1,9})\s*,\s*(?P<column>\d{1,9})\s*\]\s*:\s*(?P<value>[^\s\[\]]*)"
_BROKEN = r"(?P<broken>\[)"
_MATRIX_TEXT = re.compile(f"{_ENTRY}|{_BROKEN}|{_TITLE}")
_REAL = r"[+-]?(?:\d+\.\d*|\.\d+)(?:[EeDd][+-]?\d+)?"
_INTEGER = r"[+-]?\d+"
# A node with three or six reals anywhere in the text, or with any numbers on a line of its own.
_NODE = re.compile(rf"(?<!\S)(\d{{1,9}})((?:\s+{_REAL}|[+-](?:\d+\.\d*|\.\d+)(?:[EeDd][+-]?\d+)?){{2,}})(?!\S)")
_NODE_LINE = re.compile(rf"^[ \t]*(\d{{1,9}})((?:[ \t]+(?:{_REAL}|{_INTEGER})){{3,}})[ \t]*\r?$", re.MULTILINE)
_MASTER = re.compile(r"(?<!\S)(\d{1,9})\s+(UX|UY|UZ|ROTX|ROTY|ROTZ)\b")
_NODE_HEADING = re.compile(r"\bNODE\s+X\s+Y\s+Z\b")
_Entries = tuple["array[int]", "array[int]", "array[float]", "array[int]"]


@dataclass(frozen=True)
class Listing:
    """Contents of listings, in their own units and order.

    Attributes:
        matrices: matrices by letter, "K" and "M", (n, n), rows in the order of the listing.
        nodes: coordinates by node number, (3,).
        angles: nodal frames THXY THYZ THZX by node number, (3,) [deg].
        masters: node and DoF of the first rows, in order.
        where: name of the file of each matrix, by letter.
    """

    matrices: Mapping[str, Array]
    nodes: dict[int, Array]
    angles: Mapping[int, Array]
    masters: tuple[tuple[int, str], ...]
    where: Mapping[str, str] = field(default_factory=dict)


def read_listings(
    paths: Sequence[Path],
    *,
    positions: Mapping[int, ArrayLike] | None,
    dofs: Iterable[Sequence[int]] | None,
) -> NodalMatrices:
    """Read stiffness and mass of a superelement from listings.

    Args:
        paths: all files.
        positions: coordinates by node, (3,), which replace those of the files.
        dofs: node and component of each row (default: the table of masters, then modal coordinates).

    Raises:
        ValueError: naming file and cause, without a table of masters or dofs, and for more masters than the matrices
            have rows.
    """
    label = ", ".join(map(str, paths))
    listing = parse_listings({str(path): _text(path) for path in paths})
    n = len(listing.matrices["K"])
    rows = [(node, 1 + DOFS.index(dof)) for node, dof in listing.masters]
    if not rows and dofs is None:
        raise ValueError(
            f"{label}: no table of master DoFs (heading NODE DOF): which row belongs to which node? Add the table, or "
            f"give dofs=[(node, component), ...], {n} pairs"
        )
    if len(rows) > n:
        raise ValueError(f"{label}: {len(rows)} master DoFs, but matrices of {n} x {n}; one of them is cut")
    rows += [(k, 0) for k in range(n - len(rows))]
    return NodalMatrices(
        listing.matrices["K"],
        listing.matrices["M"],
        tuple(rows) if dofs is None else given_dofs(dofs, n, label),
        listing.nodes | given_positions(positions, label),
        {node: nodal_frame(angles) for node, angles in listing.angles.items() if np.any(angles)},
    )


def _text(path: Path) -> str:
    data = read_bytes(path)
    if b"\0" in data:
        raise ValueError(f"{path}: binary data, not a text listing")
    return data.decode("latin-1")


def parse_listings(texts: Mapping[str, str]) -> Listing:
    """Parse the listings of one superelement.

    Args:
        texts: texts by file name.

    Returns:
        Matrices, nodes, angles and masters of all texts.

    Raises:
        ValueError: naming file, line and cause, for entries that are not numbers, missing or contradictory, for
            matrices of different size, and for truncated tables.
    """
    if sum(map(len, texts.values())) > LONGEST_TEXT:
        raise ValueError(
            f"{', '.join(texts)}: more than {LONGEST_TEXT >> 20} million characters, the most that is read"
        )
    matrices: dict[str, Array] = {}
    where: dict[str, str] = {}
    nodes: dict[int, Array] = {}
    angles: dict[int, Array] = {}
    masters: dict[tuple[int, str], None] = {}
    for file, text in texts.items():
        for letter, matrix in _matrices(file, text).items():
            if letter in matrices:
                raise ValueError(f"{file}: a second matrix {letter}; the first is in {where[letter]}")
            matrices[letter], where[letter] = matrix, file
        _add_nodes(file, text, nodes, angles)
        masters.update(dict.fromkeys((int(m[1]), m[2]) for m in _MASTER.finditer(text)))
    for letter in "KM":
        if letter not in matrices:
            raise ValueError(
                f"{', '.join(texts)}: no matrix with a title such as MAT_{letter}: or SUB_{letter}:; of other files, "
                "give the arrays to `superelement`"
            )
    if matrices["K"].shape != matrices["M"].shape:
        raise ValueError(
            f"{where['K']}: K has {len(matrices['K'])} rows, M in {where['M']} has {len(matrices['M'])}; one is cut"
        )
    return Listing(matrices, nodes, angles, tuple(masters), where)


def nodal_frame(angles: Array) -> Array:
    """Return the rotation matrix from the frame of a node to that of the body, about z, then x, then y.

    Args:
        angles: THXY, THYZ, THZX, (3,) [deg].

    Returns:
        Rotation matrix, (3, 3).
    """
    (cz, cx, cy), (sz, sx, sy) = np.cos(np.radians(angles)), np.sin(np.radians(angles))
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    return about_z @ about_x @ about_y


def _line(text: str, place: int) -> int:
    return text.count("\n", 0, place) + 1


def _matrices(file: str, text: str) -> dict[str, Array]:
    # Row, column, value and position of each entry; arrays, because a listing may contain millions of entries.
    entries: dict[str, _Entries] = {}
    letter = ""
    for match in _MATRIX_TEXT.finditer(text):
        if match["title"]:
            letter = match["letter"]
            entries.setdefault(letter, (array("i"), array("i"), array("d"), array("q")))
            continue
        where = match.start()
        if match["broken"] is not None:
            raise ValueError(f"{file}, line {_line(text, where)}: '[' begins no entry such as [ 1, 2]: 3.4")
        if not letter:
            raise ValueError(f"{file}, line {_line(text, where)}: an entry before a title such as MAT_K:")
        row, column = int(match["row"]), int(match["column"])
        if not (1 <= row <= MOST_COORDINATES and 1 <= column <= MOST_COORDINATES):
            raise ValueError(
                f"{file}, line {_line(text, where)}: entry [{row}, {column}]; indices run from 1 to {MOST_COORDINATES}"
            )
        value = _number(match["value"])
        if value is None:
            raise ValueError(
                f"{file}, line {_line(text, where)}: entry [{row}, {column}] is {match['value']!r}, not a number"
            )
        rows, columns, values, places = entries[letter]
        rows.append(row)
        columns.append(column)
        values.append(value)
        places.append(where)
    return {name: _filled(file, text, name, found) for name, found in entries.items()}


def _filled(file: str, text: str, letter: str, entries: "_Entries") -> Array:
    """Return the matrix from all or all nonzero entries, or those of one triangle.

    Raises:
        ValueError: for missing entries and for contradictory ones.
    """
    rows, columns, values, places = (np.array(part) for part in entries)
    if not len(rows):
        raise ValueError(f"{file}: the title of {letter} is followed by no entry such as [ 1, 2]: 3.4")
    n = int(max(rows.max(), columns.max()))
    matrix = np.full((n, n), np.nan)
    matrix[rows - 1, columns - 1] = values
    other = np.flatnonzero(matrix[rows - 1, columns - 1] != values)
    if len(other):
        k = other[0]
        raise ValueError(
            f"{file}, line {_line(text, int(places[k]))}: entry [{rows[k]}, {columns[k]}] is there twice and differs"
        )
    missing = np.isnan(matrix)
    if missing[np.tril_indices(n, -1)].all() or missing[np.triu_indices(n, 1)].all():
        matrix = np.where(missing, matrix.T, matrix)
    missing = np.isnan(matrix)
    if np.all(values != 0) and not np.diag(missing).any() and np.all(missing == missing.T):  # nonzero entries alone
        matrix = np.nan_to_num(matrix)
    missing = np.argwhere(np.isnan(matrix))
    if len(missing):
        row, column = missing[0] + 1
        raise ValueError(
            f"{file}, line {_line(text, places[-1])}: {letter} is cut: of {n} x {n} entries {len(missing)} are "
            f"missing, the first is [{row}, {column}]"
        )
    return matrix


def _number(text: str) -> float | None:
    try:
        value = float(text.replace("D", "E").replace("d", "e"))
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def _add_nodes(file: str, text: str, nodes: dict[int, Array], angles: dict[int, Array]) -> None:
    heading = _NODE_HEADING.search(text)
    if not heading:
        return
    if system := re.search(r"DSYS=\s*0*([1-9]\d*)", text):
        line = _line(text, system.start())
        raise ValueError(f"{file}, line {line}: coordinates in the system {system[1]}: list the nodes with DSYS,0")
    rows = {match.start(1): match for pattern in (_NODE_LINE, _NODE) for match in pattern.finditer(text, heading.end())}
    for start, match in rows.items():
        where = f"{file}, line {_line(text, start)}"
        values = [_number(word) for word in re.findall(f"{_REAL}|{_INTEGER}", match[2])]
        if len(values) not in (3, 6) or None in values:
            raise ValueError(f"{where}: node {match[1]} has {len(values)} numbers, not finite x y z (and three angles)")
        row = np.array(values, dtype=float)
        number = int(match[1])
        if number in nodes and not np.array_equal(nodes[number], row[:3]):
            raise ValueError(f"{where}: node {number} is there twice, at different places")
        nodes[number] = row[:3]
        if len(row) == 6:
            angles[number] = row[3:]
