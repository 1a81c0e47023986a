"""What views hold: bodies where they are, displacements that are those of the body, marks where parts are."""

import re
import warnings
from dataclasses import dataclass, replace

import netgen.occ as occ
import numpy as np
import pytest
from conftest import STEEL, lattice
from scipy.spatial.transform import Rotation
from seen import TURN, bar, bar_model, machine, turning

from nassim import (
    Bushing,
    FlexibleBody,
    RemotePoint,
    RigidBody,
    Scene,
    Solid,
    VoltageDrive,
    VoltageSensor,
    craig_bampton,
)
from nassim.bodies import PortCoupling, Surface, trim_body
from nassim.bodies.readouts import by_name
from nassim.fem import glue, list_faces, solid_surface
from nassim.scene import (
    AngleSensor,
    BodyCoordinates,
    Combination,
    Constraint,
    Displacement,
    Drive,
    ForceSensor,
    Joint,
    Motion,
    Output,
    RotationDeviation,
    Sensor,
    SpringDamper,
)
from nassim.scene.joints import prismatic, revolute
from nassim.simulation import assemble, traced, trim_scene
from nassim.viewer import (
    Coloring,
    Form,
    Mark,
    Mode,
    Shape,
    View,
    block,
    cylinder,
    view_body,
    view_buckling,
    view_faces,
    view_mesh,
    view_modes,
    view_motion,
    view_scene,
    view_scene_modes,
    view_solid,
)
from nassim.viewer.encoding import encode


def corners(surface):
    return surface.points[surface.triangles]


def area(surface, label=None):
    a, b, c = corners(surface).transpose(1, 0, 2)
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return areas[[label in (None, own) for own in surface.labels]].sum()


def inertia(surface):
    """Volume, centre and moments about it of a solid of density 1 within a surface, by tetrahedra from inside it."""
    middle = surface.points.mean(axis=0)
    tets = corners(surface) - middle
    volume = np.abs(np.linalg.det(tets)) / 6
    second = sum(v / 20 * (t.T @ t + np.outer(t.sum(axis=0), t.sum(axis=0))) for v, t in zip(volume, tets, strict=True))
    centre = (volume[:, None] * tets.sum(axis=1) / 4).sum(axis=0) / volume.sum()
    second = second - volume.sum() * np.outer(centre, centre)
    return volume.sum(), middle + centre, np.trace(second) * np.eye(3) - second


@pytest.mark.parametrize("name", ["right", None])
def test_a_solid_shows_its_outer_faces_by_owner(name):
    """Three touching blocks: 14 outer faces and none between; the face of the remote point is its own."""
    blocks = [occ.Box((1e-3 * a, 0, 0), (1e-3 * b, 1e-3, 1e-3)) for a, b in ((0, 1), (1, 3), (3, 4))]
    names = ("left", "middle", name)
    for block_, its_name in zip(blocks, names, strict=True):
        block_.name = its_name
    blocks[0].faces.Min(occ.X).name = "end"
    materials = {its_name or "": STEEL for its_name in names}
    solid = Solid("row", glue(blocks), materials, (RemotePoint("tip", "end", np.zeros(3)),))
    surface = solid_surface(solid)
    assert {label: round(1e6 * area(surface, label), 5) for label in set(surface.labels)} == {
        "left": 4.0, "middle": 8.0, name or "": 5.0, "tip": 1.0
    }  # fmt: skip
    assert len(surface.points) == 16
    view = view_solid(solid)
    assert [mark.name for mark in view.marks] == ["tip"]
    assert view.size == pytest.approx(np.sqrt(18) * 1e-3)


def test_faces_show_their_numbers():
    """A red tile on a block: nine faces in sight, each with a mark just outside of it that says what it is."""
    block_, tile = occ.Box((0, 0, 0), (0.04, 0.03, 0.02)), occ.Box((0, 0, 0.02), (0.04, 0.03, 0.022))
    block_.name, tile.name = "block", "tile"
    tile.faces.col = (1, 0, 0)
    solid = Solid("pair", glue([block_, tile]), {"block": STEEL, "tile": STEEL})
    view = view_faces(solid)
    shape = view.shape("pair")
    faces = {str(face.number): face for face in list_faces(solid.shape) if len(face.bodies) == 1}
    assert {mark.name: mark.text for mark in view.marks} == {
        number: str(face).removeprefix(f"face {number}: ") for number, face in faces.items()
    }
    for number, face in faces.items():
        assert area(shape.form.surface, str(face)) == pytest.approx(face.area)
        height = (shape.form.points[shape.form.index(number)] - face.centre) @ face.normal
        assert 0 < height < 0.01 * view.size
    reds = [label for label, color in shape.colors.items() if color == "#ff0000"]
    assert sorted(reds) == sorted(str(face) for face in faces.values() if face.bodies == ("tile",))


def test_a_mesh_shows_its_surface_and_lines_a_hand_made_one_says_it_has_none():
    view = view_mesh(bar_model())
    assert view.shape("bar").form.surface is bar_model().surface
    assert np.allclose(view.shape("bar").points[-2:], [[0, 0, 0], [0.1, 0, 0]])
    with pytest.raises(ValueError, match="'lattice' has no surface to draw"):
        view_mesh(lattice())


def test_an_outline_is_that_of_the_bar():
    """Its twelve edges, as long as they are; the faces of the remote points end there too."""
    form = view_body(bar()).shape("bar").form
    ends = form.points[form.outline]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert lengths.sum() == pytest.approx(4 * 0.1 + 8 * 0.01)
    assert set(map(tuple, form.outline)) <= set(map(tuple, np.sort(form.surface.edges, axis=1)))


