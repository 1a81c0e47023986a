"""Table of the CAD bodies and faces of a solid, a shape or a CAD file."""

from pathlib import Path
from typing import Any

from nassim.base.tables import text_table
from nassim.fem.cad_files import millimetres
from nassim.fem.faces import list_faces, rounded_direction
from nassim.fem.solid import read_shape

TABLE_WIDTH = 150


def face_table(shape: Any, *, unit: str = "mm") -> str:
    """Return a table of the CAD bodies of a shape and of its faces with their numbers.

    Args:
        shape: a `Solid`, an OpenCASCADE shape in metres, or the path of a CAD file, as for `read_solid`
        unit: length of one coordinate unit of a file, see `read_solid`
    """
    if isinstance(shape, str | Path):
        shape = read_shape(shape, unit=unit)
    shape = getattr(shape, "shape", shape)
    bodies = [["body", "volume [mm3]", "centre [mm]", "faces"]]
    for body in shape.solids:
        centre = millimetres(body.center)[1:-4]
        bodies.append([body.name or "", f"{1e9 * body.mass:.5g}", centre, str(len(body.faces))])
    rows = [["face", "kind", "area [mm2]", "centre [mm]", "normal or axis", "radius [mm]", "body", "name", "colour"]]
    for face in list_faces(shape):
        along = face.axis[1] if face.axis is not None else face.normal if face.kind == "plane" else None
        rows.append(
            [
                str(face.number),
                f"{face.kind} (hollow)" if face.hollow else face.kind,
                f"{1e6 * face.area:.4g}",
                millimetres(face.centre)[1:-4],
                "" if along is None else rounded_direction(along),
                "" if face.radius is None else f"{1e3 * face.radius:.4g}",
                ", ".join(face.bodies),
                face.name,
                face.colour,
            ]
        )
    return "\n\n".join(text_table(table, width=TABLE_WIDTH) for table in (bodies, rows))
