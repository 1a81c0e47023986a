"""Outputs of a running Exudyn system that pass filters, from step to step."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from nassim.base.checks import Array
from nassim.simulation.exudyn.state import System
from nassim.simulation.filters import start_filter


class Filtering:
    """Lets outputs pass their filters, at every time step once, and tells what passes, here and to the system.

    Filters start as if they had always read what they read first; but a scene at rest did not accelerate before.
    """

    def __init__(self, system: System, samples: Mapping[str, Sequence[float]], n_steps: int, time_step: float) -> None:
        scene = system.assembly.scene
        self.system, self.samples, self.time_step = system, [samples[name] for name in scene.inputs], time_step
        self.steps: dict[str, Callable[[float, float], float]] = {}
        self.at_rest = not scene.speeds and not any(np.any(body.angular_velocity) for body in scene.bodies)
        self.now = 0
        for output in system.assembly.filters:
            system.filtered[output] = np.zeros(n_steps + 1)

    def step(self, n: int, added: Array) -> None:
        """At time step n; added: by loops to the inputs, (inputs,)."""
        system, self.now = self.system, n
        for output, passed in system.filtered.items():
            k, value = system.assembly.scene.outputs.index(output), system.measured(output)
            if not n:
                calm = self.at_rest and np.any(system.assembly.acceleration_matrix[k])
                filtering = system.assembly.filters[output]
                self.steps[output] = start_filter(filtering, self.time_step, 0.0 if calm else value)
            share = system.assembly.ground_matrix[k]
            ground = sum(share[j] * (self.samples[j][n] + added[j]) for j in np.flatnonzero(share))
            passed[n] = self.steps[output](value, float(ground))

    def measure(self) -> Array:
        """Present outputs, (outputs,)."""
        passed = self.system.filtered
        names = self.system.readings
        return np.array([passed[name][self.now] if name in passed else self.system.measured(name) for name in names])
