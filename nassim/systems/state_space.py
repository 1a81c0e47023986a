"""Matrices of linear systems: from continuous to sampled and back, over many samples, their frequency response."""

import contextlib

import numpy as np
import scipy
from numpy.typing import NDArray

from nassim.base.checks import Array

EPSILON = float(np.finfo(float).eps)
WELL_CONDITIONED = 1e6
"""Condition of unit eigenvectors below which they span."""
CHECKED = 8
"""Poles of a part, those with the closest points, at which its sum over eigenvectors is checked."""
AGREED = 1e-9
"""Difference of that sum from a direct solve, over the response, up to which it is used."""
NOTHING = 1e-14
"""Relative change of A's rows: a response that is no larger than its effect is rounding."""
ROUNDING = EPSILON**0.75
"""Of a system whose numbers are near 1, what counts as zero in a rank."""
SWEEPS = 3
EARLIER = 0.5
"""Weight of an input's last value but one in what has settled to its values, see `settling_response`."""
StateSpace = tuple[Array, Array, Array, Array]
"""A (n, n), B (n, inputs), C (outputs, n), D (outputs, inputs)."""
Parts = tuple[Array, Array, Array]
"""A, B and C of systems, which may have leading axes; or their poles, drives and shows."""


def uncoupled(state: Array) -> list[Array]:
    """Which states of dx/dt = A x belong together, as those of a mode, and to no others: (parts, size) for each size.

    state: A, (n, n)
    """
    _, part = scipy.sparse.csgraph.connected_components(scipy.sparse.csr_matrix(state != 0), directed=False)
    order = np.argsort(part, kind="stable")
    sizes = np.bincount(part)[part[order]] if len(part) else part
    return [order[sizes == size].reshape(-1, size) for size in np.unique(sizes)]


def discretize(state: Array, inputs: Array, time_step: float) -> tuple[Array, Array, Array]:
    """Exact steps of dx/dt = A x + B u: x_1 = P x_0 + G u_0 + H (u_1 - u_0); without H for inputs that are held.

    state: A, (n, n); inputs: B, (n, m). Returns P (n, n), G (n, m), H (n, m). Parts that nothing couples go by
    themselves, so that fast ones cost slow ones no digits.
    Source: C. F. Van Loan, Computing integrals involving the matrix exponential, IEEE Trans. Automatic Control 23
    (1978) 395-404.
    """
    n, m = inputs.shape
    # Displacements and velocities differ by the frequency: a balanced matrix keeps the exponential accurate.
    balanced, scale = _balanced(state)
    phi, integrals = np.zeros((n, n)), np.zeros((n, 2 * m))
    for part in uncoupled(state):
        size = part.shape[1]
        joint = np.zeros((len(part), size + 2 * m, size + 2 * m))
        joint[:, :size, :size] = time_step * balanced[part[:, :, None], part[:, None]]
        joint[:, :size, size : size + m] = (time_step * inputs / scale[:, None])[part]
        joint[:, size : size + m, size + m :] = np.eye(m)
        result = scipy.linalg.expm(joint)[:, :size]
        phi[part[:, :, None], part[:, None]] = result[..., :size]
        integrals[part] = result[..., size:]
    integrals *= scale[:, None]
    return scale[:, None] * phi / scale, integrals[:, :m], integrals[:, m:]


def _balanced(state: Array) -> tuple[Array, Array]:
    """A in other units of its states, (n, n), in which its rows are as large as its columns; and these units, (n,)."""
    if not len(state):  # SciPy before 1.14 takes no empty matrices.
        return state, np.zeros(0)
    # A state that no other moves, or that moves no other, cannot be balanced: its own little rate must not try.
    guide, rates = np.array(state), np.diag(state)
    rows, columns = (np.linalg.norm(state - np.diag(rates), axis=axis) for axis in (1, 0))
    lone = (rows == 0) | (columns == 0)
    np.fill_diagonal(guide, np.where(lone, np.maximum(np.abs(rates), rows + columns), rates))
    with np.errstate(invalid="ignore"):  # SciPy casts units, which may be large, to indices, which nobody asked for.
        _, (scale, _) = scipy.linalg.matrix_balance(guide, permute=False, separate=True)
    return state * scale / scale[:, None], scale


