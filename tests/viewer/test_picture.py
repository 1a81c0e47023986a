"""Pictures drawn off the screen: the figures in them, without PyVista a message."""

import sys
from dataclasses import replace

import netgen.occ as occ
import numpy as np
import pytest
from conftest import STEEL
from seen import bar, bar_model, machine, turning

from nassim import Solid, list_faces
from nassim.scene import Motion
from nassim.viewer import (
    Coloring,
    Form,
    Mark,
    Shape,
    View,
    block,
    picture,
    save_picture,
    view_faces,
    view_mesh,
    view_modes,
    view_motion,
    view_scene,
    view_scene_modes,
)
from nassim.viewer.view_content import MARK_COLORS


def drawn(path):
    image = pytest.importorskip("PIL.Image").open(path)
    return np.asarray(image.convert("RGB")).astype(int)


@pytest.fixture(autouse=True)
def _pyvista(request):
    if "without" not in request.node.name and "drawing" not in request.node.name:
        pytest.importorskip("pyvista", reason="pictures need the extra viewer")


@pytest.fixture
def legends(monkeypatch):
    """Legends of all pictures: colours by name."""
    found = []
    monkeypatch.setattr(picture, "_add_legend", lambda _pyvista, _plotter, colors: found.append(colors))
    return found


def test_a_picture_shows_the_body_with_its_colours(tmp_path, legends):
    """Its legend names faces, that of several bodies names the bodies."""
    pixels = drawn(save_picture(view_mesh(bar_model()), tmp_path / "new" / "mesh.png", mesh=True, size=(400, 300)))
    assert pixels.shape == (300, 400, 3)
    assert np.all(pixels[150, [2, -3]] == 255)
    grey = np.ptp(pixels, axis=2) < 30
    assert 0.03 < np.mean(grey & (pixels.mean(axis=2) < 240) & (pixels.mean(axis=2) > 60)) < 0.5
    view = view_scene(machine())
    save_picture(view, tmp_path / "scene.png", size=(40, 30))
    bodies, kinds = {"bar_1", "bar_2", "block"}, {f"{mark.kind}s" for mark in view.marks}
    assert list(map(set, legends)) == [{"left", "right", "bar", "remote points"}, bodies | kinds]


def test_a_sheet_of_modes_and_a_frame_of_a_scene(tmp_path):
    view = view_modes(bar(), fixed=["left"], n=3)
    names = [mode.name for mode in view.modes]
    sheet = drawn(save_picture(view, tmp_path / "modes.png", modes=names, size=(600, 400)))
    quarters = [sheet[i : i + 200, j : j + 300] for i in (0, 200) for j in (0, 300)]
    assert [np.mean(np.ptp(q, axis=2) > 40) > 0.01 for q in quarters] == [True, True, True, False]
    moving = view_motion(machine(), turning())
    frames = [drawn(save_picture(moving, tmp_path / "f.png", frame=k, size=(400, 300))) for k in (0, 6)]
    assert np.mean(np.abs(frames[0] - frames[1]).max(axis=2) > 40) > 0.01
    assert drawn(save_picture(view_scene(machine()), tmp_path / "scene.png", size=(400, 300))).std() > 5


def test_a_picture_numbers_the_faces_in_sight(tmp_path, monkeypatch, legends):
    """A bracket seen from above shows the numbers of its two steps, and not that of its underside."""
    pyvista = pytest.importorskip("pyvista")
    told, draw = [], pyvista.Plotter.add_point_labels

    def add_point_labels(self, points, labels, **style):
        told.extend(labels)
        return draw(self, points, labels, **style)

    monkeypatch.setattr(pyvista.Plotter, "add_point_labels", add_point_labels)
    bracket = occ.Box((0, 0, 0), (0.04, 0.02, 0.005)) + occ.Box((0, 0, 0), (0.005, 0.02, 0.03))
    solid = Solid("bracket", bracket, {"": STEEL})
    save_picture(view_faces(solid), tmp_path / "faces.png", camera=(0.001, 0.0, 1.0), size=(300, 200))
    up, down = ({str(f.number) for f in list_faces(bracket) if sign * f.normal[2] > 0.5} for sign in (1, -1))
    assert (len(up), len(down)) == (2, 1)
    assert up <= set(told)
    assert not down & set(told)
    assert legends == [{}], "numbers take the place of a legend"