def test_modes_say_the_errors_that_the_body_knows():
    held = {"fixed": ["left"], "masses": {"right": 0.2}, "n": 4}
    body = replace(bar(), released_stiffness=np.diag(np.linspace(1e-3, 1e-2, 15) * np.diag(bar().stiffness_matrix)))
    truncation, discretisation = (
        100 * errors(**held) for errors in (body.truncation_errors, body.discretization_errors)
    )
    for mode, left_out, coarse in zip(view_modes(body, **held).modes, truncation, discretisation, strict=True):
        found = re.fullmatch(r"estimated errors: truncation (\S+) %, discretisation (\S+) %", mode.text)
        assert [float(text) for text in found.groups()] == pytest.approx([left_out, coarse], rel=0.05)
    assert view_modes(body, n=7).modes[5].text == "", "a rigid-body mode has no error"
    assert view_modes(replace(bar(), enriched=None, released_stiffness=None), n=7).modes[6].text == ""


def test_modes_move_points_as_the_body_says():
    body = bar()
    view = view_modes(body, fixed=["left"], masses={"right": 0.2}, n=4)
    frequency, vectors = body.eigenmodes(fixed=["left"], masses={"right": 0.2}, n=4)
    assert view.title == "bar: left held, 0.2 kg at right"
    for k, (mode, f) in enumerate(zip(view.modes, frequency, strict=True)):
        assert mode.name == f"mode {k + 1}: {f:.5g} Hz"
        moved = view.displacement("bar", mode=mode.name)
        assert np.allclose(moved[: len(body.surface.points)], body.surface_modes @ vectors[:, k])
        index = view.shape("bar").form.index("right")
        assert np.allclose(moved[index], vectors[6:9, k])
    assert view_modes(body, n=1).modes[0].name == "mode 1: rigid-body mode"
    guided = view_modes(body, fixed=["left"], guided={"right": "x"}, n=2)
    assert guided.title == "bar: left held, right free along x"
    index = guided.shape("bar").form.index("right")
    for mode in guided.modes:
        moved = guided.displacement("bar", mode=mode.name)
        assert np.abs(moved[index, 1:]).max() < 1e-9 * np.abs(moved).max()


@pytest.mark.parametrize("kept", [("left", "right"), ("left",)])
def test_a_body_without_a_surface_is_rods_that_its_points_carry(kept):
    """All of them, also those that are no coordinates any more."""
    whole = craig_bampton(lattice(), n_modes=2, progress=False)
    body = trim_body(whole, points=kept, loads=np.zeros((14, 0)), cutoff_frequency=1e9)
    form = view_body(body).shape("lattice").form
    assert (form.surface.points - body.center_of_mass)[:, 0].max() > 0.014
    assert (form.surface.points - body.center_of_mass)[:, 0].min() < -0.014
    beside = body.center_of_mass + np.array([0.01, -0.02, 0.03])
    turn = np.cross([1, 2, 3], form.points - beside)
    coordinates = np.zeros(len(body.mass_matrix))
    for k, place in enumerate(body.positions):
        coordinates[6 * k : 6 * k + 6] = [*np.cross([1, 2, 3], place - beside), 1, 2, 3]
    assert np.allclose(form.modes @ coordinates, turn, atol=1e-12)


@pytest.mark.parametrize("remembering", [False, True])
def test_trimmed_bodies_show_their_surface(remembering):
    """What was trimmed before and what is trimmed on the way move alike, whether or not it remembers what it was."""
    whole = replace(machine(), springs=(), cutoff_frequency=3e3)
    trimmed = trim_scene(traced(whole) if remembering else whole)
    found, expected = (view_scene_modes(scene, n=4) for scene in (trimmed, whole))
    assert [mode.name for mode in found.modes] == [mode.name for mode in expected.modes]
    n = len(bar().surface.points)
    for name in ("bar_1", "bar_2"):
        assert len(trimmed.body(name).reduced.mass_matrix) < len(bar().mass_matrix)
        assert np.array_equal(found.shape(name).points[:n], expected.shape(name).points[:n])
        for mode in found.modes:
            moved, right = (view.displacement(name, mode=mode.name)[:n] for view in (found, expected))
            assert np.allclose(moved * np.sign(np.sum(moved * right)), right, atol=1e-6 * np.abs(right).max())


