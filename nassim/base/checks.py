"""Checks of input: each says what was given, what is allowed and what to do."""

from collections.abc import Collection, Iterable, Mapping
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]
"""A float array unless its docstring says otherwise; shapes and units stand there too."""
Value = TypeVar("Value")


def finite_array(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    """Return `value` as a read-only float array of the given shape (None: any length).

    Raises ValueError for another shape and for NaN or infinity.
    """
    if np.iscomplexobj(value):
        raise ValueError(f"{name} must be real numbers, got complex ones")
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be numbers, got {value!r}") from error
    if array.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, array.shape, strict=True)):
        wanted = " x ".join("any" if n is None else str(n) for n in shape) or "a single number"
        raise ValueError(f"{name} must have shape {wanted}, got {' x '.join(map(str, array.shape)) or 'a number'}")
    if not np.all(np.isfinite(array)):
        count = int(np.sum(~np.isfinite(array)))
        raise ValueError(f"{name} holds {count} value(s) that are NaN or infinite; all must be finite")
    array.setflags(write=False)
    return array


def finite(name: str, value: float) -> float:
    """Return a finite float; raises ValueError otherwise."""
    return float(finite_array(name, value, ()))


def positive(name: str, value: float, unit: str = "") -> float:
    """Return a float above zero; raises ValueError otherwise."""
    number = finite(name, value)
    if number <= 0:
        raise ValueError(f"{name} must be positive, got {number:g}{' ' + unit if unit else ''}")
    return number


def not_negative(name: str, value: float, unit: str = "") -> float:
    """Return a float of at least zero; raises ValueError otherwise."""
    number = finite(name, value)
    if number < 0:
        raise ValueError(f"{name} must not be negative, got {number:g}{' ' + unit if unit else ''}")
    return number


def above_zero(name: str, value: float, unit: str = "") -> float:
    """Return a number above zero, infinity included; raises ValueError otherwise."""
    if not isinstance(value, (int, float, np.number)) or not value > 0:
        raise ValueError(f"{name} must be positive, got {value!r} {unit}".rstrip() + "; inf for none")
    return float(value)


def known(kind: str, name: str, names: Collection[str]) -> str:
    """Return `name` if it is one of `names`; the ValueError otherwise lists them."""
    if name not in names:
        raise ValueError(f"unknown {kind} {name!r}; known: {', '.join(names) or 'none'}")
    return name


def unique(kind: str, names: Iterable[str]) -> tuple[str, ...]:
    """Return the names as a tuple; raises ValueError for a bare text, and if one is empty or occurs twice."""
    if isinstance(names, str):
        raise ValueError(f"{kind} names must be a list of them, got the text {names!r}; write [{names!r}]")
    result = tuple(names)
    twice = sorted({n for n in result if result.count(n) > 1})
    if twice:
        raise ValueError(f"{kind} names must differ; used more than once: {', '.join(twice)}")
    if any(not isinstance(n, str) or not n for n in result):
        raise ValueError(f"{kind} names must be non-empty strings, got {result}")
    return result


def instances(label: str, value: Any, kinds: tuple[type, ...]) -> tuple[Any, ...]:
    """Return a sequence as a tuple; raises ValueError for what is none, and for one that holds another kind."""
    allowed = ", ".join(kind.__name__ for kind in kinds)
    if isinstance(value, (str, Mapping)) or not isinstance(value, Iterable):
        raise ValueError(f"{label} must be a tuple of {allowed}, got {type(value).__name__}; write (part,) for one")
    result = tuple(value)
    for part in result:
        if not isinstance(part, kinds):
            raise ValueError(f"{label} must be of {allowed}, got {part!r:.60}, a {type(part).__name__}")
    return result


def frozen_mapping(value: Mapping[str, Value] | None) -> Mapping[str, Value]:
    """Return a read-only copy of a mapping (None: an empty one)."""
    return MappingProxyType(dict(value or {}))


def freeze(instance: object, **fields: Any) -> None:
    """Set fields of a frozen dataclass from its own `__post_init__`, after they were checked."""
    for name, value in fields.items():
        object.__setattr__(instance, name, value)
