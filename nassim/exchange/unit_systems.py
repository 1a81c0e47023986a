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
}
"""Of bodies in machines [kg, m, m/s, kg/m3]."""
SOLID = 4000.0
"""Between aluminium and steel [kg/m3]; the likelier units are those that come nearer."""


@dataclass(frozen=True)
class Looks:
    """Figures of a body that wrong units make absurd; `str` of it tells them.

    mass [kg]; size: its length [m]; speed: first elastic frequency times size [m/s]; waves are faster
    density: over the homogeneous box of the same inertia [kg/m3], NaN where that has no volume
    """

    mass: float
    size: float
    speed: float
    density: float

    @property
    def implausible(self) -> list[str]:
        """Which of mass, size, wave speed and density no body in a machine has."""
        values = zip(PLAUSIBLE.items(), (self.mass, self.size, self.speed, self.density), strict=True)
        return [name for (name, (low, high)), value in values if np.isfinite(value) and not low <= value <= high]

    @property
    def figures(self) -> dict[str, float]:
        """By name and unit."""
        return {
            "mass_kg": self.mass,
            "size_m": self.size,
            "speed_m_per_s": self.speed,
            "density_kg_per_m3": self.density,
        }

    def reread(self, given: str, other: str) -> "Looks":
        """The same numbers of a file read in other units."""
        length, force, mass = (b / a for a, b in zip(unit_factors(given), unit_factors(other), strict=True))
        speed = self.speed * length * np.sqrt(force / (mass * length))
        return Looks(self.mass * mass, self.size * length, float(speed), self.density * mass / length**3)

    def __str__(self) -> str:
        box = f", {self.density:.3g} kg/m3 of its box" if np.isfinite(self.density) else ""
        return f"{self.mass:.3g} kg, {self.size:.3g} m long{box}"


def likely_units(looks: Looks, given: str) -> list[tuple[str, Looks]]:
    """Other `SYSTEMS` of units in which the numbers are plausible, likeliest first, and the body's figures in them."""
    readings = {units: looks.reread(given, units) for units in SYSTEMS if units != given}
    likely = [(units, reread) for units, reread in readings.items() if not reread.implausible]
    if np.isfinite(looks.density):
        likely.sort(key=lambda item: abs(np.log(item[1].density / SOLID)))
    return likely


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
