"""Scenes that turn as a whole: closed forms, published figures, node masses, and integration in the inertial frame."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.transform import Rotation

from nassim import (
    Encoder,
    Joint,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    linearize,
)
from nassim.scene.part import ForceElement, Reading, Row, Sensor, Spring
from nassim.simulation.linearization import spinning_equilibrium
from nassim.simulation.small_motion import assemble
from nassim.simulation.spinning import spinning
from nassim.systems.linear_model import damping


@dataclass(frozen=True)
class Strut(ForceElement):
    """A spring without mass along an inclined line, which turns with the table."""

    name: str
    a: str
    b: str
    stiffness: float

    def says(self, scene):
        """The distance of b from a is stiff."""
        line = scene.point_position(self.b) - scene.point_position(self.a)
        return (Spring(Row.between(self.a, self.b, line / np.linalg.norm(line)), self.stiffness),)


@dataclass(frozen=True)
class Spot(Sensor):
    """Motion of a point along a direction."""

    name: str
    point: str
    direction: tuple
    derivative: int = 0
    unit: str = "m"

    def says(self, scene):
        """It reads the point."""
        return (
            Reading(self.name, self.unit, Row.of_point(self.point, np.array(self.direction)), 1.0, self.derivative),
        )


def spun(scene, velocity, point=(0.0, 0.0, 0.0)):
    return linearize(scene, angular_velocity=velocity, axis_point=point)


def upper(poles):
    """Imaginary parts above zero, ascending."""
    return np.sort(poles.imag[poles.imag > 1e-9 * np.abs(poles).max()])


def random_inertia(seed, size=1e-3):
    """Of a body of six random point masses about their centre: moments that a body can have, in no order."""
    spread = np.random.default_rng(seed).standard_normal((6, 3))
    spread -= spread.mean(axis=0)
    second = size * spread.T @ spread / 6
    return np.trace(second) * np.eye(3) - second


def platform(offset=0.0, **options):
    """A mass on two slides at right angles, the lower of which has next to none, on springs of 1 N/m."""
    centre = np.array([offset, 0.0, 0.0])
    table = RigidBody("table", {"rail": centre}, fixed=True)
    slide = RigidBody("slide", {"rail": np.zeros(3)}, 1e-9, 1e-12 * np.eye(3), centre)
    mass = RigidBody("mass", {"rail": np.zeros(3)}, 1.0, np.diag([0.1, 0.2, 0.25]), centre)
    return Scene(
        "platform",
        (table, slide, mass),
        (Joint("u", "table.rail", "slide.rail", free=("x",)), Joint("v", "slide.rail", "mass.rail", free=("y",))),
        (PointForce("Fu", "mass.rail", "x", "Fu"), PointForce("Fv", "mass.rail", "y", "Fv")),
        (Encoder("u", "table.rail", "mass.rail", "x"), Encoder("v", "table.rail", "mass.rail", "y")),
        (
            SpringDamper("ku", "table.rail", "mass.rail", "x", 1.0, 0.05),
            SpringDamper("kv", "slide.rail", "mass.rail", "y", 1.0, 0.05),
        ),
        **{"damping_ratio": 0.0, **options},
    )


@pytest.mark.parametrize(
    ("spin", "published"),
    [
        (0.1, [-0.027501 + 1.099691j, -0.022499 + 0.899691j]),
        (0.7, [-0.042503 + 1.699841j, -0.007497 + 0.299841j]),
        (1.1, [+0.002498 + 0.099934j]),
    ],
)
def test_platform_on_two_slides(spin, published):
    """T. Dehaeze, C. Collette, Engineering Research Express 3 (2021) 015036: poles in the turning frame."""
    poles = spun(platform(), (0, 0, spin)).poles()
    for expected in published:
        assert np.abs(poles - expected).min() < 2e-6
    assert (poles.real.max() > 0) == (spin > 1)


def test_static_gain_and_coupling_of_the_platform():
    """At W = 0.1: u per Fu at rest is 1 / (k - m W^2); the sign of the Coriolis force: Fu turns v negative."""
    model = spun(platform(), (0, 0, 0.1))
    a, b, c, d = model.matrices
    at = 1j * 0.5
    answer = c @ np.linalg.solve(at * np.eye(len(a)) - a, b) + d
    own, cross = 1 - 0.01 - 0.25 + 0.05 * at, 2 * 0.1 * at
    expected = np.linalg.inv([[own, -cross], [cross, own]])
    np.testing.assert_allclose(answer, expected, rtol=1e-6)
    assert (c @ np.linalg.solve(-a, b))[0, 0] == pytest.approx(1 / 0.99, rel=1e-6)


def test_equilibrium_of_the_platform():
    """A spring beside the axis is stretched by m W^2 r / (k - m W^2); beyond the critical speed nothing holds."""
    found = spinning_equilibrium(platform(offset=0.02), angular_velocity=(0, 0, 0.5))
    assert found["u"] == pytest.approx(0.02 * 0.25 / 0.75, rel=1e-6)
    assert found["v"] == pytest.approx(0.0, abs=1e-12)
    moved = spinning_equilibrium(platform(), angular_velocity=(0, 0, 0.5), axis_point=(0.0, 0.03, 0.7))
    assert moved["v"] == pytest.approx(-0.03 * 0.25 / 0.75, rel=1e-6)
    with pytest.raises(ValueError, match="unstable: an oscillation at 0.01591 Hz that grows"):
        spinning_equilibrium(platform(offset=0.02), angular_velocity=(0, 0, 1.1))


def hexapod():
    """The struts of a published platform as springs, its top plate and a load of 50 kg on it."""
    height, low, high = 0.09, 0.015, 0.015
    feet, heads = np.deg2rad([-10, 10, 110, 130, 230, 250]), np.deg2rad([-50, 50, 70, 170, 190, -70])
    base = {f"a{k}": np.array([0.115 * np.cos(t), 0.115 * np.sin(t), low]) for k, t in enumerate(feet)}
    tops = {f"b{k}": np.array([0.09 * np.cos(t), 0.09 * np.sin(t), height - high]) for k, t in enumerate(heads)}
    plate, load = np.array([0, 0, height - 0.005]), np.array([0, 0, height + 0.2])
    joint = np.array([0, 0, height])
    return Scene(
        "hexapod",
        (
            RigidBody("table", base, fixed=True),
            RigidBody(
                "plate",
                {name: at - plate for name, at in tops.items()} | {"top": joint - plate},
                1.0,
                np.diag([0.1**2 / 4 + 0.01**2 / 12, 0.1**2 / 4 + 0.01**2 / 12, 0.1**2 / 2]),
                plate,
            ),
            RigidBody("load", {"foot": joint - load}, 50.0, np.eye(3), load),
        ),
        (Joint("on", "plate.top", "load.foot"),),
        springs=tuple(Strut(f"strut {k}", f"table.a{k}", f"plate.b{k}", 1.846e6) for k in range(6)),
        damping_ratio=0.0,
    )


def test_spinning_hexapod():
    """Figures computed elsewhere by two routes, for this geometry, at 0 and 60 rpm."""
    standing, _ = damping(linearize(hexapod()))
    np.testing.assert_allclose(standing, [11.2747, 11.2747, 36.9134, 46.7331, 75.0703, 75.0703], atol=6e-5)
    spinning_, _ = damping(spun(hexapod(), (0, 0, 2 * np.pi)))
    np.testing.assert_allclose(spinning_, [10.4091, 12.1414, 36.9134, 46.7331, 74.4199, 75.7247], atol=6e-5)


@pytest.mark.parametrize("moments", [(0.02, 0.03, 0.045), (0.045, 0.03, 0.02), (0.045, 0.02, 0.03)])
def test_free_body_about_a_principal_axis(moments):
    """Euler's equations: rotations at W and at W sqrt((C-A)(C-B) / AB), about the middle axis a drift; drift at W."""
    a, b, c = moments
    turn = Rotation.from_rotvec([0.4, -0.9, 0.5]).as_matrix()
    centre, w = np.array([0.3, -0.1, 0.2]), 7.0
    body = RigidBody("body", {"a": np.zeros(3)}, 1.3, turn @ np.diag(moments) @ turn.T, centre)
    poles = spun(Scene("free", (body,)), w * turn[:, 2], centre + 0.3 * turn[:, 2]).poles()
    rotation = w * np.emath.sqrt(-(c - a) * (c - b) / (a * b))
    expected = [*[1j * w] * 3, *[-1j * w] * 3, rotation, -rotation, 0, 0, 0, 0]
    left = list(poles)
    for pole in expected:
        nearest = int(np.argmin(np.abs(np.array(left) - pole)))
        assert abs(left.pop(nearest) - pole) < 1e-5 * w  # double poles: the root of rounding


