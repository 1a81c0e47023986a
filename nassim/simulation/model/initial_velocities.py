"""Initial velocities of a scene's bodies, moved as rigid bodies, and a check of constraints that are redundant at rest.

A body's twist (6,) is the motion (ux uy uz rx ry rz) of its point at the world's origin, along the world's axes.
"""

from collections.abc import Collection, Mapping, Sequence

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_transfer
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.measures import body_of
from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint, ForceLaw, PrescribedMotion
from nassim.simulation.model.states import RigidState

FOLLOWED = 1e-9
"""Relative error of a required angular velocity that rounding may leave."""
PERTURBATION = 1e-3
"""Rotation [rad], and displacement over the scene's size, of the small finite motions that test constraints."""
IMPLIED = 1e-4
"""Violation, over the perturbation squared, up to which other constraints imply a constraint in motion too."""


def initial_twists(scene: Scene, rates: Mapping[str, float] | None = None) -> dict[str, Array]:
    """Compute the twists of all moving bodies at the start that satisfy joints and drives.

    Drives run at their speeds and bodies rotate at their given angular velocity. All other motion is at the least
    distance, in kinetic energy, from the motion without joints, in which each body rotates about its centre of mass.
    Joints thus take up forces, but a free scene keeps its momentum. Nothing deforms.

    Args:
        scene: the scene.
        rates: initial rates of inputs that drives follow, by name [m/s], [rad/s] (default: 0).

    Returns:
        Twists (6,) by body name.

    Raises:
        ValueError: for an angular velocity or a drive's speed that the joints do not allow.
    """
    bodies = _moving(scene)
    spins = [body for body in bodies.values() if np.any(body.angular_velocity)]
    places = {name: slice(6 * k, 6 * k + 6) for k, name in enumerate(bodies)}
    drives, speeds = _driven(scene, places, rates or {})
    if not spins and not np.any(speeds):
        return {name: np.zeros(6) for name in bodies}
    # Square roots of energy: u = L^T twist, with M = L L^T.
    to_twist = np.linalg.inv(np.linalg.cholesky(scipy.linalg.block_diag(*map(_mass, bodies.values())))).T
    alone = np.zeros(6 * len(bodies))
    spin_rows = np.zeros((3 * len(spins), 6 * len(bodies)))
    for k, body in enumerate(spins):
        alone[places[body.name]] = _spinning(body)
        spin_rows[3 * k : 3 * k + 3, places[body.name]] = np.eye(3, 6, 3)
    asked = np.concatenate([spin_rows @ alone, speeds])
    spin_rows = np.vstack([spin_rows, drives])
    allowed = to_twist @ _null_space(_all_rows(scene, places) @ to_twist)
    free = allowed.T @ scipy.linalg.block_diag(*map(_mass, bodies.values())) @ alone
    possible = spin_rows @ allowed
    found = allowed @ (free + np.linalg.pinv(possible, rcond=1e-9) @ (asked - possible @ free))
    for k, body in enumerate(spins):
        missing = (asked - spin_rows @ found)[3 * k : 3 * k + 3]
        if np.linalg.norm(missing) > FOLLOWED * np.linalg.norm(asked):
            raise ValueError(
                f"body {body.name!r} cannot start to turn at {_listed(body.angular_velocity)} rad/s: its joints, and "
                f"what else turns, leave {_listed(asked[3 * k : 3 * k + 3] - missing)} rad/s, with all bodies rigid; "
                "give an angular_velocity that they allow, or free more directions of a joint"
            )
    # A motion that follows an input may begin by straining bodies; a constant speed would strain them without end.
    missed = np.abs(drives @ found - speeds) * [bool(term.speed) for term in scene.terms_of(PrescribedMotion)]
    if missed.size and missed.max() > FOLLOWED * np.abs(asked).max():
        term = scene.terms_of(PrescribedMotion)[int(np.argmax(missed))]
        raise ValueError(
            f"{term.component} of joint {term.constraint!r} cannot start at the speed of its drive: other joints, and "
            "what else turns, do not allow it"
        )
    return {name: found[place] for name, place in places.items()}


def starting_energy(scene: Scene) -> float:
    """Return the kinetic energy of a scene's bodies at the start [J], with all bodies rigid."""
    twists, bodies = initial_twists(scene), _moving(scene)
    return 0.5 * float(sum(twists[name] @ _mass(body) @ twists[name] for name, body in bodies.items()))


