"""Solids: CAD objects that consist of named CAD bodies, with named faces, materials and remote points."""

import itertools
import re
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import netgen.occ as occ
import numpy as np

from nassim.base.checks import freeze, instances, known, of_kind, positive, unique
from nassim.base.field_types import Array, Field, data_class, held
from nassim.base.library_lock import hold_library_lock
from nassim.base.short_repr import short_repr
from nassim.base.warning_log import warn
from nassim.bodies.piezo import ElectricalPort
from nassim.bodies.readouts import SURFACE
from nassim.bodies.remote_points import RemotePoint
from nassim.fem.cad_files import millimetres, open_edges, read_bodies, warn_of_tiny_features, warn_without_unit
from nassim.fem.face_picks import FacePick, matching, name_faces
from nassim.fem.materials import Material

CAD_UNITS = {"m": 1.0, "mm": 1e-3, "inch": 0.0254}
SHORTEST_SOLID = 1e-6
"""Smallest length of a solid [m]. OpenCASCADE merges points within 1e-7."""
LONG_SOLID = 10.0
"""Length of a solid from which its CAD was probably drawn in millimetres [m]."""
SHORT_SOLID = 1e-3
"""Length of a solid below which its CAD was probably drawn in metres, and read as millimetres [m]."""
FAR_POINT = 10.0
"""Lengths of a solid from which a remote point's distance was probably given in millimetres."""
THINNEST_BODY = 1e-7
"""Smallest thickness of a CAD body, averaged over its faces [m]."""
OVERLAP = 1e-4
"""Share of the smaller CAD body's volume above which two CAD bodies overlap and do not only touch."""
CHANGED_BY_GLUE = 1e-3
"""Share of a CAD body's volume above which OpenCASCADE must not change it when it glues."""
TOUCHING = 1e-9
"""Distance of CAD bodies up to which they touch [m]."""


@data_class
class Solid:
    """A CAD object: an OpenCASCADE shape in metres with one or several named CAD bodies and named faces.

    Make a shape of several CAD bodies by `glue`. OpenCASCADE's own gluing assigns an overlap to the first CAD body
    without a message.

    Attributes:
        name: name in files and reports
        shape: OpenCASCADE shape of one or several CAD bodies that touch [m]
        materials: one material for all CAD bodies, or materials by name of the CAD body
        remote_points: remote points; may be empty if only eigenmodes are needed
        ports: electrical ports of its piezoelectric CAD bodies

    Raises:
        ValueError: for a CAD body without material, an unknown face or CAD body, a face of two remote points, a CAD
            body of two ports, a name of both a point and a port ("surface" is reserved), CAD bodies that overlap, are
            not closed or have no thickness, and a shape below 1e-6 m

    Warns:
        UserWarning: for a shape of 10 m or more, or below 1 mm, and for a remote point far away from the shape
    """

    name: str
    shape: Any
    materials: Field[Material | Mapping[str, Material], Mapping[str, Material]]
    remote_points: Field[Sequence[RemotePoint], tuple[RemotePoint, ...]] = held(())
    ports: Field[Sequence[ElectricalPort], tuple[ElectricalPort, ...]] = held(())
    __repr__ = short_repr

    def __post_init__(self) -> None:
        label = f"solid {self.name!r}"
        of_kind(f"{label}: shape", self.shape, occ.TopoDS_Shape, "read_solid reads a file")
        bodies = body_names(self.shape)
        points = instances(f"{label}: remote_points", self.remote_points, (RemotePoint,))
        unique("remote point", (p.name for p in points))
        materials = dict.fromkeys(bodies, self.materials) if isinstance(self.materials, Material) else self.materials
        of_kind(f"{label}: materials", materials, Mapping, f"a Material for each of the CAD bodies {bodies}")
        for body, material in materials.items():
            of_kind(f"{label}: material of CAD body {body!r}", material, Material)
        for body in bodies:
            if body not in materials:
                raise ValueError(f"{label}: CAD body {body!r} has no material; given: {', '.join(materials) or 'none'}")
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
        ports = instances(f"{label}: ports", self.ports, (ElectricalPort,))
        unique("electrical port", (port.name for port in ports))
        # A reduced body has read-outs with these names and its surface.
        named = (SURFACE, *(point.name for point in points), *(port.name for port in ports))
        unique(f"{label}: remote point, electrical port and surface ({SURFACE!r})", named)
        for body in unique("CAD body of electrical port", (body for port in ports for body in port.bodies)):
            known("CAD body", body, bodies)
        with hold_library_lock(forkable=True):
            _check_bodies(self.name, list(self.shape.solids))
            _refuse_overlaps(self.name, list(self.shape.solids))
        _check_size(self.name, self.shape, points)
        freeze(self, materials=materials, remote_points=points, ports=ports)

    @property
    def rigid_inertia(self) -> tuple[float, Array, Array]:
        """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m2], without a mesh."""
        bodies = self.shape.solids
        masses = np.array([self.materials[body.name or ""].density * body.mass for body in bodies])
        centres = np.array([list(body.center) for body in bodies])
        mass, centre = float(masses.sum()), masses @ centres / masses.sum()
        inertia = np.zeros((3, 3))
        for own, arm, body in zip(masses, centres - centre, bodies, strict=True):
            about = np.array([[body.inertia[i, j] for j in range(3)] for i in range(3)])  # of unit density
            inertia += own / body.mass * about + own * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        return mass, centre, inertia


