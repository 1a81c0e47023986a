"""Outputs of a running Exudyn system that pass filters, from step to step."""

from collections.abc import Callable

import numpy as np

from nassim.base.checks import Array
from nassim.scene.terms import BaseAcceleration
from nassim.simulation.exudyn.state import System
from nassim.simulation.model.filters import start_filter


class Filtering:
    """Lets outputs pass their filters, at every time step once, and tells what passes, here and to the system.

    Filters start as if they had always read what they read first; but a scene at rest did not accelerate before.
    """

    def __init__(self, system: System, samples: Array, time_step: float) -> None:
        """samples: of all inputs at all time steps, (n_steps + 1, inputs)."""
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
        """At time step n; added: by loops to the inputs, (inputs,)."""
        system, self.now = self.system, n
        for output, passed in system.filtered.items():
            k, value = self.outputs.index(output), system.measured(output)
            share = system.assembly.ground_matrix[k]
            for sensor, weights in system.turning.get(output, ()):
                axes = np.reshape(system.mbs.GetSensorValues(sensor), (3, 3))
                share = share - (axes @ weights - weights) @ self.falls
            value += float(sum(share[j] * (self.samples[n, j] + added[j]) for j in np.flatnonzero(share)))
            if not n:
                calm = self.at_rest and np.any(system.assembly.acceleration_matrix[k])
                filtering = system.assembly.filters[output]
                self.steps[output] = start_filter(filtering, self.time_step, 0.0 if calm else value)
            passed[n] = self.steps[output](value)

    def measure(self) -> Array:
        """Present outputs that loops measure; the others stay 0, (outputs,)."""
        result = self.read()
        for output, passed in self.system.filtered.items():
            result[self.outputs.index(output)] = passed[self.now]
        return result
