"""Solids: CAD objects that consist of named CAD bodies, with named faces, materials and remote points."""

import itertools
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import netgen.occ as occ
import numpy as np
from numpy.typing import ArrayLike

from nassim.base.checks import Array, finite_array, freeze, frozen_mapping, known, unique
from nassim.base.library_lock import hold_library_lock
from nassim.base.warning_log import warn
from nassim.bodies.interface import RemotePoint
from nassim.bodies.piezo import ElectricalPort
from nassim.bodies.readouts import SURFACE
from nassim.fem.materials import Material

CAD_ENDINGS = {".step": ".step", ".stp": ".step", ".iges": ".iges", ".igs": ".iges", ".brep": ".brep"}
CAD_UNITS = {"m": 1.0, "mm": 1e-3, "inch": 0.0254}
SHORTEST_SOLID = 1e-6
"""Smallest length of a solid [m]. OpenCASCADE merges points within 1e-7."""
LONG_SOLID = 10.0
"""Length of a solid from which its CAD was probably drawn in millimetres [m]."""
OVERLAP = 1e-4
"""Share of the smaller CAD body's volume above which two CAD bodies overlap and do not only touch."""


@dataclass(frozen=True)
class Solid:
    """A CAD object: an OpenCASCADE shape in metres with one or several named CAD bodies and named faces.

    Make a shape of several CAD bodies by `glue`. OpenCASCADE's own gluing assigns an overlap to the first CAD body
    without a message.

    Attributes:
        name: name in files and reports
        shape: OpenCASCADE shape of one or several CAD bodies that touch [m]
        materials: materials by name of the CAD body
        remote_points: remote points; may be empty if only eigenmodes are needed
        ports: electrical ports of its piezoelectric CAD bodies

    Raises:
        ValueError: for a CAD body without material, an unknown face or CAD body, a face of two remote points, a CAD
            body of two ports, a name of both a point and a port ("surface" is reserved), CAD bodies that overlap, and a
            shape below 1e-6 m

    Warns:
        UserWarning: for a shape of 10 m or more
    """

    name: str
    shape: Any
    materials: Mapping[str, Material]
    remote_points: tuple[RemotePoint, ...] = field(default=())
    ports: tuple[ElectricalPort, ...] = ()

    def __post_init__(self) -> None:
        points = tuple(self.remote_points)
        unique("remote point", (p.name for p in points))
        bodies = body_names(self.shape)
        for body in bodies:
            if body not in self.materials:
                raise ValueError(
                    f"solid {self.name!r}: CAD body {body!r} has no material; "
                    f"given: {', '.join(self.materials) or 'none'}"
                )
        faces = face_names(self.shape)
        owner: dict[str, str] = {}
        for point in points:
            if not point.faces:
                raise ValueError(f"remote point {point.name!r} has no faces; known faces: {', '.join(faces) or 'none'}")
            for face in point.faces:
                known("face", face, faces)
                if face in owner:
                    raise ValueError(
                        f"remote points {owner[face]!r} and {point.name!r} both claim the face {face!r}; "
                        "a face belongs to one remote point"
                    )
                owner[face] = point.name
        ports = tuple(self.ports)
        unique("electrical port", (port.name for port in ports))
        # A reduced body has read-outs with these names and its surface.
        named = (SURFACE, *(point.name for point in points), *(port.name for port in ports))
        unique(f"solid {self.name!r}: remote point, electrical port and surface ({SURFACE!r})", named)
        for body in unique("CAD body of electrical port", (body for port in ports for body in port.bodies)):
            known("CAD body", body, bodies)
        with hold_library_lock(forkable=True):
            _refuse_overlaps(self.name, list(self.shape.solids))
        _check_size(self.name, self.shape)
        freeze(self, materials=frozen_mapping(self.materials), remote_points=points, ports=ports)


@dataclass(frozen=True)
class OnPlane:
    """Choice of the flat faces that lie in a plane.

    Attributes:
        point: point on the plane, shape (3,) [m]
        normal: normal of the plane, shape (3,)
        several: accept more than one face
    """

    point: Array
    normal: Array
    several: bool = False

    def __post_init__(self) -> None:
        normal = finite_array("normal", self.normal, (3,))
        if not np.any(normal):
            raise ValueError("the normal of a plane must not be zero")
        freeze(self, point=finite_array("point", self.point, (3,)), normal=normal / np.linalg.norm(normal))


