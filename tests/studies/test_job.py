import ast
import dataclasses
import functools
import importlib.util
import linecache
import math
import os
import pickle
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import tiny_functions

from nassim import TimeHistory
from nassim.studies.hashing import content_hash
from nassim.studies.job import identity, label, make_job, pickle_task

LOCK = threading.Lock()
FACTOR = 2.0


def uses_a_lock(a):
    with LOCK:
        return a


def scaled(a):
    return helped(a) * FACTOR


def helped(a):
    return a + 1


@pytest.mark.parametrize(
    ("function", "names", "seed", "message"),
    [
        (5, ("a",), None, "needs a function, got 5, a int"),
        (
            tiny_functions.product,
            ("a", "c", "d"),
            None,
            r"unknown parameters c, d: tiny_functions\.product takes a, b$",
        ),
        (tiny_functions.product, ("b",), None, "needs values of a beside what the study gives"),
        (tiny_functions.noisy, ("a",), None, "needs values of seed"),
        (
            tiny_functions.product,
            ("a",),
            1,
            "seed is given to the function's parameter of that name, but .* takes a, b",
        ),
        (tiny_functions.noisy, ("a", "seed"), 1, "but the study varies it"),
        (tiny_functions.noisy, ("a",), -1, "whole number of at least 0, got -1"),
        (tiny_functions.noisy, ("a",), 1.5, "whole number of at least 0, got 1.5"),
        (math.hypot, ("a",), None, "math.hypot"),
    ],
)
def test_functions_that_do_not_fit_the_study_are_refused(function, names, seed, message):
    with pytest.raises(ValueError, match=message):
        make_job(function, names, seed)


def test_any_keyword_is_known_to_a_function_that_takes_any():
    job = make_job(lambda a, **others: a + sum(others.values()), ("a", "b"), None)
    assert job.arguments({"a": 1, "b": 2}, "00" * 16) == {"a": 1, "b": 2}
    seeded = make_job(job.function, ("a", "b"), 3)
    assert set(seeded.arguments({"a": 1, "b": 2}, "00" * 16)) == {"a", "b", "seed"}


def test_fixed_arguments_need_no_value():
    make_job(functools.partial(tiny_functions.count_calls, calls="file"), ("a",), None)
    assert label(functools.partial(tiny_functions.product, b=3.0)) == "tiny_functions.product"


def test_functions_travel_by_value_where_they_have_no_module():
    factor = np.arange(3.0)
    job = make_job(lambda a: a * factor, ("a",), None)
    outcome = pickle.loads(pickle_task(job))({"a": 2.0})
    np.testing.assert_array_equal(outcome.layout.arrays(outcome.data)["result"], [0.0, 2.0, 4.0])


@pytest.mark.parametrize("fixed", [False, True], ids=["around it", "fixed"])
def test_what_cannot_travel_is_named(fixed, tmp_path):
    with (tmp_path / "log").open("w") as log:
        function = functools.partial(lambda a, log: a, log=log) if fixed else lambda a: log.write(str(a))
        with pytest.raises(
            ValueError, match=r"cannot be sent .* because of log, a TextIOWrapper .*executor=\"serial\""
        ):
            pickle_task(make_job(function, ("a",), None))


def test_functions_of_modules_travel_by_name_whatever_they_use():
    assert set(identity(make_job(uses_a_lock, ("a",), None))["inputs"]) == {"LOCK"}
    assert len(pickle_task(make_job(uses_a_lock, ("a",), None))) < 500


def makes(values, text="x"):
    def function(a, shift=1.0):
        return a + values[0] + len(text) + shift

    return function


def known_by(function, seed=None):
    return identity(make_job(function, ("a",), seed))


