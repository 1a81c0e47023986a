"""Dynamic error budgets: contributions of disturbances to the spectrum of an output and to its rms over a band."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from nassim.base.checks import Array, finite, finite_array, freeze, known, unique, units_of
from nassim.base.field_types import ArrayLike
from nassim.base.short_repr import short_repr
from nassim.base.tables import text_table
from nassim.base.warning_log import warn
from nassim.signals.spectra import Spectrum, spectrum_values, table_frequencies, welch
from nassim.signals.time_history import TimeHistory
from nassim.systems.linear_model import LinearModel, Names, frequency_response, names, subsystem, unstable_poles

UNDAMPED = 1e-9
"""Damping ratio below which a pole counts as undamped: its mean square has no bound."""
AT_REST = 1e-8
"""Fraction of the fastest pole below which a pole counts as a pole at the origin."""
FINENESS = 0.12
"""Frequency step at a pole, relative to the half width of the resonance. The rms is then accurate to a thousandth."""
PROBES = 128
"""Number of points between two frequencies at which a spectrum given as a function is searched for lines."""
PROBES_OF_TABLES = 8
"""The same for a table, which has no lines between its points."""
LINE_RESOLUTION = 1e-5
"""Fraction of the mean square of an output that a line between two frequencies may contribute without being resolved.
"""
SETTLED = 0.5
"""Share of the first estimate of a mean square above which the estimate was good enough."""
FINEST = 1e-9
"""Relative distance of two frequencies below which the refinement stops."""
RMS_ERROR_WARNED = 0.02
"""Relative error of the rms of an output, caused by coarse frequencies, above which a budget warns."""


@dataclass(frozen=True)
class NoiseBudget:
    """Spectra of outputs, split by the uncorrelated disturbances that cause them.

    Attributes:
        frequency: (n,), ascending [Hz].
        psd: one-sided power spectral densities, (outputs, inputs, n) [output unit^2/Hz].
        outputs: names of the rows of `psd`.
        inputs: names of the columns of `psd`.
        units: units of the outputs; "" for each where none is given.
    """

    frequency: Array
    psd: Array
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    units: tuple[str, ...] = ()
    __repr__ = short_repr

    def __post_init__(self) -> None:
        frequency = ascending(self.frequency)
        outputs, inputs = unique("output", self.outputs), unique("input", self.inputs)
        psd = finite_array("psd", self.psd, (len(outputs), len(inputs), len(frequency)))
        if not psd.size:
            raise ValueError("a noise budget needs at least one output and one disturbance")
        if psd.min() < 0:
            raise ValueError(f"psd must not be negative, got {psd.min():g}")
        units = units_of("output", self.units, outputs)
        freeze(self, frequency=frequency, psd=psd, outputs=outputs, inputs=inputs, units=units)

    @property
    def total(self) -> "NoiseBudget":
        """The budget with all disturbances added up, as the one input "total"."""
        return replace(self, psd=self.psd.sum(axis=1, keepdims=True), inputs=("total",))

    def rms(self, low: float | None = None, high: float | None = None) -> Array:
        """Compute the root mean square of each output by each disturbance between two frequencies.

        `total.rms()` is the rms by all disturbances.

        Args:
            low: lower end within the frequencies of the budget (default: the first one) [Hz].
            high: upper end within the frequencies of the budget (default: the last one) [Hz].

        Returns:
            Root mean square, (outputs, inputs) [output unit].
        """
        first, last = float(self.frequency[0]), float(self.frequency[-1])
        low = first if low is None else finite("frequency", low)
        high = last if high is None else finite("frequency", high)
        if not first <= low <= high <= last:
            raise ValueError(f"low and high must rise within {first:g} ... {last:g} Hz, got {low:g} and {high:g} Hz")
        inside = self.frequency[(self.frequency > low) & (self.frequency < high)]
        points = np.concatenate([[low], inside, [high]])
        values = interpolated(self.frequency, self.psd, points)
        return np.sqrt(_strips(points, values).sum(axis=-1))

    def cumulative(self) -> Array:
        """Compute the cumulative amplitude spectra: the rms of all that lies above each frequency.

        The sum runs from the highest frequency down. A resonance therefore appears as a step, whose height shows the
        benefit of removing it, and the value at the lowest frequency is the total rms.

        Returns:
            Cumulative rms, (outputs, inputs, n) [output unit].
        """
        strips = _strips(self.frequency, self.psd)
        above = np.cumsum(strips[..., ::-1], axis=-1)[..., ::-1]
        return np.sqrt(np.concatenate([above, np.zeros((*above.shape[:-1], 1))], axis=-1))

    @property
    def integration_error(self) -> Array:
        """Estimated relative error of `rms()` by the frequency steps, (outputs, inputs) [-].

        It is relative to the total of the output.
        It is a third of the change that results when every second frequency is omitted, as for a rule of second order.
        """
        fine, last = self.rms(), len(self.frequency) - 1
        # Check the even and the odd frequencies: a line of the spectrum lies in only one of the two sets.
        halves = (np.union1d(np.arange(start, last, 2), [0, last]) for start in (0, 1))
        coarse = [np.sqrt(_strips(self.frequency[k], self.psd[..., k]).sum(axis=-1)) for k in halves]
        total = np.sqrt((fine**2).sum(axis=1, keepdims=True))
        return np.abs(np.array(coarse) - fine).max(axis=0) / 3 / np.where(total > 0, total, 1.0)

    def __str__(self) -> str:
        """Return the table of all frequencies."""
        return self.table()

    def table(self, low: float | None = None, high: float | None = None) -> str:
        """Return a table of the rms between two frequencies, with a row per disturbance and one for the total.

        Args:
            low: see `rms` [Hz].
            high: see `rms` [Hz].
        """
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
    """Compute the spectra of outputs that uncorrelated disturbances with given spectra cause.

    Points are added where `frequency` is too coarse for resonances of the model, for lines of spectra given as
    functions, and for tables. The budget's own `frequency` contains all points. A line of a function that is narrower
    than a hundredth of the distance of two frequencies may be missed: add frequencies at it. Correlated disturbances
    must be combined into one input (`nassim.systems.with_inputs`).

    Args:
        model: linear model, open or closed loop. `close_loop(..., noise=True)` adds inputs for the noise of sensors in
            a loop.
        spectra: one-sided power spectral density by input: a function of frequency (see `nassim.signals.spectra`), a
            value at each frequency, (n,), or a number for white noise. Other inputs have no disturbance. For a sampled
            model they are spectra of the samples, up to half the sample rate [input unit^2/Hz].
        frequency: (n,), ascending; its ends are the limits of the band [Hz].
        outputs: one name or several; None for all.

    Returns:
        Budget with the spectra of each output by each disturbance.

    Warns:
        UserWarning: where the frequencies are still too coarse, for example for a table with lines.

    Raises:
        ValueError: for unknown names, for an unstable model, and for undamped poles in the band, where the mean square
            has no bound.
    """
    given = band_of(frequency, model.time_step)
    inputs = disturbed_inputs(model, spectra)
    part = subsystem(model, inputs=inputs, outputs=outputs)
    points = with_resonances(model, with_tables(spectra, given))
    gain = np.abs(frequency_response(part, points).values) ** 2
    lines = [with_lines(name, spectra[name], points, gain[:, k]) for k, name in enumerate(inputs)]
    every = np.unique(np.concatenate(lines))
    if len(every) > len(points):
        gain = np.abs(frequency_response(part, every).values) ** 2
    densities = np.array([spectrum_values(name, spectra[name], given, every) for name in inputs])
    budget = NoiseBudget(every, gain * densities, part.outputs, inputs, part.units)
    warn_if_coarse(budget)
    return budget


def disturbed_inputs(model: LinearModel, spectra: Mapping[str, Spectrum | ArrayLike]) -> tuple[str, ...]:
    """Return the inputs that have a spectrum, in the order of the model; refuse unknown names and no spectra at all."""
    if not spectra:
        raise ValueError(f"give at least one input a spectrum; known inputs: {', '.join(model.inputs)}")
    for name in spectra:
        known("input", name, model.inputs)
    return tuple(name for name in model.inputs if name in spectra)


def interpolated(known_at: Array, values: Array, frequency: Array) -> Array:
    """Interpolate values known at ascending frequencies, (..., k), by straight lines; at frequencies within, (n,).

    Returns:
        The values at these frequencies, (..., n).
    """
    before = np.clip(np.searchsorted(known_at, frequency, side="right") - 1, 0, len(known_at) - 2)
    share = (frequency - known_at[before]) / np.diff(known_at)[before]
    result: Array = (1 - share) * values[..., before] + share * values[..., before + 1]
    return result


def _strips(frequency: Array, psd: Array) -> Array:
    """Return the mean square between neighbouring frequencies, (..., n - 1)."""
    return np.diff(frequency) * (psd[..., 1:] + psd[..., :-1]) / 2


def _titled(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def ascending(frequency: ArrayLike) -> Array:
    """Return frequencies (n,) [Hz], checked to be ascending and not negative, at least two."""
    result = finite_array("frequency", frequency, (None,))
    if len(result) < 2 or np.any(np.diff(result) <= 0) or result[0] < 0:
        raise ValueError("frequency must be ascending and not negative, at least two")
    return result


def band_of(frequency: ArrayLike, time_step: float | None) -> Array:
    """Return the checked frequencies of a band, (n,), which for a sampled model ends at half its sample rate [Hz]."""
    band = ascending(frequency)
    if time_step is not None and band[-1] > 0.5 / time_step * (1 + 1e-9):
        raise ValueError(
            f"the model is sampled at {1 / time_step:g} Hz, so its responses and spectra end at "
            f"{0.5 / time_step:g} Hz, got {band[-1]:g} Hz"
        )
    return band


def with_tables(spectra: Mapping[str, Spectrum | ArrayLike], frequency: Array) -> Array:
    """Merge the frequencies (n,) with those of tables in the band [Hz]: a table may have a line in between."""
    every = np.unique(np.concatenate([frequency, *map(table_frequencies, spectra.values())]))
    return every[(every >= frequency[0]) & (every <= frequency[-1])]


def with_resonances(model: LinearModel, frequency: Array) -> Array:
    """Merge the frequencies (n,) with those that resonances of the model need [Hz].

    At a pole's frequency the step is a small fraction of the half width of the resonance. Away from it the step is the
    same fraction of the distance, until the given frequencies are as close. Raises ValueError where the mean square has
    no bound.
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
        raise ValueError("the model has a pole at s = 0, whose spectrum is infinite at 0 Hz; begin above 0 Hz")
    inside = (centres >= frequency[0]) & (centres <= frequency[-1]) & ~resting
    endless = inside & (widths < UNDAMPED * size / (2 * np.pi))
    if endless.any():
        raise ValueError(
            f"an undamped motion at {centres[endless][0]:g} Hz has no bound under noise; give the model damping, or "
            "take a band without it"
        )
    return near_poles(poles[~resting], frequency)


