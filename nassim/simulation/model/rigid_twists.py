"""Twists of a scene's bodies, moved as rigid bodies, and the rates of constraints and drives per unit of them.

A body's twist (6,) is the motion (ux uy uz rx ry rz) of its point at the world's origin, along the world's axes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_transfer
from nassim.scene.bodies import Body
from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint, PrescribedMotion
from nassim.simulation.model.states import RigidState


@dataclass(frozen=True)
class RigidTwists:
    """Twists of the bodies of a scene that move, one after the other, (6 n_bodies,)."""

    scene: Scene

    @cached_property
    def bodies(self) -> dict[str, Body]:
        """The bodies, by name."""
        return {body.name: body for body in self.scene.bodies if body.moves}

    @cached_property
    def places(self) -> dict[str, slice]:
        """Slice of each body's twist among all, by name."""
        return {name: slice(6 * k, 6 * k + 6) for k, name in enumerate(self.bodies)}

    @property
    def size(self) -> int:
        """Number of components of all twists."""
        return 6 * len(self.bodies)

    @property
    def mass(self) -> Array:
        """Mass matrix of all twists, (size, size)."""
        return scipy.linalg.block_diag(*map(rigid_mass, self.bodies.values()))

    def rows(self, joint: Constraint, components: tuple[str, ...], twists: Array | None = None) -> Array:
        """Return the rates of components of a constraint's measure per unit of all twists, (components, size).

        They are those after finite motions of all bodies, (size,), or in the reference configuration.
        """
        states = self._states(joint, np.zeros(self.size) if twists is None else twists)
        result = np.zeros((len(components), self.size))
        for name, rows in joint.measure.evaluate(states)[1].items():
            if name in self.places:
                result[:, self.places[name]] = rows[joint.rows(components)]
        return result

    def held_rows(self, held: Mapping[str, Sequence[str]] | None = None) -> Array:
        """Return the rates of all held components, or of given components by name, per unit of all twists."""
        result = [np.zeros((0, self.size))]
        for joint in self.scene.terms_of(Constraint):
            result.append(self.rows(joint, joint.held if held is None else tuple(held[joint.name])))
        return np.vstack(result)

    def driven_rows(self, rates: Mapping[str, float]) -> tuple[Array, Array]:
        """Return the rates of driven components per unit of all twists, (drives, size), and their values, (drives,).

        Args:
            rates: rates of the inputs that drives follow, by name; 0 for others.
        """
        joints, driven = self.scene.constraints, self.scene.terms_of(PrescribedMotion)
        rows = [np.zeros((0, self.size))]
        rows += [self.rows(joints[term.constraint], (term.component,)) for term in driven]
        return np.vstack(rows), np.array([starting_speed(term, rates) for term in driven])

    def gaps(self, joint: Constraint, components: Sequence[str], twists: Array) -> Array:
        """Evaluate components of a constraint's measure after finite motions of all bodies, (size,)."""
        return joint.measure.evaluate(self._states(joint, twists))[0][joint.rows(tuple(components))]

    def _states(self, joint: Constraint, twists: Array) -> dict[str, RigidState]:
        """Return the states of a joint's bodies after finite motions of all bodies, (size,)."""
        moved = {name: twists[self.places[name]] for name in joint.measure.bodies if name in self.places}
        return {name: RigidState(self.scene.body(name), moved.get(name, np.zeros(6))) for name in joint.measure.bodies}


def starting_speed(term: PrescribedMotion, rates: Mapping[str, float]) -> float:
    """Return the speed at which a drive starts, under given rates of inputs by name; a servo starts at rest."""
    return term.speed + (rates.get(term.input, 0.0) if np.isinf(term.bandwidth) else 0.0)


def rigid_mass(body: Body) -> Array:
    """Return the mass matrix of a rigid body's twist, (6, 6)."""
    mass, center, inertia = body.rigid_inertia
    to_center = rigid_transfer(center)
    return to_center.T @ scipy.linalg.block_diag(mass * np.eye(3), inertia) @ to_center


def null_space(rows: Array) -> Array:
    """Return the motions, (n, k), that rows, (m, n), of any size leave."""
    if not len(rows):
        return np.eye(rows.shape[1])
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    return scipy.linalg.null_space(rows / np.where(sizes > 0, sizes, 1.0), rcond=1e-9)
