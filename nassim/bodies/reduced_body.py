"""A body reduced to remote points and modes, with estimates of its error."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import KW_ONLY, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nassim.base.checks import Array, finite_array, freeze, instances, known, unique, whole_number
from nassim.base.field_types import ArrayField, Field, OptionalArray, data_class, held
from nassim.base.html_repr import html_repr
from nassim.base.short_repr import short_repr
from nassim.bodies.piezo import PortCoupling
from nassim.bodies.readouts import BodyDamping, PassivePoint, Picture, Readout, Surface, readouts_of
from nassim.bodies.remote_points import RemotePoint, coordinate_names, free_coordinates, point_masses
from nassim.bodies.strain import Strain, body_strain, strain_eigenfrequencies, strain_eigenmodes
from nassim.bodies.stress_stiffness import StressStiffness

ROUNDING = 1e-12
"""Relative error that rounding may have."""
SATURATION = 2.5
"""Ratio of a mesh's whole error to the part of it that elements one order higher remove, as the estimate finds it.

It is 0.9 to 1.7 where the strain is smooth and 2 to 3 at sharp re-entrant edges, where a higher order gains little.
"""
LARGEST_KNOWN_ERROR = 0.5
"""Relative error above which the estimate only says that the error is larger."""
SAME_MODE = 0.05
"""Relative frequency difference above which a fixed-interface mode and one of the enriched body are different modes."""


@data_class
class ReducedBody:
    """A flexible body in n = 6 r + p coordinates: the motions of r remote points, then p modal coordinates.

    Source: R. R. Craig, M. C. C. Bampton, Coupling of substructures for dynamic analyses, AIAA J. 6 (1968) 1313.

    Attributes:
        name: name of the body in files and reports
        remote_points: remote points in order; each has the coordinates ux uy uz [m] rx ry rz [rad]
        mass_matrix: symmetric, shape (n, n); modes are normalised to unit modal mass
        stiffness_matrix: symmetric, shape (n, n)
        gram: integrals over the body of density times the product of every two of the scalar fields
            1, x, y, z, psi_1x, psi_1y, psi_1z, psi_2x, ..., shape (4 + 3 n, 4 + 3 n), where psi_j is the displacement
            field of coordinate j. It holds all inertia data that large motion needs.
        readouts: further quantities that follow from the coordinates, by name: the surface for images ("surface"),
            electrical ports, whose static responses the coordinates contain exactly, passive points, the geometric
            stiffness under loads ("stress stiffness") and viscous damping ("damping")
        record: how the reduction was made, as text; "warnings" holds the warnings given meanwhile, one per line
        enriched: the same body with the omitted modes as further coordinates. The difference between its results and
            those of this body is the truncation error. None if unknown
        released_stiffness: estimated decrease of the stiffness matrix with finite elements one order higher, shape (n,
            n), for `discretization_errors`; None if it was not requested
        full_integrals: False if `gram` is exact for rigid motions only and otherwise estimated, as for imported
            matrices; see `nassim.bodies.inertia`

    Raises:
        ValueError: for matrices that do not belong together, and for a name used by a remote point and a read-out
    """

    name: str
    _: KW_ONLY
    remote_points: Field[Sequence[RemotePoint], tuple[RemotePoint, ...]]
    mass_matrix: ArrayField
    stiffness_matrix: ArrayField
    gram: ArrayField
    readouts: Mapping[str, Readout] = field(default_factory=dict, repr=False)
    record: Mapping[str, str] = field(default_factory=dict, repr=False)
    enriched: "ReducedBody | None" = field(default=None, repr=False)
    released_stiffness: OptionalArray = field(default=held(None), repr=False)
    full_integrals: bool = True
    __repr__ = short_repr
    _repr_html_ = html_repr

    def __post_init__(self) -> None:
        points = instances(f"body {self.name!r}: remote_points", self.remote_points, (RemotePoint,))
        unique("body", (self.name,))
        unique(f"body {self.name!r}: remote point", (point.name for point in points))
        mass = finite_array(f"body {self.name!r}: mass matrix", self.mass_matrix, (None, None))
        n = len(mass)
        if not n:
            raise ValueError(f"body {self.name!r} has no coordinates: its matrices are empty")
        stiffness = finite_array(f"body {self.name!r}: stiffness matrix", self.stiffness_matrix, (n, n))
        gram = finite_array(f"body {self.name!r}: gram", self.gram, (4 + 3 * n, 4 + 3 * n))
        for label, matrix in (("mass", mass), ("stiffness", stiffness)):
            if matrix.shape != (n, n) or np.abs(matrix - matrix.T).max() > 1e-9 * np.abs(matrix).max():
                raise ValueError(f"body {self.name!r}: the {label} matrix must be square and symmetric")
        if np.diag(mass).min() < 0:
            raise ValueError(f"body {self.name!r}: the diagonal of the mass matrix holds {np.diag(mass).min():.3g}")
        released = self.released_stiffness
        if released is not None:
            released = finite_array(f"body {self.name!r}: released stiffness", released, (n, n))
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
            released_stiffness=released,
            readouts=self.readouts,
            record=self.record,
        )
        self._check_readouts()

    def _check_readouts(self) -> None:
        """Check that names, types and numbers of coordinates of the read-outs agree with the body."""
        n = len(self.mass_matrix)
        for name, readout in self.readouts.items():
            label = f"body {self.name!r}: read-out {name!r}"
            if not isinstance(readout, Readout):
                raise ValueError(f"{label} is a {type(readout).__name__}, which `project` could not convert")
            if readout.name != name:
                raise ValueError(f"{label} has the name {readout.name!r}; make the mapping by readouts.by_name")
            if readout.n_coordinates != n:
                raise ValueError(f"{label} reads {readout.n_coordinates} coordinates, but the body has {n}")
        unique(f"body {self.name!r}: remote point and read-out", (*self.point_names, *self.readouts))

    @cached_property
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

    @property
    def surface(self) -> Surface | None:
        """Triangles of the outer surface, for images; None if unknown."""
        return self._picture.surface if self._picture else None

    @property
    def surface_modes(self) -> Array | None:
        """Displacements of the surface's points per unit of the coordinates, (n_points, 3, n); None if unknown."""
        return self._picture.modes if self._picture else None

    @property
    def _picture(self) -> Picture | None:
        return next(iter(readouts_of(self.readouts, Picture)), None)

    @property
    def ports(self) -> tuple[PortCoupling, ...]:
        """Electrical ports with their forces on the coordinates per volt."""
        return readouts_of(self.readouts, PortCoupling)

    @property
    def stress_stiffness(self) -> StressStiffness | None:
        """Geometric stiffness under loads; None for a body that was reduced without it."""
        return next(iter(readouts_of(self.readouts, StressStiffness)), None)

    @property
    def damping_matrix(self) -> Array | None:
        """Damping that the body has without ratios for its modes, shape (n, n); None where it has none."""
        return next((damping.matrix for damping in readouts_of(self.readouts, BodyDamping)), None)

    @cached_property
    def passive_points(self) -> tuple[RemotePoint, ...]:
        """Points that are not coordinates but move with the body."""
        return tuple(passive.point for passive in readouts_of(self.readouts, PassivePoint))

    @cached_property
    def all_point_names(self) -> tuple[str, ...]:
        """Names of the remote points, then of the passive points."""
        return self.point_names + tuple(point.name for point in self.passive_points)

    def point(self, name: str) -> RemotePoint:
        """Return a remote or passive point by name.

        Raises:
            ValueError: for an unknown name; the message lists the names
        """
        names = self.all_point_names
        return (*self.remote_points, *self.passive_points)[names.index(known("remote point", name, names))]

    def motion(self, name: str) -> Array:
        """Return the motion (ux uy uz rx ry rz) of a remote or passive point per unit of the coordinates, shape (6, n).

        Raises:
            ValueError: for an unknown name; the message lists the names
        """
        index = self.all_point_names.index(known("remote point", name, self.all_point_names))
        active = len(self.remote_points)
        if index < active:
            return np.eye(6, len(self.mass_matrix), 6 * index)
        return readouts_of(self.readouts, PassivePoint)[index - active].motions

    def port(self, name: str) -> PortCoupling:
        """Return an electrical port by name.

        Raises:
            ValueError: for an unknown name; the message lists the names
        """
        names = [port.name for port in self.ports]
        return self.ports[names.index(known("electrical port", name, names))]

    @cached_property
    def strain(self) -> Strain:
        """Strains that resist the body's motions."""
        return body_strain(self.stiffness_matrix, self.mass_matrix, self.positions)

    @cached_property
    def valid_frequency(self) -> float:
        """Frequency of the first fixed-interface mode that the body omits [Hz]; inf if no such mode is known.

        Above this frequency the coordinates contain the static shapes of remote points and loads, but not all modes. It
        is found from the `enriched` body, so it is inf for a body without one.
        """
        if self.enriched is None:
            return np.inf
        own, whole = (body.eigenfrequencies(fixed=self.point_names) for body in (self, self.enriched))
        # By Rayleigh's principle, each frequency is at least that of the enriched body with the same index.
        own = np.append(own, np.full(max(0, len(whole) - len(own)), np.inf))[: len(whole)]
        left_out = whole[own > (1 + SAME_MODE) * whole]
        return float(left_out[0]) if len(left_out) else np.inf

    @property
    def positions(self) -> Array:
        """Positions of the remote points in the body's frame, shape (r, 3) [m]."""
        return np.array([point.position for point in self.remote_points]).reshape(-1, 3)

    def eigenmodes(
        self,
        *,
        fixed: Collection[str] = (),
        guided: Mapping[str, str] | None = None,
        masses: Mapping[str, float] | None = None,
        n: int | None = None,
    ) -> tuple[Array, Array]:
        """Compute undamped eigenfrequencies and mode shapes under boundary conditions.

        Args:
            fixed: remote points that cannot move
            guided: point -> its one free direction ("x", "y", "z", "rx", "ry" or "rz")
            masses: point masses at remote points [kg]
            n: number of modes (default: all)

        Returns:
            Frequencies, shape (m,) [Hz], exactly 0 for rigid-body modes only, and mode shapes, shape (n_coordinates,
            m).

        Raises:
            ValueError: for unknown names and for points that are both fixed and guided
        """
        free, strain, mass, first = self._constrained(fixed, guided, masses, n)
        frequency, vectors = strain_eigenmodes(strain, mass)
        frequency, vectors = frequency[first], vectors[:, first]
        shapes = np.zeros((len(self.mass_matrix), len(frequency)))
        shapes[free] = vectors
        return frequency, shapes

    def _constrained(
        self,
        fixed: Collection[str],
        guided: Mapping[str, str] | None,
        masses: Mapping[str, float] | None,
        n: int | None,
    ) -> tuple[NDArray[np.int64], Strain, Array, slice]:
        """Return the free coordinates under boundary conditions, strains and mass matrix in these, and the n modes."""
        first = slice(None if n is None else whole_number("n", n, 1))
        n_interface = 6 * len(self.remote_points)
        free = free_coordinates(self.point_names, fixed=fixed, guided=guided)
        free = np.concatenate([free, np.arange(n_interface, len(self.mass_matrix))])
        added = np.zeros(len(self.mass_matrix))
        added[:n_interface] = point_masses(self.point_names, masses)
        mass = (self.mass_matrix + np.diag(added))[np.ix_(free, free)]
        return free, Strain(self.strain.rows[:, free], self.strain.root[:, free]), mass, first

    def eigenfrequencies(
        self,
        *,
        fixed: Collection[str] = (),
        guided: Mapping[str, str] | None = None,
        masses: Mapping[str, float] | None = None,
        n: int | None = None,
    ) -> Array:
        """Compute the eigenfrequencies, ascending, shape (m,) [Hz].

        Args:
            fixed: remote points that cannot move
            guided: point -> its one free direction ("x", "y", "z", "rx", "ry" or "rz")
            masses: point masses at remote points [kg]
            n: number of modes (default: all)
        """
        _, strain, mass, first = self._constrained(fixed, guided, masses, n)
        return strain_eigenfrequencies(strain, mass)[first]

    def truncation_errors(
        self,
        *,
        fixed: Collection[str] = (),
        guided: Mapping[str, str] | None = None,
        masses: Mapping[str, float] | None = None,
        n: int | None = None,
    ) -> Array:
        """Estimate the relative errors [-] of `eigenfrequencies` due to the omitted modes, shape (m,).

        An error is positive if the frequency is too high, and zero for rigid-body modes. The discretisation error of
        the mesh is not included.

        Args:
            fixed: remote points that cannot move
            guided: point -> its one free direction ("x", "y", "z", "rx", "ry" or "rz")
            masses: point masses at remote points [kg]
            n: number of modes (default: all)

        Raises:
            ValueError: for a body without an `enriched` body
        """
        if self.enriched is None:
            raise ValueError(f"body {self.name!r} has no enriched form, so its truncation error is unknown")
        frequency = self.eigenfrequencies(fixed=fixed, guided=guided, masses=masses, n=n)
        better = self.enriched.eigenfrequencies(fixed=fixed, guided=guided, masses=masses)
        return truncation_errors(frequency, better)

    def discretization_errors(
        self,
        *,
        fixed: Collection[str] = (),
        guided: Mapping[str, str] | None = None,
        masses: Mapping[str, float] | None = None,
        n: int | None = None,
    ) -> Array:
        """Estimate the relative errors [-] of `eigenfrequencies` due to the finite elements, shape (m,).

        With elements one order higher, a mode would lose a share of its energy, which follows from
        `released_stiffness`; see `relative_errors`. An error is inf if all that is known is that it, or that of a lower
        mode, is above 50 %. If the mesh misses a feature of the shape, the estimate does not include it.

        Args:
            fixed: remote points that cannot move
            guided: point -> its one free direction ("x", "y", "z", "rx", "ry" or "rz")
            masses: point masses at remote points [kg]
            n: number of modes (default: all)

        Raises:
            ValueError: for a body without `released_stiffness`
        """
        if self.released_stiffness is None:
            raise ValueError(
                f"body {self.name!r} does not know its discretisation error; reduce it by "
                "craig_bampton(..., discretization=True)"
            )
        frequency, shapes = self.eigenmodes(fixed=fixed, guided=guided, masses=masses, n=n)
        elastic = frequency > 0
        released, energy = (
            np.einsum("ij,ij->j", shapes, matrix @ shapes)[elastic]
            for matrix in (self.released_stiffness, self.stiffness_matrix)
        )
        errors = np.zeros(len(frequency))
        errors[elastic] = relative_errors(released / energy, power=0.5)
        return unknown_from_first(errors)

    def compliance(self, *, fixed: Collection[str], guided: Mapping[str, str] | None = None) -> Array:
        """Compute the static motion of all remote points per unit force at each of them.

        Args:
            fixed: remote points that cannot move
            guided: point -> its one free direction ("x", "y", "z", "rx", "ry" or "rz")

        Returns:
            Compliance, shape (6 r, 6 r) [m/N, rad/N, m/Nm, rad/Nm]. Rows and columns of constrained coordinates are
            zero.

        Raises:
            ValueError: if the body has a rigid-body mode under these boundary conditions
        """
        # An open electrical port couples modal coordinates to the points.
        moving, strain, mass, _ = self._constrained(fixed, guided, None, None)
        if np.any(strain_eigenfrequencies(strain, mass) == 0):
            raise ValueError(f"body {self.name!r} can move freely: fix enough remote points, known: {self.point_names}")
        stiffness = self.stiffness_matrix[np.ix_(moving, moving)]
        scale = 1.0 / np.sqrt(np.diag(stiffness))
        scaled = scale[:, None] * stiffness * scale
        result = np.zeros_like(self.stiffness_matrix)
        result[np.ix_(moving, moving)] = scale[:, None] * np.linalg.inv(scaled) * scale
        n_interface = 6 * len(self.remote_points)
        return result[:n_interface, :n_interface]