def test_names_of_marks_are_at_their_last_ends(tmp_path, monkeypatch):
    """Of lines too, at which the directions of a part are drawn."""
    pyvista = pytest.importorskip("pyvista")
    told, draw = {}, pyvista.Plotter.add_point_labels

    def add_point_labels(self, points, labels, **style):
        told.update(zip(labels, points, strict=True))
        return draw(self, points, labels, **style)

    monkeypatch.setattr(pyvista.Plotter, "add_point_labels", add_point_labels)
    view = view_scene(machine())
    save_picture(view, tmp_path / "p.png", size=(300, 200))
    places = [[1e3 * view.shape(s).points[view.shape(s).form.index(p)] for s, p in mark.ends] for mark in view.marks]
    assert max(np.ptp(ends, axis=0).max() for ends in places) > 10
    for mark, ends in zip(view.marks, places, strict=True):
        found = [there for text, there in told.items() if mark.name in text.strip().split(", ")]
        np.testing.assert_allclose(found, [ends[-1]], atol=1e-5)


class Told:
    """What a picture gives PyVista to draw, beside being drawn."""

    def __init__(self, monkeypatch):
        pyvista = pytest.importorskip("pyvista")
        told = self
        self.meshes, self.actors, self.bars = [], [], []

        class Plotter(pyvista.Plotter):
            def add_mesh(self, mesh, **style):
                told.meshes.append((mesh.copy(), style))
                told.actors.append(super().add_mesh(mesh, **style))
                return told.actors[-1]

            def add_scalar_bar(self, title, **style):
                told.bars.append(title.rstrip())
                told.range = style["mapper"].scalar_range
                return super().add_scalar_bar(title, **style)

            def close(self):
                told.camera = [np.array(self.camera.position), np.array(self.camera.focal_point)]
                told.up = np.array(self.camera.up)
                told.height = 2 * self.camera.parallel_scale
                super().close()

        monkeypatch.setattr(pyvista, "Plotter", Plotter)

    def bodies(self):
        return [(mesh, style) for mesh, style in self.meshes if "ambient" in style and "diffuse" in style]

    def lines(self, color):
        """Ends of lines of a colour, (n, 2, 3) [mm]."""
        found = [m for m, style in self.meshes if style.get("color") == color and m.n_lines]
        return np.concatenate([m.points[m.lines.reshape(-1, 3)[:, 1:]] for m in found])


def test_a_frame_is_drawn_where_it_is_and_coloured_by_its_share(tmp_path, monkeypatch):
    """In millimetres, colours over the largest of all bodies, beside the outlines of where bodies rest."""
    told, motion = Told(monkeypatch), turning()
    view = view_motion(machine(), motion)
    save_picture(view, tmp_path / "p.png", frame=4, magnification=3.0, size=(300, 200))
    assert told.bars == ["share of the largest deformation"]
    own = {name: view.deformation(name, 4) for name in ("bar_1", "bar_2")}
    largest = max(np.linalg.norm(values, axis=1).max() for values in own.values())
    bodies = [mesh for mesh, _ in told.bodies()]
    for mesh, (name, moved) in zip(bodies[:2], own.items(), strict=True):
        n = mesh.n_points
        assert mesh["value"][:n] == pytest.approx(np.linalg.norm(moved, axis=1)[:n] / largest)
        there = (bar().surface.points + 3 * moved[: len(bar().surface.points)]) @ motion.rotations[name][4].T
        expected = 1e3 * (motion.positions[name][4] + there)
        assert np.asarray(mesh.points)[: len(there)] == pytest.approx(expected, abs=1e-6)
    assert all(style["clim"] == (0, 1) for _, style in told.bodies())
    rest = np.concatenate([1e3 * view.shape(name).points[view.shape(name).form.outline] for name in own])
    assert told.lines(picture.RESTING)[: len(rest)] == pytest.approx(rest, abs=1e-6)


