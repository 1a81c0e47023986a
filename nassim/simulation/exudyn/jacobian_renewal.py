"""Renewal of the Jacobian of Newton's iterations, where it pays.

Exudyn goes on with a Jacobian until an iteration leaves more than half of the residual. As a machine turns, more and
more iterations are needed long before that.
"""

from typing import Any

COST = 25
"""Iterations that cost as much as a Jacobian of a hexapod; that of a few rigid bodies costs less."""
RENEWED = 1e-6
"""Share of the residual that an iteration may leave in a step that renews the Jacobian."""
FEW = 3
"""Iterations of a step that are no reason for a new Jacobian."""
STEPS = 8
"""Steps between two decisions, each of which costs some microseconds."""


class JacobianRenewal:
    """Rule that renews the Jacobian when a step costs more than the mean step with it, its own cost included."""

    def __init__(self, solver: Any) -> None:
        """Begin before the first step of a solver, whose settings of Newton's iterations change from step to step."""
        self._solver = solver
        self._usual = solver.newton.modifiedNewtonContractivity
        self._counts = solver.it.newtonStepsCount, solver.it.newtonJacobiCount
        self._steps = self._iterations = self._before = 0

    def begin_step(self) -> None:
        """Ask the solver for a new Jacobian in this step if that pays."""
        self._solver.newton.modifiedNewtonContractivity = self._usual
        if self._steps and self._steps % STEPS == 0:
            self._decide()
        self._steps += 1

    def _decide(self) -> None:
        iterations, jacobians = self._new()
        self._iterations += iterations
        latest = (self._iterations - self._before) / STEPS
        pays = latest > FEW and latest * self._steps > COST + self._iterations
        if pays and not jacobians:
            # After the first iteration. Before it, a single one could pass, and leave its error in the constraints.
            self._solver.newton.modifiedNewtonContractivity = RENEWED
        if pays or jacobians:
            self._steps = self._iterations = 0
        self._before = self._iterations
        counts = self._solver.it
        self._counts = counts.newtonStepsCount, counts.newtonJacobiCount + (pays and not jacobians)

    def _new(self) -> tuple[int, int]:
        """Return numbers of iterations and of Jacobians since the last decision."""
        counts = self._solver.it
        return counts.newtonStepsCount - self._counts[0], counts.newtonJacobiCount - self._counts[1]

    @property
    def state(self) -> Any:
        """A copy of all that changes from step to step."""
        return self._steps, self._iterations, self._before, self._new()

    def restore(self, state: Any) -> None:
        """Go back to a state, from which the solver goes on with one Jacobian that is not new."""
        self._steps, self._iterations, self._before, (iterations, jacobians) = state
        counts = self._solver.it
        self._counts = counts.newtonStepsCount - iterations, counts.newtonJacobiCount + 1 - jacobians
