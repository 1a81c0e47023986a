"""Scenes with a rotor and a stator: the frame of their equations, and the terms that it adds to small motion.

One frame describes all motion: the rotor's or the stator's. A body of the other side is in the other frame, and must be
rigid. With V the angular velocity of that body's side in the describing frame, R(t) its rotation, u its small motion in
its own frame and v = R u in the describing frame, M its mass, G and K the terms of its own spin,

    M v'' + (G - 2 M V~) v' + (K - G V~ + M V~ V~) v = f

and a damper, whose row w may rotate in the describing frame, resists w v' + w' v. Its forces convert rotations, as the
dampers of bearings on the stator do in the rotor's frame, and can make motion unstable.

The model is constant in time where the scene is the same for the describing frame at every angle: the bodies in the
other frame have equal moments of inertia across the axis, and their connections to each other, to the ground and to the
other side are equal in all directions across it, as those of three equal bushings around the axis are. This is checked
at odd angles, as are the directions of outputs and forces. The stiffness by unbalance forces is that at the start.

Source: G. Genta, Dynamics of Rotating Systems, Springer (2005), ch. 6, on rotors and stators without symmetry.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.rigid_motion import rotated_motion, rotation_matrix, skew
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.terms import Constraint, ForceLaw, Term
from nassim.simulation.loaded.rotor_stator import label_of, resists, rotation_about, term_rows
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.damping import damps
from nassim.simulation.model.states import ReferenceState
from nassim.simulation.model.ties import Tie

FRAMES = ("rotor", "stator")
CHECKED_ANGLES = (1.0, 2.3)
"""Angles of the rotor [rad] at which everything must equal the start."""
CONSTANT_TOLERANCE = 1e-7
"""Relative difference up to which it counts as equal."""
OTHERWISE = {
    "rotor": "make the stator equal in all directions across the axis, or, if the rotor is rigid and equal in all "
    'directions, take frame="stator"; or simulate in time',
    "stator": "make the rotor equal in all directions across the axis, or, if the stator is rigid and equal in all "
    'directions, take frame="rotor"; or simulate in time',
}
"""Remedies for parts that change with the angle, by frame."""
ALONG = {
    "rotor": 'take the axis, or a direction whose frame is a point of the rotor: frame="body.point"',
    "stator": "take the axis, or a direction whose frame is the world or a point of the stator",
}
"""Remedies for signals that change with the angle, by frame."""


class ChangesWithAngle(ValueError):
    """A scene whose model in a frame depends on the angle of the rotor, so that no linear model in it is constant."""


@dataclass(frozen=True)
class RotorPartition:
    """Partition of a scene into rotor and stator, and the frame of its equations.

    Attributes:
        velocity: angular velocity of the rotor, (3,) [rad/s], not zero.
        point: a point of the axis, (3,) [m].
        stator: names of the bodies of the stator.
        frame: "rotor" for the rotor's frame or "stator" for the stator's.
    """

    velocity: Array
    point: Array
    stator: frozenset[str]
    frame: str = "rotor"

    def in_other_frame(self, name: str) -> bool:
        """Whether a body, or "" for the world with its axes, belongs to the side that does not describe the motion."""
        return (not name or name in self.stator) == (self.frame == "rotor")

    @property
    def relative_velocity(self) -> Array:
        """Angular velocity V of the other side in the describing frame, (3,) [rad/s]."""
        return -self.velocity if self.frame == "rotor" else self.velocity

    def rotation_at(self, angle: float) -> Array:
        """Return the rotation of the other side in the describing frame, (3, 3), at an angle [rad]."""
        return rotation_matrix(angle * self.relative_velocity / np.linalg.norm(self.relative_velocity))

    def moved_body(self, body: Body, angle: float) -> Body:
        """Return a body in the describing frame once the other side has rotated by an angle [rad]."""
        if not self.in_other_frame(body.name):
            return body
        rotation = self.rotation_at(angle)
        place = self.point + rotation @ (body.position - self.point)
        return replace(body, position=place, rotation=rotation @ body.rotation)  # type: ignore[type-var]  # a dataclass


@dataclass(frozen=True)
class FrameView:
    """An assembled scene in its describing frame, with the other side at any angle.

    Attributes:
        assembly: the assembled scene.
        partition: rotor and stator.
        seen: states of all bodies by angle [rad], computed so far.
        known: terms with their rows, by the term's identity and angle [rad], computed so far.
    """

    assembly: Assembly
    partition: RotorPartition
    seen: dict[float, dict[str, ReferenceState]] = field(default_factory=dict)
    known: dict[tuple[int, float], tuple[Term, Array]] = field(default_factory=dict)

    def states(self, angle: float) -> dict[str, ReferenceState]:
        """Return the states of all bodies, by name, written along the world's axes."""
        if angle not in self.seen:
            partition = self.partition
            view = partition.rotation_at(angle).T if partition.in_other_frame("") else None
            bodies = self.assembly.scene.bodies
            self.seen[angle] = {
                body.name: ReferenceState(partition.moved_body(body, angle), body, view, partition.point)
                for body in bodies
            }
        return self.seen[angle]

    def rows(self, term: Term, angle: float) -> Array:
        """Return the rows of a term on all coordinates, (m, n_all)."""
        key = id(term), angle
        if key not in self.known:
            self.known[key] = term, term_rows(self.assembly.coordinates.reference, term, self.states(angle))
        return self.known[key][1]

    def slopes(self, term: Term, angle: float) -> Array:
        """Return the exact derivative of the rows per radian: they are constant plus sine and cosine of the angle."""
        now, ahead, behind = (self.rows(term, quarter) for quarter in (0.0, np.pi / 2, -np.pi / 2))
        along_cosine, along_sine = now - 0.5 * (ahead + behind), 0.5 * (ahead - behind)
        return np.cos(angle) * along_sine - np.sin(angle) * along_cosine

    def laws(self, law: ForceLaw, angle: float) -> tuple[Array, Array, Array]:
        """Return stiffness, damping and stiffness by damping along rotating rows, (n_all, n_all) each."""
        still = np.zeros(len(law.measure.components))
        stiffness, damping = law.tangents(still, still)
        rows = self.rows(law, angle)
        slopes = self.slopes(law, angle) if damping.any() else np.zeros_like(rows)
        return rows.T @ stiffness @ rows, rows.T @ damping @ rows, self.rate * rows.T @ damping @ slopes

    @property
    def rate(self) -> float:
        """Angular speed of the other side in the describing frame [rad/s]."""
        return float(np.linalg.norm(self.partition.relative_velocity))

    @cached_property
    def scale(self) -> Array:
        """Factors that scale all coordinates to comparable square roots of energy, (n_all,)."""
        masses = [np.diag(self.states(0.0)[name].body.mass_matrix) for name in self.assembly.coordinates.slices]
        return 1 / np.sqrt(np.concatenate(masses))


