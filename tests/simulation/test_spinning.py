"""Scenes that turn as a whole: closed forms, published figures, node masses, and integration in the inertial frame."""

import warnings
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
import scipy.linalg
from conftest import lattice
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from nassim import (
    AngleSensor,
    Bushing,
    Controller,
    Drive,
    Encoder,
    FlexibleBody,
    Joint,
    Loop,
    PointForce,
    ReducedBody,
    RemotePoint,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    VoltageSensor,
    craig_bampton,
    frequency_response,
    linearize,
    prismatic,
    revolute,
    simulate,
)
from nassim.base.modal import decay_poles
from nassim.base.rigid_motion import rigid_transfer, skew
from nassim.bodies.piezo import PortCoupling
from nassim.scene.forces import PointTorque
from nassim.scene.measures import Displacement
from nassim.scene.part import Actuator, ForceElement, Sensor
from nassim.scene.terms import AppliedForce, Output, Spring
from nassim.simulation.linear.closed_linearization import linearize_closed
from nassim.simulation.linear.linearization import spinning_equilibrium
from nassim.simulation.loaded.geometric_stiffness import GeometricStiffness, frames
from nassim.simulation.loaded.loaded_state import loaded_state
from nassim.simulation.loaded.loads import spin_loads
from nassim.simulation.loaded.spinning import inertia_terms
from nassim.simulation.model.assembly import assemble
from nassim.systems.linear_model import damping


@dataclass(frozen=True)
class Strut(ForceElement):
    """A spring without mass along an inclined line, which turns with the table."""

    name: str
    a: str
    b: str
    stiffness: float

    def terms(self, scene):
        """The distance of b from a is stiff."""
        line = scene.point_position(self.b) - scene.point_position(self.a)
        return (Spring(Displacement.between(self.a, self.b, line / np.linalg.norm(line)), self.stiffness),)


@dataclass(frozen=True)
class Pusher(Actuator):
    """A force that drives two points apart along the line between them."""

    name: str
    a: str
    b: str

    def terms(self, scene):
        """It pushes b away from a."""
        line = scene.point_position(self.b) - scene.point_position(self.a)
        return (AppliedForce(self.name, "N", Displacement.between(self.a, self.b, line / np.linalg.norm(line))),)


@dataclass(frozen=True)
class Length(Sensor):
    """Elongation of the line between two points."""

    name: str
    a: str
    b: str
    unit: str = "m"

    def terms(self, scene):
        """It reads the distance of b from a."""
        line = scene.point_position(self.b) - scene.point_position(self.a)
        return (Output(self.name, "m", Displacement.between(self.a, self.b, line / np.linalg.norm(line))),)


@dataclass(frozen=True)
class Spot(Sensor):
    """Motion of a point along a direction."""

    name: str
    point: str
    direction: tuple
    derivative: int = 0
    unit: str = "m"

    def terms(self, scene):
        """It reads the point."""
        return (
            Output(self.name, self.unit, Displacement(((self.point, np.array(self.direction)),)), 1.0, self.derivative),
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


def test_loops_close_on_the_spinning_model():
    """A loop without gain leaves the platform's published poles where they are."""
    idle = Controller([[0.0]], [[0.0]], [[0.0]], [[0.0]], 100.0)
    looped = platform(loops=(Loop("idle", idle, ("u",), ("Fu",)),))
    poles = linearize_closed(looped, continuous=True, angular_velocity=(0, 0, 0.1)).poles()
    assert np.abs(poles - (-0.027501 + 1.099691j)).min() < 2e-6


def test_loops_of_what_turns_about_an_axis_beside_it():
    """A pendulum hinged beside the axis, W sqrt(m e L / (m L^2 + J)), with a loop that adds stiffness; sampled too."""
    mass, moment, arm, beside, spin, rate = 0.5, 4e-3, 0.2, 0.15, 7.0, 200.0
    axis, out = np.array([0.3, -0.2, 0.1]), np.array([0.6, 0.8, 0.0])
    body = RigidBody("p", {"h": -arm * out}, mass, np.diag([2e-3, 3e-3, moment]), axis + (beside + arm) * out)
    table = RigidBody("table", {"h": axis + beside * out}, fixed=True)
    gain = Controller(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-2.0]], rate, delay=0)
    other = replace(gain, D=[[0.0]], sample_rate=3 * rate)
    scene = Scene(
        "p", (table, body), (Joint("hinge", "table.h", "p.h", free="rz"),), (PointTorque("t", "p.h", "z", "t"),),
        (AngleSensor("a", "table.h", "p.h"),),
        loops=(Loop("stiff", gain, "a", "t"), Loop("idle", other, "a", "t")), damping_ratio=0.0,
    )  # fmt: skip
    turning = {"angular_velocity": (0, 0, spin), "axis_point": axis}
    square = mass * spin**2 * beside * arm / (mass * arm**2 + moment)
    model = linearize_closed(scene, loops=["stiff"], **turning)
    assert model.time_step == pytest.approx(1 / rate)
    phi = scipy.linalg.expm(np.array([[0, 1, 0], [-square, 0, 1], [0, 0, 0]]) / rate)
    closed = phi[:2, :2] + np.outer(phi[:2, 2], [-2.0 / (mass * arm**2 + moment), 0])
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(model.A)), np.sort_complex(np.linalg.eigvals(closed)))
    idle = linearize_closed(scene, loops=["idle"], **turning)
    assert idle.time_step == pytest.approx(1 / (3 * rate))
    np.testing.assert_allclose(np.abs(np.angle(np.linalg.eigvals(idle.A)[:2])), np.sqrt(square) / (3 * rate), rtol=1e-6)


def test_equilibrium_of_the_platform():
    """A spring beside the axis is stretched by m W^2 r / (k - m W^2); beyond the critical speed nothing holds."""
    found = spinning_equilibrium(platform(offset=0.02), angular_velocity=(0, 0, 0.5))
    assert found["u"] == pytest.approx(0.02 * 0.25 / 0.75, rel=1e-6)
    assert found["v"] == pytest.approx(0.0, abs=1e-12)
    moved = spinning_equilibrium(platform(), angular_velocity=(0, 0, 0.5), axis_point=(0.0, 0.03, 0.7))
    assert moved["v"] == pytest.approx(-0.03 * 0.25 / 0.75, rel=1e-6)
    with pytest.raises(ValueError, match=r"unstable: an oscillation at 0\.01591 Hz that grows"):
        spinning_equilibrium(platform(offset=0.02), angular_velocity=(0, 0, 1.1))


