"""Conversion of superelements to bodies for scenes: repair of rounding errors, refusal of faults."""

from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.progress import tell
from nassim.base.short_repr import short_repr
from nassim.bodies.inertia import elastic_basis, estimate_gram
from nassim.bodies.reduced_body import ReducedBody
from nassim.bodies.remote_points import RemotePoint
from nassim.exchange.inspection import Report, as_superelement, check, signed_frequencies
from nassim.exchange.row_order import rigid_residual
from nassim.exchange.superelements import Superelement

RESIDUAL_ROUNDING = 1e-12
"""Residual of rigid-body motions below which no projection is needed."""
SINGLE_NODE = 0.01
"""Residual of all other rows, relative to that of one node's rows, below which only that node's rows are damaged."""
REPAIRABLE = 1e-2
"""Negative eigenvalues above this fraction of the positive ones are not rounding and are not repaired."""
CONFIRMED_BY = {
    "units": "; read it in its own units, or confirm by any_size=True",
    "row order": "; correct the file or what reads it, or confirm by any_coordinates=True",
}
"""Cures of the faults that `to_body` accepts on request."""
SHOWN = 10
"""Number of elastic frequencies in the text of a repair, in addition to the one with the largest change."""

Body = TypeVar("Body", ReducedBody, Superelement)


@dataclass(frozen=True)
class Repair(Generic[Body]):
    """Result of `repair`.

    Attributes:
        body: the repaired body, of the given type.
        steps: descriptions of the steps, in order.
        before: report of `check` before the repair.
        after: report of `check` after the repair.
        elastic_before: frequencies other than the six lowest before the repair, negative where unstable [Hz].
        elastic_after: the same after the repair [Hz].
    """

    body: Body
    steps: tuple[str, ...]
    before: Report
    after: Report
    elastic_before: Array = field(repr=False)
    elastic_after: Array = field(repr=False)
    __repr__ = short_repr

    @property
    def elastic_shift(self) -> Array:
        """Relative change of each elastic frequency [-]."""
        return self.elastic_after / self.elastic_before - 1

    def __str__(self) -> str:
        lines = [f"{self.before.name}: {len(self.steps)} repair(s), {self.before.verdict} -> {self.after.verdict}"]
        lines += [f"  {step}" for step in self.steps]
        for name, key, unit in (
            ("rigid motions", "highest_Hz", "Hz, highest of six rigid motions"),
            ("rigid motions", "residual", "K R over its terms"),
            ("mass", "kg", "kg, mass"),
        ):
            old, new = (_figure(report, name, key) for report in (self.before, self.after))
            lines.append(f"  {old:12.6g} -> {new:12.6g}  {unit}")
        shift: Array = self.elastic_shift
        n: int = len(shift)
        shown = list(range(min(n, SHOWN)))
        if n and (largest := int(np.argmax(np.abs(shift)))) >= SHOWN:
            shown.append(largest)
        for k in shown:
            where = "" if k < SHOWN else f", number {k + 1} of {n}: the largest change"
            figures = f"{self.elastic_before[k]:12.6g} -> {self.elastic_after[k]:12.6g}"
            lines.append(f"  {figures}  Hz, elastic ({100 * shift[k]:+.2g} %{where})")
        if n > len(shown):
            lines.append(f"  and {n - len(shown)} more elastic ones, which moved less")
        return "\n".join(lines)