def other_frame_terms(view: FrameView, name: str, coriolis: Array, stiffness: Array) -> tuple[Array, Array]:
    """Convert Coriolis matrix and stiffness of a body in the other frame to the describing frame, (6, 6) each.

    Args:
        view: the scene in its describing frame.
        name: name of the body.
        coriolis: Coriolis matrix G in the body's own frame, (6, 6).
        stiffness: stiffness K in the body's own frame, (6, 6).

    Returns:
        Both in the describing frame, (6, 6) each.
    """
    mass, turn = view.states(0.0)[name].body.mass_matrix, rotated_motion(skew(view.partition.relative_velocity))
    return coriolis - 2 * mass @ turn, stiffness - coriolis @ turn + mass @ turn @ turn


def rotating_damping(view: FrameView) -> Array:
    """Return the stiffness by dampers along rotating rows, on all coordinates, (n_all, n_all), not symmetric."""
    result = np.zeros((len(view.scale),) * 2)
    for term in view.assembly.terms:
        if isinstance(term, ForceLaw):
            result += view.laws(term, 0.0)[2]
    return result


def check_constant(view: FrameView) -> None:
    """Check that the linear model does not change while the rotor rotates.

    Raises:
        ChangesWithAngle: for a part that changes it; the message names the part.
        ValueError: for a part that resists the rotation, and for damping that belongs to neither side.
    """
    partition, coordinates = view.partition, view.assembly.coordinates
    for name in filter(partition.in_other_frame, coordinates.slices):
        _check_other_frame_body(view, name)
    rotor = coordinates.slices.keys() - partition.stator
    rotation = rotation_about(coordinates, rotor, partition.velocity, partition.point)
    ties: dict[tuple[str, ...], list[Tie]] = {}
    for term in view.assembly.terms:
        if isinstance(term, Tie):
            _check_tie(view, term, rotation)
            moving = {name for name in term.measure.bodies if name in coordinates.slices}
            ties.setdefault(("joint",) * isinstance(term, Constraint) + tuple(sorted(moving)), []).append(term)
        else:
            start = view.rows(term, 0.0) * view.scale
            change = max(float(np.linalg.norm(view.rows(term, a) * view.scale - start)) for a in CHECKED_ANGLES)
            _check_change(partition, label_of(term), change, float(np.linalg.norm(start)), ALONG)
    for terms in ties.values():
        for start, *others in zip(*(_figures(view, terms, angle) for angle in (0.0, *CHECKED_ANGLES)), strict=True):
            change = max(float(np.linalg.norm(other - start)) for other in others)
            _check_change(
                partition, ", ".join(dict.fromkeys(map(label_of, terms))), change, float(np.linalg.norm(start))
            )


