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
from nassim.simulation.model.constraints import Constraints
from nassim.simulation.model.modal_model import ModalModel, Structure

SUM_ROUNDING = 1e-9
"""Share of the sum of a sum's absolute terms below which the sum is rounding."""
MODE_ROUNDING = 1e-12
"""Share of the size of a row, a force or a motion below which its part in a mode is rounding."""


@dataclass(frozen=True)
class PrescribedMotions:
    """Effect of d drives that follow inputs on a scene.

    Attributes:
        inputs: index of each drive's input, (d,).
        rates: rate of each drive's servo, a low-pass of first order, (d,) [1/s]; infinite without a servo.
        motion: F, motion of all coordinates per unit of the drives' motion, (n_all, d).
        momentum: P, in the modes' amplitudes, (n, d).
        damping: R, in the modes' amplitudes, (n, d).
        residual: F - X P, motion of all coordinates that no mode has, (n_all, d), exactly 0 where it is rounding.
    """

    inputs: tuple[int, ...]
    rates: tuple[float, ...]
    motion: Array
    momentum: Array
    damping: Array
    residual: Array

    @classmethod
    def none(cls, n_all: int, n: int) -> "PrescribedMotions":
        """Make the effect of no drives."""
        return cls((), (), np.zeros((n_all, 0)), np.zeros((n, 0)), np.zeros((n, 0)), np.zeros((n_all, 0)))

    @classmethod
    def of(cls, constraints: Constraints, structure: Structure, modal: ModalModel) -> "PrescribedMotions":
        """Find the effect of a scene's drives that follow inputs."""
        coordinates, modes = constraints.coordinates, modal.modes
        scene, scale = coordinates.scene, coordinates.scale[:, None]
        motion = _quasi_static_motion(constraints, structure, modal)
        forces, size = structure.damping_forces(motion), np.linalg.norm(scale * motion, axis=0)
        momentum = cleared(modes.T @ coordinates.mass @ motion, size)
        damping = cleared(modes.T @ forces, np.linalg.norm(forces / scale, axis=0))
        residual = product(np.hstack([np.eye(len(modes)), -modes]), np.vstack([motion, momentum]))
        return cls(
            tuple(scene.inputs.index(drive.input) for drive in scene.prescribed),
            tuple(2 * np.pi * drive.bandwidth for drive in scene.prescribed),
            motion,
            momentum,
            damping,
            cleared(residual, size / scale),
        )

    def chosen(self, kept: Sequence[int]) -> "PrescribedMotions":
        """Return those of some drives, by their indices; the others stay at rest."""
        columns = (part[:, kept] for part in (self.motion, self.momentum, self.damping, self.residual))
        return PrescribedMotions(tuple(self.inputs[k] for k in kept), tuple(self.rates[k] for k in kept), *columns)

    @property
    def servos(self) -> tuple[int, ...]:
        """Indices of the drives with a servo, whose outputs are the last states."""
        return tuple(k for k, rate in enumerate(self.rates) if np.isfinite(rate))

    def by_states(self, n_states: int) -> Array:
        """Return the motion of the drives per unit of a model's states, (d, n_states)."""
        result = np.zeros((len(self.inputs), n_states))
        result[list(self.servos), n_states - len(self.servos) :] = np.eye(len(self.servos))
        return result

    def by_inputs(self, n_inputs: int) -> Array:
        """Return the motion of the drives per unit of a scene's inputs, (d, n_inputs)."""
        result = np.zeros((len(self.inputs), n_inputs))
        for k, (index, rate) in enumerate(zip(self.inputs, self.rates, strict=True)):
            result[k, index] = not np.isfinite(rate)
        return result


def _quasi_static_motion(constraints: Constraints, structure: Structure, modal: ModalModel) -> Array:
    """Return the quasi-static motion F, (n_all, d), which satisfies the constraints: rows @ F = driven."""
    driven, mass, strain = constraints.driven, constraints.coordinates.mass, structure.strain
    if not driven.shape[1]:
        return np.zeros((len(mass), 0))
    scale = 1.0 / constraints.coordinates.scale
    sizes = np.linalg.norm(constraints.rows * scale, axis=1, keepdims=True)
    rows = constraints.rows * scale / sizes
    result: Array = scale[:, None] * np.linalg.lstsq(rows, driven / sizes, rcond=SUM_ROUNDING)[0]
    free, elastic = modal.modes[:, modal.rigid_modes], modal.modes[:, ~modal.rigid_modes]
    strained = (strain.root @ elastic).T / modal.omega[~modal.rigid_modes, None] ** 2
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
