"""Filters of outputs in time, from step to step."""

import numpy as np

from nassim.base.checks import Array
from nassim.systems.state_space import StateSpace, discretize


def gain_at_rest(system: StateSpace) -> float:
    """Return the gain of a state space at zero frequency."""
    a, b, c, d = system
    return float((d - c @ np.linalg.solve(a, b))[0, 0])


class RunningFilter:
    """A filter that runs, called with its input at every time step; it starts at rest on a constant input."""

    def __init__(self, system: StateSpace, time_step: float, value: float) -> None:
        a, b, self._c, self._d = system
        self._phi, self._held, self._risen = discretize(a, b, time_step) if len(a) else (a, b, b)
        self.state: tuple[Array, float | None] = -np.linalg.solve(a, b[:, 0]) * value, None
        """States, and the last input, None before the first; its arrays are never changed in place."""

    def __call__(self, now: float) -> float:
        """Return the output for the input now; between time steps the input is linear."""
        state, before = self.state
        if before is not None:
            state = self._phi @ state + self._held[:, 0] * before + self._risen[:, 0] * (now - before)
        self.state = state, now
        return float(self._c[0] @ state + self._d[0, 0] * now)
