"""Geometric stiffness of a condensed FE model in reduced coordinates; see `nassim.bodies.stress_stiffness`.

The stress term of a displacement field has the same scalar form for each of the three components. One scalar matrix per
field therefore gives all integrals, also those of the change of shape, since the third derivative of the strain energy
is symmetric in its three fields.
"""

from collections.abc import Callable, Sequence

import ngsolve as ng
import numpy as np

from nassim.base.checks import Array
from nassim.base.progress import Advance, silent
from nassim.base.rigid_motion import rigid_transfer
from nassim.bodies.piezo import PortCoupling
from nassim.bodies.stress_stiffness import BODY_FORCES, StressStiffness
from nassim.fem.assembly import lame_parameters, mesh_and_solid
from nassim.fem.condensation import Condensation, vector_dofs
from nassim.fem.fe_model import FEModel
from nassim.fem.native_threads import threads
from nassim.fem.ports import blocked_stress
from nassim.fem.regions import by_body
from nassim.fem.sparse import SymmetricMatrix, symmetric_matrix


def stress_stiffness(
    condensed: Condensation, basis: Array, ports: Sequence[PortCoupling] = (), *, advance: Advance = silent
) -> StressStiffness:
    """Compute the geometric stiffness in the coordinates of a reduction.

    Args:
        condensed: static condensation of the model
        basis: displacements of the n coordinates, the constraint modes first, shape (n_dofs, n)
        ports: electrical ports of the model
        advance: called once per field of displacements

    Raises:
        ValueError: for a model that was not made from a mesh
    """
    model = condensed.fe_model
    stress_form = _stress_form(model, [port.name for port in ports])
    r, n = condensed.constraint_modes.shape[1], basis.shape[1]
    with threads():
        # Coordinates have no loads of their own, so their columns are zero.
        loads = np.hstack([np.zeros((model.n_dofs, n)), body_forces(model), *(port.forces[:, None] for port in ports)])
        fields = np.hstack([basis, condensed.solve_fixed(loads[:, n:])])
        size = fields.shape[1]
        components = fields.reshape(3, -1, size)
        forms = np.zeros((size, size, size))
        for k in range(6, size):
            voltages = np.arange(n + BODY_FORCES, size) == k
            matrix = stress_form(fields[:, k], voltages.astype(float))
            forms[k] = sum(part.T @ (matrix @ part) for part in components)
            advance()
        forms = 0.5 * (forms + forms.transpose(0, 2, 1)) + _interface_rotations(condensed, fields, loads)
        blocked = _interface_rotations(condensed, 0 * fields, loads)[n + BODY_FORCES :]
        for k in range(len(ports)):
            matrix = stress_form(0 * fields[:, 0], np.eye(len(ports))[k])
            blocked[k] += sum(part.T @ (matrix @ part) for part in components)
    # A rigid motion of the body has no stress, so the motion of the first point has minus that of all others.
    first = condensed.couplings[0].point.position
    forms[:6] = 0.0
    for j, coupling in enumerate(condensed.couplings[1:], start=1):
        transfer = rigid_transfer(coupling.point.position - first)
        forms[:6] -= np.tensordot(transfer.T, forms[6 * j : 6 * j + 6], axes=1)
    cases, own = np.concatenate([np.arange(r), np.arange(n, size)]), np.arange(n)
    shape = forms.transpose(1, 0, 2)  # the stress of coordinate i, as case k has turned coordinate j
    kept = np.ix_(cases, own, own)
    names = tuple(port.name for port in ports)
    return StressStiffness(np.eye(size, n)[cases], forms[kept], shape[kept], names, blocked[:, :n, :n])


def _stress_form(model: FEModel, ports: Sequence[str]) -> Callable[[Array, Array], SymmetricMatrix]:
    """Return a function that assembles the stress term of displacements (n_dofs,) and of voltages at the ports.

    Its result is the scalar block that all three components share, shape (n_dofs / 3, n_dofs / 3); it is valid until
    the next call.
    """
    mesh, solid = mesh_and_solid(model)
    lambda_, mu = lame_parameters(mesh, solid)
    u = ng.GridFunction(ng.VectorH1(mesh, order=model.order))
    stress = lambda_ * ng.Trace(ng.Grad(u)) * ng.Id(3) + 2 * mu * ng.Sym(ng.Grad(u))
    voltages = [ng.Parameter(0.0) for _ in ports]
    electrical = {port.name: port for port in solid.ports}
    for name, voltage in zip(ports, voltages, strict=True):
        blocked = {body: blocked_stress(solid, electrical[name], body) for body in electrical[name].bodies}
        entries = [
            by_body(mesh, {body: float(blocked[body][index]) if body in blocked else 0.0 for body in solid.materials})
            for index in np.ndindex(3, 3)
        ]
        stress = stress - voltage * ng.CoefficientFunction(tuple(entries), dims=(3, 3))
    v, w = ng.H1(mesh, order=model.order).TnT()
    form = ng.BilinearForm(v.space, symmetric=True, symmetric_storage=True)
    # The stress has one order less than the displacements.
    form += ng.InnerProduct(stress * ng.grad(v), ng.grad(w)) * ng.dx(bonus_intorder=model.order)

    def assemble(displacement: Array, values: Array) -> SymmetricMatrix:
        u.vec.FV().NumPy()[:] = displacement
        for voltage, value in zip(voltages, values, strict=True):
            voltage.Set(float(value))
        return symmetric_matrix(form.Assemble().mat)

    return assemble


def body_forces(model: FEModel) -> Array:
    """Return forces of the body forces per mass g e_b, g = 1, x, y, z, b running first, shape (n_dofs, 12)."""
    weighted = model.scalar_mass_matrix @ model.fields.T
    return np.hstack([np.kron(np.eye(3), field[:, None]) for field in weighted.T])


def _interface_rotations(condensed: Condensation, fields: Array, loads: Array) -> Array:
    """Return the stiffness of forces at rbe2 interfaces, per field, as these rotate, shape (k, k, k).

    A rotation phi moves an interface point at s by phi x s + phi x (phi x s) / 2. Fields of displacements hold the
    first part only. In rbe3 interfaces all points deform by themselves.
    """
    model, k = condensed.fe_model, fields.shape[1]
    result = np.zeros((k, k, k))
    stiff = [(i, c) for i, c in enumerate(condensed.couplings) if c.point.coupling == "rbe2"]
    forces = model.stiffness @ fields - loads if stiff else loads
    for i, coupling in stiff:
        held = forces[vector_dofs(coupling, model.n_dofs)]
        arms = model.fields[1:, coupling.dofs] - np.outer(coupling.point.position, model.fields[0, coupling.dofs])
        virial = np.einsum("aik,bi->kab", held.reshape(3, -1, k), arms)
        virial = 0.5 * (virial + virial.transpose(0, 2, 1))
        rotations = slice(6 * i + 3, 6 * i + 6)
        result[:, rotations, rotations] = virial - np.trace(virial, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    return result
