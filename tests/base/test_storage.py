"""Files of nassim's data classes, fingerprints and the cache."""

import hashlib
import os
import platform
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

import h5py
import numpy as np
import pytest

from nassim import FRF, Material, TimeHistory, load, save
from nassim.base import file_registry, storage
from nassim.base.storage import cache_directory, fingerprint, load_or_compute


def record(amplitude=1.0):
    time = np.arange(100) / 1000.0
    return TimeHistory(time, [amplitude * np.sin(time), np.cos(time)], ("u", "lengthening é"), ("V", "µm"))


def frf(coherence=None):
    values = np.arange(12.0).reshape(2, 2, 3) * (1 + 2j)
    return FRF([1.0, 2.0, 3.0], values, ("a", "b"), ("u", "v"), coherence, "a label")


def assert_same(left, right):
    assert type(left) is type(right)
    assert fingerprint(left) == fingerprint(right)


@pytest.mark.parametrize("value", [record(), frf(), frf(np.full((2, 3), 0.5)), Material("steel", 210e9, 0.3, 7850.0)])
def test_round_trip(value, tmp_path):
    path = save(value, tmp_path / "new folder" / "data.h5")
    assert_same(load(path), value)
    assert [p.name for p in path.parent.iterdir()] == ["data.h5"]


MAPPING = {"x": {"z": 1.5, "y": 2.5, "w": 1.0}}


@pytest.mark.parametrize("value", [None, True, 3, 2.5, "text", "", ("a", (1, None), ()), MAPPING])
def test_round_trip_of_plain_values(value, tmp_path):
    loaded = load(save(value, tmp_path / "value.h5"))
    assert loaded == value
    assert type(loaded) is type(value)
    assert repr(loaded) == repr(value), "in the same order"


def test_a_file_is_loaded_as_the_class_that_is_asked_for(tmp_path):
    path = save(record(), tmp_path / "record.h5")
    assert_same(load(path, as_=TimeHistory), record())
    with pytest.raises(ValueError, match=r"record\.h5 holds a TimeHistory, not a FRF; load it with as_=TimeHistory"):
        load(path, as_=FRF)


def test_saving_again_replaces_the_file(tmp_path):
    path = tmp_path / "data.h5"
    save(record(1.0), path)
    save(record(2.0), path)
    assert_same(load(path), record(2.0))


def test_a_cache_without_progress_prints_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("NASSIM_CACHE", str(tmp_path))
    for progress in (False, False, True):
        assert not capsys.readouterr().out
        load_or_compute("record", "0" * 16, record, progress=progress)
    assert capsys.readouterr().out.startswith("record: loaded from")


@pytest.mark.skipif(os.name != "posix", reason="other systems have no such modes")
def test_all_may_read_a_file_that_one_wrote(tmp_path):
    assert save(record(), tmp_path / "data.h5").stat().st_mode & 0o777 == 0o644


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_truncated_file_is_named(tmp_path, share):
    path = save(record(), tmp_path / "cut.h5")
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(ValueError, match=r"cannot read .*cut\.h5"):
        load(path)