def test_a_rigid_body_is_the_block_of_its_inertia():
    turn, sides, mass = Rotation.from_euler("xyz", [0.3, -0.5, 0.9]).as_matrix(), np.array([0.02, 0.05, 0.1]), 0.7
    moments = mass / 12 * ((sides**2).sum() - sides**2)
    body = RigidBody("box", {"a": [0.01, 0, 0]}, mass, turn @ np.diag(moments) @ turn.T, np.ones(3), rotation=TURN)
    shape = view_scene(_alone(body)).shape("box")
    volume, centre, own = inertia(shape.form.surface)
    assert volume == pytest.approx(sides.prod())
    assert np.allclose(centre, 0, atol=1e-12)
    assert np.allclose(mass * own / volume, body.inertia)
    assert np.allclose(shape.points[-1], np.ones(3) + TURN[:, 0] * 0.01)
    for known in ({}, {"mass": mass}, {"inertia": body.inertia}):
        post = RigidBody("post", {"top": np.zeros(3)}, **known, fixed=True)
        assert not len(view_scene(Scene("two", (body, post))).shape("post").form.surface.triangles)


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("reach", [1.0, -1.0])
def test_halves_of_a_joint_are_cones_on_the_sides_on_which_they_are_held(swapped, reach):
    """Cubes of 12 mm, as two cones as high as half of each, neck to neck along the stiffest axis."""
    place, axes = np.array([0.3, -0.2, 0.1]), Rotation.from_euler("xyz", [0.4, 1.1, -0.7]).as_matrix()
    along, mass = axes[:, 1], 0.0146
    inertia_of_cube = mass * 12e-3**2 / 6 * np.eye(3)
    far = reach * 0.03 * TURN.T @ (along + 0.4 * axes[:, 2])
    bodies = (
        RigidBody("free", {"p": np.zeros(3)}, mass, inertia_of_cube, place, rotation=axes),
        RigidBody("held", {"p": np.zeros(3), "far": far}, mass, inertia_of_cube, place, rotation=TURN),
        RigidBody("plate", {"hole": -far}, 2.0, 1e-3 * np.eye(3), place + TURN @ far),
    )
    ends = ("held.p", "free.p") if swapped else ("free.p", "held.p")
    stiffness = [1e7, 9e7, 2e7, 10.0, 500.0, 10.0]
    beside = Bushing("beside", "held.far", "plate.hole", stiffness)
    scene = Scene("joint", bodies, springs=(Bushing("joint", *ends, stiffness, axes=axes), beside))
    view = view_scene(scene)
    for name, side in (("held", reach), ("free", -reach)):
        shape = view.shape(name)
        heights = side * (shape.points[: len(shape.form.surface.points)] - place) @ along
        assert heights.min() == pytest.approx(0.0, abs=1e-12)
        extent = heights.max()
        # A cube reaches as far as the axis is askew in it; its own axes are any, for it is the same about all.
        assert 6e-3 - 1e-9 < extent < 6e-3 * np.sqrt(3) + 1e-9
        across = np.linalg.norm(np.cross(shape.points[: len(heights)] - place, along), axis=1)
        assert across[heights < 1e-9].max() == pytest.approx(0.2 * across.max())
        assert np.pi * across.max() ** 2 * 2 * extent == pytest.approx(12e-3**3)
    assert len(view.shape("plate").form.surface.points) == 8


def _alone(body):
    return Scene("alone", (body,))


def test_a_thin_rod_is_drawn_thick_enough_to_be_seen():
    body = RigidBody("rod", {}, 0.3, np.diag([0.3 * 0.5**2 / 12] * 2 + [1e-12]))
    points = view_scene(_alone(body)).shape("rod").points
    assert np.ptp(points, axis=0) == pytest.approx([0.01, 0.01, 0.5])


@pytest.mark.parametrize(("density", "drawn"), [(9.0, 1000.0), (11.0, 11.0)])
def test_a_body_lighter_than_any_structure_is_drawn_small(density, drawn):
    sides = np.array([0.02, 0.05, 0.1])
    mass = density * sides.prod()
    body = RigidBody("link", {}, mass, np.diag(mass / 12 * ((sides**2).sum() - sides**2)))
    extent = np.ptp(view_scene(_alone(body)).shape("link").points, axis=0)
    assert mass / extent.prod() == pytest.approx(drawn)
    assert extent / extent[0] == pytest.approx(sides / sides[0])


def test_pages_open_on_the_first_mode_that_is_not_rigid():
    free, held = view_modes(bar(), n=8), view_modes(bar(), fixed=["left"], n=2)
    assert encode(free)[0]["first_mode"] == 6
    assert encode(held)[0]["first_mode"] == 0
    carriage = RigidBody("carriage", {"a": [0.0, 0, 0], "b": [0.1, 0, 0]}, 1.0, np.diag([1e-3, 2e-3, 3e-3]))
    post = RigidBody("post", {"top": [0.2, 0.1, 0.3]}, 5.0, fixed=True)  # without an inertia it has no shape
    scene = Scene("free", (carriage, post), springs=(SpringDamper("spring", "carriage.b", "post.top", "line", 1e4),))
    assert [mode.rigid for mode in view_scene_modes(scene, n=6).modes] == [True] * 5 + [False]


def test_blocks_and_cylinders_have_their_volumes():
    volume, centre, _ = inertia(block((1, 2, 3), (4, 5, 6)))
    assert volume == pytest.approx(6)
    assert np.allclose(centre, (4, 5, 6))
    surface = cylinder(0.5, 2.0, (0, 0, 1))
    volume, centre, _ = inertia(surface)
    assert volume == pytest.approx(24 * np.sin(2 * np.pi / 48) / 2), "that of 48 equal chords"
    assert np.allclose(centre, (0, 0, 1))
    assert np.ptp(surface.points[:, 2]) == 2.0


def test_blocks_and_cylinders_lie_and_are_called_as_told():
    turn = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
    straight, turned = block((1, 2, 3)), block((1, 2, 3), (4, 5, 6), axes=turn, label="plate")
    np.testing.assert_allclose(turned.points, straight.points @ turn.T + (4, 5, 6), atol=1e-12)
    names = [set(shape.labels) for shape in (straight, turned, cylinder(1.0, 1.0), cylinder(1.0, 1.0, label="shaft"))]
    assert names == [{"block"}, {"plate"}, {"cylinder"}, {"shaft"}]


def test_looks_are_those_of_modes_and_motions_too():
    looks = {"ground": block((0.2, 0.2, 0.02), label="table")}
    for view in (view_scene_modes(machine(), n=1, looks=looks), view_motion(machine(), turning(), looks=looks)):
        assert view.shape("ground").form.surface is looks["ground"]
    assert len(view_scene_modes(machine(), n=1).shape("ground").form.surface.points) == 0


