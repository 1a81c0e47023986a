"""Flexible bodies in Exudyn: in small motion as linear equations, in large motion in a floating frame."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np
import scipy
from exudyn.rigidBodyUtilities import GetRigidBodyNode, RotationMatrix2EulerParameters

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_transfer
from nassim.bodies.floating_frames import FloatingFrame, floating_frame
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.scene import Scene
from nassim.simulation.exudyn.circuits import modal_node
from nassim.simulation.exudyn.general import BodyNodes
from nassim.simulation.exudyn.items import (
    NO_OFFSET,
    Items,
    MarkerFactory,
    Place,
    frame_at,
    offset_of,
)
from nassim.simulation.exudyn.springs import VIRTUAL_NODE_RADIUS, extended_points
from nassim.simulation.exudyn.state import FlexibleCoordinates
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.rigid_groups import (
    CarriedBody,
    with_carried,
)
from nassim.simulation.model.states import LinearState, euler_state

VIRTUAL_NODE_DIRECTIONS = np.array([[2, -1, -1], [-1, 2, -1], [-1, -1, 2]]) / np.sqrt(6)
"""Corners of a regular triangle: three virtual nodes, the fewest, whose equal weights give a point's motion exactly."""

Added = tuple[dict[str, int], FlexibleCoordinates, int, dict[Place, MarkerFactory], dict[str, tuple[int, list[int]]]]
"""Nodes of a body's points, its flexible coordinates, its object, its marker factories and its virtual nodes."""


def add_deformable(
    items: Items, assembly: Assembly, body: FlexibleBody, inside: tuple[Array, Array, Array], twist: Array
) -> None:
    """Add a body that deforms, with the rigid bodies that it carries; inside: its added mass, damping and stress."""
    frame = assembly.coordinates.frames[body.name]
    guests = [guest for guest in items.carried.values() if guest.host is body]
    small = items.fidelity(body.name) == "linear"
    if small:
        added = _add_linear(items, body, frame, guests, inside, twist)
    else:
        added = _add_floating(items.mbs, items.scene, body, frame.point, guests, inside, twist)
    nodes, coordinates, number, factories, threes = added
    items.point_nodes.update({f"{body.name}.{point}": node for point, node in nodes.items()})
    items.marker_factories.update(factories)
    items.virtual_nodes.update(threes)
    items.flexible[body.name] = coordinates
    for member in (body, *guests):
        items.objects[member.name] = number
        if frame.point in nodes:
            items.nodes[member.name] = nodes[frame.point]
        if small:
            items.body_nodes[member.name] = _linear_nodes(member, body, list(nodes), coordinates, number)
        else:
            items.body_nodes[member.name] = _floating_nodes(
                member, body, frame, nodes[frame.point], coordinates, number
            )


def _linear_nodes(
    member: Body, body: FlexibleBody, points: Sequence[str], coordinates: FlexibleCoordinates, number: int
) -> BodyNodes:
    """Return the nodes of a body in small motion, of its moving points, for itself or for one that it carries."""
    state = partial(LinearState, member, change=coordinates.coordinates)
    places = [np.concatenate([body.point_position(point), np.zeros(3)]) for point in points]
    return BodyNodes(number, coordinates.nodes, state, np.concatenate([*places, np.zeros(body.reduced.n_modes)]))


def _floating_nodes(
    member: Body, body: FlexibleBody, frame: FloatingFrame, node: int, coordinates: FlexibleCoordinates, number: int
) -> BodyNodes:
    """Return the nodes of a floating body for the body itself, or for one that it carries."""
    start = np.array(RotationMatrix2EulerParameters(body.rotation))
    at, deforms = body.point_position(frame.point), coordinates.coordinates
    euler = partial(euler_state, member, at, start=start, deforms=deforms)
    reference = np.concatenate([at, start, np.zeros(deforms.shape[1])])
    return BodyNodes(number, ((node, 7), *coordinates.nodes), euler, reference)


def _add_linear(
    items: Items,
    body: FlexibleBody,
    frame: FloatingFrame,
    guests: Sequence[CarriedBody],
    matrices: tuple[Array, Array, Array],
    twist: Array,
) -> Added:
    """Add a body in small motion: a node per remote point that moves, along the world's axes, and one for the modes.

    Points that the ground holds have no coordinates. A floating body whose frame is held so is in small motion about
    that frame, with the rigid bodies that it carries.
    """
    mbs, whole = items.mbs, with_carried(body, guests)
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
    deformation = frame.deformation(whole.reduced) @ coordinates
    *on_deformation, stress = matrices
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
    factories = _linear_markers(items, body, frame, guests, nodes)
    return nodes, FlexibleCoordinates(tuple(counts), coordinates), number, factories, {}


def _linear_markers(
    items: Items, body: FlexibleBody, frame: FloatingFrame, guests: Sequence[CarriedBody], nodes: Mapping[str, int]
) -> dict[Place, MarkerFactory]:
    """Return the marker factories of a body in small motion, by the nodes of its points; others are on the ground."""
    mbs, scene, names = items.mbs, items.scene, body.reduced.point_names
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

    carriers = {guest.name: guest.point for guest in guests}
    places = {(f"{body.name}.{point}", NO_OFFSET) for point in names}
    factories: dict[Place, MarkerFactory] = {}
    for path, offset in sorted(places.union(_places(scene, body, frame.point, guests))):
        name, _, own = path.partition(".")
        point = carriers.get(name, own)
        if point not in names:
            continue
        arm = scene.point_position(path) + offset - body.point_position(point)
        if point in nodes and not np.any(arm):
            marker = _marker_factory(mbs, np.eye(3), arm, eii.MarkerNodeRigid, nodeNumber=nodes[point])
        else:
            marker = _marker_factory(mbs, np.eye(3), arm, eii.MarkerBodyRigid, bodyNumber=carrier(point))
        factories[path, offset] = marker
    return factories


