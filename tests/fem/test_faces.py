"""Faces of a part in an odd position: what they are said to be, and how they are chosen."""

import itertools
import re
from types import SimpleNamespace

import netgen.occ as occ
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nassim import Extreme, NearestTo, OfColour, OnBody, OnCylinder, OnPlane, face_table, list_faces, name_faces
from nassim.fem import glue
from nassim.fem.face_picks import matching
from nassim.fem.faces import _flat_normal, _round_form, solid_triangles

VECTOR = np.array([0.5, -0.8, 0.3])
TURN = Rotation.from_rotvec(VECTOR).as_matrix()
SHIFT = np.array([0.15, -0.2, 0.4])
RED, BLUE = "#ff0000", "#3366cc"


def moved(shape):
    """Turn and shift a shape."""
    axis = occ.Axis(occ.Pnt(0, 0, 0), occ.Dir(*VECTOR))
    return shape.Rotate(axis, np.degrees(np.linalg.norm(VECTOR))).Move(occ.Vec(*SHIFT))


def at(*point):
    """Where a point of the part in millimetres is."""
    return TURN @ (1e-3 * np.array(point)) + SHIFT


def along(*vector):
    return TURN @ np.array(vector)


@pytest.fixture(scope="module")
def made():
    """Two plates of 40 x 10 x 6 mm, glued along y = 10.

    The joint cuts a hole of radius 3 mm in halves. The first plate has a cone, a ball's dent, a boss of radius 3 mm and
    a vertical fillet of radius 3 mm.
    """
    size = 1e-3
    first, second = (occ.Box((0, 10 * k * size, 0), (40 * size, 10 * (k + 1) * size, 6 * size)) for k in (0, 1))
    hole = occ.Cylinder(occ.Pnt(20 * size, 10 * size, -size), occ.Z, 3 * size, 8 * size)
    upright = [e for e in first.edges if abs(e.center.x) + abs(e.center.y) < 1e-9]
    first = first.MakeFillet(upright, 3 * size) - hole
    boss = occ.Cylinder(occ.Pnt(35 * size, 4 * size, 6 * size), occ.Z, 3 * size, 4 * size)
    cone = occ.Cone(
        occ.Axes(occ.Pnt(28 * size, 4 * size, 6 * size), -occ.Z, occ.X), 3 * size, size, 2 * size, 2 * np.pi
    )
    first = first + boss - cone - occ.Sphere(occ.Pnt(10 * size, 5 * size, 6 * size), 2 * size)
    second = second - hole
    first.name, second.name = "front", "back"
    second.faces.Max(occ.Y).col = (1, 0, 0)
    second.faces.Max(occ.Z).name, first.faces.Max(occ.Z).name = "lid (back)", "boss"
    return glue([moved(first), moved(second)])


@pytest.fixture
def part(made):
    """The same, whose faces get their names back afterwards."""
    faces = [(face, face.name) for face in made.faces]
    yield made
    for face, name in faces:
        face.name = name


def nearest(faces, *point):
    return min(faces, key=lambda face: np.linalg.norm(face.centre - at(*point)))


def test_faces_are_what_they_are(part):
    faces = list_faces(part)
    assert [face.number for face in faces] == list(range(1, len(faces) + 1))
    assert sorted(face.kind for face in faces) == sorted(["cone", "sphere"] + 4 * ["cylinder"] + 14 * ["plane"])
    sphere = next(face for face in faces if face.kind == "sphere")
    assert (sphere.radius, sphere.hollow) == (pytest.approx(2e-3), True)
    assert next(face for face in faces if face.kind == "cone").hollow
    boss, fillet = nearest(faces, 35, 4, 8), nearest(faces, 1, 1, 3)
    for face, middle in ((boss, (35, 4, 0)), (fillet, (3, 3, 0))):
        assert (face.kind, face.radius, face.hollow) == ("cylinder", pytest.approx(3e-3), False)
        origin, direction = face.axis
        assert np.abs(direction @ along(0, 0, 1)) == pytest.approx(1)
        assert np.linalg.norm(np.cross(at(*middle) - origin, direction)) < 1e-9
    assert boss.area == pytest.approx(2 * np.pi * 3e-3 * 4e-3)


