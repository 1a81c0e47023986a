"""Exudyn's solvers on the system of a scene: statics, time integration, eigenfrequencies; guards while they run."""

import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import Any

import exudyn as exu
import exudyn.solver
import numpy as np

from nassim.base.checks import Array
from nassim.base.progress import Advance, stage
from nassim.simulation.exudyn.jacobian_renewal import JacobianRenewal
from nassim.simulation.exudyn.monitor import Monitor
from nassim.simulation.exudyn.rounding import rounding
from nassim.simulation.exudyn.running_system import System, find_accelerations
from nassim.simulation.exudyn.steady_state import coordinates_at_start, solve_loaded_equilibrium, squares_at_rest
from nassim.simulation.exudyn.step_actions import StepActions
from nassim.simulation.model.reach import find_reach
from nassim.simulation.model.runaway import runaway
from nassim.simulation.model.stopped_runs import CHECKS, Stopped
from nassim.simulation.model.tangents import no_equilibrium

INITIAL = exu.ConfigurationType.Initial
STEPS_OF_A_CHECK = 25
"""Fewest steps between two checks. A check costs as much as one or two steps."""


def _settings(system: System) -> Any:
    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    for solver in (settings.timeIntegration, settings.staticSolver):
        solver.verboseMode = 0
        solver.newton.absoluteTolerance = max(solver.newton.absoluteTolerance, rounding(system.assembly))
    return settings


def fixed_steps(system: System, n_steps: int, time_step: float, spectral_radius: float) -> Any:
    """Make Exudyn's settings of a run with a fixed time step.

    Exudyn finds the time step as the end over the number of steps. With a power of two it is the given one to the last
    bit; a run of fewer steps has to be stopped.

    Args:
        system: the system.
        n_steps: least number of steps.
        time_step: [s].
        spectral_radius: of generalized-alpha.

    Returns:
        The settings.
    """
    settings = _settings(system)
    settings.timeIntegration.numberOfSteps = 2 ** (n_steps - 1).bit_length()
    settings.timeIntegration.endTime = settings.timeIntegration.numberOfSteps * time_step
    settings.timeIntegration.adaptiveStep = False
    settings.timeIntegration.generalizedAlpha.spectralRadius = spectral_radius
    # One solution of linear equations is exact to rounding: no tolerance has to tell small inputs from that of large
    # forces at rest.
    settings.timeIntegration.newton.active = not system.is_linear
    settings.solution.sensors.writePeriod = time_step
    if system.sparse:
        settings.linearSolver.solverType = exu.LinearSolverType.EigenSparse
    return settings


def eigenfrequencies(system: System) -> Array:
    """Return the undamped eigenfrequencies of the system as Exudyn linearises it, ascending [Hz]."""
    eigenvalues, _ = system.mbs.ComputeODE2Eigenvalues()
    return np.sqrt(np.sort(np.abs(eigenvalues))) / (2 * np.pi)


def loaded_eigenfrequencies(system: System) -> Array:
    """Return the undamped eigenfrequencies about the static equilibrium, with the stiffness of all forces [Hz].

    They are ascending; that of a mode that grows, whose square is negative, is negative.
    """
    solve_static(system)
    squares = squares_at_rest(system)
    return np.sign(squares) * np.sqrt(np.abs(squares)) / (2 * np.pi)


def solve_static(system: System) -> None:
    """Bring the system into static equilibrium and keep that as the initial state; RuntimeError without one.

    Where the equilibrium is neutral, such as of a block free to slide, it is the one with the block where it is. The
    system is at rest there, so that its dampers bear nothing; then bodies have their initial twists again.
    """
    data = system.mbs.systemData
    rates, start = np.array(data.GetODE2Coordinates_t(INITIAL)), coordinates_at_start(system)
    _set_rates(system, np.zeros(len(rates)))
    try:
        _find_static_equilibrium(system)
    finally:
        _set_rates(system, _carried(system, rates, start, coordinates_at_start(system)))


def _find_static_equilibrium(system: System) -> None:
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
    # The Jacobians of Exudyn's joints have no geometric stiffness, which the equilibrium under a weight needs.
    try:
        solve_loaded_equilibrium(system)
    except RuntimeError:
        raise RuntimeError(no_equilibrium(system.assembly.scene)) from None


def _set_rates(system: System, rates: Array) -> None:
    for kind in (INITIAL, exu.ConfigurationType.Current):
        system.mbs.systemData.SetODE2Coordinates_t(rates, kind)


