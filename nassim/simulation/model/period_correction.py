"""Period correction: masses and dampings from which generalized-alpha makes the true periods of a scene's modes.

The rule lengthens periods: where it is the trapezoidal rule, by (2 pi h / T)^2 / 12. The error of each mode is known,
so it can be corrected. A slightly smaller modal mass gives the mode's own frequency in steps; at a spectral radius of 1
its factor is (x / tan x)^2 with x = pi h / T. A damping with 1 + tan(x)^2 times that factor gives, to first order, the
mode's own damping. Only the scene's damping ratios get it: bodies' own damping and dampers couple modes, and a slow
motion that takes fast modes along would see the factors of these. The stiffness does not change, and with it no static
result. Only the mass of deformation changes, so rigid-body motion, its momentum and its forces do not change either.

The rule's velocities and accelerations are not corrected: for a harmonic motion they are too large by the factors
tan(x) / x and its square, at the motion's own frequency.

Source: the correction prewarps mode by mode, as Tustin's rule is prewarped in K. J. Astrom, B. Wittenmark,
Computer-Controlled Systems, 3rd ed. (1997), section 8.2. For slow modes the corrected rule is that of L. Fox and
E. T. Goodwin, Proc. Camb. Phil. Soc. 45 (1949) 373-388.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.rigid_motion import skew
from nassim.bodies.floating_frames import FloatingFrame
from nassim.scene.terms import PrescribedMotion
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.coordinates import Coordinates

FASTEST = 0.9
"""Half a step's angle [rad] up to which a mode is corrected, 3.5 steps a period; faster modes get the same factor."""
TRANSFER_ROUNDS = 5
"""Iterations that transfer to bodies the correction of modes in which springs have a share."""
EQUAL_FREQUENCIES = 1e-6
"""Relative difference up to which two frequencies count as equal."""
MOST = 0.6
"""Largest share of a modal mass that the correction removes, so that masses stay positive."""

SPARED = 0.9
"""Largest share of the mass of a body's deformation in free flight that the correction removes, in every position."""

MASSLESS = 1e-12
"""Share of the largest inertia below which an inertia is rounding."""


@dataclass(frozen=True)
class Steps:
    """Steps of generalized-alpha.

    Attributes:
        time_step: time step [s].
        spectral_radius: spectral radius at infinite frequency [-], see `nassim.simulation.integrator_error`.
        corrected: whether masses and damping ratios correct the rule's period error.
    """

    time_step: float
    spectral_radius: float = 1.0
    corrected: bool = True

    @property
    def coefficients(self) -> tuple[float, float, float, float]:
        """The rule's alpha_m, alpha_f, gamma and beta."""
        rho = self.spectral_radius
        alpha_m, alpha_f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
        return alpha_m, alpha_f, 0.5 - alpha_m + alpha_f, 0.25 * (1 - alpha_m + alpha_f) ** 2

    def rates(self, path: Array) -> tuple[Array, Array]:
        """Compute the velocities and accelerations that the rule gives to a prescribed path.

        Args:
            path: values at the time steps, (n,); it starts at its first rate, without acceleration.

        Returns:
            Velocities and accelerations at the time steps, (n,) each.
        """
        alpha_m, alpha_f, gamma, beta = self.coefficients
        # The state is v and h a: h a = (change / h - v_0 - (1/2 - beta) h a_0) / beta, v = v_0 + (1 - gamma) h a_0 ...
        state = np.array([[1.0, 1 - gamma], [0.0, 0.0]]) - np.outer([gamma, 1.0], [1.0, 0.5 - beta]) / beta
        rise = np.array([gamma, 1.0]) / beta
        changes = np.diff(path) / self.time_step
        of_changes = np.column_stack([rise, (state - np.trace(state) * np.eye(2)) @ rise])
        jolts = [scipy.signal.lfilter(row, np.poly(state), changes - changes[0]) for row in of_changes]
        velocities, algorithmic = np.pad(jolts, ((0, 0), (1, 0)))
        accelerations = scipy.signal.lfilter([1 - alpha_m, alpha_m], [1 - alpha_f, alpha_f], algorithmic)
        return changes[0] + velocities, accelerations / self.time_step

    def factors(self, frequency: Array) -> tuple[Array, Array]:
        """Compute the factors of modal masses and of modal dampings at frequencies.

        The rule's equations for q = z^n with z = exp(i omega h) give M a(z) + C h b(z) + K h^2 d(z) = 0. The imaginary
        part of this equation, divided by b, gives M.

        Args:
            frequency: frequencies of modes, (n,) [Hz].

        Returns:
            Factors of the masses and of the dampings, (n,) each; 1 for rigid-body modes.
        """
        if not self.corrected:
            return np.ones(len(frequency)), np.ones(len(frequency))
        alpha_m, alpha_f, gamma, beta = self.coefficients
        x = np.clip(np.pi * frequency * self.time_step, 1e-4, FASTEST)
        z = np.exp(2j * x)
        a = ((1 - alpha_m) * z + alpha_m) / ((1 - alpha_f) * z + alpha_f)
        b = (gamma * z + 1 - gamma) / (z - 1)
        d = (b + beta * z + 0.5 - beta) / (z - 1)
        mass = np.where(frequency > 0, -((2 * x) ** 2) * (d / b).imag / (a / b).imag, 1.0)
        return mass, np.where(frequency > 0, mass * (1 + np.tan(x) ** 2), 1.0)


