"""Loops of scenes: a digital controller between named outputs and inputs, with its converters."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from nassim.base.checks import above_zero, freeze, not_negative, of_kind, unique
from nassim.base.field_types import Field, data_class, held
from nassim.base.short_repr import short_repr
from nassim.scene.field_kinds import Signal
from nassim.systems.controllers import Controller
from nassim.systems.python_controller import PythonController

SignalNames = Field[Signal | Sequence[Signal], tuple[Signal, ...]]


@data_class
class Loop:
    """A digital controller between named outputs and inputs of a scene. Its commands add to the excitation.

    Attributes:
        name: name of the loop, by which its commands are recorded.
        controller: a linear `Controller`, or a `PythonController` around any object with `output(measured, time)`.
        measured: names of outputs, in the order of the controller's inputs.
        driven: names of inputs, in the order of the controller's outputs.
        input_step: resolution of the analogue-to-digital converters, in the outputs' units; 0 for none.
        input_limit: range of the analogue-to-digital converters, in the outputs' units.
        output_step: resolution of the digital-to-analogue converters, in the inputs' units; 0 for none.
        reference: names of set points, one for each measured output, or none. They are inputs of the scene, in the
            outputs' units. The controller then reads measured minus reference, so a controller that gives negative
            feedback, such as `nassim.systems.pid`, follows them.
        feedforward: a controller from the references to the driven inputs, with the sample rate and the delay of
            `controller`. Its outputs add to those of `controller` before the limit. None: no feedforward.
        noise: names of inputs for the noise of sensors and converters, one for each measured output, or none. They are
            inputs of the scene, in the outputs' units. The converters read measured plus noise; records hold the
            outputs without it.

    Raises:
        ValueError: for a controller of another kind, for numbers of signals that do not fit it or each other, for names
            that repeat, for steps and limits out of range, and for a step beyond its limit.
    """

    name: str
    controller: Controller | PythonController
    measured: SignalNames
    driven: SignalNames
    input_step: float = 0.0
    input_limit: float = math.inf
    output_step: float = 0.0
    reference: SignalNames = held(())
    feedforward: Controller | None = None
    noise: SignalNames = held(())
    __repr__ = short_repr

    def __post_init__(self) -> None:
        label = f"loop {self.name!r}"
        if not isinstance(self.controller, Controller | PythonController):
            raise ValueError(
                f"{label}: controller must be a Controller or a PythonController, got a "
                f"{type(self.controller).__name__}; PythonController takes any object with output(measured, time)"
            )
        measured, driven, reference, noise = (
            (n,) if isinstance(n, str) else tuple(n) for n in (self.measured, self.driven, self.reference, self.noise)
        )
        for kind, given in (("reference(s)", reference), ("noise input(s)", noise)):
            if given and len(given) != len(measured):
                raise ValueError(
                    f"{label}: it measures {len(measured)} signal(s), but has {len(given)} {kind}; give one for each "
                    "measured signal, or none"
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
        for what, step, limit in (
            ("input_step", self.input_step, self.input_limit),
            ("output_step", self.output_step, self.controller.limit),
        ):
            if step > limit:
                raise ValueError(f"{label}: an {what} of {step:g} has no step within the limit of {limit:g}, only 0")
        unique(f"{label}: reference and noise", (*reference, *noise))
        freeze(
            self,
            measured=unique(f"{label}: measured", measured),
            driven=unique(f"{label}: driven", driven),
            reference=reference,
            noise=noise,
        )
        if self.feedforward is not None:
            self._check_feedforward(label, self.feedforward)

    def _check_feedforward(self, label: str, given: Controller) -> None:
        of_kind(f"{label}: feedforward", given, Controller, "nassim.systems.proportional makes one of a gain")
        shape, own = (len(self.driven), len(self.reference)), self.linear_controller
        if not self.reference:
            raise ValueError(f"{label}: a feedforward reads references, but the loop has none")
        if given.D.shape != shape:
            raise ValueError(
                f"{label}: its feedforward has {given.D.shape[1]} input(s) and {given.D.shape[0]} output(s), but the "
                f"loop has {shape[1]} reference(s) and drives {shape[0]} signal(s)"
            )
        if given.limit < math.inf:
            raise ValueError(
                f"{label}: its feedforward has a limit of {given.limit:g}; leave it out: the limit of the controller "
                "holds the sum of both"
            )
        if (given.sample_rate, given.delay) != (own.sample_rate, own.delay):
            raise ValueError(
                f"{label}: one computer evaluates controller and feedforward, so the feedforward has the sample rate "
                f"{own.sample_rate:g} Hz and the delay {own.delay} of the controller, not {given.sample_rate:g} Hz and "
                f"{given.delay}"
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
    def n_channels(self) -> int:
        """Number of values that its controllers read: measured minus reference, then minus reference alone."""
        return len(self.measured) + len(self.reference) * (self.feedforward is not None)

    @property
    def law(self) -> Controller:
        """Controller and feedforward as one linear controller of `n_channels` inputs."""
        own, ahead = self.linear_controller, self.feedforward
        if ahead is None:
            return own
        return replace(
            own,
            A=block_diag(own.A, ahead.A),
            B=block_diag(own.B, -ahead.B),
            C=np.hstack([own.C, ahead.C]),
            D=np.hstack([own.D, -ahead.D]),
            anti_windup=None if own.anti_windup is None else np.vstack([own.anti_windup, np.zeros_like(ahead.C.T)]),
        )

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of its signals in records: its own for one driven input, else "name.input"."""
        return (self.name,) if len(self.driven) == 1 else tuple(f"{self.name}.{name}" for name in self.driven)
