"""What the parts of a scene say, as Exudyn's items, in floating frames and large motion."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np
from exudyn.rigidBodyUtilities import GetRigidBodyNode

from nassim.base.checks import Array
from nassim.base.rigid_motion import DIRECTIONS
from nassim.scene.bodies import FlexibleBody, RigidBody
from nassim.scene.part import Constraint, Field, Force, Line, Row, SixSprings, Spring
from nassim.scene.scene import Scene
from nassim.simulation.exudyn.state import Carrier, Drive, add_forces
from nassim.simulation.rows import shares


Grip = Callable[[Array], int]


@dataclass(frozen=True)
class Items:
    """Exudyn's numbers of a scene's bodies, by name.

    rigid: bodies without deformation, along the world's axes; carriers: of those that deform; nodes: of all that move
    grips: by the path of a point of a body that deforms, what adds a rigid marker there with axes, as columns, world
        frame at the start, (3, 3)
    pilots: object and mesh nodes that make up a point of a floating body, by path
    """

    mbs: Any
    scene: Scene
    nodes: Mapping[str, int]
    objects: Mapping[str, int]
    rigid: Mapping[str, RigidBody]
    carriers: Mapping[str, Carrier]
    grips: Mapping[str, Grip]
    pilots: Mapping[str, tuple[int, list[int]]]
    markers: dict[str, int] = field(default_factory=dict)

    def marker(self, path: str, *, axes: Array | None = None, at: Array | None = None) -> int:
        """Rigid marker of a point.

        axes: its own at the start, as columns, world frame; default: the world's
        at: another place that the point reaches rigidly, world frame at the start, (3,)
        """
        axes = np.eye(3) if axes is None else axes
        offset = np.zeros(3) if at is None else at - self.scene.point_position(path)
        key = f"{path} {offset.tolist()} {axes.tolist()}"
        if key not in self.markers:
            self.markers[key] = self._new_marker(path, axes, offset)
        return self.markers[key]

    def _new_marker(self, path: str, axes: Array, offset: Array) -> int:
        name, _, point = path.partition(".")
        if name in self.rigid:
            return add_rigid_marker(self.mbs, self.objects[name], axes, self.rigid[name].points[point] + offset)
        if path not in self.grips:
            raise ValueError(
                f"{path!r} is no coordinate of a body in small motion any more; in a floating frame it can be"
            )
        if not np.any(offset):
            return self.grips[path](axes)
        number = add_weightless(self.mbs, self.scene.point_position(path))
        held = [self.grips[path](np.eye(3)), add_rigid_marker(self.mbs, number, np.eye(3), np.zeros(3))]
        self.mbs.AddObject(eii.ObjectJointGeneric(markerNumbers=held, constrainedAxes=[1] * 6))
        return add_rigid_marker(self.mbs, number, axes, offset)

    def fidelity(self, path: str) -> str:
        """Of a point's body: "rigid", "linear" or "ffrf"."""
        name = path.partition(".")[0]
        body = self.scene.split(f"{name}.")[0]
        return body.fidelity if isinstance(body, FlexibleBody) and name not in self.rigid else "rigid"

    def moves(self, path: str) -> bool:
        """Whether a point's body does."""
        return path.partition(".")[0] in self.nodes


def add_rigid_marker(mbs: Any, number: int, axes: Array, position: Array) -> int:
    """Add a marker with axes at a position of a body along the world's axes."""
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = axes, position
    return int(mbs.AddMarker(eii.MarkerBodyRigid(bodyNumber=number, localHT=place)))


def add_weightless(mbs: Any, position: Array) -> int:
    """Add a body without mass, for joints to hold; returns its number."""
    node = mbs.AddNode(GetRigidBodyNode(exu.NodeType.RotationEulerParameters, position=list(position)))
    return int(mbs.AddObject(eii.ObjectRigidBody(nodeNumber=node, mass=0.0, inertia=[0.0] * 6)))


def add_force(items: Items, word: Force) -> list[Drive]:
    """Add what an input pushes through: a line, coordinates of bodies, and loads at points."""
    rate, gain = 2 * np.pi * word.bandwidth, word.gain
    if isinstance(word.row, Line):
        markers = [items.marker(path) for path in word.row.paths]
        number = items.mbs.AddObject(eii.ObjectConnectorSpringDamper(markerNumbers=markers, force=0.0))
        return [Drive(number, word.input, np.array(-gain), "force", rate)]
    drives = []
    nodes = on_coordinates(items, word.row)
    if nodes:
        # Forces in balance inside a body do no work on its frame, so they act on coordinates of deformation only.
        forces = gain * np.concatenate([row for _, row in nodes])
        number = add_forces(items.mbs, [node for node, _ in nodes], len(forces))
        drives.append(Drive(number, word.input, forces, "forceVector", rate))
    for path, weights in on_points(items, word.row):
        if word.row.frame not in ("", path):
            raise ValueError(
                f"{path!r}: in large motion a force acts along the world's axes, those of its own point or a line"
            )
        for load, vector in ((eii.LoadForceVector, weights[:3]), (eii.LoadTorqueVector, weights[3:])):
            if np.any(vector):
                own = bool(word.row.frame)
                number = items.mbs.AddLoad(load(markerNumber=items.marker(path), loadVector=[0.0] * 3, bodyFixed=own))
                drives.append(Drive(number, word.input, gain * vector, "loadVector", rate))
    return drives


