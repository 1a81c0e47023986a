"""Construction of a scene's Exudyn system: bodies, markers, joints, loads and sensors.

The system exists within one call of `simulate` or `static_response` only.
"""

from collections.abc import Mapping
from typing import Any

import exudyn as exu
import numpy as np

from nassim.base.checks import Array
from nassim.scene.terms import (
    AppliedForce,
    BaseAcceleration,
    Constraint,
    ForceLaw,
    Output,
    PrescribedMotion,
    SpringForce,
    Term,
)
from nassim.simulation.exudyn.bodies import add_bodies, add_stress_updates
from nassim.simulation.exudyn.circuits import AddedCircuit, add_circuit
from nassim.simulation.exudyn.general_items import NO_MATRIX, add_general_coil
from nassim.simulation.exudyn.input_channels import InputChannel
from nassim.simulation.exudyn.items import Items, add_base_acceleration, add_constraint, add_force
from nassim.simulation.exudyn.outputs import add_axes, add_output
from nassim.simulation.exudyn.running_system import StressChange, System
from nassim.simulation.exudyn.small_motion_system import small_motion_system
from nassim.simulation.exudyn.spring_forces import add_spring_force
from nassim.simulation.exudyn.springs import add_force_law
from nassim.simulation.exudyn.summands import Summand
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.capabilities import LARGE_MOTION, check_capabilities
from nassim.simulation.model.period_correction import Steps, correct_periods
from nassim.simulation.model.redundant_constraints import check_implied
from nassim.simulation.model.signals import Circuit

SPARSE = 3.2
"""Entries of the Jacobian over those that are not zero above which a sparse factorisation is faster.

It is measured: chains of 2 to 16 bars and of 5 to 30 rigid bodies, hexapods, the bench, by both modules of Exudyn.
"""


def build_system(
    assembly: Assembly,
    rates: Mapping[str, float] | None = None,
    steps: Steps | None = None,
    stress_changes: Mapping[str, StressChange] | None = None,
) -> System:
    """Build the Exudyn system of an assembled scene, with all inputs at zero.

    Args:
        assembly: the assembled scene.
        rates: initial rates of inputs that drives follow, see `initial_twists`.
        steps: steps whose period error is corrected; None: no correction.
        stress_changes: changes of the geometric stiffness of floating bodies during a run, by name, see
            `System.update_stress`; others keep that of the start.

    Returns:
        The system.

    Raises:
        ValueError: for joints and angular velocities that contradict each other, see
            `nassim.simulation.model.initial_velocities` and `redundant_constraints`.
    """
    if assembly.scene.in_small_motion and len(assembly.modal.mass):
        return small_motion_system(assembly, rates or {}, steps)
    check_capabilities(assembly.scene, LARGE_MOTION)
    size = len(assembly.modal.damping.root)
    assembly, added = correct_periods(assembly, steps) if steps else (assembly, np.zeros((size, size)))
    check_implied(assembly.scene, assembly.constraints.enforced)
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    items = add_bodies(mbs, assembly, rates, added)
    updates = add_stress_updates(items, assembly, stress_changes or {})
    channels: list[InputChannel] = []
    readings: dict[str, list[Summand]] = {output: [] for output in assembly.scene.outputs}
    rotating_axes: dict[str, list[tuple[int, Array]]] = {output: [] for output in assembly.scene.outputs}
    for term in assembly.terms:
        if isinstance(term, Output):
            readings[term.name] += add_output(items, term)
            rotating_axes[term.name] += add_axes(items, term)
        elif isinstance(term, SpringForce):
            readings[term.name] += add_spring_force(items, term)
        else:
            channels += _realise(items, term, assembly)
    circuits: list[AddedCircuit] = []
    for circuit in assembly.signals.circuits:
        found, more = _add_circuit(items, circuit, assembly)
        circuits += found
        channels += more
        for output, gain in circuit.outputs:
            readings[output] += [Summand.linear(one.sensor, np.array([gain * one.scale])) for one in found]
    mbs.Assemble()
    return System(
        container=container,
        mbs=mbs,
        assembly=assembly,
        nodes=dict(items.nodes),
        flexible=dict(items.flexible),
        channels=tuple(channels),
        readings=readings,
        massless={one.number: NO_MATRIX for one in circuits},
        circuits=[(one.node, 0, one.damping) for one in circuits],
        sparse=_is_sparse(mbs.systemData),
        rotating_axes=rotating_axes,
        evaluators=items.evaluators,
        bodies=items.body_nodes,
        carried=items.carried,
        stress_updates=updates,
        joints=items.joints,
        fixed_frames=_fixed_frames(items),
    )


def _fixed_frames(items: Items) -> dict[str, tuple[Array, Array]]:
    """Return rotation and position of the frames that the ground holds, see `System.fixed_frames`."""
    scene, result = items.scene, {}
    for body in scene.deformable_bodies:
        point = scene.frame_point(body)
        if point in items.grounded.get(body.name, ()):
            members = [body.name, *(name for name in items.carried if items.host(name) == body.name)]
            result.update(dict.fromkeys(members, (body.rotation, body.point_position(point))))
    return result


def _is_sparse(data: Any) -> bool:
    """Whether a sparse factorisation of the Jacobian is faster, by the coordinates that objects couple."""
    n = data.ODE2Size()
    coupled = np.zeros((n + data.AEsize(),) * 2, dtype=bool)
    for number in range(data.NumberOfObjects()):
        places = [*data.GetObjectLTGODE2(number), *(n + k for k in data.GetObjectLTGAE(number))]
        coupled[np.ix_(places, places)] = True
    coupled[n:, n:] = False
    return bool(coupled.size > SPARSE * np.count_nonzero(coupled))


def _realise(items: Items, term: Term, assembly: Assembly) -> list[InputChannel]:
    """Add a term and return the channels of its input.

    Shunts and coils are circuits of the assembly, filters are the assembly's, prescribed motions belong to their
    constraints.
    """
    if isinstance(term, Constraint):
        if assembly.constraints.enforced[term.name] and term.name not in items.rigid_joints:
            driven = [t for t in assembly.scene.terms_of(PrescribedMotion) if t.constraint == term.name]
            return add_constraint(items, term, assembly.constraints.enforced[term.name], driven)
    elif isinstance(term, ForceLaw):
        add_force_law(items, term)
    elif isinstance(term, AppliedForce):
        return add_force(items, term)
    elif isinstance(term, BaseAcceleration):
        return add_base_acceleration(items, term)
    return []


def _add_circuit(items: Items, circuit: Circuit, assembly: Assembly) -> tuple[list[AddedCircuit], list[InputChannel]]:
    """Add a circuit; return it, unless nothing that deforms has its port, and the channel of a coil's input."""
    if circuit.coil:
        added, channel = add_general_coil(items.mbs, items.evaluator(circuit.coil.measure), circuit.coil)
        return [added], [channel]
    forces = {name: circuit.forces[assembly.coordinates.slices[name]] for name in items.flexible}
    parts = [part for name, coordinates in items.flexible.items() for part in coordinates.parts(forces[name])]
    if not parts:
        return [], []
    row = np.concatenate([piece for _, piece in parts])
    return [add_circuit(items.mbs, circuit, [node for node, _ in parts], row)], []
