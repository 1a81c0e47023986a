"""Outputs as Exudyn's sensors and functions of their columns, in floating frames and large motion."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.scene.field_kinds import body_of
from nassim.scene.measures import (
    BodyCoordinates,
    Combination,
    DirectionalMeasure,
    Displacement,
    Distance,
    Measure,
    PointVelocity,
)
from nassim.scene.rotation_measures import RotationAngle, RotationDeviation
from nassim.scene.terms import BaseAcceleration, Output
from nassim.simulation.exudyn.general_items import general_term
from nassim.simulation.exudyn.items import Items, on_coordinates, on_points
from nassim.simulation.exudyn.running_system import COORDINATES, STORED, add_node_sensor
from nassim.simulation.exudyn.summands import Summand, dot

Kind = exu.OutputVariableType
MOTIONS = (Kind.Displacement, Kind.Velocity, Kind.Acceleration)
"""Exudyn's variables of a point for an output of each derivative."""


def add_output(items: Items, term: Output) -> list[Summand]:
    """Add an output: by the faster reading of its measure where there is one, else by the general one.

    Args:
        items: Exudyn's items of the scene.
        term: the output.

    Returns:
        The summands of the output.

    Raises:
        ValueError: for a measure without a value in large motion, unless its derivative is read.
    """
    measure, evaluate = term.measure, items.evaluator(term.measure)
    if not evaluate.names:
        return []
    faster = FASTER_OUTPUTS.get(type(measure))
    terms = faster(items, term, measure) if faster else None
    if terms is None:
        gain = term.gain
        return [general_term(items.mbs, evaluate, _general(gain, term.derivative), term.derivative)]
    return terms


def _general(gain: float, derivative: int) -> Callable[[Array, Array], float]:
    """Return the function of value and rate that gives an output."""
    return lambda value, rate: gain * float((rate if derivative else value)[0])


def _of_coordinates(items: Items, term: Output, measure: Measure) -> list[Summand] | None:
    """Read weighted sums of coordinates, and of points along the world's axes."""
    nodes = on_coordinates(items, measure)
    if nodes is None:
        return None
    result = []
    for node, share in nodes:
        sensor = add_node_sensor(items.mbs, node, COORDINATES[term.derivative])
        result.append(Summand.linear(sensor, term.gain * share))
    for path, weights in on_points(items, measure) or ():
        sensors = _sensors(items, path, MOTIONS[term.derivative])
        result += [Summand.linear(number, term.gain * weights / len(sensors)) for number in sensors]
    if measure.constant and not term.derivative:
        if not result:
            return None  # of a body that does not deform
        constant = term.gain * measure.constant
        result.append(Summand(result[0].sensors, lambda columns: np.full(len(columns), constant)))
    return result


def _of_displacement(items: Items, term: Output, measure: Displacement) -> list[Summand] | None:
    """Read a displacement."""
    if on_points(items, measure) is None:
        return None
    if not measure.axes_of:
        return _of_coordinates(items, term, measure)
    return None if term.derivative else [_along_axes(items, term, measure)]


def _of_velocity(items: Items, term: Output, measure: PointVelocity) -> list[Summand] | None:
    """Read a velocity or acceleration of points."""
    if on_points(items, measure) is None or (measure.angular and term.derivative == 2):
        return None
    if not measure.axes_of and not measure.angular:
        return _of_coordinates(items, term, measure)
    if term.derivative == 2 and not all(_has_acceleration(items, path) for path, _ in measure.weights):
        return None
    return [_along_axes(items, term, measure)]


def _has_acceleration(items: Items, path: str) -> bool:
    """Whether a sensor of Exudyn reads the acceleration of a point, or that is at rest."""
    rigid = body_of(path) in items.rigid
    return rigid or path in items.virtual_nodes or path in items.point_nodes or not items.moves(path)


def add_axes(items: Items, term: Output) -> list[tuple[int, Array]]:
    """Add a sensor of the rotating axes of an inertial output, where the base accelerates.

    Returns:
        Its number and the output's direction times its gain, (3,); nothing where neither has an effect.
    """
    measure = term.measure
    if not (term.inertial and isinstance(measure, PointVelocity) and measure.axes_of and items.moves(measure.axes_of)):
        return []
    if not items.scene.terms_of(BaseAcceleration):
        return []
    weights = term.gain * np.sum([weights for _, weights in measure.weights], axis=0)
    return [(items.sensor(items.marker(measure.axes_of), Kind.RotationMatrix), weights)]


def _sensors(items: Items, path: str, kind: Kind) -> list[int]:
    """Add sensors whose mean is a point's motion along the world's axes."""
    name, _, point = path.partition(".")
    if name in items.rigid:
        position = list(items.rigid[name].points[point])
        sensor = eii.SensorBody(
            bodyNumber=items.objects[name], localPosition=position, outputVariableType=kind, **STORED
        )
        return [items.mbs.AddSensor(sensor)]
    if kind != Kind.Acceleration:
        sensor = eii.SensorMarker(markerNumber=items.marker(path), outputVariableType=kind, **STORED)
        return [items.mbs.AddSensor(sensor)]
    if path in items.point_nodes:
        return [add_node_sensor(items.mbs, items.point_nodes[path], kind)]
    number, nodes = items.virtual_nodes[path]
    return [
        items.mbs.AddSensor(
            eii.SensorSuperElement(bodyNumber=number, meshNodeNumber=node, outputVariableType=kind, **STORED)
        )
        for node in nodes
    ]