def truncation_errors(frequency: Array, enriched: Array) -> Array:
    """Return the relative errors of eigenfrequencies against those of an enriched body, zero for rigid-body modes.

    Args:
        frequency: eigenfrequencies, ascending, shape (m,) [Hz]
        enriched: those of the enriched body, at least as many [Hz]
    """
    better = enriched[: len(frequency)]
    elastic = (frequency > 0) & (better > 0)
    errors = np.zeros(len(frequency))
    errors[elastic] = frequency[elastic] / better[elastic] - 1
    return errors


def relative_errors(released: Array, *, power: float | Array) -> Array:
    """Estimate relative errors due to finite elements from the energy that one order more releases.

    The true energy is taken as the computed one times 1 - SATURATION * released.

    Args:
        released: released shares of the energies [-]
        power: exponent of the energy in the quantity: 0.5 for a frequency, 1 for a stiffness

    Returns:
        Relative errors [-], inf where all that is known is that they are above 50 %.
    """
    left = 1 - SATURATION * np.maximum(released, 0.0)
    with np.errstate(divide="ignore"):
        errors = np.maximum(left, 0.0) ** -np.asarray(power) - 1
    return np.where(errors > LARGEST_KNOWN_ERROR, np.inf, errors)


def unknown_from_first(errors: Array) -> Array:
    """Return errors of ascending frequencies, inf from the first one that is inf.

    A mode is orthogonal to all lower ones, so it is unknown where one of these is.
    """
    return np.where(np.logical_or.accumulate(np.isinf(errors)), np.inf, errors)


def error_text(error: float) -> str:
    """Return a relative error as text in per cent."""
    if error > LARGEST_KNOWN_ERROR:
        return "unknown, above 50 %"
    return f"{100 * error:.2g} %" if abs(error) > ROUNDING else f"below {100 * ROUNDING:g} %"