def test_far_ways_of_stiff_bodies_leave_them_their_colours(tmp_path, monkeypatch):
    """Where nothing deforms, colours of deformation would tell nothing."""
    told, motion = Told(monkeypatch), turning()
    still = {name: 0 * values for name, values in motion.coordinates.items()}
    view = view_motion(machine(), replace(motion, coordinates=still))
    save_picture(view, tmp_path / "p.png", frame=4, size=(300, 200))
    assert not told.bars
    assert all(style["scalars"] == "color" for _, style in told.bodies())
    assert not any(style.get("color") in MARK_COLORS.values() for _, style in told.meshes)


def test_a_picture_at_rest_has_the_colours_of_faces_and_marks(tmp_path, monkeypatch):
    """A force from its point on, a hinge to both sides of it, a spring from end to end."""
    told, scene = Told(monkeypatch), machine()
    view = view_scene(scene)
    save_picture(view, tmp_path / "p.png", size=(300, 200))
    mesh, _ = told.bodies()[0]
    shape = view.shape("bar_1")
    colors = ["#" + bytes(color).hex() for color in mesh.cell_data["color"]]
    assert colors == [shape.colors[label] for label in shape.form.surface.labels]
    assert len(set(colors)) == 3
    drawn = zip(told.actors, told.meshes, strict=True)
    marks = [actor.mapper for actor, (_, style) in drawn if style.get("color") in MARK_COLORS.values()]
    assert len(marks) > 4
    for mapper in marks:  # in front of the bodies
        offset = pytest.importorskip("vtkmodules.vtkCommonCore").reference(0.0)
        mapper.GetRelativeCoincidentTopologyPointOffsetParameter(offset)
        assert float(offset) == picture.BEFORE_ALL
    tip, reach = 1e3 * scene.point_position("bar_2.right"), 60 * view.size
    assert told.lines(MARK_COLORS["actuator"])[0] == pytest.approx(
        np.array([tip, tip + reach * np.eye(3)[2]]), abs=1e-4
    )
    hinge = 1e3 * scene.point_position("ground.hinge")
    middle = told.lines(MARK_COLORS["joint"]).mean(axis=1)
    assert np.linalg.norm(middle - hinge, axis=1).min() < 1e-4
    spring = np.array([1e3 * scene.point_position("bar_1.right"), tip])
    assert told.lines(MARK_COLORS["spring"])[0] == pytest.approx(spring, abs=1e-4)
    between, axis = told.lines(MARK_COLORS["sensor"])
    assert between == pytest.approx(np.array([hinge, tip]), abs=1e-4)
    assert axis == pytest.approx(np.array([tip, tip + reach * np.eye(3)[0]]), abs=1e-4)


def test_the_camera_stands_where_it_is_told(tmp_path, monkeypatch):
    """From the front, a little to the right and above, z upwards; y upwards in views from above and below."""
    told, view = Told(monkeypatch), view_mesh(bar_model())
    middle = 1e3 * view.bounds.mean(axis=0)
    for camera, up in ((None, "z"), ((1, 0, 0), "z"), ((0, 0, 1), "y"), ((0, 0, -1), "y")):
        save_picture(view, tmp_path / "p.png", size=(300, 200), **({} if camera is None else {"camera": camera}))
        position, focus = told.camera
        wanted = np.array((0.435, -0.819, 0.375) if camera is None else camera)
        assert focus == pytest.approx(middle)
        assert (position - focus) / np.linalg.norm(position - focus) == pytest.approx(wanted, abs=1e-3)
        assert told.up == pytest.approx(np.eye(3)["xyz".index(up)])


