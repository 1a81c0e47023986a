"""Solids: CAD files written here with OpenCASCADE, read back, and the checks on what is read."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from netgen import occ

from nassim import Material, NearestTo, OnPlane, RemotePoint, Solid, build_fe_model, craig_bampton, read_solid
from nassim.fem import body_names, face_names, glue, name_faces, shape_bytes
from nassim.fem.meshing import generate_mesh

STEEL = Material("steel", 210e9, 0.3, 7850.0)
ALU = Material("aluminium", 70e9, 0.33, 2700.0)
SIZE = np.array([0.01, 0.02, 0.03])


def block(unit=1e-3):
    """A block of 10 x 20 x 30 mm, its upper face named "lid", in coordinates of the given unit [m]."""
    shape = occ.Box((0, 0, 0), tuple(SIZE / unit))
    shape.name = "block"
    shape.faces.Max(occ.Z).name = "lid"
    return shape


def tower():
    """Two cubes of 10 mm, one upon the other [mm]."""
    low, high = occ.Box((0, 0, 0), (10, 10, 10)), occ.Box((0, 0, 10), (10, 10, 20))
    low.name, high.name = "low", "high"
    return occ.Compound([low, high])


def written(shape, path):
    """Write a shape to a file; OpenCASCADE's writers look at the ending, so a small one goes first."""
    plain = path.with_suffix(path.suffix.lower())
    (shape.WriteStep if plain.suffix in (".step", ".stp") else shape.WriteBrep)(str(plain))
    return plain.rename(path)


def extent(solid):
    return np.ptp(np.array([tuple(corner) for corner in solid.shape.bounding_box]), axis=0)


def faces_named(solid, name):
    return [face for face in solid.shape.faces if face.name == name]


@pytest.mark.parametrize("ending", [".step", ".STEP", ".stp", ".StP", ".brep", ".BREP"])
def test_endings_in_any_letter_case(tmp_path, ending):
    solid = read_solid(written(block(), tmp_path / f"part{ending}"), STEEL)
    np.testing.assert_allclose(extent(solid), SIZE, atol=1e-6)
    assert solid.shape.mass == pytest.approx(SIZE.prod())
    assert solid.name == "part"


def test_step_keeps_names_of_bodies_and_faces(tmp_path):
    solid = read_solid(written(block(), tmp_path / "part.step"), {"block": ALU}, name="my part")
    assert body_names(solid.shape) == ("block",)
    assert face_names(solid.shape) == ("lid",)
    assert solid.materials["block"] is ALU
    assert solid.name == "my part"


def test_step_that_declares_metres(tmp_path):
    path = written(block(unit=1.0), tmp_path / "part.step")
    text = path.read_text()
    assert "SI_UNIT(.MILLI.,.METRE.)" in text
    path.write_text(text.replace("SI_UNIT(.MILLI.,.METRE.)", "SI_UNIT($,.METRE.)"))
    np.testing.assert_allclose(extent(read_solid(path, STEEL)), SIZE, atol=1e-6)


@pytest.mark.parametrize(("unit", "metres"), [("m", 1.0), ("mm", 1e-3), ("inch", 0.0254)])
def test_units_of_brep_files(tmp_path, unit, metres):
    path = written(block(unit=metres), tmp_path / "part.brep")
    np.testing.assert_allclose(extent(read_solid(path, STEEL, unit=unit)), SIZE, atol=1e-6)


@pytest.mark.parametrize(("ending", "names"), [(".step", ("low", "high")), (".brep", ("body 1", "body 2"))])
def test_several_bodies_share_their_faces(tmp_path, ending, names):
    path = written(tower(), tmp_path / f"tower{ending}")
    middle = OnPlane((0, 0, 0.01), (0, 0, 1))
    solid = read_solid(path, {names[0]: STEEL, names[1]: ALU}, faces={"middle": middle})
    assert body_names(solid.shape) == names
    assert [solid.materials[name] for name in names] == [STEEL, ALU]
    assert len(faces_named(solid, "middle")) == 2  # one face, listed once for either body
    assert solid.shape.mass == pytest.approx(2e-6)


def test_one_material_goes_to_all_bodies(tmp_path):
    solid = read_solid(written(tower(), tmp_path / "tower.step"), STEEL)
    assert dict(solid.materials) == {"low": STEEL, "high": STEEL}


