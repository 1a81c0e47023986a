"""What every optional argument of the verbs of kinematics does, and limits a tenth below and above."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from arguments import assert_all_tried, table
from conftest import assert_limit
from scipy.spatial.transform import Rotation
from test_poses import odd_platform

import nassim.kinematics
from nassim.kinematics import (
    StewartPlatform,
    compliance_matrix,
    forward_kinematics,
    inverse_kinematics,
    jacobian,
    joint_angles,
    stiffness_matrix,
    strut_directions,
    strut_forces,
    strut_frames,
    strut_strokes,
    workspace,
)

PLATFORM = odd_platform()
PLACE = np.array([0.01, -0.02, 0.015])
TURN = Rotation.from_rotvec([0.1, -0.2, 0.15]).as_matrix()
REST, UPRIGHT = np.zeros(3), np.eye(3)
SPRINGS = np.array([1e6, 2e6, 3e6, 1.5e6, 2.5e6, 3.5e6])
WRENCH = np.array([1.0, -2.0, 30.0, 0.4, -0.5, 0.6])
BOX = np.array([1.0, 0.5, 0.2, 3.0, 2.0, 1.0])


def moved(position=REST, rotation=UPRIGHT):
    """The platform that rests where `PLATFORM` is in a pose: B goes along, and the top's joints turn about it."""
    point = np.asarray(PLATFORM.point) + position
    joints = point + (PLATFORM.platform_joints - PLATFORM.point) @ np.transpose(rotation)
    return replace(PLATFORM, platform_joints=joints, point=point)


def bent(**pose):
    """Whether angles at base and top are those between struts before and after, at the top turned back."""
    now, rest = strut_directions(moved(**pose)), strut_directions(PLATFORM)
    expected = [np.arccos(np.sum(v * rest, axis=1)) for v in (now, now @ pose.get("rotation", UPRIGHT))]
    return lambda _, after: np.allclose(after, expected, atol=1e-7)


def as_moved(call, **pose):
    return lambda _, after: np.allclose(after, call(moved(**pose)), rtol=1e-9)


POSED = {
    "inverse_kinematics": inverse_kinematics,
    "jacobian": jacobian,
    "stiffness_matrix": lambda platform, **pose: stiffness_matrix(platform, SPRINGS, **pose),
    "compliance_matrix": lambda platform, **pose: compliance_matrix(platform, SPRINGS, **pose),
    "strut_forces": lambda platform, **pose: strut_forces(platform, WRENCH, **pose),
}
UPSIDE_DOWN = np.array([0.02, 0.01, -0.25])
TWISTED = Rotation.from_rotvec([2.0, 1.0, 0.0]).as_matrix()
RING = {"height": 0.1, "base_radius": 0.1, "base_angles": range(0, 360, 60), "base_height": 0.0}
RING |= {"platform_radius": 0.08, "platform_angles": range(10, 370, 60), "platform_depth": 0.01}
JOINTS = {"base_joints": PLATFORM.base_joints, "platform_joints": PLATFORM.platform_joints, "height": 0.1}
CUBE = {"height": 0.1, "edge_height": 0.1, "centre_height": 0.05, "base_height": 0.02, "platform_depth": 0.02}


def found_elsewhere(before, after):
    """Another pose that has the same lengths."""
    lengths = inverse_kinematics(PLATFORM)
    same = [np.allclose(inverse_kinematics(PLATFORM, *pose), lengths, atol=1e-10) for pose in (before, after)]
    return all(same) and np.allclose(before[0], 0, atol=1e-9) and not np.allclose(after[0], 0, atol=1e-2)


def point_is(place):
    return lambda _, after: np.array_equal(after.point, place)


def within(bending):
    """Whether a joint bends by just as much at a corner of the box."""

    def law(before, after):
        corners = after * np.array(np.meshgrid(*[[-1, 1]] * 6)).reshape(6, -1).T
        turns = Rotation.from_rotvec(corners[:, 3:]).as_matrix()
        most = max(angle.max() for angle in joint_angles(PLATFORM, corners[:, :3], turns))
        return np.isclose(most, bending, rtol=1e-9) and np.all(after < before)

    return law


ARGUMENTS = table(
    {
        **{name: partial(call, PLATFORM) for name, call in POSED.items()},
        "joint_angles": partial(joint_angles, PLATFORM),
        "forward_kinematics": partial(forward_kinematics, PLATFORM, inverse_kinematics(PLATFORM)),
        "workspace": partial(workspace, PLATFORM, BOX, stroke=1e-3),
        "from_angles": partial(StewartPlatform.from_angles, **RING),
        "cubic": partial(StewartPlatform.cubic, **CUBE),
        "StewartPlatform": partial(StewartPlatform, **JOINTS),
    },
    [
        *((name, "position", REST, PLACE, as_moved(call, position=PLACE)) for name, call in POSED.items()),
        *((name, "rotation", UPRIGHT, TURN, as_moved(call, rotation=TURN)) for name, call in POSED.items()),
        ("joint_angles", "position", REST, PLACE, bent(position=PLACE)),
        ("joint_angles", "rotation", UPRIGHT, TURN, bent(rotation=TURN)),
        ("forward_kinematics", "position", REST, UPSIDE_DOWN, found_elsewhere),
        ("forward_kinematics", "rotation", UPRIGHT, TWISTED, found_elsewhere),
        ("workspace", "bending", np.inf, 1e-3, within(1e-3)),
        *((verb, "point", REST, PLACE, point_is(PLACE)) for verb in ("from_angles", "cubic", "StewartPlatform")),
    ],
)


