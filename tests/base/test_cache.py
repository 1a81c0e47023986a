"""The cache: its key knows the whole input, its files repeat what was told when they were made, its folder may fail."""

import functools
import importlib.metadata
import inspect
import shutil
import warnings
from dataclasses import fields, replace

import pytest
from conftest import lattice, make_bar

from models import apa300ml
from models.apa300ml import PORTS, PZT, STACK, APAGeometry, reduced_apa300ml
from nassim import build_fe_model, craig_bampton, load, save
from nassim.base import storage
from nassim.base.storage import code_fingerprint, fingerprint, load_or_compute
from nassim.fem import meshing, solid
from nassim.fem.assembly import replace_materials

MESH = {"extrude": "y", "layer_thickness": 5e-3, "local_sizes": {"arm_roots": 0.3e-3}, "curvature": 0.5}


@pytest.fixture
def cache(tmp_path, monkeypatch):
    folder = tmp_path / "not yet there" / "cache"
    monkeypatch.setenv("NASSIM_CACHE", str(folder))
    return folder


one_shape = functools.cache(apa300ml._shape)
"""CAD takes most of a key's time."""


@pytest.fixture
def key(monkeypatch):
    """The key that a call of `reduced_apa300ml` looks up, without any work; its CAD bodies are sound."""
    monkeypatch.setattr(solid, "_check_bodies", lambda *_: None)
    monkeypatch.setattr(solid, "_refuse_overlaps", lambda *_: None)
    monkeypatch.setattr(apa300ml, "code_fingerprint", functools.cache(code_fingerprint))
    monkeypatch.setattr(apa300ml, "load_or_compute", lambda name, key, build, *, progress: key)
    monkeypatch.setattr(apa300ml, "_shape", one_shape)
    return reduced_apa300ml


CHANGES = {
    "geometry": [APAGeometry(**{f.name: 0.99 * getattr(APAGeometry(), f.name)}) for f in fields(APAGeometry)],
    "element_size": [4e-3],
    "order": [2],
    "n_modes": [7],
    "coupling": ["rbe2"],
    "stack_coupling": ["rbe2"],
    "ports": [
        PORTS,
        PORTS[:1],
        (replace(PORTS[0], name="other"), PORTS[1]),
        (replace(PORTS[0], stack=replace(STACK, capacitance=1.01 * STACK.capacitance)), PORTS[1]),
        (replace(PORTS[0], stack=replace(STACK, stiffness=1.01 * STACK.stiffness)), PORTS[1]),
    ],
    "ceramic": [
        replace(PZT, young_modulus=1.001 * PZT.young_modulus),
        replace(PZT, poisson_ratio=0.3),
        replace(PZT, density=7801.0),
    ],
    "mesh": [
        {},
        MESH,
        {**MESH, "extrude": None},
        {**MESH, "layer_thickness": 4e-3},
        {**MESH, "curvature": 0.6},
        {**MESH, "local_sizes": {"arm_roots": 0.4e-3}},
        {**MESH, "local_sizes": {"holes": 0.3e-3}},
    ],
    "geometric_stiffness": [True],
}


def test_every_argument_changes_the_key(key):
    """Each given change has another key than the default and than every other change.

    Progress has not, nor has a condensed model at hand, which is of the same arguments.
    """
    given = set(inspect.signature(reduced_apa300ml).parameters)
    assert given == {*CHANGES, "condensed", "progress"}, "a new argument needs its changes here"
    found = [key(), *(key(**{name: value}) for name, values in CHANGES.items() for value in values)]
    assert len(set(found)) == len(found)
    assert key() == key(progress=False) == key(APAGeometry()) == found[0]


def test_the_solver_changes_the_key(key, monkeypatch):
    default = key()
    monkeypatch.setattr(apa300ml, "solver_name", lambda: "another")
    assert key() != default


def test_code_changes_the_key(key, monkeypatch):
    default = key()
    monkeypatch.setattr(apa300ml, "code_fingerprint", lambda: "another")
    assert key() != default


@pytest.mark.parametrize("library", ["netgen-mesher", "ngsolve", "numpy", "scipy"])
def test_versions_of_libraries_change_the_key(monkeypatch, library):
    before, version = code_fingerprint(), importlib.metadata.version
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "0.0" if name == library else version(name))
    assert code_fingerprint() != before


