"""Axes and points of parts: their checks, the measures between them, and their description.

A direction is "x", "y", "z" or a vector along the world's axes, which do not rotate. With `frame` "body.point" it is
along axes that are the world's at the start and rotate with the body at that point. Between two points, "line" is the
present direction of the line through them.
"""

import numpy as np

from nassim.base.checks import finite_array, known
from nassim.base.field_types import ArrayLike
from nassim.base.rigid_motion import direction_text, unit_vector
from nassim.scene.measures import Displacement, Distance, Measure, PointVelocity
from nassim.scene.scene import Scene

LINE = "line"


def checked_axis(label: str, axis: str | ArrayLike, *, line: bool = False) -> str | tuple[float, ...]:
    """Check an axis and return it as a part keeps it.

    Args:
        label: name of the part, for messages.
        axis: "x", "y", "z", or a vector (3,).
        line: whether "line" is allowed.

    Returns:
        The name, or the vector as a tuple.

    Raises:
        ValueError: for an unknown name, another shape, or a vector of no length.
    """
    if isinstance(axis, str):
        return known("axis", axis, ("x", "y", "z", LINE) if line else ("x", "y", "z"))
    vector = finite_array(f"{label}: axis", axis, (3,))
    if not np.any(vector):
        raise ValueError(f"{label}: an axis must have a length, got (0, 0, 0)")
    return tuple(vector.tolist())


def axis_text(axis: str | ArrayLike, frame: str) -> str:
    """Return an axis as text for reports."""
    text = ("their line" if axis == LINE else axis) if isinstance(axis, str) else direction_text(axis)
    return f"{text} of {frame}" if frame else text


def check_two_points(label: str, a: str, b: str) -> None:
    """Refuse a part that connects a point with itself."""
    if a == b:
        raise ValueError(f"{label} connects {a!r} with itself")


def check_moves(scene: Scene, part: str, path: str) -> None:
    """Check that a point exists and belongs to a body that can move.

    Raises:
        ValueError: for an unknown point, and for a point of a fixed body.
    """
    scene.point_position(path)
    if not scene.split(path)[0].moves:
        raise ValueError(f"{part!r}: {path!r} belongs to a fixed body, which no force moves")


def check_any_moves(scene: Scene, part: str, *paths: str) -> None:
    """Check that points exist and that at least one belongs to a body that can move.

    Raises:
        ValueError: for unknown points, and where all belong to fixed bodies.
    """
    for path in paths:
        scene.point_position(path)
    if not any(scene.split(path)[0].moves for path in paths):
        raise ValueError(f"{part!r}: {' and '.join(map(repr, paths))} belong to fixed bodies, so it would read nothing")


def check_apart(scene: Scene, label: str, a: str, b: str) -> None:
    """Refuse points of one rigid body and points of fixed bodies."""
    for path in (a, b):
        scene.point_position(path)
    first, second = scene.split(a)[0], scene.split(b)[0]
    if first is second and not first.deforms:
        raise ValueError(f"{label}: {a!r} and {b!r} belong to one rigid body")
    if not (first.moves or second.moves):
        raise ValueError(f"{label}: {a!r} and {b!r} belong to fixed bodies")


def checked_frame(scene: Scene, frame: str) -> str:
    """Check that the point of a frame exists and return its path; "" is the world.

    Raises:
        ValueError: for an unknown point.
    """
    if frame:
        scene.point_position(frame)
    return frame


def between(scene: Scene, a: str, b: str, axis: str | ArrayLike, frame: str) -> Measure:
    """Return the measure of the motion of b against a along an axis."""
    if isinstance(axis, str) and axis == LINE:
        if np.allclose(scene.point_position(a), scene.point_position(b), rtol=0, atol=1e-12):
            raise ValueError(f"{a!r} and {b!r} lie in one place: no line joins them; give a direction")
        return Distance(a, b)
    return Displacement.between(a, b, unit_vector(axis), axes_of=checked_frame(scene, frame))


def at_point(scene: Scene, point: str, axis: str | ArrayLike, frame: str, *, angular: bool = False) -> PointVelocity:
    """Return the measure of the velocity of a point along an axis, or of its angular velocity about the axis."""
    return PointVelocity(((point, unit_vector(axis)),), checked_frame(scene, frame), angular)
