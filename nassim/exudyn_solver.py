"""Exudyn's solvers on the system of a scene: statics, time integration, eigenfrequencies; guards while they run."""

import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import exudyn as exu
import numpy as np

from nassim.assembly import motion_size
from nassim.checks import Array
from nassim.exudyn_state import System
from nassim.progress import stage

CHECKS = 200
"""How often a run looks at its state."""
LOST = 1.0
"""A deformation of this share of the body's size, or this rotation [rad] by deformation, means that a run diverges."""


def _settings() -> Any:
    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    settings.timeIntegration.verboseMode = 0
    settings.staticSolver.verboseMode = 0
    return settings


def eigenfrequencies(system: System) -> Array:
    """Undamped eigenfrequencies of the system as Exudyn linearises it, ascending [Hz]."""
    eigenvalues, _ = system.mbs.ComputeODE2Eigenvalues()
    result: Array = np.sqrt(np.sort(np.abs(eigenvalues))) / (2 * np.pi)
    return result


def solve_static(system: System) -> None:
    """Bring the system into static equilibrium and keep that as the initial state; RuntimeError without one."""
    settings = _settings()
    # The static solver counts its load steps as time; inputs are to keep their value at t = 0.
    settings.staticSolver.loadStepDuration = 1e-12
    try:
        system.mbs.SolveStatic(settings, updateInitialValues=True)
    except Exception as error:
        raise RuntimeError(
            f"no static equilibrium: can a body move freely? Add joints, or leave gravity out. Exudyn says: {error}"
        ) from error


def solve_dynamic(
    system: System,
    inputs: Mapping[str, Array],
    *,
    n_steps: int,
    time_step: float,
    spectral_radius: float,
    progress: bool,
    explicit: bool = False,
) -> dict[str, Array]:
    """Integrate with a fixed step by generalized-alpha, or explicitly by Runge and Kutta's rule of order 4.

    The explicit rule holds each input from its time step to the next, and needs a system without constraints.

    inputs: values at the time steps, shape (n_steps + 1,) each, by name [V]

    Returns the largest `motion_size` of the bodies that some 200 looks at them found, by body.
    Ctrl-C ends the run after the step at hand with KeyboardInterrupt; RuntimeError, with time, body and likely cause,
    when the integration fails or diverges.
    """
    settings = _settings()
    settings.timeIntegration.numberOfSteps = n_steps
    settings.timeIntegration.endTime = n_steps * time_step
    settings.timeIntegration.adaptiveStep = False
    if system.assembly.circuits:
        # A charge has no mass, so no acceleration can be computed for it.
        settings.timeIntegration.generalizedAlpha.computeInitialAccelerations = False
    settings.timeIntegration.generalizedAlpha.spectralRadius = spectral_radius
    settings.solution.sensors.writePeriod = time_step
    samples = {name: row.tolist() for name, row in inputs.items()}
    setters = [(number, samples[name], forces) for number, name, forces in system.drives]
    largest = {name: np.zeros(2) for name in system.carriers}
    lost: list[str] = []
    count = 0
    chunk = max(1, n_steps // CHECKS)
    set_forces = system.mbs.SetObjectParameter
    system.apply({name: row[0] for name, row in samples.items()})
    with stage("simulate", total=n_steps, unit="steps", enabled=progress) as advance, _interrupts() as interrupts:

        def look() -> None:
            for name in system.carriers:
                now = motion_size(system.assembly, name, system.deformation(name)[:, None])
                if not np.all(now < LOST):
                    lost.append(name)
                largest[name] = np.maximum(largest[name], now)

        def before_step(_mbs: Any, _time: float) -> bool:
            nonlocal count
            count += 1
            for number, row, forces in setters:
                set_forces(number, "forceVector", row[count - explicit] * forces)
            if count % chunk == 0:
                advance(chunk)
                look()
            return not interrupts and not lost

        system.mbs.SetPreStepUserFunction(before_step)
        failure: Exception | None = None
        try:
            kind = exu.DynamicSolverType.RK44 if explicit else exu.DynamicSolverType.GeneralizedAlpha
            system.mbs.SolveDynamic(settings, solverType=kind)
        except Exception as error:
            failure = error
        if interrupts:
            raise KeyboardInterrupt(f"simulation stopped at t = {count * time_step:g} s")
        if not lost:
            look()
        if lost:
            raise RuntimeError(
                f"the run diverges: at t = {count * time_step:g} s body {lost[0]!r} is deformed beyond its own size; "
                "likely an excitation far too large, or a spectral_radius of 1 on a spinning body without damping: "
                "take one below 1 or a smaller time_step"
            )
        if failure is not None:
            raise RuntimeError(
                f"the integration failed at t = {count * time_step:g} s; try a smaller time_step or a "
                f"spectral_radius below 1. {failure}"
            ) from failure
        advance(n_steps % chunk)
    return largest


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Collect Ctrl-C instead of raising it: an exception inside one of Exudyn's callbacks would look like a failure."""
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    earlier = signal.signal(signal.SIGINT, lambda number, _frame: received.append(number))
    try:
        yield received
    finally:
        signal.signal(signal.SIGINT, earlier)
