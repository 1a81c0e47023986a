"""Sparse Cholesky factorisation by dense fronts, for blocks of right-hand sides.

Unknowns that are connected to the same others (the three displacements of a node) form one node of the matrix's graph.
The parts of its nested dissection are eliminated one after the other. Each part is a dense front: its own unknowns, and
the later unknowns that it is connected to. What it leaves on these is added to the front of the next separator. All
floating-point work is that of BLAS and LAPACK on dense matrices, also when many columns are solved at once.

Source: J. W. H. Liu, The multifrontal method for sparse matrix solution: theory and practice, SIAM Review 34 (1992)
82-109.
"""

import itertools
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from nassim.base.checks import Array
from nassim.fem.dissection import GraphPart, Indices, borders, dissect
from nassim.fem.native_threads import blas_threads, share
from nassim.fem.parallel_blas import factorize_in_place, solve_in_place, subtract_products

ROWS, ENTRIES = 4096, 2**18
"""Number of rows of a matrix whose pattern is read at once, and of entries whose places are compared at once."""
LARGEST_BRANCH = 1 / 16
"""Largest share of the whole work in one branch of the elimination tree, so that threads end at about the same time."""
SMALL_BRANCH = 1e7
"""Number of multiplications below which a branch is not worth a thread."""


@dataclass(frozen=True)
class Front:
    """Rows of the factor L^T that belong to one part; unknowns are counted in the order of elimination.

    Attributes:
        own: the part's k unknowns
        border: later unknowns, ascending, shape (b,)
        diagonal: columns of L^T that belong to the part's own unknowns, upper triangle, shape (k, k)
        right: columns of the border, shape (k, b)
    """

    own: slice
    border: Indices
    diagonal: Array
    right: Array

    def forward(self, x: Array) -> None:
        """Replace right-hand sides (n, c) in place by the solution of L y = x, as far as the front decides."""
        solve_in_place(self.diagonal, x[self.own], transposed=True)
        # BLAS multiplies few rows by a large matrix in less time than a large matrix by few columns.
        x[self.border] -= (x[self.own].T @ self.right).T

    def backward(self, x: Array) -> None:
        """Replace right-hand sides (n, c) in place by the solution of L^T y = x, as far as the front decides."""
        x[self.own] -= (x[self.border].T @ self.right.T).T
        solve_in_place(self.diagonal, x[self.own], transposed=False)


@dataclass(frozen=True)
class Branch:
    """Fronts of one branch of the elimination tree, which do not wait for those of other branches.

    Attributes:
        own: the branch's m unknowns
        border: later unknowns that they are connected to, ascending, shape (b,)
        fronts: the fronts; their unknowns are counted from the first one of the branch, those of the border last
    """

    own: slice
    border: Indices
    fronts: list[Front]

    def forward(self, x: Array) -> Array:
        """Return the solutions of L y = x for the own unknowns, and what is to be added to the border, (m + b, c)."""
        result = np.concatenate([x[self.own], np.zeros((len(self.border), x.shape[1]))])
        for front in self.fronts:
            front.forward(result)
        return result

    def backward(self, x: Array, found: Array) -> None:
        """Replace the own rows of x by the solution of L^T x = y; found: result of `forward`, which is changed."""
        m = len(found) - len(self.border)
        found[m:] = x[self.border]
        for front in reversed(self.fronts):
            front.backward(found)
        x[self.own] = found[:m]


class Factor:
    """Cholesky factor of a symmetric positive definite matrix, some unknowns of which may be fixed at zero.

    The branches of the elimination tree are shared among threads. The trunk, on which they meet, follows.
    """

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
        tree = _Tree.of(parts, borders(graph, parts), np.cumsum(unknowns[nodes]))
        entries = _reordered(lower, self._order)
        branches, trunk = tree.branches()
        memory = _Memory(len(self._order))
        found = share(lambda places: _eliminate_parts(entries, tree, places, memory), branches)
        self._branches = [tree.branch(places, fronts) for places, (fronts, _) in zip(branches, found, strict=True)]
        known = {places[-1]: update for places, (_, update) in zip(branches, found, strict=True)}
        self._trunk = _eliminate_parts(entries, tree, trunk, memory, known)[0]

    def solve(self, columns: Array) -> Array:
        """Solve for right-hand sides, shape (n, k); rows of fixed unknowns are zero."""
        x = np.ascontiguousarray(columns[self._order])
        found = share(lambda branch: branch.forward(x), self._branches)
        pairs = list(zip(self._branches, found, strict=True))
        for branch, rows in pairs:
            x[branch.border] += rows[len(rows) - len(branch.border) :]
        for front in self._trunk:
            with blas_threads(front.right.size * x.shape[1]):
                front.forward(x)
        for front in reversed(self._trunk):
            with blas_threads(front.right.size * x.shape[1]):
                front.backward(x)
        share(lambda pair: pair[0].backward(x, pair[1]), pairs)
        result = np.zeros(columns.shape)
        result[self._order] = x
        return result


