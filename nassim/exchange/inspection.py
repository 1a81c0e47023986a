"""Inspection of reduced bodies: physical properties of their matrices, with a verdict for each."""

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from itertools import combinations

import numpy as np
import scipy

from nassim.base.checks import Array, freeze, known
from nassim.base.progress import wrap_text
from nassim.base.short_repr import short_repr
from nassim.bodies.inertia import RigidInertia, elastic_basis, rigid_inertia
from nassim.bodies.reduced_body import ReducedBody
from nassim.exchange.node_positions import (
    explain_misfit,
    from_degrees,
    motions_without_stiffness,
    other_units,
    positions_from_motions,
)
from nassim.exchange.row_order import FITS, guess_order, order_misfit, rigid_residual
from nassim.exchange.superelements import Superelement
from nassim.exchange.unit_systems import PhysicalProperties, likely_units, relative_stiffness, sort_by_likelihood

VERDICTS = ("ok", "warning", "fault")
RANGE_FACTOR = 1.5
"""A body is valid up to the highest retained fixed-interface frequency divided by this factor: the usual rule."""
SPIN_LIMIT = 1 / 30
"""Angular velocity over the lowest elastic frequency above which unknown integrals matter: `nassim.bodies.inertia`."""
NO_INERTIA = 1e-30
"""Fraction of the largest entry of M; a diagonal entry below it is a motion without inertia."""


@dataclass(frozen=True)
class Finding:
    """One line of a report.

    Attributes:
        name: the property that was inspected.
        verdict: "ok", "warning" (usable, but could be better) or "fault" (wrong).
        text: description.
        figures: numbers by name, with their units in the names.
    """

    name: str
    verdict: str
    text: str
    figures: Mapping[str, float] = field(default_factory=dict)
    __repr__ = short_repr

    def __post_init__(self) -> None:
        known("verdict", self.verdict, VERDICTS)
        freeze(self, figures={key: float(value) for key, value in self.figures.items()})


@dataclass(frozen=True)
class Report:
    """Findings of `check` on one body; `str` of it is a table.

    Attributes:
        name: name of the body.
        findings: the findings in order.
    """

    name: str
    findings: tuple[Finding, ...]
    __repr__ = short_repr

    @property
    def verdict(self) -> str:
        """The worst verdict of all findings."""
        return max((finding.verdict for finding in self.findings), key=VERDICTS.index)

    @property
    def faults(self) -> tuple[Finding, ...]:
        """The findings that are faults."""
        return tuple(finding for finding in self.findings if finding.verdict == "fault")

    def __getitem__(self, name: str) -> Finding:
        """Return a finding by name; raise ValueError with the list of names for an unknown one."""
        names = [finding.name for finding in self.findings]
        return self.findings[names.index(known("finding", name, names))]

    def __str__(self) -> str:
        lines = [f"{self.name}: {self.verdict}"]
        for finding in self.findings:
            lines.append(
                wrap_text(finding.text, indent=f"  {finding.verdict:8}{finding.name:22}", next_indent=32 * " ")
            )
        return "\n".join(lines)


@dataclass(frozen=True)
class _Numbers:
    """Common quantities of findings: symmetric matrices, rigid-body motions, frequencies signed like their squares."""

    body: Superelement
    _: KW_ONLY
    stiffness: Array
    mass: Array
    motions: Array
    rigid: RigidInertia
    frequency: Array  # ascending by magnitude
    elastic: Array  # of the elastic motions

    @property
    def first(self) -> float:
        """Lowest elastic frequency [Hz]; infinite for a body without elastic motion."""
        return float(np.min(np.abs(self.elastic), initial=np.inf))


def check(body: ReducedBody | Superelement) -> Report:
    """Inspect a reduced body, imported or not.

    `to_body` refuses a body with a finding of the verdict "fault".

    Args:
        body: reduced body or superelement.

    Returns:
        Report with a verdict for each property.

    Raises:
        ValueError: only for a body without remote points.
    """
    given = as_superelement(body)
    stiffness, mass = _symmetric_parts(given)
    findings, numbers = [symmetry(given), _digits(given), _definite_mass(given, mass)], None
    if findings[-1].verdict != "fault":
        try:
            numbers = _numbers(given, stiffness, mass)
        except np.linalg.LinAlgError:
            findings.append(Finding("rigid motions", "fault", "the eigenvalue problem of K and M has no solution"))
            return Report(given.name, tuple(findings))
        findings += [line(numbers) for line in _LINES]
    if isinstance(body, Superelement) or not body.full_integrals:
        findings.append(_large_motion(numbers))
    return Report(given.name, tuple(findings))


