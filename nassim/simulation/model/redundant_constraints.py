"""Check that constraints which are redundant at the start stay so once the bodies move."""

from collections.abc import Mapping, Sequence

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_transfer
from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint
from nassim.simulation.model.rigid_twists import RigidTwists, null_space

PERTURBATION = 1e-3
"""Rotation [rad], and displacement over the scene's size, of the small finite motions that test constraints."""
IMPLIED = 1e-4
"""Violation, over the perturbation squared, up to which other constraints imply a constraint in motion too."""


def check_implied(scene: Scene, enforced: Mapping[str, Sequence[str]]) -> None:
    """Check that redundant constraints stay redundant once the bodies move.

    Args:
        scene: the scene.
        enforced: directions that each joint holds, by name, without those that others hold at the start. Small finite
            motions that satisfy these must also satisfy the redundant directions.

    Raises:
        ValueError: for a joint's direction that the others hold at the start, but not in motion.
    """
    joints, rigid = scene.terms_of(Constraint), RigidTwists(scene)
    left_out = {joint.name: tuple(d for d in joint.held if d not in enforced[joint.name]) for joint in joints}
    if not any(left_out.values()):
        return
    points = np.array([scene.point_position(joint.points[0]) for joint in joints])
    middle, size = points.mean(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-6)
    n = len(rigid.bodies)
    about_middle = scipy.linalg.block_diag(*[rigid_transfer(-middle)] * n) * np.tile([size] * 3 + [1.0] * 3, n)
    motions = about_middle @ null_space(rigid.held_rows() @ about_middle)
    if not motions.size:
        return
    correct = about_middle @ np.linalg.pinv(rigid.held_rows(enforced) @ about_middle, rcond=1e-9)

    def opened(twists: Array) -> Array:
        return np.hstack([rigid.gaps(joint, enforced[joint.name], twists) for joint in joints])

    directions = np.hstack([np.eye(motions.shape[1]), np.random.default_rng(0).standard_normal((motions.shape[1], 5))])
    for motion in (motions @ directions).T:
        twists = PERTURBATION * motion / np.abs(np.linalg.solve(about_middle, motion)).max()
        for _ in range(10):
            twists = twists - correct @ opened(twists)
        limit = IMPLIED * PERTURBATION**2 * size
        if np.abs(opened(twists)).max(initial=0.0) > limit:
            continue  # the other constraints lock it, so this is no finite motion
        for joint in joints:
            broken = np.abs(rigid.gaps(joint, left_out[joint.name], twists)) > limit
            if broken.any():
                listed = ", ".join(np.array(left_out[joint.name])[broken])
                raise ValueError(
                    f"joint {joint.name!r}: at the start other joints imply what it holds along {listed}, but no more "
                    "once the bodies move, so there the scene locks or branches, which cannot be simulated; free that "
                    "direction of a joint, start in another position, or let a body deform"
                )