def test_a_scene_shows_bodies_in_their_places_and_copies_share_one_form():
    view = view_scene(machine(), looks={"ground": block((0.2, 0.2, 0.02))})
    first, second = view.shape("bar_1"), view.shape("bar_2")
    assert first.form is second.form
    assert np.allclose(second.points - first.points, TURN @ [0, 0, 0.1])
    tip = second.points[second.form.index("right")]
    assert np.allclose(tip, machine().point_position("bar_2.right"))
    assert len(view.shape("ground").form.surface.triangles) == 12
    for looks, problem in (({"bar": None}, "unknown body 'bar'"), ({"bar_1": block((1, 1, 1))}, "is flexible")):
        with pytest.raises(ValueError, match=problem):
            view_scene(machine(), looks=looks)


def test_shapes_and_points_tell_what_they_are():
    """Masses by hand: a bar of steel of 0.1 m x 1 cm2 has 78 g."""
    (shape,), (left, right) = view_body(bar()).shapes, view_body(bar()).marks
    assert shape.text == "78 g, 15 coordinates"
    assert (left.text, right.text) == ("rbe3 at 0, 0, 0 mm", "rbe3 at 100, 0, 0 mm")
    texts = {shape.name: shape.text for shape in view_scene(machine()).shapes}
    bars = dict.fromkeys(("bar_1", "bar_2"), "78 g, flexible (ffrf)")
    assert texts == {"ground": "fixed", "block": "0.1 kg, rigid", **bars}


def test_parts_of_one_kind_have_one_colour():
    """Rigid bodies of one name in several copies of a machine, beside others; faces of points beside the body's own."""
    names = ("leg_1/foot", "leg_1/knee", "leg_2/foot", "leg_2/knee")
    view = view_scene(Scene("walker", tuple(RigidBody(name, {}, 1.0, np.eye(3)) for name in names)))
    (foot,), (knee,), *others = (shape.colors.values() for shape in view.shapes)
    assert foot != knee
    assert [list(colors) for colors in others] == [[foot], [knee]]
    colors = view_body(bar()).shape("bar").colors
    vivid = {label: np.ptp([*bytes.fromhex(color[1:])]) > 100 for label, color in colors.items()}
    assert vivid == {"bar": False, "left": True, "right": True}
    assert colors["left"] != colors["right"]


@dataclass(frozen=True)
class Gauge(Sensor):
    """How far a body's ends are apart along their line."""

    name: str
    body: str

    def terms(self, scene):
        reduced = scene.body(self.body).reduced
        row = BodyCoordinates(self.body, reduced.motion("right")[0], (f"{self.body}.right", f"{self.body}.left"))
        return (Output(self.name, "m", row),)


def test_directions_along_a_bodys_own_axes_turn_with_it():
    scene = replace(machine(), sensors=(Gauge("gauge", "bar_1"),))
    (mark,) = (mark for mark in view_scene(scene).marks if mark.name == "gauge")
    assert (mark.kind, mark.ends, mark.frame) == ("sensor", (("bar_1", "right"), ("bar_1", "left")), "bar_1")
    assert mark.axes == pytest.approx(-TURN[:, 0][None])


def test_marks_stand_where_parts_are_and_point_where_they_act():
    view = view_scene(machine())
    assert replace(view, marks=list(view.marks)).marks == view.marks  # a tuple again
    marks = {mark.name: mark for mark in view.marks}
    assert {name: (mark.kind, mark.ends) for name, mark in marks.items()} == {
        "clamp": ("joint", (("ground", "foot"),)),
        "pin": ("joint", (("ground", "hinge"),)),
        "ball": ("joint", (("bar_1", "right"),)),
        "spring": ("spring", (("bar_1", "right"), ("bar_2", "right"))),
        "push": ("actuator", (("bar_2", "right"),)),
        "encoder": ("sensor", (("ground", "hinge"), ("bar_2", "right"))),
    }
    assert len(marks["clamp"].axes) == 0
    assert np.abs(marks["pin"].axes) == pytest.approx(np.abs(TURN[:, 1])[None])
    assert len(marks["ball"].axes) == 3
    assert marks["push"].axes == pytest.approx(np.array([[0, 0, 1]]))
    assert (marks["push"].frame, marks["encoder"].frame) == ("bar_2", "")
    assert marks["encoder"].axes == pytest.approx(np.array([[1, 0, 0]]))
    assert marks["encoder"].text == "encoder encoder [m]: bar_2.right against ground.hinge along x"
    assert "turns about (" in marks["pin"].text


@dataclass(frozen=True)
class Wobble(Sensor):
    """Reads a component of a rotation beside the turn of the hinge."""

    def terms(self, scene):
        """One output."""
        measure = RotationDeviation(
            "ground.foot", "bar_2.right", np.array([0, 0, 2.0]), "ground.hinge", "bar_2.left", TURN[:, 1]
        )
        return (Output(self.name, "rad", measure),)


def test_marks_of_angles_have_unit_axes_and_those_of_forces_are_their_springs():
    sensors = (
        AngleSensor("angle", "ground.hinge", "bar_2.left", (0, 3.0, 4.0)),
        Wobble("wobble"),
        ForceSensor("pull", "spring"),
    )
    marks = {mark.name: mark for mark in view_scene(replace(machine(), sensors=sensors)).marks}
    assert marks["angle"].ends == (("ground", "hinge"), ("bar_2", "left"))
    assert marks["angle"].axes == pytest.approx(np.array([[0.0, 0.6, 0.8]]))
    assert marks["wobble"].ends == (("ground", "foot"), ("bar_2", "right"))
    assert marks["wobble"].axes == pytest.approx(np.array([[0.0, 0.0, 1.0]]))
    assert (marks["pull"].ends, marks["pull"].kind) == (marks["spring"].ends, "sensor")


