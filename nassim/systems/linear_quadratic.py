"""Linear-quadratic-Gaussian control."""

from collections.abc import Mapping

import numpy as np
import scipy

from nassim.base.checks import Array, known, positive
from nassim.systems.linear_model import LinearModel
from nassim.systems.riccati import check_continuous, check_regular, regulator, scaled


def lqg(
    model: LinearModel,
    *,
    acceptable: Mapping[str, float],
    effort: Mapping[str, float],
    disturbances: Mapping[str, float],
    noise: Mapping[str, float],
    integral: Mapping[str, float] | None = None,
) -> LinearModel:
    """Compute the linear-quadratic-Gaussian controller, u = -K x of an optimal estimate of the state.

    It minimises the mean of the sum of (y / acceptable)^2, (u / effort)^2 and (integral of y dt / integral)^2 (Bryson's
    rule for weights).

    Args:
        model: continuous model.
        acceptable: size of each output that shall be small, in its unit.
        effort: size of each input that the controller drives, in its unit.
        disturbances: density of a white disturbance at each input that has one, one-sided [unit/sqrt(Hz)].
        noise: density of the sensor's white noise of each output that the controller reads, one-sided [unit/sqrt(Hz)].
        integral: size of the integral of each measured output whose offset the controller shall remove
            [unit s]; None for none.

    Returns:
        Controller u = K y from the outputs of `noise` to the inputs of `effort`.

    Raises:
        ValueError: for unknown names, sizes that are not positive, a sampled model, and a model with growing or
            undamped motions that the inputs do not move, the outputs do not show or the disturbances do not reach.

    Source: S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2nd ed. (2005), sec. 9.2.
    """
    check_continuous(model)
    rows, q = _weights("output", acceptable, model.outputs)
    columns, r = _weights("input", effort, model.inputs)
    pushed, w = _weights("input", disturbances, model.inputs)
    seen, v = _weights("output", noise, model.outputs)
    kept, qi = _weights("output", integral or {}, model.outputs)
    if unread := [model.outputs[k] for k in kept if k not in seen]:
        raise ValueError(f"the controller does not read {', '.join(unread)} and cannot integrate it; give its noise")
    if not (rows and columns and pushed and seen):
        raise ValueError("acceptable, effort, disturbances and noise need at least one signal each")
    # All signals are over their sizes, so that the noises and the effort have weight 1.
    outputs, inputs = [*rows, *kept, *seen], [*columns, *pushed]
    heights, widths = np.concatenate([q, qi, v]), np.concatenate([r, w])
    rate, a, b, c = scaled(model.A, model.B[:, inputs] * widths, model.C[outputs] / heights[:, None])
    d = model.D[np.ix_(outputs, inputs)] * widths / heights[:, None]
    n, m, nu, ny = len(a), len(kept), len(columns), len(seen)
    (b2, b1), d21 = np.hsplit(b, [nu]), d[-ny:, nu:]
    (cz, ci, cy), (dz, di, dy) = (np.split(part, [len(rows), len(rows) + m]) for part in (c, d[:, :nu]))
    # The integrals are states too: rate times the integral of y dt / integral, in scaled time.
    state, drive = np.block([[a, np.zeros((n, m))], [ci, np.zeros((m, m))]]), np.vstack([b2, di])
    costs = (
        scipy.linalg.block_diag(cz, np.eye(m) / rate, np.zeros((nu, 0))),
        np.vstack([dz, np.zeros((m, nu)), np.eye(nu)]),
    )
    noises = np.vstack([b1.T, np.zeros((ny, n))]), np.vstack([d21.T, np.eye(ny)])
    gain = _optimal_gain(state, drive, *costs, "driven inputs", "outputs to be small")
    observer = _optimal_gain(a.T, cy.T, *noises, "measured outputs", "disturbances").T
    of_state, of_integrals = gain[:, :n], gain[:, n:]
    corrected = b2 - observer @ dy
    integrated = np.zeros((m, ny))
    read = [seen.index(k) for k in kept]
    integrated[range(m), read] = v[read] / qi
    estimated = a - observer @ cy - corrected @ of_state
    return LinearModel(
        rate * np.block([[estimated, -corrected @ of_integrals], [np.zeros((m, n + m))]]),
        rate * np.vstack([observer, integrated]) / v,
        -r[:, None] * gain,
        np.zeros((nu, ny)),
        tuple(model.outputs[k] for k in seen),
        tuple(model.inputs[k] for k in columns),
    )


def _optimal_gain(a: Array, b: Array, c: Array, d: Array, movers: str, seers: str) -> Array:
    """Return the gain K of the control u = -K x that minimises the integral of |c x + d u|^2; names: for messages."""
    check_regular(a, b, c, d, movers, seers)
    x = regulator(a, b, c, d)
    return np.linalg.solve(d.T @ d, b.T @ x + d.T @ c)


def _weights(kind: str, sizes: Mapping[str, float], allowed: tuple[str, ...]) -> tuple[list[int], Array]:
    for name, size in sizes.items():
        positive(f"{kind} {name!r}", size)
    return [allowed.index(known(kind, name, allowed)) for name in sizes], np.array(list(sizes.values()), dtype=float)
