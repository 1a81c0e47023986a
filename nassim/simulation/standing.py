"""Scenes of which a part spins and a part stands: who does what, and what that adds to the equations of small motion.

One frame describes all: that of what turns, or that of what stands. A body that is at home in the other is its guest,
and must be rigid: with V the angular velocity at which the frame sees its guests turn, R(t) that turn, u a guest's
small motion as seen at its home and v = R u as the frame sees it, M its mass, G and K of its own spin,

    M v'' + (G - 2 M V~) v' + (K - G V~ + M V~ V~) v = f

and a damper, whose row w may turn as the frame sees it, resists w v' + w' v: its forces turn motions, as those of
bearings that stand do in the frame of a rotor, and can drive them.

The model does not change in time where the frame sees the same whatever the angle: guests have equal moments of inertia
across the axis, and what ties them to each other, to the ground and to the others is the same in all directions across
it, as three equal bushings around the axis are. Odd angles are tried; signals must read and push the same, too.
What the forces of an unbalance stiffen is taken as it is at the start.

Source: G. Genta, Dynamics of Rotating Systems, Springer (2005), ch. 6, on rotors and stators without symmetry.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.base.rigid_motion import DIRECTIONS, rigid_motions, skew
from nassim.scene.bodies import Body, FlexibleBody
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
FRAMES = ("turning", "standing")
ANGLES = (1.0, 2.3)
"""At which everything must look as it does at the start [rad]."""
SAME = 1e-7
"""Share of itself by which it may differ."""
BORNE = 1e-9
"""Share of a row's size that a turn about the axis may count in it."""
OTHERWISE = {
    "turning": "make what stands alike in all directions across the axis, or, if what turns is rigid and alike all "
    'around, take frame="standing"; or simulate in time',
    "standing": "make what turns alike in all directions across the axis, or, if what stands is rigid and alike all "
    'around, take frame="turning"; or simulate in time',
}


@dataclass(frozen=True)
class Parted:
    """What stands while the rest of a scene turns, and who describes it.

    velocity: of what turns, (3,) [rad/s], not zero; point: of its axis, (3,) [m]
    standing: names of the bodies that stand; frame: "turning" or "standing"
    """

    velocity: Array
    point: Array
    standing: frozenset[str]
    frame: str = "turning"

    def spin(self, name: str) -> Array:
        """Angular velocity of a body, (3,)."""
        return np.zeros(3) if name in self.standing else self.velocity

    def is_guest(self, name: str) -> bool:
        """Whether a body, or "", the world with its axes, is at home in the other frame."""
        return (not name or name in self.standing) == (self.frame == "turning")

    @property
    def drift(self) -> Array:
        """Angular velocity V at which the frame sees its guests turn, (3,)."""
        return -self.velocity if self.frame == "turning" else self.velocity

    def turn(self, angle: float) -> Array:
        """Of the guests as the frame sees them, (3, 3)."""
        rotation: Array = Rotation.from_rotvec(angle * self.drift / np.linalg.norm(self.drift)).as_matrix()
        return rotation

    def carried(self, body: Body, angle: float) -> Body:
        """A body as the frame sees it once its guests have turned by an angle [rad]."""
        if not self.is_guest(body.name):
            return body
        turn = self.turn(angle)
        return replace(body, position=self.point + turn @ (body.position - self.point), rotation=turn @ body.rotation)

    def said(self, word: Word, angle: float) -> Word:
        """What a part says, along axes as the frame sees them: the world's stand, a bushing's turn halfway."""
        turn = self.turn(angle) if self.is_guest("") else np.eye(3)
        if isinstance(word, Field):
            return replace(word, direction=turn @ word.direction)
        if isinstance(word, Constraint):
            return replace(word, axes=self.turn(angle * self.is_guest(_body(word.a))) @ word.axes)
        if isinstance(word, SixSprings):
            guests = [self.is_guest(_body(path)) for path in (word.a, word.b)]
            return replace(word, axes=self.turn(angle * sum(guests) / 2) @ word.axes)
        if isinstance(word, Tension):
            spring = self.said(word.spring, angle)
            return replace(word, spring=spring) if isinstance(spring, (Spring, SixSprings)) else word
        if isinstance(word, (Follow, Filter)) or not isinstance(word.row, Row) or word.row.within:
            return word
        both = np.kron(np.eye(2), self.turn(angle * self.is_guest(_body(word.row.frame))))
        points = tuple((path, both @ weights) for path, weights in word.row.points)
        return replace(word, row=replace(word.row, points=points))


