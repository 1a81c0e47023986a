"""Finite element model: matrices of a meshed solid and its coupled remote points, from any mesher."""

import math
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from nassim.base.checks import Array, freeze, known
from nassim.base.short_repr import short_repr
from nassim.bodies.piezo import PortCoupling
from nassim.bodies.readouts import Surface
from nassim.bodies.reduced_body import error_text
from nassim.bodies.remote_points import RemotePoint
from nassim.fem.sparse import SymmetricMatrix, symmetric_matrix


@dataclass(frozen=True)
class Coupling:
    """A remote point coupled to the finite element unknowns of its interface.

    Attributes:
        point: the remote point
        dofs: scalar unknowns of the interface, shape (m,)
        averages: rows from the displacements of the interface to the motion of the point (ux uy uz rx ry rz), a
            least-squares fit over the area, shape (6, 3 m), unknowns ordered x..., y..., z...
        motions: displacements of the interface for unit motions of the point, shape (3 m, 6); averages @ motions = 1
    """

    point: RemotePoint
    dofs: NDArray[np.int64]
    averages: Array
    motions: Array
    __repr__ = short_repr


@dataclass(frozen=True)
class MeshRound:
    """Cost and error of one mesh that was tried.

    Attributes:
        order: polynomial order of the elements
        n_elements: number of elements
        n_dofs: number of unknowns
        seconds: time since the work began [s]
        error: largest estimated relative error of what the tolerance is for [-]; NaN if it was not estimated, inf if
            all that is known is that it is above 50 %
    """

    order: int
    n_elements: int
    n_dofs: int
    _: KW_ONLY
    seconds: float
    error: float = math.nan
    __repr__ = short_repr

    def __str__(self) -> str:
        error = "" if math.isnan(self.error) else f", error {error_text(self.error)} (estimate)"
        return f"order {self.order}, {self.n_elements} elements, {self.n_dofs} unknowns{error}, {self.seconds:.1f} s"


@dataclass(frozen=True)
class FEModel:
    """Stiffness and mass of a meshed solid. Unknowns: all x, then all y, then all z displacements.

    Attributes:
        name: name of the solid
        stiffness: symmetric, shape (3 n, 3 n) [N/m]; a SciPy matrix is accepted too
        scalar_mass_matrix: integral of density times two scalar shape functions, sparse, shape (n, n) [kg]; the mass
            matrix consists of three such blocks
        fields: coefficients of the functions 1, x, y, z in the scalar shape functions, shape (4, n) [-, m, m, m]
        couplings: couplings of the remote points, in the order of the solid
        surface: triangles for images; None in models that were not made from a mesh
        surface_evaluation: sparse matrix (n_points, n) that evaluates a scalar field at the surface's points, or None
        description: element order, sizes and counts as text, for reports
        order: polynomial order of the elements; 0 if unknown
        ports: electrical ports, in the order of the solid
        warnings: warnings given while the mesh was made
        rounds: the meshes that were tried for a tolerance, in order, with their costs and errors; the model is that of
            the smallest error
    """

    name: str
    _: KW_ONLY
    stiffness: SymmetricMatrix = field(repr=False)
    scalar_mass_matrix: sp.csr_matrix = field(repr=False)
    fields: Array = field(repr=False)
    couplings: tuple[Coupling, ...] = field(default=(), repr=False)
    surface: Surface | None = field(default=None, repr=False)
    surface_evaluation: sp.csr_matrix | None = field(default=None, repr=False)
    description: str = ""
    order: int = 0
    ports: tuple[PortCoupling, ...] = field(default=(), repr=False)
    warnings: tuple[str, ...] = ()
    rounds: tuple[MeshRound, ...] = field(default=(), repr=False)
    _condensation: Any = None  # with all remote points, if it exists already
    _source: tuple[Any, Any] | None = None  # NGSolve's mesh, Solid
    __repr__ = short_repr

    def __post_init__(self) -> None:
        n = self.scalar_mass_matrix.shape[0]
        if self.stiffness.shape != (3 * n, 3 * n) or self.fields.shape != (4, n):
            raise ValueError(
                f"FE model {self.name!r}: stiffness {self.stiffness.shape}, scalar mass "
                f"{self.scalar_mass_matrix.shape} and fields {self.fields.shape} do not belong together"
            )
        if sp.issparse(self.stiffness):
            freeze(self, stiffness=symmetric_matrix(self.stiffness))
        for label, values in (
            ("stiffness matrix holds", self.stiffness.lower.data),
            ("mass matrix holds", self.scalar_mass_matrix.data),
            ("fields hold", self.fields),
        ):
            if not np.all(np.isfinite(values)):
                raise ValueError(f"FE model {self.name!r}: the {label} NaN or infinite values")
        freeze(self, couplings=tuple(self.couplings), ports=tuple(self.ports), warnings=tuple(self.warnings))
        freeze(self, rounds=tuple(self.rounds))

    @property
    def n_dofs(self) -> int:
        """Number of unknowns, 3 n."""
        return self.stiffness.shape[0]

    @property
    def remote_points(self) -> tuple[RemotePoint, ...]:
        """Remote points, in order."""
        return tuple(c.point for c in self.couplings)

    @property
    def stiffness_matrix(self) -> sp.csr_matrix:
        """Stiffness matrix (3 n, 3 n) [N/m]; every access makes a new one."""
        return self.stiffness.to_scipy()

    @property
    def mass_matrix(self) -> sp.csr_matrix:
        """Mass matrix (3 n, 3 n) [kg]; every access makes a new one."""
        return sp.block_diag([self.scalar_mass_matrix] * 3, format="csr")

    @property
    def mass(self) -> float:
        """Total mass [kg]."""
        one = self.fields[0]
        return float(one @ (self.scalar_mass_matrix @ one))

    @property
    def discretization_error(self) -> float:
        """Largest estimated relative error of what its tolerance was for [-]; NaN if unknown, inf if above 50 %."""
        return min((made.error for made in self.rounds), default=math.nan)

    def rigid_motions(self) -> Array:
        """Return unit translations and rotations about the CAD's origin, shape (3 n, 6)."""
        return rigid_fields(self.fields, np.zeros(3))

    def port(self, name: str) -> PortCoupling:
        """Return an electrical port by name.

        Raises:
            ValueError: for an unknown name; the message lists the names
        """
        names = [port.name for port in self.ports]
        return self.ports[names.index(known("electrical port", name, names))]

    def coupling(self, name: str) -> Coupling:
        """Return the coupling of a remote point.

        Raises:
            ValueError: for an unknown name; the message lists the names
        """
        names = [c.point.name for c in self.couplings]
        return self.couplings[names.index(known("remote point", name, names))]


