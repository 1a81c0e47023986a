"""Rigid groups: bodies without deformation that rigid connections combine, with each other or with a floating body.

Rigid connections also hold points of flexible bodies to the ground. A body whose frame is held so has a fixed frame.

Exudyn then has fewer bodies and no joints between them. Small motion needs no groups: its minimal coordinates have the
motions that the joints leave.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_transfer, skew
from nassim.bodies.inertia import estimate_gram, transform_gram
from nassim.scene.bodies import Body, FlexibleBody, RigidBody
from nassim.scene.field_kinds import body_of, point_of
from nassim.scene.rotation_measures import RelativePose
from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint
from nassim.simulation.model.constraints import Constraints

HEAVIEST = 1e3
"""Mass of a carried body over that of its host above which its rounding would hide the host's inertia."""


@dataclass(frozen=True)
class RigidGroups:
    """Groups of bodies without deformation that rigid connections combine.

    Attributes:
        leaders: name of each body's leader, which represents its group; a fixed body where there is one.
        joints: names of the rigid connections within groups, and of those that make a group part of a floating body.
        hosts: point of a floating body that carries a group, "body.point", by the group's leader.
        grounded: points of a flexible body that rigid connections hold to fixed bodies, by its name.
    """

    leaders: Mapping[str, str]
    joints: frozenset[str]
    hosts: Mapping[str, str]
    grounded: Mapping[str, frozenset[str]]

    @property
    def groups(self) -> dict[str, list[str]]:
        """Names of the bodies of each group, by its leader."""
        found: dict[str, list[str]] = {}
        for name, leader in self.leaders.items():
            found.setdefault(leader, []).append(name)
        return found


def find_rigid_groups(constraints: Constraints, *, bending: bool = True) -> RigidGroups:
    """Find the rigid groups of a scene: bodies without deformation that joints hold together in all six directions.

    A moving group that a joint so holds to a floating body is part of that, where this is as right as the floating
    frame itself: at the point of the frame, which moves without deformation; and at another point, which rotates by
    small deformation, where the group reaches no farther than the size of the floating body. Far heavier groups stay
    bodies of their own.

    Points that joints so hold to a fixed body are grounded: always of a body in small motion; of a floating body where
    the point of its frame is among them, so that the frame cannot move.

    Args:
        constraints: constraints of the scene.
        bending: whether points that rotate by deformation carry groups, which a spin needs the stiffness of loads for.

    Returns:
        The groups.
    """
    scene = constraints.coordinates.scene
    leaders, joints, mounts = _rigid_connections(constraints)
    hosts = _hosts(scene, leaders, mounts, bending=bending)
    grounded = _grounded(scene, leaders, mounts)
    joints += [mount.joint for mount in hosts.values()]
    joints += [joint for points in grounded.values() for joint in points.values()]
    return RigidGroups(
        leaders,
        frozenset(joints),
        {leader: mount.host for leader, mount in hosts.items()},
        {name: frozenset(points) for name, points in grounded.items()},
    )


@dataclass(frozen=True)
class _Mount:
    """A rigid joint between a body without deformation and a point of another one.

    Attributes:
        joint: name of the joint.
        rigid: name of the body without deformation.
        host: the point, "body.point".
    """

    joint: str
    rigid: str
    host: str


def _rigid_connections(constraints: Constraints) -> tuple[dict[str, str], list[str], list[_Mount]]:
    """Return the leaders of bodies without deformation, the joints within groups, and the joints to other bodies."""
    scene = constraints.coordinates.scene
    leaders, joints = {body.name: body.name for body in scene.bodies if body.is_rigid}, list[str]()
    mounts = []
    for joint in scene.terms_of(Constraint):
        # Directions that other joints hold already, and those that a drive moves, are not enforced by this joint.
        pose = isinstance(joint.measure, RelativePose)
        enforced = constraints.enforced[joint.name]
        if not (pose and len(joint.held) == len(enforced) == len(joint.measure.components)):
            continue
        paths = joint.points[:2]
        a, b = (leaders.get(body_of(path)) for path in paths)
        if a is not None and b is not None:
            first, second = sorted((a, b), key=lambda name: scene.body(name).moves)
            leaders = {name: first if leader == second else leader for name, leader in leaders.items()}
            joints.append(joint.name)
        elif a is not None or b is not None:
            rigid, other = paths if b is None else paths[::-1]
            mounts.append(_Mount(joint.name, body_of(rigid), other))
    return leaders, joints, mounts


def _hosts(scene: Scene, leaders: Mapping[str, str], mounts: Sequence[_Mount], *, bending: bool) -> dict[str, _Mount]:
    """Return the mount at which a floating body carries a group, by the group's leader; points of frames come first."""
    hosts: dict[str, _Mount] = {}
    for at_frame in (True, False) if bending else (True,):
        for mount in mounts:
            leader = leaders[mount.rigid]
            host, point = scene.split(mount.host)
            if leader in hosts or not scene.body(leader).moves:
                continue
            if not isinstance(host, FlexibleBody) or host.fidelity != "ffrf":
                continue
            bodies = [scene.body(name) for name, other in leaders.items() if other == leader]
            if sum(body.rigid_inertia[0] for body in bodies) > HEAVIEST * host.reduced.mass:
                continue
            if (point == scene.frame_point(host)) == at_frame and (at_frame or _is_near(bodies, host, point)):
                hosts[leader] = mount
    return hosts


