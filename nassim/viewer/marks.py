"""Marks of parts without a surface: joints, springs, actuators and sensors, at the places of their measures."""

from collections.abc import Iterable

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import DIRECTIONS
from nassim.bodies.remote_points import RemotePoint
from nassim.scene.bodies import FlexibleBody
from nassim.scene.field_kinds import body_of
from nassim.scene.measures import BodyCoordinates, Combination, DirectionalMeasure, Measure
from nassim.scene.part import Part
from nassim.scene.rotation_measures import RelativePose, RotationAngle, RotationDeviation
from nassim.scene.scene import Scene
from nassim.scene.terms import (
    AppliedForce,
    BaseAcceleration,
    CoilForce,
    Constraint,
    ForceLaw,
    Output,
    Shunt,
    SpringForce,
    Term,
)
from nassim.viewer.forms import CENTRE
from nassim.viewer.view_content import Mark


def point_mark(point: RemotePoint, shape: str) -> Mark:
    """Return the mark of a remote point.

    Args:
        point: the remote point.
        shape: name of the shape of its body.
    """
    x, y, z = 1e3 * point.position
    return Mark(
        point.name, "remote point", ((shape, point.name),), text=f"{point.coupling} at {x:.4g}, {y:.4g}, {z:.4g} mm"
    )


def scene_marks(scene: Scene) -> tuple[Mark, ...]:
    """Return the marks of all parts of a scene that have a place; the shapes have the names of the bodies.

    Args:
        scene: the scene.
    """
    kinds = {"joint": scene.joints, "spring": scene.springs, "actuator": scene.actuators, "sensor": scene.sensors}
    return tuple(mark for kind, parts in kinds.items() for part in parts for mark in _part_marks(scene, kind, part))


def _part_marks(scene: Scene, kind: str, part: Part) -> Iterable[Mark]:
    """Yield the marks of a part; terms on the same points share one mark."""
    axes: dict[tuple[tuple[str, ...], str], list[Array]] = {}
    for term in part.terms(scene):
        for paths, frame, direction in _places(scene, term):
            axes.setdefault((paths, frame), []).extend(direction)
    text = part.describe() or f"{kind} {part.name}" + "".join(f" [{unit}]" for unit in _units(part, scene))
    for (paths, frame), directions in axes.items():
        ends = tuple(_end(scene, path) for path in paths)
        shown = np.array(directions).reshape(-1, 3)
        if frame and "." not in frame:
            shown = shown @ scene.body(frame).rotation.T
        shown = np.unique(np.round(shown, 12), axis=0) if len(shown) else shown
        yield Mark(part.name, kind, ends, shown, body_of(frame), text)


Place = tuple[tuple[str, ...], str, list[Array]]
"""Points, frame of the directions, and directions of a term or measure."""


def _places(scene: Scene, term: Term) -> Iterable[Place]:
    """Yield the places of a term."""
    if isinstance(term, SpringForce):
        yield from _places(scene, term.spring)
    elif isinstance(term, Constraint) and isinstance(term.measure, RelativePose):
        free = [d for d in DIRECTIONS if d not in term.held]
        axes, a = term.measure.axes, term.measure.a
        yield (a,), a, [axes[:, "xyz".index(d[-1])] for d in free]
    elif isinstance(term, (Constraint, ForceLaw, AppliedForce, CoilForce, Output, Shunt)):
        yield from _measured(scene, term.measure)


def _measured(scene: Scene, measure: Measure) -> Iterable[Place]:
    """Yield the places of a measure."""
    if isinstance(measure, Combination):
        for _, part in measure.parts:
            yield from _measured(scene, part)
    elif isinstance(measure, DirectionalMeasure):
        direction = np.asarray(measure.weights[-1][1])
        length = np.linalg.norm(direction)
        paths = tuple(path for path, _ in measure.weights[-2:])
        yield paths, measure.axes_of, [direction / length] if length else []
    elif isinstance(measure, RotationAngle):
        yield (*filter(None, (measure.a,)), measure.b), measure.a, [measure.axis / np.linalg.norm(measure.axis)]
    elif isinstance(measure, RotationDeviation):
        yield (measure.a, measure.b), measure.a, [measure.direction / np.linalg.norm(measure.direction)]
    elif isinstance(measure, BodyCoordinates) and not measure.ends:
        yield (_own_place(scene, measure.body, np.asarray(measure.weights)),), "", []
    elif isinstance(measure, BodyCoordinates):
        yield measure.ends, measure.body, [_line(scene, measure)]
    else:
        yield measure.points[:2], "", []


def _line(scene: Scene, measure: BodyCoordinates) -> Array:
    """Return the direction from one end to the other, along the axes of the body."""
    a, b = map(scene.point_position, measure.ends[:2])
    return scene.body(measure.body).rotation.T @ (b - a) / np.linalg.norm(b - a)


def _own_place(scene: Scene, name: str, weights: Array) -> str:
    """Return the point of an electrical port with these weights of the body's coordinates, or the body without one."""
    body = scene.body(name)
    ports = body.reduced.ports if isinstance(body, FlexibleBody) else ()
    known = [port.name for port in ports if port.place is not None and np.array_equal(port.forces, weights)]
    return f"{name}.{known[0]}" if known else name


def _end(scene: Scene, path: str) -> tuple[str, str]:
    """Return a shape and its point; without a point the centre of the body."""
    if "." not in path:
        return path, CENTRE
    body, point = scene.split(path)
    return body.name, point


def _units(part: Part, scene: Scene) -> list[str]:
    kinds = (AppliedForce, CoilForce, Output, SpringForce, BaseAcceleration)
    return list(dict.fromkeys(term.unit for term in part.terms(scene) if isinstance(term, kinds)))
