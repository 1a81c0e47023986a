"""Construction of a scene's Exudyn system: bodies, markers, joints, loads and sensors.

The system exists within one call of `simulate` or `static_response` only.
"""

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
from nassim.scene.bodies import Body, FlexibleBody, RigidBody
from nassim.scene.scene import Scene
from nassim.scene.terms import (
    AppliedForce,
    BaseAcceleration,
    Constraint,
    ForceLaw,
    Output,
    PrescribedMotion,
    SpringForce,
    Term,
)
from nassim.simulation.exudyn.general import NO_MATRIX, BodyNodes, add_general_coil
from nassim.simulation.exudyn.items import (
    NO_OFFSET,
    Items,
    MarkerFactory,
    Place,
    add_base_acceleration,
    add_constraint,
    add_force,
    frame_at,
    offset_of,
)
from nassim.simulation.exudyn.modal import small_motion_system
from nassim.simulation.exudyn.outputs import add_axes, add_output
from nassim.simulation.exudyn.spring_forces import add_spring_force
from nassim.simulation.exudyn.springs import VIRTUAL_NODE_RADIUS, add_force_law, extended_points
from nassim.simulation.exudyn.state import (
    AddedCircuit,
    FlexibleCoordinates,
    InputChannel,
    StressChange,
    StressUpdate,
    Summand,
    System,
    add_circuit,
    modal_node,
)
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.capabilities import LARGE_MOTION, check_capabilities
from nassim.simulation.model.initial_velocities import check_implied, initial_twists
from nassim.simulation.model.period_correction import Steps, correct_periods
from nassim.simulation.model.rigid_groups import (
    CarriedBody,
    carried_bodies,
    combine_bodies,
    find_rigid_groups,
    with_carried,
    with_points_of,
)
from nassim.simulation.model.signals import Circuit
from nassim.simulation.model.states import LinearState, euler_state

NO_ROTATION = np.array([1.0, 0.0, 0.0, 0.0])
"""Euler parameters of no rotation."""
SPARSE = 3.2
"""Entries of the Jacobian over those that are not zero above which a sparse factorisation is faster.

It is measured: chains of 2 to 16 bars and of 5 to 30 rigid bodies, hexapods, the bench, by both modules of Exudyn.
"""
VIRTUAL_NODE_DIRECTIONS = np.array([[2, -1, -1], [-1, 2, -1], [-1, -1, 2]]) / np.sqrt(6)
"""Corners of a regular triangle: three virtual nodes, the fewest, whose equal weights give a point's motion exactly."""


Added = tuple[dict[str, int], FlexibleCoordinates, int, dict[Place, MarkerFactory], dict[str, tuple[int, list[int]]]]
"""Nodes of a body's points, its flexible coordinates, its object, its marker factories and its virtual nodes."""


def build_system(
    assembly: Assembly,
    rates: Mapping[str, float] | None = None,
    steps: Steps | None = None,
    stress_changes: Mapping[str, StressChange] | None = None,
) -> System:
    """Build the Exudyn system of an assembled scene, with all inputs at zero.

    Args:
        assembly: the assembled scene.
        rates: initial rates of inputs that drives follow, see `initial_twists`.
        steps: steps whose period error is corrected; None: no correction.
        stress_changes: changes of the geometric stiffness of floating bodies during a run, by name, see
            `System.update_stress`; others keep that of the start.

    Returns:
        The system.

    Raises:
        ValueError: for joints and angular velocities that contradict each other, see
            `nassim.simulation.model.initial_velocities`.
    """
    if assembly.scene.in_small_motion and len(assembly.modal.mass):
        return small_motion_system(assembly, rates or {}, steps)
    check_capabilities(assembly.scene, LARGE_MOTION)
    size = len(assembly.modal.damping.root)
    assembly, added = correct_periods(assembly, steps) if steps else (assembly, np.zeros((size, size)))
    check_implied(assembly.scene, assembly.constraints.enforced)
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    items = _add_bodies(mbs, assembly, rates, added)
    updates = _add_stress_updates(items, assembly, stress_changes or {})
    drives: list[InputChannel] = []
    readings: dict[str, list[Summand]] = {output: [] for output in assembly.scene.outputs}
    rotating_axes: dict[str, list[tuple[int, Array]]] = {output: [] for output in assembly.scene.outputs}
    for term in assembly.terms:
        if isinstance(term, Output):
            readings[term.name] += add_output(items, term)
            rotating_axes[term.name] += add_axes(items, term)
        elif isinstance(term, SpringForce):
            readings[term.name] += add_spring_force(items, term)
        else:
            drives += _realise(items, term, assembly)
    circuits: list[AddedCircuit] = []
    for circuit in assembly.signals.circuits:
        found, channels = _add_circuit(items, circuit, assembly)
        circuits += found
        drives += channels
        for output, gain in circuit.outputs:
            readings[output] += [Summand.linear(one.sensor, np.array([gain * one.scale])) for one in found]
    mbs.Assemble()
    return System(
        container,
        mbs,
        assembly,
        dict(items.nodes),
        dict(items.flexible),
        tuple(drives),
        readings,
        {one.number: NO_MATRIX for one in circuits},
        circuits=[(one.node, 0, one.damping) for one in circuits],
        sparse=_is_sparse(mbs.systemData),
        rotating_axes=rotating_axes,
        evaluators=items.evaluators,
        carried=items.carried,
        stress_updates=updates,
        fixed_frames=_fixed_frames(items),
    )


