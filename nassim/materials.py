"""Linear elastic, isotropic materials."""

from dataclasses import dataclass

from nassim.checks import finite, freeze, positive


@dataclass(frozen=True)
class Material:
    """An isotropic linear elastic material.

    name: what reports call it
    young_modulus: Young's modulus [Pa]
    poisson_ratio: Poisson's ratio [-], above -1 and below 0.5
    density: mass density [kg/m3]

    Raises ValueError when a value is not physical.
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
        freeze(
            self,
            young_modulus=positive(f"{label}: young_modulus", self.young_modulus, "Pa"),
            poisson_ratio=nu,
            density=positive(f"{label}: density", self.density, "kg/m3"),
        )

    @property
    def lame_parameters(self) -> tuple[float, float]:
        """Lamé's first parameter and the shear modulus (lambda, mu) [Pa]."""
        e, nu = self.young_modulus, self.poisson_ratio
        return e * nu / ((1 + nu) * (1 - 2 * nu)), e / (2 * (1 + nu))
