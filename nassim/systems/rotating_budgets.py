"""Error budgets of machines that turn, for disturbances and errors along axes that do not turn.

A linear model in the rotor's frame has constant coefficients. Signals along fixed axes reach it, and leave it, through
a rotation by the angle w t, whose sines shift frequencies by that of the rotation, f0:

    u(t) = sum_m exp(-i m w t) V_m u_fixed(t),   y_fixed(t) = sum_k exp(i k w t) U_k y(t),   k, m in -1, 0, 1

    y_fixed(f) = sum_s [sum_k U_k G(f - k f0) V_(k + s)] u_fixed(f + s f0)

Stationary noise has uncorrelated amplitudes at different frequencies. The spectrum of an error, averaged over a turn,
is therefore the sum of the squares of the brackets times the shifted spectra.

Source: N. M. Wereley, Analysis and control of linear periodically time varying systems, MIT (1991), on harmonic
    transfer functions.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from nassim.base.checks import Array, finite, known
from nassim.base.field_types import ArrayLike
from nassim.signals.spectra import Spectrum
from nassim.systems.linear_model import LinearModel, Names, frequency_response, names
from nassim.systems.noise_budgets import NoiseBudget, noise_budget

SHARP = 1e-9
"""Relative distance of the two frequencies at which a spectrum jumps."""
FORWARD = 0.5 * np.array([[1, 1j], [-1j, 1]])
"""Factor of exp(i w t) in the rotation of x and y by w t."""


def rotating_noise_budget(
    model: LinearModel,
    spectra: Mapping[str, Spectrum],
    frequency: ArrayLike,
    *,
    rotation_frequency: float,
    fixed_inputs: Sequence[tuple[str, str]] = (),
    fixed_outputs: Sequence[tuple[str, str]] = (),
    outputs: Names | None = None,
) -> NoiseBudget:
    """Compute the spectra of outputs of a rotor by uncorrelated disturbances, some of them along fixed axes.

    Spectra of outputs are averages over a turn. Frequencies go on by up to twice the rotation frequency beyond the
    band, where sines of the rotation shift the noise to.

    Args:
        model: linear model in the rotor's frame, with constant coefficients.
        spectra: one-sided power spectral density by input, functions of frequency. They hold in the band, and there is
            no noise outside it [input unit^2/Hz].
        frequency: (n,), ascending; its ends are the limits of the band [Hz].
        rotation_frequency: turns per second, positive about z [Hz].
        fixed_inputs: pairs of inputs along the rotor's x and y; their spectra are those along fixed x and y.
        fixed_outputs: pairs of outputs along the rotor's x and y whose spectra along fixed x and y are wanted.
        outputs: one name or several; None for all.

    Returns:
        Budget with the spectra of each output by each disturbance.

    Raises:
        ValueError: for unknown names, and as `nassim.systems.noise_budget`.
    """
    turns = finite("rotation_frequency", rotation_frequency)
    found = noise_budget(model, spectra, frequency, outputs=model.outputs)  # checks, and frequencies close enough
    low, high = found.frequency[[0, -1]]
    chosen = model.outputs if outputs is None else names("output", outputs)
    rows = [model.outputs.index(known("output", name, model.outputs)) for name in chosen]
    columns = [model.inputs.index(name) for name in found.inputs]
    into, out = _harmonics(model.inputs, fixed_inputs, "input"), _harmonics(model.outputs, fixed_outputs, "output")
    shifts = turns * np.arange(-2, 3)
    points = np.unique(np.abs(found.frequency + shifts[:, None]))
    edges = np.abs(np.array([[low], [high]]) + shifts).ravel()  # where shifted bands end
    points = np.unique(np.concatenate([points, edges * (1 - SHARP), edges * (1 + SHARP)]))
    points = points[points <= high + 2 * abs(turns)]
    if model.time_step is not None:
        points = points[points + abs(turns) <= 0.5 / model.time_step]
    gains = {k: out[k][rows] @ _two_sided(model, points - k * turns) for k in (-1, 0, 1)}
    psd = np.zeros((len(points), len(rows), len(columns)))
    for s in range(-2, 3):
        total = sum(gains[k] @ into[k + s][:, columns] for k in (-1, 0, 1) if abs(k + s) <= 1)
        at = np.abs(points + s * turns)
        inside = (at >= low) & (at <= high)
        density = np.zeros((len(points), len(columns)))
        density[inside] = np.transpose([spectra[name](at[inside]) for name in found.inputs])
        psd += np.abs(total) ** 2 * density[:, None]
    units = tuple(model.units[k] for k in rows) if model.units else ()
    return NoiseBudget(points, np.moveaxis(psd, 0, 2), chosen, found.inputs, units)


def _harmonics(every: Sequence[str], pairs: Iterable[tuple[str, str]], kind: str) -> dict[int, Array]:
    """Return the factors of exp(i k w t), k in -1, 0, 1, in the rotation of pairs of signals, (n, n) each."""
    forward, constant = np.zeros((len(every),) * 2, complex), np.eye(len(every))
    for pair in pairs:
        at = [every.index(known(kind, name, every)) for name in pair]
        forward[np.ix_(at, at)] = FORWARD
        constant[at, at] = 0.0
    return {-1: forward.conj(), 0: constant, 1: forward}


def _two_sided(model: LinearModel, frequency: Array) -> Array:
    """Return the response at frequencies of either sign, (n, outputs, inputs)."""
    every, place = np.unique(np.abs(frequency), return_inverse=True)
    values = np.moveaxis(frequency_response(model, every).values, 2, 0)[place]
    return np.where((frequency < 0)[:, None, None], values.conj(), values)
