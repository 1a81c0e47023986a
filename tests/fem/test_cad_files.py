"""Assemblies from STEP files as CAD programs write them, and files with faults."""

import re
import warnings
from itertools import product

import netgen.occ as occ
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from step_assembly import write_assembly

from nassim import (
    Extreme,
    Material,
    OfColour,
    OnBody,
    RemotePoint,
    Solid,
    build_fe_model,
    craig_bampton,
    face_table,
    list_faces,
    read_solid,
)
from nassim.fem import body_names, face_names, glue
from nassim.fem.cad_files import _with_telling_names, open_edges, read_bodies

STEEL = Material("steel", 210e9, 0.3, 7850.0)
ALU = Material("aluminium", 70e9, 0.33, 2700.0)
BRASS = Material("brass", 100e9, 0.35, 8500.0)
TURN = Rotation.from_rotvec([0.4, -0.9, 0.6]).as_matrix()
SHIFT = np.array([30.0, -70.0, 12.0])
HALF = np.diag([-1.0, -1.0, 1.0])
"""Half a turn about z."""
BOXES = {
    "base": ((0, 0, 0), (40, 30, 5), ALU),
    "pillar": ((2, 3, 5), (6, 9, 25), STEEL),
    "pillar:2": ((32, 20, 5), (36, 26, 25), STEEL),
    "table": ((0, 0, 25), (40, 30, 30), ALU),
    "motor": ((10, 8, 30), (30, 22, 40), BRASS),
}
"""Lowest and highest corner [mm] and material of the bodies of the machine, before it is turned and shifted."""
MATERIALS = {"*": ALU, "pillar": STEEL, "mot*": BRASS}
PURE = dict(zip(product(("motor", "base"), "XY", ("Min", "Max")), product((0, 1), repeat=3), strict=True))
"""Red, green and blue by body, axis and end of faces: the colours that STEP files write by name."""


def box(name):
    return occ.Box(*BOXES[name][:2])


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    """A table on two equal pillars, the second one turned by half a turn."""
    pillar = occ.Box((0, 0, 0), (4, 6, 20))
    pillar.name, pillar.col = "Boss-Extrude1", (1, 0, 0)
    pillar.faces.Max(occ.Z).name = "top"
    parts = {"base": box("base"), "pillar": pillar, "table": box("table"), "motor": box("motor")}
    parts["table"].faces.Max(occ.X).col = (0.2, 0.4, 0.6)
    for (part, axis, end), colour in PURE.items():
        getattr(parts[part].faces, end)(getattr(occ, axis)).col = colour
    instances = [
        ("base", "NAUO1", (0, 0, 0), np.eye(3)),
        ("pillar", "pillar-1", (2, 3, 5), np.eye(3)),
        ("pillar", "pillar-2", (36, 26, 5), HALF),
        ("table", "", (0, 0, 0), np.eye(3)),
        ("motor", "=>[0:1:1:4]", (0, 0, 0), np.eye(3)),
    ]
    placed = [(part, name, TURN @ np.array(p) + SHIFT, TURN @ turn) for part, name, p, turn in instances]
    return write_assembly(tmp_path_factory.mktemp("step") / "machine.step", parts, placed)


def read(path, **options):
    foot = RemotePoint("foot", "underside", 1e-3 * (TURN @ (20, 15, 0) + SHIFT))
    faces = {"underside": OnBody("base", Extreme(-TURN[:, 2]))}
    return read_solid(path, MATERIALS, faces=faces, remote_points=(foot,), **options)


def test_bodies_have_the_names_of_their_parts_and_stand_where_they_should(machine):
    solid = read(machine)
    assert body_names(solid.shape) == tuple(BOXES)
    assert {name: material.name for name, material in solid.materials.items()} == {
        name: material.name for name, (_, _, material) in BOXES.items()
    }
    for body in solid.shape.solids:
        low, high, _ = map(np.array, BOXES[body.name])
        assert body.mass == pytest.approx(1e-9 * np.prod(high - low), rel=1e-9)
        np.testing.assert_allclose(tuple(body.center), 1e-3 * (TURN @ (low + high) / 2 + SHIFT), atol=1e-9)
    assert sum(len(face.bodies) == 2 for face in list_faces(solid)) == 5  # glued


