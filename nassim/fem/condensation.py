"""Static condensation of an FE model to its remote points, with one factorisation.

A displacement is the sum of two parts, which are orthogonal in the strain energy: the static response to the motion q
of the remote points, and a part w in which the remote points do not move:

    u = Psi q + w,   W w = 0,   Psi^T K w = 0

The rows of W read q. With this split, the responses of the full model under any boundary conditions at the remote
points need one factorisation and small dense matrices only. The couplings differ in how Psi and w are computed:

- rbe2 (stiff interface): the unknowns of the interface are prescribed, and Psi solves for the other unknowns.
- rbe3 (mean motion of a soft interface): the forces l at the remote points are multipliers of W u = q. Without an rbe2
  coupling the stiffness is singular. Then six unknowns are fixed, just enough to prevent rigid motion. Inertia forces
  balance the load before each solve, so the fixed unknowns carry no force, and any rigid motion Z may be added to the
  solution.
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np
import scipy
import scipy.sparse as sp
from numpy.typing import NDArray

from nassim.base.checks import Array, unique
from nassim.base.progress import Advance, silent, stage
from nassim.base.rigid_motion import rigid_transfer
from nassim.base.short_repr import short_repr
from nassim.fem.fe_model import Coupling, FEModel, rigid_fields
from nassim.fem.native_threads import blas_threads
from nassim.fem.solver import Factorization, factorize, solver_name

DEPENDENT_MOTION = 1e-9
"""Share of a remote point's squared motion that is independent of other points, below which it follows from theirs."""


