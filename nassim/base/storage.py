"""Storage of nassim's data classes in HDF5 files, and a cache that recomputes a result when its inputs change."""

import errno
import hashlib
import importlib.metadata
import io
import os
import platform
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, overload

import h5py
import numpy as np
import psutil

from nassim.base.file_registry import find, is_data_class, upgrade_fields
from nassim.base.progress import tell
from nassim.base.warning_log import warn

FORMAT_VERSION = 4
"""Format of files. Format 1, of nassim 0.1, has no checksum.

Formats 1 and 2 name data classes together with a module, as in "nassim.signals:TimeHistory". Up to format 3, a body's
geometric stiffness has one array.
"""
SEAL_SIZE = 512
"""Bytes before the HDF5 image, which HDF5 leaves to applications (its user block); they hold the image's SHA-256."""
NUMBERS = "biufc"
"""Kinds of NumPy's types that files hold as arrays and numbers."""
NUMERIC = (bool, int, float, complex, np.ndarray, np.generic)
"""Python's and NumPy's types of values that may be of these kinds."""
TEXT_SIZE = 16
"""Bytes in an HDF5 dataset per text of variable length: its length and the address of its characters."""
PACKAGE = Path(__file__).parents[1]
LIBRARIES = ("netgen-mesher", "ngsolve", "numpy", "scipy", "cvxopt", "mkl")

DataClass = TypeVar("DataClass")


def save(obj: object, path: str | Path) -> Path:
    """Write a data class (TimeHistory, FRF, ReducedBody, ..., registered ones) to an HDF5 file with a checksum.

    The file is written completely or not at all: it is made in memory, written under a temporary name and then moved.

    Args:
        obj: the data class to save
        path: of the file

    Returns:
        Path of the file.

    Raises:
        ValueError: for dataclasses that are not in `nassim.base.file_registry` and for objects that files cannot hold
        OSError: if the file cannot be written; the message names the file
    """
    # When HDF5 itself writes to a full disk, it terminates the interpreter.
    image = io.BytesIO()
    with h5py.File(image, "w", userblock_size=SEAL_SIZE) as file:
        file.attrs["nassim_format"] = FORMAT_VERSION
        _write(file, "content", obj)
    content = image.getbuffer()
    content[:SEAL_SIZE] = _seal(hashlib.sha256(content[SEAL_SIZE:]))
    with write_atomically(path) as temporary:
        temporary.write_bytes(content)
    return Path(path)


