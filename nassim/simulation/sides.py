"""On which side of a spin each body is, by what ties it to others, and what words count on all coordinates."""

from collections.abc import Iterable, Mapping

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import DIRECTIONS, rigid_motions
from nassim.scene.bodies import FlexibleBody
from nassim.scene.part import (
    Constraint,
    Field,
    Filter,
    Follow,
    Force,
    Leak,
    Reading,
    Row,
    SixSprings,
    Spring,
    Tension,
    Word,
)
from nassim.scene.scene import Scene
from nassim.simulation.rows import bushing_rows, shares
from nassim.simulation.small_motion import Assembly

Tie = Constraint | Spring | SixSprings
"""What holds or resists."""
BORNE = 1e-9
"""Share of a row's size that a turn about the axis may count in it."""


def word_rows(assembly: Assembly, scene: Scene, word: Word) -> Array:
    """What a word counts on all coordinates of an assembly whose bodies stand as in a scene, (m, n_all)."""
    if isinstance(word, (Follow, Filter)):
        return np.zeros((0, len(assembly.basis)))
    if isinstance(word, Tension):
        return word_rows(assembly, scene, word.spring)
    if isinstance(word, Field):
        weights = {name: scene.split(f"{name}.")[0].weight(word.direction) for name in assembly.slices}
        return _gathered(assembly, weights)[None]
    if isinstance(word, Constraint):
        apart = _motion(assembly, scene, word.b) - _motion(assembly, scene, word.a)
        return (np.kron(np.eye(2), word.axes.T) @ apart)[[list(DIRECTIONS).index(d) for d in word.held]]
    if isinstance(word, SixSprings):
        return np.array([_gathered(assembly, shares(scene, row)) for row in bushing_rows(word)])
    derivative = word.derivative if isinstance(word, Reading) else int(isinstance(word, Force))
    return _gathered(assembly, shares(scene, word.row, derivative=derivative))[None]


def turn_about(assembly: Assembly, names: Iterable[str], axis: Array, point: Array) -> Array:
    """Coordinates of a unit turn of some bodies about the axis, all others at rest, (n_all,)."""
    unit, scene = axis / np.linalg.norm(axis), assembly.scene
    result = np.zeros(len(assembly.basis))
    for name in names:
        body, _ = scene.split(f"{name}.")
        twist = np.concatenate([np.cross(unit, body.position - point), unit])
        if isinstance(body, FlexibleBody):
            places = np.array([p.position for p in body.reduced.remote_points])
            twist = rigid_motions(places, len(body.mass_matrix)) @ np.kron(np.eye(2), body.rotation.T) @ twist
        result[assembly.slices[name]] = twist
    return result


def standing_bodies(assembly: Assembly, joint: Constraint, axis: Array) -> frozenset[str]:
    """Names of the bodies that stand while a joint is driven about its axis, (3,).

    Bodies stand, or turn, with those that they are tied to by what resists a turn about the axis; what is tied to one
    side only, otherwise, goes with that. Raises ValueError for a body of which that does not say where it belongs.
    """
    scene, point = assembly.scene, assembly.scene.point_position(joint.a)
    groups = {body.name: body.name if body.moves else "" for body in scene.bodies}
    loose: list[set[str]] = []
    for word in assembly.words:
        if isinstance(word, Tie):
            names = [name for name in dict.fromkeys(map(body_of, ends_of(word))) if name in assembly.slices]
            ends = dict.fromkeys(map(body_of, ends_of(word)))
            if any(bears(assembly, word, turn_about(assembly, [name], axis, point)) for name in names):
                first, *others = (groups[name] for name in ends)
                groups = {name: first if group in others else group for name, group in groups.items()}
            else:
                loose.append(set(ends))
    ground = next((groups[body.name] for body in scene.bodies if not body.moves), "")
    driven = [groups[body_of(path)] for path in (joint.a, joint.b)]
    if driven.count(ground) != 1:
        raise ValueError(
            f"joint {joint.name!r}: a drive of constant speed needs a fixed body on one side, or one that is tied to "
            "such a body by what resists the turn; and no such tie on the other side. Or say which bodies stand: "
            "linearize(..., standing=[...])"
        )
    turning = driven[1 - driven.index(ground)]
    sides = {group: group for group in groups.values()}
    while True:
        found = dict(sides)
        for group in set(sides.values()) - {ground, turning}:
            members = {name for name in groups if sides[groups[name]] == group}
            met = {sides[groups[name]] for ends in loose if ends & members for name in ends} - {group}
            if {ground, turning} <= met:
                raise ValueError(
                    f"body {min(members)!r} is tied to what turns and to what stands, so it is not known whether it "
                    "turns: say which bodies stand, fixed ones too: linearize(..., standing=[...])"
                )
            if met:
                to = met.pop()
                found = {key: to if side == group else side for key, side in sides.items()}
                break
        if found == sides:
            return frozenset(name for name in groups if sides[groups[name]] != turning)
        sides = found


