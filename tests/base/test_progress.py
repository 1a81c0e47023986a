"""Progress: a line per stage where there is no terminal, nothing when switched off."""

import pytest

from nassim.base.progress import stage


def test_a_stage_prints_its_name_and_time(capsys):
    with stage("factorise") as advance:
        advance()
    assert capsys.readouterr().out.split() == ["factorise", "0.0", "s"]


def test_a_stage_that_is_switched_off_prints_nothing(capsys):
    with stage("factorise", total=3, unit="solves", enabled=False) as advance:
        advance(3)
    assert capsys.readouterr().out == ""


def test_an_interrupted_stage_says_so(capsys):
    with pytest.raises(KeyboardInterrupt), stage("simulate", unit="steps", total=9):
        raise KeyboardInterrupt
    assert "stopped" in capsys.readouterr().out


def test_on_a_terminal_a_bar_moves(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with stage("simulate", total=4, unit="steps") as advance:
        advance(4)
    assert "4/4 steps" in capsys.readouterr().err
