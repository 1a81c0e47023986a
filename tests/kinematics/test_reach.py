"""Strokes and workspaces: published figures, and limits that are reached and not crossed."""

import itertools
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from models.hexapods import DEFAULT_PLATFORM
from nassim.kinematics import inverse_kinematics, joint_angles, strut_lengths, strut_strokes, workspace

BOX = np.array([50e-6, 50e-6, 50e-6, 30e-6, 30e-6, 0])


def test_published_strokes():
    """76.100 um for single motions, 177.169 um for combined ones, the largest change of length minus the least."""
    single = np.array([strut_strokes(DEFAULT_PLATFORM, BOX * one) for one in np.eye(6)[:5]])
    assert single.max() - single.min() == pytest.approx(76.100e-6, abs=5e-10)
    combined = strut_strokes(DEFAULT_PLATFORM, BOX)
    assert combined.max() - combined.min() == pytest.approx(177.169e-6, abs=5e-10)


def test_strokes_of_every_strut():
    """Pose by pose; the extremes inside the box are not larger."""
    found = strut_strokes(DEFAULT_PLATFORM, BOX)
    rest = strut_lengths(DEFAULT_PLATFORM)
    changes = np.array(
        [
            inverse_kinematics(DEFAULT_PLATFORM, m[:3], Rotation.from_rotvec(m[3:]).as_matrix()) - rest
            for m in BOX * np.array(list(itertools.product((-1, 0, 1), repeat=6)))
        ]
    )
    np.testing.assert_allclose(found, np.column_stack([changes.min(axis=0), changes.max(axis=0)]), atol=1e-16)


def corners(box):
    motions = box * np.array(list(itertools.product((-1, 1), repeat=6)))
    return motions[:, :3], Rotation.from_rotvec(motions[:, 3:]).as_matrix()


@pytest.mark.parametrize("box", [BOX, np.array([0.1, 0, 0.3, 1.0, 0, 2.0])])
@pytest.mark.parametrize(("stroke", "bending"), [(100e-6, np.inf), (0.02, np.inf), (0.05, 24.5e-3), (1e-5, 1e-4)])
def test_workspace_reaches_a_limit_and_keeps_all(box, stroke, bending):
    keeps_its_limits(DEFAULT_PLATFORM, box, stroke, bending)


def test_the_end_of_a_strut_that_bends_most_sets_the_limit():
    """About a point at the height of the base, struts turn with the platform, so the joints of the base bend more."""
    low, turns = replace(DEFAULT_PLATFORM, point=(0, 0, -DEFAULT_PLATFORM.height)), np.array([0, 0, 0, 1.0, 1.0, 0])
    for platform, end in ((low, 0), (DEFAULT_PLATFORM, 1)):
        found = keeps_its_limits(platform, turns, np.inf, 0.02)
        assert np.max(joint_angles(platform, *corners(found))[end]) == pytest.approx(0.02, rel=1e-6)
        assert np.max(joint_angles(platform, *corners(found))[1 - end]) < 0.018


def keeps_its_limits(platform, box, stroke, bending):
    """Check that a workspace reaches a limit and that all smaller boxes keep both; return its half widths."""
    found = workspace(platform, box, stroke=stroke, bending=bending)
    np.testing.assert_allclose(found * np.abs(box).max(), box * found.max(), atol=1e-15)
    for share, full in ((1.0, True), (0.97, False), (0.5, False), (0.1, False)):
        pose = corners(share * found)
        length = np.abs(inverse_kinematics(platform, *pose) - strut_lengths(platform)).max() / stroke
        used = max(length, np.max(joint_angles(platform, *pose)) / bending)
        assert used == pytest.approx(1, rel=1e-6) if full else used < 1
    return found


def test_small_motion_by_the_struts_slope():
    """Up and down along z, all struts alike: the stroke over their slope."""
    found = workspace(DEFAULT_PLATFORM, (0, 0, 1, 0, 0, 0), stroke=1e-7)
    np.testing.assert_allclose(found, [0, 0, 1e-7 / (0.06 / 0.0952254), 0, 0, 0], rtol=2e-6)


def singular_share(motion):
    """The share of a motion at which the platform loses its hold, by the first change of sign of its own Jacobian."""
    base = DEFAULT_PLATFORM.base_joints
    top = DEFAULT_PLATFORM.platform_joints - DEFAULT_PLATFORM.point
    centre = np.array([0, 0, DEFAULT_PLATFORM.height]) + DEFAULT_PLATFORM.point

    def hold(share):
        arms = top @ Rotation.from_rotvec(share * motion[3:]).as_matrix().T
        struts = centre + share * motion[:3] + arms - base
        return np.linalg.det(np.hstack([struts, np.cross(arms, struts)]) / np.linalg.norm(struts, axis=1)[:, None])

    shares = np.linspace(0, 1, 1000)
    return shares[np.flatnonzero([hold(share) * hold(0.0) <= 0 for share in shares])[0]]


@pytest.mark.parametrize("motion", [(0, 0, 0, 0, 0, np.pi), (0.1, 0, 0, 0, -1.5, 0)])
def test_a_workspace_that_holds_singular_poses_is_told(motion):
    """A turn of the cubic platform about z, and a motion along x with a turn about y against it, of all signs first.

    Beyond such a pose the struts can neither hold the platform nor bring it back.
    """
    singular = singular_share(np.array(motion)) * np.array(motion)
    far, near = (
        np.abs(inverse_kinematics(DEFAULT_PLATFORM, *corners(share * singular)) - strut_lengths(DEFAULT_PLATFORM)).max()
        for share in (1.25, 0.9)
    )
    with pytest.warns(UserWarning, match="singular poses.* from 8[01] % of"):
        workspace(DEFAULT_PLATFORM, np.abs(motion), stroke=far)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        workspace(DEFAULT_PLATFORM, np.abs(motion), stroke=near)


def test_what_is_refused():
    with pytest.raises(ValueError, match="nothing limits"):
        workspace(DEFAULT_PLATFORM, np.ones(6), stroke=np.inf)
    with pytest.raises(ValueError, match="stroke must be positive"):
        workspace(DEFAULT_PLATFORM, np.ones(6), stroke=0.0)
    for box in (np.zeros(6), np.array([1.0, 1.0, 1.0, -1.0, 0.0, 0.0])):
        with pytest.raises(ValueError, match="six half widths"):
            strut_strokes(DEFAULT_PLATFORM, box)