def repair(body: Body) -> Repair[Body]:
    """Repair the effects of rounding and truncation on reduced matrices, and print the change of each figure.

    The repair symmetrises K and M. It raises eigenvalues of M that rounding made negative. It removes the stiffness of
    K against rigid-body motions, K' = P^T K P with P = I - R A and A R = I, so that K' R = 0. It changes the sign of
    elastic eigenvalues that rounding made negative. Every A preserves the true part of K. A = (R^T M R)^-1 R^T M
    averages the error over the body. Where only the rows of one node contain the error, an A from the motion of that
    node removes the error completely: the rows of the node then follow from the others by equilibrium.

    Args:
        body: reduced body or superelement.

    Returns:
        `Repair` with a body of the given type.

    Raises:
        ValueError: for errors other than rounding: rows in another order, a matrix that is far from definite, a mass
            that is not that of a body.
    """
    given = as_superelement(body)
    before = check(given)
    wrong = [finding for finding in before.faults if finding.name in ("row order", "mass", "inertia")]
    if wrong:
        raise ValueError(f"{given.source}: cannot be repaired: {wrong[0].name}: {wrong[0].text}")
    steps: list[str] = []
    stiffness = _symmetric(given.stiffness_matrix, "K", steps)
    mass = _positive_mass(_symmetric(given.mass_matrix, "M", steps), given.source, steps)
    motions = given.rigid_motions
    old = signed_frequencies(stiffness, mass)
    if rigid_residual(stiffness, motions).max() > RESIDUAL_ROUNDING:
        stiffness = _without_rigid_stiffness(stiffness, mass, given, steps)
    stiffness = _positive_stiffness(stiffness, mass, given, steps)
    mended: Body = _with_matrices(body, stiffness, mass)
    new = signed_frequencies(stiffness, mass)
    report = Repair(
        mended,
        steps=tuple(steps),
        before=before,
        after=check(mended),
        elastic_before=np.sort(old[6:]),
        elastic_after=np.sort(new[6:]),
    )
    tell(str(report), indent="")
    return report


def to_body(body: Superelement, *, any_size: bool = False, any_coordinates: bool = False) -> ReducedBody:
    """Convert a superelement to a body for scenes.

    Mass, centre of mass, inertia and response in small motion are those of the matrices. Large motion needs integrals
    that matrices do not contain; `nassim.bodies.inertia` describes their estimate. The body has no surface for
    pictures.

    Args:
        body: the superelement.
        any_size: accept a mass, size, wave speed, density or stiffness that no body in a machine has. The usual cause
            is wrong units.
        any_coordinates: accept rows and node coordinates that do not fit each other (the finding "row order").

    Returns:
        Reduced body with symmetric matrices and without a surface.

    Raises:
        ValueError: naming the source and all faults that `check` finds.
    """
    report = check(body)
    confirmed = {"units": any_size, "row order": any_coordinates}
    faults = [finding for finding in report.faults if not confirmed.get(finding.name)]
    if faults:
        found = "; ".join(f"{finding.name}: {finding.text}{CONFIRMED_BY.get(finding.name, '')}" for finding in faults)
        raise ValueError(f"{body.source}: not fit for use: {found}")
    mass = 0.5 * (body.mass_matrix + body.mass_matrix.T)
    return ReducedBody(
        body.name,
        remote_points=tuple(
            RemotePoint(name, (), position) for name, position in zip(body.names, body.positions, strict=True)
        ),
        mass_matrix=mass,
        stiffness_matrix=0.5 * (body.stiffness_matrix + body.stiffness_matrix.T),
        gram=estimate_gram(mass, body.positions),
        record={"imported from": body.source, "units": body.units, "inspection": str(report)},
        full_integrals=False,
    )


def _with_matrices(body: ReducedBody | Superelement, stiffness: Array, mass: Array) -> Any:
    changed = replace(body, stiffness_matrix=stiffness, mass_matrix=mass)
    if isinstance(changed, Superelement) or np.array_equal(mass, body.mass_matrix):
        return changed
    gram = estimate_gram(mass, as_superelement(changed).positions)
    return replace(changed, gram=gram, full_integrals=False)


def _figure(report: Report, name: str, key: str) -> float:
    figures = {finding.name: finding.figures for finding in report.findings}
    return figures.get(name, {}).get(key, np.nan)


def _symmetric(matrix: Array, letter: str, steps: list[str]) -> Array:
    result: Array = 0.5 * (matrix + matrix.T)
    moved = np.abs(result - matrix).max()
    if moved:
        steps.append(
            f"{letter} made symmetric: entries moved by up to {moved / np.abs(matrix).max():.1e} of its largest"
        )
    return result


