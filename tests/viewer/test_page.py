"""What a page holds, read back from its file: everything in it, and displacements that are those of the body."""

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pages import Page
from scipy.spatial.transform import Rotation
from seen import TURN, bar, bar_model, machine, turning

import nassim.viewer
from nassim.bodies import Surface
from nassim.viewer import Form, Mode, Shape, View, block, view_mesh, view_modes, view_motion, view_scene, write_page

SOME = slice(None, None, 18)
"""Points at which displacements are compared."""


@pytest.fixture
def written(tmp_path):
    return lambda view: Page(write_page(view, tmp_path / "page.html"))


def test_a_page_asks_for_nothing_outside_itself(written):
    """No address to load from; those that remain are names of SVG and comments of the library, which is packed."""
    page = written(view_modes(bar(), n=2))
    assert re.findall(r'(?:src|href)\s*=\s*"(?!data:,)', page.text) == []
    assert re.findall(r"https?://", page.text) == []
    assert "nassim" in page.text
    assert "<!--" not in page.text.partition("<body>")[2]


def test_the_same_view_gives_the_same_file(tmp_path, monkeypatch):
    """At whatever time it is written."""
    clock = itertools.count(1e9, 1e3)
    monkeypatch.setattr("time.time", lambda: next(clock))
    first, second = (write_page(view_mesh(bar_model()), tmp_path / name).read_bytes() for name in "ab")
    assert first == second


def test_names_cannot_break_out_of_the_page(written):
    page = written(replace(view_mesh(bar_model()), title="</script><b>bar & 1"))
    assert page.title == "</script><b>bar & 1"
    assert page.header["title"] == "</script><b>bar & 1"
    assert page.text.count("<b>") == 0


def test_displacements_of_modes_are_the_bodys(written):
    body = bar()
    page = written(view_modes(body, fixed=["left"], n=5))
    assert page.header["error"] < 1e-4
    _, vectors = body.eigenmodes(fixed=["left"], n=5)
    for k in range(5):
        expected = body.surface_modes @ vectors[:, k]
        largest = np.linalg.norm(expected, axis=1).max()
        assert page.header["modes"][k]["peak"] == pytest.approx(largest)
        error = np.abs(page.mode(k, "bar")[SOME] - expected[SOME]).max() / largest
        assert error < page.header["error"]
    points = page.array(page.header["forms"][0]["points"], -1, 3)
    assert np.allclose(points[SOME], body.surface.points[SOME], rtol=1e-6, atol=1e-9)


def test_whole_numbers_are_the_nearest(written):
    """One mode is one pattern, told in 16 bits: no component is off by more than half of their step."""
    body = bar()
    _, vectors = body.eigenmodes(fixed=["left"], n=1)
    page = written(view_modes(body, fixed=["left"], n=1))
    mode, patterns = page.header["modes"][0], page.header["forms"][0]["patterns"]
    assert patterns["values"]["kind"] == "int16"
    (scale,), (coordinate,) = patterns["scales"], mode["coordinates"]["bar"]
    step = scale * abs(coordinate) * mode["peak"]
    exact = body.surface_modes @ vectors[:, 0]
    assert 2 * 32767 * step == pytest.approx(2 * np.abs(exact).max(), rel=1e-3)
    assert np.abs(page.mode(0, "bar")[: len(exact)] - exact).max() < 0.501 * step


def test_patterns_that_cancel_are_told_finely(written):
    """Of a dozen modes that share patterns, rounding in 16 bits would show: they are told in 32."""
    body = bar()
    _, vectors = body.eigenmodes(n=12)
    page = written(view_modes(body, {str(k): vector for k, vector in enumerate(vectors.T)}))
    assert page.header["forms"][0]["patterns"]["values"]["kind"] == "float32"
    assert page.header["error"] < 2e-5
    for k in range(12):
        exact = body.surface_modes @ vectors[:, k]
        largest = np.linalg.norm(exact, axis=1).max()
        assert np.abs(page.mode(k, "bar")[: len(exact)] - exact).max() < page.header["error"] * largest


def test_displacements_of_a_motion_are_the_bodys(written):
    motion = turning()
    page = written(view_motion(machine(), motion))
    assert page.header["error"] < 1e-4
    np.testing.assert_array_equal(page.array(page.header["motion"]["time"]), motion.time)
    for name in ("bar_1", "bar_2"):
        patterns = page.patterns(name)
        moved = patterns @ page.moved(name, "coordinates", -1, patterns.shape[2]).T.astype(float)
        expected = bar().surface_modes @ motion.coordinates[name].T
        largest = np.linalg.norm(bar().surface_modes @ motion.coordinates["bar_2"].T, axis=1).max()
        assert np.abs(moved[SOME] - expected[SOME]).max() < page.header["error"] * largest
        assert np.allclose(page.moved(name, "shift", -1, 3), 0)
        turns = TURN @ Rotation.from_rotvec(page.moved(name, "turn", -1, 3)).as_matrix()
        assert np.allclose(turns, motion.rotations[name], atol=1e-6)
    assert page.header["motion"]["largest_deformation"] == pytest.approx(largest)
    assert not page.header["small"]
    assert "block" not in page.header["motion"]["moved"]


