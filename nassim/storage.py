"""Saving nassim's nouns to HDF5, and a cache that recomputes when its inputs change."""

import hashlib
import importlib
import importlib.metadata
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np

from nassim.notices import warn

FORMAT_VERSION = 1
PACKAGE = Path(__file__).parent
LIBRARIES = ("netgen-mesher", "ngsolve", "numpy", "scipy", "pypardiso", "mkl")

Noun = TypeVar("Noun")


def save(obj: object, path: str | Path) -> Path:
    """Write a noun of nassim (TimeHistory, FRF, ReducedBody, ...) to an HDF5 file.

    The file appears whole or not at all: it is written under another name and then moved in place.
    Raises ValueError for objects that are not dataclasses of nassim.
    """
    with written_whole(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs["nassim_format"] = FORMAT_VERSION
        _write(file, "content", obj)
    return Path(path)


@contextmanager
def written_whole(path: str | Path) -> Iterator[Path]:
    """Give a temporary path to write to, which is moved to `path` at the end, or removed when an error comes first."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(suffix=".tmp", prefix=target.name, dir=target.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp lets only its owner read; a cache may be shared.
        temporary.chmod(0o644)
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


def load(path: str | Path) -> Any:
    """Read what `save` wrote.

    Raises FileNotFoundError, or ValueError naming the file when it is damaged or of a newer format.
    """
    source = Path(path)
    if not source.exists():
        raise FileNotFoundError(f"no such file: {source}")
    try:
        with h5py.File(source, "r") as file:
            version = int(file.attrs.get("nassim_format", 0))
            if version == 0:
                raise ValueError("it was not written by nassim.save")
            if version > FORMAT_VERSION:
                raise ValueError(f"it has format {version}, this nassim reads up to {FORMAT_VERSION}; upgrade nassim")
            return _read(file["content"])
    except (OSError, KeyError, TypeError, ValueError, AttributeError, ImportError, RuntimeError) as error:
        raise ValueError(f"cannot read {source}: {error}") from error


def cache_directory() -> Path:
    """Folder of cached reductions: the environment variable NASSIM_CACHE, else ~/.cache/nassim."""
    return Path(os.environ.get("NASSIM_CACHE", Path.home() / ".cache" / "nassim"))


def cached(name: str, key: str, build: Callable[[], Noun], *, progress: bool = True) -> Noun:
    """Return `build()`, or what it returned earlier for the same name and key.

    key: a `fingerprint` of everything that the result depends on
    progress: print whether the result was loaded or computed, and where it lies

    Warnings that the result remembers in its `record` are given again when it is loaded. A damaged file is reported and
    rebuilt. A folder that cannot be written is warned of before the work, whose result is then not kept.
    """
    path = cache_directory() / f"{name}-{key[:16]}.h5"

    def tell(message: str) -> None:
        if progress:
            print(f"{name}: {message}", flush=True)

    if os.path.exists(path):
        try:
            result: Noun = load(path)
        except ValueError as error:
            tell(f"the cached file is damaged and will be rebuilt ({error})")
        else:
            tell(f"loaded from {path} (same inputs)")
            record = getattr(result, "record", {})
            if "finite element model" in record:
                tell(record["finite element model"])
            for message in record.get("warnings", "").splitlines():
                warn(message, stacklevel=3)
            return result
    problem = _why_not_writable(path.parent)
    if problem:
        warn(
            f"the cache folder {path.parent} cannot be written ({problem}), so {name} will be computed but not kept; "
            "set the environment variable NASSIM_CACHE to a folder that can",
            stacklevel=3,
        )
        return build()
    result = build()
    try:
        save(result, path)
    except OSError as error:
        warn(f"{name} could not be kept in the cache folder {path.parent}: {error}", stacklevel=3)
    else:
        tell(f"saved to {path}")
    return result


def _why_not_writable(folder: Path) -> str:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        return str(error)
    return ""


def fingerprint(*parts: object) -> str:
    """SHA-256, as hex digits, of nested dataclasses, mappings, sequences, arrays, numbers and text."""
    digest = hashlib.sha256()
    for part in parts:
        _update(digest, part)
    return digest.hexdigest()


def code_fingerprint() -> str:
    """SHA-256 of what computes a reduction: all sources of nassim, and the versions of the libraries beneath."""
    sources = {path.relative_to(PACKAGE).as_posix(): path.read_bytes() for path in PACKAGE.rglob("*.py")}
    return fingerprint(sources, {name: _version(name) for name in LIBRARIES})


def _version(library: str) -> str:
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def _update(digest: Any, part: object) -> None:
    digest.update(type(part).__name__.encode() + b":")
    if is_dataclass(part):
        for item in fields(part):
            digest.update(item.name.encode())
            _update(digest, getattr(part, item.name))
    elif isinstance(part, Mapping):
        digest.update(str(len(part)).encode())
        for key in sorted(part):
            _update(digest, key)
            _update(digest, part[key])
    elif isinstance(part, (tuple, list)):
        digest.update(str(len(part)).encode())
        for item in part:
            _update(digest, item)
    elif isinstance(part, np.ndarray):
        digest.update(f"{part.dtype}{part.shape}".encode() + np.ascontiguousarray(part).tobytes())
    elif isinstance(part, bytes):
        digest.update(str(len(part)).encode() + b":" + part)
    elif part is None or isinstance(part, (str, bool, int, float, np.generic)):
        digest.update(repr(part).encode())
    else:
        raise ValueError(f"cannot make a fingerprint of {type(part).__name__}")


def _write(parent: Any, name: str, value: object) -> None:
    if is_dataclass(value) and type(value).__module__.startswith("nassim."):
        group = parent.create_group(name)
        group.attrs["kind"] = "dataclass"
        group.attrs["type"] = f"{type(value).__module__}:{type(value).__qualname__}"
        for item in fields(value):
            if item.init:
                _write(group, item.name, getattr(value, item.name))
    elif isinstance(value, Mapping):
        group = parent.create_group(name)
        group.attrs["kind"] = "mapping"
        _write(group, "keys", tuple(value))
        _write(group, "values", tuple(value.values()))
    elif isinstance(value, (tuple, list)) and value and all(isinstance(item, str) for item in value):
        parent.create_dataset(name, data=list(value), dtype=h5py.string_dtype())
    elif isinstance(value, (tuple, list)):
        group = parent.create_group(name)
        group.attrs["kind"] = "tuple"
        for index, item in enumerate(value):
            _write(group, str(index), item)
    elif value is None:
        parent.create_group(name).attrs["kind"] = "none"
    elif isinstance(value, (str, bool, int, float, complex, np.ndarray, np.generic)):
        parent.create_dataset(name, data=value)
    else:
        raise ValueError(f"cannot save {type(value).__name__} ({name}): only nouns of nassim, arrays, numbers and text")


def _read(item: Any) -> Any:
    if isinstance(item, h5py.Dataset):
        if h5py.check_string_dtype(item.dtype):
            text = item.asstr()[()]
            return text if isinstance(text, str) else tuple(text.tolist())
        value = item[()]
        return value.item() if isinstance(value, np.generic) else value
    kind = item.attrs["kind"]
    if kind == "none":
        return None
    if kind == "tuple":
        return tuple(_read(item[str(index)]) for index in range(len(item)))
    content = {name: _read(item[name]) for name in item}
    if kind == "mapping":
        return dict(zip(content["keys"], content["values"], strict=True))
    module, _, type_name = item.attrs["type"].partition(":")
    if not module.startswith("nassim."):
        raise ValueError(f"it holds a {module}.{type_name}, which is not of nassim")
    noun: Any = getattr(importlib.import_module(module), type_name)
    if not (isinstance(noun, type) and is_dataclass(noun)):
        raise ValueError(f"{module}.{type_name} is not a noun of nassim")
    return noun(**content)
