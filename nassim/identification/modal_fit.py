"""Identification of modes from measurements: poles, damping ratios and gains with their uncertainty."""

import functools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController

from nassim.base.checks import (
    Array,
    finite,
    finite_array,
    freeze,
    known,
    positive,
    unique,
    whole_number,
)
from nassim.base.field_types import ArrayLike
from nassim.base.progress import wrap_text
from nassim.base.short_repr import short_repr
from nassim.base.tables import text_table, with_deviation
from nassim.base.warning_log import warn
from nassim.identification.compressed_lines import compress_lines
from nassim.identification.measured_lines import lines_of_frf, lines_of_record
from nassim.identification.pole_fit import (
    DAMPING_RANGE,
    Solution,
    correlation,
    describe_misfit,
    describe_similar_modes,
    fit_poles,
    misfit,
    strongest_pole,
)
from nassim.identification.spectral_lines import Lines
from nassim.signals.frf import FRF
from nassim.signals.time_history import TimeHistory

MOST_MODES_IN_BAND = 12
"""Largest number of modes in a band."""
FIT_ROUNDING = 1e-10
"""Residual over response that counts as rounding; nothing remains to be fitted below it."""
POOR = 0.01
"""Relative standard deviation of a damping ratio above which a systematic residual causes a warning."""
IF_GIVEN, IF_FREE = 0.5, 0.25
"""Largest relative standard deviation of a damping ratio, where the number of modes is given and where it is free."""
RESPONSE_SHARES = 10.0 ** np.arange(-3, 7)
"""Tried values of the part of the noise variance that is proportional to |H|^2, at the mean of |H|^2, over the rest."""
NOISE_DEGREE = 3
"""Highest power of frequency in the logarithm of the noise."""
LINES_PER_POWER = 25
"""Lines beyond those that the unknowns take up, for each such power. With fewer, the noise would seem small where the
fit follows it, as at the ends of a band, and a fit that trusts these lines would follow it further.
"""