@dataclass(frozen=True)
class Condensation:
    """Static behaviour of an FE model in terms of r remote points.

    Attributes:
        fe_model: the FE model
        couplings: couplings of the remote points, in order
        constraint_modes: displacements Psi for unit motions of the remote points, shape (n_dofs, 6 r)
        stiffness: forces at the remote points for unit motions of these points, shape (6 r, 6 r)
        averages: rows W that read the motions of the remote points, sparse, shape (6 r, n_dofs)
    """

    fe_model: FEModel
    _: KW_ONLY
    couplings: tuple[Coupling, ...]
    constraint_modes: Array
    stiffness: Array
    averages: sp.csr_matrix
    _grounded: "_Grounded"
    _soft_averages: sp.csr_matrix  # rows of W for rbe3 points
    _soft_flexibility: Array  # X = G W_soft^T
    _border: Array  # inverse of [[W X, W Z], [Z^T W^T, 0]]
    _modes: tuple[Array, Array] | None = None  # known fixed-interface modes
    __repr__ = short_repr

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the remote points, in order."""
        return tuple(c.point.name for c in self.couplings)

    @property
    def solved_at_once(self) -> int:
        """Number of right-hand sides that the solver solves at once."""
        return self._grounded.factorization.block

    def solve_fixed(self, load: Array, *, advance: Advance = silent) -> Array:
        """Compute displacements under a load with all remote points fixed.

        Args:
            load: forces, shape (n_dofs,) or (n_dofs, k) [N]
            advance: called with the number of columns done

        Returns:
            Displacements, in the shape of `load` [m].
        """
        solution = self._grounded.solve(load, advance=advance)
        if not self._border.size:
            return solution  # without rbe3 points, their unknowns are fixed
        motions = self._grounded.motions
        forces = self._border @ np.concatenate([self._soft_averages @ solution, motions.T @ load])
        n_soft = self._soft_averages.shape[0]
        solution -= self._soft_flexibility @ forces[:n_soft]
        solution -= motions @ forces[n_soft:]
        return solution


@dataclass(frozen=True)
class _Grounded:
    """Solver for K u = load with some unknowns fixed.

    If motions Z remain possible, inertia forces balance the load, and u is made orthogonal to Z in the mass's inner
    product. The inverse is then symmetric and independent of the choice of the fixed unknowns.
    """

    factorization: Factorization
    motions: Array
    inertia_forces: Array  # M Z (Z^T M Z)^-1

    def solve(self, load: Array, *, advance: Advance = silent) -> Array:
        """Return the displacements under a load, shape (n_dofs, k)."""
        if not self.motions.size:
            return self.factorization.solve(load, advance=advance)
        balanced = self.inertia_forces @ (self.motions.T @ load)
        np.subtract(load, balanced, out=balanced)
        solution = self.factorization.solve(balanced, advance=advance)
        solution -= self.motions @ (self.inertia_forces.T @ solution)
        return solution


def condense(fe_model: FEModel, *, remote_points: Sequence[str] | None = None, progress: bool = True) -> Condensation:
    """Factorise the stiffness once and compute the constraint modes of the remote points.

    Args:
        fe_model: the FE model
        remote_points: names (default: all remote points of the model, in its order)
        progress: show the stages and their times

    Raises:
        ValueError: for unknown names, for no remote points, for rbe2 interfaces that share nodes, and for rbe3
            interfaces with too few nodes of their own to move independently
    """
    if remote_points is None and (known := _existing(fe_model)) is not None:
        return known
    names = [p.name for p in fe_model.remote_points] if remote_points is None else list(remote_points)
    if not unique("remote point", names):
        raise ValueError(f"FE model {fe_model.name!r} has no remote points: give its Solid at least one RemotePoint")
    couplings = tuple(fe_model.coupling(name) for name in names)
    stiff = np.repeat([c.point.coupling == "rbe2" for c in couplings], 6)
    held, prescribed = _prescribed_motions(fe_model, couplings)
    averages = sp.vstack([_average_rows(c, fe_model.n_dofs) for c in couplings], format="csr")
    _refuse_dependent(couplings, averages, held)
    with stage(f"factorise ({solver_name()})", enabled=progress):
        grounded = _ground(fe_model, held)
    soft_averages = averages[~stiff]
    n_solves = len(stiff) - 6 if stiff.any() else len(stiff)
    shared = blas_threads(fe_model.n_dofs * len(stiff) ** 2)
    with stage("static modes", total=n_solves, unit="solves", enabled=progress) as advance, shared:
        lift = np.zeros((fe_model.n_dofs, len(stiff)))
        if stiff.any():
            reaction = fe_model.stiffness.times_rows(held, prescribed[held, 6:])
            reaction[held] = 0.0
            others = prescribed[:, 6:] - grounded.solve(reaction, advance=advance)
            lift[:, stiff] = np.hstack([_motions_of_first(fe_model, couplings, others), others])
        flexibility = grounded.solve(soft_averages.T.toarray(), advance=advance)
        border = _border_inverse(soft_averages @ flexibility, soft_averages @ grounded.motions)
        # Difference of the rbe3 points' motions when only the rbe2 points move, and the forces that remove it.
        lacking = np.eye(len(stiff))[~stiff] - soft_averages @ lift
        n_soft = len(lacking)
        forces = border[:, :n_soft] @ lacking
        constraint_modes = flexibility @ forces[:n_soft]
        constraint_modes += grounded.motions @ forces[n_soft:]
        constraint_modes += lift
        stiffness = lacking.T @ forces[:n_soft]
        if stiff.any():
            stiffness += fe_model.stiffness.between(lift)
        keep = deformation_projector([c.point.position for c in couplings])
        stiffness = keep.T @ stiffness @ keep
    return Condensation(
        fe_model,
        couplings=couplings,
        constraint_modes=constraint_modes,
        stiffness=0.5 * (stiffness + stiffness.T),
        averages=averages,
        _grounded=grounded,
        _soft_averages=soft_averages,
        _soft_flexibility=flexibility,
        _border=border,
    )


def _existing(fe_model: FEModel) -> Condensation | None:
    """Return the condensation that was made with the model, unless its matrices or its remote points were replaced."""
    known: Condensation | None = fe_model._condensation
    if known is None or any(
        getattr(known.fe_model, name) is not getattr(fe_model, name)
        for name in ("stiffness", "scalar_mass_matrix", "fields", "couplings")
    ):
        return None
    return replace(known, fe_model=fe_model)


def vector_dofs(coupling: Coupling, n_dofs: int) -> NDArray[np.int64]:
    """Return the unknowns x..., y..., z... of a coupling's interface among all n_dofs unknowns, shape (3 m,)."""
    return np.concatenate([coupling.dofs + k * (n_dofs // 3) for k in range(3)])


def _average_rows(coupling: Coupling, n_dofs: int) -> sp.csr_matrix:
    """Return the rows of W of a coupling, sparse, shape (6, n_dofs)."""
    columns = vector_dofs(coupling, n_dofs)
    rows = np.repeat(np.arange(6), len(columns))
    return sp.csr_matrix((coupling.averages.ravel(), (rows, np.tile(columns, 6))), shape=(6, n_dofs))


def _prescribed_motions(fe_model: FEModel, couplings: Sequence[Coupling]) -> tuple[NDArray[np.int64], Array]:
    """Return the unknowns on rbe2 interfaces and their displacements for unit motions of the points (n_dofs, 6 r2)."""
    stiff = [c for c in couplings if c.point.coupling == "rbe2"]
    prescribed = np.zeros((fe_model.n_dofs, 6 * len(stiff)))
    owner: dict[int, str] = {}
    for i, coupling in enumerate(stiff):
        for dof in coupling.dofs.tolist():
            if dof in owner:
                raise ValueError(
                    f"the interfaces of remote points {owner[dof]!r} and {coupling.point.name!r} share nodes; rbe2 "
                    "moves each as a rigid body, so they must not touch: use rbe3 or separate the faces"
                )
            owner[dof] = coupling.point.name
        prescribed[vector_dofs(coupling, fe_model.n_dofs), 6 * i : 6 * i + 6] = coupling.motions
    scalar = np.array(sorted(owner), dtype=np.int64)
    return np.concatenate([scalar + k * (fe_model.n_dofs // 3) for k in range(3)]), prescribed


def _refuse_dependent(couplings: Sequence[Coupling], averages: sp.csr_matrix, held: NDArray[np.int64]) -> None:
    """Raise ValueError for rbe3 points whose motions follow from those of other points, as on small adjacent faces."""
    soft = [i for i, c in enumerate(couplings) if c.point.coupling == "rbe3"]
    if not soft:
        return
    free = np.ones(averages.shape[1])
    free[held] = 0.0
    rows = []
    for i in soft:
        own = averages[6 * i : 6 * i + 6]
        # The rows are orthonormal on the whole interface, so their part on free unknowns has a norm of at most 1.
        factor = np.linalg.cholesky((own @ own.T).toarray())
        rows.append(sp.csr_matrix(np.linalg.inv(factor)) @ own.multiply(free))
    readings = sp.vstack(rows, format="csr")
    independent, directions = np.linalg.eigh((readings @ readings.T).toarray())
    if independent[0] < DEPENDENT_MOTION:
        share = np.sum(directions[:, 0].reshape(-1, 6) ** 2, axis=1)
        tied = [couplings[i].point.name for i, s in zip(soft, share, strict=True) if s > DEPENDENT_MOTION]
        raise ValueError(
            f"rbe3 remote points that cannot move by themselves: {', '.join(map(repr, tied))}; too few nodes of their "
            "interfaces belong to them alone and not to another remote point; make the elements there smaller "
            "(local_sizes), raise the order, or separate the faces"
        )


def _motions_of_first(fe_model: FEModel, couplings: Sequence[Coupling], others: Array) -> Array:
    """Return displacements for the first rbe2 point that complete the others to rigid motions of the body."""
    positions = [c.point.position for c in couplings if c.point.coupling == "rbe2"]
    result = rigid_fields(fe_model.fields, positions[0])
    for i, position in enumerate(positions[1:]):
        result = result - others[:, 6 * i : 6 * i + 6] @ rigid_transfer(position - positions[0])
    return result


def _ground(fe_model: FEModel, held: NDArray[np.int64]) -> _Grounded:
    """Factorise the stiffness with the unknowns `held`, or with six that prevent rigid motion if there are none."""
    if held.size:
        nothing = np.zeros((fe_model.n_dofs, 0))
        return _Grounded(factorize(fe_model.stiffness, held=held), nothing, nothing)
    motions = fe_model.rigid_motions()
    inertia = np.vstack([fe_model.scalar_mass_matrix @ block for block in np.split(motions, 3)])
    # Pivoted QR finds six unknowns that prevent rigid motion with a good condition.
    _, _, order = scipy.linalg.qr(motions.T, mode="economic", pivoting=True)
    factorization = factorize(fe_model.stiffness, held=np.sort(order[:6]))
    return _Grounded(factorization, motions, inertia @ np.linalg.inv(motions.T @ inertia))


def deformation_projector(positions: Sequence[Array]) -> Array:
    """Return the projection that removes a common rigid motion from motions of points at `positions`, shape (6 r, 6 r).

    Curved prisms have a small strain energy in rigid motions. The projection removes it from forces and stiffnesses.

    Args:
        positions: positions of the points, shape (r, 3) [m]
    """
    motions = np.vstack([rigid_transfer(position - positions[0]) for position in positions])
    extent = max(float(np.ptp(positions, axis=0).max()), np.finfo(float).eps)
    scale = np.tile(np.repeat([1.0, extent], 3), len(positions))  # rotations times this length are in metres
    basis = np.linalg.qr(scale[:, None] * motions)[0]
    keep = np.eye(len(scale)) - basis @ basis.T
    return keep * scale / scale[:, None]


def _border_inverse(flexibility: Array, motions: Array) -> Array:
    """Return the inverse of [[S, B], [B^T, 0]], scaled because S is in m/N and rad/Nm and B in m and rad."""
    n, m = motions.shape
    if n == 0:
        return np.zeros((0, 0))
    rows = 1.0 / np.sqrt(np.diag(flexibility))
    columns = 1.0 / np.linalg.norm(rows[:, None] * motions, axis=0)
    scale = np.concatenate([rows, columns])
    matrix = np.block([[0.5 * (flexibility + flexibility.T), motions], [motions.T, np.zeros((m, m))]])
    return scale[:, None] * np.linalg.inv(scale[:, None] * matrix * scale) * scale
