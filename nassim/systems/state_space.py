"""Matrices of linear systems: sampling and its inverse, several samples at once, zeros."""

from collections.abc import Sequence

import numpy as np
import scipy

from nassim.base.checks import Array, finite_array, not_negative, positive
from nassim.base.field_types import ArrayLike

EPSILON = float(np.finfo(float).eps)
WELL_CONDITIONED = 1e6
"""Condition number of unit eigenvectors below which they count as linearly independent."""
RANK_TOLERANCE = EPSILON**0.75
"""Rank tolerance for a system whose entries are near 1."""
SWEEPS = 3
EARLIER = 0.5
"""Weight of the last but one value of an input in the settled response, see `settling_response`."""
StateSpace = tuple[Array, Array, Array, Array]
"""A (n, n), B (n, inputs), C (outputs, n), D (outputs, inputs)."""


def uncoupled(state: Array) -> list[Array]:
    """Group the states of dx/dt = A x into parts that are not coupled to each other, such as modes.

    Args:
        state: A, (n, n).

    Returns:
        Indices of states, (parts, size), one array for each size of part.
    """
    _, part = scipy.sparse.csgraph.connected_components(scipy.sparse.csr_matrix(state != 0), directed=False)
    order = np.argsort(part, kind="stable")
    sizes = np.bincount(part)[part[order]] if len(part) else part
    return [order[sizes == size].reshape(-1, size) for size in np.unique(sizes)]


def checked_system(system: Sequence[ArrayLike]) -> StateSpace:
    """Return the matrices of a system as arrays.

    Raises:
        ValueError: for anything but four matrices of finite numbers whose shapes agree
    """
    if not isinstance(system, Sequence) or len(system) != 4:
        raise ValueError(f"a system is (A, B, C, D), got {type(system).__name__}; a LinearModel has them as `matrices`")
    a, d = (finite_array(name, system[k], (None, None)) for name, k in (("A", 0), ("D", 3)))
    n = len(a)
    b, c = finite_array("B", system[1], (n, d.shape[1])), finite_array("C", system[2], (len(d), n))
    return finite_array("A", a, (n, n)), b, c, d


def discretize(state: ArrayLike, inputs: ArrayLike, time_step: float) -> tuple[Array, Array, Array]:
    """Compute the exact step x_1 = P x_0 + G u_0 + H (u_1 - u_0) of dx/dt = A x + B u with inputs linear in time.

    Inputs that are held need no H. Uncoupled parts are treated separately, so that fast parts do not reduce the
    accuracy of slow ones.

    Args:
        state: A, (n, n).
        inputs: B, (n, m).
        time_step: [s].

    Returns:
        P (n, n), G (n, m) and H (n, m).

    Raises:
        ValueError: for matrices whose shapes do not agree, and a time step that is not positive.

    Source: C. F. Van Loan, Computing integrals involving the matrix exponential, IEEE Trans. Automatic Control 23
        (1978) 395-404.
    """
    n = len(finite_array("A", state, (None, None)))
    state, inputs = finite_array("A", state, (n, n)), finite_array("B", inputs, (n, None))
    time_step, n_in = positive("time_step", time_step, "s"), inputs.shape[1]
    generator = np.zeros((2 * n_in, 2 * n_in))
    generator[:n_in, n_in:] = np.eye(n_in)
    phi, driven = discretize_generated(state, np.hstack([inputs, np.zeros_like(inputs)]), generator, time_step)
    return phi, driven[:, :n_in], driven[:, n_in:]


def discretize_generated(state: Array, inputs: Array, generator: Array, time_step: float) -> tuple[Array, Array]:
    """Compute the exact step x_1 = P x_0 + G z_0 of dx/dt = A x + B z with inputs that obey dz/dt = S z.

    Uncoupled parts are treated separately, as by `discretize`.

    Args:
        state: A, (n, n).
        inputs: B, (n, m).
        generator: S times the time step, (m, m).
        time_step: [s].

    Returns:
        P (n, n) and G (n, m).
    """
    n, m = inputs.shape
    # Displacements and velocities differ by a factor of the frequency; balancing keeps the exponential accurate.
    balanced, scale = balanced_states(state)
    phi, driven = np.zeros((n, n)), np.zeros((n, m))
    for part in uncoupled(state):
        size = part.shape[1]
        joint = np.zeros((len(part), size + m, size + m))
        joint[:, :size, :size] = time_step * balanced[part[:, :, None], part[:, None]]
        joint[:, :size, size:] = (time_step * inputs / scale[:, None])[part]
        joint[:, size:, size:] = generator
        result = scipy.linalg.expm(joint)[:, :size]
        phi[part[:, :, None], part[:, None]] = result[..., :size]
        driven[part] = result[..., size:]
    return scale[:, None] * phi / scale, scale[:, None] * driven


