"""Aliasing of lightly damped modes above half the sample rate in digital loops ("folding").

A held and sampled mode of frequency f_m far above the sample rate rings at the frequency to which f_m folds. For a pole
p, a time step T and a static gain R, its response there has the magnitude R sin(theta / 2) / (1 - |exp(p T)|), where
theta is the angle per sample of the folded frequency. This follows from the step response 1 - Re exp(p k T) of a mode.
"""

from dataclasses import dataclass

import numpy as np

from nassim.base.checks import finite
from nassim.base.field_types import Array
from nassim.base.short_repr import short_repr
from nassim.systems.controller_models import controller_model
from nassim.systems.controllers import Controller
from nassim.systems.feedback import loop_indices
from nassim.systems.linear_model import LinearModel, Names
from nassim.systems.transfer_matrices import transfer_matrix

FOLDED_ANGLES = np.geomspace(1e-3, np.pi, 300)
"""Angles per sample of the folded frequencies at which the loop gain is evaluated [rad]."""
SAME_FREQUENCY = 1e-3
"""Relative difference of frequencies below which modes count as one, such as those of six equal struts."""
PARTICIPATION = 0.5
"""Participation of a pole in the states of unsupported modes from which on it counts as one of them."""


@dataclass(frozen=True)
class FoldingMode:
    """Mode above half the sample rate, or several of one frequency, that a sampled model treats as quasi-static.

    Attributes:
        frequency: frequency of the mode [Hz].
        folded: frequency below half the sample rate where the mode would appear. It is as uncertain as `frequency`
            [Hz].
        loop_gain: largest loop gain that the mode can cause at any folded frequency. Below 1 the mode alone cannot make
            the loop unstable [-].
    """

    frequency: float
    folded: float
    loop_gain: float
    __repr__ = short_repr


def folding_modes(
    model: LinearModel, controller: Controller, *, measured: Names, driven: Names, gain: float = 1.0
) -> tuple[FoldingMode, ...]:
    """Find the unsupported modes that fold in a digital loop, the one with the largest loop gain first.

    `sampled` treats these modes as quasi-static, so neither margins nor a largest stable gain contain their resonances.
    Up to the gain 1 / (largest loop gain), none of them alone makes the loop unstable at any frequency, with the
    damping that the model gives it.

    Args:
        model: continuous model with `LinearModel.unsupported`, as `linearize` returns it.
        controller: controller of the loop.
        measured: output, or outputs, that the controller reads.
        driven: input, or inputs, to which the output of the controller is added.
        gain: factor on the whole controller [-].

    Returns:
        Folding modes; empty without any.

    Raises:
        ValueError: for a sampled model, and in the cases of `close_loop` for signals that do not fit.
    """
    if model.time_step is not None:
        raise ValueError("folding_modes takes the continuous model: a sampled one no longer has these modes")
    rows, columns = loop_indices(model, measured, driven)
    rate = controller.sample_rate
    unsupported = model.unsupported_above(rate / 2)
    scale, poles, left, right = model.balanced_eigenvectors
    shares = np.abs(left * right)
    own = (poles.imag > np.pi * rate) & (shares[unsupported].sum(axis=0) > PARTICIPATION * shares.sum(axis=0))
    if not own.any():
        return ()
    k = controller_model(controller, inputs=measured, outputs=driven, time_step=1 / rate)
    gains = finite("gain", gain) * transfer_matrix(k.matrices, np.exp(1j * FOLDED_ANGLES))
    poles, left, right = poles[own], left[:, own].T.conj(), right[:, own]
    drives = left @ (model.B[:, columns] / scale[:, None]) / np.sum(left.T * right, axis=0)[:, None]
    shows, order = (model.C[rows] * scale) @ right, np.argsort(np.abs(poles))
    frequency = np.abs(poles[order]) / (2 * np.pi)
    decays = -np.expm1(poles.real / rate)

    def largest(group: Array, weights: Array | float) -> float:
        """Return the largest loop gain of modes with weights; those of one frequency add up."""
        loops = np.einsum(
            "uyf,yk,kv->fuv", gains, shows[:, group] * (2 / np.abs(poles[group]) * weights), drives[group]
        )
        return float((np.abs(np.linalg.eigvals(loops)).max(axis=1) * np.sin(FOLDED_ANGLES / 2)).max())

    found = []
    for group in np.split(order, np.flatnonzero(np.diff(frequency) > SAME_FREQUENCY * frequency[1:]) + 1):
        lasting = decays[group] <= 0
        endless = largest(group[lasting], 1.0)
        size = np.inf if endless else largest(group[~lasting], 1 / decays[group[~lasting]])
        pole = poles[group[0]]
        at = float(abs(pole)) / (2 * np.pi)
        found.append(FoldingMode(at, abs(at - rate * round(at / rate)), size))
    return tuple(sorted(found, key=lambda mode: -mode.loop_gain))
