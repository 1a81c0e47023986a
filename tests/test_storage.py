"""Files of nassim's nouns, fingerprints and the cache."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from nassim import FRF, Material, TimeHistory, load, save, storage
from nassim.storage import cache_directory, cached, fingerprint


def record(amplitude=1.0):
    time = np.arange(100) / 1000.0
    return TimeHistory(time, [amplitude * np.sin(time), np.cos(time)], ("u", "lengthening é"), ("V", "µm"))


def frf(coherence=None):
    values = np.arange(12.0).reshape(2, 2, 3) * (1 + 2j)
    return FRF([1.0, 2.0, 3.0], values, ("a", "b"), ("u", "v"), coherence, "a label")


def assert_same(left, right):
    assert type(left) is type(right)
    assert fingerprint(left) == fingerprint(right)


@pytest.mark.parametrize("noun", [record(), frf(), frf(np.full((2, 3), 0.5)), Material("steel", 210e9, 0.3, 7850.0)])
def test_round_trip(noun, tmp_path):
    path = save(noun, tmp_path / "new folder" / "noun.h5")
    assert_same(load(path), noun)
    assert [p.name for p in path.parent.iterdir()] == ["noun.h5"]


@pytest.mark.parametrize("value", [None, True, 3, 2.5, "text", "", ("a", (1, None), ()), {"x": {"y": 1.5}}])
def test_round_trip_of_plain_values(value, tmp_path):
    loaded = load(save(value, tmp_path / "value.h5"))
    assert loaded == value
    assert type(loaded) is type(value)


def test_saving_again_replaces_the_file(tmp_path):
    path = tmp_path / "noun.h5"
    save(record(1.0), path)
    save(record(2.0), path)
    assert_same(load(path), record(2.0))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_truncated_file_is_named(tmp_path, share):
    path = save(record(), tmp_path / "cut.h5")
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(ValueError, match=r"cannot read .*cut\.h5"):
        load(path)


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no such file: .*none\.h5"):
        load(tmp_path / "none.h5")


@pytest.mark.parametrize(
    ("attribute", "value", "message"),
    [
        ("nassim_format", 99, r"noun\.h5: it has format 99, this nassim reads up to 1; upgrade"),
        ("nassim_format", 0, r"noun\.h5: it was not written by nassim\.save"),
        ("type", "os:system", r"noun\.h5: it holds a os\.system, which is not of nassim"),
        ("type", "nassim.storage:load", r"noun\.h5: nassim\.storage\.load is not a noun"),
        ("type", "nassim.signals:Gone", r"cannot read .*noun\.h5: .*Gone"),
    ],
)
def test_files_that_are_not_ours_are_refused(tmp_path, attribute, value, message):
    path = save(record(), tmp_path / "noun.h5")
    with h5py.File(path, "a") as file:
        (file if attribute == "nassim_format" else file["content"]).attrs[attribute] = value
    with pytest.raises(ValueError, match=message):
        load(path)


def test_files_are_checked_like_new_nouns(tmp_path):
    path = save(record(), tmp_path / "noun.h5")
    with h5py.File(path, "a") as file:
        file["content/values"][0, 0] = np.nan
    with pytest.raises(ValueError, match=r"noun\.h5: values holds 1 value.* NaN"):
        load(path)


def test_what_cannot_be_saved_leaves_no_file(tmp_path):
    with pytest.raises(ValueError, match=r"cannot save object \(1\): only nouns of nassim"):
        save(("text", object()), tmp_path / "noun.h5")
    assert list(tmp_path.iterdir()) == []


def test_failure_while_saving_leaves_the_old_file(tmp_path, monkeypatch):
    path = save(record(1.0), tmp_path / "noun.h5")

    def disk_full(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(storage, "_write", disk_full)
    with pytest.raises(OSError, match="no space left"):
        save(record(2.0), path)
    monkeypatch.undo()
    assert [p.name for p in tmp_path.iterdir()] == ["noun.h5"]
    assert_same(load(path), record(1.0))


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("NASSIM_CACHE", str(tmp_path))
    return tmp_path


def test_cache_directory(cache, monkeypatch):
    assert cache_directory() == cache
    monkeypatch.delenv("NASSIM_CACHE")
    assert cache_directory() == Path.home() / ".cache" / "nassim"


class Builder:
    def __init__(self):
        self.calls = 0

    def __call__(self):
        self.calls += 1
        return record(self.calls)


def test_cached_computes_once_and_says_so(cache, capsys):
    build = Builder()
    first = cached("part", fingerprint(1), build)
    assert "part: saved to" in capsys.readouterr().out
    second = cached("part", fingerprint(1), build)
    assert f"part: loaded from {cache}" in capsys.readouterr().out
    assert build.calls == 1
    assert_same(first, second)


def test_another_key_is_computed_anew(cache):
    build = Builder()
    cached("part", fingerprint(1), build)
    cached("part", fingerprint(2), build)
    assert build.calls == 2
    assert len(list(cache.glob("part-*.h5"))) == 2
    assert_same(cached("part", fingerprint(1), build), record(1))


@pytest.mark.usefixtures("cache")
def test_cached_keeps_silent_when_asked(capsys):
    for _ in range(2):
        cached("part", fingerprint(1), Builder(), progress=False)
    assert capsys.readouterr().out == ""


def test_damaged_cache_is_reported_and_rebuilt(cache, capsys):
    build = Builder()
    cached("part", fingerprint(1), build)
    (file,) = cache.iterdir()
    file.write_bytes(file.read_bytes()[:500])
    assert_same(cached("part", fingerprint(1), build), record(2))
    out = capsys.readouterr().out
    assert "damaged and will be rebuilt" in out
    assert file.name in out
    assert_same(load(file), record(2))


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_build_that_stops_leaves_no_file(cache, error):
    def build():
        raise error

    with pytest.raises(error):
        cached("part", fingerprint(1), build)
    assert list(cache.iterdir()) == []


def test_interrupted_saving_leaves_no_file(cache, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(storage.os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        cached("part", fingerprint(1), Builder())
    assert list(cache.iterdir()) == []


def test_fingerprints_differ_wherever_the_inputs_do():
    steel = Material("steel", 210e9, 0.3, 7850.0)
    parts = [
        1, 1.0, "1", b"1", None, True, (1,), [1], (1, 2), ((1,), 2), {"a": 1}, {"b": 1}, {"a": 2},
        np.zeros(2), np.zeros((2, 1)), np.zeros(2, dtype=int), steel, Material("steel", 210e9, 0.3, 7851.0),
        record(), frf(),
    ]  # fmt: skip
    assert len({fingerprint(part) for part in parts}) == len(parts)


def test_fingerprints_do_not_depend_on_order_or_layout():
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})
    values = np.arange(6.0).reshape(2, 3)
    assert fingerprint(values) == fingerprint(np.asfortranarray(values))
    assert fingerprint(record()) == fingerprint(record())


def test_fingerprint_refuses_what_it_cannot_see_through():
    with pytest.raises(ValueError, match="cannot make a fingerprint of function"):
        fingerprint(lambda: 0)
