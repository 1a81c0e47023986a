"""Craig-Bampton reduction of an FE model to remote points and fixed-interface modes."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from nassim.checks import Array, finite_array, freeze, frozen_mapping, known, positive
from nassim.condensation import Condensation, condense
from nassim.fem import FEModel, Surface
from nassim.geometry import RemotePoint
from nassim.interface import coordinate_names, free_coordinates, point_masses
from nassim.modal import eigenmodes
from nassim.modes import check_n_modes, fixed_interface_modes, left_out_vectors, modes_below
from nassim.progress import stage
from nassim.solver import threads

DEFAULT_MODES = 6
RIGID = 1e-6
"""Frequencies below this share of a body's highest are those of rigid motions."""
COLUMNS = 64
"""Fields whose products with the mass matrix are held at once."""


@dataclass(frozen=True)
class ReducedBody:
    """A flexible body in n = 6 r + p coordinates: the motions of r remote points, then p modal coordinates.

    name: of the part
    remote_points: in order; each has the coordinates ux uy uz [m] rx ry rz [rad]
    mass_matrix, stiffness_matrix: shape (n, n), symmetric; modes are normalised to unit modal mass
    gram: integrals over the body of density times the product of every two of the scalar fields
        1, x, y, z, psi_1x, psi_1y, psi_1z, psi_2x, ..., shape (4 + 3 n, 4 + 3 n), where psi_j is the displacement
        field of coordinate j: all that large motion needs to know of the inertia
    surface, surface_modes: triangles of the outer surface and its displacements per coordinate, shape
        (n_points, 3, n), for pictures; None where unknown
    record: how the reduction was made, as text
    enriched: the same body with more coordinates, in which what was left out is present, so that the difference of
        any answer of the two is the truncation error; None where unknown

    Source: R. R. Craig, M. C. C. Bampton, Coupling of substructures for dynamic analyses, AIAA J. 6 (1968) 1313.
    """

    name: str
    remote_points: tuple[RemotePoint, ...]
    mass_matrix: Array
    stiffness_matrix: Array
    gram: Array
    surface: Surface | None = field(default=None)
    surface_modes: Array | None = field(default=None)
    record: Mapping[str, str] = field(default_factory=dict)
    enriched: "ReducedBody | None" = field(default=None, repr=False)

    def __post_init__(self) -> None:
        points = tuple(self.remote_points)
        mass = finite_array(f"body {self.name!r}: mass matrix", self.mass_matrix, (None, None))
        n = len(mass)
        stiffness = finite_array(f"body {self.name!r}: stiffness matrix", self.stiffness_matrix, (n, n))
        gram = finite_array(f"body {self.name!r}: gram", self.gram, (4 + 3 * n, 4 + 3 * n))
        for label, matrix in (("mass", mass), ("stiffness", stiffness)):
            if matrix.shape != (n, n) or np.abs(matrix - matrix.T).max() > 1e-9 * np.abs(matrix).max():
                raise ValueError(f"body {self.name!r}: the {label} matrix must be square and symmetric")
        if n < 6 * len(points):
            raise ValueError(
                f"body {self.name!r}: {len(points)} remote points need {6 * len(points)} coordinates, got {n}"
            )
        freeze(
            self,
            remote_points=points,
            mass_matrix=mass,
            stiffness_matrix=stiffness,
            gram=gram,
            record=frozen_mapping(self.record),
        )

    @property
    def point_names(self) -> tuple[str, ...]:
        """Names of the remote points, in order."""
        return tuple(point.name for point in self.remote_points)

    @property
    def n_modes(self) -> int:
        """Number p of modal coordinates."""
        return len(self.mass_matrix) - 6 * len(self.remote_points)

    @property
    def coordinate_names(self) -> tuple[str, ...]:
        """Names of the n coordinates: "bottom.ux", ..., "mode 1", ..."""
        return coordinate_names(self.point_names) + tuple(f"mode {k + 1}" for k in range(self.n_modes))

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return float(self.gram[0, 0])

    @property
    def center_of_mass(self) -> Array:
        """Centre of mass in the body's frame, shape (3,) [m]."""
        return self.gram[0, 1:4] / self.gram[0, 0]

    def point(self, name: str) -> RemotePoint:
        """A remote point by name; raises ValueError listing the names when there is none."""
        return self.remote_points[self.point_names.index(known("remote point", name, self.point_names))]

    def eigenmodes(
        self,
        *,
        fixed: Collection[str] = (),
        guided: Mapping[str, str] | None = None,
        masses: Mapping[str, float] | None = None,
        n: int | None = None,
    ) -> tuple[Array, Array]:
        """Eigenfrequencies (m,) [Hz] and mode shapes (n_coordinates, m) of the undamped body.

        fixed: remote points that cannot move; guided: point -> the one direction left free ("x" ... "rz")
        masses: point masses at remote points [kg]; n: how many modes (default: all)

        Raises ValueError for unknown names and for points both fixed and guided.
        """
        n_interface = 6 * len(self.remote_points)
        free = free_coordinates(self.point_names, fixed=fixed, guided=guided)
        free = np.concatenate([free, np.arange(n_interface, len(self.mass_matrix))])
        added = np.zeros(len(self.mass_matrix))
        added[:n_interface] = point_masses(self.point_names, masses)
        mass = (self.mass_matrix + np.diag(added))[np.ix_(free, free)]
        frequency, vectors = eigenmodes(self.stiffness_matrix[np.ix_(free, free)], mass, n_modes=n)
        shapes = np.zeros((len(self.mass_matrix), len(frequency)))
        shapes[free] = vectors
        return frequency, shapes

    def eigenfrequencies(
        self,
        *,
        fixed: Collection[str] = (),
        guided: Mapping[str, str] | None = None,
        masses: Mapping[str, float] | None = None,
        n: int | None = None,
    ) -> Array:
        """Eigenfrequencies [Hz], ascending, shape (m,); arguments as in `eigenmodes`."""
        return self.eigenmodes(fixed=fixed, guided=guided, masses=masses, n=n)[0]

    def truncation_errors(
        self,
        *,
        fixed: Collection[str] = (),
        guided: Mapping[str, str] | None = None,
        masses: Mapping[str, float] | None = None,
        n: int | None = None,
    ) -> Array:
        """Estimated relative errors [-] of `eigenfrequencies` due to the modes left out, shape (m,).

        Positive where a frequency is too high, zero for rigid motions; arguments as in `eigenmodes`. The mesh's own
        error is not in it. Raises ValueError for a body that does not know its `enriched` form.
        """
        if self.enriched is None:
            raise ValueError(f"body {self.name!r} carries no enriched form, so its truncation error is unknown")
        frequency = self.eigenfrequencies(fixed=fixed, guided=guided, masses=masses)
        better = self.enriched.eigenfrequencies(fixed=fixed, guided=guided, masses=masses)[: len(frequency)]
        elastic = better > RIGID * frequency[-1]
        errors = np.zeros(len(frequency))
        errors[elastic] = frequency[elastic] / better[elastic] - 1
        return errors[:n]

    def compliance(self, *, fixed: Collection[str], guided: Mapping[str, str] | None = None) -> Array:
        """Static motion of all remote points per unit force at each, shape (6 r, 6 r) [m/N and the like].

        Rows and columns of constrained coordinates are zero. Raises ValueError when the body can still move freely.
        """
        n_interface = 6 * len(self.remote_points)
        free = free_coordinates(self.point_names, fixed=fixed, guided=guided)
        stiffness = self.stiffness_matrix[np.ix_(free, free)]
        scale = 1.0 / np.sqrt(np.diag(stiffness))
        scaled = scale[:, None] * stiffness * scale
        if np.linalg.eigvalsh(scaled)[0] < 1e-10:
            raise ValueError(f"body {self.name!r} can move freely: fix enough remote points, known: {self.point_names}")
        result = np.zeros((n_interface, n_interface))
        result[np.ix_(free, free)] = scale[:, None] * np.linalg.inv(scaled) * scale
        return result


