"""Tangents of force laws about the static equilibrium of small motion."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nassim.base.checks import Array
from nassim.scene.scene import Scene
from nassim.scene.terms import ForceLaw, Term
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.ties import loose_bodies

EQUILIBRIUM_ITERATIONS = 100
LEFT_OVER = 1e-11
"""Share of the largest stiffness below which a stiffness is rounding."""
BALANCED = 1e-10
"""Share of the weight by which forces may be out of balance in static equilibrium."""
ROUNDING = 1e-14
"""Share of all forces, whether they balance or not, below which what is left of them is rounding."""


def no_equilibrium(scene: Scene) -> str:
    """Return the message of a scene without a static equilibrium, with the bodies that nothing holds."""
    loose = ", ".join(map(repr, loose_bodies(scene)))
    cause = f"no joint and no spring connects {loose} to a fixed body" if loose else "can a body move freely?"
    return (
        f"no static equilibrium: {cause}{'.' if loose else ''} Add joints, leave gravity out, or start from the "
        'reference configuration by simulate(..., start="released")'
    )


@dataclass(frozen=True)
class Tangent:
    """A force law about the static equilibrium of small motion.

    Attributes:
        law: the force law.
        rows: Jacobian of its measure on all coordinates, (k, n_all).
        value: value of the measure, (k,).
        stiffness: derivative of the resistance with respect to the value, (k, k).
        damping: derivative of the resistance with respect to the rate, (k, k).
        offset: constant part of the value, which is rows @ coordinates + offset, (k,).
    """

    law: ForceLaw
    rows: Array
    value: Array
    stiffness: Array
    damping: Array
    offset: Array | float = 0.0

    @classmethod
    def of(cls, law: ForceLaw, rows: Array, coordinates: Array) -> "Tangent":
        """Evaluate the tangent at given coordinates, (n_all,)."""
        value = rows @ coordinates
        return cls(law, rows, value, *law.tangents(value, np.zeros(len(value))))

    def moved_to(self, coordinates: Coordinates) -> "Tangent":
        """Return the tangent of the law where the bodies are; that of a linear law is the same everywhere."""
        moved = replace(self, rows=coordinates.jacobian(self.law.measure))
        if self.law.is_linear:
            return moved
        value = self.law.measure.evaluate(coordinates.states)[0]
        stiffness, damping = self.law.tangents(value, np.zeros(len(value)))
        return replace(moved, value=value, stiffness=stiffness, damping=damping)

    @property
    def constant(self) -> Array:
        """Resistance by the tangent where all coordinates are zero, at rest, (k,)."""
        return self.law.static_resistance(self.value) + self.stiffness @ (self.offset - self.value)


def law_tangents(coordinates: Coordinates, terms: Sequence[Term], basis: Array) -> list[Tangent]:
    """Compute the tangents of force laws about the static equilibrium under gravity.

    The equilibrium is at zero where all laws are linear and relaxed.

    Args:
        coordinates: coordinates of the scene.
        terms: terms of the parts.
        basis: motions that the constraints leave, (n_all, n).

    Returns:
        The tangents, in the order of the laws.

    Raises:
        ValueError: if no equilibrium is found, and for a law whose tangent stiffness is negative there.
    """
    laws = [(term, coordinates.jacobian(term.measure)) for term in terms if isinstance(term, ForceLaw)]
    at_rest = np.zeros(len(coordinates.mass))
    if any(not law.is_linear for law, _ in laws):
        at_rest = nonlinear_equilibrium(coordinates, laws, basis, coordinates.weight(coordinates.scene.gravity))
    result = [Tangent.of(law, rows, at_rest) for law, rows in laws]
    check_resistance(result)
    return result


def check_resistance(tangents: Sequence[Tangent]) -> None:
    """Refuse laws whose tangent stiffness is negative, with ValueError."""
    for tangent in tangents:
        least = float(np.linalg.eigvalsh(0.5 * (tangent.stiffness + tangent.stiffness.T))[0])
        if least < -LEFT_OVER * np.abs(tangent.stiffness).max():
            raise ValueError(
                f"the {type(tangent.law).__name__} between {', '.join(tangent.law.measure.points)} pushes away from "
                f"equilibrium, with a tangent of {least:.3g}: it has no model of small motion; simulate in large "
                'motion (fidelity "ffrf", or rigid bodies alone)'
            )


def tangent_of(coordinates: Coordinates, law: ForceLaw, tangents: Sequence[Tangent]) -> Tangent:
    """Return the tangent of a law that another part states again; a law within a body is taken about zero."""
    rows = coordinates.jacobian(law.measure)
    for tangent in tangents:
        if type(tangent.law) is type(law) and np.array_equal(tangent.rows, rows):
            stiffness, damping = law.tangents(tangent.value, np.zeros(len(rows)))
            return Tangent(law, rows, tangent.value, stiffness, damping, tangent.offset)
    return Tangent.of(law, rows, np.zeros(rows.shape[1]))


def nonlinear_equilibrium(
    coordinates: Coordinates, laws: Sequence[tuple[ForceLaw, Array]], basis: Array, weight: Array
) -> Array:
    """Find the coordinates at rest under constant forces by Newton's method with halved steps.

    Rigid-body modes stay at zero.

    Args:
        coordinates: coordinates of the scene.
        laws: force laws and the Jacobians of their measures.
        basis: motions that the constraints leave, (n_all, n).
        weight: constant forces, (n_all,).

    Returns:
        The coordinates, (n_all,).

    Raises:
        ValueError: if no equilibrium is found.
    """
    scene, scale = coordinates.scene, 1 / np.sqrt(np.einsum("ij,ij->j", basis, coordinates.mass @ basis))
    free = basis * scale
    elastic = np.zeros_like(coordinates.mass)
    for body in scene.bodies:
        if body.moves and body.strain is not None:
            elastic[coordinates.slices[body.name], coordinates.slices[body.name]] = body.strain.stiffness

    def left(q: Array) -> Array:
        force = weight - elastic @ q
        for law, rows in laws:
            force = force - rows.T @ law.static_resistance(rows @ q)
        return free.T @ force

    q = np.zeros(len(coordinates.mass))
    size = max(float(np.linalg.norm(free.T @ weight)), float(np.linalg.norm(left(q))))
    terms = np.abs(weight) + sum(np.abs(rows.T) @ np.abs(law.static_resistance(rows @ q)) for law, rows in laws)
    rounding = ROUNDING * float(np.linalg.norm(np.abs(free.T) @ terms))  # of preload that joints bear alone
    for _ in range(EQUILIBRIUM_ITERATIONS):
        stiffness = elastic + sum(t.rows.T @ t.stiffness @ t.rows for t in (Tangent.of(*law, q) for law in laws))
        values, shapes = np.linalg.eigh(free.T @ stiffness @ free)
        # Forces on what nothing holds stay out of balance: only the others decide.
        held = np.abs(values) > LEFT_OVER * np.abs(values).max(initial=0.0)
        now = shapes[:, held].T @ left(q)
        if np.linalg.norm(now) <= max(BALANCED * size, rounding):
            return q
        step, share = free @ (shapes[:, held] @ (now / values[held])), 1.0
        while share > LEFT_OVER and np.linalg.norm(shapes[:, held].T @ left(q + share * step)) >= np.linalg.norm(now):
            share /= 2
        q = q + share * step
    raise ValueError(f"scene {scene.name!r}: {no_equilibrium(scene)}")
