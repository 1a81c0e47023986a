"""What turns far without a drive, at default steps: energy, momentum and angle over long times.

At a spectral radius of 1 each of these runs dies before its first ten seconds.
"""

import numpy as np
import pytest
import scipy.integrate
from conftest import lattice
from test_large_motion import GRAVITY, INERTIA, NORMAL, SKEWED, Motions, ground, run, three

from nassim import AngleSensor, Encoder, FlexibleBody, Loop, RigidBody, Scene, SpringDamper, craig_bampton
from nassim.scene.forces import PointTorque
from nassim.scene.joints import prismatic, revolute
from nassim.simulation import integrator_error
from nassim.systems.controllers import Controller

STEP = 2e-3
SPEED = 10.0
ARM = np.array([0.02, -0.03, 0.01])
"""From an axis to a centre of mass."""
ABOUT = NORMAL @ (INERTIA + 0.7 * (ARM @ ARM * np.eye(3) - np.outer(ARM, ARM))) @ NORMAL
"""Moment of inertia about an axis along NORMAL."""


def wheel(speed=SPEED, **parts):
    """A body on a hinge beside its centre of mass, along an odd axis."""
    body = RigidBody("wheel", {"o": -ARM}, 0.7, INERTIA, ARM, angular_velocity=speed * NORMAL)
    sensor = AngleSensor("angle", "ground.o", "wheel.o", NORMAL)
    return Scene(
        "wheel", (ground(), body), (revolute("hinge", "ground.o", "wheel.o", NORMAL),), sensors=(sensor,), **parts
    )


def check_coasting(duration, step):
    record = run(wheel(), duration, step)
    assert np.abs(record["angle"] - SPEED * record.time).max() < 5 * (SPEED * step) ** 2 / 12 * SPEED * duration


def check_pendulum(duration, step):
    """theta'' = -g . (n x r(theta)) m / I, from rest, by SciPy."""
    record = run(wheel(0.0, gravity=GRAVITY), duration, step, start="released")

    def rate(_t, state):
        along = NORMAL * (NORMAL @ ARM)
        arm = along + (ARM - along) * np.cos(state[0]) + np.cross(NORMAL, ARM) * np.sin(state[0])
        return [state[1], 0.7 * NORMAL @ np.cross(arm, GRAVITY) / ABOUT]

    found = scipy.integrate.solve_ivp(
        rate, (0, duration), [0.0, 0.0], t_eval=record.time, method="DOP853", rtol=1e-10, atol=1e-12
    )
    assert np.ptp(found.y[0]) > 1.5
    fastest = np.abs(found.y[1]).max()
    assert np.abs(record["angle"] - found.y[0]).max() < 3 * (fastest * step) ** 2 / 12 * fastest * duration


def check_tumbling(duration, step):
    """Energy and angular momentum of a body of unequal inertias."""
    spin = np.array([1.0, SPEED, 2.0])
    body = RigidBody("body", {"c": (0, 0, 0)}, 0.7, INERTIA, rotation=SKEWED, angular_velocity=spin)
    sensors = (Motions("w", "body.c", 1, "body.c", turns=True),)
    record = run(Scene("body", (body,), sensors=sensors), duration, step)
    inertia = SKEWED @ INERTIA @ SKEWED.T
    momentum = three(record, "w") @ inertia
    energy = np.sum(momentum * three(record, "w"), axis=1)
    assert np.ptp(three(record, "w"), axis=0).max() > 0.5 * SPEED
    assert np.ptp(energy) < (SPEED * step) ** 2 * energy[0]
    assert np.ptp(np.linalg.norm(momentum, axis=1)) < (SPEED * step) ** 2 * np.linalg.norm(momentum[0])


