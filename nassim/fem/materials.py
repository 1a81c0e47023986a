"""Linear elastic, isotropic materials."""

from dataclasses import dataclass

import numpy as np

from nassim.base.checks import finite, freeze, positive
from nassim.base.short_repr import short_repr
from nassim.base.warning_log import warn

POSSIBLE_SPEEDS = (0.5, 1e6)
"""Range of the speed of sound [m/s]. Outside this range, a modulus or density is in other units.

Examples are 1 for jelly and 18 000 for diamond; wrong units give 0.2 for steel in GPa and 5e9 for steel in t/mm3.
"""
USUAL_SPEEDS = (10.0, 30e3)
"""Range of the speed of sound of engineering materials [m/s].

Examples are 20 for soft rubber and 18 000 for diamond. Wrong units give 5 for steel in MPa, 9.7 for alumina in MPa,
160 000 for steel in g/cm3 and 40 000 for a plastic in g/cm3.
"""
LIGHTEST = 5.0
"""Density of the lightest foams [kg/m3]. Rubber and plastics in g/cm3, about 1, and aerogels are below it."""


@dataclass(frozen=True)
class Material:
    """An isotropic linear elastic material.

    Attributes:
        name: name in reports
        young_modulus: Young's modulus [Pa]
        poisson_ratio: Poisson's ratio, above -1 and below 0.5 [-]
        density: mass density [kg/m3]

    Raises:
        ValueError: if a value is not physical, or if modulus and density do not fit together. The speed of sound
            sqrt(young_modulus / density) must be between 0.5 and 1e6 m/s. It is 1 m/s in jelly, 20 in soft rubber, 5000
            in steel and 18 000 in diamond.

    Warns:
        UserWarning: if the speed of sound is outside 10 to 30 000 m/s, or the density is below 5 kg/m3. Values were
            probably given in GPa, MPa or g/cm3. The warning can be ignored for a fictitious material that is rigid or
            massless.
    """

    name: str
    young_modulus: float
    poisson_ratio: float
    density: float
    __repr__ = short_repr

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
            warn(message)
        freeze(self, young_modulus=modulus, poisson_ratio=nu, density=density)

    @property
    def lame_parameters(self) -> tuple[float, float]:
        """Lamé's first parameter and the shear modulus (lambda, mu) [Pa]."""
        e, nu = self.young_modulus, self.poisson_ratio
        return e * nu / ((1 + nu) * (1 - 2 * nu)), e / (2 * (1 + nu))
