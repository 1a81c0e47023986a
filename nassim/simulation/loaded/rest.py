"""Small motion about a loaded equilibrium: joints, springs, inputs and outputs act where the bodies rest.

Bodies that loads have moved have other arms and directions than in the reference configuration. This changes a model in
first order in the loads, as their stiffness does. So the scene is assembled again where its bodies rest, with each body
moved as a rigid body. Its deformation there is left out: inside the body the geometric stiffness contains it, and arms
change by its share of the body's size.
"""

from dataclasses import replace

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import skew
from nassim.scene.bodies import FlexibleBody
from nassim.simulation.loaded.spinning import integrals
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.effect_of_loads import LoadedState
from nassim.simulation.model.modal_model import ModalModel, Structure
from nassim.simulation.model.moved_coordinates import (
    MovedCoordinates,
    deformed_pairs,
    displaced,
    largest_change,
)
from nassim.simulation.model.prescribed_motion import PrescribedMotions
from nassim.simulation.model.signals import Signals
from nassim.simulation.model.states import FrameState

UNCHANGED = 1e-5
"""Relative change of the rows of joints and springs below which the reference configuration serves."""


def about_rest(assembly: Assembly, loads: LoadedState, velocity: Array) -> Assembly:
    """Assemble a scene about its equilibrium under loads.

    The equilibrium stays that of first order: outputs there, and displacements, are as in the reference configuration.
    Modes that nothing holds keep their forces from there too.

    Args:
        assembly: the assembly in the reference configuration.
        loads: effect of the loads there.
        velocity: angular velocity with which the whole scene rotates, (3,) [rad/s].

    Returns:
        The assembly about the equilibrium, with the effect of the loads; the given one with it where the equilibrium
        changes no row of a joint or spring by more than `UNCHANGED`, and where other motions are free there.
    """
    here, modal, start = replace(assembly, loads=loads), assembly.modal, assembly.coordinates
    displacement = modal.modes @ loads.equilibrium
    coordinates = displaced(start, displacement)
    if largest_change(start, coordinates) < UNCHANGED:
        return here
    constraints = assembly.constraints.moved_to(coordinates)
    tangents = tuple(replace(one, rows=coordinates.jacobian(one.law.measure)) for one in assembly.tangents)
    structure = Structure.of(coordinates, tangents)
    always = {body.name: np.inf for body in assembly.scene.flexible_bodies}
    moved = ModalModel.of(constraints, structure, always)
    if not np.array_equal(moved.rigid_modes, modal.rigid_modes):
        return here
    modes = moved.modes
    change = modal.modes.T @ start.mass @ modes  # amplitudes of the earlier modes per unit of these
    moved = replace(moved, unsupported=modal.unsupported[np.argmax(np.abs(change), axis=0)])
    prescribed = PrescribedMotions.of(constraints, structure, moved)
    signals = Signals.of(coordinates, assembly.terms, tangents, prescribed)
    amplitudes = modes.T @ coordinates.mass @ displacement
    rest = modes @ amplitudes
    tangents = tuple(
        replace(now, offset=before.rows @ displacement - now.rows @ rest)
        for before, now in zip(assembly.tangents, tangents, strict=True)
    )
    gyroscopic, stiffness = modes.T @ _coriolis(coordinates, velocity), change.T @ loads.stiffness @ change
    force, free = stiffness @ amplitudes + (2 * np.pi * moved.frequency) ** 2 * amplitudes, modal.rigid_modes
    for circuit in signals.port_circuits:
        pull = modes.T @ circuit.forces
        force -= pull * (pull @ amplitudes) / circuit.storage
    for tangent in tangents:
        if not tangent.law.is_linear:
            value = tangent.rows @ rest
            resistance = tangent.law.resistance(value + tangent.offset, np.zeros(len(value)))
            force -= modes.T @ tangent.rows.T @ (tangent.stiffness @ value - resistance)
    unheld = loads.force - loads.stiffness @ loads.equilibrium
    force[free] += change[np.ix_(free, free)].T @ unheld[free]
    state = replace(
        loads,
        gyroscopic=gyroscopic @ modes,
        stiffness=stiffness,
        force=force,
        equilibrium=amplitudes,
        drive_damping=gyroscopic @ prescribed.motion,
        drive_stiffness=change.T @ loads.drive_stiffness,
        offset=displacement - rest,
        output_offsets=assembly.signals.output_matrix @ displacement - signals.output_matrix @ rest,
    )
    return replace(
        assembly,
        coordinates=coordinates,
        constraints=constraints,
        tangents=tangents,
        modal=moved,
        signals=signals,
        loads=state,
    )


def _coriolis(coordinates: MovedCoordinates, velocity: Array) -> Array:
    """Return the Coriolis matrix of all bodies at rest in a rotating frame, (n_all, n_all)."""
    result = np.zeros((coordinates.size,) * 2)
    for name, place in coordinates.slices.items() if velocity.any() else ():
        state = coordinates.moved[name]
        assert isinstance(state, FrameState)  # other bodies have no centrifugal forces
        body, along = state.body, state.rotation.T @ velocity
        if isinstance(body, FlexibleBody):
            index = body.reduced.point_names.index(coordinates.scene.frame_point(body))
            assert state.deformed is not None
            pairs, along = deformed_pairs(body.reduced, index, state.deformed), body.rotation.T @ along
        else:
            pairs = integrals(body)[2][4:, 4:].reshape(6, 3, 6, 3)
        result[place, place] = 2 * np.einsum("jakb,ab->jk", pairs, skew(along))
    return result
