"""Change of a body's energies where the faces of its mesh are not those of the CAD.

Elements that fold on a curved face get straighter edges (`curving`), which takes material from a convex face. The
displacements that would restore the faces change the energies of a displacement shape to first order by the shape
derivative in its distributed form: the shape moves with the material, and its own change does not count, because
Rayleigh's quotient is stationary.

Source: J. Sokolowski, J.-P. Zolesio, Introduction to Shape Optimization (1992), sections 3.1 and 3.5.
"""

from typing import Any

import ngsolve as ng
import numpy as np

from nassim.base.checks import Array
from nassim.fem.assembly import density, lame_parameters
from nassim.fem.native_threads import threads
from nassim.fem.solid import Solid


def restored_energies(
    mesh: Any, solid: Solid, order: int, restoring: Any, displacements: Array, squares: Array
) -> Array:
    """Compute by how much energies would change if the nodes of a mesh moved to the faces of the CAD, to first order.

    Args:
        mesh: NGSolve mesh
        solid: the solid
        order: polynomial order of the displacements
        restoring: displacements of the nodes, NGSolve function of three components [m]
        displacements: shapes, (n_dofs, t) [m]
        squares: squared angular frequencies of the shapes that are modes, 0 for static ones, (t,) [1/s2]

    Returns:
        Changes of twice the strain energy less twice the kinetic energy, (t,) [J].
    """
    space = ng.VectorH1(mesh, order=restoring.space.globalorder)
    moves = ng.GridFunction(space)
    nodes = restoring.vec.FV().NumPy().reshape(-1, 3)
    moves.vec.FV().NumPy()[:] = nodes.T.ravel()
    moving = nodes.any(axis=1)
    scalar = restoring.space
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
    result = np.empty(len(squares))
    for k, column in enumerate(displacements.T):
        shape.vec.FV().NumPy()[:] = column
        square.Set(float(squares[k]))
        with threads():
            result[k] = ng.Integrate(change * ng.dx(definedonelements=near), mesh)
    return result
