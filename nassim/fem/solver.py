"""Sparse factorisation for many right-hand sides, for symmetric positive definite matrices.

NGSolve's sparse Cholesky is always available. SuiteSparse's CHOLMOD (`pip install cvxopt`) is preferred if it is
installed: it solves in half of the time and takes about 10 to 40 % more memory. The next choice is MKL's PARDISO
(`pip install pypardiso`). The environment variables NASSIM_SOLVER and NASSIM_THREADS override the solver and the number
of threads.
"""

import importlib
import importlib.util
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import ngsolve
import numpy as np
from ngsolve import la
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from nassim.base.checks import Array, known
from nassim.base.library_lock import hold_library_lock
from nassim.base.progress import Advance, silent
from nassim.fem.sparse import SymmetricMatrix

SOLVERS = {"cholmod": "cvxopt", "pardiso": "pypardiso", "sparsecholesky": "ngsolve"}
"""Solvers and the packages that provide them, the preferred ones first."""
ELEMENTS_PER_LEAF = 24
SOLVE_BLOCK = 16
"""Number of right-hand sides that CHOLMOD and PARDISO solve at once."""
ROWS_PER_BLOCK = 4096
"""Number of rows of a matrix that are passed to CHOLMOD at once."""
SINGULAR = (
    "the stiffness matrix is singular or indefinite: is something loose, or does a material or element have no "
    "stiffness?"
)
ZERO_PIVOT = -4
"""PARDISO's error code for a matrix that is not positive definite."""


@dataclass(frozen=True)
class Factorization:
    """A factorised matrix with some unknowns fixed at zero.

    Attributes:
        n: number of unknowns
        solver: name of the solver, a key of SOLVERS
        seconds: time of the factorisation [s]
    """

    n: int
    solver: str
    seconds: float
    _block: int = field(repr=False)
    _solve: Callable[[Array], Array] = field(repr=False)

    def solve(self, rhs: Array, *, advance: Advance = silent) -> Array:
        """Solve for one right-hand side or several; rows of fixed unknowns are zero.

        Args:
            rhs: right-hand sides, shape (n,) or (n, k)
            advance: called with the number of columns done

        Returns:
            Solutions, in the shape of `rhs`.
        """
        columns = rhs.reshape(self.n, -1)
        result = np.empty(columns.shape, order="F")
        with threads():
            for start in range(0, columns.shape[1], self._block):
                chosen = slice(start, start + self._block)
                result[:, chosen] = self._solve(columns[:, chosen])
                advance(result[:, chosen].shape[1])
        return result.reshape(rhs.shape)


def solver_name() -> str:
    """Return the solver in use: NASSIM_SOLVER, otherwise the first of SOLVERS that is installed."""
    installed = [name for name, package in SOLVERS.items() if importlib.util.find_spec(package)]
    name = known("NASSIM_SOLVER", os.environ.get("NASSIM_SOLVER", installed[0]), SOLVERS)
    if name not in installed:
        raise ValueError(f"NASSIM_SOLVER is {name}, which is not installed: pip install {SOLVERS[name]}")
    return name


def factorize(matrix: SymmetricMatrix, *, held: NDArray[np.int64] | None = None) -> Factorization:
    """Factorise a symmetric matrix that is positive definite once the unknowns `held` are fixed at zero.

    A singular matrix is recognised if a trial solve does not return its right-hand side. An indefinite one is
    recognised by a diagonal entry, or an energy of the trial solution, that is not positive. NGSolve's Cholesky is in
    effect L D L^T and factorises indefinite matrices too, so an indefinite matrix without these signs is not
    recognised.

    Args:
        matrix: the matrix, shape (n, n)
        held: indices of unknowns that are fixed at zero

    Raises:
        ValueError: for a singular or indefinite matrix
    """
    n = matrix.shape[0]
    free = np.ones(n, dtype=bool)
    free[[] if held is None else held] = False
    name = solver_name()
    start = time.perf_counter()
    with threads():
        solve = {"cholmod": _cholmod, "pardiso": _pardiso, "sparsecholesky": _sparse_cholesky}[name](matrix, free)
    block = 1 if name == "sparsecholesky" else SOLVE_BLOCK
    factor = Factorization(n, name, time.perf_counter() - start, block, solve)
    probe = np.where(free, np.random.default_rng(0).standard_normal(n), 0.0)
    solution = factor.solve(probe)
    residual = np.where(free, matrix @ solution, 0.0) - probe
    solved = np.linalg.norm(residual) < 1e-4 * np.linalg.norm(probe)
    if not (solved and np.all(matrix.lower.diagonal()[free] > 0) and probe @ solution > 0):
        raise ValueError(SINGULAR)
    return factor


def _sparse_cholesky(matrix: SymmetricMatrix, free: NDArray[np.bool_]) -> Callable[[Array], Array]:
    """Factorise by NGSolve and return the function that solves."""
    native = matrix.native
    if native is None:
        # The factorisation only reads the lower triangle.
        lower = matrix.lower.tocoo()
        native = la.SparseMatrixd.CreateFromCOO(lower.row, lower.col, lower.data, *matrix.shape)
    inverse = native.Inverse(ngsolve.BitArray(free.tolist()), inverse="sparsecholesky")
    rhs, solution = native.CreateColVector(), native.CreateColVector()

    def solve(column: Array) -> Array:
        rhs.FV().NumPy()[:] = column[:, 0]
        solution.data = inverse * rhs
        return solution.FV().NumPy()[:, None]

    return solve


