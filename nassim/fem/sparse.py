"""Sparse symmetric matrices, stored once, from any assembler."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp

from nassim.base.checks import Array


@dataclass(frozen=True)
class SymmetricMatrix:
    """A sparse symmetric matrix of which only the lower triangle is stored, if possible in NGSolve's own memory.

    Attributes:
        lower: lower triangle with the diagonal, shape (n, n)
        native: the same as an NGSolve matrix; with None, a factorisation makes one when it needs it
    """

    lower: sp.csr_matrix
    native: Any = field(default=None, repr=False)

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns."""
        return self.lower.shape

    def __matmul__(self, columns: Array) -> Array:
        """Return the product with a vector (n,) or with columns (n, k)."""
        diagonal = self.lower.diagonal()
        below = columns * (diagonal if columns.ndim == 1 else diagonal[:, None])
        result: Array = self.lower @ columns + self.lower.T @ columns - below
        return result

    def to_scipy(self) -> sp.csr_matrix:
        """Return the whole matrix; every call makes a new one."""
        return (self.lower + sp.tril(self.lower, -1).T).tocsr()


def symmetric_matrix(matrix: Any) -> SymmetricMatrix:
    """Return the lower triangle of a SciPy matrix, or of a symmetric NGSolve matrix (shared, not copied)."""
    if sp.issparse(matrix):
        return SymmetricMatrix(sp.tril(matrix, format="csr"))
    values, columns, row_starts = (np.asarray(part) for part in matrix.CSR())
    shape = (matrix.height, matrix.width)
    return SymmetricMatrix(sp.csr_matrix((values, columns, row_starts.astype(columns.dtype)), shape=shape), matrix)