def add_field(items: Items, word: Field) -> list[Drive]:
    """Add a uniform acceleration of every body that moves."""
    drives = []
    for name in items.nodes:
        if items.fidelity(name) == "linear":
            numbers = [number for number, _ in items.carriers[name].nodes]
            weight = items.scene.split(f"{name}.")[0].weight(word.direction)
            forces = items.carriers[name].coordinates.T @ weight
            drives.append(Drive(add_forces(items.mbs, numbers, len(forces)), word.input, forces))
        else:
            marker = items.mbs.AddMarker(eii.MarkerBodyMass(bodyNumber=items.objects[name]))
            number = items.mbs.AddLoad(eii.LoadMassProportional(markerNumber=marker, loadVector=[0.0, 0.0, 0.0]))
            drives.append(Drive(number, word.input, word.direction, "loadVector"))
    return drives


def add_spring(items: Items, word: Spring) -> None:
    """Add a spring-damper, relaxed at the start: within bodies, along a line, or along a direction."""
    nodes = on_coordinates(items, word.row) if word.row.within else []
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
    elif isinstance(word.row, Line):
        a, b = word.row.paths
        length = float(np.linalg.norm(items.scene.point_position(b) - items.scene.point_position(a)))
        items.mbs.AddObject(
            eii.ObjectConnectorSpringDamper(
                markerNumbers=[items.marker(a), items.marker(b)],
                referenceLength=length,
                stiffness=word.stiffness,
                damping=word.damping,
            )
        )
    elif not word.row.within:
        _add_spring_along(items, word, word.row)


def _add_spring_along(items: Items, word: Spring, row: Row) -> None:
    """A spring between two points along a direction of the world, or of one of the points."""
    (a, along_a), (b, along_b) = row.points
    if np.any(along_b[3:]) or np.any(along_a + along_b):
        raise ValueError(f"between {a!r} and {b!r}: in large motion a spring acts on the distance along a direction")
    along = along_b[:3]
    if not row.frame and np.count_nonzero(along) == 1:
        items.mbs.AddObject(
            eii.ObjectConnectorCartesianSpringDamper(
                markerNumbers=[items.marker(a), items.marker(b)],
                stiffness=list(word.stiffness * along**2),
                damping=list(word.damping * along**2),
                offset=list(items.scene.point_position(b) - items.scene.point_position(a)),
            )
        )
        return
    frame = row.frame or next((path for path in (a, b) if not items.moves(path)), "")
    if frame not in (a, b):
        raise ValueError(
            f"between {a!r} and {b!r}: in large motion a spring acts along one of the world's axes, or along any "
            "direction of one of its points (frame=...), or of the ground that one of them belongs to"
        )
    other = b if frame == a else a
    six = np.zeros((6, 6))
    six[:3, :3] = np.outer(along, along)
    held, place = items.marker(frame, at=items.scene.point_position(other)), items.marker(other)
    if items.moves(frame):
        place = _companion(items, held, place, items.scene.point_position(other))
    _connect(items, (held, place), word.stiffness * six, word.damping * six)


def _companion(items: Items, a: int, b: int, position: Array) -> int:
    """Marker of a weightless body that goes with the place of marker b and turns with marker a.

    Between a and this body a spring may pull anywhere between them, while the two do not turn against each other: its
    moment on a's body is then the one of a force at the place of b.
    """
    marker = add_rigid_marker(items.mbs, add_weightless(items.mbs, position), np.eye(3), np.zeros(3))
    for other, held in ((a, [0, 0, 0, 1, 1, 1]), (b, [1, 1, 1, 0, 0, 0])):
        items.mbs.AddObject(eii.ObjectJointGeneric(markerNumbers=[other, marker], constrainedAxes=held))
    return marker


def add_six_springs(items: Items, word: SixSprings) -> None:
    """Add a bushing: where its points lie apart, a's body reaches rigidly to the place of b."""
    place = items.scene.point_position(word.b)
    markers = items.marker(word.a, axes=word.axes, at=place), items.marker(word.b, axes=word.axes)
    _connect(items, markers, word.stiffness, word.damping)


def _connect(items: Items, markers: tuple[int, int], stiffness: Array, damping: Array) -> None:
    """Exudyn's six-dimensional spring between two markers in one place, whose axes turn along halfway between both.

    Its other formulation, along the axes of the first marker, forgets the moment that a displacement gives the force,
    and damps common turns.
    """
    items.mbs.AddObject(
        eii.ObjectConnectorRigidBodySpringDamper(
            markerNumbers=list(markers),
            stiffness=stiffness,
            damping=damping,
            useIntrinsicFormulation=True,
        )
    )


def add_constraint(items: Items, word: Constraint, held: tuple[str, ...]) -> None:
    """Add a joint that holds the given ones of its directions."""
    items.mbs.AddObject(
        eii.ObjectJointGeneric(
            markerNumbers=[items.marker(path, axes=word.axes) for path in (word.a, word.b)],
            constrainedAxes=[int(direction in held) for direction in DIRECTIONS],
        )
    )


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
