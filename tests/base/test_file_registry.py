"""Data classes of nassim and of users in files: public names, files of earlier formats, changes between formats."""

import importlib
import pkgutil
import subprocess
import sys
from dataclasses import dataclass, fields, is_dataclass, make_dataclass
from pathlib import Path
from typing import get_args, get_type_hints

import h5py
import numpy as np
import pytest

import nassim
from nassim import (
    FRF,
    Controller,
    Encoder,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    load,
    register,
    save,
)
from nassim.base import file_registry
from nassim.base.storage import fingerprint
from nassim.scene.part import Part

DATA = Path(__file__).parents[1] / "data"
NOT_DATA = {
    # hold matrices of SciPy, shapes, meshes or solvers, which files cannot hold
    *("Assembly", "Condensation", "Coupling", "Damping", "FEModel", "Face", "MeshRound", "Solid"),
    *("LoadedEquilibrium", "LoadedState"),
    # hold code of a user, or are code
    *("CCode", "PythonController", "SimulationState"),
    # base classes of parts
    *("Part", "Actuator", "Sensor", "ForceElement", "Connection"),
    # contents of a page or an image
    *("Coloring", "Form", "Mark", "Mode", "Shape", "View"),
}
NOT_DATA_MODULES = (  # made from parts and never saved
    "nassim.scene.measures",
    "nassim.scene.rotation_measures",
    "nassim.scene.terms",
)


def exported_dataclasses():
    for name in ("nassim", *(f"nassim.{module.name}" for module in pkgutil.iter_modules(nassim.__path__))):
        package = importlib.import_module(name)
        for value in (getattr(package, public) for public in getattr(package, "__all__", ())):
            if isinstance(value, type) and is_dataclass(value) and value.__module__ not in NOT_DATA_MODULES:
                yield value.__name__


def test_every_exported_dataclass_is_registered_or_excluded():
    assert set(exported_dataclasses()) - set(file_registry.DATA_CLASSES) == NOT_DATA


def test_every_entry_is_that_dataclass():
    for name, module in file_registry.DATA_CLASSES.items():
        data_class = file_registry.find(name)
        assert "__dataclass_fields__" in vars(data_class)
        assert (data_class.__name__, data_class.__module__) == (name, module)
        assert register(data_class) is data_class


def parts(hint):
    yield hint
    for part in get_args(hint):
        yield from parts(part)


def test_dataclasses_in_fields_are_registered():
    for data_class in map(file_registry.find, file_registry.DATA_CLASSES):
        hints = get_type_hints(data_class)
        held = [part for item in fields(data_class) for part in parts(hints[item.name]) if is_dataclass(part)]
        saved = {part.__name__ for part in held if not issubclass(part, Part)} - {"PythonController"}  # holds code
        assert saved <= set(file_registry.DATA_CLASSES), data_class


