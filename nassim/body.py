"""A body reduced to remote points and modes, and what is known of its error."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from nassim.checks import Array, finite_array, freeze, frozen_mapping, known
from nassim.geometry import RemotePoint
from nassim.interface import coordinate_names, free_coordinates, point_masses
from nassim.modal import eigenmodes
from nassim.surface import Surface

RIGID = 1e-6
"""Frequencies below this share of a body's highest are those of rigid motions."""


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
    coarse: the same body from finite elements one order lower, and so on, for `discretization_errors`; None where
        not asked for

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
    coarse: "ReducedBody | None" = field(default=None, repr=False)

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

    def discretization_errors(
        self,
        *,
        fixed: Collection[str] = (),
        guided: Mapping[str, str] | None = None,
        masses: Mapping[str, float] | None = None,
        n: int | None = None,
    ) -> Array:
        """Estimated relative errors [-] of `eigenfrequencies` due to the finite elements, shape (m,).

        From the same mesh with elements one and two orders lower: with d and d' the last and the last but one
        change of a frequency, the error left is 4 d (d / d')^0.7. Factor and exponent are fitted to bars and to the
        APA300ML with orders 3 and 4; not yet tested on the latter, and up to 10 times too large on smooth bars; a
        mesh that misses a feature altogether is beyond it. Arguments as in `eigenmodes`. Raises ValueError for a body
        that has no two `coarse` forms.
        """
        bodies: list[ReducedBody] = [self]
        while bodies[-1].coarse is not None and len(bodies) < 3:
            bodies.append(bodies[-1].coarse)
        if len(bodies) < 3:
            raise ValueError(
                f"body {self.name!r} has no forms of lower order, so its discretisation error is unknown; reduce it by "
                "craig_bampton(..., discretization=True) from elements of order 3 or more"
            )
        # Enriched, so that the error of truncation does not hide that of the mesh.
        found = [(b.enriched or b).eigenfrequencies(fixed=fixed, guided=guided, masses=masses) for b in bodies]
        size = min(len(self.mass_matrix), *map(len, found))
        fine, middle, rough = (frequency[:size] for frequency in found)
        elastic = fine > RIGID * fine[-1]
        last = np.maximum(middle[elastic] - fine[elastic], 0.0)
        before = np.maximum(rough[elastic] - middle[elastic], last)
        errors = np.zeros(size)
        errors[elastic] = 4.0 * last * (last / np.maximum(before, np.finfo(float).tiny)) ** 0.7 / fine[elastic]
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
