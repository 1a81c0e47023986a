"""Exudyn's items of a scene in large motion: bodies by name, markers, forces of inputs, constraints."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np

from nassim.base.checks import Array
from nassim.scene.bodies import Body, FlexibleBody, RigidBody
from nassim.scene.field_kinds import body_of
from nassim.scene.measures import BodyCoordinates, Combination, DirectionalMeasure, Distance, Measure, PointVelocity
from nassim.scene.rotation_measures import MATRIX, RelativePose
from nassim.scene.scene import Scene
from nassim.scene.terms import AppliedForce, BaseAcceleration, Constraint, PrescribedMotion
from nassim.simulation.exudyn.general_items import BodyNodes, Evaluator, add_general_actuator, add_general_constraint
from nassim.simulation.exudyn.input_channels import InputChannel, add_forces
from nassim.simulation.exudyn.running_system import STORED, FlexibleCoordinates
from nassim.simulation.model.rigid_groups import CarriedBody
from nassim.simulation.model.states import ReferenceState

SAME_PLACE = 1e-12
"""Distance [m] up to which two points coincide."""
Place = tuple[str, tuple[float, float, float]]
"""A point, and the offset [m] of a place that moves rigidly with it; world frame at the start."""
NO_OFFSET = (0.0, 0.0, 0.0)
MarkerFactory = Callable[[Array], int]
"""Function that adds a rigid marker with axes, (3, 3), as columns; world frame at the start."""


@dataclass(frozen=True)
class Items:
    """Exudyn's numbers of a scene's bodies, by name.

    Attributes:
        mbs: Exudyn's system.
        scene: the scene.
        rigid_joints: names of joints within rigid groups and of their hosts, which need no item.
        carried: bodies without deformation that floating bodies carry.
        grounded: points of flexible bodies that rigid joints hold to the ground, by body; they have no coordinates.
        nodes: nodes of the frames of bodies; the bodies of a rigid group share theirs, and carried bodies have their
            host's. Bodies whose frame the ground holds have none.
        point_nodes: nodes whose motion is that of a point of a flexible body, by path.
        own: one body of each rigid group that is not carried, and all other bodies with a node of their frame.
        objects: objects of all bodies.
        rigid: bodies without deformation, along the world's axes, as parts of their rigid groups.
        flexible: coordinates of bodies that deform.
        marker_factories: functions that add a rigid marker, by the path of a point of a body that deforms or is
            carried, and an offset.
        virtual_nodes: object and mesh nodes that define a point of a floating body, by path.
        body_nodes: Exudyn's nodes of the moving bodies.
        markers: markers added so far.
        sensors: sensors of markers added so far.
        evaluators: evaluators of measures made so far.
        joints: objects of the joints without drives, by name.
    """

    mbs: Any
    scene: Scene
    rigid_joints: frozenset[str]
    carried: Mapping[str, CarriedBody]
    grounded: Mapping[str, frozenset[str]]
    nodes: dict[str, int] = field(default_factory=dict)
    point_nodes: dict[str, int] = field(default_factory=dict)
    own: list[str] = field(default_factory=list)
    objects: dict[str, int] = field(default_factory=dict)
    rigid: dict[str, RigidBody] = field(default_factory=dict)
    flexible: dict[str, FlexibleCoordinates] = field(default_factory=dict)
    marker_factories: dict[Place, MarkerFactory] = field(default_factory=dict)
    virtual_nodes: dict[str, tuple[int, list[int]]] = field(default_factory=dict)
    body_nodes: dict[str, BodyNodes] = field(default_factory=dict)
    markers: dict[str, int] = field(default_factory=dict)
    sensors: dict[tuple[int, exu.OutputVariableType], int] = field(default_factory=dict)
    evaluators: list[Evaluator] = field(default_factory=list)
    joints: dict[str, int] = field(default_factory=dict)

    def marker(self, path: str, *, axes: Array | None = None, at: Array | None = None) -> int:
        """Return a rigid marker of a point, added if required.

        Args:
            path: the point, "body.point".
            axes: axes of the marker at the start, as columns, world frame, (3, 3); default: the world's.
            at: another place to which the point's body is extended rigidly, world frame at the start, (3,).

        Returns:
            The marker's number.
        """
        axes = np.eye(3) if axes is None else axes
        offset = NO_OFFSET if at is None else offset_of(self.scene, path, at)
        key = f"{path} {offset} {axes.tolist()}"
        if key not in self.markers:
            self.markers[key] = self._new_marker(path, axes, offset)
        return self.markers[key]

    def _new_marker(self, path: str, axes: Array, offset: tuple[float, float, float]) -> int:
        name, _, point = path.partition(".")
        if name in self.rigid:
            place = frame_at(self.rigid[name].points[point] + offset, axes)
            return int(self.mbs.AddMarker(eii.MarkerBodyRigid(bodyNumber=self.objects[name], localHT=place)))
        if (path, offset) in self.marker_factories:
            return self.marker_factories[path, offset](axes)
        raise ValueError(f"{path!r} is no longer a coordinate of a body in small motion; use a floating frame")

    def sensor(self, marker: int, kind: exu.OutputVariableType) -> int:
        """Return a sensor of a marker's motion, added if required."""
        if (marker, kind) not in self.sensors:
            sensor = eii.SensorMarker(markerNumber=marker, outputVariableType=kind, **STORED)
            self.sensors[marker, kind] = int(self.mbs.AddSensor(sensor))
        return self.sensors[marker, kind]

    def fidelity(self, path: str) -> str:
        """Return the fidelity of a point's body, "rigid", "linear" or "ffrf"; "linear" also about the ground."""
        name = body_of(path)
        if self.host(name) in self.grounded:
            return "linear"
        body = self.scene.body(name)
        return body.fidelity if isinstance(body, FlexibleBody) else "rigid"

    def host(self, name: str) -> str:
        """Return the name of the body that carries a body, or of the body itself."""
        return self.carried[name].host.name if name in self.carried else name

    def body(self, name: str) -> Body:
        """Return a body, in the coordinates of the body that carries it where there is one."""
        return self.carried[name] if name in self.carried else self.scene.body(name)

    def evaluator(self, measure: Measure) -> Evaluator:
        """Return an evaluator of a measure on Exudyn's coordinates; bodies that joints hold to the ground have none."""
        fixed = {body.name: ReferenceState(body) for body in self.scene.bodies if body.name not in self.body_nodes}
        self.evaluators.append(Evaluator(measure, self.body_nodes, fixed))
        return self.evaluators[-1]

    def has_markers(self, measure: Measure) -> bool:
        """Whether all points of a measure can have rigid markers."""
        return all(self.has_marker(path) for path in measure.points)

    def has_marker(self, path: str) -> bool:
        """Whether a point can have a rigid marker."""
        return body_of(path) in self.rigid or (path, NO_OFFSET) in self.marker_factories

    def add_body_force(self, name: str, acceleration: Array) -> tuple[int, float]:
        """Add the load of a uniform body force per mass on a body.

        Exudyn's load that is proportional to mass leaves out the moment of the force on the deformation of a floating
        frame, which does not conserve energy. There the force acts on the centre of mass of the deformed body.

        Args:
            name: name of the body.
            acceleration: body force per mass, world frame, (3,) [m/s2].

        Returns:
            Number of the load, and its load vector per unit of the acceleration.
        """
        number = self.objects[name]
        if self.fidelity(name) != "ffrf":
            marker = self.mbs.AddMarker(eii.MarkerBodyMass(bodyNumber=number))
            return self.mbs.AddLoad(eii.LoadMassProportional(markerNumber=marker, loadVector=list(acceleration))), 1.0
        properties = self.mbs.GetObject(number)
        mass, centre = properties["mass"], len(properties["referencePositions"]) // 3 - 1
        marker = self.mbs.AddMarker(
            eii.MarkerSuperElementPosition(bodyNumber=number, meshNodeNumbers=[centre], weightingFactors=[1.0])
        )
        load = eii.LoadForceVector(markerNumber=marker, loadVector=list(mass * np.asarray(acceleration)))
        return self.mbs.AddLoad(load), mass

    def moves(self, path: str) -> bool:
        """Whether a point's body moves."""
        return body_of(path) in self.body_nodes


