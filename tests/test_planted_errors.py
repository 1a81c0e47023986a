"""The list of planted errors is whole and fits the code, and the tool tells what is caught from what survives."""

from collections import Counter
from dataclasses import replace

import pytest
from planted_errors import LIST, ROOT, PlantedError, check_tests, copies, main, missing_tests, read_errors, try_error

ERRORS = read_errors()
WITHOUT_PHYSICS = {"__init__", "progress"}
"""Modules in which nobody need plant an error."""


def test_every_patch_applies_once():
    texts = {file: (ROOT / file).read_text(encoding="utf-8") for file in {error.file for error in ERRORS}}
    assert [error.name for error in ERRORS if texts[error.file].count(error.old) != 1] == []


def test_every_named_test_exists():
    assert missing_tests(ERRORS) == []


def test_the_list_covers_the_library():
    assert len(ERRORS) >= 100
    planted = {error.file for error in ERRORS}
    modules = [path for path in (ROOT / "nassim").rglob("*.py") if path.stem not in WITHOUT_PHYSICS]
    assert sorted({path.relative_to(ROOT).as_posix() for path in modules} - planted) == []
    assert {"models/bench.py", "models/apa300ml/__init__.py"} <= planted


def test_no_error_is_planted_twice():
    patches = Counter((error.file, error.old, error.new) for error in ERRORS)
    assert [patch for patch, count in patches.items() if count > 1] == []


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


HALF = PlantedError(
    "half", "nassim/circle.py", "3.0 * r * r", "1.5 * r * r", "half an area", ("test_circle.py::test_area",)
)


@pytest.mark.parametrize(
    ("change", "caught", "text"),
    [
        ({}, True, "caught"),
        ({"new": "r * r * 3.0"}, False, "SURVIVES"),
        ({"tests": ("test_circle.py::test_skipped",)}, False, "SURVIVES"),
        ({"new": "3.0 * r *"}, False, "do not run"),
        ({"old": "4.0 * r * r"}, False, "occurs 0 times"),
        ({"old": "r"}, False, "occurs 6 times"),
        ({"file": "nassim/square.py"}, False, "occurs 0 times"),
    ],
    ids=str,
)
def test_fates_of_an_error(small_repository, change, caught, text):
    with copies(small_repository, 1) as (place,):
        outcome = try_error(place, replace(HALF, **change))
        assert (place / "nassim" / "circle.py").read_text() == (small_repository / "nassim" / "circle.py").read_text()
    assert outcome.caught == caught
    assert text in outcome.text


@pytest.mark.parametrize(
    ("test", "problem"),
    [
        ("test_circle.py::test_area", ""),
        ("test_circle.py::test_volume", "do not exist: test_circle.py::test_volume"),
        ("test_ball.py::test_area", "do not exist: test_ball.py::test_area"),
        ("test_circle.py::test_broken", "fail without any planted error"),
    ],
)
def test_tests_are_tried_before_anything_is_planted(small_repository, test, problem):
    with copies(small_repository, 1) as (place,):
        found = check_tests(place, [replace(HALF, tests=(test,))])
    assert (problem in found) if problem else not found


@pytest.mark.parametrize(
    "table",
    [
        "[a]\nfile = 'f'\nold = 'x'\nnew = 'y'\nmeans = ''\ntests = []\n",
        "[a]\nfile = 'f'\nold = 'x'\nnew = 'x'\nmeans = ''\ntests = ['t']\n",
        "[a]\nfile = 'f'\nold = 'x'\nmeans = ''\ntests = ['t']\n",
    ],
)
def test_incomplete_tables_are_refused(table, tmp_path):
    path = tmp_path / "list.toml"
    path.write_text(table)
    with pytest.raises(ValueError, match=r"list\.toml, \[a\]: "):
        read_errors(path)


def test_errors_that_need_a_missing_program_are_left_out(small_repository, tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("CI", raising=False)
    body = "file = 'nassim/circle.py'\nold = '3.0'\nnew = '4.0'\nmeans = ''\ntests = ['test_circle.py::test_area']\n"
    path = tmp_path / "list.toml"
    path.write_text(f"[a]\n{body}needs = ['no-such-program']\n[b]\n{body}needs = ['python3']\n")
    never, here = read_errors(path)
    assert (never.can_be_tried, here.can_be_tried) == (False, True)
    assert main(["--list", str(path), "--names", "a"]) == 0
    assert "1 left out, whose tests need programs that are not here: a\n0 errors planted" in capsys.readouterr().out
    monkeypatch.setenv("CI", "true")
    assert not here.can_be_tried


def test_unknown_names_are_refused(capsys):
    with pytest.raises(SystemExit):
        main(["--names", "no-such-error", "--list", str(LIST)])
    assert "no such error: no-such-error" in capsys.readouterr().err
