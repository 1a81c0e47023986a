"""Modes beyond the valid frequency of the bodies' reductions, and a warning of loops that they could make unstable."""

import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from nassim.base.callers import outside
from nassim.base.checks import Array
from nassim.bodies.strain import Strain
from nassim.scene.loop import Loop
from nassim.scene.scene import Scene
from nassim.systems.folding import folding_modes
from nassim.systems.linear_model import LinearModel
from nassim.systems.python_controller import PythonController

BEYOND = 0.5
"""Share of strain energy in bodies with incomplete modes at a mode's frequency, above which the mode is unsupported."""


def unsupported_modes(
    scene: Scene, valid: Mapping[str, float], strains: Sequence[Strain], frequency: Array, modes: Array
) -> Array:
    """Find the modes with most strain energy beyond the bodies' valid frequencies, or above the scene's limit.

    Args:
        scene: the scene.
        valid: frequency up to which each flexible body has all modes, by name [Hz].
        strains: strains, those of the bodies that deform first.
        frequency: frequencies of the modes, (n,) [Hz].
        modes: the modes in all coordinates, (n_all, n).

    Returns:
        Whether each mode is unsupported, bool (n,).
    """
    if scene.quasi_static_above is not None:
        above: Array = frequency > scene.quasi_static_above
        return above
    beyond = np.zeros(len(frequency))
    for body, strain in zip(scene.deformable_bodies, strains, strict=False):
        beyond += (frequency > valid[body.name]) * np.sum((strain.root @ modes) ** 2, axis=0)
    result: Array = beyond > BEYOND * (2 * np.pi * frequency) ** 2
    return result


def warn_of_folding(model: LinearModel, loops: Sequence[Loop]) -> None:
    """Warn of modes that are quasi-static in a sampled model and could make a loop unstable where they fold.

    Args:
        model: the continuous model with the loops open.
        loops: the loops.
    """
    for loop in loops:
        if isinstance(loop.controller, PythonController):  # of no known gain
            continue
        modes = folding_modes(model, loop.linear_controller, measured=loop.measured, driven=loop.driven)
        worst = [mode for mode in modes if mode.loop_gain > 1]
        if worst:
            listed = ", ".join(f"{mode.frequency:.4g} (folds to {mode.folded:.4g})" for mode in worst[:4])
            warnings.warn(
                f"loop {loop.name!r} may be unstable on modes that are quasi-static in this model, as they lie beyond "
                f"what the bodies' reductions hold: at {listed} Hz. If they are as little damped as the scene says, "
                f"the loop's gain on them is up to {worst[0].loop_gain:.3g}: give the actuator a bandwidth, or lower "
                f"the gain by that factor, or reduce the bodies with more modes",
                stacklevel=outside(),
            )
