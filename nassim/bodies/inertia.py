"""Inertia of a body from its reduced matrices and node positions: exact for rigid motion, estimated otherwise.

With the six rigid motions R in the reduced coordinates, R^T M R holds the mass, centre of mass and inertia. M R holds
the integrals of psi_j and of x cross psi_j (mPhitTPsi and mXRefTildePsi in Exudyn). Large motion also needs two kinds
of integrals that no reduced matrix holds:

- the symmetric part of the integrals of x_a psi_jb, for the centrifugal forces on the undeformed shape;
- the integrals of psi_ja psi_kb other than their trace M_jk, for Coriolis and centrifugal forces on the deformation.

Each displacement field is therefore split into a rigid part, whose integrals are known, and a remainder orthogonal to
all rigid motions. For the remainder, the integrals of the first kind are estimated from the motion of the points in
homogeneous strain (correct for the extension of a bar, zero if all points coincide). The integrals of the second kind
are otherwise assumed to be equal in all directions. The Gram matrix stays positive semidefinite (to the accuracy of M),
and everything that is known stays exact.

Error bound: let the body rotate at Omega, and let omega be its lowest elastic eigenfrequency with its actual
supports. By the Cauchy-Schwarz inequality, the amplitude of each mode of unit modal mass under centrifugal forces is
at most (Omega / omega)^2 times the square root of the polar moment of inertia. The deformation is then at most
(Omega / omega)^2 of the body's size, and eigenfrequencies change by at most about Omega. Below Omega = omega / 30 both
are small: 0.1 % of the size and 3 % of the lowest frequency. Small motion about a body at rest, free flight of a stiff
body, and the fidelities "linear" and "rigid" are not affected.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_motions, skew
from nassim.base.short_repr import short_repr

FLAT = 1e-6
"""Points lie in a plane or on a line if their distance from it is below this share of the body's size."""


@dataclass(frozen=True)
class RigidInertia:
    """Inertia of a body in rigid motion.

    Attributes:
        mass: mass [kg]
        center_of_mass: centre of mass, shape (3,) [m]
        inertia: inertia about the body's origin, shape (3, 3) [kg m2]
        misfit: largest relative deviation of R^T M R from the form that it has for a rigid body [-]
    """

    mass: float
    center_of_mass: Array
    inertia: Array
    misfit: float
    __repr__ = short_repr

    @property
    def central_inertia(self) -> Array:
        """Inertia about the centre of mass, shape (3, 3) [kg m2]."""
        arm = skew(self.center_of_mass)
        return self.inertia + self.mass * arm @ arm

    @property
    def box(self) -> Array:
        """Squared sides of the homogeneous box with this inertia, ascending, (3,) [m2]; negative if there is none."""
        moments = np.linalg.eigvalsh(self.central_inertia)
        return np.sort(6 * (moments.sum() - 2 * moments) / self.mass)

    @property
    def box_density(self) -> float:
        """Mass over the volume of that box [kg/m3]; NaN if the box is flat or does not exist."""
        sides = self.box
        return float(self.mass / np.sqrt(np.prod(sides))) if sides[0] > 1e-5 * sides[-1] else np.nan


def rigid_inertia(mass_matrix: Array, rigid_motions: Array) -> RigidInertia:
    """Compute mass, centre of mass and inertia from the mass matrix.

    Args:
        mass_matrix: mass matrix, shape (n, n)
        rigid_motions: the six rigid motions about the origin as columns, shape (n, 6)
    """
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


def elastic_basis(mass_matrix: Array, motions: Array) -> Array:
    """Compute a basis of the motions that are orthogonal to the rigid motions in the mass's inner product.

    Args:
        mass_matrix: mass matrix, shape (n, n)
        motions: rigid motions as columns, shape (n, 6)

    Returns:
        Basis as columns, shape (n, n - 6).
    """
    scale = 1.0 / np.sqrt(np.diag(mass_matrix))
    weighted = (motions.T @ mass_matrix * scale).T
    full = scipy.linalg.qr(weighted)[0]
    return scale[:, None] * full[:, 6:]


def estimate_gram(mass_matrix: Array, positions: Array) -> Array:
    """Estimate the Gram matrix of a `ReducedBody` from its mass matrix; see the module's description for the error.

    Args:
        mass_matrix: positive definite mass matrix, shape (n, n)
        positions: positions of the remote points, shape (r, 3) [m]

    Returns:
        Gram matrix, shape (4 + 3 n, 4 + 3 n).
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
    # The known part of psi_j as coefficients on 1, x, y, z, beginning with translation + rotation cross x.
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
    return 0.5 * (gram + gram.T)


def transform_gram(gram: Array, place: Array, axes: Array, rows: Array) -> Array:
    """Write the Gram matrix of a body, see `ReducedBody`, in another frame and in other coordinates.

    Args:
        gram: Gram matrix in the body's frame and its k coordinates, shape (4 + 3 k, 4 + 3 k)
        place: origin of the body's frame in the new frame, shape (3,) [m]
        axes: rotation from the body's to the new frame, shape (3, 3)
        rows: the body's coordinates per unit of the new ones, shape (k, n)

    Returns:
        Gram matrix, shape (4 + 3 n, 4 + 3 n).
    """
    fields = np.zeros((len(gram), 4 + 3 * rows.shape[1]))
    fields[0, 0], fields[0, 1:4], fields[1:4, 1:4] = 1.0, place, axes.T
    fields[4:, 4:] = np.kron(rows, axes.T)
    result: Array = fields.T @ gram @ fields
    return 0.5 * (result + result.T)


def _homogeneous_strains(mass_matrix: Array, positions: Array, rigid: RigidInertia) -> Array:
    """Estimate the strain in the non-rigid part of each psi_j as coefficients on x - centre, shape (3, n, 3).

    A homogeneous strain is represented by the shape whose points move as in this strain, in the space that the points
    span. M times this shape gives the symmetric integrals of x_a psi_jb. The strains are reduced where they would need
    more inertia than the body has.
    """
    n = len(mass_matrix)
    motions = rigid_motions(positions, n)
    free = elastic_basis(mass_matrix, motions)
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
    return strains / np.sqrt(max(excess, 1.0))
