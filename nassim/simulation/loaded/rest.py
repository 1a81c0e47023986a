"""Small motion about a loaded equilibrium: the scene is assembled where its bodies rest.

Bodies that loads have moved have other arms and directions than in the reference configuration, and deformed ones
another inertia. This changes a model in first order in the loads, as their stiffness does. At rest, the model is exact
for rigid bodies, joints and springs. In a spin, what is left out is of second order, about the square of the bodies'
rotations. The stress inside flexible bodies is of first order.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import skew
from nassim.scene.bodies import FlexibleBody
from nassim.scene.terms import CoilForce, Output, Shunt, SpringForce
from nassim.simulation.loaded.geometric_stiffness import GeometricStiffness, frames
from nassim.simulation.loaded.spinning import body_loads, integrals
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.constraints import Constraints
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.displacement import advanced, deformed_pairs, displaced, motion_of_frames
from nassim.simulation.model.effect_of_loads import LoadedState
from nassim.simulation.model.modal_model import ModalModel, Structure
from nassim.simulation.model.moved_coordinates import MovedCoordinates
from nassim.simulation.model.prescribed_motion import PrescribedMotions
from nassim.simulation.model.signals import Signals
from nassim.simulation.model.states import FrameState
from nassim.simulation.model.tangents import Tangent

UNCHANGED = 1e-5
"""Rotation of bodies [rad], and displacement over the scene's size, below which the reference configuration serves."""
ITERATIONS, SETTLED = 12, 1e-7
"""Newton's iterations, and the relative size of their last step."""


@dataclass(frozen=True)
class SteadyLoads:
    """Constant loads of a scene beside its inputs, along the axes in which it is described.

    Attributes:
        gravity: gravity, (3,) [m/s2].
        velocity: angular velocity with which the whole scene rotates, (3,) [rad/s].
        axis_point: a point of the axis, (3,) [m].
    """

    gravity: Array
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    axis_point: Array = field(default_factory=lambda: np.zeros(3))

    def on_bodies(self, moved: MovedCoordinates) -> tuple[Array, Array, dict[str, Array]]:
        """Compute weights and centrifugal forces of bodies that have moved, see `body_loads`."""
        still = frames(Coordinates(moved.scene, moved.slices, moved.mass))
        return body_loads(moved, still, self.gravity, self.velocity, self.axis_point)


def about_rest(assembly: Assembly, loads: LoadedState, steady: SteadyLoads) -> Assembly:
    """Assemble a scene about its equilibrium under loads.

    Amplitudes are counted from the reference configuration. Outputs at rest are exact for rigid bodies where Newton's
    iterations have found the equilibrium, and otherwise of first order in the displacement.

    Args:
        assembly: the assembly in the reference configuration.
        loads: effect of the loads there.
        steady: gravity and spin among the loads.

    Returns:
        The assembly about the equilibrium, with the effect of the loads; the given one with it where bodies move by
        less than `UNCHANGED`, and where motions are free without loads: these are often neutral, which a model of
        second order in part would not be.
    """
    assembly = assembly.under(loads)
    added, of_contacts = loads.on_all, loads.of_contacts
    displacement = assembly.modal.modes @ loads.equilibrium
    coordinates = displaced(assembly.coordinates, displacement)
    moved = motion_of_frames(assembly.coordinates, coordinates)
    if added is None or of_contacts is None or moved < UNCHANGED or np.any(assembly.modal.rigid_modes):
        return assembly
    settled = settled_rest(assembly, loads, steady)
    elongations = [one.rows @ displacement for one in assembly.tangents]
    if settled:
        coordinates, displacement = settled.coordinates, settled.values
        elongations = [one.law.measure.evaluate(coordinates.states)[0] for one in assembly.tangents]
    constraints, tangents, structure, modal = _structure_at(assembly, coordinates)
    if settled:
        now = replace(assembly, coordinates=coordinates, constraints=constraints, tangents=tangents)
        still = displaced(assembly.coordinates, np.zeros(coordinates.size))
        before, after = (steady.on_bodies(one)[1] for one in (still, coordinates))
        added = added - of_contacts - before + after + GeometricStiffness.of(now).at_rest(settled.borne)
    modes = modal.modes
    before = assembly.modal.modes.T @ assembly.coordinates.mass @ modes  # the earlier modes per unit of these
    modal = replace(modal, unsupported=assembly.modal.unsupported[np.argmax(np.abs(before), axis=0)])
    prescribed = PrescribedMotions.of(constraints, structure, modal)
    signals = Signals.of(coordinates, assembly.terms, tangents, prescribed)
    amplitudes = modes.T @ coordinates.mass @ displacement
    rest = modes @ amplitudes
    tangents = tuple(
        replace(one, offset=value - one.rows @ rest) for one, value in zip(tangents, elongations, strict=True)
    )
    stiffness, gyroscopic = modes.T @ added @ modes, modes.T @ _coriolis(coordinates, steady.velocity)
    force = stiffness @ amplitudes + _holding_forces(modal, signals, tangents, amplitudes)
    state = replace(
        loads,
        gyroscopic=gyroscopic @ modes,
        stiffness=stiffness,
        force=force,
        equilibrium=amplitudes,
        drive_damping=gyroscopic @ prescribed.motion,
        drive_stiffness=modes.T @ added @ prescribed.motion,
        offset=displacement - rest,
        output_offsets=_outputs_at_rest(assembly, displacement, coordinates if settled else None)
        - _outputs_at_rest(replace(assembly, signals=signals), rest)
        + signals.offsets,
    )
    return replace(
        assembly,
        coordinates=coordinates,
        constraints=constraints,
        tangents=tangents,
        modal=modal,
        signals=signals,
        loads=state,
    )


