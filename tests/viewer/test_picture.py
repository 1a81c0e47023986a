"""Pictures drawn off the screen: the figures in them, without PyVista a message."""

import sys

import numpy as np
import pytest
from seen import bar, bar_model, machine, turning

from nassim.viewer import picture, save_picture, view_mesh, view_modes, view_motion, view_scene


def drawn(path):
    image = pytest.importorskip("PIL.Image").open(path)
    return np.asarray(image.convert("RGB")).astype(int)


@pytest.fixture(autouse=True)
def _pyvista(request):
    if "without" not in request.node.name and "drawing" not in request.node.name:
        pytest.importorskip("pyvista", reason="pictures need the extra viewer")


def test_a_picture_shows_the_body_with_its_colours(tmp_path):
    pixels = drawn(save_picture(view_mesh(bar_model()), tmp_path / "new" / "mesh.png", mesh=True, size=(400, 300)))
    assert pixels.shape == (300, 400, 3)
    assert np.all(pixels[150, [2, -3]] == 255)
    grey = np.ptp(pixels, axis=2) < 30
    assert 0.03 < np.mean(grey & (pixels.mean(axis=2) < 240) & (pixels.mean(axis=2) > 60)) < 0.5


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


def test_a_drawing_of_a_mode_is_as_large_as_on_a_page():
    view = view_modes(bar(), fixed=["left"], n=2)
    drawing = picture._drawing(view, view.modes[1].name, None, 1.0)
    moved = drawing.points["bar"] - view.shape("bar").points
    assert np.linalg.norm(moved, axis=1).max() == pytest.approx(0.06 * view.size)
    exact = view.displacement("bar", mode=view.modes[1].name)
    assert np.allclose(moved / np.abs(moved).max(), exact / np.abs(exact).max())


def test_a_drawing_magnifies_deformation_and_leaves_far_ways_true():
    view, motion = view_motion(machine(), turning()), turning()
    drawing = picture._drawing(view, None, 4, 100.0)
    own = bar().surface.points + 100 * bar().surface_modes @ motion.coordinates["bar_2"][4]
    there = view.shape("bar_2").position + own @ motion.rotations["bar_2"][4].T
    assert np.allclose(drawing.points["bar_2"][: len(own)], there)
    assert "0.2 s, deformation x 100" in drawing.title
    assert drawing.told == "deformation"
    assert drawing.lengths["bar_2"][: len(own)] == pytest.approx(
        np.linalg.norm(bar().surface_modes @ motion.coordinates["bar_2"][4], axis=1)
    )
    small = view_motion(machine(), turning(angle=1e-4))
    drawing = picture._drawing(small, None, 4, 100.0)
    moved = drawing.points["bar_2"] - small.shape("bar_2").points
    assert np.allclose(moved, 100 * small.displacement("bar_2", frame=4))
    assert drawing.told == "displacement"
    assert 100 * drawing.lengths["bar_2"] == pytest.approx(np.linalg.norm(moved, axis=1))


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"modes": "mode 9"}, "unknown mode 'mode 9'; known: mode 1"),
        ({"frame": 0}, "has no motion, so no frame 0"),
        ({"modes": "mode 1: free motion", "frame": 0}, "has no motion, so no frame 0"),
        ({"frame": 0, "magnification": 0}, "magnification must be positive"),
    ],
)
def test_what_a_view_does_not_have_is_refused(tmp_path, options, problem):
    with pytest.raises(ValueError, match=problem):
        save_picture(view_modes(bar(), n=2), tmp_path / "p.png", **options)
    with pytest.raises(ValueError, match="has the frames 0 to 6, not 7"):
        save_picture(view_motion(machine(), turning()), tmp_path / "p.png", frame=7)
    assert list(tmp_path.iterdir()) == []


def test_without_pyvista_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(ImportError, match=r'pip install "nassim\[viewer\]"'):
        save_picture(view_mesh(bar_model()), tmp_path / "p.png")