def check_crank(duration, step):
    """A crank, a rod and a piston, four constraints too many: kinetic energy."""
    crank_radius, rod = 0.05, 0.13
    first = np.array([2.0, 1.0, 2.0]) / 3
    second = np.cross(NORMAL, first)
    pin = crank_radius * (first * np.cos(0.4) + second * np.sin(0.4))
    slider = first * (pin @ first + np.sqrt(rod**2 - (pin @ second) ** 2))
    half = (slider - pin) / 2
    crank = RigidBody(
        "crank", {"o": -pin / 2, "pin": pin / 2}, 0.3, INERTIA, pin / 2, angular_velocity=-1.5 * SPEED * NORMAL
    )
    conrod = RigidBody("rod", {"pin": -half, "end": half, "c": (0, 0, 0)}, 0.4, 2 * INERTIA, pin + half)
    piston = RigidBody("piston", {"c": (0, 0, 0)}, 0.6, INERTIA, slider)
    joints = (
        revolute("bearing", "ground.o", "crank.o", NORMAL),
        revolute("crankpin", "crank.pin", "rod.pin", NORMAL),
        revolute("wristpin", "rod.end", "piston.c", NORMAL),
        prismatic("guide", "ground.slider", "piston.c", first),
    )
    points = {"crank": "crank.pin", "rod": "rod.c", "piston": "piston.c"}
    sensors = [Motions(f"v {name}", point, 1) for name, point in points.items()]
    sensors += [Motions(f"w {name}", point, 1, turns=True) for name, point in points.items()]
    scene = Scene("crank", (ground(o=(0, 0, 0), slider=slider), crank, conrod, piston), joints, sensors=tuple(sensors))
    record = run(scene, duration, step)
    energy = 0.0
    for name, mass, inertia, share in (("crank", 0.3, 1, 0.5), ("rod", 0.4, 2, 1.0), ("piston", 0.6, 1, 1.0)):
        energy = energy + mass / 2 * (share**2 * three(record, f"v {name}") ** 2).sum(axis=1)
        energy = energy + inertia / 2 * (NORMAL @ INERTIA @ NORMAL) * (three(record, f"w {name}") @ NORMAL) ** 2
    assert np.ptp(energy) < 3 * (1.5 * SPEED * step) ** 2 * energy[0]


def check_loop(duration, step):
    """A digital controller brakes the wheel by the difference of two samples: by its difference equations."""
    gain = 0.02 * ABOUT / step
    brake = Controller([[0.0]], [[1.0]], [[gain]], [[-gain]], 1 / step, delay=1)
    scene = wheel(
        actuators=(PointTorque("torque", "wheel.o", NORMAL, "torque"),),
        loops=(Loop("brake", brake, "angle", "torque"),),
    )
    time = step * np.arange(round(duration / step) + 1)
    record = run(scene, duration, step, {"torque": np.zeros_like})
    angles, speed, torque = np.zeros(len(time)), SPEED, 0.0
    for k in range(1, len(time)):
        angles[k] = angles[k - 1] + step * speed + step**2 * torque / ABOUT / 2
        speed += step * torque / ABOUT
        torque = -gain * (angles[k - 1] - angles[k - 2] if k > 1 else 0.0)
    assert speed < 0.95 * SPEED
    assert np.abs(record["angle"] - angles).max() < 1e-4 * angles[-1]


@pytest.fixture(scope="module")
def bar():
    return craig_bampton(lattice(stiffness=1e4), n_modes=2, progress=False)


def check_flexible(bar, duration, step):
    """A soft bar on a hinge along an odd axis, let go: how high it comes back at the end, in energy."""
    axis = np.cross(NORMAL, GRAVITY) / np.linalg.norm(np.cross(NORMAL, GRAVITY))
    body = FlexibleBody("bar", bar, -SKEWED @ bar.point("left").position, SKEWED)
    scene = Scene(
        "bar",
        (ground(), body),
        (revolute("hinge", "ground.o", "bar.left", axis),),
        sensors=(AngleSensor("angle", "ground.o", "bar.left", axis), Motions("u", "bar.right")),
        gravity=GRAVITY,
        damping_ratio=0.0,
    )
    record = run(scene, duration, step, start="released")
    height = -three(record, "u") @ GRAVITY
    assert np.ptp(record["angle"]) > 1.0
    late = height[round(len(height) / 2) :]
    assert abs(late.max()) < 5e-3 * np.ptp(height)


