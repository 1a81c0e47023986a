"""What finite rotations add to small motion, to second order: where forces that stand still become stiffness.

A body is carried by a frame, a rigid body by its centre of mass, a reduced one by its floating frame. With theta the
rotation vector of the frame and everything else linear in the coordinates, a point at r from the frame's origin, whose
small motion is u, moves by u + theta x (u - u_frame) - theta x (theta x r) / 2. So does Exudyn's floating frame.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import DIRECTIONS, skew
from nassim.scene.bodies import RigidBody
from nassim.scene.part import Constraint, Line, Row, SixSprings, Spring
from nassim.scene.scene import Scene
from nassim.simulation.rows import bushing_rows, shares
from nassim.simulation.small_motion import Assembly


@dataclass(frozen=True)
class Frame:
    """What carries a body.

    position: of its origin at the start, world frame, (3,) [m]
    motion: of its origin along the world's axes per unit of all coordinates, (6, n_all)
    """

    position: Array
    motion: Array

    @property
    def turn(self) -> Array:
        """Its rotation, (3, n_all)."""
        return self.motion[3:]


@dataclass(frozen=True)
class Point:
    """A point of a body: its small motion along the world's axes, (6, n_all), and what carries it, at an arm (3,)."""

    motion: Array
    frame: Frame
    arm: Array

    def bends(self, force: Array) -> Array:
        """Second derivatives, (n_all, n_all), of the work of a force (3,) that keeps its direction."""
        beside = self.motion[:3] - self.frame.motion[:3] + 0.5 * skew(self.arm) @ self.frame.turn
        return turned(force, self.frame.turn, beside)

    def twists(self, moment: Array) -> Array:
        """Second derivatives of a moment (3,) times the point's rotation vector, (n_all, n_all)."""
        return 0.5 * turned(moment, self.frame.turn, self.motion[3:] - self.frame.turn)


def turned(force: Array, a: Array, b: Array) -> Array:
    """Second derivatives of force . (a q x b q) by q, (n, n); a, b: (3, n)."""
    half = -a.T @ skew(force) @ b
    result: Array = half + half.T
    return result


def frames(assembly: Assembly) -> dict[str, Frame]:
    """What carries each moving body, by name."""
    scene, result = assembly.scene, {}
    for name, place in assembly.slices.items():
        body, _ = scene.split(f"{name}.")
        motion = np.zeros((6, len(assembly.basis)))
        if isinstance(body, RigidBody):
            motion[:, place] = np.eye(6)
            result[name] = Frame(body.position, motion)
        else:
            point = scene.frame_point(body)
            motion[:, place] = body.motion(point)
            result[name] = Frame(body.point_position(point), motion)
    return result


@dataclass(frozen=True)
class FiniteMotion:
    """An assembly's joints, springs and bodies of fidelity "rigid", to second order.

    held: rows on all coordinates that vanish, (m, n_all): of the joints, as `Assembly.enforced` says, then those of
        bodies that keep their shape, in which nothing is of second order
    """

    assembly: Assembly
    frames: Mapping[str, Frame]
    held: Array

    @classmethod
    def of(cls, assembly: Assembly) -> "FiniteMotion":
        """Of an assembled scene."""
        carried = frames(assembly)
        size = len(assembly.basis)
        rows = [np.zeros((0, size))]
        for joint in _joints(assembly):
            a, b = (_point(assembly, carried, path) for path in (joint.a, joint.b))
            relative = np.kron(np.eye(2), joint.axes.T) @ (b.motion - a.motion)
            rows.append(relative[[list(DIRECTIONS).index(d) for d in assembly.enforced[joint.name]]])
        for body in assembly.scene.flexible_bodies:
            if not body.deforms:
                kept = assembly.frames[body.name].deformation(body.reduced)
                rows.append(np.zeros((len(kept), size)))
                rows[-1][:, assembly.slices[body.name]] = kept
        return cls(assembly, carried, np.vstack(rows))

    def of_joints(self, forces: Array) -> Array:
        """Stiffness of constraint forces on all coordinates, (n_all,), as the joints' axes and arms turn."""
        size = len(forces)
        result = np.zeros((size, size))
        if not len(self.held):
            return result
        multipliers = _shares_of(self.held, forces)
        first = 0
        for joint in _joints(self.assembly):
            directions = self.assembly.enforced[joint.name]
            wrench = np.zeros(6)
            wrench[[list(DIRECTIONS).index(d) for d in directions]] = multipliers[first : first + len(directions)]
            first += len(directions)
            a, b = (_point(self.assembly, self.frames, path) for path in (joint.a, joint.b))
            result += _joint_bends(a, b, wrench, joint.axes)
        return result

    def of_springs(self, coordinates: Array) -> Array:
        """Stiffness of what springs bear at given coordinates, (n_all,), as their arms and directions turn.

        Rotations that the row of a single spring counts are counted in small motion, as everywhere.
        """
        result = np.zeros((len(coordinates), len(coordinates)))
        for word in self.assembly.words:
            if isinstance(word, Spring) and word.stiffness and not word.row.within:
                tension = word.stiffness * float(vector(self.assembly, word.row) @ coordinates)
                result += self._row_bends(word.row, tension)
            elif isinstance(word, SixSprings):
                rows = np.array([vector(self.assembly, row) for row in bushing_rows(word)])
                a, b = (_point(self.assembly, self.frames, path) for path in (word.a, word.b))
                wrench = np.kron(np.eye(2), word.axes) @ word.stiffness @ rows @ coordinates
                apart = _place(self.assembly, word.b) - _place(self.assembly, word.a)
                result += _gap_bends(a, b, a, wrench[:3], apart) + _turn_bends(a, b, wrench[3:])
        return result

    def _row_bends(self, row: Row | Line, tension: float) -> Array:
        points = {path: _point(self.assembly, self.frames, path) for path in row.paths}
        if isinstance(row, Line):
            apart = _place(self.assembly, row.b) - _place(self.assembly, row.a)
            length = float(np.linalg.norm(apart))
            along, gap = apart / length, points[row.b].motion[:3] - points[row.a].motion[:3]
            across = gap - np.outer(along, along @ gap)
            bends = points[row.b].bends(tension * along) - points[row.a].bends(tension * along)
            return bends + tension / length * across.T @ across
        result = np.zeros((len(self.assembly.basis),) * 2)
        for path, weights in row.points:
            point, force = points[path], tension * weights[:3]
            if row.frame:
                origin = np.zeros_like(point.motion)
                still = Point(origin, Frame(np.zeros(3), origin), np.zeros(3))
                result += _gap_bends(still, point, points[row.frame], force, _place(self.assembly, path))
            else:
                result += point.bends(force)
        return result