def test_normals_point_out_of_the_material(part):
    faces = list_faces(part)
    dent = ((28, 4, 4), (0, 0, 1))
    for point, normal in (((40, 5, 3), (1, 0, 0)), ((20, 0, 3), (0, -1, 0)), ((35, 4, 10), (0, 0, 1)), dent):
        np.testing.assert_allclose(nearest(faces, *point).normal, along(*normal), atol=1e-9)
    bottoms = [face for face in faces if face.kind == "plane" and face.normal @ along(0, 0, -1) > 0.999]
    assert sorted(face.bodies for face in bottoms) == [("back",), ("front",)]
    joint = nearest(faces, 8.5, 10, 3)
    assert joint.bodies == ("front", "back")
    np.testing.assert_allclose(joint.normal, along(0, 1, 0), atol=1e-9)
    np.testing.assert_allclose(joint.seen_from("back").normal, along(0, -1, 0), atol=1e-9)
    assert (joint.hollow, joint.seen_from("back").hollow) == (None, None)  # a plane


@pytest.mark.parametrize(
    ("pick", "centres"),
    [
        (Extreme(along(0, 0, 1)), [(35, 4, 10)]),
        (Extreme(along(3, 0, 0), several=True), [(40, 5, 3), (40, 15, 3)]),
        (OnPlane(at(7, 0, 9), along(0, -1, 0)), [(21.5, 0, 3)]),
        (OnBody("back", Extreme(along(0, 0, -1))), [(20, None, 0)]),
        (OnBody("front", Extreme(along(0, 1, 0), several=True)), [(8.5, 10, 3), (31.5, 10, 3)]),
        (OnCylinder(hole=True), [(20, None, 3), (20, None, 3)]),
        (OnCylinder(3e-3, hole=False), [(35, 4, 8)]),
        (OnCylinder(3.001e-3, near=at(0, 0, 3)), [(None, None, 3)]),
        (OnCylinder(axis=along(0, 0, -2), hole=False), [(35, 4, 8)]),
        (NearestTo(at(35, 4, 30)), [(35, 4, 10)]),
        (OfColour("#FF0000"), [(20, 20, 3)]),
        ("lid (back)", [(20, None, 6)]),
        ("lid*", [(20, None, 6)]),
        ([OnBody("*", Extreme(along(1, 0, 0))), "b?ss"], [(40, 5, 3), (40, 15, 3), (35, 4, 10)]),
    ],
)
def test_picks_find_what_a_person_sees(part, pick, centres):
    name_faces(part, {"chosen": pick})
    found = [TURN.T @ (face.centre - SHIFT) * 1e3 for face in list_faces(part) if face.name == "chosen"]
    assert len(found) == len(centres)
    for centre in centres:
        given = [k for k in range(3) if centre[k] is not None]
        off = [np.abs(place[given] - np.array(centre, dtype=float)[given]).max() for place in found]
        assert min(off) < 1e-6


def test_two_holes_on_one_axis_are_two():
    """The ears of a fork: choose one by its place, or both."""
    fork = occ.Box((0, 0, 0), (0.03, 0.02, 0.02)) - occ.Box((0.01, -1, 0.005), (0.02, 1, 1))
    fork = moved(fork - occ.Cylinder(occ.Pnt(-1, 0.01, 0.013), occ.X, 0.004, 2))
    with pytest.raises(ValueError, match="finds 2 faces, one is wanted"):
        name_faces(fork, {"bore": OnCylinder(0.004)})
    name_faces(fork, {"bore": OnCylinder(0.004, near=at(28, 10, 13))})
    (bore,) = [face for face in list_faces(fork) if face.name == "bore"]
    np.testing.assert_allclose(bore.centre, at(25, 10, 13), atol=1e-9)
    name_faces(fork, {"both": OnCylinder(0.004, several=True)})
    assert [face.name for face in list_faces(fork)].count("both") == 2


