"""Fixed-interface modes of a condensed FE model, and the vectors that stand for all modes left out.

Written in all fixed-interface modes phi_j with squared frequencies lambda_j, the remote points see a body through

    D(omega) = K_cc - omega^2 M_cc - omega^4 sum_j m_j m_j^T / (lambda_j - omega^2),   m_j = Psi^T M phi_j

so a reduction that keeps p modes lacks the rest of the sum. The solutions X = K^-1 M Psi with the remote points at
rest, one solve each, span a space whose Galerkin projection reproduces the whole sum and its first derivative with
respect to omega^2 at zero. With the modes projected out, its Ritz vectors behave as the left-out modes do together.
Source: R. R. Craig, C. J. Chang, On the use of attachment modes in substructure coupling, AIAA paper 77-405 (1977);
Z.-Q. Qu, Model Order Reduction Techniques (2004), ch. 6, on moments.
"""

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
"""Relative residual at which a mode counts as found: its frequency is then off by about the square of that."""
DEPENDENT = 1e-10
"""Directions of left-out vectors with less than this share of their mass are rounding."""
ROUNDING = 1e-16
"""A solution of which the modes leave less than this share of its mass lies in the modes, for example by symmetry."""


def check_n_modes(n_modes: int, n_dofs: int) -> None:
    """Raise ValueError when a model with n_dofs unknowns cannot give so many modes."""
    if not (isinstance(n_modes, Real) and 0 <= n_modes < n_dofs // 2 and int(n_modes) == n_modes):
        raise ValueError(f"n_modes must be a whole number from 0 to {n_dofs // 2 - 1} for this model, got {n_modes!r}")


def fixed_interface_modes(condensed: Condensation, *, n_modes: int, advance: Advance = silent) -> tuple[Array, Array]:
    """The lowest modes with all remote points held: frequencies (p,) [Hz], shapes (n_dofs, p) of unit modal mass.

    Shift-invert Lanczos around the factorisation at hand. advance: called once per solve.
    """
    n = condensed.fe_model.n_dofs
    n_free = n - sum(3 * len(c.dofs) if c.point.coupling == "rbe2" else 6 for c in condensed.couplings)
    check_n_modes(n_modes, min(n, 2 * n_free))
    if n_modes == 0:
        return np.zeros(0), np.zeros((n, 0))
    mass = mass_operator(condensed.fe_model)

    def solve(load: Array) -> Array:
        advance()
        return condensed.solve_fixed(np.ravel(load))

    inverse = LinearOperator((n, n), matvec=solve, dtype=float)
    with threads():
        start = condensed.solve_fixed(mass @ np.random.default_rng(0).standard_normal(n))
        # A basis this large mostly needs no restart; one beyond the motions that there are is an error in old ARPACK.
        basis = min(n_free, max(20, 2 * n_modes + 8))
        eigenvalues, modes = eigsh(
            mass, k=n_modes, M=mass, sigma=0.0, OPinv=inverse, v0=start, ncv=basis, tol=LANCZOS_TOLERANCE
        )
    order = np.argsort(eigenvalues)
    return np.sqrt(eigenvalues[order]) / (2 * np.pi), modes[:, order]


def modes_below(condensed: Condensation, cutoff_frequency: float, *, advance: Advance = silent) -> tuple[Array, Array]:
    """As `fixed_interface_modes`: all modes below a frequency [Hz], and at least one above it."""
    count = 8
    while True:
        frequency, modes = fixed_interface_modes(condensed, n_modes=count, advance=advance)
        if frequency[-1] > cutoff_frequency:
            return frequency, modes
        count *= 2


def left_out_vectors(
    condensed: Condensation, frequency: Array, modes: Array, *, loads: Array | None = None, advance: Advance = silent
) -> tuple[Array, Array]:
    """Ritz vectors that stand for all modes beyond the given ones: frequencies (k,) [Hz], shapes (n_dofs, k).

    frequency (p,) [Hz], modes (n_dofs, p): the lowest fixed-interface modes. The k vectors are at rest at the remote
    points, of unit modal mass and orthogonal to the modes. advance: called once per solve.
    loads: further forces, shape (n_dofs, q) [N], whose static answers the modes and vectors together hold exactly
    """
    mass = mass_operator(condensed.fe_model)
    with threads():
        inertia = mass @ condensed.constraint_modes
        directions = _slowest_motions(condensed, frequency, inertia, modes.T @ inertia)
        loads = np.zeros((len(inertia), 0)) if loads is None else loads
        vectors = condensed.solve_fixed(np.hstack([loads, inertia @ directions]), advance=advance)
        # The modes are good to LANCZOS_TOLERANCE but orthogonal to the last digit, and what they leave may be small:
        # so neither K X = M Psi nor K phi = lambda M phi is made use of, only products with K and M themselves.
        whole = np.einsum("ij,ij->j", vectors, mass @ vectors)
        vectors -= modes @ (modes.T @ (mass @ vectors))
        # The rest of a solution that lies in the modes is rounding, which must not be scaled to unit mass.
        left = np.einsum("ij,ij->j", vectors, mass @ vectors) > ROUNDING * whole
        vectors, n_loads = vectors[:, left], int(np.count_nonzero(left[: loads.shape[1]]))
        gram = vectors.T @ (mass @ vectors)
        stiffness = vectors.T @ (condensed.fe_model.stiffness @ vectors)
        combinations = _independent(0.5 * (gram + gram.T), n_loads)
        ritz, shapes = eigenmodes(combinations.T @ stiffness @ combinations, combinations.T @ gram @ combinations)
        return ritz, vectors @ (combinations @ shapes)


def _independent(gram: Array, n_first: int) -> Array:
    """Combinations of vectors with this Gram matrix, less what rounding left; the first n_first stay exact."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    gram = scale[:, None] * gram * scale
    n = len(gram)
    others = np.eye(n, n - n_first, -n_first)
    others[:n_first] = -np.linalg.solve(gram[:n_first, :n_first], gram[:n_first, n_first:])
    weight, turn = np.linalg.eigh(others.T @ gram @ others)
    return scale[:, None] * np.hstack([np.eye(n, n_first), others @ turn[:, weight > DEPENDENT * weight[-1]]])


def _slowest_motions(condensed: Condensation, frequency: Array, inertia: Array, participation: Array) -> Array:
    """Motions of the remote points (6 r, k) in the free reduced body's eigenmodes within reach of the kept modes.

    Motions that only faster modes contain hardly excite what was left out; at least half of all are taken.
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
    """The mass matrix as an operator (n_dofs, n_dofs), from its one scalar block."""
    block = fe_model.scalar_mass_matrix
    n = block.shape[0]

    def multiply(u: Array) -> Array:
        components = np.reshape(u, (3, n, -1))
        return np.concatenate([block @ component for component in components]).reshape(u.shape)

    return LinearOperator((3 * n, 3 * n), matvec=multiply, matmat=multiply, dtype=float)