@contextmanager
def write_atomically(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path to write to, which is moved to `path` at the end, or removed after an error.

    Temporary files that terminated processes left in the folder are removed too.

    Raises:
        OSError: if `path` cannot be written; the message names it
    """
    target = Path(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        host = re.sub(r"\W", "_", platform.node())
        _remove_stale(target.parent, host)
        handle, name = tempfile.mkstemp(suffix=".tmp", prefix=f"nassim-{host}-{os.getpid()}-", dir=target.parent)
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            # A file of mkstemp can be read by its owner only, but a cache may be shared.
            temporary.chmod(0o644)
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        cause = f"cannot be written: {error.strerror or error}"
        raise OSError(error.errno or errno.EIO, cause, str(target)) from error


def _remove_stale(folder: Path, host: str) -> None:
    """Remove temporary files that terminated processes of this computer left."""
    for path in folder.glob("nassim-*.tmp"):
        name = re.fullmatch(rf"nassim-{host}-(\d{{1,9}})-\w*\.tmp", path.name)
        if name and not psutil.pid_exists(int(name[1])):
            with suppress(OSError):  # the file may belong to another user
                path.unlink()


@overload
def load(path: str | Path) -> Any: ...
@overload
def load(path: str | Path, *, as_: type[DataClass]) -> DataClass: ...
def load(path: str | Path, *, as_: type[Any] | None = None) -> Any:
    """Read what `save` wrote.

    The checksum is compared first, except in files of format 1, which have none. Content that `save` does not write,
    such as links and external or compressed data, is refused. A foreign file can therefore neither read other files nor
    ask for more memory than its own size. Only registered data classes are made, by their own constructors.

    Args:
        path: of the file
        as_: class of the object that the file should hold, such as `TimeHistory`; type checkers then know its type

    Returns:
        The object.

    Raises:
        FileNotFoundError: if there is no such file
        ValueError: if the file is damaged, foreign, of a newer format, or holds another class than `as_`; the message
            names the file
    """
    found = _read(path)
    if as_ is not None and not isinstance(found, as_):
        kind = type(found).__name__
        raise ValueError(f"{path} holds a {kind}, not a {as_.__name__}; load it with as_={kind}, or without as_")
    return found


def _read(path: str | Path) -> Any:
    source = Path(path)
    if not source.exists():
        raise FileNotFoundError(f"no such file: {source}")
    try:
        sealed = _check_seal(source)
        with h5py.File(source, "r") as file:
            version = int(_attribute(file, "nassim_format") if "nassim_format" in file.attrs else 0)
            if version < 1:
                raise ValueError("it was not written by nassim.save")
            if version > FORMAT_VERSION:
                raise ValueError(f"it has format {version}, this nassim reads up to {FORMAT_VERSION}; upgrade nassim")
            if version > 1 and not sealed:
                raise ValueError("its checksum is missing")
            return _Reader(source.stat().st_size, version).child(file, "content")
    except Exception as error:  # constructors may raise any error for wrong fields
        raise ValueError(f"cannot read {source}: {error or type(error).__name__}") from error


def _seal(digest: Any) -> bytes:
    """Return the bytes at the start of a file that hold its checksum."""
    return f"nassim, SHA-256 of what follows byte {SEAL_SIZE}: {digest.hexdigest()}\n".encode().ljust(SEAL_SIZE, b"\0")


def _check_seal(source: Path) -> bool:
    """Return whether a file begins with a checksum; raise ValueError if it differs from that of the content."""
    if not source.is_file():
        raise ValueError("it is not a file")
    with source.open("rb") as stream:
        seal = stream.read(SEAL_SIZE)
        if seal.startswith(b"\x89HDF"):
            return False
        digest = hashlib.sha256()
        while block := stream.read(2**20):
            digest.update(block)
    if not seal.startswith(b"nassim"):
        raise ValueError(
            "it was not written by nassim.save, or is damaged at its start; read_record and read_frf read measured "
            "data, nassim.exchange.read_superelement the matrices of other programs"
        )
    if seal != _seal(digest):
        raise ValueError("it is damaged or was edited: its content does not match its checksum")
    return True


def cache_directory() -> Path:
    """Return the folder of cached results: the environment variable NASSIM_CACHE, otherwise ~/.cache/nassim."""
    return Path(os.environ.get("NASSIM_CACHE", Path.home() / ".cache" / "nassim"))


def load_or_compute(name: str, key: str, build: Callable[[], DataClass], *, progress: bool = True) -> DataClass:
    """Return `build()`, or its earlier result for the same name and key from the cache.

    Warnings in the `record` of a result are given again when it is loaded. A damaged file is reported and rebuilt. If
    the folder cannot be written, a warning is given before the work and the result is not kept.

    Args:
        name: name of the result, part of the file's name
        key: a `fingerprint` of all inputs of the result
        build: function that computes the result
        progress: print whether the result was loaded or computed, and the path of its file
    """
    path = cache_directory() / f"{name}-{key[:16]}.h5"

    def report(message: str) -> None:
        if progress:
            tell(f"{name}: {message}", indent="")

    if os.path.exists(path):
        try:
            result: DataClass = load(path)
        except ValueError as error:
            report(f"the cached file is damaged and will be rebuilt ({error})")
        else:
            report(f"loaded from {path} (same inputs)")
            record = getattr(result, "record", {})
            if progress and "finite element model" in record:
                tell(f"{name}: {record['finite element model']}", indent="")
            for message in record.get("warnings", "").splitlines():
                warn(message)
            return result
    problem = _why_not_writable(path.parent)
    if problem:
        warn(
            f"the cache folder {path.parent} cannot be written ({problem}), so {name} will be computed but not kept; "
            "set the environment variable NASSIM_CACHE to a folder that can"
        )
        return build()
    result = build()
    try:
        save(result, path)
    except OSError as error:
        warn(f"{name} could not be kept in the cache folder {path.parent}: {error}")
    else:
        report(f"saved to {path}")
    return result


def _why_not_writable(folder: Path) -> str:
    """Return why a folder cannot be written, or an empty string."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        return str(error)
    return ""


def fingerprint(*parts: object) -> str:
    """Return the SHA-256 hex digest of nested dataclasses, mappings, sequences, arrays, numbers and text."""
    digest = hashlib.sha256()
    for part in parts:
        _update(digest, part)
    return digest.hexdigest()


def code_fingerprint() -> str:
    """Return the SHA-256 hex digest of nassim's sources, without `devices`, and the versions of its libraries."""
    paths = {*PACKAGE.rglob("*.py")} - {*PACKAGE.glob("devices/**/*.py")}
    sources = {path.relative_to(PACKAGE).as_posix(): path.read_bytes() for path in paths}
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
        digest.update(f"{part.dtype}{part.shape}".encode() + part.tobytes())
    elif isinstance(part, bytes):
        digest.update(str(len(part)).encode() + b":" + part)
    elif part is None or isinstance(part, (str, bool, int, float, np.generic)):
        digest.update(repr(part).encode())
    else:
        raise ValueError(f"cannot make a fingerprint of {type(part).__name__}")


def _write(parent: Any, name: str, value: object) -> None:
    if is_data_class(value):
        group = parent.create_group(name)
        group.attrs["kind"] = "dataclass"
        group.attrs["type"] = type(value).__name__
        for item in fields(value):
            if item.init:
                _write(group, item.name, getattr(value, item.name))
    elif is_dataclass(value) and not isinstance(value, type):
        raise ValueError(f"cannot save {type(value).__name__} ({name}): {_why_not_saved(type(value))}")
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
    elif isinstance(value, str) or (isinstance(value, NUMERIC) and np.asarray(value).dtype.kind in NUMBERS):
        parent.create_dataset(name, data=value)
    else:
        raise ValueError(
            f"cannot save {type(value).__name__} ({name}): files hold only data classes of nassim, registered "
            "dataclasses, arrays of numbers, numbers of up to 64 bits, text and tuples of these"
        )


def _why_not_saved(kind: type) -> str:
    """Return why files cannot hold a dataclass that is not registered, and what to do."""
    if kind.__module__.startswith("nassim."):
        return (
            "nassim keeps no such object in files; save what is made of it, such as the ReducedBody that "
            "craig_bampton makes of an FEModel"
        )
    return (
        "it is not registered; give a dataclass of your own to nassim.register, before saving and before loading: its "
        "fields can be registered dataclasses, arrays, numbers and text"
    )


class _Reader:
    """Reader of a file's tree that refuses what `save` does not write.

    Attributes:
        left: bytes of the file that have not been read
        version: format of the file
        seen: addresses of the objects that have been read
    """

    def __init__(self, size: int, version: int) -> None:
        self.left = size
        self.version = version
        self.seen: set[Any] = set()

    def child(self, group: Any, name: str) -> Any:
        """Return the value under a name of a group."""
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise ValueError(f"{name!r} is missing or a link to elsewhere")
        item = group[name]
        place = h5py.h5o.get_info(item.id).addr
        if place in self.seen:
            raise ValueError(f"{name!r} is in it twice")
        self.seen.add(place)
        return self.dataset(item) if isinstance(item, h5py.Dataset) else self.group(item)

    def dataset(self, item: Any) -> Any:
        """Return an array, a number or text."""
        text = h5py.check_string_dtype(item.dtype)
        known = text.length is None if text else item.dtype.kind in NUMBERS
        plan = item.id.get_create_plist()
        plain = plan.get_layout() in (h5py.h5d.CONTIGUOUS, h5py.h5d.COMPACT)
        if not (known and plain) or plan.get_external_count():
            raise ValueError(f"{item.name} is stored in a way that nassim.save does not use")
        if item.id.get_storage_size() != item.size * (TEXT_SIZE if text else item.id.get_type().get_size()):
            raise ValueError(f"{item.name} has shape {item.shape}, which is not the length of its data")
        if text:
            return self.text(item)
        self.take(item.size * item.dtype.itemsize)
        value = item[()]
        return value.item() if isinstance(value, np.generic) else value

    def text(self, item: Any) -> Any:
        """Return a text or a tuple of texts, read one by one because a length is known only after reading."""
        if item.ndim > 1:
            raise ValueError(f"{item.name} is a table of texts")
        if not item.shape:
            text = item.asstr()[()]
            self.take(len(text))
            return text
        # As item.asstr()[k], in a tenth of its time: the surface of a body has thousands of labels.
        one, place, held = h5py.h5s.create_simple((1,)), item.id.get_space(), np.empty(1, dtype=item.dtype)
        texts = []
        for k in range(len(item)):
            place.select_hyperslab((k,), (1,))
            item.id.read(one, place, held)
            texts.append(held[0].decode())
            self.take(len(texts[-1]))
        return tuple(texts)

    def take(self, size: int) -> None:
        """Count bytes that are read; raise ValueError if they exceed the size of the file."""
        self.left -= size
        if self.left < 0:
            raise ValueError("it claims to hold more data than it has bytes")

    def group(self, group: Any) -> Any:
        """Return None, a tuple, a mapping or a data class."""
        kind = _attribute(group, "kind")
        if kind == "none":
            return None
        if kind == "tuple":
            return tuple(self.child(group, str(index)) for index in range(len(group)))
        if kind == "mapping":
            return dict(zip(self.child(group, "keys"), self.child(group, "values"), strict=True))
        if kind != "dataclass":
            raise ValueError(f"{group.name} is of the kind {kind!r}, which this nassim does not know; upgrade nassim")
        name = _public_name(_attribute(group, "type"), self.version)
        data_class = find(name)
        content = {field: self.child(group, field) for field in group}
        if self.version < FORMAT_VERSION:
            content = upgrade_fields(name, content)
        return data_class(**content)


def _attribute(item: Any, name: str) -> Any:
    if item.attrs.get_id(name).shape != ():
        raise ValueError(f"its attribute {name!r} is not a single value")
    return item.attrs[name]


def _public_name(written: str, version: int) -> str:
    """Return the public name of a data class from the name written in a file of this format."""
    module, _, name = written.partition(":")
    return name if version < 3 and module.startswith("nassim.") else written
