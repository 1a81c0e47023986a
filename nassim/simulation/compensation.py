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
import scipy

from nassim.base.checks import Array
from nassim.base.modal import eigenmodes
from nassim.simulation.small_motion import Assembly

FASTEST = 0.9
"""Half a step's angle [rad] up to which a mode is compensated: 3.5 steps a period."""
DEFORMING = 0.1
"""Share of a mode's strain that bodies' deformation has, from which on their mass can make up for it."""


def prewarped(frequency: Array, time_step: float) -> tuple[Array, Array]:
    """Factors of modal masses and of modal damping at frequencies, (n,) [Hz]; 1 for modes too fast for the step."""
    x = np.pi * frequency * time_step
    x = np.where(x < FASTEST, np.maximum(x, 1e-9), 1e-9)
    mass = (x / np.tan(x)) ** 2
    return mass, mass * (1 + np.tan(x) ** 2)


def compensated(assembly: Assembly, time_step: float) -> tuple[Assembly, Array]:
    """The scene with damping ratios for a time step [s], and the mass to add on the deformation of its bodies, (m, m).

    With D the deformation per unit of coordinates, K_f its stiffness and phi_j a mode of which its strain has the share
    r_j, v_j = K_f D phi_j / (omega_j^2 r_j) finds the mode in the deformation: the mass is the sum of v_j v_j^T times
    what each mode's lacks. Exact where only bodies deform; modes that springs share in get theirs to first order, and
    those in which hardly a body deforms stay as the rule makes them: see `period_errors`.
    """
    damping, omega = assembly.damping, 2 * np.pi * assembly.frequency
    mass, ratio = prewarped(assembly.frequency, time_step)
    bent = damping.deformation @ assembly.shapes
    frames = [assembly.frames[body.name].stiffness_matrix for body in assembly.scene.deformable_bodies]
    forces = scipy.linalg.block_diag(np.zeros((0, 0)), *frames) @ bent
    strain = np.einsum("ij,ij->j", bent, forces) / np.where(omega, omega, 1.0) ** 2
    found = (strain > DEFORMING) & (omega > 0)
    forces = forces[:, found] / (omega**2 * strain)[found]
    added: Array = (forces * (mass - 1)[found]) @ forces.T
    return replace(assembly, damping=replace(damping, ratio=damping.ratio * np.where(found, ratio, 1.0))), added


def period_errors(assembly: Assembly, time_step: float) -> Array:
    """Relative error of each mode's frequency in compensated steps of the trapezoidal rule, (n,) [-]; 0 if free."""
    _, added = compensated(assembly, time_step)
    deformation = assembly.damping.deformation @ assembly.shapes
    stiffness = np.diag((2 * np.pi * assembly.frequency) ** 2)
    stepped, _ = eigenmodes(stiffness, np.eye(len(stiffness)) + deformation.T @ added @ deformation)
    real = np.arctan(np.pi * stepped * time_step) / (np.pi * time_step)
    result: Array = np.where(assembly.free, 0.0, real / np.where(assembly.free, 1.0, assembly.frequency) - 1)
    return result
