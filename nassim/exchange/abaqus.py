"""Substructure matrices of Abaqus and CalculiX: text in the form of the option *USER ELEMENT, LINEAR (.mtx).

Sources: Abaqus Keywords Guide, *USER ELEMENT, *MATRIX and *SUBSTRUCTURE MATRIX OUTPUT (OUTPUT FILE=USER DEFINED);
CalculiX User's Manual, *SUBSTRUCTURE MATRIX OUTPUT.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from nassim.base.checks import Array
from nassim.base.field_types import ArrayLike
from nassim.exchange.nodal_matrices import (
    MOST_COORDINATES,
    Dof,
    NodalMatrices,
    given_dofs,
    given_positions,
    read_text,
)

NODES, COORDINATES, MODAL = "ELEMENT NODES", "COORDINATES", "MODAL NODES"
"""Headings of comments; the second and third are nassim's own."""


def read_mtx(
    path: Path,
    *,
    positions: Mapping[int, ArrayLike] | None,
    dofs: Iterable[Sequence[int]] | None,
) -> NodalMatrices:
    """Read stiffness and mass of a substructure.

    Args:
        path: the file.
        positions: coordinates by node, (3,) (default: those of a file that nassim wrote).
        dofs: node and component of each row, which replace those of the file.

    Raises:
        ValueError: naming file, line and cause, for files that are foreign, cut or without mass.
    """
    text = read_text(path)
    if text.startswith("%%MatrixMarket"):
        raise ValueError(
            f"{path}: one matrix in the Matrix Market format: give arrays of scipy.io.mmread to `superelement`"
        )
    comments, sections = _sections(path, text)
    if "USER ELEMENT" not in sections:
        raise ValueError(f"{path}: no *USER ELEMENT, LINEAR: not a substructure of Abaqus or CalculiX")
    nodes = _integers(path, comments.get(NODES, []))
    modal = set(_integers(path, comments.get(MODAL, [])))
    rows = _dofs(path, nodes, sections["USER ELEMENT"])
    n = len(rows)
    found = {kind: _triangle(path, kind, sections.get(f"MATRIX {kind}", []), n) for kind in ("STIFFNESS", "MASS")}
    places = _numbers(path, comments.get(COORDINATES, []))
    if len(places) % 4:
        raise ValueError(f"{path}: coordinates are lines of node, x, y, z")
    if not np.all(np.isfinite(places)):
        raise ValueError(f"{path}: coordinates must be finite")
    written = {int(row[0]): row[1:] for row in np.array(places).reshape(-1, 4)}
    named = tuple((node, 0 if node in modal else component) for node, component in rows)
    return NodalMatrices(
        found["STIFFNESS"],
        found["MASS"],
        named if dofs is None else given_dofs(dofs, n, str(path)),
        written | given_positions(positions, str(path)),
    )


def mtx_text(found: NodalMatrices, title: str) -> str:
    """Return a substructure as text of *USER ELEMENT, LINEAR, with 17 digits, which Abaqus reads.

    Abaqus has no place for coordinates of nodes and for the kind of a coordinate; they follow as comments.

    Args:
        found: matrices and positions.
        title: comment at the start.
    """
    dofs = [(node, component or 1) for node, component in found.dofs]
    nodes = list(dict.fromkeys(node for node, _ in dofs))
    of_node = [[str(k) for other, k in dofs if other == node] for node in nodes]
    lines = [f"** {title}", f"*USER ELEMENT, NODES={len(nodes)}, LINEAR", f"** {NODES}", *_comment(map(str, nodes))]
    lines.append(", ".join(of_node[0]))
    for k in range(1, len(nodes)):
        if of_node[k] != of_node[k - 1]:
            lines.append(", ".join([str(k + 1), *of_node[k]]))
    for kind, matrix in (("STIFFNESS", found.stiffness), ("MASS", found.mass)):
        lines.append(f"*MATRIX,TYPE={kind}")
        for i, row in enumerate(matrix):
            entries = [f"{value:.16E}" for value in row[: i + 1]]
            lines += [", ".join(entries[k : k + 4]) + "," for k in range(0, i + 1, 4)]
    lines.append(f"** {COORDINATES}")
    for node, place in found.positions.items():
        lines.append(f"** {node}, " + ", ".join(f"{x:.16E}" for x in place))
    modal = [str(node) for node, component in found.dofs if component == 0]
    if modal:
        lines += [f"** {MODAL}", *_comment(modal)]
    return "\n".join([*lines, "**", ""])


