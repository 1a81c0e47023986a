"""Interface coordinates: kinematics of rigid bodies, names and boundary conditions."""

import numpy as np
import pytest

from nassim.base.rigid_motion import rigid_transfer, skew
from nassim.bodies.remote_points import coordinate_names, coordinate_vector, free_coordinates, point_masses

POINTS = ("bottom", "top")
RNG = np.random.default_rng(0)


def test_skew_is_the_cross_product():
    a, b = RNG.standard_normal((2, 3))
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b))
    np.testing.assert_array_equal(skew(a).T, -skew(a))


def test_rigid_transfer_is_a_small_rigid_motion():
    offset, shift, turn = RNG.standard_normal((3, 3))
    moved = rigid_transfer(offset) @ np.concatenate([shift, turn])
    np.testing.assert_allclose(moved, np.concatenate([shift + np.cross(turn, offset), turn]))


def test_rigid_transfers_chain_and_carry_forces_back():
    a, b, force = RNG.standard_normal((3, 3))
    np.testing.assert_allclose(rigid_transfer(a) @ rigid_transfer(b), rigid_transfer(a + b))
    wrench = rigid_transfer(a).T @ np.concatenate([force, np.zeros(3)])
    np.testing.assert_allclose(wrench, np.concatenate([force, np.cross(a, force)]))


def test_coordinate_names():
    assert coordinate_names(POINTS)[:3] == ("bottom.ux", "bottom.uy", "bottom.uz")
    assert coordinate_names(POINTS)[-1] == "top.rz"


@pytest.mark.parametrize(
    ("fixed", "guided", "free"),
    [
        ((), None, range(12)),
        (["bottom"], None, range(6, 12)),
        (["bottom"], {"top": "z"}, [8]),
        ((), {"bottom": "rx"}, [3, *range(6, 12)]),
        (["top", "bottom"], {}, []),
    ],
)
def test_free_coordinates(fixed, guided, free):
    np.testing.assert_array_equal(free_coordinates(POINTS, fixed=fixed, guided=guided), list(free))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fixed": ["side"]}, "unknown remote point 'side'; known: bottom, top"),
        ({"guided": {"side": "z"}}, "unknown remote point 'side'; known: bottom, top"),
        ({"guided": {"top": "uz"}}, "unknown direction 'uz'; known: x, y, z, rx, ry, rz"),
        ({"fixed": ["top"], "guided": {"top": "z"}}, "top cannot be both fixed and guided"),
        ({"fixed": "top"}, r"fixed must be a list of names, got the text 'top'; write \['top'\]"),
    ],
)
def test_boundary_conditions_are_checked(options, message):
    with pytest.raises(ValueError, match=message):
        free_coordinates(POINTS, **options)


def test_point_masses_act_on_translations_only():
    expected = np.zeros(12)
    expected[6:9] = 5.0
    np.testing.assert_array_equal(point_masses(POINTS, {"top": 5.0}), expected)
    assert not point_masses(POINTS, None).any()


@pytest.mark.parametrize(
    ("masses", "message"),
    [
        ({"side": 1.0}, "unknown remote point 'side'; known: bottom, top"),
        ({"top": -1.0}, "mass at 'top' must not be negative, got -1 kg"),
        ({"top": np.nan}, "mass at 'top' holds 1 value.* NaN"),
    ],
)
def test_point_masses_are_checked(masses, message):
    with pytest.raises(ValueError, match=message):
        point_masses(POINTS, masses)


def test_coordinate_vector():
    vector = coordinate_vector(POINTS, {"top.uz": 1.0, "bottom.uz": -1.0})
    np.testing.assert_array_equal(np.flatnonzero(vector), [2, 8])
    assert (vector[8], vector[2]) == (1.0, -1.0)
    with pytest.raises(
        ValueError, match=r"unknown coordinate 'top.z'; did you mean 'top.uz'. known: bottom.ux, .*top.rz"
    ):
        coordinate_vector(POINTS, {"top.z": 1.0})