def test_a_picture_of_any_shape_has_all_of_the_body_in_it(tmp_path, monkeypatch):
    """Of a bar of 100 x 10 x 10 mm along x, from the front and from its end, with a margin of 45 %."""
    told, view = Told(monkeypatch), view_mesh(bar_model())
    for camera, size, height in (
        ((0, -1, 0), (90, 60), 1.45 * 100 * 60 / 90),
        ((0, -1, 0), (30, 60), 1.45 * 100 * 60 / 30),
        ((1, 0, 0), (90, 60), 1.45 * 10),
    ):
        save_picture(view, tmp_path / "p.png", size=size, camera=camera)
        assert told.height == pytest.approx(height)


def test_the_mesh_is_drawn_where_it_is_asked_for_and_the_size_is_that_of_a_page(tmp_path, monkeypatch):
    """Lines of the outline alone, or those of all triangles too; 1200 x 900 pixels, or as many as are wanted."""
    told, view = Told(monkeypatch), view_mesh(bar_model())
    form = view.shapes[0].form
    for options, size, lines in ({}, (1200, 900), 0), ({"mesh": True, "size": (90, 60)}, (90, 60), 1):
        told.meshes.clear()
        pixels = drawn(save_picture(view, tmp_path / "p.png", **options))
        assert pixels.shape == (*size[::-1], 3)
        drawn_lines = [mesh.n_lines for mesh, style in told.meshes if style.get("color") == picture.LINE_COLOR]
        assert drawn_lines == [len(form.outline), len(form.surface.edges)][: 1 + lines]


def test_twelve_marks_have_names_in_a_picture_and_more_have_none(tmp_path, monkeypatch):
    pyvista = pytest.importorskip("pyvista")
    told = []
    monkeypatch.setattr(
        pyvista.Plotter, "add_point_labels", lambda _self, _points, labels, **_: told.append(len(labels))
    )
    for n in (12, 13):
        names = tuple(f"p{k}" for k in range(n))
        form = Form(block((1, 1, 1)), names, np.linspace(0, 0.4, 3 * n).reshape(n, 3))
        marks = tuple(Mark(name, "joint", (("brick", name),)) for name in names)
        save_picture(View("brick", (Shape("brick", form),), marks), tmp_path / "p.png", size=(60, 40))
    assert told == [12]


def test_a_motion_is_drawn_at_rest_or_as_it_is_unless_more_is_asked_for(tmp_path, monkeypatch):
    told, view = [], view_motion(machine(), turning())
    monkeypatch.setattr(picture, "_draw", lambda *arguments, **_: told.append(arguments[3].title))
    for options in {}, {"frame": 4}, {"frame": 4, "magnification": 1.0}, {"frame": 4, "magnification": 2.0}:
        save_picture(view, tmp_path / "p.png", size=(30, 20), **options)
    assert told == ["machine", "machine: 0.2 s", "machine: 0.2 s", "machine: 0.2 s, deformation x 2"]


def test_a_drawing_of_a_mode_is_as_large_as_on_a_page():
    view = view_modes(bar(), fixed=["left"], n=2)
    drawing = picture._drawing(view, view.modes[1].name, None, 1.0)
    moved = drawing.points["bar"] - view.shape("bar").points
    assert np.linalg.norm(moved, axis=1).max() == pytest.approx(0.06 * view.size)
    exact = view.displacement("bar", mode=view.modes[1].name)
    assert np.allclose(moved / np.abs(moved).max(), exact / np.abs(exact).max())


def test_a_drawing_of_a_scenes_mode_is_sized_by_what_moves_most():
    view = view_scene_modes(machine(), n=5)
    drawing = picture._drawing(view, view.modes[4].name, None, 1.0)
    moved = {shape.name: drawing.points[shape.name] - shape.points for shape in view.shapes}
    far = {name: np.linalg.norm(values, axis=1).max() for name, values in moved.items()}
    assert max(far.values()) == pytest.approx(0.06 * view.size)
    assert not far["ground"]
    assert max(values.max() for values in drawing.values.values()) == 1.0


