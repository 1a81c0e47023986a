"""What there is to see: shapes, marks, modes and a motion. Pages and pictures are made of it, and of nothing else."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nassim.base.checks import Array, finite_array, freeze, frozen_mapping, instances, known, unique
from nassim.base.rigid_motion import proper_rotation
from nassim.bodies.readouts import Surface
from nassim.scene.motion import Motion

GREY = "#c9ccd1"
KINDS = {
    "remote point": "#c2185b",
    "joint": "#1f77b4",
    "spring": "#2ca02c",
    "actuator": "#d9480f",
    "sensor": "#7b2cbf",
}
"""Kinds of marks and their colours."""
SHARP = np.cos(np.radians(40.0))
"""Faces that meet at more than 40 degrees have an outline between them; chords of small holes come to 30."""
SMALL_TURN, SMALL_SHIFT = 0.02, 0.02
"""Largest turn [rad] and shift over the size of all of what counts as small motion, which may be shown magnified."""


@dataclass(frozen=True)
class Form:
    """What a body looks like in its own frame, at rest and moved. Bodies that are copies of each other share one.

    surface: its triangles; they may be none
    names: of points beside those of the surface, which move along; positions: theirs, shape (len(names), 3) [m]
    modes: displacements of the surface's points, then of the named ones, per unit of k coordinates,
        (n_points + len(names), 3, k); None: it does not deform
    """

    surface: Surface
    names: tuple[str, ...] = ()
    positions: Array = field(default_factory=lambda: np.zeros((0, 3)))
    modes: Array | None = None

    def __post_init__(self) -> None:
        names = unique("named point", self.names)
        freeze(self, names=names, positions=finite_array("positions", self.positions, (len(names), 3)))
        if self.modes is not None:
            freeze(self, modes=finite_array("modes of a form", self.modes, (len(self.points), 3, None)))

    @cached_property
    def points(self) -> Array:
        """All points, those of the surface and the named ones, (n, 3) [m]."""
        return np.vstack([self.surface.points.reshape(-1, 3), self.positions])

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the surface, that of the most triangles first."""
        return tuple(label for label, _ in Counter(self.surface.labels).most_common())

    @property
    def n_coordinates(self) -> int:
        """Number k of the coordinates that it deforms by."""
        return 0 if self.modes is None else self.modes.shape[2]

    def index(self, name: str) -> int:
        """Which of the points has a name; raises ValueError listing the names."""
        return len(self.surface.points) + self.names.index(known("point", name, self.names))

    @cached_property
    def outline(self) -> NDArray[np.int64]:
        """Where the surface ends, has a sharp edge or another label, as pairs of its points, (n, 2)."""
        return feature_edges(self.surface)


@dataclass(frozen=True)
class Shape:
    """A form somewhere in the world.

    name: what is told of it; position (3,) [m], rotation (3, 3): of its frame at rest, from its axes to the world's
    colors: of the surface's labels, as "#rrggbb"; others are grey. text: what else to tell
    """

    name: str
    form: Form
    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))
    colors: Mapping[str, str] = field(default_factory=dict)
    text: str = ""

    def __post_init__(self) -> None:
        freeze(
            self,
            position=finite_array(f"shape {self.name!r}: position", self.position, (3,)),
            rotation=proper_rotation(f"shape {self.name!r}: rotation", self.rotation),
            colors=frozen_mapping(self.colors),
        )

    @property
    def points(self) -> Array:
        """All points at rest in the world, (n, 3) [m]."""
        return self.form.points @ self.rotation.T + self.position


@dataclass(frozen=True)
class Mark:
    """Something without a surface: a remote point, a joint, a spring, what acts or measures.

    name, text: what is told of it; kind: one of `KINDS`
    ends: one or two points, (shape, name of a point of its form); two are joined by a line
    axes: directions in the world at rest, (n, 3), drawn at the last end
    frame: the shape that they turn with; "": none
    """

    name: str
    kind: str
    ends: tuple[tuple[str, str], ...]
    axes: Array = field(default_factory=lambda: np.zeros((0, 3)))
    frame: str = ""
    text: str = ""

    def __post_init__(self) -> None:
        known("kind of mark", self.kind, KINDS)
        if len(self.ends) not in (1, 2):
            raise ValueError(f"mark {self.name!r} must have one or two ends, got {len(self.ends)}")
        freeze(self, axes=finite_array(f"mark {self.name!r}: axes", self.axes, (None, 3)))


@dataclass(frozen=True)
class Mode:
    """A motion of shapes of which only the form counts, not the size.

    name: such as "mode 3: 720.7 Hz"; coordinates: of the shapes' forms, (k,) each, by shape; others rest
    """

    name: str
    coordinates: Mapping[str, Array]

    def __post_init__(self) -> None:
        arrays = {
            k: finite_array(f"{self.name}: coordinates of {k!r}", v, (None,)) for k, v in self.coordinates.items()
        }
        freeze(self, coordinates=frozen_mapping(arrays))