@pytest.mark.parametrize(
    ("check", "duration"), [(check_coasting, 3.0), (check_pendulum, 6.0), (check_tumbling, 3.0), (check_loop, 3.0)]
)
def test_what_turns_far_turns_on(check, duration):
    check(duration, STEP)


def test_closed_chains_and_soft_bodies_turn_on(bar):
    check_crank(2.0, STEP)
    check_flexible(bar, 2.5, STEP)


@pytest.mark.slow
@pytest.mark.parametrize("check", [check_coasting, check_pendulum, check_tumbling, check_loop, check_crank])
def test_a_minute(check):
    check(60.0, STEP)


@pytest.mark.slow
def test_a_minute_of_a_soft_body(bar):
    check_flexible(bar, 60.0, STEP)


def test_what_cannot_turn_keeps_its_amplitude():
    """A mass on a guide and a spring, 20 steps a period: at the radius of what turns it would lose 0.3 %."""
    frequency = 25.0
    mass = RigidBody("mass", {"c": (0, 0, 0)}, 2.0, INERTIA, ARM, rotation=SKEWED)
    scene = Scene(
        "mass",
        (ground(o=ARM), mass),
        (prismatic("guide", "ground.o", "mass.c", NORMAL),),
        springs=(SpringDamper("spring", "ground.o", "mass.c", NORMAL, 2.0 * (2 * np.pi * frequency) ** 2),),
        sensors=(Encoder("x", "ground.o", "mass.c", NORMAL),),
        gravity=GRAVITY,
        damping_ratio=0.0,
    )
    x = run(scene, 4.0, STEP, start="released")["x"]
    periods = round(frequency * 4.0)
    early, late = np.ptp(x[: len(x) // 10]), np.ptp(x[-len(x) // 10 :])
    _, damping = integrator_error(frequency, STEP, spectral_radius=0.9)
    assert 2 * np.pi * periods * damping > 1e-3
    assert late == pytest.approx(early, rel=1e-4)


def test_the_spectral_radius_of_what_may_turn_is_nine_tenths():
    """Unless another one is given; a body on a guide takes the trapezoidal rule."""
    mass = RigidBody("mass", {"c": (0, 0, 0)}, 2.0, INERTIA)
    guided = Scene(
        "guided",
        (ground(), mass),
        (prismatic("guide", "ground.o", "mass.c", NORMAL),),
        springs=(SpringDamper("spring", "ground.o", "mass.c", NORMAL, 2e4),),
        sensors=(Encoder("x", "ground.o", "mass.c", NORMAL),),
        gravity=GRAVITY,
        damping_ratio=0.0,
    )
    for scene, radius in ((wheel(), 0.9), (guided, 1.0)):
        default, given, other = (
            run(scene, 0.04, STEP, start="released", **options).values
            for options in ({}, {"spectral_radius": radius}, {"spectral_radius": 0.95})
        )
        np.testing.assert_array_equal(default, given)
        assert np.any(default != other)


def test_the_turn_in_a_step_that_a_spectral_radius_bears():
    """-ln(r): right for thousands of steps below it; far above, rounding grows until the run fails, which tells why."""
    limit = -np.log(0.8)
    record = run(wheel(), 400 * limit, 0.9 * limit / SPEED, spectral_radius=0.8)
    assert np.abs(record["angle"][1:] / (SPEED * record.time[1:]) - 1).max() < 0.004
    with pytest.raises(RuntimeError, match=r"a spectral_radius of 0\.8 holds for 0\.22 rad; take a smaller time_step"):
        run(wheel(), 400 * limit, 2 * limit / SPEED, spectral_radius=0.8)