def _fixed_frames(items: Items) -> dict[str, tuple[Array, Array]]:
    """Return rotation and position of the frames that the ground holds, see `System.fixed_frames`."""
    scene, result = items.scene, {}
    for body in scene.deformable_bodies:
        point = scene.frame_point(body)
        if point in items.grounded.get(body.name, ()):
            members = [body.name, *(name for name in items.carried if items.host(name) == body.name)]
            result.update(dict.fromkeys(members, (body.rotation, body.point_position(point))))
    return result


def _is_sparse(data: Any) -> bool:
    """Whether a sparse factorisation of the Jacobian is faster, by the coordinates that objects couple."""
    n = data.ODE2Size()
    coupled = np.zeros((n + data.AEsize(),) * 2, dtype=bool)
    for number in range(data.NumberOfObjects()):
        places = [*data.GetObjectLTGODE2(number), *(n + k for k in data.GetObjectLTGAE(number))]
        coupled[np.ix_(places, places)] = True
    coupled[n:, n:] = False
    return bool(coupled.size > SPARSE * np.count_nonzero(coupled))


def _realise(items: Items, term: Term, assembly: Assembly) -> list[InputChannel]:
    """Add a term and return the channels of its input.

    Shunts and coils are circuits of the assembly, filters are the assembly's, prescribed motions belong to their
    constraints.
    """
    if isinstance(term, Constraint):
        if assembly.constraints.enforced[term.name] and term.name not in items.rigid_joints:
            driven = [t for t in assembly.scene.terms_of(PrescribedMotion) if t.constraint == term.name]
            return add_constraint(items, term, assembly.constraints.enforced[term.name], driven)
    elif isinstance(term, ForceLaw):
        add_force_law(items, term)
    elif isinstance(term, AppliedForce):
        return add_force(items, term)
    elif isinstance(term, BaseAcceleration):
        return add_base_acceleration(items, term)
    return []


def _add_circuit(items: Items, circuit: Circuit, assembly: Assembly) -> tuple[list[AddedCircuit], list[InputChannel]]:
    """Add a circuit; return it, unless nothing that deforms has its port, and the channel of a coil's input."""
    if circuit.coil:
        added, channel = add_general_coil(items.mbs, items.evaluator(circuit.coil.measure), circuit.coil)
        return [added], [channel]
    forces = {name: circuit.forces[assembly.coordinates.slices[name]] for name in items.flexible}
    parts = [part for name, coordinates in items.flexible.items() for part in coordinates.parts(forces[name])]
    if not parts:
        return [], []
    row = np.concatenate([piece for _, piece in parts])
    return [add_circuit(items.mbs, circuit, [node for node, _ in parts], row)], []


