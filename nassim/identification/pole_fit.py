"""Least-squares fit of poles common to several responses over the lines of a spectrum.

The model of output o at the line omega, with U the spectrum of the input (1 for an FRF), s = i omega and z = exp(s h):

    Y_o = [sum_r c_or w_r^2 / (s^2 + 2 zeta_r w_r s + w_r^2) + sum_p d_op s^p] U + T_o

For sampled records, T_o is the contribution of the motion before and after the record to its DFT, so that no window is
needed. It consists of the exact transform of a decaying exponential for each mode, a polynomial for the modes outside
the band, and a linear drift. All parameters except the poles are linear and are eliminated (variable projection).

Source: R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed. (2012), ch. 6 and 9; G.
Golub, V. Pereyra, Inverse Problems 19 (2003) R1 (variable projection; here with Kaufman's Jacobian).
"""

import itertools
from dataclasses import dataclass

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.modal import mac
from nassim.identification.compressed_lines import COMPRESSED_FROM, compress_lines
from nassim.identification.spectral_lines import Lines

DAMPING_RANGE = (1e-5, 0.5)
"""Range of damping ratios in which a pole counts as a resonance."""

TRIED, ALIKE = (0.003, 0.01, 0.03), 10
"""Damping ratios of the search for resonances, and number of merged lines per half-width."""
SIMILAR_SHAPES = 0.99
"""Modal assurance criterion of the gains of two modes, normalised per output, above which their shapes are similar."""
NEAR_HALF_WIDTHS = 5.0
"""Half-widths on each side of a resonance in which its misfit is evaluated."""
FEWEST_NEAR_LINES = 8
MISFIT_POWERS = 4
SYSTEMATIC = 6.0
"""Standard deviations by which the energy of a misfit must exceed that of noise."""
ABSORBED = 2.0
"""Errors absorbed by the parameters over those left in the residual: up to 2 for two modes within a half-width."""


