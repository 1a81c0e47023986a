"""Geometric stiffness: the stiffness that forces in springs and joints add to small motion, as their directions rotate.

Each body has a frame: a rigid body at its centre of mass, a reduced body its floating frame. The rotation vector theta
of the frame, and the deformation d and rotation e of each point relative to it, are linear in the coordinates. A point
at r from the frame's origin p moves to p + R(theta) (r + d) and rotates by R(theta) exp(e), as in Exudyn's floating
frame. A force f in a measure with the Jacobian J has the stiffness d(J^T f)/dq.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.rigid_motion import skew
from nassim.scene.bodies import FlexibleBody, RigidBody
from nassim.scene.measures import Combination, Measure, PointMeasure
from nassim.scene.terms import AppliedForce, BaseAcceleration, CoilForce, Constraint
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.constraints import undeformed_rows
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.moved_coordinates import MovedCoordinates
from nassim.simulation.model.states import FrameState
from nassim.simulation.model.tangents import Tangent


@dataclass(frozen=True)
class Frame:
    """The frame of a body.

    Attributes:
        position: position of its origin at the start, world frame, (3,) [m].
        motion: motion of its origin along the world's axes per unit of all coordinates, (6, n_all).
    """

    position: Array
    motion: Array

    @property
    def rotation(self) -> Array:
        """Rotation per unit of all coordinates, (3, n_all)."""
        return self.motion[3:]


def frames(coordinates: Coordinates) -> dict[str, Frame]:
    """Return the frame of each moving body, by name; bodies of other formulations move linearly beside a fixed one."""
    scene, result = coordinates.scene, {}
    for name, place in coordinates.slices.items():
        body = scene.body(name)
        motion = np.zeros((6, coordinates.size))
        if isinstance(state := coordinates.states[name], FrameState):
            motion[:, place] = state.frame_motion
            result[name] = Frame(state.position, motion)
            continue
        if isinstance(body, FlexibleBody):
            point = scene.frame_point(body)
            motion[:, place] = body.motion(point)
            result[name] = Frame(body.point_position(point), motion)
        else:
            if isinstance(body, RigidBody):
                motion[:, place] = np.eye(6)
            result[name] = Frame(body.position, motion)
    return result


@dataclass(frozen=True)
class GeometricStiffness:
    """Geometric stiffness of an assembly's springs and joints.

    Attributes:
        assembly: the assembled scene.
        frames: frames of the moving bodies, by name.
        held: rows on all coordinates that vanish, (m, n_all): those of the joints, see `Constraints.enforced`, then
            those of bodies that do not deform, without terms of second order.
    """

    assembly: Assembly
    frames: Mapping[str, Frame]
    held: Array

    @classmethod
    def of(cls, assembly: Assembly) -> "GeometricStiffness":
        """Make the geometric stiffness of an assembled scene."""
        coordinates, enforced = assembly.coordinates, assembly.constraints.enforced
        rows = [np.zeros((0, coordinates.size))]
        for joint in assembly.scene.terms_of(Constraint):
            rows.append(coordinates.jacobian(joint.measure)[joint.rows(enforced[joint.name])])
        rows.append(undeformed_rows(coordinates))
        return cls(assembly, frames(coordinates), np.vstack(rows))

    def resisted_by_springs(self, coordinates: Array) -> Iterator[tuple[Measure, Array]]:
        """Yield the measures of springs with the forces that resist them at given coordinates, (n_all,)."""
        for tangent in self.assembly.tangents:
            yield tangent.law.measure, tangent.law.static_resistance(tangent.rows @ coordinates)

    def resisted_by_joints(self, forces: Array) -> Iterator[tuple[Measure, Array]]:
        """Yield the measures of joints with the forces that resist them, where constraints bear forces, (n_all,)."""
        if not len(self.held):
            return
        multipliers, first = _shares_of(self.held, forces), 0
        for joint in self.assembly.scene.terms_of(Constraint):
            components = self.assembly.constraints.enforced[joint.name]
            force = np.zeros(len(joint.measure.components))
            force[joint.rows(components)] = multipliers[first : first + len(components)]
            first += len(components)
            yield joint.measure, force

    def of_joints(self, forces: Array) -> Array:
        """Compute the stiffness of constraint forces, (n_all,), as the joints' axes and arms rotate, (n_all, n_all)."""
        return self._sum(self.resisted_by_joints(forces))

    def of_springs(self, coordinates: Array) -> Array:
        """Compute the stiffness of spring forces at given coordinates, (n_all,), as their directions rotate."""
        return self._sum(self.resisted_by_springs(coordinates))

    def at_rest(self, forces: Array) -> Array:
        """Compute the stiffness of springs, and of constraint forces (n_all,), where the bodies are, (n_all, n_all)."""
        result, states = self.of_joints(forces), self.assembly.coordinates.states
        for tangent in self.assembly.tangents:
            value = tangent.law.measure.evaluate(states)[0]
            self._add_measure(result, tangent.law.measure, tangent.law.static_resistance(value))
        return result

    def _sum(self, resisted: Iterable[tuple[Measure, Array]]) -> Array:
        result = np.zeros((self.assembly.coordinates.size,) * 2)
        for measure, force in resisted:
            self._add_measure(result, measure, force)
        return result

    def of_measure(self, measure: Measure, force: Array) -> Array:
        """Compute the stiffness of a force that resists a measure, (k,), as the rows of the measure change.

        Returns:
            The stiffness, (n_all, n_all), symmetric where the force has an energy.
        """
        result = np.zeros((self.assembly.coordinates.size,) * 2)
        self._add_measure(result, measure, force)
        return result

    def _add_measure(self, total: Array, measure: Measure, force: Array) -> None:
        """Add the stiffness of a force that resists a measure, see `of_measure`, to a sum, (n_all, n_all)."""
        if np.any(force):
            for factor, part in measure.point_measures:
                moving, stiffness = self._of_points(part, factor * force)
                if part.has_energy(force):
                    stiffness = 0.5 * (stiffness + stiffness.T)
                total[np.ix_(moving, moving)] += stiffness

    def _of_points(self, measure: PointMeasure, force: Array) -> tuple[Array, Array]:
        """Return coordinates of the points' bodies, (n,), and the stiffness of a force in their measure, (n, n)."""
        coordinates, slices = self.assembly.coordinates, self.assembly.coordinates.slices
        columns = [np.arange(coordinates.size)[slices[name]] for name in measure.bodies if name in slices]
        moving = np.concatenate([np.zeros(0, dtype=int), *columns])
        poses, reference = measure.poses(coordinates.states)
        motions = [coordinates.motion(path)[:, moving] for path in measure.points]
        wrenches = force @ measure.at(poses, reference)[1]
        motion = np.vstack(motions)
        if isinstance(coordinates, MovedCoordinates):
            own = measure.stiffness_at(force, poses, reference)
        else:
            own = measure.geometric_stiffness(force, reference)
        stiffness = motion.T @ own @ motion
        for k, (path, (place, _)) in enumerate(zip(measure.points, poses, strict=True)):
            frame = self._frame(path)
            wrench = wrenches[6 * k : 6 * k + 6]
            stiffness += stiffness_of_point(frame.motion[:, moving], motions[k], place - frame.position, wrench)
        return moving, stiffness

    def _frame(self, path: str) -> Frame:
        body, _ = self.assembly.scene.split(path)
        if body.moves:
            return self.frames[body.name]
        return Frame(self.assembly.scene.point_position(path), np.zeros((6, self.assembly.coordinates.size)))


