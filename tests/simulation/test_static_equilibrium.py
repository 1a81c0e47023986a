"""Static equilibria that weight stiffens or softens: pendulums, by themselves and on springs, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from conftest import lattice
from scipy.spatial.transform import Rotation

from nassim import (
    AngleSensor,
    Bushing,
    Drive,
    Encoder,
    FlexibleBody,
    Joint,
    RigidBody,
    Scene,
    SpringDamper,
    craig_bampton,
    prismatic,
    revolute,
    static_response,
)
from nassim.simulation import loaded_equilibrium

MASS, ARM, GRAVITY = 2.0, 0.3, 9.81
WEIGHT = MASS * GRAVITY * ARM
UPWARDS = Rotation.from_rotvec([0.3, -0.5, 0.4]).as_matrix()
"""Axes of the whole scene: gravity is along none of the world's."""


def pendulum(angle, springs, *, upwards=UPWARDS, **points):
    """A mass at a hinge, drawn at an angle from upwards, in oblique axes; what the hinge says is its turn."""
    centre = ARM * np.array([np.sin(angle), 0, np.cos(angle)])
    turn = upwards.T
    ground = RigidBody("ground", {"o": np.zeros(3), "side": turn.T @ [0.5, 0, 0.1]}, fixed=True)
    named = {"o": -centre, **{name: np.array(place) - centre for name, place in points.items()}}
    body = RigidBody(
        "mass",
        {name: turn.T @ place for name, place in named.items()},
        MASS,
        turn.T @ np.diag([1e-3, 2e-3, 3e-3]) @ turn,
        position=turn.T @ centre,
    )
    axis = turn.T @ [0, 1, 0]
    hinge = revolute("hinge", "ground.o", "mass.o", axis=axis)
    sensor = AngleSensor("turn", "ground.o", "mass.o", axis=axis)
    return Scene(
        "pendulum",
        (ground, body),
        (hinge,),
        springs=springs,
        sensors=(sensor,),
        gravity=turn.T @ [0, 0, -GRAVITY],
        damping_ratio=0.0,
    )


def test_a_body_that_turns_freely_has_no_static_response():
    scene = pendulum(2.0, ())
    ground, body = scene.bodies
    swinging = replace(scene, bodies=(ground, replace(body, angular_velocity=3.0 * UPWARDS[:, 1])))
    with pytest.raises(ValueError, match="no static response: body 'mass' turns freely; look at the end of a run"):
        static_response(swinging)


def test_a_stroke_beside_a_rotation_has_no_static_response():
    """A spindle on a carriage: at its place by steps about the rotation, which a stroke would leave out."""
    bodies = (
        RigidBody("ground", {"o": np.zeros(3)}, fixed=True),
        RigidBody("carriage", {"o": np.zeros(3)}, 3.0, 1e-2 * np.eye(3)),
        RigidBody("disc", {"o": np.zeros(3)}, 1.0, 1e-3 * np.eye(3)),
    )
    joints = prismatic("guide", "ground.o", "carriage.o", "x"), revolute("spindle", "carriage.o", "disc.o", "z")
    drives = Drive("motor", "spindle", "rz", speed=50.0), Drive("slide", "guide", input="stroke")
    scene = Scene("lathe", bodies, joints, drives, (Encoder("x", "ground.o", "disc.o", "x"),))
    assert static_response(scene)["x"] == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(ValueError, match="no static response: input 'stroke' moves a drive beside a rotation"):
        static_response(scene, {"stroke": 0.01})


@pytest.mark.filterwarnings("ignore:the run starts")
@pytest.mark.parametrize("turn", [-1.5, -0.3, 0.02, 0.5, 1.2])
def test_a_pendulum_hangs_along_its_weight(turn):
    assert static_response(pendulum(np.pi - turn, ()))["turn"] == pytest.approx(turn, rel=1e-6)


@pytest.mark.filterwarnings("ignore:the run starts")
@pytest.mark.parametrize("down", [*np.eye(3), *-np.eye(3)])
def test_a_pendulum_hangs_along_a_weight_along_any_axis_of_the_world(down):
    side = np.roll(down, 1)
    scene = pendulum(np.pi - 0.5, (), upwards=np.column_stack([side, np.cross(side, down), -down]))
    np.testing.assert_allclose(scene.gravity, GRAVITY * down, atol=1e-12)
    assert static_response(replace(scene, gravity=GRAVITY * down))["turn"] == pytest.approx(0.5, rel=1e-6)


