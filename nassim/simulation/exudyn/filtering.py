"""Filters of the outputs of a running Exudyn system, from step to step."""

from collections.abc import Callable

import numpy as np

from nassim.base.checks import Array
from nassim.scene.terms import BaseAcceleration
from nassim.simulation.exudyn.state import System
from nassim.simulation.model.filters import start_filter


class Filtering:
    """Filters of a system's outputs, which run once at every time step and pass their results to the system.

    Filters start in steady state at their first input, except accelerations of a scene at rest, which start at zero.
    """

    def __init__(self, system: System, samples: Array, time_step: float) -> None:
        """Start the filters of a system.

        Args:
            system: the system.
            samples: all inputs at all time steps, (n_steps + 1, inputs).
            time_step: time step [s].
        """
        scene = system.assembly.scene
        self.system, self.samples, self.time_step = system, samples, time_step
        self.steps: dict[str, Callable[[float], float]] = {}
        self.at_rest = not scene.speeds and not any(np.any(body.angular_velocity) for body in scene.bodies)
        self.falls = np.zeros((3, len(scene.inputs)))
        for base in scene.terms_of(BaseAcceleration):
            self.falls[:, scene.inputs.index(base.input)] -= base.direction
        self.now = 0
        self.outputs = scene.outputs
        self.read = system.measuring(dict.fromkeys(name for loop in scene.loops for name in loop.measured))
        for output in system.assembly.filters:
            system.filtered[output] = np.zeros(len(samples))

    def step(self, n: int, added: Array) -> None:
        """Filter at time step n; added: additions of loops to the inputs, (inputs,)."""
        system, self.now = self.system, n
        for output, passed in system.filtered.items():
            k, value = self.outputs.index(output), system.measured(output)
            share = system.assembly.ground_matrix[k]
            for sensor, weights in system.rotating_axes.get(output, ()):
                axes = np.reshape(system.mbs.GetSensorValues(sensor), (3, 3))
                share = share - (axes @ weights - weights) @ self.falls
            value += float(sum(share[j] * (self.samples[n, j] + added[j]) for j in np.flatnonzero(share)))
            if not n:
                calm = self.at_rest and np.any(system.assembly.acceleration_matrix[k])
                filtering = system.assembly.filters[output]
                self.steps[output] = start_filter(filtering, self.time_step, 0.0 if calm else value)
            passed[n] = self.steps[output](value)

    def measure(self) -> Array:
        """Return the present outputs that loops measure, (outputs,); the others are 0."""
        result = self.read()
        for output, passed in self.system.filtered.items():
            result[self.outputs.index(output)] = passed[self.now]
        return result
