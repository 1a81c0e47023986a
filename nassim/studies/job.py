"""Function of a study: check of its parameters, transport to other processes, and identity."""

import ast
import functools
import hashlib
import inspect
import pickle
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import CodeType, FunctionType, ModuleType
from typing import Any

from nassim.base.checks import whole_number
from nassim.base.storage import fingerprint
from nassim.studies.hashing import code_text, content_hash
from nassim.studies.outcome import Task
from nassim.studies.plan import Parameters, run_seed

Function = Callable[..., Any]
SEED = "seed"
CLASS = "class "
"""What the name of a class begins with in the identity of a study."""
DESCRIPTORS = (
    property,
    classmethod,
    staticmethod,
    functools.cached_property,
    functools.partialmethod,
    functools.singledispatchmethod,
)
DESCRIBED = ("fget", "fset", "fdel", "func", "__func__", "args", "keywords")
"""Attributes in which these hold what they were made of."""


@dataclass(frozen=True)
class Job:
    """Checked function of a study.

    Attributes:
        function: the function.
        task: the function as a task for other processes.
        seed: seed of the study, for functions with a parameter `seed`; None for others.
    """

    function: Function
    task: Task
    seed: int | None

    def arguments(self, parameters: Parameters, key: str) -> Parameters:
        """Return the arguments of the function for a run.

        Args:
            parameters: parameters of the run.
            key: name of the run.
        """
        return parameters if self.seed is None else {**parameters, SEED: run_seed(self.seed, key)}


def make_job(function: Function, names: tuple[str, ...], seed: int | None) -> Job:
    """Check that a function takes the parameters of a study by keyword.

    Args:
        function: the function.
        names: names of the parameters.
        seed: seed of the study, or None.

    Returns:
        Job with the function and the seed.

    Raises:
        ValueError: listing unknown and missing parameters, and for a seed that is not a whole number or that the
            function does not take.
    """
    if not callable(function):
        raise ValueError(f"a study needs a function, got {function!r:.60}, a {type(function).__name__}")
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{label(function)} has no signature that can be read; wrap it in a function with named parameters"
        ) from error
    keywords = {p.name: p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)}
    takes_any = any(p.kind is p.VAR_KEYWORD for p in parameters)
    known = f"{label(function)} takes {', '.join(keywords) or 'none'}"
    unknown = [name for name in names if name not in keywords]
    if unknown and not takes_any:
        raise ValueError(f"unknown parameters {', '.join(unknown)}: {known}")
    if seed is not None:
        seed = whole_number("seed", seed, 0)
        if SEED in names or (SEED not in keywords and not takes_any):
            why = "the study varies it" if SEED in names else known
            raise ValueError(f"seed is given to the function's parameter of that name, but {why}")
    given = {*names, *([SEED] if seed is not None else [])}
    missing = [p.name for p in keywords.values() if p.default is p.empty and p.name not in given]
    if missing or any(p.kind is p.POSITIONAL_ONLY and p.default is p.empty for p in parameters):
        what = f"values of {', '.join(missing)}" if missing else "arguments without a name"
        raise ValueError(
            f"{label(function)} needs {what} beside what the study gives ({', '.join(given)}): add them to the grid or "
            "samples, set seed=, or fix them with functools.partial"
        )
    return Job(function, Task(function, tuple(names)), seed)


def label(function: Function) -> str:
    """Return the name of a function with that of its module."""
    base = function.func if isinstance(function, functools.partial) else function
    base = base if hasattr(base, "__qualname__") else type(base)
    return f"{base.__module__}.{base.__qualname__}"


def pickle_task(job: Job) -> bytes:
    """Pickle the function with all values that it needs, once.

    Functions of importable modules are pickled by name. Other functions (of a script, a notebook, inside a function,
    lambdas) are pickled by value.

    Args:
        job: the job.

    Returns:
        Pickled task.

    Raises:
        ValueError: naming the values that cannot be pickled.
    """
    import cloudpickle  # noqa: PLC0415 -- of the extra `studies`

    try:
        return bytes(cloudpickle.dumps(job.task, protocol=pickle.HIGHEST_PROTOCOL))
    except Exception as error:
        cause = error
    culprits = []
    for name, value in values_in_function(job.function):
        try:
            cloudpickle.dumps(value)
        except Exception as error:
            culprits.append(f"{name}, a {type(value).__name__} ({error})")
    raise ValueError(
        f"{label(job.function)} cannot be sent to another process because of {', '.join(culprits) or cause}. Make such "
        "things inside the function, from numbers and paths, or give it data (arrays, a ReducedBody) by "
        'functools.partial; executor="serial" runs it here, one run after the other'
    ) from cause


def identity(job: Job) -> dict[str, Any]:
    """Return the identity of a study as plain data: function, hashes of its source and its values, and the seed.

    Args:
        job: the job.
    """
    inputs: dict[str, str] = {}
    source = _identify(job.function, inputs, {})
    return {"function": label(job.function), "source": source, "inputs": dict(sorted(inputs.items())), "seed": job.seed}


