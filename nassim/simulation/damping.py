"""Damping of an assembled scene: one noun that every engine reads."""

import warnings
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array
from nassim.base.modal import modal_damping_matrix

LOST_DAMPING = 0.01
"""Share of a mode's damping whose loss is worth a warning."""


@dataclass(frozen=True)
class Damping:
    """What damps a scene in its minimal coordinates, (n,).

    mass: (n, n); frequency: of the undamped modes, (n,) [Hz]; shapes: (n, n), unit modal mass
    ratio: damping ratio of each mode, 0 for free motions, (n,) [-]
    dampers: of spring-dampers and the like, beside modal damping, (n, n)
    """

    mass: Array
    frequency: Array
    shapes: Array
    ratio: Array
    dampers: Array

    @property
    def modal(self) -> Array:
        """The part that gives each mode its ratio, (n, n)."""
        return modal_damping_matrix(self.mass, self.frequency, self.shapes, self.ratio)

    @property
    def matrix(self) -> Array:
        """The damping matrix, (n, n)."""
        return self.modal + self.dampers

    @property
    def of_modes(self) -> Array:
        """The damping matrix in the modes' amplitudes, (n, n) [1/s]."""
        result: Array = np.diag(4 * np.pi * self.ratio * self.frequency) + self.shapes.T @ self.dampers @ self.shapes
        return result

    def through(self, deformation: Array, root: Array) -> Array:
        """The modal part as a damping matrix C_f on m coordinates of deformation, (m, m).

        deformation: D, these per unit of the minimal coordinates, (m, n)
        root: scales them to comparable energy, (m, m)

        D^T C_f D is the modal damping for C_f = D^+T C D^+: exact where motion without deformation has no damped mode.
        Modes of bodies that only springs hold lose damping, of which a warning tells.
        """
        # Coordinates in metres, radians and modal units, hence the scale before the pseudo-inverse.
        inverse = np.linalg.pinv(root @ deformation, rcond=1e-9) @ root
        result: Array = inverse.T @ self.modal @ inverse
        self._warn_of_loss(deformation.T @ result @ deformation)
        return result

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
