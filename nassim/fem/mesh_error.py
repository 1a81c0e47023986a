"""Discretisation error: decrease of a reduced body's stiffness with elements one order higher.

This is a hierarchical estimate. For each basis vector, its residual on the finer unknowns gives the energy that these
would release while the coarser unknowns do not move. One factorisation therefore serves all boundary conditions at the
remote points.

Source: R. E. Bank, R. K. Smith, A posteriori error estimates based on hierarchical bases, SIAM J. Numer. Anal. 30
(1993) 921-935.
"""

import numpy as np

from nassim.base.checks import Array
from nassim.base.progress import Advance, silent
from nassim.fem.assembly import refine_order
from nassim.fem.condensation import Condensation, vector_dofs
from nassim.fem.modes import mass_operator
from nassim.fem.solver import factorize, threads


def released_stiffness(condensed: Condensation, frequency: Array, modes: Array, *, advance: Advance = silent) -> Array:
    """Estimate the decrease of the reduced stiffness matrix with elements one order higher.

    Args:
        condensed: static condensation of the model
        frequency: frequencies of fixed-interface modes, shape (p,) [Hz]
        modes: fixed-interface modes, shape (n_dofs, p)
        advance: called once per solve

    Returns:
        Decrease of the stiffness matrix, positive semidefinite, shape (6 r + p, 6 r + p), coordinates as in
        `ReducedBody`.

    Raises:
        ValueError: for FE models that were not made from a mesh
    """
    finer = refine_order(condensed.fe_model)
    couplings = {coupling.point.name: coupling for coupling in finer.couplings}
    n_dofs = finer.stiffness.shape[0]
    with threads():
        inertia = mass_operator(condensed.fe_model) @ modes * (2 * np.pi * frequency) ** 2
        residual = np.hstack([finer.mixed_stiffness @ condensed.constraint_modes, finer.mixed_stiffness @ modes])
        for block, part in zip(np.split(residual, 3), np.split(modes, 3), strict=True):
            block[:, len(condensed.stiffness) :] -= finer.mixed_mass @ part * (2 * np.pi * frequency) ** 2
        # Forces at the remote points that keep the body in each shape.
        forces = np.hstack([condensed.stiffness, -condensed.constraint_modes.T @ inertia])
        held = [finer.held]
        for i, name in enumerate(condensed.names):
            dofs = vector_dofs(couplings[name], n_dofs)
            if couplings[name].point.coupling == "rbe2":
                held.append(dofs)
            else:
                residual[dofs] -= couplings[name].averages.T @ forces[6 * i : 6 * i + 6]
        fixed = np.unique(np.concatenate(held))
        residual[fixed] = 0.0
        released = residual.T @ factorize(finer.stiffness, held=fixed).solve(residual, advance=advance)
    result: Array = 0.5 * (released + released.T)
    return result
