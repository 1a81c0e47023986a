"""Signals of a scene: how its inputs act on all coordinates, and how its outputs read them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nassim.base.checks import Array
from nassim.scene.measures import Measure
from nassim.scene.scene import Scene
from nassim.scene.terms import (
    AppliedForce,
    BaseAcceleration,
    CircuitState,
    CoilForce,
    Feedthrough,
    Output,
    OutputFilter,
    Shunt,
    SpringForce,
    Term,
)
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.prescribed_motion import PrescribedMotions
from nassim.simulation.model.tangents import Tangent, tangent_of
from nassim.systems.state_space import StateSpace, cascade


@dataclass(frozen=True)
class Circuit:
    """An electrical circuit of first order, v' = input / storage - rate (v - forces @ q / storage).

    A resistance across an electrical port: v is its charge over the capacitance [V], and the voltage of the port,
    v - forces @ q / capacitance, drives the current that discharges it. A coil: v is its flux linkage over the
    inductance, v - forces @ q / inductance its current [A].

    Attributes:
        outputs: names of the outputs to which v adds, and the output per unit of v.
        forces: forces on all coordinates q per unit of v, (n_all,).
        storage: capacitance of port and load [F], or inductance [H].
        rate: 1 / (resistance capacitance), or resistance / inductance [1/s].
        coil: term of the coil, whose circuit also has the stiffness forces forces^T / storage; None for a port, whose
            body has that stiffness.
        input: index of the coil's input.
    """

    outputs: tuple[tuple[str, float], ...]
    forces: Array
    storage: float
    rate: float
    coil: CoilForce | None = None
    input: int = -1

    @property
    def at_rest(self) -> Array:
        """Forces on all coordinates at rest in the reference configuration per unit of the coil's input, (n_all,)."""
        return self.forces / (self.rate * self.storage)


@dataclass(frozen=True)
class Amplifier:
    """A low-pass of first order between an input, and forces and outputs: v' = rate (input - v).

    Attributes:
        input: index of the input.
        rate: rate of the low-pass [1/s].
        forces: forces on all coordinates per unit of v, (n_all,).
        readings: outputs per unit of v, (outputs,).
    """

    input: int
    rate: float
    forces: Array
    readings: Array


