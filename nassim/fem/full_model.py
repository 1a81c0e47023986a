"""Results of the full FE model without reduction, as reference for reductions.

The factorisation of a `Condensation` serves all boundary conditions at remote points. The free motions of the points
contribute the constraint modes times a small dense inverse; the rest is solved with the points fixed.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

from nassim.base.checks import Array, finite_array, positive
from nassim.base.field_types import ArrayLike
from nassim.base.progress import Advance, stage
from nassim.base.short_repr import short_repr
from nassim.bodies.remote_points import coordinate_vector, free_coordinates, point_masses
from nassim.fem.block_lanczos import BlockLanczos
from nassim.fem.condensation import Condensation
from nassim.fem.modes import mass_operator
from nassim.signals.frf import FRF

MECHANISM_TOLERANCE = 1e-10
"""Scaled stiffness eigenvalues below this value belong to motions without strain."""
ROUNDING = 1e-28
"""Share of a vector's mass outside a space that contains it but for rounding."""
DEPENDENT = 1e-14
"""Share of the mass of a block's vectors below which a combination of them is rounding."""


@dataclass(frozen=True)
class FullModel:
    """A full FE model under boundary conditions at its remote points.

    Attributes:
        condensed: its static condensation
        free: indices of the free coordinates of the remote points
        multiply_mass: function from displacements (n_dofs,) to the mass matrix times them, including point masses
        solve: function from forces (n_dofs,) to static displacements, with motions without strain projected out
        mechanisms: motions without strain that the boundary conditions allow, shape (n_dofs, k)
    """

    condensed: Condensation
    free: Array
    multiply_mass: Callable[[Array], Array] = field(repr=False)
    solve: Callable[[Array], Array] = field(repr=False)
    mechanisms: Array = field(repr=False)
    __repr__ = short_repr


def constrain(
    condensed: Condensation,
    *,
    fixed: Collection[str] = (),
    guided: Mapping[str, str] | None = None,
    masses: Mapping[str, float] | None = None,
) -> FullModel:
    """Apply boundary conditions to a full model.

    Args:
        condensed: static condensation of the model
        fixed: remote points that cannot move
        guided: point -> its one free direction ("x", "y", "z", "rx", "ry" or "rz")
        masses: point masses at remote points [kg]
    """
    free = free_coordinates(condensed.names, fixed=fixed, guided=guided)
    modes = condensed.constraint_modes[:, free]
    added = point_masses(condensed.names, masses)
    operator = mass_operator(condensed.fe_model)

    def multiply_mass(u: Array) -> Array:
        return operator @ u + condensed.averages.T @ (added * (condensed.averages @ u).T).T

    stiffness = condensed.stiffness[np.ix_(free, free)]
    size = np.diag(stiffness)
    scale = 1.0 / np.sqrt(np.where(size > 0, size, 1.0))  # zero for the point of a body that has one alone
    eigenvalues, vectors = np.linalg.eigh(scale[:, None] * stiffness * scale)
    stiff = eigenvalues > MECHANISM_TOLERANCE
    # The pseudo-inverse is sufficient, because loads are made orthogonal to the mechanisms first.
    scaled = scale[:, None] * vectors
    flexibility = (scaled[:, stiff] / eigenvalues[stiff]) @ scaled[:, stiff].T
    mechanisms = modes @ scaled[:, ~stiff]
    inertia = np.column_stack([multiply_mass(m) for m in mechanisms.T]) if mechanisms.size else mechanisms
    gain = inertia @ np.linalg.inv(mechanisms.T @ inertia)

    def solve(load: Array) -> Array:
        balanced = load - gain @ (mechanisms.T @ load)
        solution = condensed.solve_fixed(balanced) + modes @ (flexibility @ (modes.T @ balanced))
        return solution - mechanisms @ (gain.T @ solution)

    return FullModel(condensed, free, multiply_mass, solve, mechanisms)


def full_eigenfrequencies(
    condensed: Condensation,
    *,
    fixed: Collection[str] = (),
    guided: Mapping[str, str] | None = None,
    masses: Mapping[str, float] | None = None,
    n: int = 10,
    progress: bool = True,
) -> Array:
    """Compute the lowest eigenfrequencies of the full model, including those of motions without strain (0 Hz).

    Args:
        condensed: static condensation of the model
        fixed: remote points that cannot move
        guided: point -> its one free direction ("x", "y", "z", "rx", "ry" or "rz")
        masses: point masses at remote points [kg]
        n: number of eigenfrequencies
        progress: show the stages and their times

    Returns:
        Frequencies, shape (n,) [Hz].
    """
    model = constrain(condensed, fixed=fixed, guided=guided, masses=masses)
    size = condensed.fe_model.n_dofs
    n_zero = min(model.mechanisms.shape[1], n)
    if n == n_zero:
        return np.zeros(n)
    mass = LinearOperator((size, size), matvec=lambda u: model.multiply_mass(np.ravel(u)), dtype=float)
    with stage("full model's eigenmodes", unit="solves", enabled=progress) as advance:

        def solve(load: Array) -> Array:
            advance()
            return model.solve(np.ravel(load))

        inverse = LinearOperator((size, size), matvec=solve, dtype=float)
        start = model.solve(model.multiply_mass(np.random.default_rng(0).standard_normal(size)))
        eigenvalues = eigsh(mass, k=n - n_zero, M=mass, sigma=0.0, OPinv=inverse, v0=start, return_eigenvectors=False)
    return np.concatenate([np.zeros(n_zero), np.sqrt(np.sort(eigenvalues)) / (2 * np.pi)])