def test_faces_between_bodies():
    """A pin in a plate, with a dome of the pin's radius on it: what is a hole, a shaft, and on top."""
    pin = occ.Cylinder(occ.Pnt(0.01, 0.01, 0), occ.Z, 0.004, 0.012)
    plate = occ.Box((0, 0, 0), (0.02, 0.02, 0.005)) - pin
    dome = occ.Sphere(occ.Pnt(0.01, 0.01, 0.012), 0.004) - occ.Box((0, 0, 0), (0.02, 0.02, 0.012))
    plate.name, pin.name, dome.name = "plate", "pin", "dome"
    shape = glue([moved(body) for body in (plate, pin, dome)])
    name_faces(shape, {"bore": OnCylinder(hole=True), "top": Extreme(along(0, 0, 1))})
    found = {face.name: face for face in list_faces(shape)}
    assert found["bore"].bodies == ("plate", "pin")
    np.testing.assert_allclose(found["bore"].centre, at(10, 10, 2.5), atol=1e-9)
    assert found["top"].bodies == ("plate",)
    name_faces(shape, {"shaft": OnBody("pin", OnCylinder(hole=False)), "seat": OnBody("pin", Extreme(along(0, 0, 1)))})
    assert sum(face.area for face in list_faces(shape) if face.name == "shaft") == pytest.approx(96e-6 * np.pi)
    assert {face.name: face for face in list_faces(shape)}["seat"].bodies == ("pin", "dome")
    with pytest.raises(ValueError, match="finds no face"):
        name_faces(shape, {"top": OnBody("dome", Extreme(along(0, 0, 1)))})


def test_numbers_name_faces(part):
    (top,) = [face for face in list_faces(part) if face.name == "boss"]
    line = next(row for row in face_table(part).splitlines() if row.startswith(f"{top.number} "))
    x, y, z = 1e3 * at(35, 4, 10)
    normal = ", ".join(f"{c:.3g}" for c in along(0, 0, 1))
    assert re.search(rf"plane +28.27  {x:.4g}, {y:.4g}, {z:.4g} +\({normal}\)", line)
    assert line.split()[-2:] == ["front", "boss"]
    name_faces(part, {"end": top.number, "others": (1, 2) if top.number > 2 else (3, 4)})
    assert [face.name for face in list_faces(part)].count("end") == 1
    assert [face.name for face in list_faces(part)].count("others") == 2


def test_cylinders_are_told_as_holes_or_shafts_along_their_axes(part):
    told = {(face.hollow, str(face).partition(", radius ")[2]) for face in list_faces(part) if face.kind == "cylinder"}
    sides = [", ".join(f"{c + 0.0:.3g}" for c in np.round(sign * along(0, 0, 1), 4)) for sign in (1, -1)]
    assert {hollow for hollow, _ in told} == {True, False}
    for hollow, text in told:
        radius, _, rest = text.partition(" mm")
        assert float(radius) == pytest.approx(3.0)
        assert rest.startswith(" from inside, axis along (" if hollow else ", axis along (")
        assert any(f"axis along ({side})" in rest for side in sides)