def has_free_rotation(scene: Scene) -> bool:
    """Return whether joints leave some body a free rotation, with all bodies rigid and without springs."""
    bodies = _moving(scene)
    places = {name: slice(6 * k, 6 * k + 6) for k, name in enumerate(bodies)}
    motions = _null_space(_all_rows(scene, places)).reshape(len(bodies), 6, -1)
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
    bodies, rates = _moving(scene), rates or {}
    joints = scene.constraints
    driven = scene.terms_of(PrescribedMotion)
    speeds = [(joints[term.constraint], term.component, term.speed + rates.get(term.input, 0.0)) for term in driven]
    spindles = [(joint, component, speed) for joint, component, speed in speeds if speed]
    groups = _tied(scene, {joint.name for joint, _, _ in spindles})
    found = {name: np.zeros(6) for name in bodies}
    for joint, component, speed in spindles:
        axis = joint.measure.rotation_axis(component)
        a, b = map(body_of, joint.points[:2])
        if axis is None or (a in bodies) == (b in bodies):
            return None
        velocity = (speed if b in bodies else -speed) * axis
        twist = np.concatenate([np.cross(scene.point_position(joint.points[0]), velocity), velocity])
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
    return all(tied <= set(twists) for tied in _ties(scene, driven))


def _ties(scene: Scene, spindles: Collection[str]) -> list[set[str]]:
    """Return the sets of bodies that joints, without the given ones, and springs connect."""
    found = [joint.measure for joint in scene.terms_of(Constraint) if joint.name not in spindles]
    found += [law.measure for law in scene.terms_of(ForceLaw) if not law.measure.within]
    return [set(measure.bodies) for measure in found]


def _tied(scene: Scene, spindles: Collection[str]) -> dict[str, int]:
    """Return the number of the group of connected moving bodies, by body."""
    names = list(_moving(scene))
    matrix = np.eye(len(names))
    for tied in _ties(scene, spindles):
        among = [names.index(name) for name in tied if name in names]
        matrix[np.ix_(among, among)] = 1.0
    _, labels = scipy.sparse.csgraph.connected_components(scipy.sparse.csr_matrix(matrix), directed=False)
    return dict(zip(names, labels.tolist(), strict=True))


def _goes_on(scene: Scene, twists: Mapping[str, Array], rates: Mapping[str, float]) -> bool:
    """Whether bodies can keep their twists: with joints and drives, and with their required angular velocities."""
    bodies = _moving(scene)
    places = {name: slice(6 * k, 6 * k + 6) for k, name in enumerate(bodies)}
    every = np.concatenate([twists[name] for name in bodies])
    drives, speeds = _driven(scene, places, rates)
    slips = [_all_rows(scene, places) @ every, drives @ every - speeds]
    for joint in scene.terms_of(Constraint):
        a, b = (twists.get(body_of(path), np.zeros(6)) for path in joint.points[:2])
        if np.any(a != b):  # a bearing stays at its place, so its point must not move on a circle
            slips.append((rigid_transfer(scene.point_position(joint.points[0])) @ (b - a))[:3])
    slips += [b.angular_velocity - twists[b.name][3:] for b in bodies.values() if np.any(b.angular_velocity)]
    small = any(
        isinstance(body, FlexibleBody) and body.fidelity == "linear" and np.any(twists[body.name])
        for body in bodies.values()
    )
    return not small and bool(np.abs(np.concatenate(slips)).max(initial=0.0) <= FOLLOWED * np.abs(every).max())


