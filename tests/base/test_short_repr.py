"""Representations of data classes: one line that tells what is in them."""

import importlib
import inspect
from dataclasses import dataclass, field, is_dataclass
from pkgutil import iter_modules

import numpy as np

import nassim
from nassim import FRF, FEModel, RemotePoint, RigidBody, Scene, SpringDamper, TimeHistory
from nassim.base.file_registry import DATA_CLASSES, find
from nassim.base.short_repr import LONGEST, short_repr
from nassim.bodies import StressField
from nassim.scene.part import Sensor
from nassim.systems import LinearModel, damping, sampled


def test_arrays_appear_by_ends_or_shape_and_defaults_do_not_appear():
    record = TimeHistory(np.linspace(0.5, 2.5, 20001), np.zeros((2, 20001)), ("force", "encoder"), ("N", "m"))
    assert repr(record) == (
        "TimeHistory(time=[0.5 ... 2.5] (20001), values=array (2, 20001), names=('force', 'encoder'), units=('N', 'm'))"
    )
    body = RigidBody("table", {"top": [0, 0, 1]}, mass=1.25, inertia=np.eye(3), position=[0, 0.1, 0])
    assert repr(body) == "RigidBody(name='table', points={'top'}, mass=1.25, inertia=array (3, 3), position=[0 0.1 0])"
    stress = StressField("top", np.ones((1, 3)), np.zeros((1, 6, 4)), np.zeros((1, 6, 4)))
    assert repr(stress) == "StressField(name='top', positions=array (1, 3))", "its rows are no figures to read"
    assert repr(RemotePoint("top", "face", [0, 0, 1])) == "RemotePoint(name='top', faces=('face',), position=[0 0 1])"


def test_data_classes_in_others_appear_by_their_names():
    many = [RigidBody(f"body{k}", {}, mass=1.0, inertia=np.eye(3)) for k in range(7)]
    assert repr(Scene("bench", many[:1])) == "Scene(name='bench', bodies=(RigidBody('body0'),))"
    assert repr(Scene("machine", many)) == "Scene(name='machine', bodies=(7 RigidBody))"
    names = [f"signal_{k}" for k in range(9)]
    assert "names=('signal_0', 'signal_1'," in repr(TimeHistory([0, 1], np.zeros((9, 2)), names))


def test_representations_are_cut_at_their_longest():
    body = repr(RigidBody("x" * 100, {f"point_{k}": [0, 0, k] for k in range(8)}, fixed=True))
    assert "... 8 in all" in body
    assert "x" * 41 not in body
    frf = FRF([1.0, 2.0], np.zeros((4, 1, 2)), [f"output_{'z' * 50}_{k}" for k in range(4)], ["y" * 50], label="w" * 90)
    assert len(repr(frf)) <= LONGEST
    assert repr(frf).startswith("FRF(frequency=[1 2], values=array (4, 1, 2), outputs=(")


def test_all_data_classes_that_users_hold_have_it():
    assert [name for name in DATA_CLASSES if find(name).__repr__ is not short_repr] == []
    assert FEModel.__repr__ is short_repr
    packages = [nassim, *(importlib.import_module(f"nassim.{found.name}") for found in iter_modules(nassim.__path__))]
    public = {getattr(package, name) for package in packages for name in getattr(package, "__all__", ())}
    data = [one for one in public if isinstance(one, type) and is_dataclass(one) and not inspect.isabstract(one)]
    assert len(data) > 100
    assert {one.__name__ for one in data if one.__repr__ is not short_repr} <= {"PythonController", "Term"}


def test_parts_outside_the_library_have_it_unless_they_have_their_own():
    @dataclass(frozen=True)
    class Gauge(Sensor):
        rows: np.ndarray = field(default_factory=lambda: np.zeros(6))
        _found: tuple = (1,)

        def terms(self, scene):
            return ()

    @dataclass(frozen=True)
    class Own(Gauge):
        def __repr__(self):
            return "own"

    assert repr(Gauge("g", np.ones(8), (2,))) == "Gauge(name='g', rows=[1 ... 1] (8))"
    assert repr(Own("g")) == "own"
    assert repr(SpringDamper("s", "a.b", "c.d", stiffness=1e6)) == (
        "SpringDamper(name='s', a='a.b', b='c.d', stiffness=1e+06)"
    )


def test_results_print_as_text_with_names_and_units():
    model = LinearModel(-4 * np.eye(1), [[1.0]], [[1.0]], [[0.0]], ["force"], ["gap"], ["m"])
    assert str(model) == "linear model, continuous, 1 states\n  inputs: force\n  outputs: gap [m]"
    pair = LinearModel([[-4.0]], [[1.0]], np.ones((2, 1)), np.zeros((2, 1)), ["force"], ["gap", "share"], ["m", ""])
    assert str(pair).endswith("outputs: gap [m], share")
    assert str(sampled(model, 250.0)).startswith("linear model, sampled, 250 Hz, 1 states")
    frequency, ratio = found = damping(model)
    assert (frequency[0], ratio[0]) == (4 / (2 * np.pi), 1.0)
    assert str(found) == "frequency [Hz]  damping ratio [-]\n0.63662                         1"
    frf = FRF([1.0, 2.5], np.zeros((1, 1, 2)), ["gap"], ["force"], label="run")
    assert str(frf) == "frequency responses 'run' at 2 frequencies from 1 Hz to 2.5 Hz\n  inputs: force\n  outputs: gap"
    record = TimeHistory([0.0, 0.5, 1.0], [[1.0, 3.0, -2.0]], ("gap",), ("m",), notes=("a note",))
    first, heading, row, note = str(record).splitlines()
    assert first == "3 samples from 0 s to 1 s, 2 Hz"
    assert heading.split() == ["signal", "unit", "least", "largest", "last"]
    assert row.split() == ["gap", "m", "-2", "3", "-2"]
    assert note == "a note"
