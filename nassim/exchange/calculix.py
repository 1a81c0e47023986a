"""Matrices that CalculiX stores (.sti, .mas, .dof), reduced to interface nodes.

CalculiX's own substructures have no mass. Its stored matrices are of all degrees of freedom:
`*FREQUENCY, SOLVER=MATRIXSTORAGE` writes the upper triangles of stiffness and mass as lines of row, column and value,
and the degree of freedom of each row as node.component. Source: CalculiX User's Manual, *FREQUENCY.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import scipy

from nassim.base.checks import Array, whole_number
from nassim.base.field_types import ArrayLike
from nassim.exchange.nodal_matrices import NodalMatrices, given_positions, read_text, with_rotation_nodes

STORED = {".sti", ".mas", ".dof"}
"""Endings of the three files: stiffness, mass, and the degree of freedom of each row."""


def read_stored_matrices(
    path: Path, *, positions: Mapping[int, ArrayLike], rotation_nodes: Mapping[int, int], n_modes: int
) -> NodalMatrices:
    """Read CalculiX's stored matrices, and reduce them to interface nodes by the method of Craig and Bampton.

    Args:
        path: one of the three files; the others have the same name with their endings.
        positions: coordinates of the interface nodes, which are reference nodes of *RIGID BODY, (3,) each.
        rotation_nodes: number of the rotation node (ROT NODE) by that of the reference node.
        n_modes: number of fixed-interface modes that are retained.

    Raises:
        ValueError: naming file and cause, for files that are foreign or cut, and for nodes that they do not contain.
    """
    files = {ending[1:]: path.with_suffix(ending) for ending in STORED}
    listed = read_text(files["dof"]).split()
    try:
        dofs = [(int(node), int(component)) for node, component in (word.split(".") for word in listed)]
    except ValueError:
        raise ValueError(f"{files['dof']}: not a list of node.component, one for each row") from None
    n = len(dofs)
    stiffness, mass = (_sparse(files[kind], n) for kind in ("sti", "mas"))
    places = given_positions(positions, str(path))
    named = with_rotation_nodes(dofs, rotation_nodes)
    place = {dof: row for row, dof in enumerate(named)}
    wanted = [(node, component) for node in places for component in range(1, 7)]
    lacking = [dof for dof in wanted if dof not in place]
    if lacking:
        node, component = lacking[0]
        raise ValueError(
            f"{files['dof']}: no row for node {node}, component {component}; positions name reference nodes of "
            "*RIGID BODY, and rotation_nodes the ROT NODE of each"
        )
    boundary = np.array([place[dof] for dof in wanted])
    inner = np.setdiff1d(np.arange(n), boundary)
    n_modes = whole_number(f"{path}: n_modes", n_modes, 0, len(inner) - 1)
    try:
        basis = _craig_bampton(stiffness, mass, boundary, inner, n_modes)
    except RuntimeError as error:  # SciPy's, also of ARPACK
        raise ValueError(f"{path}: the body cannot be reduced ({error}); are all of its parts connected?") from error
    k_reduced, m_reduced = (basis.T @ (matrix @ basis) for matrix in (stiffness, mass))
    first = max(node for node, _ in dofs) + 1
    modes = [(first + k, 0) for k in range(n_modes)]
    return NodalMatrices(
        0.5 * (k_reduced + k_reduced.T), 0.5 * (m_reduced + m_reduced.T), tuple(wanted + modes), places
    )


def _craig_bampton(
    stiffness: scipy.sparse.csc_matrix, mass: scipy.sparse.csc_matrix, boundary: Array, inner: Array, n_modes: int
) -> Array:
    """Return constraint modes and fixed-interface modes, (n, b + n_modes). Source: Craig and Bampton 1968."""
    k_inner, m_inner = stiffness[inner][:, inner].tocsc(), mass[inner][:, inner].tocsc()
    factor = scipy.sparse.linalg.splu(k_inner)
    basis = np.zeros((stiffness.shape[0], len(boundary) + n_modes))
    basis[boundary, np.arange(len(boundary))] = 1.0
    basis[inner, : len(boundary)] = -factor.solve(stiffness[inner][:, boundary].toarray())
    if n_modes:
        inverse = scipy.sparse.linalg.LinearOperator(k_inner.shape, factor.solve, dtype=float)
        start = np.random.default_rng(0).normal(size=len(inner))
        squares, modes = scipy.sparse.linalg.eigsh(k_inner, n_modes, m_inner, sigma=0.0, OPinv=inverse, v0=start)
        basis[inner, len(boundary) :] = modes[:, np.argsort(squares)]
    return basis


def _sparse(path: Path, n: int) -> scipy.sparse.csc_matrix:
    """Return a symmetric matrix from lines of row, column and value of its upper triangle."""
    words = read_text(path).split()
    try:
        table = np.array(words, dtype=float).reshape(-1, 3)
    except ValueError:
        raise ValueError(f"{path}: not lines of row, column and value, or cut") from None
    rows, columns = (table[:, k].astype(int) - 1 for k in (0, 1))
    if not len(table) or min(rows.min(), columns.min()) < 0 or max(rows.max(), columns.max()) >= n:
        raise ValueError(f"{path}: rows and columns must be from 1 to {n}, the number of rows of the .dof file")
    if len(np.unique(rows[rows == columns])) != n:
        raise ValueError(f"{path}: {n} rows, but not an entry on the diagonal of each: the file is cut")
    pairs = np.sort([rows, columns], axis=0)
    _, first, counts = np.unique(pairs[0] * n + pairs[1], return_index=True, return_counts=True)
    if counts.max() > 1:
        row, column = pairs[:, first[counts.argmax()]] + 1
        raise ValueError(
            f"{path}: the entry of row {row} and column {column} is there twice; CalculiX writes one triangle, each "
            "entry once"
        )
    half = scipy.sparse.coo_matrix((table[:, 2], (rows, columns)), shape=(n, n)).tocsc()
    result: scipy.sparse.csc_matrix = half + half.T - scipy.sparse.diags(half.diagonal())
    return result.tocsc()