@dataclass(frozen=True)
class _Tree:
    """Parts of a nested dissection as a tree; unknowns are counted in the order of elimination.

    Attributes:
        own: each part's unknowns
        borders: later unknowns that each part is connected to, ascending
        children: places of the parts between which each one is the separator
    """

    own: list[slice]
    borders: list[Indices]
    children: list[tuple[int, ...]]

    @staticmethod
    def of(parts: Sequence[GraphPart], borders: Sequence[Indices], ends: Indices) -> "_Tree":
        """Return the tree of parts with their borders in nodes; `ends` holds the end of each node's unknowns."""
        stops = np.append(0, ends)[np.cumsum([0, *(len(part.nodes) for part in parts)])].tolist()
        return _Tree(
            [slice(start, stop) for start, stop in itertools.pairwise(stops)],
            [_unknowns(ends, border) for border in borders],
            [part.children for part in parts],
        )

    def branches(self) -> tuple[list[range], list[int]]:
        """Return the places of the parts of each branch, and of the trunk with the last part of each branch."""
        works: list[float] = []
        sizes: list[int] = []
        for own, border, children in zip(self.own, self.borders, self.children, strict=True):
            k, b = own.stop - own.start, len(border)
            works.append(k * (k**2 / 3 + k * b + b**2) + sum(works[child] for child in children))
            sizes.append(1 + sum(sizes[child] for child in children))
        limit = max(LARGEST_BRANCH * max(works, default=0.0), SMALL_BRANCH)
        trunk = [place for place, work in enumerate(works) if work > limit]
        met = {child for place in trunk for child in self.children[place]} | ({len(works) - 1} if works else set())
        last = sorted(met - set(trunk))
        return [range(place + 1 - sizes[place], place + 1) for place in last], sorted({*trunk, *last})

    def branch(self, places: range, fronts: Sequence[Front]) -> Branch:
        """Return the branch of some parts, whose fronts count all unknowns."""
        border = self.borders[places[-1]]
        start, stop = self.own[places[0]].start, self.own[places[-1]].stop
        local = []
        for front in fronts:
            later = stop - start + np.searchsorted(border, front.border)
            rows = np.where(front.border < stop, front.border - start, later)
            local.append(replace(front, own=slice(front.own.start - start, front.own.stop - start), border=rows))
        return Branch(slice(start, stop), border, local)


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

    def pop(self) -> Array:
        """Remove the last update and return it."""
        update = self.last(1)[0].copy()
        self._sizes.pop()
        return update


class _Memory(threading.local):
    """Memory of each thread for the elimination of n unknowns: places in a front, and updates."""

    def __init__(self, n: int) -> None:
        """Begin with nothing, in each thread."""
        self.local = np.zeros(n, dtype=np.int64)
        self.updates = _UpdateStack()


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


def _eliminate_parts(
    entries: sp.csc_matrix,
    tree: _Tree,
    places: Sequence[int],
    memory: "_Memory",
    known: Mapping[int, Array] = MappingProxyType({}),
) -> tuple[list[Front], Array]:
    """Eliminate parts one after the other, and return their fronts and the update of the last one.

    Args:
        entries: lower triangle of the matrix
        tree: all parts
        places: places of the parts, each one after its children
        memory: memory to use
        known: updates of those that are eliminated already
    """
    local, updates = memory.local, memory.updates
    fronts = []
    for place in places:
        if place in known:
            updates.replace_last(0, known[place])
            continue
        own, border = tree.own[place], tree.borders[place]
        local[own] = np.arange(own.stop - own.start)
        local[border] = np.arange(len(border)) + own.stop - own.start
        children = [local[tree.borders[child]] for child in tree.children[place]]
        fronts.append(_eliminate(entries, own, border, local, children, updates))
    return [front for front in fronts if front.diagonal.size], updates.pop() if places else np.zeros((0, 0))


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
        if k and not factorize_in_place(diagonal):
            raise ArithmeticError("the matrix is not positive definite")
        if k and b:
            solve_in_place(diagonal, below, transposed=True)
            subtract_products(below, update)
    updates.replace_last(len(children), update)
    return Front(own, border, diagonal, below)


def _runs(places: Indices, k: int) -> list[tuple[int, int, int, int]]:
    """Return the runs of consecutive places, none of them across place k: their first and last index and place."""
    if not len(places):
        return []
    cuts = np.flatnonzero((np.diff(places) != 1) | (places[1:] == k)) + 1
    firsts, lasts = np.append(0, cuts), np.append(cuts, len(places))
    return list(zip(*(a.tolist() for a in (firsts, lasts, places[firsts], places[lasts - 1] + 1)), strict=True))
