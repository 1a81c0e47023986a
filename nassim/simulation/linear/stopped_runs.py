"""Runs in time that end early: what they raise, with what they had recorded."""

import numpy as np

from nassim.base.checks import Array
from nassim.signals.time_history import TimeHistory


class SimulationError(RuntimeError):
    """A simulation that failed, diverged or ran away.

    Attributes:
        record: what `simulate` would have returned, up to the step in which the run ended; None when it has fewer than
            two samples.
        trusted_until: time [s] of the last look at the run before the first one that found it unsound: a body
            deformed or turned beyond what small deformation holds for, or farther away than forces, speeds and drives
            can bring it, or velocities that part from the constraints. The run looks at itself some 200 times. Do
            not trust the record after that time.
    """

    def __init__(self, message: str, record: TimeHistory | None = None, trusted_until: float = 0.0) -> None:
        super().__init__(message)
        self.record, self.trusted_until = record, trusted_until


class SimulationInterrupted(KeyboardInterrupt):
    """A simulation that Ctrl-C has ended, with the same attributes as `SimulationError`."""

    def __init__(self, message: str, record: TimeHistory | None = None, trusted_until: float = 0.0) -> None:
        super().__init__(message)
        self.record, self.trusted_until = record, trusted_until


class Stopped(RuntimeError):
    """What an engine raises when a run ends early.

    Attributes:
        readings: of outputs and commands until then, shape (outputs + commands, n_samples).
        trusted: number of the last sample that is to be trusted.
        interrupted: whether Ctrl-C has ended the run.
    """

    def __init__(self, message: str, readings: Array, trusted: int, *, interrupted: bool = False) -> None:
        super().__init__(message)
        finite = np.isfinite(readings).all(axis=0)
        n_samples = readings.shape[1] if finite.all() else int(np.argmin(finite))
        self.readings = readings[:, :n_samples]
        self.trusted = max(0, min(trusted, n_samples - 1))
        self.interrupted = interrupted

    def public_error(self, record: TimeHistory | None, time_step: float) -> SimulationError | SimulationInterrupted:
        """Return the public exception with the record that the readings make; time_step [s]."""
        until = self.trusted * time_step
        kept = f"this exception's `record` has what was recorded; trust it until t = {until:g} s"
        message = f"{self}; {kept}" if record else str(self)
        return (SimulationInterrupted if self.interrupted else SimulationError)(message, record, until)


class Trust:
    """Until when a run is to be trusted: `sample` is the last one that was sound before the first that was not."""

    def __init__(self) -> None:
        self.sample, self._lost = 0, False

    def see(self, sample: int, *, sound: bool) -> None:
        """Take note of a look at a sample."""
        self._lost |= not sound
        if not self._lost:
            self.sample = sample
