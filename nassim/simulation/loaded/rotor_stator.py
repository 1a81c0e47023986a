"""Rotor and stator: the side of a spindle to which each body belongs, by its connections."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_motions, rotated_motion
from nassim.scene.bodies import FlexibleBody
from nassim.scene.field_kinds import body_of
from nassim.scene.measures import Measure
from nassim.scene.terms import (
    AppliedForce,
    BaseAcceleration,
    CircuitState,
    CoilForce,
    Constraint,
    Feedthrough,
    ForceLaw,
    Output,
    OutputFilter,
    PrescribedMotion,
    Shunt,
    SpringForce,
    Term,
)
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.states import ReferenceState
from nassim.simulation.model.ties import Tie

ROTATION_TOLERANCE = 1e-9
"""Share of a row's size by which a rotation about the axis may change its measure."""


def term_rows(coordinates: Coordinates, term: Term, states: Mapping[str, ReferenceState] | None = None) -> Array:
    """Evaluate the rows of a term on all coordinates.

    Args:
        coordinates: coordinates of the scene.
        term: the term.
        states: states of the bodies, by name; default: the reference configuration.

    Returns:
        The rows, (m, n_all).
    """
    if isinstance(term, (PrescribedMotion, OutputFilter, CircuitState, Feedthrough)):
        return np.zeros((0, len(coordinates.mass)))
    if isinstance(term, SpringForce):
        return term_rows(coordinates, term.spring, states)
    if isinstance(term, BaseAcceleration):
        return coordinates.of_base(term, states)[None]
    assert isinstance(term, (AppliedForce, CoilForce, Output, ForceLaw, Shunt, Constraint))
    measure = term.measure if states is None else term.measure.deviation
    rows = coordinates.jacobian(measure, states)
    return rows[term.rows(term.held)] if isinstance(term, Constraint) else rows


def rotation_about(coordinates: Coordinates, names: Iterable[str], axis: Array, point: Array) -> Array:
    """Return the coordinates of a unit rotation of some bodies about an axis, with all others at rest, (n_all,).

    Args:
        coordinates: coordinates of the scene.
        names: names of the bodies.
        axis: the axis, (3,).
        point: a point of the axis, (3,) [m].
    """
    unit, scene = axis / np.linalg.norm(axis), coordinates.scene
    arms = {name: scene.body(name).position - point for name in names}
    return rigid_coordinates(coordinates, {n: np.concatenate([np.cross(unit, arm), unit]) for n, arm in arms.items()})


def rigid_coordinates(coordinates: Coordinates, motions: Mapping[str, Array]) -> Array:
    """Return the coordinates of bodies that move as rigid bodies, with all others at rest, (n_all,).

    Args:
        coordinates: coordinates of the scene.
        motions: motion of the points at the bodies' positions along the world's axes, (6,) each, by name.
    """
    result = np.zeros(coordinates.size)
    for name, motion in motions.items():
        body, own = coordinates.scene.body(name), motion
        if isinstance(body, FlexibleBody):
            to_body = rotated_motion(body.rotation.T)
            own = rigid_motions(body.reduced.positions, len(body.mass_matrix)) @ to_body @ motion
        result[coordinates.slices[name]] = own
    return result


def stator_bodies(assembly: Assembly, joint: Constraint, axis: Array) -> frozenset[str]:
    """Find the bodies of the stator of a driven joint.

    Bodies belong to the side of those to which something connects them that resists a rotation about the axis. A body
    that is otherwise connected to one side only belongs to that side.

    Args:
        assembly: the assembled scene.
        joint: the driven joint.
        axis: its axis, (3,).

    Returns:
        Names of the bodies.

    Raises:
        ValueError: for a body whose connections do not define its side.
    """
    scene, coordinates = assembly.scene, assembly.coordinates.reference
    point = scene.point_position(joint.points[0])
    groups = {body.name: body.name if body.moves else "" for body in scene.bodies}
    loose: list[set[str]] = []
    for term in assembly.terms:
        if isinstance(term, Tie):
            ends = term.measure.bodies
            names = [name for name in ends if name in coordinates.slices]
            if any(resists(assembly, term, rotation_about(coordinates, [name], axis, point)) for name in names):
                first, *others = (groups[name] for name in ends)
                groups = {name: first if group in others else group for name, group in groups.items()}
            else:
                loose.append(set(ends))
    ground = next((groups[body.name] for body in scene.bodies if not body.moves), "")
    driven = [groups[body_of(path)] for path in joint.points[:2]]
    if driven.count(ground) != 1:
        raise ValueError(
            f"joint {joint.name!r}: a drive that turns far needs a fixed body on one side, or one that a joint or "
            "spring which resists the rotation ties to a fixed body; and no such tie on the other side. Or name the "
            "bodies of the stator: linearize(..., stator=[...])"
        )
    rotor = driven[1 - driven.index(ground)]
    sides = _sides(groups, loose, ground, rotor)
    return frozenset(name for name in groups if sides[groups[name]] != rotor)


