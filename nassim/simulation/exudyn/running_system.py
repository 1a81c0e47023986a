"""A running Exudyn system: its inputs, outputs and deformations by name, with Exudyn's numbers of them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np

from nassim.base.checks import Array
from nassim.simulation.exudyn.input_channels import ForceCarrier, InputChannel
from nassim.simulation.exudyn.summands import Summand, unwrapped, weighted
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.digital_controllers import span
from nassim.simulation.model.filters import gain_at_rest
from nassim.simulation.model.rigid_groups import CarriedBody

COORDINATES = (
    exu.OutputVariableType.Coordinates,
    exu.OutputVariableType.Coordinates_t,
    exu.OutputVariableType.Coordinates_tt,
)
"""Exudyn's variables of a node for an output of each derivative."""
STORED = {"storeInternal": True, "writeToFile": False}
"""Options of every sensor: its values stay in memory."""
StressChange = Callable[[Array, Array], Array]
"""Change of a body's geometric stiffness since the start, on its coordinates, (n, n), by the rotation of its frame
since then, (3, 3), and its angular velocity along the world's axes, (3,) [rad/s]."""


@dataclass(frozen=True)
class FlexibleCoordinates:
    """Exudyn's nodes of the deformation of a flexible body.

    Attributes:
        nodes: nodes and their numbers of coordinates, whose sum is m.
        coordinates: the reduced body's coordinates per unit of the nodes', (n, m).
        offset: constant part of the reduced body's coordinates, (n,).
    """

    nodes: tuple[tuple[int, int], ...]
    coordinates: Array
    offset: Array | float = 0.0

    def parts(self, row: Array) -> list[tuple[int, Array]]:
        """Split a row over the body's coordinates by nodes; nodes without a part are left out."""
        ends = np.cumsum([count for _, count in self.nodes])
        pieces = np.split(row @ self.coordinates, ends[:-1])
        return [(node, piece) for (node, _), piece in zip(self.nodes, pieces, strict=True) if np.any(piece)]


@dataclass(frozen=True)
class StressUpdate:
    """Change of the geometric stiffness of a floating body during a run.

    Attributes:
        node: rigid-body node of its frame.
        start: rotation of the body at the start, (3, 3).
        number: object that takes the stiffness.
        flexible: indices of the flexible coordinates among the body's.
        change: the change by the motion of the frame.
    """

    node: int
    start: Array
    number: int
    flexible: Array
    change: StressChange