@pytest.mark.parametrize("offset", [0.0, 0.02])
def test_a_stage_that_moves_along_a_radius_pushes_its_load_aside(offset):
    """m y'' + c y' + (k - m W^2) y = -2 m W x' + c z' + k z, where x and z are the stroke's parts across and along it.

    Also where the centrifugal force moves the load.
    """
    m, c, k, w = 1.5, 4.0, 600.0, 6.0
    axes = Rotation.from_rotvec([0.3, -0.5, 0.4]).as_matrix()
    ground = RigidBody("ground", {"c": np.zeros(3)}, fixed=True)
    carrier = RigidBody("carrier", {"c": np.zeros(3), "seat": offset * axes[:, 1]}, 0.4, 1e-3 * np.eye(3))
    load = RigidBody("load", {"c": np.zeros(3)}, m, np.diag([1e-3, 2e-3, 3e-3]), offset * axes[:, 1])
    slide = prismatic("slide", "ground.c", "carrier.c", axes @ [0.8, 0.6, 0.0])
    guide = prismatic("guide", "carrier.seat", "load.c", axes[:, 1])
    spring = SpringDamper("spring", "carrier.seat", "load.c", axes[:, 1], k, c)
    read = (Encoder("aside", "ground.c", "load.c", axes[:, 1]),)
    scene = Scene("stage", (ground, carrier, load), (slide, guide), (Drive("drive", "slide", input="stroke"),), read)
    model = spun(replace(scene, springs=(spring,), damping_ratio=0.0), w * axes[:, 2])
    frequency = np.array([0.5, 2.0, 3.1, 9.0])
    s = 2j * np.pi * frequency
    expected = (0.6 * (k + c * s) - 0.8 * 2 * m * w * s) / (m * s**2 + c * s + k - m * w**2)
    found = frequency_response(model, frequency).response("aside", "stroke")
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_at_the_critical_speed():
    """The mass moves freely, if it is in the middle; beside it, nothing is at rest."""
    block = RigidBody("block", {"p": np.zeros(3)}, 1.0, np.eye(3))
    table = RigidBody("table", {"p": np.zeros(3)}, fixed=True)
    spring = SpringDamper("spring", "table.p", "block.p", "x", 1.0)
    scene = Scene("critical", (table, block), (Joint("x", "table.p", "block.p", ("x",)),), springs=(spring,))
    assert np.abs(spun(replace(scene, damping_ratio=0.0), (0, 0, 1.0)).poles()).max() < 1e-7
    with pytest.raises(ValueError, match="that nothing holds, or that is at its critical speed"):
        spun(scene, (0, 0, 1.0), (0.01, 0.0, 0.0))


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
        actuators=tuple(Pusher(f"F{k}", f"table.a{k}", f"plate.b{k}") for k in range(6)),
        sensors=tuple(Length(f"d{k}", f"table.a{k}", f"plate.b{k}") for k in range(6)),
        springs=tuple(Strut(f"strut {k}", f"table.a{k}", f"plate.b{k}", 1.846e6) for k in range(6)),
        damping_ratio=0.0,
    )


def test_spinning_hexapod():
    """Figures computed elsewhere by two routes, for this geometry, at 0 and 60 rpm."""
    standing, _ = damping(linearize(hexapod()))
    np.testing.assert_allclose(standing, [11.2747, 11.2747, 36.9134, 46.7331, 75.0703, 75.0703], atol=6e-5)
    spinning_, _ = damping(spun(hexapod(), (0, 0, 2 * np.pi)))
    np.testing.assert_allclose(spinning_, [10.4091, 12.1414, 36.9134, 46.7331, 74.4199, 75.7247], atol=6e-5)


@pytest.mark.parametrize(("leak", "growth", "least"), [(0.0, 0.552, None), (2 * np.pi, None, 0.104)])
def test_force_feedback_in_a_spinning_hexapod(leak, growth, least):
    """Six integrators of the struts' tension, F' = g (k d - F) - leak F: pure ones are unstable at any speed."""
    a, b, c, _ = spun(hexapod(), (0, 0, 2 * np.pi)).matrices
    gain, eye = 100.0, np.eye(6)
    poles = np.linalg.eigvals(np.block([[a, b], [gain * 1.846e6 * c, -(gain + leak) * eye]]))
    if growth is not None:
        assert poles.real.max() == pytest.approx(growth, abs=6e-4)
    else:
        swinging = poles[poles.imag > 0]
        assert poles.real.max() < 0
        assert (-swinging.real / np.abs(swinging)).min() == pytest.approx(least, abs=6e-4)


@pytest.mark.parametrize("spin", [1.0, 8.0])
def test_stretch_of_a_free_dumbbell(spin):
    """w^2 = k / m - W^2 + 4 W^2 m L^2 / J by the conservation of angular momentum, m the reduced mass; free to turn."""
    point = np.array([0.2, -0.3, 0.4])
    light, heavy, length, stiffness = 0.4, 1.1, 0.5, 300.0
    along = np.array([0, length / (light + heavy), 0])
    ends = [point - heavy * along, point + light * along]
    bodies = [
        RigidBody(name, {"end": ends[0] - at}, mass, inertia * np.diag([1.0, 0.9, 1.3]), at)
        for name, at, mass, inertia in zip("ab", ends, (light, heavy), (2e-3, 5e-3), strict=True)
    ]
    link, spring = Joint("rail", "a.end", "b.end", ("y",)), SpringDamper("spring", "a.end", "b.end", "y", stiffness)
    scene = Scene("dumbbell", tuple(bodies), (link,), springs=(spring,), damping_ratio=0.0)
    poles = spun(scene, (0, 0, spin), point).poles()
    m = light * heavy / (light + heavy)
    share = m * length**2 / (m * length**2 + 1.3 * (2e-3 + 5e-3))
    assert upper(poles)[-1] == pytest.approx(np.sqrt(stiffness / m - spin**2 + 4 * spin**2 * share), rel=1e-9)
    assert np.sort(np.abs(poles))[:4].max() < 1e-6 * spin  # along the axis, and about it: two double zeros


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
    hinge = HUB + np.array([REACH, 0, 0])
    table = RigidBody("table", {"hinge": hinge}, fixed=True)
    if body is None:
        turn = Rotation.from_rotvec([0.3, 0, 0]).as_matrix()
        inertia = turn @ np.diag([1e-3, 3e-3, 3.4e-3]) @ turn.T
        inertia[0, 1] = inertia[1, 0] = inertia[0, 2] = inertia[2, 0] = 0.0
        body = RigidBody("bar", {"left": np.array([-ARM, 0, 0])}, 0.9, inertia, hinge + np.array([ARM, 0, 0]))
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
    model = spun(scene, (0, 0, 11.0), HUB + np.array([1.0, 0, 0]))
    bar = scene.bodies[1]
    rate = 11.0 * np.sqrt(bar.mass * (1.0 - REACH) * ARM / (bar.inertia[2, 2] + bar.mass * ARM**2))
    assert model.poles().real.max() == pytest.approx(rate, rel=1e-9)
    with pytest.raises(ValueError, match="unstable: a drift that grows"):
        spinning_equilibrium(scene, angular_velocity=(0, 0, 11.0), axis_point=HUB + np.array([1.0, 0, 0]))