def spring_forces(assembly: Assembly, coordinates: Array) -> Array:
    """What springs resist with, (n_all,), at given coordinates, (n_all,)."""
    result = np.zeros(len(coordinates))
    for word in assembly.words:
        if isinstance(word, Spring):
            row = vector(assembly, word.row)
            result += word.stiffness * float(row @ coordinates) * row
        elif isinstance(word, SixSprings):
            rows = np.array([vector(assembly, row) for row in bushing_rows(word)])
            result += rows.T @ word.stiffness @ rows @ coordinates
    return result


def vector(assembly: Assembly, row: Row | Line) -> Array:
    """A row on all coordinates, (n_all,)."""
    result = np.zeros(len(assembly.basis))
    for name, share in shares(assembly.scene, row).items():
        result[assembly.slices[name]] = share
    return result


def _joints(assembly: Assembly) -> tuple[Constraint, ...]:
    return tuple(word for word in assembly.words if isinstance(word, Constraint))


def _point(assembly: Assembly, carried: Mapping[str, Frame], path: str) -> Point:
    scene: Scene = assembly.scene
    body, name = scene.split(path)
    position, motion = scene.point_position(path), np.zeros((6, len(assembly.basis)))
    if not body.moves:
        return Point(motion, Frame(position, motion), np.zeros(3))
    motion[:, assembly.slices[body.name]] = body.motion(name)
    frame = carried[body.name]
    return Point(motion, frame, position - frame.position)


def _place(assembly: Assembly, path: str) -> Array:
    return assembly.scene.point_position(path)


def _gap_bends(a: Point, b: Point, frame: Point, force: Array, apart: Array) -> Array:
    """Second derivatives of force . (b less a), which lie apart (3,), along axes that turn with a frame's point."""
    theta = frame.motion[3:]
    result = b.bends(force) - a.bends(force) - turned(force, theta, b.motion[:3] - a.motion[:3])
    bent = np.outer(force, apart) + np.outer(apart, force) - 2 * (force @ apart) * np.eye(3)
    return result + 0.5 * theta.T @ bent @ theta - frame.twists(np.cross(apart, force))


def _turn_bends(a: Point, b: Point, moment: Array) -> Array:
    """Second derivatives of moment . rotation vector of b against a, along axes that turn with a."""
    return b.twists(moment) - a.twists(moment) - 0.5 * turned(moment, a.motion[3:], b.motion[3:])


def _joint_bends(a: Point, b: Point, wrench: Array, axes: Array) -> Array:
    """Second derivatives of a wrench (6) along a joint's axes, which turn with a, times gap and twist of b against a.

    The twist is what the joint lets vanish: entries (y, z), (x, z), (x, y) of the relative rotation matrix, with the
    sign of its small form, as Exudyn's generic joint has them: a joint with one held rotation is a universal joint.
    """
    force, moment = axes @ wrench[:3], axes @ wrench[3:]
    result = _gap_bends(a, b, a, force, np.zeros(3)) + _turn_bends(a, b, moment)
    x, y, z = axes.T @ (b.motion - a.motion)[3:]
    for share, (first, second) in zip(wrench[3:] * (-0.5, 0.5, -0.5), ((y, z), (x, z), (x, y)), strict=True):
        result += share * (np.outer(first, second) + np.outer(second, first))
    return result


def _shares_of(rows: Array, forces: Array) -> Array:
    """Multipliers (m,) of rows (m, n) that add up to forces (n,)."""
    sizes = np.linalg.norm(rows, axis=1)
    result: Array = np.linalg.lstsq((rows / sizes[:, None]).T, forces, rcond=None)[0] / sizes
    return result