def values_in_function(function: Function) -> Iterator[tuple[str, Any]]:
    """Yield the values that a function needs in addition to its parameters, by name: fixed arguments, defaults,
    closures.

    Modules, classes and functions of other modules are omitted.
    """
    if isinstance(function, functools.partial):
        yield from ((f"argument {index}", value) for index, value in enumerate(function.args))
        yield from function.keywords.items()
        function = function.func
    if (owner := getattr(function, "__self__", None)) is not None and not isinstance(owner, ModuleType):
        yield "self", owner
    function = getattr(function, "__func__", function)
    if not isinstance(function, FunctionType):
        if not isinstance(function, type) and hasattr(function, "__dict__"):
            yield "self", function.__dict__
        return
    defaults, code = function.__defaults__ or (), function.__code__
    yield from zip(code.co_varnames[code.co_argcount - len(defaults) : code.co_argcount], defaults, strict=True)
    yield from (function.__kwdefaults__ or {}).items()
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            yield name, cell.cell_contents
        except ValueError:  # not filled yet
            continue
    for name in sorted(set(_names(function.__code__)) & set(function.__globals__)):
        value = function.__globals__[name]
        foreign = isinstance(value, FunctionType) and value.__module__ != function.__module__
        if not foreign and not isinstance(value, (ModuleType, type)):
            yield name, value


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _identify(function: Function, inputs: dict[str, str], seen: dict[int, int]) -> str:
    """Return the hash of a function's source, and enter its values in `inputs`, functions by their own source.

    seen: functions entered before by their ids, in order, because functions may refer to each other
    """
    for name, value in values_in_function(function):
        if not isinstance(value, FunctionType):
            found = content_hash(value)
        elif id(value) in seen:
            found = f"function {seen[id(value)]}"
        else:
            seen[id(value)] = len(seen)
            found = _identify(value, inputs, seen)
        _enter(name, found, inputs)
    for kind in _classes_beside(function):
        if id(kind) not in seen:
            _enter(f"{CLASS}{kind.__qualname__}", _identify_class(kind, seen), inputs)
    base = function.func if isinstance(function, functools.partial) else function
    return _source(getattr(base, "__func__", base))


def _enter(name: str, found: str, inputs: dict[str, str]) -> None:
    """Enter a hash. Several functions may use different values of the same name: all of them count."""
    inputs[name] = fingerprint(inputs[name], found)[:16] if name in inputs else found


def _identify_class(kind: type, seen: dict[int, int]) -> str:
    """Return the hash of a class: its source, its values, what its methods use, and the classes of which it is made."""
    seen[id(kind)] = len(seen)
    used: dict[str, str] = {}
    parts = []
    for part in (*_members(kind), *kind.__bases__, type(kind)):
        if isinstance(part, FunctionType):
            if part.__module__ == kind.__module__ and _has_file(part):
                parts.append(_identify(part, used, seen))
        elif not isinstance(part, type):
            parts.append(content_hash(part))
        elif part.__module__ == kind.__module__ and id(part) not in seen:
            parts.append(_identify_class(part, seen))
    return fingerprint(_source(kind), parts, sorted(used.items()))[:16]


def _members(kind: type) -> Iterator[Any]:
    """Yield the functions, classes and values of a class, those behind properties and the like among them."""
    for name, member in vars(kind).items():
        if isinstance(member, DESCRIPTORS):
            yield from (_unwrapped(getattr(member, part)) for part in DESCRIBED if hasattr(member, part))
        elif name == "__dataclass_fields__":
            yield from (part for field in member.values() for part in (field.default, field.default_factory))
        elif isinstance(found := _unwrapped(member), (FunctionType, type)) or not name.startswith("__"):
            yield found


def _unwrapped(value: Any) -> Any:
    """Return the function in a decorated one, and any other value as it is, without a call of its `__getattr__`."""
    while (inner := inspect.getattr_static(value, "__wrapped__", None)) is not None:
        value = inner
    return value


def _has_file(function: FunctionType) -> bool:
    """Whether a function was written, not made by a decorator such as that of data classes."""
    return not function.__code__.co_filename.startswith("<string>")


def _classes_beside(function: Function) -> Iterator[type]:
    """Yield the classes of its own module that a function names, and those of the values that it carries."""
    base = function.func if isinstance(function, functools.partial) else function
    base = getattr(base, "__func__", base)
    values = [function, *(value for _, value in values_in_function(function))]
    if isinstance(base, FunctionType):
        values += [base.__globals__[name] for name in sorted(set(_names(base.__code__)) & set(base.__globals__))]
    yield from _classes_in(values, getattr(base, "__module__", ""), set())


def _classes_in(value: Any, module: str, seen: set[int]) -> Iterator[type]:
    """Yield a class of a module, or the classes of a value and of all that is in it."""
    kind = value if isinstance(value, type) else type(value)
    own = kind.__module__ == module
    if own:
        yield kind
    if isinstance(value, type) or id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, Mapping):
        parts: Iterable[Any] = value.values()
    elif isinstance(value, (list, tuple)):
        parts = value
    else:
        parts = getattr(value, "__dict__", {}).values() if own else ()
    for part in parts:
        yield from _classes_in(part, module, seen)


def _source(base: Any) -> str:
    """Return the hash of the source of a function, a class or the class of an object; of code without a source."""
    code = getattr(base, "__code__", None)
    try:
        if code and code.co_filename == "<string>":
            raise OSError  # made by exec: under this name, Python 3.13 keeps the text of `python -c`
        source = inspect.getsource(base if code or isinstance(base, type) else type(base))
        text = ast.dump(ast.parse(textwrap.dedent(source)))
    except (OSError, TypeError, SyntaxError):  # of a console, or a lambda in the middle of a line
        text = code_text(code) if code else label(base)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