class _Probes:
    """Collector of sensors, which finds points' motions in their columns: (n, 3), or rotations (n, 3, 3)."""

    def __init__(self, items: Items) -> None:
        self.items = items
        self.numbers: list[int] = []

    def add(self, path: str, kind: Kind) -> slice | None:
        """Return the place of a point's motion among the columns; None for a point at rest."""
        if not self.items.moves(path):
            return None
        found = _sensors(self.items, path, kind)
        self.numbers += found
        return slice(len(self.numbers) - len(found), len(self.numbers))


def _mean(columns: Sequence[Array], place: slice | None, rest: Array) -> Array:
    """Return the mean of columns, (n, ...), or the constant of a point at rest."""
    return np.broadcast_to(rest, (len(columns[0]), *rest.shape)) if place is None else np.mean(columns[place], axis=0)


def _turn(columns: Sequence[Array], place: slice | None) -> Array:
    """Return the rotation matrices of a point since the start, (n, 3, 3)."""
    if place is None:
        return np.broadcast_to(np.eye(3), (len(columns[0]), 3, 3))
    return columns[place.start].reshape(-1, 3, 3)


def _along_line(items: Items, term: Output, measure: Distance) -> list[Summand] | None:
    """Read the distance of two points, or its rate."""
    if term.derivative == 2 or not items.has_markers(measure):
        return None
    probes = _Probes(items)
    at = [items.scene.point_position(path) for path in measure.points]
    places = [probes.add(path, Kind.Position) for path in measure.points]
    speeds = [probes.add(path, Kind.Velocity) for path in measure.points] if term.derivative else []
    length = float(np.linalg.norm(at[1] - at[0]))

    def value(*columns: Array) -> Array:
        a, b = (_mean(columns, place, rest) for place, rest in zip(places, at, strict=True))
        now = np.sqrt(dot(b - a, b - a))
        if not term.derivative:
            return term.gain * (now - length)
        u, v = (_mean(columns, place, np.zeros(3)) for place in speeds)
        return term.gain * dot(v - u, b - a) / now

    return [Summand(tuple(probes.numbers), value)]


def _along_axes(items: Items, term: Output, measure: DirectionalMeasure) -> Summand:
    """Read along axes that rotate with a point: positions, velocities or accelerations of points."""
    probes = _Probes(items)
    frame = probes.add(measure.axes_of, Kind.RotationMatrix) if measure.axes_of else None
    kind = (
        Kind.AngularVelocity if measure.angular else (Kind.Position, Kind.Velocity, Kind.Acceleration)[term.derivative]
    )
    places = [probes.add(path, kind) for path, _ in measure.weights]
    rests = [np.zeros(3) if term.derivative else items.scene.point_position(path) for path, _ in measure.weights]
    start = sum(float(w @ at) for (_, w), at in zip(measure.weights, rests, strict=True))

    def value(*columns: Array) -> Array:
        axes = _turn(columns, frame)
        result = np.zeros(len(columns[0]))
        for place, (_, w), rest in zip(places, measure.weights, rests, strict=True):
            result += dot(dot(axes, w), _mean(columns, place, rest))
        return term.gain * (result - start)

    return Summand(tuple(probes.numbers), value)


def _of_angle(items: Items, term: Output, measure: RotationAngle) -> list[Summand] | None:
    """Read the twist of point b against a, unwrapped."""
    if term.derivative or not items.has_markers(measure):
        return None
    probes, size = _Probes(items), float(np.linalg.norm(measure.axis))
    places = [probes.add(path, Kind.RotationMatrix) for path in measure.points]

    def value(*columns: Array) -> Array:
        now = _turn(columns, places[0])
        if measure.a:
            now = np.swapaxes(_turn(columns, places[1]), 1, 2) @ now
        quaternion = Rotation.from_matrix(now).as_quat()
        angles = 2 * np.arctan2(dot(quaternion[:, :3], measure.axis) / size, quaternion[:, 3])
        return term.gain * size * (angles - 2 * np.pi * np.round(angles / (2 * np.pi)))

    return [Summand(tuple(probes.numbers), value, period=2 * np.pi * abs(term.gain) * size)]


def _of_deviation(items: Items, term: Output, measure: RotationDeviation) -> list[Summand] | None:
    """Read a component of the rotation of point b against a beside the turn of a joint."""
    if term.derivative or not items.has_markers(measure):
        return None
    probes = _Probes(items)
    places = [probes.add(path, Kind.RotationMatrix) for path in measure.points]

    def value(*columns: Array) -> Array:
        vectors, _ = measure.vectors(*(_turn(columns, place) for place in places))
        return term.gain * dot(vectors, measure.direction)

    return [Summand(tuple(probes.numbers), value)]


FASTER_OUTPUTS: Mapping[type[Measure], Callable[[Items, Output, Any], list[Summand] | None]] = {
    BodyCoordinates: _of_coordinates,
    Combination: _of_coordinates,
    Displacement: _of_displacement,
    Distance: _along_line,
    PointVelocity: _of_velocity,
    RotationAngle: _of_angle,
    RotationDeviation: _of_deviation,
}
"""Faster readings, by measure; each returns None where it does not fit these points or this derivative."""