def test_every_flipped_bit_is_noticed(tmp_path):
    path = save(record(), tmp_path / "data.h5")
    content = path.read_bytes()
    for place in np.random.default_rng(0).choice(8 * len(content), 300, replace=False):
        changed = bytearray(content)
        changed[place // 8] ^= 1 << (place % 8)
        path.write_bytes(changed)
        with pytest.raises(ValueError, match=r"cannot read .*data\.h5: it .*damaged"):
            load(path)
    path.write_bytes(content)
    assert_same(load(path), record())


def test_threads_save_at_once(tmp_path):
    with ThreadPoolExecutor(4) as pool:
        paths = list(pool.map(lambda k: save(record(k), tmp_path / f"{k}.h5"), range(40)))
    for k, path in enumerate(paths):
        assert_same(load(path), record(k))


def test_the_checksum_is_that_of_the_hdf5_image(tmp_path):
    content = save(record(), tmp_path / "data.h5").read_bytes()
    assert hashlib.sha256(content[512:]).hexdigest().encode() in content[:512]
    assert content[512:].startswith(b"\x89HDF")
    with h5py.File(tmp_path / "data.h5") as file:
        np.testing.assert_array_equal(file["content/values"][:], record().values)


def test_a_seal_taken_away_is_noticed(tmp_path):
    """Files have one since format 2."""
    path = tmp_path / "data.h5"
    for content in (
        save(record(), tmp_path / "new.h5").read_bytes(),
        (Path(__file__).parents[1] / "data" / "record_format_2.h5").read_bytes(),
    ):
        path.write_bytes(content[512:])
        with pytest.raises(ValueError, match=r"data\.h5: its checksum is missing"):
            load(path)


def test_only_files_are_loaded(tmp_path):
    with pytest.raises(ValueError, match="it is not a file"):
        load(tmp_path)
    (tmp_path / "text.h5").write_text("no HDF5 at all")
    with pytest.raises(ValueError, match=r"text\.h5: it was not written by nassim\.save"):
        load(tmp_path / "text.h5")


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no such file: .*none\.h5"):
        load(tmp_path / "none.h5")


def sealed_anew(path):
    image = path.read_bytes()[512:]
    path.write_bytes(storage._seal(hashlib.sha256(image)) + image)


@pytest.mark.parametrize(
    ("attribute", "value", "message"),
    [
        ("nassim_format", 99, r"data\.h5: it has format 99, this nassim reads up to 4; upgrade"),
        ("nassim_format", 0, r"data\.h5: it was not written by nassim\.save"),
        ("nassim_format", -1, r"data\.h5: it was not written by nassim\.save"),
        ("kind", "set", r"data\.h5: /content is of the kind 'set', which this nassim does not know; upgrade"),
        ("type", "Gone", r"data\.h5: it holds a 'Gone', .* upgrade nassim, or, .* nassim\.register before loading"),
        ("type", 3, r"cannot read .*data\.h5"),
        ("type", ["TimeHistory"] * 2, r"data\.h5: its attribute 'type' is not a single value"),
        ("type", "FRF", r"data\.h5: FRF\.__init__\(\) got an unexpected keyword argument"),
    ],
)
def test_files_that_are_not_ours_are_refused(tmp_path, attribute, value, message):
    path = save(record(), tmp_path / "data.h5")
    with h5py.File(path, "a") as file:
        (file if attribute == "nassim_format" else file["content"]).attrs[attribute] = value
    sealed_anew(path)
    with pytest.raises(ValueError, match=message):
        load(path)


def test_loaded_fields_are_checked_like_new_ones(tmp_path):
    path = save(record(), tmp_path / "data.h5")
    with h5py.File(path, "a") as file:
        file["content/values"][0, 0] = np.nan
    sealed_anew(path)
    with pytest.raises(ValueError, match=r"data\.h5: values holds 1 value.* NaN"):
        load(path)


FORGED = (
    "os:system",
    "nassim.storage:load",
    "nassim.fem:build_fe_model",
    "nassim.fem:FEModel",
    "antigravity:FRF",
    "load",
)


@pytest.mark.parametrize("version", [1, 2, 3])
@pytest.mark.parametrize("forged", FORGED)
@pytest.mark.parametrize("place", ["content", "content/0"])
def test_a_file_cannot_load_an_unregistered_class(tmp_path, monkeypatch, version, forged, place):
    monkeypatch.setattr(
        file_registry.importlib, "import_module", lambda name: pytest.fail(f"the file made nassim import {name}")
    )
    path = save(((),), tmp_path / "data.h5")
    with h5py.File(path, "a") as file:
        file.attrs["nassim_format"] = version
        file[place].attrs["kind"], file[place].attrs["type"] = "dataclass", forged
    sealed_anew(path)
    with pytest.raises(
        ValueError, match=r"cannot read .*data\.h5: it holds a '.*', a data class that this nassim does not know"
    ):
        load(path)


def test_wrong_fields_are_refused_with_the_name_of_the_file(tmp_path):
    """`load` names the file in its error, whatever error a constructor raises for wrong fields."""
    for name in file_registry.DATA_CLASSES:
        data_class = file_registry.find(name)
        for wrong in ({"a": ()}, np.zeros((2, 0))):
            path = tmp_path / "data.h5"
            with h5py.File(path, "w") as file:
                file.attrs["nassim_format"] = 1
                group = file.create_group("content")
                for item in fields(data_class):
                    if item.init:
                        storage._write(group, item.name, wrong)
                group.attrs["kind"], group.attrs["type"] = "dataclass", f"nassim.moved.away:{name}"
            with suppress(ValueError):
                assert type(load(path)) is data_class


def external_storage(group, folder):
    (folder / "secret").write_bytes(np.arange(6.0).tobytes())
    group.create_dataset("values", shape=(2, 3), dtype=float, external=[(str(folder / "secret"), 0, 48)])


def external_link(group, folder):
    with h5py.File(folder / "secret.h5", "w") as other:
        other["values"] = np.zeros((2, 3))
    group["values"] = h5py.ExternalLink(str(folder / "secret.h5"), "/values")


def soft_link(group, _folder):
    group.file["elsewhere"] = np.zeros((2, 3))
    group["values"] = h5py.SoftLink("/elsewhere")


def virtual(group, folder):
    with h5py.File(folder / "secret.h5", "w") as other:
        other["values"] = np.zeros((2, 3))
    layout = h5py.VirtualLayout((2, 3), dtype=float)
    layout[:] = h5py.VirtualSource(str(folder / "secret.h5"), "values", shape=(2, 3))
    group.create_virtual_dataset("values", layout)


def other_dataset(**options):
    return lambda group, _folder: group.create_dataset("values", **options)


def compact_and_huge(group, _folder):
    plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plan.set_layout(h5py.h5d.COMPACT)
    group.create_dataset("values", data=np.zeros((2, 3)), dcpl=plan)


def cycle(group, _folder):
    group["values"] = group


def same_twice(group, _folder):
    group["values"] = group["time"]


def named_type(group, _folder):
    group["values"] = np.dtype("f8")


def deep(group, _folder):
    for _ in range(500):
        group.attrs["kind"] = "tuple"
        group = group.create_group("0")
    group.attrs["kind"] = "none"


def crafted(folder, build):
    """A file as nassim 0.1 wrote a TimeHistory, without a checksum, but for its values."""
    path = folder / "crafted.h5"
    with h5py.File(path, "w") as file:
        file.attrs["nassim_format"] = 1
        group = file.create_group("content")
        group.attrs["kind"], group.attrs["type"] = "dataclass", "nassim.signals:TimeHistory"
        group["time"] = np.arange(3.0)
        for name, texts in (("names", ["a", "b"]), ("units", ["V", "m"])):
            group.create_dataset(name, data=texts, dtype=h5py.string_dtype())
        build(group, folder)
    return path


ELSEWHERE, OTHERWISE = "'values' is missing or a link to elsewhere", "values is stored in a way that nassim"


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (external_storage, OTHERWISE),
        (external_link, ELSEWHERE),
        (soft_link, ELSEWHERE),
        (virtual, OTHERWISE),
        (other_dataset(shape=(2, 2**35), dtype=float), r"values has shape \(2, 34359738368\), which is not the length"),
        (other_dataset(shape=(2, 2**35), dtype=float, chunks=(1, 2**10), fillvalue=1.0), OTHERWISE),
        (other_dataset(data=np.zeros((2, 3)), compression="gzip"), OTHERWISE),
        (other_dataset(data=np.zeros(3, dtype=[("a", "f8"), ("b", "f8")])), OTHERWISE),
        (other_dataset(data=np.array([b"fixed", b"width"])), OTHERWISE),
        (other_dataset(data=np.array([["a"]], dtype=object), dtype=h5py.string_dtype()), "values is a table of texts"),
        (other_dataset(shape=(2**40,), dtype=h5py.string_dtype()), "which is not the length of its data"),
        (cycle, "'values' is in it twice"),
        (same_twice, "'values' is in it twice"),
        (named_type, "attribute: .kind"),
        (deep, "recursion"),
        (lambda *_: None, "missing .* argument: 'values'"),
    ],
)
def test_crafted_files_are_refused(tmp_path, build, message):
    with pytest.raises(ValueError, match=rf"cannot read .*crafted\.h5: .*{message}"):
        load(crafted(tmp_path, build))


