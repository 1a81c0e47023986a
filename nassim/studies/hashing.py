"""Hashes of values that are the same in every process."""

import copyreg
import pickle
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from types import BuiltinFunctionType, CodeType, FunctionType
from typing import Any

import numpy as np

from nassim.base.storage import fingerprint


def content_hash(value: Any) -> str:
    """Return the hash of a value, 16 digits.

    Pickles of sets and of the classes and functions of a script differ between processes. Sets are therefore hashed
    without order, and such classes and functions by name. Objects that cannot be pickled (locks, files), and random
    generators, whose state changes with every draw, are hashed by type only.

    Args:
        value: any object.
    """
    return fingerprint(_plain(value, ()))[:16]


def code_text(code: CodeType) -> str:
    """Return a text for compiled code without source; equal code has equal text."""
    constants = [code_text(c) if isinstance(c, CodeType) else c for c in code.co_consts]
    return repr((code.co_code, code.co_names, constants))


def _plain(value: Any, above: tuple[int, ...]) -> Any:
    """Return a value in the form that `fingerprint` takes; above: ids of its containers, which it may contain again."""
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
    """Return the parts of a value, without its type."""
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
