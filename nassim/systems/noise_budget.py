"""Dynamic error budgets: which disturbance makes which part of an output's spectrum, and of its rms over a band."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from nassim.base.checks import Array, finite, finite_array, freeze, known, unique
from nassim.base.tables import text_table
from nassim.signals.spectra import Spectrum, TabulatedSpectrum, spectrum_values
from nassim.systems.linear_model import LinearModel, Names, frequency_response, names, unstable_poles

UNDAMPED = 1e-9
"""Damping ratio below which a pole counts as undamped: the mean square at it has no bound."""
AT_REST = 1e-8
"""Share of the fastest pole below which a pole counts as at rest."""
FINENESS = 0.12
"""Distance of two frequencies at a pole over the resonance's half width; the rms is then good to a thousandth."""
PROBES = 128
"""Points between two frequencies at which a spectrum given as a function is looked at for lines."""
RESOLVED = 1e-5
"""Share of an output's mean square that a line may add unseen between two frequencies."""
FINEST = 1e-9
"""Distance of two frequencies, relative to them, below which nothing is resolved any more."""
TOLD = 0.02
"""Error of an output's rms by the frequencies' distances, above which a budget warns."""


@dataclass(frozen=True)
class NoiseBudget:
    """Spectra of outputs, split by the uncorrelated disturbances that make them.

    frequency: (n,), ascending [Hz]
    psd: one-sided power spectral densities, (outputs, inputs, n) [output unit^2/Hz]
    outputs, inputs: names of the rows and columns; units: of the outputs, one each or none
    """

    frequency: Array
    psd: Array
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    units: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        frequency = _ascending(self.frequency)
        outputs, inputs = unique("output", self.outputs), unique("input", self.inputs)
        psd = finite_array("psd", self.psd, (len(outputs), len(inputs), len(frequency)))
        if psd.size and psd.min() < 0:
            raise ValueError(f"psd must not be negative, got {psd.min():g}")
        units = tuple(self.units) or ("",) * len(outputs)
        if len(units) != len(outputs):
            raise ValueError(f"one unit per output: got {len(units)} units for {len(outputs)} outputs")
        freeze(self, frequency=frequency, psd=psd, outputs=outputs, inputs=inputs, units=units)

    @property
    def total(self) -> "NoiseBudget":
        """The same with all disturbances added up, as the one input "total"."""
        return replace(self, psd=self.psd.sum(axis=1, keepdims=True), inputs=("total",))

    def rms(self, low: float | None = None, high: float | None = None) -> Array:
        """Root mean square of each output by each disturbance between two frequencies, (outputs, inputs) [unit].

        low, high: [Hz], within the budget's frequencies, which are the default; `total.rms()` for all disturbances
        """
        first, last = self.frequency[[0, -1]]
        low, high = (end if f is None else finite("frequency", f) for f, end in ((low, first), (high, last)))
        if not first <= low <= high <= last:
            raise ValueError(f"low and high must rise within {first:g} ... {last:g} Hz, got {low:g} and {high:g} Hz")
        inside = self.frequency[(self.frequency > low) & (self.frequency < high)]
        points = np.concatenate([[low], inside, [high]])
        before = np.clip(np.searchsorted(self.frequency, points, side="right") - 1, 0, len(self.frequency) - 2)
        share = (points - self.frequency[before]) / np.diff(self.frequency)[before]
        values = (1 - share) * self.psd[..., before] + share * self.psd[..., before + 1]
        result: Array = np.sqrt(_strips(points, values).sum(axis=-1))
        return result

    def cumulative(self) -> Array:
        """Cumulative amplitude spectra, (outputs, inputs, n) [unit]: rms of all that lies above each frequency.

        Summed up from the highest frequency down, so that a resonance is a step which shows what removing it would
        gain, and the value at the lowest frequency is the rms.
        """
        strips = _strips(self.frequency, self.psd)
        above = np.cumsum(strips[..., ::-1], axis=-1)[..., ::-1]
        result: Array = np.sqrt(np.concatenate([above, np.zeros((*above.shape[:-1], 1))], axis=-1))
        return result

    @property
    def integration_error(self) -> Array:
        """Estimated error of `rms()` by the frequencies' distances, over the outputs' total, (outputs, inputs) [-].

        A third of what leaving out every second frequency changes, as of a rule of second order.
        """
        fine, last = self.rms(), len(self.frequency) - 1
        # Both halves: a line in the spectrum lies in one of them only.
        halves = (np.union1d(np.arange(start, last, 2), [0, last]) for start in (0, 1))
        coarse = [np.sqrt(_strips(self.frequency[k], self.psd[..., k]).sum(axis=-1)) for k in halves]
        total = np.sqrt((fine**2).sum(axis=1, keepdims=True))
        result: Array = np.abs(np.array(coarse) - fine).max(axis=0) / 3 / np.where(total > 0, total, 1.0)
        return result

    def table(self, low: float | None = None, high: float | None = None) -> str:
        """Rms between two frequencies [Hz] by disturbance, for the terminal: a row for each and for the total."""
        rms, total = self.rms(low, high), self.total
        low, high = (end if f is None else f for f, end in ((low, self.frequency[0]), (high, self.frequency[-1])))
        rows = [[f"rms from {low:g} to {high:g} Hz", *map(_titled, self.outputs, self.units)]]
        rows += [[name, *(f"{x:.3g}" for x in rms[:, k])] for k, name in enumerate(self.inputs)]
        rows += [["total", *(f"{x:.3g}" for x in total.rms(low, high)[:, 0])]]
        rows += [["error by integration", *(f"{100 * x:.2g} %" for x in total.integration_error[:, 0])]]
        return text_table(rows)


