"""Stress and strain of a reduced body: linear functions of its coordinates, and what an engineer reads from them.

Stress has the six components of `COMPONENTS` along the axes of the body's own frame. It is found from the displacement
field of every coordinate at the order of the finite elements. An element's own stress jumps at its faces. The stress
here is the mean of what all elements of one CAD body say at a node; its difference from a single element's is an
estimate of the error of the mesh. Two elements may agree at one node by chance, so on a surface the estimate is the
root mean square over the points of the elements around. Elements of second order have a linear stress: there, what the
mean bends over an edge counts too.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from nassim.base.checks import Array, finite_array, freeze, positive
from nassim.base.field_types import ArrayLike
from nassim.base.short_repr import short_repr
from nassim.bodies.readouts import Surface, sparse_if_faster

COMPONENTS = ("sxx", "syy", "szz", "sxy", "syz", "sxz")
"""Names of the components of stress, in their order."""
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
"""Row and column of the components in the tensor."""


@dataclass(frozen=True)
class StressField:
    """Stress of a body at m points per unit of its coordinates.

    Attributes:
        name: name of the place: of a `StressPoint` (m = 1) or a `StressSurface`
        positions: points in the body's frame, shape (m, 3) [m]
        rows: stress per unit of the coordinates, shape (m, 6, n) [Pa]
        deviations: stress minus that of a single element at the point, or at a node beside it, or minus the mean of
            those at the ends of an edge, shape (m, 6, n) [Pa]
        voltages: stress per volt with all coordinates held, by electrical port, shape (m, 6) [Pa/V]; ports that do not
            stress the points directly are left out
        surface: triangles between the points, None for a single point
    """

    name: str
    positions: Array
    rows: Array = field(repr=False)
    deviations: Array = field(repr=False)
    voltages: Mapping[str, Array] = field(default_factory=dict)
    surface: Surface | None = field(default=None, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        label = f"stress {self.name!r}"
        positions = finite_array(f"{label}: positions", self.positions, (None, 3))
        m = len(positions)
        rows = finite_array(f"{label}: rows", self.rows, (m, 6, None))
        deviations = finite_array(f"{label}: deviations", self.deviations, rows.shape)
        voltages = {k: finite_array(f"{label}: stress by {k!r}", v, (m, 6)) for k, v in self.voltages.items()}
        freeze(self, positions=positions, rows=rows, deviations=deviations, voltages=voltages)

    @property
    def n_coordinates(self) -> int:
        """Number n of the body's coordinates."""
        return self.rows.shape[2]

    def projected(self, change: Array) -> "StressField":
        """Return the stress for n' coordinates q', where q = change @ q', shape (n, n')."""
        # One product of matrices is several times faster than one for each point.
        factor = sparse_if_faster(change)
        rows, deviations = (
            (part.reshape(-1, len(change)) @ factor).reshape(*part.shape[:2], change.shape[1])
            for part in (self.rows, self.deviations)
        )
        return replace(self, rows=rows, deviations=deviations)

    def without_points(self) -> "StressField":
        """Return the stress at none of the points."""
        rows = np.zeros((0, 6, self.n_coordinates))
        voltages = {port: np.zeros((0, 6)) for port in self.voltages}
        return replace(self, positions=np.zeros((0, 3)), rows=rows, deviations=rows, voltages=voltages, surface=None)

    def with_voltage_rows(self, rows: Mapping[str, Array]) -> "StressField":
        """Return the stress of a body whose ports have voltages that follow its coordinates.

        Args:
            rows: name of a port -> its voltage per unit of the coordinates, shape (n,) [V]
        """
        added = [np.multiply.outer(self.voltages[port], row) for port, row in rows.items() if port in self.voltages]
        return replace(self, rows=self.rows + sum(added)) if added else self

    def moved(self, place: Array, rotation: Array) -> "StressField":
        """Return the stress along the axes of another frame.

        Args:
            place: origin of the body's frame in the other frame, shape (3,) [m]
            rotation: axes of the body's frame as columns in the other frame, shape (3, 3)
        """
        turn = component_rotation(rotation)
        positions = place + self.positions @ rotation.T
        surface = None if self.surface is None else replace(self.surface, points=positions)
        return replace(
            self,
            positions=positions,
            rows=np.einsum("ij,mjn->min", turn, self.rows),
            deviations=np.einsum("ij,mjn->min", turn, self.deviations),
            voltages={port: stress @ turn.T for port, stress in self.voltages.items()},
            surface=surface,
        )

    def stress(self, coordinates: Array, voltages: Mapping[str, ArrayLike] | None = None) -> Array:
        """Compute the stress.

        Args:
            coordinates: coordinates of the body, shape (..., n)
            voltages: voltages of electrical ports, by name, numbers or shape (...) [V]; others are zero

        Returns:
            Stress, shape (..., m, 6) [Pa].

        Raises:
            ValueError: for another number of coordinates
        """
        result = self._of(self.rows, coordinates)
        for port, volts in (voltages or {}).items():
            if port in self.voltages:
                result = result + np.multiply.outer(np.asarray(volts), self.voltages[port])
        return result

    def mesh_error(self, coordinates: Array) -> Array:
        """Estimate the error of the finite elements, shape (..., m) [Pa].

        It is the von Mises stress of `deviations`, on a surface its root mean square over the points around. It is of
        the right size where the stress is finite. At a sharp re-entrant edge no mesh is fine enough: there the stress
        grows with every refinement.

        Args:
            coordinates: coordinates of the body, shape (..., n)
        """
        at_points = von_mises(self._of(self.deviations, coordinates))
        if self.surface is None:
            return at_points
        squares = at_points.reshape(-1, len(self.positions)) ** 2
        return np.sqrt(self._around @ squares.T).T.reshape(at_points.shape)

    @cached_property
    def _around(self) -> sp.csr_matrix:
        """Weights of a mean over the points up to two edges from each: over those of the elements around it."""
        assert self.surface is not None
        a, b, c = self.surface.triangles.T
        m = len(self.positions)
        ends = np.concatenate([np.arange(m), a, b, b, c, c, a]), np.concatenate([np.arange(m), b, a, c, b, a, c])
        beside = sp.csr_matrix((np.ones(len(ends[0])), ends), shape=(m, m)).sign()
        once = sp.diags(1 / beside.sum(axis=1).A1) @ beside
        return sp.csr_matrix(once @ once)

    def _of(self, rows: Array, coordinates: Array) -> Array:
        q = np.asarray(coordinates, dtype=float)
        if q.shape[-1:] != (self.n_coordinates,):
            raise ValueError(f"stress {self.name!r} reads {self.n_coordinates} coordinates, got an array {q.shape}")
        return (q @ rows.reshape(-1, self.n_coordinates).T).reshape(*q.shape[:-1], *rows.shape[:2])


