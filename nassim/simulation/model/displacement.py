"""Displacement of a scene's bodies to another configuration: with their frames, and deformed.

A body's frame rotates and carries its deformation, as in `nassim.simulation.model.states.FrameState`. The coordinates
of small motion about the new configuration are along axes that turn with the frames.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_motions, rotated_motion, skew
from nassim.bodies.reduced_body import ReducedBody
from nassim.scene.bodies import Body, FlexibleBody, RigidBody
from nassim.scene.field_kinds import body_of
from nassim.scene.scene import Scene
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.motion_size import scene_size
from nassim.simulation.model.moved_coordinates import MovedCoordinates
from nassim.simulation.model.states import FrameState, LinearState, ReferenceState, SceneState
from nassim.simulation.model.ties import Tie

ROUNDING = 1e-9
"""Size of a direction over that of all of its measure, below which it is rounding."""


def displaced(coordinates: Coordinates, values: Array) -> MovedCoordinates:
    """Move the bodies of a scene from the reference configuration by given values of its coordinates, (n_all,)."""
    scene, mass = coordinates.scene, coordinates.mass.copy()
    states: dict[str, SceneState] = {body.name: ReferenceState(body) for body in scene.bodies}
    for name, place in coordinates.slices.items():
        body = scene.body(name)
        states[name] = state = _displaced_body(scene, body, values[place])
        if isinstance(body, FlexibleBody) and isinstance(state, FrameState) and state.deformed is not None:
            change = deformed_pairs(scene, body, state.deformed) - _pairs(body.reduced)
            mass[place, place] += np.einsum("jaka->jk", change)
    return MovedCoordinates(scene, coordinates.slices, mass, states)


def _displaced_body(scene: Scene, body: Body, values: Array) -> SceneState:
    """Return the state of a body that is moved by given values of its coordinates, (n,)."""
    if isinstance(body, RigidBody):
        rotation = Rotation.from_rotvec(values[3:]).as_matrix()
        return FrameState(body, body.position, body.position + values[:3], rotation, rotated_motion(rotation))
    if not isinstance(body, FlexibleBody):
        return LinearState(body, values)
    point = scene.frame_point(body)
    index, rigid = _frame_of(scene, body)
    origin, of_frame = body.point_position(point), body.motion(point)
    motion, deforms = of_frame @ values, np.eye(len(values))
    deforms -= rigid @ deforms[6 * index : 6 * index + 6]
    rotation = Rotation.from_rotvec(motion[3:]).as_matrix()
    turned = rotated_motion(rotation) @ of_frame
    return FrameState(body, origin, origin + motion[:3], rotation, turned, deforms @ values, deforms)


def advanced(coordinates: MovedCoordinates, step: Array) -> Array:
    """Return the values, see `displaced`, of the configuration a small step from a displaced one, (n_all,)."""
    result = np.zeros(coordinates.size)
    for name, place in coordinates.slices.items():
        state = coordinates.moved[name]
        if isinstance(state, LinearState):
            result[place] = state.coordinates + step[place]
        elif isinstance(state, FrameState):
            moved = state.frame_motion @ step[place]
            rotation = Rotation.from_rotvec(moved[3:]) * Rotation.from_matrix(state.rotation)
            motion = np.concatenate([state.position + moved[:3] - state.frame, rotation.as_rotvec()])
            if isinstance(state.body, FlexibleBody):
                _, rigid = _frame_of(coordinates.scene, state.body)
                deformed, deforms = state.own(np.eye(len(rigid)))
                motion = rigid @ rotated_motion(state.body.rotation.T) @ motion + deformed + deforms @ step[place]
            result[place] = motion
    return result


def _frame_of(scene: Scene, body: FlexibleBody) -> tuple[int, Array]:
    """Return the index of the point with a body's frame, and the coordinates as the frame moves rigidly, (n, 6)."""
    index = body.reduced.point_names.index(scene.frame_point(body))
    places = body.reduced.positions
    return index, rigid_motions(places - places[index], len(body.mass_matrix))


def _pairs(body: ReducedBody) -> Array:
    n = len(body.mass_matrix)
    return body.gram[4:, 4:].reshape(n, 3, n, 3)


def deformed_pairs(scene: Scene, body: FlexibleBody, deformed: Array) -> Array:
    """Return the integrals of products of two fields over the mass of a deformed body, (n, 3, n, 3) [kg m2].

    The fields are displacements per unit of the coordinates, along the body's axes. The three rotations of the frame
    carry the deformation along: their fields have e x (psi deformed) besides, with the axis e.

    Args:
        scene: the scene.
        body: the body.
        deformed: its coordinates by deformation, (n,).
    """
    pairs, index = _pairs(body.reduced), _frame_of(scene, body)[0]
    carried = np.einsum("m,mbkc->bkc", deformed, pairs)
    result, twice = pairs.copy(), np.einsum("k,bkc->bc", deformed, carried)
    turns = [(6 * index + 3 + k, skew(axis)) for k, axis in enumerate(np.eye(3))]
    for j, turn in turns:
        result[j] += np.einsum("ab,bkc->akc", turn, carried)
        result[:, :, j] += np.einsum("ab,bkc->kca", turn, carried)
    for j, turn in turns:
        for k, other in turns:
            result[j, :, k] += turn @ twice @ other.T
    return result


def motion_of_frames(coordinates: Coordinates, moved: MovedCoordinates) -> float:
    """Return the largest rotation of a body's frame [rad] or displacement over the size of the scene."""
    size, result = scene_size(coordinates.scene), 0.0
    for state in moved.states.values():
        if isinstance(state, FrameState):
            way = float(np.linalg.norm(state.position - state.frame)) / size
            result = max(result, way, float(Rotation.from_matrix(state.rotation).magnitude()))
        elif isinstance(state, LinearState):
            motions = np.vstack([state.motion(point) for point in state.body.point_names]) @ state.coordinates
            result = max(result, float(np.abs(motions.reshape(-1, 6) / np.repeat([size, 1.0], 3)).max(initial=0.0)))
    return result


def change_of_directions(coordinates: Coordinates, moved: MovedCoordinates) -> float:
    """Return the largest relative change of the directions of joints and springs, as their bodies see them.

    These are directions of forces, or of moments where there is no force; arms do not count.

    Args:
        coordinates: coordinates of the scene.
        moved: `displaced` coordinates of the same scene.
    """
    scene, result = coordinates.scene, 0.0
    for term in scene.terms:
        if not isinstance(term, Tie):
            continue
        for _, part in term.measure.point_measures:
            found = []
            for states in (coordinates.states, moved.states):
                rows = part.at_states(states)[1]
                for k, path in enumerate(part.points):
                    state = states[body_of(path)]
                    rotation = state.rotation if isinstance(state, FrameState) else np.eye(3)
                    place = slice(6 * k, 6 * k + 6)
                    rows[:, place] = rows[:, place] @ rotated_motion(rotation) * state.body.moves
                found.append(rows.reshape(len(rows), -1, 2, 3))
            (forces, moments), change = np.moveaxis(found[0], 2, 0), np.moveaxis(found[1] - found[0], 2, 0)
            for k in range(len(forces)):
                kind = 0 if forces[k].any() else 1
                size = np.linalg.norm((forces, moments)[kind][k])
                if size > ROUNDING * np.linalg.norm((forces, moments)[kind]):  # a bearing has no moment about its shaft
                    result = max(result, float(np.linalg.norm(change[kind][k]) / size))
    return result