def noise_budget(
    model: LinearModel,
    spectra: Mapping[str, Spectrum | ArrayLike],
    frequency: ArrayLike,
    *,
    outputs: Names | None = None,
) -> NoiseBudget:
    """What uncorrelated disturbances with given spectra make of each output.

    model: open or closed; noise of sensors inside a loop: `close_loop(..., noise=True)`
    spectra: by input, one-sided power spectral density [input unit^2/Hz]: a function of frequency (see
        `nassim.signals.spectra`), a value at each frequency, (n,), or a number for white noise. Inputs without one are
        quiet. Of a sampled model they are spectra of the samples, up to half the sample rate.
    frequency: (n,), ascending [Hz]; its ends are the band, and points are added where it is too coarse for the
        model's resonances and for lines of spectra that are functions, and those of tables: the budget's own
        `frequency` has them all. A function's line may be missed that is narrower than a hundredth of the distance of
        two frequencies: give frequencies at it.
    outputs: one name or several; None for all

    Disturbances that are correlated: make them one input (`nassim.systems.with_inputs`). Warns where the frequencies
    are too coarse nevertheless, as for a table with lines. Raises ValueError for unknown names, for an unstable model,
    and for undamped poles in the band, at which the mean square has no bound.
    """
    given = _band(frequency, model.time_step)
    if not spectra:
        raise ValueError(f"give at least one input a spectrum; known inputs: {', '.join(model.inputs)}")
    for name in spectra:
        known("input", name, model.inputs)
    inputs = tuple(name for name in model.inputs if name in spectra)
    chosen = model.outputs if outputs is None else names("output", outputs)
    rows = [model.outputs.index(known("output", name, model.outputs)) for name in chosen]
    columns = [model.inputs.index(name) for name in inputs]
    points = _with_resonances(model, _with_tables(spectra, given))
    units = tuple(model.units[k] for k in rows) if model.units else ()
    part = LinearModel(
        model.A,
        model.B[:, columns],
        model.C[rows],
        model.D[np.ix_(rows, columns)],
        inputs,
        chosen,
        units,
        model.time_step,
    )
    gain = np.abs(frequency_response(part, points).values) ** 2
    lines = [_with_lines(name, spectra[name], points, gain[:, k]) for k, name in enumerate(inputs)]
    every = np.unique(np.concatenate(lines))
    if len(every) > len(points):
        gain = np.abs(frequency_response(part, every).values) ** 2
    densities = np.array([spectrum_values(name, spectra[name], given, every) for name in inputs])
    budget = NoiseBudget(every, gain * densities, chosen, inputs, units)
    _warn_if_coarse(budget)
    return budget


def _strips(frequency: Array, psd: Array) -> Array:
    """Mean square between neighbouring frequencies, (..., n - 1)."""
    return np.diff(frequency) * (psd[..., 1:] + psd[..., :-1]) / 2