@dataclass(frozen=True)
class View:
    """An assembled scene as its describing frame sees it, guests turned by any angle [rad]."""

    assembly: Assembly
    parted: Parted
    scenes: dict[float, Scene] = field(default_factory=dict)

    def scene(self, angle: float) -> Scene:
        """The bodies alone."""
        if angle not in self.scenes:
            bodies = tuple(self.parted.carried(body, angle) for body in self.assembly.scene.bodies)
            self.scenes[angle] = Scene(self.assembly.scene.name, bodies)
        return self.scenes[angle]

    def rows(self, word: Word, angle: float) -> Array:
        """What a word counts, on all coordinates, (m, n_all)."""
        return word_rows(self.assembly, self.scene(angle), self.parted.said(word, angle))

    def slopes(self, word: Word, angle: float) -> Array:
        """Their change per radian: exact, as they are polynomials of second degree in sine and cosine."""
        whole, half = (
            0.5 * (self.rows(word, angle + step) - self.rows(word, angle - step)) for step in (np.pi / 2, np.pi / 4)
        )
        return whole + 2 * (half - np.sqrt(0.5) * whole)

    def laws(self, word: Spring | SixSprings, angle: float) -> tuple[Array, Array, Array]:
        """Stiffness, damping, and what damping drives as its rows turn, on all coordinates, (n_all, n_all) each."""
        stiffness, damping = np.atleast_2d(word.stiffness), np.atleast_2d(word.damping)
        rows, rate = self.rows(word, angle), float(np.linalg.norm(self.parted.drift))
        turned = rate * rows.T @ damping @ self.slopes(word, angle) if damping.any() else np.zeros((len(rows.T),) * 2)
        return rows.T @ stiffness @ rows, rows.T @ damping @ rows, turned

    @cached_property
    def scale(self) -> Array:
        """Of all coordinates to comparable roots of energy, (n_all,)."""
        masses = [np.diag(self.scene(0.0).split(f"{name}.")[0].mass_matrix) for name in self.assembly.slices]
        result: Array = 1 / np.sqrt(np.concatenate(masses))
        return result


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


def guest_terms(view: View, name: str, coriolis: Array, stiffness: Array) -> tuple[Array, Array]:
    """Coriolis matrix and stiffness of a guest, as the frame sees it, from those at its home, (6, 6) each."""
    mass, drift = view.scene(0.0).split(f"{name}.")[0].mass_matrix, np.kron(np.eye(2), skew(view.parted.drift))
    return coriolis - 2 * mass @ drift, stiffness - coriolis @ drift + mass @ drift @ drift


def turned_damping(view: View) -> Array:
    """What dampers drive as their rows turn, on all coordinates, (n_all, n_all), not symmetric."""
    result = np.zeros((len(view.scale),) * 2)
    for word in view.assembly.words:
        if isinstance(word, (Spring, SixSprings)):
            result += view.laws(word, 0.0)[2]
    return result


def check_constant(view: View) -> None:
    """Raise ValueError for what makes a linear model change while a part of the scene turns; the message names it."""
    assembly, parted = view.assembly, view.parted
    for name in filter(parted.is_guest, assembly.slices):
        _check_guest(view, name)
    turn = turn_about(assembly, assembly.slices.keys() - parted.standing, parted.velocity, parted.point)
    ties: dict[tuple[str, ...], list[Tie]] = {}
    for word in assembly.words:
        if isinstance(word, Tie):
            if _bears(assembly, word, turn):
                raise ValueError(
                    f"{_named(word)} resists the turn about the axis, of what turns against what stands or against "
                    "the world's axes: free that motion, put its points on the axis, or let its axes turn along"
                )
            moving = {name for name in map(_body, _paths(word)) if name in assembly.slices}
            ties.setdefault(("joint",) * isinstance(word, Constraint) + tuple(sorted(moving)), []).append(word)
        else:
            start = view.rows(word, 0.0) / view.scale
            _check_change(
                parted,
                _named(word),
                max(float(np.linalg.norm(view.rows(word, a) / view.scale - start)) for a in ANGLES),
                float(np.linalg.norm(start)),
            )
    for words in ties.values():
        for start, *others in zip(*(_figures(view, words, angle) for angle in (0.0, *ANGLES)), strict=True):
            change = max(float(np.linalg.norm(other - start)) for other in others)
            _check_change(parted, ", ".join(dict.fromkeys(map(_named, words))), change, float(np.linalg.norm(start)))