def _cholmod(matrix: SymmetricMatrix, free: NDArray[np.bool_]) -> Callable[[Array], Array]:
    # Imported here, because it is optional.
    """Factorise by CHOLMOD and return the function that solves."""
    cvxopt = importlib.import_module("cvxopt")
    cholmod = importlib.import_module("cvxopt.cholmod")
    lower = matrix.lower[free][:, free]
    # A few rows (columns of the upper triangle) at a time: all at once would take three times the memory.
    parts = (lower[start : start + ROWS_PER_BLOCK].tocoo() for start in range(0, lower.shape[0], ROWS_PER_BLOCK))
    upper = cvxopt.sparse([[cvxopt.spmatrix(part.data, part.col, part.row, part.shape[::-1])] for part in parts])
    factor = cholmod.symbolic(upper, uplo="U")
    try:
        cholmod.numeric(upper, factor)
    except ArithmeticError as error:
        raise ValueError(SINGULAR) from error

    def solve(columns: Array) -> Array:
        block = cvxopt.matrix(columns[free])
        cholmod.solve(factor, block)
        result = np.zeros(columns.shape)
        result[free] = block
        return result

    return solve


def _pardiso(matrix: SymmetricMatrix, free: NDArray[np.bool_]) -> Callable[[Array], Array]:
    """Factorise by PARDISO and return the function that solves."""
    upper = matrix.lower[free][:, free].T.tocsr()
    upper.sort_indices()
    # Imported here, because it is optional and its MKL takes a second to load.
    pypardiso = importlib.import_module("pypardiso")
    engine = pypardiso.PyPardisoSolver(mtype=2)
    try:
        engine.factorize(upper)
    except pypardiso.pardiso_wrapper.PyPardisoError as error:
        if error.value != ZERO_PIVOT:
            raise
        raise ValueError(SINGULAR) from error
    engine.set_phase(33)

    def solve(columns: Array) -> Array:
        result = np.zeros(columns.shape)
        # The public solve function would hash the whole matrix at every call.
        result[free] = engine._call_pardiso(upper, np.asfortranarray(columns[free]))
        return result

    return solve


def factor_memory(centres: Array, unknowns: Sequence[NDArray[np.int64]], components: int = 3) -> float:
    """Estimate an upper bound of the memory of a factorisation [bytes] from the mesh alone, before it begins.

    The elements are repeatedly divided at the median of their longest extent. The unknowns between two halves form
    dense fronts, whose entries are counted. The orderings of the solvers need 30 to 70 % of this bound (measured on
    compact and on thin solids).

    Args:
        centres: centres of the elements, shape (n_elements, 3) [m]
        unknowns: scalar unknowns of each element
        components: number of unknowns per scalar unknown
    """
    depth = max(0, int(np.ceil(np.log2(len(centres) / ELEMENTS_PER_LEAF))))
    leaf = np.zeros(len(centres), dtype=np.int64)
    parts = [np.arange(len(centres))]
    for _ in range(depth):
        halves = []
        for part in parts:
            axis = np.argmax(np.ptp(centres[part], axis=0))
            order = part[np.argsort(centres[part, axis], kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
            leaf[part] *= 2
            leaf[halves[-1]] += 1
        parts = halves
    element = np.repeat(np.arange(len(centres)), [len(dofs) for dofs in unknowns])
    dof = np.concatenate(unknowns)
    first, last = np.full(dof.max() + 1, np.iinfo(np.int64).max), np.zeros(dof.max() + 1, dtype=np.int64)
    np.minimum.at(first, dof, leaf[element])
    np.maximum.at(last, dof, leaf[element])
    # Two leaves separate at the highest binary digit in which their numbers differ.
    differing = np.where(first < last, first ^ last, 0)
    level = depth - np.ceil(np.log2(differing + 1.0)).astype(np.int64)
    entries = 0.0
    for k in range(depth + 1):
        own = np.bincount(first[level == k] >> (depth - k), minlength=2**k)
        above = level[dof] < k
        border = np.unique((leaf[element[above]] >> (depth - k)) * len(first) + dof[above]) // len(first)
        own, shared = components * own, components * np.bincount(border, minlength=2**k)
        entries += float(np.sum(0.5 * own * own + own * shared))
    return 8.0 * entries


_BLAS = ThreadpoolController().select(internal_api="openblas")
_running = False  # changed only by the thread that holds the lock of NGSolve


@contextmanager
def threads() -> Iterator[None]:
    """Run NGSolve on all processors that this process may use, or on NASSIM_THREADS of them (environment variable).

    NumPy's own threads are stopped meanwhile. They keep spinning after each product and would take the processors from
    the solver, which halves its speed. The context may be nested; the outermost one counts, and other threads of Python
    wait for its end.
    """
    global _running  # noqa: PLW0603 (it represents global state of NGSolve)
    with hold_library_lock():
        if _running:
            yield
            return
        available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        ngsolve.SetNumThreads(int(os.environ.get("NASSIM_THREADS", available)))
        _running = True
        try:
            with _BLAS.limit(limits=1), ngsolve.TaskManager():
                yield
        finally:
            _running = False
