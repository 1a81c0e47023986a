"""Pages in Debian's Chromium, without a screen and without a network; skipped where there is none, and in CI."""

import io
import os
import shutil
import time
from dataclasses import replace

import numpy as np
import pytest
from conftest import STEEL
from seen import TURN, bar, bar_model, machine, turning

from nassim import Solid
from nassim.scene import Motion
from nassim.viewer import (
    Coloring,
    Form,
    Mark,
    Mode,
    Shape,
    View,
    block,
    view_faces,
    view_mesh,
    view_modes,
    view_motion,
    view_scene,
    view_scene_modes,
    write_page,
)

webdriver = pytest.importorskip("selenium.webdriver", reason="Selenium drives the browser: pip install selenium")
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="needs chromium and chromedriver, as Debian has them"),
    pytest.mark.skipif("CI" in os.environ, reason="what CI's machines draw with is not ours to test"),
]
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--window-size=1200,800",
    "--proxy-server=127.0.0.1:9",  # nobody listens there: no network
)  # fmt: skip
PATIENCE = 60.0


class Browser:
    """A page, and what a person does with it."""

    def __init__(self, driver, folder):
        self.driver, self.folder = driver, folder

    def open(self, view, *, coloured=False):
        path = write_page(view, self.folder / "page.html")
        self.driver.get(path.as_uri())
        self.wait("return Boolean(window.nassim?.ready)")
        if coloured:
            self.switch("colour by size")
        return path

    def switch(self, name):
        """Press one of the switches by its name."""
        self.run("[...document.querySelectorAll('label')].find(b => b.textContent === arguments[0]).click()", name)

    def wait(self, script):
        end = time.monotonic() + PATIENCE
        while not self.run(script):
            assert time.monotonic() < end, f"{script!r} does not come true; console: {self.console()}"
            time.sleep(0.05)

    def run(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def console(self):
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] != "INFO"]

    def find(self, name):
        return self.driver.find_element("id", name)

    def pixels(self):
        image = pytest.importorskip("PIL.Image").open(io.BytesIO(self.find("scene").screenshot_as_png))
        return np.asarray(image.convert("RGB")).astype(int)

    def key(self, letter):
        webdriver.ActionChains(self.driver).send_keys(letter).perform()

    def set(self, name, value):
        """Move a slider, or choose from a list by number."""
        self.run(
            "const e = document.getElementById(arguments[0]); if (e.options) e.selectedIndex = arguments[1];"
            "else e.value = arguments[1]; e.dispatchEvent(new Event(e.options ? 'change' : 'input'))", name, value
        )  # fmt: skip

    def click(self, name):
        """Press one of the buttons by what is written on it."""
        self.run("[...document.querySelectorAll('button')].find(b => b.textContent === arguments[0]).click()", name)

    def drawn_again(self):
        """Wait until what was asked for is on the screen."""
        self.driver.execute_async_script("const done = arguments[0]; requestAnimationFrame(() => setTimeout(done, 0))")

    def on_screen(self, place):
        return np.array(self.run("return nassim.toScreen(arguments[0])", [float(x) for x in place]))

    def displacements(self, name, points):
        return np.array([self.run("return nassim.displacement(...arguments)", name, int(k)) for k in points])


@pytest.fixture(scope="module")
def driver(tmp_path_factory):
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    result = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield result
    result.quit()


@pytest.fixture
def browser(driver, tmp_path):
    result = Browser(driver, tmp_path)
    yield result
    assert result.console() == []


def ten(body):
    return np.linspace(0, len(body.surface.points) - 1, 10).astype(int)


