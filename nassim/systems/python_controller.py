"""Sampled controllers that are Python objects: nonlinear, adaptive or learned ones."""

import math
from dataclasses import dataclass
from typing import NoReturn, Protocol

from nassim.base.checks import Array, above_zero, freeze, positive, whole_number
from nassim.base.field_types import ArrayLike


class ControlLaw(Protocol):
    """Protocol of the object that a `PythonController` calls at each sample."""

    def output(self, measured: Array, time: float) -> ArrayLike:
        """Compute the commands, (driven,), from the measured values, (measured,), at a time [s]."""
        ...


@dataclass(frozen=True)
class PythonController:
    """A sampled controller whose commands any Python object computes.

    A run works on a deep copy of the object, so every run starts from the object as it was given. Linear models refuse
    a loop with such a controller, because it has no matrices.

    Args:
        law: object with a method `output(measured, time) -> commands`. It is called once in a sample period with the
            measured values, shape (measured,), in the outputs' units, and the time [s]. It returns the commands,
            shape (driven,), in the inputs' units; a number serves for one driven input.
        sample_rate: [Hz].
        delay: whole sample periods from a sample to the time at which its command appears.
        limit: largest magnitude of a command, in its unit; beyond, it saturates.

    Raises:
        ValueError: for an object without the method `output`, and for numbers out of range.
    """

    law: ControlLaw
    sample_rate: float
    delay: int = 1
    limit: float = math.inf

    def __post_init__(self) -> None:
        if not callable(getattr(self.law, "output", None)):
            raise ValueError(
                f"controller: law must be an object with a method output(measured, time), got a "
                f"{type(self.law).__name__}"
            )
        freeze(
            self,
            sample_rate=positive("controller: sample_rate", self.sample_rate, "Hz"),
            delay=whole_number("controller: delay", self.delay, 0),
            limit=above_zero("controller: limit", self.limit),
        )

    @property
    def matrices(self) -> NoReturn:
        """Refuse: there are none."""
        raise ValueError(
            f"a PythonController ({type(self.law).__name__}) has no matrices, which linear models need: give a "
            "Controller, or leave its loop open"
        )

    A = B = C = D = matrices