def test_instances_have_the_names_and_colours_of_faces(machine):
    solid = read_solid(machine, STEEL, faces={"side": OfColour("#7caacb")})
    faces = list_faces(solid.shape)
    tops = [face for face in faces if face.name == "top"]
    assert [face.bodies for face in tops] == [("pillar", "table"), ("pillar:2", "table")]
    reds = [face for face in faces if face.colour == "#ff0000" and len(face.bodies) == 1]
    assert {face.bodies[0] for face in reds} == {"base", "pillar", "pillar:2"}
    for (part, axis, end), colour in PURE.items():
        outward = TURN[:, "XY".index(axis)] * (1 if end == "Max" else -1)
        (found,) = [face.colour for face in faces if face.bodies == (part,) and face.normal @ outward > 0.99]
        assert found == "#" + "".join("ff" if light else "00" for light in colour)
    (side,) = [face for face in faces if face.name == "side"]
    np.testing.assert_allclose(side.normal, TURN[:, 0], atol=1e-9)


@pytest.mark.parametrize("context", ["representation", "placement"])
def test_the_colour_of_one_instance_is_not_that_of_the_others(machine, tmp_path, context):
    """The second pillar (entities from #300) is green, but for its top, which has a colour of its own."""
    text = machine.read_text(encoding="latin-1")
    solid = re.search(r"(#2\d{5}) = MANIFOLD_SOLID_BREP", text)[1]
    styled, colour = re.search(r"(#2\d{5}) = STYLED_ITEM\('color',\((#2\d{5})\)", text).groups()
    top = re.search(r"(#2\d{5}) = ADVANCED_FACE\('top'", text)[1]
    assert text.count("#7 = PRODUCT_DEFINITION_SHAPE('','',#6);") == 1
    more = f"""#60 = OVER_RIDING_STYLED_ITEM('overriding color',(#61),{solid},{styled});
#61 = PRESENTATION_STYLE_BY_CONTEXT((#62),{"#68" if context == "representation" else "#304"});
#62 = SURFACE_STYLE_USAGE(.BOTH.,#63);
#63 = SURFACE_SIDE_STYLE('',(#64));
#64 = SURFACE_STYLE_FILL_AREA(#65);
#65 = FILL_AREA_STYLE('',(#66));
#66 = FILL_AREA_STYLE_COLOUR('',#69);
#67 = SHAPE_DEFINITION_REPRESENTATION(#307,#68);
#68 = SHAPE_REPRESENTATION('',(#300),#200000);
#69 = DRAUGHTING_PRE_DEFINED_COLOUR('green');
#70 = OVER_RIDING_STYLED_ITEM('overriding color',(#71),{top},{styled});
#71 = PRESENTATION_STYLE_ASSIGNMENT((#72));
#72 = SURFACE_STYLE_USAGE(.BOTH.,#73);
#73 = SURFACE_SIDE_STYLE('',(#74));
#74 = SURFACE_STYLE_FILL_AREA(#75);
#75 = FILL_AREA_STYLE('',(#76));
#76 = FILL_AREA_STYLE_COLOUR('',#79);
#79 = DRAUGHTING_PRE_DEFINED_COLOUR('blue');
"""
    path = tmp_path / "machine.step"
    path.write_text(text.replace("#1 = APPLICATION_CONTEXT", more + "#1 = APPLICATION_CONTEXT"), encoding="latin-1")
    faces = list_faces(read(path).shape)
    for body, colour in (("pillar", "#ff0000"), ("pillar:2", "#00ff00")):
        own = [face.colour for face in faces if face.bodies[0] == body and face.name != "top"]
        assert set(own) == {colour}
    assert [face.colour for face in faces if face.name == "top"] == ["#0000ff"] * 2


