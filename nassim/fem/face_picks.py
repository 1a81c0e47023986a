"""Choice of CAD faces by what a person sees: where they are, how they are curved, their colour, name or number."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import netgen.occ as occ
import numpy as np

from nassim.base.checks import Array, finite_array, freeze, known, positive
from nassim.base.field_types import ArrayField, ArrayLike, OptionalArray, data_class, held
from nassim.base.rigid_motion import unit_vector
from nassim.base.short_repr import short_repr
from nassim.fem.faces import Face, list_faces, occ_faces

ON_PLANE = 1e-6
"""Largest distance of a face from the plane of a choice [m]."""
PARALLEL = 1e-3
"""Largest angle between parallel directions [rad], for directions that were typed in."""
SAME_RADIUS = 1e-3
"""Relative difference of radii that counts as zero, for radii that were typed in."""
SAME_AXIS = 1e-6
"""Largest distance between axes of faces on one cylinder [m], and relative difference of their radii."""
FULL_TURN = 0.05
"""Largest distance from its axis of the centre of a full turn of a cylinder, over the radius."""
MOST_LISTED = 30
"""Largest number of faces in a message."""


@data_class
class OnPlane:
    """Choice of the flat faces that lie in a plane.

    Attributes:
        point: point on the plane, shape (3,) [m]
        normal: normal of the plane, either way, shape (3,)
        several: accept more than one face
    """

    point: ArrayField
    normal: ArrayField
    several: bool = False
    kind: ClassVar[str] = "plane"
    __repr__ = short_repr

    def __post_init__(self) -> None:
        normal = finite_array("normal", self.normal, (3,))
        if not np.any(normal):
            raise ValueError("the normal of a plane must not be zero")
        normal = finite_array("normal", normal / np.linalg.norm(normal), (3,))
        freeze(self, point=finite_array("point", self.point, (3,)), normal=normal)

    def find(self, faces: Sequence[Face], shape_faces: Sequence[Any]) -> list[list[Face]]:
        """Return groups of faces, each of which counts as one."""
        return [
            [face]
            for face in faces
            if face.kind == "plane"
            and _parallel(face.normal, self.normal)
            and abs((face.centre - self.point) @ self.normal) < ON_PLANE
        ]


@data_class
class NearestTo:
    """Choice of the face nearest to a point.

    Attributes:
        point: the point, shape (3,) [m]
    """

    point: ArrayField
    several: ClassVar[bool] = False
    kind: ClassVar[str] = ""
    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze(self, point=finite_array("point", self.point, (3,)))

    def find(self, faces: Sequence[Face], shape_faces: Sequence[Any]) -> list[list[Face]]:
        """Return groups of faces, each of which counts as one."""
        return _nearest([[face] for face in faces], self.point, shape_faces)


@dataclass(frozen=True)
class Extreme:
    """Choice of the outermost flat face whose outward normal has a direction, such as the top of a part.

    A face between two CAD bodies is seen only by `OnBody`.

    Attributes:
        direction: "+x", "-x", "+y", "-y", "+z", "-z", or a vector of any length, shape (3,)
        several: accept more than one face in the outermost plane
    """

    direction: str | ArrayLike
    several: bool = False
    kind: ClassVar[str] = "plane"
    __repr__ = short_repr

    def __post_init__(self) -> None:
        if isinstance(self.direction, str):
            known("direction", self.direction, ("+x", "-x", "+y", "-y", "+z", "-z"))
        else:
            freeze(self, direction=unit_vector(self.direction))

    @property
    def vector(self) -> Array:
        """Unit vector along the direction, shape (3,)."""
        if isinstance(self.direction, str):
            return unit_vector(self.direction[1]) * (-1 if self.direction[0] == "-" else 1)
        return np.asarray(self.direction)

    def find(self, faces: Sequence[Face], shape_faces: Sequence[Any]) -> list[list[Face]]:
        """Return groups of faces, each of which counts as one."""
        along = self.vector
        facing = [f for f in faces if f.kind == "plane" and _parallel(f.normal, along) and f.normal @ along > 0]
        facing = [face for face in facing if len(face.bodies) == 1]
        heights = [face.centre @ along for face in facing]
        return [[face] for face, height in zip(facing, heights, strict=True) if height > max(heights) - ON_PLANE]


@data_class
class OnCylinder:
    """Choice of a cylindrical face: a hole, a shaft or a fillet.

    CAD programs cut a cylinder into faces. Faces on one cylinder that share an edge count as one.

    Attributes:
        radius: radius [m]; None for any
        near: take the cylinder nearest to this point, shape (3,) [m]; None for any place
        axis: direction of the axis, either way: "x", "y", "z" or a vector of shape (3,); None for any
        hole: True for holes, False for shafts (both of a full turn), None for any, also fillets
        several: accept more than one cylinder
    """

    radius: float | None = None
    near: OptionalArray = held(None)
    axis: str | ArrayLike | None = None
    hole: bool | None = None
    several: bool = False
    kind: ClassVar[str] = "cylinder"
    __repr__ = short_repr

    def __post_init__(self) -> None:
        if self.radius is not None:
            positive("radius", self.radius, "m")
        if self.axis is not None:
            unit_vector(self.axis)
        if self.near is not None:
            freeze(self, near=finite_array("near", self.near, (3,)))

    def find(self, faces: Sequence[Face], shape_faces: Sequence[Any]) -> list[list[Face]]:
        """Return groups of faces, each of which counts as one."""
        found = _joined_cylinders([face for face in faces if face.kind == "cylinder"], shape_faces)
        found = [group for group in found if self._fits(group)]
        return found if self.near is None or not found else _nearest(found, self.near, shape_faces)

    def _fits(self, group: Sequence[Face]) -> bool:
        face, radius = group[0], group[0].radius or 0.0
        return (
            (self.radius is None or abs(radius / self.radius - 1) < SAME_RADIUS)
            and (self.axis is None or _parallel(_axis(face)[1], unit_vector(self.axis)))
            and (self.hole is None or (face.hollow is self.hole and _turns_fully(group)))
        )


@dataclass(frozen=True)
class OfColour:
    """Choice of all faces of a colour.

    Attributes:
        colour: colour as "#rrggbb", as the CAD shows it
    """

    colour: str
    several: ClassVar[bool] = True
    kind: ClassVar[str] = ""
    __repr__ = short_repr

    def __post_init__(self) -> None:
        if not re.fullmatch("#[0-9a-fA-F]{6}", self.colour):
            raise ValueError(f'a colour must be of the form "#rrggbb", such as "#ff0000" for red, got {self.colour!r}')

    def find(self, faces: Sequence[Face], shape_faces: Sequence[Any]) -> list[list[Face]]:
        """Return groups of faces, each of which counts as one."""
        return [[face] for face in faces if _same_colour(face.colour, self.colour)]


@dataclass(frozen=True)
class OnBody:
    """Choice among the faces of one CAD body, also those that it shares with others.

    Attributes:
        body: name of the CAD body; "*" stands for any text, "?" for one character
        pick: choice among its faces
    """

    body: str
    pick: "FacePick"
    several: ClassVar[bool] = True
    kind: ClassVar[str] = ""
    __repr__ = short_repr

    def find(self, faces: Sequence[Face], shape_faces: Sequence[Any]) -> list[list[Face]]:
        """Return groups of faces, each of which counts as one."""
        names = dict.fromkeys(body for face in faces for body in face.bodies)
        bodies = matching(self.body, names)
        if not bodies:
            raise ValueError(f"{self} finds no CAD body; there are {', '.join(map(repr, names))}")
        return [
            [face]
            for body in bodies
            for face in _choose(self.pick, [face.seen_from(body) for face in faces if body in face.bodies], shape_faces)
        ]


@dataclass(frozen=True)
class _Named:
    """Choice of all faces of a name."""

    name: str
    several: ClassVar[bool] = True
    kind: ClassVar[str] = ""

    def find(self, faces: Sequence[Face], shape_faces: Sequence[Any]) -> list[list[Face]]:
        """Return groups of faces, each of which counts as one."""
        names = matching(self.name, {face.name for face in faces if face.name})
        return [[face] for face in faces if face.name in names]

    def __str__(self) -> str:
        return f"name {self.name!r}"


@dataclass(frozen=True)
class _Numbered:
    """Choice of the face of a number."""

    number: int
    several: ClassVar[bool] = False
    kind: ClassVar[str] = ""

    def find(self, faces: Sequence[Face], shape_faces: Sequence[Any]) -> list[list[Face]]:
        """Return groups of faces, each of which counts as one."""
        return [[face] for face in faces if face.number == self.number]

    def __str__(self) -> str:
        return f"number {self.number}"


FacePick = OnPlane | NearestTo | Extreme | OnCylinder | OfColour | OnBody | str | int
"""Choice of faces; a text is a name of the CAD with "*" and "?", a number one of `face_table`."""


def name_faces(shape: Any, faces: Mapping[str, FacePick | Sequence[FacePick]]) -> None:
    """Give faces of a shape names.

    Args:
        shape: OpenCASCADE shape in metres, such as the result of `glue`
        faces: new name -> choice of faces, or several choices whose faces get this name

    Raises:
        ValueError: if a choice finds no face or too many, with a list of faces, and if two names choose one face
    """
    listed, items = list_faces(shape), occ_faces(shape)
    owner: dict[int, str] = {}
    for name, picks in faces.items():
        for pick in picks if isinstance(picks, Sequence) and not isinstance(picks, str) else (picks,):
            try:
                found = _choose(pick, listed, items)
            except ValueError as error:
                raise ValueError(f"face {name!r}: {error}") from error
            for face in found:
                if owner.setdefault(face.number, name) != name:
                    raise ValueError(f"faces {owner[face.number]!r} and {name!r} are both {face}")
    for number, name in owner.items():
        items[number - 1].name = name


def matching(pattern: str, names: Iterable[str]) -> list[str]:
    """Return the names that a pattern describes: the name itself, otherwise all that fit its "*" and "?".

    Args:
        pattern: name or pattern
        names: names
    """
    names = list(names)
    if pattern in names or not re.search("[*?]", pattern):
        return [name for name in names if name == pattern]
    expression = re.escape(pattern).replace(r"\*", ".*").replace(r"\?", ".")
    return [name for name in names if re.fullmatch(expression, name, re.DOTALL)]


def _choose(pick: FacePick, faces: Sequence[Face], shape_faces: Sequence[Any]) -> list[Face]:
    """Return the faces of a choice; raise ValueError if there are none or too many.

    Args:
        pick: the choice
        faces: faces from which it chooses
        shape_faces: all OpenCASCADE faces of the shape, in the order of their numbers
    """
    choice = _Named(pick) if isinstance(pick, str) else _Numbered(pick) if isinstance(pick, int) else pick
    found = choice.find(faces, shape_faces)
    chosen = [face for group in found for face in group]
    if found and (choice.several or len(found) == 1):
        return chosen
    shown = chosen or [face for face in faces if choice.kind in ("", face.kind)] or list(faces)
    listing = "".join(f"\n  {face}" for face in shown[:MOST_LISTED])
    if len(shown) > MOST_LISTED:
        listing += f"\n  and {len(shown) - MOST_LISTED} more: see face_table"
    problem = f"finds {len(found)} faces, one is wanted. Found" if found else "finds no face. The solid has"
    raise ValueError(f"{choice} {problem}:{listing}")


def _nearest(groups: Sequence[list[Face]], point: ArrayLike, shape_faces: Sequence[Any]) -> list[list[Face]]:
    """Return the groups of faces nearest to a point."""
    vertex = occ.Vertex(occ.Pnt(*np.asarray(point, dtype=float).tolist()))
    distances = [min(shape_faces[face.number - 1].Distance(vertex) for face in group) for group in groups]
    return [group for group, d in zip(groups, distances, strict=True) if d <= min(distances) + 1e-9]


def _joined_cylinders(faces: Sequence[Face], shape_faces: Sequence[Any]) -> list[list[Face]]:
    """Return groups of faces that are on one cylinder and share edges."""
    edges = {face.number: set(shape_faces[face.number - 1].edges) for face in faces}
    groups: list[list[Face]] = []
    for face in faces:
        joined = [g for g in groups if any(edges[face.number] & edges[f.number] and _one_cylinder(face, f) for f in g)]
        groups = [g for g in groups if g not in joined] + [[f for g in joined for f in g] + [face]]
    return groups


def _one_cylinder(a: Face, b: Face) -> bool:
    """Return whether two cylindrical faces have the same axis and radius and are on the same side of it."""
    (origin, along), (other, direction) = _axis(a), _axis(b)
    offset = (other - origin) - ((other - origin) @ along) * along
    assert a.radius is not None
    assert b.radius is not None
    return bool(
        a.hollow == b.hollow
        and np.linalg.norm(np.cross(along, direction)) < SAME_AXIS
        and np.linalg.norm(offset) < SAME_AXIS
        and abs(b.radius / a.radius - 1) < SAME_AXIS
    )


def _turns_fully(group: Sequence[Face]) -> bool:
    """Return whether faces on one cylinder surround its axis, so that their centre is on it."""
    origin, along = _axis(group[0])
    areas = np.array([face.area for face in group])
    offset = areas @ np.array([face.centre for face in group]) / areas.sum() - origin
    return bool(np.linalg.norm(offset - (offset @ along) * along) < FULL_TURN * (group[0].radius or 0.0))


def _axis(face: Face) -> Array:
    assert face.axis is not None
    return face.axis


def _parallel(a: Array, b: Array) -> bool:
    return bool(np.linalg.norm(np.cross(a, b)) < PARALLEL)


def _same_colour(a: str, b: str) -> bool:
    """Return whether colours differ by rounding only."""
    return bool(a) and all(abs(int(a[k : k + 2], 16) - int(b[k : k + 2], 16)) <= 1 for k in (1, 3, 5))
