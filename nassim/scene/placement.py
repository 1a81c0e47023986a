"""Scenes within scenes: a named copy of a scene, translated and rotated, and several scenes joined into one.

The annotated types of fields (`nassim.scene.field_kinds`) decide what is renamed and what is rotated, so a new kind of
part is placed without further code.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from nassim.base.checks import Array, finite_array, instances, unique
from nassim.base.field_types import ArrayLike, Field
from nassim.base.rigid_motion import proper_rotation, rotated_motion, unit_vector
from nassim.scene.bodies import Body
from nassim.scene.field_kinds import FieldKind, Path
from nassim.scene.loop import Loop
from nassim.scene.measures import Measure
from nassim.scene.part import Actuator, Connection, ForceElement, Sensor
from nassim.scene.rotation_measures import RelativePose
from nassim.scene.scene import KINDS, Scene
from nassim.scene.terms import Constraint, NonlinearSpring, Spring, Term

PLACED_TOLERANCE = 1e-9
"""Share of a part's largest value by which two ways to rotate it may differ."""

PROBE = 1e-3
"""Size of values and rates at which two nonlinear force laws are compared [m], [rad], [m/s], [rad/s]."""


def placed(scene: Scene, name: str, *, position: ArrayLike = (0, 0, 0), rotation: ArrayLike | None = None) -> Scene:
    """Copy a scene, translate and rotate it as a whole, and name all of it "name/...", such as "strut_1/apa.top".

    Directions and axes of parts rotate with the scene; reduced bodies are shared with the original. Gravity belongs to
    the world: it does not rotate with the scene.

    Args:
        scene: the scene.
        name: name of the copy. It and a "/" precede the names of bodies, parts, loops, inputs and outputs.
        position: new position of the scene's origin, (3,) [m].
        rotation: rotation about the scene's origin, (3, 3); default: none.

    Returns:
        The copy.

    Raises:
        ValueError: for names that are empty or hold a dot, for a matrix that is no rotation, and for a part whose terms
            in the new place differ from its renamed and rotated terms: then a field of its class lacks its annotation
            (`Path`, `Signal`, `Direction`, `Axes` or `Position` of `nassim.scene`).
    """
    unique("placed scene", (name,))
    if "." in name:
        raise ValueError(f"scene {name!r}: no dot in its name, because points are written 'body.point'")
    turn = np.eye(3) if rotation is None else proper_rotation(f"scene {name!r}: rotation", rotation)
    # Orthogonal to rounding, so that the rotated axes of parts stay within their tolerance.
    turn = turn @ (1.5 * np.eye(3) - 0.5 * turn.T @ turn)
    place = _Place(name, finite_array(f"scene {name!r}: position", position, (3,)), turn)
    there: dict[str, Any] = {kind: tuple(map(place.moved, getattr(scene, kind))) for kind in KINDS}
    try:
        result = replace(scene, name=name, **there)
    except ValueError as error:
        raise ValueError(f"scene {scene.name!r} cannot be placed: {error}; {_ANNOTATE}") from error
    for part, copy in zip(scene.parts, result.parts, strict=True):
        if not _alike(tuple(map(place.moved, part.terms(scene))), copy.terms(result)):
            raise ValueError(
                f"{type(part).__name__} {part.name!r} cannot be placed: its terms in the new place are not its old "
                f"terms, renamed and rotated; {_ANNOTATE}"
            )
    return result


_ANNOTATE = (
    "in a class of your own, fields that name points, inputs and outputs, or that hold directions, axes and places of "
    "the world need their annotation: Path, Signal, Direction, Axes, Position of nassim.scene"
)


