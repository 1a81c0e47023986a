"""What reduced matrices and node positions tell of a body's inertia: exactly for rigid motions, not for the rest.

With R the six rigid motions in the reduced coordinates, R^T M R holds mass, centre of mass and inertia, and M R the
integrals of psi_j and of x cross psi_j (Exudyn's mPhitTPsi and mXRefTildePsi). Large motion also asks for

- the symmetric part of the integrals of x_a psi_jb: the pull of centrifugal forces on the resting shape,
- the integrals of psi_ja psi_kb beyond their trace M_jk: Coriolis and centrifugal forces on the deformation,

which no reduced matrix holds. Each displacement field is therefore split into its rigid part, whose integrals are
known, and a rest that is orthogonal to all rigid motions. Of the rest, the integrals of the first kind are estimated
from how the points move in homogeneous strain (right for a bar's stretch, zero where all points coincide), and those
of the second kind taken as equal in all directions otherwise. The Gram matrix stays positive semidefinite (to the
digits of M), and all that is known stays exact.

The error of that, for a body that turns at Omega, whose lowest elastic eigenfrequency (as it is held) is omega:
by Cauchy and Schwarz, the deformation under centrifugal forces is at most (Omega / omega)^2 times the root of mass
times polar moment in each unit-mass mode, so (Omega / omega)^2 of the body's size, and eigenfrequencies are off by at
most about Omega. Below Omega = omega / 30 both are small: 0.1 % of the size, 3 % of the lowest frequency. Small motion
about a body at rest, free flight of a stiff body, and the fidelities "linear" and "rigid" are not touched.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_motions, skew

FLAT = 1e-6
"""Points within this share of the body's size of a plane or line lie in it."""


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
        """Squared sides of the homogeneous box with this inertia, ascending, (3,) [m2]; negative where none has."""
        moments = np.linalg.eigvalsh(self.central_inertia)
        result: Array = np.sort(6 * (moments.sum() - 2 * moments) / self.mass)
        return result

    @property
    def box_density(self) -> float:
        """Mass over that box's volume [kg/m3]; NaN where it is flat or there is none."""
        sides = self.box
        return float(self.mass / np.sqrt(np.prod(sides))) if sides[0] > 1e-5 * sides[-1] else np.nan


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


def free_of_rigid_motions(mass_matrix: Array, motions: Array) -> Array:
    """A basis of the motions orthogonal to the rigid ones (n, 6) in the mass's product, (n, n - 6)."""
    scale = 1.0 / np.sqrt(np.diag(mass_matrix))
    weighted = (motions.T @ mass_matrix * scale).T
    weighted = weighted / np.maximum(np.linalg.norm(weighted, axis=0), 1e-300)
    full = scipy.linalg.qr(weighted)[0]
    result: Array = scale[:, None] * full[:, 6:]
    return result


def completed_gram(mass_matrix: Array, positions: Array) -> Array:
    """The Gram matrix of a `ReducedBody` from its mass matrix, as far as that tells, shape (4 + 3 n, 4 + 3 n).

    mass_matrix: (n, n), positive definite; positions: of the remote points, (r, 3) [m]
    """
    n = len(mass_matrix)
    motions = rigid_motions(positions, n)
    rigid = rigid_inertia(mass_matrix, motions)
    moments = np.zeros((4, 4))
    moments[0, 0] = rigid.mass
    moments[0, 1:] = moments[1:, 0] = rigid.mass * rigid.center_of_mass
    moments[1:, 1:] = 0.5 * np.trace(rigid.inertia) * np.eye(3) - rigid.inertia
    weighted = motions.T @ mass_matrix
    content = np.linalg.solve(weighted @ motions, weighted)
    # What is known of psi_j by its coefficients on 1, x, y, z: first translation + rotation cross x.
    fields = np.zeros((4, n, 3))
    fields[0] = content[:3].T
    for j in range(n):
        fields[1:, j] = skew(content[3:, j]).T
    strains = _homogeneous_strains(mass_matrix, positions, rigid)
    fields[1:] += strains
    fields[0] -= np.einsum("a,ajb->jb", rigid.center_of_mass, strains)
    known = np.hstack([np.eye(4), fields.reshape(4, 3 * n)])
    gram = known.T @ moments @ known
    trace = np.einsum("jckc->jk", gram[4:, 4:].reshape(n, 3, n, 3))
    gram[4:, 4:] += np.kron((mass_matrix - trace) / 3, np.eye(3))
    result: Array = 0.5 * (gram + gram.T)
    return result


def _homogeneous_strains(mass_matrix: Array, positions: Array, rigid: RigidInertia) -> Array:
    """Strain in each psi_j beside its rigid part, by coefficients on x - centre, (3, n, 3); estimated.

    The shape whose points move as in a homogeneous strain of the space that they span stands for that strain, so M
    times it gives the symmetric integrals of x_a psi_jb. All are shrunk where they ask for more inertia than there is.
    """
    n = len(mass_matrix)
    motions = rigid_motions(positions, n)
    free = free_of_rigid_motions(mass_matrix, motions)
    offsets = positions - positions.mean(axis=0)
    _, spread, axes = np.linalg.svd(offsets)
    size = np.sqrt(np.trace(rigid.central_inertia) / rigid.mass)
    axes = axes[: int(np.sum(spread > FLAT * size))]
    if not len(axes) or not free.shape[1]:
        return np.zeros((3, n, 3))
    shapes = np.zeros((n, 3, 3))
    across = (positions - rigid.center_of_mass) @ axes.T @ axes
    for i, offset in enumerate(across):
        # Displacement 0.5 (e_a x_b + e_b x_a), within the space that the points span.
        stretch = np.einsum("ca,b->cab", axes.T @ axes, offset)
        shapes[6 * i : 6 * i + 3] = 0.5 * (stretch + stretch.transpose(0, 2, 1))
    inner = free.T @ mass_matrix @ free
    onto_rest = mass_matrix @ free @ np.linalg.solve(inner, free.T @ mass_matrix)
    pulls = np.einsum("jk,kab->ajb", onto_rest, shapes)
    central = 0.5 * np.trace(rigid.central_inertia) * np.eye(3) - rigid.central_inertia
    strains = np.einsum("ac,cjb->ajb", np.linalg.pinv(central, hermitian=True), pulls)
    needed = np.einsum("ajb,ac,ckb->jk", strains, central, strains)
    excess = float(scipy.linalg.eigh(free.T @ needed @ free, inner, eigvals_only=True)[-1])
    result: Array = strains / np.sqrt(max(excess, 1.0))
    return result