def test_a_study_is_known_by_its_function_and_all_that_this_carries(monkeypatch):
    record = TimeHistory([0.0, 1.0], [[1.0, 2.0]], ("u",), ("V",))
    other = TimeHistory([0.0, 1.0], [[1.0, 3.0]], ("u",), ("V",))
    assert known_by(makes(np.ones(3))) == known_by(makes(np.ones(3)))
    assert known_by(makes(np.ones(3))) != known_by(makes(np.zeros(3)))
    for one, two in ((record, other), (np.ones(2), np.zeros(2)), ({"k": 1.0}, {"k": 2.0}), ({3, 4}, {3, 5})):
        first, second = (known_by(functools.partial(tiny_functions.product, b=value)) for value in (one, two))
        assert first == known_by(functools.partial(tiny_functions.product, b=one))
        assert {key for key in first if first[key] != second[key]} == {"inputs"}
    before = known_by(scaled)
    assert {"FACTOR", "helped"} <= set(before["inputs"])
    monkeypatch.setattr(f"{__name__}.FACTOR", 3.0)
    assert known_by(scaled)["inputs"]["FACTOR"] != before["inputs"]["FACTOR"]
    assert known_by(scaled)["inputs"]["helped"] == before["inputs"]["helped"]


def shifted(a, x, y=2.0):
    return a + x + y


def with_defaults(one, two, three):
    def function(a, x=one, y=two, *, z=three):
        return a + x + y + z

    return function


@dataclasses.dataclass
class Machine:
    mass: float

    def move(self, a):
        return a * self.mass

    def __call__(self, a):
        return a * self.mass


def in_two_helpers(first, second):
    helpers = [makes([first]), makes([second])]
    one, two = helpers

    def function(a):
        return one(a) + two(a)

    return function


def with_an_inner_one(a):
    def inner():
        return helped(a) * FACTOR

    return inner()


def with_a_helper(a):
    return scaled(a) + 1


@pytest.mark.parametrize(
    ("one", "other", "what"),
    [
        (functools.partial(shifted, x=1.0, y=1.0), functools.partial(shifted, x=1.0), {"y"}),
        (with_defaults(1, 2, 3), with_defaults(1, 5, 3), {"y"}),
        (with_defaults(1, 2, 3), with_defaults(1, 2, 5), {"z"}),
        (functools.partial(lambda x, a: x, 1.0), functools.partial(lambda x, a: x, 2.0), {"argument 0"}),
        (Machine(1.0).move, Machine(2.0).move, {"self"}),
        (Machine(1.0), Machine(2.0), {"self"}),
        (in_two_helpers(1, 2), in_two_helpers(1, 3), {"values"}),
    ],
    ids=["same value twice", "default", "keyword default", "position", "method", "object", "one name twice"],
)
def test_nothing_that_a_function_carries_is_overlooked(one, other, what):
    first, second = known_by(one)["inputs"], known_by(other)["inputs"]
    assert {name for name in {*first, *second} if first.get(name) != second.get(name)} == what
    assert known_by(one) == known_by(one)


@pytest.mark.parametrize("function", [with_an_inner_one, with_a_helper])
def test_what_helpers_use_counts_however_deep(function, monkeypatch):
    before = known_by(function)["inputs"]
    monkeypatch.setattr(f"{__name__}.FACTOR", 3.0)
    after = known_by(function)["inputs"]
    assert {name for name in before if before[name] != after[name]} == {"FACTOR"}


CLASSES = """
from dataclasses import dataclass
import functools

FACTOR, LOAD, MASS, LIMIT = 2.0, 2.5, 3.0, 7.0

class Base:
    def shift(self):
        return 1.0

class Lazy:
    def __getattr__(self, name):
        raise ValueError(name)

@dataclass
class Machine(Base):
    mass: float = MASS
    limit = 2 * LIMIT
    lazy = Lazy()

    @property
    def weight(self):
        return FACTOR * self.mass

    @functools.cached_property
    def load(self):
        return LOAD

    def move(self, a):
        return self.weight * a + self.shift()

def run(a):
    return Machine().move(a)

move = Machine().move
machines = {"heavy": Machine()}

def pick(a):
    return machines["heavy"].move(a)
"""


