"""Change of a body's energies where the faces of its mesh differ from the CAD.

Elements that fold on a curved face get straighter edges (`curving`), which takes material from a convex face. The
displacements that would restore the faces change the energies of a displacement shape to first order by the shape
derivative in its distributed form: the shape moves with the material, and its own change does not count, because
Rayleigh's quotient is stationary. Only at interfaces it counts: where nodes of an interface move by V and its remote
point turns by theta, the interface moves by theta x V more, against its forces. The warping of interfaces that are free
to warp, and the forces of electrical ports, are taken as they were.

Source: J. Sokolowski, J.-P. Zolesio, Introduction to Shape Optimization (1992), sections 3.1 and 3.5.
"""

from typing import Any

import ngsolve as ng
import numpy as np

from nassim.base.checks import Array
from nassim.fem.assembly import density, lame_parameters, mesh_and_solid
from nassim.fem.condensation import Condensation
from nassim.fem.native_threads import threads


def restored_energies(
    condensed: Condensation, restoring: Any, displacements: Array, motions: Array, forces: Array, squares: Array
) -> Array:
    """Compute by how much energies would change if the nodes of a mesh moved to the faces of the CAD, to first order.

    Args:
        condensed: static condensation with all remote points
        restoring: displacements of the nodes, NGSolve function of three components [m]
        displacements: shapes, (n_dofs, t) [m]
        motions: motions of the remote points in these, (6 r, t) [m, rad]
        forces: forces on the unknowns in these, (n_dofs, t) [N]
        squares: squared angular frequencies of the shapes that are modes, 0 for static ones, (t,) [1/s2]

    Returns:
        Changes of twice the strain energy less twice the kinetic energy, (t,) [J].
    """
    order = condensed.fe_model.order
    mesh, solid = mesh_and_solid(condensed.fe_model)
    nodes = ng.GridFunction(ng.H1(mesh, order=order, dim=3))
    nodes.Set(restoring)
    steps = nodes.vec.FV().NumPy().reshape(-1, 3).T
    moves = ng.GridFunction(ng.VectorH1(mesh, order=order))
    moves.vec.FV().NumPy()[:] = steps.ravel()
    scalar, moving = restoring.space, restoring.vec.FV().NumPy().reshape(-1, 3).any(axis=1)
    near = ng.BitArray(mesh.ne)
    near.Clear()
    for element in mesh.Elements(ng.VOL):
        if moving[list(scalar.GetDofNrs(element))].any():
            near.Set(element.nr)
    shape = ng.GridFunction(ng.VectorH1(mesh, order=order))
    slope, move = ng.Grad(shape), ng.Grad(moves)
    strain, growth = ng.Sym(slope), ng.Trace(move)
    first, shear = lame_parameters(mesh, solid)
    stress = first * ng.Trace(strain) * ng.Id(3) + 2 * shear * strain
    elastic = growth * ng.InnerProduct(stress, strain) - 2 * ng.InnerProduct(stress, slope * move)
    square = ng.Parameter(0.0)
    change = elastic - square * growth * density(mesh, solid) * ng.InnerProduct(shape, shape)
    result = _turned_interfaces(condensed, steps, motions, forces)
    for k, column in enumerate(displacements.T):
        shape.vec.FV().NumPy()[:] = column
        square.Set(float(squares[k]))
        with threads():
            result[k] += ng.Integrate(change * ng.dx(definedonelements=near), mesh)
    return result


def _turned_interfaces(condensed: Condensation, steps: Array, motions: Array, forces: Array) -> Array:
    """Return twice the work of the forces on interfaces as these turn with their remote points, (t,) [J].

    Args:
        condensed: static condensation
        steps: displacements of the nodes, (3, n_dofs / 3) [m]
        motions: as of `restored_energies`
        forces: as of `restored_energies`
    """
    result = np.zeros(motions.shape[1])
    for coupling, motion in zip(condensed.couplings, np.split(motions, len(motions) // 6), strict=True):
        turned = np.cross(motion[3:, None], steps[:, coupling.dofs, None], axis=0)
        result += 2 * np.einsum("imt,imt->t", turned, forces.reshape(3, -1, len(result))[:, coupling.dofs])
    return result