def offset_of(scene: Scene, path: str, place: Array) -> tuple[float, float, float]:
    """Return the offset from a point to a place, see `Place`; zero where it is rounding."""
    x, y, z = (place - scene.point_position(path)).tolist()
    return (x, y, z) if max(abs(x), abs(y), abs(z)) > SAME_PLACE else NO_OFFSET


def frame_at(position: Array, axes: Array) -> Array:
    """Return the homogeneous transformation, (4, 4), of a position with axes."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = axes, position
    return result


def add_force(items: Items, term: AppliedForce) -> list[InputChannel]:
    """Add the forces of an input: on a line, on coordinates of bodies, as loads at points, or along any measure.

    Args:
        items: Exudyn's items of the scene.
        term: the applied force.

    Returns:
        The channels of the input.
    """
    rate, gain, measure = 2 * np.pi * term.bandwidth, term.gain, term.measure
    if isinstance(measure, Distance) and items.has_markers(measure):
        markers = [items.marker(path) for path in measure.points]
        number = items.mbs.AddObject(eii.ObjectConnectorSpringDamper(markerNumbers=markers, force=0.0))
        return [InputChannel(number, term.input, np.array(-gain), "force", rate)]
    nodes, loads = on_coordinates(items, measure), on_points(items, measure)
    if nodes is None or loads is None or not _is_load(measure):
        strength = add_general_actuator(items.mbs, items.evaluator(measure), term)
        return [InputChannel(-1, term.input, np.ones(1), rate=rate, offset=strength)]
    channels = []
    if nodes:
        # Forces in balance inside a body do no work on its frame, so they act on coordinates of deformation only.
        forces = gain * np.concatenate([row for _, row in nodes])
        number = add_forces(items.mbs, [node for node, _ in nodes], len(forces))
        channels.append(InputChannel(number, term.input, forces, "forceVector", rate))
    for path, weights in loads:
        load, own = eii.LoadTorqueVector if measure.angular else eii.LoadForceVector, bool(measure.axes_of)
        number = items.mbs.AddLoad(load(markerNumber=items.marker(path), loadVector=[0.0] * 3, bodyFixed=own))
        channels.append(InputChannel(number, term.input, gain * weights, "loadVector", rate))
    return channels


def add_base_acceleration(items: Items, term: BaseAcceleration) -> list[InputChannel]:
    """Add a uniform acceleration of every moving body, opposite to that of the base."""
    channels = []
    others = [name for name in items.body_nodes if name not in items.nodes]
    for name in (*items.own, *others):
        if name not in items.nodes or items.fidelity(name) == "linear":
            flexible = items.flexible[items.host(name)]
            numbers = [number for number, _ in flexible.nodes]
            forces = flexible.coordinates.T @ items.body(name).weight(-term.direction)
            channels.append(InputChannel(add_forces(items.mbs, numbers, len(forces)), term.input, forces))
        else:
            number, factor = items.add_body_force(name, np.zeros(3))
            channels.append(InputChannel(number, term.input, -factor * np.asarray(term.direction), "loadVector"))
    return channels


def add_constraint(
    items: Items, term: Constraint, held: tuple[str, ...], driven: Sequence[PrescribedMotion]
) -> list[InputChannel]:
    """Add a constraint that holds some of its components; driven components follow their drives.

    Args:
        items: Exudyn's items of the scene.
        term: the constraint.
        held: names of the held components, driven ones included.
        driven: prescribed motions of the constraint.

    Returns:
        The channels of the drives' inputs.
    """
    measure = term.measure
    is_joint = isinstance(measure, RelativePose) and measure.rotation == MATRIX and items.has_markers(measure)
    if not is_joint:
        offset, channels = _prescribed(term, driven)
        components = tuple(c for c in measure.components if c in held)
        rows = term.rows(components)
        evaluate = items.evaluator(measure)
        add_general_constraint(items.mbs, evaluate, term, components, lambda time: offset(time)[rows])
        return channels
    assert isinstance(measure, RelativePose)
    markers = [items.marker(path, axes=measure.axes) for path in measure.points]
    if not driven:
        items.joints[term.name], _ = _add_joint(items, term, markers, held, ())
        return []
    turning = [drive for drive in driven if measure.rotation_axis(drive.component) is not None]
    shifting = [drive for drive in driven if drive not in turning]
    across = tuple(c for c in held if measure.rotation_axis(c) is None)
    about = tuple(c for c in held if c not in across)
    # Exudyn turns the axes of the first marker by the drives, so held displacements have a joint of their own. Where it
    # holds all three, it takes them along the world's axes, and their forces have no moment by the shift.
    parts = [across[:1], across[1:]] if shifting and len(across) == 3 else [across]
    channels = []
    for part in filter(None, parts):
        channels += _add_joint(items, term, markers, part, [drive for drive in shifting if drive.component in part])[1]
    if not about:
        return channels
    # The second arm of a universal joint is fixed in b, and turns a back.
    sign = -1 if _turns_second_arm(term, driven) else 1
    return channels + _add_joint(items, term, markers[::sign], about, turning, sign)[1]


def _turns_second_arm(term: Constraint, driven: Sequence[PrescribedMotion]) -> bool:
    """Whether drives turn the second arm of a universal joint and leave its first arm free."""
    turns = [c for c in term.measure.components if c.startswith("r") and c not in term.held]
    return len(turns) == 2 and [d.component for d in driven if d.component.startswith("r")] == turns[1:]


def _add_joint(
    items: Items,
    term: Constraint,
    markers: list[int],
    held: tuple[str, ...],
    driven: Sequence[PrescribedMotion],
    sign: float = 1.0,
) -> tuple[int, list[InputChannel]]:
    """Add a joint of Exudyn between two markers, see `add_constraint`; the motions of drives count with a sign.

    Returns:
        The joint's number, and the channels of the drives' inputs.
    """
    motion, channels = _joint_motion(term, driven, sign) if driven else ({}, [])
    number = items.mbs.AddObject(
        eii.ObjectJointGeneric(
            markerNumbers=markers,
            constrainedAxes=[int(component in held) for component in term.measure.components],
            **motion,
        )
    )
    return int(number), channels


def _prescribed(
    term: Constraint, driven: Sequence[PrescribedMotion], sign: float = 1.0
) -> tuple[Callable[[float], Array], list[InputChannel]]:
    """Return all components of a constraint's measure as a function of time, and the channels of its inputs."""
    n = len(term.measure.components)
    offsets: list[Array] = []
    speeds, channels = np.zeros(n), []
    for drive in driven:
        unit = sign * np.eye(n)[term.rows((drive.component,))[0]]
        speeds += drive.speed * unit
        if drive.input:
            offsets.append(np.zeros(n))
            channels.append(InputChannel(-1, drive.input, unit, rate=2 * np.pi * drive.bandwidth, offset=offsets[-1]))

    def offset(time: float) -> Array:
        result: Array = speeds * time
        for own in offsets:  # a loop is faster than a sum of arrays, and Exudyn asks a dozen times a step
            result = result + own
        return result

    return offset, channels


