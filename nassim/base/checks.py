"""Checks of input. Each error message says what was given, what is allowed and what to do."""

import copyreg
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from difflib import get_close_matches
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from nassim.base import field_types
from nassim.base.field_types import ArrayLike

Array = field_types.Array
"""A float array unless its docstring says otherwise. The docstrings give its shape and units."""
FEW = 8
"""Number of known names above which the nearest is told first."""
Value = TypeVar("Value")


def finite_array(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    """Return `value` as a read-only float array of the given shape.

    Args:
        name: what error messages call the value
        value: real numbers
        shape: expected shape; None stands for any length

    Raises:
        ValueError: for another shape, for complex numbers, NaN or infinity
    """
    try:
        given = np.asarray(value)
    except ValueError as error:
        raise ValueError(f"{name} must be numbers, in rows of equal length, got {value!r}") from error
    if np.iscomplexobj(given):
        raise ValueError(f"{name} must be real numbers, got complex ones")
    try:
        array = np.array(given, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be {'numbers' if shape else 'a number'}, got {value!r}") from error
    if array.shape != shape and (
        array.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, array.shape, strict=True))
    ):
        wanted = " x ".join("any" if n is None else str(n) for n in shape) or "a single number"
        raise ValueError(f"{name} must have shape {wanted}, got {' x '.join(map(str, array.shape)) or 'a number'}")
    if not np.isfinite(array).all():
        count = int(np.sum(~np.isfinite(array)))
        raise ValueError(f"{name} holds {count} value(s) that are NaN or infinite; all must be finite")
    array.setflags(write=False)
    return array


def finite(name: str, value: float) -> float:
    """Return `value` as a finite float.

    Raises:
        ValueError: if it is not a finite number
    """
    return float(finite_array(name, value, ()))


def positive(name: str, value: float, unit: str = "") -> float:
    """Return `value` as a float above zero; `unit` completes the error message.

    Raises:
        ValueError: if it is not a finite number above zero
    """
    number = finite(name, value)
    if number <= 0:
        raise ValueError(f"{name} must be positive, got {number:g}{' ' + unit if unit else ''}")
    return number


def not_negative(name: str, value: float, unit: str = "") -> float:
    """Return `value` as a float of at least zero; `unit` completes the error message.

    Raises:
        ValueError: if it is negative or not a finite number
    """
    number = finite(name, value)
    if number < 0:
        raise ValueError(f"{name} must not be negative, got {number:g}{' ' + unit if unit else ''}")
    return number


def below_nyquist(name: str, frequency: float, sample_rate: float, *, zero: bool = False) -> float:
    """Return a frequency [Hz] as a float below half the sample rate and above zero; `zero` allows that too.

    Raises:
        ValueError: if it is not such a number
    """
    half = positive("sample_rate", sample_rate, "Hz") / 2
    number = (not_negative if zero else positive)(name, frequency, "Hz")
    if number >= half:
        raise ValueError(f"{name} must lie below half the sample rate, {half:g} Hz, got {number:g} Hz")
    return number


def whole_number(name: str, value: float, least: float = -math.inf, most: float = math.inf) -> int:
    """Return `value` as an integer.

    Raises:
        ValueError: if it is not a whole number within the limits, and for a truth value
    """
    value = value[()] if isinstance(value, np.ndarray) else value  # of an array of one number, its number
    is_number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
    if is_number and least <= value <= most and value == np.floor(value) and abs(value) < math.inf:
        return int(value)
    limits = "" if least == -math.inf else f" of at least {least}" if most == math.inf else f" from {least} to {most}"
    raise ValueError(f"{name} must be a whole number{limits}, got {value!r}")


def above_zero(name: str, value: float, unit: str = "") -> float:
    """Return `value` as a number above zero, which may be infinite; `unit` completes the error message.

    Raises:
        ValueError: if it is not a number above zero
    """
    value = value[()] if isinstance(value, np.ndarray) else value
    if not isinstance(value, (int, float, np.number)) or not value > 0:
        raise ValueError(f"{name} must be positive, got {value!r} {unit}".rstrip() + "; inf for none")
    return float(value)


def of_kind(label: str, value: Any, kind: type[Any], advice: str = "") -> None:
    """Check the type of a value.

    Args:
        label: what error messages call the value
        value: the value
        kind: the allowed type
        advice: what to do; ends the message

    Raises:
        ValueError: if it is of another type
    """
    if not isinstance(value, kind):
        own = type(value)
        given = own.__name__ if own.__module__ == "builtins" else f"{own.__module__}.{own.__name__}"
        raise ValueError(f"{label} must be a {kind.__name__}, got {given}{advice and '; '}{advice}")


