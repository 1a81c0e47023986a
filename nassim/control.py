"""Controllers as data: discrete-time state space as a digital controller runs it."""

import math
from dataclasses import dataclass

from nassim.checks import Array, finite_array, freeze, positive


@dataclass(frozen=True)
class Controller:
    """A sampled controller: x_(k+1) = A x_k + B y_k, u_k = C x_k + D y_k, once per sample period.

    A: (n, n); B: (n, inputs); C: (outputs, n); D: (outputs, inputs)
    sample_rate: [Hz]
    delay: whole sample periods from a sample to the time at which its output appears, held for a period
    limit: largest magnitude of an output, in its unit; beyond, it saturates
    """

    A: Array
    B: Array
    C: Array
    D: Array
    sample_rate: float
    delay: int = 1
    limit: float = math.inf

    def __post_init__(self) -> None:
        direct = finite_array("controller: D", self.D, (None, None))
        n_out, n_in = direct.shape
        state = finite_array("controller: A", self.A, (None, None))
        n = len(state)
        if int(self.delay) != self.delay or self.delay < 0:
            raise ValueError(f"controller: delay must be a whole number of samples from 0 on, got {self.delay!r}")
        if not self.limit > 0:
            raise ValueError(f"controller: limit must be positive, got {self.limit!r}; inf for none")
        freeze(
            self,
            A=finite_array("controller: A", state, (n, n)),
            B=finite_array("controller: B", self.B, (n, n_in)),
            C=finite_array("controller: C", self.C, (n_out, n)),
            D=direct,
            sample_rate=positive("controller: sample_rate", self.sample_rate, "Hz"),
            delay=int(self.delay),
            limit=float(self.limit),
        )