def test_modes_are_drawn_chosen_and_swung(browser):
    body = bar()
    view = view_modes(body, fixed=["left"], n=4)
    browser.open(view, coloured=True)
    assert "bar: left held" in browser.find("side").text
    assert "displacement [mm]" in browser.find("colors").text
    _, vectors = body.eigenmodes(fixed=["left"], n=4)
    before = browser.pixels()
    assert before.std() > 5
    for k in (0, 3):
        browser.set("mode", k)
        browser.drawn_again()
        assert browser.find("mode-text").text == view.modes[k].text != ""
        expected = (body.surface_modes @ vectors[:, k])[ten(body)]
        assert browser.displacements("bar", ten(body)) == pytest.approx(expected, abs=1e-4 * np.abs(expected).max())
    time.sleep(0.3)
    assert np.abs(browser.pixels() - before).max() > 50
    phase = browser.run("return nassim.state.phase")
    browser.key(" ")
    browser.wait(f"return nassim.state.playing && nassim.state.phase > {phase} + 0.5")
    browser.key(" ")
    browser.wait("return !nassim.state.playing")


def test_the_amplitude_is_what_the_slider_and_the_colours_say(browser):
    view = view_modes(bar(), fixed=["left"], n=1)
    browser.open(view, coloured=True)
    browser.set("amplitude", 10)
    browser.wait("return document.getElementById('amplitude-text').textContent.startsWith('10.1 mm')")
    assert browser.find("figures").text.split()[0] == "10.1"
    assert 0.1 * view.size == pytest.approx(10.1e-3, rel=1e-2)
    largest = np.linalg.norm(view.displacement("bar", mode=view.modes[0].name), axis=1)
    point = int(np.argmax(largest))
    drawn = np.array(browser.run("return nassim.drawn('bar', arguments[0])", point))
    assert np.linalg.norm(drawn - view.shape("bar").points[point]) == pytest.approx(0.1 * view.size, rel=1e-3)


def test_figures_of_what_is_large(browser):
    browser.open(
        View("tower", (Shape("tower", Form(block((30.0, 40.0, 120.0)))),), modes=(Mode("none", {}),)), coloured=True
    )
    browser.wait("return document.getElementById('amplitude-text').textContent.startsWith('7.8 m;')")
    assert browser.find("quantity").text == "displacement [m]"
    assert browser.find("figures").text.split() == ["7.8", "5.85", "3.9", "1.95", "0"]


def test_a_motion_plays_and_shows_what_moved(browser):
    motion = turning(n=31)
    view = view_motion(machine(), motion)
    browser.open(view)
    assert "deformation, magnified".upper() in browser.find("side").text.upper()
    browser.run("document.getElementById('play').click()")
    browser.wait("return nassim.state.frame > 2")
    browser.run("document.getElementById('play').click()")
    for frame in (0, 17, 30):
        browser.set("frame", frame)
        expected = view.displacement("bar_2", frame=frame)[ten(bar())]
        assert browser.displacements("bar_2", ten(bar())) == pytest.approx(expected, abs=1e-6)
    browser.wait("return document.getElementById('time').textContent === '0.300 s'")
    factor = browser.run("return nassim.state.magnification")
    drawn = np.array(browser.run("return nassim.drawn('bar_2', 0)"))
    turn, own = motion.rotations["bar_2"][-1], view.deformation("bar_2", -1)[0]
    exact = view.shape("bar_2").position + turn @ (bar().surface.points[0] + factor * own)
    assert drawn == pytest.approx(exact, abs=1e-6)


def test_a_small_motion_is_magnified_as_a_whole(browser):
    motion = turning(angle=1e-6, size=1e-9)
    shift = 1e-8 * np.arange(7)[:, None] * [1.0, -2.0, 0.5]
    view = view_motion(machine(), replace(motion, positions={n: p + shift for n, p in motion.positions.items()}))
    browser.open(view)
    assert "motion, magnified".upper() in browser.find("side").text.upper()
    browser.set("frame", 6)
    factor = browser.run("return nassim.state.magnification")
    assert factor > 1e3
    # A turn stays a turn when it is magnified, which bends the path of points a little.
    for k in ten(bar()):
        drawn = np.array(browser.run("return nassim.drawn('bar_2', arguments[0])", int(k)))
        moved = view.displacement("bar_2", frame=6)[k]
        assert drawn - view.shape("bar_2").points[k] == pytest.approx(factor * moved, abs=0.1 * (1e-6 * factor) ** 2)
    expected = view.displacement("bar_2", frame=6)[ten(bar())]
    assert browser.displacements("bar_2", ten(bar())) == pytest.approx(expected, abs=1e-3 * np.abs(expected).max())


