"""A scene as an Exudyn system: bodies, markers, joints, loads and sensors, and Exudyn's solvers.

The one stateful thing of nassim; it is born and gone within one call of `simulate` or `static_response`.
"""

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np
import scipy.linalg
from exudyn.rigidBodyUtilities import GetRigidBodyNode

from nassim.checks import Array
from nassim.floating_frame import FloatingFrame
from nassim.interface import DIRECTIONS, rigid_transfer
from nassim.linear import Assembly, assemble, deformation_damping
from nassim.progress import stage
from nassim.scene import FlexibleBody, Joint, RigidBody, Scene, Sensor, StackActuator, StackSensor

# Corners of a regular tetrahedron: equal weights on four pilots there give a remote point's motion exactly.
PILOT_DIRECTIONS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)


@dataclass(frozen=True)
class System:
    """Exudyn's numbers of what a scene consists of.

    mbs: the Exudyn system, kept alive by container; nodes: rigid-body node per moving body; modal_nodes: modal
    node per flexible body; readings: per output, Exudyn's sensors and the weights of their columns
    """

    container: Any
    mbs: Any
    nodes: dict[str, int]
    modal_nodes: dict[str, int]
    readings: dict[str, list[tuple[int, Array]]]

    def recorded(self, sensor: Sensor) -> Array:
        """Samples of one output, shape (n_samples,)."""
        terms = [
            self.mbs.GetSensorStoredData(number)[:, 1:] @ weights for number, weights in self.readings[sensor.name]
        ]
        return np.sum(terms, axis=0) if terms else np.zeros(1)


def build_system(scene: Scene, input_value: Callable[[str, float], float]) -> System:
    """Build the Exudyn system of a scene.

    input_value: value of an input [V] by its name and the time [s]
    """
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    assembly = assemble(scene)
    dampings = _damping_blocks(scene, assembly)
    nodes: dict[str, int] = {}
    modal_nodes: dict[str, int] = {}
    markers: dict[str, int] = {}
    objects: dict[str, int] = {}
    for body in scene.bodies:
        if isinstance(body, FlexibleBody):
            frame = assembly.frames[body.name]
            nodes[body.name], modal_nodes[body.name], objects[body.name], pilots = _add_flexible(
                mbs, scene, body, frame, dampings[body.name]
            )
            markers.update({f"{body.name}.{point}": marker for point, marker in pilots.items()})
        else:
            node, objects[body.name] = _add_rigid(mbs, body)
            if node is not None:
                nodes[body.name] = node
    for name in nodes:
        if np.any(scene.gravity):
            marker = mbs.AddMarker(eii.MarkerBodyMass(bodyNumber=objects[name]))
            mbs.AddLoad(eii.LoadMassProportional(markerNumber=marker, loadVector=list(scene.gravity)))
    _couple_dampings(mbs, scene, assembly, modal_nodes)
    for joint in scene.joints:
        _add_joint(mbs, scene, joint, objects, markers)
    for actuator in scene.actuators:
        _add_actuator(mbs, scene, assembly, actuator, modal_nodes, input_value)
    readings = {s.name: _add_sensor(mbs, scene, assembly, s, objects, modal_nodes) for s in scene.sensors}
    mbs.Assemble()
    return System(container, mbs, nodes, modal_nodes, readings)


def _add_flexible(
    mbs: Any, scene: Scene, body: FlexibleBody, frame: FloatingFrame, damping: Array
) -> tuple[int, int, int, dict[str, int]]:
    """Add a floating-frame body; returns its rigid node, modal node, object, and a marker per jointed remote point."""
    n = len(frame.flexible)
    node = mbs.AddNode(
        GetRigidBodyNode(
            exu.NodeType.RotationEulerParameters,
            position=list(body.point_position(frame.point)),
            rotationMatrix=body.rotation,
            velocity=list(np.cross(body.angular_velocity, body.point_position(frame.point) - _centre(body))),
            angularVelocity=list(body.angular_velocity),
        )
    )
    modal_node = mbs.AddNode(
        eii.NodeGenericODE2(
            numberOfODE2Coordinates=n,
            referenceCoordinates=[0.0] * n,
            initialCoordinates=[0.0] * n,
            initialCoordinates_t=[0.0] * n,
        )
    )
    paths = [path for joint in scene.joints for path in (joint.a, joint.b)]
    used = [p for p in body.reduced.point_names if f"{body.name}.{p}" in paths and p != frame.point]
    positions, rows = _pilots(body, frame, used)
    number = mbs.AddObject(
        eii.ObjectFFRFreducedOrder(
            nodeNumbers=[node, modal_node],
            mass=frame.mass,
            inertia=frame.inertia,
            centerOfMass=frame.center_of_mass,
            massMatrixReduced=_container(frame.mass_matrix),
            stiffnessMatrixReduced=_container(frame.stiffness_matrix),
            dampingMatrixReduced=_container(damping),
            mPhitTPsi=frame.translation_flexible,
            mPhitTPsiTilde=frame.translation_rotated,
            mXRefTildePsi=frame.position_flexible,
            mXRefTildePsiTilde=frame.position_rotated,
            mPsiTildePsi=frame.rotated_flexible,
            mPsiTildePsiTilde=frame.rotated_rotated,
            modeBasis=rows,
            referencePositions=positions,
        )
    )
    # Joint axes are the world's at the start, whatever way the body is turned.
    axes = np.eye(4)
    axes[:3, :3] = body.rotation.T
    markers = {frame.point: mbs.AddMarker(eii.MarkerNodeRigid(nodeNumber=node, localHT=axes))}
    for i, point in enumerate(used):
        markers[point] = mbs.AddMarker(
            eii.MarkerSuperElementRigid(
                bodyNumber=number,
                meshNodeNumbers=list(range(4 * i, 4 * i + 4)),
                weightingFactors=[0.25] * 4,
                localHT=axes,
            )
        )
    return node, modal_node, number, markers


