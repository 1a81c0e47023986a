"""Optional arguments of public verbs: each has the default that its signature documents, and changes what it should."""

import inspect
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Argument:
    """An optional argument of a verb.

    call: the verb with all that it requires, taking further arguments by keyword
    default: as documented; other: another value; law: whether results (before, after) are as `other` demands
    """

    call: Callable[..., Any]
    name: str
    default: Any
    other: Any
    law: Callable[[Any, Any], Any]

    def check(self) -> None:
        """Fail where the default is another one than documented, and where the argument does not do what it should."""
        before = self.call()
        assert same(before, self.call(**{self.name: self.default})), f"{self.name} is not {self.default!r} by default"
        assert np.all(self.law(before, self.call(**{self.name: self.other}))), f"{self.name} does not do what it should"


def table(calls: Mapping[str, Callable[..., Any]], rows: list[tuple[str, str, Any, Any, Any]]) -> dict[str, Argument]:
    """Arguments by "verb: argument" from rows of verb, argument, default, other value and law."""
    return {f"{verb}: {name}": Argument(calls[verb], name, *rest) for verb, name, *rest in rows}


def assert_all_tried(package: ModuleType, tables: Collection[str], elsewhere: Mapping[str, str] | None = None) -> None:
    """Fail unless every optional argument of a package's public verbs is in a table, or in a test "folder/file::name".

    Arguments are called "verb: argument", those of methods too.
    """
    public = [getattr(package, name) for name in package.__all__]
    classes = list(filter(inspect.isclass, public))
    methods = (getattr(one, name) for one in classes for name in vars(one) if not name.startswith("_"))
    calls = (*filter(inspect.isfunction, public), *classes, *filter(callable, methods))
    given = ((call.__name__, one) for call in calls for one in inspect.signature(call).parameters.values())
    assert {f"{verb}: {one.name}" for verb, one in given if one.default is not one.empty} == {
        *tables,
        *(elsewhere or ()),
    }
    for file, _, name in (place.partition("::") for place in (elsewhere or {}).values()):
        assert f"def {name}(" in (Path(__file__).parent / file).read_text(), f"there is no test {name} in {file}"


def same(a: Any, b: Any) -> bool:
    """Whether results are equal to the last digits: numbers, arrays, tuples, mappings and data classes of these."""
    if is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, Mapping):
        return list(a) == list(b) and all(same(a[key], b[key]) for key in a)
    if a is None or isinstance(a, str):
        return a == b
    return np.shape(a) == np.shape(b) and np.allclose(a, b, rtol=1e-13, atol=1e-300, equal_nan=True)
