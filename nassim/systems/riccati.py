"""Riccati equations of optimal controllers, the scaling of their models, and checks that they have a solution."""

import math

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.systems.linear_model import LinearModel
from nassim.systems.state_space import balanced_system

RANK = 1e-9
"""Singular values below this fraction of the largest count as zero in the checks of a plant."""


def care(a: Array, b: Array, q: Array, r: Array, s: Array) -> Array | None:
    """Return the stabilising solution of a'x + x a - (x b + s) r^-1 (b'x + s') + q = 0, or None without one."""
    if not len(a):
        return np.zeros((0, 0))
    for balanced in (True, False):  # either way, rounding spoils the order of the eigenvalues now and then
        try:
            with np.errstate(invalid="ignore"):  # SciPy casts the units of balancing, which may be large, to indices
                return np.asarray(scipy.linalg.solve_continuous_are(a, b, q, r, s=s, balanced=balanced))
        except np.linalg.LinAlgError:
            return None
        except ValueError:
            continue
    return None


def regulator(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return the stabilising solution of the Riccati equation of a quadratic cost |c x + d u|^2.

    Raises:
        ValueError: where rounding leaves none.
    """
    found = care(a, b, c.T @ c, d.T @ d, c.T @ d)
    if found is None:
        raise ValueError(
            "the Riccati equation has no solution within rounding: scale the signals, or change the weights"
        )
    return found


def scaled(a: Array, b: Array, c: Array) -> tuple[float, Array, Array, Array]:
    """Return a rate [rad/s], and the matrices in states that are balanced and in time that is scaled by this rate."""
    balanced, b, c = balanced_system(a, b, c)
    sizes = np.abs(np.linalg.eigvals(balanced))
    rate = float(np.exp(np.log(sizes[sizes > 0]).mean())) if sizes.any() else 1.0
    enters, leaves = np.linalg.norm(b) / rate, np.linalg.norm(c)
    factor = math.sqrt(leaves / enters) if enters and leaves else 1.0
    return rate, balanced / rate, factor * b / rate, c / factor


def check_continuous(model: LinearModel) -> None:
    """Raise ValueError for a sampled model."""
    if model.time_step is not None:
        raise ValueError(f"synthesis needs a continuous model, got one sampled every {model.time_step:g} s")


def check_regular(a: Array, b: Array, c: Array, d: Array, movers: str, seers: str) -> None:
    """Raise ValueError for motions that movers cannot stabilise, and for undamped ones that seers do not notice.

    The second are the invariant zeros of (a, b, c, d) on the imaginary axis. d has independent columns.
    """
    through = np.linalg.pinv(d) @ c
    for state, seen, all_growing, problem in (
        (a.T, b.T, True, f"no {movers} stabilise"),
        (a - b @ through, c - d @ through, False, f"no {seers} notice"),
    ):
        own = seen / (np.linalg.norm(seen) or 1.0)  # in any units
        for s in np.linalg.eigvals(state):
            undamped = abs(s.real) <= RANK * max(1.0, abs(s))
            sizes = np.linalg.svd(np.vstack([state - s * np.eye(len(a)), own]), compute_uv=False)
            if (undamped or (all_growing and s.real > 0)) and sizes[-1] <= RANK * sizes[0]:
                motion = "a drift" if abs(s.imag) <= RANK else "an oscillation"
                raise ValueError(f"the model has {motion} that {problem}; add such a signal, or damping")