def test_parts_are_named_under_the_pointer_and_can_be_hidden(browser):
    browser.open(view_scene(machine(), looks={"ground": block((0.06, 0.06, 0.01), (0, 0, -0.03))}))
    for name in ("ground", "bar_1", "bar_2", "block", "joints", "springs", "actuators", "sensors"):
        assert name in browser.find("side").text
    at = "const p = nassim.toScreen(nassim.drawn(arguments[0], arguments[1])); return nassim.under(p[0], p[1])"
    index = len(bar().surface.points)
    tips = browser.run(at, "bar_2", index + 1)
    assert "spring spring: bar_1.right to bar_2.right along their line" in tips
    assert {"spring spring", "actuator push", "sensor encoder"} <= set(tips.splitlines())
    assert "encoder encoder [m]: bar_2.right against ground.hinge along x" in tips
    for box in browser.driver.find_elements("css selector", "#switches input")[:4]:
        box.click()
    assert browser.run(at, "bar_1", index + 2).startswith("bar_1\n")
    before = browser.pixels()
    browser.driver.find_elements("css selector", "#parts input")[1].click()
    time.sleep(0.3)
    assert np.abs(browser.pixels() - before).max() > 50
    assert not browser.run(at, "bar_1", index + 2).startswith("bar_1\n")
    assert browser.run("return nassim.shapes.map(s => s.group.visible)") == [True, False, True, True]


SCALE = ["440154", "482475", "414487", "355f8d", "2a788e", "21918c", "22a884", "44bf70", "7ad151", "bddf26", "fde725"]
"""Viridis in tenths, as screens have it: from what rests to what moves most."""


def check_colors(browser, name, share):
    """Points of a shape have the colours of their shares of the largest length, mixed as light (IEC 61966-2-1)."""
    script = "return [...nassim.shapes.find(s => s.name === arguments[0]).color.array]"
    colors = np.array(browser.run(script, name)).reshape(-1, 3)
    steps = np.array([[int(color[k : k + 2], 16) for k in (0, 2, 4)] for color in SCALE]) / 255
    light = np.where(steps <= 0.04045, steps / 12.92, ((steps + 0.055) / 1.055) ** 2.4)
    expected = np.column_stack([np.interp(share, np.linspace(0, 1, 11), channel) for channel in light.T])
    assert colors == pytest.approx(expected, abs=5e-3)


def test_modes_of_turned_bodies(browser):
    """Displacements along the world's axes, colours by their share of the mode's largest, outlines at rest."""
    view = view_scene_modes(machine(), n=6)
    browser.open(view, coloured=True)
    assert browser.run("return document.getElementById('bar').style.background").startswith("linear-gradient(to top,")
    for k in (0, 5):
        sent = browser.run("return nassim.shapes[2].color.version")
        browser.set("mode", k)
        browser.drawn_again()
        assert browser.run("return nassim.shapes[2].color.version") > sent, "new colours are sent to be drawn"
        moved = {shape.name: view.displacement(shape.name, mode=view.modes[k].name) for shape in view.shapes}
        largest = max(np.linalg.norm(values, axis=1).max() for values in moved.values())
        for name in ("bar_1", "bar_2", "block"):
            points = ten(bar()) if "bar" in name else range(8)
            assert browser.displacements(name, points) == pytest.approx(moved[name][points], abs=1e-4 * largest)
            check_colors(browser, name, np.linalg.norm(moved[name], axis=1) / largest)
    rest = "return nassim.shapes[2].rest.matrixWorld.elements"
    place = np.array(browser.run(rest)).reshape(4, 4).T
    assert place[:3, :3] == pytest.approx(view.shape("bar_2").rotation, abs=1e-6)
    assert place[:3, 3] == pytest.approx(view.shape("bar_2").position, abs=1e-6)
    lines = "return nassim.shapes[2].rest.geometry.index.count"
    assert browser.run(lines) == view.shape("bar_2").form.outline.size


