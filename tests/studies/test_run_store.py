"""The folder of a study: whole runs or none, whatever stopped it, and of one study only."""

import json
import os
import warnings
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import psutil
import pytest

from nassim import TimeHistory
from nassim.studies import run_store as records
from nassim.studies.outcome import Outcome
from nassim.studies.plan import run_key
from nassim.studies.results import flatten_result
from nassim.studies.run_store import open_records

STUDY = {"function": "module.function", "source": "12ab", "inputs": {"body": "34cd"}, "seed": 5}
KEYS = [run_key({"a": a}) for a in range(3)]


def outcome(*values):
    return Outcome("ok", "", "", 0.25, *flatten_result({"x": np.array(values), "y": 1j * values[0]}, ()))


@pytest.fixture
def folder(tmp_path):
    """Two runs of one layout, one that failed, and one of another layout."""
    with open_records(tmp_path / "study", STUDY) as found:
        found.add(KEYS[0], {"a": 0}, outcome(0.1, 0.2))
        found.add(KEYS[1], {"a": 1}, Outcome("failed", "ValueError: no", "Traceback ...", 0.5))
        found.add(KEYS[2], {"a": 2}, outcome(1.0, 2.0, 3.0))
    return tmp_path / "study"


def read(folder):
    with open_records(folder, STUDY) as found:
        return found.runs, {key: found.numbers(key) for key in found.runs if found.runs[key].layout}


def test_runs_are_there_when_the_folder_is_opened_again(folder):
    runs, numbers = read(folder)
    assert [runs[key].status for key in KEYS] == ["ok", "failed", "ok"]
    assert (runs[KEYS[1]].message, runs[KEYS[1]].wall_time) == ("ValueError: no", 0.5)
    np.testing.assert_array_equal(numbers[KEYS[0]]["x"], [0.1, 0.2])
    np.testing.assert_array_equal(numbers[KEYS[2]]["x"], [1.0, 2.0, 3.0])
    assert numbers[KEYS[2]]["y"] == 1j
    lines = [json.loads(line) for line in (folder / "manifest.jsonl").read_text().splitlines()]
    assert [line["parameters"] for line in lines if "run" in line] == [{"a": 0}, {"a": 1}, {"a": 2}]
    assert [line["details"] for line in lines if "details" in line] == ["Traceback ..."]


def test_a_later_line_takes_the_place_of_an_earlier_one(folder):
    with open_records(folder, STUDY) as found:
        found.add(KEYS[1], {"a": 1}, outcome(7.0, 8.0))
    runs, numbers = read(folder)
    assert runs[KEYS[1]].status == "ok"
    np.testing.assert_array_equal(numbers[KEYS[1]]["x"], [7.0, 8.0])


@pytest.mark.parametrize("cut", [1, 30])
def test_a_cut_last_line_is_dropped(folder, cut):
    path = folder / "manifest.jsonl"
    path.write_bytes(path.read_bytes()[:-cut])
    assert list(read(folder)[0]) == KEYS[:2]
    with open_records(folder, STUDY) as found:
        found.add(KEYS[2], {"a": 2}, outcome(5.0, 6.0))
    runs, numbers = read(folder)
    assert list(runs) == KEYS
    np.testing.assert_array_equal(numbers[KEYS[2]]["x"], [5.0, 6.0])


@pytest.mark.parametrize("damage", ["cut", "changed"])
def test_runs_whose_numbers_are_not_whole_do_not_count(folder, damage):
    path = folder / "results.bin"
    data = path.read_bytes()
    path.write_bytes(data[:-1] if damage == "cut" else data[:-1] + bytes([data[-1] ^ 1]))
    assert list(read(folder)[0]) == KEYS[:2]


def test_a_repeated_run_that_is_not_whole_does_not_fall_back_to_what_it_was(folder):
    with open_records(folder, STUDY) as found:
        found.add(KEYS[1], {"a": 1}, outcome(7.0, 8.0))
    path = folder / "results.bin"
    path.write_bytes(path.read_bytes()[:-1])
    assert sorted(read(folder)[0]) == sorted([KEYS[0], KEYS[2]])