def expected_inertia():
    """Mass, centre and moments about it of the boxes, in closed form."""
    masses, centres, moments = [], [], []
    for low, high, material in BOXES.values():
        size, centre = 1e-3 * (np.array(high) - low), 0.5e-3 * (np.array(high) + low)
        masses.append(material.density * np.prod(size))
        centres.append(TURN @ centre + 1e-3 * SHIFT)
        moments.append(masses[-1] / 12 * TURN @ np.diag(size @ size - size**2) @ TURN.T)
    mass, centre = sum(masses), np.average(centres, axis=0, weights=masses)
    arms = np.array(centres) - centre
    steiner = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, arms, strict=True))
    return mass, centre, sum(moments) + steiner


@pytest.mark.slow
def test_mass_inertia_and_modes_of_an_assembly(machine):
    """Modes are those of the same boxes without a file and without a turn."""
    options = {"element_size": 0.015, "order": 3, "progress": False}
    body = craig_bampton(build_fe_model(read(machine), **options), n_modes=8)
    mass, centre, inertia = expected_inertia()
    assert body.mass == pytest.approx(mass, rel=1e-9)
    np.testing.assert_allclose(body.center_of_mass, centre, atol=1e-9)
    second = body.gram[1:4, 1:4] - mass * np.outer(centre, centre)
    np.testing.assert_allclose(np.trace(second) * np.eye(3) - second, inertia, atol=1e-9 * np.trace(inertia))

    boxes = {name: occ.Box(*(tuple(1e-3 * np.array(c)) for c in corners)) for name, (*corners, _) in BOXES.items()}
    for name, shape in boxes.items():
        shape.name = name
    boxes["base"].faces.Min(occ.Z).name = "underside"
    foot = RemotePoint("foot", "underside", (0.02, 0.015, 0))
    materials = {name: material for name, (_, _, material) in BOXES.items()}
    straight = Solid("machine", glue(list(boxes.values())), materials, (foot,))
    other = craig_bampton(build_fe_model(straight, **options), n_modes=8)
    for fixed, first in (([], 6), (["foot"], 0)):
        found, expected = (b.eigenfrequencies(fixed=fixed, n=first + 3)[first:] for b in (body, other))
        assert found == pytest.approx(expected, rel=5e-3)  # the meshes differ


@pytest.mark.parametrize(
    ("materials", "message"),
    [
        ({"*": ALU, "bolt": STEEL}, "no CAD body for the material 'bolt'; its CAD bodies are base, pillar, pillar:2"),
        ({"pill*": STEEL}, "CAD body 'base' has no material"),
    ],
)
def test_materials_that_fit_no_body(machine, materials, message):
    with pytest.raises(ValueError, match=message):
        read_solid(machine, materials)


def test_the_name_of_an_instance_goes_before_its_part_and_a_pattern(machine):
    solid = read_solid(machine, {"pillar:2": BRASS, "pill*": ALU, "pillar": STEEL, "*": ALU})
    assert [solid.materials[name] for name in ("pillar", "pillar:2", "base")] == [STEEL, BRASS, ALU]


def test_bodies_of_one_part_have_their_own_names(tmp_path):
    """An instance without a name, which some programs write as $, is read too."""
    pair = [occ.Box((0, 0, 0), (1, 1, 1)), occ.Box((3, 0, 0), (4, 1, 1))]
    pair[0].name, pair[1].name = "left", "right"
    parts = {"pair": occ.Compound(pair), "bar": occ.Box((6, 0, 0), (7, 1, 1))}
    path = write_assembly(tmp_path / "pair.step", parts, [(part, "unnamed", np.zeros(3), np.eye(3)) for part in parts])
    path.write_text(path.read_text().replace("'unnamed',''", "$,$"))
    assert [body.name for body in read_bodies(path, 1e-3)] == ["left", "right", "bar"]
    alone = "#1 = NEXT_ASSEMBLY_USAGE_OCCURRENCE('1','bolt','',#2,#3,$);"
    assert _with_telling_names(alone) == alone, "its part is an entity of another kind"