@pytest.mark.parametrize(
    ("pick", "centre"),
    [
        (OnPlane((0, 0, 0), (0, 0, -5)), (0.005, 0.01, 0.0)),
        (OnPlane((0, 0, 0), (0, 0, 0.2)), (0.005, 0.01, 0.0)),
        (OnPlane((0.01, 0.3, -0.7), (1, 0, 0)), (0.01, 0.01, 0.015)),
        (NearestTo((0.005, 0.01, 0.04)), (0.005, 0.01, 0.03)),
        (NearestTo((0.001, 0.01, 0.015)), (0.0, 0.01, 0.015)),
        ("lid", (0.005, 0.01, 0.03)),
    ],
)
def test_picks(tmp_path, pick, centre):
    point = RemotePoint("end", "chosen", centre)
    solid = read_solid(written(block(), tmp_path / "part.step"), STEEL, faces={"chosen": pick}, remote_points=(point,))
    (face,) = faces_named(solid, "chosen")
    np.testing.assert_allclose(tuple(face.center), centre, atol=1e-9)
    assert solid.remote_points[0].faces == ("chosen",)


def test_plane_may_pick_several_faces(tmp_path):
    path = written(tower(), tmp_path / "tower.step")
    solid = read_solid(path, STEEL, faces={"side": OnPlane((0, 0, 0), (1, 0, 0), several=True)})
    assert sum(face.mass for face in faces_named(solid, "side")) == pytest.approx(2e-4)


@pytest.mark.parametrize(
    ("pick", "message"),
    [
        (OnPlane((0, 0, 0.02), (0, 0, 1)), r"'end': OnPlane.* finds no face. The solid has:(\n.*){6}'lid'"),
        (OnPlane((0, 0, 0.02), (0, 0, 1), several=True), "finds no face"),
        (OnPlane((0, 0, 0), (1, 1, 0)), "finds no face"),
        (
            NearestTo((0, 0, 0)),
            r"finds 3 faces, one is wanted. Found:\n  face 1: plane, 600 mm2 around \(0, 10, 15\) mm",
        ),
        ("roof", "name 'roof' finds no face. The solid has:"),
    ],
)
def test_picks_that_fail_list_the_faces(tmp_path, pick, message):
    path = written(block(), tmp_path / "part.step")
    with pytest.raises(ValueError, match=message):
        read_solid(path, STEEL, faces={"end": pick})


def test_plane_with_too_many_faces(tmp_path):
    path = written(tower(), tmp_path / "tower.step")
    with pytest.raises(ValueError, match=r"finds 2 faces, one is wanted. Found:(\n  face \d+: plane, 100 mm2 .*){2}$"):
        read_solid(path, STEEL, faces={"side": OnPlane((0, 0, 0), (1, 0, 0))})


@pytest.mark.parametrize("ending", [".step", ".brep", ".igs"])
def test_unreadable_file_is_named(tmp_path, ending):
    path = tmp_path / f"broken{ending}"
    path.write_text("this is not CAD\n")
    with pytest.raises(ValueError, match=rf"broken\{ending} is not a readable (STEP|BREP|IGES) file"):
        read_solid(path, STEEL)


def test_truncated_step_file(tmp_path):
    path = written(block(), tmp_path / "cut.step")
    path.write_text(path.read_text()[:8000])
    with pytest.raises(ValueError, match=r"cut\.step is not a readable STEP file"):
        read_solid(path, STEEL)


def test_file_without_a_body(tmp_path):
    block().faces[0].WriteBrep(str(tmp_path / "sheet.brep"))
    with pytest.raises(ValueError, match=r"sheet\.brep holds no CAD body, only surfaces"):
        read_solid(tmp_path / "sheet.brep", STEEL)


def test_wrong_endings_missing_files_and_units(tmp_path):
    with pytest.raises(ValueError, match=r"unknown ending '\.stl'; known: \.step, \.stp, \.iges"):
        read_solid(tmp_path / "part.stl", STEEL)
    with pytest.raises(FileNotFoundError, match=r"no such CAD file: .*part\.step"):
        read_solid(tmp_path / "part.step", STEEL)
    path = written(block(), tmp_path / "part.step")
    with pytest.raises(ValueError, match="unknown unit 'km'; known: m, mm, inch"):
        read_solid(path, STEEL, unit="km")


def test_body_without_material(tmp_path):
    path = written(tower(), tmp_path / "tower.step")
    with pytest.raises(ValueError, match="solid 'tower': CAD body 'high' has no material; given: low"):
        read_solid(path, {"low": STEEL})
    with pytest.raises(ValueError, match="CAD body 'low' has no material; given: none"):
        read_solid(path, {})


def cube(length):
    return Solid("cube", occ.Box((0, 0, 0), (length,) * 3), {"": STEEL})


