"""Strains of a body's motions: rigid-body modes, and eigenmodes whose low frequencies are as accurate as high ones.

A motion without strain is a rigid-body mode. This follows from geometry alone: from the rows of the strains, whatever
their stiffness. The computed frequency cannot decide it, because 0.7 Hz and 2 MHz occur in one scene. The eigenvalues
of a stiffness matrix cannot decide it either, because their errors are a share of the *square* of the highest
frequency. With K = G^T G they are computed from G, and the errors are a share of the highest frequency itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.modal import unit_mass_scale
from nassim.base.rigid_motion import rigid_motions
from nassim.base.short_repr import short_repr
from nassim.bodies.readouts import sparse_if_faster

UNSTRAINED = 1e-9
"""A strain below this share of the largest possible sum of its terms is a rounding error."""
RIGID_MOTION_ROUNDING = 1e-11
"""Share of a body's largest stiffness, as the square of a frequency, that rounding may leave in its rigid motions."""


@dataclass(frozen=True)
class Strain:
    """Strains that resist motion in n coordinates.

    Attributes:
        rows: strain per unit of the coordinates, shape (m, n); rows have unit length if each coordinate is scaled to
            unit mass
        root: G, shape (p, n): weighted strains such that the stiffness matrix is G^T G
    """

    rows: Array
    root: Array
    __repr__ = short_repr

    @property
    def stiffness(self) -> Array:
        """Stiffness matrix, shape (n, n)."""
        return self.root.T @ self.root

    def within(self, change: Array) -> "Strain":
        """Return the strains in the n' coordinates q', where q = change @ q', shape (n, n')."""
        factor = sparse_if_faster(change)
        return Strain(self.rows @ factor, self.root @ factor)


def combine_strains(strains: Sequence[Strain], n: int) -> Strain:
    """Combine the strains of several bodies and springs in the same n coordinates."""
    nothing = np.zeros((0, n))
    return Strain(np.vstack([nothing, *(s.rows for s in strains)]), np.vstack([nothing, *(s.root for s in strains)]))


def spring_strain(row: Array, stiffness: float, mass: Array) -> Strain:
    """Return the strain of a spring whose elongation is row @ q.

    Args:
        row: elongation per unit of the coordinates, shape (n,)
        stiffness: stiffness of the spring [N/m]
        mass: mass matrix, shape (n, n)
    """
    size = np.linalg.norm(row * unit_mass_scale(mass))
    rows = row[None] if stiffness > 0 and size > 0 else np.zeros((0, len(row)))
    return Strain(rows / (size or 1.0), np.sqrt(stiffness) * rows)


def body_strain(stiffness: Array, mass: Array, positions: Array) -> Strain:
    """Compute the strains of a body from its stiffness matrix.

    If the six rigid motions cause no forces, within rounding, only motion relative to the first point causes strain. If
    they cause forces, because the body is connected to the ground or its matrix is damaged, all motion causes strain.
    Directions in which the stiffness is only rounding, or negative, have no strain.

    Args:
        stiffness: stiffness matrix, shape (n, n)
        mass: mass matrix, shape (n, n)
        positions: positions of the r points whose motions are the first 6 r coordinates, shape (r, 3) [m]
    """
    n = len(mass)
    relative = np.eye(n)
    if has_rigid_modes(stiffness, mass, positions):
        relative, stiffness = _relative_to_first(positions, n), stiffness[6:, 6:]
    kinds, weights = stiffness_root(stiffness, n_points=len(stiffness) - n + 6 * len(positions))
    rows = kinds @ relative
    size = np.linalg.norm(rows * unit_mass_scale(mass), axis=1, keepdims=True)
    return Strain(rows / size, weights @ relative)


def strain_eigenmodes(strain: Strain, mass: Array) -> tuple[Array, Array]:
    """Compute eigenfrequencies and mode shapes from strains.

    Args:
        strain: strains in n coordinates
        mass: mass matrix, shape (n, n)

    Returns:
        Frequencies, ascending, shape (n,) [Hz], exactly 0 for rigid-body modes only, and mode shapes of unit modal
        mass, shape (n, n).

    Raises:
        ValueError: if the mass matrix is not positive definite
    """
    motions, n_rigid = _unit_mass_motions(strain, mass)
    _, omega, combinations = np.linalg.svd(strain.root @ motions[:, n_rigid:], full_matrices=False)
    shapes = np.hstack([motions[:, :n_rigid], motions[:, n_rigid:] @ combinations[::-1].T])
    return np.concatenate([np.zeros(n_rigid), omega[::-1]]) / (2 * np.pi), shapes


