"""Block Lanczos: orthonormal vectors on which the inverse A = K^-1 M of an eigenproblem is projected.

A is symmetric in the mass's inner product. So in exact arithmetic it takes a block of vectors to the span of that
block, the one before and a new one, and its projection on all blocks is a band. Its eigenvectors of large eigenvalues
are the slowest modes. Functions of A times the first block converge on the same vectors.

Source: R. G. Grimes, J. G. Lewis, H. D. Simon, A shifted block Lanczos algorithm for solving sparse symmetric
generalized eigenproblems, SIAM J. Matrix Anal. Appl. 15 (1994) 228-272.
"""

from collections.abc import Callable

import numpy as np

from nassim.base.checks import Array
from nassim.fem.sparse import symmetric_product


class BlockLanczos:
    """Blocks of vectors that are orthonormal in the mass's inner product, and the projection of A = K^-1 M on them.

    All blocks are kept, and every new one is made orthogonal to all of them.

    Attributes:
        vectors: the blocks, shape (n_dofs, k) each
        projection: of A on all blocks but the last, shape (p, p)
        rest: A times the last but one block, in terms of the last, shape (k_last, k)
        n_solves: number of columns solved
    """

    def __init__(
        self, solve: Callable[[Array], Array], multiply_mass: Callable[[Array], Array], rounding: float, share: float
    ) -> None:
        """Begin without vectors.

        Args:
            solve: function from forces (n_dofs, k) to static displacements K^-1 f, which may be changed
            multiply_mass: function from displacements (n_dofs, k) to the mass matrix times them
            rounding: share of the mass of a vector below which what is new in it is rounding
            share: share of the mass of a block's vectors below which a combination of them is rounding
        """
        self._solve, self._multiply_mass, self._rounding, self._share = solve, multiply_mass, rounding, share
        self.vectors: list[Array] = []
        self._inertia: list[Array] = []  # products of the vectors with the mass matrix
        self.projection = self.rest = np.zeros((0, 0))
        self.n_solves = 0

    @property
    def is_complete(self) -> bool:
        """Whether A takes all vectors to themselves."""
        return not self.vectors or not self.vectors[-1].size

    def begin(self, loads: Array) -> Array:
        """Append what is new in the responses to loads, (n_dofs, k), and return these in terms of all vectors, (p, k).

        That is how to begin, and how to go on once the vectors are complete.
        """
        responses = self._append(loads, 0)
        self.rest = np.zeros((self.vectors[-1].shape[1], 0))
        return responses

    def extend(self) -> None:
        """Apply A to the last block, and append what is new in the result."""
        last = len(self.vectors) - 1
        # A is symmetric, so only the last two blocks have more than a rounding error in the result.
        columns = self._append(self._inertia[-1], max(0, last - 1))
        before, count = len(self.projection), len(self.projection) + self.vectors[last].shape[1]
        columns, self.rest = columns[:count], columns[count:]
        self.projection = np.block([[self.projection, columns[:before]], [columns[:before].T, columns[before:]]])

    def combine(self, shapes: Array) -> Array:
        """Return combinations (n_dofs, m) of the first vectors by their factors, (p, m)."""
        result, first = np.zeros((len(self.vectors[0]), shapes.shape[1])), 0
        for vectors in self.vectors:
            chosen = shapes[first : first + vectors.shape[1]]
            result += vectors[:, : len(chosen)] @ chosen
            first += len(chosen)
        return result

    def _append(self, loads: Array, nearest: int) -> Array:
        """Append what is new in the responses to loads, and return these in terms of all vectors.

        Args:
            loads: the loads, (n_dofs, k)
            nearest: index of the first block that has more than a rounding error in the responses
        """
        new = self._solve(loads)
        self.n_solves += loads.shape[1]
        parts = [np.zeros((vectors.shape[1], loads.shape[1])) for vectors in self.vectors]
        # The pass through all blocks removes the rounding errors of the first one.
        for k in (*range(nearest, len(parts)), *range(len(parts))):
            change = self._inertia[k].T @ new
            new -= self.vectors[k] @ change
            parts[k] += change
        inertia = self._multiply_mass(new)
        left = np.einsum("ij,ij->j", new, inertia)
        kept = left > self._rounding * sum((np.sum(part**2, axis=0) for part in parts), left)
        unit = 1 / np.sqrt(left[kept])
        vectors, inertia = orthonormal(unit * new[:, kept], unit * inertia[:, kept], self._share)
        self.vectors.append(vectors)
        self._inertia.append(inertia)
        return np.vstack([*parts, inertia.T @ new])


def orthonormal(vectors: Array, inertia: Array, share: float) -> tuple[Array, Array]:
    """Return vectors of unit mass that span given ones of at most unit mass, without directions below a share of that.

    The second round removes the rounding errors that the first one leaves in short directions.

    Args:
        vectors: the vectors, shape (n_dofs, k)
        inertia: their products with the mass matrix, which are returned for the new vectors too
        share: share of the mass
    """
    for _ in range(2 if vectors.size else 0):
        change = unit_combinations(symmetric_product(vectors, inertia), share)
        vectors, inertia = vectors @ change, inertia @ change
    return vectors, inertia


def unit_combinations(gram: Array, share: float) -> Array:
    """Return combinations of vectors, shape (k, k'), that have unit mass, without directions below a share of that.

    Args:
        gram: products of the vectors in the mass's inner product, shape (k, k)
        share: share of the mass
    """
    size, axes = np.linalg.eigh(gram)
    kept = size > share * size.max(initial=1.0)
    return axes[:, kept] / np.sqrt(size[kept])
