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
from nassim.simulation.linear.digital_controllers import BadCommand, runaway, start_loops
from nassim.simulation.linear.stopped_runs import Stopped
from nassim.simulation.model.buckling import axial_rows
from nassim.simulation.model.reach import find_reach, scene_size
from nassim.simulation.model.tangents import NO_EQUILIBRIUM

MANY = 10**9
"""Steps that a run one by one may have."""
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
        solve_loaded_equilibrium(system, scene_size(system.assembly.scene))
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

    Args:
        system: in its state at the start.
        inputs: values at the time steps, shape (n_steps + 1,) each, by name.
        n_steps: number of steps.
        time_step: [s].
        spectral_radius: of generalized-alpha.
        progress: whether to show a bar.
        explicit: whether to step by the explicit rule.
        look: called at every time step with its number 0 ... n_steps, when the system is in its state.

    Returns what some 200 looks at the run found, and what the scene's loops put out, shape (commands, n_steps + 1).

    Raises:
        Stopped: with time, body and likely cause, when the integration fails or diverges or a controller in Python
            fails, and when Ctrl-C ends the run after the step at hand.
    """
    scene, settings = system.assembly.scene, _fixed_steps(system, n_steps, time_step, spectral_radius)
    samples = np.column_stack([np.zeros((n_steps + 1, 0)), *(inputs[name] for name in scene.inputs)])
    steps = _Steps(system, samples[0], time_step, explicit=explicit)
    commands = np.zeros((n_steps + 1, len(scene.commands)))
    system.filtered.update({output: np.zeros(n_steps + 1) for output in steps.filtering.passed})
    watch = Monitor(system, find_reach(system.assembly, samples.T, time_step) if scene.commands else None)
    find_accelerations(system, settings)
    chunk = max(1, n_steps // CHECKS)

    def sample() -> bool:
        """Take the samples of filters and loops; whether the controllers have worked."""
        n = steps.begun
        if not steps.sample(samples[n]):
            return False
        commands[n] = steps.commands
        for output, passed in steps.filtering.passed.items():
            system.filtered[output][n] = passed
        return True

    with stage("simulate", total=n_steps, unit="steps", enabled=progress) as advance, _interrupts() as interrupts:

        def before_step(_mbs: Any, _time: float) -> bool:
            n = steps.begun
            if look:
                look(n)
            if not sample():
                return False
            steps.act(samples[n], samples[n + 1])
            if steps.begun % chunk == 0:
                advance(chunk)
                watch.look(n)
            return not interrupts and not watch.lost

        system.mbs.SetPreStepUserFunction(before_step)
        failure = _integrate(system, settings, explicit=explicit)
        if not (interrupts or failure or watch.lost or steps.bad):
            watch.look(n_steps)
            sample()
        told = _ending(system, watch, steps, failure, spectral_radius, interrupted=bool(interrupts))
        if told:
            n = steps.begun
            outputs = _recorded(system, n)
            if watch.lost and scene.loops and not steps.bad and not interrupts:
                told = runaway(scene, watch.lost[0][1], outputs.T, time_step)
            cause = steps.bad.__cause__ if steps.bad else None if interrupts or watch.lost else failure
            readings = np.vstack([outputs, commands[:n].T])
            raise Stopped(told, readings, watch.trust.sample, interrupted=bool(interrupts)) from cause
        if look:
            look(n_steps)
        advance(n_steps % chunk)
    return watch, commands.T


class SteppedRun:
    """A run of Exudyn's generalized-alpha solver, step by step: the same to the last digit as by `solve_dynamic`.

    Attributes:
        row: outputs and commands now, shape (outputs + commands,).
        count: number of steps done.
    """

    def __init__(self, system: System, inputs: Array, time_step: float, spectral_radius: float) -> None:
        """Start a run.

        Args:
            system: in its state at the start.
            inputs: at the start, shape (inputs,).
            time_step: [s].
            spectral_radius: see `nassim.simulation.integrator_error`.

        Raises:
            Stopped: when Exudyn finds no accelerations to start with, or a controller in Python fails.
        """
        self.system, self.count, self._inputs = system, 0, inputs
        self._radius, self._time_step = spectral_radius, time_step
        self._settings = _fixed_steps(system, MANY, time_step, spectral_radius)
        self._steps = _Steps(system, inputs, time_step, explicit=False)
        self.watch = Monitor(system)
        find_accelerations(system, self._settings)
        solver: Any = exu.MainSolverImplicitSecondOrder()
        self._solver = solver
        with _silent():
            if not solver.InitializeSolver(system.mbs, self._settings):
                raise Stopped("Exudyn finds no accelerations at the start", np.zeros((len(self._names), 0)), 0)
        self._solver.it.currentStepSize = time_step
        self._sample()

    @property
    def _names(self) -> tuple[str, ...]:
        scene = self.system.assembly.scene
        return *scene.outputs, *scene.commands

    def _sample(self) -> None:
        if not self._steps.sample(self._inputs):
            self._stop(None)
        self.row = np.concatenate([self._steps.filtering.read_all(), self._steps.commands])

    def _stop(self, failure: Exception | None) -> None:
        told = _ending(self.system, self.watch, self._steps, failure, self._radius, interrupted=False)
        cause = self._steps.bad.__cause__ if self._steps.bad else failure
        raise Stopped(told, np.zeros((len(self._names), 0)), self.watch.trust.sample) from cause

    def step(self, inputs: Array) -> None:
        """Go on by a step to these inputs, shape (inputs,).

        Raises:
            Stopped: when the step fails or a controller in Python does, without readings.
        """
        mbs, solver, settings = self.system.mbs, self._solver, self._settings
        self._steps.act(self._inputs, inputs)
        try:
            with _silent():
                # Exudyn's own loop over steps keeps this state; without it, Newton's restarts begin at a stale one.
                data, start = mbs.systemData, exu.ConfigurationType.StartOfStep
                data.SetSystemState(data.GetSystemState(), start)
                data.SetODE2Coordinates_tt(data.GetODE2Coordinates_tt(), start)
                solver.InitializeStep(mbs, settings)
                if not solver.DiscontinuousIteration(mbs, settings):
                    raise RuntimeError("Newton's iterations do not converge")
                solver.FinishStep(mbs, settings)
        except Exception as error:
            self._stop(error)
        self.count, self._inputs = self.count + 1, inputs
        self._sample()

    @property
    def state(self) -> Any:
        """A copy of all that changes from step to step.

        From here on the solver goes with a new Jacobian, here and wherever the state is restored: an old one of an
        earlier configuration, which Newton's iterations may use as well, cannot be had from Exudyn.
        """
        data, solver = self.system.mbs.systemData, self._solver
        exudyn = (data.GetSystemState(), np.array(data.GetODE2Coordinates_tt()), np.array(solver.GetAAlgorithmic()))
        solver.conv.jacobianUpdateRequested = True
        own = self.system.turns, self._steps.state, solver.it.currentTime, self.count, self._inputs, self.row
        return (*exudyn, *own)

    def restore(self, state: Any) -> None:
        """Go back to a state."""
        system_state, accelerations, algorithmic, turns, steps, time, self.count, self._inputs, self.row = state
        data, solver, settings = self.system.mbs.systemData, self._solver, self._settings
        # Exudyn starts with the accelerations that it finds as those of its rule, which can be set in no other way.
        for configuration in (exu.ConfigurationType.Initial, exu.ConfigurationType.Current):
            data.SetSystemState(system_state, configuration)
            data.SetODE2Coordinates_tt(algorithmic, configuration)
        rule = settings.timeIntegration.generalizedAlpha
        rule.computeInitialAccelerations = rule.resetAccelerations = False
        settings.timeIntegration.startTime = time
        solver.InitializeSolverInitialConditions(self.system.mbs, settings)
        solver.it.currentTime, solver.it.currentStepSize = time, self._time_step
        data.SetODE2Coordinates_tt(accelerations, exu.ConfigurationType.Current)
        solver.conv.jacobianUpdateRequested = True
        self.system.restore_turns(turns)
        self._steps.restore(steps)


class _Steps:
    """Sets, step by step, the inputs and what loops add to them, after outputs passed their filters.

    begun: number of steps begun; commands: what the loops put out at the last sample, (commands,)
    bad: the failure of a controller in Python, which must not pass through Exudyn's callbacks
    """

    def __init__(self, system: System, start: Array, time_step: float, *, explicit: bool) -> None:
        """start: the inputs at the start, (inputs,)."""
        scene = system.assembly.scene
        self.system, self.explicit, self.time_step = system, explicit, time_step
        self.begun = 0
        self.bad: BadCommand | None = None
        self.commands = np.zeros(len(scene.commands))
        self.loops = start_loops(scene, time_step)
        self.filtering = Filtering(system, time_step)
        self.held = self.end = np.zeros(len(scene.inputs))
        self.places = np.array([scene.inputs.index(drive.input) for drive in system.drives], dtype=int)
        rates = [drive.rate for drive in system.drives]
        self.lagging = {k: _Amplifier(rate, time_step) for k, rate in enumerate(rates) if np.isfinite(rate)}
        starting = start[self.places]
        starting[list(self.lagging)] = 0.0
        self.acting = starting
        system.act(starting)

    def sample(self, inputs: Array) -> bool:
        """Let filters and loops take their samples at these inputs, (inputs,); whether the controllers have worked."""
        self.filtering.step(inputs + self.held)
        if self.commands.size:
            try:
                self.held, self.end, self.commands = self.loops(self.begun, self.filtering.measure)
            except BadCommand as bad:
                self.bad = bad
                return False
        return True

    def act(self, before: Array, after: Array) -> None:
        """Set what acts during the next step, with inputs before and after it, (inputs,) each."""
        held, explicit = self.held, self.explicit
        # The implicit rule takes forces at both ends of a step. A command that jumps there enters with its mean, else
        # the loop would have half a step of delay more.
        values = (before + held if explicit else after + self.end)[self.places]
        for k, follow in self.lagging.items():
            place = self.places[k]
            values[k] = follow(before[place] + held[place], (before if explicit else after)[place] + held[place])
        self.acting = values
        self.system.act(values)
        self.begun += 1

    @property
    def state(self) -> Any:
        """A copy of all that changes from step to step."""
        followed = {k: follow.value for k, follow in self.lagging.items()}
        now = self.begun, self.acting.copy(), self.commands.copy(), self.held.copy(), self.end.copy()
        return (*now, followed, self.loops.state, self.filtering.state)

    def restore(self, state: Any) -> None:
        """Go back to a state."""
        self.begun, acting, commands, held, end, followed, loops, filtering = state
        self.acting, self.commands, self.held, self.end = acting, commands, held, end
        for k, value in followed.items():
            self.lagging[k].value = value
        self.loops.restore(loops)
        self.filtering.restore(filtering)
        self.system.act(acting)


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
    *,
    interrupted: bool,
) -> str:
    """Return why a run has ended in its step number `steps.begun`; empty for one that has come to its end."""
    scene, now = system.assembly.scene, f"t = {steps.begun * steps.time_step:g} s"
    if interrupted:
        return f"simulation stopped at {now}"
    if steps.bad:
        return str(steps.bad)
    if watch.lost:
        return diverged(watch.lost[0][0], steps.begun * steps.time_step, spectral_radius)
    if failure is not None:
        looped = ", or look for a loop that runs away (linearize_closed, unstable_poles)" if scene.loops else ""
        likely = watch.describe_drift(steps.time_step, spectral_radius) or "try a smaller time_step or spectral_radius"
        return f"the integration failed at {now}; {likely}{looped}"
    return ""


def diverged(body: str, time: float, spectral_radius: float) -> str:
    """Return what to say of a run that diverges: which body is lost, and when [s]."""
    return (
        f"the run diverges: at t = {time:g} s body {body!r} is deformed beyond its own size; likely an "
        f"excitation far too large, or a spectral_radius of {spectral_radius:g} on a spinning body without "
        "damping: take a smaller one or a smaller time_step"
    )


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


class _Amplifier:
    """What an amplifier at rest puts out at the end of each time step, whose input runs straight between two values.

    rate: of its low-pass [1/s]
    """

    def __init__(self, rate: float, time_step: float) -> None:
        x = rate * time_step
        self.share = -float(np.expm1(-x))
        self.slope = 1 - self.share / x
        self.value = 0.0

    def __call__(self, before: float, after: float) -> float:
        self.value += self.share * (before - self.value) + self.slope * (after - before)
        return self.value


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