@dataclass(frozen=True)
class Mean(Sensor):
    """Reads the mean displacement of several points."""

    def terms(self, scene):
        """One displacement, of the last point along another axis."""
        axes = {"bar_1.right": (0, 0, 1), "bar_2.right": (0, 0, 1), "block.corner": (0, 3, 0)}
        return (Output(self.name, "m", Displacement(tuple((path, np.array(axis)) for path, axis in axes.items()))),)


def test_a_mark_of_several_points_points_where_its_last_one_moves():
    (mark,) = (one for one in view_scene(replace(machine(), sensors=(Mean("mean"),))).marks if one.name == "mean")
    assert mark.ends == (("bar_2", "right"), ("block", "corner"))
    assert mark.text == "sensor mean [m]"  # of a part that does not describe itself
    assert mark.axes == pytest.approx(np.array([[0.0, 1.0, 0.0]]))


@dataclass(frozen=True)
class Lever(Joint):
    """Holds the displacements of two points in proportion."""

    def terms(self, scene):
        """One constraint on two displacements."""
        parts = [(f, Displacement(((path, np.array([0, 0, 2.0])),))) for f, path in ((1.0, self.a), (0.5, self.b))]
        return (Constraint(self.name, Combination(tuple(parts)), ("value",)),)


def test_a_joint_on_a_measure_of_its_own_is_marked_at_each_of_its_points():
    scene = replace(machine(), joints=(Lever("lever", "bar_1.right", "bar_2.right"),))
    marks = [mark for mark in view_scene(scene).marks if mark.kind == "joint"]
    assert [mark.ends for mark in marks] == [(("bar_1", "right"),), (("bar_2", "right"),)]
    assert [mark.axes.tolist() for mark in marks] == [[[0.0, 0.0, 1.0]]] * 2


def test_ports_are_marked_where_their_stacks_lie():
    """The mark goes along rigidly where the body does, and as the surface about it; without a place, amid the body."""
    whole, place = bar(), np.array([0.03, 0.001, -0.002])
    n = len(whole.mass_matrix)
    known = PortCoupling("stack", np.random.default_rng(0).standard_normal(n), 1e-6, place)
    unknown = PortCoupling("other", np.random.default_rng(1).standard_normal(n), 1e-6)
    body = replace(whole, readouts=by_name([*whole.readouts.values(), known, unknown]))
    flexible = FlexibleBody("bar", body, (1, 2, 3), rotation=TURN)
    drives = VoltageDrive("drive", "bar.stack", "u"), VoltageSensor("sensor", "bar.other")
    view = view_scene(Scene("alone", (flexible,), actuators=drives[:1], sensors=drives[1:]))
    assert {mark.name: mark.ends for mark in view.marks} == {
        "drive": (("bar", "stack"),), "sensor": (("bar", "centre of mass"),)
    }  # fmt: skip
    form = view.shape("bar").form
    assert np.allclose(view.shape("bar").points[form.index("stack")], flexible.position + TURN @ place)
    rows = form.modes[form.index("stack")]
    spin = np.array([0.3, -0.2, 0.5])
    rigid = np.concatenate([*([*(1 + np.cross(spin, p)), *spin] for p in body.positions), np.zeros(n - 12)])
    assert np.allclose(rows @ rigid, 1 + np.cross(spin, place), atol=1e-9)
    _, modes = body.eigenmodes(fixed=["left"], n=1)
    bent = (body.surface_modes @ modes[:, 0])[:, 1:]
    line = [np.polyval(np.polyfit(body.surface.points[:, 0], values, 4), place[0]) for values in bent.T]
    assert np.allclose(rows[1:] @ modes[:, 0], line, atol=0.03 * np.linalg.norm(line))


def test_modes_of_a_scene_hold_its_joints_and_keep_rigid_bodies_stiff():
    view = view_scene_modes(machine(), n=9)
    frequency = assemble(machine()).modal.frequency
    assert frequency[0] == 0
    assert [m.name for m in view.modes][:1] == ["mode 1: rigid-body mode"]
    for k, mode in enumerate(view.modes):
        assert f"{frequency[k]:.5g}" in mode.name or not frequency[k]
        moved = {name: view.displacement(name, mode=mode.name) for name in ("bar_1", "block")}
        joined = (("bar_1", "right"), ("block", "corner"))
        ends = [moved[name][view.shape(name).form.index(point)] for name, point in joined]
        size = max(np.abs(values).max() for values in moved.values())
        assert np.allclose(*ends, atol=1e-9 * size)
        points = view.shape("block").points
        stretched = np.einsum("ij,ij->i", points[1:] - points[0], moved["block"][1:] - moved["block"][0])
        assert np.abs(stretched).max() < 1e-9 * size


def test_modes_of_a_scene_have_their_own_shapes():
    """Two weights on springs of their own, the stiffer one named first: sqrt(k / m) of each."""
    weights = {"stiff": (4.0, np.array([0.1, 0, 0])), "soft": (1.0, np.array([0, 0.2, 0]))}
    base = RigidBody("base", {name: place for name, (_, place) in weights.items()}, fixed=True)
    bodies = [RigidBody(name, {"c": np.zeros(3)}, 1.0, np.eye(3), place) for name, (_, place) in weights.items()]
    scene = Scene(
        "weights",
        (base, *bodies),
        tuple(prismatic(name, f"base.{name}", f"{name}.c", "z") for name in weights),
        springs=tuple(
            SpringDamper(f"{name} spring", f"base.{name}", f"{name}.c", "z", (2 * np.pi * 10) ** 2 * k)
            for name, (k, _) in weights.items()
        ),
    )
    view = view_scene_modes(scene)
    assert [mode.name for mode in view.modes] == ["mode 1: 10 Hz", "mode 2: 20 Hz"]
    for mode, moving, still in zip(view.modes, ("soft", "stiff"), ("stiff", "soft"), strict=True):
        assert np.abs(view.displacement(still, mode=mode.name)).max() < 1e-9
        assert np.abs(view.displacement(moving, mode=mode.name)) == pytest.approx(np.tile([0, 0, 1.0], (9, 1)))