def _add_floating(
    mbs: Any,
    scene: Scene,
    body: FlexibleBody,
    frame_point: str,
    guests: Sequence[CarriedBody],
    matrices: tuple[Array, Array, Array],
    twist: Array,
) -> Added:
    """Add a floating-frame body with the rigid bodies that it carries."""
    added, damping, stress = matrices
    frame = floating_frame(with_carried(body, guests).reduced, frame_point)
    n, origin = len(frame.flexible), body.point_position(frame.point)
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
    places = _places(scene, body, frame.point, guests)
    positions, rows = _virtual_nodes(body, frame, places, guests)
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
    factories = _floating_markers(mbs, scene, body, frame, places, guests, node, number)
    virtual_nodes = {place[0]: (number, _virtual_numbers(k)) for k, place in enumerate(places) if place[1] == NO_OFFSET}
    coordinates = FlexibleCoordinates(((modes, n),), np.eye(len(body.reduced.mass_matrix))[:, frame.flexible])
    return {frame.point: node}, coordinates, number, factories, virtual_nodes


def _floating_markers(
    mbs: Any,
    scene: Scene,
    body: FlexibleBody,
    frame: FloatingFrame,
    places: Sequence[Place],
    guests: Sequence[CarriedBody],
    node: int,
    number: int,
) -> dict[Place, MarkerFactory]:
    """Return the marker factories of a floating-frame body at its frame's point and at further places.

    Args:
        mbs: Exudyn's system.
        scene: the scene.
        body: the body.
        frame: its floating frame.
        places: the places, in the order of the virtual nodes.
        guests: the rigid bodies that it carries.
        node: node of the frame.
        number: object of the body.
    """
    riding = [place for place in places if _rides_on_frame(place, frame, guests)]
    # Markers on a body without mass follow the frame; those on mesh nodes would cost more.
    carrier = mbs.AddObject(eii.ObjectRigidBody(nodeNumber=node, mass=0.0, inertia=[0.0] * 6)) if riding else -1
    node_marker = _marker_factory(mbs, body.rotation, np.zeros(3), eii.MarkerNodeRigid, nodeNumber=node)
    factories: dict[Place, MarkerFactory] = {(f"{body.name}.{frame.point}", NO_OFFSET): node_marker}
    for k, place in enumerate(places):
        if place in riding:
            arm = body.rotation.T @ (scene.point_position(place[0]) + place[1] - body.point_position(frame.point))
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
    return factories


def _virtual_numbers(i: int) -> list[int]:
    """Return the numbers of the virtual nodes of place i of a floating-frame body."""
    return list(range(3 * i, 3 * i + 3))


def _marker_factory(
    mbs: Any, rotation: Array, arm: Array, marker: Callable[..., Any], **of_place: Any
) -> MarkerFactory:
    """Return a function that adds markers to a body of a given initial rotation, with axes of the world's frame."""
    return lambda axes: int(mbs.AddMarker(marker(localHT=frame_at(arm, rotation.T @ axes), **of_place)))


def _rides_on_frame(place: Place, frame: FloatingFrame, guests: Sequence[CarriedBody]) -> bool:
    """Whether a place belongs to a rigid body that the point of the floating frame carries."""
    return any(guest.name == place[0].partition(".")[0] and guest.point == frame.point for guest in guests)


def _places(scene: Scene, body: FlexibleBody, frame_point: str, guests: Sequence[CarriedBody]) -> list[Place]:
    """Return the points of a body that parts use, except the frame's, and the places to which points are extended.

    Points of the rigid bodies that it carries are among them.
    """
    members = {body.name: body.reduced.all_point_names} | {guest.name: guest.point_names for guest in guests}
    places = set()
    for name, points in members.items():
        named = scene.named_points(scene.split(f"{name}.")[0])
        places |= {(f"{name}.{point}", NO_OFFSET) for point in points if point in named}
    for path, place in extended_points(scene):
        if path.partition(".")[0] in members:
            places.add((path, offset_of(scene, path, place)))
    at_frame = (f"{body.name}.{frame_point}", NO_OFFSET)
    return sorted(places - {at_frame}) or [at_frame]


def _virtual_nodes(
    body: FlexibleBody, frame: FloatingFrame, places: Sequence[Place], guests: Sequence[CarriedBody]
) -> tuple[Array, Array]:
    """Return virtual mesh nodes: three around each place, whose displacements define the rigid motion of its point.

    The last node is the centre of mass, which moves with the deformation.

    Returns:
        Their positions (3 n_nodes,) and mode rows (3 n_nodes, n).
    """
    everyone = np.array([p.position for p in body.reduced.remote_points])
    radius = VIRTUAL_NODE_RADIUS * max(float(np.ptp(everyone, axis=0).max()), 1e-6)
    members: dict[str, Body] = {member.name: member for member in (body, *guests)}
    back, positions, rows = body.rotation.T, [], []
    for path, away in places:
        name, _, point = path.partition(".")
        start = back @ (members[name].point_position(point) - body.point_position(frame.point))
        motion = np.kron(np.eye(2), back) @ members[name].motion(point)
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
