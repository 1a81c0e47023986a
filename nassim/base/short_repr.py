"""One-line representations of data classes that hold arrays and other data classes."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any

import numpy as np

LONGEST = 280
"""Number of characters of the longest representation."""
SHORT_TEXT, FEW = 40, 6
"""Number of characters of a text, and of items of an array, tuple or mapping, that are written out."""


def short_repr(self: Any) -> str:
    """Represent a data class by its type and its fields, with shapes in place of large arrays.

    Private fields, and those that are empty or have their default, are left out. Write `__repr__ = short_repr` in the
    class.

    Args:
        self: instance of a data class

    Returns:
        One line of at most `LONGEST` characters, such as
        `TimeHistory(time=[0 ... 2] (20001), values=array (2, 20001), names=('force', 'encoder'), units=('N', 'm'))`.
    """
    public = [f for f in fields(self) if f.repr and not f.name.startswith("_")]
    shown = [f for f in public if not _is_default(f, getattr(self, f.name))]
    text = f"{type(self).__name__}({', '.join(f'{f.name}={_short(getattr(self, f.name))}' for f in shown)})"
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 5]} ...)"


class ShortRepr:
    """Base class of data classes that are represented by `short_repr`, unless they define `__repr__` themselves."""

    def __init_subclass__(cls) -> None:
        if "__repr__" not in vars(cls):
            cls.__repr__ = short_repr  # type: ignore[method-assign]  # which `dataclass` then keeps


def _is_default(described: "Field[Any]", value: Any) -> bool:
    if isinstance(value, (tuple, Mapping)) and not value:
        return True
    default = described.default_factory() if described.default_factory is not MISSING else described.default
    if default is MISSING or type(default) is not type(value):
        return False
    return bool(np.array_equal(default, value)) if isinstance(value, np.ndarray) else bool(default == value)


def _short(value: Any) -> str:
    match value:
        case np.ndarray():
            return _short_array(value)
        case str():
            text = repr(value if len(value) <= SHORT_TEXT else value[:SHORT_TEXT] + "...")
        case float():
            text = f"{value:.6g}"
        case Mapping():
            names = [_short(key) for key in value]
            text = "{" + ", ".join(names if len(names) <= FEW else [*names[:FEW], f"... {len(names)} in all"]) + "}"
        case tuple() | list():
            text = _short_sequence(value)
        case _ if is_dataclass(value) and not isinstance(value, type):
            name = getattr(value, "name", None)
            text = f"{type(value).__name__}({name!r})" if isinstance(name, str) else type(value).__name__
        case _:
            text = repr(value)
            text = text if len(text) <= SHORT_TEXT else f"<{type(value).__name__}>"
    return text


def _short_array(array: Any) -> str:
    if array.size <= FEW and array.ndim == 1 and array.dtype.kind in "biufc":
        return "[" + " ".join(f"{x:.6g}" for x in array) + "]"
    if array.ndim == 1 and array.dtype.kind in "iuf":
        return f"[{array[0]:.6g} ... {array[-1]:.6g}] ({len(array)})"
    return f"array {array.shape}"


def _short_sequence(values: tuple[Any, ...] | list[Any]) -> str:
    if len(values) > FEW and all(isinstance(value, str) for value in values):
        return f"({', '.join(map(_short, values[:FEW]))}, ... {len(values)} in all)"
    if len(values) > FEW or any(isinstance(value, (np.ndarray, tuple, list, Mapping)) for value in values):
        kinds = Counter(type(value).__name__ for value in values)
        return "(" + ", ".join(f"{number} {kind}" for kind, number in kinds.items()) + ")"
    items = ", ".join(map(_short, values))
    return f"({items},)" if len(values) == 1 else f"({items})"