def read_solid(
    path: str | Path,
    materials: Material | Mapping[str, Material],
    *,
    faces: Mapping[str, FacePick | Sequence[FacePick]] | None = None,
    remote_points: Sequence[RemotePoint] = (),
    unit: str = "mm",
    name: str | None = None,
    heal: float | None = None,
) -> Solid:
    """Read a solid from a STEP, IGES or BREP file (endings in any letter case).

    CAD bodies that touch are glued, so that the mesh is conforming. A CAD body of an assembly has the name of its part.
    Further instances of the part are "bolt:2", "bolt:3", ... in the order of the file. CAD bodies without a name become
    "body 1", "body 2", ... `face_table` lists all of them.

    Args:
        path: of the file
        materials: one material for all CAD bodies, or materials by name. The name of a part stands for all of its
            instances; "*" stands for any text and "?" for one character. An exact name goes before a part, a part
            before a pattern, and a long pattern before a short one.
        faces: new face name -> `OnPlane`, `NearestTo`, `Extreme`, `OnCylinder`, `OfColour`, `OnBody`, the name of faces
            in the file, or a number from `face_table`; a sequence of these names several faces
        remote_points: as in `Solid`; they use the names given in `faces`
        unit: length of one coordinate unit after reading. OpenCASCADE converts STEP and IGES to "mm" from any declared
            unit. Other values are for BREP files, which declare none, and for wrong declarations.
        name: name of the solid (default: that of the file)
        heal: length below which OpenCASCADE removes edges and slivers and closes gaps between faces [m]; None changes
            nothing

    Raises:
        FileNotFoundError: if there is no such file
        ValueError: if the file cannot be read, for CAD bodies that overlap or are not closed, for materials of unknown
            CAD bodies, and if a choice of faces finds none or too many (the message lists the faces)

    Warns:
        UserWarning: for a STEP file that declares no unit of length, for faces that belong to no CAD body, for edges
            and faces that are far smaller than the solid, and for CAD bodies that touch no other
    """
    label = name or Path(path).stem
    with hold_library_lock(forkable=True):
        shape = read_shape(path, unit=unit, heal=heal, name=label)
        if faces:
            name_faces(shape, faces)
        return Solid(label, shape, _materials_of(label, body_names(shape), materials), remote_points)


def read_shape(path: str | Path, *, unit: str = "mm", heal: float | None = None, name: str | None = None) -> Any:
    """Read the CAD bodies of a file and glue those that touch; see `read_solid`.

    Returns:
        The OpenCASCADE shape, in metres.
    """
    source = Path(path)
    scale = CAD_UNITS[known("unit", unit, CAD_UNITS)]
    if heal is not None:
        positive("heal", heal, "m")
    label = name or source.stem
    with hold_library_lock(forkable=True):
        bodies = read_bodies(source, scale, heal=heal)
        if unit == "mm":
            warn_without_unit(source)
        _check_bodies(label, bodies)
        return glue(bodies, name=label)


def glue(bodies: Sequence[Any], *, name: str = "") -> Any:
    """Join CAD bodies that touch into one shape, in which they share their common faces.

    Args:
        bodies: the CAD bodies [m]
        name: name of the solid, for messages

    Raises:
        ValueError: if CAD bodies overlap, because the material of the overlap is unknown, and if OpenCASCADE fails

    Warns:
        UserWarning: if CAD bodies do not share faces with the others, and for edges and faces that are far smaller than
            the solid, such as those between outlines that nearly agree
    """
    shape = bodies[0]
    if len(bodies) > 1:
        _refuse_overlaps(name, bodies)
        shape = occ.Glue(list(bodies))
        _refuse_damage(name, bodies, shape)
        _warn_of_loose_bodies(name, list(shape.solids))
    warn_of_tiny_features(name, list(shape.solids))
    return shape


def _materials_of(
    name: str, bodies: Sequence[str], materials: Material | Mapping[str, Material]
) -> Mapping[str, Material]:
    """Return materials by CAD body from materials by CAD body, part or pattern."""
    if isinstance(materials, Material):
        return dict.fromkeys(bodies, materials)
    parts = {body: re.sub(r":\d+$", "", body) for body in bodies}
    for key in materials:
        if key not in parts.values() and not matching(key, bodies):
            raise ValueError(
                f"solid {name!r} has no CAD body for the material {key!r}; its CAD bodies are {', '.join(bodies)}"
            )
    patterns = sorted(materials, key=len, reverse=True)
    keys = {
        body: [key for key in (body, part, *(k for k in patterns if body in matching(k, bodies))) if key in materials]
        for body, part in parts.items()
    }
    return {body: materials[found[0]] for body, found in keys.items() if found}


