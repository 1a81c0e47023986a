"""Content of a page or picture: shapes, marks, modes and a motion."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nassim.base.checks import Array, finite_array, freeze, instances, known, positive, unique
from nassim.base.html_repr import html_repr
from nassim.base.rigid_motion import proper_rotation
from nassim.base.short_repr import short_repr
from nassim.bodies.readouts import Surface
from nassim.scene.motion import Motion

GREY = "#c9ccd1"
MARK_COLORS = {
    "remote point": "#c2185b",
    "joint": "#1f77b4",
    "spring": "#2ca02c",
    "actuator": "#d9480f",
    "sensor": "#7b2cbf",
    "face": "#37474f",
}
"""Colours of marks by kind."""
SHARP = np.cos(np.radians(40.0))
"""Cosine of the angle between faces above which an edge is part of the outline.

The angle is 40 degrees, because chords of small holes have up to 30.
"""
SMALL_TURN, SMALL_SHIFT = 0.02, 0.02
"""Largest rotation [rad], and largest translation over the size of the view, of small motion."""
MOST_STEPS = 10
"""Largest number of steps of a legend."""
SAME_TICK = 1e-9
"""Relative difference up to which a value is a tick."""


@dataclass(frozen=True)
class Form:
    """Appearance of a body in its own frame, at rest and deformed. Copies of a body share one form.

    Attributes:
        surface: triangles, possibly none.
        names: names of points in addition to those of the surface, which move with the form.
        positions: positions of the named points, (len(names), 3) [m].
        modes: displacements of the surface points, then of the named points, per unit of k coordinates, (n_points +
            len(names), 3, k); None for a form that does not deform.
    """

    surface: Surface
    names: tuple[str, ...] = ()
    positions: Array = field(default_factory=lambda: np.zeros((0, 3)))
    modes: Array | None = None
    __repr__ = short_repr

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
        """Labels of the surface, that with the most triangles first."""
        return tuple(label for label, _ in Counter(self.surface.labels).most_common())

    @property
    def n_coordinates(self) -> int:
        """Number k of coordinates of the deformation."""
        return 0 if self.modes is None else self.modes.shape[2]

    def index(self, name: str) -> int:
        """Return the index of a named point; raise ValueError with the list of names for an unknown one.

        Args:
            name: name of the point.
        """
        return len(self.surface.points) + self.names.index(known("point", name, self.names))

    @cached_property
    def outline(self) -> NDArray[np.int64]:
        """Edges at the border of the surface, sharp edges, and edges between labels, as pairs of points, (n, 2)."""
        return feature_edges(self.surface)


@dataclass(frozen=True)
class Coloring:
    """Quantity on a surface at the images of a motion, shown as colours.

    Attributes:
        quantity: name and unit, such as "von Mises stress [MPa]".
        values: its values at the points of the surface, not negative, (n_images, n_points).
        largest: value at the upper end of the colours; what is above has the last colour.
    """

    quantity: str
    values: Array
    largest: float

    __repr__ = short_repr

    def __post_init__(self) -> None:
        label = f"colouring by {self.quantity!r}"
        values = finite_array(f"{label}: values", self.values, (None, None))
        if values.min(initial=0.0) < 0:
            raise ValueError(f"{label}: values must not be negative, got {values.min():g}")
        freeze(self, values=values, largest=positive(f"{label}: largest", self.largest))

    @property
    def ticks(self) -> tuple[float, ...]:
        """Values for a legend, evenly spaced from 0 to the largest: round ones where that is a round one."""
        step = round_step(self.largest)
        n = round(self.largest / step)
        if abs(n * step / self.largest - 1) > SAME_TICK:
            step, n = self.largest / 4, 4
        return tuple(float(f"{k * step:.6g}") for k in range(n + 1))


def round_step(largest: float) -> float:
    """Return the smallest of the steps 1, 2 and 5 times a power of ten that divides a range into at most ten.

    Args:
        largest: the end of the range from 0, positive.
    """
    power = 10.0 ** np.floor(np.log10(largest / MOST_STEPS))
    return float(next(k * power for k in (1, 2, 5, 10) if k * power * MOST_STEPS >= (1 - SAME_TICK) * largest))


@dataclass(frozen=True)
class Shape:
    """Form at a place in the world.

    Attributes:
        name: name for the user.
        form: the form.
        position: position of its frame at rest, (3,) [m].
        rotation: rotation at rest from the axes of the form to those of the world, (3, 3).
        colors: colours of the labels of the surface, as "#rrggbb"; other labels are grey.
        text: further description for the user.
        coloring: quantity that its colours show in a motion, in place of displacements; all of a view have one quantity
            and largest value.
    """

    name: str
    form: Form
    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))
    colors: Mapping[str, str] = field(default_factory=dict)
    text: str = ""
    coloring: Coloring | None = None
    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze(
            self,
            position=finite_array(f"shape {self.name!r}: position", self.position, (3,)),
            rotation=proper_rotation(f"shape {self.name!r}: rotation", self.rotation),
            colors=self.colors,
        )

    @property
    def points(self) -> Array:
        """All points at rest in the world, (n, 3) [m]."""
        return self.form.points @ self.rotation.T + self.position


@dataclass(frozen=True)
class Mark:
    """Mark of a part without a surface (a remote point, a joint, a spring, an actuator, a sensor), or of a CAD face.

    Attributes:
        name: name for the user.
        kind: one of `MARK_COLORS`.
        ends: one or two points, as (shape, name of a point of its form); a line connects two points.
        axes: directions in the world at rest, shown at the last end, (n, 3).
        frame: shape with which the directions rotate; "" for none.
        text: further description for the user.
    """

    name: str
    kind: str
    ends: tuple[tuple[str, str], ...]
    axes: Array = field(default_factory=lambda: np.zeros((0, 3)))
    frame: str = ""
    text: str = ""
    __repr__ = short_repr

    def __post_init__(self) -> None:
        known("kind of mark", self.kind, MARK_COLORS)
        if len(self.ends) not in (1, 2):
            raise ValueError(f"mark {self.name!r} must have one or two ends, got {len(self.ends)}")
        freeze(self, axes=finite_array(f"mark {self.name!r}: axes", self.axes, (None, 3)))


@dataclass(frozen=True)
class Mode:
    """Mode shape with arbitrary amplitude.

    Attributes:
        name: name, such as "mode 3: 720.7 Hz".
        coordinates: coordinates of the forms by shape, (k,) each; other shapes do not move.
        rigid: True for a rigid-body mode; pages open on the first other mode.
        text: what pages say of it, such as the estimated errors of its frequency.
    """

    name: str
    coordinates: Mapping[str, Array]
    rigid: bool = False
    text: str = ""
    __repr__ = short_repr

    def __post_init__(self) -> None:
        arrays = {
            k: finite_array(f"{self.name}: coordinates of {k!r}", v, (None,)) for k, v in self.coordinates.items()
        }
        freeze(self, coordinates=arrays)


@dataclass(frozen=True)
class View:
    """Content of a page or picture.

    Attributes:
        title: title.
        shapes: shapes.
        marks: marks.
        modes: modes to choose from; a view has either modes or a motion.
        motion: motion of the shapes by name, in the coordinates of their forms.

    Raises:
        ValueError: for names that are unknown or not unique, and for coordinates that do not fit the forms.
    """

    title: str
    shapes: tuple[Shape, ...]
    marks: tuple[Mark, ...] = ()
    modes: tuple[Mode, ...] = ()
    motion: Motion | None = None
    __repr__ = short_repr
    _repr_html_ = html_repr

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
            raise ValueError(f"{label} is empty: none of its shapes has a point")
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
        _check_colorings(label, shapes, len(self.motion.time) if self.motion else 0)

    def shape(self, name: str) -> Shape:
        """Return a shape by name; raise ValueError with the list of names for an unknown one.

        Args:
            name: name of the shape.
        """
        names = [shape.name for shape in self.shapes]
        return self.shapes[names.index(known("shape", name, names))]

    def mode(self, name: str) -> Mode:
        """Return a mode by name; raise ValueError with the list of names for an unknown one.

        Args:
            name: name of the mode.
        """
        names = [mode.name for mode in self.modes]
        return self.modes[names.index(known("mode", name, names))]

    @cached_property
    def bounds(self) -> Array:
        """Lowest and highest corner of the view at rest, (2, 3) [m]."""
        points = np.vstack([shape.points for shape in self.shapes])
        return np.array([points.min(axis=0), points.max(axis=0)])

    @property
    def size(self) -> float:
        """Diagonal of the view at rest [m]."""
        return float(np.linalg.norm(np.ptp(self.bounds, axis=0))) or 1.0

    def displacement(self, shape: str, *, mode: str | None = None, frame: int | None = None) -> Array:
        """Return the displacements of all points of a shape from rest, along the world's axes.

        Args:
            shape: name of the shape.
            mode: name of a mode, with the amplitude of its coordinates.
            frame: index of an image of the motion.

        Returns:
            Displacements, (n, 3) [m].
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
        moved = np.zeros_like(form.points) if coordinates is None or form.modes is None else form.modes @ coordinates
        return shift + form.points @ (turn - item.rotation).T + moved @ turn.T

    def deformation(self, shape: str, frame: int) -> Array:
        """Return the displacements of all points relative to the frame of a shape, along its axes.

        Args:
            shape: name of the shape.
            frame: index of an image of the motion.

        Returns:
            Displacements, (n, 3) [m].
        """
        form = self.shape(shape).form
        if self.motion is None or form.modes is None or shape not in self.motion.coordinates:
            return np.zeros_like(form.points)
        return form.modes @ self.motion.coordinates[shape][frame]

    @cached_property
    def small(self) -> bool:
        """Whether all shapes stay near their initial positions, so that the whole motion can be magnified."""
        if self.motion is None:
            return True
        for name, places in self.motion.positions.items():
            item = self.shape(name)
            turns = item.rotation.T @ self.motion.rotations[name]
            # The Frobenius norm of R - 1 is sqrt(2) times the angle.
            angle = np.linalg.norm(turns - np.eye(3), axis=(1, 2)).max() / np.sqrt(2)
            if angle > SMALL_TURN or np.abs(places - item.position).max() > SMALL_SHIFT * self.size:
                return False
        return True


