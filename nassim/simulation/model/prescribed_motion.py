"""Prescribed motion in small motion: the effect of drives that follow inputs, without any derivative of the inputs.

With X the modes of the scene with its drives at rest (unit modal mass, frequencies w, damping C) and F the motion of
all coordinates per unit of a drive's motion u, all coordinates move by X p + F u, and

    p'' + C p' + w^2 p = X^T f - P u'' - R u',    P = X^T M F,    R = X^T C F.

F is the quasi-static motion: X^T K F = 0; coordinates without elastic support keep their momentum. The states are

    a = p + P u,  b = a' - G u  with  G = C P - R:    a' = b + G u,    b' = X^T f - w^2 a - C b + (w^2 P - C G) u.

Displacements are X a + (F - X P) u. A velocity contains u' where F - X P does not vanish: for motion without a mode of
its own.

Modal damping acts on the strain relative to the quasi-static motion, for which X^T C F = 0, as for a damping
proportional to the stiffness. Rigid-body motion with a drive is therefore undamped, as in floating frames.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array
from nassim.bodies.strain import Strain

SUM_ROUNDING = 1e-9
"""Share of the sum of a sum's absolute terms below which the sum is rounding."""
MODE_ROUNDING = 1e-12
"""Share of the size of a row, a force or a motion below which its part in a mode is rounding."""


@dataclass(frozen=True)
class PrescribedMotions:
    """Effect of d drives that follow inputs on an assembly.

    Attributes:
        inputs: index of each drive's input, (d,).
        rates: rate of each drive's servo, a low-pass of first order, (d,) [1/s]; infinite without a servo.
        motion: F, motion of all coordinates per unit of the drives' motion, (n_all, d).
        momentum: P, in the modes' amplitudes, (n, d).
        drag: R, in the modes' amplitudes, (n, d).
        beyond: F - X P, (n_all, d), exactly 0 where it is rounding.
    """

    inputs: tuple[int, ...]
    rates: tuple[float, ...]
    motion: Array
    momentum: Array
    drag: Array
    beyond: Array

    @classmethod
    def none(cls, n_all: int, n: int) -> "PrescribedMotions":
        """Make the effect of no drives."""
        return cls((), (), np.zeros((n_all, 0)), np.zeros((n, 0)), np.zeros((n, 0)), np.zeros((n_all, 0)))

    @property
    def lags(self) -> tuple[int, ...]:
        """Indices of the drives with a servo, whose outputs are the last states."""
        return tuple(k for k, rate in enumerate(self.rates) if np.isfinite(rate))

    def lagging(self, n_states: int) -> Array:
        """Return the motion of the drives per unit of a model's states, (d, n_states)."""
        result = np.zeros((len(self.inputs), n_states))
        result[list(self.lags), n_states - len(self.lags) :] = np.eye(len(self.lags))
        return result

    def taken(self, n_inputs: int) -> Array:
        """Return the motion of the drives per unit of a scene's inputs, (d, n_inputs)."""
        result = np.zeros((len(self.inputs), n_inputs))
        for k, (index, rate) in enumerate(zip(self.inputs, self.rates, strict=True)):
            result[k, index] = not np.isfinite(rate)
        return result


def prescribed_motion_of(held: Array, moved: Array, modes: Array, omega: Array, strain: Strain, mass: Array) -> Array:
    """Compute the quasi-static motion F with held @ F = moved.

    Args:
        held: rows of all constraints, (m, n_all).
        moved: their values per unit of the drives' motions, (m, d).
        modes: modes X, (n_all, n).
        omega: angular frequencies of the modes, (n,) [rad/s].
        strain: strains, in all coordinates.
        mass: mass matrix in all coordinates, (n_all, n_all).

    Returns:
        F, (n_all, d).
    """
    if not moved.shape[1]:
        return np.zeros((len(mass), 0))
    scale = 1.0 / np.sqrt(np.diag(mass))
    sizes = np.linalg.norm(held * scale, axis=1, keepdims=True)
    rows = held * scale / sizes
    result: Array = scale[:, None] * np.linalg.lstsq(rows, moved / sizes, rcond=SUM_ROUNDING)[0]
    free, elastic = modes[:, omega == 0], modes[:, omega > 0]
    strained = (strain.root @ elastic).T / omega[omega > 0, None] ** 2
    for _ in range(2):  # two passes orthogonalise to the last digit
        result = result - free @ (free.T @ (mass @ result)) - elastic @ (strained @ (strain.root @ result))
    return cleared(result, scale[:, None] * np.linalg.norm(result / scale[:, None], axis=0))


def cleared(values: Array, sizes: Array) -> Array:
    """Set values to exactly 0 where they are rounding of quantities of given sizes.

    The sizes of rows and forces, in which metres and radians compare, are |row / s| with s the square roots of all
    coordinates' masses: no mode of unit modal mass has a larger part. The sizes of motions are |s motion|.
    """
    return np.where(np.abs(values) > MODE_ROUNDING * sizes, values, 0.0)


def product(a: Array, b: Array) -> Array:
    """Multiply a @ b, exactly 0 where the result is rounding."""
    result: Array = a @ b
    return np.where(np.abs(result) > SUM_ROUNDING * (np.abs(a) @ np.abs(b)), result, 0.0)


def prescribed_motions(
    inputs: Sequence[int], rates: Sequence[float], motion: Array, modes: Array, mass: Array, dragged: Array
) -> PrescribedMotions:
    """Make the effect of drives from their motion F, (n_all, d), in an assembly of modes X, (n_all, n).

    Args:
        inputs: index of each drive's input.
        rates: rate of each drive's servo [1/s].
        motion: F, (n_all, d).
        modes: X, (n_all, n).
        mass: mass matrix in all coordinates, (n_all, n_all).
        dragged: forces of dampers on all coordinates per unit rate of the drives, (n_all, d).

    Returns:
        The effect of the drives.
    """
    scale = np.sqrt(np.diag(mass))[:, None]
    size = np.linalg.norm(scale * motion, axis=0)
    momentum = cleared(modes.T @ mass @ motion, size)
    drag = cleared(modes.T @ dragged, np.linalg.norm(dragged / scale, axis=0))
    beyond = cleared(product(np.hstack([np.eye(len(mass)), -modes]), np.vstack([motion, momentum])), size / scale)
    return PrescribedMotions(tuple(inputs), tuple(rates), motion, momentum, drag, beyond)
