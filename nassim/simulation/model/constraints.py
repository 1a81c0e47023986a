"""Constraints in small motion: rows that vanish, rows that drives prescribe, and the motions that remain."""

from collections.abc import Callable

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.scene.measures import Measure
from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint, PrescribedMotion

REDUNDANT = 1e-7
"""Share of its own size below which the independent part of a constraint is rounding: other constraints imply it."""


def constraint_rows(
    scene: Scene, jacobian: Callable[[Measure], Array], mass: Array, rows: Array
) -> tuple[Array, Array, dict[str, tuple[str, ...]]]:
    """Collect the rows of all constraints, without those that earlier rows imply.

    Args:
        scene: the scene.
        jacobian: function that returns the rows of a measure, (k, n_all).
        mass: mass matrix, (n_all, n_all).
        rows: rows that precede those of the constraints, (k, n_all).

    Returns:
        The rows, (m, n_all); their values per unit of the drives that follow inputs, (m, d), as small motion is about
        the state of the drives, whose joints' motions are held; and the directions that each joint holds, by name.

    Raises:
        ValueError: for a drive whose motion other joints or drives hold.
    """
    joints = {joint.name: joint for joint in scene.terms_of(Constraint)}
    wanted: list[tuple[Constraint, str, PrescribedMotion | None]]
    wanted = [(joint, component, None) for joint in joints.values() for component in joint.held]
    wanted += [(joints[drive.constraint], drive.component, drive) for drive in scene.terms_of(PrescribedMotion)]
    all_rows = {name: jacobian(joint.measure) for name, joint in joints.items()}
    scale = 1.0 / np.sqrt(np.diag(mass))
    basis = scipy.linalg.orth((rows * scale).T).T if len(rows) else rows  # SciPy before 1.14 takes no empty matrix
    kept, moved = [rows], [np.zeros((len(rows), len(scene.prescribed)))]
    enforced: dict[str, tuple[str, ...]] = {name: () for name in joints}
    for joint, component, drive in wanted:
        (row,) = all_rows[joint.name][joint.rows((component,))]
        rest = row * scale
        size = np.linalg.norm(rest)
        for _ in range(2):  # two passes orthogonalise to the last digit
            rest = rest - basis.T @ (basis @ rest)
        if np.linalg.norm(rest) > REDUNDANT * size:
            basis = np.vstack([basis, rest / np.linalg.norm(rest)])
            kept.append(row[None])
            moved.append(np.array([[float(other is drive) for other in scene.prescribed]]).reshape(1, -1))
            enforced[joint.name] += (component,)
        elif drive is not None:
            raise ValueError(
                f"{component} of joint {joint.name!r} cannot be driven: other joints or drives hold it already"
            )
    return np.vstack(kept), np.vstack(moved), enforced


def null_space(constraints: Array, mass: Array) -> Array:
    """Compute an orthonormal basis of the motions that satisfy the constraints, which may be redundant."""
    n = len(mass)
    if len(constraints) == 0:
        return np.eye(n)
    # The scale turns metres, radians and modal amplitudes into comparable square roots of energy.
    scale = 1.0 / np.sqrt(np.diag(mass))
    scaled = constraints * scale
    scaled = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
    result: Array = scale[:, None] * scipy.linalg.null_space(scaled, rcond=1e-9)
    return result