def _centre(body: FlexibleBody) -> Array:
    result: Array = body.position + body.rotation @ body.reduced.center_of_mass
    return result


def _pilots(body: FlexibleBody, frame: FloatingFrame, points: Sequence[str]) -> tuple[Array, Array]:
    """Virtual mesh nodes: four around each point, whose displacements are the point's rigid motion.

    Returns their positions (3 n_pilots,) and mode rows (3 n_pilots, n). At least one node must exist, so a body
    without jointed points gets pilots that do not move.
    """
    everyone = np.array([p.position for p in body.reduced.remote_points])
    radius = 0.05 * max(float(np.ptp(everyone, axis=0).max()), 1e-6)
    n = len(frame.flexible)
    if not points:
        return (radius * PILOT_DIRECTIONS).ravel(), np.zeros((12, n))
    positions, rows = [], []
    for point in points:
        start = 6 * body.reduced.point_names.index(point)
        motion = np.zeros((6, len(body.reduced.mass_matrix)))
        motion[:, start : start + 6] = np.eye(6)
        for offset in radius * PILOT_DIRECTIONS:
            positions.append(body.reduced.point(point).position - frame.origin + offset)
            rows.append((rigid_transfer(offset) @ motion[:, frame.flexible])[:3])
    return np.hstack(positions), np.vstack(rows)


def _add_rigid(mbs: Any, body: RigidBody) -> tuple[int | None, int]:
    if body.fixed:
        return None, mbs.AddObject(eii.ObjectGround(referencePosition=list(body.position)))
    node = mbs.AddNode(eii.NodeRigidBodyEP(referenceCoordinates=[*body.position, 1.0, 0.0, 0.0, 0.0]))
    j = np.asarray(body.inertia)
    six = [j[0, 0], j[1, 1], j[2, 2], j[1, 2], j[0, 2], j[0, 1]]
    return node, mbs.AddObject(eii.ObjectRigidBody(nodeNumber=node, mass=body.mass, inertia=six))


def _add_joint(mbs: Any, scene: Scene, joint: Joint, objects: dict[str, int], markers: dict[str, int]) -> None:
    for path in (joint.a, joint.b):
        body, point = scene.split(path)
        if isinstance(body, RigidBody) and path not in markers:
            markers[path] = mbs.AddMarker(
                eii.MarkerBodyRigid(bodyNumber=objects[body.name], localPosition=list(body.points[point]))
            )
    mbs.AddObject(
        eii.ObjectJointGeneric(
            markerNumbers=[markers[joint.a], markers[joint.b]],
            constrainedAxes=[int(direction not in joint.free) for direction in DIRECTIONS],
        )
    )


def _add_actuator(
    mbs: Any,
    scene: Scene,
    assembly: Assembly,
    actuator: StackActuator,
    modal_nodes: dict[str, int],
    input_value: Callable[[str, float], float],
) -> None:
    """A pair of opposite forces inside a body: no work on its frame, so loads on flexible coordinates only."""
    name, row = _flexible_elongation(scene, assembly, actuator)
    force = actuator.gain * actuator.force_per_volt * row
    for coordinate in np.flatnonzero(force):
        marker = mbs.AddMarker(eii.MarkerNodeCoordinate(nodeNumber=modal_nodes[name], coordinate=int(coordinate)))
        mbs.AddLoad(
            eii.LoadCoordinate(
                markerNumber=marker,
                load=float(force[coordinate]),
                loadUserFunction=lambda _mbs, t, load, name=actuator.input: load * input_value(name, t),
            )
        )


def _add_sensor(
    mbs: Any,
    scene: Scene,
    assembly: Assembly,
    sensor: Sensor,
    objects: dict[str, int],
    modal_nodes: dict[str, int],
) -> list[tuple[int, Array]]:
    if isinstance(sensor, StackSensor):
        name, row = _flexible_elongation(scene, assembly, sensor)
        number = mbs.AddSensor(
            eii.SensorNode(
                nodeNumber=modal_nodes[name],
                outputVariableType=exu.OutputVariableType.Coordinates,
                storeInternal=True,
                writeToFile=False,
            )
        )
        return [(number, -sensor.voltage_per_elongation * row)]
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
                    storeInternal=True,
                    writeToFile=False,
                )
            )
            result.append((number, sign * np.eye(3)["xyz".index(sensor.axis)]))
    return result


