"""Flexible bodies in Exudyn: in small motion as linear equations, in large motion in a floating frame."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np
import scipy
from exudyn.rigidBodyUtilities import GetRigidBodyNode, RotationMatrix2EulerParameters

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_transfer, rotated_motion
from nassim.bodies.floating_frames import FloatingFrame, floating_frame
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.field_kinds import body_of, point_of
from nassim.scene.scene import Scene
from nassim.simulation.exudyn.circuits import modal_node
from nassim.simulation.exudyn.general_items import BodyNodes
from nassim.simulation.exudyn.items import NO_OFFSET, Items, MarkerFactory, Place, frame_at, offset_of
from nassim.simulation.exudyn.running_system import FlexibleCoordinates
from nassim.simulation.exudyn.springs import VIRTUAL_NODE_RADIUS, extended_points
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.rigid_groups import CarriedBody, with_carried
from nassim.simulation.model.states import LinearState, euler_state

VIRTUAL_NODE_DIRECTIONS = np.array([[2, -1, -1], [-1, 2, -1], [-1, -1, 2]]) / np.sqrt(6)
"""Corners of a regular triangle: three virtual nodes, the fewest, whose equal weights give a point's motion exactly."""

Inside = tuple[Array, Array, Array]
"""Mass and damping that are added on a body's deformation, (m, m), and stiffness of its stress, (n, n)."""


@dataclass(frozen=True)
class _Host:
    """A body that deforms, with its floating frame and the rigid bodies that it carries."""

    body: FlexibleBody
    frame: FloatingFrame
    carried: Sequence[CarriedBody]

    @property
    def whole(self) -> FlexibleBody:
        """The body with the mass and inertia of what it carries."""
        return with_carried(self.body, self.carried)

    @property
    def frame_place(self) -> Place:
        """The point of the frame."""
        return f"{self.body.name}.{self.frame.point}", NO_OFFSET

    @property
    def origin(self) -> Array:
        """Position of the frame's point at the start, world frame, (3,) [m]."""
        return self.body.point_position(self.frame.point)

    def rides_on_frame(self, place: Place) -> bool:
        """Whether a place belongs to a rigid body that the point of the frame carries."""
        return any(rigid.name == body_of(place[0]) and rigid.point == self.frame.point for rigid in self.carried)


def add_deformable(items: Items, assembly: Assembly, body: FlexibleBody, inside: Inside, twist: Array) -> None:
    """Add a body that deforms, with the rigid bodies that it carries.

    Args:
        items: Exudyn's items of the scene, which get those of the body.
        assembly: the assembled scene.
        body: the body.
        inside: see `Inside`.
        twist: motion of the body at the start, (6,).
    """
    carried = [rigid for rigid in items.carried.values() if rigid.host is body]
    host = _Host(body, assembly.coordinates.frames[body.name], carried)
    small = items.fidelity(body.name) == "linear"
    nodes, coordinates, number = (_add_linear if small else _add_floating)(items, host, inside, twist)
    items.point_nodes.update({f"{body.name}.{point}": node for point, node in nodes.items()})
    items.flexible[body.name] = coordinates
    for member in (body, *carried):
        items.objects[member.name] = number
        if host.frame.point in nodes:
            items.nodes[member.name] = nodes[host.frame.point]
        if small:
            items.body_nodes[member.name] = _linear_nodes(member, body, list(nodes), coordinates, number)
        else:
            items.body_nodes[member.name] = _floating_nodes(member, host, nodes[host.frame.point], coordinates, number)


def _linear_nodes(
    member: Body, body: FlexibleBody, points: Sequence[str], coordinates: FlexibleCoordinates, number: int
) -> BodyNodes:
    """Return the nodes of a body in small motion, of its moving points, for itself or for one that it carries."""
    state = partial(LinearState, member, change=coordinates.coordinates)
    places = [np.concatenate([body.point_position(point), np.zeros(3)]) for point in points]
    return BodyNodes(number, coordinates.nodes, state, np.concatenate([*places, np.zeros(body.reduced.n_modes)]))


def _floating_nodes(member: Body, host: _Host, node: int, coordinates: FlexibleCoordinates, number: int) -> BodyNodes:
    """Return the nodes of a floating body for the body itself, or for one that it carries."""
    start, deforms = np.array(RotationMatrix2EulerParameters(host.body.rotation)), coordinates.coordinates
    euler = partial(euler_state, member, host.origin, start=start, deforms=deforms)
    reference = np.concatenate([host.origin, start, np.zeros(deforms.shape[1])])
    return BodyNodes(number, ((node, 7), *coordinates.nodes), euler, reference)


