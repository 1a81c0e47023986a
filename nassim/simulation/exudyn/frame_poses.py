"""Poses and speeds of the frames of a running Exudyn system's bodies."""

from collections.abc import Callable, Sequence
from functools import cached_property

import exudyn as exu
import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.base.rigid_motion import rotated_motion
from nassim.scene.bodies import Body
from nassim.simulation.exudyn.running_system import System
from nassim.simulation.exudyn.summands import dot


class FramePoses:
    """Reader of the poses of bodies' frames, also of bodies that floating bodies carry or the ground holds."""

    def __init__(self, system: System) -> None:
        self.system = system

    def pose(self, body: Body) -> tuple[Array, Array]:
        """Return position, (3,) [m], and rotation to the world's axes, (3, 3), of a body's own frame.

        The place and axes of Exudyn's node in the body do not matter: they move with the body's frame.
        """
        (now, place), (before, start) = (self._pose(body.name, reference=reference) for reference in (False, True))
        turn = now @ before.T
        return place + turn @ (body.position - start), turn @ body.rotation

    def rotation_angle(self, name: str) -> float:
        """Return the rotation angle of a body's frame since the reference configuration [rad]."""
        rotation = self._pose(name, reference=False)[0] @ self._pose(name, reference=True)[0].T
        return float(np.arccos(np.clip(0.5 * (np.trace(rotation) - 1), -1.0, 1.0)))

    def speed(self, name: str) -> float:
        """Return the angular speed of a body's frame [rad/s]."""
        rate = self.system.mbs.GetNodeOutput(self.system.nodes[name], exu.OutputVariableType.AngularVelocity)
        return float(np.linalg.norm(rate))

    def distance(self, name: str) -> float:
        """Return the displacement [m] of a body's frame; 0 for a body that rigid joints hold to a fixed one."""
        if name not in self.system.framed:
            return 0.0
        return float(np.linalg.norm(self._pose(name, reference=False)[1] - self._pose(name, reference=True)[1]))

    def shifting(self, pairs: Sequence[tuple[str, str]]) -> Callable[[], Array]:
        """Make a function that returns the motion of each pair's first body relative to the other's frame.

        Args:
            pairs: pairs of bodies.

        Returns:
            The function, which returns rotations [rad] and displacements [m] since the reference configuration, (pairs,
            2).
        """
        names = sorted({name for pair in pairs for name in pair})
        bodies, others = np.array([[names.index(name) for name in pair] for pair in pairs], dtype=int).reshape(-1, 2).T

        def seen(*, reference: bool) -> tuple[Array, Array]:
            rotations, places = self.poses(names, reference=reference)
            back = rotations[others].transpose(0, 2, 1)
            return back @ rotations[bodies], (back @ (places[bodies] - places[others])[:, :, None])[:, :, 0]

        turned_at_start, placed_at_start = seen(reference=True)

        def shifts() -> Array:
            turned, placed = seen(reference=False)
            cosines = 0.5 * (np.einsum("nij,nij->n", turned, turned_at_start) - 1)
            away = np.linalg.norm(placed - placed_at_start, axis=1)
            return np.column_stack([np.arccos(np.clip(cosines, -1.0, 1.0)), away])

        return shifts

    def _pose(self, name: str, *, reference: bool) -> tuple[Array, Array]:
        """Return rotation (3, 3) and position (3,) of a body's frame in the world, now or in the reference."""
        rotations, positions = self.poses([name], reference=reference)
        return rotations[0], positions[0]

    def poses(self, names: Sequence[str], *, reference: bool) -> tuple[Array, Array]:
        """Return rotations (k, 3, 3) and positions (k, 3) of bodies' frames in the world, now or in the reference."""
        when = exu.ConfigurationType.Reference if reference else exu.ConfigurationType.Current
        rotations, positions = np.zeros((len(names), 3, 3)), np.zeros((len(names), 3))
        for k, name in enumerate(names):
            if name in self.system.fixed_frames:
                rotations[k], positions[k] = self.system.fixed_frames[name]
                continue
            node, read = self.system.nodes[name], self.system.mbs.GetNodeOutput
            rotations[k] = np.reshape(read(node, exu.OutputVariableType.RotationMatrix, configuration=when), (3, 3))
            positions[k] = read(node, exu.OutputVariableType.Position, configuration=when)
        places = [k for k, name in enumerate(names) if name in self.system.carried]
        if places:
            arms, bent = np.zeros((len(places), 3)), np.zeros((len(places), 6))
            for i, k in enumerate(places):
                host, arms[i], rows = self._arms[names[k]]
                if not reference:
                    bent[i] = rows @ self.system.node_coordinates(host)
            # The axes of a carried body in the reference are those of its host's frame.
            positions[places] += dot(rotations[places], (arms + bent[:, :3])[:, None])
            rotations[places] = rotations[places] @ Rotation.from_rotvec(bent[:, 3:]).as_matrix()
        return rotations, positions

    @cached_property
    def _arms(self) -> dict[str, tuple[str, Array, Array]]:
        """Host of each carried body, its centre of mass from the host's frame, and its motion by deformation, (6, m).

        Both are along the axes of the host.
        """
        result = {}
        for name, body in self.system.carried.items():
            back, frame = body.host.rotation.T, self.system.assembly.coordinates.frames[body.host.name].point
            arm = back @ (body.position - body.host.point_position(frame))
            rows = rotated_motion(back) @ body.motion_at(body.position)
            result[name] = body.host.name, arm, rows @ self.system.flexible[body.host.name].coordinates
        return result
