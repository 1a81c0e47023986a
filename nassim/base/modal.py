"""Eigenmodes of dense mass and stiffness matrices, modal damping, poles in discrete time and of decays."""

import math
import warnings

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from nassim.base.checks import Array, finite_array, not_negative

EXCITED = 1e-9
"""Directions of a decay below this share of the largest are rounding."""


def eigenmodes(stiffness: Array, mass: Array, *, n_modes: int | None = None) -> tuple[Array, Array]:
    """Eigenfrequencies and mode shapes of K phi = (2 pi f)^2 M phi.

    stiffness, mass: symmetric matrices, shape (n, n); mass positive definite
    n_modes: how many, from the lowest (default: all)

    Returns (frequency [Hz], shape (n_modes,), ascending; shapes (n, n_modes), normalised to
    phi^T M phi = 1). A rigid motion's eigenvalue that rounding made negative is returned as 0 Hz.
    Raises ValueError when the mass matrix is not positive definite.
    """
    finite_array("stiffness matrix", stiffness, (len(mass), len(mass)))
    finite_array("mass matrix", mass, (len(mass), len(mass)))
    if n_modes is not None and n_modes < 1:
        raise ValueError(f"n_modes must be at least 1, got {n_modes}")
    if len(mass) == 0:
        return np.zeros(0), np.zeros((0, 0))
    last = len(stiffness) - 1 if n_modes is None else min(n_modes, len(stiffness)) - 1
    # Scaling to a unit diagonal of M mends the mix of metres, radians and modal coordinates.
    diagonal = np.diag(mass)
    if np.any(diagonal <= 0):
        raise ValueError("the mass matrix has a diagonal entry that is not positive; it must be positive definite")
    scale = 1.0 / np.sqrt(diagonal)
    try:
        eigenvalues, vectors = scipy.linalg.eigh(
            scale[:, None] * stiffness * scale, scale[:, None] * mass * scale, subset_by_index=(0, last)
        )
    except np.linalg.LinAlgError as error:
        raise ValueError("the mass matrix is not positive definite: no eigenmodes") from error
    return np.sqrt(np.maximum(eigenvalues, 0.0)) / (2 * np.pi), scale[:, None] * vectors


def modal_damping_matrix(mass: Array, frequency: Array, shapes: Array, damping_ratio: ArrayLike) -> Array:
    """Damping matrix that gives each mode its damping ratio: C = M Phi diag(2 zeta omega) Phi^T M.

    mass: (n, n); frequency: (m,) [Hz]; shapes: (n, m) with Phi^T M Phi = I
    damping_ratio: one number or one per mode [-]

    Returns (n, n) [N s/m and the like]. Modes at 0 Hz and modes not listed stay undamped.
    """
    ratio = np.broadcast_to(np.asarray(damping_ratio, dtype=float), frequency.shape)
    if not np.all(ratio >= 0):
        raise ValueError(f"damping ratios must not be negative or NaN, got {ratio}")
    weighted = mass @ shapes
    result: Array = (weighted * (2 * ratio * 2 * np.pi * frequency)) @ weighted.T
    return result


def damping_ratios(label: str, value: ArrayLike, *, stacklevel: int = 2) -> Array:
    """Return damping ratios, one number or several, as a read-only array (k,) [-]; label: what messages call them.

    Raises ValueError for none at all and for negative ones; warns of critical damping, as of 2 written for 2 %.
    """
    ratio = finite_array(label, np.atleast_1d(value), (None,))
    if ratio.size == 0:
        raise ValueError(f"{label} needs at least one value; 0 for no damping")
    for one in ratio:
        not_negative(label, one)
    if ratio.max() >= 1:
        warnings.warn(
            f"{label} {ratio.max():g} is critical damping or more, in which nothing swings: one percent is the ratio "
            "0.01",
            stacklevel=stacklevel + 1,
        )
    return ratio