def test_spring_held_disc():
    """(A s^2 + k + W^2 (C - B)) (B s^2 + k' + W^2 (C - A)) + (A + B - C)^2 W^2 s^2 = 0, moments A, B, C."""
    a, b, c, w = 0.02, 0.033, 0.05, 40.0
    arms = {f"{k}": 0.1 * np.array([np.cos(t), np.sin(t), 0]) for k, t in enumerate(np.pi / 2 * np.arange(4))}
    table = RigidBody("table", {**arms, "hub": np.zeros(3)}, fixed=True)
    disc = RigidBody("disc", {**arms, "hub": np.zeros(3)}, 2.0, np.diag([a, b, c]))
    stiffness = (3e3, 5e3, 3e3, 5e3)
    springs = [
        SpringDamper(name, f"table.{name}", f"disc.{name}", "z", k) for name, k in zip(arms, stiffness, strict=True)
    ]
    scene = Scene("disc", (table, disc), (Joint("hub", "table.hub", "disc.hub", ("rx", "ry")),), springs=tuple(springs))
    k_x, k_y = 2 * 5e3 * 0.01, 2 * 3e3 * 0.01
    one, other = [a, 0, k_x + w**2 * (c - b)], [b, 0, k_y + w**2 * (c - a)]
    whole = np.polyadd(np.polymul(one, other), [(a + b - c) ** 2 * w**2, 0, 0])
    found = upper(spun(replace(scene, damping_ratio=0.0), (0, 0, w)).poles())
    np.testing.assert_allclose(found, upper(np.roots(whole)), rtol=1e-8)


