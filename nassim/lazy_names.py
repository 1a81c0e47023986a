"""Public names of a package, loaded when used; an error tells which other package has a name that it lacks."""

import importlib
from collections.abc import Callable
from difflib import get_close_matches
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import lazy_loader

STUBS = sorted(Path(__file__).parent.glob("*/__init__.pyi"))
PACKAGES = ("nassim", *(f"nassim.{stub.parent.name}" for stub in STUBS))
"""Packages with public names."""


def attach_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package that has a stub.

    Args:
        package: its `__name__`.
        file: its `__file__`.
    """
    load, list_names, public = lazy_loader.attach_stub(package, file)

    def get(name: str) -> Any:
        try:
            return load(name)
        except AttributeError:
            raise missing_name(package, name, public) from None

    return get, list_names, public


def missing_name(package: str, name: str, public: list[str]) -> AttributeError | ImportError:
    """Return the error for a name that a package lacks.

    It is an ImportError for a name of another package, because `from ... import` shows no AttributeError's message.

    Args:
        package: the package.
        name: the name.
        public: names of the package.
    """
    if not name.startswith("_") and find_spec(f"{package}.{name}") is None:
        homes = [home for home in PACKAGES if name in importlib.import_module(home).__all__]
        if homes:
            return ImportError(f"{package} has no {name!r}, but {homes[0]} has: from {homes[0]} import {name}")
    near = "".join(f"; did you mean {found!r}?" for found in get_close_matches(name, public, 1))
    return AttributeError(f"module {package!r} has no attribute {name!r}{near}")
