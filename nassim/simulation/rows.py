"""Rows, which parts speak in, as weights on the coordinates of a scene's bodies."""

import numpy as np

from nassim.base.checks import Array
from nassim.scene.bodies import Body
from nassim.scene.part import Row
from nassim.scene.scene import Scene


def shares(scene: Scene, row: Row) -> dict[str, Array]:
    """What each moving body's coordinates count in a row, (n,) by the body's name, in small motion.

    Raises ValueError for unknown bodies and points, and for a frame that is not the body of all the row's points.
    """
    result: dict[str, Array] = {}

    def add(body: Body, weights: Array) -> None:
        result[body.name] = result.get(body.name, np.zeros(len(weights))) + weights

    for path, weights in row.points:
        body, point = scene.split(path)
        if row.frame and row.frame != body.name:
            raise ValueError(f"a row along the axes of {row.frame!r} can count no point of another body, as {path!r}")
        if body.moves:
            add(body, weights @ (body.own_motion(point) if row.frame else body.motion(point)))
    for name, weights in row.own:
        add(scene.split(f"{name}.")[0], weights)
    return result
