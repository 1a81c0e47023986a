"""Finite element models: mesh, stiffness and mass of any element order, remote points."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import ngsolve as ng
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from nassim.checks import Array, freeze, known
from nassim.exclusive import exclusive
from nassim.interface import RemotePoint
from nassim.materials import Material
from nassim.mesh_checks import check_memory, check_volume, warn_of_thin_walls
from nassim.meshing import generate_mesh
from nassim.notices import collected
from nassim.piezo import PortCoupling
from nassim.ports import couple_port
from nassim.progress import stage
from nassim.regions import by_body, faces
from nassim.skin import Surface, outer_surface
from nassim.solid import Solid
from nassim.solver import SymmetricMatrix, symmetric_matrix, threads

MAX_ORDER = 6
ELEMENTS = {ng.ET.TET: "tetrahedra", ng.ET.PRISM: "prisms", ng.ET.PYRAMID: "pyramids", ng.ET.HEX: "hexahedra"}


@dataclass(frozen=True)
class Coupling:
    """A remote point tied to the finite element unknowns of its interface.

    point: the remote point
    dofs: scalar unknowns of the interface, shape (m,)
    averages: rows that turn the interface's displacements into the point's motion (ux uy uz rx ry rz) by a
        least-squares fit over the area, shape (6, 3 m), unknowns ordered x..., y..., z...
    motions: the interface's displacements when the point moves by one unit, shape (3 m, 6); averages @ motions = 1
    """

    point: RemotePoint
    dofs: NDArray[np.int64]
    averages: Array
    motions: Array


@dataclass(frozen=True)
class FEModel:
    """Stiffness and mass of a meshed part. Unknowns: all x, then all y, then all z displacements.

    name: of the part
    stiffness: (3 n, 3 n), symmetric [N/m]; a SciPy matrix is taken too
    scalar_mass_matrix: (n, n) sparse, integral of density times two scalar shape functions [kg]; the mass
        matrix is three such blocks
    fields: coefficients of the functions 1, x, y, z in the scalar shape functions, shape (4, n) [-, m, m, m]
    couplings: the remote points, in the part's order; ports: the electrical ports, likewise
    surface, surface_evaluation: triangles for pictures, and the (n_points, n) sparse matrix that evaluates
        a scalar field at their points; None in models made by hand
    description: element order, sizes and counts as text, for reports
    order: polynomial order of the elements; 0 where unknown
    warnings: what was told while the mesh was made
    """

    name: str
    stiffness: SymmetricMatrix
    scalar_mass_matrix: sp.csr_matrix
    fields: Array
    couplings: tuple[Coupling, ...] = field(default=())
    surface: Surface | None = field(default=None)
    surface_evaluation: sp.csr_matrix | None = field(default=None)
    description: str = field(default="")
    order: int = field(default=0)
    ports: tuple[PortCoupling, ...] = ()
    warnings: tuple[str, ...] = ()
    _source: "tuple[Any, Solid] | None" = field(default=None, repr=False)  # NGSolve's mesh, part

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

    @property
    def n_dofs(self) -> int:
        """Number of unknowns, 3 n."""
        return self.stiffness.shape[0]

    @property
    def remote_points(self) -> tuple[RemotePoint, ...]:
        """The remote points, in order."""
        return tuple(c.point for c in self.couplings)

    @property
    def stiffness_matrix(self) -> sp.csr_matrix:
        """The stiffness matrix (3 n, 3 n) [N/m], made anew at every call."""
        return self.stiffness.to_scipy()

    @property
    def mass_matrix(self) -> sp.csr_matrix:
        """The mass matrix (3 n, 3 n) [kg], made anew at every call."""
        return sp.block_diag([self.scalar_mass_matrix] * 3, format="csr")

    @property
    def mass(self) -> float:
        """Total mass [kg]."""
        one = self.fields[0]
        return float(one @ (self.scalar_mass_matrix @ one))

    def rigid_motions(self) -> Array:
        """Unit translations and rotations about the part's origin, shape (3 n, 6)."""
        return rigid_motions(self.fields, np.zeros(3))

    def port(self, name: str) -> PortCoupling:
        """An electrical port by name; raises ValueError listing the names when there is none."""
        names = [port.name for port in self.ports]
        return self.ports[names.index(known("electrical port", name, names))]

    def coupling(self, name: str) -> Coupling:
        """The coupling of a remote point; raises ValueError listing the names when there is none."""
        names = [c.point.name for c in self.couplings]
        return self.couplings[names.index(known("remote point", name, names))]