def small_motion_factors(assembly: Assembly, frequency: Array, steps: Steps) -> tuple[Array, Array]:
    """Compute `Steps.factors` of a scene in small motion whose modes have given frequencies, (n,) [Hz].

    They are 1 where drives follow inputs, because the inertia forces of prescribed motion are those of the true masses.
    """
    if assembly.signals.prescribed.inputs:
        return np.ones(len(frequency)), np.ones(len(frequency))
    return steps.factors(frequency)


def with_ratios_for_steps(assembly: Assembly, steps: Steps) -> Assembly:
    """Return a scene in small motion with the damping ratios that become its own in steps."""
    return _with_ratios(assembly, small_motion_factors(assembly, assembly.modal.frequency, steps)[1])


def _with_ratios(assembly: Assembly, growth: Array) -> Assembly:
    """Return an assembly whose modes have other damping ratios; growth: factor of each, (n,)."""
    damping = assembly.modal.damping
    return assembly.with_damping(replace(damping, ratio=damping.ratio * growth))


def correct_periods(assembly: Assembly, steps: Steps) -> tuple[Assembly, Array]:
    """Correct a scene's damping ratios and the mass of its bodies' deformation for its steps.

    With d_j the deformation in mode j and a_j the required reduction of its modal mass, the reduction of the mass
    matrix is the inverse of the sum of d_j d_j^T over a_j. This is exact where only bodies deform. Where springs deform
    too, it takes from no mode more than the largest a_j; iterations then transfer the missing reduction to the bodies
    as far as they deform, see `period_errors`. A scene with rigid-body modes or drives can leave the position in which
    these are its modes; there the reduction is limited to what bodies can lose in every position.

    Args:
        assembly: the assembled scene.
        steps: the steps.

    Returns:
        The assembly with corrected damping ratios, and the mass to add on the deformation of its bodies, (m, m).
    """
    modal, damping, elastic = assembly.modal, assembly.modal.damping, ~assembly.modal.rigid_modes
    if not steps.corrected or not damping.root.size or not elastic.any():
        return assembly, np.zeros_like(damping.root)
    mass, growth = steps.factors(modal.frequency)
    required, bent = 1 - mass[elastic], damping.root @ damping.deformation @ modal.shapes[:, elastic]
    requested, reduction = required, _inverse(bent, required)
    # Modes of equal frequency have arbitrary directions: they share their correction, which would else be rounding.
    frequency = modal.frequency[elastic]
    groups = np.cumsum(np.diff(frequency, prepend=0.0) > EQUAL_FREQUENCIES * frequency) - 1
    for _ in range(TRANSFER_ROUNDS):
        modal_reduction = np.sum(bent * (reduction @ bent), axis=0)
        achieved = (np.bincount(groups, modal_reduction) / np.bincount(groups))[groups]
        requested = np.clip(requested * required / np.maximum(achieved, required / 10), required, MOST)
        reduction = _inverse(bent, requested)
    reduction = damping.root.T @ reduction @ damping.root
    if modal.rigid_modes.any() or assembly.scene.terms_of(PrescribedMotion):
        reduction = _limit_to_free_flight(assembly.coordinates, reduction)
    return _with_ratios(assembly, growth), -reduction


def _limit_to_free_flight(coordinates: Coordinates, reduction: Array) -> Array:
    """Limit the reduction of a mass to what bodies can lose in every position, (m, m).

    Bodies have at least the kinetic energy of their deformation in free flight, for any joints.
    """
    frames = [coordinates.frames[body.name] for body in coordinates.scene.deformable_bodies]
    spare = scipy.linalg.block_diag(*map(in_free_flight, frames))
    scale = np.sqrt(np.maximum(np.diag(spare), np.finfo(float).tiny))
    sizes, axes = np.linalg.eigh(spare / np.outer(scale, scale))
    heavy = sizes > MASSLESS
    factor = scale[:, None] * axes[:, heavy] * np.sqrt(sizes[heavy])
    inverse = axes[:, heavy] / scale[:, None] / np.sqrt(sizes[heavy])
    shares, vectors = np.linalg.eigh(inverse.T @ reduction @ inverse)
    weighted = factor @ vectors
    return (weighted * np.minimum(shares, SPARED)) @ weighted.T


def in_free_flight(frame: FloatingFrame) -> Array:
    """Compute the mass matrix of a body's deformation while its frame moves freely with it, (n, n)."""
    arm = frame.mass * skew(frame.center_of_mass)
    rigid = np.block([[frame.mass * np.eye(3), -arm], [arm, frame.inertia]])
    driven = np.vstack([frame.translation_flexible, -frame.position_flexible])
    result: Array = frame.mass_matrix - driven.T @ np.linalg.pinv(rigid, rcond=MASSLESS, hermitian=True) @ driven
    return 0.5 * (result + result.T)


def _inverse(bent: Array, requested: Array) -> Array:
    """Invert the sum of d d^T over a, of columns d and numbers a."""
    return np.linalg.pinv((bent / requested) @ bent.T, rcond=1e-12, hermitian=True)
