"""Quantities that a tolerance applies to, and their errors by element.

They are the first eigenfrequencies, the static stiffnesses at the remote points, and the responses to the electrical
ports. Each one is decided by the energy of one displacement shape, of which `mesh_error` tells how much a higher order
would release in each element, and `geometry_error` the effect of mesh faces that differ from the CAD.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg

from nassim.base.checks import Array
from nassim.base.modal import eigenmodes
from nassim.base.rigid_motion import DIRECTIONS
from nassim.bodies.reduced_body import relative_errors, unknown_from_first
from nassim.fem.condensation import Condensation
from nassim.fem.geometry_error import restored_energies
from nassim.fem.mesh_error import ReleasedEnergy, released_energy
from nassim.fem.modes import fixed_interface_modes, largest_n_modes, mass_operator
from nassim.fem.native_threads import blas_threads

EXTRA_MODES = 3
"""Fixed-interface modes of the basis beyond the number of frequencies."""


@dataclass(frozen=True)
class MeshTargets:
    """Quantities that must be right, and the shapes whose energies decide their errors.

    Attributes:
        labels: descriptions for messages, of length t
        values: angular frequencies and stiffnesses, with the faces of the CAD to first order, shape (t,)
        powers: exponents of the energy in the values, 0.5 for a frequency and 1 for a stiffness, shape (t,)
        shares: released share of each shape's energy by element, shape (n_elements, t)
        sequences: places of ascending frequencies under one condition
        geometry: relative changes of the values by mesh faces that differ from the CAD, shape (t,)
    """

    labels: list[str]
    values: Array
    powers: Array
    shares: Array
    sequences: list[slice]
    geometry: Array | float = 0.0

    def errors(self) -> Array:
        """Return the estimated relative errors of the elements, shape (t,); inf if only known to be above 50 %."""
        result = relative_errors(self.shares.sum(axis=0), power=self.powers)
        for frequencies in self.sequences:
            result[frequencies] = unknown_from_first(result[frequencies])
        return result


@dataclass(frozen=True)
class MeshTarget:
    """A quantity that must be right.

    Attributes:
        label: description for messages
        value: a quantity that every error increases: angular frequency or stiffness
        power: exponent of the energy in the quantity, 0.5 for a frequency and 1 for a stiffness
        shape: combination of the shapes of a `TargetBasis` with unit energy
    """

    label: str
    value: float
    power: float
    shape: Array


@dataclass(frozen=True)
class TargetBasis:
    """Displacement shapes of which the targets are combinations.

    The shapes are the constraint modes of the remote points, the first fixed-interface modes, and the responses to one
    volt at each electrical port with all remote points fixed.

    Attributes:
        condensed: static condensation
        mass: mass matrix of constraint modes and fixed-interface modes
        stiffness: stiffness matrix of all shapes
        displacements: the shapes, shape (n_dofs, k)
        released: energy that a higher order would release in the shapes
    """

    condensed: Condensation
    mass: Array
    stiffness: Array
    displacements: Array
    released: ReleasedEnergy

    @staticmethod
    def of(condensed: Condensation, n_modes: int) -> "TargetBasis":
        """Compute the basis of an FE model."""
        model, static = condensed.fe_model, condensed.constraint_modes
        n_modes = min(n_modes, largest_n_modes(condensed))
        frequency, modes = fixed_interface_modes(condensed, n_modes=n_modes)
        ports = np.column_stack([np.zeros((model.n_dofs, 0)), *(port.forces for port in model.ports)])
        responses = condensed.solve_fixed(ports)
        held = np.hstack([modes, responses])
        shapes = np.hstack([static, held])
        accelerations = np.zeros_like(shapes)
        nb, n = static.shape[1], static.shape[1] + n_modes
        accelerations[:, nb:n] = modes * (2 * np.pi * frequency) ** 2
        voltages = np.eye(len(model.ports), shapes.shape[1], n)
        with blas_threads(model.n_dofs * n**2):
            mass = shapes[:, :n].T @ (mass_operator(model) @ shapes[:, :n])
            # Modes K phi = omega^2 M phi and responses K s = f, both with the remote points fixed.
            inner = np.hstack([np.vstack([np.diag((2 * np.pi * frequency) ** 2), ports.T @ modes]), held.T @ ports])
            stiffness = scipy.linalg.block_diag(condensed.stiffness, inner)
        released = released_energy(condensed, shapes, accelerations=accelerations, voltages=voltages)
        return TargetBasis(condensed, 0.5 * (mass + mass.T), 0.5 * (stiffness + stiffness.T), shapes, released)

    def frequencies(self, fixed: Collection[str], n: int) -> list[MeshTarget]:
        """Return the first n elastic eigenfrequencies with some remote points fixed."""
        free = np.array([i for i in range(len(self.mass)) if self._point(i) not in fixed])
        square, vectors = eigenmodes(self.stiffness[np.ix_(free, free)], self.mass[np.ix_(free, free)])
        first = 0 if fixed else 6
        where = f"with {', '.join(map(repr, fixed))} fixed" if fixed else "of the free body"
        targets = []
        for k in range(first, min(first + n, len(square))):
            shape = np.zeros(len(self.stiffness))
            shape[free] = vectors[:, k]
            targets.append(self._target(f"frequency {k - first + 1} {where}", shape, power=0.5))
        return targets

    def static_responses(self) -> list[MeshTarget]:
        """Return the stiffnesses at each remote point but the first, which is fixed, and the responses to the ports."""
        n_points, names = len(self.condensed.stiffness), self.condensed.names
        flexibility = np.linalg.inv(self.condensed.stiffness[6:, 6:])
        targets = []
        for i, column in enumerate(flexibility.T):
            shape = np.zeros(len(self.stiffness))
            shape[6:n_points] = column
            label = f"stiffness along {list(DIRECTIONS)[i % 6]} at {names[1 + i // 6]!r} with {names[0]!r} fixed"
            targets.append(self._target(label, shape, power=1.0))
        for port, shape in zip(
            self.condensed.fe_model.ports, np.eye(len(self.stiffness))[len(self.mass) :], strict=True
        ):
            targets.append(self._target(f"charge of port {port.name!r} with all points fixed", shape, power=1.0))
            if len(names) > 1:
                stroke = shape.copy()
                stroke[6:n_points] = flexibility @ (port.forces @ self.condensed.constraint_modes)[6:]
                targets.append(self._target(f"stroke by port {port.name!r}", stroke, power=1.0))
        return targets

    def _point(self, coordinate: int) -> str | None:
        """Return the name of the remote point that has a coordinate."""
        return self.condensed.names[coordinate // 6] if coordinate < len(self.condensed.stiffness) else None

    def _target(self, label: str, shape: Array, *, power: float) -> MeshTarget:
        """Return the target that a shape decides."""
        energy = float(shape @ self.stiffness @ shape)
        # The energy of a mode of unit modal mass is a squared frequency, that of a unit load a compliance.
        return MeshTarget(label, energy**power if power < 1 else 1 / energy, power, shape / np.sqrt(energy))


def find_targets(
    condensed: Condensation, n: int, conditions: Sequence[tuple[str, ...]], restoring: Any = None
) -> MeshTargets:
    """Compute what a tolerance applies to, and its errors by element.

    Args:
        condensed: static condensation with all remote points
        n: number of elastic eigenfrequencies under each condition
        conditions: sets of fixed remote points
        restoring: displacements that would bring the faces of the mesh back to the CAD, see `Curving`
    """
    basis = TargetBasis.of(condensed, n + EXTRA_MODES)
    groups = [basis.frequencies(fixed, n) for fixed in conditions]
    found = [target for group in groups for target in group] + basis.static_responses()
    ends = np.cumsum([len(group) for group in groups]).tolist()
    shapes = np.column_stack([target.shape for target in found])
    values, powers = (np.array([getattr(target, name) for target in found]) for name in ("value", "power"))
    geometry = np.zeros(len(found))
    if restoring is not None:
        model, displacements, n = condensed.fe_model, basis.displacements @ shapes, len(basis.mass)
        squares = np.where(powers < 1, values**2, 0.0)
        forces = model.stiffness @ displacements - (mass_operator(model) @ displacements) * squares
        for port, voltages in zip(model.ports, shapes[n:], strict=True):
            forces -= np.outer(port.forces, voltages)
        motions = shapes[: len(condensed.stiffness)]
        geometry = powers * restored_energies(condensed, restoring, displacements, motions, forces, squares)
    return MeshTargets(
        [target.label for target in found],
        values * (1 + geometry),
        powers,
        basis.released.by_element(shapes),
        [slice(end - len(group), end) for group, end in zip(groups, ends, strict=True)],
        geometry,
    )
