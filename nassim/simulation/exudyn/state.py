"""What nassim keeps of an Exudyn system, and the system of a scene in small motion."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np

from nassim.base.checks import Array
from nassim.scene.bodies import Body
from nassim.simulation.model.assembly import Assembly, Circuit
from nassim.simulation.model.filters import static_gain

COORDINATES = (
    exu.OutputVariableType.Coordinates,
    exu.OutputVariableType.Coordinates_t,
    exu.OutputVariableType.Coordinates_tt,
)
"""What a reading of each derivative records of a node."""


@dataclass(frozen=True)
class FlexibleCoordinates:
    """Where Exudyn keeps the deformation of a flexible body.

    nodes: nodes and their numbers of coordinates, whose sum is m
    coordinates: the reduced body's coordinates per unit of these, shape (n, m)
    """

    nodes: tuple[tuple[int, int], ...]
    coordinates: Array

    def parts(self, row: Array) -> list[tuple[int, Array]]:
        """A row over the body's coordinates, split by nodes; nodes that it leaves alone are left out."""
        ends = np.cumsum([count for _, count in self.nodes])
        pieces = np.split(row @ self.coordinates, ends[:-1])
        return [(node, piece) for (node, _), piece in zip(self.nodes, pieces, strict=True) if np.any(piece)]


@dataclass(frozen=True)
class InputChannel:
    """How an input acts on an Exudyn system.

    number: of a load or an object, to which other inputs may add; parameter: of it, that carries the forces
    input: name; forces: per unit of it
    rate: of the amplifier between, a low-pass of first order [1/s]
    offset: of a joint whose motion the input is, which reads it at every iteration; None for forces
    """

    number: int
    input: str
    forces: Array
    parameter: str = "forceVector"
    rate: float = math.inf
    offset: Array | None = None


@dataclass
class _Carried:
    """What a load or an object carries.

    places: of the drives that add to it; forces: per unit of each, (places, m); beside: what else it carries, (m,)
    setting: tells it the forces; last: values of its drives that it has been told
    """

    places: Array
    forces: Array
    beside: Array | None
    setting: Callable[[Array], None]
    last: bytes = b""

    def tell(self, values: Array) -> None:
        """Carry what these values of all drives make; every call into Exudyn takes a microsecond or more."""
        now = values[self.places]
        told = now.tobytes()
        if told != self.last:
            forces = now.dot(self.forces)
            self.setting(forces if self.beside is None else forces + self.beside)
            self.last = told


@dataclass(frozen=True)
class Summand:
    """One summand of an output.

    sensors: Exudyn's numbers; value: makes of their columns, (n_samples, k) each, the summand, (n_samples,)
    weights: of the columns of one sensor, where the summand is their weighted sum
    period: of a summand that counts turns on: what a whole turn adds to it, by which single samples are ambiguous; or 0
    """

    sensors: tuple[int, ...]
    value: Callable[..., Array]
    weights: Array | None = None
    period: float = 0.0

    @classmethod
    def linear(cls, sensor: int, weights: Array) -> "Summand":
        """A weighted sum of one sensor's columns."""
        return cls((sensor,), lambda columns: columns @ weights, weights)


