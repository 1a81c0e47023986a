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
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

from nassim.base.checks import Array
from nassim.fem.dissection import Indices, borders, dissect
from nassim.fem.native_threads import blas_threads

ROWS, ENTRIES = 4096, 2**18
"""Number of rows of a matrix whose pattern is read at once, and of entries whose places are compared at once."""


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
    """Cholesky factor of a symmetric positive definite matrix, some unknowns of which may be fixed at zero."""

    def __init__(self, lower: sp.csr_matrix, free: NDArray[np.bool_] | None = None) -> None:
        """Factorise a matrix.

        Args:
            lower: lower triangle with the diagonal, shape (n, n)
            free: unknowns that are not fixed, shape (n,) (default: all)

        Raises:
            ArithmeticError: if the matrix is not positive definite
        """
        free = np.ones(lower.shape[0], dtype=bool) if free is None else free
        node, graph = _graph_of_nodes(lower, free)
        unknowns = np.bincount(node, minlength=graph.shape[0])
        parts = dissect(graph, unknowns)
        nodes = np.concatenate([np.zeros(0, dtype=np.int64), *(part.nodes for part in parts)])
        self._order = np.flatnonzero(free)[np.argsort(np.argsort(nodes)[node], kind="stable")]
        ends = np.cumsum(unknowns[nodes])
        entries = _reordered(lower, self._order)
        local = np.zeros(len(self._order), dtype=np.int64)
        self._fronts: list[Front] = []
        updates = _UpdateStack()
        last_node = end = 0
        for part, border_nodes in zip(parts, borders(graph, parts), strict=True):
            last_node += len(part.nodes)
            begin, end = end, int(ends[last_node - 1])
            border = _unknowns(ends, border_nodes)
            local[begin:end] = np.arange(end - begin)
            local[border] = np.arange(len(border)) + end - begin
            children = [local[self._fronts[child].border] for child in part.children]
            self._fronts.append(_eliminate(entries, slice(begin, end), border, local, children, updates))
        self._fronts = [front for front in self._fronts if front.diagonal.size]

    def solve(self, columns: Array) -> Array:
        """Solve for right-hand sides, shape (n, k); rows of fixed unknowns are zero."""
        x = np.ascontiguousarray(columns[self._order])
        for front in self._fronts:
            # Rows of x, transposed, are columns in Fortran's order, which BLAS overwrites. It also multiplies few rows
            # by a large matrix in less time than a large matrix by few columns.
            blas.dtrsm(1.0, front.diagonal, x[front.own].T, side=1, lower=1, trans_a=1, overwrite_b=1)
            x[front.border] -= (x[front.own].T @ front.below.T).T
        for front in reversed(self._fronts):
            x[front.own] -= (x[front.border].T @ front.below).T
            blas.dtrsm(1.0, front.diagonal, x[front.own].T, side=1, lower=1, overwrite_b=1)
        result = np.zeros(columns.shape)
        result[self._order] = x
        return result


class _UpdateStack:
    """Updates of the fronts whose parent is not yet eliminated, in memory that is used again.

    Memory that is given back to the system is filled with zeros before it is used again, which would cost about as much
    time as the elimination itself.
    """

    def __init__(self) -> None:
        self._sizes: list[int] = []
        self._values, self._new = np.zeros(0), np.zeros(0)

    def new(self, size: int) -> Array:
        """Return zeros for the next update, shape (size, size)."""
        if self._new.size < size**2:
            self._new = np.empty(size**2)
        self._new[: size**2] = 0.0
        return self._new[: size**2].reshape(size, size)

    def last(self, count: int) -> list[Array]:
        """Return the last updates, the newest one last."""
        begin = sum(size**2 for size in self._sizes[: len(self._sizes) - count])
        result = []
        for size in self._sizes[len(self._sizes) - count :]:
            result.append(self._values[begin : begin + size**2].reshape(size, size))
            begin += size**2
        return result

    def replace_last(self, count: int, update: Array) -> None:
        """Replace the last updates by a new one."""
        self._sizes = self._sizes[: len(self._sizes) - count]
        begin = sum(size**2 for size in self._sizes)
        if self._values.size < begin + update.size:
            self._values = np.concatenate([self._values[:begin], np.empty(begin + 2 * update.size)])
        self._values[begin : begin + update.size] = update.ravel()
        self._sizes.append(len(update))


