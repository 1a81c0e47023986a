"""Marks of what has no surface: joints, springs, actuators and sensors, placed by what they say, whatever they are."""

from collections.abc import Iterable

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import DIRECTIONS
from nassim.bodies.interface import RemotePoint
from nassim.scene.bodies import FlexibleBody
from nassim.scene.part import (
    Constraint,
    Field,
    Force,
    Leak,
    Line,
    Part,
    Reading,
    Row,
    SixSprings,
    Spring,
    Tension,
    Word,
)
from nassim.scene.scene import Scene
from nassim.viewer.forms import CENTRE
from nassim.viewer.views import Mark


def point_mark(point: RemotePoint, shape: str) -> Mark:
    """A remote point of a body that is shown as a shape."""
    x, y, z = 1e3 * point.position
    return Mark(
        point.name, "remote point", ((shape, point.name),), text=f"{point.coupling} at {x:.4g}, {y:.4g}, {z:.4g} mm"
    )


def scene_marks(scene: Scene) -> tuple[Mark, ...]:
    """All parts of a scene that have a place; its bodies are shapes of their names."""
    kinds = {"joint": scene.joints, "spring": scene.springs, "actuator": scene.actuators, "sensor": scene.sensors}
    return tuple(mark for kind, parts in kinds.items() for part in parts for mark in _part_marks(scene, kind, part))


def _part_marks(scene: Scene, kind: str, part: Part) -> Iterable[Mark]:
    """A part's marks: what it says of the same points is one."""
    axes: dict[tuple[tuple[str, ...], str], list[Array]] = {}
    for word in part.says(scene):
        for paths, frame, direction in _places(scene, word):
            axes.setdefault((paths, frame), []).extend(direction)
    text = part.describe() or f"{kind} {part.name}" + "".join(f" [{unit}]" for unit in _units(part, scene))
    for (paths, frame), directions in axes.items():
        ends = tuple(_end(scene, path) for path in paths)
        shown = np.array(directions).reshape(-1, 3)
        if frame and "." not in frame:
            shown = shown @ _rotation(scene, frame).T
        shown = np.unique(np.round(shown, 12), axis=0) if len(shown) else shown
        yield Mark(part.name, kind, ends, shown, frame.partition(".")[0], text)


def _places(scene: Scene, word: Word) -> Iterable[tuple[tuple[str, ...], str, list[Array]]]:
    """Points that a word is about, the frame of its directions, and these."""
    if isinstance(word, Constraint):
        free = [d for d in DIRECTIONS if d not in word.held]
        yield (word.a,), word.a, [word.axes[:, "xyz".index(d[-1])] for d in free]
    elif isinstance(word, SixSprings):
        yield (word.a, word.b), "", []
    elif isinstance(word, Tension):
        yield from _places(scene, word.spring)
    elif isinstance(word, (Force, Reading, Spring, Leak)):
        row = word.row
        if isinstance(row, Line):
            yield (row.a, row.b), "", []
        elif row.points:
            yield _row_place(row)
        else:
            yield from (((_own_place(scene, *own),), "", []) for own in row.own)
    elif isinstance(word, Field):
        return


def _row_place(row: Row) -> tuple[tuple[str, ...], str, list[Array]]:
    weights = row.points[-1][1]
    direction = weights[:3] if np.any(weights[:3]) else weights[3:]
    length = np.linalg.norm(direction)
    return tuple(path for path, _ in row.points[-2:]), row.frame, [direction / length] if length else []


def _own_place(scene: Scene, name: str, weights: Array) -> str:
    """An electrical port whose charge a body's own coordinates bring by these weights, where its place is known."""
    body = scene.split(f"{name}.")[0]
    ports = body.reduced.ports if isinstance(body, FlexibleBody) else ()
    known = [port.name for port in ports if port.place is not None and np.array_equal(port.forces, weights)]
    return f"{name}.{known[0]}" if known else name


def _end(scene: Scene, path: str) -> tuple[str, str]:
    """Shape and its point; of what has no point the body's middle."""
    if "." not in path:
        return path, CENTRE
    body, point = scene.split(path)
    return body.name, point


def _rotation(scene: Scene, name: str) -> Array:
    return next(body.rotation for body in scene.bodies if body.name == name)


def _units(part: Part, scene: Scene) -> list[str]:
    said = [w.unit for w in part.says(scene) if isinstance(w, (Force, Reading, Tension, Field))]
    return list(dict.fromkeys(said))