@dataclass(frozen=True)
class System:
    """An Exudyn system, with Exudyn's numbers of a scene's bodies, inputs and outputs.

    Attributes:
        container: Exudyn's container, which keeps the system alive.
        mbs: the Exudyn system.
        assembly: the assembled scene.
        nodes: rigid-body node of each moving body, by name; bodies whose frame the ground holds have none.
        flexible: coordinates of each flexible body that deforms, by name.
        channels: channels of the inputs.
        readings: summands of each output before its filter, by name.
        massless: objects with coordinates without mass, and the mass matrix that `find_accelerations` gives them.
        circuits: node, place among the node's coordinates, and damping of the state of each circuit.
        constant_forces: forces of objects that do not depend on inputs, by number.
        sparse: whether Exudyn's sparse solver is faster.
        is_linear: whether the equations are linear, so that Newton's iterations take one step and never restart.
        filtered: filtered values of a run, by output of `Signals.filters`, (n_samples,) each.
        rotating_axes: by inertial output, sensors of the axes with which its directions rotate, and these directions
            times gains, (3,).
        counts: last values of unwrapped summands, by their `id`.
        evaluators: evaluators of measures by general items, whose angles are unwrapped.
        bodies: `BodyNodes` of the moving bodies, by name.
        carried: bodies without deformation that floating bodies carry, by name; `nodes` has their host's.
        stress_updates: changes of the bodies' geometric stiffness.
        constant_inputs: constant values of inputs that act beside those that are set.
        joints: objects of the joints without drives, by name.
        fixed_frames: rotation (3, 3) and position (3,) [m] of the frames that the ground holds, by name of their bodies
            and of those that these carry.
    """

    container: Any
    mbs: Any
    assembly: Assembly
    nodes: dict[str, int]
    flexible: dict[str, FlexibleCoordinates]
    channels: tuple[InputChannel, ...]
    readings: dict[str, list[Summand]]
    massless: Mapping[int, Any]
    circuits: Sequence[tuple[int, int, float]] = ()
    constant_forces: Mapping[int, Array] = field(default_factory=dict)
    sparse: bool = False
    is_linear: bool = False
    filtered: dict[str, Array] = field(default_factory=dict)
    rotating_axes: dict[str, list[tuple[int, Array]]] = field(default_factory=dict)
    counts: dict[int, float] = field(default_factory=dict)
    evaluators: Sequence[Any] = ()
    bodies: Mapping[str, Any] = field(default_factory=dict)
    carried: Mapping[str, CarriedBody] = field(default_factory=dict)
    stress_updates: Sequence[StressUpdate] = ()
    constant_inputs: dict[str, float] = field(default_factory=dict)
    joints: Mapping[str, int] = field(default_factory=dict)
    fixed_frames: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)

    @property
    def framed(self) -> frozenset[str]:
        """Names of the bodies with a frame, which moves or is held."""
        return frozenset(self.nodes) | frozenset(self.fixed_frames)

    @property
    def renews_jacobian(self) -> bool:
        """Whether Newton's iterations cost so much that a `JacobianRenewal` pays: those of floating bodies do."""
        return bool(self.flexible) and not self.is_linear

    def add_constant_inputs(self, inputs: Mapping[str, float]) -> None:
        """Let constant values of inputs, by name, act from now on, beside those that are set."""
        self.constant_inputs.update(inputs)
        self._constant[:] = [self.constant_inputs.get(channel.input, 0.0) for channel in self.channels]
        self.act(np.zeros(len(self.channels)))

    def update_stress(self) -> None:
        """Set the geometric stiffness of bodies whose stress changes to that of the present speed and gravity."""
        for update in self.stress_updates:
            mbs, kind = self.mbs, exu.OutputVariableType
            rotation = np.reshape(mbs.GetNodeOutput(update.node, kind.RotationMatrix), (3, 3)) @ update.start.T
            full = update.change(rotation, np.array(mbs.GetNodeOutput(update.node, kind.AngularVelocity)))
            own = full[np.ix_(update.flexible, update.flexible)]
            mbs.SetObjectParameter(update.number, "stiffnessMatrix", 0.5 * (own + own.T))

    def apply(self, inputs: Mapping[str, float]) -> None:
        """Set the inputs, as if they had always been constant."""
        self.act(np.array([inputs[channel.input] for channel in self.channels]))

    def act(self, values: Array) -> None:
        """Set forces and joint motions by the values of all channels, after their amplifiers, (channels,)."""
        if self.constant_inputs:
            values = values + self._constant
        for place, channel in self._moved:
            channel.offset[:] = values[place] * channel.forces
        for carrier in self._force_carriers:
            carrier.update(values)

    @cached_property
    def _constant(self) -> Array:
        """Constant values that add to those of the channels, (channels,)."""
        return np.zeros(len(self.channels))

    @cached_property
    def _moved(self) -> list[tuple[int, Any]]:
        """Channels that move joints, and their indices."""
        return [(place, channel) for place, channel in enumerate(self.channels) if channel.offset is not None]

    @cached_property
    def _force_carriers(self) -> list[ForceCarrier]:
        """Loads and objects that carry forces of inputs; one call each sets them."""
        found: dict[tuple[int, str], list[int]] = {}
        for place, channel in enumerate(self.channels):
            if channel.offset is None:
                found.setdefault((channel.number, channel.parameter), []).append(place)
        result = []
        for (number, parameter), places in found.items():
            is_load = parameter == "loadVector"
            setting = partial(self.mbs.SetLoadParameter if is_load else self.mbs.SetObjectParameter, number, parameter)
            constant = None if is_load else self.constant_forces.get(number)
            forces = np.array([self.channels[k].forces for k in places])
            result.append(ForceCarrier(span(places), forces, constant, setting))
        return result

    @property
    def angles(self) -> Any:
        """Last values of unwrapped angles."""
        return list(self.counts.items()), [evaluate.last for evaluate in self.evaluators]

    def restore_angles(self, angles: Any) -> None:
        """Unwrap angles from these values, which may be those of another system of the same scene."""
        counts, lasts = angles
        found = [term for name in self.assembly.scene.outputs for term in self.readings[name] if term.period]
        self.counts.clear()
        self.counts.update(zip(map(id, found), (value for _, value in counts), strict=False))
        for evaluate, last in zip(self.evaluators, lasts, strict=True):
            evaluate.last = last

    def measuring(self, outputs: Iterable[str]) -> Callable[[], Array]:
        """Make a function that returns present values of these outputs before their filters.

        It reads each sensor once for all weighted sums of its columns.

        Args:
            outputs: names of the outputs.

        Returns:
            The function, which returns all outputs of the scene, (outputs,); the others are 0.
        """
        read, n = self.mbs.GetSensorValues, len(self.assembly.scene.outputs)
        sums, others = self._summands(outputs)
        if len(sums) == 1 and not others:
            ((sensor, rows),) = sums
            return lambda: weighted(rows, np.atleast_1d(read(sensor)))

        def measure() -> Array:
            values = np.zeros(n)
            for sensor, rows in sums:
                values += weighted(rows, np.atleast_1d(read(sensor)))
            for k, term in others:
                values[k] += self._present(term)
            return values

        return measure

    def _summands(self, outputs: Iterable[str]) -> tuple[list[tuple[int, Array]], list[tuple[int, Summand]]]:
        """Split the summands of outputs.

        Args:
            outputs: names of the outputs.

        Returns:
            For each sensor with weighted sums of its columns, the weights, (outputs, columns), for all outputs of the
            scene; and the other summands with the indices of their outputs.
        """
        names, others = self.assembly.scene.outputs, []
        sums: dict[int, Array] = {}
        for k, term in ((names.index(name), term) for name in outputs for term in self.readings[name]):
            if term.weights is None:
                others.append((k, term))
            else:
                weights = np.atleast_1d(term.weights)
                rows = sums.setdefault(term.sensors[0], np.zeros((len(names), len(weights))))
                rows[k] += weights
        return list(sums.items()), others

    def measured(self, output: str) -> float:
        """Return the present value of one output before its filter."""
        return sum((self._present(term) for term in self.readings[output]), 0.0)

    def _present(self, term: Summand) -> float:
        """Return the present value of a summand, unwrapped from its last value."""
        if term.weights is not None:
            return float(np.vdot(self.mbs.GetSensorValues(term.sensors[0]), term.weights))
        value = float(term.value(*(np.reshape(self.mbs.GetSensorValues(k), (1, -1)) for k in term.sensors))[0])
        if term.period:
            value += term.period * round((self.counts.get(id(term), value) - value) / term.period)
            self.counts[id(term)] = value
        return value

    def at_rest(self, output: str, inputs: Array) -> float:
        """Return the present value of one output after its filter, for a system at rest under inputs, (inputs,)."""
        signals = self.assembly.signals
        direct = float(signals.feedthrough_at_rest[self.assembly.scene.outputs.index(output)] @ inputs)
        gain = gain_at_rest(signals.filters[output]) if output in signals.filters else 1.0
        return gain * (self.measured(output) + direct)

    def deformation(self, name: str) -> Array:
        """Return the present coordinates of a flexible body that deforms, in the order of `ReducedBody`, (n,)."""
        flexible = self.flexible[name]
        return flexible.coordinates @ self.node_coordinates(name) + flexible.offset

    def node_coordinates(self, name: str) -> Array:
        """Return the present coordinates of the nodes of a flexible body's deformation, (m,)."""
        kind = exu.OutputVariableType.Coordinates
        nodes = self.flexible[name].nodes
        return np.concatenate([np.atleast_1d(self.mbs.GetNodeOutput(node, kind))[:count] for node, count in nodes])

    def selection(self, name: str) -> Array:
        """Return the selection of these coordinates from all of Exudyn's coordinates, (m, all)."""
        nodes, every = self.flexible[name].nodes, np.eye(self.mbs.systemData.ODE2Size())
        firsts = [self.mbs.GetNodeODE2Index(node) for node, _ in nodes]
        return np.vstack([every[first : first + count] for first, (_, count) in zip(firsts, nodes, strict=True)])

    def recorded(self, n_samples: int) -> Array:
        """Return the outputs at the first samples of a run, (outputs, n_samples): the same as steps one by one read."""
        names, read = self.assembly.scene.outputs, self.mbs.GetSensorStoredData
        sums, others = self._summands(name for name in names if name not in self.filtered)
        values = np.zeros((n_samples, len(names)))
        for sensor, rows in sums:
            values += weighted(rows, read(sensor)[:n_samples, 1:])
        for k, term in others:
            found = term.value(*(read(sensor)[:n_samples, 1:] for sensor in term.sensors))
            values[:, k] += unwrapped(term, found)
        for output, samples in self.filtered.items():
            values[:, names.index(output)] = samples[:n_samples]
        return values.T


