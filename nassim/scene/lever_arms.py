"""Force laws between moving bodies that leave a moment on both together.

A spring, a damper or a coil along an axis of the world acts on each body at its own point. Where the points lie apart
across the axis, the two forces are on two parallel lines. Their moment acts on the bodies from outside: it resists a
common rotation, as no real part does. An axis that rotates with one of the points (`frame`) has both forces on the line
through the other point. A force against a fixed body leaves its moment on the ground.
"""

import numpy as np

from nassim.base.checks import Array
from nassim.scene.field_kinds import body_of
from nassim.scene.measures import PointMeasure
from nassim.scene.part import Part
from nassim.scene.scene import Scene
from nassim.scene.terms import AppliedForce, CoilForce, ForceLaw

LEAST_ARM = 1e-3
"""Lever arm over the size of both bodies below which it counts as a tolerance of the parts."""


def lever_arm(scene: Scene, part: Part) -> tuple[Array, tuple[str, ...]]:
    """Find the moment that a part leaves on two moving bodies together, per unit of its force.

    Args:
        scene: the scene.
        part: a part of it.

    Returns:
        The moment, (3,) [m], whose size is the distance of the two forces, and the points on which they act; 0 and no
        points below `LEAST_ARM` of the bodies' size.
    """
    found, points = np.zeros(3), tuple[str, ...]()
    for term in part.terms(scene):
        if not isinstance(term, (ForceLaw, AppliedForce, CoilForce)) or not isinstance(term.measure, PointMeasure):
            continue
        bodies = [scene.body(name) for name in term.measure.bodies]
        if not all(body.moves for body in bodies):
            continue
        places = [scene.point_position(path) for path in term.measure.points]
        rows = term.measure.at([(place, np.eye(3)) for place in places], places)[1].reshape(-1, len(places), 6)
        loaded = {body_of(path) for k, path in enumerate(term.measure.points) if rows[:, k].any()}
        if len(loaded) < 2:  # another point only carries axes
            continue
        moments = (np.cross(places, rows[:, :, :3]) + rows[:, :, 3:]).sum(axis=1)
        moments *= np.linalg.norm(rows[:, :, :3].sum(axis=1), axis=1, keepdims=True) < LEAST_ARM
        size = np.linalg.norm(np.ptp([*places, *(body.position for body in bodies)], axis=0))
        largest = max(moments, key=np.linalg.norm)
        if np.linalg.norm(largest) > LEAST_ARM * size:
            found, points = largest, term.measure.points
    return found, points


def describe_arm(scene: Scene, part: Part) -> str:
    """Describe the moment of a part where it has one, else return an empty text."""
    arm = float(np.linalg.norm(lever_arm(scene, part)[0]))
    return f"; forces {1e3 * arm:.3g} mm apart across it: {arm:.3g} N m per N on both bodies" if arm else ""