def as_superelement(body: ReducedBody | Superelement) -> Superelement:
    """Return the matrices, positions and names of a reduced body as a superelement.

    Args:
        body: reduced body; a superelement is returned unchanged.
    """
    if isinstance(body, Superelement):
        return body
    return Superelement(
        body.name,
        stiffness_matrix=body.stiffness_matrix,
        mass_matrix=body.mass_matrix,
        positions=body.positions,
        names=body.point_names,
        source=f"body {body.name!r}",
    )


def signed_frequencies(stiffness: Array, mass: Array) -> Array:
    """Return eigenfrequencies [Hz], ascending by magnitude; a negative one stands for a negative square (unstable).

    Args:
        stiffness: symmetric, (n, n).
        mass: symmetric with a positive diagonal, (n, n).
    """
    scale = 1.0 / np.sqrt(np.diag(mass))
    squares = scipy.linalg.eigvalsh(scale[:, None] * stiffness * scale, scale[:, None] * mass * scale)
    squares = squares[np.argsort(np.abs(squares))]
    return np.sign(squares) * np.sqrt(np.abs(squares)) / (2 * np.pi)


def _symmetric_parts(body: Superelement) -> tuple[Array, Array]:
    stiffness, mass = body.stiffness_matrix, body.mass_matrix
    return 0.5 * (stiffness + stiffness.T), 0.5 * (mass + mass.T)


def _numbers(body: Superelement, stiffness: Array, mass: Array) -> _Numbers:
    motions = body.rigid_motions
    basis = elastic_basis(mass, motions)
    elastic = np.zeros(0)
    if basis.shape[1]:
        elastic = signed_frequencies(basis.T @ stiffness @ basis, basis.T @ mass @ basis)
    rigid = rigid_inertia(mass, motions)
    return _Numbers(
        body,
        stiffness=stiffness,
        mass=mass,
        motions=motions,
        rigid=rigid,
        frequency=signed_frequencies(stiffness, mass),
        elastic=elastic,
    )


def symmetry(body: Superelement) -> Finding:
    """Compare K and M with their transposes."""
    worst = {}
    for letter, matrix in (("K", body.stiffness_matrix), ("M", body.mass_matrix)):
        worst[letter] = float(np.abs(matrix - matrix.T).max() / max(np.abs(matrix).max(), 1e-300))
    verdict = "ok" if max(worst.values()) <= 1e-12 else "warning" if max(worst.values()) <= 1e-9 else "fault"
    text = f"largest |A - A^T| over largest |A|: {worst['K']:.1e} in K, {worst['M']:.1e} in M"
    if verdict == "fault":
        text += "; a reduced body needs symmetric ones: repair, or look for a damaged entry"
    return Finding("symmetry", verdict, text, {"K": worst["K"], "M": worst["M"]})


def _digits(body: Superelement) -> Finding:
    few = body.digits <= 8
    text = f"{body.digits} significant digits" + (": went through a text listing" if few else "")
    return Finding("digits", "warning" if few else "ok", text, {"digits": body.digits})


def _definite_mass(body: Superelement, mass: Array) -> Finding:
    diagonal = np.diag(mass)
    if np.any(diagonal <= NO_INERTIA * np.abs(mass).max()):
        row = int(np.argmin(diagonal))
        text = (
            f"the diagonal of M holds {diagonal[row]:.3g} in row {row + 1}: a motion without inertia, or no mass matrix"
        )
        return Finding("mass matrix", "fault", text)
    scale = 1.0 / np.sqrt(diagonal)
    least = float(np.linalg.eigvalsh(scale[:, None] * mass * scale)[0])
    bad = least <= 1e-13 * len(mass)
    text = f"{'not ' if bad else ''}positive definite; least eigenvalue {least:.2e} for unit diagonal"
    return Finding("mass matrix", "fault" if bad else "ok", text, {"least_eigenvalue": least})


def _rigid_motions(n: _Numbers) -> Finding:
    residual = float(rigid_residual(n.stiffness, n.motions).max())
    six = n.frequency[:6]
    share = float(np.abs(six).max() / max(n.first, 1e-100))
    verdict = "ok" if share <= 1e-2 else "warning" if share <= 0.1 else "fault"
    text = (
        f"K R is {residual:.1e} of its terms; the six get {' '.join(f'{f:.3g}' for f in np.sort(six))} Hz "
        f"(first elastic: {n.first:.5g} Hz; negative: unstable)"
    )
    if verdict != "ok":
        text += "; repair projects this out"
    figures = {"residual": residual, "highest_Hz": np.abs(six).max(), "first_elastic_Hz": n.first}
    return Finding("rigid motions", verdict, text, figures)


