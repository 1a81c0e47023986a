"""Units of foreign files: against definitions, and a body built anew in each of them."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from nassim.base.units import to_si
from nassim.exchange.superelements import superelement
from nassim.exchange.unit_systems import (
    FORCES,
    LENGTHS,
    MASSES,
    SYSTEMS,
    PhysicalProperties,
    likely_units,
    relative_stiffness,
    sort_by_likelihood,
    unit_factors,
)

# International yard and pound agreement (1959), CGPM (1901): exact.
FOOT, POUND, GRAVITY = Fraction(3048, 10000), Fraction(45359237, 10**8), Fraction(980665, 10**5)
DEFINED = {
    "length": {"m": 1, "cm": Fraction(1, 100), "mm": Fraction(1, 10**3), "um": Fraction(1, 10**6), "ft": FOOT}
    | {"in": FOOT / 12},
    "force": {"N": 1, "mN": Fraction(1, 10**3), "uN": Fraction(1, 10**6), "kN": 10**3, "MN": 10**6}
    | {"lbf": POUND * GRAVITY},
    # A slug is what one pound of force accelerates by a foot per second squared, a slinch by an inch.
    "mass": {"kg": 1, "g": Fraction(1, 10**3), "t": 10**3, "lb": POUND}
    | {"slug": POUND * GRAVITY / FOOT, "slinch": POUND * GRAVITY / (FOOT / 12)},
}


@pytest.mark.parametrize(("kind", "table"), [("length", LENGTHS), ("force", FORCES), ("mass", MASSES)])
def test_units_are_what_they_are_defined_as(kind, table):
    assert set(table) == set(DEFINED[kind])
    for name, value in table.items():
        assert value == pytest.approx(float(DEFINED[kind][name]), rel=1e-15), name


def defined(units):
    return [float(DEFINED[kind][part]) for kind, part in zip(DEFINED, units.split("-"), strict=True)]


def skew(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def body_in(units):
    """Two lumps with products of inertia on a bar, and a mass on a spring inside: K, M and positions in these units.

    Every figure is turned into the file's units before the matrices are put together: a spring's stiffness in force
    over length, moments of inertia in mass times length squared; the inner mass's motion by its unit modal mass.
    """
    length, force, mass = defined(units)
    positions = np.array([[0.02, -0.01, 0.03], [0.15, 0.06, -0.04]]) / length
    stiffness, masses = np.zeros((13, 13)), np.zeros((13, 13))

    centre = np.array([0.4, 0.2, -0.1]) * 0.03 / length  # of each lump, from its node
    own = np.array([[3.0, 0.4, -0.2], [0.4, 2.0, 0.5], [-0.2, 0.5, 2.5]]) * 1e-5 / (mass * length**2)
    for k, lump in enumerate((0.3 / mass, 0.5 / mass)):
        block = slice(6 * k, 6 * k + 6)
        coupling = lump * skew(centre)
        masses[block, block] = np.block(
            [[lump * np.eye(3), -coupling], [coupling, (k + 1) * own - lump * skew(centre) @ skew(centre)]]
        )

    # The bar resists the motion of end 2 relative to that of end 1 carried along as a rigid body.
    arm = positions[1] - positions[0]
    relative = np.hstack([np.block([[-np.eye(3), skew(arm)], [np.zeros((3, 3)), -np.eye(3)]]), np.eye(6)])
    push = np.diag([2e6, 5e5, 8e5]) / (force / length)
    twist = np.array([[400.0, 30.0, 0.0], [30.0, 300.0, -20.0], [0.0, -20.0, 500.0]]) / (force * length)
    bend = np.array([[0.0, 2e3, -1e3], [1e3, 0.0, 3e3], [0.0, 1e3, 0.0]]) / force
    stiffness[:12, :12] = relative.T @ np.block([[push, bend], [bend.T, twist]]) @ relative

    inner, spring = 0.08 / mass, 4e5 / (force / length)  # rides along y on node 1, 20 mm off along z
    carried = np.concatenate([[0, 1, 0], np.cross(np.array([0, 0, 0.02 / length]), [0, 1, 0]), np.zeros(6)])
    masses[:12, :12] += inner * np.outer(carried, carried)
    masses[12, :12] = masses[:12, 12] = np.sqrt(inner) * carried
    masses[12, 12] = 1.0
    stiffness[12, 12] = spring / inner
    return stiffness, masses, positions


ODD = ("ft-kN-lb", "um-mN-slug", "in-N-slinch", "cm-MN-t")


@pytest.mark.parametrize("units", [*SYSTEMS, *ODD])
def test_a_body_is_the_same_in_all_units(units):
    """Translations, rotations, products of inertia and the modal row, each with its own unit."""
    body = superelement(*body_in(units), units=units)
    stiffness, masses, positions = body_in("m-N-kg")
    np.testing.assert_allclose(body.positions, positions, rtol=1e-13)
    for found, expected in ((body.stiffness_matrix, stiffness), (body.mass_matrix, masses)):
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(found / scale, expected / scale, atol=1e-13)


def test_the_body_of_this_test_is_one():
    """Six rigid motions that cost nothing, a mass that is the lumps' and the inner one's."""
    stiffness, masses, positions = body_in("m-N-kg")
    motions = np.vstack(
        [*(np.block([[np.eye(3), -skew(p)], [np.zeros((3, 3)), np.eye(3)]]) for p in positions), [[0] * 6]]
    )
    assert np.abs(stiffness @ motions).max() < 1e-9 * np.abs(stiffness).max()
    assert (motions.T @ masses @ motions)[0, 0] == pytest.approx(0.8, rel=1e-12)
    assert (motions.T @ masses @ motions)[1, 1] == pytest.approx(0.88, rel=1e-12)
    assert np.linalg.eigvalsh(masses).min() > 0


@pytest.mark.parametrize("given", SYSTEMS)
@pytest.mark.parametrize("other", ["m-N-kg", "mm-N-t", "ft-lbf-slug", "in-lbf-lb"])
def test_reread_figures_are_those_of_the_same_numbers(given, other):
    """A rod of steel whose file was written in `other` and read as `given`; its speed sqrt(E / density) too."""
    (l_given, f_given, m_given), (length, force, mass) = defined(given), defined(other)
    true = PhysicalProperties(0.6, 0.25, float(np.sqrt(2e11 / 7800.0)), 7800.0, 0.05)
    # A frequency is the root of a stiffness over a mass: numbers of the file times units.
    rate = np.sqrt((f_given / l_given / m_given) / (force / length / mass))
    read = PhysicalProperties(
        true.mass / mass * m_given,
        true.size / length * l_given,
        float(true.speed * rate * l_given / length),
        true.density / (mass / length**3) * (m_given / l_given**3),
        true.stiffness / (force / length / mass ** (1 / 3)) * (f_given / l_given / m_given ** (1 / 3)),
    )
    again = read.reread(given, other)
    for name, value in true.figures.items():
        assert again.figures[name] == pytest.approx(value, rel=1e-12), name


@pytest.mark.parametrize(("units", "others"), [("in-lbf-lb", 3), ("in-lbf-slinch", 2)])
def test_the_likeliest_units_make_a_body_as_dense_as_metals(units, others):
    """Aluminium in inches, read as metres: before those that would make it foam come the true ones."""
    length, force, mass = defined(units)
    speed = 5000.0 / length / np.sqrt(force / (mass * length))
    found = likely_units(PhysicalProperties(0.6 / mass, 0.25 / length, speed, 2700.0 / (mass / length**3)), "m-N-kg")
    assert found[0][0] == units
    assert tuple(found[0][1].figures.values())[:4] == pytest.approx((0.6, 0.25, 5000.0, 2700.0))
    assert len(found) == 1 + others
    assert all(looks.density < 300.0 for _, looks in found[1:])


def test_unknown_systems_are_refused():
    for units in ("mm-N", "mm-N-stone", "furlong-N-kg", "", "m-N-kg-s", "mm--t"):
        with pytest.raises(ValueError, match="unit"):
            unit_factors(units)


# BIPM, The International System of Units, 9th ed. (2019), table 7: powers of ten.
POWERS = {"": 0, "k": 3, "m": -3, "u": -6, "µ": -6, "μ": -6, "n": -9, "p": -12}


@pytest.mark.parametrize("base", ["m", "s", "Hz", "N", "V", "A", "C", "rad"])
@pytest.mark.parametrize("prefix", POWERS)
def test_prefixes_are_the_powers_of_ten_of_the_si(prefix, base):
    power = POWERS[prefix]
    for unit, si, exponent in (
        (prefix + base, base, power),
        (f"{prefix}{base}2", f"{base}2", 2 * power),
        (f"V/{prefix}{base}", f"V/{base}", -power),
        (f"kN/{prefix}{base}^2", f"N/{base}2", 3 - 2 * power),
    ):
        factor, found = to_si(unit)
        assert (factor, found) == (pytest.approx(10.0**exponent, rel=1e-12), si)


PLAUSIBLE = {"mass": (1e-7, 1e6), "size": (1e-4, 100.0), "speed": (0.1, 2e4), "density": (10.0, 3e4)}
SOUND = PhysicalProperties(1.0, 0.1, 100.0, 5000.0, 0.01)


@pytest.mark.parametrize("name", PLAUSIBLE)
def test_what_bodies_in_machines_have(name):
    low, high = PLAUSIBLE[name]
    told = {"speed": "wave speed"}.get(name, name)
    for value, strange in ((0.9 * low, True), (1.1 * low, False), (0.9 * high, False), (1.1 * high, True)):
        assert replace(SOUND, **{name: value}).implausible == [told] * strange
    assert replace(SOUND, stiffness=np.nan, density=np.nan).implausible == []


def test_the_relative_stiffness_of_a_steel_cube_is_one():
    """E a for an edge a = 30 mm."""
    assert relative_stiffness(200e9 * 0.03, 7800 * 0.03**3) == pytest.approx(1.0, rel=1e-12)
    assert np.isnan([relative_stiffness(*nothing) for nothing in ((1.0, 0.0), (0.0, 1.0), (1.0, -1.0))]).all()


def test_an_unknown_system_is_answered_with_the_names_that_there_are():
    with pytest.raises(ValueError, match=r"'m-N-kg' for SI, got 'SI'; length: m, .*; force: N, .*; mass: kg"):
        unit_factors("SI")


def test_units_are_the_likelier_the_nearer_the_density_is_to_a_solids():
    """Four thousand kg/m3 as a ratio; units of a flat body, which has no density, come last."""
    densities = {"heavy": 16000.0, "flat": np.nan, "light": 1500.0, "metal": 7800.0}
    readings = [(units, PhysicalProperties(1.0, 1.0, 1e3, density)) for units, density in densities.items()]
    assert [units for units, _ in sort_by_likelihood(readings)] == ["metal", "light", "heavy", "flat"]
