"""Geometric stiffness of the stress in a scene's bodies: exact where their reduction holds it, otherwise estimated."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from nassim.base.checks import Array
from nassim.base.warning_log import warn
from nassim.bodies.stress_stiffness import GeometricTerms
from nassim.scene.bodies import FlexibleBody
from nassim.scene.measures import BodyCoordinates
from nassim.simulation.loaded.geometric_stiffness import applied_forces
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.axial_preload import FACTOR, axial_rows, estimated_stiffness

WARNED_SHIFT = 0.01
"""Relative change of a frequency by estimated or omitted geometric stiffness above which a warning is given."""


@dataclass(frozen=True)
class InnerForces:
    """Constant forces within bodies, which stress them beside their deformation.

    Attributes:
        voltages: voltages at electrical ports, by body and port [V].
        pairs: forces on the coordinates of bodies otherwise, as of stacks that push two points apart, by body, (n,).
    """

    voltages: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    pairs: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, assembly: Assembly, inputs: Mapping[str, float]) -> "InnerForces":
        """Collect the forces within bodies by constant values of inputs, by name."""
        voltages: dict[str, dict[str, float]] = {}
        pairs: dict[str, Array] = {}
        bodies = {body.name: body.reduced for body in assembly.scene.deformable_bodies}
        for measure, force in applied_forces(assembly, inputs):
            if not isinstance(measure, BodyCoordinates) or measure.body not in bodies:
                continue
            ports = bodies[measure.body].ports
            driven = [port.name for port in ports if np.array_equal(port.forces, measure.weights)]
            for port in driven:
                own = voltages.setdefault(measure.body, {})
                own[port] = own.get(port, 0.0) + force
            if not driven:
                pairs[measure.body] = pairs.get(measure.body, 0.0) + force * measure.weights
        return cls(voltages, pairs)

    def on(self, body: FlexibleBody) -> Array:
        """Return the forces on the coordinates of a body, (n,)."""
        by_volt = {port.name: port.forces for port in body.reduced.ports}
        of_pairs = self.pairs.get(body.name, np.zeros(len(body.mass_matrix)))
        return sum((volts * by_volt[name] for name, volts in self.voltages.get(body.name, {}).items()), of_pairs)

    def of_pairs(self, body: FlexibleBody) -> Array:
        """Return the stiffness of what pairs of forces press between points, as of a beam between these, (n, n)."""
        if body.name not in self.pairs:
            return np.zeros_like(body.mass_matrix)
        return estimated_stiffness(body.reduced, -axial_rows(body.reduced) @ self.pairs[body.name])

    def stiffness_at_once(self, assembly: Assembly) -> dict[str, Array]:
        """Return the stiffness of the stress that does not grow with the deformation, by body that holds it, (n, n)."""
        result = {}
        for body in assembly.scene.deformable_bodies:
            if body.reduced.stress_stiffness is not None:
                of_ports = body.reduced.stress_stiffness.of_voltages(self.voltages.get(body.name, {}))
                result[body.name] = of_ports + self.of_pairs(body)
        return result


def stress_of_bodies(
    assembly: Assembly, displacement: Array, body_forces: Mapping[str, Array], inner: InnerForces
) -> dict[str, GeometricTerms]:
    """Compute the geometric stiffness of bodies that hold it, see `nassim.bodies.stress_stiffness`.

    Args:
        assembly: the assembled scene.
        displacement: elastic displacement under the loads in all coordinates, (n_all,).
        body_forces: body force per mass of each body as coefficients of 1, x, y, z along its axes, less the
            acceleration of its material, by name, (3, 4).
        inner: constant forces within bodies.

    Returns:
        Terms on the n coordinates of each of these bodies, by name.
    """
    result = {}
    for body in assembly.scene.deformable_bodies:
        if (stress := body.reduced.stress_stiffness) is None:
            continue
        place, bent = assembly.coordinates.slices[body.name], deformation(assembly, body.name, displacement)
        applied = dict(inner.voltages.get(body.name, {}))
        for circuit in assembly.signals.port_circuits:  # at rest, a resistance has taken the voltage of the charge away
            for port in body.reduced.ports:
                if np.array_equal(port.forces, circuit.forces[place]):
                    taken = float(port.forces @ displacement[place]) / circuit.storage
                    applied[port.name] = applied.get(port.name, 0.0) + taken
        terms = stress.under(bent, body_forces[body.name], applied)
        result[body.name] = replace(terms, stress=terms.stress + inner.of_pairs(body))
    return result


def deformation(assembly: Assembly, name: str, displacement: Array) -> Array:
    """Return a body's coordinates by deformation relative to its floating frame, (n,); displacement: (n_all,)."""
    return deformation_rows(assembly, name) @ displacement[assembly.coordinates.slices[name]]