def _row_order(n: _Numbers) -> Finding:
    misfit, free = order_misfit(n.body), motions_without_stiffness(n.stiffness, n.mass)
    derived = None if free is None else positions_from_motions(free, len(n.body.positions))
    away = "" if derived is None else explain_misfit(n.body, derived, _size(n))
    figures = {"misfit": misfit}
    if misfit <= FITS and not away:
        return Finding("row order", "ok", "per node ux uy uz rx ry rz, as given", figures)
    units = other_units(n.body, misfit)
    if units:
        return Finding("row order", "fault", f"the order is right, but {units[0]}", figures | units[1])
    guess = guess_order(n.body)
    if guess is not None:
        text = f"wrong (misfit {misfit:.2g}); the rows fit when read as: {guess.text} (misfit {guess.misfit:.1e})"
        if guess.alternatives:
            text += f"; {guess.alternatives} other order(s) fit as well"
        return Finding("row order", "fault", text, figures | {"guess_misfit": guess.misfit})
    if away:
        return Finding("row order", "fault", f"misfit of rigid motions {misfit:.2g}: {away}", figures)
    text = f"misfit of rigid motions {misfit:.2g}, and no other order of rows fits better"
    if free is not None and derived is None:
        text += (
            ", though K resists no six motions: rows of other nodes, or along other axes than the body's (orientations)"
        )
        return Finding("row order", "fault", text, figures)
    text += ": errors in the numbers"
    if n.body.units[:2] != "m-":
        text += '; or another order, found only when the file is read in units "m-..."'
    return Finding("row order", "warning", text, figures)


def _mass(n: _Numbers) -> Finding:
    wrong = n.rigid.mass <= 0 or n.rigid.misfit > 10 * FITS
    text = f"{n.rigid.mass:.6g} kg"
    if wrong:
        text += f"; but R^T M R is no rigid body's (misfit {n.rigid.misfit:.2g}): wrong rows, units or coordinates"
    return Finding("mass", "fault" if wrong else "ok", text, {"kg": n.rigid.mass, "misfit": n.rigid.misfit})


def _centre_of_mass(n: _Numbers) -> Finding:
    centre, positions = n.rigid.center_of_mass, n.body.positions
    low, high = positions.min(axis=0), positions.max(axis=0)
    outside = float(np.linalg.norm(np.maximum(low - centre, 0) + np.maximum(centre - high, 0)))
    size = max(float(np.ptp(positions, axis=0).max()), _size(n))
    far = len(positions) > 1 and outside > size
    text = f"{_vector(1e3 * centre)} mm"
    if far:
        text += f"; {1e3 * outside:.3g} mm outside the nodes, farther than the body is large"
    return Finding(
        "centre of mass", "warning" if far else "ok", text, dict(zip(("x_m", "y_m", "z_m"), centre, strict=True))
    )


def _inertia(n: _Numbers) -> Finding:
    moments = np.linalg.eigvalsh(n.rigid.central_inertia)
    possible = moments[0] > 0 and moments[2] <= (1 + 2e-3) * (moments[0] + moments[1])
    text = f"principal moments {_vector(moments)} kg m2 about the centre of mass"
    if not possible:
        text += "; impossible: none may be negative or larger than the sum of the others"
    figures = {f"moment_{k + 1}_kgm2": value for k, value in enumerate(moments)}
    return Finding("inertia", "ok" if possible else "fault", text, figures)


def _stiffness(n: _Numbers) -> Finding:
    falling = n.elastic[n.elastic < 0]
    if not n.elastic.size:
        return Finding("stiffness matrix", "ok", "no elastic motion: a rigid body")
    least = float(n.elastic.min()) if falling.size else n.first
    text = f"positive for all but rigid motions; elastic from {n.first:.5g} Hz"
    verdict = "ok"
    if falling.size or n.first <= 0:
        verdict, text = "fault", f"{max(falling.size, 1)} elastic motion(s) with negative or no stiffness: repair"
    elif np.any(n.frequency[:6] < 0):
        text += "; negative eigenvalues in rigid motions only"
    return Finding("stiffness matrix", verdict, text, {"lowest_elastic_Hz": least})


def _size(n: _Numbers) -> float:
    """Return the largest side of the box with the same inertia, or the largest distance of nodes along an axis [m]."""
    return float(max(np.sqrt(max(n.rigid.box[-1], 0.0)), np.ptp(n.body.positions, axis=0).max()))


