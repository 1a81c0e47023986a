"""Runs of Exudyn's generalized-alpha solver step by step."""

from typing import Any
from weakref import WeakMethod

import exudyn as exu
import numpy as np

from nassim.base.checks import Array
from nassim.simulation.exudyn.jacobian_renewal import JacobianRenewal
from nassim.simulation.exudyn.monitor import Monitor
from nassim.simulation.exudyn.running_system import System, find_accelerations
from nassim.simulation.exudyn.solver import Silent, describe_end, fixed_steps
from nassim.simulation.exudyn.step_actions import StepActions
from nassim.simulation.model.stopped_runs import Stopped

MANY = 2**30
"""Steps that a run one by one may have."""


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
        self._settings = fixed_steps(system, MANY, time_step, spectral_radius)
        self._actions = StepActions(system, inputs, time_step, explicit=False)
        self.monitor = Monitor(system)
        find_accelerations(system, self._settings)
        self._jacobians, self._solver = self._start_solver(), self._start_solver()
        self._renewal = JacobianRenewal(self._solver)
        self._jacobian: Array | None = None
        self._restored: Array | None = None
        weak = WeakMethod(self._set_jacobian)  # Python cannot collect a cycle through Exudyn

        def set_jacobian(*arguments: Any) -> bool:
            own = weak()
            return own is not None and own(*arguments)

        self._solver.SetUserFunctionComputeNewtonJacobian(system.mbs, set_jacobian)
        self._sample()

    def _start_solver(self) -> Any:
        solver: Any = exu.MainSolverImplicitSecondOrder()
        with Silent():
            if not solver.InitializeSolver(self.system.mbs, self._settings):
                raise Stopped("Exudyn finds no accelerations at the start")
        solver.it.currentStepSize = self._time_step
        return solver

    def _sample(self) -> None:
        if not self._actions.sample(self._inputs):
            self._stop(None)
        outputs, commands = self._actions.filtering.read_all(), self._actions.commands
        self.row = np.concatenate([outputs, commands]) if commands.size else outputs

    def _stop(self, failure: Exception | None) -> None:
        told = describe_end(self.system, self.monitor, self._actions, failure, self._radius, interrupted=False)
        cause = self._actions.bad.__cause__ if self._actions.bad else failure
        raise Stopped(told) from cause

    def step(self, inputs: Array) -> None:
        """Go on by a step to these inputs, shape (inputs,).

        Raises:
            Stopped: when the step fails or a controller in Python does, without readings.
        """
        mbs, solver, settings = self.system.mbs, self._solver, self._settings
        if self._actions.act(self._inputs, inputs):
            solver.conv.jacobianUpdateRequested = True
        try:
            with Silent():
                if self.system.renews_jacobian:
                    self._renewal.begin_step()
                if not self.system.is_linear:
                    self._keep_start()
                solver.InitializeStep(mbs, settings)
                mbs.systemData.SetTime((self.count + 1) * self._time_step)  # which drives of constant speed follow
                if not solver.DiscontinuousIteration(mbs, settings):
                    raise RuntimeError("Newton's iterations do not converge")
                solver.FinishStep(mbs, settings)
        except Exception as error:
            self._stop(error)
        self.count, self._inputs = self.count + 1, inputs
        self._sample()

    def _keep_start(self) -> None:
        """Keep the state at the start of a step, as Exudyn's own loop does: Newton's iterations restart there."""
        data, start = self.system.mbs.systemData, exu.ConfigurationType.StartOfStep
        data.SetSystemState(data.GetSystemState(), start)
        data.SetODE2Coordinates_tt(data.GetODE2Coordinates_tt(), start)

    @property
    def state(self) -> Any:
        """A copy of all that changes from step to step, with the Jacobian, which may be that of an earlier step."""
        data, solver = self.system.mbs.systemData, self._solver
        exudyn = (data.GetSystemState(), np.array(data.GetODE2Coordinates_tt()), np.array(solver.GetAAlgorithmic()))
        rules = self._renewal.state, self.system.angles, self._actions.state
        return (*exudyn, self._jacobian, *rules, solver.it.currentTime, self.count, self._inputs, self.row)

    def restore(self, state: Any) -> None:
        """Go back to a state."""
        (system_state, accelerations, algorithmic, jacobian, renewal, angles, actions, time, *own) = state
        self.count, self._inputs, self.row = own
        data, solver, settings = self.system.mbs.systemData, self._solver, self._settings
        self._jacobian = self._restored = jacobian
        solver.conv.jacobianUpdateRequested = True
        # Exudyn starts with the accelerations that it finds as those of its rule, which can be set in no other way.
        data.SetSystemState(system_state, exu.ConfigurationType.Initial)
        data.SetODE2Coordinates_tt(algorithmic, exu.ConfigurationType.Initial)
        rule = settings.timeIntegration.generalizedAlpha
        rule.computeInitialAccelerations = rule.resetAccelerations = False
        settings.timeIntegration.startTime = time
        solver.InitializeSolverInitialConditions(self.system.mbs, settings)
        solver.it.currentTime, solver.it.currentStepSize = time, self._time_step
        data.SetODE2Coordinates_tt(accelerations, exu.ConfigurationType.Current)
        self._renewal.restore(renewal)
        self.system.restore_angles(angles)
        self._actions.restore(actions)

    def _set_jacobian(self, solver: Any, mbs: Any, settings: Any) -> bool:
        """Set the Jacobian that Newton's iterations request: the present one, or after `restore` that of the state.

        Newton's iterations keep a Jacobian over several steps, and Exudyn overwrites it by its inverse. A second solver
        computes it, because this method replaces the solver's own function.
        """
        if self._restored is None:
            self._jacobians.ComputeMassMatrix(mbs)
            self._jacobians.ComputeNewtonJacobian(mbs, settings)
            self._jacobian = np.array(self._jacobians.GetSystemJacobian())
        else:
            self._jacobian, self._restored = self._restored, None
        solver.SetSystemJacobian(self._jacobian)
        return True
