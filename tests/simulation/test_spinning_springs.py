"""What springs of every kind and joints of any axes bear in spinning scenes."""

import numpy as np
import pytest

from nassim import Bushing, Encoder, Joint, RigidBody, Scene, SpringDamper, linearize, placed, revolute
from nassim.systems import damping

SPEED, RADIUS, HUB = 9.0, 0.5, 0.2
LENGTH = RADIUS - HUB
INERTIA = np.diag([2e-3, 3e-3, 4e-3])
SKEW = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
SKEW *= np.linalg.det(SKEW)


def wire(spring, free=("x", "y", "z")):
    """A mass that may shift but not turn, on a radial spring so stiff that it keeps its length."""
    table = RigidBody("table", {"hub": [HUB, 0, 0], "rail": [RADIUS, 0, 0]}, fixed=True)
    mass = RigidBody("mass", {"c": np.zeros(3)}, 0.7, INERTIA, [RADIUS, 0, 0])
    joints = (Joint("rail", "table.rail", "mass.c", free),)
    return Scene("wire", (table, mass), joints, springs=(spring,), damping_ratio=0.0)


def frequencies(scene, angular_velocity=(0, 0, SPEED), point=(0, 0, 0)):
    return np.sort(damping(linearize(scene, angular_velocity=angular_velocity, axis_point=point))[0]) * 2 * np.pi


def test_a_mass_on_a_radial_wire_swings_like_a_pendulum():
    """Out of the plane W sqrt(r / l), in it W sqrt(hub / l), as its tension m W^2 r turns with it."""
    found = frequencies(wire(SpringDamper("wire", "table.hub", "mass.c", "line", 1e9)))
    expected = SPEED * np.sqrt([HUB / LENGTH, RADIUS / LENGTH])
    np.testing.assert_allclose(found[:2], expected, rtol=1e-4)


def test_a_spring_along_a_direction_of_the_table_bears_nothing_across():
    """Its direction does not follow the mass: neutral out of the plane, unstable in it."""
    for spring in (
        SpringDamper("s", "table.hub", "mass.c", "x", 1e9),
        SpringDamper("s", "table.hub", "mass.c", (1.0, 0, 0), 1e9, frame="table.hub"),
    ):
        model = linearize(wire(spring), angular_velocity=(0, 0, SPEED))
        assert model.poles().real.max() == pytest.approx(SPEED, rel=1e-4)


def test_a_spring_that_turns_with_the_mass():
    """A stiff spring along axes of a mass that may turn about z: the force m W^2 r stays on the mass's own line."""
    stiff = SpringDamper("s", "table.hub", "mass.c", (1.0, 0, 0), 1e9, frame="mass.c")
    line = SpringDamper("l", "table.hub", "mass.c", "line", 1e9)
    # Held at the hub by its own axes, the mass turns as a pendulum whose arm reaches there; a bar with a hinge does so.
    table = RigidBody("table", {"hub": [HUB, 0, 0]}, fixed=True)
    bar = RigidBody("mass", {"hub": [-LENGTH, 0, 0]}, 0.7, INERTIA, [RADIUS, 0, 0])
    hinged = Scene("bar", (table, bar), (revolute("hinge", "table.hub", "mass.hub", "z"),), damping_ratio=0.0)
    expected = SPEED * np.sqrt(0.7 * HUB * LENGTH / (INERTIA[2, 2] + 0.7 * LENGTH**2))
    np.testing.assert_allclose(frequencies(hinged)[:1], [expected], rtol=1e-9)
    across = SpringDamper("t", "table.hub", "mass.c", (0, 1.0, 0), 1e9, frame="mass.c")
    held = Scene("held", wire(line).bodies, (Joint("flat", "table.rail", "mass.c", ("x", "y", "rz")),),
                 springs=(stiff, across), damping_ratio=0.0)  # fmt: skip
    np.testing.assert_allclose(frequencies(held)[:1], [expected], rtol=1e-4)


def test_a_stiff_bushing_is_a_joint():
    """Of a bar hinged beside the axis about an odd axis, on a soft torsion spring."""
    table = RigidBody("table", {"hub": [HUB, 0.05, 0.03]}, fixed=True)
    bar = RigidBody("bar", {"hub": [-LENGTH, 0, 0.02]}, 0.7, INERTIA, [RADIUS, 0.05, 0.01])
    soft = Bushing("hub", "table.hub", "bar.hub", [0, 0, 0, 0, 0, 40.0], axes=SKEW)
    stiff = Bushing("hub", "table.hub", "bar.hub", [1e9, 1e9, 1e9, 1e7, 1e7, 40.0], axes=SKEW)
    hinge = Joint("hub", "table.hub", "bar.hub", ("rz",), SKEW)
    found, expected = (
        frequencies(Scene("hub", (table, bar), joints, springs=(spring,), damping_ratio=0.0))
        for joints, spring in (((), stiff), ((hinge,), soft))
    )
    np.testing.assert_allclose(found[:1], expected[:1], rtol=1e-4)


def test_a_spinning_scene_turned_as_a_whole_has_the_same_poles():
    table = RigidBody("table", {"hub": [HUB, 0.05, 0.03], "wall": [0.1, 0.4, 0.2]}, fixed=True)
    bar = RigidBody(
        "bar",
        {"hub": [-LENGTH, 0, 0.02], "tip": [0.1, 0.05, 0]},
        0.7,
        INERTIA,
        [RADIUS, 0.05, 0.01],
        rotation=np.eye(3),
    )
    scene = Scene(
        "machine",
        (table, bar),
        (Joint("hub", "table.hub", "bar.hub", ("rz", "ry")),),
        (),
        (Encoder("e", "table.wall", "bar.tip", "x"),),
        (
            SpringDamper("leg", "table.wall", "bar.tip", "line", 4e3, 1.0),
            SpringDamper("rail", "table.wall", "bar.tip", (0.0, 0.6, 0.8), 2e3, 2.0, frame="table.wall"),
            Bushing(
                "rubber",
                "table.hub",
                "bar.hub",
                np.diag([0, 0, 0, 10.0, 20.0, 30.0]),
                np.diag([0, 0, 0, 0.01, 0.02, 0.03]),
            ),
        ),
        damping_ratio=0.0,
    )
    turned = placed(scene, "there", position=(0.3, -0.2, 0.1), rotation=SKEW)
    velocity = np.array([2.0, -1.0, 7.0])
    found = linearize(turned, angular_velocity=SKEW @ velocity, axis_point=(0.3, -0.2, 0.1)).poles()
    expected = linearize(scene, angular_velocity=velocity).poles()
    for pole in expected:
        assert np.abs(found - pole).min() < 1e-7 * np.abs(pole)
    assert np.abs(expected - linearize(scene).poles()[:, None]).min(axis=0).max() > 0.05