def _flexible_elongation(scene: Scene, assembly: Assembly, stack: StackActuator | StackSensor) -> tuple[str, Array]:
    """Name of a stack's body, and the stack's elongation per unit of its flexible coordinates, shape (n,)."""
    body, start = scene.split(stack.start)
    _, end = scene.split(stack.end)
    assert isinstance(body, FlexibleBody)
    axis = body.reduced.point(end).position - body.reduced.point(start).position
    axis = axis / np.linalg.norm(axis)
    row = np.zeros(len(body.reduced.mass_matrix))
    for point, sign in ((start, -1.0), (end, 1.0)):
        first = 6 * body.reduced.point_names.index(point)
        row[first : first + 3] += sign * axis
    return body.name, row[assembly.frames[body.name].flexible]


def _damping_blocks(scene: Scene, assembly: Assembly) -> dict[str, Array]:
    """Each flexible body's own block of the damping matrix."""
    if not scene.flexible_bodies:
        return {}
    full = deformation_damping(scene, assembly)
    blocks, start = {}, 0
    for body in scene.flexible_bodies:
        stop = start + len(assembly.frames[body.name].flexible)
        blocks[body.name] = full[start:stop, start:stop]
        start = stop
    return blocks


def _couple_dampings(mbs: Any, scene: Scene, assembly: Assembly, modal_nodes: dict[str, int]) -> None:
    """Damping between the deformations of several flexible bodies, which modal damping of their assembly needs."""
    if len(scene.flexible_bodies) < 2:
        return
    full = deformation_damping(scene, assembly)
    full -= scipy.linalg.block_diag(*_damping_blocks(scene, assembly).values())
    zero = np.zeros_like(full)
    mbs.AddObject(
        eii.ObjectGenericODE2(
            nodeNumbers=[modal_nodes[body.name] for body in scene.flexible_bodies],
            massMatrix=zero,
            stiffnessMatrix=zero,
            dampingMatrix=full,
        )
    )


def _container(matrix: Array) -> Any:
    result = exu.MatrixContainer()
    result.SetWithDenseMatrix(matrix, useDenseMatrix=True)
    return result


def _settings() -> Any:
    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    settings.timeIntegration.verboseMode = 0
    settings.staticSolver.verboseMode = 0
    return settings


def eigenfrequencies(system: System) -> Array:
    """Undamped eigenfrequencies of the system as Exudyn linearises it, ascending [Hz]."""
    eigenvalues, _ = system.mbs.ComputeODE2Eigenvalues()
    result: Array = np.sqrt(np.sort(np.abs(eigenvalues))) / (2 * np.pi)
    return result


def solve_static(system: System) -> None:
    """Bring the system into static equilibrium and keep that as the initial state; RuntimeError without one."""
    settings = _settings()
    # The static solver counts its load steps as time; inputs are to keep their value at t = 0.
    settings.staticSolver.loadStepDuration = 1e-12
    try:
        system.mbs.SolveStatic(settings, updateInitialValues=True)
    except Exception as error:
        raise RuntimeError(
            f"no static equilibrium: can a body move freely? Add joints, or leave gravity out. Exudyn says: {error}"
        ) from error


def solve_dynamic(system: System, n_steps: int, time_step: float, spectral_radius: float, progress: bool) -> None:
    """Integrate by generalized-alpha with a fixed step.

    Ctrl-C ends the run after the step at hand with KeyboardInterrupt; RuntimeError when the integration fails.
    """
    settings = _settings()
    settings.timeIntegration.numberOfSteps = n_steps
    settings.timeIntegration.endTime = n_steps * time_step
    settings.timeIntegration.adaptiveStep = False
    settings.timeIntegration.generalizedAlpha.spectralRadius = spectral_radius
    settings.solution.sensors.writePeriod = time_step
    count = 0
    chunk = max(1, n_steps // 200)
    with stage("simulate", total=n_steps, unit="steps", enabled=progress) as advance, _interrupts() as interrupts:

        def before_step(_mbs: Any, _time: float) -> bool:
            nonlocal count
            count += 1
            if count % chunk == 0:
                advance(chunk)
            return not interrupts

        system.mbs.SetPreStepUserFunction(before_step)
        try:
            system.mbs.SolveDynamic(settings)
        except Exception as error:
            if not interrupts:
                raise RuntimeError(
                    f"the integration failed at t = {count * time_step:g} s; try a smaller time_step or a "
                    f"spectral_radius below 1. {error}"
                ) from error
        if interrupts:
            raise KeyboardInterrupt(f"simulation stopped at t = {count * time_step:g} s")
        advance(n_steps % chunk)


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Collect Ctrl-C instead of raising it: an exception inside one of Exudyn's callbacks would look like a failure."""
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    earlier = signal.signal(signal.SIGINT, lambda number, _frame: received.append(number))
    try:
        yield received
    finally:
        signal.signal(signal.SIGINT, earlier)
