"""Faces of a CAD shape as a person describes them: flat or round, where, how large, which way, of which colour."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import netgen.occ as occ
import numpy as np

from nassim.base.checks import Array
from nassim.base.library_lock import hold_library_lock
from nassim.base.short_repr import short_repr
from nassim.fem.cad_files import millimetres

FLAT = 1e-7
"""Largest distance of points of a flat face from its plane [m]. OpenCASCADE merges points within that distance."""
SAME_SURFACE = 1e-6
"""Relative difference of radii and directions that counts as zero."""
DRAWN_ALIKE = 1e-3
"""Largest difference of a drawn face's normals from those of its kind. Netgen gives them in single precision."""
SMALLEST_DRAWN = 1e-3
"""Size of a body below which it is drawn larger [m]."""
CIRCLE = np.arange(4) * np.pi / 2
"""Angles at which a surface is compared with a surface of revolution [rad]."""
HEIGHTS = (0.0, 0.4)
"""Second parameters of these comparisons [m or rad]. The equator of a sphere and of a torus is at zero."""


@dataclass(frozen=True)
class Face:
    """Description of a CAD face.

    Attributes:
        number: number of the face in its shape, from 1; another shape of the same CAD has other numbers
        kind: "plane", "cylinder", "cone", "sphere" or "other"
        area: area [m2]
        centre: centre of area, shape (3,) [m]
        place: a point on the face, shape (3,) [m]
        normal: outward unit normal at `place`, shape (3,); zero for a face that is too small to be drawn
        axis: point and unit direction of the axis of a cylinder or cone, shape (2, 3) [m, -]; None for other kinds
        radius: radius of a cylinder or sphere [m]; None for other kinds
        hollow: whether the material is outside a cylinder, cone or sphere, as in a hole; None for other kinds
        name: name, or ""
        colour: colour as "#rrggbb", or ""
        bodies: names of the one or two CAD bodies to which it belongs; `normal` and `hollow` are those of the first
    """

    number: int
    kind: str
    area: float
    centre: Array
    place: Array
    normal: Array
    axis: Array | None = None
    radius: float | None = None
    hollow: bool | None = None
    name: str = ""
    colour: str = ""
    bodies: tuple[str, ...] = ()
    __repr__ = short_repr

    def seen_from(self, body: str) -> "Face":
        """Return the face as a face of one of its bodies, out of which its normal then points.

        Args:
            body: name of the body
        """
        if self.bodies[:1] == (body,):
            return replace(self, bodies=(body,))
        hollow = None if self.hollow is None else not self.hollow
        return replace(self, normal=-self.normal, hollow=hollow, bodies=(body,))

    def __str__(self) -> str:
        text = f"face {self.number}: {self.kind}, {1e6 * self.area:.4g} mm2 around {millimetres(self.centre)}"
        if self.kind == "plane":
            text += f", normal {rounded_direction(self.normal)}"
        if self.radius is not None:
            text += f", radius {1e3 * self.radius:.4g} mm" + (" from inside" if self.hollow else "")
        if self.axis is not None:
            text += f", axis along {rounded_direction(self.axis[1])}"
        text += f", colour {self.colour}" if self.colour else ""
        return text + (f", named {self.name!r}" if self.name else "")


def list_faces(shape: Any) -> tuple[Face, ...]:
    """List the faces of a shape.

    Args:
        shape: a `Solid`, or an OpenCASCADE shape in metres

    Returns:
        The faces in the order of their numbers; a face between two CAD bodies is listed once.
    """
    shape = getattr(shape, "shape", shape)
    with hold_library_lock():
        sides: dict[Any, list[str]] = {}
        drawn: dict[Any, tuple[Array, Array]] = {}
        for body in shape.solids or [shape]:
            for face, drawing in zip(body.faces, _drawings(body), strict=True):
                sides.setdefault(face, []).append(body.name or "" if len(shape.solids) else "")
                drawn.setdefault(face, drawing)
        return tuple(
            _describe(number, face, *drawn[face], tuple(sides[face])) for number, face in enumerate(sides, start=1)
        )


