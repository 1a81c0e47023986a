"""Equilibrium at rest with the stiffness that the loads add: how far a scene deflects under them.

To first order in the loads, a scene deflects as its own stiffness lets it. A column at half of its buckling load
deflects twice as far under a force across it, because the load along it acts on what it has deflected.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from nassim.base.checks import Array
from nassim.bodies.stress_stiffness import GeometricTerms
from nassim.simulation.loaded.body_stress import deformation, deformation_rows, on_deformation
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.prescribed_motion import SUM_ROUNDING


@dataclass(frozen=True)
class LoadedStiffness:
    """Stiffness that loads add to a scene.

    Attributes:
        assembly: the assembled scene.
        parts: stiffness of forces on bodies, joints and springs, (n_all, n_all) each.
        terms: geometric stiffness of the bodies, by name.
    """

    assembly: Assembly
    parts: Sequence[Array]
    terms: Mapping[str, GeometricTerms]

    @cached_property
    def inside(self) -> dict[str, Array]:
        """Stiffness of the stress on the coordinates of each body, by name, (n, n)."""
        bodies = {body.name: body.reduced for body in self.assembly.scene.deformable_bodies}
        return {name: own.added_to(bodies[name].strain) for name, own in self.terms.items()}

    @cached_property
    def _all_parts(self) -> list[Array]:
        of_bodies = np.zeros((self.assembly.coordinates.size,) * 2)
        for name, own in self.inside.items():
            place = self.assembly.coordinates.slices[name]
            of_bodies[place, place] = on_deformation(self.assembly, name, own)
        return [*self.parts, of_bodies]

    @property
    def on_all(self) -> Array:
        """Stiffness on all coordinates, (n_all, n_all)."""
        return np.sum(self._all_parts, axis=0)

    @cached_property
    def on_modes(self) -> Array:
        """Stiffness on the modal amplitudes, (n, n), without what rounding leaves of the sum."""
        modes = self.assembly.modal.modes
        added: Array = modes.T @ sum(self._all_parts) @ modes
        sizes = np.abs(modes).T @ sum(map(np.abs, self._all_parts)) @ np.abs(modes)
        added[np.abs(added) < SUM_ROUNDING * sizes] = 0.0
        return added

    def with_shapes(self, terms: Mapping[str, GeometricTerms]) -> "LoadedStiffness":
        """Return the stiffness with the change of shape of other terms, by name of the body."""
        changed = {name: replace(self.terms[name], shape=own.shape) for name, own in terms.items()}
        return replace(self, terms={**self.terms, **changed})


@dataclass(frozen=True)
class Deflection:
    """Equilibrium of a scene under its loads, with the stiffness that they add.

    A body resists it by its own stiffness and by the stiffness of its stress. The latter counts by half up to the
    equilibrium of first order, as the stress grows with the deformation, and whole beyond it. Stress that is only
    estimated does not count.

    Attributes:
        stiffness: what the loads add to the stiffness, about the equilibrium of first order.
        first: displacement of first order in all coordinates, (n_all,).
        beyond: amplitudes beyond it, (n,).
        resisted: forces on the modes with which the scene without loads resists `beyond`, (n,).
        at_once: stiffness of the stress that counts whole from the start, by body, (n_own, n_own): that of voltages.
    """

    stiffness: LoadedStiffness
    first: Array
    beyond: Array
    resisted: Array
    at_once: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def of_first_order(cls, stiffness: LoadedStiffness, first: Array) -> "Deflection":
        """Make the equilibrium of first order."""
        none = np.zeros(stiffness.assembly.modal.modes.shape[1])
        return cls(stiffness, first, none, none)

    @classmethod
    def of(
        cls,
        stiffness: LoadedStiffness,
        first: Array,
        farther: Array,
        at_once: Mapping[str, Array],
    ) -> "Deflection":
        """Compute the equilibrium at rest.

        It is that of first order where the loads make it unstable, and where a motion is free without them.

        Args:
            stiffness: what the loads add to the stiffness, to first order.
            first: displacement of first order in all coordinates, (n_all,).
            farther: forces by which joints, springs and weights drive the scene farther there, (n_all,).
            at_once: stiffness of the stress that counts whole from the start, by body, (n_own, n_own).
        """
        start, assembly = replace(cls.of_first_order(stiffness, first), at_once=at_once), stiffness.assembly
        modes = assembly.modal.modes
        resisting = assembly.signals.discharged(np.diag(assembly.modal.omega**2), modes)
        whole = resisting + stiffness.on_modes
        if np.any(assembly.modal.rigid_modes) or np.linalg.eigvalsh(0.5 * (whole + whole.T)).min(initial=1.0) <= 0:
            return start
        pushed = farther.copy()
        for name in stiffness.terms:
            pushed[assembly.coordinates.slices[name]] -= deformation_rows(assembly, name).T @ start.stress_force(name)
        beyond = np.linalg.solve(whole, modes.T @ pushed)
        return replace(start, beyond=beyond, resisted=resisting @ beyond)

    @property
    def displacement(self) -> Array:
        """Displacement in the equilibrium in all coordinates, (n_all,)."""
        return self.first + self.stiffness.assembly.modal.modes @ self.beyond

    def stress_force(self, name: str) -> Array:
        """Return the forces with which the stress of a body resists its deformation, on its coordinates, (n,)."""
        early = 0.5 * deformation(self.stiffness.assembly, name, self.first)
        result: Array = self.stiffness.inside[name] @ self._counted(name)
        if name in self.at_once:
            result = result + self.at_once[name] @ early
        return result

    def strained_beside(self, name: str) -> Array:
        """Return the coordinates that strain a body in the equilibrium beside its deformation, (n,)."""
        (body,) = (body for body in self.stiffness.assembly.scene.deformable_bodies if body.name == name)
        return self.stiffness.terms[name].strained_beside(body.reduced.strain) @ self._counted(name)

    def _counted(self, name: str) -> Array:
        assembly = self.stiffness.assembly
        return deformation(assembly, name, self.displacement) - 0.5 * deformation(assembly, name, self.first)