ARM, REACH, HUB = 0.12, 0.17, np.array([0.3, -0.2, 0.1])
"""Of pendulums: centre from the hinge, hinge from the axis, a point of the axis [m]."""


def pendulum(free, body=None):
    """A bar along x, hinged beside an axis along z."""
    hinge = HUB + [REACH, 0, 0]
    table = RigidBody("table", {"hinge": hinge}, fixed=True)
    if body is None:
        turn = Rotation.from_rotvec([0.3, 0, 0]).as_matrix()
        inertia = turn @ np.diag([1e-3, 3e-3, 3.4e-3]) @ turn.T
        inertia[0, 1] = inertia[1, 0] = inertia[0, 2] = inertia[2, 0] = 0.0
        body = RigidBody("bar", {"left": np.array([-ARM, 0, 0])}, 0.9, inertia, hinge + [ARM, 0, 0])
    return Scene("pendulum", (table, body), (Joint("hinge", "table.hinge", "bar.left", (free,)),), damping_ratio=0.0)


@pytest.mark.parametrize("free", ["ry", "rz"])
def test_pendulum_beside_the_axis(free):
    """In the plane W sqrt(m R l / J); out of it W sqrt((m R l + int x^2 - int z^2) / J), J about the hinge."""
    scene, w = pendulum(free), 11.0
    bar = scene.bodies[1]
    moments = np.diag(bar.inertia) + bar.mass * ARM**2 * np.array([0, 1, 1])
    pull = bar.mass * REACH * ARM
    expected = {"rz": pull / moments[2], "ry": (pull + moments[2] - moments[0]) / moments[1]}[free]
    found = upper(spun(scene, (0, 0, w), HUB).poles())
    assert found == pytest.approx([w * np.sqrt(expected)], rel=1e-9)