def _carried(system: System, rates: Array, start: Array, end: Array) -> Array:
    """Return rates with which bodies have the same twists at other coordinates; deformations keep theirs.

    Args:
        system: Exudyn's system.
        rates: rates at the first coordinates, (n,).
        start: the first coordinates, (n,).
        end: the other ones, (n,).
    """
    result = rates.copy()
    for node in system.nodes.values():
        first = system.mbs.GetNodeODE2Index(node)
        place, turn = slice(first, first + 3), slice(first + 3, first + 7)
        if not np.any(rates[turn]):
            continue  # the node may be of any kind
        scalar, vector = start[first + 3], start[first + 4 : first + 7]
        rate, growth = rates[first + 3], rates[first + 4 : first + 7]
        omega = 2 * (scalar * growth - rate * vector + np.cross(vector, growth))
        scalar, vector = end[first + 3], end[first + 4 : first + 7]
        result[place] += np.cross(omega, end[place] - start[place])
        result[turn] = 0.5 * np.array([-omega @ vector, *(scalar * omega + np.cross(omega, vector))])
    return result


def _solved(system: System, settings: Any) -> bool:
    try:
        with Silent():
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

    Returns:
        The monitor with the results of some 200 checks, and the commands of the loops, (commands, n_steps + 1).

    Raises:
        Stopped: with time, body and likely cause, when the integration fails or diverges or a controller in Python
            fails, and when Ctrl-C ends the run after the step at hand.
    """
    settings = fixed_steps(system, n_steps, time_step, spectral_radius)
    samples = np.column_stack([np.zeros((n_steps + 1, 0)), *(inputs[name] for name in system.assembly.scene.inputs)])
    actions = StepActions(system, samples[0], time_step, explicit=explicit)
    with stage("simulate", total=n_steps, unit="steps", enabled=progress) as advance, _interrupts() as interrupts:
        run = _WholeRun(system, samples, actions, advance, look, interrupts)
        find_accelerations(system, settings)
        system.mbs.SetPreStepUserFunction(run.begin_step)
        # Exudyn's own loop over steps: `SteppedRun` makes the same steps, but costs more for calls into Exudyn.
        failure = _integrate(system, settings, explicit=explicit)
        system.mbs.SetPreStepUserFunction(0)  # Python cannot collect a cycle through Exudyn
        run.end(failure, spectral_radius)
    return run.monitor, run.commands.T


class _WholeRun:
    """A run by Exudyn's own loop over steps, which calls back before each.

    Attributes:
        monitor: the checks of the run.
        commands: commands of the loops, (n_steps + 1, commands).
    """

    def __init__(
        self,
        system: System,
        samples: Array,
        actions: StepActions,
        advance: Advance,
        look: Callable[[int], None] | None,
        interrupts: Sequence[int],
    ) -> None:
        """Begin before the first step.

        Args:
            system: in its state at the start.
            samples: inputs at the time steps, (n_steps + 1, inputs).
            actions: of its steps.
            advance: called with the number of steps done.
            look: see `solve_dynamic`.
            interrupts: filled by Ctrl-C.
        """
        scene, self.n_steps = system.assembly.scene, len(samples) - 1
        self._system, self._samples, self._actions = system, samples, actions
        self._advance, self._look, self._interrupts = advance, look, interrupts
        self._renews = system.renews_jacobian and not actions.explicit
        self._chunk = max(STEPS_OF_A_CHECK, self.n_steps // CHECKS)
        self.commands = np.zeros((self.n_steps + 1, len(scene.commands)))
        system.filtered.update({output: np.zeros(self.n_steps + 1) for output in actions.filtering.passed})
        reach = find_reach(system.assembly, samples.T, actions.time_step) if scene.commands else None
        self.monitor = Monitor(system, reach)

    @cached_property
    def _renewal(self) -> JacobianRenewal:
        return JacobianRenewal(self._system.mbs.sys["dynamicSolver"])

    def _sample(self) -> bool:
        """Take the samples of filters and loops and record them; whether the controllers have worked."""
        actions, n = self._actions, self._actions.begun
        if not actions.sample(self._samples[n]):
            return False
        if actions.commands.size:
            self.commands[n] = actions.commands
        for output, passed in actions.filtering.passed.items():
            self._system.filtered[output][n] = passed
        return True

    def begin_step(self, _mbs: Any, _time: float) -> bool:
        """Take the samples at a time step and set what acts until the next; whether to go on beyond that."""
        actions, samples = self._actions, self._samples
        n = actions.begun
        if self._look:
            self._look(n)
        if actions.samples_any and not self._sample():
            return False
        if self._renews:
            self._renewal.begin_step()
        if actions.act(samples[n], samples[n + 1]):
            self._system.mbs.sys["dynamicSolver"].conv.jacobianUpdateRequested = True
        begun = n + 1
        if begun % self._chunk == 0:
            self._advance(self._chunk)
            self.monitor.look(n)
        return not self._interrupts and not self.monitor.lost and begun < self.n_steps

    def _look_before_failure(self) -> None:
        """Look at the last state that Newton's iterations have found, which may tell why the next step fails."""
        data, now = self._system.mbs.systemData, exu.ConfigurationType
        data.SetSystemState(data.GetSystemState(now.StartOfStep), now.Current)
        self.monitor.look(max(self._actions.begun - 1, 0))

    def end(self, failure: Exception | None, spectral_radius: float) -> None:
        """Take the last sample; raises Stopped where the run has not come to its end."""
        monitor, bad, interrupted = self.monitor, self._actions.bad, bool(self._interrupts)
        if failure:
            self._look_before_failure()
        if not (interrupted or failure or monitor.lost or bad):
            monitor.look(self.n_steps)
            self._sample()
            bad = self._actions.bad
        told = describe_end(self._system, monitor, self._actions, failure, spectral_radius, interrupted=interrupted)
        if not told:
            if self._look:
                self._look(self.n_steps)
            self._advance(self.n_steps % self._chunk)
            return
        n, scene = self._actions.begun, self._system.assembly.scene
        outputs = self._system.recorded(n)
        if monitor.lost and scene.loops and not interrupted:
            told = runaway(scene, monitor.lost[0][1], outputs.T, self._actions.time_step)
        cause = bad.__cause__ if bad else None if monitor.lost else failure
        readings = np.vstack([outputs, self.commands[:n].T])
        raise Stopped(told, readings, monitor.valid.last, interrupted=interrupted) from cause