def _check_bodies(name: str, bodies: Sequence[Any]) -> None:
    """Raise ValueError for CAD bodies that are not closed or have no thickness."""
    for body in bodies:
        label = f"solid {name!r}: CAD body {body.name or ''!r}"
        gaps = open_edges(body)
        if gaps:
            raise ValueError(
                f"{label} is not closed: {len(gaps)} of its edges bound only one face, one at "
                f"{millimetres(gaps[0].center)}; repair it in the CAD, or close small gaps by read_solid(..., heal=...)"
            )
        # Faces of an inverted body may have negative areas.
        thickness = 2 * body.mass / sum(abs(face.mass) for face in body.faces)
        if abs(thickness) < THINNEST_BODY:
            raise ValueError(
                f"{label} has no thickness: its volume is {1e9 * body.mass:.3g} mm3, {1e6 * thickness:.2g} um times "
                f"half of its surface; at least {1e6 * THINNEST_BODY:g} um are needed"
            )
        if thickness < 0:
            raise ValueError(
                f"{label} is inside out: its volume is {1e9 * body.mass:.3g} mm3; reverse it in the CAD, or "
                "draw an extruded outline in the other direction"
            )


def _refuse_overlaps(name: str, bodies: Sequence[Any]) -> None:
    """Raise ValueError for CAD bodies that overlap. Those that share a face are glued, and gluing leaves no overlap."""
    faces = [set(body.faces) for body in bodies]
    boxes = [np.array([tuple(corner) for corner in body.bounding_box]) for body in bodies]
    for (i, a), (j, b) in itertools.combinations(enumerate(bodies), 2):
        apart = np.any((boxes[i][0] >= boxes[j][1]) | (boxes[j][0] >= boxes[i][1]))
        if apart or faces[i] & faces[j]:
            continue
        common = a * b
        shared, smaller = common.mass, min(a.mass, b.mass)
        if shared > OVERLAP * smaller:
            raise ValueError(
                f"solid {name!r}: CAD bodies {a.name or ''!r} and {b.name or ''!r} share "
                f"{100 * shared / smaller:.2g} % of the smaller one's volume, {1e9 * shared:.3g} mm3 around "
                f"{millimetres(common.center)}, so its material there is unknown: cut one by the other in the CAD"
            )


def _refuse_damage(name: str, bodies: Sequence[Any], shape: Any) -> None:
    """Raise ValueError for a shape in which a CAD body is missing or has another volume than before it was glued."""
    before, after = [solid for body in bodies for solid in body.solids], list(shape.solids)
    changed = [
        (a, b) for a, b in zip(before, after, strict=False) if abs(b.mass - a.mass) > CHANGED_BY_GLUE * abs(a.mass)
    ]
    # A small overlap becomes a body of its own.
    if len(after) < len(before) or (changed and len(after) == len(before)):
        found = "".join(
            f": {a.name or ''!r} had {1e9 * a.mass:.3g} mm3, then {1e9 * b.mass:.3g} mm3" for a, b in changed[:1]
        )
        raise ValueError(
            f"solid {name!r}: OpenCASCADE damages CAD bodies where it joins them{found}. It takes points within 1e-7 m "
            "for one: draw them larger, or so that their faces meet"
        )


def _warn_of_loose_bodies(name: str, bodies: Sequence[Any]) -> None:
    """Warn of glued CAD bodies that are not connected to the first one by common faces."""
    faces = [set(body.faces) for body in bodies]
    joined, loose = [0], [*range(1, len(bodies))]
    for i in joined:  # grows
        touching = [j for j in loose if faces[i] & faces[j]]
        joined += touching
        loose = [j for j in loose if j not in touching]
    if not loose:
        return
    gaps = [(min(bodies[i].Distance(bodies[j]) for i in joined), bodies[j].name or "") for j in loose]
    gap, nearest = min(gaps)
    others = f" (and {len(loose) - 1} more)" if len(loose) > 1 else ""
    where = (
        f"the smallest gap is {1e3 * gap:.3g} mm: it moves on its own unless you join it"
        if gap > TOUCHING
        else "it touches them at an edge or a corner only, about which it turns: place it in the CAD so that faces meet"
    )
    warn(
        f"solid {name!r}: CAD body {nearest!r}{others} has no face in common with the others; {where}",
    )


def _check_size(name: str, shape: Any, points: Sequence[RemotePoint]) -> None:
    """Check that the length of a shape and the places of its remote points are plausible in metres."""
    low, high = np.array([tuple(corner) for corner in shape.bounding_box])
    size = (high - low).max()
    if not SHORTEST_SOLID < size < np.inf:
        raise ValueError(
            f"solid {name!r} is {size:g} m long; at least {SHORTEST_SOLID:g} m is needed, and shapes are in metres: "
            "check the CAD file's unit"
        )
    if not SHORT_SOLID <= size < LONG_SOLID:
        warn(
            f"solid {name!r} is {size:g} m long; shapes are in metres: check the CAD file's unit unless that is right",
        )
    for point in points:
        away = float(np.linalg.norm(point.position - np.clip(point.position, low, high)))
        if away > FAR_POINT * size:
            warn(
                f"remote point {point.name!r} is {away:.3g} m away from solid {name!r}, which is {size:.3g} m long: "
                "give its position in metres, unless that is right",
            )


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