@dataclass(frozen=True)
class Signals:
    """Inputs and outputs of a scene, on all coordinates.

    Attributes:
        input_matrix: forces per unit input, (n_all, inputs), without those through amplifiers.
        weight: forces of gravity, (n_all,).
        amplifiers: actuators with a bandwidth.
        prescribed: effect of drives that follow inputs.
        circuits: electrical ports with a resistance, and coils.
        circuit_matrix: rates of the circuits' states per unit input, (circuits, inputs).
        output_matrix: outputs before the filters per unit of the coordinates, (outputs, n_all).
        velocity_matrix: outputs per unit of the coordinates' first derivatives, (outputs, n_all).
        acceleration_matrix: outputs per unit of the coordinates' second derivatives, (outputs, n_all).
        feedthrough: outputs per unit input, without those behind amplifiers, (outputs, inputs). Inertial outputs have
            the ground's acceleration along their directions.
        offsets: constant part of the outputs, (outputs,): of springs with a force in the reference configuration, and
            of strains under loads.
        filters: filters by output, including outputs to which inputs add.
        against_ground: whether velocities and accelerations in a rotating frame are against the ground.
    """

    input_matrix: Array
    weight: Array
    amplifiers: tuple[Amplifier, ...]
    prescribed: PrescribedMotions
    circuits: tuple[Circuit, ...]
    circuit_matrix: Array
    output_matrix: Array
    velocity_matrix: Array
    acceleration_matrix: Array
    feedthrough: Array
    offsets: Array
    filters: dict[str, StateSpace]
    against_ground: bool = False

    @classmethod
    def of(
        cls,
        coordinates: Coordinates,
        terms: Sequence[Term],
        tangents: Sequence[Tangent],
        prescribed: PrescribedMotions,
    ) -> "Signals":
        """Collect the signals of a scene.

        Args:
            coordinates: coordinates of the scene.
            terms: terms of the parts.
            tangents: tangents of the force laws, which outputs of spring forces read.
            prescribed: effect of drives that follow inputs.

        Returns:
            The signals.
        """
        scene = coordinates.scene
        input_matrix, amplifiers = _actions(coordinates, terms)
        feedthrough = _ground_accelerations(coordinates)
        for direct in scene.terms_of(Feedthrough):
            if np.isinf(direct.bandwidth):
                feedthrough[scene.outputs.index(direct.output), scene.inputs.index(direct.input)] += direct.gain
        output_matrix, velocity_matrix, acceleration_matrix = _readings(coordinates, terms, tangents)
        circuits = _circuits(coordinates, terms)
        return cls(
            input_matrix=input_matrix,
            weight=coordinates.weight(scene.gravity),
            amplifiers=amplifiers,
            prescribed=prescribed,
            circuits=circuits,
            circuit_matrix=_circuit_rates(circuits, len(scene.inputs)),
            output_matrix=output_matrix,
            velocity_matrix=velocity_matrix,
            acceleration_matrix=acceleration_matrix,
            feedthrough=feedthrough,
            offsets=_constant_readings(coordinates, terms, tangents),
            filters=_output_filters(scene),
        )

    @property
    def port_circuits(self) -> tuple[Circuit, ...]:
        """Circuits of electrical ports."""
        return tuple(circuit for circuit in self.circuits if circuit.coil is None)

    def discharged(self, stiffness: Array, modes: Array) -> Array:
        """Return the stiffness of modes, (n, n), once the charges of ports with a resistance have flowed away.

        Args:
            stiffness: stiffness with charges that stay, (n, n).
            modes: the modes in all coordinates, (n_all, n).
        """
        for circuit in self.port_circuits:
            pull = modes.T @ circuit.forces
            stiffness = stiffness - np.outer(pull, pull) / circuit.storage
        return stiffness

    @property
    def forces_at_rest(self) -> Array:
        """Forces per unit of constant inputs behind amplifiers and coils at rest, (n_all, inputs)."""
        result = self.input_matrix.copy()
        for amplifier in self.amplifiers:
            result[:, amplifier.input] += amplifier.forces
        for circuit in self.circuits:
            if circuit.coil:
                result[:, circuit.input] += circuit.at_rest
        return result

    @property
    def feedthrough_at_rest(self) -> Array:
        """Outputs per unit of constant inputs, also behind amplifiers, beside those by motion, (outputs, inputs)."""
        result = self.feedthrough.copy()
        for amplifier in self.amplifiers:
            result[:, amplifier.input] += amplifier.readings
        return result

    @property
    def are_static(self) -> bool:
        """Whether inputs act as forces only, and outputs read displacements only, both without states of their own."""
        states = self.circuits or self.amplifiers or self.prescribed.inputs or self.filters
        return not (states or np.any(self.velocity_matrix) or np.any(self.acceleration_matrix))


def _actions(coordinates: Coordinates, terms: Sequence[Term]) -> tuple[Array, tuple[Amplifier, ...]]:
    """Return forces on all coordinates per unit input, (n_all, inputs), and amplifiers with a bandwidth."""
    scene = coordinates.scene
    matrix = np.zeros((coordinates.size, len(scene.inputs)))
    amplifiers: dict[tuple[str, float], Amplifier] = {}
    for term in terms:
        if isinstance(term, BaseAcceleration):
            matrix[:, scene.inputs.index(term.input)] += coordinates.of_base(term)
        elif isinstance(term, (AppliedForce, Feedthrough)):
            forces, readings = np.zeros(coordinates.size), np.zeros(len(scene.outputs))
            if isinstance(term, AppliedForce):
                forces = term.gain * coordinates.jacobian(term.measure)[0]
            else:
                readings[scene.outputs.index(term.output)] = term.gain
            index, key = scene.inputs.index(term.input), (term.input, term.bandwidth)
            if np.isinf(term.bandwidth):
                matrix[:, index] += forces
            elif key in amplifiers:
                one = amplifiers[key]
                amplifiers[key] = replace(one, forces=one.forces + forces, readings=one.readings + readings)
            else:
                amplifiers[key] = Amplifier(index, 2 * np.pi * term.bandwidth, forces, readings)
    return matrix, tuple(amplifiers.values())


def _readings(coordinates: Coordinates, terms: Sequence[Term], tangents: Sequence[Tangent]) -> Array:
    """Return outputs per unit of all coordinates and of their first and second derivatives, (3, outputs, n_all)."""
    outputs = coordinates.scene.outputs
    result = np.zeros((3, len(outputs), coordinates.size))
    for term in terms:
        if isinstance(term, Output):
            result[term.derivative, outputs.index(term.name)] += term.gain * coordinates.jacobian(term.measure)[0]
        elif isinstance(term, SpringForce):
            tangent = tangent_of(coordinates, term.spring, tangents)
            k = term.spring.measure.components.index(term.component)
            pulls = np.stack([tangent.stiffness[k], tangent.damping[k]])
            result[:2, outputs.index(term.name)] += pulls @ tangent.rows
    return result


