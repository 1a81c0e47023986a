"""What the parts of a scene say to engines: a few neutral words. An engine knows the words and no kind of part.

To add a kind of sensor, actuator, spring or joint: write one frozen dataclass with the base class `Sensor`, `Actuator`,
`ForceElement` or `Connection` and its method `says`, anywhere. All engines (linear models, exact steps, floating
frames) then run it, summaries describe it and trimming keeps what it needs. An engine that meets a word it does not
know raises TypeError.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from nassim.base.checks import Array

if TYPE_CHECKING:
    from nassim.scene.scene import Scene


Path = Annotated[str, "path"]
Direction = Annotated[Any, "direction"]
Axes = Annotated[Array, "axes"]
Position = Annotated[Array, "position"]
Signal = Annotated[str, "signal"]
"""What a field of a part, a body or a word is, so that `placed` finds what to rename and to turn: a point, port or body
by name; a direction of the world's frame ("x", "y", "z" or a vector); axes as columns in the world's frame; a place in
the world; an input or output. Fields may be these, None, or tuples of them."""


@dataclass(frozen=True)
class Row:
    """A scalar motion of a scene, zero at its start.

    points: what motions of points count, ((path, weights on ux uy uz rx ry rz, (6,)), ...)
    frame: along whose axes these weights are.
        "": the world's, which do not turn.
        A point, "body.point": along axes that are the world's at the start and turn with the body there. Displacement
        is then that of the points' places in these axes, so that a common turn of all bodies is none; velocity and
        acceleration are those against inertial space, along these axes.
        The name of a flexible body that has all the points: along its own axes, where only its deformation counts.
        In large motion weights on rotations are those of one point, or opposite ones of two: the twist of the second
        against the first since the start, about an axis that turns with the first. A twist is what is left of a turn
        when the least one that brings the axis where it went is taken off: the whole turn about an axis that stays.
    own: what bodies' own coordinates count, ((name, weights (n,)), ...), on the coordinates of `FlexibleBody.reduced`;
        in large motion on those of the deformation beside the floating frame
    """

    points: tuple[tuple[str, Array], ...] = ()
    frame: str = ""
    own: tuple[tuple[str, Array], ...] = ()

    @property
    def paths(self) -> tuple[str, ...]:
        """Its points, and that of its frame."""
        return (*(path for path, _ in self.points), *((self.frame,) if "." in self.frame else ()))

    @property
    def within(self) -> str | None:
        """Name of the one body whose own shape is all that counts; None where there is no such body."""
        names = {name for name, _ in self.own} | ({self.frame} if self.points else set())
        name = names.pop() if len(names) == 1 else ""
        return name if name and "." not in name else None

    @classmethod
    def between(cls, a: str, b: str, direction: Array, *, frame: str = "", turns: bool = False) -> "Row":
        """Displacement of point b against point a along a direction, (3,), or its turn about it."""
        weights = np.roll(np.concatenate([direction, np.zeros(3)]), 3 * turns)
        return cls(((a, -weights), (b, weights)), frame)

    @classmethod
    def of_point(cls, path: str, direction: Array, *, frame: str = "", turns: bool = False) -> "Row":
        """Displacement of a point along a direction, (3,), or its turn about it."""
        return cls(((path, np.roll(np.concatenate([direction, np.zeros(3)]), 3 * turns)),), frame)


@dataclass(frozen=True)
class Line:
    """A scalar motion of a scene: how much farther apart two points are than at its start, wherever the line points."""

    a: Path
    b: Path

    @property
    def paths(self) -> tuple[str, ...]:
        """Its points."""
        return (self.a, self.b)

    @property
    def within(self) -> None:
        """No body's own shape alone."""
        return


@dataclass(frozen=True)
class Force:
    """An input pushes along a row: gain newtons (or what the row's dual is) per unit.

    bandwidth: of an amplifier between, a low-pass of first order, -3 dB [Hz]
    """

    input: Signal
    unit: str
    row: Row | Line
    gain: float = 1.0
    bandwidth: float = math.inf


@dataclass(frozen=True)
class Field:
    """An input accelerates everything that moves along a direction of the world's frame, (3,) per unit."""

    input: Signal
    unit: str
    direction: Direction


