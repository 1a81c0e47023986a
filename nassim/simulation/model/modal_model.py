"""Modal model of a scene: matrices in the minimal coordinates that the constraints leave, and its undamped modes."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from nassim.base.checks import Array
from nassim.base.modal import elastic_damping_ratios
from nassim.bodies.strain import strain_eigenmodes
from nassim.simulation.model.constraints import Constraints
from nassim.simulation.model.damping import Damping
from nassim.simulation.model.structure import Structure
from nassim.simulation.model.unsupported_modes import unsupported_modes


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
        mass, strain = basis.T @ coordinates.mass @ basis, structure.strain.within(basis)
        frequency, shapes = strain_eigenmodes(strain, mass)
        damping = Damping(
            mass,
            frequency,
            shapes,
            elastic_damping_ratios(frequency, coordinates.scene.mode_ratios),
            structure.deformation @ basis,
            structure.root,
            structure.own,
            basis.T @ structure.dampers @ basis,
        )
        unsupported = unsupported_modes(coordinates.scene, valid, structure.strains, frequency, basis @ shapes)
        return cls(basis, mass, strain.stiffness, frequency, shapes, damping, unsupported)

    @cached_property
    def modes(self) -> Array:
        """Eigenmodes in all coordinates, (n_all, n)."""
        return self.basis @ self.shapes

    @property
    def rigid_modes(self) -> Array:
        """Whether each mode is a rigid-body mode, which strains no body and no spring, bool (n,)."""
        result: Array = self.frequency == 0
        return result