def near_poles(poles: Array, frequency: Array) -> Array:
    """Merge the frequencies (n,) with those that resonances need, see `with_resonances` [Hz].

    Args:
        poles: complex poles in the s-plane, (m,) [rad/s].
        frequency: (n,), ascending [Hz].
    """
    poles = poles[poles.imag >= 0]
    centres, widths = poles.imag / (2 * np.pi), np.abs(poles.real) / (2 * np.pi)
    points = [frequency]
    for pole, (centre, width) in enumerate(zip(centres, widths, strict=True)):
        k = int(np.clip(np.searchsorted(frequency, centre), 1, len(frequency) - 1))
        coarse = (frequency[k] - frequency[k - 1]) / (FINENESS * width) if width > 0 else 1.0
        if coarse > 1:
            offsets = width * np.sinh(FINENESS * np.arange(np.arccosh(coarse) / FINENESS + 1))
            near = np.concatenate([centre - offsets, centre + offsets])
            # Keep the points nearest to this pole; a pole that needs closer points adds its own.
            points.append(near[np.hypot(widths, near[:, None] - centres).argmin(axis=1) == pole])
    every = np.unique(np.concatenate(points))
    return every[(every >= frequency[0]) & (every <= frequency[-1])]


def with_lines(name: str, spectrum: Spectrum | ArrayLike, points: Array, gain: Array) -> Array:
    """Merge the frequencies (n,), which contain those of a table, with those that a function or a table needs [Hz].

    gain: squared gain of each output, (outputs, n), linear between the frequencies
    """
    if not callable(spectrum):
        return points
    n_probes = PROBES_OF_TABLES if len(table_frequencies(spectrum)) else PROBES

    def density(frequency: Array) -> Array:
        between = np.array([np.interp(frequency, points, row) for row in gain])
        return between * spectrum_values(name, spectrum, points, frequency)

    probes = points[:-1, None] + np.diff(points)[:, None] * np.arange(n_probes) / n_probes
    fine = np.append(probes, points[-1])
    values = density(fine)
    allowed = LINE_RESOLUTION * _strips(fine, values).sum(axis=1, keepdims=True)
    every, starts, step = points, np.arange(0, len(fine) - 1, n_probes), n_probes
    while step > 1:  # halve the intervals between the probes
        inside = values[:, starts[:, None] + np.arange(step + 1)]
        straight = inside[..., :1] + (inside[..., -1:] - inside[..., :1]) * np.arange(step + 1) / step
        unseen = np.abs(inside - straight).mean(axis=2) * (fine[starts + step] - fine[starts])
        starts, step = starts[np.any(unseen > allowed, axis=0)], step // 2
        every = np.append(every, fine[starts + step])
        starts = np.append(starts, starts + step)
    low, high = fine[starts], fine[starts + 1]
    while True:
        every = np.unique(np.append(every, _halved(density, low, high, allowed)))
        enough = LINE_RESOLUTION * _strips(every, density(every)).sum(axis=1, keepdims=True)
        if np.all(enough >= SETTLED * allowed):
            return every
        allowed, low, high = enough, every[:-1], every[1:]  # the first points saw far too large a mean square