def occ_faces(shape: Any) -> list[Any]:
    """Return the OpenCASCADE faces of a shape in the order of `list_faces`.

    Args:
        shape: OpenCASCADE shape
    """
    return list(dict.fromkeys(face for body in shape.solids or [shape] for face in body.faces))


def solid_triangles(body: Any) -> tuple[Array, Array, Array]:
    """Return the triangles by which OpenCASCADE draws a CAD body, for which it starts threads.

    Args:
        body: OpenCASCADE shape

    Returns:
        Corners, shape (n, 3, 3), in the unit of the shape; outward unit normals at the corners, of the same shape; for
        each triangle the index of its face in `body.faces`, shape (n,).
    """
    low, high = (np.array(tuple(corner)) for corner in body.bounding_box)
    size = (high - low).max()
    # OpenCASCADE ends the interpreter where it fails to draw a face, as it does in tiny bodies.
    scale = 1 / size if 0 < size < SMALLEST_DRAWN else 1.0
    drawing = occ.OCCGeometry(body if scale == 1 else body.Scale(occ.Pnt(0, 0, 0), scale))._visualizationData()
    corners, normals = (np.asarray(drawing[key], dtype=float).reshape(-1, 3, 3) for key in ("vertices", "normals"))
    return corners / scale, normals, np.asarray(drawing["indices"], dtype=int)


def _describe(number: int, face: Any, corners: Array, normals: Array, bodies: tuple[str, ...]) -> Face:
    """Describe a face, given the corners of its triangles, shape (n, 3, 3), and the outward normals there."""
    centre = np.array(tuple(face.center))
    place, outward = _place(corners, normals) if len(corners) else (centre, np.zeros(3))
    flat = _flat_normal(face)
    kind, axis, radius = ("plane", None, None) if flat is not None else _round_form(face)
    # The samples of a surface may all be in one part of it, such as the straight beginning of a spline.
    if not _drawn_as(kind, normals, axis):
        kind, axis, radius = "other", None, None
    hollow = None
    if kind == "plane" and flat is not None:
        outward = flat * np.sign(flat @ outward)
    elif kind != "other":
        middle = axis[0] if axis is not None else _ring(face, HEIGHTS[0])[0]
        radial = place - middle
        radial = radial if axis is None else radial - (radial @ axis[1]) * axis[1]
        hollow = bool(radial @ outward < 0)
    name, colour = face.name or "", _screen_colour(face.col)
    return Face(
        number=number,
        kind=kind,
        area=face.mass,
        centre=centre,
        place=place,
        normal=outward,
        axis=axis,
        radius=radius,
        hollow=hollow,
        name=name,
        colour=colour,
        bodies=bodies,
    )


def _flat_normal(face: Any) -> Array | None:
    """Return a unit normal of a flat face, None for any other."""
    # Second moments of area would serve for any surface, but their round-off hides up to a micrometre.
    try:
        samples = [_sample(face, angle, height) for angle in CIRCLE for height in HEIGHTS]
    except occ.OCCException:  # a surface that is not defined at these parameters
        return None
    normals = np.cross([u for _, u, _ in samples], [v for _, _, v in samples])
    normal = normals[0] / (np.linalg.norm(normals[0]) or 1.0)
    points = np.array([point for point, _, _ in samples])
    turned = np.linalg.norm(np.cross(normals, normal), axis=1) > SAME_SURFACE * np.linalg.norm(normals, axis=1)
    return None if np.any(turned) or np.abs((points - points[0]) @ normal).max() > FLAT else normal