def _sides(groups: Mapping[str, str], loose: Sequence[set[str]], ground: str, rotor: str) -> dict[str, str]:
    """Return the group to whose side each group belongs: a group with ties to one side only goes to that side.

    Args:
        groups: group of each body, by name.
        loose: bodies that each tie connects which resists no rotation about the axis.
        ground: group of the stator.
        rotor: group of the rotor.

    Raises:
        ValueError: for bodies with ties to both sides.
    """
    sides = {group: group for group in groups.values()}
    while True:
        found = dict(sides)
        for group in set(sides.values()) - {ground, rotor}:
            members = {name for name in groups if sides[groups[name]] == group}
            met = {sides[groups[name]] for ends in loose if ends & members for name in ends} - {group}
            if {ground, rotor} <= met:
                raise ValueError(
                    f"body {min(members)!r} is tied to the rotor and to the stator, so its side is not known: name "
                    "all bodies of the stator, fixed ones too: linearize(..., stator=[...])"
                )
            if met:
                to = met.pop()
                found = {key: to if side == group else side for key, side in sides.items()}
                break
        if found == sides:
            return sides
        sides = found


def resists(assembly: Assembly, term: Tie, rotation: Array) -> bool:
    """Whether a tie holds or resists a rotation, (n_all,); a spring along a driven component resists nothing."""
    rows = term_rows(assembly.coordinates.reference, term)
    if isinstance(term, ForceLaw):
        if len(rows) == 1 and _has_drive(assembly, term.measure, rows):
            return False
        both = np.vstack(term.tangents(*np.zeros((2, len(rows)))))
        rows = both / np.maximum(np.abs(both).max(axis=1, keepdims=True), 1e-300) @ rows
    met = np.abs(rows @ rotation)
    # Points on the axis move by rounding alone, hence the millimetre.
    return bool(np.any(met > ROTATION_TOLERANCE * (np.abs(rows) @ (np.abs(rotation) + 1e-3))))


def label_of(term: Term) -> str:
    """Name a term, for messages."""
    if isinstance(term, Constraint):
        return f"joint {term.name!r}"
    if isinstance(term, (BaseAcceleration, AppliedForce, CoilForce)):
        return f"input {term.input!r}"
    if isinstance(term, (Output, SpringForce)):
        return f"output {term.name!r}"
    if isinstance(term, Shunt):
        return f"output {term.output!r}"
    if isinstance(term, ForceLaw):
        return f"the force law between {' and '.join(dict.fromkeys(term.measure.points))}"
    return type(term).__name__


def _has_drive(assembly: Assembly, measure: Measure, rows: Array) -> bool:
    """Whether a scalar measure is between a joint's points, along a direction that the joint or its drive holds."""
    for joint in assembly.terms:
        if isinstance(joint, Constraint) and set(joint.points) == set(measure.points):
            driven = [
                t.component for t in assembly.terms if isinstance(t, PrescribedMotion) if t.constraint == joint.name
            ]
            held = assembly.coordinates.reference.jacobian(joint.measure)[joint.rows((*joint.held, *driven))]
            scale = 1 / np.sqrt(np.diag(assembly.coordinates.mass))
            rest = (rows * scale).T
            rest = rest - (held * scale).T @ np.linalg.lstsq((held * scale).T, rest, rcond=ROTATION_TOLERANCE)[0]
            if np.linalg.norm(rest) <= ROTATION_TOLERANCE * np.linalg.norm(rows * scale) and len(held):
                return True
    return False
