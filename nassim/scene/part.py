"""Parts of a scene: actuators, sensors, force elements and connections; each states its terms.

To add a kind of sensor, actuator, spring or joint, write one frozen dataclass with the base class `Sensor`, `Actuator`,
`ForceElement` or `Connection` and its method `terms`. It may be in any module. Measures are in `nassim.scene.measures`,
laws on them in `nassim.scene.terms`. All engines then run it, summaries describe it and trimming keeps what it needs.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from nassim.base.checks import above_zero, whole_number
from nassim.base.short_repr import ShortRepr
from nassim.scene.field_kinds import Axes, Direction, Path, Position, Signal
from nassim.scene.terms import Output, OutputFilter, SpringForce, Term

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

MOST_POLES = 8
"""Largest order of the low-pass of a sensor."""


@dataclass(frozen=True)
class Part(ShortRepr, ABC):
    """An element of a scene: a frozen dataclass with a name.

    Attributes:
        name: name of the part, unique among the parts of its kind.
        factor: name of the field that scales the effect of the part and that an identification may correct; None where
            there is no such field.
    """

    name: str
    factor: ClassVar[str | None] = None

    @abstractmethod
    def terms(self, scene: "Scene") -> tuple[Term, ...]:
        """Return the terms of the part in a scene.

        Raises:
            ValueError: if the part does not fit the scene.
        """

    def all_terms(self, scene: "Scene") -> tuple[Term, ...]:
        """Return the terms of the part in a scene with those that parts of its kind have in common."""
        return self.terms(scene)

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
    """A part that gives an output, behind a Butterworth low-pass where it has a bandwidth.

    The low-pass delays what is slow against it by 1 / (2 pi bandwidth sin(pi / (2 order))) [s]: 0.16, 0.23, 0.32 and
    0.42 over the bandwidth for orders of 1 to 4.

    Attributes:
        bandwidth: -3 dB frequency of the low-pass [Hz]; math.inf for none.
        order: order of the low-pass, a whole number from 1 to 8.
    """

    bandwidth: float = field(default=math.inf, kw_only=True)
    order: int = field(default=1, kw_only=True)

    def all_terms(self, scene: "Scene") -> tuple[Term, ...]:
        """Return the terms of the sensor in a scene, with the low-pass of each of its outputs.

        Raises:
            ValueError: for a bandwidth or an order out of range, and for what `terms` refuses.
        """
        terms = self.terms(scene)
        outputs = dict.fromkeys(term.name for term in terms if isinstance(term, (Output, SpringForce)))
        return (*terms, *(low_pass for output in outputs for low_pass in self._low_pass(output)))

    def _low_pass(self, output: str) -> tuple[OutputFilter, ...]:
        """Return the sections of the low-pass of an output: pairs of poles at equal angles, and a real one."""
        label = f"sensor {self.name!r}"
        above_zero(f"{label}: bandwidth", self.bandwidth, "Hz")
        order = whole_number(f"{label}: order", self.order, 1, MOST_POLES)
        if math.isinf(self.bandwidth):
            return ()
        ratios = [math.sin(math.pi * (k + 0.5) / order) for k in range(order // 2)]
        pairs = [OutputFilter(output, "low", self.bandwidth, ratio) for ratio in ratios]
        return (*pairs, *[OutputFilter(output, "low", self.bandwidth)] * (order % 2))


@dataclass(frozen=True)
class ForceElement(Part):
    """A part that resists motion: a spring, a damper or a bushing."""


@dataclass(frozen=True)
class Connection(Part):
    """A part that constrains the relative motion of points: a joint."""
