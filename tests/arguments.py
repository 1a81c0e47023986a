"""Optional arguments of public verbs: each changes what it should; `test_defaults` sees their defaults."""

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from nassim.base.field_types import Field


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


def is_now(name: str, value: Any) -> Callable[[Any, Any], bool]:
    """Law of an argument that sets an attribute of a result, which had another value before."""
    return lambda before, after: (
        np.array_equal(getattr(after, name), value) and not np.array_equal(getattr(before, name), value)
    )


def optional_arguments(module: ModuleType) -> set[str]:
    """Return "verb: argument" of every optional argument of what a module exports, methods included."""
    return {f"{verb}: {name}" for verb, call in _verbs(module) for name in _optional(call)}


def _verbs(module: ModuleType) -> Iterator[tuple[str, Callable[..., Any]]]:
    for name in module.__all__:
        item = getattr(module, name)
        if not callable(item):
            continue
        yield name, item
        for method, member in vars(item).items() if inspect.isclass(item) else ():
            call = getattr(member, "__func__", member)
            if not method.startswith("_") and inspect.isfunction(call):
                yield f"{name}.{method}", call


def _optional(call: Callable[..., Any]) -> list[str]:
    known = inspect.signature(call).parameters.values()
    return [p.name for p in known if p.default is not p.empty and not p.name.startswith("_")]


def check_fields(make: Callable[..., Any], values: Mapping[str, tuple[Any, Any]]) -> None:
    """Fail where fields of a data class, name -> (default, other value), have other defaults or do not take a value.

    The fields are all that have a default. Fails too where a field that takes a list can be changed in place.
    """
    plain = make()
    with_default = [f for f in fields(plain) if f.default is not MISSING or f.default_factory is not MISSING]
    assert {f.name for f in with_default if not f.name.startswith("_")} == set(values)
    for name, (default, other) in values.items():
        assert same(getattr(plain, name), default), f"{name} is not {default!r} by default"
        assert same(getattr(make(**{name: other}), name), other), f"{name} is not what it was made with"
    for f in fields(plain):
        if isinstance(f.type, Field):
            value = getattr(plain, f.name)
            fixed = not value.flags.writeable if isinstance(value, np.ndarray) else not isinstance(value, list | dict)
            assert fixed, f"{f.name} can be changed in place"


def check_finite(make: Callable[..., Any], values: Mapping[str, tuple[Any, Any]]) -> None:
    """Fail where a number or an array of a data class is taken without a message when it is not finite."""
    for one in (make(), *(make(**{name: other}) for name, (_, other) in values.items())):
        for f in fields(one):
            value = getattr(one, f.name)
            if isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype == float and value.size):
                with pytest.raises(ValueError, match="NaN or infinite"):
                    replace(one, **{f.name: value * np.nan})


def assert_all_tried(
    package: ModuleType, tables: Mapping[str, Argument], elsewhere: Mapping[str, str] | None = None
) -> None:
    """Fail unless every optional argument of a package's public verbs is in a table, or in a test "folder/file::name".

    Arguments are called "verb: argument", those of methods too.
    """
    found = {f"{verb.partition('.')[2] or verb}: {name}" for verb, call in _verbs(package) for name in _optional(call)}
    assert found == {*tables, *(elsewhere or ())}
    for file, _, name in (place.partition("::") for place in (elsewhere or {}).values()):
        assert f"def {name}(" in (Path(__file__).parent / file).read_text(), f"there is no test {name} in {file}"


def same(a: Any, b: Any) -> bool:
    """Whether results are equal to the last digits: numbers, arrays, tuples, mappings and data classes of these."""
    if a is b:
        return True
    if is_dataclass(a):
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, Mapping):
        return list(a) == list(b) and all(same(a[key], b[key]) for key in a)
    if a is None or isinstance(a, str):
        return a == b
    return np.shape(a) == np.shape(b) and np.allclose(a, b, rtol=1e-13, atol=1e-300, equal_nan=True)
