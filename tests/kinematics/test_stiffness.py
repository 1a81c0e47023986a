"""Stiffness and forces: published figures, energies of six springs, and scenes that know nothing of Jacobians."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from models.hexapods import DEFAULT_PLATFORM
from nassim import Bushing, LinearActuator, PointForce, PointTorque, Pose, RigidBody, Scene, SpringDamper, linearize
from nassim.kinematics import (
    StewartPlatform,
    compliance_matrix,
    inverse_kinematics,
    stiffness_matrix,
    strut_directions,
    strut_forces,
    strut_lengths,
)


def test_published_compliance():
    """Of the default platform on struts of 20e6 N/m."""
    expected = np.diag([4.7500e-8, 4.7500e-8, 2.0990e-8, 5.1863e-6, 5.1863e-6, 1.7073e-6])
    expected[[0, 4], [4, 0]], expected[[1, 3], [3, 1]] = 3.2093e-7, -3.2093e-7
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    found = compliance_matrix(DEFAULT_PLATFORM, 20e6)
    np.testing.assert_allclose(found / scale, expected / scale, rtol=2.4e-5, atol=1e-9)
    np.testing.assert_allclose(found @ stiffness_matrix(DEFAULT_PLATFORM, 20e6), np.eye(6), atol=1e-9)


def test_compliance_on_unequal_struts_sums_what_each_of_them_yields():
    """A strut alone yields F^2 / 2 k to a wrench, so the wrench's motion per wrench is the sum of F^2 / k."""
    springs, position = np.array([1.0, 2.0, 3.0, 5.0, 7.0, 11.0]) * 1e6, np.array([3e-3, -2e-3, 4e-3])
    rotation = Rotation.from_rotvec([0.03, -0.02, 0.05]).as_matrix()
    found = compliance_matrix(DEFAULT_PLATFORM, springs, position, rotation)
    for wrench in np.random.default_rng(0).normal(size=(3, 6)):
        forces = strut_forces(DEFAULT_PLATFORM, wrench, position, rotation)
        assert wrench @ found @ wrench == pytest.approx(np.sum(forces**2 / springs), rel=1e-9)


@pytest.mark.parametrize(("point", "turning", "coupling"), [(-0.05, 0.015, 0.0), (0.02, 0.0248, -0.14)])
@pytest.mark.parametrize(("base", "depth"), [(0.015, 0.015), (0.03, 0.01), (0.0, 0.0)])
def test_published_stiffness_of_the_cubic_platform(point, turning, coupling, base, depth):
    """Wherever along the cube's edges the joints are."""
    platform = StewartPlatform.cubic(
        height=0.1, edge_height=0.1, centre_height=0.05, base_height=base, platform_depth=depth, point=(0, 0, point)
    )
    expected = np.diag([2, 2, 2, turning, turning, 0.06])
    expected[[0, 4], [4, 0]], expected[[1, 3], [3, 1]] = coupling, -coupling
    np.testing.assert_allclose(stiffness_matrix(platform, 1.0), expected, rtol=1e-12, atol=1e-12)
    lines = strut_directions(platform)
    products = np.abs(lines @ lines.T)
    np.testing.assert_allclose(np.sort(products, axis=1), np.tile([0, 0, 0, 0, 1, 1], (6, 1)), atol=1e-12)


def test_law_of_the_cubic_platform():
    """1.5 k Hc^2 and 6 k Hc^2 with B in the cube's centre, which need not be half way up."""
    platform = StewartPlatform.cubic(
        height=0.12, edge_height=0.15, centre_height=0.07, base_height=0.02, platform_depth=0.02, point=(0, 0, -0.05)
    )
    expected = 3.0 * np.diag([2, 2, 2, 1.5 * 0.15**2, 1.5 * 0.15**2, 6 * 0.15**2])
    np.testing.assert_allclose(stiffness_matrix(platform, 3.0), expected, atol=1e-12)
    about_z = np.cross(platform.base_joints, strut_directions(platform))[:, 2]
    np.testing.assert_array_equal(np.sign(about_z), [-1, 1, -1, 1, -1, 1])
    start = platform.base_joints[:, :2]
    np.testing.assert_allclose(
        np.round(np.rad2deg(np.arctan2(start[:, 1], start[:, 0])) % 360 / 120) % 3, [0, 0, 1, 1, 2, 2]
    )
    with pytest.raises(ValueError, match=r"lie -0\.03 and 0\.23 m .* from -0\.05 to 0\.05 m"):
        StewartPlatform.cubic(height=0.3, edge_height=0.1, centre_height=0.05, base_height=0.02, platform_depth=0.02)


def odd_platform():
    noise = np.random.default_rng(3).normal(scale=0.01, size=(2, 6, 3))
    base, top = DEFAULT_PLATFORM.base_joints + noise[0], DEFAULT_PLATFORM.platform_joints + noise[1]
    return StewartPlatform(base_joints=base, platform_joints=top, height=0.1, point=(0.02, -0.03, 0.05))


