"""General items of Exudyn: any force law and any constraint on any measure, by Python functions.

They are right for every measure but slow: some 0.1 ms a step and iteration each. Frequent pairs of a law and a measure
have faster items, which are tested against these.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import exudyn.itemInterface as eii
import numpy as np

from nassim.base.checks import Array
from nassim.scene.measures import BodyState, Measure
from nassim.scene.terms import AppliedForce, CoilForce, Constraint, ForceLaw
from nassim.simulation.exudyn.circuits import AddedCircuit, modal_node
from nassim.simulation.exudyn.input_channels import InputChannel
from nassim.simulation.exudyn.running_system import COORDINATES, add_node_sensor
from nassim.simulation.exudyn.summands import Summand

NO_MATRIX = np.zeros((0, 0))
"""An empty matrix, which costs no time."""


@dataclass(frozen=True)
class BodyNodes:
    """Nodes of a moving body in Exudyn.

    Attributes:
        number: number of its object.
        nodes: numbers of its nodes, and their numbers of coordinates.
        state: function of all these coordinates, (n,), relative to the reference configuration, that returns the body's
            state.
        reference: the coordinates in the reference configuration, (n,), which Exudyn adds in constraints.
    """

    number: int
    nodes: tuple[tuple[int, int], ...]
    state: Callable[[Array], BodyState]
    reference: Array


@dataclass
class Evaluator:
    """Evaluator of a measure on coordinates of Exudyn's nodes; it unwraps angles from call to call.

    Attributes:
        measure: the measure.
        bodies: nodes of all moving bodies, by name.
        fixed: states of bodies that are fixed, or held by joints to such, by name.
        last: last value of a measure with a period, from which it is unwrapped.
    """

    measure: Measure
    bodies: Mapping[str, BodyNodes]
    fixed: Mapping[str, BodyState]
    last: Array | None = None

    @property
    def names(self) -> list[str]:
        """Moving bodies that the measure depends on."""
        return [name for name in self.measure.bodies if name in self.bodies]

    @property
    def nodes(self) -> list[int]:
        """Nodes of these bodies; bodies of a rigid group share theirs."""
        return list(dict.fromkeys(node for name in self.names for node, _ in self.bodies[name].nodes))

    @property
    def n_coordinates(self) -> int:
        """Number of coordinates of these nodes."""
        return self._columns[1]

    @cached_property
    def _columns(self) -> tuple[dict[str, list[int]], int]:
        counts = {node: count for name in self.names for node, count in self.bodies[name].nodes}
        ends = np.cumsum([0, *counts.values()])
        first = dict(zip(counts, ends[:-1].tolist(), strict=True))
        places = {
            name: [first[node] + k for node, count in self.bodies[name].nodes for k in range(count)]
            for name in self.names
        }
        return places, int(ends[-1])

    def __call__(self, coordinates: Array) -> tuple[Array, Array]:
        """Evaluate value (k,) and Jacobian (k, n) at the coordinates of `nodes`, (n,)."""
        places, n = self._columns
        states = {
            **self.fixed,
            **{name: self.bodies[name].state(coordinates[columns]) for name, columns in places.items()},
        }
        value, parts = self.measure.evaluate(states)
        rows = np.zeros((len(value), n))
        for name, columns in places.items():
            rows[:, columns] += parts[name]
        period = self.measure.period
        if period:
            before = value if self.last is None else self.last
            self.last = value = before + (value - before + period / 2) % period - period / 2
        return value, rows


def add_general_force(mbs: Any, evaluate: Evaluator, law: ForceLaw) -> None:
    """Add any force law, with the resistance J^T f."""

    def state(q: Any, rates: Any) -> tuple[Array, Array, Array]:
        value, rows = evaluate(np.asarray(q))
        return value, rows, rows @ np.asarray(rates)

    def force(_mbs: Any, _t: float, _item: int, q: Any, rates: Any) -> Array:
        value, rows, rate = state(q, rates)
        return -rows.T @ law.resistance(value, rate)

    def jacobian(_mbs: Any, _t: float, _item: int, q: Any, rates: Any, by_q: float, by_rates: float) -> Array:
        value, rows, rate = state(q, rates)
        stiffness, damping = law.tangents(value, rate)
        return rows.T @ (by_q * stiffness + by_rates * damping) @ rows

    mbs.AddObject(
        eii.ObjectGenericODE2(
            nodeNumbers=evaluate.nodes, massMatrix=NO_MATRIX, forceUserFunction=force, jacobianUserFunction=jacobian
        )
    )


def add_general_actuator(mbs: Any, evaluate: Evaluator, term: AppliedForce) -> Array:
    """Add an applied force along any measure; return the array, (1,), whose value is the input.

    It has no effect where joints hold all bodies of the measure to fixed ones.
    """
    strength = np.zeros(1)
    if not evaluate.nodes:
        return strength

    def force(_mbs: Any, _t: float, _item: int, q: Any, _rates: Any) -> Array:
        return term.gain * strength[0] * evaluate(np.asarray(q))[1][0]

    # Without a jacobianUserFunction, Exudyn differentiates the force: a large one may be stiffer than the springs.
    mbs.AddObject(eii.ObjectGenericODE2(nodeNumbers=evaluate.nodes, massMatrix=NO_MATRIX, forceUserFunction=force))
    return strength


def add_general_coil(mbs: Any, evaluate: Evaluator, term: CoilForce) -> tuple[AddedCircuit, InputChannel]:
    """Add a coil along any measure m.

    Its state is the flux linkage over the force constant k, z = m + inductance i / k, which has the unit of m. Then
    k i = k^2 / inductance (z - m) and k^2 / resistance z' = k / resistance input - k i. The mass of z serves for the
    accelerations at the start, see `find_accelerations`.

    Args:
        mbs: Exudyn's system.
        evaluate: evaluator of the measure.
        term: the coil.

    Returns:
        The circuit and the channel of its input.
    """
    strength, k, node = np.zeros(1), term.force_constant, mbs.AddNode(modal_node(1))
    spring, damper, n = k**2 / term.inductance, k**2 / term.resistance, evaluate.n_coordinates
    mass, damping = np.zeros((2, n + 1, n + 1))
    mass[n, n], damping[n, n] = 1.0, damper

    def stretch(q: Any) -> tuple[float, Array]:
        value, rows = evaluate(np.asarray(q)[:n])
        return float(q[n] - value[0]), np.append(-rows[0], 1.0)

    def force(_mbs: Any, _t: float, _item: int, q: Any, _rates: Any) -> Array:
        length, row = stretch(q)
        result = -spring * length * row
        result[n] += term.gain * strength[0]
        return result

    def jacobian(_mbs: Any, _t: float, _item: int, q: Any, _rates: Any, by_q: float, _by_rates: float) -> Array:
        row = stretch(q)[1]
        return by_q * spring * np.outer(row, row)

    number = mbs.AddObject(
        eii.ObjectGenericODE2(
            nodeNumbers=[*evaluate.nodes, node],
            massMatrix=mass,
            dampingMatrix=damping,
            forceUserFunction=force,
            jacobianUserFunction=jacobian,
        )
    )
    circuit = AddedCircuit(number, node, damper, add_node_sensor(mbs, node, COORDINATES[0]), k / term.inductance)
    return circuit, InputChannel(-1, term.input, np.ones(1), offset=strength)


def add_general_constraint(
    mbs: Any, evaluate: Evaluator, term: Constraint, components: tuple[str, ...], target: Callable[[float], Array]
) -> None:
    """Add any constraint between one or two moving bodies.

    Args:
        mbs: Exudyn's system.
        evaluate: evaluator of the constraint's measure.
        term: the constraint.
        components: the held components of the measure.
        target: function of time [s] that returns the values of the held components, (components,).

    Raises:
        ValueError: for a measure of more than two bodies.
    """
    names = evaluate.names
    objects = list(dict.fromkeys(evaluate.bodies[name].number for name in names))
    if len(objects) < len(names):
        raise ValueError(f"constraint {term.name!r}: rigid joints make one body of {', '.join(names)}; leave it out")
    markers = [mbs.AddMarker(eii.MarkerObjectODE2Coordinates(objectNumber=number)) for number in objects]
    if len(objects) == 1:
        ground = mbs.AddNode(eii.NodePointGround())
        markers.append(mbs.AddMarker(eii.MarkerNodeCoordinates(nodeNumber=ground)))
    held, start = term.rows(components), np.concatenate([evaluate.bodies[name].reference for name in names])

    def rows_at(q: Any) -> tuple[Array, Array]:
        value, rows = evaluate(np.asarray(q) - start)
        return value[held], rows[held]

    def gap(_mbs: Any, t: float, _item: int, q: Any, rates: Any, velocity_level: bool) -> Array:
        value, rows = rows_at(q)
        return rows @ np.asarray(rates) if velocity_level else value - target(t)

    def jacobian(_mbs: Any, _t: float, _item: int, q: Any, _rates: Any, _velocity_level: bool) -> Array:
        return rows_at(q)[1]

    mbs.AddObject(
        eii.ObjectConnectorCoordinateVector(
            markerNumbers=markers,
            scalingMarker0=np.zeros((len(held), 1)),  # Exudyn counts the equations by its rows
            constraintUserFunction=gap,
            jacobianUserFunction=jacobian,
        )
    )


def general_term(mbs: Any, evaluate: Evaluator, read: Callable[[Array, Array], float], derivative: int) -> Summand:
    """Make a summand of an output from any measure.

    Args:
        mbs: Exudyn's system.
        evaluate: evaluator of the measure.
        read: function of value and rate, (k,) each, for derivatives 0 and 1; for derivative 2 both are the
            acceleration.
        derivative: highest required derivative.

    Returns:
        The summand.
    """
    kinds = COORDINATES[: derivative + 1]
    # Where joints hold all bodies to fixed ones, columns of no width count the samples.
    nodes = evaluate.nodes or [mbs.AddNode(eii.NodePointGround())]
    sensors = [add_node_sensor(mbs, node, kind) for kind in kinds for node in nodes]
    n, step = len(nodes), 1e-6

    def value(*columns: Array) -> Array:
        orders = [np.hstack(columns[k * n : (k + 1) * n]) for k in range(derivative + 1)]
        if len(orders[0]) > 1:
            evaluate.last = None  # a record unwraps its angles from its first sample
        result = []
        for sample in zip(*orders, strict=True):
            now, rows = evaluate(sample[0])
            rate = rows @ sample[1] if derivative else np.zeros_like(now)
            if derivative == 2:
                ahead, behind = (evaluate(sample[0] + s * step * sample[1])[1] for s in (1, -1))
                change = (ahead - behind) @ sample[1] / (2 * step) if evaluate.measure.has_value else 0.0
                now = rate = rows @ sample[2] + change
            result.append(read(now, rate))
        return np.array(result)

    return Summand(tuple(sensors), value)