def test_a_tiny_motion_keeps_its_figures(written):
    """A nanometre of a body that stands a metre away is not lost in single precision."""
    motion = turning(angle=1e-8)
    away = np.array([1.0, 2.0, 3.0])
    scene = replace(machine(), bodies=tuple(replace(b, position=b.position + away) for b in machine().bodies))
    shift = 1e-9 * np.arange(7)[:, None] * [1.0, -2.0, 0.5]
    places = {name: values + away + shift for name, values in motion.positions.items()}
    page = written(view_motion(scene, replace(motion, positions=places)))
    assert page.header["small"]
    assert page.moved("bar_2", "shift", -1, 3) == pytest.approx(shift, rel=1e-6)
    turn = page.moved("bar_2", "turn", -1, 3)
    assert turn == pytest.approx(np.outer(np.linspace(0, 1e-8, 7), [0, 1, 0]), rel=1e-6, abs=1e-15)


def test_the_header_holds_the_view(written):
    """Bounds, lines, names and largest displacements of a scene in small motion."""
    view = view_motion(machine(), turning(angle=1e-5, n=5))
    page = written(view)
    points = np.vstack([shape.form.points @ shape.rotation.T + shape.position for shape in view.shapes])
    assert page.header["bounds"] == [points.min(axis=0).tolist(), points.max(axis=0).tolist()]
    assert page.header["small"]
    moved = [np.linalg.norm(view.displacement("bar_2", frame=k), axis=1).max() for k in range(5)]
    assert max(moved) > 1.2 * min(moved)
    assert page.header["motion"]["largest"] == pytest.approx(max(moved))
    form, surface = page.header["forms"][page.shape("bar_1")["form"]], bar().surface
    for name, lines in (("triangles", surface.triangles), ("edges", surface.edges)):
        assert np.array_equal(page.array(form[name]), lines.ravel())
    assert len(page.array(form["outline"])) < len(page.array(form["edges"]))
    texts = {mark["name"]: mark["text"] for mark in page.header["marks"]}
    assert "spring spring: bar_1.right to bar_2.right along their line" in texts["spring"]
    assert page.shape("bar_1")["text"] == "78 g, flexible (ffrf)"


def test_a_modes_largest_displacement_may_be_any_bodys(written):
    """A block spins beside one that stands."""
    corners = block((0.1, 0.2, 0.3)).points
    still = Shape("still", Form(block((1, 1, 1))))
    turns = np.cross([0, 0, 1.0], corners)[:, :, None]
    turned = Shape("turned", Form(block((0.1, 0.2, 0.3)), modes=turns))
    page = written(View("two", (still, turned), modes=(Mode("spin", {"turned": [0.5]}),)))
    assert page.header["modes"][0]["peak"] == pytest.approx(0.5 * np.hypot(0.05, 0.1))
    assert page.mode(0, "turned") == pytest.approx(0.5 * turns[:, :, 0], abs=1e-5)


def test_copies_of_a_body_share_one_set_of_arrays(written):
    page = written(view_scene(machine()))
    assert [shape["form"] for shape in page.header["shapes"]] == [0, 1, 1, 2]
    assert len(page.header["forms"]) == 3


def test_faces_have_the_colours_of_their_labels(written):
    """Also where there are more parts than a byte can count; the colour of one that has none is grey."""
    numbers = np.random.default_rng(3).permutation(300)
    labels = tuple(f"part {k}" for k in numbers)
    surface = Surface(np.eye(3), np.tile([0, 1, 2], (300, 1)), np.zeros((0, 2), int), labels)
    colors = {f"part {k}": f"#{k:06x}" for k in range(299)}
    page = written(View("many", (Shape("many", Form(surface), colors=colors),)))
    form, shape = page.header["forms"][0], page.shape("many")
    assert [form["labels"][k] for k in page.array(form["label"])] == [*labels]
    shown = [shape["colors"][k] for k in page.array(form["label"])]
    assert shown == [f"#{k:06x}" if k < 299 else "#c9ccd1" for k in numbers]


def test_axes_of_marks_stand_in_the_frame_that_they_turn_with(written):
    page = written(view_scene(machine()))
    pin, encoder = (next(m for m in page.header["marks"] if m["name"] == name) for name in ("pin", "encoder"))
    assert np.abs(TURN @ np.ravel(pin["axes"])) == pytest.approx(np.abs(TURN[:, 1])) or pin["frame"] == "ground"
    push = next(m for m in page.header["marks"] if m["name"] == "push")
    assert push["frame"] == "bar_2"
    assert TURN @ np.ravel(push["axes"]) == pytest.approx([0, 0, 1])
    assert encoder["axes"] == [[1, 0, 0]]


def test_the_programs_stay_readable():
    """Short enough to be read, without a build step, and with no name of a server in it."""
    folder = Path(nassim.viewer.__file__).parent / "page"
    for name in ("viewer.js", "marks.js", "stage.js"):
        lines = (folder / name).read_text(encoding="utf-8").splitlines()
        assert len(lines) <= 400
        assert max(map(len, lines)) <= 130
    assert "MIT" in (folder / "three" / "LICENSE").read_text(encoding="utf-8")


def test_coordinates_that_cancel_are_told_exactly():
    """A rigid shift as the sum of all points' constraint modes, beside it a deformation a millionth as large."""
    from nassim.viewer.encoding import encode

    rigid = np.concatenate([np.tile([0, 0, 1.0, 0, 0, 0], 2), np.zeros(3)])
    bend = np.eye(15)[12]
    view = view_modes(bar(), {"both": rigid + 1e-6 * bend})
    header, _ = encode(view)
    assert len(header["modes"][0]["coordinates"]["bar"]) == 1
    assert header["modes"][0]["peak"] == pytest.approx(1.0, rel=1e-3)
