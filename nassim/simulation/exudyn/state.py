"""What nassim keeps of an Exudyn system, and the system of a scene in small motion."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np

from nassim.base.checks import Array
from nassim.simulation.filters import static_gain
from nassim.simulation.small_motion import Assembly, Circuit

COORDINATES = (
    exu.OutputVariableType.Coordinates,
    exu.OutputVariableType.Coordinates_t,
    exu.OutputVariableType.Coordinates_tt,
)
"""What a reading of each derivative records of a node."""


@dataclass(frozen=True)
class Carrier:
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
class Push:
    """How an input acts on an Exudyn system.

    number: of a load or an object; parameter: of it, that carries the forces
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

    def apply(self, mbs: Any, value: float) -> None:
        """Set the forces, or the joint's motion, for a value behind the amplifier."""
        if self.offset is not None:
            self.offset[:] = value * self.forces
        elif self.parameter == "loadVector":
            mbs.SetLoadParameter(self.number, self.parameter, value * self.forces)
        else:
            mbs.SetObjectParameter(self.number, self.parameter, value * self.forces)


@dataclass(frozen=True)
class Term:
    """One summand of an output.

    sensors: Exudyn's numbers; value: makes of their columns, (n_samples, k) each, the summand, (n_samples,)
    """

    sensors: tuple[int, ...]
    value: Callable[..., Array]

    @classmethod
    def linear(cls, sensor: int, weights: Array) -> "Term":
        """A weighted sum of one sensor's columns."""
        return cls((sensor,), lambda columns: columns @ weights)


@dataclass(frozen=True)
class System:
    """Exudyn's numbers of what a scene consists of.

    mbs: the Exudyn system, kept alive by container; assembly: what it models
    nodes: rigid-body node per moving body; carriers: per flexible body that deforms
    drives: what the inputs act through
    readings: per output, what it is the sum of, before its filter
    massless: objects whose mass `find_accelerations` takes away
    filtered: what a run lets pass, by output of `Assembly.filters`, (n_samples,) each
    turning: by inertial output, sensors of axes with which its directions turn, and these directions times gains, (3,)
    """

    container: Any
    mbs: Any
    assembly: Assembly
    nodes: dict[str, int]
    carriers: dict[str, Carrier]
    drives: tuple[Push, ...]
    readings: dict[str, list[Term]]
    massless: tuple[int, ...]
    filtered: dict[str, Array] = field(default_factory=dict)
    turning: dict[str, list[tuple[int, Array]]] = field(default_factory=dict)

    def apply(self, inputs: Mapping[str, float]) -> None:
        """Set the inputs, as if they had always been so."""
        for drive in self.drives:
            drive.apply(self.mbs, inputs[drive.input])

    def measured(self, output: str) -> float:
        """Present value of one output, before its filter."""
        read = self.mbs.GetSensorValues
        terms = self.readings[output]
        return sum(float(term.value(*(np.reshape(read(k), (1, -1)) for k in term.sensors))[0]) for term in terms)

    def at_rest(self, output: str) -> float:
        """Present value of one output, behind its filter, of a system that rests."""
        filters = self.assembly.filters
        return self.measured(output) * (static_gain(filters[output]) if output in filters else 1.0)

    def deformation(self, name: str) -> Array:
        """Present coordinates of a flexible body that deforms, as `ReducedBody` orders them, shape (n,)."""
        carrier = self.carriers[name]
        kind = exu.OutputVariableType.Coordinates
        found = [np.atleast_1d(self.mbs.GetNodeOutput(node, kind))[:count] for node, count in carrier.nodes]
        result: Array = carrier.coordinates @ np.concatenate(found)
        return result

    def turn(self, name: str) -> float:
        """Angle by which a body's frame is turned against the scene as drawn [rad]."""
        return _angle(self._pose(name, drawn=False)[0] @ self._pose(name, drawn=True)[0].T)

    def speed(self, name: str) -> float:
        """How fast a body's frame turns [rad/s]."""
        rate = self.mbs.GetNodeOutput(self.nodes[name], exu.OutputVariableType.AngularVelocity)
        return float(np.linalg.norm(rate))

    def shift(self, name: str, other: str) -> Array:
        """Turn [rad] and displacement [m] of a body as seen from another's frame, against the scene as drawn, (2,)."""
        rotations, positions = [], []
        for drawn in (False, True):
            (turned, place), (own, origin) = self._pose(name, drawn=drawn), self._pose(other, drawn=drawn)
            rotations.append(own.T @ turned)
            positions.append(own.T @ (place - origin))
        return np.array([_angle(rotations[0] @ rotations[1].T), np.linalg.norm(positions[0] - positions[1])])

    def _pose(self, name: str, *, drawn: bool) -> tuple[Array, Array]:
        """Rotation (3, 3) and position (3,) of a body's frame in the world, now or as drawn."""
        when = exu.ConfigurationType.Reference if drawn else exu.ConfigurationType.Current
        kinds = exu.OutputVariableType.RotationMatrix, exu.OutputVariableType.Position
        rotation, position = (self.mbs.GetNodeOutput(self.nodes[name], kind, configuration=when) for kind in kinds)
        return np.reshape(rotation, (3, 3)), np.asarray(position)

    def recorded(self, output: str) -> Array:
        """Samples of one output, shape (n_samples,); a single 0 where nothing that moves is measured.

        Of statics, where no run has passed its filter, what passes of a constant.
        """
        if output in self.filtered:
            return self.filtered[output]
        read = self.mbs.GetSensorStoredData
        terms = [term.value(*(read(k)[:, 1:] for k in term.sensors)) for term in self.readings[output]]
        values: Array = np.sum(terms, axis=0) if terms else np.zeros(1)
        return values * static_gain(self.assembly.filters[output]) if output in self.assembly.filters else values


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


def add_circuit(
    mbs: Any, circuit: Circuit, nodes: Sequence[int], forces: Array, *, driven: int = 0
) -> tuple[int, Term]:
    """Add a port's charge as a coordinate w = v / scale; returns its object and the sensor of its output.

    forces: on the nodes' coordinates per volt of v; driven: how many of these, the last, are motions of drives, which
    no force moves

    Symmetric rows: c v + R c^2 v' = forces @ q. The scale makes them as large as those of the body's forces, else the
    tolerance of Newton's iterations passes over them. The mass is for the accelerations at the start, where w'' = 0;
    `find_accelerations` takes it away.
    """
    n, c = len(forces), circuit.capacitance
    scale = float(np.linalg.norm(forces)) / c or 1.0
    node = mbs.AddNode(modal_node(1))
    mass, stiffness, damping = np.zeros((3, n + 1, n + 1))
    mass[n, n] = 1.0
    stiffness[:n, n] = stiffness[n, :n] = -scale * forces
    stiffness[n - driven : n, n] = 0.0
    stiffness[n, n], damping[n, n] = scale**2 * c, scale**2 * circuit.resistance * c**2
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
    return number, Term.linear(mbs.AddSensor(sensor), np.array([scale * circuit.gain]))


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
    for number in system.massless:
        mbs.SetObjectParameter(number, "massMatrix", np.zeros((0, 0)))
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
