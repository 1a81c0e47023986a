"""Initial velocities of a scene's bodies, moved as rigid bodies: twists, see `nassim.simulation.model.rigid_twists`."""

from collections.abc import Mapping

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_transfer
from nassim.scene.field_kinds import body_of
from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint, PrescribedMotion
from nassim.simulation.model.rigid_twists import RigidTwists, null_space, rigid_mass, starting_speed
from nassim.simulation.model.states import RigidState
from nassim.simulation.model.ties import Tie, find_ties, grounded_groups, is_grounded, tied_groups

FOLLOWED = 1e-9
"""Relative error of a required angular velocity that rounding may leave."""


def initial_twists(scene: Scene, rates: Mapping[str, float] | None = None) -> dict[str, Array]:
    """Compute the twists of all moving bodies at the start that satisfy joints and drives.

    Drives run at their speeds and bodies rotate at their given angular velocity. All other motion is at the least
    distance, in kinetic energy, from the motion without joints. In that, each body rotates about its centre of mass,
    and what a drive of constant speed turns against the ground, or what joints and springs tie to it, turns about the
    drive's axis. Joints thus take up forces, but a free scene keeps its momentum. Nothing deforms.

    Args:
        scene: the scene.
        rates: initial rates of inputs that drives follow, by name [m/s], [rad/s] (default: 0).

    Returns:
        Twists (6,) by body name.

    Raises:
        ValueError: for an angular velocity or a drive's speed that the joints do not allow.
    """
    rigid = RigidTwists(scene)
    spins = [body for body in rigid.bodies.values() if np.any(body.angular_velocity)]
    drives, speeds = rigid.driven_rows(rates or {})
    if not spins and not np.any(speeds):
        return {name: np.zeros(6) for name in rigid.bodies}
    # Square roots of energy: u = L^T twist, with M = L L^T.
    to_twist = np.linalg.inv(np.linalg.cholesky(rigid.mass)).T
    alone = np.zeros(rigid.size)
    for name, twist in _rotor_twists(scene).items():
        alone[rigid.places[name]] = twist
    spin_rows = np.zeros((3 * len(spins), rigid.size))
    for k, body in enumerate(spins):
        alone[rigid.places[body.name]] = _rotation_about(body.rigid_inertia[1], body.angular_velocity)
        spin_rows[3 * k : 3 * k + 3, rigid.places[body.name]] = np.eye(3, 6, 3)
    asked = np.concatenate([spin_rows @ alone, speeds])
    spin_rows = np.vstack([spin_rows, drives])
    allowed = to_twist @ null_space(rigid.held_rows() @ to_twist)
    free = allowed.T @ rigid.mass @ alone
    possible = spin_rows @ allowed
    rounding = 1e-9 * np.linalg.norm(spin_rows @ to_twist)
    possible[np.abs(possible) < rounding] = 0.0  # joints may hold all that is asked
    found = allowed @ (free + np.linalg.pinv(possible, rcond=1e-9) @ (asked - possible @ free))
    for k, body in enumerate(spins):
        missing = (asked - spin_rows @ found)[3 * k : 3 * k + 3]
        if np.linalg.norm(missing) > FOLLOWED * np.linalg.norm(asked):
            raise ValueError(
                f"body {body.name!r} cannot start to turn at {_listed(body.angular_velocity)} rad/s: its joints, and "
                f"what else turns, leave {_listed(asked[3 * k : 3 * k + 3] - missing)} rad/s, with all bodies rigid, "
                f"which differs by {np.linalg.norm(missing):.2g}; give an angular_velocity that they allow, or free "
                "more directions of a joint"
            )
    # A motion that follows an input may begin by straining bodies; a constant speed would strain them without end.
    missed = np.abs(drives @ found - speeds) * [bool(term.speed) for term in scene.terms_of(PrescribedMotion)]
    if missed.size and missed.max() > FOLLOWED * np.abs(asked).max():
        term = scene.terms_of(PrescribedMotion)[int(np.argmax(missed))]
        raise ValueError(
            f"{term.component} of joint {term.constraint!r} cannot start at the speed of its drive: other joints, and "
            "what else turns, do not allow it"
        )
    return {name: found[place] for name, place in rigid.places.items()}


def starting_energy(scene: Scene) -> float:
    """Return the kinetic energy of a scene's bodies at the start [J], with all bodies rigid."""
    twists, bodies = initial_twists(scene), RigidTwists(scene).bodies
    return 0.5 * float(sum(twists[name] @ rigid_mass(body) @ twists[name] for name, body in bodies.items()))


def has_free_rotation(scene: Scene) -> bool:
    """Return whether joints leave some body a free rotation, with all bodies rigid and without springs."""
    rigid = RigidTwists(scene)
    motions = null_space(rigid.held_rows()).reshape(len(rigid.bodies), 6, -1)
    return bool(np.abs(motions[:, 3:]).max(initial=0.0) > FOLLOWED)


