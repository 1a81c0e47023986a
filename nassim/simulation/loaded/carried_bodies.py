"""Stiffness of the loads on rigid bodies that floating bodies carry, as these bodies turn by the deformation.

In a floating frame, a place of a carried body at the arm a from the point that carries it moves by e x a, with the
rotation vector e of that point by deformation. A body that a joint holds moves by exp(e) a - a, which a force f feels:
to second order it does the work f . (e x (e x a)) / 2, so that its stiffness on e is (f . a) I - (f a^T + a f^T) / 2.
"""

import numpy as np

from nassim.base.checks import Array
from nassim.scene.bodies import FlexibleBody
from nassim.simulation.loaded.geometric_stiffness import GeometricStiffness
from nassim.simulation.loaded.spinning import integrals
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.rigid_groups import find_rigid_groups


def stiffness_of_carried(
    assembly: Assembly,
    geometric: GeometricStiffness,
    displacement: Array,
    borne: Array,
    body_forces: dict[str, Array],
) -> dict[str, Array]:
    """Compute the stiffness that loads on carried bodies add to the deformation of the bodies that carry them.

    Args:
        assembly: the assembled scene.
        geometric: its geometric stiffness.
        displacement: elastic displacement under the loads in all coordinates, (n_all,).
        borne: forces that constraints bear, (n_all,).
        body_forces: body force per mass by body, along its axes, see `body_force_terms`.

    Returns:
        The stiffness on each carrying body's coordinates relative to its frame, by name, (n, n).
    """
    scene, groups = assembly.scene, find_rigid_groups(assembly.constraints)
    result: dict[str, Array] = {}
    if not groups.hosts:
        return result
    found = [*geometric.resisted_by_springs(displacement), *geometric.resisted_by_joints(borne)]
    for leader, path in groups.hosts.items():
        host, point = scene.split(path)
        assert isinstance(host, FlexibleBody)
        if point == scene.frame_point(host):
            continue  # it does not turn by deformation
        names, start = groups.groups[leader], host.point_position(point)
        dyad = np.zeros((3, 3))  # sum of f a^T
        for name in names:
            rotation, origin, gram = integrals(scene.body(name))
            arms = np.hstack([(origin - start)[:, None], rotation])
            dyad += rotation @ body_forces[name] @ gram[:4, :4] @ arms.T
        for measure, force in found:
            for factor, part in measure.point_measures:
                places = [scene.point_position(end) for end in part.points]
                rows = part.at([(place, np.eye(3)) for place in places], places)[1]
                for k, (end, place) in enumerate(zip(part.points, places, strict=True)):
                    if end.partition(".")[0] in names:
                        dyad -= np.outer(factor * force @ rows[:, 6 * k : 6 * k + 3], place - start)
        turn = host.motion(point)[3:]
        own = turn.T @ (np.trace(dyad) * np.eye(3) - 0.5 * (dyad + dyad.T)) @ turn
        result[host.name] = result.get(host.name, 0.0) + own
    return result
