"""Matrices whose rows are named by node and component, as ANSYS, Nastran, Abaqus and CalculiX write them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nassim.base.checks import Array, finite_array, whole_number
from nassim.base.field_types import ArrayLike
from nassim.base.short_repr import short_repr
from nassim.exchange.mat_npz import read_bytes

MOST_COORDINATES = 1500
"""Largest number of coordinates of a superelement."""
Dof = tuple[int, int]
"""Number of a node, and component: 1 to 6 are ux uy uz rx ry rz, 0 is a modal coordinate."""


@dataclass(frozen=True)
class NodalMatrices:
    """Matrices as a file holds them, in its units and order.

    Attributes:
        stiffness: (n, n).
        mass: (n, n).
        dofs: node and component of each row, (n,).
        positions: coordinates by node, (3,); of interface nodes only.
        frames: rotation from the axes of a node's components to those of the body, by node, (3, 3); other nodes have
            the axes of the body.
    """

    stiffness: Array
    mass: Array
    dofs: tuple[Dof, ...]
    positions: Mapping[int, Array] = field(default_factory=dict)
    frames: Mapping[int, Array] = field(default_factory=dict)
    __repr__ = short_repr


ROUNDING = 1e-6
"""Largest difference of two triangles, over the geometric mean of the diagonal entries."""


def read_text(path: Path) -> str:
    """Return a text file; raise ValueError where its last line is cut or it is no text."""
    data = read_bytes(path)
    if not data.strip():
        raise ValueError(f"{path}: the file is empty")
    if b"\0" in data[:4096]:
        raise ValueError(f"{path}: binary data, not the text that the ending {path.suffix} stands for")
    if not data.endswith((b"\n", b"\r")):
        raise ValueError(f"{path}: the last line has no end: the file is cut")
    return data.decode("latin-1")


def matrix_from_entries(label: str, entries: Mapping[tuple[Dof, Dof], float], dofs: Sequence[Dof]) -> Array:
    """Return a symmetric matrix from the entries of one or both triangles; entries that are not given are zero.

    Args:
        label: file and matrix, for messages.
        entries: values by row and column.
        dofs: node and component of each row, (n,).

    Raises:
        ValueError: for two triangles that differ, and for a row without any entry.
    """
    if len(dofs) > MOST_COORDINATES:
        raise ValueError(f"{label}: {len(dofs)} coordinates; nassim takes up to {MOST_COORDINATES}")
    place = {dof: k for k, dof in enumerate(dofs)}
    matrix = np.zeros((len(dofs), len(dofs)))
    for (row, column), value in entries.items():
        matrix[place[row], place[column]] = value
    size = np.sqrt(np.abs(np.diag(matrix)))
    both = [(place[a], place[b]) for a, b in entries if a != b and (b, a) in entries]
    i, j = np.array(both, dtype=int).reshape(-1, 2).T
    differ = np.flatnonzero(np.abs(matrix[i, j] - matrix[j, i]) > ROUNDING * np.maximum(size[i] * size[j], 1e-300))
    if len(differ):
        a, b = (dofs[k] for k in both[differ[0]])
        raise ValueError(f"{label}: entries {a}, {b} and {b}, {a} differ: {entries[a, b]:g} and {entries[b, a]:g}")
    matrix = np.where(matrix == 0, matrix.T, matrix)
    empty = [dof for dof in dofs if (dof, dof) not in entries]
    if empty:
        node, component = empty[0]
        raise ValueError(
            f"{label}: {len(empty)} of {len(dofs)} rows have no entry on the diagonal, the first is node {node}, "
            f"component {component}: the matrix is cut, of other nodes than the other one, or zero there"
        )
    return matrix


def given_dofs(dofs: Iterable[Sequence[int]], n: int, label: str) -> tuple[Dof, ...]:
    """Check the order of rows that a caller gives, (node, component) each.

    Raises:
        ValueError: unless there are n different pairs with components of 0 to 6.
    """
    of_row = f"{label}: node and component of a row"
    pairs = [tuple(whole_number(of_row, k) for k in np.ravel(dof).tolist()) for dof in dofs]
    wrong = [pair for pair in pairs if len(pair) != 2 or not 0 <= pair[1] <= 6]
    if wrong:
        raise ValueError(f"{label}: dofs are pairs of node and component (1 to 6, 0 for a modal one), got {wrong[0]}")
    if len(pairs) != n or len(set(pairs)) != n:
        raise ValueError(f"{label}: the matrices have {n} rows, dofs names {len(set(pairs))} different ones")
    return tuple((pair[0], pair[1]) for pair in pairs)


def with_rotation_nodes(dofs: Sequence[Dof], rotation_nodes: Mapping[int, int]) -> tuple[Dof, ...]:
    """Name components 1 to 3 of rotation nodes as components 4 to 6 of their reference nodes (CalculiX).

    Args:
        dofs: node and component of each row.
        rotation_nodes: number of the rotation node by that of the reference node.
    """
    reference = {rotation: node for node, rotation in rotation_nodes.items()}
    return tuple((reference[node], k + 3) if node in reference and k <= 3 else (node, k) for node, k in dofs)


def given_positions(positions: Mapping[int, ArrayLike] | None, label: str) -> dict[int, Array]:
    """Check the positions of nodes that a caller gives, (3,) each."""
    return {
        int(node): finite_array(f"{label}: position of node {node}", place, (3,))
        for node, place in (positions or {}).items()
    }


def interface_rows(found: NodalMatrices, label: str) -> tuple[tuple[int, ...], Array]:
    """Return the interface nodes in the order of the rows, and the row of each coordinate.

    Args:
        found: the matrices.
        label: names of the files, for messages.

    Returns:
        Node numbers (r,), and rows of ux uy uz rx ry rz of each node and then of the modal coordinates, (n,).

    Raises:
        ValueError: for nodes without all six components or without coordinates.
    """
    place = {dof: row for row, dof in enumerate(found.dofs)}
    if len(place) != len(found.dofs):
        raise ValueError(f"{label}: a component of a node has two rows")
    nodes = tuple(dict.fromkeys(node for node, component in found.dofs if component))
    if not nodes:
        raise ValueError(f"{label}: no row belongs to a component of a node")
    for node in nodes:
        lacking = [str(component) for component in range(1, 7) if (node, component) not in place]
        if lacking:
            raise ValueError(
                f"{label}: node {node} lacks the components {' '.join(lacking)}; each interface node needs all six: "
                "the list of rows is cut, or a face of solid elements is not coupled to one reference node"
            )
    unknown = [node for node in nodes if node not in found.positions]
    if unknown:
        raise ValueError(
            f"{label}: no coordinates of {len(unknown)} of {len(nodes)} nodes, the first is {unknown[0]}: give them by "
            f"positions={{{unknown[0]}: (x, y, z), ...}} in the units of the file"
        )
    rows = [place[node, component] for node in nodes for component in range(1, 7)]
    modal = [row for row, (_, component) in enumerate(found.dofs) if component == 0]
    return nodes, np.array(rows + modal)
