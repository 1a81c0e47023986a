"""Damping of an assembled scene: of its modes, its bodies and its dampers, in one class that every engine uses."""

from dataclasses import dataclass, replace

import numpy as np

from nassim.base.checks import Array
from nassim.base.modal import elastic_damping_ratios, modal_damping_matrix
from nassim.base.short_repr import short_repr
from nassim.base.warning_log import warn
from nassim.bodies.floating_frames import FloatingFrame
from nassim.scene.bodies import FlexibleBody
from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint, ForceLaw

LOST_DAMPING = 0.01
"""Share of a mode's damping above whose loss a warning is given."""
DAMPING_ROUNDING = 1e-9
"""Share of the largest possible damping of a mode that is rounding."""


@dataclass(frozen=True)
class Damping:
    """Damping of a scene in its minimal coordinates, (n,).

    Attributes:
        frequency: frequencies of the undamped modes, (n,) [Hz].
        shapes: mode shapes, (n, n), unit modal mass.
        ratio: damping ratio that the scene gives each mode, 0 for rigid-body modes, (n,) [-].
        deformation: deformation D of all bodies that deform, in order, per unit of the minimal coordinates, (m, n).
        root: matrix that scales the deformation to comparable energies, (m, m).
        own: the bodies' own damping, on their deformation, the same in every position, (m, m).
        dampers: damping matrix of spring-dampers and other dampers, (n, n).
    """

    frequency: Array
    shapes: Array
    ratio: Array
    deformation: Array
    root: Array
    own: Array
    dampers: Array
    __repr__ = short_repr

    @property
    def non_modal(self) -> Array:
        """Non-modal damping: the bodies' own damping and dampers, (n, n)."""
        return self.deformation.T @ self.own @ self.deformation + self.dampers

    @property
    def of_modes(self) -> Array:
        """The damping matrix in the modes' amplitudes, (n, n) [1/s]; exactly 0 for undamped modes.

        For rigid-body motion that moves no damper, rounding would else make poles that creep and couple to others.
        """
        matrix, amplitudes = self.non_modal, np.abs(self.shapes)
        non_modal = self.shapes.T @ matrix @ self.shapes
        size = np.sqrt(np.einsum("ij,ij->j", amplitudes, np.abs(matrix) @ amplitudes))
        damped = np.any(np.abs(non_modal) > DAMPING_ROUNDING * np.outer(size, size), axis=1)
        return np.diag(4 * np.pi * self.ratio * self.frequency) + non_modal * np.outer(damped, damped)

    def on_deformation(self) -> Array:
        """Return all damping except dampers as a damping matrix on the deformation of the bodies, (m, m).

        With the deformation B of modes of amplitude 1 / sqrt(omega), the modal damping becomes the damping
        C_f = B^+T diag(2 zeta) B^+ of the deformation. In the reference configuration this is exact where bodies alone
        deform, because B then has an inverse. Where springs deform too, no mode gets more than the largest ratio,
        because B^+ B is a projection. Modes in which springs deform lose damping; a warning reports it.
        """
        elastic = self.frequency > 0
        shapes = self.shapes[:, elastic] / np.sqrt(2 * np.pi * self.frequency[elastic])
        # Coordinates in metres, radians and modal units, hence the scale before the pseudo-inverse.
        inverse = np.linalg.pinv(self.root @ self.deformation @ shapes, rcond=1e-9) @ self.root
        modal = (inverse.T * (2 * self.ratio[elastic])) @ inverse
        self._warn_of_loss(self.deformation.T @ modal @ self.deformation)
        return self.own + modal

    @property
    def of_deformation(self) -> "Damping":
        """The same damping with the modal ratios realised as a damping of the deformation, see `on_deformation`."""
        return replace(self, ratio=np.zeros_like(self.ratio), own=self.on_deformation())

    def _warn_of_loss(self, realised: Array) -> None:
        """Warn of modes that a damping matrix in minimal coordinates, (n, n), damps less than required."""
        wanted = 4 * np.pi * self.ratio * self.frequency
        lost = wanted - np.einsum("ik,ij,jk->k", self.shapes, realised, self.shapes)
        modes = (lost > LOST_DAMPING * wanted) & (self.frequency > 0)
        if modes.any():
            listed = ", ".join(f"{f:.4g}" for f in self.frequency[modes][:5])
            warn(
                f"damping_ratio acts through deformation only, so the modes at {listed} Hz, in which springs rather "
                "than bodies deform, lose damping in this simulation: give the spring-dampers a damping of their own "
                "and such modes a ratio of 0"
            )


def damps(law: ForceLaw) -> bool:
    """Whether a force law resists rates."""
    still = np.zeros(len(law.measure.components))
    return bool(np.any(law.tangents(still, still)[1]))


def held_alone(scene: Scene, body: FlexibleBody) -> tuple[str, ...]:
    """Return the remote points that are clamped in the modes to which a body's own damping ratio belongs.

    The frame's point is clamped where a joint holds it: the damping of a clamped bar, stated for free modes, would give
    its lowest mode a sixth. A body that no joint holds there, on springs too, is free, so that the choice of the
    frame's point has no effect.
    """
    point = scene.frame_point(body)
    joined = [path for measure in scene.measures_of(Constraint) for path in measure.points]
    return (point,) if f"{body.name}.{point}" in joined else ()


def own_damping(scene: Scene, body: FlexibleBody, frame: FloatingFrame) -> Array:
    """Return a body's own damping on its m coordinates of deformation, (m, m), positive semidefinite."""
    m = len(frame.flexible)
    reduced, chosen = body.reduced, np.ix_(frame.flexible, frame.flexible)
    damping = np.zeros((m, m)) if reduced.damping_matrix is None else reduced.damping_matrix[chosen]
    if body.damping_ratio is None:
        return damping
    frequency, shapes = reduced.eigenmodes(fixed=held_alone(scene, body))
    ratio = elastic_damping_ratios(frequency, body.damping_ratio)
    return damping + modal_damping_matrix(reduced.mass_matrix, frequency, shapes, ratio)[chosen]
