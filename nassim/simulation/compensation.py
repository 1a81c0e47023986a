"""Steps that keep periods: masses and dampings which the trapezoidal rule turns into the true poles of a scene's modes.

The rule makes of a pole s one at (2/h) artanh(s h/2): it lengthens periods by (2 pi h / T)^2 / 12. That is known for
each mode, so it can be made up for: with x = omega h / 2, a modal mass times (x / tan x)^2 and a damping times
(x / tan x)^2 (1 + tan(x)^2) are stepped to the mode's own frequency and, to first order, its damping; stiffness stays,
and with it all statics. The mass that changes is that of deformation, so that motion as rigid bodies, its momentum and
its forces stay as they are.

What the rule says of velocities and accelerations stays as well: of a harmonic motion they are too large by factors of
tan(x) / x and its square, at the motion's own frequency.

Source: as for frequency prewarping of Tustin's rule, K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 3rd ed.
(1997), section 8.2, mode by mode.
"""

from dataclasses import replace

import numpy as np

from nassim.base.checks import Array
from nassim.base.modal import eigenmodes
from nassim.simulation.small_motion import Assembly

FASTEST = 0.9
"""Half a step's angle [rad] up to which a mode is compensated, 3.5 steps a period; faster ones get the same factor."""
ROUNDS = 5
"""In which modes that springs share in get from bodies what these must take over."""
MOST = 0.6
"""Share of a modal mass that is taken away at most: masses stay positive."""


def prewarped(frequency: Array, time_step: float) -> tuple[Array, Array]:
    """Factors of modal masses and of modal damping, (n,) each, at frequencies, (n,) [Hz]; 1 for free motions."""
    x = np.clip(np.pi * frequency * time_step, 1e-9, FASTEST)
    mass = (x / np.tan(x)) ** 2
    return mass, mass * (1 + np.tan(x) ** 2)


def compensated(assembly: Assembly, time_step: float) -> tuple[Assembly, Array]:
    """The scene with damping ratios for a time step [s], and the mass to add on the deformation of its bodies, (m, m).

    With d_j the deformation in mode j and a_j what its mass lacks, the mass is the inverse of the sum of d_j d_j^T / a_j:
    exact where only bodies deform, the largest that takes from no mode more than the largest a_j where springs do too.
    What these lack is asked of the bodies again, as far as they have it: see `period_errors`. (For slow modes, a_j is
    -h^2 omega_j^2 / 6 and the mass -h^2 / 6 times the bodies' stiffness: the rule of Fox and Goodwin.)
    """
    damping, elastic = assembly.damping, ~assembly.free
    mass, ratio = prewarped(assembly.frequency, time_step)
    wanted, shapes = 1 - mass[elastic], assembly.shapes[:, elastic]
    bent = damping.root @ damping.deformation @ shapes
    asked = wanted
    for _ in range(ROUNDS):
        taken = np.linalg.pinv((bent / asked) @ bent.T, rcond=1e-12, hermitian=True)
        given = np.einsum("ij,ik,kj->j", bent, taken, bent)
        asked = np.clip(asked * wanted / np.maximum(given, wanted / 10), wanted, MOST)
    taken = np.linalg.pinv((bent / asked) @ bent.T, rcond=1e-12, hermitian=True)
    return replace(
        assembly, damping=replace(damping, ratio=damping.ratio * ratio)
    ), -damping.root.T @ taken @ damping.root


def period_errors(assembly: Assembly, time_step: float) -> Array:
    """Relative error of each mode's frequency in compensated steps of the trapezoidal rule, (n,) [-]; 0 if free."""
    _, added = compensated(assembly, time_step)
    deformation = assembly.damping.deformation @ assembly.shapes
    stiffness = np.diag((2 * np.pi * assembly.frequency) ** 2)
    stepped, _ = eigenmodes(stiffness, np.eye(len(stiffness)) + deformation.T @ added @ deformation)
    real = np.arctan(np.pi * stepped * time_step) / (np.pi * time_step)
    result: Array = np.where(assembly.free, 0.0, real / np.where(assembly.free, 1.0, assembly.frequency) - 1)
    return result
