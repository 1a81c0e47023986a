"""Eigenmodes of dense mass and stiffness matrices, modal damping, discrete-time poles, and poles of free decays."""

import math

import numpy as np
import scipy
from numpy.typing import NDArray

from nassim.base.checks import Array, finite_array, not_negative
from nassim.base.field_types import ArrayLike
from nassim.base.warning_log import warn

SMALLEST_EXCITED = 1e-9
"""Singular values of a decay below this share of the largest are rounding errors."""


def eigenmodes(stiffness: Array, mass: Array, *, n_modes: int | None = None) -> tuple[Array, Array]:
    """Compute eigenfrequencies and mode shapes of K phi = (2 pi f)^2 M phi.

    Args:
        stiffness: symmetric matrix K, shape (n, n)
        mass: symmetric, positive definite matrix M, shape (n, n)
        n_modes: number of modes, from the lowest (default: all)

    Returns:
        Frequencies [Hz], ascending, shape (n_modes,), and mode shapes, shape (n, n_modes), normalised to phi^T M phi =
        1. If rounding makes the eigenvalue of a rigid-body mode negative, its frequency is returned as 0 Hz.

    Raises:
        ValueError: if the mass matrix is not positive definite
    """
    finite_array("stiffness matrix", stiffness, (len(mass), len(mass)))
    finite_array("mass matrix", mass, (len(mass), len(mass)))
    if n_modes is not None and n_modes < 1:
        raise ValueError(f"n_modes must be at least 1, got {n_modes}")
    if len(mass) == 0:
        return np.zeros(0), np.zeros((0, 0))
    last = len(stiffness) - 1 if n_modes is None else min(n_modes, len(stiffness)) - 1
    scale = unit_mass_scale(mass)
    try:
        eigenvalues, vectors = scipy.linalg.eigh(
            scale[:, None] * stiffness * scale, scale[:, None] * mass * scale, subset_by_index=(0, last)
        )
    except np.linalg.LinAlgError as error:
        raise ValueError("the mass matrix is not positive definite: no eigenmodes") from error
    return np.sqrt(np.maximum(eigenvalues, 0.0)) / (2 * np.pi), scale[:, None] * vectors


def unit_mass_scale(mass: Array) -> Array:
    """Return scale factors (n,) that give M a unit diagonal, to balance metres, radians and modal coordinates.

    Raises:
        ValueError: if a diagonal entry is not positive
    """
    diagonal = np.diag(mass)
    if np.any(diagonal <= 0):
        raise ValueError("the mass matrix has a diagonal entry that is not positive; it must be positive definite")
    return 1.0 / np.sqrt(diagonal)


def modal_damping_matrix(mass: Array, frequency: Array, shapes: Array, damping_ratio: ArrayLike) -> Array:
    """Compute the damping matrix C = M Phi diag(2 zeta omega) Phi^T M, which gives each mode its damping ratio.

    Args:
        mass: mass matrix M, shape (n, n)
        frequency: eigenfrequencies, shape (m,) [Hz]
        shapes: mode shapes Phi with Phi^T M Phi = I, shape (n, m)
        damping_ratio: zeta, one number or one per mode [-]

    Returns:
        C, shape (n, n) [N s/m, N m s/rad]. Modes at 0 Hz and modes that are not listed stay undamped.

    Raises:
        ValueError: if a damping ratio is negative or NaN
    """
    ratio = np.broadcast_to(np.asarray(damping_ratio, dtype=float), frequency.shape)
    if not np.all(ratio >= 0):
        raise ValueError(f"damping ratios must not be negative or NaN, got {ratio}")
    weighted = mass @ shapes
    return (weighted * (2 * ratio * 2 * np.pi * frequency)) @ weighted.T


def damping_ratios(label: str, value: ArrayLike) -> Array:
    """Return damping ratios as a read-only array, shape (k,) [-], and warn if one is at or above critical damping.

    Such a value is probably a percentage, for example 2 written for 2 %.

    Args:
        label: what messages call the ratios
        value: one damping ratio or several [-]

    Raises:
        ValueError: if there is no value or a value is negative
    """
    ratio = finite_array(label, np.atleast_1d(value), (None,))
    if ratio.size == 0:
        raise ValueError(f"{label} needs at least one value; 0 for no damping")
    for one in ratio:
        not_negative(label, one)
    if ratio.max() >= 1:
        warn(f"{label} {ratio.max():g} is critical damping or more, without oscillation: one percent is the ratio 0.01")
    return ratio