def rigid_motions(fields: Array, centre: Array) -> Array:
    """Translations along and rotations about axes through `centre`, (3 n, 6), from the fields 1, x, y, z (4, n)."""
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
    """Tie a remote point to interface unknowns.

    dofs: scalar unknowns (m,); area_integrals: integral over the interface of each scalar shape function times
    1, x, y, z, shape (4, m) [m2, m3]; interface_fields: coefficients of 1, x, y, z in them, shape (4, m)

    With F the area integrals of the six rigid motions and R their coefficients, the mean motion is
    (F R)^-1 F u. Raises ValueError when the interface cannot carry a rotation (a line or a point).
    """
    integrals = rigid_motions(area_integrals, point.position).T
    motions = rigid_motions(interface_fields, point.position)
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


def build_fe_model(
    solid: Solid,
    *,
    element_size: float,
    order: int = 3,
    curvature: float = 0.5,
    local_sizes: Mapping[str, float] | None = None,
    extrude: str | None = None,
    layer_thickness: float | None = None,
    progress: bool = True,
) -> FEModel:
    """Mesh a part and assemble its stiffness and mass.

    element_size, curvature, local_sizes, extrude, layer_thickness: as in `meshing.generate_mesh`
    order: polynomial order of the displacements, 1 to 6; order 1 is far too stiff in thin parts
    progress: show the stages and their times

    Raises ValueError for bad arguments, for a part that falls into pieces and for a mesh that the memory cannot hold.
    Warns of thin walls in elements of order 1.
    """
    if not 1 <= order <= MAX_ORDER or int(order) != order:
        raise ValueError(f"order must be a whole number from 1 to {MAX_ORDER}, got {order!r}")
    with exclusive(), collected() as told:
        with stage("mesh", enabled=progress):
            mesh = ng.Mesh(
                generate_mesh(
                    solid,
                    element_size=element_size,
                    curvature=curvature,
                    local_sizes=local_sizes,
                    extrude=extrude,
                    layer_thickness=layer_thickness,
                )
            )
            # Isoparametric at most: the unknowns then hold every rigid motion exactly.
            mesh.Curve(order)
            check_memory(mesh, solid, order, element_size)
        check_volume(mesh, solid)
        if order == 1:
            warn_of_thin_walls(mesh, solid)
        with stage("assemble", enabled=progress):
            model = assemble_mesh(mesh, solid, order)
    description = "; ".join([model.description, *told.notes])
    model = replace(model, description=description, warnings=tuple(told.warnings))
    if progress:
        print(f"  {model.description}")
    return model


def assemble_mesh(mesh: Any, solid: Solid, order: int) -> FEModel:
    """The FE model of a part on an NGSolve mesh that is curved with the elements' order at most.

    Raises ValueError when the part falls into pieces.
    """
    with threads():
        scalar = ng.H1(mesh, order=order)
        mass = _scalar_mass(mesh, solid, scalar)
        pieces, _ = sp.csgraph.connected_components(mass, directed=False)
        if pieces > 1:
            raise ValueError(
                f"part {solid.name!r} falls into {pieces} pieces that do not touch; join the bodies in the CAD"
            )
        fields = _position_fields(scalar)
        stiffness = _stiffness(mesh, solid, order)
        couplings = tuple(_couple(mesh, scalar, fields, point) for point in solid.remote_points)
        surface, evaluation = outer_surface(mesh, scalar, fields, solid)
        kinds = Counter(ELEMENTS[element.type] for element in mesh.Elements(ng.VOL))
        counts = " + ".join(f"{count} {kind}" for kind, count in kinds.items())
        description = f"{counts} of order {order}, {mesh.nv} vertices, {3 * scalar.ndof} degrees of freedom"
        ports = tuple(couple_port(mesh, solid, order, port) for port in solid.ports)
        return FEModel(
            solid.name,
            stiffness,
            mass,
            fields,
            couplings,
            surface,
            evaluation,
            description,
            order,
            ports,
            _source=(mesh, solid),
        )


def with_materials(fe_model: FEModel, materials: Mapping[str, Material]) -> FEModel:
    """The same part on the same mesh with other materials by body name; ValueError for models made by hand."""
    mesh, solid = _source(fe_model)
    changed = replace(solid, materials={**solid.materials, **materials})
    model = assemble_mesh(mesh, changed, fe_model.order)
    return replace(model, description=fe_model.description, warnings=fe_model.warnings)


def _source(fe_model: FEModel) -> tuple[Any, Solid]:
    if fe_model._source is None:
        raise ValueError(f"FE model {fe_model.name!r} was made by hand, so its mesh is unknown")
    return fe_model._source


