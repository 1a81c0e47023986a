"""Loops of scenes: a digital controller between named outputs and inputs, with its converters."""

import math
from collections.abc import Sequence

from nassim.base.checks import above_zero, freeze, not_negative, unique
from nassim.base.field_types import Field, data_class, held
from nassim.base.short_repr import short_repr
from nassim.scene.part import Signal
from nassim.systems.controllers import Controller
from nassim.systems.python_controller import PythonController

Signals = Field[Signal | Sequence[Signal], tuple[Signal, ...]]


@data_class
class Loop:
    """A digital controller between named outputs and inputs of a scene. Its commands add to the excitation.

    Args:
        name: of the loop; commands are recorded by it.
        controller: a linear `Controller`, or a `PythonController` around any object with `output(measured, time)`.
        measured: names of outputs, in the order of the controller's inputs.
        driven: names of inputs, in the order of the controller's outputs.
        input_step: resolution of the analogue-to-digital converters, in the outputs' units; 0 for none.
        input_limit: range of the analogue-to-digital converters, in the outputs' units.
        output_step: resolution of the digital-to-analogue converters, in the inputs' units; 0 for none.
        reference: names of set points, one for each measured output, or none. They are inputs of the scene, in the
            outputs' units. The controller then reads measured minus reference, so a controller that gives negative
            feedback, such as `nassim.systems.pid`, follows them.

    Raises:
        ValueError: for a controller of another kind, for numbers of signals that do not fit it or each other, for names
            that repeat and for steps and limits out of range.
    """

    name: str
    controller: Controller | PythonController
    measured: Signals
    driven: Signals
    input_step: float = 0.0
    input_limit: float = math.inf
    output_step: float = 0.0
    reference: Signals = held(())
    __repr__ = short_repr

    def __post_init__(self) -> None:
        label = f"loop {self.name!r}"
        if not isinstance(self.controller, Controller | PythonController):
            raise ValueError(
                f"{label}: controller must be a Controller or a PythonController, got a "
                f"{type(self.controller).__name__}; PythonController takes any object with output(measured, time)"
            )
        measured, driven, reference = (
            (n,) if isinstance(n, str) else tuple(n) for n in (self.measured, self.driven, self.reference)
        )
        if reference and len(reference) != len(measured):
            raise ValueError(
                f"{label}: it measures {len(measured)} signal(s), but has {len(reference)} reference(s); give one for "
                "each measured signal, or none"
            )
        if isinstance(self.controller, Controller):
            n_out, n_in = self.controller.D.shape
            if (len(driven), len(measured)) != (n_out, n_in):
                raise ValueError(
                    f"{label}: its controller has {n_in} input(s) and {n_out} output(s), but it measures "
                    f"{len(measured)} and drives {len(driven)} signal(s)"
                )
        for name in ("input_step", "output_step"):
            not_negative(f"{label}: {name}", getattr(self, name))
        above_zero(f"{label}: input_limit", self.input_limit)
        freeze(
            self,
            measured=unique(f"{label}: measured", measured),
            driven=unique(f"{label}: driven", driven),
            reference=unique(f"{label}: reference", reference),
        )

    @property
    def linear_controller(self) -> Controller:
        """Its controller, where that is linear.

        Raises:
            ValueError: for a controller that has no linear model.
        """
        if isinstance(self.controller, PythonController):
            raise ValueError(
                f"loop {self.name!r}: its controller, a {type(self.controller.law).__name__} in Python, has no linear "
                "model: leave the loop open (`loops` of linearize_closed), or give it a Controller"
            )
        return self.controller

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of its signals in records: its own for one driven input, else "name.input"."""
        return (self.name,) if len(self.driven) == 1 else tuple(f"{self.name}.{name}" for name in self.driven)
