"""What can be read out of a reduced body beside its coordinates: each kind one noun that every projection carries.

A new kind is a frozen dataclass with the three members of `Readout`; `ReducedBody.readouts` takes it as it is.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from nassim.base.checks import Array, finite_array, freeze, unique
from nassim.bodies.interface import RemotePoint

SURFACE = "surface"
"""Name of the picture among what a body reads out."""


@runtime_checkable
class Readout(Protocol):
    """A linear function of a body's n coordinates, with a name of its own."""

    @property
    def name(self) -> str:
        """What it is called among all that the body reads out."""

    @property
    def n_coordinates(self) -> int:
        """Number n of the coordinates that it reads."""

    def projected(self, change: Array) -> "Readout":
        """The same of n' coordinates q', where q = change @ q', shape (n, n')."""


Kind = TypeVar("Kind")


def by_name(readouts: Iterable[Readout]) -> dict[str, Readout]:
    """Read-outs as the mapping that a body takes; raises ValueError for a name used twice."""
    found = tuple(readouts)
    return dict(zip(unique("read-out", (readout.name for readout in found)), found, strict=True))


def of_kind(readouts: Mapping[str, Readout], kind: type[Kind]) -> tuple[Kind, ...]:
    """Those of one class, in order."""
    return tuple(readout for readout in readouts.values() if isinstance(readout, kind))


@dataclass(frozen=True)
class Surface:
    """The outer surface as triangles, for pictures.

    points: (n_points, 3) [m]; triangles: (n_triangles, 3) indices of points; edges: (n_edges, 2) of the mesh's edges
    labels: name of the CAD body or, on a remote point's interface, of the remote point, per triangle
    """

    points: Array
    triangles: NDArray[np.int64]
    edges: NDArray[np.int64]
    labels: tuple[str, ...]


@dataclass(frozen=True)
class Picture:
    """How a body's surface moves.

    surface: its triangles; modes: displacements of its points per unit of the coordinates, shape (n_points, 3, n)
    """

    surface: Surface
    modes: Array

    def __post_init__(self) -> None:
        freeze(self, modes=finite_array("picture: modes", self.modes, (len(self.surface.points), 3, None)))

    @property
    def name(self) -> str:
        """Always "surface": a body has one picture."""
        return SURFACE

    @property
    def n_coordinates(self) -> int:
        """Number n of the body's coordinates."""
        return self.modes.shape[2]

    def projected(self, change: Array) -> "Picture":
        """The picture in n' coordinates q', where q = change @ q', shape (n, n')."""
        return replace(self, modes=self.modes @ change)


@dataclass(frozen=True)
class PassivePoint:
    """A point that is no coordinate (any more) but moves along.

    point: where it lies; motions: its motion (ux uy uz rx ry rz) per unit of the coordinates, shape (6, n)
    """

    point: RemotePoint
    motions: Array

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
        """The point in n' coordinates q', where q = change @ q', shape (n, n')."""
        return replace(self, motions=self.motions @ change)


@dataclass(frozen=True)
class Trace:
    """What a body of fewer coordinates means for the one that it was made from.

    rows: coordinates of that per unit of the body's own, shape (n_original, n)
    """

    rows: Array

    def __post_init__(self) -> None:
        freeze(self, rows=finite_array("trace: rows", self.rows, (None, None)))

    @property
    def name(self) -> str:
        """Always "trace": a body has one."""
        return "trace"

    @property
    def n_coordinates(self) -> int:
        """Number n of the body's coordinates."""
        return self.rows.shape[1]

    def projected(self, change: Array) -> "Trace":
        """The trace in n' coordinates q', where q = change @ q', shape (n, n')."""
        return replace(self, rows=self.rows @ change)


def upgraded_readouts(content: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a `ReducedBody` as files of nassim 0.1 hold them, with one mapping in the place of five fields.

    These were: surface, surface_modes (n_points, 3, n), ports, passive_points (s of them), passive_motions (6 s, n).
    Content that has none of them is returned as it is.
    """
    old = ("surface", "surface_modes", "ports", "passive_points", "passive_motions")
    kept = {name: value for name, value in content.items() if name not in old}
    if len(kept) == len(content):
        return kept
    surface, modes = content.get("surface"), content.get("surface_modes")
    pictures = [] if surface is None or modes is None else [Picture(surface, modes)]
    points = content.get("passive_points") or ()
    motions = np.split(content["passive_motions"], len(points)) if points else []
    passive = [PassivePoint(point, block) for point, block in zip(points, motions, strict=True)]
    return {**kept, "readouts": by_name([*pictures, *(content.get("ports") or ()), *passive])}