def balanced_states(state: Array) -> tuple[Array, Array]:
    """Return A (n, n) in units of its states that make its rows as large as its columns, and these units, (n,)."""
    if not len(state):  # SciPy before 1.14 does not accept empty matrices.
        return state, np.zeros(0)
    # A state that is not moved by others, or moves no others, cannot be balanced: its small own rate must not be used.
    guide, rates = np.array(state), np.diag(state)
    rows, columns = (np.linalg.norm(state - np.diag(rates), axis=axis) for axis in (1, 0))
    lone = (rows == 0) | (columns == 0)
    np.fill_diagonal(guide, np.where(lone, np.maximum(np.abs(rates), rows + columns), rates))
    with np.errstate(invalid="ignore"):  # SciPy also casts the units, which may be large, to unused indices.
        _, (scale, _) = scipy.linalg.matrix_balance(guide, permute=False, separate=True)
    return state * scale / scale[:, None], scale


def balanced_system(state: Array, inputs: Array, outputs: Array) -> tuple[Array, Array, Array]:
    """Return A (n, n), B (n, m) and C (p, n) in balanced states, see `balanced_states`."""
    balanced, scale = balanced_states(state)
    return balanced, inputs / scale[:, None], outputs * scale


def comparable_states(state: Array, inputs: Array, outputs: Array) -> tuple[Array, Array]:
    """Return A (n, n) in balanced states whose parts are comparable, and the units of these states, (n,).

    Balancing leaves open how large parts are that are not coupled, such as modes, or in one direction only, such as a
    controller behind a plant. Each part is scaled so that what drives it is as large as what it drives: other parts,
    inputs and outputs.

    Args:
        state: A, (n, n).
        inputs: B, (n, inputs).
        outputs: C, (outputs, n).
    """
    balanced, scale = balanced_states(state)
    if not len(state):
        return balanced, scale
    n, part = scipy.sparse.csgraph.connected_components(scipy.sparse.csr_matrix(balanced != 0), connection="strong")
    of = np.eye(n)[:, part]
    powers = np.zeros((n + 1, n + 1))
    powers[:n, :n] = of @ balanced**2 @ of.T
    powers[:n, n] = of @ ((inputs / scale[:, None]) ** 2).sum(axis=1)
    powers[n, :n] = of @ ((outputs * scale) ** 2).sum(axis=0)
    np.fill_diagonal(powers, 0.0)
    units = balanced_states(np.sqrt(powers))[1]
    scale = scale * (units[:n] / units[n])[part]
    return state * scale / scale[:, None], scale


def sizes_without_units(loop: Array) -> Array:
    """Return the singular values of a balanced matrix from signals to the same signals, the largest first, (n,).

    Balancing takes the units of the signals out: in metres and newtons, entries of any size leave a loop regular.

    Args:
        loop: real or complex, (n, n).
    """
    return np.linalg.svd(scipy.linalg.matrix_balance(loop, permute=False)[0], compute_uv=False)


def quasi_static(state: Array, inputs: Array, fast: Array) -> tuple[Array, Array, Array, Array]:
    """Replace the dynamics of some states of dx/dt = A x + B u by their equilibrium with all else.

    The response to constant inputs does not change. At a frequency f, the contribution of a mode at f_m with damping
    ratio zeta has a relative error of (f / f_m)^2 in magnitude and an error of 2 zeta f / f_m in phase.

    Args:
        state: A, (n, n).
        inputs: B, (n, m).
        fast: which states become quasi-static, bool, (n,).

    Returns:
        A' (k, k) and B' (k, m) of the other states x', and X (n, k) and U (n, m) of all states x = X x' + U u.

    Source: residual flexibility: R. H. MacNeal, A hybrid method of component mode synthesis, Computers & Structures 1
        (1971) 581-601; general states: P. Kokotovic, H. K. Khalil, J. O'Reilly, Singular Perturbation Methods in
        Control (1986), sec. 1.2.
    """
    n, slow = len(state), np.flatnonzero(~fast)
    kept, taken = np.eye(n)[:, slow], np.zeros_like(inputs)
    if len(slow) == n:
        return state, inputs, kept, taken
    balanced, scale = balanced_states(state)
    by_others = np.hstack([balanced[np.ix_(fast, slow)] / scale[slow], inputs[fast] / scale[fast, None]])
    followed_by = -scale[fast, None] * np.linalg.solve(balanced[np.ix_(fast, fast)], by_others)
    kept[fast], taken[fast] = np.split(followed_by, [len(slow)], axis=1)
    return state[slow] @ kept, inputs[slow] + state[slow] @ taken, kept, taken


