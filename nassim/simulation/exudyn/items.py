"""What the parts of a scene say, as Exudyn's items, in floating frames and large motion."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import DIRECTIONS
from nassim.scene.bodies import FlexibleBody, RigidBody
from nassim.scene.part import Constraint, Field, Follow, Force, Line, Row
from nassim.scene.scene import Scene
from nassim.simulation.exudyn.state import Carrier, Push, add_forces
from nassim.simulation.rows import shares

TOUCHING = 1e-12
"""Distance [m] up to which two points lie in one place."""
Place = tuple[str, tuple[float, float, float]]
"""A point, and the offset [m] from it of a place that goes with it rigidly; world frame at the start."""
Grip = Callable[[Array], int]
"""Adds a rigid marker with axes, (3, 3), as columns; world frame at the start."""


@dataclass(frozen=True)
class Items:
    """Exudyn's numbers of a scene's bodies, by name.

    rigid: bodies without deformation, along the world's axes, as parts of what is one with them
    carriers: of bodies that deform; nodes: of all that move, which those that are one share
    own: one of each that are one, and all others that move; welded: names of joints that need not be closed
    grips: by the path of a point of a body that deforms, and an offset, what adds a rigid marker there
    pilots: object and mesh nodes that make up a point of a floating body, by path
    """

    mbs: Any
    scene: Scene
    nodes: Mapping[str, int]
    own: Sequence[str]
    welded: frozenset[str]
    objects: Mapping[str, int]
    rigid: Mapping[str, RigidBody]
    carriers: Mapping[str, Carrier]
    grips: Mapping[Place, Grip]
    pilots: Mapping[str, tuple[int, list[int]]]
    markers: dict[str, int] = field(default_factory=dict)
    sensors: dict[tuple[int, exu.OutputVariableType], int] = field(default_factory=dict)

    def marker(self, path: str, *, axes: Array | None = None, at: Array | None = None) -> int:
        """Rigid marker of a point.

        axes: its own at the start, as columns, world frame; default: the world's
        at: another place that the point reaches rigidly, world frame at the start, (3,)
        """
        axes = np.eye(3) if axes is None else axes
        offset = (0.0, 0.0, 0.0) if at is None else offset_of(self.scene, path, at)
        key = f"{path} {offset} {axes.tolist()}"
        if key not in self.markers:
            self.markers[key] = self._new_marker(path, axes, offset)
        return self.markers[key]

    def _new_marker(self, path: str, axes: Array, offset: tuple[float, float, float]) -> int:
        name, _, point = path.partition(".")
        if name in self.rigid:
            place = frame_at(self.rigid[name].points[point] + offset, axes)
            return int(self.mbs.AddMarker(eii.MarkerBodyRigid(bodyNumber=self.objects[name], localHT=place)))
        if (path, offset) in self.grips:
            return self.grips[path, offset](axes)
        if any(offset):
            raise ValueError(
                f'{path!r} belongs to a body of fidelity "linear", which beside floating frames reaches to no other '
                "place: let the points coincide"
            )
        raise ValueError(f"{path!r} is no coordinate of a body in small motion any more; in a floating frame it can be")

    def sensor(self, marker: int, kind: exu.OutputVariableType) -> int:
        """Sensor of a marker's motion."""
        if (marker, kind) not in self.sensors:
            sensor = eii.SensorMarker(
                markerNumber=marker, outputVariableType=kind, storeInternal=True, writeToFile=False
            )
            self.sensors[marker, kind] = int(self.mbs.AddSensor(sensor))
        return self.sensors[marker, kind]

    def fidelity(self, path: str) -> str:
        """Of a point's body: "rigid", "linear" or "ffrf"."""
        name = path.partition(".")[0]
        body = self.scene.split(f"{name}.")[0]
        return body.fidelity if isinstance(body, FlexibleBody) and name not in self.rigid else "rigid"

    def node_of(self, path: str) -> int:
        """Node of a point of a body in small motion."""
        body, point = self.scene.split(path)
        assert isinstance(body, FlexibleBody)
        return self.carriers[body.name].nodes[body.reduced.point_names.index(point)][0]

    def moves(self, path: str) -> bool:
        """Whether a point's body does."""
        return path.partition(".")[0] in self.nodes


def offset_of(scene: Scene, path: str, place: Array) -> tuple[float, float, float]:
    """From a point to a place, as in `Place`; nothing where rounding parts them."""
    x, y, z = (place - scene.point_position(path)).tolist()
    return (x, y, z) if max(abs(x), abs(y), abs(z)) > TOUCHING else (0.0, 0.0, 0.0)