def joined(
    name: str,
    *scenes: Scene,
    bodies: Sequence[Body] = (),
    joints: Sequence[Connection] = (),
    actuators: Sequence[Actuator] = (),
    sensors: Sequence[Sensor] = (),
    springs: Sequence[ForceElement] = (),
    loops: Sequence[Loop] = (),
    damping_ratio: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    cutoff_frequency: float | None = None,
    quasi_static_above: float | None = None,
) -> Scene:
    """Join several scenes into one, with parts that connect them.

    A ground acceleration in any of the scenes accelerates the ground of all.

    Args:
        name: name of the whole.
        *scenes: the scenes.
        bodies: additional bodies.
        joints: additional joints; they and the following may name the scenes' points and signals.
        actuators: additional actuators.
        sensors: additional sensors.
        springs: additional springs.
        loops: additional loops.
        damping_ratio: as in `Scene`; this and the following where None: the value of the scenes, which must agree.
        gravity: as in `Scene`, (3,) [m/s2].
        cutoff_frequency: as in `Scene` [Hz].
        quasi_static_above: as in `Scene` [Hz].

    Returns:
        The whole.

    Raises:
        ValueError: for names, of inputs too, that two of the scenes share or that are added again, for damping ratios
            by mode, which belong to the modes of one scene, and for values in which the scenes differ.
    """
    if not instances(f"joined scene {name!r}: scenes", scenes, (Scene,)):
        raise ValueError(f"joined scene {name!r} needs at least one scene; make a Scene of bodies and parts")
    added: dict[str, Any] = dict(zip(KINDS, (bodies, joints, actuators, sensors, springs, loops), strict=True))
    added = {kind: instances(f"joined scene {name!r}: {kind}", more, KINDS[kind]) for kind, more in added.items()}
    for kind in KINDS:
        owned = [(scene.name, [part.name for part in getattr(scene, kind)]) for scene in scenes]
        _refuse_shared_names(kind, [*owned, (name, [part.name for part in added[kind]])])
    _refuse_shared_names("inputs", [(scene.name, scene.inputs) for scene in scenes])
    if damping_ratio is None and any(np.size(scene.mode_ratios) > 1 for scene in scenes):
        raise ValueError(f"joined scene {name!r}: ratios by mode are those of a part's modes; give damping_ratio")
    whole: dict[str, Any] = {k: (*(part for scene in scenes for part in getattr(scene, k)), *added[k]) for k in KINDS}
    return Scene(
        name,
        **whole,
        damping_ratio=_agreed(scenes, "damping_ratio", damping_ratio),
        gravity=_agreed(scenes, "gravity", gravity),
        cutoff_frequency=_agreed(scenes, "cutoff_frequency", cutoff_frequency),
        quasi_static_above=_agreed(scenes, "quasi_static_above", quasi_static_above),
    )


def _refuse_shared_names(kind: str, owned: Sequence[tuple[str, Sequence[str]]]) -> None:
    """Refuse names that two scenes share."""
    owners: dict[str, str] = {}
    for owner, names in owned:
        for name in names:
            if name in owners:
                raise ValueError(
                    f"{owners[name]!r} and {owner!r} both have {name!r} among their {kind}: give each a name of its "
                    "own, scenes by placed(scene, name)"
                )
        owners |= dict.fromkeys(names, owner)


def _agreed(scenes: Sequence[Scene], name: str, given: Any) -> Any:
    """Return a given value, or the one that all scenes share."""
    if given is not None:
        return given
    values = [getattr(scene, name) for scene in scenes]
    for scene, value in zip(scenes, values, strict=True):
        if not np.array_equal(value, values[0]):
            raise ValueError(
                f"{name} is {values[0]} in {scenes[0].name!r} and {value} in {scene.name!r}; give the whole's value "
                f"by joined(..., {name}=...)"
            )
    return values[0]