@pytest.mark.parametrize(
    "line", ["no line", "[]", "{}", "5", '{"run": "a"', '{"run": "a", "of_layout": "none", "offset": 0}']
)
def test_a_damaged_line_is_named(folder, line):
    path = folder / "manifest.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join([*lines[:2], f"{line}\n", *lines[2:]]))
    with pytest.raises(ValueError, match=r"line 3 of .*manifest\.jsonl is damaged .*; remove that line"):
        read(folder)
    path.write_text("".join(lines))
    assert list(read(folder)[0]) == KEYS


def test_axes_are_whole_when_the_folder_is_opened_again(tmp_path):
    record = TimeHistory([0.0, 0.1], [[1.0, 2.0], [3.0, 4.0]], ("u", "y"), ("V", "m"))
    layout, data = flatten_result({"record": record, "x": 1j}, ())
    for number in (1, 2):
        with open_records(tmp_path, STUDY) as found:
            found.add(f"{number}" * 32, {"a": number}, Outcome("ok", "", "", 0.25, layout, data))
    with open_records(tmp_path, STUDY) as found:
        assert list(found.layouts.values()) == [layout]
    lines = [json.loads(line) for line in (tmp_path / "manifest.jsonl").read_text().splitlines()]
    assert ["layout" in line for line in lines] == [True, False, False], "a layout is written once"


BOTH = ["results.bin", "manifest.jsonl"]


def test_numbers_reach_the_disk_before_the_lines_that_tell_of_them(tmp_path, monkeypatch):
    """At the latest when the study ends, and every second before."""
    forced = []

    def fsync(number):
        forced.extend(n for n in BOTH if os.path.samestat((tmp_path / n).stat(), os.fstat(number)))

    monkeypatch.setattr(records.os, "fsync", fsync)
    with open_records(tmp_path, STUDY) as found:
        found.add(KEYS[0], {"a": 0}, outcome(0.1, 0.2))
        assert (tmp_path / "results.bin").stat().st_size == 2 * 8 + 16
        assert len((tmp_path / "manifest.jsonl").read_text().splitlines()) == 2, "who is killed now loses no run"
    assert forced == BOTH
    monkeypatch.setattr(records, "FLUSH_INTERVAL", -1.0)
    with open_records(tmp_path, STUDY) as found:
        found.add(KEYS[1], {"a": 1}, outcome(0.1, 0.2))
        assert forced == BOTH * 2
        found.add(KEYS[0], {"a": 0}, outcome(0.3, 0.4))
        assert forced == BOTH * 3


def test_numbers_without_a_line_do_no_harm(folder):
    with (folder / "results.bin").open("ab") as file:
        file.write(b"half a run")
    with open_records(folder, STUDY) as found:
        found.add(KEYS[1], {"a": 1}, outcome(7.0, 8.0))
    np.testing.assert_array_equal(read(folder)[1][KEYS[1]]["x"], [7.0, 8.0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"function": "module.other"}, "its function is module.function, not module.other"),
        ({"source": "ffff"}, "the function's source has changed"),
        ({"seed": None}, "its seed is 5, not None"),
        ({"inputs": {"body": "ffff"}}, "'body', which the function carries, has changed"),
        ({"inputs": {"body": "34cd", "gain": "1"}}, "'gain', which the function carries, is new"),
        ({"inputs": {}}, "'body', which the function carries, is gone"),
    ],
)
def test_a_folder_of_another_study_is_refused_with_what_differs(folder, change, message):
    with (
        pytest.raises(ValueError, match=f"holds another study: .*{message}.*folder of its own"),
        open_records(folder, {**STUDY, **change}),
    ):
        pass
    assert list(read(folder)[0]) == KEYS