def strain_eigenfrequencies(strain: Strain, mass: Array) -> Array:
    """Compute the eigenfrequencies of `strain_eigenmodes` without the mode shapes, shape (n,) [Hz]."""
    n, scale, factor = len(mass), unit_mass_scale(mass), _mass_factor(mass)
    n_elastic = n - _unstrained(strain, scale).shape[1]
    omega = np.zeros(0)
    if strain.root.size:  # SciPy before 1.14 takes no empty matrix
        # Rigid-body modes have no strain, so they leave the largest singular values as they are.
        root = scipy.linalg.solve_triangular(factor, (strain.root * scale).T, lower=True, check_finite=False)
        omega = np.linalg.svd(root, compute_uv=False)[:n_elastic]
    return np.concatenate([np.zeros(n - n_elastic), omega[::-1]]) / (2 * np.pi)


def _unit_mass_motions(strain: Strain, mass: Array) -> tuple[Array, int]:
    """Return motions that are orthonormal in the mass's inner product, shape (n, n), and how many are without strain.

    Those without strain, which are the rigid-body modes, come first.
    """
    if not len(mass):
        return np.zeros((0, 0)), 0
    scale, factor = unit_mass_scale(mass), _mass_factor(mass)
    rigid = _unstrained(strain, scale)
    axes = np.linalg.qr(factor.T @ rigid, mode="complete")[0] if rigid.size else np.eye(len(mass))
    return scale[:, None] * scipy.linalg.solve_triangular(factor.T, axes), rigid.shape[1]


def _mass_factor(mass: Array) -> Array:
    """Return the lower triangular factor of a mass matrix that is scaled to a unit diagonal, shape (n, n)."""
    scale = unit_mass_scale(mass)
    try:
        return np.linalg.cholesky(scale[:, None] * mass * scale)
    except np.linalg.LinAlgError as error:
        raise ValueError("the mass matrix is not positive definite: no eigenmodes") from error


def _unstrained(strain: Strain, scale: Array) -> Array:
    """Return orthonormal motions without strain, (n, k), of coordinates scaled to unit mass; by pivoted QR."""
    rows = strain.rows * scale
    n = rows.shape[1]
    if not rows.size:
        return np.eye(n)
    (reflectors, factors), triangle, _ = scipy.linalg.qr(rows.T, mode="raw", pivoting=True, check_finite=False)
    rank = int(np.count_nonzero(np.abs(np.diag(triangle)) > UNSTRAINED))
    last = np.eye(n, n - rank, -rank)
    return scipy.linalg.lapack.dormqr("L", "N", reflectors[:, : len(factors)], factors, last, 64 * n)[0]


def stiffness_root(stiffness: Array, *, n_points: int) -> tuple[Array, Array]:
    """Factorise a stiffness matrix, which may be semidefinite, as K = G^T G.

    Args:
        stiffness: K, shape (n, n)
        n_points: number of coordinates, the first ones, that are translations and rotations of points

    Returns:
        Independent strains, shape (m, n), and G, shape (m, n).
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
    """Return whether rigid motions cause no forces, within rounding of the largest force that any motion causes.

    The forces are not compared with the sum of their own terms, because for a body with one point these are rounding
    errors too.

    Args:
        stiffness: stiffness matrix, shape (n, n)
        mass: mass matrix, shape (n, n)
        positions: positions of the points, shape (r, 3) [m]
    """
    if not len(positions):
        return False
    scale = unit_mass_scale(mass)
    scaled, amplitudes = scale[:, None] * stiffness * scale, rigid_motions(positions, len(mass)) / scale[:, None]
    force = np.linalg.norm(scaled @ amplitudes, axis=0)
    return bool(np.all(force <= RIGID_MOTION_ROUNDING * np.linalg.norm(scaled) * np.linalg.norm(amplitudes, axis=0)))


def remove_rounding(stiffness: Array, positions: Array) -> Array:
    """Return a stiffness matrix with rigid-body modes, whose rows of the first point follow from equilibrium.

    Args:
        stiffness: stiffness matrix of a body with rigid-body modes, shape (n, n)
        positions: positions of the points, shape (r, 3) [m]
    """
    relative = _relative_to_first(positions, len(stiffness))
    result: Array = relative.T @ stiffness[6:, 6:] @ relative
    return 0.5 * (result + result.T)


def _relative_to_first(positions: Array, n: int) -> Array:
    """Return the motions of all points relative to the first one as a rigid body, and the modes, shape (n - 6, n)."""
    motions = rigid_motions(positions - positions[0], n)
    return np.hstack([-motions[6:], np.eye(n - 6)])
