"""Kinds of the fields of parts, bodies, terms and measures: names of points and signals, directions, positions."""

from typing import TYPE_CHECKING, Any

from nassim.base.checks import Array


class FieldKind(type):
    """Kind of a field of a part, a body, a term or a measure; `help` prints it as the type that a user gives.

    `placed` renames and rotates fields by their kind. A field may hold one of these, None, or a tuple of them.
    """


if TYPE_CHECKING:
    Path = str
    Signal = str
    Direction = Any
    AngularVelocity = Any
    Axes = Array
    Position = Array
else:

    def _kind(name: str, given: str) -> FieldKind:
        return FieldKind(name, (), {"__module__": "builtins", "__qualname__": given})

    Path = _kind("Path", "str")  # a point, port or body by name
    Signal = _kind("Signal", "str")  # an input or output by name
    Direction = _kind("Direction", "str | numpy.typing.ArrayLike")  # of the world's frame: "x", "y", "z" or a vector
    AngularVelocity = _kind("AngularVelocity", "numpy.typing.ArrayLike")  # in the world's frame
    Axes = _kind("Axes", "numpy.ndarray")  # columns, in the world's frame
    Position = _kind("Position", "numpy.ndarray")  # in the world's frame


def body_of(path: str) -> str:
    """Return the name of the body of a point "body.point"."""
    return path.partition(".")[0]


def point_of(path: str) -> str:
    """Return the name of the point in its body of a point "body.point"."""
    return path.partition(".")[2]
