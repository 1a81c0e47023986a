"""Lower limits of the cost of nassim's work: Exudyn's own steps, matrix products, solves with held unknowns."""

from collections.abc import Callable
from functools import partial
from typing import Any

import exudyn as exu
import numpy as np

from nassim import FEModel, Scene
from nassim.fem.condensation import vector_dofs
from nassim.simulation import assemble
from nassim.simulation.exudyn.rounding import rounding
from nassim.simulation.exudyn.running_system import find_accelerations
from nassim.simulation.exudyn.system import build_system
from nassim.simulation.model.period_correction import Steps

BLOCK = 64
"""Samples in a block of exact steps."""
PUSH = 1e-5
"""Value of every input [V], [N], [N m]. Without motion, Newton's iterations would end at once."""


def exudyns_steps(scene: Scene, step: float, n_steps: int) -> Callable[[], Any]:
    """Return steps of Exudyn's solver on a scene's system with constant inputs, without loops, checks and records."""
    system = build_system(assemble(scene), {}, Steps(step))
    system.apply(dict.fromkeys(scene.inputs, PUSH))
    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = settings.timeIntegration.endTime = n_steps * step
    settings.timeIntegration.verboseMode = 0
    settings.timeIntegration.numberOfSteps = n_steps
    settings.timeIntegration.adaptiveStep = False
    settings.timeIntegration.generalizedAlpha.spectralRadius = 1.0
    newton = settings.timeIntegration.newton  # as `simulate` has it
    newton.absoluteTolerance = max(newton.absoluteTolerance, rounding(system.assembly))
    newton.active = not system.is_linear
    if system.sparse:
        settings.linearSolver.solverType = exu.LinearSolverType.EigenSparse
    find_accelerations(system, settings)
    # The system lives as long as its container.
    return partial(lambda _, solve: solve(settings), system, system.mbs.SolveDynamic)


def bare_product(states: int, inputs: int, outputs: int, samples: int) -> Callable[[], Any]:
    """Return the matrix product that gives outputs block by block from states at their starts and inputs."""
    given = states + BLOCK * inputs
    return partial(np.matmul, np.ones((-(-samples // BLOCK), given)), np.ones((given, BLOCK * outputs)))


def held_unknowns(model: FEModel) -> np.ndarray:
    """Return the indices of the unknowns that nassim's route holds at zero while it solves."""
    return np.unique(np.concatenate([vector_dofs(coupling, model.n_dofs) for coupling in model.couplings]))
