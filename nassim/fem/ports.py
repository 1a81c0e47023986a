"""Electrical ports of a finite element model: piezoelectric stacks as consistent loads over their volume.

The enthalpy of a stack with strain S and voltage V is 1/2 S:C:S - V S:C:s - 1/2 c V^2, integrated over the volume, with
the free strain per volt s and the elasticity C at constant voltage. Its derivatives are the forces K u - b V and the
charge Q = b u + c V. The capacitance in the data sheet is that of the unloaded stack, in which S = s V; c is smaller by
the integral of s:C:s.
Source: IEEE Standard on Piezoelectricity, ANSI/IEEE Std 176-1987, section 2.
"""

from typing import Any

import ngsolve as ng
import numpy as np

from nassim.base.checks import Array
from nassim.bodies.piezo import ElectricalPort, PortCoupling
from nassim.fem.regions import bodies
from nassim.fem.solid import Solid

VOLUME_MISMATCH = 0.02
"""Largest relative difference between a CAD body's volume and that of its stack's data sheet."""


def couple_port(mesh: Any, solid: Solid, order: int, port: ElectricalPort) -> PortCoupling:
    """Compute a port's forces on the unknowns x..., y..., z..., its blocked capacitance and its position.

    Args:
        mesh: NGSolve mesh
        solid: the solid
        order: polynomial order of the elements
        port: the electrical port

    Raises:
        ValueError: if a CAD body does not have the volume or length of the stack, or if the stack's data do not agree
            with its material
    """
    stack, strain = port.stack, port.strain_per_volt
    test = ng.VectorH1(mesh, order=order).TestFunction()
    form = ng.LinearForm(test.space)
    capacitance, moment, total = 0.0, np.zeros(3), 0.0
    for body in port.bodies:
        region = bodies(mesh, [body])
        volume = ng.Integrate(1.0, mesh, definedon=region)
        if abs(volume / (stack.length * stack.area) - 1) > VOLUME_MISMATCH:
            raise ValueError(
                f"electrical port {port.name!r}: CAD body {body!r} has {1e9 * volume:.4g} mm3, its stack "
                f"{1e9 * stack.length * stack.area:.4g} mm3; give each stack a CAD body of its own, of that size"
            )
        along = sum(c * x for c, x in zip(np.asarray(port.direction).tolist(), (ng.x, ng.y, ng.z), strict=True))
        mean = ng.Integrate(along, mesh, definedon=region) / volume
        extent = np.sqrt(12 * ng.Integrate((along - mean) ** 2, mesh, definedon=region) / volume)
        if abs(extent / stack.length - 1) > VOLUME_MISMATCH:
            raise ValueError(
                f"electrical port {port.name!r}: CAD body {body!r} is {1e3 * extent:.4g} mm long along the port's "
                f"direction, its stack {1e3 * stack.length:.4g} mm; does the direction follow the stack?"
            )
        stress = blocked_stress(solid, port, body)
        field = ng.CoefficientFunction(tuple(stress.ravel()), dims=(3, 3))
        form += ng.InnerProduct(field, ng.Grad(test)) * ng.dx(definedon=region)
        total += volume
        moment += [ng.Integrate(x, mesh, definedon=region) for x in (ng.x, ng.y, ng.z)]
        capacitance += stack.capacitance - volume * float(np.sum(stress * strain))
    form.Assemble()
    return PortCoupling(port.name, form.vec.FV().NumPy().copy(), capacitance, moment / total)


def blocked_stress(solid: Solid, port: ElectricalPort, body: str) -> Array:
    """Return minus the stress of a CAD body of a port under one volt, if nothing moves, shape (3, 3) [Pa/V]."""
    lambda_, mu = solid.materials[body].lame_parameters
    strain = port.strain_per_volt
    return lambda_ * np.trace(strain) * np.eye(3) + 2 * mu * strain