def _check_colorings(label: str, shapes: tuple[Shape, ...], n_images: int) -> None:
    """Check that colourings fit the surfaces and the images of a motion, and that all have one scale."""
    scales = set()
    for shape in shapes:
        if shape.coloring is not None:
            wanted, given = (n_images, len(shape.form.surface.points)), shape.coloring.values.shape
            if given != wanted:
                raise ValueError(
                    f"{label}: the colouring of shape {shape.name!r} needs values for every image of a motion and "
                    f"every point of the surface, {wanted}, got {given}"
                )
            scales.add((shape.coloring.quantity, shape.coloring.largest))
    if len(scales) > 1:
        raise ValueError(f"{label}: all colourings must have one quantity and one largest value")


def feature_edges(surface: Surface) -> NDArray[np.int64]:
    """Return the edges that belong to one triangle only, separate two labels or are sharp.

    Args:
        surface: the surface.

    Returns:
        Indices of the ends of the edges, (n, 2).
    """
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
    outlined = count != 2
    a, b = owner[order[first[~outlined]]], owner[order[first[~outlined] + 1]]
    # The order of corners need not be consistent, so that either side of a triangle may be its outside.
    bend = np.abs(np.einsum("ij,ij->i", normals[a], normals[b]))
    outlined[~outlined] = (bend < SHARP) | (label[a] != label[b])
    return edges[outlined]