def damps_both(view: View) -> bool:
    """Whether a damping of the scene's modes would be one of what stands and of what turns at once."""
    standing = view.parted.standing
    if any(name in standing for name in view.assembly.slices):
        return True
    words = (word for word in view.assembly.words if isinstance(word, (Spring, SixSprings)))
    return any(_body(path) in standing for word in words for path in _paths(word))


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
            names = [name for name in dict.fromkeys(map(_body, _paths(word))) if name in assembly.slices]
            ends = dict.fromkeys(map(_body, _paths(word)))
            if any(_bears(assembly, word, turn_about(assembly, [name], axis, point)) for name in names):
                first, *others = (groups[name] for name in ends)
                groups = {name: first if group in others else group for name, group in groups.items()}
            else:
                loose.append(set(ends))
    ground = next((groups[body.name] for body in scene.bodies if not body.moves), "")
    sides_of_joint = [groups[_body(path)] for path in (joint.a, joint.b)]
    if sides_of_joint.count(ground) != 1:
        raise ValueError(
            f"joint {joint.name!r}: a drive of constant speed needs a fixed body on one side, or one that is tied to "
            "such a body by what resists the turn; and no such tie on the other side. Or say which bodies stand: "
            "linearize(..., standing=[...])"
        )
    turning = sides_of_joint[1 - sides_of_joint.index(ground)]
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


def _check_guest(view: View, name: str) -> None:
    parted = view.parted
    body, _ = view.assembly.scene.split(f"{name}.")
    if isinstance(body, FlexibleBody):
        raise ValueError(
            f"body {name!r} {'stands' if name in parted.standing else 'turns'} and is a reduced one, which a model in "
            f"the {parted.frame} frame cannot turn: describe it as a RigidBody, {OTHERWISE[parted.frame]}"
        )
    masses = [view.scene(angle).split(f"{name}.")[0].mass_matrix for angle in (0.0, *ANGLES)]
    change = max(float(np.linalg.norm((mass - masses[0])[3:, 3:])) for mass in masses)
    _check_change(parted, f"body {name!r}", change, float(np.linalg.norm(masses[0][3:, 3:])))
    if name not in parted.standing:
        unit = parted.velocity / np.linalg.norm(parted.velocity)
        beside = float(np.linalg.norm(np.cross(unit, body.position - parted.point)))
        if beside > SAME * np.sqrt(masses[0][3, 3] / masses[0][0, 0]):
            raise ValueError(
                f"body {name!r} turns with its centre of mass {beside:.3g} m beside the axis: its force turns, as the "
                f"standing frame sees it; {OTHERWISE[parted.frame]}"
            )


def _check_change(parted: Parted, what: str, change: float, size: float) -> None:
    if change > SAME * size:
        raise ValueError(
            f"{what}: the model changes as it turns, by {100 * change / size:.2g} % of what this part does as the "
            f"{parted.frame} frame sees it; {OTHERWISE[parted.frame]}"
        )


def _figures(view: View, words: Iterable[Tie], angle: float) -> list[Array]:
    """What must stay the same of ties between the same bodies, without units: of joints, what they leave free."""
    scale = view.scale
    joints = [view.rows(word, angle) * scale for word in words if isinstance(word, Constraint)]
    if joints:
        held = scipy.linalg.orth(np.vstack(joints).T, rcond=1e-9)
        return [held @ held.T]
    laws = [view.laws(word, angle) for word in words if not isinstance(word, Constraint)]
    return [scale[:, None] * sum(parts) * scale for parts in zip(*laws, strict=True)]


def _bears(assembly: Assembly, word: Tie, turn: Array) -> bool:
    """Whether a tie that holds, or resists, meets coordinates (n_all,) of a turn."""
    rows = word_rows(assembly, assembly.scene, word)
    if isinstance(word, SixSprings):
        both = np.vstack([word.stiffness, word.damping])
        rows = both / np.maximum(np.abs(both).max(axis=1, keepdims=True), 1e-300) @ rows
    met = np.abs(rows @ turn)
    return bool(np.any(met > BORNE * (np.abs(rows) @ np.abs(turn))))


def _named(word: Word) -> str:
    """A word, for messages."""
    if isinstance(word, Constraint):
        return f"joint {word.name!r}"
    if isinstance(word, (Field, Force)):
        return f"input {word.input!r}"
    if isinstance(word, (Reading, Leak)):
        return f"output {word.output!r}"
    return f"what ties {' and '.join(_paths(word))}"


def _paths(word: Word) -> tuple[str, ...]:
    if isinstance(word, (Constraint, SixSprings)):
        return (word.a, word.b)
    return word.row.paths if isinstance(word, Spring) else ()


def _body(path: str) -> str:
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
