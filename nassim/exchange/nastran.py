"""Superelements of Nastran: bulk data with DMIG (.pch), matrices in .op4 and .op2.

Bulk data is text, parsed here; .op4 and .op2 are read by the package pyYeti, which is optional.

Sources: MSC Nastran Quick Reference Guide, DMIG, EXTRN, GRID, CORD2R, QSET, QSET1 and EXTSEOUT; pyYeti's manual.
"""

import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from nassim.base.checks import Array
from nassim.base.field_types import ArrayLike
from nassim.exchange.nodal_matrices import (
    MOST_COORDINATES,
    Dof,
    NodalMatrices,
    given_dofs,
    given_positions,
    matrix_from_entries,
    read_text,
)

USUAL_NAMES = {"K": ("KAAX", "KAA", "KXX", "KGG"), "M": ("MAAX", "MAA", "MXX", "MGG")}
"""Names of matrices, by their meaning."""
BINARY = (".op4", ".op2")
SQUARE, SYMMETRIC = 1, 6
_REAL = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))(?:[EeDd]?([+-]?\d+))?")

Entries = dict[tuple[Dof, Dof], float]


@dataclass(frozen=True)
class Card:
    """Card of bulk data.

    Attributes:
        where: file and line, for messages.
        name: in capitals.
        fields: the fields after the name, those of continuations included, without the fields that join lines.
    """

    where: str
    name: str
    fields: tuple[str, ...]

    def word(self, k: int) -> str:
        """Return field k; empty where the card has none."""
        return self.fields[k] if k < len(self.fields) else ""

    def integer(self, k: int) -> int:
        """Return the integer in field k, 0 where it is blank; raise ValueError for other text."""
        word = self.word(k)
        if word and not re.fullmatch(r"[+-]?\d+", word):
            raise ValueError(f"{self.where}: {self.name} has {word!r} where an integer belongs")
        return int(word or 0)

    def real(self, k: int) -> float:
        """Return the number in field k, 0 where it is blank; raise ValueError for other text."""
        word = self.word(k)
        match = _REAL.fullmatch(word or "0.")
        if not match:
            raise ValueError(f"{self.where}: {self.name} has {word!r} where a number belongs")
        return float(f"{match[1]}e{match[2] or 0}")


@dataclass
class BulkData:
    """Entries of a Nastran bulk data file that concern a superelement, collected while the file is read.

    Attributes:
        matrices: entries of DMIG by name of the matrix.
        others: names of rectangular and of complex ones, which are no stiffness and no mass.
        grids: cards of interface nodes, by node.
        axes: cards of coordinate systems, by number.
        order: node and component of each row of the matrices, of EXTRN.
        spoints: scalar points, which are modal coordinates.
        modal: node and component of modal coordinates, of QSET and QSET1.
    """

    matrices: dict[str, Entries] = field(default_factory=dict)
    others: set[str] = field(default_factory=set)
    grids: dict[int, Card] = field(default_factory=dict)
    axes: dict[int, Card] = field(default_factory=dict)
    order: list[Dof] = field(default_factory=list)
    spoints: list[int] = field(default_factory=list)
    modal: set[Dof] = field(default_factory=set)


def read_nastran(
    paths: Sequence[Path],
    *,
    names: Mapping[str, str],
    positions: Mapping[int, ArrayLike] | None,
    dofs: Iterable[Sequence[int]] | None,
) -> NodalMatrices:
    """Read stiffness and mass of one superelement from all of its files.

    Args:
        paths: bulk data with DMIG, GRID, EXTRN (.pch, .asm, ...) and at most one .op4 or .op2 file.
        names: names of the matrices K and M (default: `USUAL_NAMES`).
        positions: coordinates by node, (3,), which replace GRID cards.
        dofs: node and component of each row of .op4 and .op2 matrices (default: EXTRN, or all GRID and SPOINT cards by
            their numbers).

    Raises:
        ValueError: naming file, line and cause.
        RuntimeError: for .op4 and .op2 without the package pyYeti.
    """
    label = ", ".join(map(str, paths))
    bulk = BulkData()
    for path in paths:
        if path.suffix.lower() not in BINARY:
            _add(bulk, cards(path, read_text(path)))
    binary = [path for path in paths if path.suffix.lower() in BINARY]
    if len(binary) > 1:
        raise ValueError(f"one .op4 or .op2 file holds both matrices, got {len(binary)}: {label}")
    dense: list[tuple[str, Array]] = []
    if binary:
        entries, dense = _read_binary(binary[0])
        bulk.matrices.update(entries)
    stiffness, mass, rows = _matrices(bulk, dense, names, dofs, label)
    rows = tuple((-k, 0) if dof in bulk.modal else dof for k, dof in enumerate(rows, start=1))
    given = given_positions(positions, label)
    places, frames = {}, {}
    for node in dict.fromkeys(node for node, _ in rows if node in bulk.grids):
        card = bulk.grids[node]
        if node not in given:
            origin, turn = _axes(bulk, card.integer(1), card)
            places[node] = origin + turn @ [card.real(k) for k in (2, 3, 4)]
        if card.integer(5):
            frames[node] = _axes(bulk, card.integer(5), card)[1]
    return NodalMatrices(stiffness, mass, rows, places | given, frames)


