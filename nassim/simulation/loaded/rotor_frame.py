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
from nassim.scene.terms import Constraint, ForceLaw, Term
from nassim.simulation.loaded.rotor_stator import Tie, label_of, resists, rotation_about, term_rows
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.damping import damps
from nassim.simulation.model.states import ReferenceState

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
class RotorPartition:
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

    def in_other_frame(self, name: str) -> bool:
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
        if not self.in_other_frame(body.name):
            return body
        turn = self.turn(angle)
        place = self.point + turn @ (body.position - self.point)
        return replace(body, position=place, rotation=turn @ body.rotation)  # type: ignore[type-var]  # a dataclass


@dataclass(frozen=True)
class FrameView:
    """An assembled scene as its describing frame sees it, guests turned by any angle [rad]."""

    assembly: Assembly
    parted: RotorPartition
    seen: dict[float, dict[str, ReferenceState]] = field(default_factory=dict)

    def states(self, angle: float) -> dict[str, ReferenceState]:
        """Of all bodies, by name, as told along the world's axes."""
        if angle not in self.seen:
            parted = self.parted
            view = parted.turn(angle).T if parted.in_other_frame("") else None
            bodies = self.assembly.scene.bodies
            self.seen[angle] = {
                body.name: ReferenceState(parted.carried(body, angle), body, view, parted.point) for body in bodies
            }
        return self.seen[angle]

    def rows(self, term: Term, angle: float) -> Array:
        """Rows of a term on all coordinates, (m, n_all)."""
        return term_rows(self.assembly.coordinates, term, self.states(angle))

    def slopes(self, term: Term, angle: float) -> Array:
        """Their change per radian, exact: their vectors stand or turn as a whole, in sine and cosine of the angle."""
        result: Array = 0.5 * (self.rows(term, angle + np.pi / 2) - self.rows(term, angle - np.pi / 2))
        return result

    def laws(self, law: ForceLaw, angle: float) -> tuple[Array, Array, Array]:
        """Stiffness, damping, and what damping drives as its rows turn, on all coordinates, (n_all, n_all) each."""
        still = np.zeros(len(law.measure.components))
        stiffness, damping = law.tangents(still, still)
        rows = self.rows(law, angle)
        slopes = self.slopes(law, angle) if damping.any() else np.zeros_like(rows)
        return rows.T @ stiffness @ rows, rows.T @ damping @ rows, self.rate * rows.T @ damping @ slopes

    @property
    def rate(self) -> float:
        """At which the guests turn [rad/s]."""
        return float(np.linalg.norm(self.parted.drift))

    @cached_property
    def scale(self) -> Array:
        """Of all coordinates to comparable roots of energy, (n_all,)."""
        masses = [np.diag(self.states(0.0)[name].body.mass_matrix) for name in self.assembly.slices]
        result: Array = 1 / np.sqrt(np.concatenate(masses))
        return result


def other_frame_terms(view: FrameView, name: str, coriolis: Array, stiffness: Array) -> tuple[Array, Array]:
    """Coriolis matrix and stiffness of a guest, as the frame sees it, from those at its home, (6, 6) each."""
    mass, drift = view.states(0.0)[name].body.mass_matrix, np.kron(np.eye(2), skew(view.parted.drift))
    return coriolis - 2 * mass @ drift, stiffness - coriolis @ drift + mass @ drift @ drift


def rotating_damping(view: FrameView) -> Array:
    """What dampers drive as their rows turn, on all coordinates, (n_all, n_all), not symmetric."""
    result = np.zeros((len(view.scale),) * 2)
    for term in view.assembly.terms:
        if isinstance(term, ForceLaw):
            result += view.laws(term, 0.0)[2]
    return result


def check_constant(view: FrameView) -> None:
    """Raise ValueError for what makes a linear model change while a part of the scene turns; the message names it."""
    assembly, parted = view.assembly, view.parted
    for name in filter(parted.in_other_frame, assembly.slices):
        _check_guest(view, name)
    turn = rotation_about(assembly, assembly.slices.keys() - parted.standing, parted.velocity, parted.point)
    ties: dict[tuple[str, ...], list[Tie]] = {}
    for term in assembly.terms:
        if isinstance(term, Tie):
            if resists(assembly, term, turn):
                raise ValueError(
                    f"{label_of(term)} resists the turn about the axis, of what turns against what stands or against "
                    "the world's axes: free that motion, put its points on the axis, or let its axes turn along"
                )
            sides = {name in parted.standing for name in term.measure.bodies}
            halfway = len(term.measure.components) > 1 and len(sides) > 1
            if isinstance(term, ForceLaw) and halfway and damps(term):
                raise ValueError(
                    f"{label_of(term)}: axes of a bushing turn halfway between its bodies, so its damping would be "
                    "neither one that stands nor one that turns; damp by a SpringDamper with the frame of either body"
                )
            moving = {name for name in term.measure.bodies if name in assembly.slices}
            ties.setdefault(("joint",) * isinstance(term, Constraint) + tuple(sorted(moving)), []).append(term)
        else:
            start = view.rows(term, 0.0) * view.scale
            change = max(float(np.linalg.norm(view.rows(term, a) * view.scale - start)) for a in ANGLES)
            _check_change(parted, label_of(term), change, float(np.linalg.norm(start)), ALONG)
    for terms in ties.values():
        for start, *others in zip(*(_figures(view, terms, angle) for angle in (0.0, *ANGLES)), strict=True):
            change = max(float(np.linalg.norm(other - start)) for other in others)
            _check_change(parted, ", ".join(dict.fromkeys(map(label_of, terms))), change, float(np.linalg.norm(start)))


def damps_both(view: FrameView) -> bool:
    """Whether a damping of the scene's modes would be one of what stands and of what turns at once, or of guests."""
    standing = view.parted.standing
    if any(name in standing or view.parted.in_other_frame(name) for name in view.assembly.slices):
        return True
    laws = (term for term in view.assembly.terms if isinstance(term, ForceLaw))
    return any(name in standing for law in laws for name in law.measure.bodies)


def _check_guest(view: FrameView, name: str) -> None:
    parted = view.parted
    body, _ = view.assembly.scene.split(f"{name}.")
    if isinstance(body, FlexibleBody):
        raise ValueError(
            f"body {name!r} {'stands' if name in parted.standing else 'turns'} and is a reduced one, which a model in "
            f"the {parted.frame} frame cannot turn: describe it as a RigidBody, {OTHERWISE[parted.frame]}"
        )
    masses = [view.states(angle)[name].body.mass_matrix for angle in (0.0, *ANGLES)]
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


def _check_change(
    parted: RotorPartition, what: str, change: float, size: float, cures: Mapping[str, str] = OTHERWISE
) -> None:
    if change > SAME * size:
        raise ValueError(
            f"{what}: as the {parted.frame} frame sees it, this changes by {100 * change / size:.2g} % while the scene "
            f"turns, so that no linear model holds; {cures[parted.frame]}"
        )


def _figures(view: FrameView, terms: Iterable[Tie], angle: float) -> list[Array]:
    """What must stay the same of ties between the same bodies, without units: of joints, what they leave free."""
    scale = view.scale
    joints = [view.rows(term, angle) * scale for term in terms if isinstance(term, Constraint)]
    if joints:
        held = scipy.linalg.orth(np.vstack(joints).T, rcond=1e-9)
        return [held @ held.T]
    laws = [view.laws(term, angle) for term in terms if isinstance(term, ForceLaw)]
    stiffness, damping, turned = (scale[:, None] * sum(parts) * scale for parts in zip(*laws, strict=True))
    return [stiffness, np.hstack([view.rate * damping, turned])]