def test_a_drawing_magnifies_deformation_and_leaves_far_ways_true():
    view, motion = view_motion(machine(), turning()), turning()
    drawing = picture._drawing(view, None, 4, 100.0)
    own = bar().surface.points + 100 * bar().surface_modes @ motion.coordinates["bar_2"][4]
    there = view.shape("bar_2").position + own @ motion.rotations["bar_2"][4].T
    assert np.allclose(drawing.points["bar_2"][: len(own)], there)
    assert "0.2 s, deformation x 100" in drawing.title
    assert drawing.quantity == "share of the largest deformation"
    moved = np.linalg.norm(bar().surface_modes @ motion.coordinates["bar_2"][4], axis=1)
    shares = drawing.values["bar_2"][: len(own)]
    assert shares / shares.max() == pytest.approx(moved / moved.max())
    small = view_motion(machine(), turning(angle=1e-4))
    drawing = picture._drawing(small, None, 4, 100.0)
    moved = drawing.points["bar_2"] - small.shape("bar_2").points
    assert np.allclose(moved, 100 * small.displacement("bar_2", frame=4))
    assert drawing.quantity == "share of the largest displacement"
    sizes = np.linalg.norm(moved, axis=1)
    assert drawing.values["bar_2"] / drawing.values["bar_2"].max() == pytest.approx(sizes / sizes.max())


def test_a_picture_of_a_coloured_motion_shows_its_quantity(tmp_path, monkeypatch):
    """The quantity at the image, with its own scale; a shape without one has the lowest colour."""
    told, surface = Told(monkeypatch), block((0.02, 0.02, 0.02))
    values = 70.0 * np.outer([0.2, 1.0], np.linspace(0, 1, len(surface.points)))
    coloring = Coloring("von Mises stress [MPa]", values, 60.0)
    still = np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1))
    motion = Motion(np.arange(2.0), dict.fromkeys("ab", still[0]), dict.fromkeys("ab", still[1]), {})
    shapes = Shape("a", Form(surface), coloring=coloring), Shape("b", Form(surface), np.array([0.1, 0, 0]))
    save_picture(View("colours", shapes, motion=motion), tmp_path / "p.png", frame=1, size=(300, 200))
    assert told.bars == ["von Mises stress [MPa]"]
    (first, style), (second, _) = told.bodies()
    np.testing.assert_allclose(first["value"], values[1])
    np.testing.assert_array_equal(second["value"], 0.0)
    assert style["clim"] == told.range == (0, 60.0)


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"modes": "mode 9"}, "unknown mode 'mode 9'; known: mode 1"),
        ({"frame": 0}, "has no motion, so no image 0"),
        ({"modes": "mode 1: rigid-body mode", "frame": 0}, "has no motion, so no image 0"),
        ({"frame": 0, "magnification": 0}, "magnification must be positive"),
        ({"frame": 0.5}, "frame must be a whole number, got 0.5"),
        ({"modes": []}, "name at least one mode; known: mode 1: rigid-body mode, mode 2"),
        ({"size": (30, 0)}, "size of a picture must be a whole number of at least 1, got"),
        ({"size": (30,)}, "size of a picture must have shape 2, got 1"),
        ({"path": "p.jpg"}, "unknown file ending '.jpg'; known: .png"),
    ],
)
def test_what_a_view_does_not_have_is_refused(tmp_path, options, problem):
    with pytest.raises(ValueError, match=problem):
        save_picture(view_modes(bar(), n=2), **{**options, "path": tmp_path / options.get("path", "p.png")})
    with pytest.raises(ValueError, match="has the images 0 to 6, not 7"):
        save_picture(view_motion(machine(), turning()), tmp_path / "p.png", frame=7)
    assert list(tmp_path.iterdir()) == []


def test_without_pyvista_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(ImportError, match=r'pip install "nassim\[viewer\]"'):
        save_picture(view_mesh(bar_model()), tmp_path / "p.png")
