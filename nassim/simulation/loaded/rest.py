"""Small motion about a loaded equilibrium: joints, springs, inputs and outputs act where the bodies rest.

Bodies that loads have moved have other arms and directions than in the reference configuration. This changes a model in
first order in the loads, as their stiffness does. So the scene is assembled again where its bodies rest, with each body
moved as a rigid body. Its deformation there is left out: inside the body the geometric stiffness contains it, and arms
change by its share of the body's size.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.scene.bodies import FlexibleBody, RigidBody
from nassim.scene.terms import Constraint, ForceLaw
from nassim.simulation.loaded.geometric_stiffness import frames
from nassim.simulation.loaded.spinning import inertia_terms
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.effect_of_loads import LoadedState
from nassim.simulation.model.modal_model import ModalModel, Structure
from nassim.simulation.model.moved_coordinates import MovedCoordinates
from nassim.simulation.model.prescribed_motion import PrescribedMotions
from nassim.simulation.model.signals import Signals
from nassim.simulation.model.states import ReferenceState

UNCHANGED = 1e-5
"""Relative change of the rows of joints and springs below which the reference configuration serves."""


def moved_coordinates(coordinates: Coordinates, values: Array) -> MovedCoordinates:
    """Return the coordinates of a scene whose bodies are moved by given values, (n_all,), each as its frame moves."""
    scene, turned = coordinates.scene, np.eye(coordinates.size)
    states = {body.name: ReferenceState(body) for body in scene.bodies}
    for name, frame in frames(coordinates).items():
        body, place = scene.split(f"{name}.")[0], coordinates.slices[name]
        if not isinstance(body, (RigidBody, FlexibleBody)):
            continue  # its points move linearly with its coordinates
        motion = frame.motion @ values
        rotation = Rotation.from_rotvec(motion[3:]).as_matrix()
        position = frame.position + motion[:3] + rotation @ (body.position - frame.position)
        moved = replace(body, position=position, rotation=rotation @ body.rotation)
        states[name] = ReferenceState(moved, body)
        if isinstance(body, RigidBody):
            turned[place, place] = np.kron(np.eye(2), rotation)
    return MovedCoordinates(scene, coordinates.slices, coordinates.mass, states, turned)


def largest_change(coordinates: Coordinates, moved: Coordinates) -> float:
    """Return the largest relative change of the rows of joints and springs as the bodies move."""
    result = 0.0
    for term in coordinates.scene.terms:
        if isinstance(term, (ForceLaw, Constraint)) and not term.measure.within:
            before, after = (one.jacobian(term.measure) / coordinates.scale for one in (coordinates, moved))
            size = np.linalg.norm(before, axis=1)
            result = max(result, float(np.max(np.linalg.norm(after - before, axis=1)[size > 0] / size[size > 0], initial=0.0)))
    return result


def about_rest(assembly: Assembly, loads: LoadedState, velocity: Array) -> Assembly:
    """Assemble a scene about its equilibrium under loads.

    Modes that nothing holds keep the forces of the reference configuration.

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
    coordinates = moved_coordinates(start, displacement)
    if largest_change(start, coordinates) < UNCHANGED:
        return here
    constraints = assembly.constraints.moved_to(coordinates)
    tangents = tuple(replace(one, rows=coordinates.jacobian(one.law.measure)) for one in assembly.tangents)
    structure = Structure.of(coordinates, tangents)
    moved = ModalModel.of(constraints, structure, {})
    if not np.array_equal(moved.rigid_modes, modal.rigid_modes):
        return here
    weighted = start.mass @ moved.modes
    change = modal.modes.T @ weighted  # amplitudes of the modes in the reference configuration per unit of these
    moved = replace(moved, unsupported=modal.unsupported[np.argmax(np.abs(change), axis=0)])
    prescribed = PrescribedMotions.of(constraints, structure, moved)
    signals = Signals.of(coordinates, assembly.terms, tangents, prescribed)
    gyroscopic = moved.modes.T @ _coriolis(assembly, coordinates, velocity)
    stiffness = change.T @ loads.stiffness @ change
    amplitudes = weighted.T @ coordinates.turned.T @ displacement
    free = modal.rigid_modes
    force = stiffness @ amplitudes + (2 * np.pi * moved.frequency) ** 2 * amplitudes
    for circuit in signals.port_circuits:
        pull = moved.modes.T @ circuit.forces
        force -= pull * (pull @ amplitudes) / circuit.storage
    unheld = loads.force - loads.stiffness @ loads.equilibrium
    force[free] += change[np.ix_(free, free)].T @ unheld[free]
    state = LoadedState(
        gyroscopic @ moved.modes,
        stiffness,
        force,
        amplitudes,
        gyroscopic @ prescribed.motion,
        change.T @ loads.drive_stiffness,
        loads.inside,
        loads.carried,
        loads.inputs,
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


def _coriolis(assembly: Assembly, coordinates: MovedCoordinates, velocity: Array) -> Array:
    """Return the Coriolis matrix of all bodies, along axes that turn with them, (n_all, n_all)."""
    result, start = np.zeros((coordinates.size,) * 2), frames(assembly.coordinates)
    for name, place in coordinates.slices.items() if velocity.any() else ():
        body, moved = assembly.scene.split(f"{name}.")[0], coordinates.moved[name]
        along = moved.pose(body.point_names[0])[1].T @ velocity
        result[place, place] = inertia_terms(body, start[name], place, along, np.zeros(3)).coriolis
    return result
