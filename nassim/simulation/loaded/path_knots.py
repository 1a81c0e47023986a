"""The scene at one angle of a path: its assembly, damping, and static displacements under loads and inertia."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import rotated_motion
from nassim.scene.bodies import RigidBody
from nassim.scene.measures import ROTATION_STEP
from nassim.scene.terms import Constraint, ForceLaw
from nassim.simulation.loaded.first_order_equilibrium import check_small
from nassim.simulation.loaded.path_loads import PathLoads
from nassim.simulation.loaded.rotor_frame import FrameView, RotorPartition
from nassim.simulation.loaded.rotor_stator import label_of, term_rows
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.constraints import Constraints
from nassim.simulation.model.damping import damps
from nassim.simulation.model.modal_model import ModalModel, Structure
from nassim.simulation.model.moved_coordinates import DrivenCoordinates
from nassim.simulation.model.prescribed_motion import PrescribedMotions, cleared
from nassim.simulation.model.signals import Signals
from nassim.simulation.model.tangents import law_tangents
from nassim.simulation.model.ties import Tie

ROUNDING = 1e3
"""Times that a part of a mode in a signal must exceed `MODE_ROUNDING`: constraints of turned joints have more of it."""
ROUNDED_SLOPE = 1e-9
"""Share of its rows up to which their change with the angle, per radian, is rounding."""
PULLS = 1e-7
"""Share of its largest part on a mode that a force along the path may have by rounding."""

Parts = tuple[Array, ...]
"""Matrices of a model, see `PathKnot.parts`."""


@dataclass(frozen=True)
class PathKnot:
    """The scene at one angle of the path.

    Attributes:
        assembly: assembly there; its coordinates turn with the rotor, the drive of the path has no effect on it.
        damping: damping matrix of all coordinates, (n_all, n_all).
        rotating_damping: stiffness by dampers whose rows on turning coordinates change with the angle, per unit of
            speed, (n_all, n_all), not symmetric.
        bent: static displacements under gravity and constant inputs, and under the inertia of the path per square of
            its speed and per acceleration, (3, n_all).
        at_start: stiffness of the loads at the start on the modal amplitudes, (n, n).
        read: what constant inputs add to the outputs at once, (outputs,).
    """

    assembly: Assembly
    damping: Array
    rotating_damping: Array
    bent: Array
    at_start: Array
    read: Array

    @property
    def modes(self) -> Array:
        """Modes B in all coordinates, (n_all, n)."""
        return self.assembly.modal.modes

    @property
    def bent_readings(self) -> Array:
        """Readings of the static displacements and of constant inputs by the outputs, (3, outputs)."""
        signals, outputs = self.assembly.signals, self.assembly.scene.outputs
        result = self.bent @ signals.output_matrix.T
        result[0] += self.read
        for circuit in signals.circuits:
            charges = self.bent @ circuit.forces / circuit.storage
            for output, gain in circuit.outputs:
                result[:, outputs.index(output)] += gain * charges
        return result

    @cached_property
    def stiffness(self) -> Array:
        """Stiffness of the modal amplitudes at rest, with charges that stay, (n, n)."""
        return np.diag(self.assembly.modal.omega**2) + self.at_start

    def parts(self, loads: PathLoads) -> Parts:
        """Return stiffness and damping (n, n), readings (outputs, n) and forces (n, inputs + 3) in modal amplitudes.

        Readings are those of displacements, velocities and accelerations alike; the last forces are the inertia of the
        path per square of its speed and per acceleration, and the weight at the start, which turns with the rotor here.
        """
        signals, modes, scale = self.assembly.signals, self.modes, self.assembly.coordinates.scale[:, None]
        through = [amplifier.forces[:, None] for amplifier in signals.amplifiers]
        own = np.column_stack([loads.of_speed[1], loads.of_acceleration[1], loads.weight])
        given = np.hstack([signals.input_matrix, *through, own])
        read = signals.output_matrix + signals.velocity_matrix + signals.acceleration_matrix
        return (
            self.stiffness,
            self.assembly.modal.damping.of_modes,
            cleared(read @ modes, ROUNDING * np.linalg.norm(read.T / scale, axis=0)[:, None]),
            cleared(modes.T @ given, ROUNDING * np.linalg.norm(given / scale, axis=0)),
        )


def make_knot(
    assembly: Assembly,
    partition: RotorPartition,
    drive: int,
    loads: PathLoads,
    angle: float,
    constant_inputs: Mapping[str, float],
) -> PathKnot:
    """Make the model at an angle of the path.

    Args:
        assembly: the assembled scene.
        partition: the rotor, with unit speed about the axis of the drive in the stator's frame, and the stator.
        drive: index of the drive among those that follow inputs.
        loads: inertia of the rotor along the path.
        angle: the angle [rad].
        constant_inputs: constant values of inputs, by name.

    Returns:
        The model.

    Raises:
        ValueError: for a singular or unstable position, motions that nothing holds, and parts that resist the path.
    """
    scene, path = assembly.scene, assembly.scene.prescribed[drive]
    where = f'method "exact": at {angle:.4g} rad of the path of drive {path.input!r}, scene {scene.name!r}'
    now = _assembly_at(assembly, partition, drive, angle, where)
    for term in scene.terms:
        if isinstance(term, Tie):
            _check_free(term, now, loads.rotation, where)
    at_start = now.modal.modes.T @ loads.at_start @ now.modal.modes
    bent = _static_displacements(now, loads, at_start, constant_inputs, where)
    check_small(now.coordinates, bent[0], "its loads")
    damping = Structure.of(now.coordinates, now.tangents).damping_forces(np.eye(now.coordinates.size))
    given = [constant_inputs.get(name, 0.0) for name in scene.inputs]
    rotating_damping = _rotating_damping(assembly, partition, angle)
    return PathKnot(now, damping, rotating_damping, bent, at_start, now.signals.feedthrough_at_rest @ given)


def _rotating_damping(assembly: Assembly, partition: RotorPartition, angle: float) -> Array:
    """Return the rotating damping of a `PathKnot` at an angle [rad].

    A damper with the rows w(angle) on turning coordinates x resists w x' + speed w' x, for example between a rotor and
    the bearing's seat, across the axis.
    """
    view = FrameView(assembly, partition)
    result = np.zeros((assembly.coordinates.size,) * 2)
    dampers = [law for law in assembly.terms if isinstance(law, ForceLaw) and damps(law)]
    if not dampers:
        return result
    angles = angle + ROTATION_STEP * np.array([0, -2, -1, 1, 2])
    for law in dampers:
        rows, *beside = (turning_rows(view, law, now) for now in angles)
        slope = np.tensordot([1, -8, 8, -1], beside, 1) / (12 * ROTATION_STEP)
        if np.abs(slope / view.scale).max() > ROUNDED_SLOPE * np.abs(rows / view.scale).max():
            still = np.zeros(len(rows))
            result += rows.T @ law.tangents(still, still)[1] @ slope
    return result


def turning_rows(view: FrameView, law: ForceLaw, angle: float) -> Array:
    """Return the rows of a force law at an angle [rad] on coordinates that turn with the rotor, (m, n_all)."""
    rows = term_rows(view.assembly.coordinates, law, view.states(angle))
    return rows @ _turned(view.assembly, view.partition, angle)


def _turned(assembly: Assembly, partition: RotorPartition, angle: float) -> Array:
    """Return coordinates along the world's axes per unit of those that turn with the rotor, (n_all, n_all)."""
    turned, rotation = np.eye(assembly.coordinates.size), rotated_motion(partition.rotation_at(angle))
    for name, place in assembly.coordinates.slices.items():
        if name not in partition.stator and isinstance(assembly.scene.body(name), RigidBody):
            turned[place, place] = rotation
    return turned


