"""Sparse symmetric matrices, held once, whoever assembled them."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp

from nassim.base.checks import Array


@dataclass(frozen=True)
class SymmetricMatrix:
    """A sparse symmetric matrix that is held once: its lower triangle, where possible in NGSolve's own memory.

    lower: lower triangle with the diagonal, shape (n, n)
    native: the same as an NGSolve matrix; None makes one when a factorisation needs it
    """

    lower: sp.csr_matrix
    native: Any = field(default=None, repr=False)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.lower.shape

    def __matmul__(self, columns: Array) -> Array:
        """Product with a vector (n,) or with columns (n, k)."""
        diagonal = self.lower.diagonal()
        below = columns * (diagonal if columns.ndim == 1 else diagonal[:, None])
        result: Array = self.lower @ columns + self.lower.T @ columns - below
        return result

    def to_scipy(self) -> sp.csr_matrix:
        """The whole matrix, made anew at every call."""
        return (self.lower + sp.tril(self.lower, -1).T).tocsr()


def symmetric_matrix(matrix: Any) -> SymmetricMatrix:
    """The lower triangle of a SciPy matrix, or of an NGSolve matrix with symmetric storage (shared, not copied)."""
    if sp.issparse(matrix):
        return SymmetricMatrix(sp.tril(matrix, format="csr"))
    values, columns, row_starts = (np.asarray(part) for part in matrix.CSR())
    shape = (matrix.height, matrix.width)
    return SymmetricMatrix(sp.csr_matrix((values, columns, row_starts.astype(columns.dtype)), shape=shape), matrix)
