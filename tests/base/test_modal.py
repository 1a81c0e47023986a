"""Dense modal analysis against the spring-mass chain, whose modes are known in closed form."""

import warnings

import numpy as np
import pytest

from nassim.base.modal import (
    damping_ratios,
    decay_poles,
    discretize_pole,
    eigenmodes,
    elastic_damping_ratios,
    mac,
    modal_damping_matrix,
)

N, MASS, STIFFNESS = 8, 0.3, 2e5


def chain(free_ends=False):
    """Equal masses in line between equal springs, held by springs at both ends unless free_ends."""
    stiffness = STIFFNESS * (2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1))
    if free_ends:
        stiffness[0, 0] = stiffness[-1, -1] = STIFFNESS
    return stiffness, MASS * np.eye(N)


def test_chain_between_walls():
    stiffness, mass = chain()
    expected = np.sqrt(STIFFNESS / MASS) * np.sin(np.arange(1, N + 1) * np.pi / (2 * (N + 1))) / np.pi
    frequency, shapes = eigenmodes(stiffness, mass)
    np.testing.assert_allclose(frequency, expected, rtol=1e-12)
    first = np.sin(np.arange(1, N + 1) * np.pi / (N + 1))
    np.testing.assert_allclose(mac(first[:, None], shapes[:, :1]), 1.0, rtol=1e-12)


def test_free_chain_has_a_rigid_motion_at_0_hz():
    stiffness, mass = chain(free_ends=True)
    frequency, _ = eigenmodes(stiffness, mass)
    expected = np.sqrt(STIFFNESS / MASS) * np.sin(np.arange(N) * np.pi / (2 * N)) / np.pi
    np.testing.assert_allclose(frequency, expected, rtol=1e-10, atol=1e-5 * expected[1])
    assert np.all(frequency >= 0)


def test_ratios_are_those_of_the_elastic_modes():
    """In their order, the last for all that follow; rigid motions have none."""
    given = elastic_damping_ratios(np.array([0.0, 0.0, 5.0, 7.0, 9.0]), [0.01, 0.02])
    np.testing.assert_array_equal(given, [0.0, 0.0, 0.01, 0.02, 0.02])


def test_shapes_diagonalise_both_matrices():
    stiffness, mass = chain()
    mass = mass + 0.05 * (np.eye(N, k=1) + np.eye(N, k=-1))
    frequency, shapes = eigenmodes(stiffness, mass)
    np.testing.assert_allclose(shapes.T @ mass @ shapes, np.eye(N), atol=1e-12)
    omega_squared = (2 * np.pi * frequency) ** 2
    np.testing.assert_allclose(shapes.T @ stiffness @ shapes, np.diag(omega_squared), atol=1e-12 * omega_squared[-1])


def test_frequencies_do_not_depend_on_the_units_of_the_coordinates():
    stiffness, mass = chain()
    scale = np.diag(10.0 ** np.linspace(-6, 6, N))
    scaled, _ = eigenmodes(scale @ stiffness @ scale, scale @ mass @ scale)
    np.testing.assert_allclose(scaled, eigenmodes(stiffness, mass)[0], rtol=1e-9)


@pytest.mark.parametrize(("n_modes", "expected"), [(1, 1), (3, 3), (N, N), (5 * N, N), (None, N)])
def test_number_of_modes(n_modes, expected):
    frequency, shapes = eigenmodes(*chain(), n_modes=n_modes)
    assert frequency.shape == (expected,)
    assert shapes.shape == (N, expected)
    np.testing.assert_allclose(frequency, eigenmodes(*chain())[0][:expected])


@pytest.mark.parametrize("ratio", [0.02, np.linspace(0.001, 0.3, N)])
def test_damping_matrix_gives_the_stated_ratios(ratio):
    stiffness, mass = chain()
    frequency, shapes = eigenmodes(stiffness, mass)
    damping = modal_damping_matrix(mass, frequency, shapes, ratio)
    inverse = np.linalg.inv(mass)
    state = np.block([[np.zeros((N, N)), np.eye(N)], [-inverse @ stiffness, -inverse @ damping]])
    poles = np.linalg.eigvals(state)
    poles = poles[poles.imag > 0]
    poles = poles[np.argsort(np.abs(poles))]
    np.testing.assert_allclose(np.abs(poles), 2 * np.pi * frequency, rtol=1e-9)
    np.testing.assert_allclose(-poles.real / np.abs(poles), np.broadcast_to(ratio, N), rtol=1e-9)


def test_modes_at_0_hz_and_modes_not_listed_stay_undamped():
    stiffness, mass = chain(free_ends=True)
    frequency, shapes = eigenmodes(stiffness, mass)
    damping = modal_damping_matrix(mass, frequency[:3], shapes[:, :3], 0.05)
    expected = np.zeros(N)
    expected[1:3] = 2 * 0.05 * 2 * np.pi * frequency[1:3]
    modal = shapes.T @ damping @ shapes
    np.testing.assert_allclose(modal, np.diag(expected), atol=1e-5 * expected.max())


def test_mac_of_modes_with_themselves_is_the_identity():
    stiffness, mass = chain()
    mass = mass * np.linspace(1, 5, N)
    _, shapes = eigenmodes(stiffness, mass)
    np.testing.assert_allclose(mac(shapes, -3.0 * shapes, mass), np.eye(N), atol=1e-12)