def test_bodies_have_their_volumes_and_centres_in_millimetres(part):
    """The second plate, without the half of a hole, whose centre is 4 r / 3 pi from its axis."""
    half = np.pi * 9 * 6 / 2
    volume = 2400 - half
    x, y, z = 1e3 * at(20, (2400 * 15 - half * (10 + 4 * 3 / (3 * np.pi))) / volume, 3)
    assert re.search(rf"\nback +{volume:.5g} +{x:.4g}, {y:.4g}, {z:.4g} +\d+ *\n", face_table(part))


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        (
            {"a": OnCylinder(3e-3)},
            r"'a': OnCylinder.* finds 3 faces, one is wanted. Found:(\n.*: cylinder.*){4}$",
        ),
        ({"a": OnCylinder(4e-3)}, r"finds no face. The solid has:(\n  face \d+: cylinder, .* radius 3 mm.*){4}$"),
        ({"a": Extreme(along(1, 0, 0))}, r"finds 2 faces, one is wanted. Found:(\n  face \d+: plane.*normal.*){2}$"),
        ({"a": Extreme((1, 1, 1))}, r"finds no face. The solid has:(\n  face \d+: plane.*){14}$"),
        ({"a": OfColour(BLUE)}, r"finds no face. The solid has:(\n  face .*){20}$"),
        ({"a": 99}, "number 99 finds no face"),
        ({"a": "*lod*"}, r"name '\*lod\*' finds no face"),
        ({"a": OnBody("middle", Extreme("+z"))}, "finds no CAD body; there are 'front', 'back'"),
        ({"a": "boss", "b": NearestTo(at(35, 4, 30))}, r"faces 'a' and 'b' are both face \d+: plane, 28.27 mm2"),
    ],
)
def test_picks_that_fail_say_where_the_faces_are(part, faces, message):
    before = [face.name for face in list_faces(part)]
    with pytest.raises(ValueError, match=message):
        name_faces(part, faces)
    assert [face.name for face in list_faces(part)] == before


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Extreme("z"), r"unknown direction 'z'; known: \+x, -x"),
        (lambda: Extreme((0, 0, 0)), "must have a length"),
        (lambda: OnCylinder(-1.0), "radius must be positive"),
        (lambda: OnCylinder(near=(0, 0)), "near must have shape 3"),
        (lambda: OnCylinder(axis="w"), "unknown axis 'w'"),
        (lambda: OfColour("red"), 'must be of the form "#rrggbb"'),
    ],
)
def test_picks_check_themselves(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_names_and_patterns():
    names = ["bolt", "bolt:2", "M6 [x2]", "a*b"]
    assert matching("bolt*", names) == ["bolt", "bolt:2"]
    assert matching("M6 [x?]", names) == ["M6 [x2]"]
    assert matching("a*b", names) == ["a*b"]
    assert matching("bolt.2", names) == []


def surface(point, along_u, along_v):
    """A face whose surface has a point and derivatives by functions of its two parameters."""

    def derive(u, v):
        return tuple(SimpleNamespace(**dict(zip("xyz", part(u, v), strict=True))) for part in (point, along_u, along_v))

    return SimpleNamespace(surf=SimpleNamespace(D1=derive))


@pytest.mark.parametrize("colour", ["#104080", "#0f417F", "#114080", "#124080", "#104280", "#10407e", ""])
def test_colours_are_the_same_up_to_one_step_of_a_channel(colour):
    near = colour in ("#104080", "#0f417F", "#114080")
    assert bool(OfColour("#104080").find([SimpleNamespace(colour=colour)], ())) == near


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_face_is_flat_to_a_ten_thousandth_of_a_millimetre_and_a_millionth_of_a_radian(share):
    x, y = lambda _u, _v: (1, 0, 0), lambda _u, _v: (0, 1, 0)
    raised = surface(lambda u, v: (u, v, 1e-7 * share * (v > 0)), x, y)
    turned = surface(lambda u, v: (u, v, 0.0), x, lambda _u, v: (0, 1, 1e-6 * share * (v > 0)))
    for face in (raised, turned):
        normal = _flat_normal(face)
        assert (normal is not None) == (share < 1)
        assert normal is None or normal.tolist() == [0, 0, 1]


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_cone_is_a_cylinder_to_a_millionth_of_the_radius(share):
    """Of 3 mm, which grows from one ring to the next, 0.4 m further along."""
    slope = 1e-6 * share * 3e-3 / 0.4

    def radial(u, v):
        return (3e-3 + slope * v) * np.array([np.cos(u), np.sin(u), 0.0])

    face = surface(
        lambda u, v: radial(u, v) + np.array([0, 0, v]),
        lambda u, v: np.cross([0, 0, 1], radial(u, v)),
        lambda u, _v: np.array([slope * np.cos(u), slope * np.sin(u), 1.0]),
    )
    kind, axis, radius = _round_form(face)
    assert (kind, radius) == (("cylinder", pytest.approx(3e-3)) if share < 1 else ("cone", None))
    np.testing.assert_allclose(axis, [[0, 0, 0], [0, 0, 1]], atol=1e-15)


@pytest.mark.parametrize("radius", [2e-5, 3.0])
def test_spheres_of_any_size_are_neither_cylinders_nor_cones(radius):
    shell = surface(
        lambda u, v: radius * np.array([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)]),
        lambda u, v: radius * np.array([-np.cos(v) * np.sin(u), np.cos(v) * np.cos(u), 0.0]),
        lambda u, v: radius * np.array([-np.sin(v) * np.cos(u), -np.sin(v) * np.sin(u), np.cos(v)]),
    )
    assert _round_form(shell) == ("sphere", None, pytest.approx(radius))


