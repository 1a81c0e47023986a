"""Unit systems of foreign files, and the unit system that the properties of a body suggest."""

from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array, known

INCH, FOOT, POUND = 0.0254, 0.3048, 0.45359237
POUND_FORCE = 9.80665 * POUND
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": INCH, "ft": FOOT}
FORCES = {"N": 1.0, "mN": 1e-3, "uN": 1e-6, "kN": 1e3, "MN": 1e6, "lbf": POUND_FORCE}
MASSES = {"kg": 1.0, "g": 1e-3, "t": 1e3, "lb": POUND, "slug": POUND_FORCE / FOOT, "slinch": POUND_FORCE / INCH}
SYSTEMS = (
    *("m-N-kg", "mm-N-t", "mm-mN-kg", "mm-N-kg", "mm-uN-g", "cm-N-kg", "m-N-t", "m-kN-t", "m-N-g"),
    *("in-lbf-slinch", "in-lbf-lb", "ft-lbf-slug"),
)
PLAUSIBLE = {
    "mass": (1e-7, 1e6),
    "size": (1e-4, 100.0),
    "wave speed": (0.1, 2e4),
    "density": (10.0, 3e4),
    "stiffness": (2e-4, np.inf),
}
"""Plausible ranges for bodies in machines [kg, m, m/s, kg/m3, -].

A steel beam 500 times as long as thick has a stiffness of 2e-4.
"""
STEEL = 2e11, 7800.0
"""Young's modulus [Pa] and density [kg/m3] of the cube whose relative stiffness is 1."""
SOLID = 4000.0
"""Density between aluminium and steel [kg/m3]; units are the more likely, the closer the density is to it."""


@dataclass(frozen=True)
class PhysicalProperties:
    """Properties of a body that are implausible with wrong units; `str` of it lists them.

    Attributes:
        mass: mass [kg].
        size: length of the body [m].
        speed: first elastic frequency times size, less than the speed of waves [m/s].
        density: density of the homogeneous box with the same inertia; NaN where the box has no volume [kg/m3].
        stiffness: stiffness of the node with the largest translational one, over that of a steel cube of the same mass;
            NaN where no node has any [-].
    """

    mass: float
    size: float
    speed: float
    density: float
    stiffness: float = np.nan

    @property
    def implausible(self) -> list[str]:
        """Names of those properties (mass, size, wave speed, density, stiffness) that no body in a machine has."""
        values = zip(PLAUSIBLE.items(), (self.mass, self.size, self.speed, self.density, self.stiffness), strict=True)
        return [name for (name, (low, high)), value in values if np.isfinite(value) and not low <= value <= high]

    @property
    def figures(self) -> dict[str, float]:
        """The properties by name, with units in the names."""
        return {
            "mass_kg": self.mass,
            "size_m": self.size,
            "speed_m_per_s": self.speed,
            "density_kg_per_m3": self.density,
            "stiffness_over_steel": self.stiffness,
        }

    def reread(self, given: str, other: str) -> "PhysicalProperties":
        """Return the properties of the same numbers in other units.

        Args:
            given: units in which the numbers were read.
            other: other units.
        """
        length, force, mass = (b / a for a, b in zip(unit_factors(given), unit_factors(other), strict=True))
        speed = self.speed * length * np.sqrt(force / (mass * length))
        stiffness = self.stiffness * force / length / np.cbrt(mass)
        return PhysicalProperties(
            self.mass * mass, self.size * length, float(speed), self.density * mass / length**3, float(stiffness)
        )

    def __str__(self) -> str:
        box = f", {self.density:.3g} kg/m3 of its box" if np.isfinite(self.density) else ""
        return f"{self.mass:.3g} kg, {self.size:.3g} m long{box}"


def likely_units(looks: PhysicalProperties, given: str) -> list[tuple[str, PhysicalProperties]]:
    """Find other units in which the numbers are plausible, the most likely first.

    The search includes `SYSTEMS` and the given units with another unit of force.

    Args:
        looks: properties in the given units, in which they are implausible.
        given: the given units.

    Returns:
        Pairs of units and properties in these units.
    """
    length, _, mass = given.split("-")
    others = dict.fromkeys((*SYSTEMS, *(f"{length}-{force}-{mass}" for force in FORCES)))
    readings = [(units, looks.reread(given, units)) for units in others]
    return sort_by_likelihood([(units, reread) for units, reread in readings if not reread.implausible])


def sort_by_likelihood(readings: list[tuple[str, PhysicalProperties]]) -> list[tuple[str, PhysicalProperties]]:
    """Sort pairs of units and properties by the distance of the density from a solid's; those without density last."""

    def unlikely(reading: tuple[str, PhysicalProperties]) -> float:
        density = reading[1].density
        return abs(float(np.log(density / SOLID))) if np.isfinite(density) else np.inf

    return sorted(readings, key=unlikely)


def relative_stiffness(stiffness: float, mass: float) -> float:
    """Return a stiffness [N/m] over that of a steel cube of the given mass [kg]; NaN where there is none.

    Args:
        stiffness: [N/m].
        mass: [kg].
    """
    modulus, density = STEEL
    return float(stiffness / (modulus * np.cbrt(mass / density))) if stiffness > 0 and mass > 0 else np.nan


def unit_factors(units: str) -> tuple[float, float, float]:
    """Return the units of length [m], force [N], mass [kg] of a text such as "mm-N-t"; raise ValueError for others.

    Args:
        units: length-force-mass.
    """
    parts = units.split("-")
    tables = (("length", LENGTHS), ("force", FORCES), ("mass", MASSES))
    if len(parts) != 3:
        names = "; ".join(f"{kind}: {', '.join(table)}" for kind, table in tables)
        raise ValueError(
            f"units are written length-force-mass, such as 'mm-N-t', or 'm-N-kg' for SI, got {units!r}; {names}"
        )
    length, force, mass = (
        table[known(f"unit of {kind} in {units!r}", part, table)]
        for part, (kind, table) in zip(parts, tables, strict=True)
    )
    return length, force, mass


def matrix_units(units: str, r: int, p: int) -> tuple[float, Array, Array]:
    """Return the units of reduced matrices in SI; angles are in radians, and unit modal masses remain ones.

    Args:
        units: length-force-mass, such as "mm-N-t".
        r: number of nodes.
        p: number of modal coordinates.

    Returns:
        Unit of length [m], and of each entry of K and of M, (n, n) each with n = 6 r + p [SI].
    """
    length, force, mass = unit_factors(units)
    energy = mass * length**2
    # SI value of each coordinate: metres, radians, and modal amplitudes that preserve unit modal masses.
    unit = np.concatenate([np.tile([length] * 3 + [1.0] * 3, r), [np.sqrt(energy)] * p])
    products: Array = np.outer(unit, unit)
    return length, force * length / products, energy / products