def _outputs_at_rest(assembly: Assembly, values: Array, coordinates: Coordinates | None = None) -> Array:
    """Return outputs at rest before their filters, without currents and inputs, (outputs,).

    Args:
        assembly: the assembly whose signals read the outputs.
        values: values of all coordinates, (n_all,), of which the outputs are linear functions.
        coordinates: coordinates in the configuration of these values, where the outputs are exact; None: linear.
    """
    scene, signals = assembly.scene, assembly.signals
    result = signals.offsets + signals.output_matrix @ values
    charges = [circuit.forces @ values for circuit in signals.circuits]
    if coordinates is not None:
        states, result = coordinates.states, np.zeros(len(scene.outputs))
        for term in assembly.terms:
            if isinstance(term, Output) and term.derivative == 0:
                result[scene.outputs.index(term.name)] += term.gain * term.measure.evaluate(states)[0][0]
            elif isinstance(term, SpringForce):
                value = term.spring.measure.evaluate(states)[0]
                force = term.spring.resistance(value, np.zeros(len(value)))
                result[scene.outputs.index(term.name)] += force[term.spring.measure.components.index(term.component)]
        sources = [term for term in assembly.terms if isinstance(term, Shunt | CoilForce)]
        charges = [
            (term.force_constant if isinstance(term, CoilForce) else 1.0) * term.measure.evaluate(states)[0][0]
            for term in sources
        ]
    for circuit, charge in zip(signals.circuits, charges, strict=True):
        for output, gain in circuit.outputs:
            result[scene.outputs.index(output)] += gain * charge / circuit.storage
    return result


def _holding_forces(modal: ModalModel, signals: Signals, tangents: Sequence[Tangent], amplitudes: Array) -> Array:
    """Return the forces on the modes that hold given amplitudes, (n,), with discharged ports and without loads."""
    modes, force = modal.modes, (2 * np.pi * modal.frequency) ** 2 * amplitudes
    for circuit in signals.port_circuits:
        pull = modes.T @ circuit.forces
        force -= pull * (pull @ amplitudes) / circuit.storage
    for tangent in tangents:
        if not tangent.law.is_linear:
            value = tangent.rows @ modes @ amplitudes
            resistance = tangent.law.resistance(value + tangent.offset, np.zeros(len(value)))
            force -= modes.T @ tangent.rows.T @ (tangent.stiffness @ value - resistance)
    return force


def _structure_at(
    assembly: Assembly, coordinates: MovedCoordinates
) -> tuple[Constraints, tuple[Tangent, ...], Structure, ModalModel]:
    """Return constraints, tangents, structure and modes of an assembled scene in another configuration."""
    constraints = assembly.constraints.moved_to(coordinates)
    tangents = tuple(replace(one, rows=coordinates.jacobian(one.law.measure)) for one in assembly.tangents)
    structure = Structure.of(coordinates, tangents)
    always = {body.name: np.inf for body in assembly.scene.flexible_bodies}
    return constraints, tangents, structure, ModalModel.of(constraints, structure, always)