def elastic_ratios(frequency: Array, damping_ratio: ArrayLike) -> Array:
    """Damping ratio of each mode, (n,) [-]: 0 for free motions, which have 0 Hz; for the others as given.

    damping_ratio: one number or one per elastic mode from the lowest; the last one is that of all that follow
    Raises ValueError for one that is negative or NaN.
    """
    given = np.atleast_1d(np.asarray(damping_ratio, dtype=float))
    if not np.all(given >= 0):
        raise ValueError(f"damping ratios must not be negative or NaN, got {given}")
    elastic = np.flatnonzero(frequency > 0)
    result = np.zeros(len(frequency))
    result[elastic] = given[np.minimum(np.arange(len(elastic)), len(given) - 1)]
    return result


def held_pole(rate: complex, time_step: float, *, hold_order: int) -> tuple[complex, complex, complex]:
    """Exact discrete form z[k] = decay z[k-1] + now u[k] + before u[k-1] of z' = rate z + u.

    rate [1/s], not zero; hold_order: 0 for an input that keeps each sample's value until the next, 1 for one that runs
    straight between them. Returns (now, before, decay).
    """
    x = rate * time_step
    first = np.expm1(x) / x
    if hold_order == 0:
        return 0.0, time_step * first, np.exp(x)
    # Taylor's series where the closed form would cancel.
    second = (first - 1) / x if abs(x) > 1e-2 else sum(x**n / math.factorial(n + 2) for n in range(8))
    return time_step * second, time_step * (first - second), np.exp(x)


def mac(shapes_a: Array, shapes_b: Array, mass: Array | None = None) -> Array:
    """Modal assurance criterion between two sets of mode shapes, (n, a) and (n, b).

    mass: weight (n, n) (default: the identity). Returns (a, b), 1 where shapes coincide up to a factor.
    Source: R. J. Allemang, "The modal assurance criterion", Sound and Vibration 37 (2003) 14-23.
    """
    weighted = shapes_b if mass is None else mass @ shapes_b
    weighted_a = shapes_a if mass is None else mass @ shapes_a
    norm_a = np.einsum("ij,ij->j", shapes_a, weighted_a)
    norm_b = np.einsum("ij,ij->j", shapes_b, weighted)
    result: Array = (shapes_a.T @ weighted) ** 2 / np.outer(norm_a, norm_b)
    return result


def decay_poles(decay: Array, time_step: float, *, n_poles: int) -> NDArray[np.complex128]:
    """Poles of free decays, by the eigensystem realisation algorithm; for simulated signals without noise.

    decay: of one decay, (signals, n_samples), or of several of the same system, (decays, signals, n_samples). A pole
        that occurs twice, as of a symmetric machine, is found twice only in two decays that begin differently
    time_step [s]; n_poles: at most so many, less where only rounding excites more

    Returns the poles s, those with most energy in the decays, shape (n,) [rad/s]; frequency |s| / 2 pi, damping ratio
    -Re s / |s|. Raises ValueError for fewer than 4 n_poles samples.

    Source: J.-N. Juang, R. S. Pappa, An eigensystem realization algorithm for modal parameter identification and model
    reduction, J. Guidance 8 (1985) 620-627.
    """
    single = np.ndim(decay) == 2
    decays = finite_array("decay", decay, (None,) * (2 if single else 3))[(None,) if single else ()]
    _, n_signals, n_samples = decays.shape
    if n_samples < 4 * n_poles:
        raise ValueError(f"{n_poles} poles need at least {4 * n_poles} samples, got {n_samples}")
    columns = n_samples // 2
    # What a decay begins with may be scaled, and what a signal reads, but that in all decays alike.
    for others in ((0, 2), (1, 2)):
        decays = decays / np.maximum(np.abs(decays).max(axis=others, keepdims=True), np.finfo(float).tiny)
    beside = decays.swapaxes(0, 1)
    hankel = np.vstack([beside[..., k : k + columns].reshape(n_signals, -1) for k in range(min(columns, 8 * n_poles))])
    left, sizes, _ = np.linalg.svd(hankel, full_matrices=False)
    n = min(n_poles, int(np.count_nonzero(sizes > EXCITED * sizes[0])))
    states = left[:, :n]
    step = np.linalg.lstsq(states[:-n_signals], states[n_signals:], rcond=None)[0]
    return np.log(np.linalg.eigvals(step).astype(complex)) / time_step
