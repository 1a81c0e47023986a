"""Lengths of struts, poses and angles, against geometry written out here, differences and published figures."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nassim
from models.hexapods import DEFAULT_PLATFORM, NANO_HEXAPOD
from nassim.kinematics import (
    StewartPlatform,
    forward_kinematics,
    inverse_kinematics,
    jacobian,
    joint_angles,
    strut_directions,
    strut_frames,
    strut_lengths,
    strut_vectors,
)


def odd_platform(seed=1):
    """No symmetry: joints anywhere near two planes, B beside M."""
    noise = np.random.default_rng(seed).normal(scale=0.01, size=(2, 6, 3))
    base, top = DEFAULT_PLATFORM.base_joints + noise[0], DEFAULT_PLATFORM.platform_joints + noise[1]
    return StewartPlatform(base_joints=base, platform_joints=top, height=0.1, point=(0.02, -0.03, 0.05))


def turn(*degrees):
    return Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()


def test_published_struts():
    np.testing.assert_allclose(strut_lengths(DEFAULT_PLATFORM), 95.2254e-3, atol=5e-8)
    np.testing.assert_allclose(strut_lengths(NANO_HEXAPOD), 82.485e-3, atol=5e-7)
    lean = np.rad2deg(np.arccos(strut_directions(NANO_HEXAPOD)[:, 2]))
    np.testing.assert_allclose(lean, 52.7, atol=0.05)
    first = np.array([0.09 * np.cos(np.deg2rad(-50)), 0.09 * np.sin(np.deg2rad(-50)), 0.075])
    first -= [0.115 * np.cos(np.deg2rad(-10)), 0.115 * np.sin(np.deg2rad(-10)), 0.015]
    np.testing.assert_allclose(strut_vectors(DEFAULT_PLATFORM)[0], first, atol=1e-15)


def test_frames_of_struts():
    for platform in (DEFAULT_PLATFORM, NANO_HEXAPOD, odd_platform()):
        for along, axes in zip(strut_vectors(platform), strut_frames(platform), strict=True):
            z = along / np.linalg.norm(along)
            x = np.cross([0, 1, 0], z) / np.linalg.norm(np.cross([0, 1, 0], z))
            np.testing.assert_allclose(axes, np.column_stack([x, np.cross(z, x), z]), atol=1e-14)
    sideways = np.array(DEFAULT_PLATFORM.platform_joints)
    sideways[3] = DEFAULT_PLATFORM.base_joints[3] + [0, 0.1, -DEFAULT_PLATFORM.height]
    with pytest.raises(ValueError, match="along F's y axis"):
        strut_frames(replace(DEFAULT_PLATFORM, platform_joints=sideways))


def test_lengths_of_a_pose_written_out():
    platform, rotation, place = odd_platform(), turn(20, -35, 50), np.array([0.03, -0.02, 0.06])
    point = np.array([0, 0, 0.1]) + platform.point + place
    for k in range(6):
        end = point + rotation @ (platform.platform_joints[k] - platform.point)
        expected = np.linalg.norm(end - platform.base_joints[k])
        assert inverse_kinematics(platform, place, rotation)[k] == pytest.approx(expected, rel=1e-13)
    many = inverse_kinematics(platform, np.array([[0, 0, 0], place]), np.array([np.eye(3), rotation]))
    np.testing.assert_allclose(many, [strut_lengths(platform), inverse_kinematics(platform, place, rotation)])


def test_jacobian_is_the_derivative_of_the_lengths():
    platform, rotation, place = odd_platform(), turn(-25, 15, 40), np.array([0.03, -0.02, 0.06])
    found, h = jacobian(platform, place, rotation), 1e-6
    for k, motion in enumerate(h * np.eye(6)):
        ahead, behind = (
            inverse_kinematics(
                platform, place + sign * motion[:3], Rotation.from_rotvec(sign * motion[3:]).as_matrix() @ rotation
            )
            for sign in (1, -1)
        )
        np.testing.assert_allclose(found[:, k], (ahead - behind) / (2 * h), atol=1e-8)
    many = jacobian(platform, np.array([place, 0 * place]), np.array([rotation, np.eye(3)]))
    np.testing.assert_allclose(many, [found, jacobian(platform)], atol=1e-15)


@pytest.mark.parametrize(
    ("angles", "place"),
    [
        *itertools.product([(0, 0, 0), (20, -15, 30), (-30, 25, -40)], [(0, 0, 0), (0.03, -0.04, 0.05)]),
        ((-60, 15, 90), (0.04, 0.04, 0.04)),
    ],
)
def test_the_pose_of_given_lengths(angles, place):
    """From rest to large poses and back; Newton's full steps do not reach the last one."""
    platform, rotation = odd_platform(), turn(*angles)
    lengths = inverse_kinematics(platform, place, rotation)
    found_place, found_turn = forward_kinematics(platform, lengths)
    np.testing.assert_allclose(inverse_kinematics(platform, found_place, found_turn), lengths, atol=1e-13)
    np.testing.assert_allclose(found_place, place, atol=1e-10)
    np.testing.assert_allclose(found_turn, rotation, atol=1e-9)


