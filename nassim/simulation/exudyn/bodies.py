"""A scene's bodies in Exudyn, with their weight, the stiffness of their stress and the damping between them."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np
from exudyn.rigidBodyUtilities import GetRigidBodyNode

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_transfer
from nassim.scene.bodies import Body, FlexibleBody, RigidBody
from nassim.scene.scene import Scene
from nassim.simulation.exudyn.circuits import modal_node
from nassim.simulation.exudyn.flexible_bodies import add_deformable
from nassim.simulation.exudyn.general_items import NO_MATRIX, BodyNodes
from nassim.simulation.exudyn.items import Items
from nassim.simulation.exudyn.running_system import FlexibleCoordinates, StressChange, StressUpdate
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.initial_velocities import initial_twists
from nassim.simulation.model.rigid_groups import carried_bodies, combine_bodies, find_rigid_groups, with_points_of
from nassim.simulation.model.states import LinearState, euler_state

NO_ROTATION = np.array([1.0, 0.0, 0.0, 0.0])
"""Euler parameters of no rotation."""

Blocks = dict[tuple[str, str], Array]
"""Blocks of a matrix on the deformation of all bodies, by the names of two bodies."""


def add_bodies(mbs: Any, assembly: Assembly, rates: Mapping[str, float] | None, added_mass: Array) -> Items:
    """Add the bodies with their weight, the mass added on their deformation, (m, m), and the damping between them."""
    scene = assembly.scene
    groups = find_rigid_groups(assembly.constraints, bending=assembly.bent_points_carry)
    twists = initial_twists(scene, rates)
    damping, mass = _by_bodies(assembly, assembly.modal.damping.on_deformation()), _by_bodies(assembly, added_mass)
    bodies = {body.name: _as_rigid(body, assembly) for body in scene.bodies if body.is_rigid}
    items = Items(mbs, scene, groups.joints, carried_bodies(scene, groups, bodies), groups.grounded)
    stress = _stress_stiffness(assembly)
    for body in scene.deformable_bodies:
        inside = (mass[body.name, body.name], damping[body.name, body.name], stress[body.name])
        add_deformable(items, assembly, body, inside, twists[body.name])
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
    linear = [body.name for body in scene.of_fidelity("linear")]
    for name in items.own:
        if np.any(scene.gravity) and name not in linear:
            items.add_body_force(name, scene.gravity)
    return items


def _add_rigid_group(items: Items, bodies: Sequence[RigidBody], twist: Array) -> None:
    """Add rigid bodies that joints hold rigidly to each other, as one."""
    one = combine_bodies(bodies)
    node, item = _add_rigid(items.mbs, one, twist)
    for body in bodies:
        items.rigid[body.name], items.objects[body.name] = with_points_of(one, body), item
        if node is not None:
            items.nodes[body.name] = node
            euler = partial(euler_state, items.scene.body(body.name), one.position, start=NO_ROTATION)
            items.body_nodes[body.name] = BodyNodes(
                item, ((node, 7),), euler, np.concatenate([one.position, NO_ROTATION])
            )


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


def _stress_stiffness(assembly: Assembly) -> dict[str, Array]:
    """Return the stiffness of the stress in bodies that deform and of the loads on what they carry, by name, (n, n).

    In a floating body it is zero but for the flexible coordinates. In a body in small motion it acts on all
    coordinates, which also gives rigid rotations the stiffness of the weight and of the forces at its points, in fixed
    directions.
    """
    result, loads = {}, assembly.loads
    for body in assembly.scene.deformable_bodies:
        n = len(body.mass_matrix)
        own = np.zeros((n, n))
        if loads and body.name in loads.stress:
            own += loads.stress[body.name].stiffness
        if loads and body.name in loads.carried:
            own += loads.carried[body.name]
        if body.fidelity == "ffrf":
            flexible = np.isin(np.arange(n), assembly.coordinates.frames[body.name].flexible)
            own = np.where(np.outer(flexible, flexible), own, 0.0)
        result[body.name] = 0.5 * (own + own.T)
    return result


def _hold_equilibrium(mbs: Any, assembly: Assembly, flexible: Mapping[str, FlexibleCoordinates]) -> None:
    """Add the constant forces beside the stiffness of the stress in bodies, see `BodyStress.held`.

    Args:
        mbs: Exudyn's system.
        assembly: the assembled scene.
        flexible: coordinates of the bodies that deform, by name.
    """
    for name, stress in assembly.loads.stress.items() if assembly.loads else ():
        force = flexible[name].coordinates.T @ stress.held
        if np.any(force):
            nodes = [node for node, _ in flexible[name].nodes]
            mbs.AddObject(eii.ObjectGenericODE2(nodeNumbers=nodes, massMatrix=NO_MATRIX, forceVector=force))


def add_stress_updates(
    items: Items, assembly: Assembly, changes: Mapping[str, StressChange]
) -> tuple[StressUpdate, ...]:
    """Add an object to each body whose stress changes, which takes the change of its stiffness since the start.

    That of a body whose frame the ground holds does not change.
    """
    result = []
    for name, change in changes.items():
        if name not in items.nodes:
            continue
        ((node, n),), body = items.flexible[name].nodes, assembly.scene.body(name)
        assert isinstance(body, FlexibleBody)
        empty = eii.ObjectGenericODE2(nodeNumbers=[node], massMatrix=NO_MATRIX, stiffnessMatrix=np.zeros((n, n)))
        flexible = assembly.coordinates.frames[name].flexible
        result.append(StressUpdate(items.nodes[name], body.rotation, items.mbs.AddObject(empty), flexible, change))
    return tuple(result)


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