@pytest.mark.parametrize("angle", [0.1, np.pi / 2])
def test_a_pendulum_without_a_stable_equilibrium_nearby_has_none(angle):
    """Upright, where nothing holds it, and level, where its weight has no stiffness."""
    with pytest.raises(RuntimeError, match="no static equilibrium"):
        static_response(pendulum(angle, ()))


def test_a_floating_bar_on_four_springs_has_none():
    """It has six motions to fall by; Newton's steps deform it until its mass matrix is not positive definite."""
    random = np.random.default_rng(0)
    base = RigidBody("base", dict(zip("abcd", random.normal(0.0, 0.06, (4, 3)), strict=True)), fixed=True)
    springs = [
        SpringDamper(foot, f"base.{foot}", f"bar.{end}", random.normal(size=3), 1e3)
        for foot, end in zip("abcd", ("left", "right") * 2, strict=True)
    ]
    bar = FlexibleBody("bar", craig_bampton(lattice(), n_modes=2, progress=False))
    with pytest.raises(RuntimeError, match="no static equilibrium"):
        static_response(Scene("bar", (base, bar), springs=springs, gravity=GRAVITY * np.array([0.6, 0.0, -0.8])))


@pytest.mark.filterwarnings("ignore:the run starts")
def test_a_soft_bar_hangs():
    """A flexible bar in floating frame on its hinge, in oblique axes: its centre of mass comes below the hinge."""
    bar, turn = craig_bampton(lattice(stiffness=1e4), n_modes=1, progress=False), UPWARDS.T
    axis = turn @ [0, 1, 0]
    base = RigidBody("base", {"o": np.zeros(3)}, fixed=True)
    body = FlexibleBody("bar", bar, -turn @ bar.point("left").position, turn)
    hinge = Joint("hinge", "base.o", "bar.left", ("rz",), revolute("h", "base.o", "bar.left", axis=axis).axes)
    arm = body.centre - axis * (axis @ body.centre)
    for angle in (0.05, 0.8):
        down = Rotation.from_rotvec(angle * axis).apply(arm / np.linalg.norm(arm))
        sensor = AngleSensor("turn", "base.o", "bar.left", axis=axis)
        scene = Scene("bar", (base, body), (hinge,), sensors=(sensor,), gravity=GRAVITY * down)
        assert static_response(scene)["turn"] == pytest.approx(angle, abs=2e-3)


@pytest.mark.parametrize(
    ("angle", "ratio"),
    [*((angle, ratio) for angle in (0.02, 0.1, 1.6, 3.0) for ratio in (0.45, 0.55, 0.9)), (2.9, 2.0), (2.9, 30.0)],
)
def test_a_pendulum_on_a_turning_spring(angle, ratio):
    """Standing (0), beside and hanging (pi); ratio of the weight's largest stiffness to the spring's."""
    stiffness = WEIGHT / ratio
    axes = UPWARDS
    spring = Bushing("spring", "ground.o", "mass.o", [0, 0, 0, 0, stiffness, 0], axes=axes)
    expected = scipy.optimize.brentq(lambda turn: stiffness * turn - WEIGHT * np.sin(angle + turn), 0, np.pi)
    assert static_response(pendulum(angle, (spring,)))["turn"] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("ratio", [0.8, 5.0])
def test_a_hanging_pendulum_on_a_spring_between_points(ratio):
    """The spring is far softer than the weight at last; its line turns along with its end."""
    angle, rate = 2.7, WEIGHT / ratio / ARM**2
    spring = SpringDamper("spring", "ground.side", "mass.end", axis="line", stiffness=rate)
    end, side = 0.8 * ARM * np.array([np.sin(angle), np.cos(angle)]), np.array([0.5, 0.1])

    def moment(turn):
        now = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) @ end
        line = side - now
        pull = rate * (np.linalg.norm(line) - np.linalg.norm(side - end)) * line / np.linalg.norm(line)
        return now[1] * pull[0] - now[0] * pull[1] + WEIGHT * np.sin(angle + turn)

    expected = scipy.optimize.brentq(moment, -0.5, 1.0)
    found = static_response(pendulum(angle, (spring,), end=(end[0], 0.0, end[1])))["turn"]
    assert abs(expected) > 0.02
    assert found == pytest.approx(expected, rel=1e-6)


