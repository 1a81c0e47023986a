"""Exudyn's solvers on the system of a scene: statics, time integration, eigenfrequencies; guards while they run."""

import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import exudyn as exu
import exudyn.solver
import numpy as np

from nassim.base.checks import Array
from nassim.base.progress import stage
from nassim.scene.bodies import FlexibleBody
from nassim.simulation.exudyn.filtering import Filtering
from nassim.simulation.exudyn.monitor import Monitor
from nassim.simulation.exudyn.springs import rounding
from nassim.simulation.exudyn.state import System, find_accelerations
from nassim.simulation.exudyn.steady_state import solve_loaded_equilibrium
from nassim.simulation.linear.digital_controllers import runaway, start_loops
from nassim.simulation.linear.stopped_runs import Stopped
from nassim.simulation.model.buckling import axial_rows
from nassim.simulation.model.reach import find_reach, scene_size
from nassim.simulation.model.tangents import NO_EQUILIBRIUM

CHECKS = 200
"""How often a run looks at its state."""


def _settings(system: System) -> Any:
    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    for solver in (settings.timeIntegration, settings.staticSolver):
        solver.verboseMode = 0
        solver.newton.absoluteTolerance = max(solver.newton.absoluteTolerance, rounding(system.assembly.scene))
    return settings


def _fixed_steps(system: System, n_steps: int, time_step: float, spectral_radius: float) -> Any:
    settings = _settings(system)
    settings.timeIntegration.numberOfSteps = n_steps
    settings.timeIntegration.endTime = n_steps * time_step
    settings.timeIntegration.adaptiveStep = False
    settings.timeIntegration.generalizedAlpha.spectralRadius = spectral_radius
    settings.solution.sensors.writePeriod = time_step
    if system.sparse:
        settings.linearSolver.solverType = exu.LinearSolverType.EigenSparse
    return settings


def eigenfrequencies(system: System) -> Array:
    """Undamped eigenfrequencies of the system as Exudyn linearises it, ascending [Hz]."""
    eigenvalues, _ = system.mbs.ComputeODE2Eigenvalues()
    result: Array = np.sqrt(np.sort(np.abs(eigenvalues))) / (2 * np.pi)
    return result


def solve_static(system: System) -> None:
    """Bring the system into static equilibrium and keep that as the initial state; RuntimeError without one.

    Where the equilibrium is neutral, such as of a block free to slide, it is the one with the block where it is.
    """
    settings = _settings(system)
    # The static solver counts its load steps as time; inputs are to keep their value at t = 0.
    settings.staticSolver.loadStepDuration = 1e-12
    if _solved(system, settings):
        return
    # Full pivoting leaves motions without stiffness alone, and does not converge where a force acts on one.
    settings.linearSolver.solverType = exu.LinearSolverType.EigenDense
    settings.linearSolver.ignoreSingularJacobian = True
    if _solved(system, settings):
        return
    # Exudyn's joints do not tell Newton's rule what the forces in them do when they turn: a weight's own stiffness.
    try:
        solve_loaded_equilibrium(system, scene_size(system.assembly))
    except RuntimeError:
        raise RuntimeError(NO_EQUILIBRIUM) from None


def _solved(system: System, settings: Any) -> bool:
    try:
        with _silent():
            system.mbs.SolveStatic(settings, updateInitialValues=True)
    except Exception:
        return False
    return True


