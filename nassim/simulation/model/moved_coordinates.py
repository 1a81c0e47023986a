"""Coordinates of a scene in another configuration, along axes that turn with its bodies.

The coordinates are those of the reference configuration as seen by axes that turn with each body, so that mass,
stiffness and damping of every body stay as they are. What changes are the rows of measures between bodies.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_motions, rigid_transfer, skew
from nassim.bodies.reduced_body import ReducedBody
from nassim.scene.bodies import FlexibleBody, RigidBody
from nassim.scene.measures import Measure, PointVelocity, RelativePose
from nassim.scene.terms import Constraint, ForceLaw
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.states import FrameState, ReferenceState, RigidState, SceneState


@dataclass(frozen=True)
class MovedCoordinates(Coordinates):
    """Coordinates of a scene whose bodies are moved as rigid bodies.

    Attributes:
        moved: states of all bodies in this configuration, by name.
        turned: coordinates of the moved bodies per unit of these, (n_all, n_all), a rotation.
    """

    moved: Mapping[str, SceneState]
    turned: Array

    @cached_property
    def states(self) -> dict[str, SceneState]:
        """States of all bodies in this configuration, by name."""
        return dict(self.moved)

    def jacobian(self, measure: Measure, states: Mapping[str, SceneState] | None = None) -> Array:
        """Evaluate a measure's rows on all coordinates, (k, n_all)."""
        result: Array = super().jacobian(measure, states) @ self.turned
        return result

    def motion(self, path: str) -> Array:
        """Return the small motion of a point in the world's frame, (6, n_all)."""
        body, point = self.scene.split(path)
        rows = super().motion(path)
        if body.moves:
            rows[:, self.slices[body.name]] = self.moved[body.name].motion(point)
        result: Array = rows @ self.turned
        return result

    def weight(self, gravity: Array, states: Mapping[str, SceneState] | None = None) -> Array:
        """Return the forces of a uniform gravity, world frame, (3,) [m/s2], on all coordinates, (n_all,)."""
        result: Array = self.turned.T @ super().weight(gravity, states)
        return result


@dataclass(frozen=True)
class DrivenCoordinates(MovedCoordinates):
    """Coordinates of a scene whose rotor a drive has turned. Measures are of deviations from the turn.

    Attributes:
        joint: the driven joint.
        component: its driven component, a rotation.
    """

    joint: Constraint
    component: str

    def jacobian(self, measure: Measure, states: Mapping[str, SceneState] | None = None) -> Array:
        """Evaluate a measure's rows, of deviations from the rotor's turn, on all coordinates, (k, n_all)."""
        rows = super().jacobian(measure.deviation, states)
        if isinstance(measure, RelativePose) and measure is self.joint.measure:
            # Its own row vanishes after a quarter of a turn: the entry of a rotation matrix is a sine.
            axis = measure.rotation_axis(self.component)
            assert axis is not None
            spin = PointVelocity(((measure.a, -axis), (measure.b, axis)), angular=True)
            rows[self.joint.rows((self.component,))] = super().jacobian(spin, states)
        return rows


def displaced(coordinates: Coordinates, values: Array) -> MovedCoordinates:
    """Move the bodies of a scene by given values of its coordinates, (n_all,): with their frames, and deformed.

    The new coordinates are motions from there along axes that turn with the bodies' frames.
    """
    states: dict[str, ReferenceState | FrameState] = {
        body.name: ReferenceState(body) for body in coordinates.scene.bodies
    }
    mass = coordinates.mass.copy()
    for name, place in coordinates.slices.items():
        body, _ = coordinates.scene.split(f"{name}.")
        n, point = place.stop - place.start, ""
        if isinstance(body, RigidBody):
            origin, of_frame = body.position, np.eye(6)
        elif isinstance(body, FlexibleBody):
            point = coordinates.scene.frame_point(body)
            origin, of_frame = body.point_position(point), body.motion(point)
        else:
            continue  # its points move linearly with its coordinates, beside a frame that stays
        motion = of_frame @ values[place]
        rotation = Rotation.from_rotvec(motion[3:]).as_matrix()
        deformed, deforms = None, None
        if isinstance(body, FlexibleBody):
            reduced = body.reduced
            places = np.array([one.position for one in reduced.remote_points])
            index = reduced.point_names.index(point)
            deforms = np.eye(n) - rigid_motions(places - places[index], n) @ np.eye(n)[6 * index : 6 * index + 6]
            deformed = deforms @ values[place]
            mass[place, place] = deformed_mass(reduced, index, deformed)
        turned = np.kron(np.eye(2), rotation) @ of_frame
        states[name] = FrameState(body, origin, origin + motion[:3], rotation, turned, deformed, deforms)
    return MovedCoordinates(coordinates.scene, coordinates.slices, mass, states, np.eye(coordinates.size))


