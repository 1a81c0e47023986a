"""Small motion about a loaded equilibrium: the scene is assembled where its bodies are in equilibrium.

Bodies that loads have moved have other arms and directions than in the reference configuration, and deformed ones
another inertia. This changes a model in first order in the loads, as their stiffness does. The model is exact for rigid
bodies, joints and springs, at rest and in a spin. The stress inside flexible bodies is of first order.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import skew
from nassim.base.warning_log import warn
from nassim.scene.bodies import FlexibleBody
from nassim.scene.terms import CoilForce, Output, Shunt, SpringForce
from nassim.simulation.loaded.settling import newton_equilibrium
from nassim.simulation.loaded.spinning import integrals
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.displacement import deformed_pairs, displaced, motion_of_frames
from nassim.simulation.model.effect_of_loads import LoadedState
from nassim.simulation.model.modal_model import ModalModel
from nassim.simulation.model.signals import Signals
from nassim.simulation.model.states import FrameState
from nassim.simulation.model.tangents import Tangent, check_resistance

UNCHANGED = 1e-5
"""Rotation of bodies [rad], and displacement over the scene's size, below which the reference configuration serves."""


def about_equilibrium(assembly: Assembly, loads: LoadedState) -> Assembly:
    """Assemble a scene about its equilibrium under loads.

    Amplitudes are counted from the reference configuration.

    Args:
        assembly: the assembly in the reference configuration.
        loads: effect of the loads there.

    Returns:
        The assembly about the equilibrium, with the effect of the loads; the given one with it where bodies move by
        less than `UNCHANGED`, and where motions are free without loads: these are often neutral, which a model of
        second order in part would not be.

    Raises:
        ValueError: for a nonlinear spring that pushes away from the equilibrium.

    Warns:
        UserWarning: where no equilibrium is found near that of first order; the model is then about the reference
            configuration.
    """
    start, displacement = assembly.coordinates, assembly.modal.modes @ loads.equilibrium
    moved = motion_of_frames(start, displaced(start, displacement))
    if loads.on_all is None or moved < UNCHANGED or np.any(assembly.modal.rigid_modes):
        return assembly.under(loads)
    there = newton_equilibrium(assembly, loads)
    if there is None:
        warn(
            f"scene {assembly.scene.name!r}: Newton's iterations find no equilibrium near that of first order, where "
            f"bodies move by {moved:.2g} rad, or of the scene's size; the model is about the reference configuration"
        )
        return assembly.under(loads)
    check_resistance(there.assembly.tangents)
    loads = replace(loads, stress=there.stress)
    now = there.assembly.under(loads)
    modal, tangents, coordinates = now.modal, now.tangents, now.coordinates
    modes = modal.modes
    before = assembly.modal.modes.T @ start.mass @ modes  # the earlier modes per unit of these
    modal = replace(modal, unsupported=assembly.modal.unsupported[np.argmax(np.abs(before), axis=0)])
    amplitudes = modes.T @ coordinates.mass @ there.values
    rest = modes @ amplitudes
    elongations = [one.law.measure.evaluate(coordinates.states)[0] for one in tangents]
    tangents = tuple(
        replace(one, offset=value - one.rows @ rest) for one, value in zip(tangents, elongations, strict=True)
    )
    stiffness, gyroscopic = modes.T @ there.added @ modes, modes.T @ _coriolis(coordinates, loads.given.velocity)
    motion = now.signals.prescribed.motion
    state = replace(
        loads,
        gyroscopic=gyroscopic @ modes,
        stiffness=stiffness,
        force=stiffness @ amplitudes + _holding_forces(modal, now.signals, tangents, amplitudes),
        equilibrium=amplitudes,
        drive_damping=gyroscopic @ motion,
        drive_stiffness=modes.T @ there.added @ motion,
        on_all=there.added,
        offset=there.values - rest,
        output_offsets=_outputs_at_rest(now) - _outputs_of(now, rest),
    )
    return replace(now, tangents=tangents, modal=modal, loads=state)


def _outputs_at_rest(assembly: Assembly) -> Array:
    """Return outputs before their filters where the bodies are, without currents and inputs, (outputs,)."""
    scene, states = assembly.scene, assembly.coordinates.states
    result, charges = np.zeros(len(scene.outputs)), []
    for term in assembly.terms:
        if isinstance(term, Output) and term.derivative == 0:
            result[scene.outputs.index(term.name)] += term.gain * term.measure.evaluate(states)[0][0]
        elif isinstance(term, SpringForce):
            value = term.spring.measure.evaluate(states)[0]
            force = term.spring.static_resistance(value)
            result[scene.outputs.index(term.name)] += force[term.spring.measure.components.index(term.component)]
        elif isinstance(term, Shunt | CoilForce):
            factor = term.force_constant if isinstance(term, CoilForce) else 1.0
            charges.append(factor * float(term.measure.evaluate(states)[0][0]))
    return result + _outputs_of_charges(assembly, charges)


def _outputs_of(assembly: Assembly, values: Array) -> Array:
    """Return what outputs read of values of all coordinates, (n_all,), without their constant part, (outputs,)."""
    signals = assembly.signals
    read: Array = signals.output_matrix @ values
    return read + _outputs_of_charges(assembly, [float(one.forces @ values) for one in signals.circuits])


def _outputs_of_charges(assembly: Assembly, charges: Sequence[float]) -> Array:
    """Return what outputs read of the charges of ports and the flux linkages of coils, (outputs,)."""
    result = np.zeros(len(assembly.scene.outputs))
    for circuit, charge in zip(assembly.signals.circuits, charges, strict=True):
        for output, gain in circuit.outputs:
            result[assembly.scene.outputs.index(output)] += gain * charge / circuit.storage
    return result


def _holding_forces(modal: ModalModel, signals: Signals, tangents: Sequence[Tangent], amplitudes: Array) -> Array:
    """Return the forces on the modes that hold given amplitudes, (n,), with discharged ports and without loads."""
    modes, force = modal.modes, modal.omega**2 * amplitudes
    for circuit in signals.port_circuits:
        pull = modes.T @ circuit.forces
        force -= pull * (pull @ amplitudes) / circuit.storage
    for tangent in tangents:
        if not tangent.law.is_linear:
            value = tangent.rows @ modes @ amplitudes
            resistance = tangent.law.static_resistance(value + tangent.offset)
            force -= modes.T @ tangent.rows.T @ (tangent.stiffness @ value - resistance)
    return force


def _coriolis(coordinates: Coordinates, velocity: Array) -> Array:
    """Return the Coriolis matrix of bodies at rest in a rotating frame, (n_all, n_all)."""
    result = np.zeros((coordinates.size,) * 2)
    for name, place in coordinates.slices.items() if velocity.any() else ():
        state = coordinates.states[name]
        assert isinstance(state, FrameState)  # the centrifugal forces of other bodies are not known
        body, along = state.body, state.rotation.T @ velocity
        if isinstance(body, FlexibleBody) and state.deformed is not None:
            pairs, along = deformed_pairs(coordinates.scene, body, state.deformed), body.rotation.T @ along
        else:
            pairs = integrals(body)[2][4:, 4:].reshape(6, 3, 6, 3)
        result[place, place] = 2 * np.einsum("jakb,ab->jk", pairs, skew(along))
    return result