@dataclass(frozen=True)
class Refinement:
    """Elements one order higher on the same mesh, with m scalar unknowns, for an FE model with n.

    Attributes:
        spaces: NGSolve's scalar spaces of the model and of the finer elements
        held: whether a finer unknown adds nothing to the model: all at vertices, and all on edges except those of the
            highest degree, shape (m,)
        mixed_mass: forces on the finer unknowns from accelerations of the model, one scalar block, shape (m, n) [kg]
        couplings: remote points coupled to the finer elements
        port_forces: forces of the electrical ports per volt, shape (3 m, n_ports) [N/V]
        elements: ones where an element has an unknown, shape (n_elements, m)
    """

    spaces: tuple[Any, Any]
    held: NDArray[np.bool_]
    mixed_mass: sp.csr_matrix
    couplings: tuple[Coupling, ...]
    port_forces: Array
    elements: sp.csr_matrix


def rigid_fields(fields: Array, centre: Array) -> Array:
    """Return translations along, and rotations about, axes through `centre`, shape (3 n, 6).

    Args:
        fields: coefficients of the fields 1, x, y, z, shape (4, n)
        centre: point on the axes, shape (3,) [m]
    """
    one = fields[0]
    arm = fields[1:] - np.outer(centre, one)
    zero = np.zeros_like(one)
    x, y, z = arm
    rows = [
        [one, zero, zero, zero, z, -y],
        [zero, one, zero, -z, zero, x],
        [zero, zero, one, y, -x, zero],
    ]
    return np.vstack([np.column_stack(row) for row in rows])


def make_coupling(
    point: RemotePoint, dofs: NDArray[np.int64], area_integrals: Array, interface_fields: Array
) -> Coupling:
    """Couple a remote point to unknowns of its interface.

    With the area integrals F of the six rigid motions and their coefficients R, the mean motion is (F R)^-1 F u.

    Args:
        point: the remote point
        dofs: scalar unknowns of the interface, shape (m,)
        area_integrals: integrals over the interface of each scalar shape function times 1, x, y, z, shape (4, m) [m2,
            m3]
        interface_fields: coefficients of 1, x, y, z in the scalar shape functions, shape (4, m)

    Raises:
        ValueError: if the interface is a line or a point, which cannot carry a rotation
    """
    integrals = rigid_fields(area_integrals, point.position).T
    motions = rigid_fields(interface_fields, point.position)
    gram = integrals @ motions
    area = gram[0, 0]
    radius = np.sqrt(max(np.trace(gram[3:, 3:]) / area, 0.0)) if area > 0 else 0.0
    scale = np.repeat([1.0, 1.0 / radius if radius > 0 else 1.0], 3)
    if area <= 0 or np.linalg.eigvalsh(scale[:, None] * gram * scale).min() < 1e-9 * area:
        raise ValueError(
            f"remote point {point.name!r}: its interface {', '.join(point.faces)} is collinear or too small to carry "
            "a rotation; choose faces with an extent in two directions"
        )
    return Coupling(point, dofs, np.linalg.solve(gram, integrals), motions)
