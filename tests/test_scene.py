"""Scenes check themselves: names, gaps, stacks, encoders."""

from dataclasses import replace

import numpy as np
import pytest

from nassim import (
    Encoder,
    FlexibleBody,
    Joint,
    ReducedBody,
    RemotePoint,
    RigidBody,
    Scene,
    StackActuator,
    StackSensor,
)

LENGTH, MASS = 0.1, 2.0
TURN = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # z axis of the body: world's x


def reduced(top=(0.0, 0.0, LENGTH)):
    """Half of the mass at each of two remote points, joined by springs: a reduced body made by hand."""
    points = (RemotePoint("bottom", "floor", (0, 0, 0)), RemotePoint("top", "roof", top))
    basis = np.zeros((2, 3, 12))  # displacement of the two masses per coordinate
    for k in range(2):
        basis[k, :, 6 * k : 6 * k + 3] = np.eye(3)
    fields = np.array([[1.0, *points[k].position, *basis[k].T.ravel()] for k in range(2)])
    stiffness = 1e6 * np.kron([[1, -1], [-1, 1]], np.eye(6))
    mass = np.einsum("kci,kcj->ij", basis, basis) * MASS / 2
    return ReducedBody("spring", points, mass, stiffness, fields.T @ fields * MASS / 2)


BASE = RigidBody("base", {"mount": (0, 0, 0.02)}, position=(0, 0, -0.02), fixed=True)
LOAD_POINTS = {"foot": (0, 0, -0.05), "side": (0.1, 0, 0)}
LOAD = RigidBody("load", LOAD_POINTS, 5.0, 0.01 * np.eye(3), position=(0, 0, LENGTH + 0.05))
STRUT = FlexibleBody("strut", reduced())
SCENE = Scene(
    "bench",
    bodies=(BASE, STRUT, LOAD),
    joints=(Joint("low", "base.mount", "strut.bottom"), Joint("high", "strut.top", "load.foot", free="z")),
    actuators=(StackActuator("stack", "strut.bottom", "strut.top", 5.0, "voltage", gain=20.0),),
    sensors=(
        StackSensor("sensor", "strut.bottom", "strut.top", 1e6),
        Encoder("encoder", "base.mount", "load.side"),
    ),
)


def test_hand_made_body_is_consistent():
    assert STRUT.reduced.mass == pytest.approx(MASS)
    np.testing.assert_allclose(STRUT.reduced.center_of_mass, [0, 0, LENGTH / 2])


def test_scene_tells_its_inputs_outputs_and_points():
    assert SCENE.inputs == ("voltage",)
    assert SCENE.outputs == ("sensor", "encoder")
    assert [sensor.unit for sensor in SCENE.sensors] == ["V", "m"]
    assert SCENE.flexible_bodies == (STRUT,)
    assert SCENE.joints[1].free == ("z",)
    np.testing.assert_allclose(SCENE.point_position("load.side"), [0.1, 0, LENGTH + 0.05])
    np.testing.assert_allclose(SCENE.damping_ratio, [0.01])


def test_actuators_may_share_an_input():
    two = (SCENE.actuators[0], replace(SCENE.actuators[0], name="second"))
    assert replace(SCENE, actuators=two).inputs == ("voltage",)


def test_placement_of_flexible_bodies():
    body = FlexibleBody("strut", reduced(), position=(1, 2, 3), rotation=TURN)
    np.testing.assert_allclose(body.point_position("top"), [1 + LENGTH, 2, 3])
    assert Scene("turned", (body,)).split("strut.top") == (body, "top")


def test_frame_rides_on_the_first_jointed_point():
    assert SCENE.frame_point(STRUT) == "bottom"
    hanging = replace(SCENE, joints=SCENE.joints[1:])
    assert hanging.frame_point(STRUT) == "top"
    assert replace(SCENE, joints=()).frame_point(STRUT) == "bottom"
    chosen = replace(STRUT, frame="top")
    assert replace(SCENE, bodies=(BASE, chosen, LOAD)).frame_point(chosen) == "top"


SHIFTED = replace(STRUT, position=(1e-6, 0, 0))
NO_PARTS = {"joints": (), "actuators": (), "sensors": ()}


def with_joint(a, b):
    return {"joints": (Joint("j", a, b),)}