MARGIN = 2e-7
"""That OpenCASCADE adds to a box around a shape [m]."""


def test_arguments_of_other_kinds_are_told_with_what_to_do():
    shape = occ.Box((0, 0, 0), tuple(SIZE))
    assert dict(Solid("block", shape, STEEL).materials) == {"": STEEL}
    for arguments, message in (
        (("file.step", STEEL), "solid 'block': shape must be a TopoDS_Shape, got str; read_solid reads a file"),
        ((shape, [STEEL]), "materials must be a Mapping, got list; a Material for each of the CAD bodies"),
        ((shape, {"": 2e11}), "material of CAD body '' must be a Material, got float"),
        ((shape, STEEL, {"top": (0, 0, 0)}), "remote_points must be a tuple of RemotePoint, got dict"),
    ):
        with pytest.raises(ValueError, match=message):
            Solid("block", *arguments)
    with pytest.raises(ValueError, match=r"solid must be a Solid, got netgen.*; Solid.name, shape, materials. makes"):
        build_fe_model(shape, element_size=0.01)
    with pytest.raises(ValueError, match=r"fe_model must be a FEModel, got .*solid.Solid; build_fe_model makes"):
        craig_bampton(Solid("block", shape, STEEL))


def test_solid_below_a_thousandth_of_a_millimetre_is_refused():
    with pytest.raises(ValueError, match=r"solid 'cube' is 7e-07 m long; at least 1e-06 m .* the CAD file's unit"):
        cube(5e-7)
    with pytest.raises(ValueError, match="at least 1e-06 m"):
        cube(0.9e-6 - MARGIN)
    with pytest.warns(UserWarning, match="unless that is right"):
        cube(1.1e-6 - MARGIN)


def test_long_solid_is_warned_of_and_meshed():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cube(9.9)
    with pytest.warns(UserWarning, match="solid 'cube' is 10.1 m long"):
        cube(10.1)
    with pytest.warns(UserWarning, match="solid 'cube' is 200 m long; shapes are in metres") as told:
        solid = cube(200.0)
    assert told[0].filename == __file__
    for extrude in (None, "x"):
        model = build_fe_model(solid, element_size=100.0, order=2, extrude=extrude, progress=False)
        assert model.mass == pytest.approx(7850 * 200.0**3, rel=1e-9)


