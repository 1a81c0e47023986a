"""Rigid groups: rigid bodies that rigid connections combine.

Exudyn then has fewer bodies and no joints between them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import skew
from nassim.scene.bodies import RigidBody
from nassim.scene.measures import RelativePose
from nassim.scene.terms import Constraint
from nassim.simulation.model.assembly import Assembly


@dataclass(frozen=True)
class RigidGroups:
    """Groups of bodies without deformation that rigid connections combine.

    Attributes:
        leaders: name of each body's leader, which represents its group; a fixed body where there is one.
        joints: names of the rigid connections within groups.
    """

    leaders: Mapping[str, str]
    joints: frozenset[str]

    @property
    def groups(self) -> dict[str, list[str]]:
        """Names of the bodies of each group, by its leader."""
        found: dict[str, list[str]] = {}
        for name, leader in self.leaders.items():
            found.setdefault(leader, []).append(name)
        return found


def find_rigid_groups(assembly: Assembly) -> RigidGroups:
    """Find the rigid groups of a scene: bodies without deformation that joints hold together in all six directions."""
    moves = {body.name: body.moves for body in assembly.scene.bodies}
    leaders, joints = {body.name: body.name for body in assembly.scene.bodies if body.is_rigid}, []
    for joint in assembly.scene.terms_of(Constraint):
        a, b = (leaders.get(path.partition(".")[0]) for path in joint.points[:2])
        # Directions that other joints hold already, and those that a drive moves, are not enforced by this joint.
        pose = isinstance(joint.measure, RelativePose)
        enforced = assembly.constraints.enforced[joint.name]
        rigid = pose and len(joint.held) == len(enforced) == len(joint.measure.components)
        if rigid and a is not None and b is not None:
            first, second = sorted((a, b), key=lambda name: moves[name])
            leaders = {name: first if leader == second else leader for name, leader in leaders.items()}
            joints.append(joint.name)
    return RigidGroups(leaders, frozenset(joints))


def combine_bodies(bodies: Sequence[RigidBody]) -> RigidBody:
    """Combine bodies along the world's axes into one; with a fixed body among them, return that."""
    alone = [body for body in bodies if body.fixed] or bodies
    if len(alone) == 1:
        return alone[0]
    each = [body.rigid_inertia for body in bodies]
    mass = sum(heavy for heavy, _, _ in each)
    centre = np.sum([heavy * place for heavy, place, _ in each], axis=0) / mass
    inertia = np.sum([own + _of_a_mass(heavy, place - centre) for heavy, place, own in each], axis=0)
    return RigidBody(bodies[0].name, {}, mass, 0.5 * (inertia + inertia.T), centre)


def _of_a_mass(mass: float, arm: Array) -> Array:
    """Return the inertia of a point mass at an arm, (3, 3)."""
    result: Array = mass * skew(arm) @ skew(arm).T
    return result


def with_points_of(one: RigidBody, body: RigidBody) -> RigidBody:
    """Return a combined body with the points of one of its bodies."""
    return replace(one, points={name: body.point_position(name) - one.position for name in body.points})
