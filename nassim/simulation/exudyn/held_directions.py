"""Directions that overdetermined joints hold during a run.

Where joints hold more directions than there are independent ones, as those of linkages do, Exudyn's equations need a
choice of independent ones. Others imply the rest at the start of a run, but what is chosen may cease to be independent
once the bodies have moved far. So the choice changes with the motion, which does not depend on it.
"""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_transfer
from nassim.simulation.exudyn.frame_poses import FramePoses
from nassim.simulation.exudyn.running_system import System
from nassim.simulation.exudyn.summands import dot
from nassim.simulation.model.constraints import REDUNDANT
from nassim.simulation.model.motion_size import scene_size
from nassim.simulation.model.rigid_twists import RigidTwists

STEPS = 5
"""Time steps between two looks at the motion."""
MOVED = 0.3
"""Rotation [rad], and displacement over the scene's size, after which the best choice is checked again."""
POOR = 0.3
"""Smallest singular value of the chosen directions, over that of the best choice, below which they change."""


class HeldDirections:
    """Chooses which directions the joints of a running system hold.

    Attributes:
        chosen: directions that each joint holds, by its name.
    """

    def __init__(self, system: System) -> None:
        """Begin with the choice of the start."""
        scene, self.chosen = system.assembly.scene, dict(system.assembly.constraints.enforced)
        self._system, self._frames, self._twists = system, FramePoses(system), RigidTwists(scene)
        self._size, self._names = scene_size(scene), tuple(self._twists.bodies)
        self._seen, self._quality = np.zeros((0, 12)), 0.0
        self._compare(self.chosen)
        if self._changes:
            self._start = self._frames.poses(self._names, reference=True)
            self._seen = self._poses()
            rows = self._rows(self._seen)
            if self._independence(rows, self.chosen) < REDUNDANT:
                # Deformation makes directions independent that are not so for rigid bodies; those joints do not change.
                self._compare(self._independent_joints(rows))

    def _independent_joints(self, rows: Mapping[tuple[str, str], Array]) -> list[str]:
        """Return joints whose directions are independent for rigid bodies; joints of bodies that deform come last."""
        constraints, bent = self._twists.scene.constraints, {*self._system.flexible, *self._system.carried}
        deforms = {name: not bent.isdisjoint(constraints[name].measure.bodies) for name in self.chosen}
        result: list[str] = []
        for name in sorted(self.chosen, key=lambda name: (not self.chosen[name], deforms[name])):
            self._compare([*result, name])
            if self._independence(rows, self.chosen) >= REDUNDANT:
                result.append(name)
        return result

    def _compare(self, joints: Collection[str]) -> None:
        """Choose among the directions of these joints."""
        constraints, chosen = self._twists.scene.constraints, self.chosen
        self._joints = tuple(joints)
        self._free = [(name, c) for name in joints if name in self._system.joints for c in constraints[name].held]
        self._bound = [one for one in self._named(chosen) if one not in self._free]
        self._count = len(self._named(chosen)) - len(self._bound)
        self._changes = self._count < len(self._free)

    def renew(self, step: int) -> bool:
        """Change the directions where they are hardly independent any more.

        Args:
            step: number of the time step.

        Returns:
            Whether they have changed. Newton's iterations then need a new Jacobian.
        """
        if not self._changes or step % STEPS:
            return False
        poses = self._poses()
        if np.abs(poses - self._seen).max() < MOVED * self._quality:
            return False
        self._seen, rows = poses, self._rows(poses)
        best = self._best(rows)
        found, possible = self._independence(rows, self.chosen), self._independence(rows, best)
        self._quality = min(1.0, found / possible) if possible else 1.0
        if self._quality >= POOR:
            return False
        self._quality = 1.0
        self._hold(best)
        return True

    @property
    def state(self) -> Any:
        """The present choice and when it is checked again."""
        return self.chosen, self._seen, self._quality

    def restore(self, state: Any) -> None:
        """Go back to a state."""
        chosen, self._seen, self._quality = state
        self._hold(chosen)

    def _hold(self, chosen: dict[str, tuple[str, ...]]) -> None:
        """Let Exudyn's joints hold these directions, by the joint's name."""
        for name, number in self._system.joints.items():
            if chosen[name] != self.chosen[name]:
                components = self._twists.scene.constraints[name].measure.components
                axes = [int(component in chosen[name]) for component in components]
                self._system.mbs.SetObjectParameter(number, "constrainedAxes", axes)
        self.chosen = chosen

    def _named(self, chosen: Mapping[str, tuple[str, ...]]) -> list[tuple[str, str]]:
        return [(joint, component) for joint in self._joints for component in chosen[joint]]

    def _poses(self) -> Array:
        """Return the frames' positions over the scene's size and their rotations since the start, (bodies, 12)."""
        rotations, positions = self._frames.poses(self._names, reference=False)
        turns = rotations @ self._start[0].transpose(0, 2, 1)
        return np.hstack([positions / self._size, turns.reshape(-1, 9)])

    def _rows(self, poses: Array) -> dict[tuple[str, str], Array]:
        """Return the rates of directions at these poses by the motions of all bodies, of unit length, (6 bodies,)."""
        positions, turns = self._size * poses[:, :3], poses[:, 3:].reshape(-1, 3, 3)
        shifts = positions - dot(turns, self._start[1][:, None])
        twists = np.hstack([shifts, Rotation.from_matrix(turns).as_rotvec()]).ravel()
        scales = [rigid_transfer(-position) * ([self._size] * 3 + [1.0] * 3) for position in positions]
        result = {}
        for name in self._joints:
            joint = self._twists.scene.constraints[name]
            rows = self._twists.rows(joint, joint.measure.components, twists)
            rows = (rows.reshape(len(rows), -1, 1, 6) @ scales).reshape(rows.shape)
            sizes = np.linalg.norm(rows, axis=1, keepdims=True)
            unit = rows / np.where(sizes > 0, sizes, 1.0)
            result.update({(name, c): row for c, row in zip(joint.measure.components, unit, strict=True)})
        return result

    def _best(self, rows: Mapping[tuple[str, str], Array]) -> dict[str, tuple[str, ...]]:
        """Choose the directions that are most independent of each other, besides those that are bound."""
        free = np.array([rows[one] for one in self._free])
        if self._bound:
            bound = scipy.linalg.orth(np.array([rows[one] for one in self._bound]).T)
            free = free - free @ bound @ bound.T
        order = scipy.linalg.qr(free.T, mode="r", pivoting=True)[-1][: self._count]
        kept = {*self._bound, *(self._free[k] for k in order)}
        held = {name: self._twists.scene.constraints[name].measure.components for name in self._joints}
        return self.chosen | {name: tuple(c for c in held[name] if (name, c) in kept) for name in held}

    def _independence(self, rows: Mapping[tuple[str, str], Array], chosen: Mapping[str, tuple[str, ...]]) -> float:
        """Return the smallest singular value of chosen directions; 0 for more of them than there are motions."""
        values = np.linalg.svd(np.array([rows[one] for one in self._named(chosen)]), compute_uv=False)
        return float(values[-1]) if len(values) == len(self._named(chosen)) else 0.0