def _constant_readings(coordinates: Coordinates, terms: Sequence[Term], tangents: Sequence[Tangent]) -> Array:
    """Return the outputs of spring forces, by their tangents, and of strains where all coordinates are zero."""
    outputs = coordinates.scene.outputs
    result = np.zeros(len(outputs))
    for term in terms:
        if isinstance(term, SpringForce):
            k = term.spring.measure.components.index(term.component)
            result[outputs.index(term.name)] += tangent_of(coordinates, term.spring, tangents).constant[k]
        elif isinstance(term, Output) and not term.derivative:
            result[outputs.index(term.name)] += term.gain * term.measure.constant
    return result


def _circuits(coordinates: Coordinates, terms: Sequence[Term]) -> tuple[Circuit, ...]:
    """Return the circuits of ports and coils."""
    result = []
    states = [term for term in terms if isinstance(term, CircuitState)]
    for term in terms:
        if isinstance(term, Shunt):
            read = ((term.output, term.gain), *((t.output, t.gain) for t in states if t.circuit == term.output))
            rows, rate = coordinates.jacobian(term.measure), 1 / (term.resistance * term.capacitance)
            result.append(Circuit(read, rows[0], term.capacitance, rate))
        elif isinstance(term, CoilForce):
            read = tuple((t.output, t.gain) for t in states if t.circuit == term.name)
            forces = term.force_constant * coordinates.jacobian(term.measure)[0]
            rate = term.resistance / term.inductance
            index = coordinates.scene.inputs.index(term.input)
            result.append(Circuit(read, forces, term.inductance, rate, term, index))
    return tuple(result)


def _circuit_rates(circuits: Sequence[Circuit], n_inputs: int) -> Array:
    """Return the rates of the circuits' states per unit input, (circuits, inputs): those of coils by their voltage."""
    result = np.zeros((len(circuits), n_inputs))
    for row, circuit in zip(result, circuits, strict=True):
        if circuit.coil:
            row[circuit.input] = 1 / circuit.storage
    return result


def _output_filters(scene: Scene) -> dict[str, StateSpace]:
    """Return the filters by output, for outputs with filters or to which inputs add."""
    result = {}
    direct = {term.output for term in scene.terms_of(Feedthrough)}
    direct |= {term.name for term in scene.terms_of(Output) if term.inertial and scene.terms_of(BaseAcceleration)}
    for output in scene.outputs:
        filters = [term for term in scene.terms_of(OutputFilter) if term.output == output]
        if not filters and output not in direct:
            continue
        whole: StateSpace = (np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1)))
        for term in filters:
            whole = cascade(whole, _section(term))
        result[output] = whole
    return result


def _section(term: OutputFilter) -> StateSpace:
    """Return one filter with states in the input's unit: a low-pass, and for second order also a band-pass."""
    w = 2 * np.pi * term.frequency
    if term.damping_ratio is None:
        a, b = np.array([[-w]]), np.array([[w]])
    else:
        a, b = w * np.array([[0, 1.0], [-1.0, -2 * term.damping_ratio]]), np.array([[0], [w]])
    if term.passes == "high":
        return a, b, a[-1:] / w, np.ones((1, 1))
    return a, b, np.eye(len(a))[[0 if term.passes == "low" else -1]], np.zeros((1, 1))


def _ground_accelerations(coordinates: Coordinates) -> Array:
    """Return the ground's acceleration along the directions of inertial outputs, per unit input, (outputs, inputs).

    The base translates as a whole, so each measure is evaluated for a common translation of its points.
    """
    scene = coordinates.scene
    result = np.zeros((len(scene.outputs), len(scene.inputs)))
    for term in scene.terms_of(Output):
        if term.inertial:
            common = term.gain * _common_translation(coordinates, term.measure)
            for base in scene.terms_of(BaseAcceleration):
                place = scene.outputs.index(term.name), scene.inputs.index(base.input)
                result[place] += float(common @ coordinates.base_direction(base))
    return result


def _common_translation(coordinates: Coordinates, measure: Measure) -> Array:
    """Evaluate a measure's rate per unit of a common velocity of all its points, world axes, (3,)."""
    result = np.zeros(3)
    for factor, part in measure.point_measures:
        rows = part.at_states(coordinates.states)[1]
        result += factor * rows[0].reshape(-1, 6)[:, :3].sum(axis=0)
    return result
