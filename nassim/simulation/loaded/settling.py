"""Equilibrium of a scene under its loads by Newton's iterations about the configuration in equilibrium.

Bodies move with their frames, joints and springs turn. Gravity and the axis of a spin turn as a body sees them, and the
stress inside a body grows with its deformation. The equilibrium is exact for rigid bodies, joints and springs; inside
bodies it has the terms of `nassim.bodies.stress_stiffness`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from nassim.base.checks import Array
from nassim.simulation.loaded.body_stress import (
    InnerForces,
    deformation,
    deformation_rows,
    on_deformation,
    stress_of_bodies,
)
from nassim.simulation.loaded.geometric_stiffness import (
    GeometricStiffness,
    applied_forces,
    frames,
    gravity_felt,
)
from nassim.simulation.loaded.spinning import body_loads
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.displacement import advanced, displaced
from nassim.simulation.model.effect_of_loads import BodyStress, ConstantLoads, LoadedState
from nassim.simulation.model.modal_model import ModalModel, Structure
from nassim.simulation.model.moved_coordinates import MovedCoordinates
from nassim.simulation.model.prescribed_motion import PrescribedMotions
from nassim.simulation.model.signals import Signals

ITERATIONS, CONVERGED = 12, 1e-7
"""Newton's iterations, and the relative size of their last step, after which some of its square is left."""


@dataclass(frozen=True)
class NewtonEquilibrium:
    """A scene in equilibrium under constant loads, at rest or in a rotating frame.

    Attributes:
        assembly: the assembly about the equilibrium, without the effect of the loads.
        values: values of all coordinates of the reference configuration there, see `displaced`, (n_all,).
        borne: forces that constraints bear there, along the axes of the coordinates, (n_all,).
        added: stiffness that the loads add there, (n_all, n_all).
        stress: stress of the bodies there, by name.
    """

    assembly: Assembly
    values: Array
    borne: Array
    added: Array
    stress: Mapping[str, BodyStress]


def newton_equilibrium(assembly: Assembly, loads: LoadedState) -> NewtonEquilibrium | None:
    """Find the equilibrium of a scene by Newton's iterations.

    The stress inside bodies is that of first order in the loads; its stiffness is then that of the stress there.

    Args:
        assembly: the assembly in the reference configuration.
        loads: effect of the loads there.

    Returns:
        The equilibrium; None where the iterations do not converge.
    """
    given = replace(loads.given, gravity=gravity_felt(assembly, loads.given.gravity, loads.given.inputs))
    found = _iterated(assembly, assembly.modal.modes @ loads.equilibrium, loads, given)
    if found is None:
        return None
    now, coordinates, values, borne, of_contacts = found
    _, of_bodies, fields = body_loads(coordinates, frames(coordinates.reference), given)
    stress = _present_stress(now, values, fields, loads)
    return NewtonEquilibrium(now, values, borne, of_bodies + of_contacts + _of_stress(now, stress), stress)


def _iterated(
    assembly: Assembly, values: Array, loads: LoadedState, given: ConstantLoads
) -> tuple[Assembly, MovedCoordinates, Array, Array, Array] | None:
    """Find the equilibrium with the stress that the loads have in the reference configuration.

    Args:
        assembly: the assembly in the reference configuration.
        values: values of all coordinates to start from, (n_all,).
        loads: effect of the loads there.
        given: the loads, with the gravity that bodies feel.

    Returns:
        The assembly and its coordinates in equilibrium, their values, (n_all,), the forces that constraints bear,
        (n_all,), and the stiffness of joints, springs and inputs, (n_all, n_all); None where the iterations do not
        converge.
    """
    scale = assembly.coordinates.scale
    now, coordinates, structure = moved_assembly(assembly, values)
    for _ in range(ITERATIONS):
        on_bodies, of_bodies, _ = body_loads(coordinates, frames(coordinates.reference), given)
        borne = on_bodies + _forces_beside_weights(now, loads)
        closing, modes = now.constraints.closing(), now.modal.modes
        for circuit in now.signals.port_circuits:
            borne = borne + circuit.forces * (circuit.forces @ values) / circuit.storage
        stiffness = now.signals.discharged(np.diag(now.modal.omega**2), modes)
        of_contacts = _of_contacts(now, loads, borne)
        added = of_bodies + of_contacts + _of_stress(now, loads.stress)
        stiffness += modes.T @ added @ modes
        left = modes.T @ (borne - (structure.strain.stiffness + added) @ closing)
        try:
            step = closing + modes @ np.linalg.solve(stiffness, left)
        except np.linalg.LinAlgError:  # neutral there
            return None
        values = advanced(coordinates, step)
        now, coordinates, structure = moved_assembly(assembly, values)
        if np.abs(step * scale).max() <= CONVERGED * np.abs(values * scale).max():
            return now, coordinates, values, borne, of_contacts
    return None


