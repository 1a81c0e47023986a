"""Modes that fold: what a digital loop would make of lightly damped modes above half of its sample rate.

Held and sampled, a mode of frequency f_m far above the sample rate rings at the frequency to which f_m folds. For a
pole p, time step T and static gain R, its response there has the size R sin(theta / 2) / (1 - |exp(p T)|), with theta
the angle per sample of the folded frequency. It follows from the step response 1 - Re exp(p k T) of a mode.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from nassim.base.checks import finite, known
from nassim.systems.controllers import Controller
from nassim.systems.feedback import controller_model
from nassim.systems.linear_model import LinearModel, Names, names
from nassim.systems.state_space import transfer_matrix

ANGLES = np.geomspace(1e-3, np.pi, 300)
"""Of folded frequencies, per sample [rad]."""
SAME = 1e-3
"""Relative difference of two frequencies of modes that fold to one place, as of six struts alike."""
BELONGS = 0.5
"""Share of a pole in the states of unsupported modes, from which on it is one of them."""


@dataclass(frozen=True)
class FoldingMode:
    """A mode, or several of one frequency, that is quasi-static in a sampled model, and what a loop would make of it.

    frequency: of the mode [Hz]; folded: where it would appear below half of the sample rate [Hz], as uncertain as
        the frequency
    loop_gain: largest that it could give the loop, wherever it folds [-]; below 1 it cannot make the loop unstable
        by itself
    """

    frequency: float
    folded: float
    loop_gain: float


def folding_modes(
    model: LinearModel, controller: Controller, *, measured: Names, driven: Names, gain: float = 1.0
) -> tuple[FoldingMode, ...]:
    """Find the unsupported modes that fold in a digital loop, the one with the largest loop gain first.

    `sampled` takes them as quasi-static, so neither margins nor a largest stable gain know of their resonances. Up to
    the gain 1 / (largest loop gain), none of them alone makes the loop unstable, whatever its frequency is, with the
    damping that the model gives it.

    Args:
        model: continuous, with `LinearModel.unsupported` as `linearize` gives it.
        controller: of the loop.
        measured: output, or outputs, that it reads.
        driven: input, or inputs, to which it adds.
        gain: factor on the whole controller [-].

    Raises:
        ValueError: for a sampled model, and as `close_loop` for signals that do not fit.
    """
    if model.time_step is not None:
        raise ValueError("folding_modes takes the continuous model: a sampled one has these modes no more")
    rows = [model.outputs.index(known("output", name, model.outputs)) for name in names("measured signal", measured)]
    columns = [model.inputs.index(known("input", name, model.inputs)) for name in names("driven signal", driven)]
    rate, unsupported = controller.sample_rate, np.zeros(len(model.A), dtype=bool)
    unsupported[: len(model.unsupported)] = model.unsupported > rate / 2
    balanced, (scale, _) = scipy.linalg.matrix_balance(model.A, permute=False, separate=True)
    poles, left, right = scipy.linalg.eig(balanced, left=True, right=True)
    shares = np.abs(left * right)
    own = (poles.imag > np.pi * rate) & (shares[unsupported].sum(axis=0) > BELONGS * shares.sum(axis=0))
    if not own.any():
        return ()
    k = controller_model(controller, inputs=measured, outputs=driven, time_step=1 / rate)
    gains = finite("gain", gain) * transfer_matrix(k.matrices, np.exp(1j * ANGLES))
    poles, left, right = poles[own], left[:, own].T.conj(), right[:, own]
    drives = left @ (model.B[:, columns] / scale[:, None]) / np.sum(left.T * right, axis=0)[:, None]
    shows, order = (model.C[rows] * scale) @ right, np.argsort(np.abs(poles))
    frequency = np.abs(poles[order]) / (2 * np.pi)
    found = []
    for group in np.split(order, np.flatnonzero(np.diff(frequency) > SAME * frequency[1:]) + 1):
        loops = np.einsum("uyf,yk,kv->fuv", gains, shows[:, group], drives[group])
        around = np.abs(np.linalg.eigvals(loops)).max(axis=1) * np.sin(ANGLES / 2)
        pole = poles[group[0]]
        size = 2 / abs(pole) / -np.expm1(pole.real / rate) * around.max()
        at = float(abs(pole)) / (2 * np.pi)
        found.append(FoldingMode(at, abs(at - rate * round(at / rate)), float(size)))
    return tuple(sorted(found, key=lambda mode: -mode.loop_gain))
