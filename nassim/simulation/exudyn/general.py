"""General items of Exudyn: any force law, and any constraint, on any measure, by functions of Python.

They are right for every measure and slow: some 0.3 ms a step and iteration each. Frequent pairs of a law and a measure
have faster items, which are tested against these.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import exudyn.itemInterface as eii
import numpy as np

from nassim.base.checks import Array
from nassim.scene.measures import BodyState, Measure
from nassim.scene.terms import AppliedForce, Constraint, ForceLaw
from nassim.simulation.exudyn.state import COORDINATES, Summand

NOTHING = np.zeros((0, 0))


@dataclass(frozen=True)
class BodyNodes:
    """Where Exudyn keeps a body that moves.

    Attributes:
        number: of its object; nodes: their numbers and numbers of coordinates.
        state: of the body by all these coordinates, (n,), which are counted from the reference configuration.
        reference: the coordinates in the reference configuration, (n,), which Exudyn adds in constraints.
    """

    number: int
    nodes: tuple[tuple[int, int], ...]
    state: Callable[[Array], BodyState]
    reference: Array

    @property
    def n_coordinates(self) -> int:
        """Number of the coordinates of all nodes."""
        return sum(count for _, count in self.nodes)


@dataclass
class Evaluator:
    """Evaluates a measure on coordinates of Exudyn's nodes; angles are counted on from call to call.

    Attributes:
        measure: what is evaluated; bodies: of all moving bodies, by name.
        fixed: states of fixed bodies, by name.
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
        """Their nodes; bodies that are one share theirs."""
        return list(dict.fromkeys(node for name in self.names for node, _ in self.bodies[name].nodes))

    def _columns(self) -> tuple[dict[str, list[int]], int]:
        counts = {node: count for name in self.names for node, count in self.bodies[name].nodes}
        ends = np.cumsum([0, *counts.values()])
        first = dict(zip(counts, ends[:-1].tolist(), strict=True))
        places = {
            name: [first[node] + k for node, count in self.bodies[name].nodes for k in range(count)]
            for name in self.names
        }
        return places, int(ends[-1])

    def __call__(self, coordinates: Array, *, keep: bool = False) -> tuple[Array, Array]:
        """Evaluate value (k,) and Jacobian (k, n) at the coordinates of `nodes`, (n,).

        keep: whether further angles are counted on from here, as at the end of a step
        """
        places, n = self._columns()
        states = {**self.fixed, **{name: self.bodies[name].state(coordinates[places[name]]) for name in self.names}}
        value, parts = self.measure.evaluate(states)
        rows = np.zeros((len(value), n))
        for name in self.names:
            rows[:, places[name]] += parts[name]
        period = self.measure.period
        if period:
            before = value if self.last is None else self.last
            value = before + (value - before + period / 2) % period - period / 2
            if keep or self.last is None:
                self.last = value
        return value, rows


def add_general_force(mbs: Any, evaluate: Evaluator, law: ForceLaw) -> None:
    """Add any force law, resistance J^T f."""

    def state(q: Any, rates: Any) -> tuple[Array, Array, Array]:
        value, rows = evaluate(np.asarray(q), keep=True)
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
            nodeNumbers=evaluate.nodes, massMatrix=NOTHING, forceUserFunction=force, jacobianUserFunction=jacobian
        )
    )


def add_general_actuator(mbs: Any, evaluate: Evaluator, term: AppliedForce) -> Array:
    """Add an applied force along any measure; returns the array, (1,), whose value is the force."""
    strength = np.zeros(1)

    def force(_mbs: Any, _t: float, _item: int, q: Any, _rates: Any) -> Array:
        return term.gain * strength[0] * evaluate(np.asarray(q))[1][0]

    mbs.AddObject(eii.ObjectGenericODE2(nodeNumbers=evaluate.nodes, massMatrix=NOTHING, forceUserFunction=force))
    return strength


def add_general_constraint(
    mbs: Any, evaluate: Evaluator, term: Constraint, components: tuple[str, ...], target: Callable[[float], Array]
) -> None:
    """Add any constraint between one or two moving bodies.

    Args:
        mbs: Exudyn's system.
        evaluate: evaluator of the constraint's measure.
        term: the constraint.
        components: those of the measure that are held.
        target: of time [s], values of the held components, (components,).
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
    n = len(start)

    def rows_at(q: Any) -> tuple[Array, Array]:
        every = np.asarray(q)
        value, rows = evaluate(every[:n] - start, keep=True)
        return value[held], np.hstack([rows[held], np.zeros((len(held), len(every) - n))])

    def gap(_mbs: Any, t: float, _item: int, q: Any, rates: Any, velocity_level: bool) -> Array:
        value, rows = rows_at(q)
        return rows @ np.asarray(rates) if velocity_level else value - target(t)

    def jacobian(_mbs: Any, _t: float, _item: int, q: Any, _rates: Any, _velocity_level: bool) -> Array:
        return rows_at(q)[1]

    none = np.zeros((len(held), 1))
    mbs.AddObject(
        eii.ObjectConnectorCoordinateVector(
            markerNumbers=markers,
            scalingMarker0=none,
            scalingMarker1=none,
            constraintUserFunction=gap,
            jacobianUserFunction=jacobian,
        )
    )


def general_term(mbs: Any, evaluate: Evaluator, read: Callable[[Array, Array], float], derivative: int = 0) -> Summand:
    """Make a summand of an output from any measure.

    Args:
        mbs: Exudyn's system.
        evaluate: evaluator of the measure.
        read: of value and rate, (k,) each, for derivatives 0 and 1; of acceleration, twice, for 2.
        derivative: the highest that counts.
    """
    kept = {"storeInternal": True, "writeToFile": False}
    sensors = [
        int(mbs.AddSensor(eii.SensorNode(nodeNumber=node, outputVariableType=kind, **kept)))
        for kind in COORDINATES[: derivative + 1]
        for node in evaluate.nodes
    ]
    n = len(evaluate.nodes)
    step = 1e-6

    def value(*columns: Array) -> Array:
        orders = [np.hstack(columns[k * n : (k + 1) * n]) for k in range(derivative + 1)]
        if len(orders[0]) > 1:
            evaluate.last = None  # a record counts its angles from its first sample
        result = []
        for sample in zip(*orders, strict=True):
            now, rows = evaluate(sample[0], keep=True)
            rate = rows @ sample[1] if derivative else np.zeros_like(now)
            if derivative == 2:
                ahead, behind = (evaluate(sample[0] + s * step * sample[1])[1] for s in (1, -1))
                change = (ahead - behind) @ sample[1] / (2 * step) if evaluate.measure.has_value else 0.0
                now = rate = rows @ sample[2] + change
            result.append(read(now, rate))
        return np.array(result)

    return Summand(tuple(sensors), value)