def bears(assembly: Assembly, word: Tie, turn: Array) -> bool:
    """Whether a tie that holds, or resists, meets coordinates (n_all,) of a turn; a drive bears what its joint does."""
    if isinstance(word, Spring) and isinstance(word.row, Row) and _has_drive(assembly, word.row):
        return False
    rows = word_rows(assembly, assembly.scene, word)
    if isinstance(word, SixSprings):
        both = np.vstack([word.stiffness, word.damping])
        rows = both / np.maximum(np.abs(both).max(axis=1, keepdims=True), 1e-300) @ rows
    met = np.abs(rows @ turn)
    # What lies on the axis moves by rounding alone, hence the millimetre beside.
    return bool(np.any(met > BORNE * (np.abs(rows) @ (np.abs(turn) + 1e-3))))


def named(word: Word) -> str:
    """A word, for messages."""
    if isinstance(word, Constraint):
        return f"joint {word.name!r}"
    if isinstance(word, (Field, Force)):
        return f"input {word.input!r}"
    if isinstance(word, (Reading, Tension, Leak)):
        return f"output {word.output!r}"
    return f"what ties {' and '.join(dict.fromkeys(ends_of(word)))}"


def ends_of(word: Word) -> tuple[str, ...]:
    """Points that a word ties; none for other words."""
    if isinstance(word, (Constraint, SixSprings)):
        return (word.a, word.b)
    return word.row.paths if isinstance(word, Spring) else ()


def body_of(path: str) -> str:
    """Name of the body in a path."""
    return path.partition(".")[0]


def _gathered(assembly: Assembly, parts: Mapping[str, Array]) -> Array:
    """Rows of bodies on all coordinates, (n_all,)."""
    result = np.zeros(len(assembly.basis))
    for name, part in parts.items():
        result[assembly.slices[name]] = part
    return result


def _motion(assembly: Assembly, scene: Scene, path: str) -> Array:
    """Small motion of a point along the frame's axes, (6, n_all)."""
    body, point = scene.split(path)
    result = np.zeros((6, len(assembly.basis)))
    if body.moves:
        result[:, assembly.slices[body.name]] = body.motion(point)
    return result


def _has_drive(assembly: Assembly, row: Row) -> bool:
    """Whether a row is a motion between a joint's points that the joint or its drive holds."""
    for joint in assembly.words:
        if isinstance(joint, Constraint) and {joint.a, joint.b} == set(row.paths):
            driven = [w.direction for w in assembly.words if isinstance(w, Follow) and w.constraint == joint.name]
            held = np.kron(np.eye(2), joint.axes)[:, [list(DIRECTIONS).index(d) for d in (*joint.held, *driven)]]
            if all(np.allclose(held @ (held.T @ weights), weights, atol=BORNE) for _, weights in row.points):
                return True
    return False
