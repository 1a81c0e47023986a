"""Sparse factorisation for many right-hand sides, for symmetric positive definite matrices.

`SOLVERS` is the table of all solvers; the first one that is installed is used. The multifrontal factorisation of
nassim is always available and solves blocks of columns, as MKL's PARDISO (`pip install mkl`) does. NGSolve's sparse
Cholesky and SuiteSparse's CHOLMOD (`pip install cvxopt`) solve one column at a time and read the whole factor for each.
The environment variable NASSIM_SOLVER overrides the solver.
"""

import importlib
import importlib.util
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import ngsolve
import numpy as np
from ngsolve import la
from numpy.typing import NDArray

from nassim.base.checks import Array, known
from nassim.base.progress import Advance, silent
from nassim.fem import multifrontal, pardiso
from nassim.fem.native_threads import blas_threads, n_threads, threads
from nassim.fem.sparse import SymmetricMatrix

ELEMENTS_PER_LEAF = 24
ROWS_PER_BLOCK = 4096
"""Number of rows of a matrix that are passed to CHOLMOD at once."""
SINGULAR = (
    "the stiffness matrix is singular or indefinite: is something loose, or does a material or element have no "
    "stiffness?"
)
Solve = Callable[[Array], Array]
"""Function from right-hand sides, shape (n, k), to solutions, shape (n, k); rows of fixed unknowns are zero."""


@dataclass(frozen=True)
class Solver:
    """A sparse solver.

    Attributes:
        package: package that provides it
        block: number of right-hand sides that it solves at once
        factorize: function from the matrix and the free unknowns, shape (n,), to the function that solves
        is_installed: function that returns whether the package is installed
    """

    package: str
    block: int
    factorize: Callable[[SymmetricMatrix, NDArray[np.bool_]], Solve]
    is_installed: Callable[[], bool]


@dataclass(frozen=True)
class Factorization:
    """A factorised matrix with some unknowns fixed at zero.

    Attributes:
        n: number of unknowns
        solver: name of the solver, a key of SOLVERS
        seconds: time of the factorisation [s]
        block: number of right-hand sides that are solved at once
    """

    n: int
    solver: str
    seconds: float
    block: int
    _solve: Solve

    def solve(self, rhs: Array, *, advance: Advance = silent) -> Array:
        """Solve for one right-hand side or several; rows of fixed unknowns are zero.

        Args:
            rhs: right-hand sides, shape (n,) or (n, k)
            advance: called with the number of columns done

        Returns:
            Solutions, in the shape of `rhs`.
        """
        columns = rhs.reshape(self.n, -1)
        result = np.empty(columns.shape)
        for start in range(0, columns.shape[1], self.block):
            chosen = slice(start, start + self.block)
            result[:, chosen] = self._solve(columns[:, chosen])
            advance(result[:, chosen].shape[1])
        return result.reshape(rhs.shape)


def solver_name() -> str:
    """Return the solver in use: NASSIM_SOLVER, otherwise the first of SOLVERS that is installed."""
    chosen = os.environ.get("NASSIM_SOLVER")
    if chosen is None:
        return next(name for name, solver in SOLVERS.items() if solver.is_installed())
    name = known("NASSIM_SOLVER", chosen, SOLVERS)
    if not SOLVERS[name].is_installed():
        raise ValueError(f"NASSIM_SOLVER is {name}, which is not installed: pip install {SOLVERS[name].package}")
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
    solve = SOLVERS[name].factorize(matrix, free)
    factor = Factorization(n, name, time.perf_counter() - start, SOLVERS[name].block, solve)
    probe = np.where(free, np.random.default_rng(0).standard_normal(n), 0.0)
    solution = factor.solve(probe)
    residual = np.where(free, matrix @ solution, 0.0) - probe
    solved = np.linalg.norm(residual) < 1e-4 * np.linalg.norm(probe)
    if not (solved and np.all(matrix.diagonal[free] > 0) and probe @ solution > 0):
        raise ValueError(SINGULAR)
    return factor


def _by_ngsolve(matrix: SymmetricMatrix, free: NDArray[np.bool_], *, inverse: str) -> Solve:
    """Factorise by one of NGSolve's solvers and return the function that solves."""
    symmetric = inverse == "sparsecholesky"  # reads the lower triangle only
    entries = (matrix.lower if symmetric else matrix.to_scipy()).tocoo()
    native = la.SparseMatrixd.CreateFromCOO(entries.row, entries.col, entries.data, *matrix.shape)
    with threads():
        factor = native.Inverse(ngsolve.BitArray(free.tolist()), inverse=inverse)
    rhs, solution = native.CreateColVector(), native.CreateColVector()

    def solve(column: Array) -> Array:
        rhs.FV().NumPy()[:] = column[:, 0]
        with threads():
            solution.data = factor * rhs
        return solution.FV().NumPy()[:, None]

    return solve


def _multifrontal(matrix: SymmetricMatrix, free: NDArray[np.bool_]) -> Solve:
    """Factorise by dense fronts and return the function that solves."""
    try:
        with blas_threads(0):
            factor = multifrontal.Factor(matrix.lower, free)
    except ArithmeticError as error:
        raise ValueError(SINGULAR) from error

    def solve(columns: Array) -> Array:
        with blas_threads(0):
            return factor.solve(columns)

    return solve


def _cholmod(matrix: SymmetricMatrix, free: NDArray[np.bool_]) -> Solve:
    """Factorise by CHOLMOD and return the function that solves."""
    # Imported here, because it is optional.
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


def _pardiso(matrix: SymmetricMatrix, free: NDArray[np.bool_]) -> Solve:
    """Factorise by PARDISO and return the function that solves."""
    upper = matrix.lower[free][:, free].T.tocsr()
    upper.sort_indices()
    try:
        factor = pardiso.Factor(upper, n_threads=n_threads())
    except ArithmeticError as error:
        raise ValueError(SINGULAR) from error

    def solve(columns: Array) -> Array:
        result = np.zeros(columns.shape)
        result[free] = factor.solve(columns[free])
        return result

    return solve


def _is_found(package: str) -> bool:
    """Return whether a package is installed."""
    return importlib.util.find_spec(package) is not None


SOLVERS: Mapping[str, Solver] = MappingProxyType(
    {
        "pardiso": Solver("mkl", 32, _pardiso, pardiso.is_installed),
        "multifrontal": Solver("nassim", 32, _multifrontal, lambda: True),
        "cholmod": Solver("cvxopt", 1, _cholmod, partial(_is_found, "cvxopt")),
        "sparsecholesky": Solver("ngsolve", 1, partial(_by_ngsolve, inverse="sparsecholesky"), lambda: True),
        "umfpack": Solver("ngsolve", 1, partial(_by_ngsolve, inverse="umfpack"), lambda: True),
    }
)
"""Solvers by name, the preferred ones first."""


def factor_memory(centres: Array, unknowns: Sequence[NDArray[np.int64]]) -> float:
    """Estimate an upper bound of the memory of a factorisation [bytes] from the mesh alone, before it begins.

    The elements are repeatedly divided at the median of their longest extent. The unknowns between two halves form
    dense fronts, whose entries are counted. The orderings of the solvers need 30 to 80 % of this bound (measured on
    compact and on thin solids).

    Args:
        centres: centres of the elements, shape (n_elements, 3) [m]
        unknowns: scalar unknowns of each element
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
        own, shared = 3 * own, 3 * np.bincount(border, minlength=2**k)  # three unknowns per scalar one
        entries += float(np.sum(0.5 * own * own + own * shared))
    return 8.0 * entries