def moved_assembly(assembly: Assembly, values: Array) -> tuple[Assembly, MovedCoordinates, Structure]:
    """Assemble a scene where its coordinates have given values, (n_all,); return coordinates and structure there too.

    Args:
        assembly: the assembly in the reference configuration.
        values: the values, see `displaced`.
    """
    coordinates = displaced(assembly.coordinates, values)
    constraints = assembly.constraints.moved_to(coordinates)
    tangents = tuple(one.moved_to(coordinates) for one in assembly.tangents)
    structure = Structure.of(coordinates, tangents)
    modal = ModalModel.of(constraints, structure, {})
    signals = Signals.of(coordinates, assembly.terms, tangents, PrescribedMotions.of(constraints, structure, modal))
    now = replace(assembly, coordinates=coordinates, constraints=constraints, tangents=tangents)
    return replace(now, modal=modal, signals=signals), coordinates, structure


def _present_stress(
    now: Assembly,
    values: Array,
    fields: Mapping[str, Array],
    loads: LoadedState,
) -> dict[str, BodyStress]:
    """Return the stress of bodies with the stiffness that it has in equilibrium; estimates stay as they are.

    The stress is that of the strains with which the bodies bear the loads there, see `LoadedState.elastic`. Those of
    the coordinates alone would include the shortening of a bent body, which has none of first order in the loads.
    """
    inner = InnerForces.of(now, loads.given.inputs)
    result, shapes = dict(loads.stress), stress_of_bodies(now, values, fields, inner)
    for name in result.keys() & shapes.keys():
        strain, deformed = now.scene.body(name).strain, deformation(now, name, values)
        assert strain is not None  # a flexible body
        place, straining = now.coordinates.slices[name], values.copy()
        straining[place] = loads.elastic(name, values[place])
        stressed = stress_of_bodies(now, straining, fields, inner)[name].stress
        terms, own = replace(shapes[name], stress=stressed), result[name]
        stiffness = terms.added_to(strain)
        held = own.held + (stiffness - own.stiffness) @ deformed
        rows = terms.strained_beside(strain) @ deformation_rows(now, name)
        beside = straining[place] - values[place] - rows @ values[place]
        result[name] = BodyStress(stiffness, held, np.column_stack([rows, beside]))
    return result


def _forces_beside_weights(now: Assembly, loads: LoadedState) -> Array:
    """Return the forces of constant inputs, springs and bodies on all coordinates, (n_all,)."""
    force = np.zeros(now.coordinates.size)
    for measure, push in applied_forces(now, loads.given.inputs):
        force += push * now.coordinates.jacobian(measure)[0]
    for tangent in now.tangents:
        value = tangent.law.measure.evaluate(now.coordinates.states)[0]
        force -= tangent.rows.T @ tangent.law.static_resistance(value)
    for name, place in now.coordinates.slices.items():
        state = now.coordinates.states[name]
        if state.body.strain is not None:
            deformed, deforms = state.own(np.eye(place.stop - place.start))
            resisting = state.body.strain.stiffness @ deformed
            if name in loads.stress:
                resisting = resisting + loads.stress[name].stiffness @ deformed - loads.stress[name].held
            force[place] -= deforms.T @ resisting
    return force


def _of_contacts(now: Assembly, loads: LoadedState, borne: Array) -> Array:
    """Return the stiffness that forces in joints and springs, and of constant inputs, add, (n_all, n_all)."""
    geometric = GeometricStiffness.of(now)
    result = geometric.at_rest(borne)
    for measure, push in applied_forces(now, loads.given.inputs):
        result += geometric.of_measure(measure, np.array([-push]))
    return result


def _of_stress(now: Assembly, stress: Mapping[str, BodyStress]) -> Array:
    """Return the stiffness of the stress in the bodies on all coordinates, (n_all, n_all)."""
    result = np.zeros((now.coordinates.size,) * 2)
    for name, own in stress.items():
        place = now.coordinates.slices[name]
        result[place, place] = on_deformation(now, name, own.stiffness)
    return result
