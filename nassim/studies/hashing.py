"""What a value holds, as a hash that is the same in every process."""

import copyreg
import pickle
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from types import BuiltinFunctionType, CodeType, FunctionType
from typing import Any

import numpy as np

from nassim.base.storage import fingerprint


def content(value: Any) -> str:
    """Hash of a value, 16 digits.

    Sets have no order, and a script's classes and functions are known by their names, while pickles of both differ from
    process to process. Of what does not travel (locks, files) and of generators of random numbers, whose state moves
    on with every draw, only the kind counts.
    """
    return fingerprint(_plain(value, ()))[:16]


def code_text(code: CodeType) -> str:
    """What a function does, where there is no source: the same text for the same code."""
    constants = [code_text(c) if isinstance(c, CodeType) else c for c in code.co_consts]
    return repr((code.co_code, code.co_names, constants))


def _plain(value: Any, above: tuple[int, ...]) -> Any:
    """A value as `fingerprint` takes it; above: ids of what it is part of, which it may hold again."""
    if value is None or isinstance(value, (str, bytes, bool, int, float, np.generic)):
        return value
    if isinstance(value, np.ndarray) and value.dtype != object:
        return value
    kind = type(value).__name__
    if id(value) in above:
        return [kind, above.index(id(value))]
    above = (*above, id(value))
    if isinstance(value, (Mapping, set, frozenset)):
        items = value.items() if isinstance(value, Mapping) else value
        return [kind, sorted(fingerprint(_plain(item, above)) for item in items)]
    return [kind, *(_plain(part, above) for part in _parts(value))]


def _parts(value: Any) -> Iterable[Any]:
    """What a value is made of, beside its kind."""
    if isinstance(value, (tuple, list, np.ndarray)):
        return value
    if is_dataclass(value) and not isinstance(value, type):
        return [getattr(value, field.name) for field in fields(value)]
    if isinstance(value, FunctionType):
        around = [cell.cell_contents for cell in value.__closure__ or ()]
        return [value.__module__, value.__qualname__, code_text(value.__code__), *around]
    if isinstance(value, (type, BuiltinFunctionType)):
        return [value.__module__, value.__qualname__]
    if isinstance(value, (np.random.Generator, np.random.RandomState)):
        return ()
    reduce = copyreg.dispatch_table.get(type(value))
    try:
        pieces = reduce(value) if reduce else value.__reduce_ex__(pickle.HIGHEST_PROTOCOL)
    except Exception:  # a lock, a file
        pieces = ()
    return [list(piece) if isinstance(piece, Iterator) else piece for piece in pieces]
