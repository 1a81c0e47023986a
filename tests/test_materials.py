"""Materials: Lamé parameters in closed form, and the checks."""

import numpy as np
import pytest

from nassim import Material


def test_lame_parameters_give_back_young_modulus_and_poisson_ratio():
    lam, mu = Material("steel", 210e9, 0.3, 7850.0).lame_parameters
    assert mu == pytest.approx(210e9 / 2.6)
    assert mu * (3 * lam + 2 * mu) / (lam + mu) == pytest.approx(210e9)
    assert lam / (2 * (lam + mu)) == pytest.approx(0.3)


def test_without_lateral_contraction_lambda_vanishes():
    assert Material("cork", 20e6, 0.0, 200.0).lame_parameters == (0.0, 10e6)


@pytest.mark.parametrize("nu", [-0.99, 0.0, 0.4999])
def test_poisson_ratios_inside_the_range_are_taken(nu):
    assert Material("any", 1e9, nu, 1000.0).poisson_ratio == nu


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"poisson_ratio": 0.5}, r"'steel': poisson_ratio must lie between -1 and 0\.5 .* got 0\.5; .*0\.49"),
        ({"poisson_ratio": -1.0}, "poisson_ratio must lie between -1"),
        ({"poisson_ratio": np.nan}, "poisson_ratio holds 1 value.* NaN"),
        ({"young_modulus": 0.0}, "young_modulus must be positive, got 0 Pa"),
        ({"young_modulus": np.inf}, "young_modulus holds 1 value.* infinite"),
        ({"young_modulus": "stiff"}, "young_modulus must be numbers, got 'stiff'"),
        ({"young_modulus": [1e9, 2e9]}, "young_modulus must have shape a single number, got 2"),
        ({"density": -7850.0}, "density must be positive, got -7850 kg/m3"),
        ({"density": np.nan}, "density holds 1 value.* NaN"),
    ],
)
def test_values_that_are_not_physical_are_refused(change, message):
    steel = {"name": "steel", "young_modulus": 210e9, "poisson_ratio": 0.3, "density": 7850.0}
    with pytest.raises(ValueError, match=message):
        Material(**{**steel, **change})