def solve_dynamic(
    system: System,
    inputs: Mapping[str, Array],
    *,
    n_steps: int,
    time_step: float,
    spectral_radius: float,
    progress: bool,
    explicit: bool = False,
    look: Callable[[int], None] | None = None,
) -> tuple[Monitor, Array]:
    """Integrate with a fixed step by generalized-alpha, or explicitly by Runge and Kutta's rule of order 4.

    The explicit rule holds each input from its time step to the next, and needs a system without constraints.
    look: called at every time step with its number 0 ... n_steps, when the system is in its state

    inputs: values at the time steps, shape (n_steps + 1,) each, by name

    Returns what some 200 looks at the run found, and what the scene's loops put out, shape (commands, n_steps + 1).
    Raises Stopped, with time, body and likely cause, when the integration fails or diverges, and when Ctrl-C ends the
    run after the step at hand.
    """
    settings = _fixed_steps(system, n_steps, time_step, spectral_radius)
    steps = _Steps(system, inputs, n_steps, time_step, explicit=explicit)
    watch = Monitor(system, find_reach(system.assembly, steps.inputs.T, time_step) if steps.commands.size else None)
    find_accelerations(system, settings)
    chunk = max(1, n_steps // CHECKS)
    with stage("simulate", total=n_steps, unit="steps", enabled=progress) as advance, _interrupts() as interrupts:

        def before_step(_mbs: Any, _time: float) -> bool:
            if look:
                look(steps.begun)
            steps.begin()
            if steps.begun % chunk == 0:
                advance(chunk)
                watch.look(steps.begun - 1)
            return not interrupts and not watch.lost

        system.mbs.SetPreStepUserFunction(before_step)
        failure = _integrate(system, settings, explicit=explicit)
        if not (interrupts or failure or watch.lost):
            watch.look(n_steps)
        message = _ending(system, watch, steps, failure, spectral_radius, time_step, interrupted=bool(interrupts))
        if message:
            readings = np.vstack([_recorded(system, steps.begun), steps.commands[: steps.begun].T])
            cause = None if interrupts or watch.lost else failure
            raise Stopped(message, readings, watch.trust.sample, interrupted=bool(interrupts)) from cause
        steps.end()
        if look:
            look(n_steps)
        advance(n_steps % chunk)
    return watch, steps.commands.T


class _Steps:
    """Sets, step by step, the inputs and what loops add to them, after outputs passed their filters.

    begun: number of steps; commands: what the loops put out, (n_steps + 1, commands)
    """

    def __init__(
        self, system: System, inputs: Mapping[str, Array], n_steps: int, time_step: float, *, explicit: bool
    ) -> None:
        scene = system.assembly.scene
        self.system, self.explicit = system, explicit
        self.begun = 0
        self.inputs = np.column_stack([np.zeros((n_steps + 1, 0)), *(inputs[name] for name in scene.inputs)])
        self.commands = np.zeros((n_steps + 1, len(scene.commands)))
        self.step_loops = start_loops(scene, time_step)
        self.filtering = Filtering(system, self.inputs, time_step)
        self.nothing = self.held = np.zeros(len(scene.inputs))
        self.places = np.array([scene.inputs.index(drive.input) for drive in system.drives], dtype=int)
        rates = [drive.rate for drive in system.drives]
        self.lagging = [(k, _follow(rate, time_step)) for k, rate in enumerate(rates) if np.isfinite(rate)]
        starting = self.inputs[0, self.places]
        starting[[k for k, _ in self.lagging]] = 0.0
        system.act(starting)

    def begin(self) -> None:
        """Set what acts during the next step."""
        count, explicit = self.begun, self.explicit
        held = end = self.nothing
        self.filtering.step(count, self.held)
        if self.commands.size:
            held, end, self.commands[count] = self.step_loops(count, self.filtering.measure)
            self.held = held
        before, after = self.inputs[count], self.inputs[count + 1 - explicit]
        # The implicit rule takes forces at both ends of a step. A command that jumps there enters with its mean, else
        # the loop would have half a step of delay more.
        values = (after + (held if explicit else end))[self.places]
        for k, follow in self.lagging:
            place = self.places[k]
            values[k] = follow(before[place] + held[place], after[place] + held[place])
        self.system.act(values)
        self.begun = count + 1

    def end(self) -> None:
        """Take what passes filters and what loops put out at the end of the last step."""
        self.filtering.step(self.begun, self.held)
        if self.commands.size:
            self.commands[self.begun] = self.step_loops(self.begun, self.filtering.measure)[2]


def _integrate(system: System, settings: Any, *, explicit: bool) -> Exception | None:
    """Run Exudyn's solver; the error when it fails."""
    kind = exu.DynamicSolverType.RK44 if explicit else exu.DynamicSolverType.GeneralizedAlpha
    try:
        with _uncounted_vectors(), _silent():
            system.mbs.SolveDynamic(settings, solverType=kind)
    except Exception as error:
        return error
    return None


def _ending(
    system: System,
    watch: Monitor,
    steps: _Steps,
    failure: Exception | None,
    spectral_radius: float,
    time_step: float,
    *,
    interrupted: bool,
) -> str:
    """Return why a run has ended in its step number `steps.begun`; empty for one that has come to its end."""
    scene, now = system.assembly.scene, f"t = {steps.begun * time_step:g} s"
    if interrupted:
        return f"simulation stopped at {now}"
    if watch.lost and scene.loops:
        outputs = _recorded(system, steps.begun)[: len(scene.outputs)]
        return runaway(scene, watch.lost[0][1], outputs.T, time_step)
    if watch.lost:
        return (
            f"the run diverges: at {now} body {watch.lost[0][0]!r} is deformed beyond its own size; likely an "
            f"excitation far too large, or a spectral_radius of {spectral_radius:g} on a spinning body without "
            "damping: take a smaller one or a smaller time_step"
        )
    if failure is not None:
        looped = ", or look for a loop that runs away (linearize_closed, unstable_poles)" if scene.loops else ""
        likely = watch.describe_drift(time_step, spectral_radius) or "try a smaller time_step or spectral_radius"
        return f"the integration failed at {now}; {likely}{looped}"
    return ""


def _recorded(system: System, n_samples: int) -> Array:
    """Outputs of the samples that a run has, (outputs, n_samples)."""
    names = system.assembly.scene.outputs
    rows = [system.recorded(name) for name in names]
    rows = [np.broadcast_to(row[:n_samples] if len(row) > 1 else row, (n_samples,)) for row in rows]
    return np.reshape(rows, (len(names), n_samples))


def axial_tension(system: System, body: FlexibleBody) -> Array:
    """Present `axial_forces` of a body that deforms, (lines,) [N]."""
    result: Array = axial_rows(body.reduced) @ system.deformation(body.name)
    return result


def _follow(rate: float, time_step: float) -> Callable[[float, float], float]:
    """What an amplifier at rest puts out at the end of each time step, whose input runs straight between two values.

    rate: of its low-pass [1/s]
    """
    x = rate * time_step
    share = -float(np.expm1(-x))
    slope = 1 - share / x
    value = 0.0

    def follow(before: float, after: float) -> float:
        nonlocal value
        value += share * (before - value) + slope * (after - before)
        return value

    return follow


@contextmanager
def _silent() -> Iterator[None]:
    """Exudyn prints what fails, which nassim tells itself."""
    loud = exu.config.printToConsole
    exu.config.printToConsole = False
    try:
        yield
    finally:
        exu.config.printToConsole = loud


@contextmanager
def _uncounted_vectors() -> Iterator[None]:
    """Exudyn counts the vectors that inputs set at every step, and would warn of them in the midst of the progress."""
    earlier = exudyn.solver.solverCheckMemoryAllocationsThreshold
    exudyn.solver.solverCheckMemoryAllocationsThreshold = sys.maxsize
    try:
        yield
    finally:
        exudyn.solver.solverCheckMemoryAllocationsThreshold = earlier


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