def _add_linear(
    items: Items, host: _Host, inside: Inside, twist: Array
) -> tuple[dict[str, int], FlexibleCoordinates, int]:
    """Add a body in small motion: a node per remote point that moves, along the world's axes, and one for the modes.

    Points that the ground holds have no coordinates. A floating body whose frame is held so is in small motion about
    that frame, with the rigid bodies that it carries.

    Returns:
        The nodes of its points, its flexible coordinates, and its object.
    """
    mbs, body, whole = items.mbs, host.body, host.whole
    names, n_modes = whole.reduced.point_names, whole.reduced.n_modes
    moving = [point for point in names if point not in items.grounded.get(body.name, ())]
    nodes = {
        point: mbs.AddNode(
            eii.NodeRigidBodyRxyz(
                referenceCoordinates=[*body.point_position(point), 0.0, 0.0, 0.0],
                initialVelocities=list(rigid_transfer(body.point_position(point)) @ twist),
            )
        )
        for point in moving
    }
    counts = [(node, 6) for node in nodes.values()]
    if n_modes:
        counts.append((mbs.AddNode(modal_node(n_modes)), n_modes))
    to_body = scipy.linalg.block_diag(*[body.rotation.T] * (2 * len(names)), np.eye(n_modes))
    kept = [6 * names.index(point) + k for point in moving for k in range(6)]
    coordinates = to_body[:, [*kept, *range(6 * len(names), len(to_body))]]
    deformation = host.frame.deformation(whole.reduced) @ coordinates
    *on_deformation, stress = inside
    added, damping = (deformation.T @ matrix @ deformation for matrix in on_deformation)
    number = mbs.AddObject(
        eii.ObjectGenericODE2(
            nodeNumbers=[node for node, _ in counts],
            massMatrix=coordinates.T @ whole.mass_matrix @ coordinates + added,
            stiffnessMatrix=coordinates.T @ (whole.reduced.stiffness_matrix + stress) @ coordinates,
            dampingMatrix=damping,
            forceVector=coordinates.T @ whole.weight(items.scene.gravity),
        )
    )
    _linear_markers(items, host, nodes)
    return nodes, FlexibleCoordinates(tuple(counts), coordinates), number


def _linear_markers(items: Items, host: _Host, nodes: Mapping[str, int]) -> None:
    """Add the marker factories of a body in small motion, by the nodes of its points; others are on the ground."""
    mbs, body, names = items.mbs, host.body, host.body.reduced.point_names
    bodies: dict[str, int] = {}

    def carrier(point: str) -> int:
        """Return a body without mass that moves with a point, or the ground at that point."""
        if point not in bodies:
            if point in nodes:
                item = eii.ObjectRigidBody(nodeNumber=nodes[point], mass=0.0, inertia=[0.0] * 6)
            else:
                item = eii.ObjectGround(referencePosition=list(body.point_position(point)))
            bodies[point] = mbs.AddObject(item)
        return bodies[point]

    carriers = {rigid.name: rigid.point for rigid in host.carried}
    places = {(f"{body.name}.{point}", NO_OFFSET) for point in names}
    for path, offset in sorted(places.union(_places(items.scene, host))):
        point = carriers.get(body_of(path), point_of(path))
        if point not in names:
            continue
        arm = items.scene.point_position(path) + offset - body.point_position(point)
        if point in nodes and not np.any(arm):
            marker = _marker_factory(mbs, np.eye(3), arm, eii.MarkerNodeRigid, nodeNumber=nodes[point])
        else:
            marker = _marker_factory(mbs, np.eye(3), arm, eii.MarkerBodyRigid, bodyNumber=carrier(point))
        items.marker_factories[path, offset] = marker