def deformed_pairs(body: ReducedBody, index: int, deformed: Array) -> Array:
    """Return the integrals of the fields of a deformed body's coordinates over its mass, (n, 3, n, 3) [kg m2].

    The three rotations of the frame carry the deformation along: their fields have e x (psi deformed) besides.

    Args:
        body: the reduced body, whose `gram` has these integrals without deformation.
        index: number of the remote point that carries the frame.
        deformed: its coordinates by deformation, (n,).
    """
    n = len(body.mass_matrix)
    pairs = body.gram[4:, 4:].reshape(n, 3, n, 3)
    carried = np.einsum("m,mbkc->bkc", deformed, pairs)
    result, twice = pairs.copy(), np.einsum("k,bkc->bc", deformed, carried)
    turns = [(6 * index + 3 + k, skew(axis)) for k, axis in enumerate(np.eye(3))]
    for j, turn in turns:
        result[j] += np.einsum("ab,bkc->akc", turn, carried)
        result[:, :, j] += np.einsum("kcb,ab->kca", carried.transpose(1, 2, 0), turn)
    for j, turn in turns:
        for k, other in turns:
            result[j, :, k] += turn @ twice @ other.T
    return result


def deformed_mass(body: ReducedBody, index: int, deformed: Array) -> Array:
    """Return the mass matrix of a deformed body, (n, n); arguments as of `deformed_pairs`."""
    change = deformed_pairs(body, index, deformed) - body.gram[4:, 4:].reshape(*[len(deformed), 3] * 2)
    result: Array = body.mass_matrix + np.einsum("jaka->jk", change)
    return result


def largest_change(coordinates: Coordinates, moved: MovedCoordinates) -> float:
    """Return the largest relative change of directions and arms of joints and springs, as their bodies see them.

    Args:
        coordinates: coordinates of the scene.
        moved: `displaced` coordinates of the same scene.
    """
    scene = coordinates.scene
    places = [body.point_position(point) for body in scene.bodies for point in body.point_names]
    size = float(np.linalg.norm(np.ptp(places, axis=0))) or 1.0
    starts, ends, views = {}, {}, {}
    for body in scene.bodies:
        state, rotation, place = moved.states[body.name], np.eye(3), np.zeros(3)
        if isinstance(state, FrameState):
            rotation, place = state.rotation, state.position - state.rotation @ state.frame
        starts[body.name] = RigidState(body)
        ends[body.name] = RigidState(body, np.concatenate([place, Rotation.from_matrix(rotation).as_rotvec()]))
        centre = np.mean([body.point_position(point) for point in body.point_names], axis=0)
        # Motion of the world's origin per unit of that of the centre, along axes that turn with the body.
        turned = np.kron(np.eye(2), rotation)
        views[body.name] = rigid_transfer(-centre), rigid_transfer(-(rotation @ centre + place)) @ turned
    scale, result = np.repeat([1.0, 1 / size], 3), 0.0
    for term in scene.terms:
        if not isinstance(term, (ForceLaw, Constraint)) or term.measure.within:
            continue
        found = [term.measure.evaluate(states)[1] for states in (starts, ends)]
        changes, sizes = np.zeros((2, len(term.measure.components)))
        for name in term.measure.bodies:
            if scene.split(f"{name}.")[0].moves:
                first, second = (rows[name] @ view * scale for rows, view in zip(found, views[name], strict=True))
                changes += np.sum((second - first) ** 2, axis=1)
                sizes += np.sum(first**2, axis=1)
        acts = sizes > 0
        result = max(result, float(np.sqrt((changes[acts] / sizes[acts]).max(initial=0.0))))
    return result