def test_a_part_that_is_placed_once_keeps_its_name_and_those_of_its_faces(tmp_path):
    pin = occ.Box((0, 0, 0), (4, 6, 20))
    pin.faces.Max(occ.X).name, pin.faces.Max(occ.Z).col = "side", (1, 0, 0)
    path = write_assembly(tmp_path / "one.step", {"pin": pin}, [("pin", "pin-1", SHIFT, TURN)])
    (body,) = read_bodies(path, 1e-3)
    assert body.name == "pin"
    np.testing.assert_allclose(tuple(body.center), 1e-3 * (TURN @ (2, 3, 10) + SHIFT), atol=1e-9)
    (side,) = [face for face in list_faces(body) if face.name == "side"]
    (red,) = [face for face in list_faces(body) if face.colour == "#ff0000"]
    np.testing.assert_allclose([side.normal, red.normal], TURN.T[[0, 2]], atol=1e-9)


COPIES = """#9000 = SHAPE_REPRESENTATION('',(#9001,#9002,#9004),{context});
#9001 = MAPPED_ITEM('',#9003,#9004);
#9002 = MAPPED_ITEM('',#9003,#9009);
#9003 = REPRESENTATION_MAP({origin},{shape});
#9004 = AXIS2_PLACEMENT_3D('',#9005,#9007,#9008);
#9005 = CARTESIAN_POINT('',(0.,0.,0.));
#9006 = CARTESIAN_POINT('',(50.,20.,30.));
#9007 = DIRECTION('',(0.,0.,1.));
#9008 = DIRECTION('',(1.,0.,0.));
#9009 = CARTESIAN_TRANSFORMATION_OPERATOR_3D('','','',#9010,{second},#9006,{scale},#9007);
#9010 = DIRECTION('',({first},0.,0.));
#9011 = DIRECTION('',(0.,{first},0.));
ENDSEC;
END-ISO"""


@pytest.mark.parametrize(
    ("first", "second", "scale", "told"),
    [
        ("1.", "$", "$", False),
        ("-1.", "#9011", "0.9999999999999998", False),
        ("-1.", "$", "1.", True),
        ("1.", "#9011", "2.", True),
    ],
)
def test_copies_that_are_mirrored_or_scaled_are_told(tmp_path, first, second, scale, told):
    pin = occ.Box((0, 0, 0), (4, 6, 20))
    pin.name = "pin"
    path = written(pin, tmp_path / "pins.step")
    text = path.read_text()
    shape = re.search(r"SHAPE_DEFINITION_REPRESENTATION\(#\d+,(#\d+)\)", text)[1]
    found = re.search(rf"{shape} = \w*SHAPE_REPRESENTATION\('[^']*',\((#\d+).*?\),(#\d+)\);", text, re.DOTALL)
    more = COPIES.format(shape=shape, origin=found[1], context=found[2], first=first, second=second, scale=scale)
    text = re.sub(rf"(SHAPE_DEFINITION_REPRESENTATION\(#\d+,){shape}", r"\1#9000", text)
    path.write_text(text.replace("ENDSEC;\nEND-ISO", more))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        bodies = read_bodies(path, 1e-3)
    assert ["mirrors or scales 1 placed part(s)" in str(warning.message) for warning in caught] == told * [True]
    assert [body.name for body in bodies] == ["pin", "pin:2"]
    if not told:
        np.testing.assert_allclose(
            tuple(bodies[1].center), 1e-3 * np.array([50, 20, 40]) + float(first) * np.array([2e-3, 3e-3, 0])
        )


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8"])
def test_letters_beyond_ascii(tmp_path, encoding):
    parts = {"pin": occ.Box((0, 0, 0), (1, 1, 1)), "bar": occ.Box((2, 0, 0), (3, 1, 1))}
    path = write_assembly(tmp_path / "parts.step", parts, [(part, "", np.zeros(3), np.eye(3)) for part in parts])
    text = path.read_text().replace("'pin'", "'Träger'").replace("'bar'", r"'F\X2\00FC\X0\hler'")
    path.write_text(text, encoding=encoding)
    assert [body.name for body in read_bodies(path, 1e-3)] == ["Träger", "Fühler"]