def with_stack(start, end, kind="actuators"):
    if kind == "actuators":
        return {kind: (StackActuator("stack", start, end, 5.0, "voltage"),)}
    return {kind: (StackSensor("stack", start, end, 1e6),)}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (with_joint("base.mount", "strut.top"), "'base.mount' and 'strut.top' are 0.1 m apart; .* coincide"),
        ({"bodies": (BASE, SHIFTED, LOAD)}, "joint 'low': .* are 1e-06 m apart"),
        (with_joint("floor.mount", "strut.top"), "unknown body 'floor'; known: base, strut, load"),
        (with_joint("base.foot", "strut.top"), "unknown point of 'base' 'foot'; known: mount"),
        (with_joint("base.mount", "strut.side"), "unknown remote point 'side'; known: bottom, top"),
        (with_joint("base", "strut.top"), "a point is written 'body.point', got 'base'"),
        ({"bodies": (BASE, STRUT, LOAD, BASE)}, "body names must differ; used more than once: base"),
        ({"joints": SCENE.joints[:1] * 2}, "joint names must differ; used more than once: low"),
        ({"actuators": SCENE.actuators * 2}, "actuator names must differ"),
        ({"sensors": SCENE.sensors[:1] * 2}, "sensor names must differ"),
        ({"bodies": (BASE,), **NO_PARTS}, "'bench' has no body that can move"),
        ({"bodies": (), **NO_PARTS}, "'bench' has no body that can move"),
        ({"damping_ratio": -0.01}, "damping_ratio must not be negative, got -0.01"),
        ({"damping_ratio": [0.01, np.nan]}, "damping_ratio holds 1 value.* NaN"),
        ({"gravity": (0, 0, np.nan)}, "gravity holds 1 value.* NaN"),
        ({"gravity": -9.81}, "gravity must have shape 3, got a number"),
        (with_stack("strut.top", "strut.top"), "stack 'stack': .* must be two points of one flexible body"),
        (with_stack("strut.top", "load.foot"), "must be two points of one flexible body"),
        (with_stack("load.foot", "load.side"), "must be two points of one flexible body"),
        (with_stack("strut.top", "load.foot", "sensors"), "must be two points of one flexible body"),
        (with_stack("strut.top", "strut.side"), "unknown remote point 'side'; known: bottom, top"),
        (with_stack("strut.top", "beam.side", "sensors"), "unknown body 'beam'; known: base, strut, load"),
        ({"sensors": (Encoder("e", "base.mount", "strut.top"),)}, "'e': 'strut.top' must be"),
        ({"sensors": (Encoder("e", "strut.top", "base.mount"),)}, "'e': 'strut.top' must be"),
        ({"sensors": (Encoder("e", "base.mount", "load.top"),)}, "'load' 'top'; known: foot, side"),
    ],
)
def test_scene_checks_itself(change, message):
    with pytest.raises(ValueError, match=message):
        replace(SCENE, **change)


def test_stack_between_points_in_one_place():
    flat = FlexibleBody("strut", reduced(top=(0, 0, 0)))
    with pytest.raises(ValueError, match=r"its ends 'strut.bottom' and 'strut.top' lie in one place"):
        Scene("flat", (flat,), actuators=SCENE.actuators)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": None}, "rigid body 'load' can move, so it needs a mass and an inertia"),
        ({"inertia": None}, r"needs a mass and an inertia \(or fixed=True\)"),
        ({"mass": 0.0}, "'load': mass must be positive, got 0 kg"),
        ({"mass": np.nan}, "'load': mass holds 1 value.* NaN"),
        ({"inertia": -np.eye(3)}, "'load': inertia must be symmetric and positive definite"),
        ({"inertia": np.triu(np.ones((3, 3))) + np.eye(3)}, "inertia must be symmetric"),
        ({"inertia": np.ones(3)}, "inertia must have shape 3 x 3, got 3"),
        ({"inertia": np.full((3, 3), np.nan)}, "inertia holds 9 value.* NaN"),
        ({"position": (0, 0, np.nan)}, "'load': position holds 1 value.* NaN"),
        ({"points": {"foot": (0, np.inf, 0)}}, "'load': point 'foot' holds 1 value.* infinite"),
    ],
)
def test_rigid_body_checks_itself(change, message):
    with pytest.raises(ValueError, match=message):
        replace(LOAD, **change)


def test_fixed_body_needs_no_mass():
    assert RigidBody("granite", {}, fixed=True).mass is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fidelity": "magic"}, "unknown fidelity 'magic'; known: .*ffrf"),
        ({"frame": "side"}, "unknown remote point 'side'; known: bottom, top"),
        ({"rotation": 2 * np.eye(3)}, "'strut': rotation must be a proper orthogonal matrix"),
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "proper orthogonal"),
        ({"rotation": np.full((3, 3), np.nan)}, "rotation holds 9 value.* NaN"),
        ({"position": (0, 0)}, "'strut': position must have shape 3, got 2"),
        ({"angular_velocity": (0, 0, np.nan)}, "'strut': angular_velocity holds 1 value.* NaN"),
    ],
)
def test_flexible_body_checks_itself(change, message):
    with pytest.raises(ValueError, match=message):
        replace(STRUT, **change)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Joint("j", "a.b", "c.d", free=("x", "w")), "direction 'w'; known: x, y, z, rx, ry, rz"),
        (lambda: Encoder("e", "a.b", "c.d", axis="rz"), "unknown axis 'rz'; known: x, y, z"),
        (lambda: StackActuator("s", "a.b", "a.c", np.nan, "u"), "force_per_volt holds 1 value.* NaN"),
        (lambda: StackActuator("s", "a.b", "a.c", 1.0, "u", gain=np.inf), "gain holds 1 value.* infinite"),
        (lambda: StackSensor("s", "a.b", "a.c", np.nan), "voltage_per_elongation holds 1 value.* NaN"),
    ],
)
def test_connections_check_themselves(make, message):
    with pytest.raises(ValueError, match=message):
        make()