@dataclass(frozen=True)
class NearestTo:
    """Choice of the face nearest to a point.

    Attributes:
        point: the point, shape (3,) [m]
    """

    point: Array

    def __post_init__(self) -> None:
        freeze(self, point=finite_array("point", self.point, (3,)))


FacePick = OnPlane | NearestTo | str


def read_solid(
    path: str | Path,
    materials: Material | Mapping[str, Material],
    *,
    faces: Mapping[str, FacePick] | None = None,
    remote_points: tuple[RemotePoint, ...] = (),
    unit: str = "mm",
    name: str | None = None,
) -> Solid:
    """Read a solid from a STEP, IGES or BREP file (endings in any letter case).

    Args:
        path: of the file
        materials: one material for all CAD bodies, or materials by name (CAD bodies without a name become "body 1",
            "body 2", ...)
        faces: new face name -> `OnPlane`, `NearestTo` or the name of the face in the file
        remote_points: as in `Solid`; they use the names given in `faces`
        unit: length of one coordinate unit after reading. OpenCASCADE converts STEP and IGES to "mm" from any declared
            unit. Other values are for BREP files, which declare none, and for wrong declarations.
        name: name of the solid (default: that of the file)

    Raises:
        FileNotFoundError: if there is no such file
        ValueError: if the file cannot be read, or a choice of faces finds none or too many (the message lists the
            faces)
    """
    source = Path(path)
    with hold_library_lock(forkable=True):
        shape = _read_shape(source).Scale(occ.Pnt(0, 0, 0), CAD_UNITS[known("unit", unit, CAD_UNITS)])
        if len(shape.solids) == 0:
            raise ValueError(f"{source} holds no CAD body, only surfaces or curves; export solids")
        for index, body in enumerate(shape.solids, start=1):
            body.name = body.name or f"body {index}"
        if len(shape.solids) > 1:
            shape = glue(list(shape.solids), name=name or source.stem)
        for face_name, pick in (faces or {}).items():
            name_faces(shape, face_name, pick)
        if isinstance(materials, Material):
            materials = dict.fromkeys(body_names(shape), materials)
        return Solid(name or source.stem, shape, materials, remote_points)


def glue(bodies: Sequence[Any], *, name: str = "") -> Any:
    """Join CAD bodies that touch into one shape, in which they share their common faces.

    Args:
        bodies: the CAD bodies
        name: name of the solid, for messages

    Raises:
        ValueError: if CAD bodies overlap, because the material of the overlap is unknown
    """
    _refuse_overlaps(name, bodies)
    return occ.Glue(list(bodies))


def _refuse_overlaps(name: str, bodies: Sequence[Any]) -> None:
    """Raise ValueError for CAD bodies that overlap."""
    boxes = [np.array([tuple(corner) for corner in body.bounding_box]) for body in bodies]
    for (i, a), (j, b) in itertools.combinations(enumerate(bodies), 2):
        apart = np.any((boxes[i][0] >= boxes[j][1]) | (boxes[j][0] >= boxes[i][1]))
        shared = 0.0 if apart else (a * b).mass
        smaller = min(a.mass, b.mass)
        if shared > OVERLAP * smaller:
            raise ValueError(
                f"solid {name!r}: CAD bodies {a.name or ''!r} and {b.name or ''!r} share "
                f"{100 * shared / smaller:.2g} % of the smaller one's volume, so its material there is "
                "unknown: cut one by the other in the CAD"
            )


def _check_size(name: str, shape: Any) -> None:
    """Check that the length of a shape is plausible in metres."""
    size = np.ptp(np.array([tuple(corner) for corner in shape.bounding_box]), axis=0).max()
    if not SHORTEST_SOLID < size < np.inf:
        raise ValueError(
            f"solid {name!r} is {size:g} m long; at least {SHORTEST_SOLID:g} m is needed, and shapes are in metres: "
            "check the CAD file's unit"
        )
    if size >= LONG_SOLID:
        warn(
            f"solid {name!r} is {size:g} m long; shapes are in metres: check the CAD file's unit if that is too long",
            stacklevel=4,
        )