@dataclass(frozen=True)
class GaugeStrain:
    """Mean strain along a straight line on a body per unit of its coordinates.

    Attributes:
        name: name of the `GaugeLine`
        row: strain per unit of the coordinates, shape (n,)
        ends: both ends of the line in the body's frame, shape (2, 3) [m]
    """

    name: str
    row: Array
    ends: Array

    __repr__ = short_repr

    def __post_init__(self) -> None:
        label = f"gauge {self.name!r}"
        freeze(
            self,
            row=finite_array(f"{label}: row", self.row, (None,)),
            ends=finite_array(f"{label}: ends", self.ends, (2, 3)),
        )

    @property
    def n_coordinates(self) -> int:
        """Number n of the body's coordinates."""
        return len(self.row)

    def moved(self, place: Array, rotation: Array) -> "GaugeStrain":
        """Return the gauge with its ends in another frame.

        Args:
            place: origin of the body's frame in the other frame, shape (3,) [m]
            rotation: axes of the body's frame as columns in the other frame, shape (3, 3)
        """
        return replace(self, ends=place + self.ends @ rotation.T)

    def projected(self, change: Array) -> "GaugeStrain":
        """Return the gauge for n' coordinates q', where q = change @ q', shape (n, n')."""
        return replace(self, row=self.row @ change)


def component_rotation(rotation: Array) -> Array:
    """Return the matrix that transforms stress components to other axes, shape (6, 6).

    Args:
        rotation: axes of the present frame as columns in the other frame, shape (3, 3)
    """
    result = np.zeros((6, 6))
    for k, (i, j) in enumerate(PAIRS):
        unit = np.zeros((3, 3))
        unit[i, j] = unit[j, i] = 1.0
        turned = rotation @ unit @ rotation.T
        result[:, k] = [turned[a, b] for a, b in PAIRS]
    return result


def von_mises(stress: Array) -> Array:
    """Compute the von Mises stress, shape (...) [Pa].

    Args:
        stress: components in the order of `COMPONENTS`, shape (..., 6) [Pa]
    """
    return np.linalg.norm(stress @ VON_MISES_ROOT.T, axis=-1)


def principal_stresses(stress: Array) -> Array:
    """Compute the principal stresses, descending, shape (..., 3) [Pa].

    Args:
        stress: components in the order of `COMPONENTS`, shape (..., 6) [Pa]
    """
    tensor = np.zeros((*np.shape(stress)[:-1], 3, 3))
    for k, (i, j) in enumerate(PAIRS):
        tensor[..., i, j] = tensor[..., j, i] = stress[..., k]
    return np.linalg.eigvalsh(tensor)[..., ::-1]


def _von_mises_root() -> Array:
    """Return L with |L s|^2 the squared von Mises stress of the components s: deviator and shears, shape (6, 6)."""
    root = np.zeros((6, 6))
    root[:3, :3] = np.sqrt(1.5) * (np.eye(3) - 1 / 3)
    root[3:, 3:] = np.sqrt(3.0) * np.eye(3)
    return root


VON_MISES_ROOT = _von_mises_root()
"""Matrix L with |L s| the von Mises stress of the components s, shape (6, 6)."""


def largest_factor(constant: Array, variable: Array, limit: float) -> Array:
    """Compute the largest factor f >= 0 for which the von Mises stress of constant + f * variable keeps a limit.

    Args:
        constant: stress that does not grow, as that of the weight, shape (..., 6) [Pa]
        variable: stress per unit of the load that grows, shape (..., 6) [Pa]
        limit: largest von Mises stress allowed [Pa]

    Returns:
        Factors, shape (...), inf where no factor reaches the limit.

    Raises:
        ValueError: if the constant stress exceeds the limit already
    """
    limit = positive("limit", limit, "Pa")
    at_rest = float(von_mises(constant).max(initial=0.0))
    if at_rest > limit:
        raise ValueError(
            f"the constant loads alone give a von Mises stress of {1e-6 * at_rest:.4g} MPa, above the limit of "
            f"{1e-6 * limit:.4g} MPa"
        )
    fixed, moving = (
        np.broadcast_to(s, np.broadcast_shapes(constant.shape, variable.shape)) @ VON_MISES_ROOT.T
        for s in (constant, variable)
    )
    a, b, c = (np.sum(x * y, axis=-1) for x, y in ((moving, moving), (moving, fixed), (fixed, fixed)))
    # The root of a f^2 + 2 b f + c = limit^2 in a form that neither cancels nor divides by zero.
    room = limit**2 - c
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(b**2 + a * room)
        factors = np.where(b > 0, room / (b + root), (root - b) / a)
    return np.where(a > 0, factors, np.inf)