def _integrate(system: System, settings: Any, *, explicit: bool) -> Exception | None:
    """Run Exudyn's solver; the error when it fails."""
    kind = exu.DynamicSolverType.RK44 if explicit else exu.DynamicSolverType.GeneralizedAlpha
    try:
        # A run that diverges raises an error of its own.
        with _uncounted_vectors(), Silent(), np.errstate(over="ignore", invalid="ignore"):
            system.mbs.SolveDynamic(settings, solverType=kind)
    except Exception as error:
        return error
    return None


def describe_end(
    system: System,
    monitor: Monitor,
    actions: StepActions,
    failure: Exception | None,
    spectral_radius: float,
    *,
    interrupted: bool,
) -> str:
    """Return why a run has ended in its step number `actions.begun`; empty for one that has come to its end."""
    scene, now = system.assembly.scene, f"t = {actions.begun * actions.time_step:g} s"
    if interrupted:
        return f"simulation stopped at {now}"
    if actions.bad:
        return str(actions.bad)
    if monitor.lost:
        return diverged(monitor.lost[0][0], actions.begun * actions.time_step, spectral_radius)
    if failure is not None:
        looped = ", or look for a loop that runs away (linearize_closed, unstable_poles)" if scene.loops else ""
        likely = (
            monitor.describe_drift(actions.time_step, spectral_radius) or "try a smaller time_step or spectral_radius"
        )
        return f"the integration failed at {now}; {likely}{looped}"
    return ""


def diverged(body: str, time: float, spectral_radius: float) -> str:
    """Return what to say of a run that diverges: which body is lost, and when [s]."""
    return (
        f"the run diverges: at t = {time:g} s body {body!r} is deformed beyond its own size; likely an "
        f"excitation far too large, or a spectral_radius of {spectral_radius:g} on a spinning body without "
        "damping: take a smaller one or a smaller time_step"
    )


class Silent:
    """Context in which Exudyn prints nothing, because nassim reports failures; faster than a generator's context."""

    def __enter__(self) -> None:
        self._loud, exu.config.printToConsole = exu.config.printToConsole, False

    def __exit__(self, *_: object) -> None:
        exu.config.printToConsole = self._loud


@contextmanager
def _uncounted_vectors() -> Iterator[None]:
    """Keep Exudyn from counting the vectors that inputs set at every step, of which it warns amid the progress."""
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