def _positive_mass(mass: Array, source: str, steps: list[str]) -> Array:
    diagonal = np.diag(mass)
    if np.any(diagonal <= 0):
        raise ValueError(f"{source}: cannot be repaired: the diagonal of M holds {diagonal.min():.3g}")
    scale = np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(mass / np.outer(scale, scale))
    floor = 1e-12 * len(mass)
    if values[0] > floor:
        return mass
    if values[0] < -REPAIRABLE:
        raise ValueError(
            f"{source}: cannot be repaired: M has the eigenvalue {values[0]:.2g} (unit diagonal), which is no rounding"
        )
    raised = np.maximum(values, max(10 * floor, -float(values[0])))
    steps.append(
        f"M made positive definite: {int(np.sum(raised > values))} eigenvalue(s) (unit diagonal) from "
        f"{values[0]:.1e} up to {raised[0]:.1e}"
    )
    result: Array = scale[:, None] * ((vectors * raised) @ vectors.T) * scale
    return 0.5 * (result + result.T)


def _without_rigid_stiffness(stiffness: Array, mass: Array, body: Superelement, steps: list[str]) -> Array:
    motions = body.rigid_motions
    damaged = _damaged_node(stiffness, body)
    if damaged is None:
        weighted = motions.T @ mass
        content = np.linalg.solve(weighted @ motions, weighted)
        how = "averaged over the body's mass"
    else:
        rows = slice(6 * damaged, 6 * damaged + 6)
        content = np.zeros((6, len(mass)))
        content[:, rows] = np.linalg.inv(motions[rows])
        how = f"all of it in the rows of {body.names[damaged]}, which now follow from the others by equilibrium"
    keep = np.eye(len(mass)) - motions @ content
    result = keep.T @ stiffness @ keep
    moved = np.abs(result - stiffness).max() / np.abs(stiffness).max()
    steps.append(
        f"stiffness against rigid motions projected out of K, {how}: entries moved by up to {moved:.1e} of the largest"
    )
    return 0.5 * (result + result.T)


def _damaged_node(stiffness: Array, body: Superelement) -> int | None:
    """Return the only node whose rows contain nearly all of the erroneous forces K R; None if there is none."""
    if len(body.positions) < 2:
        return None
    scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(stiffness)), 1e-12 * np.abs(stiffness).max()))
    force = scale[:, None] * (stiffness @ body.rigid_motions)
    force = force / np.linalg.norm(body.rigid_motions / scale[:, None], axis=0)
    rows = np.linalg.norm(force, axis=1)
    by_node = np.linalg.norm(rows[: 6 * len(body.positions)].reshape(-1, 6), axis=1)
    worst = int(np.argmax(by_node))
    others = np.sqrt(max(float(rows @ rows - by_node[worst] ** 2), 0.0))
    return worst if others < SINGLE_NODE * by_node[worst] else None


def _positive_stiffness(stiffness: Array, mass: Array, body: Superelement, steps: list[str]) -> Array:
    basis = elastic_basis(mass, body.rigid_motions)
    if not basis.shape[1]:
        return stiffness
    squares, vectors = scipy.linalg.eigh(basis.T @ stiffness @ basis, basis.T @ mass @ basis)
    unstable = squares <= 0
    if not unstable.any():
        return stiffness
    if unstable.all() or -squares[0] > REPAIRABLE * squares[~unstable][0]:
        frequency = np.sqrt(-squares[0]) / (2 * np.pi)
        raise ValueError(
            f"{body.source}: cannot be repaired: K has negative stiffness in elastic motion (-{frequency:.4g} Hz), "
            "which is no rounding"
        )
    shapes = mass @ basis @ vectors[:, unstable]
    steps.append(f"{int(unstable.sum())} elastic eigenvalue(s) of K made positive, of the same size")
    result: Array = stiffness - 2 * (shapes * squares[unstable]) @ shapes.T
    return 0.5 * (result + result.T)
