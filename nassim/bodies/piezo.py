"""Piezoelectric stacks, described by their data sheet, and the electrical ports of a body."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from nassim.base.checks import Array, finite, finite_array, freeze, positive, unique
from nassim.base.field_types import ArrayField, Names, data_class, held
from nassim.base.short_repr import short_repr

LARGEST_FREE_STRAIN = 5e-3
"""Ratio of free stroke to length above the range of piezo ceramics; usual ones reach 1e-3 to 2e-3."""
LARGEST_STRESS = 500e6
"""Ratio of blocked force to cross-section above the range of piezo ceramics [Pa]; usual ones reach 30 to 50 MPa."""
STIFFNESS_MISMATCH = 2.0
"""Largest ratio, or inverse ratio, of a stack's stiffness to its blocked force over its free stroke."""
USUAL_COUPLING = (0.65, 0.78)
"""Coupling factor k33 of common PZT ceramics at small signals (IEEE Std 176-1987; manufacturers' tables)."""


@dataclass(frozen=True, kw_only=True)
class PiezoStack:
    """A multilayer piezo stack, described by its data sheet.

    Sign convention: a positive voltage lengthens the stack; forces are positive in tension.

    Attributes:
        free_stroke: elongation without load over the whole voltage range [m]
        blocked_force: force at zero elongation over the whole voltage range [N]
        voltage_range: range that stroke and force refer to [V]
        stiffness: mechanical stiffness at constant voltage [N/m]
        capacitance: capacitance of the unloaded stack [F]
        length: length of the ceramic [m]
        area: cross-section of the ceramic [m2]
        transverse_ratio: ratio of transverse to axial strain under voltage, d31 / d33 [-]. Data sheets of stacks do not
            give it; common ceramics have -0.4 to -0.5.

    Raises:
        ValueError: for values that no ceramic reaches, which indicates a wrong unit
    """

    free_stroke: float
    blocked_force: float
    voltage_range: float
    stiffness: float
    capacitance: float
    length: float
    area: float
    transverse_ratio: float = -0.45
    __repr__ = short_repr

    def __post_init__(self) -> None:
        numbers = [f.name for f in fields(self) if f.name != "transverse_ratio"]
        freeze(self, **{name: positive(f"piezo stack: {name}", getattr(self, name)) for name in numbers})
        freeze(self, transverse_ratio=finite("piezo stack: transverse_ratio", self.transverse_ratio))
        if not -0.6 <= self.transverse_ratio <= 0.0:
            raise ValueError(f"piezo stack: transverse_ratio must be from -0.6 to 0, got {self.transverse_ratio:g}")
        if self.free_stroke > LARGEST_FREE_STRAIN * self.length:
            raise ValueError(
                f"piezo stack: a free_stroke of {self.free_stroke:g} m is {100 * self.free_stroke / self.length:.3g} % "
                f"of the length {self.length:g} m; ceramics reach 0.2 %. Are both in metres?"
            )
        if self.blocked_force > LARGEST_STRESS * self.area:
            raise ValueError(
                f"piezo stack: a blocked_force of {self.blocked_force:g} N on {self.area:g} m2 is "
                f"{1e-6 * self.blocked_force / self.area:.3g} MPa; ceramics give 30 to 50. Are they in N and m2?"
            )
        implied = self.blocked_force / self.free_stroke
        if not 1 / STIFFNESS_MISMATCH < self.stiffness / implied < STIFFNESS_MISMATCH:
            raise ValueError(
                f"piezo stack: the stiffness {self.stiffness:g} N/m does not agree with blocked_force / free_stroke = "
                f"{implied:g} N/m; is it in N/m (not N/um)?"
            )
        if self.coupling_factor >= 1.0:
            least = self.stiffness * (self.free_stroke / self.voltage_range) ** 2
            raise ValueError(
                f"piezo stack: with a capacitance of {self.capacitance:g} F it would give back more energy than it "
                f"takes; stroke and stiffness need more than {least:.3g} F"
            )

    @classmethod
    def from_datasheet(
        cls,
        *,
        free_stroke: float,
        blocked_force: float,
        voltage_range: float | tuple[float, float],
        capacitance: float,
        size: Sequence[float],
        stiffness: float | None = None,
        transverse_ratio: float = -0.45,
    ) -> "PiezoStack":
        """Make a stack from the values that its data sheet gives. `consistency` compares them.

        Args:
            free_stroke: elongation without load over the whole voltage range [m]
            blocked_force: force at zero elongation over the whole voltage range [N]
            voltage_range: (lowest, highest) or their difference [V]
            capacitance: capacitance of the unloaded stack [F]
            size: length along the stack, then the two sides of its cross-section [m]
            stiffness: mechanical stiffness [N/m] (default: blocked_force / free_stroke)
            transverse_ratio: ratio of transverse to axial strain under voltage, d31 / d33 [-]
        """
        length, width, depth = finite_array("piezo stack: size", size, (3,))
        ends = np.atleast_1d(np.array(voltage_range, dtype=float))
        stroke = positive("piezo stack: free_stroke", free_stroke)
        return cls(
            free_stroke=stroke,
            blocked_force=blocked_force,
            voltage_range=float(np.ptp(ends)) if ends.size == 2 else float(ends[0]),
            stiffness=blocked_force / stroke if stiffness is None else stiffness,
            capacitance=capacitance,
            length=float(length),
            area=float(width * depth),
            transverse_ratio=transverse_ratio,
        )

    @property
    def stroke_per_volt(self) -> float:
        """Free elongation per volt, d [m/V]."""
        return self.free_stroke / self.voltage_range

    @property
    def young_modulus(self) -> float:
        """Young's modulus along the stack at constant voltage, computed from the stiffness [Pa]."""
        return self.stiffness * self.length / self.area

    @property
    def coupling_factor(self) -> float:
        """Electromechanical coupling factor k33 [-]; its square is the share of work that becomes electrical energy.

        At constant length, the stack has the capacitance (1 - k33^2) C. In open circuit, it has the stiffness
        k / (1 - k33^2).
        """
        return float(np.sqrt(self.stiffness / self.capacitance) * self.stroke_per_volt)

    @property
    def force_per_volt(self) -> float:
        """Actuator constant g_a: blocked force per volt [N/V].

        A stack obeys F = k (dl - d V) with d = free_stroke / voltage_range [m/V]. At dl = 0 it pushes outwards with
        g_a V, where g_a = k d = blocked_force / voltage_range. Equal stacks in series that share one voltage act on the
        two ends of the series with the same force g_a V.
        """
        return self.blocked_force / self.voltage_range

    @property
    def voltage_per_elongation(self) -> float:
        """Sensor constant g_s of the open-circuit stack [V/m]; the sensor's voltage is -g_s dl.

        The charge is Q = d F + C V, where C is the capacitance of the unloaded stack. In open circuit (Q = 0) the
        voltage is V = -d F / C, so compression (F < 0) gives a positive voltage. With F = k dl, where k is the
        stiffness of the open-circuit stack, g_s = d k / C = g_a / C. The piezo literature writes this value as d33 /
        (eps_T s_D n) [V/m]. If k is the stiffness at constant voltage, as an electrical port assumes, V = -g_s dl / (1
        - k33^2). Data sheets do not say which stiffness they give; the true value lies between the two.
        """
        return self.force_per_volt / self.capacitance

    def consistency(self) -> str:
        """Return a text that compares the values of the data sheet with each other, one comparison per line."""
        low, high = USUAL_COUPLING
        factor = self.coupling_factor
        if factor > high:
            verdict = "high: stroke and force are those of large signals, the capacitance is that of small ones"
        else:
            verdict = "usual" if factor >= low else "low: are there inactive ends?"
        implied = self.blocked_force / self.free_stroke
        return "\n".join(
            [
                f"stiffness {1e-6 * self.stiffness:.4g} N/um; blocked force / free stroke: {1e-6 * implied:.4g} N/um "
                f"({100 * (self.stiffness / implied - 1):+.1f} %)",
                f"Young's modulus along the stack {1e-9 * self.young_modulus:.4g} GPa",
                f"strain over the voltage range {100 * self.free_stroke / self.length:.3g} %, "
                f"blocked stress {1e-6 * self.blocked_force / self.area:.3g} MPa",
                f"coupling factor k33 {factor:.3f} (ceramics: {low} to {high}; {verdict})",
            ]
        )