def test_storage_imports_a_data_class_only_when_a_file_contains_it():
    """The modules are imported without nassim/__init__.py, which would load everything."""
    code = (
        "import sys, types, pathlib; package = types.ModuleType('nassim'); "
        f"package.__path__ = [{str(Path(nassim.__file__).parent)!r}]; sys.modules['nassim'] = package; "
        f"import {file_registry.__name__}, {load.__module__}; "
        "print(*(m for m in sys.modules if m.startswith('nassim.')))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    own = {file_registry.__name__, load.__module__}
    assert own <= set(run.stdout.split())
    table = set(file_registry.DATA_CLASSES.values())
    assert table.isdisjoint(run.stdout.split())


def record():
    time = np.arange(100) / 1000.0
    return TimeHistory(time, [np.sin(time), np.cos(time)], ("u", "lengthening é"), ("V", "µm"))


def frf():
    values = np.arange(12.0).reshape(2, 2, 3) * (1 + 2j)
    return FRF([1.0, 2.0, 3.0], values, ("a", "b"), ("u", "v"), None, "a label")


def scene():
    """A slide on a spring with a load and a position loop; the default damping ratio was 1 % then."""
    base = RigidBody("base", {"foot": [0.0, 0.0, 0.0]}, fixed=True)
    slide = RigidBody("slide", {"low": [0, 0, -0.1], "top": [0, 0, 0.1]}, 2.0, np.diag([1.0, 2.0, 2.5]), [0, 0, 0.1])
    block = RigidBody("load", {"seat": [0, 0, -0.05]}, 0.5, np.diag([1.0, 1.0, 1.0]), [0, 0, 0.25])
    controller = Controller([[0.9]], [[1.0]], [[2.0]], [[0.5]], 1e4)
    return Scene(
        "table",
        (base, slide, block),
        (Joint("guide", "base.foot", "slide.low", "z"), Joint("seat", "slide.top", "load.seat")),
        (PointForce("push", "slide.top", "z", "force"),),
        (Encoder("height", "base.foot", "load.seat"),),
        (SpringDamper("spring", "base.foot", "slide.low", "z", 1e4, 3.0),),
        (Loop("hold", controller, "height", "force", output_step=1e-3),),
        damping_ratio=0.01,
        gravity=[0.0, 0.0, -9.81],
    )


@pytest.mark.parametrize("make", [record, frf, scene])
@pytest.mark.parametrize("version", [1, 2])
def test_files_of_earlier_formats_load(make, version):
    """Files of `make()`: format 1 was saved by version 0.1, format 2 by version 0.2 in development."""
    loaded = load(DATA / f"{make.__name__}_format_{version}.h5")
    assert type(loaded) is type(make())
    assert fingerprint(loaded) == fingerprint(make())


@pytest.mark.parametrize("version", [1, 2])
def test_bodies_of_earlier_formats_load(version):
    """A steel bar, 0.1 m long and 10 mm thick, was saved by version 0.1; the loaded body was saved in format 2.

    It is the `make_bar` of these tests, two elements long (order 1), with a port that stretches its right half by
    5e-8 m per volt. It was reduced (n_modes=1) and then projected on the motions of "left" and two motions of "right",
    along x and along y. "right" is passive. The body before the projection is the enriched body.
    """
    body = load(DATA / f"body_format_{version}.h5")
    assert body.point_names == ("left",)
    assert body.all_point_names == ("left", "right")
    assert body.mass == pytest.approx(7800 * 1e-5, rel=1e-12)
    np.testing.assert_allclose(body.center_of_mass, [0.05, 0.0, 0.0], atol=1e-12)
    relative = [[1, 0], [0, 1], [0, 0], [0, 0], [0, 0], [0, 0]]
    rigid = np.eye(6)
    rigid[1, 5], rigid[2, 4] = 0.1, -0.1
    np.testing.assert_allclose(body.motion("right"), np.hstack([rigid, relative]), atol=1e-12)
    np.testing.assert_allclose(
        body.eigenfrequencies(fixed=["left"]), [5890.398602880433, 13955.672242029266], rtol=1e-12
    )
    errors = [0.546411777877855, 2.615763153854829]
    np.testing.assert_allclose(body.truncation_errors(fixed=["left"]), errors, rtol=1e-12)
    # E A / l times 5e-8 m/V, because everything between the remote points follows them.
    np.testing.assert_allclose(body.port("stack").forces, [0, 0, 0, 0, 0, 0, 10, 0], atol=1e-9)
    assert body.port("stack").blocked_capacitance == 1e-6
    assert body.record["finite element model"]
    assert len(body.surface.points) == 42
    assert set(body.surface.labels) == {"bar", "left", "right"}
    assert body.surface_modes.shape == (42, 3, 8)


def test_a_fit_of_an_earlier_format_loads():
    """A mode with 100 Hz, 1 % and a static gain of 2 was fitted to its FRF and saved in format 2 with `measured`."""
    fit = load(DATA / "fit_format_2.h5")
    np.testing.assert_allclose([fit.frequency[0], fit.damping_ratio[0], fit.gains[0, 0]], [100, 0.01, 2], rtol=1e-9)
    np.testing.assert_allclose(fit.recorded.values, fit.response(fit.recorded.frequency).values, rtol=1e-9)


@pytest.mark.parametrize("version", [1, 2])
def test_bodies_of_earlier_formats_are_saved_in_this_one(version, tmp_path):
    body = load(DATA / f"body_format_{version}.h5")
    assert fingerprint(load(save(body, tmp_path / "body.h5"))) == fingerprint(body)


def test_a_file_names_no_module(tmp_path):
    path = save(scene(), tmp_path / "scene.h5")
    with h5py.File(path) as file:
        assert file.attrs["nassim_format"] == 4
        assert file["content"].attrs["type"] == "Scene"
    assert b"nassim." not in path.read_bytes()


def first_signal(content):
    return {name: value[:1] if name != "time" else value for name, value in content.items()}


def test_fields_of_older_formats_are_brought_up_to_date(monkeypatch, tmp_path):
    """The test assumes that the fields of records changed before format 3."""
    path = save(record(), tmp_path / "new.h5")
    monkeypatch.setitem(file_registry.UPGRADES, "TimeHistory", f"{__name__}:first_signal")
    for version in (1, 2):
        assert load(DATA / f"record_format_{version}.h5").names == ("u",)
    assert load(path).names == ("u", "lengthening é")


@pytest.fixture(autouse=True)
def _forget(monkeypatch):
    monkeypatch.setattr(file_registry, "_registered", {})


def make_gap(**options):
    return make_dataclass("Gap", [("name", str), ("direction", np.ndarray)], frozen=True, **options)


def test_a_dataclass_of_the_user_is_saved_once_registered(tmp_path):
    @register
    @dataclass(frozen=True)
    class Bearing:
        name: str
        history: TimeHistory
        others: tuple["Bearing", ...] = ()

    bearing = Bearing("upper", record(), (Bearing("lower", record()),))
    again = load(save(bearing, tmp_path / "bearing.h5"))
    assert type(again) is type(again.others[0]) is Bearing
    assert fingerprint(again) == fingerprint(bearing)


def test_a_dataclass_that_is_not_registered_is_refused(tmp_path):
    gap = make_gap()("gap", np.ones(3))
    with pytest.raises(ValueError, match=r"cannot save Gap \(1\): it is not registered; give .* to nassim\.register"):
        save((record(), gap), tmp_path / "gap.h5")
    listed = make_dataclass("Listed", [], bases=(dict,))()
    with pytest.raises(ValueError, match=r"cannot save Listed \(content\): it is not registered"):
        save(listed, tmp_path / "gap.h5")
    with pytest.raises(ValueError, match=r"cannot save type \(content\): files hold only data classes"):
        save(FRF, tmp_path / "gap.h5")
    register(type(gap))
    path = save(gap, tmp_path / "gap.h5")
    assert load(path).name == "gap"
    file_registry._registered.clear()
    with pytest.raises(ValueError, match=r"gap\.h5: it holds a 'Gap', .* give it to nassim\.register before loading"):
        load(path)


def test_invalid_registrations_are_refused():
    @dataclass
    class Base:
        x: float

    class Derived(Base):
        pass

    for wrong in (Derived, int, load, Base(1.0)):
        with pytest.raises(ValueError, match=r"register takes a dataclass, got .*; write @register above @dataclass"):
            register(wrong)
    with pytest.raises(ValueError, match=r"the name 'FRF' is taken by nassim\..*FRF; give the class another name"):
        register(make_dataclass("FRF", []))
    register(Base)
    other = make_dataclass("Base", [])
    with pytest.raises(ValueError, match=r"the name 'Base' is taken by .*test_invalid_registrations_are_refused.*Base"):
        register(other)
    assert file_registry.find("Base") is Base


def test_a_class_defined_again_replaces_the_earlier_one(tmp_path):
    earlier, later = make_gap(), make_gap()
    path = save(register(earlier)("gap", np.ones(3)), tmp_path / "gap.h5")
    register(later)
    assert type(load(path)) is later
    with pytest.raises(ValueError, match="cannot save Gap"):
        save(earlier("gap", np.ones(3)), path)


def test_errors_of_constructors_name_the_file(tmp_path):
    @register
    @dataclass
    class Slope:
        rise: float
        run: float

        def __post_init__(self):
            self.value = self.rise / self.run

    slope = Slope(1.0, 2.0)
    slope.run = 0.0
    with pytest.raises(ValueError, match=r"cannot read .*slope\.h5: .*division"):
        load(save(slope, tmp_path / "slope.h5"))