def _matrices(
    bulk: BulkData,
    dense: Sequence[tuple[str, Array]],
    names: Mapping[str, str],
    dofs: Iterable[Sequence[int]] | None,
    label: str,
) -> tuple[Array, Array, tuple[Dof, ...]]:
    """Return stiffness, mass and the node and component of each row: those of DMIG in the order of GRID and SPOINT."""
    present = [name for name, _ in dense]
    keys = [_find(letter, names, [*bulk.matrices, *present], label) for letter in "KM"]
    if all(key in bulk.matrices for key in keys):
        if dofs is not None:
            raise ValueError(f"{label}: dofs are for matrices without nodes; DMIG names the node of each row")
        place = {node: k for k, node in enumerate((*bulk.grids, *bulk.spoints))}
        found = dict.fromkeys(dof for key in keys for pair in bulk.matrices[key] for dof in pair)
        rows = tuple(sorted(found, key=lambda dof: (dof[1] == 0, place.get(dof[0], len(place)))))
        stiffness, mass = (matrix_from_entries(f"{label}: {key}", bulk.matrices[key], rows) for key in keys)
        return stiffness, mass, rows
    if not all(key in present for key in keys):
        raise ValueError(f"{label}: {keys[0]} and {keys[1]} are not in the same kind of file")
    for key in keys:
        if present.count(key) > 1:
            raise ValueError(f"{label}: {present.count(key)} matrices {key}; a file holds one superelement")
    stiffness, mass = (dense[present.index(key)][1] for key in keys)
    if stiffness.shape != mass.shape or stiffness.shape[0] != stiffness.shape[1]:
        raise ValueError(f"{label}: {keys[0]} is {stiffness.shape}, {keys[1]} is {mass.shape}; both must be n x n")
    return stiffness, mass, given_dofs(_row_order(bulk, len(mass), label) if dofs is None else dofs, len(mass), label)


def cards(path: Path, text: str) -> Iterator[Card]:
    """Yield the cards of bulk data in small, large and free field format."""
    where, name, fields = "", "", []
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.partition("$")[0].expandtabs(8).rstrip()
        if not line:
            continue
        if "," in line:
            first, *rest = (word.strip() for word in line.split(","))
            width = 4 if first.endswith("*") else 8
        else:
            first = line[:8].strip()
            width, size = (4, 16) if "*" in first else (8, 8)
            rest = [line[8 + size * k : 8 + size * (k + 1)].strip() for k in range(width)]
        rest = (rest + width * [""])[:width]
        if line[0] in " +*,":
            fields += rest
            continue
        if name:
            yield Card(where, name, tuple(fields))
        where, name, fields = f"{path}, line {number}", first.rstrip("*").upper(), rest
    if name:
        yield Card(where, name, tuple(fields))


def _add(bulk: BulkData, found: Iterable[Card]) -> None:
    for card in found:
        if card.name == "DMIG":
            _add_column(bulk, card)
        elif card.name == "GRID":
            known = bulk.grids.setdefault(card.integer(0), card)
            if [known.real(k) for k in range(2, 5)] != [card.real(k) for k in range(2, 5)]:
                raise ValueError(f"{card.where}: node {card.integer(0)} is there twice, at different places")
        elif card.name.startswith("CORD"):
            bulk.axes[card.integer(0)] = card
        elif card.name == "GRDSET" and (card.word(1) or card.word(5)):
            raise ValueError(f"{card.where}: GRDSET gives nodes a coordinate system: write it on each GRID")
        elif card.name == "EXTRN":
            bulk.order += _dofs(card)
        elif card.name == "QSET":
            bulk.modal.update(_dofs(card))
        elif card.name == "QSET1":
            points = _points(replace(card, fields=card.fields[1:]))
            bulk.modal.update((node, component) for node in points for component in _components(card, 0))
        elif card.name == "SPOINT":
            bulk.spoints += [node for node in _points(card) if node not in bulk.spoints]


def _dofs(card: Card) -> list[Dof]:
    """Return nodes and components of a card that lists them in turn, the components of a node as digits."""
    nodes = [k for k in range(0, len(card.fields), 2) if card.word(k)]
    return [(card.integer(k), component) for k in nodes for component in _components(card, k + 1)]