def test_pendulum_inwards_falls():
    """Hinged outside and drawn inwards, it stands on its head."""
    scene = pendulum("rz")
    model = spun(scene, (0, 0, 11.0), HUB + [1.0, 0, 0])
    bar = scene.bodies[1]
    rate = 11.0 * np.sqrt(bar.mass * (1.0 - REACH) * ARM / (bar.inertia[2, 2] + bar.mass * ARM**2))
    assert model.poles().real.max() == pytest.approx(rate, rel=1e-9)
    with pytest.raises(ValueError, match="unstable: a drift that grows"):
        spinning_equilibrium(scene, angular_velocity=(0, 0, 11.0), axis_point=HUB + [1.0, 0, 0])


def test_drawn_far_from_its_equilibrium():
    with pytest.raises(ValueError, match=r"body 'bar' comes to rest turned by 0\.59 rad.* draw the scene nearer"):
        spun(pendulum("rz"), (0, 0, 5.0), HUB + [0, 0.1, 0])
    with pytest.warns(UserWarning, match=r"turned by 0\.041 rad.* off by a share of the same size"):
        spun(pendulum("rz"), (0, 0, 5.0), HUB + [0, 0.007, 0])


def test_no_equilibrium_at_all():
    """A body that slides along a slope is driven up it by a constant part of the centrifugal force."""
    rail = RigidBody("rail", {"end": np.array([0.1, 0.2, 0.0])}, fixed=True)
    block = RigidBody("block", {"end": np.zeros(3)}, 1.0, np.eye(3), np.array([0.1, 0.2, 0.0]))
    slide = Scene("slide", (rail, block), (Joint("slide", "rail.end", "block.end", ("z",)),))
    with pytest.raises(ValueError, match="scene 'slide' has no spinning equilibrium: a free motion is driven outwards"):
        spun(slide, (1.0, 0, 1.0))
    up = slide.bodies[1]
    assert np.abs(spun(replace(slide, bodies=(rail, up)), (0, 0, 1.0)).poles()).max() == 0


def halves(*, joined):
    """A body on springs askew, whole or in two halves with a rigid joint between; its centre is beside the axis."""
    parts = [
        (0.7, random_inertia(3), np.array([0.1, 0.02, -0.03])),
        (0.4, random_inertia(4), np.array([0.13, 0.1, 0.05])),
    ]
    mass = sum(m for m, _, _ in parts)
    centre = sum(m * c for m, _, c in parts) / mass
    inertia = sum(
        j + m * ((c - centre) @ (c - centre) * np.eye(3) - np.outer(c - centre, c - centre)) for m, j, c in parts
    )
    ends = {f"{k}": centre + 0.05 * v for k, v in enumerate(np.random.default_rng(1).standard_normal((7, 3)))}
    feet = {k: end + 0.1 * v for (k, end), v in zip(ends.items(), np.random.default_rng(2).standard_normal((7, 3)))}
    table = RigidBody("table", feet, fixed=True)
    if joined:
        a, b = (
            RigidBody(name, {k: end - c for k, end in ends.items()}, m, j, c)
            for name, (m, j, c) in zip("ab", parts, strict=True)
        )
        bodies, joints = (table, a, b), (Joint("glue", "a.6", "b.6"),)
    else:
        bodies = (table, RigidBody("a", {k: end - centre for k, end in ends.items()}, mass, inertia, centre))
        joints = ()
    springs = tuple(
        Strut(k, f"table.{k}", f"{'b' if joined and int(k) > 2 else 'a'}.{k}", 3e3 + 500 * int(k))
        for k in list(ends)[:6]
    )
    sensors = tuple(Spot(axis, "a.0", tuple(v)) for axis, v in zip("xyz", np.eye(3), strict=True))
    return Scene("halves", bodies, joints, sensors=sensors, springs=springs, damping_ratio=0.02)