@pytest.mark.parametrize("angle", [1e-6, 2.0])
def test_a_motion_is_coloured_by_what_its_scale_says(browser, angle):
    """By displacement where all of it is magnified, else by deformation."""
    view = view_motion(machine(), turning(angle=angle, size=1e-9))
    browser.open(view, coloured=True)
    browser.set("frame", 5)
    browser.drawn_again()
    small = angle < 1
    told = {
        name: [view.displacement(name, frame=k) if small else view.deformation(name, k) for k in range(7)]
        for name in ("bar_1", "bar_2")
    }
    lengths = {name: np.linalg.norm(values, axis=2) for name, values in told.items()}
    largest = max(values.max() for values in lengths.values())
    assert browser.find("quantity").text == f"{'displacement' if small else 'deformation'} [nm]"
    top = float(browser.find("figures").text.split()[0])
    assert top == pytest.approx(1e9 * largest, rel=1e-2)
    check_colors(browser, "bar_2", lengths["bar_2"][5] / largest)
    assert lengths["bar_2"][5].max() > 0.2 * largest


def test_far_ways_of_stiff_bodies_leave_them_their_colours(browser):
    motion = turning()
    still = {name: 0 * values for name, values in motion.coordinates.items()}
    browser.open(view_motion(machine(), replace(motion, coordinates=still)))
    browser.set("frame", 4)
    browser.drawn_again()
    assert not browser.find("colors").is_displayed()
    assert not browser.run("return nassim.shapes[1].parts[0].material.vertexColors")
    assert browser.run("return nassim.state.magnification") == 1


def play_by_hand(browser, steps):
    """Press play, give the page these times since then [ms] as a screen would, and stop; returns its states between."""
    browser.run(
        "window.waiting = []; window.screen_frame = window.requestAnimationFrame;"
        "window.requestAnimationFrame = f => window.waiting.push(f);"
        "document.getElementById('play').click(); window.began = nassim.state.last"
    )
    script = (
        "const due = window.waiting; window.waiting = []; for (const f of due) f(window.began + arguments[0]);"
        "const { phase, clock, frame } = nassim.state; return { phase, clock, frame }"
    )
    states = [browser.run(script, step) for step in steps]
    label = browser.find("play").text
    browser.run(
        "document.getElementById('play').click(); window.requestAnimationFrame = window.screen_frame;"
        "for (const f of window.waiting) f(performance.now())"
    )
    assert label == "pause"
    assert browser.find("play").text == "play"
    return states


def test_a_motion_plays_in_ten_seconds_or_as_fast_as_told(browser):
    """Of 0.3 s that begin at 5 s: the clock and the frame that is the last before it; the end begins anew."""
    motion = turning(n=31)
    browser.open(view_motion(machine(), replace(motion, time=motion.time + 5.0)))
    assert browser.run("return nassim.state.speed") == pytest.approx(0.03)
    states = play_by_hand(browser, [50, 90])
    assert [state["clock"] for state in states] == pytest.approx([0.03 * 0.05, 0.03 * 0.09])
    browser.set("speed", 0)
    browser.wait("return document.getElementById('speed-text').textContent === '1 × real time'")
    browser.set("frame", 8)
    browser.wait("return parseFloat(document.getElementById('time').textContent) === 5.08")
    states = play_by_hand(browser, [5, 75, 135, 215, 265])
    assert [state["clock"] for state in states] == pytest.approx([0.085, 0.155, 0.215, 0.295, 0.045])
    assert [state["frame"] for state in states] == [8, 15, 21, 29, 4]
    browser.set("speed", -2)
    browser.wait("return document.getElementById('speed-text').textContent === '1/100 × real time'")
    assert browser.run("return nassim.state.speed") == pytest.approx(0.01)


def test_a_mode_swings_in_two_seconds(browser):
    browser.open(view_modes(bar(), fixed=["left"], n=1))
    states = play_by_hand(browser, [40, 100])
    assert [state["phase"] for state in states] == pytest.approx(np.pi * np.array([0.54, 0.6]))