def _components(card: Card, k: int) -> list[int]:
    """Return the digits in field k, 0 where it is blank."""
    word = card.word(k) or "0"
    if not re.fullmatch("[0-6]+", word):
        raise ValueError(f"{card.where}: components are digits from 0 to 6, got {word!r}")
    return list(map(int, word))


def _points(card: Card) -> list[int]:
    """Return the numbers that a card lists, also as `first THRU last`."""
    used = [k for k, word in enumerate(card.fields) if word]
    if len(used) == 3 and card.word(used[1]).upper() == "THRU":
        first, last = card.integer(used[0]), card.integer(used[2])
        return list(range(first, min(last, first + MOST_COORDINATES) + 1))
    return [card.integer(k) for k in used]


def _add_column(bulk: BulkData, card: Card) -> None:
    """Add a header or a column of DMIG: NAME GJ CJ, then G C A B for each row."""
    name, matrices = card.word(0).upper(), bulk.matrices
    if card.word(1) == "0":
        if card.integer(2) not in (SQUARE, SYMMETRIC) or card.integer(3) > 2:
            bulk.others.add(name)
            return
        if matrices.get(name):
            raise ValueError(f"{card.where}: a second matrix {name}; a file holds one superelement")
        matrices[name] = {}
        return
    if name in bulk.others:
        return
    if name not in matrices:
        raise ValueError(f"{card.where}: a column of {name} before its header")
    column = (card.integer(1), card.integer(2))
    for k in range(4, len(card.fields), 4):
        if any(card.fields[k : k + 4]):
            if not (card.word(k) and card.word(k + 2)):
                raise ValueError(f"{card.where}: a row of {name} without node or value: the file is cut")
            row, value = (card.integer(k), card.integer(k + 1)), card.real(k + 2)
            if matrices[name].setdefault((row, column), value) != value:
                raise ValueError(f"{card.where}: entry {row}, {column} of {name} is there twice and differs")


def _find(letter: str, names: Mapping[str, str], present: Sequence[str], label: str) -> str:
    """Return the name of the stiffness or the mass matrix among those that are there."""
    wanted = (names[letter].upper(),) if letter in names else USUAL_NAMES[letter]
    found = [name for name in wanted if name in present]
    if not found:
        raise ValueError(
            f"{label}: no matrix {' or '.join(wanted)} for {letter}; there are {', '.join(present) or 'none'}: name it "
            f"by variables={{{letter!r}: ...}}"
        )
    return found[0]


def _row_order(bulk: BulkData, n: int, label: str) -> list[Dof]:
    """Return the rows of EXTRN, or of all GRID and SPOINT cards by their numbers."""
    if bulk.order:
        return bulk.order
    listed = [(node, k) for node in bulk.grids for k in range(1, 7)] + [(node, 0) for node in bulk.spoints]
    if len(listed) != n:
        raise ValueError(
            f"{label}: which row belongs to which node? Add the .pch or .asm file of the same run, or give "
            f"dofs=[(node, component), ...], {n} pairs"
        )
    return sorted(listed)


def _axes(bulk: BulkData, number: int, card: Card, chain: tuple[int, ...] = ()) -> tuple[Array, Array]:
    """Return origin (3,) and axes (3, 3), as columns, of a coordinate system in the basic one.

    Args:
        bulk: contains the coordinate systems.
        number: number of the system, 0 for the basic one.
        card: card that refers to it, for messages.
        chain: systems that rest on this one.
    """
    if number == 0:
        return np.zeros(3), np.eye(3)
    system = bulk.axes.get(number)
    if system is None or system.name != "CORD2R" or number in chain:
        kind = "is missing" if system is None else f"is a {system.name}; only CORD2R that rest on others are read"
        raise ValueError(f"{card.where}: its coordinate system {number} {kind}: write the nodes in basic coordinates")
    base, turn = _axes(bulk, system.integer(1), system, (*chain, number))
    a, b, c = (base + turn @ [system.real(k + d) for d in range(3)] for k in (2, 5, 8))
    z, y = b - a, np.cross(b - a, c - a)
    if not (np.linalg.norm(z) > 0 and np.linalg.norm(y) > 0):
        raise ValueError(f"{system.where}: the three points of a CORD2R must not be on one line")
    z, y = z / np.linalg.norm(z), y / np.linalg.norm(y)
    return a, np.column_stack([np.cross(y, z), y, z])


