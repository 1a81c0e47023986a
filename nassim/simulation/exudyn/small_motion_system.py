"""The Exudyn system of a scene in small motion: one object in modal coordinates."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np

from nassim.base.checks import Array
from nassim.scene.terms import SpringForce
from nassim.simulation.exudyn.circuits import Charge, modal_node
from nassim.simulation.exudyn.general_items import NO_MATRIX
from nassim.simulation.exudyn.input_channels import InputChannel
from nassim.simulation.exudyn.running_system import COORDINATES, FlexibleCoordinates, System, add_node_sensor
from nassim.simulation.exudyn.summands import Summand
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.period_correction import Steps, small_motion_factors, with_ratios_for_steps
from nassim.simulation.model.prescribed_motion import product
from nassim.simulation.model.signals import Circuit
from nassim.simulation.model.tangents import Tangent, tangent_of

NEGLIGIBLE_MIXING = 1e-6
"""Amplitude of a mode over that of another mode at whose frequency it moves along, below which their coupling is
dropped."""


@dataclass(frozen=True)
class _Modes:
    """Modes of a scene about its equilibrium: those under load, which keep the time of a step as small as without.

    Attributes:
        shapes: amplitudes of the modes without loads per unit of these, (n, n), orthogonal.
        frequency: frequencies, (n,) [Hz]; 0 for rigid-body modes and for modes that grow.
        stiffness: stiffness matrix, (n, n).
        damping: damping matrix, (n, n).
    """

    shapes: Array
    frequency: Array
    stiffness: Array
    damping: Array

    @classmethod
    def of(cls, assembly: Assembly) -> "_Modes":
        """Find the modes under the loads of an assembly."""
        modal, loads = assembly.modal, assembly.loads
        squares, damping = modal.omega**2, modal.damping.of_modes
        if loads is None or not np.any(loads.stiffness):
            return cls(np.eye(len(squares)), modal.frequency, np.diag(squares), damping)
        shapes = np.linalg.eigh(np.diag(squares) + 0.5 * (loads.stiffness + loads.stiffness.T))[1]
        stiffness = (shapes.T * squares) @ shapes + shapes.T @ loads.stiffness @ shapes
        damping = shapes.T @ damping @ shapes
        own = np.diag(stiffness)
        rates = np.sqrt(np.abs(own))[:, None]
        # At the frequency of a mode (row), another mode (column) answers by its dynamic stiffness.
        dynamic = np.hypot(own - own[:, None], rates * np.diag(damping))
        coupling = np.abs(stiffness) + rates * np.abs(damping)
        mixing = np.divide(coupling, dynamic, out=np.full_like(coupling, np.inf), where=dynamic > 0)
        kept = np.maximum(mixing, mixing.T) > NEGLIGIBLE_MIXING
        np.fill_diagonal(kept, True)
        frequency = np.sqrt(np.maximum(own, 0.0)) / (2 * np.pi)
        return cls(shapes, frequency, np.where(kept, stiffness, 0.0), np.where(kept, damping, 0.0))


@dataclass(frozen=True)
class _Equations:
    """Equations of m = n + d + c coordinates: n modal amplitudes, d motions of drives and c states of circuits.

    Attributes:
        mass: mass matrix, (m, m), zero for drives and circuits.
        stiffness: stiffness matrix, (m, m).
        damping: damping matrix, (m, m).
        massless: mass of drives and circuits while the accelerations at the start are found; these have none of their
            own, (m,).
        charges: states of the circuits, (c,).
    """

    mass: Array
    stiffness: Array
    damping: Array
    massless: Array
    charges: Sequence[Charge]

    @classmethod
    def of(cls, assembly: Assembly, modes: _Modes, motion: Array, steps: Steps | None) -> "_Equations":
        """Make the equations; motion: all coordinates by amplitudes and drives, (n_all, n + d)."""
        drives, circuits = assembly.signals.prescribed, assembly.signals.circuits
        n, d = drives.momentum.shape
        size = n + d + len(circuits)
        mass, stiffness, damping = np.zeros((3, size, size))
        factors = small_motion_factors(assembly, modes.frequency, steps)[0] if steps else np.ones(n)
        mass[:n, :n], stiffness[:n, :n], damping[:n, :n] = np.diag(factors), modes.stiffness, modes.damping
        # Rows k u = k input: k as large as the forces of u on the modes, else the tolerance of Newton's iterations
        # ignores them.
        momentum = modes.shapes.T @ drives.momentum
        push, driven = modes.stiffness @ momentum, slice(n, n + d)
        if assembly.loads is not None:
            push = push - modes.shapes.T @ assembly.loads.drive_stiffness
        sizes = np.maximum(np.linalg.norm(push, axis=0), 1.0)
        stiffness[:n, driven], stiffness[driven, driven] = -push, np.diag(sizes)
        damping[:n, driven] = modes.shapes.T @ drives.damping - modes.damping @ momentum
        charges = [Charge.of(circuit, motion.T @ circuit.forces) for circuit in circuits]
        for k, charge in enumerate(charges, start=n + d):
            stiffness[k, : n + d] = -charge.push
            stiffness[:n, k] = -charge.push[:n]  # no force moves drives
            stiffness[k, k], damping[k, k] = charge.stiffness, charge.damping
        for circuit in circuits:
            if circuit.coil:
                forces = motion.T @ circuit.forces
                stiffness[:n, : n + d] += np.outer(forces[:n], forces) / circuit.storage
        massless = np.concatenate([np.zeros(n), sizes, np.ones(len(charges))])
        return cls(mass, stiffness, damping, massless, charges)


def small_motion_system(assembly: Assembly, rates: Mapping[str, float], steps: Steps | None) -> System:
    """Build the system of a scene in small motion: one object in modal coordinates, so joints need no multipliers.

    Uncoupled entries are zero and not stored, so the time of a step is proportional to the number of modes. With drives
    that follow inputs, the amplitudes are a of `nassim.simulation.model.prescribed_motion`; the motions of the drives
    and the charges of ports with a resistance are coordinates too. The object carries all forces.

    Args:
        assembly: the assembled scene.
        rates: initial rates of inputs that drives follow, by name.
        steps: steps whose period error is corrected; None: no correction.

    Returns:
        The system.
    """
    scene, slices, signals = assembly.scene, assembly.coordinates.slices, assembly.signals
    n, d = signals.prescribed.momentum.shape
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    loaded = _Modes.of(with_ratios_for_steps(assembly, steps) if steps else assembly)
    modes = assembly.modal.modes @ loaded.shapes
    motion = np.hstack([modes, signals.prescribed.residual, np.zeros((len(modes), len(signals.circuits)))])
    equations = _Equations.of(assembly, loaded, motion[:, : n + d], steps)
    size = len(equations.mass)
    node = mbs.AddNode(modal_node(size, _initial_speeds(assembly, rates, size).tolist()))
    coils = _coils(assembly, equations.charges, np.eye(size)[n + d :])
    weight = _constant_forces(assembly, loaded.shapes, coils, size)
    number = mbs.AddObject(
        eii.ObjectGenericODE2(
            nodeNumbers=[node],
            massMatrix=_sparse(equations.mass + np.diag(equations.massless)),
            stiffnessMatrix=_sparse(equations.stiffness),
            dampingMatrix=_sparse(equations.damping),
            forceVector=weight,
        )
    )
    massless = {number: _sparse(equations.mass)} if np.any(equations.massless) else {}
    for tangent in assembly.tangents:
        if not tangent.law.is_linear:
            _add_curvature(mbs, node, tangent, tangent.rows @ motion)
    bodies = [body for body in scene.bodies if body.name in slices]
    flexible = {
        body.name: FlexibleCoordinates(((node, size),), motion[place], assembly.offset[place])
        for body in bodies
        for place in [slices[body.name]]
    }
    readings = _add_readings(mbs, assembly, node, motion, [charge.scale for charge in equations.charges])
    channels = _channels(assembly, number, modes, np.diag(equations.massless))
    channels += tuple(InputChannel(number, scene.inputs[circuit.input], drive) for circuit, drive in coils)
    mbs.Assemble()
    return System(
        container=container,
        mbs=mbs,
        assembly=assembly,
        nodes={},
        flexible=flexible,
        channels=channels,
        readings=readings,
        massless=massless,
        circuits=tuple((node, n + d + k, charge.damping) for k, charge in enumerate(equations.charges)),
        constant_forces={number: weight},
        sparse=True,
        is_linear=assembly.is_linear,
    )


def _initial_speeds(assembly: Assembly, rates: Mapping[str, float], size: int) -> Array:
    """Return the speeds of all coordinates at the start, (size,): those of drives that follow their inputs at once."""
    drives, result = assembly.signals.prescribed, np.zeros(size)
    for k, (index, rate) in enumerate(zip(drives.inputs, drives.rates, strict=True), start=drives.momentum.shape[0]):
        if np.isinf(rate):
            result[k] = rates.get(assembly.scene.inputs[index], 0.0)
    return result


def _constant_forces(assembly: Assembly, shapes: Array, coils: Sequence[tuple[Circuit, Array]], size: int) -> Array:
    """Return the forces on all coordinates by weight, constant inputs and what holds the equilibrium, (size,).

    Args:
        assembly: the assembled scene.
        shapes: amplitudes of the modes without loads per unit of those under the loads, (n, n).
        coils: as of `_coils`.
        size: number of coordinates.
    """
    modes, n, loads = assembly.modal.modes @ shapes, len(shapes), assembly.loads
    if loads is None:
        return np.pad(modes.T @ assembly.signals.weight, (0, size - n))
    result = np.pad(shapes.T @ loads.force, (0, size - n))
    for circuit, drive in coils:
        # A constant voltage is one of the circuit, which has the current; the loads have its force on the modes.
        constant = loads.constant_input(assembly.scene.inputs[circuit.input])
        result += constant * (drive - np.pad(modes.T @ circuit.at_rest, (0, size - n)))
    return result


def _channels(assembly: Assembly, number: int, modes: Array, held: Array) -> tuple[InputChannel, ...]:
    """Return the input channels: forces on modes, directly and through amplifiers, and drives; held: rows of drives."""
    scene, signals, drives, n = assembly.scene, assembly.signals, assembly.signals.prescribed, modes.shape[1]
    beyond = np.zeros((len(held) - n, len(scene.inputs)))
    forces = np.vstack([modes.T @ signals.input_matrix, beyond])
    found = [(name, forces[:, k], np.inf) for k, name in enumerate(scene.inputs)]
    found += [(scene.inputs[a.input], np.append(modes.T @ a.forces, beyond[:, 0]), a.rate) for a in signals.amplifiers]
    found += [(scene.inputs[k], held[n + j], drives.rates[j]) for j, k in enumerate(drives.inputs)]
    return tuple(InputChannel(number, name, row, rate=rate) for name, row, rate in found if np.any(row))


def _coils(assembly: Assembly, charges: Sequence[Charge], units: Array) -> list[tuple[Circuit, Array]]:
    """Return the circuits of coils with the force on all coordinates per volt, (m,); units: of their states, (c, m)."""
    every = zip(assembly.signals.circuits, charges, units, strict=True)
    return [(circuit, charge.drive * unit) for circuit, charge, unit in every if circuit.coil]


def _add_readings(
    mbs: Any, assembly: Assembly, node: int, motion: Array, scales: Sequence[float]
) -> dict[str, list[Summand]]:
    """Add a sensor for each derivative that an output reads; scales: of the states of circuits, (c,)."""
    scene, signals = assembly.scene, assembly.signals
    readings: dict[str, list[Summand]] = {name: [] for name in scene.outputs}
    rows = [product(m, motion) for m in (signals.output_matrix, signals.velocity_matrix, signals.acceleration_matrix)]
    first = motion.shape[1] - len(scales)
    for k, (circuit, scale) in enumerate(zip(signals.circuits, scales, strict=True), start=first):
        for output, gain in circuit.outputs:
            rows[0][scene.outputs.index(output), k] += gain * scale
    for kind, weights in zip(COORDINATES, rows, strict=True):
        if np.any(weights):
            number = add_node_sensor(mbs, node, kind)
            for name, row in zip(scene.outputs, weights, strict=True):
                if np.any(row):
                    readings[name].append(Summand.linear(number, row))
    for term in assembly.terms:
        if isinstance(term, SpringForce) and not term.spring.is_linear:
            tangent = tangent_of(assembly.coordinates, term.spring, assembly.tangents)
            k = term.spring.measure.components.index(term.component)
            readings[term.name].append(_beyond_tangent(mbs, node, tangent, tangent.rows @ motion, k))
    if np.any(assembly.output_offsets):
        one = mbs.AddNode(eii.NodeGenericData(numberOfDataCoordinates=1, initialCoordinates=[1.0]))
        number = add_node_sensor(mbs, one, COORDINATES[0])
        for name, offset in zip(scene.outputs, assembly.output_offsets, strict=True):
            readings[name].append(Summand.linear(number, np.array([offset])))
    return readings


def _beyond_tangent(mbs: Any, node: int, tangent: Tangent, rows: Array, k: int) -> Summand:
    """Read what component k of a force law has beyond its tangent; rows: of its measure, (components, size)."""
    sensors = tuple(add_node_sensor(mbs, node, kind) for kind in COORDINATES[:2])

    def value(coordinates: Array, rates: Array) -> Array:
        moved = zip(coordinates @ rows.T, rates @ rows.T, strict=True)
        exact = [tangent.law.resistance(now + tangent.offset, rate)[k] for now, rate in moved]
        linear = coordinates @ rows.T @ tangent.stiffness[k] + rates @ rows.T @ tangent.damping[k]
        return np.array(exact) - linear - tangent.constant[k]

    return Summand(sensors, value)


def _add_curvature(mbs: Any, node: int, tangent: Tangent, rows: Array) -> None:
    """Add the nonlinear part of a force law, beyond its tangents; rows: of its measure, (k, size)."""
    law, stiffness, damping, offset = tangent.law, tangent.stiffness, tangent.damping, tangent.offset

    def force(_mbs: Any, _t: float, _item: int, q: Any, rates: Any) -> Array:
        value, rate = rows @ np.asarray(q) + offset, rows @ np.asarray(rates)
        return rows.T @ (stiffness @ (value - offset) + damping @ rate - law.resistance(value, rate))

    def jacobian(_mbs: Any, _t: float, _item: int, q: Any, rates: Any, by_q: float, by_rates: float) -> Array:
        by_value, by_rate = law.tangents(rows @ np.asarray(q) + offset, rows @ np.asarray(rates))
        return rows.T @ (by_q * (by_value - stiffness) + by_rates * (by_rate - damping)) @ rows

    mbs.AddObject(
        eii.ObjectGenericODE2(
            nodeNumbers=[node], massMatrix=NO_MATRIX, forceUserFunction=force, jacobianUserFunction=jacobian
        )
    )


def _sparse(matrix: Array) -> Any:
    """Return a matrix as Exudyn's sparse container."""
    result: Any = exu.MatrixContainer()
    rows, columns = np.nonzero(matrix)
    entries = np.column_stack([rows, columns, matrix[rows, columns]])
    result.SetWithSparseMatrix(entries, *matrix.shape, useDenseMatrix=False)
    return result
