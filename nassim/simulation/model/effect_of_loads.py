"""Effect of constant loads on small motion: stiffness, gyroscopic forces and equilibrium, in modal amplitudes."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from nassim.base.checks import Array, finite, finite_array, freeze
from nassim.base.field_types import ArrayField, data_class, held
from nassim.base.short_repr import short_repr


@data_class
class ConstantLoads:
    """Constant loads on a scene, along the axes in which it is described.

    Attributes:
        gravity: gravity, (3,) [m/s2].
        inputs: values of inputs, by name; others are zero.
        velocity: angular velocity with which the scene, or the rotor of a partition, rotates, (3,) [rad/s].
        axis_point: a point of the axis, (3,) [m].
    """

    gravity: ArrayField = field(default_factory=held(lambda: np.zeros(3)))
    inputs: Mapping[str, float] = field(default_factory=dict)
    velocity: ArrayField = field(default_factory=held(lambda: np.zeros(3)))
    axis_point: ArrayField = field(default_factory=held(lambda: np.zeros(3)))
    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze(
            self,
            gravity=finite_array("gravity", self.gravity, (3,)),
            inputs={name: finite(name, value) for name, value in self.inputs.items()},
            velocity=finite_array("angular_velocity", self.velocity, (3,)),
            axis_point=finite_array("axis_point", self.axis_point, (3,)),
        )


@dataclass(frozen=True)
class BodyStress:
    """Geometric stiffness of the stress in a body, and the force with which it resists the body's deformation.

    Where a frame carries the body's rotation, only the deformation relative to the frame has this stiffness.

    Attributes:
        stiffness: stiffness on the n coordinates of the body, (n, n).
        held: constant part of the force, which is stiffness @ deformation - held, (n,): the stress grows with the
            deformation, so its stiffness takes part in the equilibrium by half.
        strained: deformation that strains the material beside the body's own coordinates, (n, n + 1): per unit of the
            coordinates, and a constant part. It takes away motions of second order without strain, such as the
            shortening of a bent strip. Zero where the stress is only estimated.
    """

    stiffness: Array
    held: Array
    strained: Array


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
        stress: stress inside bodies, by name.
        carried: stiffness of the loads on rigid bodies that floating bodies carry, on the deformation of these bodies,
            by name, (n_own, n_own); small motion has it in its joints.
        given: the loads.
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
    stress: Mapping[str, BodyStress] = field(default_factory=dict)
    carried: Mapping[str, Array] = field(default_factory=dict)
    given: ConstantLoads = field(default_factory=ConstantLoads)
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
            stress=self.stress,
            carried=self.carried,
        )

    def constant_input(self, name: str) -> float:
        """Return the constant value of an input among the loads."""
        return self.given.inputs.get(name, 0.0)

    def elastic(self, name: str, coordinates: Array) -> Array:
        """Return the coordinates of a body that strain its material, (..., n); coordinates: of its motion, (..., n)."""
        if name not in self.stress:
            return coordinates
        beside = self.stress[name].strained
        return coordinates + coordinates @ beside[:, :-1].T + beside[:, -1]

    @classmethod
    def none(cls, n: int, d: int, force: Array) -> "LoadedState":
        """Make the state of n modes and d drives on whose stiffness constant forces, (n,), have no effect."""
        square, of_drives = np.zeros((n, n)), np.zeros((n, d))
        return cls(square, square, force, np.zeros(n), of_drives, of_drives)
