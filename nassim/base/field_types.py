"""Types of arguments and fields: what a caller gives, and what an object holds.

The data classes take lists and single names, and hold read-only arrays and tuples. The annotation `Field[Given, Held]`
tells type checkers both, in the way of a descriptor: the constructor takes `Given`, and the attribute is `Held`. At run
time it is a note, which `help` shows as `Given`. Classes with such fields are decorated by `data_class`, because mypy
ignores descriptors without a default below `dataclass` itself; their defaults are written `held(...)`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from inspect import formatannotation
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

__all__ = [
    "Array",
    "ArrayField",
    "ArrayLike",
    "ClassArray",
    "Field",
    "NameList",
    "Names",
    "OptionalArray",
    "data_class",
    "held",
]

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray
    from typing_extensions import dataclass_transform

    DataClass = TypeVar("DataClass")
    Given = TypeVar("Given")
    Held = TypeVar("Held")
    Array = NDArray[Any]

    class Field(Generic[Given, Held]):
        """A field that takes one type and holds another."""

        held: Any

        def __get__(self, instance: object, owner: type[Any] | None = None) -> Held: ...
        def __set__(self, instance: object, value: Given) -> None: ...

    @dataclass_transform(frozen_default=True, field_specifiers=(field,))
    def data_class(cls: type[DataClass]) -> type[DataClass]:
        """Decorate a frozen dataclass that has such fields."""
        ...
else:
    from numpy import ndarray as Array

    class ArrayLike:
        """Numbers, or nested sequences of them; a name that `help` can print in place of numpy's long union."""

        __module__ = "numpy.typing"

    class Field:
        """A field that takes one type and holds another."""

        def __init__(self, given: Any, held: Any) -> None:
            self.given, self.held = given, held

        def __class_getitem__(cls, types: tuple[Any, Any]) -> "Field":
            return cls(*types)

        def __repr__(self) -> str:
            return formatannotation(self.given)

    data_class = dataclass(frozen=True)


class ClassArray:
    """Array that all instances share which have none of their own; `help` prints it in one line, not numpy's manual."""

    def __init__(self, values: Any) -> None:
        self.values = np.array(values, dtype=float)
        self.values.setflags(write=False)

    def __get__(self, instance: object, owner: type[Any] | None = None) -> Any:
        """Return the array of an instance, and this object of the class."""
        return self if instance is None else self.values

    def __repr__(self) -> str:
        """Return the values as nested lists."""
        return repr(self.values.tolist())


def held(default: Any) -> Any:
    """Return a field's default, or the function that makes it, as it is; type checkers accept it for any field."""
    return default


ArrayField = Field[ArrayLike, Array]
"""Takes numbers, holds a read-only array."""
OptionalArray = Field[ArrayLike | None, Array | None]
Names = Field[str | Sequence[str], tuple[str, ...]]
"""Takes a name or several, holds a tuple."""
NameList = Field[Sequence[str], tuple[str, ...]]