def stiffness_of_point(of_frame: Array, of_point: Array, arm: Array, wrench: Array) -> Array:
    """Return the stiffness of a wrench (6,) on a point that a frame carries, (n, n), to first order in the wrench.

    The point moves to second order by theta x (u - u_frame) - theta x (theta x arm) / 2. Its angular velocity is, with
    its small rotation v, v' + (theta x v' + theta' x v + v x v') / 2.

    Args:
        of_frame: small motion of the frame, (6, n).
        of_point: small motion of the point, (6, n).
        arm: position of the point from the origin of the frame, (3,) [m].
        wrench: force and moment that keep their directions.
    """
    force, moment = skew(wrench[:3]), skew(wrench[3:])
    theta, rotation = of_frame[3:], of_point[3:]
    beside = of_point[:3] - of_frame[:3] + 0.5 * skew(arm) @ theta
    half = (beside.T @ force + 0.5 * rotation.T @ moment) @ theta
    return half + half.T + 0.5 * rotation.T @ moment @ rotation


def spring_forces(tangents: Sequence[Tangent], coordinates: Array) -> Array:
    """Compute the resistance of springs, (n_all,), at given coordinates, (n_all,)."""
    result = np.zeros(len(coordinates))
    for tangent in tangents:
        rows = tangent.rows
        result += rows.T @ tangent.law.static_resistance(rows @ coordinates)
    return result


def applied_forces(assembly: Assembly, values: Mapping[str, float]) -> Iterator[tuple[Measure, float]]:
    """Yield the measures on which constant inputs act, and their forces, without accelerations of the base.

    A force on a combination acts on each of its parts.

    Args:
        assembly: the assembled scene.
        values: values of inputs, by name.
    """
    for term in assembly.terms:
        if isinstance(term, AppliedForce | CoilForce) and values.get(term.input):
            yield from _parts(term.measure, values[term.input] * term.gain)


def _parts(measure: Measure, force: float) -> Iterator[tuple[Measure, float]]:
    """Yield the single measures of a measure, and the parts of a force on it."""
    if isinstance(measure, Combination):
        for factor, part in measure.parts:
            yield from _parts(part, factor * force)
    else:
        yield measure, force


def gravity_felt(assembly: Assembly, gravity: Array, values: Mapping[str, float]) -> Array:
    """Return gravity less constant accelerations of the base, (3,); arguments as `applied_forces`."""
    for term in assembly.terms:
        if isinstance(term, BaseAcceleration):
            gravity = gravity - values.get(term.input, 0.0) * np.asarray(term.direction)
    return gravity


def is_preloaded(tangents: Sequence[Tangent]) -> bool:
    """Return whether a spring has a force in the reference configuration."""
    return any(np.any(tangent.law.static_resistance(np.zeros(len(tangent.rows)))) for tangent in tangents)


def _shares_of(rows: Array, forces: Array) -> Array:
    """Return multipliers (m,) of rows (m, n) that add up to forces (n,)."""
    sizes = np.linalg.norm(rows, axis=1)
    pivoted = "gelsy"  # several times faster than a singular value decomposition, and right for dependent rows too
    return scipy.linalg.lstsq((rows / sizes[:, None]).T, forces, lapack_driver=pivoted)[0] / sizes
