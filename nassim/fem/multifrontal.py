"""Sparse Cholesky factorisation by dense fronts, for blocks of right-hand sides.

Unknowns that are connected to the same others (the three displacements of a node) form one node of the matrix's graph.
The parts of its nested dissection are eliminated one after the other. Each part is a dense front: its own unknowns, and
the later unknowns that it is connected to. What it leaves on these is added to the front of the next separator. All
floating-point work is that of BLAS and LAPACK on dense matrices, also when many columns are solved at once.

Source: J. W. H. Liu, The multifrontal method for sparse matrix solution: theory and practice, SIAM Review 34 (1992)
82-109.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.linalg import blas, lapack

from nassim.base.checks import Array
from nassim.fem.dissection import Indices, borders, dissect

ROWS = 96
"""Number of rows that are added to a front at once, few enough for the processor's cache."""


@dataclass(frozen=True)
class Front:
    """Columns of the factor L that belong to one part; unknowns are counted in the order of elimination.

    Attributes:
        own: the part's k unknowns
        border: later unknowns, ascending, shape (b,)
        diagonal: rows of the part's own unknowns, lower triangle, shape (k, k)
        below: rows of the border, shape (b, k)
    """

    own: slice
    border: Indices
    diagonal: Array
    below: Array


class Factor:
    """Cholesky factor of a symmetric positive definite matrix."""

    def __init__(self, lower: sp.csr_matrix) -> None:
        """Factorise a matrix.

        Args:
            lower: lower triangle with the diagonal, shape (n, n)

        Raises:
            ArithmeticError: if the matrix is not positive definite
        """
        n = lower.shape[0]
        node, graph = _graph_of_nodes(lower)
        parts = dissect(graph)
        rank = np.empty(graph.shape[0], dtype=np.int64)
        rank[np.concatenate([np.zeros(0, np.int64), *(part.nodes for part in parts)])] = np.arange(len(rank))
        self._order = np.argsort(rank[node], kind="stable")
        ends = np.cumsum(np.bincount(rank[node]))
        place = np.empty(n, dtype=np.int64)
        place[self._order] = np.arange(n)
        rows, columns = place[_row_numbers(lower)], place[lower.indices]
        entries = sp.csc_matrix((lower.data, (np.maximum(rows, columns), np.minimum(rows, columns))), shape=(n, n))
        self._fronts: list[Front] = []
        updates: list[Array] = []
        local = np.zeros(n, dtype=np.int64)
        last_node = end = 0
        for part, nodes in zip(parts, borders(graph, parts), strict=True):
            last_node += len(part.nodes)
            begin, end = end, int(ends[last_node - 1])
            border = _unknowns(ends, nodes)
            local[begin:end] = np.arange(end - begin)
            local[border] = np.arange(len(border)) + end - begin
            children = [(local[self._fronts[child].border], updates[child]) for child in part.children]
            front, update = _eliminate(entries, slice(begin, end), border, local, children)
            for child in part.children:
                updates[child] = np.zeros((0, 0))
            self._fronts.append(front)
            updates.append(update)
        self._fronts = [front for front in self._fronts if front.diagonal.size]

    def solve(self, columns: Array) -> Array:
        """Solve for right-hand sides, shape (n, k)."""
        x = np.ascontiguousarray(columns[self._order])
        # Rows of x, transposed, are columns in Fortran's order, which BLAS overwrites.
        for front in self._fronts:
            own = x[front.own].T
            blas.dtrsm(1.0, front.diagonal, own, side=1, lower=1, trans_a=1, overwrite_b=1)
            if len(front.border):
                x[front.border] -= blas.dgemm(1.0, own, front.below, trans_b=1).T
        for front in reversed(self._fronts):
            own = x[front.own].T
            if len(front.border):
                blas.dgemm(-1.0, x[front.border].T, front.below, beta=1.0, c=own, overwrite_c=1)
            blas.dtrsm(1.0, front.diagonal, own, side=1, lower=1, overwrite_b=1)
        result = np.empty_like(x)
        result[self._order] = x
        return result


def _graph_of_nodes(lower: sp.csr_matrix) -> tuple[Indices, sp.csr_matrix]:
    """Return the node of each unknown, shape (n,), and the connections of the nodes, symmetric without diagonal."""
    n = lower.shape[0]
    # Unknowns with the same connections have the same sum of random numbers over their row.
    ones = sp.csr_matrix((np.ones(lower.nnz, dtype=np.int64), lower.indices, lower.indptr), shape=lower.shape)
    numbers = np.random.default_rng(0).integers(2**62, size=n)
    sums = ones @ numbers + ones.T @ numbers - numbers
    _, first, node = np.unique(sums, return_index=True, return_inverse=True)
    rows, columns = _row_numbers(lower), lower.indices
    is_first = np.zeros(n, dtype=bool)
    is_first[first] = True
    kept = is_first[rows] & is_first[columns] & (rows != columns)
    shape = (len(first), len(first))
    half = sp.csr_matrix((np.ones(np.count_nonzero(kept)), (node[rows[kept]], node[columns[kept]])), shape=shape)
    return node, (half + half.T).tocsr()


def _row_numbers(matrix: sp.csr_matrix) -> Indices:
    """Return the row of each stored entry."""
    return np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))


def _unknowns(ends: Indices, nodes: Indices) -> Indices:
    """Return the unknowns of nodes, in order; `ends` holds the end of each node's unknowns."""
    counts = ends[nodes] - np.where(nodes > 0, ends[nodes - 1], 0)
    return np.repeat(ends[nodes] - np.cumsum(counts), counts) + np.arange(counts.sum())


def _eliminate(
    entries: sp.csc_matrix,
    own: slice,
    border: Indices,
    local: Indices,
    children: Sequence[tuple[Indices, Array]],
) -> tuple[Front, Array]:
    """Eliminate the unknowns of a front.

    Args:
        entries: lower triangle of the matrix
        own: the front's own unknowns
        border: its later unknowns
        local: place in the front of each of its unknowns
        children: for each child, the places of its border in this front, ascending, and its update

    Returns:
        The front, and its update: what it adds to the matrix of its border, upper triangle.
    """
    k = own.stop - own.start
    m = k + len(border)
    # Rows hold columns of the lower triangle.
    above, update = np.zeros((k, m)), np.zeros((m - k, m - k))
    starts = entries.indptr[own.start : own.stop + 1]
    stored = slice(starts[0], starts[-1])
    above[np.repeat(np.arange(k), np.diff(starts)), local[entries.indices[stored]]] = entries.data[stored]
    for places, values in children:
        split = int(np.searchsorted(places, k))
        for target, shift, begin, end in ((above, 0, 0, split), (update, k, split, len(places))):
            for first in range(begin, end, ROWS):
                last = min(first + ROWS, end)
                lowest = places[first]
                spread = np.zeros((last - first, m - lowest))
                spread[:, places[first:] - lowest] = values[first:last, first:]
                target[places[first:last] - shift, lowest - shift :] += spread
    diagonal, failed = lapack.dpotrf(above[:, :k].T, lower=1, clean=0)
    if failed:
        raise ArithmeticError("the matrix is not positive definite")
    below = blas.dtrsm(1.0, diagonal, above[:, k:].T, side=1, lower=1, trans_a=1)
    if len(border):
        update = blas.dsyrk(-1.0, below, beta=1.0, c=update.T, lower=1, overwrite_c=1).T
    return Front(own, border, diagonal, below), update