def quasi_static(state: Array, inputs: Array, fast: Array) -> tuple[Array, Array, Array, Array]:
    """Let some states of dx/dt = A x + B u follow at once, in balance with the others and the inputs.

    state: A, (n, n); inputs: B, (n, m); fast: which states follow, bool (n,)

    Returns A' (k, k) and B' (k, m) of the other states x', and what all states are, x = X x' + U u: X (n, k), U (n, m).
    Constant inputs give what they gave. At a frequency f the part of a mode at f_m with a damping ratio of zeta is off
    by the share (f / f_m)^2 in size, and by 2 zeta f / f_m in phase.
    Source: as residual flexibility R. H. MacNeal, A hybrid method of component mode synthesis, Computers & Structures 1
    (1971) 581-601; of any states P. Kokotovic, H. K. Khalil, J. O'Reilly, Singular Perturbation Methods in Control
    (1986), sec. 1.2.
    """
    n, slow = len(state), np.flatnonzero(~fast)
    kept, taken = np.eye(n)[:, slow], np.zeros_like(inputs)
    if len(slow) == n:
        return state, inputs, kept, taken
    balanced, scale = _balanced(state)
    by_others = np.hstack([balanced[np.ix_(fast, slow)] / scale[slow], inputs[fast] / scale[fast, None]])
    followed_by = -scale[fast, None] * np.linalg.solve(balanced[np.ix_(fast, fast)], by_others)
    kept[fast], taken[fast] = np.split(followed_by, [len(slow)], axis=1)
    return state[slow] @ kept, inputs[slow] + state[slow] @ taken, kept, taken


def settling_response(system: StateSpace, settling: Array) -> StateSpace:
    """A sampled system with a part of its outputs that follows the inputs between samples.

    settling: of an input that stays, (outputs, inputs). Where the system itself has direct feedthrough, both are seen
        at once. Elsewhere 3/2 of it is seen of the value that an input had until the sample, less 1/2 of the one before

    These two weights, of Adams' and Bashforth's rule of second order, are right in size and in delay for a mode that
    rings through several samples, at frequencies far below the sample rate: as all else that answers a held input,
    it is half a sample late. Both values of each such input are further states, the last ones.
    """
    a, b, c, d = system
    late = np.where(d == 0, settling, 0.0)
    inputs = np.eye(b.shape[1])[late.any(axis=0)]
    n, m = len(a), len(inputs)
    state = np.zeros((n + 2 * m, n + 2 * m))
    state[:n, :n], state[n + m :, n : n + m] = a, np.eye(m)
    seen = late @ inputs.T
    return (
        state,
        np.vstack([b, inputs, np.zeros_like(inputs)]),
        np.hstack([c, (1 + EARLIER) * seen, -EARLIER * seen]),
        d + np.where(d == 0, 0.0, settling),
    )


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


def followed(first: StateSpace, second: StateSpace) -> StateSpace:
    """Sampled systems with the same states in turn, as one: inputs and outputs of the first, then of the second."""
    a1, b1, c1, d1 = first
    a2, b2, c2, d2 = second
    later = np.hstack([c2 @ b1, d2])
    return a2 @ a1, np.hstack([a2 @ b1, b2]), np.vstack([c1, c2 @ a1]), np.vstack([_beside(d1, len(b2.T)), later])