@dataclass(frozen=True)
class View:
    """All that a page or a picture shows.

    title: above it; shapes, marks: what stands there; modes: to choose from; motion: of the shapes, by their names, on
        the coordinates of their forms; a view has modes or a motion
    Raises ValueError for names that are unknown or not unique, and for coordinates that do not fit the forms.
    """

    title: str
    shapes: tuple[Shape, ...]
    marks: tuple[Mark, ...] = ()
    modes: tuple[Mode, ...] = ()
    motion: Motion | None = None

    def __post_init__(self) -> None:
        label = f"view {self.title!r}"
        shapes = instances(f"{label}: shapes", self.shapes, (Shape,))
        marks, modes = (
            instances(f"{label}: marks", self.marks, (Mark,)),
            instances(f"{label}: modes", self.modes, (Mode,)),
        )
        unique(f"{label}: shape", (shape.name for shape in shapes))
        unique(f"{label}: mode", (mode.name for mode in modes))
        freeze(self, shapes=shapes, marks=marks, modes=modes)
        if modes and self.motion is not None:
            raise ValueError(f"{label} has modes or a motion, not both: make two views")
        if not any(len(shape.form.points) for shape in shapes):
            raise ValueError(f"{label} has nothing to see: none of its shapes has a point")
        for mark in marks:
            for name, point in mark.ends:
                self.shape(name).form.index(point)
            if mark.frame:
                self.shape(mark.frame)
        moved = [mode.coordinates for mode in modes] + ([self.motion.coordinates] if self.motion else [])
        for coordinates in moved:
            for name, values in coordinates.items():
                given, wanted = values.shape[-1], self.shape(name).form.n_coordinates
                if given != wanted:
                    raise ValueError(f"{label}: shape {name!r} moves by {wanted} coordinates, got {given}")
        if self.motion is not None:
            for name in self.motion.positions:
                self.shape(name)

    def shape(self, name: str) -> Shape:
        """A shape by name; raises ValueError listing the names."""
        names = [shape.name for shape in self.shapes]
        return self.shapes[names.index(known("shape", name, names))]

    def mode(self, name: str) -> Mode:
        """A mode by name; raises ValueError listing the names."""
        names = [mode.name for mode in self.modes]
        return self.modes[names.index(known("mode", name, names))]

    @cached_property
    def bounds(self) -> Array:
        """Lowest and highest corner of everything at rest, (2, 3) [m]."""
        points = np.vstack([shape.points for shape in self.shapes])
        return np.array([points.min(axis=0), points.max(axis=0)])

    @property
    def size(self) -> float:
        """Diagonal of everything at rest [m]."""
        return float(np.linalg.norm(np.ptp(self.bounds, axis=0))) or 1.0

    def displacement(self, shape: str, *, mode: str | None = None, frame: int | None = None) -> Array:
        """How far all points of a shape are from where they rest, along the world's axes, (n, 3) [m].

        mode: by name, as large as its coordinates say; frame: index of a time of the motion
        """
        item = self.shape(shape)
        form, shift, turn = item.form, np.zeros(3), item.rotation
        coordinates = None
        if mode is not None:
            coordinates = self.mode(mode).coordinates.get(shape)
        elif frame is not None and self.motion is not None:
            if shape in self.motion.positions:
                shift = self.motion.positions[shape][frame] - item.position
                turn = self.motion.rotations[shape][frame]
            if shape in self.motion.coordinates:
                coordinates = self.motion.coordinates[shape][frame]
        moved = np.zeros_like(form.points) if coordinates is None else form.modes @ coordinates
        result: Array = shift + form.points @ (turn - item.rotation).T + moved @ turn.T
        return result

    def deformation(self, shape: str, frame: int) -> Array:
        """How far all points are from where the shape's frame carries them, along its axes, (n, 3) [m]."""
        form = self.shape(shape).form
        if self.motion is None or form.modes is None or shape not in self.motion.coordinates:
            return np.zeros_like(form.points)
        result: Array = form.modes @ self.motion.coordinates[shape][frame]
        return result

    @cached_property
    def small(self) -> bool:
        """Whether all shapes stay about where they start, so that the whole motion may be shown magnified."""
        if self.motion is None:
            return True
        for name, places in self.motion.positions.items():
            item = self.shape(name)
            turns = item.rotation.T @ self.motion.rotations[name]
            # |R - 1| in Frobenius' norm is sqrt(2) times the angle.
            angle = np.linalg.norm(turns - np.eye(3), axis=(1, 2)).max() / np.sqrt(2)
            if angle > SMALL_TURN or np.abs(places - item.position).max() > SMALL_SHIFT * self.size:
                return False
        return True


def feature_edges(surface: Surface) -> NDArray[np.int64]:
    """Edges of triangles that belong to one of them only, lie between two labels or are sharp, (n, 2)."""
    triangles = np.asarray(surface.triangles).reshape(-1, 3)
    corners = surface.points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    _, label = np.unique(np.array(surface.labels, dtype=str), return_inverse=True)
    sides = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(triangles)), 3)
    edges, which, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(which.ravel(), kind="stable")
    first = np.concatenate([[0], np.cumsum(count)[:-1]]).astype(int)
    drawn = count != 2
    a, b = owner[order[first[~drawn]]], owner[order[first[~drawn] + 1]]
    # Triangles need not all be wound the same way: either side of a face may be its outside.
    bend = np.abs(np.einsum("ij,ij->i", normals[a], normals[b]))
    drawn[~drawn] = (bend < SHARP) | (label[a] != label[b])
    return edges[drawn]