@pytest.mark.parametrize(
    "change", ["2.0|3.0", "return 1|return 4", "mass: float|mass: int", "2.5|2.6", "3.0|5.0", "7.0|8.0"]
)
@pytest.mark.parametrize("function", ["run", "move", "pick"])
def test_classes_beside_a_function_count_with_all_that_they_use(function, change, tmp_path, monkeypatch):
    def load(folder, text):
        path = tmp_path / folder / "machines.py"
        path.parent.mkdir()
        path.write_text(text)
        spec = importlib.util.spec_from_file_location("machines", path)
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, "machines", module)
        spec.loader.exec_module(module)
        return known_by(getattr(module, function))["inputs"]

    first, same, other = load("a", CLASSES), load("b", CLASSES), load("c", CLASSES.replace(*change.split("|")))
    assert first == same
    assert first["class Machine"] != other["class Machine"]


def test_a_study_is_the_same_in_every_process():
    """Sets of texts, whose order is another in each, objects of a script's classes, random states that move on.

    Four helpers have a value of one name each.
    """
    code = (
        "import numpy as np\nfrom nassim.studies.job import identity, make_job\n"
        "class Machine:\n"
        "    def __init__(self, names): self.names, self.random = names, np.random.default_rng()\n"
        "MACHINE, SETS = Machine({'alpha', 'beta', 'gamma', 'delta'}), {'k': frozenset('abcdefgh')}\n"
        "def north(k=1.0): pass\ndef east(k=2.0): pass\ndef south(k=3.0): pass\ndef west(k=4.0): pass\n"
        "def run(a): return MACHINE, SETS, north(), east(), south(), west()\n"
        "print(identity(make_job(run, ('a',), None))['inputs'])"
    )
    environments = [os.environ | {"PYTHONHASHSEED": seed} for seed in "01"]
    one, other = (
        subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True).stdout
        for environment in environments
    )
    assert {"MACHINE", "SETS", "k"} <= set(ast.literal_eval(one))
    assert one == other


def test_contents_differ_where_values_do():
    values = [1, 1.0, True, "1", b"1", None, 1j, (1,), [1], {1}, {1: 1}, {1: 2}, {"a": 1, 2: 3}, range(2), range(3)]
    values += [np.array([1, "x"], object), np.array([1, "y"], object), Path("a"), Path("b"), np.sin, np.cos, len, max]
    values += [functools.partial(max, 1), functools.partial(max, 2), lambda: 1, lambda: 2, Machine(1.0), Machine(2.0)]
    values += [makes([1]), makes([2])]
    assert len({content_hash(value) for value in values}) == len(values)
    assert content_hash({"a": 1, 2: 3}) == content_hash({2: 3, "a": 1})
    assert content_hash(np.random.default_rng(1)) == content_hash(np.random.default_rng(2))
    objects = [np.array([["x"], {"y": 1.5}], object) for _ in range(2)]
    assert content_hash(objects[0]) == content_hash(objects[1])
    ring, other = [1], [1]
    ring.append(ring)
    other.append(other)
    assert content_hash(ring) == content_hash(other)


@pytest.mark.parametrize("text", ["def f(a):\n    return a + {}\n", "f = (lambda a: a + {}, 0)[0]\n"])
def test_sources_are_compared_without_their_comments(text, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    sources = []
    for number, source in enumerate((text, f"# a comment\n\n{text}".replace("\n    ", "\n    # why\n    "), text)):
        name = f"source_{number}_{abs(hash(text))}"
        (tmp_path / f"{name}.py").write_text(source.format(2 if number == 2 else 1))
        sources.append(known_by(importlib.import_module(name).f)["source"])
    assert sources[0] == sources[1] != sources[2]


def test_functions_without_a_source_are_compared_by_what_they_do(monkeypatch):
    """Also where Python takes the text of `python -c` for their source, as it does since 3.13."""
    monkeypatch.setitem(linecache.cache, "<string>", (9, None, ["import this\n"], "<string>"))
    one, two, three = {}, {}, {}
    exec("def f(a):\n    return a + 1\n", one)
    exec("def f(a):\n\n    return a + 1\n", two)
    exec("def f(a):\n    return a + 2\n", three)
    first, second, third = (known_by(found["f"])["source"] for found in (one, two, three))
    assert first == second != third