@pytest.mark.parametrize("own", ["", "#10=STYLED_ITEM('',(#3),#7);\n"])
def test_a_face_may_override_the_colour_of_its_body(own):
    """And a colour of its own, whichever is written first."""
    text = own + (
        "#1=COLOUR_RGB('',1.,0.,0.);\n#2=COLOUR_RGB('',0.,0.,1.);\n#3=PRESENTATION_STYLE_ASSIGNMENT((#1));\n"
        "#4=PRESENTATION_STYLE_ASSIGNMENT((#2));\n#5=STYLED_ITEM('',(#3),#8);\n"
        "#6=OVER_RIDING_STYLED_ITEM('',(#4),#7,#5);\n#7=ADVANCED_FACE('top',(#9),#9,.T.);\n"
        "#8=MANIFOLD_SOLID_BREP('body',#9);\n"
    )
    for order in (text, "\n".join(text.split("\n")[::-1])):
        told = _with_telling_names(order)
        assert "ADVANCED_FACE('top\t#0000ff'" in told
        assert "MANIFOLD_SOLID_BREP('body\t#ff0000'" in told


def test_every_instance_of_a_part_has_a_name_of_its_own(tmp_path):
    """A number is not given twice, nor where a part has such a name already."""
    parts = ["pin", "pin:3", "pin", "pin", "nut", "pin"]
    placed = [(part, "", 10.0 * np.array([k, 0, 0]), np.eye(3)) for k, part in enumerate(parts)]
    path = write_assembly(tmp_path / "pins.step", {part: occ.Box((0, 0, 0), (1, 1, 1)) for part in parts}, placed)
    found = {body.name: round(1e3 * body.center[0] / 10) for body in read_bodies(path, 1e-3)}
    assert found == {"pin": 0, "pin:3": 1, "pin:2": 2, "pin:4": 3, "nut": 4, "pin:5": 5}


def written(shape, path):
    (shape.WriteStep if path.suffix == ".step" else shape.WriteBrep)(str(path))
    return path