@dataclass(frozen=True)
class _Place:
    """Position and name of a copy of a scene."""

    name: str
    position: Array
    rotation: Array

    def moved(self, item: Any) -> Any:
        """Return a body, part, loop, term or measure, renamed and rotated."""
        kinds = _kinds(item.__class__)
        return replace(item, **{name: self._moved_field(getattr(item, name), kind) for name, kind in kinds.items()})

    def _moved_field(self, value: Any, kind: Any) -> Any:
        if isinstance(value, (Measure, Term)):
            return self.moved(value)
        if value is None:
            return None
        choices = get_args(kind)
        if isinstance(kind, FieldKind):
            return self._moved_value(value, kind.__name__)
        if get_origin(kind) is tuple and isinstance(value, tuple):
            each = choices[:1] * len(value) if choices[-1:] == (...,) else choices
            return tuple(map(self._moved_field, value, each))
        if get_origin(kind) in (Union, UnionType):
            fitting = (c for c in choices if isinstance(c, FieldKind) or get_origin(c) is type(value))
            return self._moved_field(value, next(fitting, None))
        return value

    def _moved_value(self, value: Any, kind: str) -> Any:
        if kind in ("Path", "Signal"):
            return f"{self.name}/{value}" if value else value
        if kind == "Position":
            return self.position + self.rotation @ value
        if np.array_equal(self.rotation, np.eye(3)) or (isinstance(value, str) and value not in ("x", "y", "z")):
            return value
        turned = self.rotation @ (unit_vector(value) if isinstance(value, str) else np.asarray(value))
        return turned if isinstance(value, np.ndarray) else tuple(turned.tolist())


@functools.cache
def _kinds(part: type[Any]) -> dict[str, Any]:
    """Return the types of a class's fields with their annotations; the field `name` is renamed as a path."""
    try:
        hints = get_type_hints(part)
    except NameError as error:
        raise ValueError(
            f"{part.__name__} cannot be placed: the types of its fields cannot be read ({error}); import them for "
            "running, not for type checkers only"
        ) from error
    kinds = {name: kind.held if isinstance(kind, Field) else kind for name, kind in hints.items()}
    return {f.name: Path if f.name == "name" else kinds[f.name] for f in fields(part) if f.init}


def _alike(a: Any, b: Any) -> bool:
    """Whether terms, or their fields, are equal but for rounding."""
    if isinstance(a, (float, np.ndarray)):
        return np.shape(a) == np.shape(b) and np.allclose(b, a, rtol=PLACED_TOLERANCE, atol=PLACED_TOLERANCE * _size(a))
    if type(a) is not type(b):
        return False
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(_alike, a, b))
    if is_dataclass(a):
        return _alike(_comparable(a), _comparable(b))
    return bool(a == b)


def _size(a: float | Array) -> float:
    """Return the largest finite absolute value."""
    return float(np.max(np.abs(a), where=np.isfinite(a), initial=0.0))


def _comparable(term: Any) -> tuple[Any, ...]:
    """Return what must agree in equal terms or measures: their fields, but not the arbitrary axes of a relative pose.

    What is along these axes is written along those of the world.
    """
    if isinstance(term, NonlinearSpring):  # its functions are made anew with each term, and compare by their values
        probes = PROBE * np.random.default_rng(0).standard_normal((4, 2, len(term.measure.components)))
        return (term.measure, *(term.resistance(value, rate) for value, rate in probes))
    pose = getattr(term, "measure", None)
    if isinstance(pose, RelativePose) and isinstance(term, Spring):
        turn = rotated_motion(pose.axes)
        matrices = [turn @ matrix @ turn.T for matrix in term.matrices]
        return (pose.points, pose.rotation, *(block for matrix in matrices for block in _blocks(matrix)))
    if isinstance(pose, RelativePose) and isinstance(term, Constraint):
        held = rotated_motion(pose.axes)[:, term.rows(term.held)]
        return (term.name, pose.points, pose.rotation, held @ held.T)
    return tuple(getattr(term, f.name) for f in fields(term))


def _blocks(matrix: Array) -> tuple[Array, ...]:
    """Return the blocks (3, 3) of forces and moments by displacements and rotations, which differ by powers of ten."""
    return tuple(matrix[a : a + 3, b : b + 3] for a in (0, 3) for b in (0, 3))
