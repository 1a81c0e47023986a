"""Runs of a study: all combinations of a grid, or rows of samples. A run is named by its parameters."""

import hashlib
import itertools
import json
import math
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nassim.base.checks import frozen_mapping
from nassim.studies.results import OWN, RUN
from nassim.studies.samples import Samples, parameter_names

Parameters = dict[str, Any]
"""Parameters of one run by name: numbers, texts, truth values."""


@dataclass(frozen=True)
class Plan:
    """Runs of a study.

    Attributes:
        values: values of each parameter, as Python's own numbers, texts or truth values.
        grid: True for all combinations, with one dimension per parameter; False for rows along the dimension `run`.
        label: how the values were chosen.
    """

    values: Mapping[str, tuple[Any, ...]]
    grid: bool
    label: str

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions of the results."""
        return tuple(self.values) if self.grid else (RUN,)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the results."""
        lengths = tuple(map(len, self.values.values()))
        return lengths if self.grid else lengths[:1]

    def __len__(self) -> int:
        """Number of runs."""
        return math.prod(self.shape)

    def runs(self) -> Iterator[Parameters]:
        """Yield the parameters of each run; the last parameter of a grid varies fastest."""
        columns = self.values.values()
        rows = itertools.product(*columns) if self.grid else zip(*columns, strict=True)
        return (dict(zip(self.values, row, strict=True)) for row in rows)


def make_plan(grid: Mapping[str, Any] | None, samples: Samples | Mapping[str, Any] | None) -> Plan:
    """Return the plan of a grid or of samples.

    Args:
        grid: values by name of the parameter, or None.
        samples: samples, or columns by name of the parameter, or None.

    Raises:
        ValueError: for both or neither of them, and for invalid ones.
    """
    if (grid is None) == (samples is None):
        raise ValueError("give a study either grid= or samples=, mappings of parameters' names to their values")
    given = grid if samples is None else samples
    label = "grid" if samples is None else (given.plan if isinstance(given, Samples) else "")
    columns = {n: given[n].tolist() for n in given.names} if isinstance(given, Samples) else given
    if not isinstance(columns, Mapping):
        kind = "grid must be" if samples is None else "samples must be Samples or"
        raise ValueError(f"{kind} a mapping of parameters' names to their values, got {type(given).__name__}")
    parameter_names(tuple(columns))
    values = {name: _values(name, column) for name, column in columns.items()}
    lengths = {name: len(column) for name, column in values.items()}
    if reserved := [name for name in values if name in OWN]:
        raise ValueError(f"no parameter can be called {reserved}: results of studies have {', '.join(OWN)}")
    if empty := [name for name, length in lengths.items() if length == 0]:
        raise ValueError(f"the study has no run: there is no value of {', '.join(empty)}")
    if samples is None:
        for name, column in values.items():
            if twice := [value for value, count in Counter(column).items() if count > 1]:
                raise ValueError(f"values of a grid must differ; more than once in {name!r}: {twice}")
    elif len(set(lengths.values())) > 1:
        raise ValueError(f"samples need one value of every parameter per run, got as many as {lengths}")
    return Plan(frozen_mapping(values), samples is None, label)


def _values(name: str, column: Any) -> tuple[Any, ...]:
    if (
        isinstance(column, str)
        or not isinstance(column, (Sequence, np.ndarray, range))
        or getattr(column, "ndim", 1) == 0
    ):
        raise ValueError(f"values of {name!r} must be a list or an array, got {column!r:.60}; write [{column!r:.60}]")
    values = tuple(v.item() if isinstance(v, np.generic) else v for v in column)
    kinds = {float if type(v) is int else type(v) for v in values}
    if not kinds <= {float, str, bool} or len(kinds) > 1:
        raise ValueError(
            f"values of {name!r} must all be numbers, or all texts, or all truth values, got "
            f"{', '.join(sorted({type(v).__name__ for v in values}))}; sweep over names, and look up objects inside"
        )
    if wrong := [v for v in values if kinds == {float} and not abs(v) <= sys.float_info.max]:
        raise ValueError(f"values of {name!r} must be finite, got {wrong[0]!s:.60}")
    return values


def run_key(parameters: Parameters) -> str:
    """Return the name of a run: a hash of its parameters in any order, the same for 1, 1.0 and NumPy's 1.

    Args:
        parameters: parameters of the run.
    """
    plain = {name: _canonical(parameters[name]) for name in sorted(parameters)}
    return hashlib.sha256(json.dumps(plain).encode()).hexdigest()[:32]


def _canonical(value: Any) -> Any:
    exact = type(value) is int and abs(value) > 2**53
    return (value + 0.0).hex() if isinstance(value, (int, float)) and not (exact or isinstance(value, bool)) else value


def run_seed(seed: int, key: str) -> int:
    """Return the 64-bit seed of a run from those of the study and the run's name, independent of order and machine.

    Args:
        seed: seed of the study.
        key: name of the run.
    """
    entropy = [int(key[i : i + 8], 16) for i in range(0, len(key), 8)]
    return int(np.random.SeedSequence([seed, *entropy]).generate_state(1, np.uint64)[0])