def _comment(words: Iterable[str]) -> list[str]:
    every = list(words)
    return [f"** {', '.join(every[k : k + 10])}," for k in range(0, len(every), 10)]


Lines = list[tuple[int, str]]


def _sections(path: Path, text: str) -> tuple[dict[str, Lines], dict[str, Lines]]:
    """Return numbered lines of comments by heading, and of data by option."""
    comments: dict[str, Lines] = {}
    sections: dict[str, Lines] = {}
    heading, option = "", ""
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith("**"):
            content = line[2:].strip()
            if content in (NODES, COORDINATES, MODAL):
                heading = content
                comments.setdefault(heading, [])
            elif heading and re.fullmatch(r"[-+.,\dEe\s]+", content):
                comments[heading].append((number, content))
            else:
                heading = ""
            continue
        heading = ""
        if line.startswith("*"):
            words = re.sub(r"\s", "", line[1:]).upper().split(",")
            kind = next((word.partition("=")[2] for word in words if word.startswith("TYPE=")), "")
            option = f"MATRIX {kind}" if words[0] == "MATRIX" else words[0].replace("USERELEMENT", "USER ELEMENT")
            if option in sections:
                raise ValueError(f"{path}, line {number}: a second *{option}; a file holds one substructure")
            sections[option] = []
        elif line.strip():
            if not option:
                raise ValueError(f"{path}, line {number}: numbers before the first option: not a substructure")
            sections[option].append((number, line))
    return comments, sections


def _numbers(path: Path, lines: Lines) -> list[float]:
    values = []
    for number, line in lines:
        for word in line.replace(",", " ").split():
            try:
                values.append(float(word.replace("D", "E").replace("d", "e")))
            except ValueError:
                raise ValueError(f"{path}, line {number}: {word!r} is not a number") from None
    return values


def _integers(path: Path, lines: Lines) -> list[int]:
    values = _numbers(path, lines)
    if any(not np.isfinite(value) or value != int(value) for value in values):
        raise ValueError(f"{path}, line {lines[0][0]}: nodes and components must be integers")
    return [int(value) for value in values]


def _dofs(path: Path, nodes: list[int], lines: Lines) -> list[Dof]:
    """Return the rows: components of the first node, then, after a node's place, those from this node on."""
    if not nodes or not lines:
        raise ValueError(f"{path}: no list of nodes below '** {NODES}', or no components of them: not a substructure")
    at = {1: _integers(path, lines[:1])}
    for line in lines[1:]:
        place, *components = _integers(path, [line])
        if not 1 < place <= len(nodes):
            raise ValueError(f"{path}, line {line[0]}: components of node {place} in a list of {len(nodes)} nodes")
        at[place] = components
    rows: list[Dof] = []
    components = []
    for place, node in enumerate(nodes, start=1):
        components = at.get(place, components)
        rows += [(node, component) for component in components]
    if len(rows) > MOST_COORDINATES:
        raise ValueError(f"{path}: {len(rows)} coordinates; nassim takes up to {MOST_COORDINATES}")
    return rows


def _triangle(path: Path, kind: str, lines: Lines, n: int) -> Array:
    """Return the symmetric matrix of which the file lists the lower triangle row by row."""
    if not lines:
        hint = " (CalculiX writes none: see read_calculix)" if kind == "MASS" else ""
        raise ValueError(f"{path}: no *MATRIX, TYPE={kind}{hint}; both matrices are needed")
    values = _numbers(path, lines)
    if len(values) != n * (n + 1) // 2:
        raise ValueError(
            f"{path}, line {lines[-1][0]}: {kind} has {len(values)} entries; the lower triangle of {n} coordinates has "
            f"{n * (n + 1) // 2}: the file is cut or its nodes are of another substructure"
        )
    matrix = np.zeros((n, n))
    matrix[np.tril_indices(n)] = values
    return matrix + np.tril(matrix, -1).T