def turns_as_whole(view: FrameView) -> bool:
    """Whether a scene whose model is constant is one that turns as a whole in the frame of its rotor.

    Its stator is fixed, and only joints tie the rotor to it. The driven joint holds the other rotations, as the driven
    angle of a shaft that tilts depends on the tilt.
    """
    scene = view.assembly.scene
    held = [{*scene.constraints[drive.constraint].held, drive.component} for drive in scene.speeds]
    return not damps_both(view) and all({"rx", "ry", "rz"} <= components for components in held)


def damps_both(view: FrameView) -> bool:
    """Whether a damping of the scene's modes would act on stator and rotor at once, or on bodies in the other frame."""
    stator = view.partition.stator
    if any(name in stator or view.partition.in_other_frame(name) for name in view.assembly.coordinates.slices):
        return True
    laws = (term for term in view.assembly.terms if isinstance(term, ForceLaw))
    return any(name in stator for law in laws for name in law.measure.bodies)


def _check_other_frame_body(view: FrameView, name: str) -> None:
    partition = view.partition
    body = view.assembly.scene.body(name)
    if isinstance(body, FlexibleBody):
        raise ChangesWithAngle(
            f"body {name!r} of the {'stator' if name in partition.stator else 'rotor'} is a reduced body, which a "
            f"model in the {partition.frame} frame cannot rotate: describe it as a RigidBody, "
            f"{OTHERWISE[partition.frame]}"
        )
    masses = [view.states(angle)[name].body.mass_matrix for angle in (0.0, *CHECKED_ANGLES)]
    change = max(float(np.linalg.norm((mass - masses[0])[3:, 3:])) for mass in masses)
    _check_change(partition, f"body {name!r}", change, float(np.linalg.norm(masses[0][3:, 3:])))
    if name not in partition.stator:
        unit = partition.velocity / np.linalg.norm(partition.velocity)
        beside = float(np.linalg.norm(np.cross(unit, body.position - partition.point)))
        if beside > CONSTANT_TOLERANCE * np.sqrt(masses[0][3, 3] / masses[0][0, 0]):
            raise ChangesWithAngle(
                f"body {name!r} rotates with its centre of mass {beside:.3g} m beside the axis: its unbalance force "
                f"rotates in the frame of the stator; {OTHERWISE[partition.frame]}"
            )


def _check_tie(view: FrameView, term: Tie, rotation: Array) -> None:
    """Refuse a tie that resists the rotor's rotation, (n_all,), and damping that belongs to neither side."""
    if resists(view.assembly, term, rotation):
        raise ValueError(
            f"{label_of(term)} resists the rotation of the rotor about its axis, against the stator or against the "
            "world's axes: free that motion, put its points on the axis, or let its axes rotate with it"
        )
    sides = {name in view.partition.stator for name in term.measure.bodies}
    between = len(term.measure.components) > 1 and len(sides) > 1
    if isinstance(term, ForceLaw) and between and damps(term):
        raise ValueError(
            f"{label_of(term)}: a model of a rotor does not know whether the damping of a bushing between rotor and "
            "stator rotates; damp by a SpringDamper with the frame of either body"
        )


def _check_change(
    partition: RotorPartition, what: str, change: float, size: float, cures: Mapping[str, str] = OTHERWISE
) -> None:
    if change > CONSTANT_TOLERANCE * size:
        raise ChangesWithAngle(
            f"{what}: in the {partition.frame} frame, this changes by {100 * change / size:.2g} % while the rotor "
            f"turns, so that no linear model holds; {cures[partition.frame]}"
        )


def _figures(view: FrameView, terms: Iterable[Tie], angle: float) -> list[Array]:
    """Return the values of ties between the same bodies that must not change; for joints, what they hold."""
    scale = view.scale
    joints = [view.rows(term, angle) * scale for term in terms if isinstance(term, Constraint)]
    if joints:
        held = scipy.linalg.orth(np.vstack(joints).T, rcond=1e-9)
        return [held @ held.T]
    laws = [view.laws(term, angle) for term in terms if isinstance(term, ForceLaw)]
    stiffness, damping, turned = (scale[:, None] * sum(parts) * scale for parts in zip(*laws, strict=True))
    return [stiffness, np.hstack([view.rate * damping, turned])]