def steady_rotation_twists(scene: Scene, rates: Mapping[str, float] | None = None) -> dict[str, Array] | None:
    """Compute the twists of all moving bodies in steady rotation, each at rest on its rotor.

    What joints and springs connect is one rotor, which a drive rotates against the ground; all other bodies are at
    rest.

    Args:
        scene: the scene.
        rates: initial rates of inputs that drives follow, as in `initial_twists`.

    Returns:
        Twists (6,) by body name. None where nothing is driven, and where the motion is not steady: a crank and its
            slider, a screw, a rotor on a moving body, bodies in small motion that rotate.
    """
    bodies, rates = RigidTwists(scene).bodies, rates or {}
    joints = scene.constraints
    driven = scene.terms_of(PrescribedMotion)
    speeds = [(joints[term.constraint], term.component, starting_speed(term, rates)) for term in driven]
    spindles = [(joint, component, speed) for joint, component, speed in speeds if speed]
    groups = tied_groups(scene, find_ties(scene, {joint.name for joint, _, _ in spindles}))
    found = {name: np.zeros(6) for name in bodies}
    for joint, component, speed in spindles:
        axis = joint.measure.rotation_axis(component)
        a, b = map(body_of, joint.points[:2])
        if axis is None or (a in bodies) == (b in bodies):
            return None
        velocity = (speed if b in bodies else -speed) * axis
        twist = _rotation_about(scene.point_position(joint.points[0]), velocity)
        table = groups[b if b in bodies else a]
        found |= {name: twist for name in bodies if groups[name] == table}
    return found if spindles and _goes_on(scene, found, rates) else None


def is_axisymmetric(scene: Scene, twists: Mapping[str, Array]) -> bool:
    """Whether a scene in steady rotation rotates as one and is the same at every angle.

    Args:
        scene: the scene.
        twists: twists of `steady_rotation_twists`.
    """
    (twist, *others) = twists.values()
    if any(not np.array_equal(other, twist) for other in others) or np.any(np.cross(twist[3:], scene.gravity)):
        return False
    driven = {term.constraint for term in scene.terms_of(PrescribedMotion)}
    return not any(is_grounded(tie, twists) for tie in find_ties(scene, driven))


def _rotor_twists(scene: Scene) -> dict[str, Array]:
    """Return twists of the bodies on rotors that turn at constant speed against what is tied to the ground, by name.

    Where all joints and springs together tie both sides of a drive to each other, as bearings do and the friction of
    its joint, those count that resist its rotation.
    """
    joints, found = scene.constraints, dict[str, Array]()
    every = find_ties(scene, {term.constraint for term in scene.speeds})
    for term in scene.speeds:
        joint = joints[term.constraint]
        axis, ends = joint.measure.rotation_axis(term.component), [body_of(path) for path in joint.points[:2]]
        if axis is None:
            continue
        turn = _rotation_about(scene.point_position(joint.points[0]), axis)
        beside = [tie for tie in every if set(tie.measure.points) != set(joint.points)]
        for ties in (every, [tie for tie in beside if _resists(scene, tie, turn)]):
            groups = tied_groups(scene, ties)
            grounded = grounded_groups(groups, ties)
            held = [name not in groups or groups[name] in grounded for name in ends]
            if held[0] != held[1]:
                twist = (term.speed if held[0] else -term.speed) * turn
                found |= {name: twist for name in groups if groups[name] == groups[ends[held[0]]]}
                break
    return found


def _resists(scene: Scene, tie: Tie, turn: Array) -> bool:
    """Whether a tie holds or resists a rotation of one of its bodies, given by its twist, (6,)."""
    rows = tie.measure.evaluate({name: RigidState(scene.body(name)) for name in tie.measure.bodies})[1]
    if isinstance(tie, Constraint):
        weights = np.eye(len(tie.measure.components))[tie.rows(tie.held)]
    else:
        weights = np.vstack(tie.tangents(*np.zeros((2, len(tie.measure.components)))))
    met = [weights @ rows[name] for name in tie.measure.bodies if scene.body(name).moves]
    return any(np.any(np.abs(row @ turn) > FOLLOWED * (np.abs(row) @ (np.abs(turn) + 1e-3))) for row in met)


def _goes_on(scene: Scene, twists: Mapping[str, Array], rates: Mapping[str, float]) -> bool:
    """Whether bodies can keep their twists: with joints and drives, and with their required angular velocities."""
    rigid = RigidTwists(scene)
    bodies, every = rigid.bodies.values(), np.concatenate([twists[name] for name in rigid.bodies])
    drives, speeds = rigid.driven_rows(rates)
    slips = [rigid.held_rows() @ every, drives @ every - speeds]
    for joint in scene.terms_of(Constraint):
        a, b = (twists.get(body_of(path), np.zeros(6)) for path in joint.points[:2])
        if np.any(a != b):  # a bearing stays at its place, so its point must not move on a circle
            slips.append((rigid_transfer(scene.point_position(joint.points[0])) @ (b - a))[:3])
    slips += [b.angular_velocity - twists[b.name][3:] for b in bodies if np.any(b.angular_velocity)]
    small = any(np.any(twists[body.name]) for body in scene.of_fidelity("linear"))
    return not small and bool(np.abs(np.concatenate(slips)).max(initial=0.0) <= FOLLOWED * np.abs(every).max())


def _rotation_about(point: Array, velocity: Array) -> Array:
    """Return the twist of a rotation about a point, (3,) [m], at an angular velocity, (3,) [rad/s]."""
    return np.concatenate([np.cross(point, velocity), velocity])


def _listed(vector: Array) -> str:
    rounded = np.round(vector, 9) + 0.0  # no -0
    return "(" + ", ".join(f"{value:.4g}" for value in rounded) + ")"
