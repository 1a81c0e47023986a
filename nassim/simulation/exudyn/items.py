"""What the parts of a scene say, as Exudyn's items, in floating frames and large motion."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import exudyn.itemInterface as eii
import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import DIRECTIONS, axes_along
from nassim.scene.bodies import FlexibleBody, RigidBody
from nassim.scene.part import Constraint, Field, Force, Line, Row, SixSprings, Spring
from nassim.scene.scene import Scene
from nassim.simulation.exudyn.state import Carrier, Drive, add_forces
from nassim.simulation.rows import shares


@dataclass(frozen=True)
class Items:
    """Exudyn's numbers of a scene's bodies, by name; markers of points by path.

    rigid: bodies without deformation, along the world's axes; carriers: of those that deform; nodes: of all that move
    pilots: object and mesh nodes that make up a point of a floating body, by path
    """

    mbs: Any
    scene: Scene
    nodes: Mapping[str, int]
    objects: Mapping[str, int]
    rigid: Mapping[str, RigidBody]
    carriers: Mapping[str, Carrier]
    markers: dict[str, int]
    pilots: Mapping[str, tuple[int, list[int]]]

    def marker(self, path: str, *, at: Array | None = None) -> int:
        """Rigid marker of a point, whose axes are the world's at the start.

        at: another place on the point's rigid body, world frame at the start, (3,)
        """
        name, _, point = path.partition(".")
        if name in self.rigid:
            key = path if at is None else f"{path} at {at.tolist()}"
            if key not in self.markers:
                offset = self.rigid[name].points[point] if at is None else at - self.rigid[name].position
                marker = eii.MarkerBodyRigid(bodyNumber=self.objects[name], localPosition=list(offset))
                self.markers[key] = self.mbs.AddMarker(marker)
            return self.markers[key]
        if at is not None and np.linalg.norm(at - self.scene.point_position(path)) > 1e-12:
            raise ValueError(f"{path!r} belongs to a flexible body, which reaches to no other place")
        if path not in self.markers:
            raise ValueError(
                f"{path!r} is no coordinate of a body in small motion any more; in a floating frame it can be"
            )
        return self.markers[path]

    def fidelity(self, path: str) -> str:
        """Of a point's body: "rigid", "linear" or "ffrf"."""
        name = path.partition(".")[0]
        body = self.scene.split(f"{name}.")[0]
        return body.fidelity if isinstance(body, FlexibleBody) and name not in self.rigid else "rigid"

    def moves(self, path: str) -> bool:
        """Whether a point's body does."""
        return path.partition(".")[0] in self.nodes


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
    six = np.zeros((6, 6))
    six[0, 0] = along @ along
    axes = np.roll(axes_along(along), 1, axis=1)
    _connect(items, frame, b if frame == a else a, axes, word.stiffness * six, word.damping * six)


def add_six_springs(items: Items, word: SixSprings) -> None:
    """Add a bushing, whose six directions turn with the body of a."""
    _connect(items, word.a, word.b, word.axes, word.stiffness, word.damping)


def _connect(items: Items, a: str, b: str, axes: Array, stiffness: Array, damping: Array) -> None:
    """Exudyn's six-dimensional spring, at the place of b: where that is not a's, a's body reaches there rigidly."""
    place = items.scene.point_position(b)
    markers = [items.marker(a, at=place), items.marker(b)]
    items.mbs.AddObject(
        eii.ObjectConnectorRigidBodySpringDamper(
            markerNumbers=markers,
            stiffness=stiffness,
            damping=damping,
            rotationMarker0=axes,
            rotationMarker1=axes,
        )
    )


def add_constraint(items: Items, word: Constraint, held: tuple[str, ...]) -> None:
    """Add a joint that holds the given ones of its directions."""
    items.mbs.AddObject(
        eii.ObjectJointGeneric(
            markerNumbers=[items.marker(word.a), items.marker(word.b)],
            constrainedAxes=[int(direction in held) for direction in DIRECTIONS],
            rotationMarker0=word.axes,
            rotationMarker1=word.axes,
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