@data_class
class ElectricalPort:
    """Stacks of one solid that share a voltage: an electrical port with two terminals.

    Attributes:
        name: name of the port in scenes
        bodies: names of the CAD bodies, which are electrically in parallel
        stack: data of each of them
        direction: direction in which they lengthen under positive voltage, shape (3,)
    """

    name: str
    bodies: Names
    stack: PiezoStack
    direction: ArrayField = held((1.0, 0.0, 0.0))
    __repr__ = short_repr

    def __post_init__(self) -> None:
        label = f"electrical port {self.name!r}"
        bodies = (self.bodies,) if isinstance(self.bodies, str) else tuple(self.bodies)
        direction = finite_array(f"{label}: direction", self.direction, (3,))
        if not np.any(direction):
            raise ValueError(f"{label}: direction must not be zero")
        if not bodies:
            raise ValueError(f"{label} names no CAD body; name at least one")
        direction = finite_array(f"{label}: direction", direction / np.linalg.norm(direction), (3,))
        freeze(self, bodies=unique(f"{label}: CAD body", bodies), direction=direction)

    @property
    def strain_per_volt(self) -> Array:
        """Free strain under one volt, shape (3, 3) [1/V]."""
        direction = np.asarray(self.direction)
        along = np.outer(direction, direction)
        result: Array = along + self.stack.transverse_ratio * (np.eye(3) - along)
        return self.stack.stroke_per_volt / self.stack.length * result