def test_energy_of_six_springs():
    """Second differences of their energy about a pose in which they bear no load."""
    platform, stiffness = odd_platform(), np.array([1.0, 2.0, 0.5, 3.0, 1.5, 0.8])
    place, rotation = np.array([0.01, -0.02, 0.015]), Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix()
    unloaded = inverse_kinematics(platform, place, rotation)
    h = 1e-4

    def energy(motion):
        turned = Rotation.from_rotvec(motion[3:]).as_matrix() @ rotation
        return 0.5 * stiffness @ (inverse_kinematics(platform, place + motion[:3], turned) - unloaded) ** 2

    steps = h * np.eye(6)
    found = [[sum(s * t * energy(s * a + t * b) for s in (1, -1) for t in (1, -1)) for b in steps] for a in steps]
    expected = stiffness_matrix(platform, stiffness, place, rotation)
    np.testing.assert_allclose(np.array(found) / (4 * h**2), expected, atol=1e-5)


def test_forces_of_struts_balance_the_wrench():
    platform, wrench = odd_platform(), np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])
    forces = strut_forces(platform, wrench)[:, None] * strut_directions(platform)
    arms = platform.platform_joints - platform.point
    np.testing.assert_allclose(np.r_[forces.sum(axis=0), np.cross(arms, forces).sum(axis=0)], wrench, atol=1e-12)


def test_another_point():
    """Virtual work: the stiffness at another point is that at B, carried there by the rigid motion between them."""
    platform, offset = odd_platform(), np.array([0.1, -0.05, 0.2])
    carried = np.eye(6)
    carried[:3, 3:] = [[0, -offset[2], offset[1]], [offset[2], 0, -offset[0]], [-offset[1], offset[0], 0]]
    moved = stiffness_matrix(replace(platform, point=platform.point + offset), 5.0)
    np.testing.assert_allclose(carried.T @ stiffness_matrix(platform, 5.0) @ carried, moved.T, atol=1e-12)


def on_struts(platform, fixed):
    """The platform as a scene: a plate on springs that push, its base fixed or on a soft spring of its own."""
    up, centre = np.array([0, 0, platform.height]), np.array([0.01, 0.02, platform.height])
    heads = {f"h{k}": at + up - centre for k, at in enumerate(platform.platform_joints)}
    point = platform.point + up
    plate = RigidBody("plate", heads | {"b": point - centre}, 1.3, np.diag([0.02, 0.03, 0.04]), centre)
    feet = {f"f{k}": at for k, at in enumerate(platform.base_joints)} | {"o": np.zeros(3)}
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    base = RigidBody("base", feet, fixed=True) if fixed else RigidBody("base", feet, 3.0, 0.02 * np.eye(3))
    struts = [SpringDamper(f"s{k}", f"base.f{k}", f"plate.h{k}", "line", 2e5, 20.0) for k in range(6)]
    soft = [] if fixed else [Bushing("soft", "ground.o", "base.o", np.diag([3e4, 2e4, 4e4, 300, 200, 250]))]
    pushes = [LinearActuator(f"a{k}", f"base.f{k}", f"plate.h{k}", f"a{k}") for k in range(6)]
    outside = [PointForce(f"f{d}", "plate.b", d, f"f{d}") for d in "xyz"]
    outside += [PointTorque(f"t{d}", "plate.b", d, f"t{d}") for d in "xyz"]
    return Scene(
        "on struts", (ground, base, plate), (), (*pushes, *outside), (Pose("pose", "ground.o", "plate.b"),),
        (*struts, *soft), damping_ratio=0.0,
    )  # fmt: skip


@pytest.mark.parametrize("fixed", [True, False])
def test_struts_push_as_a_wrench_from_outside_on_a_fixed_base_only(fixed):
    platform, wrench = odd_platform(), np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])
    model = linearize(on_struts(platform, fixed))
    s = 2j * np.pi * 55.0
    response = model.D + model.C @ np.linalg.solve(s * np.eye(len(model.A)) - model.A, model.B)
    by_struts, from_outside = response[:, :6] @ strut_forces(platform, wrench), response[:, 6:] @ wrench
    off = np.abs(by_struts - from_outside).max() / np.abs(from_outside).max()
    assert off < 1e-10 if fixed else off > 0.1


def test_what_is_refused():
    for stiffness, least in ((0.0, "0"), ([1.0, 1.0, -2.0, 1.0, 1.0, 1.0], "-2")):
        with pytest.raises(ValueError, match=f"stiffness must be positive, got {least} N/m"):
            stiffness_matrix(DEFAULT_PLATFORM, stiffness)
    upright = replace(DEFAULT_PLATFORM, platform_joints=DEFAULT_PLATFORM.base_joints)
    assert np.ptp(strut_lengths(upright)) < 1e-15
    # Similar hexagons: the struts meet in a point, but for rounding, about which nothing holds.
    meeting = replace(DEFAULT_PLATFORM, platform_joints=DEFAULT_PLATFORM.base_joints @ np.diag([0.3, 0.3, 0.0]))
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))[:6]
    through_b = StewartPlatform(base_joints=[0, 0, 3.0] - corners, platform_joints=corners, height=3.0)
    for verb in (lambda p: compliance_matrix(p, 1.0), lambda p: strut_forces(p, np.ones(6))):
        for platform in (upright, meeting, through_b):
            with pytest.raises(ValueError, match="singular"):
                verb(platform)