def test_lengths_of_a_singular_pose():
    """Two similar plane hexagons are singular in every pose, a turn of 90 degrees of DEFAULT_PLATFORM once."""
    hexagon = np.column_stack([np.cos(np.arange(6) * np.pi / 3), np.sin(np.arange(6) * np.pi / 3), np.zeros(6)])
    similar = StewartPlatform(base_joints=hexagon, platform_joints=0.6 * hexagon, height=1.0)
    for platform, rotation in ((similar, turn(8, -5, 12)), (DEFAULT_PLATFORM, turn(0, 0, 90))):
        with pytest.warns(UserWarning, match="pose found is singular"):
            forward_kinematics(platform, inverse_kinematics(platform, rotation=rotation), rotation=turn(2, 1, 88))


def test_lengths_that_no_pose_has():
    with pytest.raises(ValueError, match="no pose found"):
        forward_kinematics(DEFAULT_PLATFORM, [0.01, 1, 0.01, 1, 0.01, 1])


def test_bending_of_joints():
    """Angles between lines, from their scalar products; a turn of the whole machine's top bends only its joints."""
    platform, rotation, place = odd_platform(), turn(3, -8, 12), np.array([0.004, 0.01, -0.006])
    rest = strut_vectors(platform)
    ends = np.array([0, 0, 0.1]) + platform.point + place + (platform.platform_joints - platform.point) @ rotation.T
    struts = ends - platform.base_joints

    def angle(a, b):
        return np.arccos(np.sum(a * b, axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1))

    base, top = joint_angles(platform, place, rotation)
    np.testing.assert_allclose(base, angle(struts, rest), atol=1e-12)
    np.testing.assert_allclose(top, angle(struts, rest @ rotation.T), atol=1e-12)
    tiny = 1e-9
    base, top = joint_angles(platform, (tiny, 0, 0))
    across = np.linalg.norm(np.cross([1, 0, 0], rest), axis=1) / np.linalg.norm(rest, axis=1) ** 2
    np.testing.assert_allclose(base, tiny * across, rtol=1e-6)
    np.testing.assert_allclose(top, base, rtol=1e-6)


def test_joints_bent_by_more_than_a_right_angle():
    """A platform turned over: angles go up to half a turn."""
    platform, rotation = odd_platform(), turn(170, 0, 0)
    rest = strut_vectors(platform)
    ends = np.array([0, 0, 0.1]) + platform.point + (platform.platform_joints - platform.point) @ rotation.T
    struts, turned = ends - platform.base_joints, rest @ rotation.T
    expected = np.arccos(
        np.sum(struts * turned, axis=1) / np.linalg.norm(struts, axis=1) / np.linalg.norm(rest, axis=1)
    )
    assert expected.max() > np.pi / 2
    np.testing.assert_allclose(joint_angles(platform, rotation=rotation)[1], expected, atol=1e-9)


def test_a_platform_is_a_noun_that_files_hold(tmp_path):
    nassim.save(odd_platform(), tmp_path / "platform.h5")
    again = nassim.load(tmp_path / "platform.h5")
    for field in ("base_joints", "platform_joints", "height", "point"):
        np.testing.assert_array_equal(getattr(again, field), getattr(odd_platform(), field))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"height": 0.0}, "height must be positive"),
        ({"base_joints": np.zeros((5, 3))}, "shape 6 x 3"),
        ({"base_joints": DEFAULT_PLATFORM.platform_joints + np.array([0, 0, 0.09])}, "begin where they end"),
    ],
)
def test_platforms_that_are_none(change, text):
    with pytest.raises(ValueError, match=text):
        replace(DEFAULT_PLATFORM, **change)


@pytest.mark.parametrize(
    ("pose", "text"),
    [
        (((0, 0),), r"shape \(\.\.\., 3\)"),
        (((0, 0, np.nan),), "finite"),
        (((0, 0, 0), 0.5 * np.eye(3)), "orthogonal"),
        (((0, 0, 0), np.diag([1, 1, -1])), "orthogonal"),
        (((0, 0, 0), (0, 0, 0.1)), "shape 3 x 3"),
    ],
)
def test_poses_that_are_none(pose, text):
    for verb in (inverse_kinematics, jacobian, joint_angles):
        with pytest.raises(ValueError, match=text):
            verb(DEFAULT_PLATFORM, *pose)