def _pyyeti() -> tuple[Any, Any]:
    try:
        with np.printoptions():  # pyYeti changes those of the whole process
            from pyyeti import nastran  # noqa: PLC0415 - an optional dependency, needed by few
            from pyyeti.nastran import op4  # noqa: PLC0415
    except ImportError as error:
        raise RuntimeError('.op4 and .op2 files need the package pyyeti: pip install "nassim[nastran]"') from error
    return nastran, op4


def _read_binary(path: Path) -> tuple[dict[str, Entries], list[tuple[str, Array]]]:
    """Return matrices with named rows (DMIG in .op2), and matrices without, with their names in capitals."""
    nastran, op4 = _pyyeti()
    if not path.exists():
        raise ValueError(f"{path}: cannot be read (no such file)")
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", message="Premature end")
            if path.suffix.lower() == ".op4":
                keys, matrices, *_ = op4.read(str(path), into="list")
                return {}, [(key.upper(), _real(value)) for key, value in zip(keys, matrices, strict=True)]
            with nastran.op2.OP2(str(path)) as file:
                plain = file.rdop2mats(which="all")
                tables = [key for key in file.dbnames if key not in plain]  # pyYeti's rddmig fails at some matrices
            found = nastran.rddmig(str(path), tables)
    except Exception as error:  # pyYeti raises many kinds, bare ones too
        raise ValueError(f"{path}: damaged or of another format: {error or type(error).__name__}") from error
    entries: dict[str, Entries] = {}
    for key, frame in found.items():
        if frame.index.nlevels == frame.columns.nlevels == 2:
            rows, columns = ([(int(node), int(k)) for node, k in axis] for axis in (frame.index, frame.columns))
            values = _real(frame.to_numpy())
            entries[key.upper()] = {(rows[i], columns[j]): float(values[i, j]) for i, j in np.argwhere(values)}
    return entries, [(key.upper(), _real(value)) for key, values in plain.items() for value in values]


def _real(value: Any) -> Array:
    """Return a real matrix; a complex one is neither a stiffness nor a mass, and left empty."""
    return np.zeros((0, 0)) if np.iscomplexobj(value) else np.asarray(value, dtype=float)


def dmig_text(found: NodalMatrices, title: str) -> str:
    """Return a superelement as bulk data in large fields: GRID, SPOINT and symmetric DMIG, KAAX and MAAX.

    A field of sixteen characters holds eleven to thirteen digits of a number.

    Args:
        found: matrices and positions.
        title: comment at the start.
    """
    lines = [bulk_text(found, title).rstrip("\n")]
    for name, matrix in (("KAAX", found.stiffness), ("MAAX", found.mass)):
        lines.append(f"DMIG    {name:8}{0:8}{SYMMETRIC:8}{2:8}{0:8}")
        for j, (node, component) in enumerate(found.dofs):
            lines.append(f"DMIG*   {name:16}{node:16}{component:16}")
            for i in range(j, len(matrix)):
                if matrix[i, j] or i == j:
                    lines.append("*       {:16}{:16}".format(*found.dofs[i]) + real_field(matrix[i, j]))
    return "\n".join([*lines, "$", ""])


def bulk_text(found: NodalMatrices, title: str) -> str:
    """Return nodes and order of rows as bulk data: GRID, SPOINT, EXTRN.

    Args:
        found: positions and order of rows.
        title: comment at the start.
    """
    lines = [f"$ {title}"]
    for node, place in found.positions.items():
        x, y, z = (real_field(value) for value in place)
        lines += [f"GRID*   {node:16}{0:16}{x}{y}", f"*       {z}{0:16}"]
    lines += [f"SPOINT  {node:8}" for node, component in found.dofs if component == 0]
    pairs = [f"{node:8}{'123456':>8}" for node in found.positions]
    pairs += [f"{node:8}{0:8}" for node, component in found.dofs if component == 0]
    lines += [("EXTRN   " if k == 0 else 8 * " ") + "".join(pairs[k : k + 4]) for k in range(0, len(pairs), 4)]
    return "\n".join([*lines, ""])


def real_field(value: float) -> str:
    """Return a number in sixteen characters, with as many digits as fit: -1.23456789012+5."""
    if value == 0:
        return f"{'0.0':>16}"
    texts = []
    for digits in range(14, 0, -1):
        mantissa, exponent = f"{value:.{digits}E}".split("E")
        texts.append(f"{mantissa}{int(exponent):+d}")
    return f"{next(text for text in texts if len(text) <= 16):>16}"


def write_op4(path: Path, matrices: Mapping[str, Array]) -> None:
    """Write matrices to a binary .op4 file.

    Raises:
        RuntimeError: without the package pyYeti.
    """
    _, op4 = _pyyeti()
    op4.write(str(path), {name.lower(): np.array(matrix) for name, matrix in matrices.items()})