def keep_modes(body: ReducedBody, n_modes: int) -> ReducedBody:
    """The same body with its first n_modes modal coordinates only; it remembers the given one as its richer form.

    Raises ValueError when there are not so many.
    """
    if not 0 <= n_modes <= body.n_modes:
        raise ValueError(f"body {body.name!r} has {body.n_modes} modes, so it cannot keep {n_modes}")
    n = 6 * len(body.remote_points) + n_modes
    return replace(
        body,
        mass_matrix=body.mass_matrix[:n, :n],
        stiffness_matrix=body.stiffness_matrix[:n, :n],
        gram=body.gram[: 4 + 3 * n, : 4 + 3 * n],
        surface_modes=None if body.surface_modes is None else body.surface_modes[:, :, :n].copy(),
        enriched=replace(body, surface=None, surface_modes=None),
    )


def craig_bampton(
    fe_model: FEModel | Condensation,
    *,
    n_modes: int | None = None,
    cutoff_frequency: float | None = None,
    tolerance: float | None = None,
    remote_points: Sequence[str] | None = None,
    progress: bool = True,
) -> ReducedBody:
    """Reduce an FE model to the motions of its remote points and fixed-interface modes, and estimate the error.

    fe_model: the model, or its `condense`d form where that is at hand
    n_modes: number p of fixed-interface modes (default: 6, where neither of the next two is given)
    cutoff_frequency: keep the modes below it [Hz]; twice the highest frequency of interest is customary
    tolerance: keep as few modes as make the estimated errors of the eigenfrequencies small enough, relative [-]: of
        the first five elastic ones, or of those below cutoff_frequency where that is given too, of the free body and
        of the body clamped at each one of its remote points
    remote_points: names (default: all); progress: show the stages and the report

    Raises ValueError for no remote points, unknown names, more modes than unknowns, and n_modes beside the others.
    """
    if n_modes is not None and not (cutoff_frequency is None and tolerance is None):
        raise ValueError("give either n_modes, or cutoff_frequency and/or tolerance, not both")
    for label, value, unit in (("cutoff_frequency", cutoff_frequency, "Hz"), ("tolerance", tolerance, "")):
        if value is not None:
            positive(label, value, unit)
    count = DEFAULT_MODES if n_modes is None else n_modes
    if isinstance(fe_model, Condensation):
        if remote_points is not None:
            raise ValueError("a Condensation has its remote points already; give them to condense instead")
        condensed = fe_model
    else:
        check_n_modes(count, fe_model.n_dofs)
        condensed = condense(fe_model, remote_points=remote_points, progress=progress)
    if tolerance is None:
        rich, count = _reduce(condensed, count, cutoff_frequency, progress)
    else:
        rich, count = _reduce_within(condensed, tolerance, cutoff_frequency, progress)
    body = keep_modes(rich, count)
    record = {**body.record, **_truncation_record(body, rich)}
    if progress:
        print("\n".join(f"  {label}: {text}" for label, text in record.items() if label != "finite element model"))
    return replace(body, record=record)