def deformation_rows(assembly: Assembly, name: str) -> Array:
    """Return a body's coordinates by deformation relative to its floating frame per unit of its coordinates, (n, n)."""
    body, frame = assembly.scene.body(name), assembly.coordinates.frames[name]
    assert isinstance(body, FlexibleBody)
    result = np.zeros((len(body.mass_matrix),) * 2)
    result[frame.flexible] = frame.deformation(body.reduced)
    return result


def estimated_stress(assembly: Assembly, displacement: Array, inner: InnerForces) -> dict[str, GeometricTerms]:
    """Estimate the geometric stiffness of bodies that do not hold it, from the forces at their points.

    Args:
        assembly: the assembled scene.
        displacement: elastic displacement under the loads in all coordinates, (n_all,).
        inner: constant forces within bodies.

    Returns:
        Terms on the n coordinates of each of these bodies, by name, without a change of shape.

    Warns:
        UserWarning: for a body whose estimate changes a frequency of the scene by more than `WARNED_SHIFT`.
    """
    result = {}
    for body in assembly.scene.deformable_bodies:
        if body.reduced.stress_stiffness is not None:
            continue
        place = assembly.coordinates.slices[body.name]
        tensions = axial_rows(body.reduced) @ (body.reduced.stiffness_matrix @ displacement[place] - inner.on(body))
        own = estimated_stiffness(body.reduced, tensions)
        result[body.name] = GeometricTerms(own, np.zeros_like(own))
        if change := describe_change(assembly, body.name, own):
            warn(
                f"{change}, which is only estimated (within a factor of {FACTOR} for slender columns): reduce the body "
                "by craig_bampton(..., geometric_stiffness=True)"
            )
    return result


def describe_change(assembly: Assembly, name: str, stiffness: Array) -> str:
    """Describe the mode that the stiffness of a body's stress changes most, to first order.

    Args:
        assembly: the assembled scene.
        name: name of the body.
        stiffness: stiffness on the body's coordinates, (n, n).

    Returns:
        The description; empty for changes up to `WARNED_SHIFT`.
    """
    modal, elastic = assembly.modal, np.flatnonzero(~assembly.modal.rigid_modes)
    part = modal.modes[assembly.coordinates.slices[name]][:, elastic]
    energy = np.einsum("ij,ij->j", part, on_deformation(assembly, name, stiffness) @ part)
    shift = 0.5 * energy / modal.omega[elastic] ** 2
    if np.abs(shift).max(initial=0.0) <= WARNED_SHIFT:
        return ""
    k = int(np.argmax(np.abs(shift)))
    return (
        f"the stress in body {name!r} under load changes the mode at {modal.frequency[elastic[k]]:.4g} Hz by some "
        f"{100 * shift[k]:+.2g} %"
    )


def on_deformation(assembly: Assembly, name: str, stiffness: Array) -> Array:
    """Return a stiffness of a body's coordinates, (n, n), as it acts on deformation relative to the floating frame."""
    body, frame = assembly.scene.body(name), assembly.coordinates.frames[name]
    assert isinstance(body, FlexibleBody)
    rows = frame.deformation(body.reduced)
    return rows.T @ stiffness[np.ix_(frame.flexible, frame.flexible)] @ rows