def settling_response(system: StateSpace, settling: Array) -> StateSpace:
    """Add outputs that settle to the inputs between samples to a sampled system.

    Where the system has direct feedthrough, the settled response is added to it without delay. Elsewhere its weights
    are 3/2 for the value that an input had until the sample and -1/2 for the value before. These weights of the
    second-order rule of Adams and Bashforth are right in magnitude and delay for a mode that rings through several
    samples, at frequencies far below the sample rate: like every response to a held input, it is half a sample late.
    Both values of each such input are additional states, the last ones.

    Args:
        system: sampled system.
        settling: static response to a constant input, (outputs, inputs).

    Returns:
        Sampled system with the additional states.
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
        d + settling - late,
    )


def tustin(system: StateSpace, time_step: float, *, prewarp: float = 0.0) -> StateSpace:
    """Sample a continuous system by Tustin's rule, s = 2/T (z - 1)/(z + 1).

    Args:
        system: continuous system.
        time_step: T [s].
        prewarp: angular frequency below pi/T at which both frequency responses agree exactly; 0 for no prewarping
            [rad/s].

    Returns:
        Sampled system with the same number of states.

    Raises:
        ValueError: for a pole at s = 2/T, which the rule maps to infinity, for matrices whose shapes do not agree, for
            a time step that is not positive, and for prewarping at pi/T or above.

    Source: K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 3rd ed. (1997), sec. 8.2.
    """
    a, b, c, d = checked_system(system)
    time_step, prewarp = positive("time_step", time_step, "s"), not_negative("prewarp", prewarp, "rad/s")
    if prewarp >= np.pi / time_step:
        raise ValueError(f"prewarp must lie below pi / time step, {np.pi / time_step:g} rad/s, got {prewarp:g} rad/s")
    half = np.tan(prewarp * time_step / 2) / prewarp if prewarp else time_step / 2
    eye = np.eye(len(a))
    inverse = _inverse(
        eye - half * a, "Tustin's rule has no answer for a pole at 2 / time step; change the sample rate"
    )
    return inverse @ (eye + half * a), 2 * half * inverse @ b, c @ inverse, d + half * c @ inverse @ b


def inverse_tustin(system: StateSpace, time_step: float) -> StateSpace:
    """Return the continuous system that Tustin's rule without prewarping samples to a given system.

    Args:
        system: sampled system.
        time_step: [s].

    Raises:
        ValueError: for a pole at z = -1, which has no continuous equivalent, and in the cases of `tustin`.
    """
    a, b, c, d = checked_system(system)
    time_step = positive("time_step", time_step, "s")
    eye = np.eye(len(a))
    inverse = _inverse(eye + a, "a pole at z = -1 has no continuous equivalent; model the loop sampled")
    return 2 / time_step * (a - eye) @ inverse, 2 / time_step * inverse @ b, 2 * c @ inverse, d - c @ inverse @ b


def cascade(first: StateSpace, second: StateSpace) -> StateSpace:
    """Connect two systems in series: outputs of the first are inputs of the second; states of the first come first.

    Args:
        first: system with the inputs of the result.
        second: system with the outputs of the result.

    Returns:
        System with the states of both.

    Raises:
        ValueError: for matrices whose shapes do not agree, and for another number of outputs of the first system than
            inputs of the second.
    """
    a1, b1, c1, d1 = checked_system(first)
    a2, b2, c2, d2 = checked_system(second)
    if len(d1) != d2.shape[1]:
        raise ValueError(f"{len(d1)} output(s) of the first system cannot be {d2.shape[1]} input(s) of the second")
    state = np.block([[a1, np.zeros((len(a1), len(a2)))], [b2 @ c1, a2]])
    return state, np.vstack([b1, b2 @ d1]), np.hstack([d2 @ c1, c2]), d2 @ d1


def combine_steps(first: StateSpace, second: StateSpace) -> StateSpace:
    """Combine the steps of two sampled systems with the same states into one step.

    The inputs and outputs of the result are those of the first system, then those of the second.

    Args:
        first: system of the first step.
        second: system of the second step.

    Returns:
        System of both steps.
    """
    a1, b1, c1, d1 = first
    a2, b2, c2, d2 = second
    feedthrough = np.block([[d1, np.zeros((len(d1), len(b2.T)))], [c2 @ b1, d2]])
    return a2 @ a1, np.hstack([a2 @ b1, b2]), np.vstack([c1, c2 @ a1]), feedthrough


def repeat_step(system: StateSpace, times: int) -> StateSpace:
    """Combine several steps of a sampled system into one, with the inputs and outputs of all samples in order.

    Args:
        system: system of one step.
        times: number of steps.

    Returns:
        System of all steps.
    """
    if times == 1:
        return system
    half = repeat_step(system, times // 2)
    twice = combine_steps(half, half)
    return combine_steps(twice, system) if times % 2 else twice


def transmission_zeros(system: StateSpace) -> Array:
    """Compute the finite invariant zeros of a system with as many outputs as inputs.

    At a zero the system matrix [[A - s, B], [C, D]] loses rank: a motion continues, driven or not, that no output
    shows. The result includes poles that the inputs do not move or the outputs do not show. Zeros at infinity are
    removed by rank decisions before the eigenvalues are computed; couplings below 2e-12 of the largest count as
    rounding.

    Args:
        system: continuous or sampled system.

    Returns:
        Zeros, complex, (n,) [rad/s], or points in the z-plane.

    Raises:
        ValueError: for different numbers of outputs and inputs, where every s would be a zero, and for matrices whose
            shapes do not agree.

    Source: A. Emami-Naeini, P. Van Dooren, Computation of zeros of linear multivariable systems, Automatica 18 (1982)
        415-430.
    """
    system = checked_system(system)
    n_out, n_in = system[3].shape
    if n_out != n_in:
        raise ValueError(f"zeros need as many outputs as inputs, got {n_out} and {n_in}; choose some of them")
    (a, b, c, d), size = _scaled(system) if len(system[0]) else (system, 1.0)
    while True:
        left, values, _ = np.linalg.svd(d)
        rank = int(np.sum(values > RANK_TOLERANCE))
        if rank == len(d):
            break
        # Outputs without feedthrough stay zero if the states and their rates stay in the null space of these outputs.
        blind = left[:, rank:].T @ c
        if len(blind) > len(a) or np.linalg.svd(blind, compute_uv=False)[-1] < RANK_TOLERANCE:
            raise ValueError(
                "every s is a zero: some input moves no output, or outputs depend on each other; leave it out"
            )
        basis = scipy.linalg.qr(blind.T)[0]
        seen, unseen = basis[:, : len(blind)].T, basis[:, len(blind) :]
        shown = left[:, :rank].T
        c, d = np.vstack([shown @ c, seen @ a]) @ unseen, np.vstack([shown @ d, seen @ b])
        a, b = unseen.T @ a @ unseen, unseen.T @ b
    # States and inputs that no output shows, and the rates of these states.
    motions = scipy.linalg.qr(np.hstack([c, d]).T)[0][:, len(d) :]
    states, rates = motions[: len(a)], np.hstack([a, b]) @ motions
    if not rates.size:
        return np.zeros(0, complex)
    return size * scipy.linalg.eigvals(rates, states).astype(complex)


def _scaled(system: StateSpace) -> tuple[StateSpace, float]:
    """Return a system with the same zeros up to a factor and with entries near 1 in any units; and that factor."""
    a, b, c, d = system
    a, scale = comparable_states(a, b, c)
    b, c = b / scale[:, None], c * scale
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
    if len(matrix):
        sizes = sizes_without_units(matrix)
        if sizes[-1] <= EPSILON * sizes[0]:
            raise ValueError(message)
    return np.linalg.inv(matrix)
