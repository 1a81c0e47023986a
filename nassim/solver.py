"""One sparse factorisation, many right-hand sides, for any symmetric positive definite SciPy matrix."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import ngsolve
import numpy as np
import scipy.sparse as sp
from ngsolve import la
from numpy.typing import NDArray

from nassim.checks import Array
from nassim.progress import Advance, silent


@dataclass(frozen=True)
class Factorization:
    """A factorised matrix with some unknowns held at zero.

    n: number of unknowns; seconds: time that the factorisation took [s]
    """

    n: int
    seconds: float
    _inverse: Any = field(repr=False)
    _rhs: Any = field(repr=False)
    _solution: Any = field(repr=False)

    def solve(self, rhs: Array, *, advance: Advance = silent) -> Array:
        """Solve for one right-hand side, shape (n,), or for several, shape (n, k); zero rows where held.

        advance: called once per column
        """
        columns = rhs.reshape(self.n, -1)
        result = np.empty_like(columns, dtype=float, order="F")
        with threads():
            for k in range(columns.shape[1]):
                self._rhs.FV().NumPy()[:] = columns[:, k]
                self._solution.data = self._inverse * self._rhs
                result[:, k] = self._solution.FV().NumPy()
                advance()
        return result.reshape(rhs.shape)


def factorize(matrix: sp.csr_matrix, *, held: NDArray[np.int64] | None = None) -> Factorization:
    """Factorise a symmetric matrix by NGSolve's sparse Cholesky.

    matrix: symmetric, positive definite once the unknowns `held` (indices) are held at zero

    Raises ValueError when a solve with the factor does not return its right-hand side, the sign of a
    matrix that is singular or indefinite.
    """
    n = matrix.shape[0]
    free = np.ones(n, dtype=bool)
    free[[] if held is None else held] = False
    start = time.perf_counter()
    # The factorisation reads the lower triangle only, so half the matrix need not be copied.
    lower = sp.tril(matrix, format="coo")
    with threads():
        native = la.SparseMatrixd.CreateFromCOO(lower.row, lower.col, lower.data, n, n)
        del lower
        inverse = native.Inverse(ngsolve.BitArray(free.tolist()), inverse="sparsecholesky")
    vectors = native.CreateColVector(), native.CreateColVector()
    factor = Factorization(n, time.perf_counter() - start, inverse, *vectors)
    probe = np.where(free, np.random.default_rng(0).standard_normal(n), 0.0)
    residual = np.where(free, matrix @ factor.solve(probe), 0.0) - probe
    if not np.linalg.norm(residual) < 1e-4 * np.linalg.norm(probe):
        raise ValueError(
            "the stiffness matrix is singular or indefinite: is a part loose, or does a material or element "
            "have no stiffness?"
        )
    return factor


@contextmanager
def threads() -> Iterator[None]:
    """Run NGSolve on all processors that this process may use (environment variable NASSIM_THREADS: on so many)."""
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    ngsolve.SetNumThreads(int(os.environ.get("NASSIM_THREADS", available)))
    with ngsolve.TaskManager():
        yield
