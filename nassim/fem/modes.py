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

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse.linalg import LinearOperator

from nassim.base.checks import Array, whole_number
from nassim.base.modal import eigenmodes
from nassim.base.progress import Advance, silent
from nassim.fem.block_lanczos import BlockLanczos, orthonormal, unit_combinations
from nassim.fem.condensation import Condensation
from nassim.fem.fe_model import FEModel
from nassim.fem.native_threads import blas_threads
from nassim.fem.sparse import symmetric_product

LANCZOS_TOLERANCE = 1e-7
"""Relative residual of a converged mode; the relative error of its frequency is about the square of this value."""
DEPENDENT_VECTOR = 1e-10
"""Directions of Ritz vectors with less than this share of their mass are rounding errors."""
DEPENDENT_LOAD = 1e-13
"""The same for responses to loads, which the vectors contain."""
SOLUTION_ROUNDING = 1e-16
"""If the modes leave less than this share of a solution's mass, it lies in their span, for example by symmetry."""
LANCZOS_BLOCK = 8
"""Number of vectors in a step of Lanczos; solves of so many columns take hardly longer than those of a few."""
CHECK_AFTER = 1.1
"""Growth of the number of vectors after which convergence is checked again, by a dense eigenproblem of this size."""
MOVED_POINTS = 1e-5
"""Motion of fixed remote points, relative to the displacements [-, 1/m], that only solutions of pure rounding have."""