def test_drawn_far_from_its_equilibrium():
    with pytest.raises(ValueError, match=r"body 'bar' comes to rest rotated by 0\.59 rad.* start nearer"):
        spun(pendulum("rz"), (0, 0, 5.0), HUB + np.array([0, 0.1, 0]))
    with pytest.warns(UserWarning, match=r"rotated by 0\.041 rad.* off by up to some 4\.1 %"):
        spun(pendulum("rz"), (0, 0, 5.0), HUB + np.array([0, 0.007, 0]))


def test_no_equilibrium_at_all():
    """A plate hinged at its centre on the axis, at 45 degrees: the moment has its maximum there, hence no slope."""
    turn = Rotation.from_euler("y", np.pi / 4).as_matrix()
    rail = RigidBody("table", {"hub": np.zeros(3)}, fixed=True)
    plate = RigidBody("plate", {"hub": np.zeros(3)}, 1.0, turn @ np.diag([1.0, 1.5, 1.2]) @ turn.T)
    tilted = Scene("tilted", (rail, plate), (Joint("hinge", "table.hub", "plate.hub", ("ry",)),))
    with pytest.raises(ValueError, match="scene 'tilted' has no spinning equilibrium: centrifugal forces drive"):
        spun(tilted, (0, 0, 1.0))


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
    feet = {
        k: end + 0.1 * v
        for (k, end), v in zip(ends.items(), np.random.default_rng(2).standard_normal((7, 3)), strict=True)
    }
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
        Strut(k, f"table.{k}", f"{'b' if joined and int(k) > 2 else 'a'}.{k}", 1e5 + 2e4 * int(k))
        for k in list(ends)[:6]
    )
    sensors = tuple(Spot(axis, "a.0", tuple(v)) for axis, v in zip("xyz", np.eye(3), strict=True))
    return Scene("halves", bodies, joints, sensors=sensors, springs=springs, damping_ratio=0.02)


def test_a_body_in_two_halves():
    """What the joint between bears is stiffness too."""
    w, point = np.array([3.0, -5.0, 7.0]), np.array([0.05, 0.0, 0.1])
    still = upper(linearize(halves(joined=False)).poles())
    whole, both = (upper(spun(halves(joined=joined), w, point).poles()) for joined in (False, True))
    effect = np.abs(whole / still - 1).max()
    assert effect > 2e-3
    np.testing.assert_allclose(both, whole, rtol=effect**2)  # the equilibrium is of first order
    rest = [spinning_equilibrium(halves(joined=j), angular_velocity=w, axis_point=point) for j in (False, True)]
    assert rest[0] == pytest.approx(rest[1], rel=1e-8)
    assert abs(rest[0]["x"]) > 1e-5


@pytest.mark.filterwarnings("ignore:under the spin, body")
def test_a_double_pendulum_of_three_bodies():
    """Drawn a little beside its equilibrium: what accelerates it there, the joints of its halved arm do not bear."""
    hinge, elbow = (HUB + np.array([reach, 0, 0]) for reach in (REACH, REACH + 0.1))
    glue = HUB + np.array([REACH + 0.05, 0.0, 0.02])
    masses, inertias = (0.7, 0.4), (random_inertia(3), random_inertia(4))
    centres = [hinge + np.array([0.03, 0.02, -0.03]), hinge + np.array([0.07, -0.03, 0.05])]
    centre = np.average(centres, axis=0, weights=masses)
    arms = [c - centre for c in centres]
    spread = [m * (arm @ arm * np.eye(3) - np.outer(arm, arm)) for m, arm in zip(masses, arms, strict=True)]
    ends = {"hinge": hinge, "glue": glue, "elbow": elbow}

    def body(name, mass, inertia, at):
        return RigidBody(name, {end: place - at for end, place in ends.items()}, mass, inertia, at)

    halves_of_arm = [body(*each) for each in zip("ab", masses, inertias, centres, strict=True)]
    whole = body("a", sum(masses), sum(inertias) + sum(spread), centre)
    bob = body("bob", 0.3, random_inertia(5), elbow + np.array([0.08, 0.004, 0.02]))
    table = RigidBody("table", {"hinge": hinge}, fixed=True)
    first, glued = Joint("hinge", "table.hinge", "a.hinge", ("rz",)), Joint("glue", "a.glue", "b.glue")
    one = Scene("one", (table, whole, bob), (first, Joint("elbow", "a.elbow", "bob.elbow", ("rz",))))
    two = Scene("two", (table, *halves_of_arm, bob), (first, glued, Joint("elbow", "b.elbow", "bob.elbow", ("rz",))))
    poles = [upper(spun(scene, (0, 0, 11.0), HUB + np.array([0, 0.003, 0])).poles()) for scene in (one, two)]
    assert len(poles[0]) == 2
    np.testing.assert_allclose(poles[1], poles[0], rtol=1e-9)


def test_coriolis_forces_do_no_work():
    """G is skew, K symmetric, so without damping the Jacobi integral q'^2 + q (K q) of a run is constant."""
    scene = replace(halves(joined=True), damping_ratio=0.0)
    spin = loaded_state(assemble(scene), angular_velocity=(3.0, -5.0, 7.0), axis_point=(0.05, 0.0, 0.1))
    assert np.abs(spin.gyroscopic + spin.gyroscopic.T).max() <= 1e-12 * np.abs(spin.gyroscopic).max() > 0
    assert np.abs(spin.stiffness - spin.stiffness.T).max() <= 1e-12 * np.abs(spin.stiffness).max()
    assembly = assemble(scene)
    n = len(assembly.modal.mass)
    stiffness = np.diag((2 * np.pi * assembly.modal.frequency) ** 2) + spin.stiffness
    energy = scipy.linalg.block_diag(stiffness, np.eye(n))
    step = scipy.linalg.expm(0.13 * np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -spin.gyroscopic]]))
    before = np.random.default_rng(5).standard_normal(2 * n)
    after = step @ before
    assert after @ energy @ after == pytest.approx(before @ energy @ before, rel=1e-9)
    assert not loaded_state(assembly, axis_point=(1, 2, 3)).gyroscopic.any()


