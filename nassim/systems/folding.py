"""Aliasing of lightly damped modes above half the sample rate in digital loops ("folding").

A held and sampled mode of frequency f_m far above the sample rate rings at the frequency to which f_m folds. From its
step response R (1 - Re exp(p k T)), with a pole p, a time step T and a static gain R, it resonates by

    R (z - 1) / 2 (1 / (z - q) + 1 / (z - q*)),   q = |exp(p T)| z,   z = exp(i theta)

where theta is the angle per sample of the folded frequency. The first term has the magnitude R sin(theta / 2) / (1 -
|q|). The second one, its mirror image, is small beside it, but doubles it at half of the sample rate.
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
ON_CIRCLE = 1e-9
"""Distance of a controller's pole from the unit circle up to which its resonance has no bound."""
NEAR_ZERO = 2.0
"""Angle over the decay per sample below which a mode hardly rings: there its mirror image does not count."""


@dataclass(frozen=True)
class FoldingMode:
    """Mode above half the sample rate, or several of one frequency, that a sampled model treats as quasi-static.

    Attributes:
        frequency: frequency of the mode [Hz].
        folded: frequency below half the sample rate where the mode would appear. It is as uncertain as `frequency`
            [Hz].
        loop_gain: largest loop gain that the mode can cause at any folded frequency. Below 1 a mode that rings through
            many samples cannot alone make the loop unstable [-].
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
    damping that the model gives it. Beside modes that decay by more than a tenth within a sample, such as one with 2 %
    of damping above 0.84 times the sample rate, take half of this gain.

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
    own = (poles.imag > 0) & (shares[unsupported].sum(axis=0) > PARTICIPATION * shares.sum(axis=0))
    if not own.any():
        return ()
    k = controller_model(controller, inputs=measured, outputs=driven, time_step=1 / rate)
    angles = _angles(np.linalg.eigvals(k.A))
    gains = finite("gain", gain) * transfer_matrix(k.matrices, np.exp(1j * angles))
    poles, left, right = poles[own], left[:, own].T.conj(), right[:, own]
    drives = left @ (model.B[:, columns] / scale[:, None]) / np.sum(left.T * right, axis=0)[:, None]
    shows, order = (model.C[rows] * scale) @ right, np.argsort(np.abs(poles))
    frequency = np.abs(poles[order]) / (2 * np.pi)
    decays = -np.expm1(poles.real / rate)

    def largest(group: Array, peaks: Array) -> float:
        """Return the largest loop gain of modes with peaks at the angles; those of one frequency add up."""
        static = shows[:, group] * (2 / np.abs(poles[group]))
        loops = np.einsum("uyf,yk,fk,kv->fuv", gains, static, peaks, drives[group])
        return float(np.abs(np.linalg.eigvals(loops)).max())

    found = []
    for group in np.split(order, np.flatnonzero(np.diff(frequency) > SAME_FREQUENCY * frequency[1:]) + 1):
        lasting = decays[group] <= 0
        endless = largest(group[lasting], np.ones((len(angles), lasting.sum())))
        size = np.inf if endless else largest(group[~lasting], _peaks(angles, decays[group[~lasting]]))
        pole = poles[group[0]]
        at = float(abs(pole)) / (2 * np.pi)
        found.append(FoldingMode(at, abs(at - rate * round(at / rate)), size))
    return tuple(sorted(found, key=lambda mode: -mode.loop_gain))


def _angles(poles: Array) -> Array:
    """Return angles per sample at which the loop gain is evaluated, also at the resonances of a controller [rad].

    Args:
        poles: of the controller, in the z-plane, (n,).
    """
    damped = np.abs(np.angle(poles[np.abs(np.abs(poles) - 1) > ON_CIRCLE]))
    inside = (damped >= FOLDED_ANGLES[0]) & (damped <= FOLDED_ANGLES[-1])
    return np.union1d(FOLDED_ANGLES, damped[inside])


def _peaks(angles: Array, decays: Array) -> Array:
    """Return how far modes resonate, over their static gains, at the angles to which they may fold, (angles, modes).

    Args:
        angles: angles per sample of the folded frequencies, (angles,) [rad].
        decays: 1 - |exp(p T)|, (modes,).
    """
    z = np.exp(1j * angles)[:, None]
    alone = np.abs(z - 1) / 2 / decays
    both = np.abs((z - 1) / 2 * (1 / (z * decays) + 1 / (z - (1 - decays) / z)))
    return np.where(angles[:, None] > NEAR_ZERO * decays, np.maximum(alone, both), alone)