@dataclass(frozen=True)
class System:
    """Exudyn's numbers of what a scene consists of.

    mbs: the Exudyn system, kept alive by container; assembly: what it models
    nodes: rigid-body node per moving body; flexible: per flexible body that deforms
    drives: what the inputs act through
    readings: per output, what it is the sum of, before its filter
    massless: objects of whose coordinates some have no mass, and the mass matrix that `find_accelerations` leaves them
    beside: what objects carry beside the forces of inputs, by number
    sparse: whether Exudyn's sparse solver is the faster one
    filtered: what a run lets pass, by output of `Assembly.filters`, (n_samples,) each
    turning: by inertial output, sensors of axes with which its directions turn, and these directions times gains, (3,)
    counts: last values of terms that count turns on, by their `id`
    """

    container: Any
    mbs: Any
    assembly: Assembly
    nodes: dict[str, int]
    flexible: dict[str, FlexibleCoordinates]
    drives: tuple[InputChannel, ...]
    readings: dict[str, list[Summand]]
    massless: Mapping[int, Any]
    beside: Mapping[int, Array] = field(default_factory=dict)
    sparse: bool = False
    filtered: dict[str, Array] = field(default_factory=dict)
    turning: dict[str, list[tuple[int, Array]]] = field(default_factory=dict)
    counts: dict[int, float] = field(default_factory=dict)

    def apply(self, inputs: Mapping[str, float]) -> None:
        """Set the inputs, as if they had always been so."""
        self.act(np.array([inputs[drive.input] for drive in self.drives]))

    def act(self, values: Array) -> None:
        """Set what acts by the values of all drives in turn, behind their amplifiers, (drives,)."""
        for place, drive in self._moved:
            drive.offset[:] = values[place] * drive.forces
        for carried in self._carried:
            carried.tell(values)

    @cached_property
    def _moved(self) -> list[tuple[int, Any]]:
        """Drives that move joints, and their places."""
        return [(place, drive) for place, drive in enumerate(self.drives) if drive.offset is not None]

    @cached_property
    def _carried(self) -> list[_Carried]:
        """Everything that carries forces of inputs: one call each sets them."""
        found: dict[tuple[int, str], list[int]] = {}
        for place, drive in enumerate(self.drives):
            if drive.offset is None:
                found.setdefault((drive.number, drive.parameter), []).append(place)
        result = []
        for (number, parameter), places in found.items():
            is_load = parameter == "loadVector"
            setting = partial(self.mbs.SetLoadParameter if is_load else self.mbs.SetObjectParameter, number, parameter)
            beside = None if is_load else self.beside.get(number)
            forces = np.array([self.drives[k].forces for k in places])
            result.append(_Carried(np.array(places), forces, beside, setting))
        return result

    def measuring(self, outputs: Iterable[str]) -> Callable[[], Array]:
        """A function that returns present values of these outputs, before their filters, among all, (outputs,).

        It asks a sensor once for all weighted sums of its columns. What is not asked for is 0.
        """
        names = self.assembly.scene.outputs
        read, weighted, others = self.mbs.GetSensorValues, dict[int, Array](), []
        for k, term in ((names.index(name), term) for name in outputs for term in self.readings[name]):
            if term.weights is None:
                others.append((k, term))
            else:
                weights = np.atleast_1d(term.weights)
                rows = weighted.setdefault(term.sensors[0], np.zeros((len(names), len(weights))))
                rows[k] += weights
        sums = list(weighted.items())
        if len(sums) == 1 and not others and sums[0][1].shape[1] > 1:
            sensor, rows = sums[0]
            return lambda: rows.dot(read(sensor))

        def measure() -> Array:
            values = np.zeros(len(names))
            for sensor, rows in sums:
                values += rows.dot(np.atleast_1d(read(sensor)))
            for k, term in others:
                values[k] += self._present(term)
            return values

        return measure

    def measured(self, output: str) -> float:
        """Present value of one output, before its filter."""
        return sum(self._present(term) for term in self.readings[output])

    def _present(self, term: Summand) -> float:
        """Present value of a term; turns are counted on from the value before."""
        value = float(term.value(*(np.reshape(self.mbs.GetSensorValues(k), (1, -1)) for k in term.sensors))[0])
        if term.period:
            value += term.period * round((self.counts.get(id(term), value) - value) / term.period)
            self.counts[id(term)] = value
        return value

    def at_rest(self, output: str) -> float:
        """Present value of one output, behind its filter, of a system that rests."""
        filters = self.assembly.filters
        return self.measured(output) * (static_gain(filters[output]) if output in filters else 1.0)

    def deformation(self, name: str) -> Array:
        """Present coordinates of a flexible body that deforms, as `ReducedBody` orders them, shape (n,)."""
        result: Array = self.flexible[name].coordinates @ self.carried(name)
        return result

    def carried(self, name: str) -> Array:
        """Present coordinates that carry the deformation of a flexible body, shape (m,)."""
        kind = exu.OutputVariableType.Coordinates
        nodes = self.flexible[name].nodes
        return np.concatenate([np.atleast_1d(self.mbs.GetNodeOutput(node, kind))[:count] for node, count in nodes])

    def taken(self, name: str) -> Array:
        """What carries the deformation of a flexible body, among all of Exudyn's coordinates, shape (m, all)."""
        nodes, every = self.flexible[name].nodes, np.eye(self.mbs.systemData.ODE2Size())
        firsts = [self.mbs.GetNodeODE2Index(node) for node, _ in nodes]
        return np.vstack([every[first : first + count] for first, (_, count) in zip(firsts, nodes, strict=True)])

    def pose(self, body: Body) -> tuple[Array, Array]:
        """Where the origin of a body's own frame is, (3,), and from its axes to the world's, (3, 3).

        Where Exudyn has its node and axes in the body does not matter: they move as the body's frame does.
        """
        (now, place), (drawn, start) = (self._pose(body.name, drawn=drawn) for drawn in (False, True))
        turn = now @ drawn.T
        return place + turn @ (body.position - start), turn @ body.rotation

    def turn(self, name: str) -> float:
        """Angle by which a body's frame is turned against the scene as drawn [rad]."""
        return _angle(self._pose(name, drawn=False)[0] @ self._pose(name, drawn=True)[0].T)

    def speed(self, name: str) -> float:
        """How fast a body's frame turns [rad/s]."""
        rate = self.mbs.GetNodeOutput(self.nodes[name], exu.OutputVariableType.AngularVelocity)
        return float(np.linalg.norm(rate))

    def distance(self, name: str) -> float:
        """How far a body's frame, or the first point of one in small motion, is from where it is drawn [m]."""
        if name in self.nodes:
            return float(np.linalg.norm(self._pose(name, drawn=False)[1] - self._pose(name, drawn=True)[1]))
        return float(np.linalg.norm(self.deformation(name)[:3]))

    def shifting(self, pairs: Sequence[tuple[str, str]]) -> Callable[[], Array]:
        """A function that tells how far each pair's first body has moved as seen from the other's frame, (pairs, 2).

        Turn [rad] and displacement [m] against the scene as drawn.
        """
        names = sorted({name for pair in pairs for name in pair})
        bodies, others = np.array([[names.index(name) for name in pair] for pair in pairs], dtype=int).reshape(-1, 2).T

        def seen(*, drawn: bool) -> tuple[Array, Array]:
            poses = [self._pose(name, drawn=drawn) for name in names]
            rotations, places = np.array([pose[0] for pose in poses]), np.array([pose[1] for pose in poses])
            back = rotations[others].transpose(0, 2, 1)
            return back @ rotations[bodies], (back @ (places[bodies] - places[others])[:, :, None])[:, :, 0]

        turned_before, placed_before = seen(drawn=True) if pairs else (np.zeros((0, 3, 3)), np.zeros((0, 3)))

        def shifts() -> Array:
            turned, placed = seen(drawn=False)
            cosines = 0.5 * (np.einsum("nij,nij->n", turned, turned_before) - 1)
            away = np.linalg.norm(placed - placed_before, axis=1)
            return np.column_stack([np.arccos(np.clip(cosines, -1.0, 1.0)), away])

        return shifts

    def _pose(self, name: str, *, drawn: bool) -> tuple[Array, Array]:
        """Rotation (3, 3) and position (3,) of a body's frame in the world, now or as drawn."""
        when = exu.ConfigurationType.Reference if drawn else exu.ConfigurationType.Current
        kinds = exu.OutputVariableType.RotationMatrix, exu.OutputVariableType.Position
        rotation, position = (self.mbs.GetNodeOutput(self.nodes[name], kind, configuration=when) for kind in kinds)
        return np.reshape(rotation, (3, 3)), np.asarray(position)

    def recorded(self, output: str) -> Array:
        """Samples of one output of a run, shape (n_samples,); a single 0 where nothing that moves is measured."""
        if output in self.filtered:
            return self.filtered[output]
        read = self.mbs.GetSensorStoredData
        terms = [term.value(*(read(k)[:, 1:] for k in term.sensors)) for term in self.readings[output]]
        values: Array = np.sum(terms, axis=0) if terms else np.zeros(1)
        return values


