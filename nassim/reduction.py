"""Craig-Bampton reduction of an FE model to remote points and fixed-interface modes."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

from nassim.checks import Array, finite_array, freeze, frozen_mapping, known, positive
from nassim.condensation import Condensation, condense
from nassim.fem import FEModel, Surface
from nassim.geometry import RemotePoint
from nassim.interface import coordinate_names, free_coordinates, point_masses
from nassim.modal import eigenmodes
from nassim.progress import Advance, silent, stage


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


def craig_bampton(
    fe_model: FEModel | Condensation,
    *,
    n_modes: int = 6,
    cutoff_frequency: float | None = None,
    remote_points: Sequence[str] | None = None,
    progress: bool = True,
) -> ReducedBody:
    """Reduce an FE model to the motions of its remote points and fixed-interface modes.

    fe_model: the model, or its `condense`d form where that is at hand
    n_modes: number p of fixed-interface modes; with cutoff_frequency [Hz], as many as lie below it
    remote_points: names (default: all); progress: show stages

    Raises ValueError for no remote points, unknown names or more modes than unknowns.
    """
    if isinstance(fe_model, Condensation):
        if remote_points is not None:
            raise ValueError("a Condensation has its remote points already; give them to condense instead")
        condensed = fe_model
    else:
        _check_n_modes(n_modes, fe_model.n_dofs)
        condensed = condense(fe_model, remote_points=remote_points, progress=progress)
    _check_n_modes(n_modes, condensed.fe_model.n_dofs)
    with stage("fixed-interface modes", unit="solves", enabled=progress) as advance:
        frequency, modes = fixed_interface_modes(
            condensed, n_modes=n_modes, cutoff_frequency=cutoff_frequency, advance=advance
        )
    with stage("integrals", enabled=progress):
        return _project(condensed, frequency, modes)


def fixed_interface_modes(
    condensed: Condensation, *, n_modes: int, cutoff_frequency: float | None = None, advance: Advance = silent
) -> tuple[Array, Array]:
    """Modes with all remote points held: frequencies (p,) [Hz] and shapes (n_dofs, p) of unit modal mass.

    Shift-invert Lanczos around the factorisation at hand. With a cut-off, the number of modes is doubled until
    one lies above it. advance: called once per solve.
    """
    n = condensed.fe_model.n_dofs
    if cutoff_frequency is not None:
        limit = positive("cutoff_frequency", cutoff_frequency, "Hz")
        count = 8
        while True:
            frequency, modes = fixed_interface_modes(condensed, n_modes=count, advance=advance)
            if frequency[-1] > limit:
                keep = frequency <= limit
                return frequency[keep], modes[:, keep]
            count *= 2
            _check_n_modes(count, n)
    if n_modes == 0:
        return np.zeros(0), np.zeros((n, 0))
    mass = mass_operator(condensed.fe_model)

    def solve(load: Array) -> Array:
        advance()
        return condensed.solve_fixed(np.ravel(load))

    inverse = LinearOperator((n, n), matvec=solve, dtype=float)
    start = condensed.solve_fixed(mass @ np.random.default_rng(0).standard_normal(n))
    eigenvalues, modes = eigsh(mass, k=n_modes, M=mass, sigma=0.0, OPinv=inverse, v0=start)
    order = np.argsort(eigenvalues)
    return np.sqrt(eigenvalues[order]) / (2 * np.pi), modes[:, order]


def mass_operator(fe_model: FEModel) -> LinearOperator:
    """The mass matrix as an operator (n_dofs, n_dofs), from its one scalar block."""
    block = fe_model.scalar_mass_matrix
    n = block.shape[0]

    def multiply(u: Array) -> Array:
        components = np.reshape(u, (3, n, -1))
        return np.concatenate([block @ component for component in components]).reshape(u.shape)

    return LinearOperator((3 * n, 3 * n), matvec=multiply, matmat=multiply, dtype=float)


def _project(condensed: Condensation, frequency: Array, modes: Array) -> ReducedBody:
    model = condensed.fe_model
    basis = np.hstack([condensed.constraint_modes, modes])
    n = basis.shape[1]
    # One scalar field per column: 1, x, y, z, then the components of each basis vector.
    components = basis.reshape(3, -1, n).transpose(1, 2, 0).reshape(-1, 3 * n)
    fields = np.hstack([model.fields.T, components])
    gram = fields.T @ (model.scalar_mass_matrix @ fields)
    gram = 0.5 * (gram + gram.T)
    mass = np.einsum("jckc->jk", gram[4:, 4:].reshape(n, 3, n, 3))
    n_interface = len(condensed.stiffness)
    stiffness = np.zeros((n, n))
    stiffness[:n_interface, :n_interface] = condensed.stiffness
    stiffness[n_interface:, n_interface:] = np.diag((2 * np.pi * frequency) ** 2)
    surface_modes = None
    if model.surface_evaluation is not None:
        surface_modes = (model.surface_evaluation @ components).reshape(-1, n, 3).transpose(0, 2, 1)
    return ReducedBody(
        model.name,
        tuple(c.point for c in condensed.couplings),
        mass,
        stiffness,
        gram,
        model.surface,
        surface_modes,
        {
            "finite element model": model.description,
            "coordinates": f"{n_interface // 6} remote points x 6 + {len(frequency)} fixed-interface modes = {n}",
            "fixed-interface frequencies [Hz]": " ".join(f"{f:.1f}" for f in frequency),
        },
    )


def _check_n_modes(n_modes: int, n_dofs: int) -> None:
    if int(n_modes) != n_modes or not 0 <= n_modes < n_dofs // 2:
        raise ValueError(f"n_modes must be a whole number from 0 to {n_dofs // 2 - 1} for this model, got {n_modes!r}")
