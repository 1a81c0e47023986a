"""Materials: Lamé parameters in closed form, and the checks."""

import warnings

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
        ({"young_modulus": "stiff"}, "young_modulus must be a number, got 'stiff'"),
        ({"young_modulus": [1e9, 2e9]}, "young_modulus must have shape a single number, got 2"),
        ({"density": -7850.0}, "density must be positive, got -7850 kg/m3"),
        ({"density": np.nan}, "density holds 1 value.* NaN"),
    ],
)
def test_values_that_are_not_physical_are_refused(change, message):
    steel = {"name": "steel", "young_modulus": 210e9, "poisson_ratio": 0.3, "density": 7850.0}
    with pytest.raises(ValueError, match=message):
        Material(**{**steel, **change})


REAL = {
    "jelly's harder sister, a silicone gel": (150e3, 1000.0),
    "soft rubber": (1e6, 1100.0),
    "rubber foam": (0.2e6, 120.0),
    "packaging foam": (5e6, 15.0),
    "polyethylene": (0.2e9, 920.0),
    "balsa": (3e9, 150.0),
    "lead": (16e9, 11340.0),
    "tungsten": (410e9, 19300.0),
    "osmium": (560e9, 22590.0),
    "beryllium": (303e9, 1848.0),
    "diamond": (1220e9, 3515.0),
}


@pytest.mark.parametrize("name", REAL)
def test_real_materials_pass_without_a_word(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Material(name, REAL[name][0], 0.3, REAL[name][1])


@pytest.mark.parametrize(("modulus", "density"), [(200.0, 7800.0), (70.0, 2700.0), (3.0, 1200.0), (210e9, 7.8e-9)])
def test_moduli_in_gpa_and_densities_in_tonnes_per_cubic_millimetre_are_refused(modulus, density):
    with pytest.raises(ValueError, match=r"'slip': young_modulus .* Pa and density .* 7800 for 7\.8 g/cm3"):
        Material("slip", modulus, 0.3, density)


@pytest.mark.parametrize(
    ("modulus", "density"),
    [
        (210e9, 7.8),  # g/cm3, of the softest and the stiffest
        (1e6, 1.1),
        (16e9, 11.3),
        (210e3, 7800.0),  # MPa, likewise
        (370e3, 3900.0),
        (2e3, 920.0),
        (1e15, 7800.0),  # a stand-in for something rigid
    ],
)
def test_moduli_in_mpa_and_densities_in_grams_per_cubic_centimetre_are_warned_of(modulus, density):
    with pytest.warns(UserWarning, match="'slip': .* make a speed of sound of") as told:
        material = Material("slip", modulus, 0.3, density)
    assert (material.young_modulus, material.density) == (modulus, density)
    assert told[0].filename == __file__


@pytest.mark.parametrize("limit", [0.5, 10.0, 30e3, 1e6])
def test_limits_of_the_speed_of_sound(limit):
    """Refused beyond the outer ones, warned of beyond the inner ones; density far from its own limit."""

    def verdict(speed):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            try:
                Material("m", speed**2 * 1000.0, 0.3, 1000.0)
            except ValueError:
                return "refused"
        return "warned" if told else "taken"

    beyond, within = (verdict(limit * share) for share in ((0.9, 1.1) if limit < 100 else (1.1, 0.9)))
    assert (within, beyond) == (("warned", "refused") if limit in (0.5, 1e6) else ("taken", "warned"))


def test_the_lightest_density_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Material("foam", 1e6, 0.3, 1.1 * 5.0)
    with pytest.warns(UserWarning, match="make a speed of sound of"):
        Material("foam", 1e6, 0.3, 0.9 * 5.0)