def name_faces(shape: Any, name: str, pick: FacePick) -> None:
    """Give the chosen face of a shape [m] a name.

    Args:
        shape: OpenCASCADE shape
        name: new name
        pick: choice of the face

    Raises:
        ValueError: if the choice fails; the message lists the faces
    """
    chosen = _pick(shape, name, pick)
    for face in shape.faces:
        # A face between two CAD bodies is listed once for each side; both entries need the name.
        if any(_same_place(face, other) for other in chosen):
            face.name = name


def body_names(shape: Any) -> tuple[str, ...]:
    """Return the names of a shape's CAD bodies, in order; a CAD body without a name has the name ''."""
    return tuple(dict.fromkeys(body.name or "" for body in shape.solids))


def face_names(shape: Any) -> tuple[str, ...]:
    """Return the names of a shape's named faces, in order."""
    return tuple(dict.fromkeys(face.name for face in shape.faces if face.name))


def shape_bytes(shape: Any) -> bytes:
    """Return the shape as BREP text with the names of its CAD bodies and faces, for a cache key."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "shape.brep"
        shape.WriteBrep(str(file))
        names = [body.name or "" for body in shape.solids] + [face.name or "" for face in shape.faces]
        return file.read_bytes() + "\n".join(names).encode()


def _read_shape(source: Path) -> Any:
    """Read a CAD file."""
    ending = CAD_ENDINGS.get(source.suffix.lower())
    if ending is None:
        raise ValueError(f"{source}: unknown ending {source.suffix!r}; known: {', '.join(CAD_ENDINGS)}")
    if not source.is_file():
        raise FileNotFoundError(f"no such CAD file: {source}")
    with tempfile.TemporaryDirectory() as folder:
        # OpenCASCADE's readers accept only endings in lower case.
        copy = Path(folder) / f"shape{ending}"
        copy.write_bytes(source.read_bytes())
        try:
            return occ.OCCGeometry(str(copy)).shape
        except Exception as error:
            raise ValueError(f"{source} is not a readable {ending[1:].upper()} file: {error}") from error


def _pick(shape: Any, name: str, pick: FacePick) -> list[Any]:
    """Return the faces of a choice."""
    faces = list(shape.faces)
    if isinstance(pick, str):
        found = [face for face in faces if face.name == pick]
        several = True
    elif isinstance(pick, OnPlane):
        found = [face for face in faces if _lies_on(face, pick)]
        several = pick.several
    else:
        vertex = occ.Vertex(occ.Pnt(*map(float, pick.point)))
        distances = np.array([face.Distance(vertex) for face in faces])
        found = [face for face, distance in zip(faces, distances, strict=True) if distance <= distances.min() + 1e-9]
        several = False
    found = [f for i, f in enumerate(found) if not any(_same_place(f, other) for other in found[:i])]
    if found and (several or len(found) == 1):
        return found
    problem = "finds no face" if not found else f"finds {len(found)} faces, one is wanted"
    listing = "\n".join(f"  {_describe(face)}" for face in (found or faces))
    raise ValueError(f"face {name!r}: {pick} {problem}. {'Found' if found else 'The solid has'}:\n{listing}")


def _lies_on(face: Any, plane: OnPlane) -> bool:
    """Return whether a face is in a plane: centre on the plane, no variance of the area along the normal."""
    inertia = np.array([[face.inertia[i, j] for j in range(3)] for i in range(3)])
    spread = 0.5 * np.trace(inertia) - plane.normal @ inertia @ plane.normal
    offset = (np.array(tuple(face.center)) - plane.point) @ plane.normal
    return bool(abs(offset) < 1e-7 and np.sqrt(max(spread, 0.0) / face.mass) < 1e-7)


def _same_place(face: Any, other: Any) -> bool:
    """Return whether two faces are in the same place."""
    distance: ArrayLike = np.array(tuple(face.center)) - np.array(tuple(other.center))
    return bool(np.linalg.norm(distance) < 1e-9 and abs(face.mass - other.mass) < 1e-9 * abs(face.mass))


def _describe(face: Any) -> str:
    """Return a line of text about a face."""
    x, y, z = (1e3 * c for c in tuple(face.center))
    label = f", named {face.name!r}" if face.name else ""
    return f"{1e6 * face.mass:.4g} mm2 around ({x:.4g}, {y:.4g}, {z:.4g}) mm{label}"
