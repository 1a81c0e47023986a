"""The lists of planted errors can be read, and the tool tells what is caught from what survives and what is stale."""

from dataclasses import replace

import planted_errors
import pytest
from planted_errors import PlantedError, copies, main, read_errors, try_error, try_errors


def test_all_lists_can_be_read():
    assert read_errors()


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


def test_tests_that_fail_anyway_are_refused(small_repository):
    with pytest.raises(ValueError, match="fail without any planted error"):
        try_errors([replace(HALF, tests=("test_circle.py::test_broken",))], root=small_repository)


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


def test_what_cannot_be_tried_is_reported_and_skipped(small_repository, tmp_path, monkeypatch, capsys):
    """Stale entries, and errors whose tests need programs that are missing here or in CI."""
    monkeypatch.delenv("CI", raising=False)
    monkeypatch.setattr(planted_errors, "ROOT", small_repository)
    lists = tmp_path / "lists"
    lists.mkdir()
    body = "file = 'nassim/circle.py'\nold = '3.0'\nnew = '4.0'\nmeans = ''\ntests = ['test_circle.py::test_area']\n"
    (lists / "a.toml").write_text(f"[a]\n{body}needs = ['no-such-program']\n[b]\n{body}needs = ['python3']\n")
    (lists / "c.toml").write_text(f"[c]\n{body.replace('3.0', '5.0')}")
    never, here, stale = read_errors(lists)
    assert (never.can_be_tried, here.can_be_tried, stale.can_be_tried) == (False, True, True)
    assert main(["--lists", str(lists), "--names", "a", "c"]) == 0
    printed = capsys.readouterr().out
    assert "1 left out, whose tests need programs that are not here: a\n" in printed
    assert "stale, skipped: c: its snippet occurs 0 times in nassim/circle.py\n0 errors planted" in printed
    monkeypatch.setenv("CI", "true")
    assert not here.can_be_tried


def test_unknown_names_are_refused(capsys):
    with pytest.raises(SystemExit):
        main(["--names", "no-such-error"])
    assert "no such error: no-such-error" in capsys.readouterr().err
