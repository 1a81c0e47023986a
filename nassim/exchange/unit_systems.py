"""Systems of units of foreign files, and which one the figures of a body speak for."""

from dataclasses import dataclass

import numpy as np

from nassim.base.checks import known

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
"""Of bodies in machines [kg, m, m/s, kg/m3, -]. Stiffness: 2e-4 has a steel beam 500 times as long as thick."""
STEEL = 2e11, 7800.0
"""Young's modulus [Pa] and density [kg/m3] of the cube whose stiffness is 1."""
SOLID = 4000.0
"""Between aluminium and steel [kg/m3]; the likelier units are those that come nearer."""


@dataclass(frozen=True)
class Looks:
    """Figures of a body that wrong units make absurd; `str` of it tells them.

    mass [kg]; size: its length [m]; speed: first elastic frequency times size [m/s]; waves are faster
    density: over the homogeneous box of the same inertia [kg/m3], NaN where that has no volume
    stiffness: of the node that resists translation most, over that of a cube of steel of the same mass [-], NaN where
        none resists
    """

    mass: float
    size: float
    speed: float
    density: float
    stiffness: float = np.nan

    @property
    def implausible(self) -> list[str]:
        """Which of mass, size, wave speed, density and stiffness no body in a machine has."""
        values = zip(PLAUSIBLE.items(), (self.mass, self.size, self.speed, self.density, self.stiffness), strict=True)
        return [name for (name, (low, high)), value in values if np.isfinite(value) and not low <= value <= high]

    @property
    def figures(self) -> dict[str, float]:
        """By name and unit."""
        return {
            "mass_kg": self.mass,
            "size_m": self.size,
            "speed_m_per_s": self.speed,
            "density_kg_per_m3": self.density,
            "stiffness_over_steel": self.stiffness,
        }

    def reread(self, given: str, other: str) -> "Looks":
        """The same numbers of a file read in other units."""
        length, force, mass = (b / a for a, b in zip(unit_factors(given), unit_factors(other), strict=True))
        speed = self.speed * length * np.sqrt(force / (mass * length))
        stiffness = self.stiffness * force / length / np.cbrt(mass)
        return Looks(
            self.mass * mass, self.size * length, float(speed), self.density * mass / length**3, float(stiffness)
        )

    def __str__(self) -> str:
        box = f", {self.density:.3g} kg/m3 of its box" if np.isfinite(self.density) else ""
        return f"{self.mass:.3g} kg, {self.size:.3g} m long{box}"


def likely_units(looks: Looks, given: str) -> list[tuple[str, Looks]]:
    """Other units in which the numbers are plausible, likeliest first, and the body's figures in them.

    Tried are `SYSTEMS` and the given units with another one of force.
    """
    length, _, mass = given.split("-")
    others = dict.fromkeys((*SYSTEMS, *(f"{length}-{force}-{mass}" for force in FORCES)))
    readings = {units: looks.reread(given, units) for units in others if units != given}
    return likeliest_first([(units, reread) for units, reread in readings.items() if not reread.implausible])


def likeliest_first(readings: list[tuple[str, Looks]]) -> list[tuple[str, Looks]]:
    """Readings in the order of how near their density comes to a solid's; those without one last."""

    def unlikely(reading: tuple[str, Looks]) -> float:
        density = reading[1].density
        return abs(float(np.log(density / SOLID))) if np.isfinite(density) else np.inf

    return sorted(readings, key=unlikely)


def relative_stiffness(stiffness: float, mass: float) -> float:
    """A stiffness [N/m] over that of a cube of steel of this mass [kg]; NaN where there is none."""
    modulus, density = STEEL
    return float(stiffness / (modulus * np.cbrt(mass / density))) if stiffness > 0 and mass > 0 else np.nan


def unit_factors(units: str) -> tuple[float, float, float]:
    """The units of length [m], force [N] and mass [kg] of a text such as "mm-N-t"; raises ValueError otherwise."""
    parts = units.split("-")
    if len(parts) != 3:
        raise ValueError(f"units are written length-force-mass, such as 'mm-N-t', got {units!r}")
    tables = (("length", LENGTHS), ("force", FORCES), ("mass", MASSES))
    length, force, mass = (
        table[known(f"unit of {kind} in {units!r}", part, table)]
        for part, (kind, table) in zip(parts, tables, strict=True)
    )
    return length, force, mass
