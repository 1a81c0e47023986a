"""Rows, which parts speak in, as weights on the coordinates of a scene's bodies, in small motion."""

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import unit_vector
from nassim.scene.part import Line, Row, SixSprings
from nassim.scene.scene import Scene


def shares(scene: Scene, row: Row | Line, *, derivative: int = 0) -> dict[str, Array]:
    """What each moving body's coordinates count in a row, (n,) by the body's name.

    derivative: 0 for displacements; in velocities and accelerations, which are against inertial space, the turn of the
        row's frame does not count

    Raises ValueError for unknown bodies and points, for a body's own frame with another body's points, and for a line
    between two points in one place.
    """
    if isinstance(row, Line):
        row = Row.between(row.a, row.b, line_direction(scene, row))
    result: dict[str, Array] = {}

    def add(name: str, weights: Array) -> None:
        result[name] = result.get(name, np.zeros(len(weights))) + weights

    for path, weights in row.points:
        body, point = scene.split(path)
        if row.frame and "." not in row.frame and row.frame != body.name:
            raise ValueError(f"a row along the axes of {row.frame!r} can count no point of another body, as {path!r}")
        if body.moves:
            add(body.name, weights @ (body.own_motion(point) if row.within else body.motion(point)))
    if "." in row.frame and not derivative:
        body, point = scene.split(row.frame)
        turn = np.sum([np.cross(scene.point_position(path), weights[:3]) for path, weights in row.points], axis=0)
        if body.moves:
            add(body.name, -turn @ body.motion(point)[3:])
    for name, weights in row.own:
        add(name, weights)
    return result


def line_direction(scene: Scene, line: Line) -> Array:
    """From point a to b at the start, world frame, unit vector (3,)."""
    along = scene.point_position(line.b) - scene.point_position(line.a)
    if not np.any(along):
        raise ValueError(f"{line.a!r} and {line.b!r} lie in one place: no line joins them")
    return unit_vector(along)


def bushing_rows(word: SixSprings) -> list[Row]:
    """The six motions of a bushing, in its order."""
    kinds = (False, True)
    return [Row.between(word.a, word.b, axis, frame=word.a, turns=turns) for turns in kinds for axis in word.axes.T]