def test_other_surfaces_have_no_form():
    """An oval tube; one whose circles tilt; one that is closed in a point at either end, as an olive."""
    oval = surface(
        lambda u, v: (np.cos(u), 2 * np.sin(u), v),
        lambda u, _v: (-np.sin(u), 2 * np.cos(u), 0),
        lambda _u, _v: (0, 0, 1),
    )
    tilted = surface(
        lambda u, v: (np.cos(u), np.sin(u) * np.cos(v), np.sin(u) * np.sin(v)),
        lambda u, v: (-np.sin(u), np.cos(u) * np.cos(v), np.cos(u) * np.sin(v)),
        lambda u, v: (0, -np.sin(u) * np.sin(v), np.sin(u) * np.cos(v)),
    )
    olive = surface(
        lambda u, v: (np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), 2 * np.sin(v)),
        lambda u, v: (-np.cos(v) * np.sin(u), np.cos(v) * np.cos(u), 0.0),
        lambda u, v: (-np.sin(v) * np.cos(u), -np.sin(v) * np.sin(u), 2 * np.cos(v)),
    )
    assert [_round_form(face)[0] for face in (oval, tilted, olive)] == ["other"] * 3
    rod = occ.WorkPlane().Ellipse(4e-3, 2.5e-3).Face().Extrude(0.01)
    assert sorted(face.kind for face in list_faces(rod)) == ["other", "plane", "plane"]


def test_a_spline_that_begins_straight_makes_neither_a_plane_nor_a_cylinder():
    """The first nine of its points are on a line, and the samples of its surface, at parameters up to 4.7, too."""
    points = [occ.Pnt(0.01 * x, 0, 0.01 * z) for x, z in [(k, 3) for k in range(9)] + [(9, 5), (10, 5)]]
    spline = occ.BSplineCurve(points, 3)
    corners = occ.Pnt(spline.end.x, 0, 0), occ.Pnt(spline.start.x, 0, 0)
    ends = [spline.end, *corners, spline.start]
    outline = occ.Face(occ.Wire([spline, *(occ.Segment(a, b) for a, b in itertools.pairwise(ends))]))
    block = outline.Extrude(occ.Vec(0, 0.05, 0))
    barrel = outline.Revolve(occ.Axis(occ.Pnt(0, 0, 0), occ.X), 360)
    assert [face.kind for face in list_faces(block)] == ["other"] + ["plane"] * 5
    assert [face.kind for face in list_faces(barrel)] == ["other", "plane", "plane"]


def test_tiny_bodies_are_drawn():
    """A ledge of 3 um around a post of 24 um: drawn in its own size, it ended the interpreter."""
    foot, post = occ.Box((0, 0, 0), (30, 30, 10)), occ.Box((3, 3, 10), (27, 27, 30))
    shape = glue([body.Scale(occ.Pnt(0, 0, 0), 1e-6) for body in (foot, post)])
    faces = list_faces(shape)
    assert [face.kind for face in faces] == ["plane"] * 12
    ledge = [face for face in faces if face.area == pytest.approx(30e-6**2 - 24e-6**2)]
    assert [tuple(face.normal) for face in ledge] == [(0, 0, 1)]
    corners, _, _ = solid_triangles(next(iter(shape.solids)))
    np.testing.assert_allclose(
        [corners.min(axis=(0, 1)), corners.max(axis=(0, 1))], [(0, 0, 0), (30e-6, 30e-6, 10e-6)], atol=1e-11
    )