def check_n_modes(n_modes: int, n_dofs: int) -> int:
    """Return a number of modes; raise ValueError if a model with n_dofs unknowns does not have so many."""
    return whole_number(f"n_modes of a model with {n_dofs} unknowns", n_modes, 0, n_dofs // 2 - 1)


def fixed_interface_modes(condensed: Condensation, *, n_modes: int, advance: Advance = silent) -> tuple[Array, Array]:
    """Compute the lowest modes with all remote points fixed.

    Args:
        condensed: static condensation of the model
        n_modes: number p of modes
        advance: called with the number of columns solved

    Returns:
        Frequencies, shape (p,) [Hz], and mode shapes of unit modal mass, shape (n_dofs, p).
    """
    return InterfaceModes(condensed).lowest(n_modes, advance=advance)


class InterfaceModes:
    """Modes with all remote points fixed, by block Lanczos on the inverse with the existing factorisation.

    The vectors are kept, so more modes cost further steps only.
    """

    def __init__(self, condensed: Condensation) -> None:
        """Begin without vectors."""
        self._condensed, self._mass = condensed, mass_operator(condensed.fe_model)
        self._random = np.random.default_rng(0)
        self._advance: Advance = silent
        self._found = BlockLanczos(self._solve, self._mass.matmat, SOLUTION_ROUNDING, DEPENDENT_VECTOR)

    def lowest(self, n_modes: int, *, advance: Advance = silent) -> tuple[Array, Array]:
        """Compute the lowest modes; arguments and result are those of `fixed_interface_modes`."""
        n, found, self._advance = self._condensed.fe_model.n_dofs, self._found, advance
        n_modes = whole_number(f"n_modes of a model with {n} unknowns", n_modes, 0, largest_n_modes(self._condensed))
        if n_modes == 0:
            return np.zeros(0), np.zeros((n, 0))
        if (known := self._condensed._modes) is not None and n_modes <= len(known[0]):
            return known[0][:n_modes], known[1][:, :n_modes]
        with blas_threads(n * LANCZOS_BLOCK**2):
            while True:
                inverse_squares, shapes = np.linalg.eigh(found.projection)
                inverse_squares, shapes = inverse_squares[: -n_modes - 1 : -1], shapes[:, : -n_modes - 1 : -1]
                residual = np.linalg.norm(found.rest @ shapes[len(shapes) - found.rest.shape[1] :], axis=0)
                if len(inverse_squares) == n_modes and np.all(residual <= LANCZOS_TOLERANCE * inverse_squares):
                    break
                enough = CHECK_AFTER * len(found.projection)
                self._extend()
                while len(found.projection) < enough and not found.is_complete:
                    self._extend()
            return 1 / (2 * np.pi * np.sqrt(inverse_squares)), found.combine(shapes)

    def _solve(self, loads: Array) -> Array:
        return self._condensed.solve_fixed(loads, advance=self._advance)

    def _extend(self) -> None:
        """Take one step, with random vectors at the beginning and where the blocks have all modes that they excite."""
        if not self._found.is_complete:
            self._found.extend()
            return
        width = min(LANCZOS_BLOCK, max(self._condensed.solved_at_once, 2))
        random = self._random.standard_normal((self._condensed.fe_model.n_dofs, width))
        self._found.begin(self._mass @ random)
        if self._found.is_complete:
            n_modes = len(self._found.projection)
            raise ValueError(f"the model has only {n_modes} modes with all remote points fixed")


def with_interface_modes(condensed: Condensation, *, n_modes: int) -> Condensation:
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

    Raises:
        ValueError: if all modes that can be computed are below the frequency
    """
    most, found = largest_n_modes(condensed), InterfaceModes(condensed)
    count, frequency = min(8, most), np.zeros(0)
    while count:
        frequency, modes = found.lowest(count, advance=advance)
        if frequency[-1] > cutoff_frequency:
            return frequency, modes
        count = min(2 * count, most) if count < most else 0
    last = f"mode {most} at {frequency[-1]:.4g} Hz, the last" if most else "the first mode, and there is none"
    raise ValueError(
        f"cutoff_frequency {cutoff_frequency:g} Hz is above {last} that a model with {condensed.fe_model.n_dofs} "
        "unknowns gives: lower it, or take smaller elements or a higher order"
    )


def residual_vectors(
    condensed: Condensation,
    frequency: Array,
    modes: Array,
    mass: Array,
    *,
    loads: Array | None = None,
    advance: Advance = silent,
) -> tuple[Array, Array]:
    """Compute Ritz vectors that represent all modes except the given ones.

    They are zero at the remote points, have unit modal mass and are orthogonal to the modes.

    Args:
        condensed: static condensation of the model
        frequency: frequencies of the lowest fixed-interface modes, shape (p,) [Hz]
        modes: the lowest fixed-interface modes, shape (n_dofs, p)
        mass: mass matrix of the constraint modes and these modes, shape (6 r + p, 6 r + p)
        loads: further forces, shape (n_dofs, q) [N]; the modes and vectors together contain the static responses to
            them exactly
        advance: called once per solve

    Returns:
        Frequencies, shape (k,) [Hz], and vectors, shape (n_dofs, k).
    """
    times_mass = mass_operator(condensed.fe_model)
    with blas_threads(len(modes) * (condensed.constraint_modes.shape[1] // 2) ** 2):
        inertia = times_mass @ (condensed.constraint_modes @ _slowest_motions(condensed, frequency, mass))
        loads = np.zeros((len(inertia), 0)) if loads is None else loads
        vectors = condensed.solve_fixed(np.hstack([loads, inertia]) if loads.size else inertia, advance=advance)
        # The modes are accurate to LANCZOS_TOLERANCE but orthogonal to machine precision, and the remainder may be
        # small. So K X = M Psi and K phi = lambda M phi are not used, only products with K and M.
        inertia = times_mass @ vectors
        whole = np.einsum("ij,ij->j", vectors, inertia)
        vectors -= modes @ (modes.T @ inertia)
        inertia = times_mass @ vectors
        size = np.einsum("ij,ij->j", vectors, inertia)
        # The remainder of a solution in the span of the modes is rounding, which must not be scaled to unit mass.
        left = size > SOLUTION_ROUNDING * whole
        # The solution under a load that the remote points bear entirely is rounding too, in which they move.
        left &= np.abs(condensed.averages @ vectors).max(axis=0) < MOVED_POINTS * np.abs(vectors).max(axis=0)
        n_loads, unit = int(np.count_nonzero(left[: loads.shape[1]])), 1 / np.sqrt(size[left])
        if not left.all():
            vectors, inertia = vectors[:, left], inertia[:, left]
        vectors *= unit
        inertia *= unit
        # Responses to the loads of a coarse mesh may depend on each other, and the others on them.
        first, first_inertia = orthonormal(vectors[:, :n_loads], inertia[:, :n_loads], DEPENDENT_LOAD)
        others, other_inertia = vectors[:, n_loads:], inertia[:, n_loads:]
        for _ in range(2 if first.size and others.size else 0):
            parts = first_inertia.T @ others
            others, other_inertia = others - first @ parts, other_inertia - first_inertia @ parts
        others = others @ unit_combinations(symmetric_product(others, other_inertia), DEPENDENT_VECTOR)
        vectors = np.hstack([first, others]) if first.size else others
        gram = symmetric_product(vectors, times_mass @ vectors)
        stiffness = condensed.fe_model.stiffness.between(vectors)
        ritz, shapes = eigenmodes(stiffness, gram)
        return ritz, vectors @ shapes


def _slowest_motions(condensed: Condensation, frequency: Array, mass: Array) -> Array:
    """Return motions of the remote points (6 r, k) in those eigenmodes of the free reduced body that matter here.

    Motions that only occur in faster modes hardly excite the omitted modes; at least half of all motions are taken.
    """
    n = len(condensed.stiffness)
    free, shapes = eigenmodes(block_diag(condensed.stiffness, np.diag((2 * np.pi * frequency) ** 2)), mass)
    within = np.count_nonzero(free < frequency[-1]) if len(frequency) else n
    return shapes[:n, : min(n, max(int(within), n // 2 + 3))]


def mass_operator(fe_model: FEModel) -> LinearOperator:
    """Return the mass matrix as an operator (n_dofs, n_dofs) from its scalar block."""
    block = fe_model.scalar_mass_matrix
    n = block.shape[0]

    def multiply(u: Array) -> Array:
        result = np.empty((3, n, u.size // (3 * n)))
        for component, product in zip(np.reshape(u, result.shape), result, strict=True):
            product[:] = block @ component
        return result.reshape(u.shape)

    return LinearOperator((3 * n, 3 * n), matvec=multiply, matmat=multiply, dtype=float)