def changed(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


INCH = """( CONVERSION_BASED_UNIT('INCH',#9001) LENGTH_UNIT() NAMED_UNIT(#9002) );
#9001 = LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#9003);
#9002 = DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.);
#9003 = ( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) );"""


def test_inches_are_converted(tmp_path):
    path = written(occ.Box((0, 0, 0), (1, 2, 3)), tmp_path / "part.step")
    changed(path, "( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) );", INCH)
    assert read_solid(path, STEEL).shape.mass == pytest.approx(6 * 0.0254**3)


@pytest.mark.parametrize("ending", [".step", ".stp", ".STP"])
def test_a_file_without_a_unit_is_told(tmp_path, ending):
    path = written(occ.Box((0, 0, 0), (1, 2, 3)), tmp_path / "part.step").rename(tmp_path / f"part{ending}")
    declared = "( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) )"
    changed(path, declared, "( NAMED_UNIT(*) SOLID_ANGLE_UNIT() SI_UNIT($,.STERADIAN.) )")
    with pytest.warns(UserWarning, match=rf"part\{ending} declares no unit of length: millimetres are") as told:
        assert read_solid(path, STEEL).shape.mass == pytest.approx(6e-9)
    assert told[0].filename == __file__
    assert read_solid(path, STEEL, unit="m").shape.mass == pytest.approx(6.0)


def test_the_table_of_faces_of_a_file(machine):
    """It has the numbers of the faces of the solid that is read from the file."""
    assert face_table(str(machine)) == face_table(read_solid(machine, STEEL))


def test_metres_read_as_millimetres_are_told(tmp_path):
    path = written(occ.Box((0, 0, 0), (0.3, 0.2, 0.1)), tmp_path / "part.step")
    with pytest.warns(UserWarning, match=r"'part' is 0\.0003\d* m long; .* unless that is right"):
        read_solid(path, STEEL)
    assert read_solid(path, STEEL, unit="m").shape.mass == pytest.approx(0.006)
    assert "6e+06" in face_table(path, unit="m")
    assert "0.006" in face_table(path)


def test_bodies_that_are_not_closed(tmp_path):
    """A block without one of its faces, from a file and made here."""
    path = written(occ.Box((0, 0, 0), (10, 20, 30)), tmp_path / "part.step")
    text = path.read_text()
    first = text[text.index("CLOSED_SHELL('',(") + 17 :].partition(",")[0]
    changed(path, f"CLOSED_SHELL('',({first},", "CLOSED_SHELL('',(")
    with pytest.raises(ValueError, match=r"only surfaces or curves; its 5 face\(s\) have 4 open edge\(s\), one "):
        read_solid(path, STEEL)
    block = occ.Solid(occ.Sew(list(occ.Box((0, 0, 0), (0.01, 0.02, 0.03)).faces)[1:]))
    block.name = "block"
    with pytest.raises(ValueError, match="CAD body 'block' is not closed: 4 of its edges bound only one face, one at"):
        Solid("part", block, {"block": STEEL})


def test_a_part_that_is_not_closed_is_told(tmp_path):
    block, cover = occ.Box((0, 0, 0), (10, 20, 30)), occ.Box((20, 0, 0), (30, 20, 30))
    parts = {"block": block, "cover": occ.Sew(list(cover.faces)[1:])}
    instances = [(part, "", TURN @ SHIFT, TURN) for part in parts]
    with pytest.warns(UserWarning, match="5 face\\(s\\) of 'cover' belong to no CAD body and are left out") as told:
        solid = read_solid(write_assembly(tmp_path / "pair.step", parts, instances), STEEL)
    assert [warning.filename for warning in told] == [__file__]
    assert body_names(solid.shape) == ("block",)


def sheets(*, gap):
    """The faces of a block, one of them shifted along its plane and named [mm]."""
    faces = list(occ.Box((0, 0, 0), (10, 20, 30)).faces)
    faces[0] = faces[0].Move(occ.Vec(0, 0, gap))
    faces[1].name = "side"
    return occ.Compound(faces)


@pytest.mark.parametrize("ending", [".step", ".brep"])
def test_surfaces_with_gaps_are_told_and_closed_on_request(tmp_path, ending):
    path = written(sheets(gap=2e-3), tmp_path / f"part{ending}")
    with pytest.raises(ValueError, match=r"only surfaces or curves; its 6 face\(s\) have \d+ open edge\(s\), one at "):
        read_solid(path, STEEL)
    solid = read_solid(path, STEEL, heal=5e-6)
    assert solid.shape.mass == pytest.approx(6e-6, rel=1e-3)
    assert open_edges(solid.shape) == []
    assert face_names(solid.shape) == (("side",) if ending == ".step" else ())


def test_a_sliver_is_told_and_removed_on_request(tmp_path, capfd):
    """A step of 2 um across a bar of 40 mm."""
    bar = occ.Box((0, 0, 0), (20, 10, 10)) + occ.Box((20, 0, 0), (40, 10, 10.002))
    bar.faces.Max(occ.X).name, bar.faces.Min(occ.Y).name = "end", "side"  # the side gets other edges
    path = written(bar, tmp_path / "bar.step")
    with pytest.warns(UserWarning, match=r"2 edge\(s\) and 1 face\(s\) .* the smallest 2 um at \(20, ") as told:
        solid = read_solid(path, STEEL)
    assert [warning.filename for warning in told] == [__file__]
    healed = read_solid(path, STEEL, heal=5e-6)
    assert (len(solid.shape.faces), len(healed.shape.faces)) == (8, 7)
    assert set(face_names(healed.shape)) == {"end", "side"}
    assert healed.shape.mass == pytest.approx(solid.shape.mass, rel=1e-4)
    assert capfd.readouterr().out == ""
    with pytest.raises(ValueError, match="heal must be positive, got -1 m"):
        read_solid(path, STEEL, heal=-1.0)


def test_several_bodies_of_a_file_are_healed(tmp_path):
    """A bar with a sliver on a plate, and a surface beside them, which is told."""
    bar = occ.Box((0, 0, 0), (20, 10, 10)) + occ.Box((20, 0, 0), (40, 10, 10.002))
    plate, bar.name = occ.Box((0, 0, -5), (40, 10, 0)), "bar"
    plate.name, plate.faces.Max(occ.X).name = "plate", "end"
    beside = occ.Box((60, 0, 0), (61, 1, 1)).faces.Max(occ.X)
    path = written(occ.Compound([bar, plate, beside]), tmp_path / "bodies.step")
    with pytest.warns(UserWarning, match="1 face") as told:
        healed = read_bodies(path, 1e-3, heal=5e-6)
    assert ["belong to no CAD body" in str(warning.message) for warning in told] == [True]
    assert [(body.name, len(body.faces)) for body in healed] == [("bar", 7), ("plate", 6)]
    assert [body.mass for body in healed] == pytest.approx([4e-6, 2e-6], rel=2e-4)
    assert [face.name for face in healed[1].faces if face.name] == ["end"]


def test_a_body_without_thickness():
    with pytest.raises(ValueError, match=r"'' has no thickness: its volume is 1\.01 mm3, 0\.01 um times"):
        Solid("plate", occ.Box((0, 0, 0), (10.0, 1.0, 1.01e-7)).Scale(occ.Pnt(0, 0, 0), 0.1), {"": STEEL})


def test_a_body_that_is_inside_out():
    block = occ.Box((0, 0, 0), (0.01, 0.02, 0.03))
    outline = occ.WorkPlane().MoveTo(0, 0).LineTo(0, 0.02).LineTo(0.01, 0.02).LineTo(0.01, 0).Close()  # clockwise
    for shape in (block.Reversed(), outline.Face().Extrude(0.03)):
        with pytest.raises(ValueError, match="is inside out: its volume is -6e"):
            Solid("block", shape, {"": STEEL})


def test_bodies_that_do_not_touch_are_told(tmp_path):
    low, high = occ.Box((0, 0, 0), (0.01, 0.01, 0.01)), occ.Box((0, 0, 0.0100005), (0.01, 0.01, 0.02))
    low.name, high.name = "low", "high"
    roof = occ.Box((0, 0, 0.02), (0.01, 0.01, 0.03))
    with pytest.warns(UserWarning, match="CAD body 'high' .and 1 more. has no .* smallest gap is 0.0005 mm") as told:
        glue([low, high, roof], name="tower")
    assert [warning.filename for warning in told] == [__file__]
    apart = occ.Compound([occ.Box((0, 0, z), (10, 10, z + 10)) for z in (0, 10.5)])
    with pytest.warns(UserWarning, match="no face in common with the others; the smallest gap is 0.5 mm") as told:
        read_solid(written(apart, tmp_path / "tower.step"), STEEL)
    assert [warning.filename for warning in told] == [__file__]
    middle = occ.Box((0, 0, 0.01), (0.01, 0.01, 0.02))
    with pytest.warns(UserWarning, match="it touches them at an edge or a corner only"):
        glue([low, middle.Move(occ.Vec(0.01, 0, 0))])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        glue([low, roof, middle])  # joined through the last one


def test_an_overlap_is_told_with_its_size_and_place(machine):
    shapes = [occ.Box((0, 0, 0), (0.04, 0.03, 0.02)), occ.Box((0.01, 0.01, 0.01), (0.02, 0.02, 0.05))]
    with pytest.raises(ValueError, match=r"25 % .* volume, 1e\+03 mm3 around \(15, 15, 15\) mm"):
        glue(shapes)