def add_node_sensor(mbs: Any, node: int, kind: exu.OutputVariableType) -> int:
    """Add a sensor of a node; return its number."""
    return int(mbs.AddSensor(eii.SensorNode(nodeNumber=node, outputVariableType=kind, **STORED)))


def find_accelerations(system: System, settings: Any) -> None:
    """Set the accelerations at the start, and remove the mass of circuits and drives that Exudyn requires for this.

    Without these accelerations, an input that does not start at zero would lose half a step. The state of a circuit has
    a rate instead: with a mass of 1, its acceleration from rest is the force that its damping takes.
    """
    if not system.massless:
        return
    mbs = system.mbs
    solver: Any = exu.MainSolverImplicitSecondOrder()
    solver.InitializeSolver(mbs, settings)
    accelerations = mbs.systemData.GetODE2Coordinates_tt(exu.ConfigurationType.Current)
    rates = mbs.systemData.GetODE2Coordinates_t(exu.ConfigurationType.Initial)
    for node, place, damping in system.circuits:
        k = mbs.GetNodeODE2Index(node) + place
        rates[k], accelerations[k] = accelerations[k] / damping, 0.0
    if system.circuits:
        mbs.systemData.SetODE2Coordinates_t(rates, exu.ConfigurationType.Initial)
    mbs.systemData.SetODE2Coordinates_tt(accelerations, exu.ConfigurationType.Initial)
    for number, mass in system.massless.items():
        mbs.SetObjectParameter(number, "massMatrix", mass)
    settings.timeIntegration.generalizedAlpha.computeInitialAccelerations = False
