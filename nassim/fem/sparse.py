"""Sparse symmetric matrices, stored once, from any assembler."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from nassim.base.checks import Array

COLUMNS = 64
"""Number of columns of a symmetric product that are computed at once."""


@dataclass(frozen=True)
class SymmetricMatrix:
    """A sparse symmetric matrix of which only the lower triangle is stored.

    Attributes:
        lower: lower triangle with the diagonal, shape (n, n)
    """

    lower: sp.csr_matrix

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns."""
        return self.lower.shape

    @cached_property
    def diagonal(self) -> Array:
        """Diagonal, shape (n,)."""
        result: Array = self.lower.diagonal()
        return result

    def __matmul__(self, columns: Array) -> Array:
        """Return the product with a vector (n,) or with columns (n, k)."""
        below = columns * (self.diagonal if columns.ndim == 1 else self.diagonal[:, None])
        return self.lower @ columns + self.lower.T @ columns - below

    def between(self, columns: Array) -> Array:
        """Return columns^T A columns, exactly symmetric, shape (k, k), by one product with the lower triangle."""
        below = self.lower @ columns - 0.5 * self.diagonal[:, None] * columns
        half = columns.T @ below
        return half + half.T

    def times_rows(self, chosen: NDArray[np.int64], rows: Array) -> Array:
        """Return the product with columns (n, k) that are zero but for some rows.

        Args:
            chosen: indices of these rows, ascending
            rows: the rows, shape (len(chosen), k)
        """
        below = self.lower[chosen]
        result: Array = self.lower[:, chosen] @ rows + below.T @ rows
        result[chosen] -= self.diagonal[chosen, None] * rows
        return result

    def to_scipy(self) -> sp.csr_matrix:
        """Return the whole matrix; every call makes a new one."""
        return (self.lower + sp.tril(self.lower, -1).T).tocsr()


def symmetric_matrix(matrix: Any) -> SymmetricMatrix:
    """Return the lower triangle of a SciPy matrix, or a copy of that of an NGSolve matrix in symmetric storage."""
    if sp.issparse(matrix):
        return SymmetricMatrix(sp.tril(matrix, format="csr"))
    values, columns, row_starts = (np.array(part, copy=True) for part in matrix.CSR())
    shape = (matrix.height, matrix.width)
    return SymmetricMatrix(sp.csr_matrix((values, columns, row_starts.astype(columns.dtype)), shape=shape))


def symmetric_product(left: Array, right: Array) -> Array:
    """Return left^T right, shape (k, k), known to be symmetric, from the products on and above its diagonal.

    Args:
        left: columns, shape (n, k)
        right: the same columns times a symmetric matrix, shape (n, k)
    """
    k = left.shape[1]
    result = np.zeros((k, k))
    for start in range(0, k, COLUMNS):
        end = start + COLUMNS
        result[:end, start:end] = left[:, :end].T @ right[:, start:end]
    return symmetric_from_upper(result)


def symmetric_from_upper(matrix: Array) -> Array:
    """Return the symmetric matrix that is equal to a given one on and above the diagonal, shape (n, n)."""
    result: Array = np.triu(matrix) + np.triu(matrix, 1).T
    return result