def elastic_damping_ratios(frequency: Array, damping_ratio: ArrayLike) -> Array:
    """Compute the damping ratio of each mode, shape (n,) [-]: zero for rigid-body modes, which have 0 Hz.

    Args:
        frequency: eigenfrequencies, shape (n,) [Hz]
        damping_ratio: one number, or one per elastic mode from the lowest [-]; the last value also applies to all
            following modes

    Raises:
        ValueError: if a damping ratio is negative or NaN
    """
    given = np.atleast_1d(np.asarray(damping_ratio, dtype=float))
    if not np.all(given >= 0):
        raise ValueError(f"damping ratios must not be negative or NaN, got {given}")
    elastic = np.flatnonzero(frequency > 0)
    result = np.zeros(len(frequency))
    result[elastic] = given[np.minimum(np.arange(len(elastic)), len(given) - 1)]
    return result


def discretize_pole(rate: complex, time_step: float, *, hold_order: int) -> tuple[complex, complex, complex]:
    """Discretise z' = rate z + u exactly, as z[k] = decay z[k-1] + now u[k] + before u[k-1].

    Args:
        rate: pole, not zero [1/s]
        time_step: time between samples [s]
        hold_order: 0 for an input that is constant between samples, 1 for an input that is linear between samples

    Returns:
        The coefficients now, before and decay.
    """
    x = rate * time_step
    first = np.expm1(x) / x
    if hold_order == 0:
        return 0.0, time_step * first, np.exp(x)
    # Taylor series, because the closed form loses digits for small arguments.
    second = (first - 1) / x if abs(x) > 1e-2 else sum(x**n / math.factorial(n + 2) for n in range(8))
    return time_step * second, time_step * (first - second), np.exp(x)


def mac(shapes_a: Array, shapes_b: Array, mass: Array | None = None) -> Array:
    """Compute the modal assurance criterion between two sets of mode shapes.

    Source: R. J. Allemang, "The modal assurance criterion", Sound and Vibration 37 (2003) 14-23.

    Args:
        shapes_a: mode shapes, shape (n, a)
        shapes_b: mode shapes, shape (n, b)
        mass: weight, shape (n, n) (default: identity)

    Returns:
        The criterion, shape (a, b) [-]. It is 1 where two shapes agree up to a factor.
    """
    weighted = shapes_b if mass is None else mass @ shapes_b
    weighted_a = shapes_a if mass is None else mass @ shapes_a
    norm_a = np.einsum("ij,ij->j", shapes_a, weighted_a)
    norm_b = np.einsum("ij,ij->j", shapes_b, weighted)
    return (shapes_a.T @ weighted) ** 2 / np.outer(norm_a, norm_b)


def decay_poles(decay: Array, time_step: float, *, n_poles: int) -> NDArray[np.complex128]:
    """Compute poles of free decays by the eigensystem realisation algorithm, for simulated signals without noise.

    Source: J.-N. Juang, R. S. Pappa, An eigensystem realization algorithm for modal parameter identification and model
    reduction, J. Guidance 8 (1985) 620-627.

    Args:
        decay: one decay, shape (signals, n_samples), or several decays of the same system, shape (decays, signals,
            n_samples). A pole of multiplicity two, as in a symmetric machine, needs two decays with different initial
            conditions; otherwise it is found once.
        time_step: time between samples [s]
        n_poles: largest number of poles; fewer are returned if the others are excited by rounding errors only

    Returns:
        The poles s with the most energy in the decays, shape (n,) [rad/s]. Their frequency is |s| / 2 pi and their
        damping ratio -Re s / |s|.

    Raises:
        ValueError: if there are fewer than 4 n_poles samples
    """
    single = np.ndim(decay) == 2
    decays = finite_array("decay", decay, (None,) * (2 if single else 3))[(None,) if single else ()]
    _, n_signals, n_samples = decays.shape
    if n_samples < 4 * n_poles:
        raise ValueError(f"{n_poles} poles need at least {4 * n_poles} samples, got {n_samples}")
    columns = n_samples // 2
    # Initial conditions and signals may be scaled, signals by the same factor in all decays.
    for others in ((0, 2), (1, 2)):
        decays = decays / np.maximum(np.abs(decays).max(axis=others, keepdims=True), np.finfo(float).tiny)
    by_signal = decays.swapaxes(0, 1)
    hankel = np.vstack(
        [by_signal[..., k : k + columns].reshape(n_signals, -1) for k in range(min(columns, 8 * n_poles))]
    )
    left, sizes, _ = np.linalg.svd(hankel, full_matrices=False)
    n = min(n_poles, int(np.count_nonzero(sizes > SMALLEST_EXCITED * sizes[0])))
    states = left[:, :n]
    step = np.linalg.lstsq(states[:-n_signals], states[n_signals:], rcond=None)[0]
    return np.log(np.linalg.eigvals(step).astype(complex)) / time_step
