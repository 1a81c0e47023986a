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
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array, axis_pairs, finite
from nassim.base.field_types import ArrayLike
from nassim.signals.spectra import Spectrum, spectrum_values
from nassim.systems.linear_model import LinearModel, Names, names, response_values, subsystem
from nassim.systems.noise_budgets import (
    NoiseBudget,
    band_of,
    disturbed_inputs,
    interpolated,
    noise_budget,
    warn_if_coarse,
    with_lines,
    with_resonances,
    with_tables,
)

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
    band, where sines of the rotation shift the noise to. Those of a sampled model end at half of its sample rate, where
    they fold back.

    Args:
        model: linear model in the rotor's frame, with constant coefficients.
        spectra: one-sided power spectral density by input, functions of frequency. They hold in the band, and there is
            no noise outside it. Lines and tables add points, see `nassim.systems.noise_budget` [input unit^2/Hz].
        frequency: (n,), ascending; its ends are the limits of the band [Hz].
        rotation_frequency: turns per second, positive about z, and 0 for a rotor at rest at the angle 0 [Hz].
        fixed_inputs: pairs of inputs along the rotor's x and y; their spectra are those along fixed x and y.
        fixed_outputs: pairs of outputs along the rotor's x and y whose spectra along fixed x and y are wanted.
        outputs: one name or several; None for all.

    Returns:
        Budget with the spectra of each output by each disturbance.

    Warns:
        UserWarning: as `nassim.systems.noise_budget`, where frequencies are too coarse.

    Raises:
        ValueError: for unknown names, a name in two pairs, and as `nassim.systems.noise_budget`.
    """
    turns = finite("rotation_frequency", rotation_frequency)
    chosen = model.outputs if outputs is None else names("output", outputs)
    fixed_inputs = axis_pairs("input", fixed_inputs, model.inputs)
    fixed_outputs = axis_pairs("output", fixed_outputs, model.outputs)
    if not turns:  # the rotor's axes are the fixed ones
        return noise_budget(model, spectra, frequency, outputs=chosen)
    disturbed, read = disturbed_inputs(model, spectra), _with_partners(chosen, fixed_outputs)
    model = subsystem(model, inputs=_with_partners(disturbed, fixed_inputs), outputs=read)
    rows, columns = [read.index(name) for name in chosen], [model.inputs.index(name) for name in disturbed]
    into, out = _harmonics(model.inputs, fixed_inputs), _harmonics(model.outputs, fixed_outputs)
    given = band_of(frequency, model.time_step)
    low, high = given[[0, -1]]

    def densities(frequency: Array) -> Array:
        """Return the spectra of the disturbances within the band, (disturbances, n)."""
        return np.array([spectrum_values(name, spectra[name], given, frequency) for name in disturbed])

    own = _folded(with_resonances(model, _shifted(with_tables(spectra, given), turns, 1)), model.time_step)
    rotor = _RotorResponse.of(model, own, {m: shares[:, columns] for m, shares in into.items()}, turns)
    within = own[(own >= low) & (own <= high)]
    gain = rotor.squared_gains(within)
    fine = np.unique(
        np.concatenate([with_lines(name, spectra[name], within, gain[:, k]) for k, name in enumerate(disturbed)])
    )
    if len(fine) > len(within):
        own = np.union1d(own, _folded(_shifted(fine, turns, 1), model.time_step))
        rotor = _RotorResponse.of(model, own, rotor.driving, turns)
    # The check is one over the disturbances' frequencies, where spectra do not jump.
    warn_if_coarse(NoiseBudget(fine, rotor.squared_gains(fine) * densities(fine), tuple(read), disturbed))
    jumps = _shifted(given[[0, -1]], turns, 2)
    points = np.concatenate([_shifted(own, turns, 1), jumps * (1 - SHARP), jumps * (1 + SHARP)])
    if model.time_step is not None:
        points = np.append(_folded(points, model.time_step), min(points.max(), 0.5 / model.time_step))
    points = np.unique(points)
    psd = np.zeros((len(points), len(rows), len(columns)))
    for shift, gain in rotor.gains_by_shift(points, {k: shares[rows] for k, shares in out.items()}).items():
        source = np.abs(_principal(points + shift * turns, model.time_step))
        inside = (source >= low) & (source <= high)
        if inside.any():
            psd[inside] += np.abs(gain[inside]) ** 2 * densities(source[inside]).T[:, None]
    units = tuple(model.units[k] for k in rows)
    return NoiseBudget(points, np.moveaxis(psd, 0, 2), chosen, disturbed, units)


@dataclass(frozen=True)
class _RotorResponse:
    """Response G of a model in the rotor's frame, and the disturbances that drive it.

    Attributes:
        frequency: frequencies of the response, (k,), ascending [Hz].
        values: the response, (outputs, inputs, k).
        driving: inputs of the model by disturbances, V_m, (inputs, disturbances), by harmonic m of the rotation.
        turns: turns per second.
        time_step: that of a sampled model, whose response repeats with the sample rate [s].
    """

    frequency: Array
    values: Array
    driving: Mapping[int, Array]
    turns: float
    time_step: float | None

    @classmethod
    def of(cls, model: LinearModel, frequency: Array, driving: Mapping[int, Array], turns: float) -> "_RotorResponse":
        """Compute the response at frequencies, (k,) [Hz]."""
        return cls(frequency, response_values(model, frequency), driving, turns, model.time_step)

    def at(self, frequency: Array) -> Array:
        """Return the response at frequencies of either sign, (n, outputs, inputs), by straight lines."""
        frequency = _principal(frequency, self.time_step)
        size = np.clip(np.abs(frequency), self.frequency[0], self.frequency[-1])
        values = np.moveaxis(interpolated(self.frequency, self.values, size), -1, 0)
        return np.where((frequency < 0)[:, None, None], values.conj(), values)

    def squared_gains(self, frequency: Array) -> Array:
        """Return squared gains from disturbances at (n,) to outputs at any frequency, (outputs, disturbances, n)."""
        shares = [np.abs(self.at(frequency - m * self.turns) @ by) ** 2 for m, by in self.driving.items()]
        return np.moveaxis(np.sum(shares, axis=0), 0, 2)

    def gains_by_shift(self, frequency: Array, out: Mapping[int, Array]) -> dict[int, Array]:
        """Return the brackets of the module's equation: gains from disturbances at the frequency f + s f0.

        Args:
            frequency: frequencies f of the outputs, (n,) [Hz].
            out: outputs by outputs of the model, U_k, (rows, outputs), by harmonic k of the rotation.

        Returns:
            The gains, (n, rows, disturbances), by the shift s.
        """
        gains = {k: shares @ self.at(frequency - k * self.turns) for k, shares in out.items()}
        pairs = [(m - k, gain @ by) for k, gain in gains.items() for m, by in self.driving.items()]
        return {s: np.sum([part for shift, part in pairs if shift == s], axis=0) for s in range(-2, 3)}


def _shifted(frequency: Array, turns: float, times: int) -> Array:
    """Return positive frequencies shifted by up to some times the rotation frequency either way."""
    shifts = turns * np.arange(-times, times + 1)
    return np.unique(np.maximum(np.abs(frequency + shifts[:, None]), SHARP * frequency[-1]))


def _principal(frequency: Array, time_step: float | None) -> Array:
    """Return the frequencies of either sign, up to half of the sample rate, that samples do not tell from others."""
    return frequency if time_step is None else frequency - np.round(frequency * time_step) / time_step


def _folded(frequency: Array, time_step: float | None) -> Array:
    """Return where samples show positive frequencies, ascending; without a time step, the same frequencies."""
    return np.unique(np.abs(_principal(frequency, time_step)))


def _with_partners(chosen: Sequence[str], pairs: Iterable[tuple[str, str]]) -> list[str]:
    """Return names with the other ones of their pairs."""
    return list(dict.fromkeys([*chosen, *(name for pair in pairs if set(pair) & set(chosen) for name in pair)]))


def _harmonics(every: Sequence[str], pairs: Iterable[tuple[str, str]]) -> dict[int, Array]:
    """Return the factors of exp(i k w t), k in -1, 0, 1, in the rotation of pairs of signals, (n, n) each."""
    forward, constant = np.zeros((len(every),) * 2, complex), np.eye(len(every))
    for pair in pairs:
        if set(pair) <= set(every):
            at = [every.index(name) for name in pair]
            forward[np.ix_(at, at)] = FORWARD
            constant[at, at] = 0.0
    return {-1: forward.conj(), 0: constant, 1: forward}
