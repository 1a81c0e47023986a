"""Structure of a scene: strains and damping of bodies and force laws in all coordinates, without constraints."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.bodies.strain import Strain, combine_strains, spring_strain, stiffness_root
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.damping import own_damping
from nassim.simulation.model.tangents import Tangent


@dataclass(frozen=True)
class Structure:
    """Strains and damping of bodies and force laws in all coordinates.

    Attributes:
        strains: strains of the bodies, then of the force laws.
        dampers: damping matrix of the force laws, (n_all, n_all).
        deformation: deformation of all bodies that deform, in order, per unit of all coordinates, (m, n_all).
        root: matrix that scales the deformation to comparable energies, (m, m).
        own: the bodies' own damping, on their deformation, (m, m).
    """

    strains: tuple[Strain, ...]
    dampers: Array
    deformation: Array
    root: Array
    own: Array

    @classmethod
    def of(cls, coordinates: Coordinates, tangents: Sequence[Tangent]) -> "Structure":
        """Collect the structure of a scene whose force laws have given tangents."""
        strains = [
            body.strain.within(coordinates.of_body(body.name))
            for body in coordinates.scene.bodies
            if body.moves and body.strain is not None
        ]
        dampers = np.zeros_like(coordinates.mass)
        for tangent in tangents:
            rows, (sizes, directions) = tangent.rows, np.linalg.eigh(tangent.stiffness)
            strains += [spring_strain(d @ rows, k, coordinates.mass) for k, d in zip(sizes, directions.T, strict=True)]
            dampers += rows.T @ tangent.damping @ rows
        deformation, roots, own = [np.zeros((0, coordinates.size))], [np.zeros((0, 0))], [np.zeros((0, 0))]
        for body in coordinates.scene.deformable_bodies:
            frame, n_points = coordinates.frames[body.name], 6 * len(body.reduced.remote_points) - 6
            deformation.append(frame.deformation(body.reduced) @ coordinates.of_body(body.name))
            roots.append(stiffness_root(frame.stiffness_matrix, n_points=n_points)[1])
            own.append(own_damping(coordinates.scene, body, frame))
        block_diagonal = scipy.linalg.block_diag
        return cls(tuple(strains), dampers, np.vstack(deformation), block_diagonal(*roots), block_diagonal(*own))

    @cached_property
    def strain(self) -> Strain:
        """All strains as one."""
        return combine_strains(self.strains, len(self.dampers))

    def damping_forces(self, rates: Array) -> Array:
        """Compute the forces of dampers and of the bodies' own damping, (n_all, k), at rates (n_all, k)."""
        result: Array = self.deformation.T @ (self.own @ (self.deformation @ rates)) + self.dampers @ rates
        return result
