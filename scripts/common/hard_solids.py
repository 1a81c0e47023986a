"""Solids whose discretisation error is hard to estimate or to reduce, each with two remote points."""

from collections.abc import Callable

import netgen.occ as occ
import numpy as np

from nassim import Material, RemotePoint, Solid

STEEL = Material("steel", young_modulus=193e9, poisson_ratio=0.31, density=7750.0)
RUBBER = Material("rubber", young_modulus=5e6, poisson_ratio=0.49, density=1100.0)


def box(*corners: float) -> occ.Solid:
    """A box between two opposite corners x, y, z, x, y, z [mm]."""
    return occ.Box(*(occ.Pnt(*(1e-3 * c for c in corner)) for corner in (corners[:3], corners[3:])))


def cylinder(x: float, y: float, z: float, axis: occ.Dir, radius: float, length: float) -> occ.Solid:
    """A cylinder from the centre of one end along an axis [mm]."""
    return occ.Cylinder(occ.Pnt(1e-3 * x, 1e-3 * y, 1e-3 * z), axis, 1e-3 * radius, 1e-3 * length)


def solid(name: str, shape: occ.TopoDS_Shape, axis: occ.Dir, coupling: str = "rbe2", **materials: Material) -> Solid:
    """A solid with remote points on its lowest and its highest face along an axis."""
    faces = shape.faces.Min(axis), shape.faces.Max(axis)
    for face, label in zip(faces, ("first", "second"), strict=True):
        face.name = label
    for body in shape.solids:
        body.name = body.name or "body"
    points = tuple(RemotePoint(face.name, face.name, np.array(tuple(face.center)), coupling) for face in faces)
    return Solid(name, shape, {"body": STEEL} | materials, points)


def make_neck(thickness: float = 0.25) -> Solid:
    """A flexible joint: two crossed pairs of circular notches of radius 2 mm, and necks between them [mm]."""
    shape, offset = box(-6, -6, 0, 6, 6, 22), 2 + thickness / 2
    for k in (-offset, offset):
        far = np.copysign(12, k)
        shape -= cylinder(k, -12, 7, occ.Y, 2, 24) + box(min(k, far), -12, 5, max(k, far), 12, 9)
        shape -= cylinder(-12, k, 15, occ.X, 2, 24) + box(-12, min(k, far), 13, 12, max(k, far), 17)
    return solid("neck", shape, occ.Z)


def make_leaf() -> Solid:
    """A leaf spring 0.35 mm thick between blocks."""
    leaf = box(0, 0, -0.175, 80, 30, 0.175)
    return solid("leaf spring", leaf + box(-10, 0, -5, 0, 30, 5) + box(80, 0, -5, 90, 30, 5), occ.X)


def make_bracket() -> Solid:
    """A bracket with a sharp re-entrant edge."""
    wall = box(0, 0, 0, 8, 20, 60)
    return solid("bracket", box(0, 0, 0, 60, 20, 8) + wall, occ.Vec(1, 0, -1))


def make_ribs() -> Solid:
    """A plate of 2 mm with crossing ribs of 1.5 mm between end blocks."""
    shape = box(0, 0, 0, 100, 60, 2) + box(-8, 0, 0, 0, 60, 12) + box(100, 0, 0, 108, 60, 12)
    for y in (14.25, 44.25):
        shape += box(0, y, 2, 100, y + 1.5, 10)
    return solid("ribbed plate", shape + box(49.25, 0, 2, 50.75, 60, 10), occ.X)


def make_frame() -> Solid:
    """A frame of bent arms of 1.4 mm with fillets, as amplified actuators have."""
    points = [(4.5, 15), (4.5, 12.7), (34, 7.5), (39, 2), (39, 0), (33, 0), (33, 5.5), (28, 7.1), (5, 11.3), (0, 11.3)]
    corners = [occ.Pnt(1e-3 * x, 0, 1e-3 * z) for x, z in [*points, (0, 15)]]
    wire = occ.Wire([occ.Segment(a, b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)])
    quarter = occ.Face(wire).Extrude(0.02 * occ.Y)
    notch = [e for e in quarter.edges if abs(e.center.x - 4.5e-3) + abs(e.center.z - 12.7e-3) < 1e-6]
    quarter = quarter.MakeFillet(notch, 0.7e-3)
    half = quarter + quarter.Mirror(occ.Axes((0, 0, 0), occ.X, occ.Y))
    return solid("frame", (half + half.Mirror(occ.Axes((0, 0, 0), occ.Z, occ.X))).UnifySameDomain(), occ.Z)


def make_shell() -> Solid:
    """A quarter of a tube, 0.8 mm thick, radius 30 mm."""
    tube = cylinder(0, 0, 0, occ.Z, 30, 60) - cylinder(0, 0, 0, occ.Z, 29.2, 60)
    return solid("shell", tube * box(0, 0, 0, 31, 31, 60), occ.Z)


def make_sandwich() -> Solid:
    """A soft layer of 1 mm between stiff blocks."""
    low, layer, high = box(0, 0, 0, 30, 20, 10), box(0, 0, 10, 30, 20, 11), box(0, 0, 11, 30, 20, 21)
    low.name, layer.name, high.name = "low", "layer", "high"
    return solid("soft layer", occ.Glue([low, layer, high]), occ.Z, low=STEEL, layer=RUBBER, high=STEEL)


def make_rubber() -> Solid:
    """A nearly incompressible block."""
    return solid("rubber block", box(0, 0, 0, 20, 20, 12), occ.Z, body=RUBBER)


def make_bar() -> Solid:
    """A slender bar, whose ends stay deformable."""
    return solid("bar", box(0, -5, -5, 100, 5, 5), occ.X, "rbe3")


def make_angled_notch() -> Solid:
    """A bar with a slot of 1 mm, cut at an odd angle to three quarters of its height."""
    slot = box(-0.5, -20, -1, 0.5, 20, 30).Rotate(occ.Axis((0, 0, 0), occ.Y), 27).Rotate(occ.Axis((0, 0, 0), occ.Z), 17)
    return solid("notch at an angle", box(0, 0, 0, 50, 10, 8) - slot.Move(occ.Vec(0.025, 0.005, 0.002)), occ.X)


def make_ring() -> Solid:
    """A ring of 2 mm with feet at both ends."""
    ring = cylinder(0, -4, 0, occ.Y, 20, 8) + box(-4, -4, -24, 4, 4, -18) + box(-4, -4, 18, 4, 4, 24)
    return solid("ring", ring - cylinder(0, -5, 0, occ.Y, 18, 10), occ.Z)


def make_wedge() -> Solid:
    """A wedge from 10 mm to 0.5 mm."""
    corners = [occ.Pnt(1e-3 * x, 0, 1e-3 * z) for x, z in [(0, 0), (60, 4.75), (60, 5.25), (0, 10)]]
    wire = occ.Wire([occ.Segment(a, b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)])
    return solid("wedge", occ.Face(wire).Extrude(0.015 * occ.Y), occ.X)


HARD_SOLIDS: dict[str, Callable[[], Solid]] = {
    "neck": make_neck,
    "leaf": make_leaf,
    "bracket": make_bracket,
    "ribs": make_ribs,
    "frame": make_frame,
    "shell": make_shell,
    "layer": make_sandwich,
    "rubber": make_rubber,
    "bar": make_bar,
    "notch": make_angled_notch,
    "ring": make_ring,
    "wedge": make_wedge,
}