def test_a_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with (
        pytest.raises(ValueError, match=r"not the folder of a study: it holds thesis\.tex"),
        open_records(tmp_path, STUDY),
    ):
        pass
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "nassim-elsewhere-12-ab.tmp").write_text("")  # of a study that was killed at its start
    with open_records(tmp_path / "study", STUDY) as found:
        assert not found.runs
    (tmp_path / "study" / "study.json").write_text("{}")
    with pytest.raises(ValueError, match="is damaged"), open_records(tmp_path / "study", STUDY):
        pass


def test_a_folder_of_another_format_is_refused(folder):
    path = folder / "study.json"
    path.write_text(path.read_text().replace('"format": 1', '"format": 7'))
    with pytest.raises(ValueError, match="its format is 7, this nassim writes 1"):
        read(folder)


def test_another_version_of_nassim_is_told(folder, monkeypatch):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with open_records(folder, STUDY):
            pass
    monkeypatch.setattr(records, "code_fingerprint", lambda: "another")
    with pytest.warns(UserWarning, match="another version of nassim"), open_records(folder, STUDY):
        pass


def test_folders_of_earlier_versions_know_no_classes(folder):
    with open_records(folder, {**STUDY, "inputs": {"body": "34cd", "class Machine": "1"}}) as found:
        assert list(found.runs) == KEYS


def test_one_study_at_a_time(folder):
    with open_records(folder, STUDY):
        assert (folder / "in_use.json").stat().st_mode & 0o444 == 0o444  # others who share the folder look at it
        with pytest.raises(ValueError, match="in use by process"), open_records(folder, STUDY):
            pass
    assert not (folder / "in_use.json").exists()


@pytest.mark.parametrize(
    ("holder", "free"),
    [
        ({"process": 1, "begun": -1.0}, True),  # a number that another process has by now
        ({"process": 2**22 + 5, "begun": 1.0}, True),
        ({"process": 1, "begun": psutil.Process(1).create_time()}, False),
        ({"host": "elsewhere", "process": 1, "begun": -1.0}, False),
    ],
)
def test_whoever_was_killed_holds_a_folder_no_longer(folder, holder, free):
    (folder / "in_use.json").write_text(json.dumps({"host": records.platform.node(), **holder}))
    if free:
        assert list(read(folder)[0]) == KEYS
    else:
        with pytest.raises(ValueError, match=r"in use by process .* remove .*in_use\.json"):
            read(folder)


def test_of_two_studies_that_begin_at_once_one_is_refused(folder, monkeypatch):
    """The other one's mark is there again as soon as it is taken away, and nobody has signed it yet."""
    (folder / "in_use.json").write_text("")
    monkeypatch.setattr(records.Path, "rename", lambda path, aside: None)
    with (
        pytest.raises(ValueError, match=r"another study begins in .*study at this moment"),
        open_records(folder, STUDY),
    ):
        pass


def test_a_lock_that_was_taken_over_meanwhile_is_left(folder, monkeypatch):
    lock, holder = folder / "in_use.json", records._holder
    lock.write_text("")

    def late(path):
        """Read a stale lock, which another study takes over before it is removed."""
        monkeypatch.setattr(records, "_holder", holder)
        with path.open("w") as file:
            me = psutil.Process()
            json.dump({"host": records.platform.node(), "process": me.pid, "begun": me.create_time()}, file)

    monkeypatch.setattr(records, "_holder", late)
    with pytest.raises(ValueError, match="in use by process"):
        read(folder)
    assert holder(lock)["process"] == psutil.Process().pid


def test_of_two_studies_at_once_one_has_the_folder(tmp_path):
    def take(number):
        start.wait()
        try:
            with records._locked(tmp_path / f"lock {number}"):
                inside.append(number)
                start.wait()
        except ValueError:
            start.wait()

    inside, start, rounds = [], Barrier(2), range(100)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(take, np.repeat(rounds, 2)))
    assert inside == list(rounds)


def test_folders_are_locked_without_hard_links(folder, monkeypatch):
    monkeypatch.setattr(records.os, "link", lambda *_: os.stat(folder / "nothing"))
    test_one_study_at_a_time(folder)
