"""Von Mises stress under noise: its spectrum and its rms from a linear model.

The squared von Mises stress is a quadratic form of the six components, s^T A s with A = L^T L. Its mean under noise is
therefore the sum of the mean squares of the six combinations L s, with all correlations of the components.
Source: D. J. Segalman et al., Estimating the probability distribution of von Mises stress for structures undergoing
random excitation, Sandia National Laboratories, SAND98-0260 (1998).
"""

from collections.abc import Mapping

from nassim.base.field_types import ArrayLike
from nassim.bodies.stress import COMPONENTS, VON_MISES_ROOT
from nassim.signals.spectra import Spectrum
from nassim.systems.linear_model import LinearModel, Names, names
from nassim.systems.noise_budgets import NoiseBudget, noise_budget
from nassim.systems.transformed_signals import with_outputs


def von_mises_budget(
    model: LinearModel,
    spectra: Mapping[str, Spectrum | ArrayLike],
    frequency: ArrayLike,
    *,
    sensors: Names,
) -> NoiseBudget:
    """Compute the spectra of the von Mises stress that uncorrelated disturbances with given spectra cause.

    The noise has no mean. With a static stress, the mean square of the sum is the sum of both squares.

    Args:
        model: linear model with the six outputs of `StressAt` sensors without a component.
        spectra: as of `noise_budget`.
        frequency: as of `noise_budget` [Hz].
        sensors: names of the sensors.

    Returns:
        Budget with an output for each sensor, of its name; `rms` gives the rms von Mises stress [Pa].

    Raises:
        ValueError: for a sensor without its six outputs or named twice, and as `noise_budget`.
    """
    chosen = names("sensor", sensors)
    roots = {name: [f"{name}, von Mises root {k}" for k in range(6)] for name in chosen}
    for name, root in roots.items():
        model = with_outputs(model, root, VON_MISES_ROOT, of=[f"{name}.{c}" for c in COMPONENTS])
    budget = noise_budget(model, spectra, frequency, outputs=[name for root in roots.values() for name in root])
    psd = budget.psd.reshape(len(chosen), 6, *budget.psd.shape[1:]).sum(axis=1)
    return NoiseBudget(budget.frequency, psd, chosen, budget.inputs, ("Pa",) * len(chosen))
