"""Floating frame of reference: a reduced body in large motion, with inertia integrals from one Gram matrix.

The frame moves with one remote point. The six coordinates of this point become the motion of the frame, and all other
coordinates describe the deformation. The integrals are those of A. Zwölfer, J. Gerstmayr, "The nodal-based floating
frame of reference formulation with modal reduction", Acta Mechanica 232 (2021) 835-851, written for continuous fields.
"""

from dataclasses import KW_ONLY, dataclass

import numpy as np

from nassim.base.checks import Array, known
from nassim.base.rigid_motion import rigid_transfer, skew
from nassim.base.short_repr import short_repr
from nassim.bodies.reduced_body import ReducedBody


@dataclass(frozen=True)
class FloatingFrame:
    """Inertia and stiffness of a body in its floating frame, with n flexible coordinates.

    In the integrals over the mass, psi_j is the displacement field of flexible coordinate j, and ~ denotes the
    cross-product matrix.

    Attributes:
        point: remote point that carries the frame
        origin: position of that point in the body's frame, shape (3,) [m]
        flexible: indices of the body's coordinates that are flexible coordinates, shape (n,)
        mass: mass [kg]
        center_of_mass: centre of mass from the frame's origin, shape (3,) [m]
        inertia: inertia about the frame's origin, shape (3, 3) [kg m2]
        mass_matrix: mass matrix of the flexible coordinates, shape (n, n)
        stiffness_matrix: stiffness matrix of the flexible coordinates, shape (n, n)
        translation_flexible: integrals of psi_j, shape (3, n)
        translation_rotated: integrals of psi_j~, shape (3, 3 n)
        position_flexible: integrals of -x cross psi_j, shape (3, n)
        position_rotated: integrals of (x . psi_j) I - psi_j x^T, shape (3, 3 n)
        rotated_flexible: integrals of -psi_j cross psi_k, shape (3 n, n)
        rotated_rotated: integrals of (psi_j . psi_k) I - psi_k psi_j^T, shape (3 n, 3 n)
    """

    point: str
    _: KW_ONLY
    origin: Array
    flexible: Array
    mass: float
    center_of_mass: Array
    inertia: Array
    mass_matrix: Array
    stiffness_matrix: Array
    translation_flexible: Array
    translation_rotated: Array
    position_flexible: Array
    position_rotated: Array
    rotated_flexible: Array
    rotated_rotated: Array
    __repr__ = short_repr

    def deformation(self, body: ReducedBody) -> Array:
        """Return the matrix from the body's to the flexible coordinates in small motion, shape (n, n_coordinates).

        It subtracts from the motion of each remote point the motion that this point would have on a rigid body that
        moves with the frame.

        Args:
            body: the reduced body of this frame
        """
        n = len(body.mass_matrix)
        index = body.point_names.index(self.point)
        rows = np.eye(n)
        for k, point in enumerate(body.remote_points):
            rows[6 * k : 6 * k + 6, 6 * index : 6 * index + 6] -= rigid_transfer(point.position - self.origin)
        return rows[self.flexible]


def floating_frame(body: ReducedBody, point: str) -> FloatingFrame:
    """Compute the floating-frame form of a reduced body whose frame moves with a given remote point.

    Args:
        body: the reduced body
        point: name of the remote point

    Raises:
        ValueError: for an unknown remote point
    """
    known("remote point", point, body.point_names)
    index = body.point_names.index(point)
    n_all = len(body.mass_matrix)
    flexible = np.delete(np.arange(n_all), np.s_[6 * index : 6 * index + 6])
    origin = body.remote_points[index].position
    # The scalar fields 1, x - origin, psi_flexible in place of 1, x, psi.
    chosen = np.concatenate([np.arange(4), (4 + 3 * flexible[:, None] + np.arange(3)).ravel()])
    gram = body.gram[np.ix_(chosen, chosen)]
    gram[1:4] -= np.outer(origin, gram[0])
    gram[:, 1:4] -= np.outer(gram[:, 0], origin)

    n = len(flexible)
    first_moment, second_moment = gram[0, 1:4], gram[1:4, 1:4]
    mean = gram[0, 4:].reshape(n, 3)  # psi_j
    position = gram[1:4, 4:].reshape(3, n, 3)  # x_a psi_jb
    pairs = gram[4:, 4:].reshape(n, 3, n, 3)  # psi_ja psi_kb
    trace = np.einsum("jaka->jk", pairs)
    eye = np.eye(3)
    permutation = np.zeros((3, 3, 3))
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        permutation[a, b, c], permutation[a, c, b] = 1.0, -1.0
    rotated_rotated = np.einsum("jk,ab->jakb", trace, eye) - np.einsum("jbka->jakb", pairs)
    return FloatingFrame(
        point=point,
        origin=origin,
        flexible=flexible,
        mass=float(gram[0, 0]),
        center_of_mass=first_moment / gram[0, 0],
        inertia=np.trace(second_moment) * eye - second_moment,
        mass_matrix=trace,
        stiffness_matrix=body.stiffness_matrix[np.ix_(flexible, flexible)],
        translation_flexible=mean.T,
        translation_rotated=np.hstack([np.zeros((3, 0)), *(skew(s) for s in mean)]),
        position_flexible=-np.einsum("abc,bjc->aj", permutation, position),
        position_rotated=(np.einsum("cjc,ab->ajb", position, eye) - np.einsum("bja->ajb", position)).reshape(3, 3 * n),
        rotated_flexible=-np.einsum("abc,jbkc->jak", permutation, pairs).reshape(3 * n, n),
        rotated_rotated=rotated_rotated.reshape(3 * n, 3 * n),
    )