def _joint_motion(
    term: Constraint, driven: Sequence[PrescribedMotion], sign: float
) -> tuple[dict[str, Any], list[InputChannel]]:
    """Return a joint's motion by its drives as an option for Exudyn, and the channels of their inputs."""
    value, channels = _prescribed(term, driven, sign)

    def offset(_mbs: Any, time: float, _item: int, _parameters: Any) -> list[float]:
        motion: list[float] = value(time).tolist()
        return motion

    return {"offsetUserFunction": offset}, channels


def on_coordinates(items: Items, measure: Measure) -> list[tuple[int, Array]] | None:
    """Return a measure's weights on the coordinates of bodies that deform, by node; None for other measures.

    These are measures of bodies' own coordinates, and of points of bodies in small motion along the world's axes.
    """
    found: list[tuple[int, Array]] = []
    for factor, part in _parts(measure):
        if isinstance(part, BodyCoordinates):
            found += _by_nodes(items, part.body, factor * np.asarray(part.weights))
        elif isinstance(part, DirectionalMeasure) and part is measure:
            for path, weights in part.weights if not part.axes_of else ():
                if items.fidelity(path) == "linear":
                    first = 3 * part.angular
                    name, _, point = path.partition(".")
                    found += _by_nodes(
                        items, items.host(name), weights @ items.body(name).motion(point)[first : first + 3]
                    )
        else:
            return None
    return found


def on_points(items: Items, measure: Measure) -> list[tuple[str, Array]] | None:
    """Return a measure's points of moving bodies with directions, (3,), beyond `on_coordinates`; else None."""
    if not isinstance(measure, DirectionalMeasure):
        return []
    found = []
    for path, weights in measure.weights:
        if items.moves(path) and (measure.axes_of or items.fidelity(path) != "linear"):
            if not items.has_marker(path):
                return None
            found.append((path, np.asarray(weights)))
    return found


def _parts(measure: Measure) -> tuple[tuple[float, Measure], ...]:
    """Return factors and measures of a combination, or the measure itself."""
    return measure.parts if isinstance(measure, Combination) else ((1.0, measure),)


def _by_nodes(items: Items, name: str, row: Array) -> list[tuple[int, Array]]:
    """Return a row over a body's coordinates by nodes; nothing for a body without deformation."""
    return items.flexible[name].parts(row) if name in items.flexible else []


def _is_load(measure: Measure) -> bool:
    """Whether loads at points realise a force along a measure: along the world's axes, or those of its only point."""
    own = isinstance(measure, PointVelocity) and [measure.axes_of] == [path for path, _ in measure.weights]
    return not measure.axes_of or own
