"""Fixed-interface modes of a condensed FE model, and Ritz vectors that represent all omitted modes.

In terms of all fixed-interface modes phi_j with squared frequencies lambda_j, the dynamic stiffness at the remote
points is

    D(omega) = K_cc - omega^2 M_cc - omega^4 sum_j m_j m_j^T / (lambda_j - omega^2),   m_j = Psi^T M phi_j

A reduction with p modes omits the rest of the sum. The solutions X = K^-1 M Psi with the remote points fixed take one
solve each. The Galerkin projection on their span reproduces the whole sum and its first derivative with respect to
omega^2 at zero. After the modes are projected out, the Ritz vectors of this space represent the omitted modes.
Source: R. R. Craig, C. J. Chang, On the use of attachment modes in substructure coupling, AIAA paper 77-405 (1977);
Z.-Q. Qu, Model Order Reduction Techniques (2004), ch. 6, on moments.
"""

from dataclasses import replace
from numbers import Real

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

from nassim.base.checks import Array
from nassim.base.modal import eigenmodes
from nassim.base.progress import Advance, silent
from nassim.fem.condensation import Condensation
from nassim.fem.fe_model import FEModel
from nassim.fem.solver import threads

LANCZOS_TOLERANCE = 1e-6
"""Relative residual of a converged mode; the relative error of its frequency is about the square of this value."""
DEPENDENT_VECTOR = 1e-10
"""Directions of Ritz vectors with less than this share of their mass are rounding errors."""
DEPENDENT_LOAD = 1e-13
"""The same for responses to loads, which the vectors contain."""
SOLUTION_ROUNDING = 1e-16
"""If the modes leave less than this share of a solution's mass, it lies in their span, for example by symmetry."""
MOVED_POINTS = 1e-5
"""Motion of fixed remote points, relative to the displacements [-, 1/m], that only solutions of pure rounding have."""