@pytest.mark.filterwarnings("ignore:under the spin")
def test_a_body_in_two_halves():
    """What the joint between bears is stiffness too."""
    w, point = np.array([3.0, -5.0, 7.0]), np.array([0.05, 0.0, 0.1])
    whole, both = (spun(halves(joined=joined), w, point) for joined in (False, True))
    np.testing.assert_allclose(upper(both.poles()), upper(whole.poles()), rtol=1e-8)
    assert np.abs(upper(whole.poles()) / upper(linearize(halves(joined=False)).poles()) - 1).max() > 1e-3
    rest = [spinning_equilibrium(halves(joined=j), angular_velocity=w, axis_point=point) for j in (False, True)]
    assert rest[0] == pytest.approx(rest[1], rel=1e-8)
    assert abs(rest[0]["x"]) > 1e-5


def test_coriolis_forces_do_no_work():
    """G is skew, K symmetric, so without damping the Jacobi integral q'^2 + q (K q) of a run is constant."""
    scene = replace(halves(joined=True), damping_ratio=0.0)
    with pytest.warns(UserWarning, match="under the spin"):
        spin = spinning(assemble(scene), (3.0, -5.0, 7.0), (0.05, 0.0, 0.1))
    assert np.abs(spin.gyroscopic + spin.gyroscopic.T).max() <= 1e-12 * np.abs(spin.gyroscopic).max()
    assert np.abs(spin.stiffness - spin.stiffness.T).max() <= 1e-12 * np.abs(spin.stiffness).max()
    assembly = assemble(scene)
    energy = scipy.linalg.block_diag(assembly.stiffness + spin.stiffness, assembly.mass)
    n = len(assembly.mass)
    inverse = np.linalg.inv(assembly.mass)
    step = scipy.linalg.expm(
        0.13
        * np.block(
            [
                [np.zeros((n, n)), np.eye(n)],
                [-inverse @ (assembly.stiffness + spin.stiffness), -inverse @ spin.gyroscopic],
            ]
        )
    )
    before = np.random.default_rng(5).standard_normal(2 * n)
    after = step @ before
    assert after @ energy @ after == pytest.approx(before @ energy @ before, rel=1e-9)
    assert spinning(assembly, (0, 0, 0), (1, 2, 3)).gyroscopic.any() == False  # noqa: E712


def test_without_spin_it_is_the_model_at_rest():
    still, model = linearize(halves(joined=True)), spun(halves(joined=True), (0, 0, 0))
    for a, b in zip(still.matrices, model.matrices, strict=True):
        assert np.array_equal(a, b)


def test_gyroscopic_matrix_is_of_first_and_the_rest_of_second_order():
    """Twice as fast: the Coriolis forces double, the centrifugal ones and their stiffness quadruple."""
    assembly = assemble(halves(joined=True))
    slow, fast = (spinning(assembly, v * np.array([0.3, -0.5, 0.7]), (0.05, 0, 0.1)) for v in (0.1, 0.2))
    np.testing.assert_allclose(fast.gyroscopic, 2 * slow.gyroscopic, rtol=0, atol=1e-12 * np.abs(fast.gyroscopic).max())
    np.testing.assert_allclose(fast.stiffness, 4 * slow.stiffness, rtol=0, atol=1e-4 * np.abs(fast.stiffness).max())