def test_a_motion_moves_points_through_space():
    """Against the position of a point as its noun says: place + rotation (x + modes q)."""
    motion = turning()
    view = view_motion(machine(), motion)
    assert not view.small
    rest, points = view.shape("bar_2").points, bar().surface.points
    for k in range(7):
        own = points + bar().surface_modes @ motion.coordinates["bar_2"][k]
        there = motion.positions["bar_2"][k] + own @ motion.rotations["bar_2"][k].T
        assert np.allclose(rest[: len(points)] + view.displacement("bar_2", frame=k)[: len(points)], there)
        assert np.allclose(view.deformation("bar_2", k)[: len(points)], own - points)
    assert not np.any(view.displacement("block", frame=3))


def test_a_long_motion_is_thinned_and_a_small_one_is_known():
    motion = turning(n=1001, angle=1e-3)
    view = view_motion(machine(), motion, frames=101)
    assert view.small
    assert view.motion.time == pytest.approx(np.linspace(0, 0.3, 101))
    assert view.motion.coordinates["bar_2"][-1] == pytest.approx(motion.coordinates["bar_2"][-1])
    assert view_motion(machine(), motion, frames=1).motion.time == pytest.approx([0.0])
    assert len(view_motion(machine(), motion, frames=3.0).motion.time) == 3
    far = {"bar_1": motion.positions["bar_1"] + 0.1}
    stiff = View("far", view.shapes, motion=Motion(motion.time, far, {"bar_1": motion.rotations["bar_1"]}, {}))
    assert not stiff.small
    assert encode(stiff)[0]["motion"]["largest_deformation"] == 0.0


def test_what_counts_as_small_motion():
    """Turns and shifts from where bodies stand, over the size of all: up to a fiftieth."""
    brick = Shape(
        "brick", Form(block((3, 4, 12))), (100.0, 0, 0), Rotation.from_euler("z", 90, degrees=True).as_matrix()
    )
    view = View("brick", (brick,))
    assert view.bounds == pytest.approx(np.array([[98.0, -1.5, -6.0], [102.0, 1.5, 6.0]]))
    assert view.size == pytest.approx(13.0)
    for shift, angle, small in ((0.25, 0.019, True), (0.27, 0.0, False), (0.0, 0.021, False)):
        # As far at all times, so that between the frames nothing moves.
        turns = np.tile(Rotation.from_rotvec(angle * np.array([0.6, 0, 0.8])).as_matrix() @ brick.rotation, (2, 1, 1))
        places = np.tile(brick.position - [0, shift, 0], (2, 1))
        moved = View("moved", (brick,), motion=Motion([0.0, 1.0], {"brick": places}, {"brick": turns}, {}))
        assert moved.small is small


def test_a_mode_that_moves_nothing_seen_is_still():
    """As one of a sensor inside, or of a body that is not drawn."""
    surface = block((1, 2, 3))
    brick = Shape("brick", Form(surface, modes=np.ones((len(surface.points), 3, 2))))
    moves, still = Mode("moves", {"brick": np.array([0.0, 2.0])}), Mode("still", {"brick": np.zeros(2)})
    first, second = encode(View("brick", (brick,), modes=(moves, still)))[0]["modes"]
    assert np.abs(first["coordinates"]["brick"]).max() > 0.1
    assert not np.any(second["coordinates"]["brick"])


def test_a_form_without_modes_may_have_no_coordinates():
    brick, still = Shape("brick", Form(block((1, 2, 3)))), np.zeros((2, 0))
    places, turns = np.array([[0.0, 0, 0], [0, 0, 2]]), np.tile(np.eye(3), (2, 1, 1))
    motion = Motion([0.0, 1.0], {"brick": places}, {"brick": turns}, {"brick": still})
    moved = View("moved", (brick,), motion=motion)
    assert encode(moved)[0]["motion"]["largest"] == pytest.approx(2.0)
    assert not encode(View("brick", (brick,), modes=(Mode("still", {"brick": still[0]}),)))[0]["error"]