@dataclass(frozen=True)
class PortCoupling:
    """An electrical port in terms of u, the unknowns of an FE model or the coordinates of a reduced body.

    Attributes:
        name: name of the port
        forces: forces on the unknowns per volt, shape (n,) [N/V]. By reciprocity, the motion u produces the charge
            forces @ u [C], so Q = forces @ u + blocked_capacitance V.
        blocked_capacitance: capacitance with all unknowns held [F]
        place: centre of the stacks at rest, for images, shape (3,) [m]; None if unknown
    """

    name: str
    forces: Array
    blocked_capacitance: float
    place: Array | None = None
    __repr__ = short_repr

    def __post_init__(self) -> None:
        forces = finite_array(f"electrical port {self.name!r}: forces", self.forces, (None,))
        capacitance = finite(f"electrical port {self.name!r}: blocked capacitance", self.blocked_capacitance)
        if capacitance <= 0:
            raise ValueError(
                f"electrical port {self.name!r}: with all strains held its capacitance would be {capacitance:.3g} F, "
                "less than none: the stack's stroke, the material's stiffness and the capacitance do not agree, "
                "or its transverse_ratio is not that of a ceramic (-0.4 to -0.5)"
            )
        freeze(self, forces=forces, blocked_capacitance=capacitance)
        if self.place is not None:
            freeze(self, place=finite_array(f"electrical port {self.name!r}: place", self.place, (3,)))

    @property
    def n_coordinates(self) -> int:
        """Number n of the unknowns or coordinates."""
        return len(self.forces)

    def projected(self, change: Array) -> "PortCoupling":
        """Return the port in terms of n' coordinates u', where u = change @ u', shape (n, n')."""
        return replace(self, forces=change.T @ self.forces)