def repeated(system: StateSpace, times: int) -> StateSpace:
    """A sampled system over several samples at once, whose inputs and outputs are those of all samples in turn."""
    if times == 1:
        return system
    half = repeated(system, times // 2)
    twice = followed(half, half)
    return followed(twice, system) if times % 2 else twice


def _beside(matrix: Array, n_columns: int) -> Array:
    return np.hstack([matrix, np.zeros((len(matrix), n_columns))])


def transfer_matrix(system: StateSpace, points: Array) -> Array:
    """C (s - A)^-1 B + D at complex points s (or z), shape (n,): complex (outputs, inputs, n); infinite at poles.

    The response is a sum over the eigenvectors of A's uncoupled parts, which costs milliseconds. Each part's sum is
    compared with a direct solve at the ends and near poles. A part whose eigenvectors do not span (a double pole at one
    place, as of rigid-body motion with or without little damping, or of delays), or whose sum differs, is solved
    directly at every point.
    """
    a, b, c, d = system
    balanced, scale = _balanced(a)
    b, c = b / scale[:, None], c * scale
    result = np.broadcast_to(d.reshape(-1, 1), (d.size, len(points))).astype(complex)
    for index in uncoupled(a):
        parts = balanced[index[:, :, None], index[:, None]], b[index], c[:, index].swapaxes(0, 1)
        modes, spanned = _modes(parts)
        right = spanned & _agrees(parts, modes, points)
        for state, inputs, outputs in zip(*(matrices[~right] for matrices in parts), strict=True):
            with np.errstate(invalid="ignore"):
                result += (outputs @ _solved(state, inputs, points[:, None, None])).reshape(len(points), -1).T
        poles, drives, shows = (of[right] for of in modes)
        # Sums over all parts and their poles at once: (outputs * inputs, poles) times (poles, points).
        terms = np.einsum("pon,pni->oipn", shows, drives).reshape(d.size, -1)
        with np.errstate(divide="ignore", invalid="ignore"):
            result += terms @ (1.0 / (points - poles.reshape(-1, 1)))
    return result.reshape(*d.shape, len(points))


def _modes(parts: Parts) -> tuple[Parts, NDArray[np.bool_]]:
    """Poles (p, n) of p parts, their drives (p, n, inputs) and shows (p, outputs, n), and whether eigenvectors span.

    Unit eigenvectors tell that by their condition; after a scaling of their rows, parallel ones may look different.
    """
    a, b, c = parts
    poles, vectors = np.linalg.eig(a)
    spanned = np.linalg.cond(vectors) < WELL_CONDITIONED
    drives = np.zeros(b.shape, complex)
    drives[spanned] = np.linalg.solve(vectors[spanned], b[spanned].astype(complex))
    return (poles, drives, c @ vectors), spanned


def _agrees(parts: Parts, modes: Parts, points: Array) -> NDArray[np.bool_]:
    """Which parts' sums over eigenvectors equal a direct solve, at both ends and at the points closest to poles, (p,).

    Of each response, its own size there counts, unless it is nothing but rounding in both, as symmetry makes it. What
    the sum's terms lose where they cancel counts as a difference, as in the sum at all points they may round otherwise.
    """
    (a, b, c), (poles, drives, shows) = parts, modes
    if not len(points):
        return np.ones(len(a), dtype=bool)
    distance = np.abs(points - poles[..., None])
    with np.errstate(divide="ignore", invalid="ignore"):
        closest = np.argsort(distance.min(axis=2) / np.abs(poles), axis=1)[:, :CHECKED]
    near = np.take_along_axis(distance.argmin(axis=2), closest, axis=1)
    ends = np.broadcast_to([0, len(points) - 1], (len(a), 2))
    at = points[np.hstack([ends, near])][..., None, None]
    states = _solved(a[:, None], b[:, None], at)
    adjoint = _solved(a[:, None].swapaxes(2, 3), c[:, None].swapaxes(2, 3), at)
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = c[:, None] @ states
        terms = shows[:, None] / (at - poles[:, None, None])
        found, lost = terms @ drives[:, None], EPSILON * (np.abs(terms) @ np.abs(drives[:, None]))
        by_rows = np.abs(adjoint).swapaxes(2, 3) @ np.linalg.norm(a, axis=2)[:, None, :, None]
        rounding = NOTHING * by_rows * np.linalg.norm(states, axis=2, keepdims=True)
        same = np.abs(found - expected) + lost <= AGREED * np.abs(expected)
        nothing = np.maximum(np.abs(found), np.abs(expected)) + lost <= rounding
    result: NDArray[np.bool_] = np.all(same | nothing, axis=(1, 2, 3))
    return result


def _solved(state: Array, inputs: Array, points: Array) -> Array:
    """(s - A)^-1 B by a solve per point, (..., n, inputs), infinite at poles.

    points: (..., 1, 1), whose leading axes are broadcast with those of A and B
    """
    matrices = points * np.eye(state.shape[-1]) - state
    forces = np.broadcast_to(inputs, (*matrices.shape[:-1], inputs.shape[-1])).astype(complex)
    try:
        result: Array = np.linalg.solve(matrices, forces)
    except np.linalg.LinAlgError:
        result = np.full(forces.shape, np.inf + 0j)
        for k in np.ndindex(matrices.shape[:-2]):
            with contextlib.suppress(np.linalg.LinAlgError):
                result[k] = np.linalg.solve(matrices[k], forces[k])
    return result


def transmission_zeros(system: StateSpace) -> Array:
    """Finite invariant zeros of a system with as many outputs as inputs, complex, shape (n,).

    Where the system matrix [[A - s, B], [C, D]] loses rank: some motion goes on, driven or not, that no output shows.
    Poles that the inputs do not move or the outputs do not show are among them. Zeros at infinity are split off before
    the eigenvalues are taken, by ranks: couplings below 2e-12 of the largest count as rounding.

    Source: A. Emami-Naeini, P. Van Dooren, Computation of zeros of linear multivariable systems, Automatica 18 (1982)
    415-430. Raises ValueError for other numbers of outputs than of inputs, and where every s would be a zero.
    """
    if system[3].shape[0] != system[3].shape[1]:
        n_out, n_in = system[3].shape
        raise ValueError(f"zeros need as many outputs as inputs, got {n_out} and {n_in}; choose some of them")
    (a, b, c, d), size = _scaled(system) if len(system[0]) else (system, 1.0)
    while True:
        left, values, _ = np.linalg.svd(d)
        rank = int(np.sum(values > ROUNDING))
        if rank == len(d):
            break
        # Outputs without feedthrough stay zero if the states move only where these see nothing, and so do their rates.
        blind = left[:, rank:].T @ c
        if len(blind) > len(a) or np.linalg.svd(blind, compute_uv=False)[-1] < ROUNDING:
            raise ValueError(
                "every s is a zero: some input moves no output, or outputs depend on each other; leave it out"
            )
        basis = scipy.linalg.qr(blind.T)[0]
        seen, unseen = basis[:, : len(blind)].T, basis[:, len(blind) :]
        shown = left[:, :rank].T
        c, d = np.vstack([shown @ c, seen @ a]) @ unseen, np.vstack([shown @ d, seen @ b])
        a, b = unseen.T @ a @ unseen, unseen.T @ b
    # Motions with inputs such that no output shows them, and their rates.
    motions = scipy.linalg.qr(np.hstack([c, d]).T)[0][:, len(d) :]
    states, rates = motions[: len(a)], np.hstack([a, b]) @ motions
    if not rates.size:
        return np.zeros(0, complex)
    result: Array = size * scipy.linalg.eigvals(rates, states).astype(complex)
    return result


def _scaled(system: StateSpace) -> tuple[StateSpace, float]:
    """A system with the same zeros but for a factor, whose numbers are near 1 whatever the units; and that factor.

    A is balanced; parts of it that do not touch each other, as modes, are as strongly driven as seen.
    """
    a, b, c, d = system
    a, scale = _balanced(a)
    b, c = b / scale[:, None], c * scale
    _, part = scipy.sparse.csgraph.connected_components(a != 0, directed=False)
    driven, seen = (np.sqrt(np.bincount(part, x, minlength=1)) for x in ((b**2).sum(axis=1), (c**2).sum(axis=0)))
    both = (driven > 0) & (seen > 0)
    ratio = np.sqrt(np.divide(driven, seen, out=np.ones_like(driven), where=both))[part]
    b, c = b / ratio[:, None], c * ratio
    size = float(np.linalg.norm(a)) or 1.0
    a, b = a / size, b / size
    for _ in range(SWEEPS):
        each = _norms(np.vstack([b, d]), axis=0)
        b, d = b / each, d / each
        each = _norms(np.hstack([c, d]), axis=1)[:, None]
        c, d = c / each, d / each
    return (a, b, c, d), size


def _norms(matrix: Array, axis: int) -> Array:
    norms = np.linalg.norm(matrix, axis=axis)
    return np.where(norms > 0, norms, 1.0)


def _inverse(matrix: Array, message: str) -> Array:
    if len(matrix) and np.linalg.cond(matrix) > 1 / np.finfo(float).eps:
        raise ValueError(message)
    result: Array = np.linalg.inv(matrix)
    return result