def test_every_source_of_the_package_changes_the_key(tmp_path, monkeypatch):
    before = code_fingerprint()
    package = tmp_path / "nassim"
    shutil.copytree(storage.PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(storage, "PACKAGE", package)
    assert code_fingerprint() == before
    found = {before}
    (package / "devices" / "as_in_a_wheel.py").write_text("")
    assert code_fingerprint() == before, "a wheel and a clone share cached bodies"
    sources = [min(folder.glob("*.py")) for folder in (package, *package.rglob("*/")) if any(folder.glob("*.py"))]
    sources = [path for path in sources if path.parent.name != "devices"]
    assert len(sources) > 15, "one of each sub-package"
    for path in sources:
        text = path.read_text()
        path.write_text(f"{text}\n")
        found.add(code_fingerprint())
        path.write_text(text)
    sources[0].rename(package / "renamed.py")
    assert len(found | {code_fingerprint()}) == len(sources) + 2


def test_nested_mappings_and_bytes_do_not_run_into_each_other():
    assert fingerprint({"a": {"b": 1}, "c": 2}) != fingerprint({"a": {"b": 1, "c": 2}})
    assert fingerprint(b"a", b"b") != fingerprint(b"abytes:b")


def thin_bar():
    """A bar whose mesh is warned of: order 1, one element thick."""
    return build_fe_model(make_bar(), element_size=0.02, order=1, progress=False)


def reduced_thin_bar():
    return craig_bampton(thin_bar(), n_modes=2, discretization=False, progress=False)


THIN = "solid 'bar': 100 % of the elements reach from surface to surface"


@pytest.mark.usefixtures("cache")
def test_warnings_are_repeated_when_the_body_is_loaded(tmp_path, told):
    for made in (True, False, False):
        with pytest.warns(UserWarning, match=THIN) as warned:
            body = load_or_compute("bar", "0", reduced_thin_bar)
        assert len(warned) == 1
        assert body.record["warnings"].startswith(THIN)
        assert ("saved to" if made else "loaded from") in told()
    again = load(save(body, tmp_path / "body.h5"))
    assert again.record["warnings"] == body.record["warnings"]


def test_a_body_without_warnings_keeps_none():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = build_fe_model(make_bar(), element_size=0.02, order=2, progress=False)
        assert "warnings" not in craig_bampton(model, n_modes=2, discretization=False, progress=False).record


def test_warnings_outlast_other_materials():
    with pytest.warns(UserWarning, match=THIN):
        model = thin_bar()
    changed = replace_materials(model, {"bar": replace(model._source[1].materials["bar"], density=1000.0)})
    assert changed.warnings == model.warnings
    assert changed.description == model.description


def refuse_first_gradings(monkeypatch, count):
    """Let Netgen fail at the first gradings that are tried."""
    generate, calls = meshing._generate, []

    def fail_first(shape, options, *sizes):
        calls.append(options)
        if len(calls) <= count:
            raise meshing.NgException("Meshing failed!")
        return generate(shape, options, *sizes)

    monkeypatch.setattr(meshing, "_generate", fail_first)


@pytest.mark.usefixtures("cache")
def test_another_size_stands_in_the_record(monkeypatch, capsys):
    def build():
        return craig_bampton(
            build_fe_model(make_bar(), element_size=0.02, order=2, progress=False),
            n_modes=1,
            discretization=False,
            progress=False,
        )

    for count, told in ((0, None), (1, None), (2, "elements of 0.95 times the size that was asked for")):
        with monkeypatch.context() as patch:
            refuse_first_gradings(patch, count)
            described = load_or_compute("bar", f"key {count}", build).record["finite element model"]
        assert ("Netgen failed" in described) == bool(told)
        assert told is None or told in described
    capsys.readouterr()
    load_or_compute("bar", "key 2", build)
    assert told in " ".join(capsys.readouterr().out.split())


@pytest.mark.usefixtures("cache")
def test_tetrahedra_in_place_of_prisms_stand_in_the_record(monkeypatch):
    def build():
        model = build_fe_model(make_bar(), element_size=0.02, order=2, extrude="x", progress=False)
        return craig_bampton(model, n_modes=1, discretization=False, progress=False)

    refuse_first_gradings(monkeypatch, len(meshing.TRIALS))
    for progress in (True, True, False):
        with pytest.warns(UserWarning, match="solid 'bar' with prisms: tetrahedra are used instead"):
            body = load_or_compute("bar", "key", build, progress=progress)
        assert "tetrahedra are used instead" in body.record["warnings"]


def test_cache_that_cannot_be_written_is_told_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("NASSIM_CACHE", str(tmp_path / "file" / "cache"))
    order = []

    def build():
        order.append("work")
        return STACK

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        monkeypatch.setattr(warnings, "showwarning", lambda message, *_: order.append(str(message)))
        assert load_or_compute("part", "key", build) is STACK
    assert order[1:] == ["work"]
    assert "cannot be written" in order[0]
    assert "set the environment variable NASSIM_CACHE" in order[0]


def reduced(build):
    """A function of a device, which calls the cache for a user."""
    return load_or_compute("part", "key", build)


@pytest.mark.parametrize("text", ["cannot be written", "could not be kept", "warned when it was made"])
def test_warnings_of_the_cache_point_to_the_line_that_calls_it(cache, tmp_path, monkeypatch, text):
    if text == "cannot be written":
        (tmp_path / "file").write_text("")
        monkeypatch.setenv("NASSIM_CACHE", str(tmp_path / "file" / "cache"))
    elif text == "could not be kept":
        monkeypatch.setattr(storage, "save", lambda *_: (tmp_path / "no folder" / "part").touch())
    else:
        body = craig_bampton(lattice(), n_modes=0, progress=False)
        save(replace(body, record={"warnings": text}), cache / "part-key.h5")
    with pytest.warns(UserWarning, match=text) as told:
        reduced(lambda: STACK)
    lines = {line for *_, line in reduced.__code__.co_lines()}
    assert [(w.filename, w.lineno in lines) for w in told] == [(__file__, True)]


def test_disk_that_fills_up_meanwhile_does_not_lose_the_result(cache, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(storage, "save", full)
    with pytest.warns(UserWarning, match=r"part could not be kept .* No space left on device"):
        assert load_or_compute("part", "key", lambda: STACK) is STACK
    assert list(cache.iterdir()) == []
