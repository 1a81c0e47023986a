"""Axes from directions, also from those that point against the world's."""

import numpy as np
import pytest
from conftest import assert_limit
from scipy.spatial.transform import Rotation

from nassim.base.rigid_motion import (
    axes_along,
    proper_rotation,
    quaternion,
    rigid_motions,
    rigid_transfer,
    rotation_matrix,
)


@pytest.mark.parametrize("z", [*np.eye(3), *-np.eye(3), (0.1, -0.9, 0.4), (-0.5, -0.6, 0.2), (0.2, 0.3, -4.0)])
def test_axes_begin_in_the_plane_of_the_flattest_world_axis(z):
    """The first of them is as near as it can be to the world's axis that is most nearly across z."""
    axes = axes_along(z)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-15)
    assert np.linalg.det(axes) > 0
    np.testing.assert_allclose(axes[:, 2], np.asarray(z) / np.linalg.norm(z), rtol=1e-15)
    flattest = np.argmin(np.abs(z))
    assert axes[flattest, 0] == pytest.approx(np.linalg.norm(np.cross(np.eye(3)[flattest], axes[:, 2])))
    other = axes_along(z, x=(0.3, 0.2, 0.5))
    assert np.cross(other[:, 2], (0.3, 0.2, 0.5)) @ other[:, 0] == pytest.approx(0, abs=1e-15)
    assert other[:, 0] @ (0.3, 0.2, 0.5) > 0


@pytest.mark.parametrize("angle", [0.0, 1e-200, 1e-9, 0.3, np.pi, 5.0])
def test_rotations_by_vectors(angle):
    vector = angle * np.array([0.48, -0.6, 0.64])
    np.testing.assert_allclose(rotation_matrix(vector), Rotation.from_rotvec(vector).as_matrix(), rtol=0, atol=1e-15)


def test_rigid_motions_of_points():
    """u = t + w x p and the rotation w at each point; what follows in the coordinates rests."""
    places, twist = np.array([[0.1, -0.2, 0.3], [0.4, 0.5, -0.6]]), np.array([1.0, 2.0, 3.0, -0.3, 0.2, 0.7])
    moved = rigid_motions(places, 14) @ twist
    for k, place in enumerate(places):
        np.testing.assert_allclose(moved[6 * k : 6 * k + 3], twist[:3] + np.cross(twist[3:], place))
        np.testing.assert_allclose(moved[6 * k + 3 : 6 * k + 6], twist[3:])
        np.testing.assert_allclose(rigid_transfer(place) @ twist, moved[6 * k : 6 * k + 6])
    assert not moved[12:].any()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda x: axes_along("z", (1e-9 / x, 0, 1)), "span no plane"),
        (lambda x: proper_rotation("turn", (1 + 5e-10 * x) * np.eye(3)), "turn must be a proper orthogonal matrix"),
    ],
    ids=["axes that are nearly parallel", "a rotation's rounding"],
)
def test_limits_lie_where_they_should(make, message):
    assert_limit(make, message)


@pytest.mark.parametrize("axis", [*np.eye(3), (-2.0, 1.0, 1.5), (1.0, -2.0, 2.0), (0.6, 0.5, -0.8)])
@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.7, np.pi - 1e-9, np.pi])
def test_quaternions_of_any_rotation(axis, angle):
    """SciPy's with a scalar part that is not negative; either sign of the vector part at half a turn."""
    rotation = Rotation.from_rotvec(angle * np.asarray(axis) / np.linalg.norm(axis))
    scalar, vector = quaternion(rotation.as_matrix())
    expected = rotation.as_quat(canonical=True)
    expected *= 1.0 if vector @ expected[:3] >= 0 else -1.0
    assert scalar >= 0
    np.testing.assert_allclose([*vector, scalar], expected, atol=1e-15)