@dataclass(frozen=True)
class Refinement:
    """What elements one order higher on the same mesh add to an FE model of n scalar unknowns; they have m.

    stiffness: of the finer elements, (3 m, 3 m) [N/m]
    held: unknowns of these that add nothing: those of the vertices and of lower degree on the edges
    mixed_stiffness: forces on the finer unknowns from displacements of the model, (3 m, 3 n)
    mixed_mass: the same for density, one scalar block, (m, n)
    couplings: the remote points on the finer elements
    """

    stiffness: SymmetricMatrix
    held: NDArray[np.int64]
    mixed_stiffness: sp.csr_matrix
    mixed_mass: sp.csr_matrix
    couplings: tuple[Coupling, ...]


def refine_order(fe_model: FEModel) -> Refinement:
    """The same part on the same mesh with elements one order higher; ValueError for models made by hand."""
    mesh, solid = _source(fe_model)
    order = fe_model.order
    with threads():
        scalar, fine_scalar = ng.H1(mesh, order=order), ng.H1(mesh, order=order + 1)
        held = np.zeros(fine_scalar.ndof, dtype=bool)
        held[: mesh.nv] = True
        for edge in mesh.edges:
            held[list(fine_scalar.GetDofNrs(edge))[:-1]] = True
        trial, test = ng.VectorH1(mesh, order=order), ng.VectorH1(mesh, order=order + 1)
        stiffness = ng.BilinearForm(trialspace=trial, testspace=test)
        stiffness += _elastic_energy(mesh, solid, trial.TrialFunction(), test.TestFunction()) * ng.dx
        mass = ng.BilinearForm(trialspace=scalar, testspace=fine_scalar)
        mass += _density(mesh, solid) * scalar.TrialFunction() * fine_scalar.TestFunction() * ng.dx(bonus_intorder=2)
        fields = _position_fields(fine_scalar)
        return Refinement(
            _stiffness(mesh, solid, order + 1),
            np.flatnonzero(np.tile(held, 3)),
            _to_scipy(stiffness.Assemble().mat),
            _to_scipy(mass.Assemble().mat),
            tuple(_couple(mesh, fine_scalar, fields, point) for point in solid.remote_points),
        )


def _elastic_energy(mesh: Any, solid: Solid, u: Any, v: Any) -> Any:
    lame = {name: material.lame_parameters for name, material in solid.materials.items()}
    lambda_, mu = (by_body(mesh, {name: values[k] for name, values in lame.items()}) for k in range(2))
    strain_u, strain_v = ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))
    return 2 * mu * ng.InnerProduct(strain_u, strain_v) + lambda_ * ng.div(u) * ng.div(v)


def _density(mesh: Any, solid: Solid) -> Any:
    return by_body(mesh, {name: material.density for name, material in solid.materials.items()})


def _stiffness(mesh: Any, solid: Solid, order: int) -> SymmetricMatrix:
    space = ng.VectorH1(mesh, order=order)
    u, v = space.TnT()
    form = ng.BilinearForm(space, symmetric=True, symmetric_storage=True)
    form += _elastic_energy(mesh, solid, u, v) * ng.dx
    return symmetric_matrix(form.Assemble().mat)


def _scalar_mass(mesh: Any, solid: Solid, scalar: Any) -> sp.csr_matrix:
    density = _density(mesh, solid)
    u, v = scalar.TnT()
    # Two orders more than the default integrate the Jacobian of curved elements exactly, or nearly so.
    return _to_scipy(ng.BilinearForm(density * u * v * ng.dx(bonus_intorder=2)).Assemble().mat)


def _to_scipy(matrix: Any) -> sp.csr_matrix:
    values, columns, row_starts = (np.array(part, copy=True) for part in matrix.CSR())
    result = sp.csr_matrix((values, columns, row_starts), shape=(matrix.height, matrix.width))
    result.sort_indices()
    return result


def _position_fields(scalar: Any) -> Array:
    rows = []
    for function in (ng.CoefficientFunction(1.0), ng.x, ng.y, ng.z):
        interpolated = ng.GridFunction(scalar)
        interpolated.Set(function)
        rows.append(interpolated.vec.FV().NumPy().copy())
    return np.array(rows)


def _couple(mesh: Any, scalar: Any, fields: Array, point: RemotePoint) -> Coupling:
    region = faces(mesh, point.faces)
    dofs = np.flatnonzero(np.array(scalar.GetDofs(region)))
    test = scalar.TestFunction()
    integrals = [
        ng.LinearForm(function * test * ng.ds(definedon=region, bonus_intorder=2)).Assemble().vec.FV().NumPy()[dofs]
        for function in (1.0, ng.x, ng.y, ng.z)
    ]
    return make_coupling(point, dofs, np.array(integrals), fields[:, dofs])