@dataclass(frozen=True)
class Reading:
    """An output reads a row: gain units per unit of the row's displacement, velocity or acceleration.

    What a part says of one output adds up: several readings, tensions and leaks.
    derivative: 0, 1 or 2
    inertial: of an acceleration: where a field accelerates everything, it is that against inertial space, and not that
        against the ground, as of a sensor in which a mass hangs
    """

    output: Signal
    unit: str
    row: Row | Line
    gain: float = 1.0
    derivative: int = 0
    inertial: bool = False


@dataclass(frozen=True)
class Filter:
    """What is read of an output passes a filter, as if it had always been at its first value; several in their order.

    passes: "low", "high" or, of second order, a "band" of frequencies; frequency: of its corner or resonance [Hz]
    damping_ratio: of a filter of second order, w^2, s^2 or w s over s^2 + 2 damping_ratio w s + w^2; None for the first
        order, w or s over s + w
    """

    output: Signal
    passes: str
    frequency: float
    damping_ratio: float | None = None


@dataclass(frozen=True)
class Spring:
    """A row is held by a spring [N/m] and a viscous damper [N s/m] in parallel."""

    row: Row | Line
    stiffness: float
    damping: float = 0.0


@dataclass(frozen=True)
class SixSprings:
    """Point b is held against point a by a spring and a damper in all six directions at once.

    axes: along which the six are counted, as columns, the world's frame at the start; they turn halfway between a, b
    stiffness, damping: on ux uy uz rx ry rz of b against a, (6, 6), symmetric, at the place of b
    """

    a: Path
    b: Path
    axes: Axes
    stiffness: Array
    damping: Array


@dataclass(frozen=True)
class Tension:
    """An output reads what a spring and its damper, which another part says, pull with: positive where they pull.

    direction: of six springs "x" ... "rz" of their axes, what they pull b with [N], [N m]; "" for one spring
    """

    output: Signal
    unit: str
    spring: Spring | SixSprings
    direction: str = ""


@dataclass(frozen=True)
class Leak:
    """The charge of an electrical port leaks through a resistance, and an output reads what it adds to the voltage.

    row: charge that the motion brings [C]; capacitance: of port and load [F]; resistance [Ohm]; gain: output per volt
    """

    output: Signal
    row: Row
    capacitance: float
    resistance: float
    gain: float


@dataclass(frozen=True)
class Constraint:
    """Point b does not move against point a along the directions held, which turn with the body of a.

    Where one turn is held and two are free, in large motion, "rz" keeps the x axis that turns with a perpendicular to
    the y axis that turns with b, "rx" a's y to b's z, and "ry" a's x to b's z.
    held: of "x" "y" "z" "rx" "ry" "rz"; axes: along which these are, as columns, the world's frame at the start
    """

    name: str
    a: Path
    b: Path
    held: tuple[str, ...]
    axes: Axes = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True)
class Follow:
    """A direction that a constraint leaves free is held as well, at what an input says or a constant speed makes.

    constraint: its name; direction: of its axes; input: name, "" for a constant speed; unit: of the input
    bandwidth: of a servo between input and motion, a low-pass of first order, -3 dB [Hz]
    """

    constraint: Signal
    direction: str
    input: Signal
    unit: str
    speed: float = 0.0
    bandwidth: float = math.inf


Word = Force | Field | Reading | Filter | Tension | Spring | SixSprings | Leak | Constraint | Follow


def unknown_word(word: object, engine: str) -> TypeError:
    """What an engine raises that meets a word it does not know."""
    return TypeError(f"{engine} does not know what {type(word).__name__} means; known words: nassim.scene.part.Word")


@dataclass(frozen=True)
class Part(ABC):
    """An element of a scene that does something; a frozen dataclass with a name.

    factor: the field that scales what the part does, which an identification may correct; None where none may
    """

    name: str
    factor: ClassVar[str | None] = None

    @abstractmethod
    def says(self, scene: "Scene") -> tuple[Word, ...]:
        """What the part does in a scene; raises ValueError where it does not fit there."""

    def describe(self) -> str:
        """What the part does, in a line for reports; empty where the scene's list of signals says it all.

        Of a part that claims an electrical port, what it does there.
        """
        return ""

    @property
    def claims(self) -> tuple[str, ...]:
        """Electrical ports, "body.port", that no other part may use."""
        return ()


@dataclass(frozen=True)
class Actuator(Part):
    """What acts by an input."""


@dataclass(frozen=True)
class Sensor(Part):
    """What gives an output."""


@dataclass(frozen=True)
class ForceElement(Part):
    """What resists motion: springs, dampers, bushings."""


@dataclass(frozen=True)
class Connection(Part):
    """What holds points together: joints."""