@dataclass(frozen=True, kw_only=True)
class ModalFit:
    """Real modes common to the responses of several outputs to one input, with their uncertainty.

    H_o = sum_r gains_or w_r^2 / (w_r^2 - w^2 + 2 i zeta_r w_r w) + sum_p residual_terms_op (i w)^p

    Attributes:
        input: name of the input.
        outputs: names of the outputs.
        frequency: ascending, (modes,) [Hz].
        damping_ratio: (modes,) [-].
        gains: contribution of each mode to the static response, (outputs, modes) [output unit over input unit].
        covariance: square matrix for frequency, damping_ratio and gains (output by output). It follows from the noise,
            and near a resonance with a systematic residual from that misfit, see
            `nassim.identification.pole_fit.misfit`.
        residual_terms: (outputs, powers) [output unit over input unit and s^p].
        residual_powers: powers p, (powers,).
        recorded: responses at the lines of the fit, without the transient of a record and the hold of its input.
        noise: standard deviation of `recorded`, (outputs, lines), estimated from the residual.
        criterion: Bayes' information criterion with 0, 1, 2 ... modes over that with none, as far as it was computed.
        how: description of data and options; the entry "doubts" contains reasons to doubt the fit and is empty without
            any.
    """

    input: str
    outputs: tuple[str, ...]
    frequency: Array
    damping_ratio: Array
    gains: Array
    covariance: Array
    residual_terms: Array
    residual_powers: Array
    recorded: FRF
    noise: Array
    criterion: Array
    how: Mapping[str, str]
    __repr__ = short_repr

    def __post_init__(self) -> None:
        n, outputs = len(self.frequency), unique("output", self.outputs)
        size = (2 + len(outputs)) * n
        freeze(
            self,
            outputs=outputs,
            frequency=finite_array("frequency", self.frequency, (n,)),
            damping_ratio=finite_array("damping_ratio", self.damping_ratio, (n,)),
            gains=finite_array("gains", self.gains, (len(outputs), n)),
            covariance=finite_array("covariance", self.covariance, (size, size)),
            residual_terms=finite_array("residual_terms", self.residual_terms, (len(outputs), None)),
            residual_powers=finite_array("residual_powers", self.residual_powers, (None,)),
            noise=finite_array("noise", self.noise, (len(outputs), len(self.recorded.frequency))),
            criterion=finite_array("criterion", self.criterion, (None,)),
            how=self.how,
        )

    @property
    def frequency_std(self) -> Array:
        """Standard deviation of the frequencies, (modes,) [Hz]."""
        return self._std[: len(self.frequency)]

    @property
    def damping_ratio_std(self) -> Array:
        """Standard deviation of the damping ratios, (modes,) [-]."""
        return self._std[len(self.frequency) : 2 * len(self.frequency)]

    @property
    def gains_std(self) -> Array:
        """Standard deviation of the gains, (outputs, modes)."""
        return self._std[2 * len(self.frequency) :].reshape(self.gains.shape)

    @property
    def _std(self) -> Array:
        return np.sqrt(np.diag(self.covariance))

    @property
    def residual(self) -> FRF:
        """Difference of `recorded` and the model at the lines of the fit."""
        model = self.response(self.recorded.frequency)
        return FRF(model.frequency, self.recorded.values - model.values, self.outputs, (self.input,), None, "residual")

    def response(self, frequency: ArrayLike, *, label: str = "fit") -> FRF:
        """Compute the identified FRF, which is valid within the band of the fit.

        Args:
            frequency: (n,) [Hz].
            label: label of the FRF.

        Returns:
            FRF with values (outputs, 1, n).

        Raises:
            ValueError: at 0 Hz, for residual terms with negative powers, which are infinite there.
        """
        f = finite_array("frequency", frequency, (None,))[:, None]
        if self.residual_powers.min(initial=0) < 0 and not f.all():
            raise ValueError(f"the fit has residual_powers of {self.residual_powers.min():g}: it is infinite at 0 Hz")
        s = 2j * np.pi * f
        modes = self.frequency**2 / (self.frequency**2 - f**2 + 2j * self.damping_ratio * self.frequency * f)
        values = self.gains @ modes.T + self.residual_terms @ (s**self.residual_powers).T
        return FRF(f[:, 0], values[:, None], self.outputs, (self.input,), None, label)

    def __str__(self) -> str:
        """Return the summary."""
        return self.summary()

    def summary(self) -> str:
        """Return the modes as a table, each figure with its standard deviation."""
        rows = [["mode", "frequency [Hz]", "damping ratio [%]", *(f"gain {output}" for output in self.outputs)]]
        for r in range(len(self.frequency)):
            gains = map(with_deviation, self.gains[:, r], self.gains_std[:, r])
            ratio = with_deviation(100 * self.damping_ratio[r], 100 * self.damping_ratio_std[r])
            rows.append([str(r + 1), with_deviation(self.frequency[r], self.frequency_std[r]), ratio, *gains])
        doubts = [wrap_text(f"doubtful: {self.how['doubts']}")] if self.how.get("doubts") else []
        return "\n".join([text_table(rows), *doubts])