def _round_form(face: Any) -> tuple[str, Array | None, float | None]:
    """Return kind, axis and radius of a round face.

    OpenCASCADE gives cylinders, cones and spheres as functions of an angle and of a length or a second angle.
    """
    try:
        rings = [_ring(face, height) for height in HEIGHTS]
    except (occ.OCCException, ValueError):
        return "other", None, None
    (low, axis, first, slope), (high, other_axis, second, other_slope) = rings
    scale = max(first, second)
    if not scale or not np.allclose(axis, other_axis, atol=SAME_SURFACE):
        return "other", None, None
    if np.allclose(slope, other_slope, atol=SAME_SURFACE * np.linalg.norm(slope)):  # the generator is straight
        if abs(second - first) < SAME_SURFACE * scale:
            return "cylinder", np.array([low, axis]), first
        return "cone", np.array([low, axis]), None
    if abs(np.hypot(np.linalg.norm(high - low), second) - first) < SAME_SURFACE * first:
        return "sphere", None, first
    return "other", None, None


def _ring(face: Any, height: float) -> tuple[Array, Array, float, Array]:
    """Return centre, axis and radius of the circle at a second parameter, and the slope along that at angle zero.

    Raises:
        ValueError: if there is no circle
    """
    points, along, slopes = np.array([_sample(face, angle, height) for angle in CIRCLE]).transpose(1, 0, 2)
    centre = points.mean(axis=0)
    arms = points - centre
    radius = float(np.linalg.norm(arms[0]))
    axis = np.cross(arms[0], arms[1])
    size = np.linalg.norm(axis)
    following = np.roll(arms, -1, axis=0)  # of an ellipse, the derivatives are the next arms too
    if not size or not np.allclose([along, np.cross(axis / size, arms)], following, atol=SAME_SURFACE * radius):
        raise ValueError("no circle")
    return centre, axis / size, radius, slopes[0]


def _sample(face: Any, u: float, v: float) -> tuple[tuple[float, ...], ...]:
    """Return a point of the surface of a face and its derivatives to the two parameters."""
    point, along_u, along_v = face.surf.D1(u, v)
    return tuple((c.x, c.y, c.z) for c in (point, along_u, along_v))


def _drawn_as(kind: str, normals: Array, axis: Array | None) -> bool:
    """Return whether the normals of a drawn face are those of its kind, for planes and cylinders.

    Args:
        kind: as of `Face`
        normals: outward normals at the corners of its triangles, shape (n, 3, 3)
        axis: point and direction of the axis of a cylinder, shape (2, 3)
    """
    if kind == "cylinder" and axis is not None:
        return bool(np.abs(normals @ axis[1]).max(initial=0.0) < DRAWN_ALIKE)
    if kind == "plane":
        return bool(np.linalg.norm(np.cross(normals, normals[:1, :1]), axis=-1).max(initial=0.0) < DRAWN_ALIKE)
    return True


def _drawings(body: Any) -> Iterator[tuple[Array, Array]]:
    """Yield the corners of the triangles of each face of a body, and the outward normals there, shape (n, 3, 3) each.

    A face that is too small to be drawn has no triangles.
    """
    corners, normals, owner = solid_triangles(body)
    for number, _ in enumerate(body.faces):
        own = owner == number
        yield corners[own], normals[own]


def _place(corners: Array, normals: Array) -> tuple[Array, Array]:
    """Return a point on a drawn face, in its largest triangle, and the outward normal there."""
    largest = np.argmax(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1))
    normal = normals[largest].mean(axis=0)
    return corners[largest].mean(axis=0), normal / (np.linalg.norm(normal) or 1.0)


def _screen_colour(colour: Sequence[float] | None) -> str:
    """Return a colour of OpenCASCADE, which is proportional to light, as "#rrggbb", or "" without one."""
    if not colour:
        return ""
    light = np.clip(np.array(colour[:3]), 0.0, 1.0)
    values = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return "#" + "".join(f"{round(255 * value):02x}" for value in values)


def rounded_direction(vector: Array) -> str:
    """Return the text of a direction, shape (3,)."""
    return "(" + ", ".join(f"{c + 0.0:.3g}" for c in np.round(vector, 4)) + ")"
