"""What the parts of a scene say, as Exudyn's items, in floating frames and large motion."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import DIRECTIONS
from nassim.scene.bodies import FlexibleBody, RigidBody
from nassim.scene.part import Constraint, Field, Force, Reading, Row, Spring
from nassim.scene.scene import Scene
from nassim.simulation.exudyn.state import COORDINATES, Carrier, Drive, add_forces
from nassim.simulation.rows import shares

MOTIONS = (exu.OutputVariableType.Displacement, exu.OutputVariableType.Velocity, exu.OutputVariableType.Acceleration)
"""What a reading of each derivative records of a point."""
KEPT = {"storeInternal": True, "writeToFile": False}


@dataclass(frozen=True)
class Items:
    """Exudyn's numbers of a scene's bodies, by name; markers of points by path.

    rigid: bodies without deformation, along the world's axes; carriers: of those that deform; nodes: of all that move
    """

    mbs: Any
    scene: Scene
    nodes: Mapping[str, int]
    objects: Mapping[str, int]
    rigid: Mapping[str, RigidBody]
    carriers: Mapping[str, Carrier]
    markers: dict[str, int]


def add_force(items: Items, word: Force) -> list[Drive]:
    """Add what an input pushes through: forces on coordinates, and loads at points of rigid bodies."""
    drives = []
    nodes = _on_coordinates(items, word.row)
    if nodes:
        # Forces in balance inside a body do no work on its frame, so they act on coordinates of deformation only.
        forces = word.gain * np.concatenate([row for _, row in nodes])
        number = add_forces(items.mbs, [node for node, _ in nodes], len(forces))
        drives.append(Drive(number, word.input, forces, rate=2 * np.pi * word.bandwidth))
    for name, position, weights in _on_points(items, word.row):
        marker = items.mbs.AddMarker(eii.MarkerBodyPosition(bodyNumber=items.objects[name], localPosition=position))
        number = items.mbs.AddLoad(eii.LoadForceVector(markerNumber=marker, loadVector=[0.0, 0.0, 0.0]))
        drives.append(Drive(number, word.input, word.gain * weights, load=True, rate=2 * np.pi * word.bandwidth))
    return drives


def add_field(items: Items, word: Field) -> list[Drive]:
    """Add a uniform acceleration of every body that moves."""
    drives = []
    for name in items.nodes:
        body = items.scene.split(f"{name}.")[0]
        if isinstance(body, FlexibleBody) and body.fidelity == "linear":
            numbers = [number for number, _ in items.carriers[name].nodes]
            forces = items.carriers[name].coordinates.T @ body.weight(word.direction)
            drives.append(Drive(add_forces(items.mbs, numbers, len(forces)), word.input, forces))
        else:
            marker = items.mbs.AddMarker(eii.MarkerBodyMass(bodyNumber=items.objects[name]))
            number = items.mbs.AddLoad(eii.LoadMassProportional(markerNumber=marker, loadVector=[0.0, 0.0, 0.0]))
            drives.append(Drive(number, word.input, word.direction, load=True))
    return drives


def add_spring(items: Items, word: Spring) -> None:
    """Add a spring-damper, relaxed at the start: within bodies, or between points of rigid ones along an axis."""
    nodes = _on_coordinates(items, word.row)
    if nodes:
        row = np.concatenate([piece for _, piece in nodes])
        items.mbs.AddObject(
            eii.ObjectGenericODE2(
                nodeNumbers=[node for node, _ in nodes],
                massMatrix=np.zeros((0, 0)),
                stiffnessMatrix=word.stiffness * np.outer(row, row),
                dampingMatrix=word.damping * np.outer(row, row),
                forceVector=np.zeros(len(row)),
            )
        )
        return
    (a, along_a), (b, along_b) = ((path, weights[:3]) for path, weights in word.row.points)
    if np.count_nonzero(along_b) != 1 or np.any(along_a + along_b):
        raise ValueError(f"between {a!r} and {b!r}: in large motion springs act along one of the world's axes")
    markers = []
    for path in (a, b):
        name, _, point = path.partition(".")
        position = list(items.rigid[name].points[point])
        markers.append(
            items.mbs.AddMarker(eii.MarkerBodyPosition(bodyNumber=items.objects[name], localPosition=position))
        )
    items.mbs.AddObject(
        eii.ObjectConnectorCartesianSpringDamper(
            markerNumbers=markers,
            stiffness=list(word.stiffness * along_b**2),
            damping=list(word.damping * along_b**2),
            offset=list(items.scene.point_position(b) - items.scene.point_position(a)),
        )
    )


def add_reading(items: Items, word: Reading) -> list[tuple[int, Array]]:
    """Add what an output is read from: Exudyn's sensors and the weights of their columns."""
    kinds = COORDINATES[word.derivative], MOTIONS[word.derivative]
    result = []
    for node, row in _on_coordinates(items, word.row):
        sensor = eii.SensorNode(nodeNumber=node, outputVariableType=kinds[0], **KEPT)
        result.append((items.mbs.AddSensor(sensor), word.gain * row))
    for name, position, weights in _on_points(items, word.row):
        number = items.objects[name]
        sensor = eii.SensorBody(bodyNumber=number, localPosition=position, outputVariableType=kinds[1], **KEPT)
        result.append((items.mbs.AddSensor(sensor), word.gain * weights))
    return result


def add_constraint(items: Items, word: Constraint, held: tuple[str, ...]) -> None:
    """Add a joint that holds the given ones of its directions."""
    for path in (word.a, word.b):
        name, _, point = path.partition(".")
        if path not in items.markers:
            position = list(items.rigid[name].points[point])
            marker = eii.MarkerBodyRigid(bodyNumber=items.objects[name], localPosition=position)
            items.markers[path] = items.mbs.AddMarker(marker)
    items.mbs.AddObject(
        eii.ObjectJointGeneric(
            markerNumbers=[items.markers[word.a], items.markers[word.b]],
            constrainedAxes=[int(direction in held) for direction in DIRECTIONS],
        )
    )


def _on_coordinates(items: Items, row: Row) -> list[tuple[int, Array]]:
    """A row's weights on the coordinates of bodies that deform, by node: those of bodies whose shape it counts."""
    if row.points and not row.frame:
        row = Row(own=row.own)
    found = shares(items.scene, row)
    return [
        part for name, share in found.items() if name in items.carriers for part in items.carriers[name].parts(share)
    ]


def _on_points(items: Items, row: Row) -> list[tuple[str, list[float], Array]]:
    """Body, place in it and weights (3,) of the points of rigid bodies that move and that a row counts."""
    result = []
    for path, weights in () if row.frame else row.points:
        name, _, point = path.partition(".")
        if name not in items.rigid:
            raise ValueError(f"{path!r}: in large motion only points of rigid bodies are pushed and read")
        if np.any(weights[3:]):
            raise ValueError(f"{path!r}: in large motion rotations are neither pushed nor read")
        if name in items.nodes:
            result.append((name, list(items.rigid[name].points[point]), weights[:3]))
    return result