def known(kind: str, name: str, names: Collection[str]) -> str:
    """Return `name` if it is one of `names`.

    Raises:
        ValueError: if it is not; the message calls it a `kind` and lists the known names
    """
    name = _plain(name)
    if name not in names:
        near = get_close_matches(str(name), map(str, names), 1) if len(names) > FEW else []
        meant = f"did you mean {near[0]!r}? " if near else ""
        raise ValueError(f"unknown {kind} {name!r}; {meant}known: {', '.join(names) or 'none'}")
    return name


def unique(kind: str, names: Iterable[str]) -> tuple[str, ...]:
    """Return names as a tuple, after checking that they differ.

    Args:
        kind: what the names belong to, for error messages
        names: the names

    Raises:
        ValueError: for a single string, an empty name, a name that is not a string, or a name used twice
    """
    result = several(f"{kind} names", names)
    twice = sorted({n for n in result if result.count(n) > 1})
    if twice:
        raise ValueError(f"{kind} names must differ; used more than once: {', '.join(twice)}")
    if any(not isinstance(n, str) or not n for n in result):
        raise ValueError(f"{kind} names must be non-empty strings, got {result}")
    return result


def several(label: str, texts: Iterable[str]) -> tuple[str, ...]:
    """Return texts as a tuple, those of NumPy as Python's.

    Raises:
        ValueError: for a single text, which would be read letter by letter
    """
    if isinstance(texts, str):
        raise ValueError(f"{label} must be a list of them, got the text {texts!r}; write [{texts!r}]")
    return tuple(map(_plain, texts))


def _plain(text: str) -> str:
    """Return a text of NumPy as one of Python, whose `repr` has no type."""
    return str(text) if isinstance(text, np.str_) else text


def axis_pairs(kind: str, pairs: Iterable[Sequence[str]], names: Collection[str]) -> tuple[tuple[str, str], ...]:
    """Return pairs of names along two axes.

    Args:
        kind: what the names belong to, for error messages
        pairs: the pairs
        names: known names

    Raises:
        ValueError: for anything but pairs, for unknown names, and for a name used twice
    """
    result = tuple(pairs)
    if any(isinstance(pair, str) or len(pair) != 2 for pair in result):
        raise ValueError(f"{kind}s along two axes must be pairs of names, such as [('x', 'y')], got {pairs!r}")
    unique(kind, (known(kind, name, names) for pair in result for name in pair))
    return tuple((first, second) for first, second in result)


def units_of(kind: str, units: Iterable[str], names: Collection[str]) -> tuple[str, ...]:
    """Return the units of named signals, one each; "" for each where none is given.

    Args:
        kind: what the names belong to, for error messages
        units: the units, one each or none
        names: the names

    Raises:
        ValueError: for a single text, and for another number of units
    """
    result = several("units", units) or ("",) * len(names)
    if len(result) != len(names):
        raise ValueError(f"one unit per {kind}, or none: got {len(result)} units for {len(names)} {kind}s")
    return result


def instances(label: str, value: Any, kinds: tuple[type, ...]) -> tuple[Any, ...]:
    """Return a sequence as a tuple, after checking the type of its elements.

    Args:
        label: what error messages call the sequence
        value: the sequence
        kinds: allowed types of the elements

    Raises:
        ValueError: if `value` is not a sequence or an element has another type
    """
    allowed = ", ".join(kind.__name__ for kind in kinds)
    if isinstance(value, (str, Mapping)) or not isinstance(value, Iterable):
        raise ValueError(f"{label} must be a tuple of {allowed}, got {type(value).__name__}; write (part,) for one")
    result = tuple(value)
    for part in result:
        if not isinstance(part, kinds):
            raise ValueError(f"{label} must be of {allowed}, got {part!r:.60}, a {type(part).__name__}")
    return result


def frozen_mapping(value: Mapping[str, Value] | None) -> Mapping[str, Value]:
    """Return a read-only copy of a mapping, which can be pickled and copied. None gives an empty mapping."""
    return MappingProxyType(dict(value or {}))


def _reduced_mapping(mapping: MappingProxyType[str, Any]) -> tuple[Any, tuple[dict[str, Any]]]:
    return frozen_mapping, (dict(mapping),)


copyreg.pickle(MappingProxyType, _reduced_mapping)


def freeze(instance: object, **fields: Any) -> None:
    """Set fields of a frozen dataclass in its own `__post_init__`, after they were checked.

    Nobody can change them in place: arrays and mappings that could be are copied, lists become tuples, also in each
    other. Tuples remain the ones that were given.
    """
    for name, value in fields.items():
        object.__setattr__(instance, name, _frozen(value))


def _frozen(value: Any) -> Any:
    if isinstance(value, Mapping):
        return frozen_mapping({key: _frozen(part) for key, part in value.items()})
    if isinstance(value, np.ndarray) and value.flags.writeable:
        value = value.copy()
        value.setflags(write=False)
    return tuple(map(_frozen, value)) if isinstance(value, list) else value
