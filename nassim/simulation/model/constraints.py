"""Constraints in small motion: rows that vanish, rows that drives prescribe, and the motions that remain."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.scene.terms import Constraint, PrescribedMotion
from nassim.simulation.model.coordinates import Coordinates

REDUNDANT = 1e-7
"""Share of its own size below which the independent part of a constraint is rounding: other constraints imply it."""


@dataclass(frozen=True)
class Constraints:
    """Independent constraints of a scene: rows @ q = driven @ u, with u the motions of d drives that follow inputs.

    Small motion is about the state of the drives, whose joints' motions are held.

    Attributes:
        coordinates: coordinates q of the scene.
        rows: rows of bodies that do not deform, then of joints and drives, (m, n_all).
        driven: values of the rows per unit of the drives' motions, (m, d).
        enforced: components that each joint holds, by name, without those that earlier rows imply.
    """

    coordinates: Coordinates
    rows: Array
    driven: Array
    enforced: dict[str, tuple[str, ...]]

    @classmethod
    def of(cls, coordinates: Coordinates) -> "Constraints":
        """Collect the constraints of a scene, without those that earlier ones imply.

        Args:
            coordinates: coordinates of the scene.

        Returns:
            The constraints.

        Raises:
            ValueError: for a drive whose motion other joints or drives hold.
        """
        scene, drives = coordinates.scene, coordinates.scene.prescribed
        joints = scene.constraints
        wanted: list[tuple[Constraint, str, PrescribedMotion | None]]
        wanted = [(joint, component, None) for joint in joints.values() for component in joint.held]
        wanted += [(joints[drive.constraint], drive.component, drive) for drive in scene.terms_of(PrescribedMotion)]
        all_rows = {name: coordinates.jacobian(joint.measure) for name, joint in joints.items()}
        rigid, scale = undeformed_rows(coordinates), 1.0 / coordinates.scale
        basis = np.zeros((len(rigid) + len(wanted), coordinates.size))
        n = 0
        if len(rigid):  # SciPy before 1.14 takes no empty matrix
            found = scipy.linalg.orth((rigid * scale).T).T
            n = len(found)
            basis[:n] = found
        kept, driven = [rigid], [np.zeros((len(rigid), len(drives)))]
        enforced: dict[str, tuple[str, ...]] = {name: () for name in joints}
        for joint, component, drive in wanted:
            (row,) = all_rows[joint.name][joint.rows((component,))]
            rest = row * scale
            size = np.linalg.norm(rest)
            for _ in range(2):  # two passes orthogonalise to the last digit
                rest = rest - (basis[:n] @ rest) @ basis[:n]
            if np.linalg.norm(rest) > REDUNDANT * size:
                basis[n] = rest / np.linalg.norm(rest)
                n += 1
                kept.append(row[None])
                driven.append(np.array([[float(other is drive) for other in drives]]).reshape(1, -1))
                enforced[joint.name] += (component,)
            elif drive is not None:
                raise ValueError(
                    f"{component} of joint {joint.name!r} cannot be driven: other joints or drives hold it already"
                )
        return cls(coordinates, np.vstack(kept), np.vstack(driven), enforced)

    def moved_to(self, coordinates: Coordinates) -> "Constraints":
        """Evaluate the same constraints in another configuration.

        Those that are implied here remain left out: after a small motion of first order, rounding would tell them
        apart.
        """
        kept = self.kept
        all_rows = {joint.name: coordinates.jacobian(joint.measure) for joint, _ in kept}
        rows = [all_rows[joint.name][joint.rows((component,))] for joint, component in kept]
        return replace(self, coordinates=coordinates, rows=np.vstack([self.rows[: len(self.rows) - len(kept)], *rows]))

    @property
    def kept(self) -> list[tuple[Constraint, str]]:
        """Joint and component of each row, after those of bodies that do not deform."""
        joints = self.coordinates.scene.constraints
        kept = [(joints[name], c) for name, own in self.enforced.items() for c in own if c in joints[name].held]
        drives = self.coordinates.scene.terms_of(PrescribedMotion)
        return kept + [(joints[drive.constraint], drive.component) for drive in drives]

    def closing(self) -> Array:
        """Return the smallest motion, (n_all,), that closes the gaps of joints."""
        kept, states = self.kept, self.coordinates.states
        values = {joint.name: joint.measure.evaluate(states)[0] for joint, _ in kept}
        gaps = [values[joint.name][joint.rows((component,))][0] for joint, component in kept]
        scaled = self.rows / self.coordinates.scale
        sizes = np.linalg.norm(scaled, axis=1)
        padded = np.concatenate([np.zeros(len(self.rows) - len(gaps)), gaps])
        found = np.linalg.lstsq(scaled / sizes[:, None], padded / sizes, rcond=1e-9)[0]
        return -found / self.coordinates.scale

    @cached_property
    def basis(self) -> Array:
        """Motions with the drives at rest: all coordinates per unit of the n minimal ones, (n_all, n)."""
        if len(self.rows) == 0:
            return np.eye(self.coordinates.size)
        # The scale turns metres, radians and modal amplitudes into comparable square roots of energy.
        scale = 1.0 / self.coordinates.scale
        scaled = self.rows * scale
        scaled = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
        return scale[:, None] * scipy.linalg.null_space(scaled, rcond=1e-9)


def undeformed_rows(coordinates: Coordinates) -> Array:
    """Return rows that vanish while the bodies of fidelity "rigid" do not deform, (m, n_all)."""
    rows = [np.zeros((0, coordinates.size))]
    for body in coordinates.scene.flexible_bodies:
        if not body.deforms:
            deformation = coordinates.frames[body.name].deformation(body.reduced)
            rows.append(deformation @ coordinates.of_body(body.name))
    return np.vstack(rows)