def _add_floating(
    items: Items, host: _Host, inside: Inside, twist: Array
) -> tuple[dict[str, int], FlexibleCoordinates, int]:
    """Add a floating-frame body; arguments and result as `_add_linear`."""
    mbs, body, (added, damping, stress) = items.mbs, host.body, inside
    frame = floating_frame(host.whole.reduced, host.frame.point)
    host = replace(host, frame=frame)
    n, origin = len(frame.flexible), host.origin
    node = mbs.AddNode(
        GetRigidBodyNode(
            exu.NodeType.RotationEulerParameters,
            position=list(origin),
            rotationMatrix=body.rotation,
            velocity=list((rigid_transfer(origin) @ twist)[:3]),
            angularVelocity=list(twist[3:]),
        )
    )
    modes = mbs.AddNode(modal_node(n))
    places = _places(items.scene, host)
    positions, rows = _virtual_nodes(host, places)
    number = mbs.AddObject(
        eii.ObjectFFRFreducedOrder(
            nodeNumbers=[node, modes],
            mass=frame.mass,
            inertia=frame.inertia,
            centerOfMass=frame.center_of_mass,
            massMatrixReduced=_container(frame.mass_matrix + added),
            stiffnessMatrixReduced=_container(frame.stiffness_matrix + stress[np.ix_(frame.flexible, frame.flexible)]),
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
    _floating_markers(items, host, places, node, number)
    coordinates = FlexibleCoordinates(((modes, n),), np.eye(len(body.reduced.mass_matrix))[:, frame.flexible])
    return {frame.point: node}, coordinates, number


def _floating_markers(items: Items, host: _Host, places: Sequence[Place], node: int, number: int) -> None:
    """Add the marker factories of a floating-frame body, and its virtual nodes.

    Args:
        items: Exudyn's items of the scene.
        host: the body.
        places: the places beside the frame's point, in the order of the virtual nodes.
        node: node of the frame.
        number: object of the body.
    """
    mbs, body, factories = items.mbs, host.body, items.marker_factories
    # Markers on a body without mass follow the frame; those on mesh nodes would cost more.
    riding = any(map(host.rides_on_frame, places))
    carrier = mbs.AddObject(eii.ObjectRigidBody(nodeNumber=node, mass=0.0, inertia=[0.0] * 6)) if riding else -1
    factories[host.frame_place] = _marker_factory(mbs, body.rotation, np.zeros(3), eii.MarkerNodeRigid, nodeNumber=node)
    for k, place in enumerate(places):
        if host.rides_on_frame(place):
            arm = body.rotation.T @ (items.scene.point_position(place[0]) + place[1] - host.origin)
            factories[place] = _marker_factory(mbs, body.rotation, arm, eii.MarkerBodyRigid, bodyNumber=carrier)
        else:
            factories[place] = _marker_factory(
                mbs,
                body.rotation,
                np.zeros(3),
                eii.MarkerSuperElementRigid,
                bodyNumber=number,
                meshNodeNumbers=_virtual_numbers(k),
                weightingFactors=[1 / 3] * 3,
            )
        if place[1] == NO_OFFSET:
            items.virtual_nodes[place[0]] = number, _virtual_numbers(k)


def _virtual_numbers(i: int) -> list[int]:
    """Return the numbers of the virtual nodes of place i of a floating-frame body."""
    return list(range(3 * i, 3 * i + 3))


def _marker_factory(
    mbs: Any, rotation: Array, arm: Array, marker: Callable[..., Any], **of_place: Any
) -> MarkerFactory:
    """Return a function that adds markers to a body of a given initial rotation, with axes of the world's frame."""
    return lambda axes: int(mbs.AddMarker(marker(localHT=frame_at(arm, rotation.T @ axes), **of_place)))


def _places(scene: Scene, host: _Host) -> list[Place]:
    """Return the points of a body that parts use, except the frame's, and the places to which points are extended.

    Points of the rigid bodies that it carries are among them.
    """
    members = {host.body.name: host.body.reduced.all_point_names}
    members |= {rigid.name: rigid.point_names for rigid in host.carried}
    places = set()
    for name, points in members.items():
        named = scene.named_points(scene.body(name))
        places |= {(f"{name}.{point}", NO_OFFSET) for point in points if point in named}
    for path, place in extended_points(scene):
        if body_of(path) in members:
            places.add((path, offset_of(scene, path, place)))
    return sorted(places - {host.frame_place}) or [host.frame_place]


def _virtual_nodes(host: _Host, places: Sequence[Place]) -> tuple[Array, Array]:
    """Return virtual mesh nodes: three around each place, whose displacements define the rigid motion of its point.

    The last node is the centre of mass, which moves with the deformation.

    Returns:
        Their positions (3 n_nodes,) and mode rows (3 n_nodes, n).
    """
    body, frame = host.body, host.frame
    radius = VIRTUAL_NODE_RADIUS * max(float(np.ptp(body.reduced.positions, axis=0).max()), 1e-6)
    members: dict[str, Body] = {member.name: member for member in (body, *host.carried)}
    back, positions, rows = body.rotation.T, [], []
    for path, away in places:
        member, point = members[body_of(path)], point_of(path)
        start = back @ (member.point_position(point) - host.origin)
        motion = rotated_motion(back) @ member.motion(point)
        for offset in back @ away + radius * VIRTUAL_NODE_DIRECTIONS:
            positions.append(start + offset)
            rows.append((rigid_transfer(offset) @ motion[:, frame.flexible])[:3])
    positions.append(frame.center_of_mass)
    rows.append(frame.translation_flexible / frame.mass)
    return np.hstack(positions), np.vstack(rows)


def _container(matrix: Array) -> Any:
    """Return a matrix as Exudyn's dense container."""
    result = exu.MatrixContainer()
    result.SetWithDenseMatrix(matrix, useDenseMatrix=True)
    return result
