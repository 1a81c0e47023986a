"""Progress: a line per stage where there is no terminal, nothing when switched off."""

import pytest

from nassim.base import progress
from nassim.base.progress import stage, tell, track_stages
from nassim.base.time_left import show_time_left


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


def test_notes_fit_a_hundred_columns(capsys):
    tell("paths: " + "word " * 40 + "/a/very-long/" + 90 * "x")
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert all(len(line) <= 100 for line in lines[:-1])
    assert lines[1].startswith("      word")
    assert "/a/very-long/" + 90 * "x" in lines[-1]


@pytest.fixture
def clock(monkeypatch):
    """A clock that only `clock.pass_by(seconds)` moves."""
    now = [1000.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])

    class Clock:
        def pass_by(self, seconds):
            now[0] += seconds

    return Clock()


def test_a_long_stage_shows_its_tenths_in_a_file(clock, capsys):
    """At most one sign in ten seconds: 25 of 200 units each 4 s; a quick stage shows none."""
    for seconds in (4.0, 0.1):
        with stage("study", total=200, unit="runs") as advance:
            for _ in range(8):
                clock.pass_by(seconds)
                advance(25)
    slow, quick = capsys.readouterr().out.splitlines()
    assert slow.split() == ["study", "30", "%", "70", "%", "32.0", "s"]
    assert quick.split() == ["study", "0.8", "s"]


def test_a_stage_that_ends_does_not_tell_its_last_tenth(clock, capsys):
    with stage("study", total=10, unit="runs") as advance:
        for _ in range(10):
            clock.pass_by(20.0)
            advance(1)
    told = capsys.readouterr().out
    assert " 90 %" in told
    assert "100 %" not in told


def test_a_stage_tells_a_tenth_at_most_every_ten_seconds(clock, capsys):
    for seconds in (9.0, 11.0):
        with stage("study", total=2, unit="runs") as advance:
            clock.pass_by(seconds)
            advance()
        assert ("50 %" in capsys.readouterr().out) == (seconds > 10)


def test_the_pace_is_that_of_the_first_tenth_or_more(clock):
    """A stage that took 9 or 11 of 100 s takes twice as long."""
    for reached, left in ((9.0, 91.0), (11.0, 178.0)):
        with track_stages((("read", reached), ("all", 100.0))) as current:
            clock.pass_by(2 * reached)
            current.end("read")
            assert current.left() == pytest.approx(left)


EARLIER = (("mesh", 2.0), ("solve", 4.0), ("solve", 6.0), ("all", 10.0))


def test_a_run_tells_what_is_left_at_its_own_pace(clock, capsys):
    """Twice as slow as the last one: at 2 of 10 s, 16 s are left; a stage that the last run did not have moves none."""
    with track_stages(EARLIER) as current:
        assert current.left() == 10.0
        for label, seconds in (("mesh", 4.0), ("read", 0.0), ("solve", 4.0)):
            with stage(label):
                clock.pass_by(seconds)
        assert current.left() == pytest.approx(12.0)
        clock.pass_by(2.0)
        assert current.left() == pytest.approx(10.0)
        clock.pass_by(100.0)
        assert current.left() == 0.0
    assert [line.split("   ")[-1].strip() for line in capsys.readouterr().out.splitlines()] == [
        "16 s left",
        "16 s left",
        "12 s left",
    ]


def test_stages_of_one_name_are_told_apart(clock):
    """At the end of the second of two: 4 s of 10 are left, at a pace of one."""
    with track_stages(EARLIER) as current:
        for label, seconds in (("mesh", 2.0), ("solve", 2.0), ("solve", 2.0)):
            clock.pass_by(seconds)
            current.end(label)
        assert current.left() == pytest.approx(4.0)
        current.end("solve")
        assert current.left() == pytest.approx(4.0), "a third one was not there"


def test_a_short_first_stage_says_nothing_about_the_pace(clock):
    """Ten times as long as it was, yet only 1 of 100 s: the others take what they took."""
    with track_stages((("read", 1.0), ("solve", 100.0), ("all", 100.0))) as current:
        clock.pass_by(10.0)
        current.end("read")
        assert current.left() == pytest.approx(99.0)


def test_before_the_first_stage_ends_time_passes(clock):
    with track_stages(EARLIER) as current:
        clock.pass_by(3.0)
        assert current.left() == pytest.approx(7.0)
        clock.pass_by(30.0)
        assert current.left() == 0.0


def test_after_a_run_nothing_is_left(clock, capsys):
    with track_stages(EARLIER):
        clock.pass_by(3.0)
    with stage("another"):
        clock.pass_by(1.0)
    assert "left" not in capsys.readouterr().out


def test_a_count_without_an_end_is_a_counter(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with stage("simulate", unit="steps") as advance:
        advance(4)
        advance()
    assert "5 steps" in (told := capsys.readouterr().err)
    assert "%" not in told


def test_times_left_are_in_seconds_or_minutes(clock, capsys):
    for whole in (99.0, 110.0):
        with track_stages((("first", 1.0), ("all", whole + 1.0))), stage("first"):
            clock.pass_by(1.0)
    first, second = capsys.readouterr().out.splitlines()
    assert first.endswith("1.0 s   99 s left")
    assert second.endswith("1.0 s   2 min left")


def test_the_same_run_knows_its_time_the_second_time(tmp_path, monkeypatch, clock, capsys):
    monkeypatch.setenv("NASSIM_CACHE", str(tmp_path))
    for name, settings in (("bench", [5.0]), ("bench", [5.0]), ("bench", [3.0]), ("hexapod", [5.0])):
        with show_time_left(name, settings):
            clock.pass_by(1.0)
            with stage("simulate"):
                clock.pass_by(200.0)
            clock.pass_by(300.0)
    lines = capsys.readouterr().out.splitlines()
    assert ["left" in line for line in lines] == [False, True, False, False]
    assert lines[1].endswith("5 min left")


def test_a_run_that_stops_forgets_nothing(tmp_path, monkeypatch, clock, capsys):
    monkeypatch.setenv("NASSIM_CACHE", str(tmp_path))
    with show_time_left("bench"), stage("simulate"):
        clock.pass_by(20.0)
    (kept,) = (tmp_path / "runs").iterdir()
    before = kept.read_text()
    with pytest.raises(KeyboardInterrupt), show_time_left("bench"):
        raise KeyboardInterrupt
    assert kept.read_text() == before
    kept.write_text("damaged")
    with show_time_left("bench"), stage("simulate"):
        clock.pass_by(20.0)
    assert "left" not in capsys.readouterr().out
    assert kept.read_text() == before


def test_a_cache_that_cannot_be_written_stops_no_run(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("NASSIM_CACHE", str(tmp_path / "file"))
    with show_time_left("bench"), stage("simulate"):
        pass


def test_on_a_terminal_the_time_left_stands_in_the_bar(monkeypatch, clock, capsys):
    monkeypatch.setenv("COLUMNS", "120")  # processes of tests may be told of narrow terminals
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with track_stages((("simulate", 40.0), ("all", 50.0))), stage("simulate", total=4, unit="steps") as advance:
        advance(4)
    assert "50 s left" in capsys.readouterr().err
