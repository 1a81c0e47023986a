"""What outputs read, as Exudyn's sensors and what their columns make, in floating frames and large motion."""

from collections.abc import Sequence

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.scene.part import Field, Line, Reading, Row
from nassim.simulation.exudyn.items import Items, on_coordinates, on_points
from nassim.simulation.exudyn.state import COORDINATES, Term

Kind = exu.OutputVariableType
MOTIONS = (Kind.Displacement, Kind.Velocity, Kind.Acceleration)
"""What a reading of each derivative records of a point."""
KEPT = {"storeInternal": True, "writeToFile": False}


def add_reading(items: Items, word: Reading) -> list[Term]:
    """Add what an output is read from."""
    row = word.row
    if isinstance(row, Line):
        return [_along_line(items, word, row)]
    if "." in row.frame or any(np.any(weights[3:]) for _, weights in row.points if not row.within):
        return [_turning(items, word, row)]
    result = []
    for node, share in on_coordinates(items, row):
        sensor = eii.SensorNode(nodeNumber=node, outputVariableType=COORDINATES[word.derivative], **KEPT)
        result.append(Term.linear(items.mbs.AddSensor(sensor), word.gain * share))
    for path, weights in on_points(items, row):
        sensors = _sensors(items, path, MOTIONS[word.derivative])
        result += [Term.linear(number, word.gain * weights[:3] / len(sensors)) for number in sensors]
    return result


def add_axes(items: Items, word: Reading) -> list[tuple[int, Array]]:
    """Add a sensor of the axes that an inertial reading turns with, where fields accelerate the ground.

    Returns its number and the reading's direction times its gain, (3,); nothing where neither matters.
    """
    row = word.row
    if not (word.inertial and isinstance(row, Row) and "." in row.frame and items.moves(row.frame)):
        return []
    if not items.scene.said(Field):
        return []
    weights = word.gain * np.sum([weights[:3] for _, weights in row.points], axis=0)
    return [(items.sensor(items.marker(row.frame), Kind.RotationMatrix), weights)]


def _sensors(items: Items, path: str, kind: Kind) -> list[int]:
    """Sensors whose mean is a point's motion along the world's axes."""
    name, _, point = path.partition(".")
    if name in items.rigid:
        position = list(items.rigid[name].points[point])
        sensor = eii.SensorBody(bodyNumber=items.objects[name], localPosition=position, outputVariableType=kind, **KEPT)
        return [items.mbs.AddSensor(sensor)]
    if kind != Kind.Acceleration:
        sensor = eii.SensorMarker(markerNumber=items.marker(path), outputVariableType=kind, **KEPT)
        return [items.mbs.AddSensor(sensor)]
    if path not in items.pilots:
        node = items.nodes[name] if items.fidelity(path) == "ffrf" else items.node_of(path)
        sensor = eii.SensorNode(nodeNumber=node, outputVariableType=kind, **KEPT)
        return [items.mbs.AddSensor(sensor)]
    number, nodes = items.pilots[path]
    return [
        items.mbs.AddSensor(
            eii.SensorSuperElement(bodyNumber=number, meshNodeNumber=node, outputVariableType=kind, **KEPT)
        )
        for node in nodes
    ]


class _Probes:
    """Collects sensors, and finds motions of points in their columns: (n, 3), of turns (n, 3, 3)."""

    def __init__(self, items: Items) -> None:
        self.items = items
        self.numbers: list[int] = []

    def add(self, path: str, kind: Kind) -> slice | None:
        """Place of a point's motion among the columns; None for a point at rest."""
        if not self.items.moves(path):
            return None
        found = _sensors(self.items, path, kind)
        self.numbers += found
        return slice(len(self.numbers) - len(found), len(self.numbers))


def _mean(columns: Sequence[Array], place: slice | None, rest: Array) -> Array:
    return np.broadcast_to(rest, (len(columns[0]), *rest.shape)) if place is None else np.mean(columns[place], axis=0)


