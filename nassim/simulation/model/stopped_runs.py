"""Exceptions of runs in time that end early, with the outputs recorded until then."""

import numpy as np

from nassim.base.checks import Array
from nassim.signals.time_history import TimeHistory

CHECKS = 200
"""How often a long run is checked."""


class _WithRecord(BaseException):
    """The end of a run, with the record until then."""

    def __init__(self, message: str, record: TimeHistory | None = None, trusted_until: float = 0.0) -> None:
        super().__init__(message)
        self.record, self.trusted_until = record, trusted_until


class SimulationError(_WithRecord, RuntimeError):
    """A simulation that failed, diverged or ran away.

    Attributes:
        record: what `simulate` would have returned, up to the step in which the run ended; None with fewer than two
            samples.
        trusted_until: time [s] of the last check of the run before the first that found it unsound: a body deformed or
            rotated beyond the range of small deformation, or farther away than forces, speeds and drives can move it,
            or velocities that violate the constraints. The run is checked some 200 times. Do not trust the record after
            that time.
    """


class SimulationInterrupted(_WithRecord, KeyboardInterrupt):
    """A simulation that Ctrl-C ended, with the same attributes as `SimulationError`."""


class Stopped(RuntimeError):
    """An engine's exception for a run that ends early.

    A run by single steps gives neither readings nor the last sample, as `Simulation` has them.

    Attributes:
        readings: outputs and commands until then, (outputs + commands, n_samples).
        trusted: number of the last sample to be trusted.
        interrupted: whether Ctrl-C ended the run.
    """

    def __init__(
        self, message: str, readings: Array | None = None, trusted: int = 0, *, interrupted: bool = False
    ) -> None:
        super().__init__(message)
        readings = np.zeros((0, 0)) if readings is None else readings
        finite = np.isfinite(readings).all(axis=0)
        n_samples = readings.shape[1] if finite.all() else int(np.argmin(finite))
        self.readings = readings[:, :n_samples]
        self.trusted = max(0, min(trusted, n_samples - 1))
        self.interrupted = interrupted

    def public_error(self, record: TimeHistory | None, time_step: float) -> SimulationError | SimulationInterrupted:
        """Make the public exception with the record of the readings.

        Args:
            record: outputs and commands until then, or None.
            time_step: time step [s].

        Returns:
            The exception.
        """
        until = self.trusted * time_step
        kept = f"this exception's `record` has what was recorded; trust it until t = {until:g} s"
        message = f"{self}; {kept}" if record else str(self)
        return (SimulationInterrupted if self.interrupted else SimulationError)(message, record, until)


class ValidSamples:
    """Samples of a run until the first one that a check finds invalid.

    Attributes:
        last: the last valid sample.
    """

    def __init__(self) -> None:
        self.last, self._ended = 0, False

    def check(self, sample: int, *, valid: bool) -> None:
        """Take the result of a sample's check."""
        self._ended |= not valid
        if not self._ended:
            self.last = sample
