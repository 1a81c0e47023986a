"""Damping of an assembled scene, of its modes, its bodies and its dampers: one noun that every engine reads."""

import warnings
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from nassim.base.checks import Array
from nassim.base.modal import elastic_damping_ratios, modal_damping_matrix
from nassim.bodies.floating_frame import FloatingFrame
from nassim.scene.bodies import FlexibleBody
from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint, ForceLaw

LOST_DAMPING = 0.01
"""Share of a mode's damping whose loss is worth a warning."""
ROUNDING = 1e-9
"""Share of what a mode's damping could add up to that is rounding."""


@dataclass(frozen=True)
class Damping:
    """What damps a scene in its minimal coordinates, (n,).

    mass: (n, n); frequency: of the undamped modes, (n,) [Hz]; shapes: (n, n), unit modal mass
    ratio: damping ratio that the scene gives each mode, 0 for free motions, (n,) [-]
    deformation: D, of all bodies that deform, in order, per unit of the minimal coordinates, (m, n)
    root: scales these to comparable energy, (m, m)
    own: what the bodies have of their own, on their deformation, the same in every position, (m, m)
    dampers: of spring-dampers and the like, (n, n)
    """

    mass: Array
    frequency: Array
    shapes: Array
    ratio: Array
    deformation: Array
    root: Array
    own: Array
    dampers: Array

    @property
    def beside(self) -> Array:
        """What damps beside the scene's ratios: the bodies' own and dampers, (n, n)."""
        result: Array = self.deformation.T @ self.own @ self.deformation + self.dampers
        return result

    @property
    def modal(self) -> Array:
        """The part that gives each mode its ratio, (n, n)."""
        return modal_damping_matrix(self.mass, self.frequency, self.shapes, self.ratio)

    @property
    def matrix(self) -> Array:
        """The damping matrix, (n, n)."""
        return self.modal + self.beside

    @property
    def of_modes(self) -> Array:
        """The damping matrix in the modes' amplitudes, (n, n) [1/s]; exactly 0 for modes that nothing damps.

        Of rigid-body motion that moves no damper, rounding would make poles that creep, and that couple to others.
        """
        beside = self.shapes.T @ self.beside @ self.shapes
        size = np.sqrt(np.diag(np.abs(self.shapes).T @ np.abs(self.beside) @ np.abs(self.shapes)))
        damped = np.any(np.abs(beside) > ROUNDING * np.outer(size, size), axis=1)
        result: Array = np.diag(4 * np.pi * self.ratio * self.frequency) + beside * np.outer(damped, damped)
        return result

    def on_deformation(self) -> Array:
        """All but dampers, as a damping matrix on the deformation of the bodies, (m, m).

        Of the modal part C that is C_f = D^+T C D^+, for which D^T C_f D = C: exact where motion without deformation
        has no damped mode, and as the scene is drawn. Modes of bodies that only springs hold lose damping, of which a
        warning tells.
        """
        # Coordinates in metres, radians and modal units, hence the scale before the pseudo-inverse.
        inverse = np.linalg.pinv(self.root @ self.deformation, rcond=1e-9) @ self.root
        modal = inverse.T @ self.modal @ inverse
        self._warn_of_loss(self.deformation.T @ modal @ self.deformation)
        return self.own + modal

    @property
    def of_deformation(self) -> "Damping":
        """The same with the modes' ratios made a damping of the deformation, see `on_deformation`."""
        return replace(self, ratio=np.zeros_like(self.ratio), own=self.on_deformation())

    def _warn_of_loss(self, realised: Array) -> None:
        """Warn of modes that a damping matrix in minimal coordinates, (n, n), damps less than they should be."""
        wanted = 4 * np.pi * self.ratio * self.frequency
        lost = wanted - np.einsum("ik,ij,jk->k", self.shapes, realised, self.shapes)
        modes = (lost > LOST_DAMPING * wanted) & (self.frequency > 0)
        if modes.any():
            listed = ", ".join(f"{f:.4g}" for f in self.frequency[modes][:5])
            warnings.warn(
                f"damping_ratio acts through deformation only, so the modes at {listed} Hz, in which springs rather "
                "than bodies deform, lose damping in this simulation: give the spring-dampers a damping of their own "
                "and such modes a ratio of 0",
                stacklevel=2,
            )


def tied_bodies(scene: Scene) -> tuple[tuple[str, str], ...]:
    """Every two moving bodies that a joint or a spring ties, whose position to each other shapes the scene's modes."""
    moving = {body.name for body in scene.bodies if body.moves}
    named = [sorted(moving & set(measure.bodies)) for measure in scene.measures_of(Constraint, ForceLaw)]
    return tuple(dict.fromkeys(pair for names in named for pair in combinations(names, 2)))


def damps(law: ForceLaw) -> bool:
    """Whether a force law resists rates."""
    still = np.zeros(len(law.measure.components))
    return bool(np.any(law.tangents(still, still)[1]))


def held_alone(scene: Scene, body: FlexibleBody) -> tuple[str, ...]:
    """Remote points that are clamped in the modes that a body's own damping ratio is of.

    That of its frame where a joint holds it: of a clamped bar, damping stated for free modes would give the lowest a
    sixth. A body that no joint holds there is free, so that it does not matter where its frame rides.
    """
    point = scene.frame_point(body)
    return (point,) if point in scene.held_points(body) else ()


def own_damping(scene: Scene, body: FlexibleBody, frame: FloatingFrame) -> Array:
    """A body's own damping on its m coordinates of deformation, (m, m), positive semidefinite."""
    m = len(frame.flexible)
    if body.damping_ratio is None:
        return np.zeros((m, m))
    frequency, shapes = body.reduced.eigenmodes(fixed=held_alone(scene, body))
    ratio = elastic_damping_ratios(frequency, body.damping_ratio)
    damping = modal_damping_matrix(body.reduced.mass_matrix, frequency, shapes, ratio)
    return damping[np.ix_(frame.flexible, frame.flexible)]