def _properties(n: _Numbers) -> PhysicalProperties:
    translations = np.diag(n.stiffness)[: 6 * len(n.body.positions)].reshape(-1, 6)[:, :3]
    stiffness = relative_stiffness(float(translations.max()), n.rigid.mass)
    return PhysicalProperties(n.rigid.mass, _size(n), n.first * _size(n), n.rigid.box_density, stiffness)


def _units(n: _Numbers) -> Finding:
    looks = _properties(n)
    text = f"{n.body.units}: {looks}"
    strange = looks.implausible
    if not strange:
        return Finding("units", "ok", text + ": plausible", looks.figures)
    text += f"; {' and '.join(strange)} not plausible"
    likely = likely_units(looks, n.body.units)
    in_radians = from_degrees(n.body)
    if order_misfit(in_radians) <= FITS:
        reread = _properties(_numbers(in_radians, *_symmetric_parts(in_radians)))
        if not reread.implausible:
            likely = sort_by_likelihood([*likely, (f"{n.body.units} with rotations in degrees", reread)])
    if likely:
        text += "; looks like " + ", or else ".join(f"{units} ({reread})" for units, reread in likely[:3])
    return Finding("units", "fault", text, looks.figures)


def _nodes(n: _Numbers) -> Finding:
    positions, size = n.body.positions, max(_size(n), 1e-12)
    pairs = [
        f"{n.body.names[a]} and {n.body.names[b]}"
        for a, b in combinations(range(len(positions)), 2)
        if np.linalg.norm(positions[a] - positions[b]) < 1e-6 * size
    ]
    if not pairs:
        return Finding("nodes", "ok", f"{len(positions)}: {', '.join(n.body.names)}")
    text = f"in one place: {'; '.join(pairs)}"
    if order_misfit(n.body) <= FITS:
        return Finding("nodes", "ok", text + " (right by the rigid-motion test, as in a flexible joint)")
    return Finding("nodes", "warning", text + ": as in a flexible joint, or coordinates are rounded or lost")


def _modal_rows(n: _Numbers) -> Finding:
    p, b = n.body.n_modes, 6 * len(n.body.positions)
    if not p:
        return Finding("modal rows", "ok", "none: a static reduction")
    size = np.sqrt(np.maximum(np.abs(np.diag(n.stiffness)), 1e-100))
    unit = float(np.abs(n.mass[b:, b:] - np.eye(p)).max())
    loose = float(np.abs(n.stiffness[:b, b:] / np.outer(size[:b], size[b:])).max())
    figures = {"rows": p, "unit_mass_misfit": unit, "coupling": loose}
    text = f"the last {p} belong to no node; "
    if unit <= 1e-3 and loose <= 1e-3:
        return Finding("modal rows", "ok", text + "unit modal masses, no static coupling: Craig-Bampton", figures)
    text += f"their masses differ from ones by {unit:.2g}, they couple to the nodes by {loose:.2g}: "
    return Finding("modal rows", "warning", text + "no Craig-Bampton modes, or a node without coordinates", figures)


def _range(n: _Numbers) -> Finding:
    p = n.body.n_modes
    if not p:
        text = "no modes: good well below the first frequency with all nodes held, unknown from these matrices"
        return Finding("range", "warning", text)
    held = signed_frequencies(n.stiffness[-p:, -p:], n.mass[-p:, -p:])
    good = float(held[-1]) / RANGE_FACTOR
    text = f"to about {good:.5g} Hz: modes with all nodes held are kept to {held[-1]:.5g} Hz, over {RANGE_FACTOR}"
    verdict = "ok" if good >= n.first else "warning"
    return Finding("range", verdict, text, {"good_to_Hz": good, "highest_kept_Hz": held[-1]})


def _large_motion(n: _Numbers | None) -> Finding:
    text = "exact for rigid motions only, as from any matrices"
    if n is None or not n.elastic.size:
        return Finding("inertia integrals", "ok", text)
    limit = SPIN_LIMIT * n.first * 60
    text += f'; "ffrf" is right below some {limit:.3g} rev/min, a thirtieth of the first elastic frequency'
    return Finding("inertia integrals", "ok", text, {"spin_limit_Hz": SPIN_LIMIT * n.first})


def _vector(values: Array) -> str:
    return " ".join(f"{value:.5g}" for value in values)


_LINES: tuple[Callable[[_Numbers], Finding], ...] = (
    _rigid_motions,
    _row_order,
    _mass,
    _centre_of_mass,
    _inertia,
    _stiffness,
    _units,
    _nodes,
    _modal_rows,
    _range,
)