def check_implied(scene: Scene, enforced: Mapping[str, Sequence[str]]) -> None:
    """Check that redundant constraints stay redundant once the bodies move.

    Args:
        scene: the scene.
        enforced: directions that each joint holds, by name, without those that others hold at the start. Small finite
            motions that satisfy these must also satisfy the redundant directions.

    Raises:
        ValueError: for a joint's direction that the others hold at the start, but not in motion.
    """
    left_out = {
        joint.name: tuple(d for d in joint.held if d not in enforced[joint.name])
        for joint in scene.terms_of(Constraint)
    }
    if not any(left_out.values()):
        return
    bodies = _moving(scene)
    places = {name: slice(6 * k, 6 * k + 6) for k, name in enumerate(bodies)}
    points = np.array([scene.point_position(joint.points[0]) for joint in scene.terms_of(Constraint)])
    middle, size = points.mean(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-6)
    scale = np.tile([size] * 3 + [1.0] * 3, len(bodies))
    about_middle = scipy.linalg.block_diag(*[rigid_transfer(-middle)] * len(bodies)) * scale
    motions = about_middle @ _null_space(_all_rows(scene, places) @ about_middle)
    if not motions.size:
        return
    correct = about_middle @ np.linalg.pinv(_all_rows(scene, places, enforced) @ about_middle, rcond=1e-9)

    def opened(twists: Array) -> Array:
        gaps = [_gaps(scene, places, joint, enforced[joint.name], twists) for joint in scene.terms_of(Constraint)]
        return np.hstack(gaps)

    directions = np.hstack([np.eye(motions.shape[1]), np.random.default_rng(0).standard_normal((motions.shape[1], 5))])
    for motion in (motions @ directions).T:
        twists = PERTURBATION * motion / np.abs(np.linalg.solve(about_middle, motion)).max()
        for _ in range(10):
            twists = twists - correct @ opened(twists)
        limit = IMPLIED * PERTURBATION**2 * size
        if np.abs(opened(twists)).max(initial=0.0) > limit:
            continue  # the other constraints lock it, so this is no finite motion
        for joint in scene.terms_of(Constraint):
            broken = np.abs(_gaps(scene, places, joint, left_out[joint.name], twists)) > limit
            if broken.any():
                listed = ", ".join(np.array(left_out[joint.name])[broken])
                raise ValueError(
                    f"joint {joint.name!r}: at the start other joints imply what it holds along {listed}, but no more "
                    "once the bodies move, so there the scene locks or branches, which cannot be simulated; free that "
                    "direction of a joint, start in another position, or let a body deform"
                )


def _moving(scene: Scene) -> dict[str, Body]:
    return {body.name: body for body in scene.bodies if body.moves}


def _mass(body: Body) -> Array:
    """Return the mass matrix of a rigid body's twist, (6, 6)."""
    mass, center, inertia = body.rigid_inertia
    to_center = rigid_transfer(center)
    result: Array = to_center.T @ scipy.linalg.block_diag(mass * np.eye(3), inertia) @ to_center
    return result


def _spinning(body: Body) -> Array:
    """Return the twist of a body that rotates about its centre of mass."""
    return np.concatenate([np.cross(body.rigid_inertia[1], body.angular_velocity), body.angular_velocity])


def _driven(scene: Scene, places: Mapping[str, slice], rates: Mapping[str, float]) -> tuple[Array, Array]:
    """Return the rows of drives on all twists, (drives, 6 n_bodies), and the drives' velocities, (drives,)."""
    joints = scene.constraints
    driven = scene.terms_of(PrescribedMotion)
    rows = [np.zeros((0, 6 * len(places)))]
    rows += [_rows(scene, places, joints[term.constraint], (term.component,)) for term in driven]
    return np.vstack(rows), np.array([t.speed + rates.get(t.input, 0.0) * np.isinf(t.bandwidth) for t in driven])


def _rows(scene: Scene, places: Mapping[str, slice], joint: Constraint, components: tuple[str, ...]) -> Array:
    """Return the rates of components of a constraint's measure per unit of all twists, (components, 6 n_bodies)."""
    states = {name: RigidState(scene.body(name)) for name in joint.measure.bodies}
    result = np.zeros((len(components), 6 * len(places)))
    for name, rows in joint.measure.evaluate(states)[1].items():
        if name in places:
            result[:, places[name]] = rows[joint.rows(components)]
    return result


def _all_rows(scene: Scene, places: Mapping[str, slice], held: Mapping[str, Sequence[str]] | None = None) -> Array:
    """Return the rates of all held components, or of given components by name, per unit of all twists."""
    result = [np.zeros((0, 6 * len(places)))]
    for joint in scene.terms_of(Constraint):
        result.append(_rows(scene, places, joint, joint.held if held is None else tuple(held[joint.name])))
    return np.vstack(result)


def _gaps(
    scene: Scene, places: Mapping[str, slice], joint: Constraint, components: Sequence[str], twists: Array
) -> Array:
    """Evaluate components of a constraint's measure after finite motions of all bodies."""
    states = {}
    for name in joint.measure.bodies:
        states[name] = RigidState(scene.body(name), twists[places[name]] if name in places else np.zeros(6))
    return joint.measure.evaluate(states)[0][joint.rows(tuple(components))]


def _null_space(rows: Array) -> Array:
    if not len(rows):
        return np.eye(rows.shape[1])
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    result: Array = scipy.linalg.null_space(rows / np.where(sizes > 0, sizes, 1.0), rcond=1e-9)
    return result


def _listed(vector: Array) -> str:
    rounded = np.round(vector, 9) + 0.0  # no -0
    return "(" + ", ".join(f"{value:.4g}" for value in rounded) + ")"
