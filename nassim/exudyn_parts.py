"""Actuators, sensors and springs of a scene as Exudyn's items."""

from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np

from nassim.assembly import body_weight
from nassim.checks import Array
from nassim.exudyn_state import Carrier, Drive, add_forces
from nassim.parts import (
    Actuator,
    Encoder,
    FlexibleBody,
    GroundAcceleration,
    PointForce,
    RigidBody,
    Sensor,
    SpringDamper,
    StackActuator,
    StackSensor,
    VoltageDrive,
    VoltageSensor,
)
from nassim.rigid_motion import unit_vector
from nassim.scene import Scene


def add_actuator(
    mbs: Any,
    scene: Scene,
    actuator: Actuator,
    nodes: dict[str, int],
    objects: dict[str, int],
    rigid: dict[str, RigidBody],
    carriers: dict[str, Carrier],
) -> list[Drive]:
    """Add what an actuator acts through."""
    if isinstance(actuator, GroundAcceleration):
        return _add_ground(mbs, actuator, scene, nodes, objects, carriers)
    if isinstance(actuator, PointForce):
        return _add_force(mbs, actuator, objects, rigid)
    return _add_stacks(mbs, scene, actuator, carriers)


def _add_stacks(
    mbs: Any, scene: Scene, actuator: StackActuator | VoltageDrive, carriers: dict[str, Carrier]
) -> list[Drive]:
    """Forces in balance inside a body do no work on its frame, so they act on coordinates of deformation only."""
    parts = _parts(scene, actuator, carriers)
    if not parts:
        return []
    forces = np.concatenate([row for _, row in parts])
    number = add_forces(mbs, [node for node, _ in parts], len(forces))
    return [Drive(number, actuator.input, forces, rate=2 * np.pi * actuator.bandwidth)]


def _add_force(mbs: Any, force: PointForce, objects: dict[str, int], rigid: dict[str, RigidBody]) -> list[Drive]:
    name, _, point = force.point.partition(".")
    marker = mbs.AddMarker(
        eii.MarkerBodyPosition(bodyNumber=objects[name], localPosition=list(rigid[name].points[point]))
    )
    number = mbs.AddLoad(eii.LoadForceVector(markerNumber=marker, loadVector=[0.0, 0.0, 0.0]))
    return [Drive(number, force.input, unit_vector(force.axis), load=True)]


def _add_ground(
    mbs: Any,
    ground: GroundAcceleration,
    scene: Scene,
    nodes: dict[str, int],
    objects: dict[str, int],
    carriers: dict[str, Carrier],
) -> list[Drive]:
    """The ground's acceleration as an opposite gravity on every body that moves."""
    fall = -unit_vector(ground.axis)
    drives = []
    for body in scene.bodies:
        if isinstance(body, FlexibleBody) and body.fidelity == "linear":
            numbers = [node for node, _ in carriers[body.name].nodes]
            forces = carriers[body.name].coordinates.T @ body_weight(body, fall)
            drives.append(Drive(add_forces(mbs, numbers, len(forces)), ground.input, forces))
        elif body.name in nodes:
            marker = mbs.AddMarker(eii.MarkerBodyMass(bodyNumber=objects[body.name]))
            number = mbs.AddLoad(eii.LoadMassProportional(markerNumber=marker, loadVector=[0.0, 0.0, 0.0]))
            drives.append(Drive(number, ground.input, fall, load=True))
    return drives


def add_spring(mbs: Any, spring: SpringDamper, objects: dict[str, int], rigid: dict[str, RigidBody]) -> None:
    """Add a spring-damper, relaxed at the start, wherever its ends are."""
    markers = []
    for path in (spring.a, spring.b):
        name, _, point = path.partition(".")
        position = list(rigid[name].points[point])
        markers.append(mbs.AddMarker(eii.MarkerBodyPosition(bodyNumber=objects[name], localPosition=position)))
    offset = rigid[spring.b.partition(".")[0]].point_position(spring.b.partition(".")[2])
    offset = offset - rigid[spring.a.partition(".")[0]].point_position(spring.a.partition(".")[2])
    axis = unit_vector(spring.axis)
    mbs.AddObject(
        eii.ObjectConnectorCartesianSpringDamper(
            markerNumbers=markers,
            stiffness=list(spring.stiffness * axis),
            damping=list(spring.damping * axis),
            offset=list(offset),
        )
    )


def add_sensor(
    mbs: Any, scene: Scene, sensor: Sensor, objects: dict[str, int], carriers: dict[str, Carrier]
) -> list[tuple[int, Array]]:
    """Add what an output is read from: Exudyn's sensors and the weights of their columns."""
    kept = {"storeInternal": True, "writeToFile": False}
    if not isinstance(sensor, Encoder):
        kind = exu.OutputVariableType.Coordinates
        return [
            (
                mbs.AddSensor(eii.SensorNode(nodeNumber=node, outputVariableType=kind, **kept)),
                row,
            )
            for node, row in _parts(scene, sensor, carriers)
        ]
    result = []
    for path, sign in ((sensor.a, -1.0), (sensor.b, 1.0)):
        body, point = scene.split(path)
        assert isinstance(body, RigidBody)
        if not body.fixed:
            number = mbs.AddSensor(
                eii.SensorBody(
                    bodyNumber=objects[body.name],
                    localPosition=list(body.points[point]),
                    outputVariableType=exu.OutputVariableType.Displacement,
                    **kept,
                )
            )
            result.append((number, sign * unit_vector(sensor.axis)))
    return result


def _parts(
    scene: Scene, part: StackActuator | VoltageDrive | StackSensor | VoltageSensor, carriers: dict[str, Carrier]
) -> list[tuple[int, Array]]:
    """A part's row over the coordinates of its body, split by nodes; empty in a rigid body."""
    body, row = scene.body_row(part)
    return carriers[body.name].parts(row) if body.name in carriers else []
