"""Norms of linear models: H2 (response to white noise) and H-infinity (largest gain over frequency)."""

import math

import numpy as np
import scipy

from nassim.base.checks import Array, above_zero
from nassim.systems.linear_model import LinearModel, Names, subsystem
from nassim.systems.state_space import balanced_system, inverse_tustin
from nassim.systems.transfer_matrices import transfer_matrix

NEAR_AXIS = 1e-3
"""Eigenvalues whose real part is below this fraction of their size are tried as crossings of the gain.

Rounding moves crossings off the imaginary axis, and each one that is tried in vain costs one value of the gain only."""
MOST_CROSSINGS = 50
UNDAMPED = 1e-12
"""Decay over the fastest pole's rate, or per sample, below which a pole is an integrator within rounding."""


def h2_norm(model: LinearModel, *, inputs: Names | None = None, outputs: Names | None = None) -> float:
    """Compute the H2 norm: the rms of all outputs together under independent white noises of unit intensity.

    White noise of unit intensity has the two-sided density of 1 unit^2/Hz, that is, 2 unit^2/Hz one-sided. For a
    sampled model it has unit variance at every sample.

    Args:
        model: the linear model.
        inputs: one name or several; None for all.
        outputs: one name or several; None for all.

    Returns:
        Norm; inf for a model that is not stable, and for a continuous model with direct feedthrough.

    Source: K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control (1996), sec. 4.6.
    """
    part = subsystem(model, inputs=inputs, outputs=outputs)
    if not _stable(part):
        return math.inf
    a, b, c = balanced_system(part.A, part.B, part.C)  # rounding of fast states would spoil those of slow ones
    if model.time_step is None and part.D.any():
        return math.inf
    states = covariance(a, b, sampled=model.time_step is not None)
    return math.sqrt(max(0.0, float(np.trace(c @ states @ c.T) + np.sum(part.D * part.D))))


def covariance(a: Array, b: Array, *, sampled: bool) -> Array:
    """Return the covariance of the states of a stable model under white noises of unit intensity, (n, n).

    Args:
        a: state matrix, (n, n).
        b: input matrix, (n, inputs).
        sampled: whether the model is sampled.
    """
    if not len(a):  # SciPy before 1.14 takes no empty matrix
        return np.zeros((0, 0))
    if not sampled:
        return np.asarray(scipy.linalg.solve_continuous_lyapunov(a, -b @ b.T))
    # SciPy's direct method loses many digits with states that decay slowly and are coupled.
    return np.asarray(scipy.linalg.solve_discrete_lyapunov(a, b @ b.T, method="bilinear"))


def hinf_norm(
    model: LinearModel, *, inputs: Names | None = None, outputs: Names | None = None, tolerance: float = 1e-6
) -> tuple[float, float]:
    """Compute the H-infinity norm: the largest singular value over all frequencies, and where it is.

    Args:
        model: the linear model.
        inputs: one name or several; None for all.
        outputs: one name or several; None for all.
        tolerance: relative accuracy of the norm.

    Returns:
        Norm, inf for a model that is not stable, and its frequency [Hz], inf where the gain of a continuous model is
        approached at high frequency only and without inputs or outputs, nan with an infinite norm.

    Source: N. A. Bruinsma, M. Steinbuch, A fast algorithm to compute the H-infinity norm of a transfer function matrix,
        Systems & Control Letters 14 (1990) 287-293.
    """
    tolerance = above_zero("tolerance", tolerance)
    part = subsystem(model, inputs=inputs, outputs=outputs)
    if not _stable(part):
        return math.inf, math.nan
    if not part.D.size:
        return 0.0, math.inf
    system = part.matrices if model.time_step is None else inverse_tustin(part.matrices, model.time_step)
    a, b, c, d = system

    def gains(omega: Array) -> Array:
        values = transfer_matrix(system, 1j * omega).transpose(2, 0, 1)
        return np.linalg.svd(values, compute_uv=False)[:, 0]

    poles = np.linalg.eigvals(a)
    omega = np.unique(np.concatenate([[0.0], np.abs(poles), np.abs(poles.imag)]))
    values = gains(omega)
    norm, at = float(values.max()), float(omega[np.argmax(values)])
    if (end := float(np.linalg.norm(d, 2))) >= norm:
        norm, at = end, math.inf
    for _ in range(MOST_CROSSINGS):
        level = (1 + tolerance) * norm
        if level == 0:
            break
        crossings = _crossings(a, b, c, d, level)
        tried = np.unique(np.concatenate([crossings, (crossings[1:] + crossings[:-1]) / 2]))
        if not len(tried) or (values := gains(tried)).max() <= level:
            break
        norm, at = float(values.max()), float(tried[np.argmax(values)])
    if model.time_step is not None:  # Tustin's rule maps frequencies by a tangent, infinity to half the sample rate
        at = 2 / model.time_step * math.atan(at * model.time_step / 2)
    return norm, at / (2 * np.pi)


def _crossings(a: Array, b: Array, c: Array, d: Array, level: float) -> Array:
    """Return the angular frequencies at which a singular value may equal a level, ascending."""
    r = np.linalg.inv(level**2 * np.eye(b.shape[1]) - d.T @ d)
    closed = a + b @ r @ d.T @ c
    hamiltonian = np.block([[closed, b @ r @ b.T], [-c.T @ (c + d @ r @ d.T @ c), -closed.T]])
    eigenvalues = np.linalg.eigvals(hamiltonian)
    near = eigenvalues[np.abs(eigenvalues.real) <= NEAR_AXIS * np.abs(eigenvalues)]
    return np.unique(np.abs(near.imag))


def _stable(model: LinearModel) -> bool:
    if not len(model.A):
        return True
    poles = np.linalg.eigvals(model.A)
    if model.time_step is not None:
        return bool(np.abs(poles).max() < 1 - UNDAMPED)
    return bool(poles.real.max() < -UNDAMPED * np.abs(poles).max())