def test_an_equilibrium_that_falls_over_is_none():
    """Drawn hardly off the upright, on a spring too soft to hold it there; the stable one is far away."""
    spring = Bushing("spring", "ground.o", "mass.o", [0, 0, 0, 0, WEIGHT / 3, 0], axes=UPWARDS)
    with pytest.raises(RuntimeError, match="no static equilibrium"):
        static_response(pendulum(0.02, (spring,)))


@pytest.mark.parametrize("fidelity", ["rigid", "ffrf"])
def test_a_bar_that_hangs_on_a_turning_spring(fidelity):
    """A reduced body that is stiff beside its spring; its half length is the weight's arm."""
    bar = craig_bampton(lattice(), n_modes=3, progress=False)
    centre, start = bar.center_of_mass - bar.point("left").position, 0.25
    weight = bar.mass * GRAVITY * np.linalg.norm(centre)
    turn = Rotation.from_rotvec([0, np.pi / 2 - start, 0]).as_matrix()
    place = -turn @ bar.point("left").position
    base = RigidBody("base", {"o": np.zeros(3)}, fixed=True)
    scene = Scene(
        "bar",
        (base, FlexibleBody("bar", bar, fidelity=fidelity, position=place, rotation=turn)),
        (revolute("hinge", "base.o", "bar.left", axis="y"),),
        springs=(Bushing("spring", "base.o", "bar.left", [0, 0, 0, 0, weight / 0.8, 0]),),
        sensors=(AngleSensor("turn", "base.o", "bar.left", axis="y"),),
        gravity=(0, 0, -GRAVITY),
        damping_ratio=0.0,
    )
    arm = turn @ centre
    angle = np.arctan2(arm[0], arm[2])
    expected = scipy.optimize.brentq(lambda turn: turn / 0.8 - np.sin(angle + turn), -1, 1)
    assert static_response(scene)["turn"] == pytest.approx(expected, rel=1e-3)


def test_bushings_in_large_motion_leave_out_the_square_of_their_rotation():
    """As `Bushing` tells, against the minimum of the energy of a body on two tilted bushings."""
    arms, end = np.array([[0.1, 0.02, -0.03], [-0.08, 0.05, 0.04]]), np.array([0.2, 0.1, 0.3])
    gravity = (5.0, -7.0, -25.0)
    axes = [Rotation.from_rotvec(v).as_matrix() for v in ((1.0, -2.0, 0.7), (-0.4, 1.0, 0.8))]
    stiffness = np.array([[3e4, 2e4, 6e4, 80, 50, 200], [5e4, 1e4, 2e4, 30, 90, 40]])
    points = {"0": arms[0], "1": arms[1], "end": end}
    bodies = RigidBody("ground", points, fixed=True), RigidBody("body", points, 3.0, np.diag([0.01, 0.02, 0.025]))
    springs = [Bushing(n, f"ground.{n}", f"body.{n}", stiffness[int(n)], axes=axes[int(n)]) for n in "01"]
    sensors = [Encoder(axis, "ground.end", "body.end", axis) for axis in "xyz"]
    scene = Scene("tilted", bodies, springs=springs, sensors=sensors, gravity=gravity)

    def energy(x):
        turn, halfway, total = Rotation.from_rotvec(x[3:]), Rotation.from_rotvec(x[3:] / 2), -3.0 * x[:3] @ gravity
        for arm, own, k in zip(arms, axes, stiffness, strict=True):
            value = np.concatenate([halfway.inv().apply(x[:3] + turn.apply(arm) - arm) @ own, x[3:] @ own])
            total += 0.5 * k @ value**2
        return total

    def slope(x):
        return [energy(x + step) - energy(x - step) for step in 1e-4 * np.eye(6)]

    rest = scipy.optimize.root(slope, np.zeros(6), tol=1e-10).x
    moved = rest[:3] + Rotation.from_rotvec(rest[3:]).apply(end) - end
    off = np.abs(np.subtract(list(static_response(scene).values()), moved)).max() / np.abs(moved).max()
    assert 1e-3 < off / (rest[3:] @ rest[3:]) < 0.5
    np.testing.assert_allclose(loaded_equilibrium(scene).motions["body.end"][:3], moved, rtol=1e-6)