def _reduce(
    condensed: Condensation, n_modes: int, cutoff_frequency: float | None, progress: bool
) -> tuple[ReducedBody, int]:
    """The body with some more modes than wanted and the vectors that stand for all others, and how many to keep."""
    with stage("fixed-interface modes", unit="solves", enabled=progress) as advance:
        if cutoff_frequency is None:
            frequency, modes = fixed_interface_modes(condensed, n_modes=n_modes + 1, advance=advance)
        else:
            frequency, modes = modes_below(condensed, cutoff_frequency, advance=advance)
            n_modes = int(np.count_nonzero(frequency <= cutoff_frequency))
    with stage("truncation error", unit="solves", enabled=progress) as advance:
        more, vectors = left_out_vectors(condensed, frequency, modes, advance=advance)
    with stage("integrals", enabled=progress), threads():
        rich = _project(condensed, np.concatenate([frequency, more]), [condensed.constraint_modes, modes, vectors])
    return rich, n_modes


def _reduce_within(
    condensed: Condensation, tolerance: float, cutoff_frequency: float | None, progress: bool
) -> tuple[ReducedBody, int]:
    """As _reduce, with the fewest modes whose estimated errors stay within a tolerance."""
    available = 2 * DEFAULT_MODES
    while True:
        check_n_modes(available, condensed.fe_model.n_dofs)
        rich, _ = _reduce(condensed, available, None, progress)
        for count in range(available + 1):
            if _worst_truncation(keep_modes(rich, count), cutoff_frequency) <= tolerance:
                return rich, count
        available *= 2