def test_a_point_far_from_its_solid_is_told():
    """Up to ten lengths are an arm; further away it was given in millimetres."""
    shape = occ.Box((0.1, 0, 0), (0.15, 0.02, 0.002))
    shape.faces.Min(occ.X).name = "root"
    points = [RemotePoint(f"arm of {arm} m", "root", (0.15 + arm, 0.01, 0.001)) for arm in (0.49, 0.51)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Solid("leaf", shape, STEEL, points[:1])
    with pytest.warns(UserWarning, match="'arm of 0.51 m' is 0.51 m away from solid 'leaf', which is 0.05 m") as told:
        Solid("leaf", shape, STEEL, points[1:])
    assert [warning.filename for warning in told] == [__file__]


def overlapping():
    """Two cubes of 10 mm, one pushed half into the other, and a third that touches the second [mm]."""
    low, high, beside = (occ.Box((0, 0, z), (10, 10, z + 10)) for z in (0, 5, 15))
    low.name, high.name, beside.name = "foot (1)", "post", "lid"
    return [low, high, beside]


def test_overlapping_bodies_are_refused_by_name(tmp_path):
    message = r"solid 'tower': CAD bodies 'foot \(1\)' and 'post' share 50 % of the smaller one's volume"
    path = written(occ.Compound(overlapping()), tmp_path / "tower.step")
    with pytest.raises(ValueError, match=message):
        read_solid(path, STEEL)
    with pytest.raises(ValueError, match=message):
        glue(overlapping(), name="tower")
    materials = dict.fromkeys(("foot (1)", "post", "lid"), STEEL)
    with pytest.raises(ValueError, match=message):
        Solid("tower", occ.Compound([body.Scale(occ.Pnt(0, 0, 0), 1e-3) for body in overlapping()]), materials)


def test_bodies_overlap_from_a_ten_thousandth_of_the_smaller_one():
    for share in (0.9e-4, 1.1e-4):
        low, high = occ.Box((0, 0, 0), (10, 10, 10)), occ.Box((0, 0, 10 - 10 * share), (10, 10, 20))
        if share < 1e-4:
            glue([low, high])
        else:
            with pytest.raises(ValueError, match=r"share 0\.011 % of the smaller one's volume"):
                glue([low, high])


@pytest.mark.parametrize(("height", "refused"), [(1.0009, False), (0.9989, True), (None, True)])
def test_bodies_that_are_damaged_by_gluing_are_refused(monkeypatch, height, refused):
    """As it does below some 30 um, where it takes edges that are 1e-7 m apart for one."""
    low, high = tower().solids
    upper = [occ.Box((0, 0, 10), (10, 10, 10 + 10 * height))] if height else []
    monkeypatch.setattr("nassim.fem.solid.occ.Glue", lambda _: occ.Compound([low, *upper]))
    if not refused:
        glue([low, high])
        return
    with pytest.raises(ValueError, match="damages CAD bodies where it joins them" + ": 'high' had 1e" * bool(height)):
        glue([low, high])


def test_picks_are_exact_to_a_thousandth_of_a_millimetre_and_of_a_radian():
    """A plane beside the floor, or tilted against it about the floor's centre; its normal of any length."""
    for share, length in ((0.9, 1.0), (0.9, 5.0), (1.1, 1.0), (1.1, 0.2)):
        beside = OnPlane((0.005, 0.01, 1e-6 * share), (0, 0, length))
        tilted = OnPlane((0.005, 0.01, 0), (1e-3 * share * length, 0, length))
        for pick in (beside, tilted):
            if share < 1:
                name_faces(shape := block(unit=1.0), {"floor": pick})
                assert [face.center.z for face in shape.faces if face.name == "floor"] == [0.0]
            else:
                with pytest.raises(ValueError, match="finds no face"):
                    name_faces(block(unit=1.0), {"floor": pick})


def test_two_faces_are_equally_near_to_a_billionth_of_a_metre():
    for share in (0.9, 1.1):
        shape, pick = block(unit=1.0), NearestTo((1e-3, 1e-3 + 1e-9 * share, 0.015))
        if share > 1:
            name_faces(shape, {"west": pick})
            assert [face.center.x for face in shape.faces if face.name == "west"] == [0.0]
        else:
            with pytest.raises(ValueError, match="finds 2 faces, one is wanted"):
                name_faces(shape, {"west": pick})


def test_bodies_that_touch_on_curved_faces_do_not_overlap():
    """A pin in its bore, their boxes one within the other."""
    pin = occ.Cylinder(occ.Pnt(0, 0, 0), occ.Z, 0.01, 0.02)
    ring = occ.Box((-0.02, -0.02, 0), (0.02, 0.02, 0.02)) - pin
    ring.name, pin.name = "ring", "pin"
    solid = Solid("pressed", glue([ring, pin]), {"ring": ALU, "pin": STEEL})
    assert solid.shape.mass == pytest.approx(0.04**2 * 0.02, rel=1e-9)


def solid_with(*points):
    shape = block(unit=1.0)
    name_faces(shape, {"floor": OnPlane((0, 0, 0), (0, 0, 1))})
    return Solid("part", shape, {"block": STEEL}, points)


def test_solid_is_frozen():
    solid = solid_with(RemotePoint("top", "lid", (0, 0, 0.03), "rbe2"))
    with pytest.raises(TypeError):
        solid.materials["block"] = ALU
    with pytest.raises(AttributeError):
        solid.name = "other"
    with pytest.raises(ValueError, match="read-only"):
        solid.remote_points[0].position[0] = 1.0


ORIGIN = (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([("a", "lid"), ("b", ("floor", "lid"))], "remote points 'a' and 'b' both claim the face 'lid'"),
        ([("a", ())], "remote point 'a' has no faces; known faces: floor, lid"),
        ([("a", "wall")], "unknown face 'wall'; known: floor, lid"),
        ([("a", "lid"), ("a", "floor")], "remote point names must differ; used more than once: a"),
    ],
)
def test_remote_points_of_a_solid_are_checked(points, message):
    with pytest.raises(ValueError, match=message):
        solid_with(*(RemotePoint(name, faces, ORIGIN) for name, faces in points))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("a", "lid", (0, 0, np.nan)), "remote point 'a': position holds 1 value.* NaN"),
        (("a", "lid", (0, 0)), "remote point 'a': position must have shape 3, got 2"),
        (("a", ("lid", "lid"), ORIGIN), "'a': face names must differ; used more than once: lid"),
        (("a", ("",), ORIGIN), "face names must be non-empty"),
        (("a", "lid", ORIGIN, "glue"), "unknown coupling 'glue'; known: rbe2, rbe3"),
    ],
)
def test_remote_point_checks_itself(arguments, message):
    with pytest.raises(ValueError, match=message):
        RemotePoint(*arguments)