def test_mac_is_the_squared_cosine_of_the_angle():
    angle = 0.4
    turned = np.array([[np.cos(angle)], [np.sin(angle)]])
    np.testing.assert_allclose(mac(np.eye(2), turned), [[np.cos(angle) ** 2], [np.sin(angle) ** 2]])


def test_counts_and_ratios_below_zero_are_refused():
    assert len(eigenmodes(np.eye(2), np.eye(2), n_modes=1)[0]) == 1
    with pytest.raises(ValueError, match="n_modes must be at least 1, got 0"):
        eigenmodes(np.eye(2), np.eye(2), n_modes=0)
    for wrong in (-0.01, np.nan):
        with pytest.raises(ValueError, match="must not be negative or NaN"):
            modal_damping_matrix(np.eye(2), np.ones(2), np.eye(2), [0.0, wrong])


@pytest.mark.parametrize(
    ("mass", "message"),
    [
        (np.diag([1.0, 0.0]), "diagonal entry that is not positive"),
        (np.diag([1.0, -1.0]), "diagonal entry that is not positive"),
        (np.array([[1.0, 2.0], [2.0, 1.0]]), "mass matrix is not positive definite"),
    ],
)
def test_mass_matrix_must_be_positive_definite(mass, message):
    with pytest.raises(ValueError, match=message):
        eigenmodes(np.eye(2), mass)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_nan_is_refused(bad):
    with pytest.raises(ValueError, match="NaN"):
        eigenmodes(np.diag([1.0, bad]), np.eye(2))


def test_poles_of_several_decays():
    """A double pole among them, which a symmetric machine has: read in many units, once faint, at every start."""
    poles = np.array([-3 + 100j, -3 + 100j, -8 + 160j, -1 + 163j])
    rng = np.random.default_rng(3)
    modes, units = np.exp(poles[:, None] * np.arange(600) * 2e-3), np.array([[1.0], [1e-6], [1e4]])
    reads = units * (rng.standard_normal((3, 4)) + 1j * rng.standard_normal((3, 4)))
    starts = np.array([[1.0], [1e-5]]) * (rng.standard_normal((2, 4)) + 1j * rng.standard_normal((2, 4)))
    decays = np.array([(reads @ (start[:, None] * modes)).real for start in starts])
    found = decay_poles(decays, 2e-3, n_poles=8)
    for pole in poles:
        assert np.count_nonzero(np.abs(found - pole) < 1e-5) == np.count_nonzero(poles == pole)
    assert len(decay_poles(decays, 2e-3, n_poles=12)) == 8, "no more than are there"
    once = decay_poles(decays[0], 2e-3, n_poles=8)
    assert np.count_nonzero(np.abs(once - poles[0]) < 1e-5) == 1
    np.testing.assert_array_equal(decay_poles(decays[:1], 2e-3, n_poles=8), once)


@pytest.mark.parametrize("rate", [-40.0 + 900.0j, -3.0 + 2.5j, -1.5 + 2.9j, 0.2j])
def test_a_pole_driven_by_held_and_by_straight_inputs(rate):
    """Against z' = rate z + start + slope t solved by hand, for steps that a pole hardly or wholly follows."""
    step, before, start, end = 3e-3, 0.7 - 0.2j, 1.3, -2.6
    turned = np.exp(rate * step)
    held = before * turned + start * (turned - 1) / rate
    slope = (end - start) / step
    free = before + start / rate + slope / rate**2
    straight = free * turned - (end / rate + slope / rate**2)
    for hold_order, expected, tolerance in ((0, held, 1e-11), (1, straight, 1e-7)):
        now, earlier, decay = discretize_pole(rate, step, hold_order=hold_order)
        assert abs(decay * before + now * end + earlier * start - expected) < tolerance * step


def test_critical_damping_is_told():
    for ratio in (0.9, 1.1):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            damping_ratios("ratio", [0.01, ratio])
        assert ["critical damping or more" in str(each.message) for each in told] == [True] * (ratio > 1)


@pytest.mark.parametrize(("share", "found"), [(1e-6, [-5.0, -1.0]), (1e-13, [-1.0])])
def test_what_rounding_excites_is_no_pole(share, found):
    """A decay and one beside it that is a millionth as large, or as small as rounding."""
    time = 0.1 * np.arange(40)
    decay = np.exp(-time) + share * np.exp(-5 * time)
    poles = decay_poles(decay[None], 0.1, n_poles=2)
    np.testing.assert_allclose(np.sort(poles.real), found, rtol=1e-3)


def test_a_pole_needs_four_samples():
    decay = np.exp(-0.1 * np.arange(8))[None]
    assert decay_poles(decay, 0.1, n_poles=2)[0] == pytest.approx(-1.0)
    with pytest.raises(ValueError, match="2 poles need at least 8 samples, got 7"):
        decay_poles(decay[:, :7], 0.1, n_poles=2)


@pytest.mark.parametrize("given", [np.ones(8), np.ones((1, 1, 1, 8)), np.array([[1.0, np.nan, *np.ones(6)]])])
def test_decays_that_are_not_finite_or_have_another_shape_are_refused(given):
    with pytest.raises(ValueError, match=r"^decay (must|holds)"):
        decay_poles(given, 0.1, n_poles=2)
