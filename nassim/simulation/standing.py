"""Scenes of which a part spins and a part stands: who does what, and what that adds to the equations of small motion.

One frame describes all: that of what turns, or that of what stands. A body that is at home in the other is its guest,
and must be rigid: with V the angular velocity at which the frame sees its guests turn, R(t) that turn, u a guest's
small motion as seen at its home and v = R u as the frame sees it, M its mass, G and K of its own spin,

    M v'' + (G - 2 M V~) v' + (K - G V~ + M V~ V~) v = f

and a damper, whose row w may turn as the frame sees it, resists w v' + w' v: its forces turn motions, as those of
bearings that stand do in the frame of a rotor, and can drive them.

The model does not change in time where the frame sees the same whatever the angle: guests have equal moments of inertia
across the axis, and what ties them to each other, to the ground and to the others is the same in all directions across
it, as three equal bushings around the axis are. That is checked at odd angles, as is what signals read and push. What
the forces of an unbalance stiffen is taken as it is at the start.

Source: G. Genta, Dynamics of Rotating Systems, Springer (2005), ch. 6, on rotors and stators without symmetry.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.base.rigid_motion import skew
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.part import (
    Constraint,
    Field,
    Filter,
    Follow,
    Row,
    SixSprings,
    Spring,
    Tension,
    Word,
)
from nassim.scene.scene import Scene
from nassim.simulation.sides import Tie, bears, body_of, ends_of, named, turn_about, word_rows
from nassim.simulation.small_motion import Assembly

FRAMES = ("turning", "standing")
ANGLES = (1.0, 2.3)
"""At which everything must look as it does at the start [rad]."""
SAME = 1e-7
"""Share of itself by which it may differ."""
OTHERWISE = {
    "turning": "make what stands alike in all directions across the axis, or, if what turns is rigid and alike all "
    'around, take frame="standing"; or simulate in time',
    "standing": "make what turns alike in all directions across the axis, or, if what stands is rigid and alike all "
    'around, take frame="turning"; or simulate in time',
}
"""What may be done about parts that change, by frame."""
ALONG = {
    "turning": 'take the axis, or a direction whose frame is a point that turns: frame="body.point"',
    "standing": "take the axis, or a direction whose frame is the world or a point that stands",
}
"""What may be done about signals that change, by frame."""


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
            return replace(word, axes=self.turn(angle * self.is_guest(body_of(word.a))) @ word.axes)
        if isinstance(word, SixSprings):
            guests = [self.is_guest(body_of(path)) for path in (word.a, word.b)]
            return replace(word, axes=self.turn(angle * sum(guests) / 2) @ word.axes)
        if isinstance(word, Tension):
            spring = self.said(word.spring, angle)
            return replace(word, spring=spring) if isinstance(spring, (Spring, SixSprings)) else word
        if isinstance(word, (Follow, Filter)) or not isinstance(word.row, Row) or word.row.within:
            return word
        both = np.kron(np.eye(2), self.turn(angle * self.is_guest(body_of(word.row.frame))))
        points = tuple((path, both @ weights) for path, weights in word.row.points)
        return replace(word, row=replace(word.row, points=points))


@dataclass(frozen=True)
class SeenScene:
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
        """Their change per radian, exact: their vectors stand or turn as a whole, in sine and cosine of the angle."""
        result: Array = 0.5 * (self.rows(word, angle + np.pi / 2) - self.rows(word, angle - np.pi / 2))
        return result

    def laws(self, word: Spring | SixSprings, angle: float) -> tuple[Array, Array, Array]:
        """Stiffness, damping, and what damping drives as its rows turn, on all coordinates, (n_all, n_all) each."""
        stiffness, damping = np.atleast_2d(word.stiffness), np.atleast_2d(word.damping)
        rows = self.rows(word, angle)
        slopes = self.slopes(word, angle) if damping.any() else np.zeros_like(rows)
        return rows.T @ stiffness @ rows, rows.T @ damping @ rows, self.rate * rows.T @ damping @ slopes

    @property
    def rate(self) -> float:
        """At which the guests turn [rad/s]."""
        return float(np.linalg.norm(self.parted.drift))

    @cached_property
    def scale(self) -> Array:
        """Of all coordinates to comparable roots of energy, (n_all,)."""
        masses = [np.diag(self.scene(0.0).split(f"{name}.")[0].mass_matrix) for name in self.assembly.slices]
        result: Array = 1 / np.sqrt(np.concatenate(masses))
        return result


def guest_terms(view: SeenScene, name: str, coriolis: Array, stiffness: Array) -> tuple[Array, Array]:
    """Coriolis matrix and stiffness of a guest, as the frame sees it, from those at its home, (6, 6) each."""
    mass, drift = view.scene(0.0).split(f"{name}.")[0].mass_matrix, np.kron(np.eye(2), skew(view.parted.drift))
    return coriolis - 2 * mass @ drift, stiffness - coriolis @ drift + mass @ drift @ drift


def turned_damping(view: SeenScene) -> Array:
    """What dampers drive as their rows turn, on all coordinates, (n_all, n_all), not symmetric."""
    result = np.zeros((len(view.scale),) * 2)
    for word in view.assembly.words:
        if isinstance(word, (Spring, SixSprings)):
            result += view.laws(word, 0.0)[2]
    return result


def check_constant(view: SeenScene) -> None:
    """Raise ValueError for what makes a linear model change while a part of the scene turns; the message names it."""
    assembly, parted = view.assembly, view.parted
    for name in filter(parted.is_guest, assembly.slices):
        _check_guest(view, name)
    turn = turn_about(assembly, assembly.slices.keys() - parted.standing, parted.velocity, parted.point)
    ties: dict[tuple[str, ...], list[Tie]] = {}
    for word in assembly.words:
        if isinstance(word, Tie):
            if bears(assembly, word, turn):
                raise ValueError(
                    f"{named(word)} resists the turn about the axis, of what turns against what stands or against "
                    "the world's axes: free that motion, put its points on the axis, or let its axes turn along"
                )
            sides = {name in parted.standing for name in map(body_of, ends_of(word))}
            if isinstance(word, SixSprings) and len(sides) > 1 and word.damping.any():
                raise ValueError(
                    f"{named(word)}: axes of a bushing turn halfway between its bodies, so its damping would be "
                    "neither one that stands nor one that turns; damp by a SpringDamper with the frame of either body"
                )
            moving = {name for name in map(body_of, ends_of(word)) if name in assembly.slices}
            ties.setdefault(("joint",) * isinstance(word, Constraint) + tuple(sorted(moving)), []).append(word)
        else:
            start = view.rows(word, 0.0) * view.scale
            change = max(float(np.linalg.norm(view.rows(word, a) * view.scale - start)) for a in ANGLES)
            _check_change(parted, named(word), change, float(np.linalg.norm(start)), ALONG)
    for words in ties.values():
        for start, *others in zip(*(_figures(view, words, angle) for angle in (0.0, *ANGLES)), strict=True):
            change = max(float(np.linalg.norm(other - start)) for other in others)
            _check_change(parted, ", ".join(dict.fromkeys(map(named, words))), change, float(np.linalg.norm(start)))


def damps_both(view: SeenScene) -> bool:
    """Whether a damping of the scene's modes would be one of what stands and of what turns at once, or of guests."""
    standing = view.parted.standing
    if any(name in standing or view.parted.is_guest(name) for name in view.assembly.slices):
        return True
    words = (word for word in view.assembly.words if isinstance(word, (Spring, SixSprings)))
    return any(body_of(path) in standing for word in words for path in ends_of(word))


def _check_guest(view: SeenScene, name: str) -> None:
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


def _check_change(parted: Parted, what: str, change: float, size: float, cures: Mapping[str, str] = OTHERWISE) -> None:
    if change > SAME * size:
        raise ValueError(
            f"{what}: as the {parted.frame} frame sees it, this changes by {100 * change / size:.2g} % while the scene "
            f"turns, so that no linear model holds; {cures[parted.frame]}"
        )


def _figures(view: SeenScene, words: Iterable[Tie], angle: float) -> list[Array]:
    """What must stay the same of ties between the same bodies, without units: of joints, what they leave free."""
    scale = view.scale
    joints = [view.rows(word, angle) * scale for word in words if isinstance(word, Constraint)]
    if joints:
        held = scipy.linalg.orth(np.vstack(joints).T, rcond=1e-9)
        return [held @ held.T]
    laws = [view.laws(word, angle) for word in words if not isinstance(word, Constraint)]
    stiffness, damping, turned = (scale[:, None] * sum(parts) * scale for parts in zip(*laws, strict=True))
    return [stiffness, np.hstack([view.rate * damping, turned])]