def _grounded(scene: Scene, leaders: Mapping[str, str], mounts: Sequence[_Mount]) -> dict[str, dict[str, str]]:
    """Return the points of flexible bodies that fixed bodies hold, each with its joint, by name of the body."""
    result = {}
    for body in scene.deformable_bodies:
        held = [m for m in mounts if body_of(m.host) == body.name and not scene.body(leaders[m.rigid]).moves]
        points = {point_of(m.host): m.joint for m in held}
        if _can_be_grounded(scene, body, points):
            result[body.name] = points
    return result


def _can_be_grounded(scene: Scene, body: FlexibleBody, points: Collection[str]) -> bool:
    """Whether a flexible body can be in small motion about the ground, which holds some of its points."""
    reduced = body.reduced
    rides = body.fidelity == "linear" or scene.frame_point(body) in points
    remains = reduced.n_modes > 0 or len(points) < len(reduced.point_names)
    # Only points with coordinates of their own get nodes, which joints and springs need.
    return bool(points) and rides and remains and set(scene.named_points(body)) <= set(reduced.point_names)


def _is_near(bodies: Sequence[Body], host: FlexibleBody, point: str) -> bool:
    """Whether bodies reach no farther from a point of a flexible body than the size of that."""
    size, start = float(np.linalg.norm(np.ptp(host.reduced.positions, axis=0))), host.point_position(point)
    for body in bodies:
        mass, centre, inertia = body.rigid_inertia
        places = np.array([centre, *map(body.point_position, body.point_names)])
        farthest, gyration = np.linalg.norm(places - start, axis=1).max(), np.sqrt(np.trace(inertia) / (2 * mass))
        if max(farthest, gyration) > size:
            return False
    return True


@dataclass(frozen=True)
class CarriedBody(Body):
    """A rigid body in the coordinates of a flexible body, one of whose points carries it.

    Attributes:
        body: the rigid body, along the world's axes.
        host: the flexible body.
        point: the remote point of the host that carries the body.
    """

    body: RigidBody
    host: FlexibleBody
    point: str

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the rigid body."""
        return self.body.name

    @property
    def position(self) -> Array:  # type: ignore[override]
        """Position of the rigid body's centre of mass, (3,) [m]."""
        return self.body.position

    @property
    def point_names(self) -> tuple[str, ...]:
        """Names of the rigid body's points."""
        return self.body.point_names

    @cached_property
    def _of_centre(self) -> Array:
        return self.motion_at(self.body.position)

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix that the rigid body adds to its host, (n, n)."""
        result: Array = self._of_centre.T @ self.body.mass_matrix @ self._of_centre
        return 0.5 * (result + result.T)

    @property
    def gram(self) -> Array:
        """Integrals that the rigid body adds to those of its host, see `ReducedBody.gram`."""
        own, host = estimate_gram(self.body.mass_matrix, np.zeros((1, 3))), self.host
        place = host.rotation.T @ (self.body.position - host.position)
        return transform_gram(own, place, host.rotation.T, self._of_centre)

    def weight(self, gravity: Array) -> Array:
        """Return the forces of a uniform gravity, world frame, (3,) [m/s2], on the host's coordinates, (n,)."""
        return self._of_centre.T @ self.body.weight(gravity)

    def motion(self, point: str) -> Array:
        """Return the small motion of a point along the world's axes per unit of the host's coordinates, (6, n)."""
        return self.motion_at(self.body.point_position(point))

    def motion_at(self, place: Array) -> Array:
        """Return the small motion at a place of the rigid body, (3,) [m], (6, n)."""
        return rigid_transfer(place - self.host.point_position(self.point)) @ self.host.motion(self.point)

    def point_position(self, point: str) -> Array:
        """Return the position of a point at the start, world frame, (3,) [m]."""
        return self.body.point_position(point)

    @property
    def rigid_inertia(self) -> tuple[float, Array, Array]:
        """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m2] at the start, world frame."""
        return self.body.rigid_inertia


def carried_bodies(scene: Scene, groups: RigidGroups, bodies: Mapping[str, RigidBody]) -> dict[str, CarriedBody]:
    """Return the bodies that floating bodies carry, by name.

    Args:
        scene: the scene.
        groups: its rigid groups.
        bodies: all bodies without deformation, along the world's axes, by name.
    """
    result = {}
    for leader, path in groups.hosts.items():
        host, point = scene.split(path)
        assert isinstance(host, FlexibleBody)
        result.update({name: CarriedBody(bodies[name], host, point) for name in groups.groups[leader]})
    return result


def with_carried(host: FlexibleBody, carried: Sequence[CarriedBody]) -> FlexibleBody:
    """Return a flexible body with the mass and inertia of the rigid bodies that it carries."""
    reduced = host.reduced
    mass = reduced.mass_matrix + sum(body.mass_matrix for body in carried)
    gram = reduced.gram + sum(body.gram for body in carried)
    return replace(host, reduced=replace(reduced, mass_matrix=mass, gram=gram, enriched=None)) if carried else host


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
    return mass * skew(arm) @ skew(arm).T


def with_points_of(one: RigidBody, body: RigidBody) -> RigidBody:
    """Return a combined body with the points of one of its bodies."""
    return replace(one, points={name: body.point_position(name) - one.position for name in body.points})
