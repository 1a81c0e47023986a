"""How the modes of a model follow its change along a path, to first order: passing to the next one excites none."""

import numpy as np

from nassim.base.checks import Array


def path_changes(system: tuple[Array, Array], slopes: tuple[Array, Array], n: int, duration: float) -> Array:
    """Compute the derivative, with respect to the angle, of the states of a scene that changes beside those of a model.

    A scene changes evenly along a path, its models in steps of a duration T. A mode far above the motion follows
    inputs and slower modes. Where a step moves the place to which it follows, the mode rings about that in models and
    does not in the scene. Along modes of the model with angular frequencies w_i, let K' be the slope of the stiffness,
    q the displacements, e those in equilibrium with the inputs, and f' the slope of the forces on modes that stay at
    e. To first order, per radian, the scene has beside the model

        d q_i = f'_i s(w_i) / w_i - sum_j K'_ij [s(w_i - w_j) + s(w_i + w_j)] (q_j - e_j) / (2 w_i)
        d q_i' = - sum_j K'_ij [s(w_i - w_j) - s(w_i + w_j)] q_j' / (2 w_j)
        s(v) = [1 - sin(v T / 2) / (v T / 2)] / v

    Without the sine, this is the change of the equilibrium and of the modes' directions. With it, modes whose phases
    differ by little within T keep their states.

    Args:
        system: A (N, N) and B (N, m) of the model, see `state_space`.
        slopes: their derivatives with respect to the angle [1/rad].
        n: number of modes; their amplitudes and rates are the first states.
        duration: time between models [s].

    Returns:
        Derivatives of the states per unit of the states and of the inputs, (N, N + m) [1/rad].
    """
    place, rate, others = slice(n), slice(n, 2 * n), slice(2 * n, None)
    force, slope = (np.hstack([by_states[rate], by_inputs[rate]]) for by_states, by_inputs in (system, slopes))
    square, modes = np.linalg.eigh(-0.5 * (force[:, place] + force[:, place].T))
    omega = np.sqrt(np.maximum(np.abs(square), np.finfo(float).tiny))  # a spin may soften some beyond zero
    apart, together = (_separation(omega[:, None] + sign * omega, duration) for sign in (-1.0, 1.0))
    turned = modes.T @ slope[:, place] @ modes
    moved = modes @ ((apart + together) / (2 * omega[:, None]) * turned) @ modes.T
    at_rest = -np.linalg.solve(force[:, place], force[:, others])
    pushed = modes.T @ (slope[:, place] @ at_rest + slope[:, others])
    result = np.zeros((len(system[0]), force.shape[1]))
    result[place, place] = moved
    result[rate, rate] = modes @ ((apart - together) / (2 * omega) * turned) @ modes.T
    result[place, others] = modes @ ((_separation(omega, duration) / omega)[:, None] * pushed) - moved @ at_rest
    return result


def _separation(rate: Array, duration: float) -> Array:
    """Return s(v) of `path_changes` at angular frequencies v [rad/s]."""
    return np.divide(1 - np.sinc(rate * duration / (2 * np.pi)), rate, out=np.zeros_like(rate), where=rate != 0)