def _add_bodies(mbs: Any, assembly: Assembly, rates: Mapping[str, float] | None, added_mass: Array) -> Items:
    """Add the bodies with their weight, the mass added on their deformation, (m, m), and the damping between them."""
    scene, known = assembly.scene, assembly.loads.carried if assembly.loads else {}
    groups = find_rigid_groups(assembly.constraints, bending=scene.at_rest or bool(known))
    twists = initial_twists(scene, rates)
    damping, mass = _by_bodies(assembly, assembly.modal.damping.on_deformation()), _by_bodies(assembly, added_mass)
    bodies = {body.name: _as_rigid(body, assembly) for body in scene.bodies if body.is_rigid}
    items = Items(mbs, scene, groups.joints, carried_bodies(scene, groups, bodies), groups.grounded)
    stress = _stress_stiffness(assembly)
    for body in scene.deformable_bodies:
        inside = (mass[body.name, body.name], damping[body.name, body.name], stress[body.name])
        _add_deformable(items, assembly, body, inside, twists[body.name])
    for leader, names in groups.groups.items():
        if leader not in groups.hosts:
            _add_rigid_group(items, [bodies[name] for name in names], twists.get(leader, np.zeros(6)))
    for other in scene.bodies:
        if not (other.is_rigid or other.deforms):
            items.body_nodes[other.name] = _add_linear_body(mbs, scene, other)
            nodes_of = items.body_nodes[other.name].nodes
            items.flexible[other.name] = FlexibleCoordinates(nodes_of, np.eye(len(other.mass_matrix)))
    items.own.extend(n for n in items.nodes if groups.leaders.get(n, n) == n and n not in items.carried)
    _couple(mbs, assembly, items.flexible, mass, damping)
    _hold_equilibrium(mbs, assembly, items.flexible)
    # A linear body carries its weight itself.
    linear = [body.name for body in scene.flexible_bodies if body.fidelity == "linear"]
    for name in items.own:
        if np.any(scene.gravity) and name not in linear:
            items.add_body_force(name, scene.gravity)
    return items