@pytest.mark.parametrize("build", [other_dataset(data=np.ones((2, 3))), compact_and_huge])
def test_the_crafted_file_is_refused_for_its_fault_only(tmp_path, build):
    assert load(crafted(tmp_path, build)).values.shape == (2, 3)


def test_many_texts_in_one_place_are_refused(tmp_path):
    """500 names that all point to the same text of 10 kB: 5 MB from a file of 30 kB."""
    path = crafted(tmp_path, other_dataset(data=["x" * 10000] + [""] * 499, dtype=h5py.string_dtype()))
    with h5py.File(path) as file:
        start = file["content/values"].id.get_offset()
    content = bytearray(path.read_bytes())
    content[start : start + 500 * 16] = content[start : start + 16] * 500
    path.write_bytes(content)
    with h5py.File(path) as file:
        assert len(file["content/values"].asstr()[499]) == 10000
    with pytest.raises(ValueError, match="it claims to hold more data than it has bytes"):
        load(path)


LIMITED = """
import resource, sys
import numpy as np
from nassim import TimeHistory, save
from nassim.signals.files import write_record
time = np.arange(100000) / 1e3
history = TimeHistory(time, [np.sin(time)], ("u",), ("V",))
resource.setrlimit(resource.RLIMIT_FSIZE, (100000, 100000))
for write, name in ((save, "record.h5"), (write_record, "record.csv")):
    try:
        write(history, f"{sys.argv[1]}/{name}")
    except OSError as error:
        print(error)
"""