def _assembly_at(assembly: Assembly, partition: RotorPartition, drive: int, angle: float, where: str) -> Assembly:
    """Assemble the scene at an angle [rad], where the drive of the path has no effect.

    Arguments are those of `make_knot`; where: beginning of a message.
    """
    scene, start = assembly.scene, assembly.coordinates
    path = scene.prescribed[drive]
    joint = scene.constraints[path.constraint]
    turned = _turned(assembly, partition, angle)
    states = FrameView(assembly, partition).states(angle)
    coordinates = DrivenCoordinates(scene, start.slices, start.mass, states, turned, joint, path.component)
    constraints = Constraints.of(coordinates)
    tangents = law_tangents(coordinates, assembly.terms, constraints.basis)
    structure = Structure.of(coordinates, tangents)
    valid = {body.name: body.reduced.valid_frequency for body in scene.flexible_bodies}
    modal = ModalModel.of(constraints, structure, valid)
    if modal.modes.shape != assembly.modal.modes.shape:
        raise ValueError(f"{where} is in a singular position: joints leave other motions than at the start")
    if np.any(modal.rigid_modes):
        raise ValueError(f"{where} has a motion that nothing holds: add a spring or a joint, or take generalized_alpha")
    own = assembly.modal.damping.of_deformation.own
    modal = replace(modal, damping=replace(modal.damping, ratio=np.zeros(len(modal.frequency)), own=own))
    others = [k for k in range(len(scene.prescribed)) if k != drive]
    prescribed = PrescribedMotions.of(constraints, structure, modal).chosen(others)
    signals = Signals.of(coordinates, assembly.terms, tangents, prescribed)
    return replace(
        assembly,
        coordinates=coordinates,
        constraints=constraints,
        tangents=tuple(tangents),
        modal=modal,
        signals=signals,
    )