def _angle(rotation: Array) -> float:
    return float(np.arccos(np.clip(0.5 * (np.trace(rotation) - 1), -1.0, 1.0)))


def add_forces(mbs: Any, nodes: Sequence[int], size: int) -> int:
    """Add an object that only carries forces; one call a step sets them, where loads would need one each."""
    nothing = np.zeros((0, 0))
    return int(
        mbs.AddObject(
            eii.ObjectGenericODE2(
                nodeNumbers=list(nodes), massMatrix=nothing, stiffnessMatrix=nothing, forceVector=np.zeros(size)
            )
        )
    )


@dataclass(frozen=True)
class Charge:
    """A port's charge as a coordinate w = v / scale, of a circuit that pushes coordinates q.

    Symmetric rows: c v + R c^2 v' = forces @ q. The scale makes them as large as those of the body's forces, else the
    tolerance of Newton's iterations passes over them.

    push: forces on q per unit of w, (n,); stiffness, damping: of w; gain: of the circuit's output
    """

    push: Array
    stiffness: float
    damping: float
    gain: float

    @classmethod
    def of(cls, circuit: Circuit, forces: Array) -> "Charge":
        """forces: on q per volt of v, (n,)."""
        c = circuit.capacitance
        scale = float(np.linalg.norm(forces)) / c or 1.0
        return cls(scale * forces, scale**2 * c, scale**2 * circuit.resistance * c**2, scale * circuit.gain)


