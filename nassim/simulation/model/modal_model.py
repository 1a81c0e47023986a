"""Modal model of a scene: strains and damping in all coordinates, and the undamped modes that constraints leave."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.modal import elastic_damping_ratios
from nassim.bodies.readouts import sparse_if_faster
from nassim.bodies.strain import Strain, combine_strains, spring_strain, stiffness_root, strain_eigenmodes
from nassim.scene.scene import Scene
from nassim.simulation.model.constraints import Constraints
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.damping import Damping, own_damping
from nassim.simulation.model.tangents import Tangent

UNSUPPORTED_SHARE = 0.5
"""Share of its strain energy in bodies that lack modes at its frequency, above which a mode is unsupported."""


@dataclass(frozen=True)
class Structure:
    """Strains and damping of bodies and force laws in all coordinates.

    Attributes:
        of_bodies: strains of the bodies, by name.
        of_laws: strains of the force laws.
        dampers: damping matrix of the force laws, (n_all, n_all).
        deformation: deformation of all bodies that deform, in order, per unit of all coordinates, (m, n_all).
        root: matrix that scales the deformation to comparable energies, (m, m).
        own: the bodies' own damping, on their deformation, (m, m).
    """

    of_bodies: Mapping[str, Strain]
    of_laws: tuple[Strain, ...]
    dampers: Array
    deformation: Array
    root: Array
    own: Array

    @classmethod
    def of(cls, coordinates: Coordinates, tangents: Sequence[Tangent]) -> "Structure":
        """Collect the structure of a scene whose force laws have given tangents."""
        of_bodies = {
            body.name: body.strain.within(coordinates.of_body(body.name))
            for body in coordinates.scene.bodies
            if body.moves and body.strain is not None
        }
        of_laws: list[Strain] = []
        dampers = np.zeros_like(coordinates.mass)
        for tangent in tangents:
            rows, (sizes, directions) = tangent.rows, np.linalg.eigh(tangent.stiffness)
            rounding = len(sizes) * np.finfo(float).eps * np.abs(sizes).max()
            sizes = np.where(sizes > rounding, sizes, 0.0)  # motions without resistance remain free
            of_laws += [spring_strain(d @ rows, k, coordinates.mass) for k, d in zip(sizes, directions.T, strict=True)]
            dampers += rows.T @ tangent.damping @ rows
        deformation, roots, own = [np.zeros((0, coordinates.size))], [np.zeros((0, 0))], [np.zeros((0, 0))]
        for body in coordinates.scene.deformable_bodies:
            frame, n_points = coordinates.frames[body.name], 6 * len(body.reduced.remote_points) - 6
            deformation.append(frame.deformation(body.reduced) @ coordinates.of_body(body.name))
            roots.append(stiffness_root(frame.stiffness_matrix, n_points=n_points)[1])
            own.append(own_damping(coordinates.scene, body, frame))
        block_diagonal = scipy.linalg.block_diag
        return cls(
            of_bodies, tuple(of_laws), dampers, np.vstack(deformation), block_diagonal(*roots), block_diagonal(*own)
        )

    @cached_property
    def strain(self) -> Strain:
        """All strains as one."""
        return combine_strains((*self.of_bodies.values(), *self.of_laws), len(self.dampers))

    def damping_forces(self, rates: Array) -> Array:
        """Compute the forces of dampers and of the bodies' own damping, (n_all, k), at rates (n_all, k)."""
        return self.deformation.T @ (self.own @ (self.deformation @ rates)) + self.dampers @ rates


@dataclass(frozen=True)
class ModalModel:
    """Small motion of a scene in n minimal coordinates, and its undamped modes.

    Attributes:
        basis: all coordinates per unit of the minimal coordinates, (n_all, n), see `Constraints.basis`.
        mass: mass matrix, (n, n).
        stiffness: stiffness matrix, (n, n).
        frequency: eigenfrequencies, ascending, exactly 0 for rigid-body modes only, (n,) [Hz].
        shapes: eigenmodes in minimal coordinates, (n, n), unit modal mass.
        damping: damping of the modes, of bodies and of dampers.
        unsupported: modes beyond the valid frequency of the bodies' reductions, quasi-static in sampled models, bool
            (n,).
    """

    basis: Array
    mass: Array
    stiffness: Array
    frequency: Array
    shapes: Array
    damping: Damping
    unsupported: Array

    @classmethod
    def of(cls, constraints: Constraints, structure: Structure, valid: Mapping[str, float]) -> "ModalModel":
        """Find the undamped modes of a scene.

        Args:
            constraints: constraints of the scene.
            structure: strains and damping of the scene.
            valid: frequency up to which each flexible body has all modes, by name [Hz].

        Returns:
            The modal model.
        """
        coordinates, basis = constraints.coordinates, constraints.basis
        factor = sparse_if_faster(basis)
        mass, strain = factor.T @ coordinates.mass @ factor, structure.strain.within(basis)
        frequency, shapes = strain_eigenmodes(strain, mass)
        damping = Damping(
            frequency=frequency,
            shapes=shapes,
            ratio=elastic_damping_ratios(frequency, coordinates.scene.mode_ratios),
            deformation=structure.deformation @ factor,
            root=structure.root,
            own=structure.own,
            dampers=factor.T @ structure.dampers @ factor,
        )
        unsupported = _unsupported_modes(coordinates.scene, valid, structure.of_bodies, frequency, basis @ shapes)
        return cls(basis, mass, strain.stiffness, frequency, shapes, damping, unsupported)

    @cached_property
    def modes(self) -> Array:
        """Eigenmodes in all coordinates, (n_all, n)."""
        return self.basis @ self.shapes

    @cached_property
    def omega(self) -> Array:
        """Angular eigenfrequencies, (n,) [rad/s]."""
        return 2 * np.pi * self.frequency

    @property
    def rigid_modes(self) -> Array:
        """Whether each mode is a rigid-body mode, which strains no body and no spring, bool (n,)."""
        return self.frequency == 0


def _unsupported_modes(
    scene: Scene, valid: Mapping[str, float], strains: Mapping[str, Strain], frequency: Array, modes: Array
) -> Array:
    """Find the modes with most strain energy in bodies beyond their valid frequencies, or above the scene's limit.

    Args:
        scene: the scene.
        valid: frequency up to which each flexible body has all modes, by name [Hz].
        strains: strains of the bodies, by name.
        frequency: frequencies of the modes, (n,) [Hz].
        modes: the modes in all coordinates, (n_all, n).

    Returns:
        Whether each mode is unsupported, bool (n,).
    """
    if scene.quasi_static_above is not None:
        return frequency > scene.quasi_static_above
    energy = np.zeros(len(frequency))
    for name, limit in valid.items():
        if name in strains:
            energy += (frequency > limit) * np.sum((strains[name].root @ modes) ** 2, axis=0)
    return energy > UNSUPPORTED_SHARE * (2 * np.pi * frequency) ** 2
