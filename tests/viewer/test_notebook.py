"""What notebooks show of scenes, bodies, views, responses and records."""

import base64
import html
import re

import numpy as np
import pytest
from matplotlib.figure import Figure
from seen import bar

from nassim import FRF, RigidBody, Scene, SpringDamper, TimeHistory
from nassim.base.file_registry import DATA_CLASSES, find
from nassim.base.html_repr import DISPLAYS, html_repr
from nassim.plotting import notebook
from nassim.viewer import view_scene
from nassim.viewer.notebook import HEIGHT
from nassim.viewer.page import page_text
from nassim.viewer.view_content import View

BASE = RigidBody("base", {"o": [0, 0, 0]}, fixed=True)
TABLE = RigidBody("table", {"foot": [0, 0, 0]}, mass=2.0, inertia=np.eye(3), position=[0, 0, 0.1])
SCENE = Scene("stage <1>", (BASE, TABLE), springs=(SpringDamper("leg", "base.o", "table.foot", stiffness=1e5),))


@pytest.fixture
def drawn(monkeypatch):
    """The figures that become pictures."""
    figures = []

    def keep(figure, file, **options):
        figures.append(figure)
        file.write(b"picture")

    monkeypatch.setattr(Figure, "savefig", keep)
    return figures


def test_scenes_and_views_are_pages_in_frames():
    text = SCENE._repr_html_()
    page, style = re.fullmatch(r'<iframe srcdoc="([^"]*)" style="([^"]*)"></iframe>', text).groups()
    assert html.unescape(page) == page_text(view_scene(SCENE))
    assert f"height: {HEIGHT}px" in style
    assert view_scene(SCENE)._repr_html_() == text


def test_bodies_are_pages_with_a_card():
    body = bar()
    text = body._repr_html_()
    assert text.startswith("<iframe")
    card = dict(re.findall(r"<tr><th[^>]*>(.*?)</th><td[^>]*>(.*?)</td></tr>", text[text.index("<table") :]))
    card = {html.unescape(name): html.unescape(value) for name, value in card.items()}
    assert card["remote points"] == "left, right"
    assert float(card["mass [kg]"]) == pytest.approx(body.gram[0, 0], rel=1e-3)
    shown = [float(value) for value in card["first elastic frequencies, free [Hz]"].split(",")]
    assert shown == pytest.approx(body.eigenfrequencies()[6 : 6 + len(shown)], rel=1e-4)
    assert len(shown) == 6
    assert set(body.record) < set(card)


def test_responses_are_drawn_in_magnitude_and_phase(drawn):
    frequency = np.geomspace(1.0, 100.0, 30)
    response = 1 / (1 + 1j * frequency / 10.0)
    FRF(frequency, np.array([[response, -2 * response]]), ["x"], ["u", "v"], label="lag")._repr_html_()
    magnitude, phase = drawn[0].axes
    assert magnitude.get_title() == "lag"
    assert [text.get_text() for text in magnitude.get_legend().get_texts()] == ["x / u", "x / v"]
    np.testing.assert_allclose(magnitude.lines[1].get_ydata(), 2 * abs(response))
    np.testing.assert_allclose(phase.lines[0].get_ydata(), -np.degrees(np.arctan(frequency / 10.0)))


def test_what_is_left_out_is_told(drawn):
    names = [f"y{k}" for k in range(notebook.MOST + 1)]
    text = TimeHistory(np.linspace(0, 1, 9), np.random.default_rng(3).normal(size=(len(names), 9)), names)._repr_html_()
    assert text == f'<img src="data:image/png;base64,{base64.b64encode(b"picture").decode()}"/>'
    FRF([1.0, 2.0], np.ones((len(names), 1, 2)), names, ["u"], label="model")._repr_html_()
    history, frf = drawn
    assert len(history.axes) == len(frf.axes[0].lines) == notebook.MOST
    assert history.get_suptitle().strip() == "(the first 8 of 9 signals)"
    assert frf.axes[0].get_title() == "model (the first 8 of 9 responses)"


def test_all_classes_with_a_display_have_it():
    for name in DISPLAYS:
        assert (find(name) if name in DATA_CLASSES else View)._repr_html_ is html_repr
