"""Loops of scenes: a digital controller between named outputs and inputs, with its converters."""

import math
from dataclasses import dataclass

from nassim.base.checks import above_zero, freeze, not_negative, unique
from nassim.scene.part import Signal
from nassim.systems.controllers import Controller


@dataclass(frozen=True)
class Loop:
    """A digital controller between named outputs and inputs of a scene; what it computes adds to the excitation.

    measured: outputs, in the order of the controller's inputs; driven: inputs, in the order of its outputs
    input_step, input_limit: resolution and range of the analogue-to-digital converters, in the outputs' units
    output_step: resolution of the digital-to-analogue converters, in the inputs' units; 0: none
    """

    name: str
    controller: Controller
    measured: tuple[Signal, ...]
    driven: tuple[Signal, ...]
    input_step: float = 0.0
    input_limit: float = math.inf
    output_step: float = 0.0

    def __post_init__(self) -> None:
        label = f"loop {self.name!r}"
        if not isinstance(self.controller, Controller):
            raise ValueError(f"{label}: controller must be a Controller, got a {type(self.controller).__name__}")
        measured, driven = ((n,) if isinstance(n, str) else tuple(n) for n in (self.measured, self.driven))
        n_out, n_in = self.controller.D.shape
        if (len(driven), len(measured)) != (n_out, n_in):
            raise ValueError(
                f"{label}: its controller has {n_in} input(s) and {n_out} output(s), but it measures {len(measured)} "
                f"and drives {len(driven)} signal(s)"
            )
        for name in ("input_step", "output_step"):
            not_negative(f"{label}: {name}", getattr(self, name))
        above_zero(f"{label}: input_limit", self.input_limit)
        freeze(self, measured=unique(f"{label}: measured", measured), driven=unique(f"{label}: driven", driven))

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of its signals in records: its own for one driven input, else "name.input"."""
        return (self.name,) if len(self.driven) == 1 else tuple(f"{self.name}.{name}" for name in self.driven)