def _worst_truncation(body: ReducedBody, cutoff_frequency: float | None) -> float:
    worst = 0.0
    for fixed in [(), *((name,) for name in body.point_names)]:
        frequency = body.eigenfrequencies(fixed=fixed)
        error = body.truncation_errors(fixed=fixed)
        elastic = frequency > RIGID * frequency[-1]
        chosen = elastic & (frequency <= cutoff_frequency) if cutoff_frequency is not None else elastic
        errors = error[chosen] if cutoff_frequency is not None else error[chosen][:5]
        worst = max(worst, float(np.max(errors, initial=0.0)))
    return worst


def _truncation_record(body: ReducedBody, rich: ReducedBody) -> dict[str, str]:
    """What was kept, what was left out, and what that costs, as text."""
    r, p = len(body.remote_points), body.n_modes
    n = 6 * r + p
    frequency = np.sqrt(np.diag(rich.stiffness_matrix)[6 * r :]) / (2 * np.pi)
    first = body.point_names[0]
    record = {
        "coordinates": f"{r} remote points x 6 + {p} fixed-interface modes = {n}; in a floating frame on one remote "
        f"point ({first!r} unless the scene says otherwise): {n - 6} flexible + 6 rigid",
        "fixed-interface frequencies [Hz]": " ".join(f"{f:.1f}" for f in frequency[:p]) or "none",
    }
    if len(frequency) > p:
        record["modes left out"] = f"all from {frequency[p]:.1f} Hz"
    for label, fixed in (("free", ()), (f"{first!r} clamped", (first,))):
        errors = body.truncation_errors(fixed=fixed)[0 if fixed else 6 :][:5]
        record[f"truncation error of the first eigenfrequencies, {label} (estimate)"] = (
            " ".join(f"{100 * e:.2g}" for e in errors) + " %"
        )
    return record


def _project(condensed: Condensation, frequency: Array, parts: Sequence[Array]) -> ReducedBody:
    model = condensed.fe_model
    sizes = [part.shape[1] for part in parts]
    n, n_nodes = sum(sizes), model.scalar_mass_matrix.shape[0]
    # One scalar field per row: 1, x, y, z, then the components of each basis vector.
    fields = np.empty((4 + 3 * n, n_nodes))
    fields[:4] = model.fields
    components = fields[4:].reshape(n, 3, n_nodes)
    for part, end in zip(parts, np.cumsum(sizes), strict=True):
        components[end - part.shape[1] : end] = part.reshape(3, n_nodes, -1).transpose(2, 0, 1)
    gram = np.empty((len(fields), len(fields)))
    for start in range(0, len(fields), COLUMNS):
        chosen = slice(start, start + COLUMNS)
        gram[:, chosen] = fields @ (model.scalar_mass_matrix @ fields[chosen].T)
    gram = 0.5 * (gram + gram.T)
    mass = np.einsum("jckc->jk", gram[4:, 4:].reshape(n, 3, n, 3))
    n_interface = len(condensed.stiffness)
    stiffness = np.zeros((n, n))
    stiffness[:n_interface, :n_interface] = condensed.stiffness
    stiffness[n_interface:, n_interface:] = np.diag((2 * np.pi * frequency) ** 2)
    surface_modes = None
    if model.surface_evaluation is not None:
        surface_modes = (model.surface_evaluation @ fields[4:].T).reshape(-1, n, 3).transpose(0, 2, 1)
    return ReducedBody(
        model.name,
        tuple(c.point for c in condensed.couplings),
        mass,
        stiffness,
        gram,
        model.surface,
        surface_modes,
        {"finite element model": model.description},
    )
