"""Parts of a scene: actuators, sensors, force elements and connections; each states its terms.

To add a kind of sensor, actuator, spring or joint, write one frozen dataclass with the base class `Sensor`, `Actuator`,
`ForceElement` or `Connection` and its method `terms`. It may be in any module. Measures are in `nassim.scene.measures`,
laws on them in `nassim.scene.terms`. All engines then run it, summaries describe it and trimming keeps what it needs.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from nassim.base.short_repr import short_repr
from nassim.scene.measures import Axes, Direction, Path, Position, Signal
from nassim.scene.terms import Term

if TYPE_CHECKING:
    from nassim.scene.scene import Scene

__all__ = [
    "Actuator",
    "Axes",
    "Connection",
    "Direction",
    "ForceElement",
    "Part",
    "Path",
    "Position",
    "Sensor",
    "Signal",
]


@dataclass(frozen=True)
class Part(ABC):
    """An element of a scene: a frozen dataclass with a name.

    Attributes:
        name: name of the part, unique among the parts of its kind.
        factor: name of the field that scales the effect of the part and that an identification may correct; None where
            there is no such field.
    """

    name: str
    factor: ClassVar[str | None] = None

    def __init_subclass__(cls) -> None:
        if "__repr__" not in vars(cls):
            cls.__repr__ = short_repr  # type: ignore[method-assign]  # which `dataclass` then keeps

    @abstractmethod
    def terms(self, scene: "Scene") -> tuple[Term, ...]:
        """Return the terms of the part in a scene.

        Raises:
            ValueError: if the part does not fit the scene.
        """

    def describe(self) -> str:
        """Describe the part in one line for reports.

        Returns:
            The line. It is empty where the scene's list of signals is enough. A part that claims an electrical port
            describes what it does at the port.
        """
        return ""

    @property
    def claims(self) -> tuple[str, ...]:
        """Electrical ports, as "body.port", that no other part may use."""
        return ()


@dataclass(frozen=True)
class Actuator(Part):
    """A part that acts by an input."""


@dataclass(frozen=True)
class Sensor(Part):
    """A part that gives an output."""


@dataclass(frozen=True)
class ForceElement(Part):
    """A part that resists motion: a spring, a damper or a bushing."""


@dataclass(frozen=True)
class Connection(Part):
    """A part that constrains the relative motion of points: a joint."""