def _titled(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _ascending(frequency: ArrayLike) -> Array:
    result = finite_array("frequency", frequency, (None,))
    if len(result) < 2 or np.any(np.diff(result) <= 0) or result[0] < 0:
        raise ValueError("frequency must be ascending and not negative, at least two")
    return result


def _band(frequency: ArrayLike, time_step: float | None) -> Array:
    band = _ascending(frequency)
    if time_step is not None and band[-1] > 0.5 / time_step * (1 + 1e-9):
        raise ValueError(
            f"the model is sampled at {1 / time_step:g} Hz, so its spectra end at {0.5 / time_step:g} Hz, got "
            f"{band[-1]:g} Hz"
        )
    return band


def _with_tables(spectra: Mapping[str, Spectrum | ArrayLike], frequency: Array) -> Array:
    """Frequencies (n,) and those of tables, between which a table may have a line [Hz]."""
    tables = [spectrum.frequency for spectrum in spectra.values() if isinstance(spectrum, TabulatedSpectrum)]
    every = np.unique(np.concatenate([frequency, *tables]))
    return every[(every >= frequency[0]) & (every <= frequency[-1])]


def _with_resonances(model: LinearModel, frequency: Array) -> Array:
    """Frequencies (n,) and those that resonances need besides, [Hz].

    At a pole's frequency the distance is a small part of the resonance's half width, and away from it the same part of
    the distance to it, until the given frequencies are as close. Raises ValueError where there is no bound.
    """
    growing = unstable_poles(model)
    if growing:
        raise ValueError(f"an unstable model has no spectrum: {growing[0]}; stabilise it first")
    poles = model.poles()
    poles = poles[poles.imag >= 0]
    centres, widths = poles.imag / (2 * np.pi), -poles.real / (2 * np.pi)
    size = np.abs(poles)
    resting = size <= AT_REST * size.max(initial=0.0)
    if resting.any() and frequency[0] == 0:
        raise ValueError("the model has a pole at rest, whose spectrum is infinite at 0 Hz; begin above")
    inside = (centres >= frequency[0]) & (centres <= frequency[-1]) & ~resting
    endless = inside & (widths < UNDAMPED * size / (2 * np.pi))
    if endless.any():
        raise ValueError(
            f"an undamped motion at {centres[endless][0]:g} Hz has no bound under noise; give the model damping, or "
            "take a band without it"
        )
    centres, widths = centres[~resting], np.abs(widths[~resting])
    points = [frequency]
    for pole, (centre, width) in enumerate(zip(centres, widths, strict=True)):
        k = int(np.clip(np.searchsorted(frequency, centre), 1, len(frequency) - 1))
        coarse = (frequency[k] - frequency[k - 1]) / (FINENESS * width) if width > 0 else 1.0
        if coarse > 1:
            offsets = width * np.sinh(FINENESS * np.arange(np.arccosh(coarse) / FINENESS + 1))
            near = np.concatenate([centre - offsets, centre + offsets])
            # Where another pole needs closer ones, it brings its own.
            points.append(near[np.hypot(widths, near[:, None] - centres).argmin(axis=1) == pole])
    every = np.unique(np.concatenate(points))
    return every[(every >= frequency[0]) & (every <= frequency[-1])]


def _with_lines(name: str, spectrum: Spectrum | ArrayLike, points: Array, gain: Array) -> Array:
    """Frequencies (n,) and those that a spectrum given as a function needs besides, [Hz].

    gain: of the mean squares that it makes, (outputs, n), which runs straight between the frequencies
    """
    if not callable(spectrum) or isinstance(spectrum, TabulatedSpectrum):
        return points

    def density(frequency: Array) -> Array:
        between = np.array([np.interp(frequency, points, row) for row in gain])
        return between * spectrum_values(name, spectrum, points, frequency)

    probes = points[:-1, None] + np.diff(points)[:, None] * np.arange(PROBES) / PROBES
    fine = np.append(probes, points[-1])
    values = density(fine)
    allowed = RESOLVED * _strips(fine, values).sum(axis=1, keepdims=True)
    every, starts, step = points, np.arange(0, len(fine) - 1, PROBES), PROBES
    while step > 1:  # halve intervals between the probes
        inside = values[:, starts[:, None] + np.arange(step + 1)]
        straight = inside[..., :1] + (inside[..., -1:] - inside[..., :1]) * np.arange(step + 1) / step
        unseen = np.abs(inside - straight).mean(axis=2) * (fine[starts + step] - fine[starts])
        starts, step = starts[np.any(unseen > allowed, axis=0)], step // 2
        every = np.append(every, fine[starts + step])
        starts = np.append(starts, starts + step)
    low, high = fine[starts], fine[starts + 1]
    while len(low):  # and where that is not enough, between two of them
        middle = (low + high) / 2
        unseen = np.abs(density(middle) - (density(low) + density(high)) / 2) * (high - low)
        split = np.any(unseen > allowed, axis=0) & (high - low > FINEST * high)
        low, middle, high = low[split], middle[split], high[split]
        every = np.append(every, middle)
        low, high = np.append(low, middle), np.append(middle, high)
    return every


def _warn_if_coarse(budget: NoiseBudget) -> None:
    error = budget.total.integration_error[:, 0]
    worst = int(np.argmax(error))
    if error[worst] > TOLD:
        warnings.warn(
            f"frequencies are too coarse for a spectrum: the rms of {budget.outputs[worst]!r} may be off by "
            f"{100 * error[worst]:.2g} %; take closer ones",
            stacklevel=3,
        )
