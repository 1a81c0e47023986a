"""Effect of constant loads on small motion: stiffness, gyroscopic forces and equilibrium, in modal amplitudes."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from nassim.base.checks import Array, finite_array, freeze
from nassim.base.short_repr import short_repr


@dataclass(frozen=True)
class LoadedState:
    """Effect of constant loads on the n modal amplitudes of an assembly, of unit modal mass.

    With w the angular frequencies and D the damping of the modes without loads,
    a'' + (D + gyroscopic) a' + (w^2 + stiffness) a = force + other forces.

    Attributes:
        gyroscopic: 2 W G of a spin, (n, n), skew.
        stiffness: stiffness that the loads add, (n, n), symmetric except for dampers along rotating rows, where there
            is a stator, and for constant forces that follow a point; exactly zero where it is rounding.
        force: constant forces that hold the equilibrium, (n,); on rigid-body modes that nothing holds, the loads.
        equilibrium: amplitudes in the equilibrium, from the reference configuration, (n,); charges of ports with a
            resistance are zero. At rest, the stiffness of the loads is part of it: a column near its buckling load
            deflects many times as far as its stiffness alone lets it.
        drive_damping: gyroscopic forces per unit rate of d drives with prescribed motion, (n, d).
        drive_stiffness: stiffness forces per unit of these drives' motion, (n, d).
        inside: stiffness of the stress inside bodies, on the coordinates of each, by name, (n_own, n_own). Where a
            frame carries a body's rotation, only the deformation relative to it has this stiffness.
        held: constant forces on the coordinates of each body with stress inside, by name, (n_own,): the stiffness of
            this stress takes part in the equilibrium by half, because the stress grows with the deformation.
        strained: deformation that strains the material beside a body's own coordinates, by name, (n_own, n_own + 1):
            per unit of the coordinates, and a constant part. It takes away motions of second order without strain, such
            as the shortening of a bent strip. Only bodies with geometric stiffness have it.
        carried: stiffness of the loads on rigid bodies that floating bodies carry, on the deformation of these bodies,
            by name, (n_own, n_own); small motion has it in its joints.
        inputs: constant values of inputs among the loads, by name.
        on_all: the stiffness on all coordinates of the reference configuration, (n_all, n_all); None: zero.
        offset: constant part of all coordinates, which are modes @ amplitudes + offset, (n_all,); None: zero.
        output_offsets: constant part of the outputs, (outputs,); None: that of the reference configuration.
    """

    gyroscopic: Array
    stiffness: Array
    force: Array
    equilibrium: Array
    drive_damping: Array
    drive_stiffness: Array
    inside: Mapping[str, Array] = field(default_factory=dict)
    held: Mapping[str, Array] = field(default_factory=dict)
    strained: Mapping[str, Array] = field(default_factory=dict)
    carried: Mapping[str, Array] = field(default_factory=dict)
    inputs: Mapping[str, float] = field(default_factory=dict)
    on_all: Array | None = None
    offset: Array | None = None
    output_offsets: Array | None = None
    __repr__ = short_repr

    def __post_init__(self) -> None:
        n = len(self.equilibrium)
        freeze(
            self,
            gyroscopic=finite_array("gyroscopic matrix", self.gyroscopic, (n, n)),
            stiffness=finite_array("stiffness of the loads", self.stiffness, (n, n)),
            force=finite_array("forces of the loads", self.force, (n,)),
            equilibrium=finite_array("equilibrium", self.equilibrium, (n,)),
            inside=self.inside,
            held=self.held,
            strained=self.strained,
            carried=self.carried,
            inputs=self.inputs,
        )

    def constant_input(self, name: str) -> float:
        """Return the constant value of an input among the loads."""
        return self.inputs.get(name, 0.0)

    def elastic(self, name: str, coordinates: Array) -> Array:
        """Return the coordinates of a body that strain its material, (..., n); coordinates: of its motion, (..., n)."""
        if name not in self.strained:
            return coordinates
        beside = self.strained[name]
        return coordinates + coordinates @ beside[:, :-1].T + beside[:, -1]

    @classmethod
    def none(cls, n: int, d: int, force: Array) -> "LoadedState":
        """Make the state of n modes and d drives on whose stiffness constant forces, (n,), have no effect."""
        square, of_drives = np.zeros((n, n)), np.zeros((n, d))
        return cls(square, square, force, np.zeros(n), of_drives, of_drives)