def _turn(columns: Sequence[Array], place: slice | None) -> Array:
    """Rotation matrices of a point since the start, (n, 3, 3)."""
    if place is None:
        return np.broadcast_to(np.eye(3), (len(columns[0]), 3, 3))
    return columns[place.start].reshape(-1, 3, 3)


def _along_line(items: Items, word: Reading, line: Line) -> Term:
    if word.derivative == 2:
        raise ValueError(f"output {word.output!r}: acceleration along a line that turns is not read; give a direction")
    probes = _Probes(items)
    at = [items.scene.point_position(path) for path in line.paths]
    places = [probes.add(path, Kind.Position) for path in line.paths]
    speeds = [probes.add(path, Kind.Velocity) for path in line.paths] if word.derivative else []
    length = float(np.linalg.norm(at[1] - at[0]))

    def value(*columns: Array) -> Array:
        a, b = (_mean(columns, place, rest) for place, rest in zip(places, at, strict=True))
        now = np.linalg.norm(b - a, axis=1)
        if not word.derivative:
            return word.gain * (now - length)
        u, v = (_mean(columns, place, np.zeros(3)) for place in speeds)
        result: Array = word.gain * np.einsum("ni,ni->n", v - u, b - a) / now
        return result

    return Term(tuple(probes.numbers), value)


def _turning(items: Items, word: Reading, row: Row) -> Term:
    """Along axes that turn with a point, and turns of points."""
    probes = _Probes(items)
    frame = probes.add(row.frame, Kind.RotationMatrix) if row.frame else None
    shifts = [(p, w[:3], items.scene.point_position(p)) for p, w in row.points if np.any(w[:3])]
    turns = [(p, w[3:]) for p, w in row.points if np.any(w[3:])]
    kind = (Kind.Position, Kind.Velocity, Kind.Acceleration)[word.derivative]
    shift_places = [probes.add(path, kind) for path, *_ in shifts]
    if turns and word.derivative == 2:
        raise ValueError(f"output {word.output!r}: angular acceleration is not read; read the angular velocity")
    opposite = len(turns) == 2 and not np.any(turns[0][1] + turns[1][1])
    if turns and not word.derivative and not (len(turns) == 1 or opposite):
        raise ValueError(
            f"output {word.output!r}: in large motion a turn is that of one point, or of one against another"
        )
    turn_kind = Kind.AngularVelocity if word.derivative else Kind.RotationMatrix
    turn_places = [probes.add(path, turn_kind) for path, _ in turns]
    start = sum(float(w @ at) for _, w, at in shifts)

    def value(*columns: Array) -> Array:
        axes = _turn(columns, frame)
        result = np.zeros(len(columns[0]))
        for place, (_, w, at) in zip(shift_places, shifts, strict=True):
            rest = np.zeros(3) if word.derivative else at
            result += np.einsum("nji,nj,i->n", axes, _mean(columns, place, rest), w)
        if not word.derivative:
            result -= start if shifts else 0.0
            return word.gain * (result + _angle(columns, turn_places, [w for _, w in turns]))
        for place, (_, w) in zip(turn_places, turns, strict=True):
            result += np.einsum("nji,nj,i->n", axes, _mean(columns, place, np.zeros(3)), w)
        return word.gain * result

    counted = turns and not word.derivative
    period = 2 * np.pi * abs(word.gain) * float(np.linalg.norm(turns[-1][1])) if counted else 0.0
    return Term(tuple(probes.numbers), value, period=period)


def _angle(columns: Sequence[Array], places: Sequence[slice | None], weights: Sequence[Array]) -> Array:
    """Twist of the last point against the first (or the world) since the start, counted on beyond half a turn, (n,)."""
    if not places:
        return np.zeros(len(columns[0]))
    now = _turn(columns, places[-1])
    if len(places) == 2:
        now = np.einsum("nji,njk->nik", _turn(columns, places[0]), now)
    size = float(np.linalg.norm(weights[-1]))
    quaternion = Rotation.from_matrix(now).as_quat()
    result: Array = size * np.unwrap(2 * np.arctan2(quaternion[:, :3] @ weights[-1] / size, quaternion[:, 3]))
    return result