def test_a_magnification_is_a_round_one_and_what_the_slider_says(browser):
    view = view_motion(machine(), turning(angle=1e-6, size=1e-9))
    browser.open(view)
    largest = max(np.linalg.norm(view.displacement("bar_2", frame=k), axis=1).max() for k in range(7))
    factor = browser.run("return nassim.state.magnification")
    assert factor * largest <= 0.04 * view.size < 2.5 * factor * largest
    assert round(factor / 10 ** np.floor(np.log10(factor)), 6) in (1, 2, 5)
    browser.set("magnification", 3)
    browser.wait("return document.getElementById('magnification-text').textContent === '× 1,000'")
    assert browser.run("return nassim.state.magnification") == pytest.approx(1000)


def test_marks_turn_with_what_they_stand_on(browser):
    """A force from its point on, along an axis of the bar; a hinge to both sides; an encoder along the world's x."""
    motion = turning()
    browser.open(view_motion(machine(), motion))
    browser.set("frame", 4)
    browser.drawn_again()
    script = (
        "const m = nassim.marks.find(m => m.name === arguments[0]);"
        "return [m.places, ...m.segments].map(points => points.map(p => p.toArray()))"
    )
    turned = motion.rotations["bar_2"][4] @ TURN.T
    (point,), force = (np.array(points) for points in browser.run(script, "push"))
    assert force[0] == pytest.approx(point)
    along = force[1] - force[0]
    assert along / np.linalg.norm(along) == pytest.approx(turned @ [0, 0, 1], abs=1e-5)
    (point,), hinge = (np.array(points) for points in browser.run(script, "pin"))
    assert hinge.mean(axis=0) == pytest.approx(point, abs=1e-9)
    along = hinge[1] - hinge[0]
    assert abs(along @ TURN[:, 1]) == pytest.approx(np.linalg.norm(along))
    places, line, arrow = (np.array(points) for points in browser.run(script, "encoder"))
    assert line == pytest.approx(places)
    assert (arrow[1] - arrow[0]) / np.linalg.norm(arrow[1] - arrow[0]) == pytest.approx([1, 0, 0])
    assert arrow[0] == pytest.approx(places[1])


SEEN_FROM = {"front": ((1, 0, 0), (0, 0, 1)), "side": ((0, 1, 0), (0, 0, 1)), "top": ((1, 0, 0), (0, 1, 0))}
"""What points to the right and up."""


@pytest.mark.parametrize("name", SEEN_FROM)
def test_buttons_turn_the_view_and_a_bar_tells_lengths(browser, name):
    browser.open(view_scene(machine()))
    browser.click(name)
    browser.drawn_again()
    right, up = (10e-3 * np.array(axis) for axis in SEEN_FROM[name])
    middle = browser.on_screen((0, 0, 0))
    across, above = browser.on_screen(right) - middle, browser.on_screen(up) - middle
    assert across[0] > 20
    assert across[1] == pytest.approx(0, abs=0.1)
    assert above == pytest.approx([0, -across[0]], abs=0.1)
    label, bar_ = browser.find("scale").find_elements("css selector", "span, div")
    length, unit = label.text.split()
    assert unit == "mm"
    assert float(length) * across[0] / 10 == pytest.approx(bar_.size["width"], rel=0.05)
    assert 50 < bar_.size["width"] < 160
    axes = {
        text.get_attribute("textContent"): [float(text.get_attribute(k)) for k in "xy"]
        for text in browser.driver.find_elements("css selector", "#triad text")
    }
    letters = ["xyz"[int(np.argmax(axis))] for axis in SEEN_FROM[name]]
    assert [axes[letter] for letter in letters] == pytest.approx(np.array([[43, 0], [0, -43]]), abs=0.1)


@pytest.mark.parametrize(("place", "mark", "hidden"), [(0.0, 0.2, True), (-0.05, 0.0, False)])
def test_a_page_is_see_through_where_a_box_hides_a_body(browser, place, mark, hidden):
    """Points of marks do not count: one of the box lies 100 mm from its centre, one of the body within far outside."""
    box = Shape("box", Form(block((0.04, 0.04, 0.04)), ("far",), np.full((1, 3), -0.1)))
    body = Shape("body", Form(block((0.01, 0.01, 0.01)), ("mark",), np.full((1, 3), mark)), np.full(3, place))
    browser.open(View("boxes", (box, body)))
    assert browser.run("return nassim.shapes[1].parts[0].material.transparent") is hidden


