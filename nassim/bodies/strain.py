"""What strains in a motion: which motions are free, and modes of which the lowest are as exact as the highest.

A motion is free when it strains nothing, which follows from geometry alone: from the strains' rows, however stiff each
is. Its frequency does not tell, because 0.7 Hz and 2 MHz share a scene. Nor do the eigenvalues of a stiffness matrix,
whose errors are a share of the highest *square*: with K = G^T G they are found from G, whose errors are a share of the
highest frequency itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_motions

UNSTRAINED = 1e-9
"""Strain below this share of what its terms could add up to is rounding."""
ROUNDING = 1e-11
"""Share of a body's largest stiffness, as square of a frequency, that rounding may leave against its rigid motions."""


@dataclass(frozen=True)
class Strain:
    """The strains that resist motion in n coordinates.

    rows: strain per unit of the coordinates, (m, n), of unit length where each coordinate is scaled to unit mass
    root: G, (p, n), the same motions weighted so that the stiffness matrix is G^T G
    """

    rows: Array
    root: Array

    @property
    def stiffness(self) -> Array:
        """The stiffness matrix, (n, n)."""
        return self.root.T @ self.root

    def within(self, change: Array) -> "Strain":
        """In the coordinates q' of the motions q = change @ q', (n, n')."""
        return Strain(self.rows @ change, self.root @ change)


def joined(strains: Sequence[Strain], n: int) -> Strain:
    """The strains of several bodies and springs together, all in the same n coordinates."""
    nothing = np.zeros((0, n))
    return Strain(np.vstack([nothing, *(s.rows for s in strains)]), np.vstack([nothing, *(s.root for s in strains)]))


def spring_strain(row: Array, stiffness: float, mass: Array) -> Strain:
    """The strain of a spring [N/m] whose elongation is row @ q; row: (n,); mass: (n, n)."""
    size = np.linalg.norm(row * _unit_mass(mass))
    rows = row[None] if stiffness > 0 and size > 0 else np.zeros((0, len(row)))
    return Strain(rows / (size or 1.0), np.sqrt(stiffness) * rows)


def body_strain(stiffness: Array, mass: Array, positions: Array) -> Strain:
    """The strains of a body in the motions of points at these positions, (r, 3) [m], then modes; matrices (n, n).

    Where the six rigid motions cause no forces, to rounding, only motion relative to the first point strains. Where
    they do, as of a body that is tied to the ground or whose matrix is damaged, all motion strains.
    Directions in which the stiffness is nothing but rounding (or negative) strain nothing.
    """
    n = len(mass)
    relative = np.eye(n)
    if has_rigid_modes(stiffness, mass, positions):
        relative, stiffness = _beside_first(positions, n), stiffness[6:, 6:]
    kinds, weights = stiffness_root(stiffness, n_points=len(stiffness) - n + 6 * len(positions))
    rows = kinds @ relative
    size = np.linalg.norm(rows * _unit_mass(mass), axis=1, keepdims=True)
    return Strain(rows / size, weights @ relative)


def strained_modes(strain: Strain, mass: Array) -> tuple[Array, Array]:
    """Eigenfrequencies, ascending (n,) [Hz], exactly 0 for free motions only, and shapes of unit modal mass, (n, n).

    Raises ValueError when the mass matrix, (n, n), is not positive definite.
    """
    n = len(mass)
    if not n:
        return np.zeros(0), np.zeros((0, 0))
    scale = _unit_mass(mass)
    try:
        factor = np.linalg.cholesky(scale[:, None] * mass * scale)
    except np.linalg.LinAlgError as error:
        raise ValueError("the mass matrix is not positive definite: no eigenmodes") from error
    scaled = strain.within(np.diag(scale))
    _, sizes, directions = np.linalg.svd(scaled.rows) if len(scaled.rows) else (None, np.zeros(0), np.eye(n))
    free = n - np.count_nonzero(sizes > UNSTRAINED)
    # Free motions first, then all that is orthogonal to them in the mass's product.
    axes = np.linalg.qr(factor.T @ directions[n - free :].T, mode="complete")[0] if free else np.eye(n)
    velocity = scipy.linalg.solve_triangular(factor.T, axes)
    elastic = np.zeros((n, n - free))
    omega = np.zeros(n - free)
    if free < n:
        _, omega, combinations = np.linalg.svd(scaled.root @ velocity[:, free:], full_matrices=False)
        omega, elastic = omega[::-1], velocity[:, free:] @ combinations[::-1].T
    shapes = scale[:, None] * np.hstack([velocity[:, :free], elastic])
    return np.concatenate([np.zeros(free), omega]) / (2 * np.pi), shapes


def stiffness_root(stiffness: Array, *, n_points: int) -> tuple[Array, Array]:
    """Independent strains, (m, n), and G with G^T G = K, (m, n), of a stiffness matrix that may be semidefinite.

    n_points: how many of the coordinates, the first ones, are translations and rotations of points
    """
    n = len(stiffness)
    rounding = 10 * n * np.finfo(float).eps
    size = np.diag(stiffness).copy()
    for kind in size[:n_points].reshape(-1, 2, 3).transpose(1, 0, 2):  # N/m, then N m/rad
        kind[kind < rounding * kind.max(initial=0.0)] = 0.0
    size = np.sqrt(np.maximum(size, 0.0))
    scale = 1.0 / np.where(size > 0, size, np.inf)
    scaled = scale[:, None] * stiffness * scale
    try:
        root = np.linalg.cholesky(scaled).T
        if np.diag(root).min(initial=1.0) ** 2 > rounding:
            return np.eye(n), root * size
    except np.linalg.LinAlgError:
        pass
    values, vectors = np.linalg.eigh(scaled)
    kept = values > rounding * values.max(initial=0.0)
    kinds = vectors[:, kept].T * size
    return kinds, np.sqrt(values[kept])[:, None] * kinds


def has_rigid_modes(stiffness: Array, mass: Array, positions: Array) -> bool:
    """Whether rigid motions cause no forces beyond rounding of the largest that any motion causes.

    The forces are not compared with their own terms: of a body with one point, these are rounding too.
    """
    if not len(positions):
        return False
    scale = _unit_mass(mass)
    scaled, amplitudes = scale[:, None] * stiffness * scale, rigid_motions(positions, len(mass)) / scale[:, None]
    force = np.linalg.norm(scaled @ amplitudes, axis=0)
    return bool(np.all(force <= ROUNDING * np.linalg.norm(scaled) * np.linalg.norm(amplitudes, axis=0)))


def without_rounding(stiffness: Array, positions: Array) -> Array:
    """A stiffness matrix that lets go, (n, n), with the first point's rows from the others' by equilibrium."""
    relative = _beside_first(positions, len(stiffness))
    result: Array = relative.T @ stiffness[6:, 6:] @ relative
    return 0.5 * (result + result.T)


def _unit_mass(mass: Array) -> Array:
    """Scales of a unit diagonal of M, (n,), which mend the mix of metres, radians and modal coordinates."""
    diagonal = np.diag(mass)
    if np.any(diagonal <= 0):
        raise ValueError("the mass matrix has a diagonal entry that is not positive; it must be positive definite")
    result: Array = 1.0 / np.sqrt(diagonal)
    return result


def _beside_first(positions: Array, n: int) -> Array:
    """Motions of all points but the first beside what the first one's would give them, and modes, (n - 6, n)."""
    motions = rigid_motions(positions - positions[0], n)
    return np.hstack([-motions[6:], np.eye(n - 6)])
