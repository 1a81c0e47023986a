"""Read-outs of a reduced body: linear functions of its coordinates. Every projection of the body includes them.

A new kind is a frozen dataclass with the three members of `Readout`. `ReducedBody.readouts` accepts it as it is.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from nassim.base.checks import Array, finite_array, freeze, unique
from nassim.base.short_repr import short_repr
from nassim.bodies.remote_points import RemotePoint

SURFACE = "surface"
"""Name of the body's moving surface among its read-outs."""
SPARSE = 0.02
"""Share of entries that are not zero up to which products with a sparse matrix are faster."""


@runtime_checkable
class Readout(Protocol):
    """A linear function of a body's n coordinates with a unique name."""

    @property
    def name(self) -> str:
        """Name, unique among the body's read-outs."""
        ...

    @property
    def n_coordinates(self) -> int:
        """Number n of the coordinates that it reads."""
        ...

    def projected(self, change: Array) -> "Readout":
        """Return the same read-out for n' coordinates q', where q = change @ q', shape (n, n')."""
        ...


Kind = TypeVar("Kind")


def by_name(readouts: Iterable[Readout]) -> dict[str, Readout]:
    """Return read-outs as the mapping that a body takes.

    Raises:
        ValueError: if a name is used twice
    """
    found = tuple(readouts)
    return dict(zip(unique("read-out", (readout.name for readout in found)), found, strict=True))


def readouts_of(readouts: Mapping[str, Readout], kind: type[Kind]) -> tuple[Kind, ...]:
    """Return the read-outs of one class, in order."""
    return tuple(readout for readout in readouts.values() if isinstance(readout, kind))


@dataclass(frozen=True)
class Surface:
    """Outer surface as triangles, for images.

    Attributes:
        points: corners, shape (n_points, 3) [m]
        triangles: indices of points, shape (n_triangles, 3)
        edges: edges of the mesh as indices of points, shape (n_edges, 2)
        labels: per triangle, name of the remote point whose interface it belongs to, otherwise of the CAD body
    """

    points: Array
    triangles: NDArray[np.int64]
    edges: NDArray[np.int64]
    labels: tuple[str, ...]
    __repr__ = short_repr

    def __post_init__(self) -> None:
        triangles, edges = np.array(self.triangles, dtype=np.int64), np.array(self.edges, dtype=np.int64)
        triangles.setflags(write=False)
        edges.setflags(write=False)
        points = finite_array("surface: points", self.points, (None, 3))
        freeze(self, points=points, triangles=triangles, edges=edges, labels=tuple(self.labels))


@dataclass(frozen=True)
class Picture:
    """Surface of a body and its displacements.

    Attributes:
        surface: triangles of the surface
        modes: displacements of its points per unit of the coordinates, shape (n_points, 3, n)
    """

    surface: Surface
    modes: Array
    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze(self, modes=finite_array("surface: modes", self.modes, (len(self.surface.points), 3, None)))

    @property
    def name(self) -> str:
        """Always "surface", because a body has one surface."""
        return SURFACE

    @property
    def n_coordinates(self) -> int:
        """Number n of the body's coordinates."""
        return self.modes.shape[2]

    def projected(self, change: Array) -> "Picture":
        """Return the surface for n' coordinates q', where q = change @ q', shape (n, n')."""
        # One product: one per point takes ten times as long.
        rows = self.modes.reshape(-1, len(change)) @ sparse_if_faster(change)
        return replace(self, modes=rows.reshape(-1, 3, change.shape[1]))


@dataclass(frozen=True)
class PassivePoint:
    """A point that is not a coordinate of the body but moves with it.

    Attributes:
        point: the point and its position
        motions: motion (ux uy uz rx ry rz) per unit of the coordinates, shape (6, n)
    """

    point: RemotePoint
    motions: Array
    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze(self, motions=finite_array(f"passive point {self.name!r}: motions", self.motions, (6, None)))

    @property
    def name(self) -> str:
        """Name of the point."""
        return self.point.name

    @property
    def n_coordinates(self) -> int:
        """Number n of the body's coordinates."""
        return self.motions.shape[1]

    def projected(self, change: Array) -> "PassivePoint":
        """Return the point for n' coordinates q', where q = change @ q', shape (n, n')."""
        return replace(self, motions=self.motions @ change)


@dataclass(frozen=True)
class Trace:
    """Expansion to the coordinates of the original body, for a body that was made from it with fewer coordinates.

    Attributes:
        rows: coordinates of the original body per unit of this body's coordinates, shape (n_original, n)
    """

    rows: Array
    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze(self, rows=finite_array("trace: rows", self.rows, (None, None)))

    @property
    def name(self) -> str:
        """Always "trace", because a body has one original."""
        return "trace"

    @property
    def n_coordinates(self) -> int:
        """Number n of the body's coordinates."""
        return self.rows.shape[1]

    def projected(self, change: Array) -> "Trace":
        """Return the expansion for n' coordinates q', where q = change @ q', shape (n, n')."""
        return replace(self, rows=self.rows @ change)


@dataclass(frozen=True)
class BodyDamping:
    """Viscous damping of a body's deformation, such as that of the bodies and dampers of which it was made.

    Attributes:
        matrix: damping matrix of the coordinates, symmetric, zero for rigid motions, shape (n, n)
    """

    matrix: Array
    __repr__ = short_repr

    def __post_init__(self) -> None:
        matrix = finite_array("damping: matrix", self.matrix, (None, None))
        freeze(self, matrix=finite_array("damping: matrix", matrix, (len(matrix), len(matrix))))

    @property
    def name(self) -> str:
        """Always "damping", because a body has one."""
        return "damping"

    @property
    def n_coordinates(self) -> int:
        """Number n of the body's coordinates."""
        return len(self.matrix)

    def projected(self, change: Array) -> "BodyDamping":
        """Return the damping for n' coordinates q', where q = change @ q', shape (n, n')."""
        return replace(self, matrix=change.T @ self.matrix @ change)


def sparse_if_faster(change: Array) -> Any:
    """Return a matrix as a sparse one where that is faster, as where most coordinates stay as they are."""
    return sp.csr_array(change) if np.count_nonzero(change) < SPARSE * change.size else change


def upgrade_readouts(content: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the fields of a `ReducedBody` from files of nassim 0.1, in which five fields held the read-outs.

    These fields were surface, surface_modes (n_points, 3, n), ports, passive_points (s of them) and passive_motions
    (6 s, n). Content without them is returned unchanged.

    Args:
        content: fields by name
    """
    old = ("surface", "surface_modes", "ports", "passive_points", "passive_motions")
    kept = {name: value for name, value in content.items() if name not in old}
    if len(kept) == len(content):
        return kept
    surface, modes = content.get("surface"), content.get("surface_modes")
    surfaces = [] if surface is None or modes is None else [Picture(surface, modes)]
    points = content.get("passive_points") or ()
    motions = np.split(content["passive_motions"], len(points)) if points else []
    passive = [PassivePoint(point, block) for point, block in zip(points, motions, strict=True)]
    return {**kept, "readouts": by_name([*surfaces, *(content.get("ports") or ()), *passive])}
