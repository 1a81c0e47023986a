"""What reduced matrices and node positions tell of a body's inertia: exactly for rigid motions, not for the rest.

With R the six rigid motions in the reduced coordinates, R^T M R holds mass, centre of mass and inertia, and M R the
integrals of psi_j and of x cross psi_j (Exudyn's mPhitTPsi and mXRefTildePsi). Large motion also asks for

- the symmetric part of the integrals of x_a psi_jb: the pull of centrifugal forces on the resting shape,
- the integrals of psi_ja psi_kb beyond their trace M_jk: Coriolis and centrifugal forces on the deformation,

which no reduced matrix holds. Each displacement field is therefore split into its rigid part, whose integrals are
known, and a rest that is orthogonal to all rigid motions; of the rest's integrals those of the second kind are taken
as equal in all directions and those of the first kind as zero. That keeps the Gram matrix positive semidefinite and
everything that is known exact.

What that neglects, for a body that turns at Omega, whose lowest elastic eigenfrequency (as it is held) is omega:
by Cauchy and Schwarz, the deformation under centrifugal forces is at most (Omega / omega)^2 times the root of mass
times polar moment in each unit-mass mode, so (Omega / omega)^2 of the body's size, and eigenfrequencies are off by at
most about Omega. Below Omega = omega / 30 both are small: 0.1 % of the size, 3 % of the lowest frequency. Small motion
about a body at rest, free flight of a stiff body, and the fidelities "linear" and "rigid" are not touched.
"""

from dataclasses import dataclass

import numpy as np

from nassim.checks import Array
from nassim.interface import skew


@dataclass(frozen=True)
class RigidInertia:
    """Inertia of a body in rigid motion.

    mass [kg]; center_of_mass: (3,) [m]; inertia: about the body's origin, (3, 3) [kg m2]
    misfit: largest deviation of R^T M R from the form that every rigid body's has [-]
    """

    mass: float
    center_of_mass: Array
    inertia: Array
    misfit: float

    @property
    def central_inertia(self) -> Array:
        """Inertia about the centre of mass, (3, 3) [kg m2]."""
        arm = skew(self.center_of_mass)
        result: Array = self.inertia + self.mass * arm @ arm
        return result

    @property
    def box(self) -> Array:
        """Squared sides of the homogeneous box with this inertia, ascending, (3,) [m2]; negative for an impossible one."""
        moments = np.linalg.eigvalsh(self.central_inertia)
        result: Array = np.sort(6 * (moments.sum() - 2 * moments) / self.mass)
        return result


def rigid_inertia(mass_matrix: Array, rigid_motions: Array) -> RigidInertia:
    """Mass, centre of mass and inertia from the mass matrix (n, n) and the rigid motions about the origin (n, 6)."""
    moments = rigid_motions.T @ (0.5 * (mass_matrix + mass_matrix.T)) @ rigid_motions
    mass = float(np.trace(moments[:3, :3])) / 3
    coupling, inertia = moments[:3, 3:], moments[3:, 3:]
    arm = 0.5 * (coupling.T - coupling)  # mass times skew(centre)
    centre = np.array([arm[2, 1], arm[0, 2], arm[1, 0]]) / mass if mass else np.zeros(3)
    radius = np.sqrt(max(float(np.trace(inertia)), 0.0) / (3 * mass)) if mass > 0 else 0.0
    strange = np.zeros((2, 3, 3))
    strange[0] = moments[:3, :3] - mass * np.eye(3)
    if radius:
        strange[1] = 0.5 * (coupling + coupling.T) / radius
    misfit = float(np.abs(strange).max() / abs(mass)) if mass else np.inf
    return RigidInertia(mass, centre, 0.5 * (inertia + inertia.T), misfit)


def completed_gram(mass_matrix: Array, rigid_motions: Array) -> Array:
    """The Gram matrix of a `ReducedBody` from its mass matrix, as far as that tells, shape (4 + 3 n, 4 + 3 n).

    mass_matrix: (n, n), positive definite; rigid_motions: about the body's origin, (n, 6)
    """
    n = len(mass_matrix)
    rigid = rigid_inertia(mass_matrix, rigid_motions)
    moments = np.zeros((4, 4))
    moments[0, 0] = rigid.mass
    moments[0, 1:] = moments[1:, 0] = rigid.mass * rigid.center_of_mass
    moments[1:, 1:] = 0.5 * np.trace(rigid.inertia) * np.eye(3) - rigid.inertia
    weighted = rigid_motions.T @ mass_matrix
    content = np.linalg.solve(weighted @ rigid_motions, weighted)
    # The rigid part of psi_j, translation + rotation cross x, by its coefficients on 1, x, y, z.
    parts = np.zeros((4, n, 3))
    parts[0] = content[:3].T
    for j in range(n):
        parts[1:, j] = skew(content[3:, j]).T
    fields = np.hstack([np.eye(4), parts.reshape(4, 3 * n)])
    gram = fields.T @ moments @ fields
    trace = np.einsum("jckc->jk", gram[4:, 4:].reshape(n, 3, n, 3))
    gram[4:, 4:] += np.kron((mass_matrix - trace) / 3, np.eye(3))
    result: Array = 0.5 * (gram + gram.T)
    return result