BRICK = block((1, 2, 3))
REFUSED = {
    "frames: none": (lambda: view_motion(machine(), turning(), frames=0), "frames must be a whole number .* 1, got 0"),
    "frames: part": (lambda: view_motion(machine(), turning(), frames=2.5), "frames must be a whole number .* got 2.5"),
    "modes: none": (lambda: view_scene_modes(machine(), n=0), "n must be a whole number of at least 1, got 0"),
    "modes: part": (lambda: view_scene_modes(machine(), n=2.5), "n must be a whole number of at least 1, got 2.5"),
    "buckling: none": (lambda: view_buckling(machine(), n=0), "n must be a whole number of at least 1, got 0"),
    "block: flat": (lambda: block((1, 0, 1)), "size of a block must be positive, got"),
    "block: negative": (lambda: block((1, 1, -1)), "size of a block must be positive, got"),
    "block: size": (lambda: block((1, 1)), "size of a block must have shape 3, got 2"),
    "block: centre": (lambda: block((1, 1, 1), (0, np.nan, 0)), "centre of a block holds 1 value"),
    "block: axes": (lambda: block((1, 1, 1), axes=np.eye(2)), "axes of a block must have shape 3 x 3, got 2 x 2"),
    "cylinder: radius": (lambda: cylinder(0.0, 1.0), "radius must be positive, got 0 m"),
    "cylinder: height": (lambda: cylinder(1.0, -1.0), "height must be positive, got -1 m"),
    "cylinder: centre": (lambda: cylinder(1.0, 1.0, (0, 0)), "centre of a cylinder must have shape 3, got 2"),
    "form: names": (lambda: Form(BRICK, ("a", "a"), np.zeros((2, 3))), "named point names must differ"),
    "form: positions": (
        lambda: Form(BRICK, ("a", "b"), np.zeros((1, 3))),
        "positions must have shape 2 x 3, got 1 x 3",
    ),
    "form: modes": (
        lambda: Form(BRICK, modes=np.zeros((7, 3, 1))),
        "modes of a form must have shape 8 x 3 x any, got 7",
    ),
    "shape: position": (lambda: Shape("s", Form(BRICK), (0, np.inf, 0)), "shape 's': position holds 1 value"),
    "shape: rotation": (
        lambda: Shape("s", Form(BRICK), rotation=-np.eye(3)),
        "'s': rotation must be a proper orthogonal",
    ),
    "mark: axes": (
        lambda: Mark("m", "joint", (("s", "a"),), (0, 0, 1)),
        "mark 'm': axes must have shape any x 3, got 3",
    ),
    "mode: coordinates": (lambda: Mode("m", {"s": [np.nan]}), "m: coordinates of 's' holds 1 value"),
    "colouring: values": (lambda: Coloring("q", [[np.nan]], 1.0), "'q': values holds 1 value"),
    "colouring: largest": (lambda: Coloring("q", np.zeros((1, 1)), 0.0), "'q': largest must be positive, got 0"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_numbers_out_of_range_are_refused(case):
    call, problem = REFUSED[case]
    with pytest.raises(ValueError, match=problem):
        call()


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"marks": (Mark("m", "joint", (("bar", "middle"),)),)}, "unknown point 'middle'; known: left, right"),
        ({"marks": (Mark("m", "joint", (("rod", "left"),)),)}, "unknown shape 'rod'; known: bar"),
        ({"marks": (Mark("m", "joint", (("bar", "left"),), frame="rod"),)}, "unknown shape 'rod'"),
        ({"modes": (Mode("a", {"bar": np.ones(3)}),)}, "'bar' moves by 15 coordinates, got 3"),
        (
            {"motion": Motion([0.0], {"bar": np.zeros((1, 3))}, {"bar": np.eye(3)[None]}, {"bar": np.ones((1, 3))})},
            "'bar' moves by 15 coordinates, got 3",
        ),
        ({"modes": (Mode("a", {}), Mode("a", {}))}, "used more than once: a"),
        ({"shapes": ()}, "is empty"),
        ({"shapes": Shape("s", Form(block((1, 1, 1))))}, "shapes must be a tuple of Shape, got Shape"),
        ({"shapes": (Shape("s", Form(block((1, 1, 1)))),) * 2}, "shape names must differ; used more than once: s"),
        ({"marks": Mark("m", "joint", (("bar", "left"),))}, "marks must be a tuple of Mark, got Mark"),
        ({"modes": Mode("a", {})}, "modes must be a tuple of Mode, got Mode"),
        ({"modes": (Mode("a", {}),), "motion": turning}, "modes or a motion, not both"),
        ({"motion": turning}, "unknown shape 'bar_1'"),
        ({"motion": Motion([0.0], {"rod": np.zeros((1, 3))}, {"rod": np.eye(3)[None]}, {})}, "unknown shape 'rod'"),
    ],
)
def test_what_does_not_fit_is_refused(change, problem):
    view = view_body(bar())
    given = {name: value() if value is turning else value for name, value in change.items()}
    with pytest.raises(ValueError, match=problem):
        View(**{"title": "bar", "shapes": view.shapes, **given})


def test_marks_of_other_kinds_and_ends_are_refused():
    with pytest.raises(ValueError, match="unknown kind of mark 'screw'"):
        Mark("m", "screw", (("bar", "left"),))
    with pytest.raises(ValueError, match="one or two ends, got 0"):
        Mark("m", "joint", ())


def test_sharp_edges_between_faces_are_seen_and_shallow_ones_are_not():
    """Of a cylinder with chords of 7.5 degrees: two rims of 48 chords, and no line on its wall."""
    form = Form(cylinder(1.0, 1.0))
    assert len(form.outline) == 96
    assert len(Form(block((1, 1, 1))).outline) == 12
    assert Shape("c", form).points.shape == (96, 3)


def test_edges_are_sharp_from_40_degrees_on():
    """A square folded along its diagonal."""
    for angle in np.radians([36.0, 44.0]):
        across = np.array([-1.0, 1.0, 0.0]) / np.sqrt(2)
        folded = 0.5 * np.array([1, 1, 0]) + (np.cos(angle) * across + np.sin(angle) * np.eye(3)[2]) / np.sqrt(2)
        points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], folded])
        form = Form(Surface(points, np.array([[0, 1, 2], [0, 2, 3]]), np.zeros((0, 2), int), ("a", "a")))
        assert len(form.outline) == 4 + (angle > np.radians(40))


def test_halves_of_a_joint_are_in_one_place_to_a_nanometre():
    for share in (0.9, 1.1):
        off = np.array([0.0, 0.0, 1e-9 * share])
        free = RigidBody("free", {"p": np.zeros(3)}, 0.01, 1e-6 * np.eye(3))
        held = RigidBody("held", {"p": -off}, 0.01, 1e-6 * np.eye(3), off)
        scene = Scene("joint", (free, held), springs=(Bushing("joint", "free.p", "held.p", [1e7] * 3 + [10.0] * 3),))
        assert len(view_scene(scene).shape("held").form.surface.points) == (96 if share < 1 else 8)


