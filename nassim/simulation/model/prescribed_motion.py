"""Drives that follow inputs, in small motion: what they make of a scene, without any derivative of the inputs.

With X the modes of the scene whose drives hold still (of unit modal mass, frequencies w, damping C) and F the motion of
all coordinates per unit of a drive's motion u, all coordinates move by X p + F u, and

    p'' + C p' + w^2 p = X^T f - P u'' - R u',    P = X^T M F,    R = X^T C F.

F is the quasi-static following: X^T K F = 0; what nothing holds elastically keeps its momentum. As states serve

    a = p + P u,  b = a' - G u  with  G = C P - R:    a' = b + G u,    b' = X^T f - w^2 a - C b + (w^2 P - C G) u.

Displacements are X a + (F - X P) u; a velocity holds u' where the last does not vanish: of what has no mode of its own.

Damping by the ratios of modes is that of strain beside the quasi-static following: X^T C F = 0 of it, as of a damping
in proportion to the stiffness. So rigid following is not damped, and floating frames are damped alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array
from nassim.bodies.strain import Strain

ROUNDING = 1e-9
"""Share of what a sum's terms could add up to that is rounding."""
LEFT = 1e-12
"""Share of a row's, a force's or a motion's own size that rounding of modes leaves of what it has no part in."""


@dataclass(frozen=True)
class PrescribedMotions:
    """What d drives that follow inputs do in an assembly.

    inputs: index of each one's input; rates: of its servo, a low-pass of first order [1/s], infinite without
    motion: F, of all coordinates per unit of the drives', (n_all, d)
    momentum: P, (n, d); drag: R, (n, d), both in the modes' amplitudes
    beyond: F - X P, (n_all, d), exactly 0 where it is rounding
    """

    inputs: tuple[int, ...]
    rates: tuple[float, ...]
    motion: Array
    momentum: Array
    drag: Array
    beyond: Array

    @classmethod
    def none(cls, n_all: int, n: int) -> "PrescribedMotions":
        """Without drives."""
        return cls((), (), np.zeros((n_all, 0)), np.zeros((n, 0)), np.zeros((n, 0)), np.zeros((n_all, 0)))

    @property
    def lags(self) -> tuple[int, ...]:
        """Which drives have a servo with a rate, whose outputs are the last states."""
        return tuple(k for k, rate in enumerate(self.rates) if np.isfinite(rate))

    def lagging(self, n_states: int) -> Array:
        """Motion of the drives per unit of a model's states, (d, n_states)."""
        result = np.zeros((len(self.inputs), n_states))
        result[list(self.lags), n_states - len(self.lags) :] = np.eye(len(self.lags))
        return result

    def taken(self, n_inputs: int) -> Array:
        """Motion of the drives per unit of a scene's inputs, (d, n_inputs)."""
        result = np.zeros((len(self.inputs), n_inputs))
        for k, (index, rate) in enumerate(zip(self.inputs, self.rates, strict=True)):
            result[k, index] = not np.isfinite(rate)
        return result


def prescribed_motion_of(held: Array, moved: Array, modes: Array, omega: Array, strain: Strain, mass: Array) -> Array:
    """The quasi-static following F, (n_all, d), with held @ F = moved.

    held: rows of all constraints, (m, n_all); moved: what they are per unit of the drives' motions, (m, d)
    modes: X, (n_all, n), of frequencies omega, (n,) [rad/s]; strain, mass: in all coordinates
    """
    if not moved.shape[1]:
        return np.zeros((len(mass), 0))
    scale = 1.0 / np.sqrt(np.diag(mass))
    sizes = np.linalg.norm(held * scale, axis=1, keepdims=True)
    rows = held * scale / sizes
    result: Array = scale[:, None] * np.linalg.lstsq(rows, moved / sizes, rcond=ROUNDING)[0]
    free, elastic = modes[:, omega == 0], modes[:, omega > 0]
    strained = (strain.root @ elastic).T / omega[omega > 0, None] ** 2
    for _ in range(2):  # twice is enough to the last digit
        result = result - free @ (free.T @ (mass @ result)) - elastic @ (strained @ (strain.root @ result))
    return cleared(result, scale[:, None] * np.linalg.norm(result / scale[:, None], axis=0))


def cleared(values: Array, sizes: Array) -> Array:
    """Values, exactly 0 where they are rounding of what is of these sizes.

    By sizes of rows and forces, in which metres and radians compare, |row / s| with s the roots of all coordinates'
    masses: no mode of unit modal mass has more of it. Of motions, likewise, |s motion|.
    """
    return np.where(np.abs(values) > LEFT * sizes, values, 0.0)


def product(a: Array, b: Array) -> Array:
    """The product a @ b, exactly 0 where it is nothing but rounding."""
    result: Array = a @ b
    return np.where(np.abs(result) > ROUNDING * (np.abs(a) @ np.abs(b)), result, 0.0)


def follow(
    inputs: Sequence[int], rates: Sequence[float], motion: Array, modes: Array, mass: Array, dragged: Array
) -> PrescribedMotions:
    """What drives do by their motion F, (n_all, d), in an assembly of modes X, (n_all, n).

    mass: in all coordinates; dragged: forces of dampers on all coordinates per unit rate of the drives, (n_all, d)
    """
    scale = np.sqrt(np.diag(mass))[:, None]
    size = np.linalg.norm(scale * motion, axis=0)
    momentum = cleared(modes.T @ mass @ motion, size)
    drag = cleared(modes.T @ dragged, np.linalg.norm(dragged / scale, axis=0))
    beyond = cleared(product(np.hstack([np.eye(len(mass)), -modes]), np.vstack([motion, momentum])), size / scale)
    return PrescribedMotions(tuple(inputs), tuple(rates), motion, momentum, drag, beyond)