def test_without_spin_it_is_the_model_at_rest():
    still, model = linearize(halves(joined=True)), spun(halves(joined=True), (0, 0, 0))
    for a, b in zip(still.matrices, model.matrices, strict=True):
        assert np.array_equal(a, b)


def test_gyroscopic_matrix_is_of_first_and_the_rest_of_second_order():
    """Twice as fast: the Coriolis forces double, the centrifugal ones and their stiffness quadruple."""
    assembly = assemble(halves(joined=True))
    axis, point = np.array([0.3, -0.5, 0.7]), (0.05, 0, 0.1)
    slow, fast = (loaded_state(assembly, angular_velocity=v * axis, axis_point=point) for v in (0.1, 0.2))
    np.testing.assert_allclose(fast.gyroscopic, 2 * slow.gyroscopic, rtol=0, atol=1e-12 * np.abs(fast.gyroscopic).max())
    np.testing.assert_allclose(fast.stiffness, 4 * slow.stiffness, rtol=0, atol=1e-9 * np.abs(fast.stiffness).max())


def test_the_moment_of_inertia_about_the_axis_is_that_of_all_bodies():
    """By Steiner: of each its own about the axis and its mass times the square of its distance."""
    axis, point, inertia = np.array([2.0, -1.0, 2.0]) / 3, np.array([0.1, 0.2, -0.3]), np.diag([1.0, 2.0, 2.5])
    places, masses = np.array([[1.0, 0.0, 0.5], [-0.4, 0.7, 0.2], [0.3, -0.8, 0.9]]), (2.0, 5.0, 3.0)
    bodies = [RigidBody(f"b{k}", {}, m, m * inertia, p) for k, (m, p) in enumerate(zip(masses, places, strict=True))]
    assembly = assemble(Scene("three", tuple(bodies)))
    found = spin_loads(assembly, GeometricStiffness.of(assembly), 7.0 * axis, point, None).moment
    distances = np.linalg.norm(np.cross(places - point, axis), axis=1)
    assert found == pytest.approx(np.sum(np.array(masses) * (axis @ inertia @ axis + distances**2)))


class Mechanism:
    """A hinged arm, a block that slides across it on a spring, a pendulum hinged on the block; of point masses.

    Positions in the inertial frame are written down; the equations of motion follow by d'Alembert's principle from
    numerical derivatives of these alone. turn: cyclic exchange of the axes, so that the spin is about z, x or y.
    """

    spin, radius, stiffness, damping = 9.0, 0.2, 150.0, 0.7
    arm, head = np.array([0.15, 0.02, 0.03]), np.array([0.06, -0.02, 0.01])

    def __init__(self, turn):
        self.turn = np.roll(np.eye(3), turn, axis=0)
        self.centre = self.turn @ np.array([0.1, -0.2, 0.3])
        random = np.random.default_rng(8)
        self.masses = [random.uniform(0.02, 0.08, 6) for _ in range(3)]
        self.places = [np.array([x, 0, 0]) + 0.03 * random.standard_normal((6, 3)) for x in (0.07, 0.01, 0.08)]
        # The pendulum's plane is one of symmetry, and the centre of all lies on the radius: at rest as drawn.
        self.masses[2][3:] = self.masses[2][:3]
        self.places[2][:, 2] += 0.04
        self.places[2][3:] = self.places[2][:3]
        self.places[2][3:, 2] *= -1
        self.head[2] = 0.0
        self.balance()

    def balance(self):
        """Shift the block and the arm sideways, until neither slide nor hinge is loaded."""
        above = self.masses[1] @ self.places[1][:, 1] + self.masses[2] @ (self.head + self.places[2])[:, 1]
        self.arm = self.arm.copy()
        self.arm[1] = -above / (self.masses[1].sum() + self.masses[2].sum())
        self.places[0][:, 1] -= self.masses[0] @ self.places[0][:, 1] / self.masses[0].sum()

    def positions(self, q, angle):
        """Of all masses from a point of the axis, in axes of which the third is the spin's, (18, 3)."""
        hinge, slide, swing = q
        about = Rotation.from_euler("z", hinge).as_matrix()
        down = Rotation.from_euler("y", swing).as_matrix()
        block = self.arm + np.array([0, slide, 0])
        local = [self.places[0], block + self.places[1], block + self.head + self.places[2] @ down.T]
        on_table = np.vstack(local) @ about.T + [self.radius, 0, 0]
        return on_table @ Rotation.from_euler("z", angle).as_matrix().T

    def accelerations(self, time, state):
        """(q', q'') of (q, q')."""
        q, rates, step = state[:3], state[3:], 1e-4
        weights = np.repeat(np.concatenate(self.masses), 3)

        def at(q, time):
            return self.positions(q, self.spin * time).ravel()

        columns = np.column_stack([(at(q + step * e, time) - at(q - step * e, time)) / (2 * step) for e in np.eye(3)])
        drift = (at(q + step * rates, time + step) + at(q - step * rates, time - step) - 2 * at(q, time)) / step**2
        # The spring acts along the table's second axis, between the arm's tip and the block.
        stretch = np.cos(q[0]) * q[1]
        of_q = np.array([-np.sin(q[0]) * q[1], np.cos(q[0]), 0.0])
        force = -(self.stiffness * stretch + self.damping * of_q @ rates) * of_q
        whole = columns.T @ (weights[:, None] * columns)
        return np.concatenate([rates, np.linalg.solve(whole, force - columns.T @ (weights * drift))])

    def scene(self):
        """The same as a scene."""
        hinge = np.array([self.radius, 0, 0])
        origins = {"arm": hinge, "block": hinge + self.arm, "bob": hinge + self.arm + self.head}
        joints = {"table": hinge, "arm": hinge + self.arm, "block": origins["bob"]}
        bodies = [RigidBody("table", {"out": self.centre + self.turn @ hinge}, fixed=True)]
        for (name, origin), masses, places in zip(origins.items(), self.masses, self.places, strict=True):
            mass = masses.sum()
            middle = masses @ places / mass
            second = (places - middle).T @ (masses[:, None] * (places - middle))
            points = {"in": self.turn @ -middle, "out": self.turn @ (joints.get(name, origin) - origin - middle)}
            inertia = self.turn @ (np.trace(second) * np.eye(3) - second) @ self.turn.T
            bodies.append(RigidBody(name, points, mass, inertia, self.centre + self.turn @ (origin + middle)))
        _, y, z = ("xyz"[int(np.argmax(axis))] for axis in self.turn.T)
        chain = ["table", "arm", "block", "bob"]
        free = [f"r{z}", y, f"r{y}"]
        links = [Joint(b, f"{a}.out", f"{b}.in", (f,)) for (a, b), f in zip(pairwise(chain), free, strict=True)]
        across, up = tuple(self.turn @ [0, 1, 0]), tuple(self.turn @ [0, 0, 1])
        spots = [("arm.out", across), ("block.out", across), ("bob.out", up)]
        sensors = [Spot(f"{p}{d}", p, v, d) for d in (0, 1) for p, v in spots]
        spring = SpringDamper("spring", "arm.out", "block.in", y, self.stiffness, self.damping)
        bodies[-1] = replace(bodies[-1], points=dict(bodies[-1].points) | {"out": self.turn @ self.tip})
        return Scene("chain", tuple(bodies), tuple(links), sensors=tuple(sensors), springs=(spring,), damping_ratio=0.0)

    tip = np.array([0.1, 0.0, 0.0])
    """A point of the pendulum from its centre, at the centre's height."""

    def readings(self, q, rates):
        """What the sensors read to first order, (6,)."""
        bob = self.tip + self.masses[2] @ self.places[2] / self.masses[2].sum()
        rows = np.array([[self.arm[0], 0, 0], [self.arm[0] + self.head[0], 1, 0], [0, 0, -bob[0]]])
        return np.concatenate([rows @ q, rows @ rates])


