"""Dependence of a floating body's strain on the point that carries its frame, which linear deformation leaves."""

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_motions
from nassim.bodies.reduced_body import ReducedBody
from nassim.scene.bodies import FlexibleBody
from nassim.simulation.model.assembly import Assembly


def frame_dependence(assembly: Assembly, body: FlexibleBody, deformed: Array) -> float:
    """Compute how much the strain of a floating body depends on the point that carries its frame.

    A reduced body is linear in its frame. Parts of it that turn by theta against the frame, beyond a neck for example,
    are off by theta^2 / 2 times their arms. Where the scene lets them, they move by as much and nothing is strained;
    where it holds them, as a strut parallel to the body does, the body is strained. A frame at another point has this
    error at other places, so the strains by the two frames differ by it. The scene's response to the difference, as a
    load, is that of small motion about the reference configuration.

    Args:
        assembly: the assembled scene.
        body: the body.
        deformed: its coordinates by deformation, (n,).

    Returns:
        The largest difference over all points, relative to the strain itself: a ratio of square roots of strain
        energies [-].
    """
    reduced, modal = body.reduced, assembly.modal
    stiffness, elastic = reduced.stiffness_matrix, ~modal.rigid_modes
    modes = modal.modes[assembly.coordinates.slices[body.name]][:, elastic]
    energy = float(deformed @ stiffness @ deformed)
    largest = 0.0
    for index in range(len(reduced.remote_points)):
        change = _change_of_frame(reduced, deformed, index)
        amplitudes = (stiffness @ change) @ modes / modal.omega[elastic] ** 2
        left = change - modes @ amplitudes
        largest = max(largest, float(left @ stiffness @ left))
    return float(np.sqrt(largest / energy)) if energy > 0 else 0.0


def _change_of_frame(body: ReducedBody, deformed: Array, index: int) -> Array:
    """Return the change of the coordinates (n,) of a deformed body from the linear to any rotation of a remote point.

    The frame moves with that point; the change is of the second order in its rotation.
    """
    result, n = np.zeros(len(deformed)), 6 * len(body.remote_points)
    motions = deformed[:n].reshape(-1, 6)
    places = body.positions
    arms, turned = places - places[index], Rotation.from_rotvec(motions[:, 3:])
    back = turned[index].inv()
    displacements = back.apply(arms + motions[:, :3] - motions[index, :3]) - arms
    result[:n] = np.hstack([displacements, (back * turned).as_rotvec()]).ravel() - deformed[:n]
    return result + rigid_motions(arms, len(deformed)) @ motions[index]