def _graph_of_nodes(lower: sp.csr_matrix, free: NDArray[np.bool_]) -> tuple[Indices, sp.csr_matrix]:
    """Return the node of each free unknown, and the connections of the nodes, symmetric without diagonal."""
    n = lower.shape[0]
    # Unknowns with the same connections have the same sum of random numbers over their row.
    numbers = np.where(free, np.random.default_rng(0).integers(2**62, size=n), 0)
    sums = -numbers
    for begin in range(0, n, ROWS):
        starts = lower.indptr[begin : begin + ROWS + 1]
        columns = lower.indices[starts[0] : starts[-1]]
        shape = (len(starts) - 1, n)
        ones = sp.csr_matrix((np.ones(len(columns), dtype=np.int64), columns, starts - starts[0]), shape=shape)
        sums[begin : begin + ROWS] += ones @ numbers
        sums += ones.T @ numbers[begin : begin + ROWS]
    _, first, node = np.unique(sums[free], return_index=True, return_inverse=True)
    number = np.full(n, -1)
    number[np.flatnonzero(free)[first]] = np.arange(len(first))
    chosen = number >= 0
    half = sp.tril(lower[chosen][:, chosen], -1)
    shape = (len(first), len(first))
    half = sp.csr_matrix((np.ones(half.nnz), (number[chosen][half.row], number[chosen][half.col])), shape=shape)
    return node, (half + half.T).tocsr()


def _reordered(lower: sp.csr_matrix, order: Indices) -> sp.csc_matrix:
    """Return the lower triangle of a symmetric matrix with its unknowns in another order, and without the others."""
    n = lower.shape[0]
    place = np.full(n, n, dtype=np.int32)  # unknowns that are left out come last
    place[order] = np.arange(len(order), dtype=np.int32)
    below, columns = np.repeat(place, np.diff(lower.indptr)), place[lower.indices]
    for begin in range(0, len(columns), ENTRIES):  # in pieces, since new memory costs more time than the comparison
        rows, chosen = below[begin : begin + ENTRIES].copy(), slice(begin, begin + ENTRIES)
        np.maximum(rows, columns[chosen], out=below[chosen])
        np.minimum(rows, columns[chosen], out=columns[chosen])
    entries = sp.coo_matrix((lower.data, (below, columns)), shape=(n + 1, n + 1))
    entries.has_canonical_format = True  # no place occurs twice, so SciPy need not sort the rows of each column
    return entries.tocsc()


def _unknowns(ends: Indices, nodes: Indices) -> Indices:
    """Return the unknowns of nodes, in order; `ends` holds the end of each node's unknowns."""
    counts = ends[nodes] - np.where(nodes > 0, ends[nodes - 1], 0)
    return np.repeat(ends[nodes] - np.cumsum(counts), counts) + np.arange(counts.sum())


def _eliminate(
    entries: sp.csc_matrix,
    own: slice,
    border: Indices,
    local: Indices,
    children: Sequence[Indices],
    updates: _UpdateStack,
) -> Front:
    """Eliminate the unknowns of a front, and replace the updates of its children by its own.

    An update is what a front adds to the matrix of its border, upper triangle.

    Args:
        entries: lower triangle of the matrix
        own: the front's own unknowns
        border: its later unknowns
        local: place in the front of each of its unknowns
        children: for each child, the places of its border in this front, ascending
        updates: updates of all fronts that are left, those of the children last
    """
    k, b = own.stop - own.start, len(border)
    # Rows hold columns of the lower triangle.
    diagonal, below, update = np.zeros((k, k)), np.zeros((k, b)), updates.new(b)
    starts = entries.indptr[own.start : own.stop + 1]
    rows, values = entries.indices[starts[0] : starts[-1]], entries.data[starts[0] : starts[-1]]
    columns = np.repeat(np.arange(k), np.diff(starts))
    inside, later = rows < own.stop, (rows >= own.stop) & (rows < len(local))
    diagonal[columns[inside], rows[inside] - own.start] = values[inside]
    below[columns[later], local[rows[later]] - k] = values[later]
    for places, child in zip(children, updates.last(len(children)), strict=True):
        runs = _runs(places, k)
        for i, (first, last, begin, end) in enumerate(runs):
            for first_column, last_column, left, right in runs[i:]:
                part = child[first:last, first_column:last_column]
                if begin >= k:
                    update[begin - k : end - k, left - k : right - k] += part
                elif left >= k:
                    below[begin:end, left - k : right - k] += part
                else:
                    diagonal[begin:end, left:right] += part
    with blas_threads(k * b**2):
        factor, failed = lapack.dpotrf(diagonal.T, lower=1, clean=0, overwrite_a=1)
        if failed:
            raise ArithmeticError("the matrix is not positive definite")
        under = blas.dtrsm(1.0, factor, below.T, side=1, lower=1, trans_a=1, overwrite_b=1)
        if b:
            blas.dsyrk(-1.0, under, beta=1.0, c=update.T, lower=1, overwrite_c=1)
    updates.replace_last(len(children), update)
    return Front(own, border, factor, under)


def _runs(places: Indices, k: int) -> list[tuple[int, int, int, int]]:
    """Return the runs of consecutive places, none of them across place k: their first and last index and place."""
    if not len(places):
        return []
    cuts = np.flatnonzero((np.diff(places) != 1) | (places[1:] == k)) + 1
    firsts, lasts = np.append(0, cuts), np.append(cuts, len(places))
    return list(zip(*(a.tolist() for a in (firsts, lasts, places[firsts], places[lasts - 1] + 1)), strict=True))
