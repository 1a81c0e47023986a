"""Matrices of linear systems: from continuous to sampled and back, and their frequency response."""

import numpy as np
import scipy

from nassim.base.checks import Array

WELL_CONDITIONED = 1e8
FAR = 100.0
"""Zeros at so many times the fastest pole's distance from the origin count as infinite."""
StateSpace = tuple[Array, Array, Array, Array]
"""A (n, n), B (n, inputs), C (outputs, n), D (outputs, inputs)."""


def discretize(state: Array, inputs: Array, time_step: float) -> tuple[Array, Array, Array]:
    """Exact steps of dx/dt = A x + B u: x_1 = P x_0 + G u_0 + H (u_1 - u_0); without H for inputs that are held.

    state: A, (n, n); inputs: B, (n, m). Returns P (n, n), G (n, m), H (n, m).
    Source: C. F. Van Loan, Computing integrals involving the matrix exponential, IEEE Trans. Automatic Control 23
    (1978) 395-404.
    """
    n, m = inputs.shape
    # Displacements and velocities differ by the frequency: a balanced matrix keeps the exponential accurate.
    balanced, scale = scipy.linalg.matrix_balance(state, permute=False, separate=True)
    scale = scale[0]
    joint = np.zeros((n + 2 * m, n + 2 * m))
    joint[:n, :n], joint[:n, n : n + m] = time_step * balanced, time_step * inputs / scale[:, None]
    joint[n : n + m, n + m :] = np.eye(m)
    result = scipy.linalg.expm(joint)[:n]
    return scale[:, None] * result[:, :n] / scale, *np.split(scale[:, None] * result[:, n:], 2, axis=1)


def tustin(system: StateSpace, time_step: float, *, prewarp: float = 0.0) -> StateSpace:
    """Sampled form of a continuous system by Tustin's rule, s = 2/T (z - 1)/(z + 1).

    time_step: T [s]; prewarp: where the two frequency responses agree exactly [rad/s], below pi/T (0: at rest)
    Source: K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 3rd ed. (1997), sec. 8.2. Raises ValueError for
    a pole at s = 2/T, which the rule sends to infinity.
    """
    a, b, c, d = system
    half = np.tan(prewarp * time_step / 2) / prewarp if prewarp else time_step / 2
    eye = np.eye(len(a))
    inverse = _inverse(
        eye - half * a, "Tustin's rule has no answer for a pole at 2 / time step; change the sample rate"
    )
    return inverse @ (eye + half * a), 2 * half * inverse @ b, c @ inverse, d + half * c @ inverse @ b


def inverse_tustin(system: StateSpace, time_step: float) -> StateSpace:
    """The continuous system whose sampled form by Tustin's rule (without prewarping) this is.

    Raises ValueError for a pole at z = -1, which no continuous system has.
    """
    a, b, c, d = system
    eye = np.eye(len(a))
    inverse = _inverse(eye + a, "a pole at z = -1 has no continuous equivalent; model the loop sampled")
    return 2 / time_step * (a - eye) @ inverse, 2 / time_step * inverse @ b, 2 * c @ inverse, d - c @ inverse @ b


def cascade(first: StateSpace, second: StateSpace) -> StateSpace:
    """Two systems in series: the outputs of the first are the inputs of the second; its states come first."""
    a1, b1, c1, d1 = first
    a2, b2, c2, d2 = second
    state = np.block([[a1, np.zeros((len(a1), len(a2)))], [b2 @ c1, a2]])
    return state, np.vstack([b1, b2 @ d1]), np.hstack([d2 @ c1, c2]), d2 @ d1


def transfer_matrix(system: StateSpace, points: Array) -> Array:
    """C (s - A)^-1 B + D at complex points s (or z), shape (n,): complex (outputs, inputs, n); infinite at poles.

    By the eigenvectors of A, which costs milliseconds; where they do not span (a double pole at one place, as of rigid
    motion without damping, or of delays) by a solve per point.
    """
    a, b, c, d = system
    constant = np.broadcast_to(d[:, :, None], (*d.shape, len(points))).astype(complex)
    if not len(a):
        return constant
    poles, vectors = np.linalg.eig(a)
    if np.linalg.cond(vectors / np.linalg.norm(vectors, axis=0)) < WELL_CONDITIONED:
        inputs = np.linalg.solve(vectors, b.astype(complex))
        with np.errstate(divide="ignore", invalid="ignore"):
            gains = 1.0 / (points - poles[:, None])
            result: Array = np.einsum("ok,ki,kf->oif", c @ vectors, inputs, gains) + constant
        return result
    resolvent = points[:, None, None] * np.eye(len(a)) - a
    try:
        states = np.linalg.solve(resolvent, np.broadcast_to(b, (len(points), *b.shape)))
    except np.linalg.LinAlgError:
        return np.full_like(constant, np.inf)
    return (c @ states).transpose(1, 2, 0) + constant


def transmission_zeros(system: StateSpace) -> Array:
    """Finite transmission zeros of a square system, complex, shape (n,): where its output vanishes for some input.

    They are generalised eigenvalues of the system matrix [[A, B], [C, D]]. Those far beyond all poles are zeros at
    infinity up to rounding, and left out.
    """
    a, b, c, d = system
    n, m = b.shape
    if not n:
        return np.zeros(0, complex)
    a, scale = scipy.linalg.matrix_balance(a, permute=False, separate=True)
    b, c = b / scale[0][:, None], c * scale[0]
    size, forces, readings = (max(float(np.abs(x).max(initial=0.0)), 1e-300) for x in (a, b, c))
    pencil = np.block([[a, b * size / forces], [c / readings, d * size / (forces * readings)]])
    unit = np.diag([1.0] * n + [0.0] * m)
    over, under = scipy.linalg.eigvals(pencil, unit, homogeneous_eigvals=True)
    finite = np.abs(over) < FAR * np.abs(np.linalg.eigvals(a)).max() * np.abs(under)
    result: Array = over[finite] / under[finite]
    return result


def _inverse(matrix: Array, message: str) -> Array:
    if len(matrix) and np.linalg.cond(matrix) > 1 / np.finfo(float).eps:
        raise ValueError(message)
    result: Array = np.linalg.inv(matrix)
    return result
