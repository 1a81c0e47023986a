"""Warning of loops that modes beyond the valid frequency of a sampled model could make unstable, where they fold."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from nassim.base.warning_log import warn
from nassim.scene.loop import Loop
from nassim.systems.folding import folding_modes
from nassim.systems.linear_model import LinearModel
from nassim.systems.python_controller import PythonController


def warn_of_folding(model: LinearModel, loops: Sequence[Loop]) -> None:
    """Warn of modes that are quasi-static in a sampled model and could make a loop unstable where they fold.

    Args:
        model: the continuous model with the loops open.
        loops: the loops.
    """
    if loops:
        model = with_common_folding(model, [loop.controller.sample_rate for loop in loops])
    for loop in loops:
        if isinstance(loop.controller, PythonController):  # of no known gain
            continue
        modes = folding_modes(model, loop.linear_controller, measured=loop.measured, driven=loop.driven)
        worst = [mode for mode in modes if mode.loop_gain > 1]
        if worst:
            listed = ", ".join(f"{mode.frequency:.4g} (folds to {mode.folded:.4g})" for mode in worst[:4])
            warn(
                f"loop {loop.name!r} may be unstable on modes that are quasi-static in this model, as they lie beyond "
                f"what the bodies' reductions hold: at {listed} Hz. If they are as little damped as the scene says, "
                f"the loop's gain on them is up to {worst[0].loop_gain:.3g}: give the actuator a bandwidth, or lower "
                f"the gain by that factor, or reduce the bodies with more modes"
            )


def with_common_folding(model: LinearModel, rates: Sequence[float]) -> LinearModel:
    """Return a model whose quasi-static modes at the lowest of sample rates [Hz] are so at all of them, as in runs."""
    own = model.unsupported
    return replace(model, unsupported=np.where(own > min(rates) / 2, np.maximum(own, max(rates)), own))