@dataclass(frozen=True)
class HarmonicSolution:
    """FRF of a full model, with its cost and its convergence.

    Attributes:
        frf: the FRF
        change: relative change of the displacements by the last two blocks of vectors, in the mass's norm; largest
            value over frequencies and inputs [-]
        n_solves: number of solves with the factorisation
    """

    frf: FRF
    change: float
    n_solves: int
    __repr__ = short_repr


def full_frequency_response(
    condensed: Condensation,
    frequency: ArrayLike,
    *,
    inputs: Mapping[str, Mapping[str, float]],
    outputs: Mapping[str, Mapping[str, float]],
    damping_ratio: float,
    fixed: Collection[str] = (),
    guided: Mapping[str, str] | None = None,
    masses: Mapping[str, float] | None = None,
    tolerance: float = 1e-8,
    max_solves: int = 200,
    progress: bool = True,
) -> HarmonicSolution:
    """Compute the harmonic response of the full model without modal reduction.

    With A = K^-1 M and u_0 = K^-1 f, the response with the same damping ratio in every mode is
    u = (I - omega^2 A + 2 i zeta omega A^1/2)^-1 u_0, a function of A. One Lanczos basis serves all frequencies and
    inputs. It costs one solve per vector and grows until the displacements have converged at all frequencies.
    Source: N. J. Higham, Functions of Matrices (2008), ch. 13.

    Args:
        condensed: static condensation of the model
        frequency: frequencies, shape (n,) [Hz]
        inputs: name -> forces per unit input at named coordinates, e.g. {"force": {"top.uz": 1.0}}, and voltages at
            electrical ports by their names; all other ports stay at zero voltage
        outputs: name -> weights of named coordinates, and of the charges [C] at ports
        damping_ratio: damping ratio zeta of every mode of the full model [-]
        fixed: remote points that cannot move
        guided: point -> its one free direction ("x", "y", "z", "rx", "ry" or "rz")
        masses: point masses at remote points [kg]
        tolerance: tolerance of the relative change by the last two blocks of a vector per input [-]
        max_solves: largest number of solves per input
        progress: show the stages and their times

    Raises:
        ValueError: if the boundary conditions allow a motion without strain
        RuntimeError: if the response has not converged after `max_solves` solves
    """
    frequency = finite_array("frequency", frequency, (None,))
    positive("tolerance", tolerance)
    model = constrain(condensed, fixed=fixed, guided=guided, masses=masses)
    if model.mechanisms.size:
        raise ValueError("the full model can move freely under these boundary conditions; fix or guide remote points")
    readings = np.array([_row(condensed, weights) for weights in outputs.values()])
    loads = np.column_stack([_row(condensed, weights) for weights in inputs.values()])
    with stage("full model's response", unit="steps", enabled=progress) as advance:
        basis, amplitudes, change = _krylov(model, loads, frequency, damping_ratio, tolerance, max_solves, advance)
    values = np.tensordot(np.hstack([readings @ block for block in basis.vectors[:-1]]), amplitudes, 1)
    for port in condensed.fe_model.ports:
        read, driven = (np.array([weights.get(port.name, 0.0) for weights in of.values()]) for of in (outputs, inputs))
        values += (port.blocked_capacitance * np.outer(read, driven))[..., None]
    frf = FRF(frequency, values, tuple(outputs), tuple(inputs), None, "full FE model")
    return HarmonicSolution(frf, change, basis.n_solves)


def _row(condensed: Condensation, weights: Mapping[str, float]) -> Array:
    """Return weights of named coordinates and electrical ports as a row over all unknowns, shape (n_dofs,)."""
    ports = {port.name: port.forces for port in condensed.fe_model.ports}
    motions = {name: weight for name, weight in weights.items() if name not in ports}
    row: Array = condensed.averages.T @ coordinate_vector(condensed.names, motions)
    return np.sum([row, *(weights[name] * forces for name, forces in ports.items() if name in weights)], axis=0)


def _krylov(
    model: FullModel,
    loads: Array,
    frequency: Array,
    damping_ratio: float,
    tolerance: float,
    max_solves: int,
    advance: Advance,
) -> tuple[BlockLanczos, Array, float]:
    """Compute a Krylov basis, the responses to m loads in its first p vectors, shape (p, m, f), and the last change."""
    basis = BlockLanczos(model.solve, model.multiply_mass, ROUNDING, DEPENDENT)
    start = basis.begin(loads)
    earlier: list[Array] = []
    while len(earlier) < max_solves:
        basis.extend()
        advance()
        earlier.append(_response(basis.projection, start, frequency, damping_ratio))
        if basis.is_complete:  # the response is exact
            return basis, earlier[-1], 0.0
        if len(earlier) > 2:
            change = earlier[-1].copy()
            change[: len(earlier[-3])] -= earlier[-3]
            size = np.maximum(np.linalg.norm(earlier[-1], axis=0), np.finfo(float).tiny)  # no response without a load
            relative = float(np.max(np.linalg.norm(change, axis=0) / size))
            if relative < tolerance:
                return basis, earlier[-1], relative
    raise RuntimeError(
        f"the response has not converged to {tolerance:.0e} after {max_solves} solves; allow more, or lower the "
        "highest frequency"
    )


def _response(projected: Array, start: Array, frequency: Array, damping_ratio: float) -> Array:
    """Return (I - omega^2 T + 2 i zeta omega T^1/2)^-1 times the first columns, shape (p, m, n_frequencies).

    start: the columns in the first vectors of the basis, zero in all others, shape (q, m)
    """
    squares, vectors = np.linalg.eigh(projected)
    period = 2 * np.pi * frequency * np.sqrt(np.maximum(squares, 0.0))[:, None]
    loaded = vectors[: len(start)].T @ start
    return np.tensordot(vectors, loaded[..., None] / (1 - period**2 + 2j * damping_ratio * period)[:, None], 1)
