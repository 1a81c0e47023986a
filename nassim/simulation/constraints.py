"""What joints hold in small motion: the rows that vanish, those that drives move, and the motions that are left."""

from collections.abc import Callable

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.scene.part import Constraint, Follow
from nassim.scene.scene import Scene

REDUNDANT = 1e-7
"""Constraints with less than this share of their own are implied by others."""


def constraint_rows(
    scene: Scene, motion: Callable[[str], Array], mass: Array, rows: Array
) -> tuple[Array, Array, dict[str, tuple[str, ...]]]:
    """All constraints after given rows, (m, n_all), less those that earlier ones imply, and what each joint holds.

    motion: of a point, by its path, in the world's frame, (6, n_all); mass: (n_all, n_all)

    In the middle what these rows are per unit of the drives that follow inputs, (m, d): small motion is about the state
    of the drives, whose joints' motions are held. Raises ValueError for a drive whose motion others hold.
    """
    joints = {joint.name: joint for joint in scene.said(Constraint)}
    wanted: list[tuple[Constraint, str, Follow | None]] = [(j, d, None) for j in joints.values() for d in j.held]
    wanted += [(joints[drive.constraint], drive.direction, drive) for drive in scene.said(Follow)]
    scale = 1.0 / np.sqrt(np.diag(mass))
    basis = scipy.linalg.orth((rows * scale).T).T if len(rows) else rows  # SciPy before 1.14 takes no empty matrix
    kept, moved = [rows], [np.zeros((len(rows), len(scene.follows)))]
    enforced: dict[str, tuple[str, ...]] = {name: () for name in joints}
    for joint, direction, drive in wanted:
        relative = motion(joint.b) - motion(joint.a)
        row = joint.axes[:, "xyz".index(direction[-1])] @ np.split(relative, 2)[direction.startswith("r")]
        rest = row * scale
        size = np.linalg.norm(rest)
        for _ in range(2):  # twice is enough for orthogonality to the last digit
            rest = rest - basis.T @ (basis @ rest)
        if np.linalg.norm(rest) > REDUNDANT * size:
            basis = np.vstack([basis, rest / np.linalg.norm(rest)])
            kept.append(row[None])
            moved.append(np.array([[float(follow is drive) for follow in scene.follows]]).reshape(1, -1))
            enforced[joint.name] += (direction,)
        elif drive is not None:
            raise ValueError(
                f"{direction} of joint {joint.name!r} cannot be driven: other joints or drives hold it already"
            )
    return np.vstack(kept), np.vstack(moved), enforced


def null_space(constraints: Array, mass: Array) -> Array:
    """Orthonormal basis of the motions that satisfy the constraints; redundant constraints do no harm."""
    n = len(mass)
    if len(constraints) == 0:
        return np.eye(n)
    # The scale turns metres, radians and modal amplitudes into comparable square roots of energy.
    scale = 1.0 / np.sqrt(np.diag(mass))
    scaled = constraints * scale
    scaled = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
    result: Array = scale[:, None] * scipy.linalg.null_space(scaled, rcond=1e-9)
    return result