def check_n_modes(n_modes: int, n_dofs: int) -> None:
    """Raise ValueError if a model with n_dofs unknowns does not have so many modes."""
    if not (isinstance(n_modes, Real) and 0 <= n_modes < n_dofs // 2 and int(n_modes) == n_modes):
        raise ValueError(f"n_modes must be a whole number from 0 to {n_dofs // 2 - 1} for this model, got {n_modes!r}")


def fixed_interface_modes(condensed: Condensation, *, n_modes: int, advance: Advance = silent) -> tuple[Array, Array]:
    """Compute the lowest modes with all remote points fixed, by shift-invert Lanczos with the existing factorisation.

    Args:
        condensed: static condensation of the model
        n_modes: number p of modes
        advance: called once per solve

    Returns:
        Frequencies, shape (p,) [Hz], and mode shapes of unit modal mass, shape (n_dofs, p).
    """
    n, n_free = condensed.fe_model.n_dofs, _n_free(condensed)
    check_n_modes(n_modes, min(n, 2 * n_free))
    if n_modes == 0:
        return np.zeros(0), np.zeros((n, 0))
    if condensed._modes is not None and n_modes <= len(condensed._modes[0]):
        frequency, modes = condensed._modes
        return frequency[:n_modes], modes[:, :n_modes]
    mass = mass_operator(condensed.fe_model)

    def solve(load: Array) -> Array:
        advance()
        return condensed.solve_fixed(np.ravel(load))

    inverse = LinearOperator((n, n), matvec=solve, dtype=float)
    with threads():
        start = condensed.solve_fixed(mass @ np.random.default_rng(0).standard_normal(n))
        # A basis of this size rarely needs a restart. Old ARPACK fails if it exceeds the number of motions.
        basis = min(n_free, max(20, 2 * n_modes + 8))
        eigenvalues, modes = eigsh(
            mass, k=n_modes, M=mass, sigma=0.0, OPinv=inverse, v0=start, ncv=basis, tol=LANCZOS_TOLERANCE
        )
    order = np.argsort(eigenvalues)
    return np.sqrt(eigenvalues[order]) / (2 * np.pi), modes[:, order]


def keep_modes(condensed: Condensation, *, n_modes: int) -> Condensation:
    """Return the condensation with its first fixed-interface modes, at most all, which are then not computed again."""
    n_modes = min(n_modes, largest_n_modes(condensed))
    return replace(condensed, _modes=fixed_interface_modes(condensed, n_modes=n_modes))


def _n_free(condensed: Condensation) -> int:
    """Return the number of motions with all remote points fixed."""
    held = sum(3 * len(c.dofs) if c.point.coupling == "rbe2" else 6 for c in condensed.couplings)
    return condensed.fe_model.n_dofs - held


def largest_n_modes(condensed: Condensation) -> int:
    """Return the largest number of modes that `fixed_interface_modes` computes."""
    return max(0, min(condensed.fe_model.n_dofs // 2, _n_free(condensed)) - 1)


def modes_below(condensed: Condensation, cutoff_frequency: float, *, advance: Advance = silent) -> tuple[Array, Array]:
    """Compute all fixed-interface modes below a frequency, and at least one above it.

    Args:
        condensed: static condensation of the model
        cutoff_frequency: the frequency [Hz]
        advance: called once per solve

    Returns:
        Frequencies, shape (p,) [Hz], and mode shapes of unit modal mass, shape (n_dofs, p).
    """
    count = 8
    while True:
        frequency, modes = fixed_interface_modes(condensed, n_modes=count, advance=advance)
        if frequency[-1] > cutoff_frequency:
            return frequency, modes
        count *= 2


def residual_vectors(
    condensed: Condensation, frequency: Array, modes: Array, *, loads: Array | None = None, advance: Advance = silent
) -> tuple[Array, Array]:
    """Compute Ritz vectors that represent all modes except the given ones.

    They are zero at the remote points, have unit modal mass and are orthogonal to the modes.

    Args:
        condensed: static condensation of the model
        frequency: frequencies of the lowest fixed-interface modes, shape (p,) [Hz]
        modes: the lowest fixed-interface modes, shape (n_dofs, p)
        loads: further forces, shape (n_dofs, q) [N]; the modes and vectors together contain the static responses to
            them exactly
        advance: called once per solve

    Returns:
        Frequencies, shape (k,) [Hz], and vectors, shape (n_dofs, k).
    """
    mass = mass_operator(condensed.fe_model)
    with threads():
        inertia = mass @ condensed.constraint_modes
        directions = _slowest_motions(condensed, frequency, inertia, modes.T @ inertia)
        loads = np.zeros((len(inertia), 0)) if loads is None else loads
        vectors = condensed.solve_fixed(np.hstack([loads, inertia @ directions]), advance=advance)
        # The modes are accurate to LANCZOS_TOLERANCE but orthogonal to machine precision, and the remainder may be
        # small. So K X = M Psi and K phi = lambda M phi are not used, only products with K and M.
        whole = np.einsum("ij,ij->j", vectors, mass @ vectors)
        vectors -= modes @ (modes.T @ (mass @ vectors))
        # The remainder of a solution in the span of the modes is rounding, which must not be scaled to unit mass.
        left = np.einsum("ij,ij->j", vectors, mass @ vectors) > SOLUTION_ROUNDING * whole
        # The solution under a load that the remote points bear entirely is rounding too, in which they move.
        left &= np.abs(condensed.averages @ vectors).max(axis=0) < MOVED_POINTS * np.abs(vectors).max(axis=0)
        vectors, n_loads = vectors[:, left], int(np.count_nonzero(left[: loads.shape[1]]))
        vectors /= np.sqrt(np.einsum("ij,ij->j", vectors, mass @ vectors))
        # Responses to the loads of a coarse mesh may depend on each other, and the others on them.
        first, others = _orthonormal(vectors[:, :n_loads], mass, DEPENDENT_LOAD), vectors[:, n_loads:]
        for _ in range(2 if first.size and others.size else 0):
            others = others - first @ (first.T @ (mass @ others))
        vectors = np.hstack([first, _orthonormal(others, mass, DEPENDENT_VECTOR)])
        gram = vectors.T @ (mass @ vectors)
        stiffness = vectors.T @ (condensed.fe_model.stiffness @ vectors)
        ritz, shapes = eigenmodes(0.5 * (stiffness + stiffness.T), 0.5 * (gram + gram.T))
        return ritz, vectors @ shapes


def _orthonormal(vectors: Array, mass: LinearOperator, share: float) -> Array:
    """Return vectors of unit mass that span given ones of at most unit mass, without directions below a share of that.

    The second round removes the rounding errors that the first one leaves in short directions.
    """
    for _ in range(2 if vectors.size else 0):
        gram = vectors.T @ (mass @ vectors)
        size, axes = np.linalg.eigh(0.5 * (gram + gram.T))
        kept = size > share * size.max(initial=1.0)
        vectors = vectors @ (axes[:, kept] / np.sqrt(size[kept]))
    return vectors


def _slowest_motions(condensed: Condensation, frequency: Array, inertia: Array, participation: Array) -> Array:
    """Return motions of the remote points (6 r, k) in those eigenmodes of the free reduced body that matter here.

    Motions that only occur in faster modes hardly excite the omitted modes; at least half of all motions are taken.
    """
    n, p = len(condensed.stiffness), len(frequency)
    mass = np.block([[condensed.constraint_modes.T @ inertia, participation.T], [participation, np.eye(p)]])
    stiffness = np.zeros((n + p, n + p))
    stiffness[:n, :n] = condensed.stiffness
    stiffness[n:, n:] = np.diag((2 * np.pi * frequency) ** 2)
    free, shapes = eigenmodes(stiffness, 0.5 * (mass + mass.T))
    within = np.count_nonzero(free < frequency[-1]) if p else n
    return shapes[:n, : min(n, max(int(within), n // 2 + 3))]


def mass_operator(fe_model: FEModel) -> LinearOperator:
    """Return the mass matrix as an operator (n_dofs, n_dofs) from its scalar block."""
    block = fe_model.scalar_mass_matrix
    n = block.shape[0]

    def multiply(u: Array) -> Array:
        components = np.reshape(u, (3, n, -1))
        return np.concatenate([block @ component for component in components]).reshape(u.shape)

    return LinearOperator((3 * n, 3 * n), matvec=multiply, matmat=multiply, dtype=float)