@pytest.mark.parametrize("turn", [0, 1, 2])
def test_a_chain_against_its_equations_in_the_inertial_frame(turn):
    """Their numerical linearisation, at any time, in terms of what the sensors read."""
    chain = Mechanism(turn)
    model = spun(chain.scene(), chain.turn @ [0, 0, chain.spin], chain.centre)
    found = model.C @ model.A @ np.linalg.inv(model.C)
    step, eye = 1e-4, np.eye(6)
    for time in (0.0, 0.37):
        assert np.abs(chain.accelerations(time, np.zeros(6))).max() < 1e-6
        pushed = [chain.accelerations(time, step * e) - chain.accelerations(time, -step * e) for e in eye]
        reads = np.column_stack([chain.readings(e[:3], e[3:]) for e in eye])
        expected = reads @ (np.column_stack(pushed) / (2 * step)) @ np.linalg.inv(reads)
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5 * np.abs(expected).max())
    assert found[3:, :3] != pytest.approx(expected[3:, :3] - chain.spin**2 * np.eye(3), rel=0.1)


def test_the_chain_run_in_the_inertial_frame():
    """Let go a little beside its equilibrium; the model's motion is that of the run."""
    chain = Mechanism(0)
    model = spun(chain.scene(), [0, 0, chain.spin], chain.centre)
    start, time = 1e-4 * np.array([1.0, 0.3, -0.8, 3.0, -5.0, 2.0]), np.linspace(0, 0.4, 9)
    run = solve_ivp(chain.accelerations, (0, time[-1]), start, t_eval=time, rtol=1e-5, atol=1e-8)
    found = np.array([chain.readings(state[:3], state[3:]) for state in run.y.T])
    first = np.linalg.solve(model.C, found[0])
    expected = np.array([model.C @ scipy.linalg.expm(t * model.A) @ first for t in time])
    size = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(found / size, expected / size, rtol=0, atol=2e-3)


ASKEW = Rotation.from_rotvec([0.5, -0.8, 1.1]).as_matrix()


def node_body():
    """A body of eight nodes, two remote points and two modes, and the nodes: masses, places, fields (8, 3, 14)."""
    random = np.random.default_rng(12)
    places, masses, shares = random.uniform(-0.1, 0.1, (8, 3)), random.uniform(0.1, 0.3, 8), random.uniform(0, 1, 8)
    ends = {"left": np.array([-0.1, 0.02, 0.01]), "right": np.array([0.12, -0.01, 0.03])}
    fields = np.zeros((8, 3, 14))
    for k, (place, share) in enumerate(zip(places, shares, strict=True)):
        for end, weight, at in zip(ends.values(), (1 - share, share), (0, 6), strict=True):
            fields[k, :, at : at + 6] = weight * rigid_transfer(place - end)[:3]
    fields[:, :, 12:] = random.standard_normal((8, 3, 2))
    gram = np.zeros((46, 46))
    for mass, place, field in zip(masses, places, fields, strict=True):
        scalars = np.concatenate([[1.0], place, field.T.ravel()])
        gram += mass * np.outer(scalars, scalars)
    matrix = np.einsum("k,kaj,kai->ji", masses, fields, fields)
    points = tuple(RemotePoint(name, name, end) for name, end in ends.items())
    body = ReducedBody("nodes", remote_points=points, mass_matrix=matrix, stiffness_matrix=np.eye(14), gram=gram)
    return body, masses, places, fields


