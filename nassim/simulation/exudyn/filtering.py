"""Filters of the outputs of a running Exudyn system, from step to step."""

from typing import Any

import numpy as np

from nassim.base.checks import Array
from nassim.scene.terms import BaseAcceleration
from nassim.simulation.exudyn.running_system import System
from nassim.simulation.model.filters import RunningFilter


class Filtering:
    """Filters of a system's outputs, which run once at every time step and pass their results to the system.

    Filters start in steady state at their first input, except accelerations of a scene at rest, which start at zero.
    """

    def __init__(self, system: System, time_step: float) -> None:
        """Start the filters of a system; time_step [s]."""
        scene, signals = system.assembly.scene, system.assembly.signals
        self.system, self.time_step = system, time_step
        self.steps: dict[str, RunningFilter] = {}
        self.passed = dict.fromkeys(signals.filters, 0.0)
        self.falls = np.zeros((3, len(scene.inputs)))
        for base in scene.terms_of(BaseAcceleration):
            self.falls[:, scene.inputs.index(base.input)] -= base.direction
        self.outputs = scene.outputs
        loads = system.assembly.loads
        in_loads = loads.given.inputs if loads else {}  # of small motion
        constant = {**in_loads, **system.constant_inputs}
        self.constant = signals.feedthrough_at_rest @ [constant.get(name, 0.0) for name in scene.inputs]
        self.read_others = system.measuring(name for name in scene.outputs if name not in self.passed)
        self.read = system.measuring(dict.fromkeys(name for loop in scene.loops for name in loop.measured))

    def step(self, inputs: Array, amplified: Array) -> None:
        """Filter at a time step.

        Args:
            inputs: what is applied and what loops have added until then, (inputs,).
            amplified: what amplifiers add to the outputs, (outputs,).
        """
        system = self.system
        for output in self.passed:
            k, value = self.outputs.index(output), system.measured(output)
            value += amplified[k] + self.constant[k]
            share = system.assembly.signals.feedthrough[k]
            for sensor, weights in system.rotating_axes.get(output, ()):
                axes = np.reshape(system.mbs.GetSensorValues(sensor), (3, 3))
                share = share - (axes @ weights - weights) @ self.falls
            value += float(sum(share[j] * inputs[j] for j in np.flatnonzero(share)))
            if output not in self.steps:
                calm = system.assembly.scene.at_rest and np.any(system.assembly.signals.acceleration_matrix[k])
                filtering = system.assembly.signals.filters[output]
                self.steps[output] = RunningFilter(filtering, self.time_step, 0.0 if calm else value)
            self.passed[output] = self.steps[output](value)

    def measure(self) -> Array:
        """Return the present outputs that loops measure, (outputs,); the others are 0."""
        return self._with_passed(self.read())

    def read_all(self) -> Array:
        """Return the present outputs as a record has them, behind their filters, (outputs,)."""
        return self._with_passed(self.read_others())

    def _with_passed(self, outputs: Array) -> Array:
        for output, passed in self.passed.items():
            outputs[self.outputs.index(output)] = passed
        return outputs

    @property
    def state(self) -> Any:
        """States of the filters, by output; the next sample gives their filtered values."""
        return {output: step.state for output, step in self.steps.items()}

    def restore(self, state: Any) -> None:
        """Restore a state, of filters that have made their first step as these have."""
        for output, own in state.items():
            self.steps[output].state = own