def frame_at(position: Array, axes: Array) -> Array:
    """The homogeneous transformation, (4, 4), of a place with axes."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = axes, position
    return result


def add_force(items: Items, word: Force) -> list[Push]:
    """Add what an input pushes through: a line, coordinates of bodies, and loads at points."""
    rate, gain = 2 * np.pi * word.bandwidth, word.gain
    if isinstance(word.row, Line):
        markers = [items.marker(path) for path in word.row.paths]
        number = items.mbs.AddObject(eii.ObjectConnectorSpringDamper(markerNumbers=markers, force=0.0))
        return [Push(number, word.input, np.array(-gain), "force", rate)]
    drives = []
    nodes = on_coordinates(items, word.row)
    if nodes:
        # Forces in balance inside a body do no work on its frame, so they act on coordinates of deformation only.
        forces = gain * np.concatenate([row for _, row in nodes])
        number = add_forces(items.mbs, [node for node, _ in nodes], len(forces))
        drives.append(Push(number, word.input, forces, "forceVector", rate))
    for path, weights in on_points(items, word.row):
        if word.row.frame not in ("", path):
            raise ValueError(
                f"{path!r}: in large motion a force acts along the world's axes, those of its own point or a line"
            )
        for load, vector in ((eii.LoadForceVector, weights[:3]), (eii.LoadTorqueVector, weights[3:])):
            if np.any(vector):
                own = bool(word.row.frame)
                number = items.mbs.AddLoad(load(markerNumber=items.marker(path), loadVector=[0.0] * 3, bodyFixed=own))
                drives.append(Push(number, word.input, gain * vector, "loadVector", rate))
    return drives


def add_field(items: Items, word: Field) -> list[Push]:
    """Add a uniform acceleration of every body that moves."""
    drives = []
    for name in items.own:
        if items.fidelity(name) == "linear":
            numbers = [number for number, _ in items.carriers[name].nodes]
            weight = items.scene.split(f"{name}.")[0].weight(word.direction)
            forces = items.carriers[name].coordinates.T @ weight
            drives.append(Push(add_forces(items.mbs, numbers, len(forces)), word.input, forces))
        else:
            marker = items.mbs.AddMarker(eii.MarkerBodyMass(bodyNumber=items.objects[name]))
            number = items.mbs.AddLoad(eii.LoadMassProportional(markerNumber=marker, loadVector=[0.0, 0.0, 0.0]))
            drives.append(Push(number, word.input, word.direction, "loadVector"))
    return drives


def add_constraint(items: Items, word: Constraint, held: tuple[str, ...], driven: Sequence[Follow]) -> list[Push]:
    """Add a joint that holds the given ones of its directions, where those that are driven follow their drives."""
    markers = [items.marker(path, axes=word.axes) for path in (word.a, word.b)]
    motion, pushes = _motion(markers[0], driven) if driven else ({}, [])
    items.mbs.AddObject(
        eii.ObjectJointGeneric(
            markerNumbers=markers,
            constrainedAxes=[int(direction in held) for direction in DIRECTIONS],
            **motion,
        )
    )
    return pushes


def _motion(marker: int, driven: Sequence[Follow]) -> tuple[dict[str, Any], list[Push]]:
    """How a joint moves by its drives, as Exudyn's function of time, and what their inputs set."""
    speeds, offsets, pushes = np.zeros(6), [np.zeros(6)], []
    for follow in driven:
        unit = np.eye(6)[list(DIRECTIONS).index(follow.direction)]
        speeds += follow.speed * unit
        if follow.input:
            offsets.append(np.zeros(6))
            pushes.append(Push(-1, follow.input, unit, rate=2 * np.pi * follow.bandwidth, offset=offsets[-1]))
    shifts = any(not follow.direction.startswith("r") for follow in driven)

    def offset(mbs: Any, time: float, _item: int, _parameters: Any) -> list[float]:
        motion = sum(offsets) + speeds * time
        # Exudyn takes turns along the marker's axes, but shifts along the world's, which do not turn with the joint.
        if shifts:
            axes = np.reshape(mbs.GetMarkerOutput(marker, exu.OutputVariableType.RotationMatrix), (3, 3))
            motion = np.concatenate([axes @ motion[:3], motion[3:]])
        result: list[float] = motion.tolist()
        return result

    return {"offsetUserFunction": offset}, pushes


def on_coordinates(items: Items, row: Row) -> list[tuple[int, Array]]:
    """A row's weights on the coordinates of bodies that deform, by node.

    These are of bodies whose own shape it counts, and points of bodies in small motion.
    """
    if not row.within:
        near = () if row.frame else tuple(p for p in row.points if items.fidelity(p[0]) == "linear")
        row = Row(points=near, own=row.own)
    found = shares(items.scene, row)
    return [
        part for name, share in found.items() if name in items.carriers for part in items.carriers[name].parts(share)
    ]


def on_points(items: Items, row: Row) -> list[tuple[str, Array]]:
    """Points, and weights (6,) on their motions, that move by more than `on_coordinates` knows."""
    if row.within:
        return []
    return [
        (path, weights)
        for path, weights in row.points
        if items.moves(path) and (row.frame or items.fidelity(path) != "linear")
    ]