def _halved(density: Spectrum, low: Array, high: Array, allowed: Array) -> Array:
    """Return frequencies (n,) within intervals that are halved until straight lines are near enough [Hz].

    Args:
        density: spectra of the outputs, (outputs, n), at frequencies, (n,).
        low: lower ends of the intervals, (m,) [Hz].
        high: upper ends of the intervals, (m,) [Hz].
        allowed: mean squares that straight lines may leave out in an interval, (outputs, 1).
    """
    added = [np.zeros(0)]
    while len(low):
        middle = (low + high) / 2
        unseen = np.abs(density(middle) - (density(low) + density(high)) / 2) * (high - low)
        split = np.any(unseen > allowed, axis=0) & (high - low > FINEST * high)
        low, middle, high = low[split], middle[split], high[split]
        added.append(middle)
        low, high = np.append(low, middle), np.append(middle, high)
    return np.concatenate(added)


def warn_if_coarse(budget: NoiseBudget) -> None:
    """Warn of a budget whose frequencies leave an error of more than `RMS_ERROR_WARNED`."""
    error = budget.total.integration_error[:, 0]
    worst = int(np.argmax(error))
    if error[worst] > RMS_ERROR_WARNED:
        warn(
            f"frequencies are too coarse for a spectrum: the rms of {budget.outputs[worst]!r} may be off by "
            f"{100 * error[worst]:.2g} %; take closer ones"
        )


def recorded_budget(
    record: TimeHistory, *, segment_duration: float, outputs: Names | None = None, name: str = "record"
) -> NoiseBudget:
    """Estimate the spectra of recorded signals by Welch's method, as a budget of one cause.

    The budget of a simulated run can so be compared with that of a linear model.

    Args:
        record: the record.
        segment_duration: length of a segment, whose inverse is the frequency resolution [s].
        outputs: one name or several; None for all signals.
        name: name of the cause.

    Raises:
        ValueError: for unknown names, and for a record without two segments.

    Source: P. D. Welch, The use of fast Fourier transform for the estimation of power spectra, IEEE Transactions on
        Audio and Electroacoustics 15 (1967) 70-73.
    """
    part = record if outputs is None else record.select(names("output", outputs))
    if not part.names:
        raise ValueError(f"name at least one output; known signals: {', '.join(record.names) or 'none'}")
    frequency, psd = welch(part, segment_duration)
    return NoiseBudget(frequency, psd[:, None], part.names, (name,), part.units)