def test_a_full_disk_is_an_error_that_leaves_no_file(tmp_path):
    pytest.importorskip("resource")
    run = subprocess.run([sys.executable, "-c", LIMITED, tmp_path], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    first, second = run.stdout.splitlines()
    assert re.search(r"cannot be written: .*record\.h5'", first)
    assert re.search(r"cannot be written: .*record\.csv'", second)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_is_named(tmp_path):
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(OSError, match=r"cannot be written: .*taken/data\.h5'"):
        save(record(), tmp_path / "taken" / "data.h5")


HANGING = """
import sys, time
from nassim.base.storage import write_atomically
with write_atomically(sys.argv[1]) as temporary:
    temporary.write_bytes(bytes(1000))
    print(temporary.name, flush=True)
    time.sleep(60)
"""


def test_what_killed_processes_leave_is_removed_by_the_next_write(tmp_path):
    command = [sys.executable, "-c", HANGING, tmp_path / "first.h5"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            left = tmp_path / process.stdout.readline().strip()
            save(record(), tmp_path / "second.h5")
            assert left.exists(), "another process is still writing this"
        finally:
            process.kill()
    host = re.sub(r"\W", "_", platform.node())
    elsewhere = tmp_path / left.name.replace(host, "another_computer", 1)
    elsewhere.write_bytes(b"")
    deep = tmp_path / "new" / "folders"
    save(record(), deep / "fourth.h5")
    assert [p.name for p in deep.iterdir()] == ["fourth.h5"]
    with storage.write_atomically(tmp_path / "third.h5") as ours:
        save(record(), tmp_path / "second.h5")
        assert ours.exists(), "this process is still writing this"
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([elsewhere.name, "new", "second.h5", "third.h5"])


@pytest.mark.parametrize("item", [object(), 2**70, np.array(["a", "bb"]), np.zeros(2, [("x", float)])])
def test_what_cannot_be_saved_leaves_no_file(item, tmp_path):
    with pytest.raises(ValueError, match=r"cannot save (object|int|ndarray) \(1\): files hold only data classes"):
        save(("text", item), tmp_path / "data.h5")
    assert list(tmp_path.iterdir()) == []


def test_failure_while_saving_leaves_the_old_file(tmp_path, monkeypatch):
    path = save(record(1.0), tmp_path / "data.h5")

    def disk_full(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(storage, "_write", disk_full)
    with pytest.raises(OSError, match="no space left"):
        save(record(2.0), path)
    monkeypatch.undo()
    assert [p.name for p in tmp_path.iterdir()] == ["data.h5"]
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


def test_cached_computes_once_and_says_so(cache, told):
    build = Builder()
    first = load_or_compute("part", fingerprint(1), build)
    assert "part: saved to" in told()
    second = load_or_compute("part", fingerprint(1), build)
    assert f"part: loaded from {cache}" in told()
    assert build.calls == 1
    assert_same(first, second)


def test_another_key_is_computed_anew(cache):
    build = Builder()
    load_or_compute("part", fingerprint(1), build)
    load_or_compute("part", fingerprint(2), build)
    assert build.calls == 2
    assert len(list(cache.glob("part-*.h5"))) == 2
    assert_same(load_or_compute("part", fingerprint(1), build), record(1))
    # Sixteen digits of a key tell results apart.
    for last in "abc":
        load_or_compute("part", 15 * "0" + last + 48 * "0", build)
    assert build.calls == 5


@pytest.mark.usefixtures("cache")
def test_cached_keeps_silent_when_asked(capsys):
    for _ in range(2):
        load_or_compute("part", fingerprint(1), Builder(), progress=False)
    assert capsys.readouterr().out == ""


def test_damaged_cache_is_reported_and_rebuilt(cache, told):
    build = Builder()
    load_or_compute("part", fingerprint(1), build)
    (file,) = cache.iterdir()
    file.write_bytes(file.read_bytes()[:500])
    assert_same(load_or_compute("part", fingerprint(1), build), record(2))
    damaged = told()
    assert "damaged and will be rebuilt" in damaged
    assert file.name in damaged
    assert_same(load(file), record(2))


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_build_that_stops_leaves_no_file(cache, error):
    def build():
        raise error

    with pytest.raises(error):
        load_or_compute("part", fingerprint(1), build)
    assert list(cache.iterdir()) == []


def test_interrupted_saving_leaves_no_file(cache, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("pathlib.Path.replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        load_or_compute("part", fingerprint(1), Builder())
    assert list(cache.iterdir()) == []


def test_fingerprints_differ_wherever_the_inputs_do():
    steel = Material("steel", 210e9, 0.3, 7850.0)
    parts = [
        1, 1.0, "1", b"1", None, True, (1,), [1], (1, 2), ((1,), 2), ((1, 2),), {"a": 1}, {"b": 1}, {"a": 2},
        ("a", "bstr:"), ("astr:b", ""), "None", "True",
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
