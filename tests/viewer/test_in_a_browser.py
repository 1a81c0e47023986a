"""Pages in Debian's Chromium, without a screen and without a network; skipped where there is none, and in CI."""

import io
import os
import shutil
import time

import numpy as np
import pytest
from seen import bar, machine, turning

from nassim.viewer import Form, Mode, Shape, View, block, view_modes, view_motion, view_scene, write_page

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

    def open(self, view):
        path = write_page(view, self.folder / "page.html")
        self.driver.get(path.as_uri())
        self.wait("return Boolean(window.nassim?.ready)")
        return path

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
    browser.open(view_modes(body, fixed=["left"], n=4))
    assert "bar: left held" in browser.find("side").text
    assert "displacement [mm]" in browser.find("colors").text
    _, vectors = body.eigenmodes(fixed=["left"], n=4)
    before = browser.pixels()
    assert before.std() > 5
    for k in (0, 3):
        browser.run("const m = document.getElementById('mode'); m.selectedIndex = arguments[0]; "
                    "m.dispatchEvent(new Event('change'))", k)  # fmt: skip
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
    browser.open(view)
    browser.run("const a = document.getElementById('amplitude'); a.value = 10; a.dispatchEvent(new Event('input'))")
    browser.wait("return document.getElementById('amplitude-text').textContent.startsWith('10.1 mm')")
    assert browser.find("figures").text.split()[0] == "10.1"
    assert 0.1 * view.size == pytest.approx(10.1e-3, rel=1e-2)
    largest = np.linalg.norm(view.displacement("bar", mode=view.modes[0].name), axis=1)
    point = int(np.argmax(largest))
    drawn = np.array(browser.run("return nassim.drawn('bar', arguments[0])", point))
    assert np.linalg.norm(drawn - view.shape("bar").points[point]) == pytest.approx(0.1 * view.size, rel=1e-3)


def test_figures_of_what_is_large(browser):
    browser.open(View("tower", (Shape("tower", Form(block((30.0, 40.0, 120.0)))),), modes=(Mode("none", {}),)))
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
        browser.run("const f = document.getElementById('frame'); f.value = arguments[0]; "
                    "f.dispatchEvent(new Event('input'))", frame)  # fmt: skip
        expected = view.displacement("bar_2", frame=frame)[ten(bar())]
        assert browser.displacements("bar_2", ten(bar())) == pytest.approx(expected, abs=1e-6)
    browser.wait("return parseFloat(document.getElementById('time').textContent) === 0.3")
    factor = browser.run("return nassim.state.magnification")
    drawn = np.array(browser.run("return nassim.drawn('bar_2', 0)"))
    turn, own = motion.rotations["bar_2"][-1], view.deformation("bar_2", -1)[0]
    exact = view.shape("bar_2").position + turn @ (bar().surface.points[0] + factor * own)
    assert drawn == pytest.approx(exact, abs=1e-6)


def test_a_small_motion_is_magnified_as_a_whole(browser):
    view = view_motion(machine(), turning(angle=1e-6, size=1e-9))
    browser.open(view)
    assert "motion, magnified".upper() in browser.find("side").text.upper()
    browser.run("const f = document.getElementById('frame'); f.value = 6; f.dispatchEvent(new Event('input'))")
    factor = browser.run("return nassim.state.magnification")
    assert factor > 1e3
    # A turn stays a turn when it is magnified, which bends the path of points a little.
    for k in ten(bar()):
        drawn = np.array(browser.run("return nassim.drawn('bar_2', arguments[0])", int(k)))
        moved = view.displacement("bar_2", frame=6)[k]
        assert drawn - view.shape("bar_2").points[k] == pytest.approx(factor * moved, abs=0.1 * (1e-6 * factor) ** 2)


def test_parts_are_named_under_the_pointer_and_can_be_hidden(browser):
    browser.open(view_scene(machine(), looks={"ground": block((0.06, 0.06, 0.01), (0, 0, -0.03))}))
    for name in ("ground", "bar_1", "bar_2", "block", "joints", "springs", "actuators", "sensors"):
        assert name in browser.find("side").text
    at = "const p = nassim.toScreen(nassim.drawn(arguments[0], arguments[1])); return nassim.under(p[0], p[1])"
    index = len(bar().surface.points)
    tips = browser.run(at, "bar_2", index + 1)
    assert "spring spring: bar_1.right to bar_2.right along their line" in tips
    assert "actuator push" in tips
    assert "sensor encoder [m]" in tips
    for box in browser.driver.find_elements("css selector", "#switches input")[:4]:
        box.click()
    assert browser.run(at, "bar_1", index + 2).startswith("bar_1\n")
    before = browser.pixels()
    browser.driver.find_elements("css selector", "#parts input")[1].click()
    time.sleep(0.3)
    assert np.abs(browser.pixels() - before).max() > 50
    assert not browser.run(at, "bar_1", index + 2).startswith("bar_1\n")