@pytest.mark.parametrize("width", [400, 700])
def test_in_a_narrow_window_the_controls_stand_apart(browser, width):
    browser.driver.set_window_size(width, 800)
    try:
        browser.open(view_motion(machine(), turning()))
        places = [browser.find(name).rect for name in ("side", "player", "triad", "scale")]
    finally:
        browser.driver.set_window_size(1200, 800)
    for k, one in enumerate(places):
        for other in places[:k]:
            apart = [abs(one[at] - other[at] + (one[size] - other[size]) / 2) - (one[size] + other[size]) / 2
                     for at, size in (("x", "width"), ("y", "height"))]  # fmt: skip
            assert max(apart) >= 0


def test_a_page_opens_in_the_colours_of_parts_on_an_elastic_mode_with_any_axis_up(browser):
    browser.open(view_modes(bar(), n=8))
    assert browser.run("return document.getElementById('mode').selectedIndex") == 6
    assert not browser.find("colors").is_displayed()
    assert "#" + browser.run("return nassim.shapes[0].parts[0].material.color.getHexString()") != "#ffffff"
    for axis, right, up in (("y", (1, 0, 0), (0, 1, 0)), ("x", (0, 0, -1), (1, 0, 0))):
        browser.set("up", "xyz".index(axis))
        browser.click("front")
        browser.drawn_again()
        middle = browser.on_screen((0, 0, 0))
        across, above = (browser.on_screen(10e-3 * np.array(way)) - middle for way in (right, up))
        assert across[0] > 20
        assert across[1] == pytest.approx(0, abs=0.1)
        assert above == pytest.approx([0, -across[0]], abs=0.1)


