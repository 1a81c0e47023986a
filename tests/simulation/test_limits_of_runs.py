"""What is refused or warned of, a little below its limit and a little above."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from nassim import (
    Bushing,
    Drive,
    Encoder,
    Joint,
    LinearActuator,
    PointForce,
    Pose,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    linearize,
    revolute,
    simulate,
)
from nassim.simulation import spinning_equilibrium
from nassim.simulation.model.initial_velocities import steady_rotation_twists

GROUND = RigidBody("ground", {"p": np.zeros(3)}, fixed=True)
BLOCK = RigidBody("block", {"p": np.zeros(3), "q": np.array([0.1, 0.2, 0.3])}, 2.0, np.diag([0.02, 0.03, 0.04]))
FIGURES = [1e4, 1e4, 1e4, 50.0, 60.0, 70.0]


def held(**options):
    """A block on a bushing, pushed beside its centre."""
    push = PointForce("push", "block.q", "z", "push")
    springs = (Bushing("b", "ground.p", "block.p", FIGURES),)
    sensors = (Encoder("way", "ground.p", "block.p", "z"),)
    return Scene("held", (GROUND, BLOCK), (), (push,), sensors, springs, damping_ratio=0.0, **options)


def steady(force, **options):
    time = np.arange(11) * 1e-3
    history = TimeHistory(time, force * (time > 0)[None], ("push",), ("N",))
    return simulate(held(), history, time_step=1e-3, method="exact", progress=False, **options)


def told(run):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        run()
    return [str(one.message) for one in found]


def test_small_motion_ends_at_a_hundredth_of_a_radian():
    """Of a rigid body too: the largest turn about any axis in a run, by the run's own figures."""
    turn = Pose("pose", "ground.p", "block.p")
    time = np.arange(41) * 1e-3
    history = TimeHistory(time, np.where(time > 0, 1.0, 0.0)[None], ("push",), ("N",))
    scene = replace(held(), sensors=(turn,))
    run = simulate(scene, history, time_step=1e-3, method="exact", progress=False)
    largest = max(np.abs(run[f"pose.r{axis}"]).max() for axis in "xyz")
    for share, expected in ((0.9, 0), (1.1, 1)):
        louder = replace(history, values=history.values * share * 0.01 / largest)
        messages = told(lambda: simulate(scene, louder, time_step=1e-3, method="exact", progress=False))  # noqa: B023
        assert sum("body 'block' turned by up to" in message for message in messages) == expected


@pytest.mark.parametrize(
    ("duration", "fits"), [(0.005, True), (0.005 * (1 + 9e-7), True), (0.005 * (1 + 11e-7), False), (0.0055, False)]
)
def test_a_duration_is_a_whole_number_of_steps(duration, fits):
    if fits:
        assert steady(1.0, duration=duration).duration == pytest.approx(0.005)
        return
    with pytest.raises(ValueError, match=r"duration .* time steps of 0.001 s; take 0.005 s or"):
        steady(1.0, duration=duration)


def test_rounding_loses_no_step():
    """0.3 s over 0.1 s is 2.9999999999999996 in floating point: three steps."""
    history = TimeHistory(0.1 * np.arange(5), np.zeros((1, 5)), ("push",), ("N",))
    run = simulate(held(), history, time_step=0.1, duration=0.3, method="exact", progress=False)
    assert len(run.time) == 4


def test_a_duration_ends_with_the_excitation():
    with pytest.raises(ValueError, match=r"duration 0.011 s is longer than the excitation \(0.01 s\)"):
        steady(1.0, duration=0.011)


def tilted(angle):
    """A rotor on a bushing, whose product of inertia tilts it by so much [rad] as its spin of 30 rad/s draws it."""
    product = angle * (FIGURES[4] + 30.0**2 * (0.05 - 0.02)) / 30.0**2
    inertia = np.array([[0.02, 0, product], [0, 0.04, 0], [product, 0, 0.05]])
    return Scene("r", (GROUND, replace(BLOCK, inertia=inertia)), springs=held().springs, sensors=held().sensors)


@pytest.mark.filterwarnings("ignore:damping_ratio acts")
def test_an_equilibrium_that_tilts_is_no_error():
    """The model is about the equilibrium."""
    messages = told(lambda: linearize(tilted(0.12), angular_velocity=(0, 0, 30.0)))
    assert not any("equilibrium" in message for message in messages)


SELF = {
    "spring": lambda: SpringDamper("s", "block.p", "block.p", "z", 1.0),
    "bushing": lambda: Bushing("s", "block.p", "block.p", FIGURES),
    "actuator": lambda: LinearActuator("s", "block.p", "block.p", "u"),
    "encoder": lambda: Encoder("s", "block.p", "block.p", "z"),
    "joint": lambda: Scene("s", (GROUND, BLOCK), (Joint("s", "block.p", "block.p"),)),
}


@pytest.mark.parametrize("kind", SELF)
def test_nothing_ties_a_point_to_itself(kind):
    with pytest.raises(ValueError, match=r"'s' connects 'block\.p' with itself"):
        SELF[kind]()


def test_a_spring_needs_stiffness_or_damping():
    SpringDamper("s", "ground.p", "block.p", "z", 1e-9)
    SpringDamper("s", "ground.p", "block.p", "z", damping=1e-9)
    with pytest.raises(ValueError, match="spring-damper 's' has neither stiffness nor damping"):
        SpringDamper("s", "ground.p", "block.p", "z")


def test_one_thing_sets_the_spin():
    hinge = revolute("hinge", "ground.p", "block.p")
    scene = Scene("r", (GROUND, BLOCK), (hinge,), (Drive("motor", "hinge", "rz", speed=3.0),), held().sensors)
    spinning_equilibrium(scene)
    with pytest.raises(ValueError, match="has a drive that sets the spin; give no angular_velocity"):
        linearize(scene, angular_velocity=(0, 0, 3.0))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "exact", "spectral_radius": 0.9}, "method 'exact' has none, leave it out"),
        ({"spectral_radius": 1.1}, r"must lie in 0 \.\.\. 1, got 1\.1"),
        ({"spectral_radius": -0.1}, r"must lie in 0 \.\.\. 1, got -0\.1"),
        ({"method": "explicit", "hold_order": 1}, "holds inputs from step to step; hold_order=1 needs another method"),
        ({"hold_order": 0}, 'hold_order=0 needs "exact"'),
        ({"method": "exact", "hold_order": 2}, "hold_order must be 0 or 1, got 2"),
    ],
)
def test_options_belong_to_their_method(options, message):
    time = np.arange(11) * 1e-3
    history = TimeHistory(time, np.zeros((1, 11)), ("push",), ("N",))
    with pytest.raises(ValueError, match=message):
        simulate(held(), history, time_step=1e-3, progress=False, **options)


def test_either_side_of_a_spindle_may_be_the_one_that_stands():
    """A drive turns b against a: with the ground as b, what turns is a, the other way."""
    for ends, sign in ((("ground.p", "block.p"), 1.0), (("block.p", "ground.p"), -1.0)):
        hinge = revolute("hinge", *ends, (0.6, 0.0, 0.8))
        scene = Scene("r", (GROUND, BLOCK), (hinge,), (Drive("motor", "hinge", "rz", speed=3.0),), held().sensors)
        twist = steady_rotation_twists(scene)["block"]
        np.testing.assert_allclose(twist[3:], sign * 3.0 * np.array([0.6, 0.0, 0.8]))