@pytest.mark.parametrize("case", ARGUMENTS)
def test_an_optional_argument_does_what_it_should(case):
    ARGUMENTS[case].check()


def test_every_optional_argument_is_tried():
    assert_all_tried(nassim.kinematics, ARGUMENTS)


def with_first_strut(vector):
    joints = np.array(PLATFORM.platform_joints)
    joints[0] = PLATFORM.base_joints[0] + vector - [0, 0, PLATFORM.height]
    return replace(PLATFORM, platform_joints=joints)


def skewed(angle):
    """Two hexagons, one above the other, with neighbouring corners of the upper one shifted by an angle to and fro."""
    ring = {**RING, "platform_angles": np.arange(0, 360, 60) + angle * np.array([1, -1, 1, -1, 1, -1])}
    return StewartPlatform.from_angles(**ring)


def nearly_singular(condition):
    """Similar hexagons one above the other hold no turn about z; this far from it, a little does, in proportion."""
    rates = jacobian(skewed(1e-4))
    rates = rates / np.repeat([1, np.abs(rates[:, 3:]).max()], 3)
    return skewed(1e-4 * np.linalg.cond(rates) / condition)


def stroke_upwards(share):
    """What struts need to rise by three times their mean length and a share."""
    rise = share * 3 * inverse_kinematics(PLATFORM).mean()
    return np.max(inverse_kinematics(PLATFORM, [0, 0, rise]) - inverse_kinematics(PLATFORM))


def too_short(gap):
    """The pose nearest to lengths that lack a gap, over the mean length at rest, even with all joints in one plane."""
    platform = skewed(10.0)
    flat = inverse_kinematics(platform, [0, 0, -0.09])
    return forward_kinematics(platform, flat - gap * inverse_kinematics(platform).mean())


def test_a_stroke_counts_both_ways():
    """About a point halfway up a tall platform, where both ends of a strut lie opposite, turns shorten it by more."""
    tall = StewartPlatform.from_angles(**{**RING, "height": 1.0}, point=(0, 0, -0.5))
    strokes = strut_strokes(tall, workspace(tall, (0, 0, 0, 1, 0.5, 0), stroke=5e-3))
    assert -strokes.min() == pytest.approx(5e-3, rel=1e-9)
    assert 1e-3 < strokes.max() < 4.999e-3


LIMITS = {
    "an endless workspace": (
        lambda x: workspace(PLATFORM, [0, 0, 1, 0, 0, 0], stroke=stroke_upwards(x)),
        "nothing limits",
    ),
    "lengths out of reach": (lambda x: too_short(1e-9 * x), "no pose found"),
    "a rotation's rounding": (lambda x: inverse_kinematics(PLATFORM, rotation=(1 + 5e-10 * x) * TURN), "orthogonal"),
    "a strut without length": (lambda x: with_first_strut([0, 0, 1e-10 / x]), "begin where they end"),
    "a strut along y": (lambda x: strut_frames(with_first_strut([1e-10 / x, 0.1, 0])), "along F's y axis"),
    "a plane below the cube": (lambda x: StewartPlatform.cubic(**{**CUBE, "base_height": -5e-11 * x}), "middle edges"),
    "a plane above the cube": (
        lambda x: StewartPlatform.cubic(**{**CUBE, "platform_depth": -5e-11 * x}),
        "middle edges",
    ),
    "planes that change places": (lambda x: StewartPlatform.cubic(**{**CUBE, "base_height": 0.08 * x}), "middle edges"),
    "a singular pose": (lambda x: compliance_matrix(nearly_singular(1e12 * x), 1e6), "singular"),
    "forces in a singular pose": (lambda x: strut_forces(nearly_singular(1e12 * x), WRENCH), "singular"),
}


@pytest.mark.parametrize("case", LIMITS)
def test_limits_lie_where_they_should(case):
    assert_limit(*LIMITS[case])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: forward_kinematics(PLATFORM, np.ones(5)), "lengths must have shape 6, got 5"),
        (
            lambda: forward_kinematics(PLATFORM, inverse_kinematics(PLATFORM), position=[0.0, 0.0]),
            "position must have shape 3",
        ),
        (lambda: StewartPlatform.from_angles(**{**RING, "base_angles": [0.0] * 5}), "base_angles must have shape 6"),
        (lambda: StewartPlatform.from_angles(**{**RING, "base_radius": 0.0}), "base_radius must be positive, got 0 m"),
        (lambda: StewartPlatform.from_angles(**{**RING, "base_height": np.nan}), r"base's level holds 1 .*NaN"),
        (lambda: replace(PLATFORM, platform_joints=np.ones((5, 3))), "platform_joints must have shape 6 x 3"),
        (lambda: replace(PLATFORM, point=np.full(3, np.nan)), r"point holds 3 .*NaN or infinite"),
        (lambda: stiffness_matrix(PLATFORM, np.ones(5)), "stiffness must have shape 6, got 5"),
        (lambda: strut_forces(PLATFORM, np.ones(5)), "wrench must have shape 6, got 5"),
        (lambda: workspace(PLATFORM, np.ones(5), stroke=0.01), "box must have shape 6, got 5"),
        (lambda: workspace(PLATFORM, BOX, stroke=0.0), r"stroke must be positive, got 0.* m"),
        (lambda: StewartPlatform.cubic(**{**CUBE, "edge_height": -0.2}), r"edge_height must be positive, got -0\.2 m"),
    ],
)
def test_what_makes_no_sense_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
