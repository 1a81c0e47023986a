"""Geometric stiffness: the stiffness that forces in springs and joints add to small motion, as their directions rotate.

Each body has a frame: a rigid body at its centre of mass, a reduced body its floating frame. The rotation vector theta
of the frame, and the deformation d and rotation e of each point relative to it, are linear in the coordinates. A point
at r from the frame's origin p moves to p + R(theta) (r + d) and rotates by R(theta) exp(e), as in Exudyn's floating
frame. A force f in a measure with the Jacobian J has the stiffness d(J^T f)/dq.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_transfer, skew
from nassim.scene.bodies import FlexibleBody, RigidBody
from nassim.scene.measures import Measure, PointMeasure, Pose
from nassim.scene.terms import Constraint
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.constraints import undeformed_rows
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.tangents import Tangent

ROTATION_STEP = 5e-4
"""Rotation [rad], and displacement over the size of the scene, of difference quotients of fourth order."""


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
        body, _ = scene.split(f"{name}.")
        motion = np.zeros((6, coordinates.size))
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
        for joint in _joints(assembly):
            rows.append(coordinates.jacobian(joint.measure)[joint.rows(enforced[joint.name])])
        rows.append(undeformed_rows(coordinates))
        return cls(assembly, frames(coordinates), np.vstack(rows))

    def of_joints(self, forces: Array) -> Array:
        """Compute the stiffness of constraint forces, (n_all,), as the joints' axes and arms rotate, (n_all, n_all)."""
        result = np.zeros((len(forces), len(forces)))
        if not len(self.held):
            return result
        multipliers, first = _shares_of(self.held, forces), 0
        for joint in _joints(self.assembly):
            components = self.assembly.constraints.enforced[joint.name]
            force = np.zeros(len(joint.measure.components))
            force[joint.rows(components)] = multipliers[first : first + len(components)]
            first += len(components)
            result += self.of_measure(joint.measure, force)
        return result

    def of_springs(self, coordinates: Array) -> Array:
        """Compute the stiffness of spring forces at given coordinates, (n_all,), as their directions rotate."""
        result = np.zeros((len(coordinates), len(coordinates)))
        for tangent in self.assembly.tangents:
            force = tangent.law.resistance(tangent.rows @ coordinates, np.zeros(len(tangent.rows)))
            result += self.of_measure(tangent.law.measure, force)
        return result

    def of_measure(self, measure: Measure, force: Array, *, conservative: bool = True) -> Array:
        """Compute the stiffness of a force that resists a measure, as the rows of the measure change.

        Args:
            measure: the measure, of k components.
            force: the force, (k,).
            conservative: whether the force has an energy, so that the stiffness is symmetric but for rounding.

        Returns:
            The stiffness, (n_all, n_all).
        """
        result = np.zeros((self.assembly.coordinates.size,) * 2)
        if np.any(force):
            for factor, part in measure.point_measures:
                result += self._of_points(part, factor * force)
        return 0.5 * (result + result.T) if conservative else result

    def _of_points(self, measure: PointMeasure, force: Array) -> Array:
        """Return the stiffness of a force in a measure of points, (n_all, n_all)."""
        scene = self.assembly.scene
        reference = [scene.point_position(path) for path in measure.points]
        motion = np.vstack([self._motion(path) for path in measure.points])
        arms = [place - self._frame(path).position for path, place in zip(measure.points, reference, strict=True)]
        n, moving = len(motion), np.flatnonzero(motion.any(axis=0))
        motion = motion[:, moving]

        def forces(moved: Array) -> Array:
            charts = [_chart(*chart) for chart in zip(reference, arms, np.split(moved, n // 12), strict=True)]
            along = force @ measure.at([pose for pose, _ in charts], reference)[1]
            return np.concatenate(
                [part @ jacobian for part, (_, jacobian) in zip(np.split(along, n // 12), charts, strict=True)]
            )

        # Rigid bodies have fewer coordinates than the motions of their points and frames have components.
        unit = np.eye(n)[:, motion.any(axis=1)]
        directions = motion if len(moving) <= unit.shape[1] else unit
        # Lengths in units of the arms and distances, so that one step fits displacements and rotations.
        size = max(float(np.ptp(reference, axis=0).max()), *(float(np.linalg.norm(arm)) for arm in arms), 1e-6)
        scale = np.tile(np.repeat([size, 1.0], 3), n // 6)
        slopes = []
        for direction in directions.T:
            step = ROTATION_STEP / np.abs(direction / scale).max()
            near, far = (forces(m * step * direction) - forces(-m * step * direction) for m in (1, 2))
            slopes.append((8 * near - far) / (12 * step))
        stiffness = np.array(slopes) @ motion
        if directions is unit:
            stiffness = motion.T @ unit @ stiffness
        result = np.zeros((self.assembly.coordinates.size,) * 2)
        result[np.ix_(moving, moving)] = stiffness.T
        return result

    def _frame(self, path: str) -> Frame:
        body, _ = self.assembly.scene.split(path)
        if body.moves:
            return self.frames[body.name]
        return Frame(self.assembly.scene.point_position(path), np.zeros((6, self.assembly.coordinates.size)))

    def _motion(self, path: str) -> Array:
        """Return the small motion of a point's frame, then of the point, (12, n_all)."""
        return np.vstack([self._frame(path).motion, self.assembly.coordinates.motion(path)])


def _chart(reference: Array, arm: Array, moved: Array) -> tuple[Pose, Array]:
    """Return a point's pose at small motions (12,) of its frame and itself, and its velocities by theirs, (6, 12)."""
    shift, theta = moved[:3], moved[3:6]
    rotation = Rotation.from_rotvec(theta).as_matrix()
    beside = moved[6:] - rigid_transfer(arm) @ moved[:6]  # deformation d and e, linear in the small motions
    d, e = beside[:3], beside[3:]
    bent = rotation @ left_jacobian(e)
    jacobian = np.zeros((6, 12))
    jacobian[:3, :3], jacobian[:3, 6:9], jacobian[3:, 9:] = np.eye(3) - rotation, rotation, bent
    spin = left_jacobian(theta)
    jacobian[:3, 3:6] = skew(rotation @ (arm + d)).T @ spin + rotation @ skew(arm)
    jacobian[3:, 3:6] = spin - bent
    position = reference - arm + shift + rotation @ (arm + d)
    return (position, rotation @ Rotation.from_rotvec(e).as_matrix()), jacobian


def left_jacobian(vector: Array) -> Array:
    """Return J with omega = J v' for a rotation vector v, (3,), and the angular velocity omega, (3, 3)."""
    cross, square = skew(vector), float(vector @ vector)
    angle = np.sqrt(square)
    if angle < 1e-4:
        return np.eye(3) + (0.5 - square / 24) * cross + (1 / 6 - square / 120) * cross @ cross
    first, second = (1 - np.cos(angle)) / square, (angle - np.sin(angle)) / (angle * square)
    return np.eye(3) + first * cross + second * cross @ cross


def spring_forces(tangents: Sequence[Tangent], coordinates: Array) -> Array:
    """Compute the resistance of springs, (n_all,), at given coordinates, (n_all,)."""
    result = np.zeros(len(coordinates))
    for tangent in tangents:
        rows = tangent.rows
        result += rows.T @ tangent.law.resistance(rows @ coordinates, np.zeros(len(rows)))
    return result


def is_preloaded(tangents: Sequence[Tangent]) -> bool:
    """Return whether a spring has a force in the reference configuration."""
    zeros = [np.zeros(len(tangent.rows)) for tangent in tangents]
    return any(np.any(tangent.law.resistance(zero, zero)) for tangent, zero in zip(tangents, zeros, strict=True))


def _joints(assembly: Assembly) -> list[Constraint]:
    return [term for term in assembly.terms if isinstance(term, Constraint)]


def _shares_of(rows: Array, forces: Array) -> Array:
    """Return multipliers (m,) of rows (m, n) that add up to forces (n,)."""
    sizes = np.linalg.norm(rows, axis=1)
    result: Array = np.linalg.lstsq((rows / sizes[:, None]).T, forces, rcond=None)[0] / sizes
    return result
