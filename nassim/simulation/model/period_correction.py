"""Steps that keep periods: masses and dampings that generalized-alpha turns into the true periods of a scene's modes.

The rule lengthens periods, by (2 pi h / T)^2 / 12 where it is the trapezoidal one. That is known for each mode, so it
can be made up for: a modal mass that is a little smaller is stepped to the mode's own frequency, one times
(x / tan x)^2 with x = pi h / T at a spectral radius of 1, and a damping times 1 + tan(x)^2 more than that mass, to
first order, to its own damping. Stiffness stays, and with it all statics. The mass that changes is that of deformation,
so that motion as rigid bodies, its momentum and its forces stay as they are.

What the rule says of velocities and accelerations stays as well: of a harmonic motion they are too large by factors of
tan(x) / x and its square, at the motion's own frequency.

Source: as for prewarping Tustin's rule, K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 3rd ed. (1997),
section 8.2, mode by mode; of slow modes it makes the rule of L. Fox and E. T. Goodwin, Proc. Camb. Phil. Soc. 45 (1949)
373-388.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.rigid_motion import skew
from nassim.bodies.floating_frame import FloatingFrame
from nassim.scene.terms import PrescribedMotion
from nassim.simulation.model.assembly import Assembly

FASTEST = 0.9
"""Half a step's angle [rad] up to which a mode is correct_periods, 3.5 steps a period; faster ones get the same factor."""
ROUNDS = 5
"""In which modes that springs share in get from bodies what these must take over."""
SAME = 1e-6
"""Relative difference of two frequencies that are one."""
MOST = 0.6
"""Share of a modal mass that is taken away at most: masses stay positive."""

SPARED = 0.9
"""Share of the mass of a body's deformation in free flight that is taken away at most, in every position."""

MASSLESS = 1e-12
"""Share of the largest below which an inertia is rounding."""


@dataclass(frozen=True)
class Steps:
    """Steps of generalized-alpha: time_step [s]; spectral_radius: see `nassim.simulation.integrator_error`.

    corrected: whether masses and dampings make up for what the rule does to periods
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

    def factors(self, frequency: Array) -> tuple[Array, Array]:
        """Of modal masses and of modal dampings at frequencies, (n,) [Hz]; (n,) each, 1 for free motions.

        The rule's equations for q = z^n with z = exp(i omega h) make M a(z) + C h b(z) + K h^2 d(z) = 0, of which the
        imaginary part after division by b leaves M.
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


def small_motion_factors(assembly: Assembly, steps: Steps) -> tuple[Array, Array]:
    """As `Steps.factors`, in small motion; 1 where drives follow inputs, whose inertia forces know the true masses."""
    if assembly.prescribed.inputs:
        ones = np.ones(len(assembly.frequency))
        return ones, ones
    return steps.factors(assembly.frequency)


def correct_periods(assembly: Assembly, steps: Steps) -> tuple[Assembly, Array]:
    """The scene with damping ratios for its steps, and the mass to add on the deformation of its bodies, (m, m).

    With d_j the deformation in mode j and a_j what its mass lacks, the mass is the inverse of the sum of d_j d_j^T
    over a_j: exact where only bodies deform; where springs do too it takes from no mode more than the largest a_j.
    What modes then still lack is asked of the bodies again, as far as they bend: see `period_errors`. Of scenes that
    can leave the position in which these are their modes, free or driven, no more than bodies can spare everywhere.
    """
    damping, elastic = assembly.damping, ~assembly.rigid_modes
    if not steps.corrected or not damping.root.size or not elastic.any():
        return assembly, np.zeros_like(damping.root)
    mass, growth = steps.factors(assembly.frequency)
    wanted, bent = 1 - mass[elastic], damping.root @ damping.deformation @ assembly.shapes[:, elastic]
    asked, taken = wanted, _inverse(bent, wanted)
    # Modes of one frequency have no axes of their own: what they get is shared, or it would be a matter of rounding.
    frequency = assembly.frequency[elastic]
    groups = np.cumsum(np.diff(frequency, prepend=0.0) > SAME * frequency) - 1
    for _ in range(ROUNDS):
        each = np.sum(bent * (taken @ bent), axis=0)
        given = (np.bincount(groups, each) / np.bincount(groups))[groups]
        asked = np.clip(asked * wanted / np.maximum(given, wanted / 10), wanted, MOST)
        taken = _inverse(bent, asked)
    taken = damping.root.T @ taken @ damping.root
    if assembly.rigid_modes.any() or assembly.scene.terms_of(PrescribedMotion):
        taken = _borne(assembly, taken)
    return replace(assembly, damping=replace(damping, ratio=damping.ratio * growth)), -taken


def _borne(assembly: Assembly, taken: Array) -> Array:
    """What of a mass bodies can spare in every position, (m, m).

    However joints tie them, bodies have at least the kinetic energy of their deformation in free flight.
    """
    frames = [assembly.frames[body.name] for body in assembly.scene.deformable_bodies]
    spare = scipy.linalg.block_diag(*map(in_free_flight, frames))
    scale = np.sqrt(np.maximum(np.diag(spare), np.finfo(float).tiny))
    sizes, axes = np.linalg.eigh(spare / np.outer(scale, scale))
    heavy = sizes > MASSLESS
    factor = scale[:, None] * axes[:, heavy] * np.sqrt(sizes[heavy])
    inverse = axes[:, heavy] / scale[:, None] / np.sqrt(sizes[heavy])
    shares, turn = np.linalg.eigh(inverse.T @ taken @ inverse)
    weighted = factor @ turn
    result: Array = (weighted * np.minimum(shares, SPARED)) @ weighted.T
    return result


def in_free_flight(frame: FloatingFrame) -> Array:
    """Mass matrix of a body's deformation while its frame moves as that drives it, (n, n)."""
    arm = frame.mass * skew(frame.center_of_mass)
    rigid = np.block([[frame.mass * np.eye(3), -arm], [arm, frame.inertia]])
    driven = np.vstack([frame.translation_flexible, -frame.position_flexible])
    result: Array = frame.mass_matrix - driven.T @ np.linalg.pinv(rigid, rcond=MASSLESS, hermitian=True) @ driven
    return 0.5 * (result + result.T)


def _inverse(bent: Array, asked: Array) -> Array:
    result: Array = np.linalg.pinv((bent / asked) @ bent.T, rcond=1e-12, hermitian=True)
    return result