@dataclass(frozen=True)
class SettledRest:
    """A scene in equilibrium at rest.

    Attributes:
        coordinates: coordinates about the equilibrium.
        values: values of all coordinates of the reference configuration there, see `displaced`, (n_all,).
        borne: forces that constraints bear there, along the axes of `coordinates`, (n_all,).
        constraints: the constraints there.
    """

    coordinates: MovedCoordinates
    values: Array
    borne: Array
    constraints: Constraints


def settled_rest(assembly: Assembly, loads: LoadedState, steady: SteadyLoads) -> SettledRest | None:
    """Find the equilibrium at rest, or in the rotating frame, by Newton's iterations.

    Bodies move with their frames, joints and springs turn. The stress inside bodies is of first order in the loads.

    Args:
        assembly: the assembly in the reference configuration.
        loads: effect of the loads there.
        steady: gravity and spin among the loads.

    Returns:
        The equilibrium; None where the iterations do not settle.
    """
    start = assembly.coordinates
    given = np.array([loads.constant_input(name) for name in assembly.scene.inputs])
    values = assembly.modal.modes @ loads.equilibrium
    coordinates = displaced(start, values)
    nothing = np.zeros((start.size,) * 2)
    of_bodies = nothing if loads.on_all is None or loads.of_contacts is None else loads.on_all - loads.of_contacts
    for _ in range(ITERATIONS):
        constraints, tangents, structure, modal = _structure_at(assembly, coordinates)
        prescribed = PrescribedMotions.of(constraints, structure, modal)
        signals = Signals.of(coordinates, assembly.terms, tangents, prescribed)
        force = steady.on_bodies(coordinates)[0] + signals.forces_at_rest @ given
        for tangent in tangents:
            value = tangent.law.measure.evaluate(coordinates.states)[0]
            force -= tangent.rows.T @ tangent.law.resistance(value, np.zeros(len(value)))
        for name, place in start.slices.items():
            state = coordinates.moved[name]
            if state.body.strain is not None:
                deformed, deforms = state.own(np.eye(place.stop - place.start))
                resisting = state.body.strain.stiffness @ deformed
                if name in loads.inside:
                    resisting += loads.inside[name] @ deformed - loads.held[name]
                force[place] -= deforms.T @ resisting
        closing, modes = constraints.closing(), modal.modes
        now = replace(assembly, coordinates=coordinates, constraints=constraints, tangents=tangents)
        added = of_bodies + GeometricStiffness.of(now).at_rest(force)
        stiffness = np.diag((2 * np.pi * modal.frequency) ** 2) + modes.T @ added @ modes
        for circuit in signals.port_circuits:
            force += circuit.forces * (circuit.forces @ values) / circuit.storage
            stiffness -= np.outer(modes.T @ circuit.forces, modes.T @ circuit.forces) / circuit.storage
        left = modes.T @ (force - (structure.strain.stiffness + added) @ closing)
        step = closing + modes @ np.linalg.solve(stiffness, left)
        values = advanced(coordinates, step)
        coordinates = displaced(start, values)
        if np.abs(step * start.scale).max() < SETTLED * np.abs(values * start.scale).max():
            return SettledRest(coordinates, values, force, constraints.moved_to(coordinates))
    return None


def _coriolis(coordinates: MovedCoordinates, velocity: Array) -> Array:
    """Return the Coriolis matrix of bodies at rest in a rotating frame, (n_all, n_all)."""
    result = np.zeros((coordinates.size,) * 2)
    for name, place in coordinates.slices.items() if velocity.any() else ():
        state = coordinates.moved[name]
        assert isinstance(state, FrameState)  # the centrifugal forces of other bodies are not known
        body, along = state.body, state.rotation.T @ velocity
        if isinstance(body, FlexibleBody) and state.deformed is not None:
            pairs, along = deformed_pairs(coordinates.scene, body, state.deformed), body.rotation.T @ along
        else:
            pairs = integrals(body)[2][4:, 4:].reshape(6, 3, 6, 3)
        result[place, place] = 2 * np.einsum("jakb,ab->jk", pairs, skew(along))
    return result
