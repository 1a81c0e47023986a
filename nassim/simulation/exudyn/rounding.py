"""Forces that rounding leaves in equilibrium, below which Newton's iterations find nothing."""

import numpy as np

from nassim.base.checks import Array
from nassim.scene.scene import Scene
from nassim.scene.terms import ForceLaw
from nassim.simulation.exudyn.springs import VIRTUAL_NODE_RADIUS
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.states import ReferenceState

EPSILON = float(np.finfo(float).eps)
DIGITS = 4
"""Last digits that a force of deformation lacks by rounding of the coordinates, of products and of sums."""


def rounding(assembly: Assembly) -> float:
    """Estimate the force that rounding leaves in an equilibrium of a scene, on Exudyn's coordinates.

    No equilibrium can be found more precisely.

    Args:
        assembly: the assembled scene, with its loads.
    """
    return rounding_of_springs(assembly.scene) + rounding_of_deformation(assembly)


def rounding_of_springs(scene: Scene) -> float:
    """Estimate the force [N] that rounding of positions and rotations leaves in a scene's springs.

    The forces of all springs add up, because equal positions round alike.
    """
    states, total = {body.name: ReferenceState(body) for body in scene.bodies}, 0.0
    for law in scene.terms_of(ForceLaw):
        still = np.zeros(len(law.measure.components))
        stiffness = np.abs(law.tangents(still, still)[0])
        pushes, motions = np.zeros(len(still)), np.zeros(len(still))
        for factor, part in law.measure.point_measures:
            rows = factor * part.at_states(states)[1]
            for path, six in zip(part.points, np.split(rows, len(part.points), axis=1), strict=True):
                pushes += np.linalg.norm(six, axis=1)
                motions += np.linalg.norm(six * _sizes(scene, path), axis=1)
        total += float(pushes @ stiffness @ motions)
    return EPSILON * total


def _sizes(scene: Scene, path: str) -> Array:
    """Return the magnitudes of a point's position [m] and rotation by virtual nodes, which round, (6,)."""
    return np.repeat([np.linalg.norm(scene.point_position(path)), 1 / VIRTUAL_NODE_RADIUS], 3)


def rounding_of_deformation(assembly: Assembly) -> float:
    """Estimate the force that rounding leaves in bodies deformed by constant loads.

    Their forces may be far larger than the loads: a strip that a few newtons bend by its thickness gets shorter, and
    forces of many kilonewtons hold that shortening in its stiffest mode.

    Args:
        assembly: the assembled scene, with its loads.
    """
    loads = assembly.loads
    if loads is None:
        return 0.0
    if assembly.scene.in_small_motion:
        return DIGITS * EPSILON * float(np.linalg.norm(loads.force))
    rest, forces = assembly.modal.modes @ loads.equilibrium + assembly.offset, [np.zeros(0)]
    for body in assembly.scene.deformable_bodies:
        own, stiffness = rest[assembly.coordinates.slices[body.name]], body.reduced.stiffness_matrix
        if body.fidelity == "ffrf":
            frame = assembly.coordinates.frames[body.name]
            own, stiffness = frame.deformation(body.reduced) @ own, frame.stiffness_matrix
        forces.append(np.abs(stiffness) @ np.abs(own))
    return DIGITS * EPSILON * float(np.linalg.norm(np.concatenate(forces)))