def test_points_near_the_centre_of_mass_have_no_rod():
    """A fiftieth of the size, over which a rod is as thick as long; rods are square, and open at their common end."""
    body = craig_bampton(lattice(), n_modes=1, progress=False)
    centre, (left, right) = body.center_of_mass, body.remote_points
    span = np.linalg.norm(right.position - centre)
    for share in (0.9, 1.1):
        near = replace(left, position=centre + np.array([0, 0, 0.02 * share * span]))
        rods = view_body(replace(body, remote_points=(near, right), readouts={})).shape(body.name).form.surface
        lengths, side = span * np.array([1, 0.02 * share])[: 1 if share < 1 else 2], 0.02 * np.sqrt(2) * span
        assert len(rods.points) == 8 * len(lengths)
        assert area(rods) == pytest.approx(np.sum(4 * side * lengths + side**2))


@pytest.mark.parametrize(
    ("triangles", "labels", "lines"),
    [
        ([[0, 1, 2], [0, 2, 3]], ("a", "a"), 4),
        ([[0, 1, 2], [0, 3, 2]], ("a", "a"), 4),
        ([[0, 1, 2], [0, 2, 3]], ("a", "b"), 5),
        ([[0, 1, 2], [0, 2, 4]], ("a", "a"), 5),
        ([[0, 1, 2], [0, 2, 3], [0, 2, 4]], ("a", "a", "a"), 7),
    ],
    ids=["flat", "wound either way", "two labels", "bent", "three meet"],
)
def test_an_open_sheet_ends_where_it_has_no_neighbour(triangles, labels, lines):
    """A square of two triangles with corners 0 1 2 3, and 4 above its diagonal."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1.0]])
    form = Form(Surface(points, np.array(triangles), np.zeros((0, 2), int), labels))
    assert len(form.outline) == lines
    assert ([0, 2] in form.outline.tolist()) == (lines > 4)


def test_the_label_of_most_faces_comes_first():
    surface = Surface(np.eye(3), np.tile([0, 1, 2], (3, 1)), np.zeros((0, 2), int), ("arm", "pad", "pad"))
    assert Form(surface).labels == ("pad", "arm")


def rotor(*, held=0.0):
    """A rotor in a bearing on a stator, whose bushing holds the rotation about the axis with a stiffness."""
    inertia = np.diag([0.02, 0.03, 0.04])
    bodies = (
        RigidBody("stator", {"axle": np.zeros(3)}, 5.0, inertia),
        RigidBody("rotor", {"axle": np.zeros(3)}, 3.0, inertia),
    )
    bearing = Bushing("bearing", "stator.axle", "rotor.axle", [1e6, 1e6, 1e6, 1e3, 1e3, held])
    return Scene("rotor", bodies, springs=(bearing,))


def test_bodies_in_a_bearing_are_no_halves_of_a_joint():
    for held, corners in ((0.0, 8), (1e3, 96)):
        shapes = [view_scene(rotor(held=held)).shape(name) for name in ("stator", "rotor")]
        assert [len(shape.form.surface.points) for shape in shapes] == [corners, corners]


@pytest.mark.parametrize("turned", [0.3, 0.36])
def test_a_page_that_shows_another_rotation_is_warned_of(turned):
    base = RigidBody("base", {"axle": np.zeros(3)}, fixed=True)
    speeds = {"slow": 1.0, "rotor": -2 * np.pi * 10.0}
    bodies = (base, *(replace(rotor().bodies[1], name=name) for name in speeds))
    joints = tuple(revolute(f"{name} axle", "base.axle", f"{name}.axle") for name in speeds)
    drives = tuple(Drive(f"{name} motor", f"{name} axle", speed=speed) for name, speed in speeds.items())
    scene = Scene("rotor", bodies, joints, drives)
    n = 11
    time, still = 5.0 + np.arange(n) * turned / 10.0, dict.fromkeys(speeds, np.zeros((n, 3)))
    turns, rest = (dict.fromkeys(speeds, values) for values in (np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 6))))
    motion = Motion(time, still, turns, rest)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        view_motion(scene, motion, frames=n if turned < 1 / 3 else 1)
    if turned > 1 / 3:
        with pytest.warns(
            UserWarning, match="turns by more than a third of a turn from image to image.* take 12 images"
        ):
            view_motion(scene, motion)
    assert view_scene_modes(replace(scene, bodies=(*scene.bodies, RigidBody("load", {}, 1.0, np.eye(3))))).title == (
        "rotor: modes without rotation"
    )


def test_the_title_tells_what_modes_of_a_scene_leave_out():
    """A pendulum on a spring swings faster under its weight than on the page."""
    ground = RigidBody("ground", {"pin": np.zeros(3)}, fixed=True)
    bob = RigidBody("bob", {"pin": [0.0, 0.0, 0.3]}, 2.0, 1e-3 * np.eye(3), [0.0, 0.0, -0.3])
    spring = Bushing("spring", "ground.pin", "bob.pin", [0, 0, 0, 0, 8.0, 0])
    scene = Scene("pendulum", (ground, bob), (revolute("hinge", "ground.pin", "bob.pin", "y"),), springs=(spring,))
    view = view_scene_modes(replace(scene, gravity=(0, 0, -9.81)))
    assert view.title == "pendulum: modes without gravity"
    assert view.modes[0].name == f"mode 1: {np.sqrt(8.0 / 0.181) / (2 * np.pi):.5g} Hz"
    assert view_scene_modes(scene).title == "pendulum: modes"
