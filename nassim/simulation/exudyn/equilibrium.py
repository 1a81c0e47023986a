"""Static equilibrium by Newton's rule with the whole tangent, for what Exudyn's own iterations do not find.

Exudyn leaves out of its static tangent how loads and constraint forces turn bodies as these rotate. Its iterations then
approach the equilibrium by the ratio of the weight's stiffness to the springs', and not at all where that is near one:
a pendulum on a spring. Differences of the residual hold everything.
"""

from typing import Any

import exudyn as exu
import numpy as np
import scipy

from nassim.base.checks import Array

ITERATIONS = 50
HALVINGS = 12
DIFFERENCE = 1e-6
"""Step of the differences, of all coordinates [m, -]."""
CONVERGED = 1e-9
"""Residual over the first one at which an equilibrium is found."""
STABLE = 1e-9
"""Share of the largest stiffness by which the least may lie below zero."""


def find_stable_equilibrium(mbs: Any, settings: Any) -> bool:
    """Find an equilibrium near the initial state and make it the initial state; False where none is found or stable.

    mbs: Exudyn's system of coordinates and constraint forces; settings: with those of its static solver
    """
    solver: Any = exu.MainSolverStatic()
    solver.InitializeSolver(mbs, settings)
    data = mbs.systemData
    n, unknowns = data.ODE2Size(), np.concatenate([data.GetODE2Coordinates(), data.GetAECoordinates()])

    def residual(values: Array) -> Array:
        data.SetODE2Coordinates(values[:n])
        data.SetAECoordinates(values[n:])
        solver.ComputeNewtonResidual(mbs, settings)
        return np.array(solver.GetSystemResidual())

    def tangent(values: Array) -> Array:
        steps = DIFFERENCE * np.eye(len(values))
        return np.column_stack([residual(values + step) - residual(values - step) for step in steps]) / (2 * DIFFERENCE)

    left = residual(unknowns)
    enough = max(CONVERGED * float(np.linalg.norm(left)), settings.staticSolver.newton.absoluteTolerance)
    for _ in range(ITERATIONS):
        matrix, size = tangent(unknowns), np.linalg.norm(left)
        if size <= enough:
            break
        step = np.linalg.lstsq(matrix, -left)[0]
        for halvings in range(HALVINGS):
            trial = unknowns + 0.5**halvings * step
            left = residual(trial)
            if np.linalg.norm(left) < size:
                break
        else:
            return False
        unknowns = trial
    else:
        return False
    if not _is_stable(matrix, n):
        return False
    data.SetODE2Coordinates(unknowns[:n], exu.ConfigurationType.Initial)
    data.SetAECoordinates(unknowns[n:], exu.ConfigurationType.Initial)
    return True


def _is_stable(tangent: Array, n: int) -> bool:
    """Whether motions that constraints allow are resisted, or at least not driven."""
    free = scipy.linalg.null_space(tangent[n:, :n]) if len(tangent) > n else np.eye(n)
    stiffness = -free.T @ tangent[:n, :n] @ free  # the residual is what pushes, less what resists
    least, *_, most = (0.0, 0.0, *np.linalg.eigvalsh(0.5 * (stiffness + stiffness.T)))
    return least >= -STABLE * most
