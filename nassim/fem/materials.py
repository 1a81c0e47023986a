"""Linear elastic, isotropic materials."""

from dataclasses import dataclass

import numpy as np

from nassim.base.checks import finite, freeze, positive
from nassim.base.warning_log import warn

POSSIBLE_SPEEDS = (0.5, 1e6)
"""Speeds of sound [m/s] outside which a modulus or density is in other units: jelly has 1, steel in GPa would have 0.2,
diamond has 18 000, steel in t/mm3 would have 5e9."""
USUAL_SPEEDS = (10.0, 30e3)
"""Speeds of sound [m/s] of engineering materials: soft rubber has 20, diamond 18 000; steel in MPa would have 5,
alumina in MPa 9.7, steel in g/cm3 160 000, a plastic in g/cm3 40 000."""
LIGHTEST = 5.0
"""Density [kg/m3] of the lightest foams; rubber and plastics in g/cm3, about 1, lie below, aerogels too."""


@dataclass(frozen=True)
class Material:
    """An isotropic linear elastic material.

    name: what reports call it
    young_modulus: Young's modulus [Pa]
    poisson_ratio: Poisson's ratio [-], above -1 and below 0.5
    density: mass density [kg/m3]

    Raises ValueError when a value is not physical, also where modulus and density together are not: the speed of sound
    sqrt(young_modulus / density) is 1 m/s in jelly, 20 in soft rubber, 5000 in steel and 18 000 in diamond; it must lie
    between 0.5 and 1e6 m/s. Outside 10 to 30 000 m/s, and below 5 kg/m3, warns: GPa, MPa or g/cm3 were probably meant;
    a stand-in for something rigid or without mass may ignore that.
    """

    name: str
    young_modulus: float
    poisson_ratio: float
    density: float

    def __post_init__(self) -> None:
        label = f"material {self.name!r}"
        nu = finite(f"{label}: poisson_ratio", self.poisson_ratio)
        if not -1.0 < nu < 0.5:
            raise ValueError(
                f"{label}: poisson_ratio must lie between -1 and 0.5 (both excluded), got {nu:g}; "
                "for a nearly incompressible material take 0.49 to 0.499 and elements of order 2 or higher"
            )
        modulus = positive(f"{label}: young_modulus", self.young_modulus, "Pa")
        density = positive(f"{label}: density", self.density, "kg/m3")
        speed = np.sqrt(modulus / density)
        message = (
            f"{label}: young_modulus {modulus:g} Pa and density {density:g} kg/m3 make a speed of sound of {speed:.2g} "
            "m/s, steel has 5000; give Pa and kg/m3: 210e9 for 210 GPa or 210e3 MPa, 7800 for 7.8 g/cm3"
        )
        if not POSSIBLE_SPEEDS[0] <= speed <= POSSIBLE_SPEEDS[1]:
            raise ValueError(message)
        if not USUAL_SPEEDS[0] <= speed <= USUAL_SPEEDS[1] or density < LIGHTEST:
            warn(message, stacklevel=3)
        freeze(self, young_modulus=modulus, poisson_ratio=nu, density=density)

    @property
    def lame_parameters(self) -> tuple[float, float]:
        """Lamé's first parameter and the shear modulus (lambda, mu) [Pa]."""
        e, nu = self.young_modulus, self.poisson_ratio
        return e * nu / ((1 + nu) * (1 - 2 * nu)), e / (2 * (1 + nu))