@pytest.mark.parametrize("carrier", ["left", "right"])
def test_inertia_of_a_floating_frame_by_its_nodes(carrier):
    """Derivatives of the spin's energy by finite rotation of the frame, and Coriolis forces, node by node."""
    reduced, masses, places, fields = node_body()
    body = FlexibleBody("nodes", reduced, (0.2, -0.1, 0.3), ASKEW, frame=carrier)
    w, point = np.array([3.0, -4.0, 6.0]), np.array([0.1, 0.5, -0.2])
    origin, at = reduced.point(carrier).position, 6 * reduced.point_names.index(carrier)

    def energy(q):
        """Half the sum of m |w x (x - point)|^2, the body deformed and then turned and moved with its frame."""
        deformation = q.copy()
        for k, end in enumerate(reduced.positions):
            deformation[6 * k : 6 * k + 6] -= rigid_transfer(end - origin) @ q[at : at + 6]
        shape = places - origin + fields @ deformation
        x = origin + q[at : at + 3] + shape @ Rotation.from_rotvec(q[at + 3 : at + 6]).as_matrix().T
        velocity = np.cross(w, body.position + x @ ASKEW.T - point)
        return 0.5 * masses @ (velocity**2).sum(axis=1)

    step, eye = 1e-3, np.eye(14)
    slope = [(energy(step * e) - energy(-step * e)) / (2 * step) for e in eye]
    bend = [
        [sum(s * t * energy(step * (s * a + t * b)) for s in (-1, 1) for t in (-1, 1)) / (4 * step**2) for a in eye]
        for b in eye
    ]
    assembly = assemble(Scene("nodes", (body,)))
    terms = inertia_terms(body, frames(assembly.coordinates)["nodes"], slice(0, 14), w, point)
    np.testing.assert_allclose(terms.force, slope, rtol=0, atol=1e-5 * np.abs(slope).max())
    np.testing.assert_allclose(terms.stiffness, -np.array(bend), rtol=0, atol=1e-5 * np.abs(bend).max())
    turned = np.cross(ASKEW.T @ w, fields.transpose(0, 2, 1))
    expected = 2 * np.einsum("k,kaj,kia->ji", masses, fields, turned)
    np.testing.assert_allclose(terms.coriolis, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_a_guessed_inertia_is_worth_a_word():
    reduced = replace(craig_bampton(lattice(), n_modes=2, progress=False), full_integrals=False)
    body = FlexibleBody("box", reduced)
    table = RigidBody("table", {"foot": body.point_position("left")}, fixed=True)
    scene = Scene("blade", (table, body), (Joint("foot", "table.foot", "box.left"),))
    with pytest.warns(UserWarning, match=r"how its inertia is spread is a guess.* off by up to some 14\.3 Hz"):
        spun(scene, (0, 0, 90.0), body.centre)
    limit = 2 * np.pi * reduced.eigenfrequencies(fixed=["left"])[0] / 30
    for share, expected in ((0.9, 0), (1.1, 1)):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            linearize(scene, angular_velocity=(0, 0, share * limit), axis_point=body.centre)
        assert sum("how its inertia is spread is a guess" in str(one.message) for one in told) == expected
    # Beside a wheel that turns it stands still.
    wheel = RigidBody("wheel", {"hub": np.zeros(3)}, 1.0, 1e-3 * np.eye(3), body.position)
    table = replace(table, points={**table.points, "hub": body.position})
    beside = Scene(
        "beside",
        (table, body, wheel),
        (*scene.joints, revolute("axle", "table.hub", "wheel.hub")),
        (Drive("motor", "axle", speed=90.0),),
    )
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        linearize(beside, frame="stator")
    assert not [one for one in told if "body 'box' turns at" in str(one.message)]


@pytest.mark.filterwarnings("ignore:under the spin, body 'box' comes to rest rotated by 0.0")
def test_a_clamped_lattice_against_all_its_nodes():
    """Turned about an odd axis: the nodes' own equations, without stress stiffening as in the reduced body."""
    model = lattice("rbe2", stiffness=1e5)
    reduced = craig_bampton(model, n_modes=52, progress=False)
    body = FlexibleBody("box", reduced, (0.2, -0.1, 0.3), ASKEW, "linear")
    table = RigidBody("table", {"foot": body.point_position("left")}, fixed=True)
    tip = Spot("tip", "box.right", (0.0, 0.0, 1.0))
    scene = Scene("blade", (table, body), (Joint("foot", "table.foot", "box.left"),), sensors=(tip,), damping_ratio=0.0)
    w, point = np.array([50.0, -20.0, 65.0]), body.centre + np.array([0.01, 0.0, -0.02])
    with pytest.warns(UserWarning, match="stress stiffening within the body, which is left out, would change"):
        found = spun(scene, w, point)
    nodes, masses = model.fields[1:].T, model.scalar_mass_matrix.diagonal()
    inner = [k for k in range(36) if 1e-9 < nodes[k, 0] < 0.03 - 1e-9]
    motions = np.zeros((108, 3 * len(inner) + 6))
    for k in range(36):
        rows = k + 36 * np.arange(3)
        if k in inner:
            motions[rows, 3 * inner.index(k) + np.arange(3)] = 1.0
        elif nodes[k, 0] > 0.02:
            motions[rows, -6:] = rigid_transfer(nodes[k] - [0.03, 0.01, 0.01])[:3]
    spin = skew(ASKEW.T @ w)
    weigh, over = np.kron(np.eye(3), np.diag(masses)), np.kron(spin, np.diag(masses))
    pull = np.kron(-spin @ spin, np.diag(masses))
    mass, gyro, soft = (motions.T @ m @ motions for m in (weigh, 2 * over, model.stiffness @ np.eye(108) - pull))
    size = len(mass)
    inverse = np.linalg.inv(mass)
    state = np.block([[np.zeros((size, size)), np.eye(size)], [-inverse @ soft, -inverse @ gyro]])
    np.testing.assert_allclose(upper(found.poles())[:20], upper(np.linalg.eigvals(state))[:20], rtol=3e-5)
    assert np.abs(upper(found.poles())[:20] / upper(linearize(scene).poles())[:20] - 1).max() > 3e-3
    away = (nodes + ASKEW.T @ (body.position - point)).T.ravel()
    rest = ASKEW @ np.linalg.solve(soft, motions.T @ pull @ away)[-6:-3]
    with pytest.warns(UserWarning, match="stress stiffening"):
        read = spinning_equilibrium(scene, angular_velocity=w, axis_point=point)
    assert read["tip"] == pytest.approx(rest[2], rel=1e-5)


@pytest.mark.filterwarnings("ignore:under the spin, body 'bar' comes to rest rotated by 0.0")
@pytest.mark.parametrize(
    ("free", "stiffness", "fidelity", "equal", "carrier"),
    [
        (("ry",), 2e4, "rigid", 1e-6, "right"),
        (("rz",), 2e4, "linear", 0.02, "right"),
        (("rz", "ry"), 2e5, "linear", 0.02, "left"),
        (("rz", "ry"), 2e5, "rigid", 1e-6, "left"),
    ],
)
def test_a_stiff_reduced_pendulum_is_a_rigid_one(free, stiffness, fidelity, equal, carrier):
    """Whichever point carries its frame; on springs askew, which bear a part; it rests near where it is drawn."""
    reduced = craig_bampton(lattice(stiffness=1e8), n_modes=2, progress=False)
    flexible = FlexibleBody("bar", reduced, (0.1, -0.1, 0.2), ASKEW, fidelity, frame=carrier)
    hinge, tip = (flexible.point_position(end) for end in ("left", "right"))
    mass, centre, inertia = flexible.rigid_inertia
    rigid = RigidBody("bar", {"left": hinge - centre, "right": tip - centre}, mass, inertia, centre)
    feet = {"y": tip + np.cross(tip - hinge, [0, 1, 0]), "z": tip + np.cross(tip - hinge, [0, 0, 1])}
    table = RigidBody("table", {"hinge": hinge, **feet}, fixed=True)
    springs = tuple(Strut(f"to {foot}", f"table.{foot}", "bar.right", stiffness) for foot in feet)
    parts = {"joints": (Joint("hinge", "table.hinge", "bar.left", free),), "springs": springs, "damping_ratio": 0.0}
    w, point = np.array([6.0, 10.0, -14.0]), np.array([0.1, 0.3, -0.2])

    def changes(body):
        scene = Scene("pendulum", (table, body), **parts)
        return (upper(spun(scene, w, point).poles()) / upper(linearize(scene).poles()) - 1)[: len(free)]

    expected = changes(rigid)
    np.testing.assert_allclose(changes(flexible), expected, rtol=equal)
    assert np.abs(expected).max() > 3e-4


@pytest.mark.parametrize("held", [0, 1, 2])
def test_a_universal_joint_bears_a_moment(held):
    """About the axis that it holds; its first axis, of x y z, stands on the table, its second on the body."""
    first, second = (k for k in range(3) if k != held)
    random = np.random.default_rng(4)
    places = random.uniform(-0.1, 0.1, (8, 3)) + 0.15 * (np.eye(3)[first] + np.eye(3)[second])
    places[4:] = places[:4]
    places[4:, held] *= -1  # a plane of symmetry, in which the joint lies: at rest as drawn, but for that moment
    masses, w = np.full(8, 0.1), 7.0 * np.eye(3)[held]
    hinge = 0.2 * np.eye(3)[first] + 0.05 * np.eye(3)[second]

    def positions(angles):
        turns = [Rotation.from_euler("xyz"[k], a) for k, a in zip((first, second), angles, strict=True)]
        return hinge + (turns[0] * turns[1]).apply(places)

    def energy(angles):
        return 0.5 * masses @ (np.cross(w, positions(angles)) ** 2).sum(axis=1)

    step, eye = 1e-3, np.eye(2)
    stiffness = [
        [-sum(s * t * energy(step * (s * a + t * b)) for s in (-1, 1) for t in (-1, 1)) / (4 * step**2) for a in eye]
        for b in eye
    ]
    rows = np.array([(positions(step * e) - positions(-step * e)) / (2 * step) for e in eye])
    mass = np.einsum("ika,jka,k->ij", rows, rows, masses)
    gyro = 2 * np.einsum("ika,jka,k->ij", rows, np.cross(w, rows), masses)
    inverse = np.linalg.inv(mass)
    expected = np.linalg.eigvals(np.block([[0 * eye, eye], [-inverse @ stiffness, -inverse @ gyro]]))
    centre = places.mean(axis=0)
    second_moment = 0.1 * (places - centre).T @ (places - centre)
    inertia = np.trace(second_moment) * np.eye(3) - second_moment
    bodies = (
        RigidBody("table", {"hinge": hinge}, fixed=True),
        RigidBody("body", {"hinge": -centre}, 0.8, inertia, hinge + centre),
    )
    free = tuple("r" + "xyz"[k] for k in (first, second))
    poles = spun(Scene("u", bodies, (Joint("u", "table.hinge", "body.hinge", free),), damping_ratio=0.0), w).poles()
    np.testing.assert_allclose(upper(poles), upper(expected), rtol=1e-5)
    assert len(upper(poles)) == 2


def test_charges_of_a_spinning_scene():
    """A charge that leaks is drained in the equilibrium, so that it is that of a short circuit; its rates stay."""
    reduced = craig_bampton(lattice(stiffness=1e5), n_modes=4, progress=False)
    port = PortCoupling("stack", np.random.default_rng(2).standard_normal(16), 1e-3)
    ported = replace(reduced, readouts={"stack": port})
    apa = FlexibleBody("apa", ported, (0.05, 0.0, 0.0), ASKEW, "linear")
    table = RigidBody("table", {"foot": apa.point_position("left")}, fixed=True)
    tip, foot = Spot("tip", "apa.right", (1.0, 0.0, 0.0)), Joint("foot", "table.foot", "apa.left")
    scenes = [
        Scene("charged", (table, apa), (foot,), sensors=(*sensors, tip))
        for sensors in ((VoltageSensor("voltage", "apa.stack", 1e3),), (), (VoltageSensor("voltage", "apa.stack"),))
    ]
    w = (0.0, 0.0, 30.0)
    leaky, short, kept = (spinning_equilibrium(scene, angular_velocity=w) for scene in scenes)
    assert leaky["tip"] == pytest.approx(short["tip"], rel=1e-9)
    assert kept["tip"] != pytest.approx(short["tip"], rel=1e-3)
    assert leaky["voltage"] == pytest.approx(0.0, abs=1e-9 * abs(kept["voltage"]))
    model, still = spun(scenes[0], w), linearize(scenes[0])
    assert np.array_equal(model.A[-1], still.A[-1])
    assert np.array_equal(model.A[:, -1], still.A[:, -1])
    assert not np.array_equal(model.A, still.A)


def test_a_drained_charge_bears_nothing():
    """Through next to no resistance a charge leaks at once: all rates are those of a short circuit, spinning too.

    Bar and bushing share what a ball pulls outwards by their stiffness, to which a charge that stays would add.
    """
    reduced = craig_bampton(lattice(stiffness=1e4), n_modes=2, progress=False)
    pull = np.zeros(14)
    pull[[0, 6]] = -3.0, 3.0
    ported = replace(reduced, readouts={"stack": PortCoupling("stack", pull, 1e-3)})
    bar = FlexibleBody("bar", ported, (0.15, -0.01, -0.01), fidelity="linear")
    tip = bar.point_position("right")
    table = RigidBody("table", {"foot": bar.point_position("left"), "other": tip}, fixed=True)
    ball = RigidBody(
        "ball", {"hinge": (-0.05, 0.0, 0.0)}, 0.3, 1e-4 * np.diag([2.0, 3.0, 4.0]), tip + np.array([0.05, 0, 0])
    )
    pin = Joint("pin", "bar.right", "ball.hinge", free=("rx", "ry", "rz"))
    pad = Bushing("pad", "table.other", "ball.hinge", [2e3, 2e3, 2e3, 0.1, 0.2, 0.3], axes=ASKEW)

    def poles(*sensors, w=20.0):
        joints = (Joint("foot", "table.foot", "bar.left"), pin)
        scene = Scene("charged", (table, bar, ball), joints, sensors=sensors, springs=(pad,), damping_ratio=0.0)
        found = upper(linearize(scene, angular_velocity=(0.0, 0.0, w)).poles())
        return found[:6]

    short, leaky = poles(), poles(VoltageSensor("voltage", "bar.stack", 1e-7))
    kept = poles(VoltageSensor("voltage", "bar.stack"))
    assert np.abs(kept / short - 1).max() > 0.02
    assert np.abs(poles(w=0.0) / short - 1).max() > 0.02
    np.testing.assert_allclose(leaky, short, rtol=1e-5)


@pytest.mark.filterwarnings("ignore:body 'bar'", "ignore:under the spin")
@pytest.mark.usefixtures("plain_steps")
def test_a_free_spinning_body_as_a_floating_frame_in_time():
    """Two balls on a flexible bar, spinning in space: their distance, the same in every frame, swings as the model.

    The run's own steps lengthen periods, which is taken back; the equilibrium is 0.3 % longer than drawn.
    """
    reduced, step = craig_bampton(lattice(stiffness=1e4), n_modes=4, progress=False), 2e-4

    def scene(velocity):
        bar = FlexibleBody("bar", reduced, rotation=ASKEW, angular_velocity=velocity)
        ends = [bar.point_position(end) for end in ("left", "right")]
        inertia = 1e-5 * np.diag([1, 1.2, 1.5])
        balls = [
            RigidBody(n, {"p": np.zeros(3)}, m, inertia, at) for n, m, at in zip("ab", (0.2, 0.1), ends, strict=True)
        ]
        joints = (Joint("l", "bar.left", "a.p"), Joint("r", "bar.right", "b.p"))
        encoders = tuple(Encoder(axis, "a.p", "b.p", axis) for axis in "xyz")
        return Scene("free", (bar, *balls), joints, (PointForce("f", "a.p", "x", "f"),), encoders, damping_ratio=0.0)

    at_rest = scene(np.zeros(3))
    bodies = [body.rigid_inertia for body in at_rest.bodies]
    centre = sum(m * at for m, at, _ in bodies) / sum(m for m, _, _ in bodies)
    whole = sum(
        j + m * ((x - centre) @ (x - centre) * np.eye(3) - np.outer(x - centre, x - centre)) for m, x, j in bodies
    )
    velocity = 40.0 * np.linalg.eigh(whole)[1][:, 2]
    run = simulate(
        scene(velocity),
        TimeHistory(step * np.arange(1001), np.zeros((1, 1001)), ("f",), ("N",)),
        time_step=step,
        progress=False,
    )
    line = at_rest.point_position("b.p") - at_rest.point_position("a.p")
    distance = np.linalg.norm(run.values[1:] + line[:, None], axis=0)
    poles = decay_poles((distance - distance.mean())[None, ::4], 4 * step, n_poles=14)
    swings = 2 / step * np.tan(np.abs(poles.imag) * step / 2)
    expected = upper(spun(at_rest, velocity, centre).poles())
    found = np.array([swings[np.argmin(np.abs(swings - pole))] for pole in expected])
    stretched = [7, 8, 9]  # after the rigid motions', those that change the distance by more than rounding
    np.testing.assert_allclose(found[stretched], expected[stretched], rtol=3e-3)
    still = upper(linearize(at_rest).poles())[3]
    np.testing.assert_allclose(found[7] - still, expected[7] - still, rtol=0.1)


def test_a_spinning_equilibrium_is_one_of_centrifugal_forces_alone():
    """The weight of a mass that stands off the axis does not lower it."""
    table = RigidBody("table", {"p": (0.05, 0.0, 0.0)}, fixed=True)
    block = RigidBody("block", {"p": np.zeros(3)}, 2.0, 0.01 * np.eye(3), (0.05, 0.0, 0.0))
    spring = Bushing("seat", "table.p", "block.p", [4e4, 5e4, 6e4, 900.0, 800.0, 700.0])
    sensors = tuple(Encoder(axis, "table.p", "block.p", axis) for axis in "xz")
    scene = Scene("seated", (table, block), springs=(spring,), sensors=sensors, gravity=(0.0, 0.0, -9.81))
    found = spinning_equilibrium(scene, angular_velocity=(0, 0, 20.0))
    force = 2.0 * 20.0**2
    assert found["x"] == pytest.approx(force * 0.05 / (4e4 - force), rel=1e-6)
    assert found["z"] == pytest.approx(0.0, abs=1e-12)


def test_weight_along_an_oblique_axis_holds_a_pendulum_there():
    """A bob below a hinge and spring on the axis: w^2 = g / l - W^2 + k / (m l^2); weight across the axis rotates."""
    axis, across, length, rate = np.array([2.0, -1.0, 2.0]) / 3, np.array([1.0, 2.0, 0.0]), 0.3, 4.0
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    bob = RigidBody("bob", {"o": -length * axis}, 2.0, 1e-12 * np.eye(3), length * axis)
    hinge = revolute("hinge", "ground.o", "bob.o", across)
    gravity = 9.81 * axis + 3.0 * across + 2.0 * np.cross(axis, across)
    spring = Bushing("spring", "ground.o", "bob.o", [0, 0, 0, 5.0, 5.0, 5.0])
    scene = Scene("pendulum", (ground, bob), (hinge,), springs=(spring,), gravity=gravity)
    for frame in ("rotor", "stator"):  # without a stator, both are the frame of the scene
        found = np.abs(linearize(scene, angular_velocity=rate * axis, frame=frame).poles())
        np.testing.assert_allclose(found, np.sqrt(9.81 / length - rate**2 + 5.0 / (2.0 * length**2)), rtol=1e-9)


@pytest.mark.filterwarnings("ignore:damping_ratio acts")
def test_an_equilibrium_that_tilts_is_no_error():
    """A rotor on a bushing, whose product of inertia tilts it by 0.12 rad: the model is about the equilibrium."""
    angle, rate, stiffness = 0.12, 30.0, 60.0
    product = angle * (stiffness + rate**2 * (0.05 - 0.02)) / rate**2
    ground = RigidBody("ground", {"p": np.zeros(3)}, fixed=True)
    inertia = np.array([[0.02, 0, product], [0, 0.04, 0], [product, 0, 0.05]])
    springs = (Bushing("b", "ground.p", "rotor.p", [1e4, 1e4, 1e4, 50.0, stiffness, 70.0]),)
    scene = Scene("r", (ground, RigidBody("rotor", {"p": np.zeros(3)}, 2.0, inertia)), springs=springs)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        linearize(scene, angular_velocity=(0, 0, rate))
    assert not any("equilibrium" in str(one.message) for one in told)
