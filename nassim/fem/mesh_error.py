"""Discretisation error: decrease of a reduced body's stiffness with elements one order higher.

This is a hierarchical estimate. For each basis vector, its residual on the finer unknowns gives the energy that these
would release while the coarser unknowns do not move. Without the lower degrees, the finer stiffness is well-conditioned
on every mesh. A few steps of conjugate gradients with its diagonal therefore replace a factorisation. The released
energy is a matrix in the coordinates of the reduced body, so it serves all boundary conditions at the remote points,
and it is a sum over the elements.

Source: R. E. Bank, R. K. Smith, A posteriori error estimates based on hierarchical bases, SIAM J. Numer. Anal. 30
(1993) 921-935.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.sparse as sp

from nassim.base.checks import Array
from nassim.base.progress import Advance, silent
from nassim.fem.assembly import mesh_and_solid, refine_order
from nassim.fem.condensation import Condensation
from nassim.fem.element_integrals import ElementStiffness, elastic_forces, element_stiffness
from nassim.fem.modes import mass_operator
from nassim.fem.native_threads import blas_threads, share

STEPS = 5
"""Steps of conjugate gradients; they find 97 to 99 % of the energy that a factorisation finds."""
COLUMNS = 16
"""Number of columns in one piece of the work."""
TINY = np.finfo(np.float32).tiny
"""Smallest divisor, for columns of zeros."""
DEPENDENT_CORRECTION = 1e-6
"""Share of the largest energy below which a combination of corrections is rounding, in single precision."""


@dataclass(frozen=True)
class ReleasedEnergy:
    """Energy that elements one order higher would release, in coordinates of k displacement shapes.

    Attributes:
        residual: forces that the shapes leave on the m finer scalar unknowns, shape (m, 3, k) [N]
        correction: displacements of these unknowns under these forces, shape (m, 3, k) [m]
        elements: ones where an element has a scalar unknown, shape (n_elements, m)
    """

    residual: Array
    correction: Array
    elements: sp.csr_matrix

    @property
    def stiffness(self) -> Array:
        """Decrease of the stiffness matrix, positive semidefinite, shape (k, k)."""
        residual, correction = (part.reshape(-1, part.shape[2]) for part in (self.residual, self.correction))
        released = residual.T @ correction
        return 0.5 * (released + released.T)

    def by_element(self, shapes: Array) -> Array:
        """Return the energy that each element would release in combinations of the shapes.

        Args:
            shapes: combinations, shape (k, t)

        Returns:
            Energies, shape (n_elements, t) [J]; each column adds up to the whole released energy.
        """
        products = (self.residual @ shapes) * (self.correction @ shapes)
        by_unknown = np.abs(products).sum(axis=1) / np.asarray(self.elements.sum(axis=0)).T
        shares = self.elements @ by_unknown
        return shares * (products.sum(axis=(0, 1)) / np.maximum(shares.sum(axis=0), np.finfo(float).tiny))


def released_energy(
    condensed: Condensation,
    displacements: Array,
    *,
    accelerations: Array,
    voltages: Array | None = None,
    advance: Advance = silent,
) -> ReleasedEnergy:
    """Estimate the energy that elements one order higher would release in displacement shapes.

    Forces at the remote points keep the body in each shape, together with its inertia and its electrical ports.

    Args:
        condensed: static condensation of the model
        displacements: the shapes, shape (n_dofs, k) [m]
        accelerations: fields whose product with the mass matrix loads the body, shape (n_dofs, k) [m/s2]; for a mode
            the shape times its squared angular frequency
        voltages: voltages of all electrical ports of the model, shape (n_ports, k) [V] (default: none)
        advance: called once per step

    Raises:
        ValueError: for FE models that were not made from a mesh
    """
    model = condensed.fe_model
    finer = refine_order(model)
    couplings = {coupling.point.name: coupling for coupling in finer.couplings}
    held = finer.held.copy()
    for name in condensed.names:
        if couplings[name].point.coupling == "rbe2":
            held[couplings[name].dofs] = True
    # Rows of the stiffness: all components of each free unknown, and three zeros at the end, for all that are held.
    m, k = int(np.count_nonzero(~held)), displacements.shape[1]
    node = np.full(len(held), m)
    node[~held] = np.arange(m)
    moving = np.flatnonzero(accelerations.any(axis=0))
    inertia = accelerations[:, moving]
    loads = np.zeros_like(displacements)
    with blas_threads(0):
        loads[:, moving] = mass_operator(model) @ inertia
        mixed_mass = finer.mixed_mass[~held]
        # On curved elements, the finer stiffness itself is integrated more closely than the model's: no residual.
        residual = elastic_forces(*mesh_and_solid(model), *finer.spaces, displacements, finer.held, node)
        for i, part in enumerate(np.split(inertia, 3)):
            residual[:m, i, moving] -= mixed_mass @ part
        if voltages is not None and len(voltages):
            loads += np.column_stack([port.forces for port in model.ports]) @ voltages
            residual[:m] -= finer.port_forces.reshape(3, len(held), -1)[:, ~held].swapaxes(0, 1) @ voltages
        # The rest of a displacement, with the remote points fixed, has no energy in common with the constraint modes.
        forces = condensed.stiffness @ (condensed.averages @ displacements) - condensed.constraint_modes.T @ loads
        for i, name in enumerate(condensed.names):
            coupling = couplings[name]
            if coupling.point.coupling != "rbe2":
                fitted = coupling.averages.T @ forces[6 * i : 6 * i + 6]
                residual[node[coupling.dofs]] -= fitted.reshape(3, -1, k).swapaxes(0, 1)
        residual[m] = 0.0
        stiffness = element_stiffness(*mesh_and_solid(model), finer.spaces[1], finer.held, node)
        correction = _relax(stiffness, residual.reshape(-1, k), advance).reshape(residual.shape)
    return ReleasedEnergy(residual[:m], correction[:m], finer.elements[:, ~held])


def _relax(matrix: ElementStiffness, loads: Array, advance: Advance) -> Array:
    """Solve approximately by conjugate gradients, then by projection on all columns' solutions, shape (m, k).

    The projection makes the energies a positive semidefinite matrix, which is not above that of a factorisation.
    """
    diagonal = matrix.diagonal()
    pieces = np.array_split(loads, max(1, loads.shape[1] // COLUMNS), axis=1)
    descents = share(partial(_Descent, matrix, 1 / diagonal[:, None]), pieces)
    for _ in range(STEPS):
        share(_Descent.step, descents)
        advance()
    unit, solution, rest = (
        np.hstack([getattr(descent, name) for descent in descents]) for name in ("unit", "solution", "rest")
    )
    gram, found = (np.asarray(solution.T @ forces, dtype=float) for forces in (unit - rest, unit))
    scale = 1 / np.sqrt(np.maximum(np.diag(gram), TINY))
    scaled = scale[:, None] * (0.5 * (gram + gram.T)) * scale
    inverse_gram = np.linalg.pinv(scaled, rcond=DEPENDENT_CORRECTION, hermitian=True)
    size = np.concatenate([descent.size for descent in descents])
    return solution @ (scale[:, None] * inverse_gram @ (scale[:, None] * found)) * size


class _Descent:
    """Conjugate gradients for some columns, in single precision.

    Attributes:
        size: norms of the columns, within the range of single precision, shape (c,)
        unit: the columns, divided by their norms, shape (m, c)
        solution: of these, approximate
        rest: of the columns, what the solution leaves
    """

    def __init__(self, matrix: ElementStiffness, inverse: Array, loads: Array) -> None:
        """Begin with no solution; inverse: of the diagonal, shape (m, 1)."""
        self._matrix, self._inverse = matrix, inverse
        self.size = np.sqrt(np.maximum(np.einsum("i,ij,ij->j", inverse[:, 0], loads, loads), np.finfo(float).tiny))
        self.unit = np.empty(loads.shape, dtype=np.float32)
        np.divide(loads, self.size, out=self.unit, casting="same_kind")
        self.solution, self.rest = np.zeros_like(self.unit), self.unit.copy()
        self._smoothed = np.empty_like(self.unit)
        self._step = inverse * self.unit
        self._square = _products(self.rest, self._step)

    def step(self) -> None:
        """Take one step."""
        pushed = self._matrix @ self._step
        along = self._square / np.maximum(_products(self._step, pushed), TINY)
        self.solution += np.multiply(along, self._step, out=self._smoothed)
        self.rest -= np.multiply(along, pushed, out=pushed)
        np.multiply(self._inverse, self.rest, out=self._smoothed)
        self._square, before = _products(self.rest, self._smoothed), self._square
        self._step *= self._square / np.maximum(before, TINY)
        self._step += self._smoothed


def _products(left: Array, right: Array) -> Array:
    """Return the product of each column with that of the same place, shape (k,)."""
    result: Array = np.einsum("ij,ij->j", left, right)
    return result


def released_stiffness(condensed: Condensation, frequency: Array, modes: Array, *, advance: Advance = silent) -> Array:
    """Estimate the decrease of the reduced stiffness matrix with elements one order higher.

    Args:
        condensed: static condensation of the model
        frequency: frequencies of fixed-interface modes, shape (p,) [Hz]
        modes: fixed-interface modes, shape (n_dofs, p)
        advance: called once per step

    Returns:
        Decrease of the stiffness matrix, positive semidefinite, shape (6 r + p, 6 r + p), coordinates as in
        `ReducedBody`.

    Raises:
        ValueError: for FE models that were not made from a mesh
    """
    static = condensed.constraint_modes
    accelerations = np.hstack([np.zeros_like(static), modes * (2 * np.pi * frequency) ** 2])
    return released_energy(
        condensed, np.hstack([static, modes]), accelerations=accelerations, advance=advance
    ).stiffness
