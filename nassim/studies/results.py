"""Results of runs as labelled arrays of one layout: numbers, arrays, FRFs and histories."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from nassim.base.checks import Array
from nassim.base.storage import fingerprint
from nassim.signals.frf import FRF
from nassim.signals.time_history import TimeHistory

RUN, STATUS, MESSAGE, WALL_TIME = "run", "status", "message", "wall_time"
OWN = (RUN, STATUS, MESSAGE, WALL_TIME)
"""Names in the results of every study."""


@dataclass(frozen=True)
class Axis:
    """Labels along a dimension of results.

    Attributes:
        along: name of the dimension.
        values: numbers or texts, (n,).
        unit: unit of the numbers.
    """

    along: str
    values: tuple[Any, ...]
    unit: str = ""


@dataclass(frozen=True)
class Quantity:
    """Dimensions and type of one result.

    Attributes:
        dims: names of the dimensions, in order.
        shape: sizes of the dimensions.
        complex: whether the numbers are complex.
    """

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    complex: bool = False

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the numbers in files."""
        return np.dtype("<c16" if self.complex else "<f8")

    @property
    def size(self) -> int:
        """Size in bytes."""
        return int(np.prod(self.shape, dtype=int)) * self.dtype.itemsize


@dataclass(frozen=True)
class Layout:
    """Description of the results of a run, without the numbers. The results of runs with one layout fit in one array.

    Attributes:
        quantities: results by name.
        axes: labels of their dimensions by name.
    """

    quantities: Mapping[str, Quantity]
    axes: Mapping[str, Axis]

    def digest(self) -> str:
        """Return a hash of the layout, also of the order of its numbers, that is the same on all machines."""
        axes = {name: (axis.along, np.array(axis.values), axis.unit) for name, axis in self.axes.items()}
        return fingerprint(tuple(self.quantities.items()), axes)[:16]

    def arrays(self, data: bytes) -> dict[str, Array]:
        """Return the numbers of a run by name, each array in the shape of its quantity.

        Args:
            data: numbers as bytes.
        """
        result, place = {}, 0
        for name, quantity in self.quantities.items():
            part = np.frombuffer(data[place : place + quantity.size], quantity.dtype)
            result[name] = part.reshape(quantity.shape)
            place += quantity.size
        return result


def flatten_result(result: Any, taken: Collection[str]) -> tuple[Layout, bytes]:
    """Return the layout of a function's result, and its numbers as bytes.

    A single number or array is named "result", an FRF "frf", a history "history". Dimensions of an array `name` are
    named `name_0`, `name_1`; those of FRFs `output`, `input`, `frequency`, and those of histories `signal`, `time`. The
    name of the result is put in front where another result of the run has different labels for the same dimension. All
    numbers become float64 or complex128.

    Args:
        result: return value of the function.
        taken: names of parameters, which no result and no dimension may have.

    Raises:
        TypeError: for other types of results.
        ValueError: for names that are taken, or that are used twice.
    """
    named = result if isinstance(result, Mapping) else {_default_name(result): result}
    if not named:
        raise ValueError("the function returned no result")
    quantities: dict[str, Quantity] = {}
    axes: dict[str, Axis] = {}
    names = [*taken, *OWN]
    data = []
    for name, value in named.items():
        if not isinstance(name, str) or not name or name in {*taken, *OWN}:
            raise ValueError(
                f"a result may not be called {name!r}: its name must be a text, other than a parameter's and {OWN}"
            )
        arrays, labels = _parts(name, value)
        renamed = _merge(axes, labels, name, {*taken, *OWN, *named})
        for part, (dims, array) in arrays.items():
            kind = np.iscomplexobj(array)
            numbers = np.asarray(array, "<c16" if kind else "<f8")
            quantities[part] = Quantity(tuple(renamed.get(d, d) for d in dims), numbers.shape, kind)
            data.append(numbers.tobytes())
        names += arrays
    _differ([*names, *{*axes, *(dim for quantity in quantities.values() for dim in quantity.dims)}])
    return Layout(quantities, axes), b"".join(data)


def _differ(names: Iterable[str]) -> None:
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise ValueError(
            f"results, their dimensions (of an array x: x_0, x_1, ...), coherences (of an FRF x: x_coherence) and "
            f"parameters need names of their own; two are called {', '.join(map(repr, twice))}: rename one"
        )


_Arrays = dict[str, tuple[tuple[str, ...], Array]]


def _default_name(result: Any) -> str:
    return {FRF: "frf", TimeHistory: "history"}.get(type(result), "result")


def _parts(name: str, value: Any) -> tuple[_Arrays, dict[str, Axis]]:
    """Return the arrays of one result with the names of their dimensions, and the axes of these dimensions."""
    if isinstance(value, FRF):
        axes = {
            "output": Axis("output", value.outputs),
            "input": Axis("input", value.inputs),
            "frequency": Axis("frequency", tuple(value.frequency.tolist()), "Hz"),
        }
        arrays: _Arrays = {name: (("output", "input", "frequency"), value.values)}
        if value.coherence is not None:
            arrays[f"{name}_coherence"] = (("output", "frequency"), value.coherence)
        return arrays, axes
    if isinstance(value, TimeHistory):
        axes = {
            "signal": Axis("signal", value.names),
            "signal_unit": Axis("signal", value.units),
            "time": Axis("time", tuple(value.time.tolist()), "s"),
        }
        return {name: (("signal", "time"), value.values)}, axes
    numbers = np.asarray(value)
    if numbers.dtype.kind not in "biufc":
        raise TypeError(
            f"{name!r} is a {type(value).__name__}; a function of a study returns a number, an array of numbers, an "
            "FRF, a TimeHistory, or a mapping of names to these"
        )
    return {name: (tuple(f"{name}_{i}" for i in range(numbers.ndim)), numbers)}, {}


def _merge(axes: dict[str, Axis], new: Mapping[str, Axis], name: str, taken: Collection[str]) -> dict[str, str]:
    """Add axes to those of earlier results; return the new names of those that had to be renamed."""
    clash = any(key in taken or axes.get(key, axis) != axis for key, axis in new.items())
    renamed = {key: f"{name}_{key}" for key in new} if clash else {}
    for key, axis in new.items():
        axes[renamed.get(key, key)] = Axis(renamed.get(axis.along, axis.along), axis.values, axis.unit)
    return renamed