def upgrade_fit(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a `ModalFit` from an older file, with `measured` renamed to `recorded`.

    Args:
        content: fields of the file by name.
    """
    return {{"measured": "recorded"}.get(name, name): value for name, value in content.items()}


def identify_modes(
    recorded: TimeHistory | FRF,
    *,
    input: str,
    outputs: Sequence[str],
    band: tuple[float, float],
    n_modes: int | None = None,
    hold_order: int | None = None,
    delay: float = 0.0,
    sample_rate: float | None = None,
    residual_powers: Sequence[int] = (0, 1, 2, 3),
) -> ModalFit:
    """Identify the modes in the responses to one input, with their standard deviations.

    The noise is assumed to be Gaussian, at the outputs only, and independent between outputs. Its variance is estimated
    for each output from the residual as a smooth function of frequency; the coherence of an FRF, where it has one and a
    single input, gives its shape. The variance of an FRF without coherence may also grow with the squared response, as
    that of estimated FRFs does, where the residual shows it. Of 400 intervals of 95 % from forty blind records, 378
    contain the truth (`scripts/identification_coverage.py`).

    The modes are real: all outputs move in phase or in antiphase. Those of a machine with a damper in one place, such
    as a coil or an isolator, are complex, more so the closer they are; the fit then finds further modes beside them.

    The residual may be systematic near a resonance, because two close modes are fitted as one, modes are complex, or a
    hold or a delay is overlooked. The standard deviations then include this error and the summary reports it. A warning
    follows when the standard deviation of a damping ratio exceeds 1 % of it.

    Args:
        recorded: record of input and outputs with common sampling, or an FRF. The outputs must be displacements, forces
            or voltages, not velocities or accelerations, whose modes have other numerators. A record is better than an
            FRF: its transient is part of the model, so there is no leakage. A windowed estimate of an FRF broadens the
            resonances: with a Hann window, damping ratios of 0.5 to 5 % become 2 to 24 % too large where the half-power
            width 2 zeta f covers two lines, up to 5 % where it covers four, and less than 1 % where it covers ten,
            which the deviations include only where the residual shows it.
            Another input that acts during a record adds noise that peaks at the resonances. The fit takes noise to be
            smooth, so that deviations become several times too small: fit the FRF that `estimate_frf` gives for all
            inputs.
        input: name of the input.
        outputs: names of the outputs.
        band: lowest and highest fitted frequency [Hz].
        n_modes: number of resonances in the band. None adds modes while Bayes' information criterion decreases and
            each damping ratio is known to a quarter of it, both if need be with one more mode; but no two modes that
            overlap and have similar shapes: such modes are one resonance that the model misrepresents (a hold, a delay,
            another input).
        hold_order: behaviour of the input between samples: 0 for a DAC that keeps each value until the next, 1 for
            straight lines, None for an input without content above half the sample rate. A neglected hold lowers gains
            by the fraction 0.6 x^2 (order 0) or x^2 / 3 (order 1) with x = pi f / sample rate, and frequencies by x
            zeta (order 0).
        delay: delay of the outputs behind the input in addition to the hold, such as the latency of converters. A
            neglected sample of 0.1 ms causes errors of some tenths of a per cent in damping ratios and gains [s].
        sample_rate: sample rate of the signals from which an FRF was estimated; needed only for its hold_order [Hz].
        residual_powers: powers p of the terms (i w)^p for modes outside the band: 0 and 2 for modes above it, 1 and 3
            for their damping and for a hold, -2 for modes below it.

    Returns:
        Modes with their covariance, and the responses at the lines of the fit.

    Raises:
        ValueError: for unknown names, a band outside the data or beyond half their sample rate, a constant input, and
            data that do not determine the modes: too few lines, no resonance, or a mode whose damping ratio has a
            standard deviation of half its value.
    """
    if not (names := unique("output", outputs)):
        raise ValueError("name at least one output")
    if n_modes is not None:
        n_modes = whole_number("n_modes", n_modes, 1, MOST_MODES_IN_BAND)
    if hold_order not in (None, 0, 1):
        raise ValueError(f"hold_order must be None, 0 or 1, got {hold_order}")
    powers = tuple(residual_powers)
    if len(set(powers)) < len(powers) or not set(powers) <= set(range(-4, 9)):
        raise ValueError(f"residual_powers must be different whole numbers from -4 to 8, got {residual_powers!r}")
    if isinstance(recorded, FRF):
        if (hold_order is None) != (sample_rate is None):
            raise ValueError("an FRF needs hold_order and sample_rate together, or neither")
        step = None if sample_rate is None else 1 / positive("sample_rate", sample_rate, "Hz")
        lines, shape = lines_of_frf(recorded, input, names, band, step, hold_order, powers)
    else:
        if sample_rate is not None:
            raise ValueError("a record states its own sample rate: sample_rate is for FRFs")
        _check_motions(recorded, names)
        lines, shape = lines_of_record(recorded, input, names, band, hold_order, powers), None
    lines = replace(lines, excitation=lines.excitation * np.exp(-1j * finite("delay", delay) * lines.omega))
    _enough(lines, n_modes or 1)
    # The matrices are tall and narrow, so that more threads would not be faster.
    with _libraries().limit(limits=1, user_api="blas"):
        (solution, criterion, doubt), noise = _search_with_noise(lines, shape, n_modes, band)
    missed = misfit(lines, solution)
    how = {
        "data": "frequency response" if isinstance(recorded, FRF) else "time record with its transient",
        "band": f"{band[0]:g} ... {band[1]:g} Hz, {len(lines.omega)} lines",
        "hold_order": str(hold_order),
        "delay": f"{delay:g} s",
        "n_modes": "chosen by BIC" if n_modes is None else "given",
        "noise": noise,
        "doubts": "; ".join(text for text in (describe_misfit(solution, missed), doubt) if text),
    }
    fit = _modal_fit(lines, solution, missed, input, names, criterion, how)
    spread = fit.damping_ratio_std / fit.damping_ratio
    if np.any((spread > POOR) & (missed[np.argsort(solution.poles[:, 0])] > 0)):
        warn(f"the fit is poor: {how['doubts']}")
    return fit


@functools.cache
def _libraries() -> ThreadpoolController:
    """Return the libraries whose threads can be limited, which are looked for once, as that takes long."""
    return ThreadpoolController()


def _check_motions(record: TimeHistory, outputs: Sequence[str]) -> None:
    """Refuse outputs that are velocities or accelerations."""
    for name in outputs:
        unit = record.units[record.names.index(known("signal", name, record.names))]
        if re.search(r"/ ?s((\*\*|\^)?2|²)?$|\bs\^?-[12]$", unit):
            raise ValueError(f"output {name!r} is a rate [{unit}]; modes are fitted to motions: integrate it first")


def _enough(lines: Lines, n_modes: int) -> None:
    per_output = n_modes * (3 if lines.transient else 1) + len(lines.residual_powers) + (5 if lines.transient else 0)
    needed = per_output + 2 * n_modes
    if len(lines.omega) < needed:
        raise ValueError(
            f"{len(lines.omega)} lines in the band carry no {n_modes} mode(s), which need at least {needed}: widen the "
            "band or record longer"
        )


def _search_with_noise(
    lines: Lines, shape: Array | None, n_modes: int | None, band: tuple[float, float]
) -> tuple[tuple[Solution, list[float], str], str]:
    """Search modes, and search again where the residual shows noise that grows with the response; also name the noise.

    The first search stands where it has, or the second one leaves, a misfit at the resonances, which unlike noise is
    systematic.
    """
    noise = "smooth over frequency, from the residual" if shape is None else "shape from the coherence"
    first = _search(lines, shape, n_modes, band)
    grown = _shape_of_response(lines, first[0]) if shape is None else None
    if grown is None:
        return first, noise
    try:
        second = _search(lines, grown, n_modes, band)
    except ValueError:
        if np.any(misfit(lines, first[0])):
            return first, noise
        raise
    if np.any(misfit(lines, second[0])):
        return first, noise
    return second, "grows with the response, from the residual"


def _search(
    lines: Lines, shape: Array | None, n_modes: int | None, band: tuple[float, float]
) -> tuple[Solution, list[float], str]:
    """Add the strongest remaining pole and refit, up to n_modes or while the criterion falls; also return doubts."""
    doubt = first = ""
    size = np.sqrt(np.mean(np.abs(lines.responses) ** 2, axis=1, keepdims=True))
    noise = np.broadcast_to(size, lines.responses.shape) if shape is None else np.maximum(shape, FIT_ROUNDING * size)
    best = last = _refined(lines, np.zeros((0, 2)), noise, shape)
    criterion = [0.0]
    for _ in range(n_modes or MOST_MODES_IN_BAND):
        if n_modes is None and np.all(np.abs(last.residual) < FIT_ROUNDING * size):
            break
        try:
            _enough(lines, len(last.poles) + 1)
            candidate, problem = _with_one_more(lines, last, size, shape, IF_GIVEN if n_modes else IF_FREE)
        except (ValueError, np.linalg.LinAlgError) as error:
            if n_modes is None:
                break
            raise _too_many(n_modes, band, str(error)) from error
        alike = "" if n_modes else describe_similar_modes(candidate)
        n_poles, problem = len(candidate.poles), problem or alike
        first = first or problem
        # Modes that are still missing may be all that is wrong with a candidate, so one more is tried.
        criterion.append(criterion[-1] + _bic_change(lines, last, candidate))
        better = not problem and criterion[-1] < criterion[len(best.poles)]
        if n_modes is None and (alike or not (better or last is best)):
            hint = f"one mode more would fit better, but {alike}, or give n_modes={n_poles}"
            doubt = hint if alike and alike == problem else ""
            break
        if problem and n_modes == n_poles:
            raise _too_many(n_poles, band, problem)
        last = candidate
        best = last if better or n_modes else best
    if not len(best.poles):
        raise ValueError(
            f"no resonance in {band[0]:g} ... {band[1]:g} Hz stands out of the noise{first and f' ({first})'}: check "
            "band and outputs, or excite it more"
        )
    return best, criterion[: len(best.poles) + 1], doubt


def _with_one_more(
    lines: Lines, last: Solution, size: Array, shape: Array | None, largest: float
) -> tuple[Solution, str]:
    """Add the strongest remaining pole to a solution and refit; also return why its modes are invalid, or "".

    Where little noise weighs lines heavily, misfits beside a pole may hide the modes that are still missing; and two
    modes closer than their widths are found from a start between them only. So if the fit is invalid, a start from
    equal weights is tried too, and one that splits the pole with the largest misfit; the first valid fit is taken.

    Args:
        lines: the spectral lines.
        last: the solution.
        size: root mean square of the responses, (outputs, 1).
        shape: see `_noise`.
        largest: see `_problem`.
    """
    starts = [
        np.vstack([last.poles, strongest_pole(lines, last.residual, weights)])
        for weights in (last.weights, np.broadcast_to(1 / size, last.weights.shape))
    ]
    if np.any(missed := misfit(lines, last)):
        frequency, ratio = last.poles[worst := int(np.argmax(missed))]
        pair = [[frequency * (1 - ratio), ratio], [frequency * (1 + ratio), ratio]]
        starts.append(np.vstack([np.delete(last.poles, worst, axis=0), pair]))
    found = []
    for k, start in enumerate(starts):
        if not any(np.array_equal(start, before) for before in starts[:k]):
            candidate = _refined(lines, start, np.sqrt(2) / last.weights, shape)
            found.append((candidate, _problem(lines, candidate, largest)))
            if not found[-1][1]:
                return found[-1]
    return found[0]


def _too_many(n_modes: int, band: tuple[float, float], problem: str) -> ValueError:
    """Return the error for more modes than the data determine."""
    return ValueError(
        f"no {n_modes} resonance(s) in {band[0]:g} ... {band[1]:g} Hz: {problem}; ask for fewer modes or another band, "
        "or record longer"
    )


def _refined(lines: Lines, start: Array, noise: Array, shape: Array | None) -> Solution:
    """Fit, estimate the noise from the residual, and fit again with the resulting weights."""
    solution = fit_poles(lines, start, np.sqrt(2) / noise)
    for _ in range(2):
        solution = fit_poles(lines, solution.poles, np.sqrt(2) / _noise(lines, solution, shape))
    return solution


def _noise(lines: Lines, solution: Solution, shape: Array | None) -> Array:
    """Return the standard deviation of complex responses, (outputs, n), smooth in frequency, scaled to the residual."""
    power, floor = _power(lines, solution)
    noise = np.maximum(np.sqrt(_smooth(lines, solution, power + floor**2)) if shape is None else shape, floor)
    misfit = np.sqrt(np.sum(power / noise**2, axis=1, keepdims=True) / max(_spare(lines, solution), 1.0))
    return np.maximum(noise * misfit, floor)


def _shape_of_response(lines: Lines, solution: Solution) -> Array | None:
    """Return the standard deviation of noise that grows with the response, up to a factor, (outputs, n).

    The variance of an estimated FRF is the larger, the larger the response is (see `lines_of_frf`), so it is taken as a
    smooth function times 1 + c |H|^2, with the c of the largest likelihood for each output.

    Returns:
        The standard deviation; None for records, and if Bayes' information criterion prefers c = 0.
    """
    if lines.transient:
        return None
    power, floor = _power(lines, solution)
    power += floor**2
    response = np.abs(lines.responses - solution.residual) ** 2
    response /= np.mean(response, axis=1, keepdims=True)

    def unlikelihood(variance: Array) -> Array:
        n = lines.omega.size
        return np.sum(np.log(variance), axis=1, keepdims=True) + n * np.log(np.mean(power / variance, axis=1))[:, None]

    best = _smooth(lines, solution, power)
    least = start = unlikelihood(best) - 0.5 * np.log(2 * lines.omega.size)
    for share in RESPONSE_SHARES:
        factor = 1 + share * response
        variance = factor * _smooth(lines, solution, power / factor)
        found = unlikelihood(variance)
        best, least = np.where(found < least, variance, best), np.minimum(found, least)
    return np.sqrt(best) if np.any(least < start) else None


def _power(lines: Lines, solution: Solution) -> tuple[Array, Array]:
    """Return the squared residual, (outputs, n), and the amplitude that counts as rounding, (outputs, 1)."""
    floor = FIT_ROUNDING * np.sqrt(np.mean(np.abs(lines.responses) ** 2, axis=1, keepdims=True))
    return solution.residual.real**2 + solution.residual.imag**2, floor


def _spare(lines: Lines, solution: Solution) -> float:
    """Return the number of lines beyond those that the unknowns take up."""
    return float(lines.omega.size - solution.n_unknowns / len(lines.responses) / 2)


def _smooth(lines: Lines, solution: Solution, power: Array) -> Array:
    """Return a smooth function of frequency fitted to the logarithm of a power, (outputs, n), up to a factor."""
    # Only the shape of log |r|^2 matters: its level, biased by Euler's constant, is set by the misfit.
    first, last = lines.omega[[0, -1]]
    degree = int(np.clip(_spare(lines, solution) // LINES_PER_POWER, 0, NOISE_DEGREE))
    basis = np.polynomial.chebyshev.chebvander((2 * lines.omega - first - last) / (last - first), degree)
    # Chebyshev polynomials are so well conditioned that normal equations are accurate enough.
    return np.asarray(np.exp(basis @ np.linalg.solve(basis.T @ basis, basis.T @ np.log(power).T)).T)


def _bic_change(lines: Lines, before: Solution, after: Solution) -> float:
    """Return the change of Bayes' information criterion by a further mode.

    The number of lines is reduced by the correlation that a window causes, for both alike: the criterion of one fit
    alone would depend on the units of the outputs.
    """
    n = 2 * lines.omega.size / correlation(after)
    likelihood = 2 * n * np.sum(np.mean(np.log(before.weights / after.weights), axis=1))
    return float(likelihood + (after.n_unknowns - before.n_unknowns) * np.log(n * len(lines.responses)))


def _problem(lines: Lines, solution: Solution, largest: float) -> str:
    """Return why modes of a solution are invalid, or ""; largest: relative standard deviation of a damping ratio."""
    spread = np.sqrt(correlation(solution) * np.diag(solution.covariance)[: solution.poles.size])
    n = len(solution.poles)
    for r, (frequency, ratio) in enumerate(solution.poles):
        if not DAMPING_RANGE[0] * 1.01 < ratio < DAMPING_RANGE[1] * 0.99:
            return f"at {frequency:.4g} Hz there is no resonance, its damping ratio would be {ratio:.3g}"
        if not lines.omega[0] * (1 + 1e-6) < 2 * np.pi * frequency < lines.omega[-1] * (1 - 1e-6):
            return f"a mode runs out of the band at {frequency:.4g} Hz"
        if spread[n + r] > largest:
            return (
                f"the data do not determine the mode at {frequency:.4g} Hz, whose damping ratio {ratio:.3g} has the "
                f"standard deviation {ratio * spread[n + r]:.2g}"
            )
    return ""


def _modal_fit(
    lines: Lines,
    solution: Solution,
    missed: Array,
    input: str,
    outputs: tuple[str, ...],
    criterion: Sequence[float],
    how: Mapping[str, str],
) -> ModalFit:
    n, n_columns = len(solution.poles), solution.values.shape[1]
    n_response = n + len(lines.residual_powers)
    order = np.argsort(solution.poles[:, 0])
    frequency, ratio = solution.poles[order].T
    index = np.concatenate([order, n + order, *(2 * n + k * n_columns + order for k in range(len(outputs)))])
    enlarged = np.sqrt(correlation(solution) + missed[order])
    scale = np.concatenate([frequency, ratio, np.ones(n * len(outputs))]) * np.tile(enlarged, 2 + len(outputs))
    covariance = scale[:, None] * solution.covariance[np.ix_(index, index)] * scale
    without_input = solution.values * (np.arange(n_columns) >= n_response)
    input_spectrum = lines.excitation * lines.held
    transient = compress_lines(lines, solution.poles).modelled(solution.poles, without_input)
    responses = (lines.responses - transient) / input_spectrum
    return ModalFit(
        input=input,
        outputs=outputs,
        frequency=frequency,
        damping_ratio=ratio,
        gains=solution.values[:, order],
        covariance=covariance,
        residual_terms=solution.values[:, n:n_response],
        residual_powers=np.array(lines.residual_powers, dtype=float),
        recorded=FRF(lines.omega / (2 * np.pi), responses[:, None], outputs, (input,), None, "recorded"),
        noise=np.sqrt(2) / solution.weights / np.abs(input_spectrum),
        criterion=np.array(criterion[: n + 1]),
        how=how,
    )
