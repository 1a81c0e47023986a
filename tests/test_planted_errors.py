"""The lists of planted errors can be read, and the tool tells what is caught from what survives and what is stale."""

from dataclasses import replace

import planted_errors
import pytest
from planted_errors import CAUGHT, STALE, PlantedError, copies, main, read_errors, run_tests, try_error


def test_all_lists_can_be_read_and_every_error_can_be_planted():
    """A snippet is in its file exactly once, and its tests are there: an entry that is stale tries nothing."""
    errors = read_errors()
    assert errors
    assert {error.name: reason for error in errors if (reason := error.stale(planted_errors.ROOT))} == {}


@pytest.fixture
def small_repository(tmp_path):
    """A repository of one function and three tests."""
    root = tmp_path / "repository"
    (root / "nassim").mkdir(parents=True)
    (root / "tests").mkdir()
    (root / "nassim" / "__init__.py").write_text("")
    (root / "nassim" / "circle.py").write_text("def area(r):\n    return 3.0 * r * r\n")
    (root / "tests" / "test_circle.py").write_text(
        "import pytest\nfrom nassim.circle import area\n\n"
        "def test_area():\n    assert area(2.0) == 12.0\n\n"
        "def test_broken():\n    assert area(2.0) == 11.0\n\n"
        "@pytest.mark.skip\ndef test_skipped():\n    pass\n"
    )
    return root


RUNS = {}


def run_once(place, tests, *options):
    """What pytest says of a text of the function, which does not change."""
    asked = (place / "nassim" / "circle.py").read_text(), tests, options
    if asked not in RUNS:
        RUNS[asked] = run_tests(place, tests, *options)
    return RUNS[asked]


HALF = PlantedError(
    "half", "nassim/circle.py", "3.0 * r * r", "1.5 * r * r", "half an area", ("test_circle.py::test_area",)
)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({}, CAUGHT),
        ({"new": "r * r * 3.0"}, "SURVIVES"),
        ({"tests": ("test_circle.py::test_skipped",)}, "SURVIVES"),
        ({"new": "3.0 * r *"}, "do not run"),
        ({"new": "3.0 * r * radius"}, "do not run: NameError"),
        ({"tests": ("test_circle.py::test_broken",)}, "fail without it"),
        ({"tests": ("test_circle.py::test_area[of-another-unit]",)}, STALE),
    ],
    ids=str,
)
def test_fates_of_an_error(small_repository, monkeypatch, change, text):
    monkeypatch.setattr(planted_errors, "run_tests", run_once)
    with copies(small_repository, 1) as (place,):
        outcome = try_error(place, replace(HALF, **change))
        assert (place / "nassim" / "circle.py").read_text() == (small_repository / "nassim" / "circle.py").read_text()
    assert text in outcome.text


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({}, ""),
        ({"old": "4.0 * r * r"}, "occurs 0 times"),
        ({"old": "r"}, "occurs 6 times"),
        ({"file": "nassim/square.py"}, "occurs 0 times"),
        ({"tests": ("test_circle.py::test_volume",)}, "do not exist: test_circle.py::test_volume"),
        ({"tests": ("test_ball.py::test_area",)}, "do not exist: test_ball.py::test_area"),
    ],
    ids=str,
)
def test_stale_entries(small_repository, change, reason):
    found = replace(HALF, **change).stale(small_repository)
    assert (reason in found) if reason else not found


@pytest.mark.parametrize(
    "table",
    [
        "[a]\nfile = 'f'\nold = 'x'\nnew = 'y'\nmeans = ''\ntests = []\n",
        "[a]\nfile = 'f'\nold = 'x'\nnew = 'x'\nmeans = ''\ntests = ['t']\n",
        "[a]\nfile = 'f'\nold = 'x'\nmeans = ''\ntests = ['t']\n",
    ],
)
def test_incomplete_entries_are_refused(table, tmp_path):
    (tmp_path / "list.toml").write_text(table)
    with pytest.raises(ValueError, match=r"list\.toml, \[a\]: "):
        read_errors(tmp_path)


def test_the_command(small_repository, tmp_path, monkeypatch, capsys):
    """A stale entry is no failure, a survivor is one; pytest finds by the code what the errors come to."""

    def run_tests(place, tests, *options):
        assert tests == ("test_circle.py::test_area",)
        return int("3" not in (place / "nassim" / "circle.py").read_text()), "1 failed"

    monkeypatch.setattr(planted_errors, "ROOT", small_repository)
    monkeypatch.setattr(planted_errors, "run_tests", run_tests)
    entry = (
        "[{}]\nfile = 'nassim/circle.py'\nold = '{}'\nnew = '{}'\nmeans = ''\ntests = ['test_circle.py::test_area']\n"
    )
    (tmp_path / "a.toml").write_text(entry.format("of-old", "5.0", "4.0"))
    (tmp_path / "b.toml").write_text(entry.format("by-tau", "3.0", "6.0") + entry.format("rounded", "3.0", "3"))
    assert main(["--lists", str(tmp_path), "--names", "of-old", "by-tau"]) == 0
    printed = capsys.readouterr().out
    assert "stale, skipped: of-old: its snippet occurs 0 times in nassim/circle.py\n" in printed
    assert "1 errors planted, 1 caught, 0 not\n" in printed
    assert main(["--lists", str(tmp_path), "--names", "rounded"]) == 1


def test_unknown_names_are_refused(capsys):
    with pytest.raises(SystemExit):
        main(["--names", "no-such-error"])
    assert "no such error: no-such-error" in capsys.readouterr().err