def test_dark_pages_and_marks_behind_a_body(browser):
    """A mark inside a body is faint; the background follows what the browser prefers."""
    inside = Form(block((0.02, 0.02, 0.02)), ("core", "front"), np.array([[0, 0, 0], [0, -0.02, 0.0]]))
    marks = tuple(Mark(name, "joint", (("block", name),)) for name in inside.names)
    browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [
        {"name": "prefers-color-scheme", "value": "dark"}]})  # fmt: skip
    browser.open(View("block", (Shape("block", inside),), marks))
    browser.click("side")
    browser.drawn_again()
    pixels = browser.pixels()
    assert pixels[-1, pixels.shape[1] // 2].max() < 60

    def color(place):
        x, y = browser.on_screen(place).astype(int)
        return pixels[y, x]

    body, faint, full = color((0, -5e-3, 0)), color((0, 0, 0)), color((0, -0.02, 0))
    assert np.abs(full - [0x1F, 0x77, 0xB4]).max() < 12
    assert faint == pytest.approx(0.7 * body + 0.3 * full, abs=20)
    browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    browser.drawn_again()
    assert browser.pixels()[-1, pixels.shape[1] // 2].min() > 240


def test_the_tip_tells_how_far_a_point_moves(browser):
    """As drawn of a mode, as it was of a motion."""
    view = view_modes(bar(), fixed=["left"], n=2)
    browser.open(view)
    browser.set("mode", 1)
    browser.set("amplitude", 5)
    points = bar().surface.points
    along = [int(np.argmin(np.linalg.norm(points - [x, -0.005, 0.0], axis=1))) for x in (0.02, 0.05, 0.08, 0.1)]
    moved = np.linalg.norm(view.displacement("bar", mode=view.modes[1].name), axis=1)
    at = "const p = nassim.toScreen(nassim.drawn(arguments[0], arguments[1])); return nassim.under(p[0] - 6, p[1])"
    browser.run("for (const mark of nassim.marks) mark.object.visible = false")
    units = {"mm": 1e-3, "µm": 1e-6}
    told = []
    for index in along:
        value, unit = browser.run(at, "bar", index).rpartition("displacement ")[2].split()
        told.append(float(value) * units[unit])
    largest = 0.05 * view.size
    assert told == pytest.approx(largest * moved[along] / moved.max(), abs=0.15 * largest)
    assert np.ptp(told) > 0.5 * largest
    view = view_motion(machine(), turning())
    browser.open(view)
    browser.set("frame", 6)
    browser.drawn_again()
    browser.run("for (const mark of nassim.marks) mark.object.visible = false")
    told = browser.run(at, "bar_2", index).rpartition("displacement ")[2].split()
    assert told[1] == "mm"
    far = np.linalg.norm(view.displacement("bar_2", frame=6), axis=1)[index]
    assert float(told[0]) == pytest.approx(1e3 * far, rel=0.15)


def test_small_lengths_have_small_units_and_faces_their_colours(browser):
    browser.open(view_modes(bar(), fixed=["left"], n=1))
    browser.set("amplitude", 0.1)
    browser.wait("return document.getElementById('amplitude-text').textContent.startsWith('101 µm;')")
    view = view_mesh(bar_model())
    browser.open(view)
    script = "return nassim.shapes[0].parts.map(p => [p.userData.label, '#' + p.material.color.getHexString()])"
    assert dict(browser.run(script)) == dict(view.shape("bar").colors)


def test_faces_show_their_numbers_and_are_listed_in_order(browser):
    """A block with twelve numbers: those in sight are drawn as white plates, beside the panel."""
    occ = pytest.importorskip("netgen.occ")
    shape = occ.Box((0, 0, 0), (0.06, 0.04, 0.02)) - occ.Box((0.02, -1, 0.01), (0.04, 1, 1))
    shape.name = "block"
    browser.open(view_faces(Solid("block", shape, {"block": STEEL})))
    browser.drawn_again()
    listed = browser.run("return [...document.querySelectorAll('#parts .name')].map(e => e.textContent)")
    numbers = [int(text.removeprefix("face ").partition(":")[0]) for text in listed]
    assert len(numbers) >= 10
    assert numbers == sorted(numbers)
    plates = browser.run("return nassim.marks.map(m => [m.name, m.dots.length, m.dots[0].type])")
    assert sorted(int(name) for name, *kind in plates if kind == [1, "Sprite"]) == numbers
    left = min(browser.on_screen((x, y, z))[0] for x in (0, 0.06) for y in (0, 0.04) for z in (0, 0.02))
    assert left > browser.run("return document.getElementById('side').getBoundingClientRect().right")


def test_a_quantity_colours_the_surface_at_each_image(browser):
    """Corners of a block with rising values that grow with time: colours of the scale, beside its title."""
    surface = block((0.02, 0.02, 0.02))
    corners = len(surface.points)
    values = np.outer([0.0, 0.5, 1.0], np.arange(corners) / (corners - 1))
    coloring = Coloring("von Mises stress [MPa]", 80.0 * values, 80.0)
    still = np.zeros((3, 3)), np.tile(np.eye(3), (3, 1, 1))
    motion = Motion(np.arange(3.0), {"a": still[0]}, {"a": still[1]}, {})
    browser.open(View("colours", (Shape("a", Form(surface), coloring=coloring),), motion=motion))
    browser.drawn_again()
    assert browser.find("colors").text.split("\n")[:2] == ["von Mises stress [MPa]", "80"]
    ends = [np.array(color) for color in ([0x44, 0x01, 0x54], [0x21, 0x91, 0x8C], [0xFD, 0xE7, 0x25])]
    shown = "return nassim.shapes[0].parts.length && [...nassim.shapes[0].color.array]"
    for frame, last in enumerate(ends):
        browser.set("frame", frame)
        found = np.reshape(browser.run(shown), (-1, 3))[:corners]
        srgb = np.where(found <= 0.0031308, 12.92 * found, 1.055 * np.maximum(found, 1e-9) ** (1 / 2.4) - 0.055)
        np.testing.assert_allclose(255 * srgb[[0, -1]], [ends[0], last], atol=3)