def _add_deformable(
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


def _add_rigid_group(items: Items, bodies: Sequence[RigidBody], twist: Array) -> None:
    """Add rigid bodies that joints hold rigidly to each other, as one."""
    one = combine_bodies(bodies)
    node, item = _add_rigid(items.mbs, one, twist)
    for body in bodies:
        items.rigid[body.name], items.objects[body.name] = with_points_of(one, body), item
        if node is not None:
            items.nodes[body.name] = node
            euler = partial(euler_state, items.scene.split(f"{body.name}.")[0], one.position, start=NO_ROTATION)
            items.body_nodes[body.name] = BodyNodes(
                item, ((node, 7),), euler, np.concatenate([one.position, NO_ROTATION])
            )


def _stress_stiffness(assembly: Assembly) -> dict[str, Array]:
    """Return the stiffness of the stress in bodies that deform and of the loads on what they carry, by name, (n, n).

    In a floating body it is zero but for the flexible coordinates. In a body in small motion it acts on all
    coordinates, which also gives rigid rotations the stiffness of the weight and of the forces at its points, in fixed
    directions.
    """
    result, parts = {}, (assembly.loads.inside, assembly.loads.carried) if assembly.loads else ()
    for body in assembly.scene.deformable_bodies:
        n = len(body.mass_matrix)
        own = sum((part[body.name] for part in parts if body.name in part), np.zeros((n, n)))
        if body.fidelity == "ffrf":
            flexible = np.isin(np.arange(n), assembly.coordinates.frames[body.name].flexible)
            own = np.where(np.outer(flexible, flexible), own, 0.0)
        result[body.name] = 0.5 * (own + own.T)
    return result


def _hold_equilibrium(mbs: Any, assembly: Assembly, flexible: Mapping[str, FlexibleCoordinates]) -> None:
    """Add the constant forces beside the stiffness of the stress in bodies, see `LoadedState.held`.

    Args:
        mbs: Exudyn's system.
        assembly: the assembled scene.
        flexible: coordinates of the bodies that deform, by name.
    """
    for name, held in assembly.loads.held.items() if assembly.loads else ():
        force = flexible[name].coordinates.T @ held
        if np.any(force):
            nodes = [node for node, _ in flexible[name].nodes]
            mbs.AddObject(eii.ObjectGenericODE2(nodeNumbers=nodes, massMatrix=NO_MATRIX, forceVector=force))


def _add_stress_updates(
    items: Items, assembly: Assembly, changes: Mapping[str, StressChange]
) -> tuple[StressUpdate, ...]:
    """Add an object to each body whose stress changes, which takes the change of its stiffness since the start.

    That of a body whose frame the ground holds does not change.
    """
    result = []
    for name, change in changes.items():
        if name not in items.nodes:
            continue
        ((node, n),), body = items.flexible[name].nodes, assembly.scene.split(f"{name}.")[0]
        assert isinstance(body, FlexibleBody)
        empty = eii.ObjectGenericODE2(nodeNumbers=[node], massMatrix=NO_MATRIX, stiffnessMatrix=np.zeros((n, n)))
        flexible = assembly.coordinates.frames[name].flexible
        result.append(StressUpdate(items.nodes[name], body.rotation, items.mbs.AddObject(empty), flexible, change))
    return tuple(result)


def _add_linear_body(mbs: Any, scene: Scene, body: Body) -> BodyNodes:
    """Add a body of another formulation by its own linear equations; general items hold and drive its points."""
    n = len(body.mass_matrix)
    node = mbs.AddNode(modal_node(n))
    number = mbs.AddObject(
        eii.ObjectGenericODE2(
            nodeNumbers=[node],
            massMatrix=body.mass_matrix,
            stiffnessMatrix=np.zeros((n, n)) if body.strain is None else body.strain.stiffness,
            forceVector=body.weight(scene.gravity),
        )
    )
    return BodyNodes(number, ((node, n),), partial(LinearState, body), np.zeros(n))


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


def _as_rigid(body: Body, assembly: Assembly) -> RigidBody:
    """Return a body without deformation along the world's axes."""
    if isinstance(body, RigidBody):
        return body.along_world
    assert isinstance(body, FlexibleBody)
    frame, turn = assembly.coordinates.frames[body.name], body.rotation
    c = frame.center_of_mass
    inertia = turn @ (frame.inertia - frame.mass * (c @ c * np.eye(3) - np.outer(c, c))) @ turn.T
    position = body.centre
    points = {name: body.point_position(name) - position for name in body.reduced.all_point_names}
    return RigidBody(body.name, points, frame.mass, 0.5 * (inertia + inertia.T), position)


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


def _add_rigid(mbs: Any, body: RigidBody, twist: Array) -> tuple[int | None, int]:
    """Add a rigid body; return its node, None where fixed, and its object."""
    if body.fixed:
        return None, mbs.AddObject(eii.ObjectGround(referencePosition=list(body.position)))
    node = mbs.AddNode(
        GetRigidBodyNode(
            exu.NodeType.RotationEulerParameters,
            position=list(body.position),
            velocity=list((rigid_transfer(body.position) @ twist)[:3]),
            angularVelocity=list(twist[3:]),
        )
    )
    j = np.asarray(body.inertia)
    six = [j[0, 0], j[1, 1], j[2, 2], j[1, 2], j[0, 2], j[0, 1]]
    return node, mbs.AddObject(eii.ObjectRigidBody(nodeNumber=node, mass=body.mass, inertia=six))


Blocks = dict[tuple[str, str], Array]
"""Blocks of a matrix on the deformation of all bodies, by the names of two bodies."""


def _by_bodies(assembly: Assembly, full: Array) -> Blocks:
    """Split a matrix on the deformation of all bodies into blocks."""
    bodies = assembly.scene.deformable_bodies
    ends = np.cumsum([0, *(len(assembly.coordinates.frames[body.name].flexible) for body in bodies)])
    places = {body.name: slice(ends[k], ends[k + 1]) for k, body in enumerate(bodies)}
    return {(a, b): full[places[a], places[b]] for a in places for b in places}


def _couple(
    mbs: Any, assembly: Assembly, flexible: dict[str, FlexibleCoordinates], mass: Blocks, damping: Blocks
) -> None:
    """Add mass and damping between the deformations of several flexible bodies, as modes of their assembly require."""
    bodies = assembly.scene.deformable_bodies
    rows = [assembly.coordinates.frames[b.name].deformation(b.reduced) @ flexible[b.name].coordinates for b in bodies]

    def between(blocks: Blocks) -> Array:
        if not any(np.any(block) for (a, b), block in blocks.items() if a != b):
            return np.zeros((0, 0))  # an empty matrix costs no time at every step
        return np.block(
            [
                [rows[i].T @ blocks[a.name, b.name] @ rows[j] * (i != j) for j, b in enumerate(bodies)]
                for i, a in enumerate(bodies)
            ]
        )

    matrices = {"massMatrix": between(mass), "dampingMatrix": between(damping)}
    if any(matrix.size for matrix in matrices.values()):
        nodes = [node for body in bodies for node, _ in flexible[body.name].nodes]
        mbs.AddObject(eii.ObjectGenericODE2(nodeNumbers=nodes, **matrices))


def _container(matrix: Array) -> Any:
    """Return a matrix as Exudyn's dense container."""
    result = exu.MatrixContainer()
    result.SetWithDenseMatrix(matrix, useDenseMatrix=True)
    return result