def _static_displacements(
    now: Assembly, loads: PathLoads, at_start: Array, constant_inputs: Mapping[str, float], where: str
) -> Array:
    """Return the static displacements of a `PathKnot`, (3, n_all), once charges have flowed.

    Args:
        now: the assembly at the angle.
        loads: inertia of the rotor along the path.
        at_start: stiffness of the loads at the start on the modal amplitudes, (n, n).
        constant_inputs: constant values of inputs, by name.
        where: beginning of a message.
    """
    signals, modes = now.signals, now.modal.modes
    given = np.array([constant_inputs.get(name, 0.0) for name in now.scene.inputs])
    force = signals.weight + signals.input_matrix @ given
    for amplifier in signals.amplifiers:
        force = force + amplifier.forces * given[amplifier.input]
    stiffness = signals.discharged(np.diag(now.modal.omega**2) + at_start, modes)
    if np.linalg.eigvalsh(0.5 * (stiffness + stiffness.T))[0] <= 0:
        raise ValueError(f"{where} is unstable under its loads: take generalized_alpha, or another path")
    forces = np.column_stack([force, loads.of_speed[1], loads.of_acceleration[1]])
    return (modes @ np.linalg.solve(stiffness, modes.T @ forces)).T


def _check_free(term: Tie, now: Assembly, rotation: Array, where: str) -> None:
    """Refuse a joint or a spring that resists the path with forces that move something."""
    assert isinstance(now.coordinates, DrivenCoordinates)
    rows, modes = term_rows(now.coordinates, term), now.modal.modes
    if isinstance(term, Constraint):
        met = np.abs(rows @ rotation)
        size = np.abs(rows) @ (np.abs(rotation) + 1e-3)
    else:
        if term.measure.within:
            return
        value, still = term.measure.evaluate(now.coordinates.moved)[0], np.zeros(len(rows))
        forces = np.column_stack(
            [rows.T @ term.resistance(value, still), rows.T @ term.resistance(still, rows @ rotation)]
        )
        stiffness, damping = (np.abs(part) for part in term.tangents(still, still))
        most = np.abs(rows).T @ (stiffness + damping) @ np.abs(rows) @ (np.abs(rotation) + 1e-3)
        met, size = np.abs(modes.T @ forces).max(axis=1), np.abs(modes).T @ most
    if np.any(met > PULLS * size):
        raise ValueError(
            f"{where}: {label_of(term)} resists the motion of the drive, so its force changes along the path: let its "
            "axes turn with the rotor, or take generalized_alpha"
        )


def transition(first: PathKnot, second: PathKnot) -> tuple[Array, float]:
    """Return modal amplitudes of one model per unit of those of another, orthogonal (n, n), and the angle between them.

    The angle [rad] is the largest between the motions that constraints leave in both.
    """
    u, cosines, v = np.linalg.svd(second.modes.T @ first.assembly.coordinates.mass @ first.modes)
    # Sines from what is left: cosines near one have lost half of their digits.
    left = first.modes - second.modes @ (second.modes.T @ first.assembly.coordinates.mass @ first.modes)
    sine = np.linalg.norm(left * first.assembly.coordinates.scale[:, None], 2)
    return u @ v, float(np.arctan2(sine, cosines[-1]))