@dataclass(frozen=True)
class Solution:
    """Poles and the linear parameters that follow from them.

    Attributes:
        poles: frequency [Hz] and damping ratio [-], (R, 2).
        values: linear parameters, (outputs, m).
        residual: responses minus model, complex, (outputs, n).
        weights: weights of the residual in the fit, (outputs, n).
        covariance: covariance of log frequency, log damping ratio and the linear parameters output by output, for
            weighted residuals with unit variance in their real and in their imaginary parts.
    """

    poles: Array
    values: Array
    residual: Array
    weights: Array
    covariance: Array

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns: those of the poles and the linear ones of all outputs."""
        return int(self.poles.size + self.values.size)


def fit_poles(lines: Lines, start: Array, weights: Array) -> Solution:
    """Refine poles from start values.

    Frequencies stay within the lines and damping ratios within `DAMPING_RANGE`.

    Args:
        lines: the spectral lines.
        start: frequency [Hz] and damping ratio [-], (R, 2) with R >= 0.
        weights: (outputs, n).

    Returns:
        Refined poles and the linear parameters.

    Raises:
        numpy.linalg.LinAlgError: when the lines do not determine the unknowns.
    """
    n_poles = len(start)
    if n_poles:
        low = np.log(np.repeat([lines.omega[0] / (2 * np.pi), DAMPING_RANGE[0]], n_poles))
        high = np.log(np.repeat([lines.omega[-1] / (2 * np.pi), DAMPING_RANGE[1]], n_poles))
        last: list[tuple[bytes, list[_Projection]]] = []
        few = compress_lines(lines, start)
        few_weights = few.weights(weights)

        def project(x: Array) -> list[_Projection]:
            if not last or last[0][0] != x.tobytes():
                last[:] = [(x.tobytes(), _project(few, _poles(x), few_weights))]
            return last[0][1]

        found = scipy.optimize.least_squares(
            lambda x: np.concatenate([part.projected for part in project(x)]),
            np.clip(np.log(start.T.ravel()), low + 1e-9, high - 1e-9),
            jac=lambda x: np.vstack([part.jacobian for part in project(x)]),
            bounds=(low, high),
            x_scale="jac",
            # The sum of squares is near 2 n, and one standard deviation changes it by 1, much more than ftol.
            ftol=1e-8,
            xtol=1e-12,
            gtol=None,
            max_nfev=100,
        )
        start = _poles(found.x)
    return _solution(lines, start, weights)


def strongest_pole(lines: Lines, residual: Array, weights: Array) -> Array:
    """Return the pole whose mode alone explains the most of the residual of a fit.

    Each candidate is evaluated at the lines within twenty half-widths of it. Lines that are much closer together than
    the half-width are merged.

    Args:
        lines: the spectral lines.
        residual: complex, (outputs, n).
        weights: (outputs, n).

    Returns:
        Frequency [Hz] and damping ratio [-], (2,).
    """
    frequency = lines.omega / (2 * np.pi)
    spacing = float(np.median(np.diff(frequency)))
    alike = (
        np.floor(np.log(frequency) / (min(TRIED) / ALIKE))
        if len(frequency) > COMPRESSED_FROM
        else np.arange(len(frequency))
    )
    first = np.flatnonzero(np.diff(alike, prepend=-np.inf))
    size = np.abs(weights * lines.excitation) ** 2
    target = weights**2 * residual * lines.excitation.conj()
    frequency = np.add.reduceat(frequency, first) / np.diff(first, append=len(frequency))
    target, size = (np.add.reduceat(values, first, axis=1) for values in (target, size))
    best, best_score = np.array([frequency[0], 0.01]), -1.0
    for ratio in TRIED:
        candidate = frequency[0]
        while candidate < frequency[-1]:
            low, high = np.searchsorted(frequency, candidate * np.array([1 - 20 * ratio, 1 + 20 * ratio]))
            near = slice(max(low - 2, 0), high + 2)
            mode = 1 / (1 - (frequency[near] / candidate) ** 2 + 2j * ratio * frequency[near] / candidate)
            explained = np.real(target[:, near] @ mode.conj()) ** 2
            score = float(np.sum(explained / (size[:, near] @ np.abs(mode) ** 2)))
            if score > best_score:
                best, best_score = np.array([candidate, ratio]), score
            candidate += max(2 * ratio * candidate, spacing)
    return best


@dataclass(frozen=True)
class _Projection:
    """Real linear least-squares problem of one output at given poles."""

    values: Array
    projected: Array
    jacobian: Array
    inverse: Array
    sensitivity: Array


def _project(lines: Lines, poles: Array, weights: Array) -> list[_Projection]:
    columns = lines.columns(poles)
    solved = []
    for weight, response in zip(weights, lines.responses, strict=True):
        matrix = _real(weight[:, None] * columns)
        scale = 1 / np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
        q, r = scipy.linalg.qr(np.asfortranarray(matrix * scale), overwrite_a=True, mode="economic", check_finite=False)
        inverse = scale[:, None] * scipy.linalg.solve_triangular(r, np.eye(len(r)))
        target = _real(weight * response)
        coordinates = q.T @ target
        solved.append((inverse @ coordinates, target - q @ coordinates, q, inverse))
    slopes = lines.derivatives(poles, np.stack([values for values, *_ in solved]))
    result = []
    for weight, slope, (values, projected, q, inverse) in zip(weights, slopes, solved, strict=True):
        full = -_real(weight[:, None] * slope)
        within = q.T @ full
        result.append(_Projection(values, projected, full - q @ within, inverse, inverse @ within))
    return result


def _solution(lines: Lines, poles: Array, weights: Array) -> Solution:
    few = compress_lines(lines, poles)
    parts = _project(few, poles, few.weights(weights))
    jacobian = np.vstack([part.jacobian for part in parts])
    # The projected Jacobian is the Schur complement of the full one: (J^T J)^-1 is the covariance of the poles.
    _, r = np.linalg.qr(jacobian)
    inverse = scipy.linalg.solve_triangular(r, np.eye(len(r))) if len(r) else r
    of_poles = inverse @ inverse.T
    slopes = np.vstack([np.eye(poles.size), *(part.sensitivity for part in parts)])
    covariance = slopes @ of_poles @ slopes.T
    place = poles.size
    for part in parts:
        here = slice(place, place + len(part.values))
        covariance[here, here] += part.inverse @ part.inverse.T
        place = here.stop
    values = np.stack([part.values for part in parts])
    residual = lines.responses - few.modelled(poles, values)
    return Solution(poles, values, residual, weights, covariance)


def _poles(x: Array) -> Array:
    return np.exp(x).reshape(2, -1).T


def _real(values: Array) -> Array:
    """Stack real parts above imaginary parts."""
    return np.concatenate([values.real, values.imag])


def describe_similar_modes(solution: Solution) -> str:
    """Return why two overlapping, similar modes are one resonance that the model misrepresents; "" if none are.

    Args:
        solution: solution of the fit.
    """
    n = len(solution.poles)
    gains = solution.values[:, :n] / np.maximum(np.abs(solution.values[:, :n]).max(axis=1, keepdims=True), 1e-300)
    alike = mac(gains, gains)
    for a, b in itertools.combinations(range(n), 2):
        (f_a, ratio_a), (f_b, ratio_b) = solution.poles[a], solution.poles[b]
        if alike[a, b] > SIMILAR_SHAPES and abs(f_a - f_b) < ratio_a * f_a + ratio_b * f_b:
            return f"modes at {f_a:.4g} and {f_b:.4g} Hz overlap and look alike; check hold_order and delay"
    return ""


def misfit(lines: Lines, solution: Solution) -> Array:
    """Compute the variance that a systematic misfit near each resonance adds, in units of the noise variance.

    Two modes 1 / (D + d) fitted by one 1 / D, or a mode with a wrong phase, leave powers of 1 / D in the residual,
    unlike noise. The energy that these powers explain, minus the energy that noise would contribute, changes a
    parameter by up to its square root, in standard deviations. The error that parameters have absorbed, and that the
    residual does not show, is larger by `ABSORBED`.

    Args:
        lines: the spectral lines.
        solution: solution of the fit.

    Returns:
        Added variance, (R,) [-]; 0 without a systematic misfit. Residuals below one standard deviation at every line
        are rounding: the noise of a fit is not taken smaller than that.
    """
    frequency = lines.omega / (2 * np.pi)
    least = FEWEST_NEAR_LINES * float(np.median(np.diff(frequency)))
    correlated, result = correlation(solution), np.zeros(len(solution.poles))
    if np.all(np.abs(solution.weights * solution.residual) < np.sqrt(2)):
        return result
    for r, (pole, ratio) in enumerate(solution.poles):
        near = np.abs(frequency - pole) < max(NEAR_HALF_WIDTHS * ratio * pole, least)
        x = frequency[near] / pole
        shape = 2j * ratio / (1 - x**2 + 2j * ratio * x)
        powers = lines.excitation[near, None] * shape[:, None] ** np.arange(1, MISFIT_POWERS + 1)
        if near.sum() < 2 * MISFIT_POWERS:
            continue
        explained = remaining = 0.0
        for weights, residual in zip(solution.weights[:, near], solution.residual[:, near], strict=True):
            q = np.linalg.qr(weights[:, None] * powers)[0]
            inside = float(np.sum(np.abs(q.conj().T @ (weights * residual)) ** 2))
            explained += inside
            remaining += float(np.sum(np.abs(weights * residual) ** 2)) - inside
        share = MISFIT_POWERS / (near.sum() - MISFIT_POWERS) * correlated * remaining
        count = 2 * MISFIT_POWERS * len(solution.weights)
        if explained > share * (1 + SYSTEMATIC * np.sqrt(2 / count)):
            result[r] = ABSORBED**2 * (explained - share)
    return result


def describe_misfit(solution: Solution, missed: Array) -> str:
    """Describe where the residual is systematic and its effect on the standard deviations; "" if it is not.

    Args:
        solution: solution of the fit.
        missed: result of `misfit`, (R,) [-].

    Returns:
        Text for a report.
    """
    where = ", ".join(
        f"{frequency:.4g} Hz ({np.sqrt(1 + energy / correlation(solution)):.0f} times)"
        for (frequency, _), energy in zip(solution.poles, missed, strict=True)
        if energy
    )
    cause = (
        "deviations enlarged: check for modes close together, complex modes (a damper in one place), hold_order, delay"
    )
    return f"the residual is systematic near {where}, {cause}" if where else ""


def correlation(solution: Solution) -> float:
    """Return the variance of a sum of adjacent lines over the independent case; windows correlate three neighbours.

    Args:
        solution: solution of the fit.
    """
    result = []
    for weighted in solution.weights * solution.residual:
        power = np.sum(np.abs(weighted) ** 2)
        lags = [np.real(np.sum(weighted[k:] * weighted[:-k].conj())) for k in (1, 2, 3)]
        result.append(1 + 2 * sum(lags) / power if power > 0 else 1.0)
    return max(1.0, *result)