def add_circuit(mbs: Any, circuit: Circuit, nodes: Sequence[int], forces: Array) -> tuple[int, Summand]:
    """Add a port's charge; returns its object and the sensor of its output.

    forces: on the nodes' coordinates per volt. The mass is for the accelerations at the start, where w'' = 0;
    `find_accelerations` takes it away.
    """
    n, charge = len(forces), Charge.of(circuit, forces)
    node = mbs.AddNode(modal_node(1))
    mass, stiffness, damping = np.zeros((3, n + 1, n + 1))
    mass[n, n] = 1.0
    stiffness[:n, n] = stiffness[n, :n] = -charge.push
    stiffness[n, n], damping[n, n] = charge.stiffness, charge.damping
    number = mbs.AddObject(
        eii.ObjectGenericODE2(
            nodeNumbers=[*nodes, node],
            massMatrix=mass,
            stiffnessMatrix=stiffness,
            dampingMatrix=damping,
        )
    )
    kind = exu.OutputVariableType.Coordinates
    sensor = eii.SensorNode(nodeNumber=node, outputVariableType=kind, storeInternal=True, writeToFile=False)
    return number, Summand.linear(mbs.AddSensor(sensor), np.array([charge.gain]))


def find_accelerations(system: System, settings: Any) -> None:
    """Set the accelerations at the start, while charges and drives have the mass that Exudyn needs for that; remove it.

    Without them an input that does not start at zero would lose half a step.
    """
    if not system.massless:
        return
    mbs = system.mbs
    solver: Any = exu.MainSolverImplicitSecondOrder()
    solver.InitializeSolver(mbs, settings)
    accelerations = mbs.systemData.GetODE2Coordinates_tt(exu.ConfigurationType.Current)
    mbs.systemData.SetODE2Coordinates_tt(accelerations, exu.ConfigurationType.Initial)
    for number, mass in system.massless.items():
        mbs.SetObjectParameter(number, "massMatrix", mass)
    settings.timeIntegration.generalizedAlpha.computeInitialAccelerations = False


def modal_node(n: int, speeds: Sequence[float] | None = None) -> Any:
    """A node of n coordinates, at rest or with speeds at the start."""
    zero = [0.0] * n
    return eii.NodeGenericODE2(
        numberOfODE2Coordinates=n,
        referenceCoordinates=zero,
        initialCoordinates=zero,
        initialCoordinates_t=zero if speeds is None else list(speeds),
    )