@pytest.mark.parametrize(
    ("pick", "arguments", "message"),
    [
        (OnPlane, (ORIGIN, (0, 0, 0)), "normal of a plane must not be zero"),
        (OnPlane, (ORIGIN, (0, 0, np.nan)), "normal holds 1 value.* NaN"),
        (OnPlane, ((0, 0), (0, 0, 1)), "point must have shape 3, got 2"),
        (NearestTo, ((0, 0, np.inf),), "point holds 1 value.* infinite"),
    ],
)
def test_picks_check_themselves(pick, arguments, message):
    with pytest.raises(ValueError, match=message):
        pick(*arguments)


def test_mesh_fills_the_volume():
    mesh = generate_mesh(solid_with(), element_size=0.01)
    corners = mesh.Coordinates()[np.array([[v.nr - 1 for v in e.vertices] for e in mesh.Elements3D()])]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert np.abs(volumes).sum() == pytest.approx(SIZE.prod())
    assert len(generate_mesh(solid_with(), element_size=0.004).Elements3D()) > 2 * len(volumes)


@pytest.mark.parametrize(
    ("size", "message"),
    [
        (0.0, "element_size must be positive, got 0 m"),
        (np.nan, "element_size holds 1 value.* NaN"),
        (2e-5, "element_size 2e-05 m is below a thousandth of the solid 'part'"),
        (5.0, r"element_size 5 m is longer than the solid 'part', which is 0\.03\d* m long; .* 5e-3 for 5 mm"),
    ],
)
def test_element_size_is_checked(size, message):
    with pytest.raises(ValueError, match=message):
        generate_mesh(solid_with(), element_size=size)


def test_an_element_is_between_a_thousandth_and_all_of_the_length(monkeypatch):
    def mesh(*_):
        raise InterruptedError

    monkeypatch.setattr("nassim.fem.meshing._mesh", mesh)
    for size, fault in ((0.9e-3, ValueError), (1.1e-3, InterruptedError), (0.9, InterruptedError), (1.1, ValueError)):
        with pytest.raises(fault):
            generate_mesh(solid_with(), element_size=size * SIZE.max())


def test_shape_bytes_see_shape_and_names(tmp_path):
    path = written(block(), tmp_path / "part.step")
    same = [shape_bytes(read_solid(Path(path), STEEL).shape) for _ in range(2)]
    renamed = shape_bytes(read_solid(path, STEEL, faces={"roof": "lid"}).shape)
    larger = shape_bytes(read_solid(path, STEEL, unit="inch").shape)
    assert same[0] == same[1]
    assert len({same[0], renamed, larger}) == 3
    shape = read_solid(path, STEEL).shape
    for item in (shape.faces.Max(occ.Z), next(iter(shape.solids))):
        name, item.name = item.name, "other"
        assert shape_bytes(shape) not in same
        item.name = name
    assert shape_bytes(shape) == same[0]


def test_a_rigid_part_has_the_inertia_of_its_boxes_and_materials():
    """Of two boxes at odd places, by their closed forms and the parallel axis theorem; products of inertia too."""
    sizes, corners = np.array([[0.1, 0.2, 0.3], [0.3, 0.1, 0.05]]), np.array([[1.0, 2, 3], [1.1, 2, 3]])
    boxes = [occ.Box(tuple(corner), tuple(corner + size)) for corner, size in zip(corners, sizes, strict=True)]
    for box, name in zip(boxes, ("heavy", "light"), strict=True):
        box.name = name
    light = replace(STEEL, density=2700.0)
    solid = Solid("two", glue(boxes), {"heavy": STEEL, "light": light})
    mass, centre, inertia = solid.rigid_inertia
    m = np.array([STEEL.density, 2700.0]) * sizes.prod(axis=1)
    expected = m @ (corners + sizes / 2) / m.sum()
    assert mass == pytest.approx(m.sum(), rel=1e-12)
    np.testing.assert_allclose(centre, expected, rtol=1e-12)
    about = np.zeros((3, 3))
    for own, size, arm in zip(m, sizes, corners + sizes / 2 - expected, strict=True):
        about += own / 12 * (size @ size * np.eye(3) - np.diag(size**2)) + own * (arm @ arm * np.eye(3))
        about -= own * np.outer(arm, arm)
    np.testing.assert_allclose(inertia, about, rtol=1e-9, atol=1e-9)
    assert np.abs(about[0, 1]) > 0.01
