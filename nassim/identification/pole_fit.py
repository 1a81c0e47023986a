"""Poles common to several responses, by separable least squares over the lines of a spectrum.

The model of output o at the line omega, with U the input's spectrum (1 for an FRF), s = i omega and z = exp(s h):

    Y_o = [sum_r c_or w_r^2 / (s^2 + 2 zeta_r w_r s + w_r^2) + sum_p d_op s^p] U + T_o

For sampled records T_o is what the motion before and after the record leaves in its DFT, so no window is needed: per
mode exactly a decaying exponential's transform, besides a polynomial for the modes outside the band and a linear drift.
All but the poles enter linearly and are eliminated (variable projection).

Source: R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed. (2012), ch. 6 and 9;
G. Golub, V. Pereyra, Inverse Problems 19 (2003) R1 (variable projection; here with Kaufman's Jacobian).
"""

import itertools
from dataclasses import dataclass

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.modal import mac
from nassim.identification.compressed_lines import MANY, compressed
from nassim.identification.spectral_lines import Lines

DAMPING_RANGE = (1e-5, 0.5)
"""Damping ratios between which a pole counts as a resonance."""

TRIED, ALIKE = (0.003, 0.01, 0.03), 10
"""Damping ratios of the resonances that are searched for, and parts of a half-width that count as one line."""
LOOKS_ALIKE = 0.99
"""Modal assurance criterion of two modes' gains, each output by its largest, above which they look alike."""
NEAR = 5.0
"""Half-widths to either side of a resonance within which its misfit shows."""
FEWEST_NEAR = 8
MISFIT_POWERS = 4
SYSTEMATIC = 6.0
"""Standard deviations by which shapes of a misfit must explain more energy than they do of noise to be told from it."""
TAKEN_UP = 2.0
"""Errors that parameters take up over those left in the residual: up to 2 for two modes within a half-width."""


@dataclass(frozen=True)
class Solution:
    """Poles, and what follows linearly from them.

    poles: (R, 2), frequency [Hz] and damping ratio; values: of the columns, (outputs, m)
    residual: responses less model, (outputs, n) complex; weights: that it was multiplied with, (outputs, n)
    covariance: of log frequency, log damping and then of the values output by output, for weighted residuals with unit
        variance in their real and in their imaginary parts
    """

    poles: Array
    values: Array
    residual: Array
    weights: Array
    covariance: Array

    @property
    def n_unknowns(self) -> int:
        """Poles' unknowns and linear ones of all outputs."""
        return int(self.poles.size + self.values.size)


def fit_poles(lines: Lines, start: Array, weights: Array) -> Solution:
    """Refine poles from a start, (R, 2) with R from 0 on; weights: (outputs, n).

    Frequencies stay within the lines and damping ratios within DAMPING_RANGE. Raises numpy.linalg.LinAlgError when the
    lines do not determine the unknowns.
    """
    n_poles = len(start)
    if n_poles:
        low = np.log(np.repeat([lines.omega[0] / (2 * np.pi), DAMPING_RANGE[0]], n_poles))
        high = np.log(np.repeat([lines.omega[-1] / (2 * np.pi), DAMPING_RANGE[1]], n_poles))
        last: list[tuple[bytes, list[_Projection]]] = []
        few = compressed(lines, start)
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
            # Of a sum of squares near 2 n, this share is far below the 1 that a standard deviation makes.
            ftol=1e-8,
            xtol=1e-12,
            gtol=None,
            max_nfev=100,
        )
        start = _poles(found.x)
    return _solution(lines, start, weights)


def strongest_pole(lines: Lines, residual: Array, weights: Array) -> Array:
    """The pole (Hz, damping ratio) whose mode alone explains the most of what a fit has left over.

    Every candidate is judged by the lines within twenty half-widths of it; lines much closer together than its
    half-width are taken as one.
    """
    frequency = lines.omega / (2 * np.pi)
    spacing = float(np.median(np.diff(frequency)))
    alike = np.floor(np.log(frequency) / (min(TRIED) / ALIKE)) if len(frequency) > MANY else np.arange(len(frequency))
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
    """One output's linear problem at given poles, in real numbers."""

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
    few = compressed(lines, poles)
    parts = _project(few, poles, few.weights(weights))
    jacobian = np.vstack([part.jacobian for part in parts])
    # The projected Jacobian is the Schur complement of the whole one: its inverse square is the poles' covariance.
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
    result: Array = np.exp(x).reshape(2, -1).T
    return result


def _real(values: Array) -> Array:
    """Real above imaginary parts."""
    return np.concatenate([values.real, values.imag])


def twins(solution: Solution) -> str:
    """Whether two modes overlap and look alike, one resonance that the model misses; why, or nothing."""
    n = len(solution.poles)
    gains = solution.values[:, :n] / np.maximum(np.abs(solution.values[:, :n]).max(axis=1, keepdims=True), 1e-300)
    alike = mac(gains, gains)
    for a, b in itertools.combinations(range(n), 2):
        (f_a, ratio_a), (f_b, ratio_b) = solution.poles[a], solution.poles[b]
        if alike[a, b] > LOOKS_ALIKE and abs(f_a - f_b) < ratio_a * f_a + ratio_b * f_b:
            return f"modes at {f_a:.4g} and {f_b:.4g} Hz overlap and look alike; check hold_order and delay"
    return ""


def misfit(lines: Lines, solution: Solution) -> Array:
    """What the model misses near each resonance, (R,): variance that it adds, in units of the noise's; 0: nothing.

    Modes 1 / (D + d) fitted by one 1 / D, or one with a wrong phase, leave powers of 1 / D, which noise does not. The
    energy that these explain of the weighted residual, beyond their share of noise of the size that remains, moves
    a parameter by up to its root, in standard deviations; and what parameters have taken up, so that no residual shows
    it, is larger by TAKEN_UP.
    """
    frequency = lines.omega / (2 * np.pi)
    least = FEWEST_NEAR * float(np.median(np.diff(frequency)))
    correlated, result = correlation(solution), np.zeros(len(solution.poles))
    for r, (pole, ratio) in enumerate(solution.poles):
        near = np.abs(frequency - pole) < max(NEAR * ratio * pole, least)
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
            result[r] = TAKEN_UP**2 * (explained - share)
    return result


def misfit_in_words(solution: Solution, missed: Array) -> str:
    """Where the residual is systematic, and what it does to the standard deviations; empty where it is not."""
    where = ", ".join(
        f"{frequency:.4g} Hz ({np.sqrt(1 + energy / correlation(solution)):.0f} times)"
        for (frequency, _), energy in zip(solution.poles, missed, strict=True)
        if energy
    )
    cause = "deviations enlarged: check for modes close together, hold_order, delay"
    return f"the residual is systematic near {where}, {cause}" if where else ""


def correlation(solution: Solution) -> float:
    """Variance of a sum of neighbouring lines over that of independent ones: windows correlate the next three."""
    result = []
    for weighted in solution.weights * solution.residual:
        power = np.sum(np.abs(weighted) ** 2)
        lags = [np.real(np.sum(weighted[k:] * weighted[:-k].conj())) for k in (1, 2, 3)]
        result.append(1 + 2 * sum(lags) / power if power > 0 else 1.0)
    return max(1.0, *result)
