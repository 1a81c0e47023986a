"""Any point of any body is pushed, held and read alike in every fidelity and by every engine."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import lattice, turned_by
from test_large_motion import INERTIA, STIFF, Motions, ground, three

from nassim import (
    Encoder,
    FlexibleBody,
    Joint,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    craig_bampton,
    simulate,
)
from nassim.base.rigid_motion import rigid_transfer
from nassim.bodies.readouts import PassivePoint
from nassim.bodies.remote_points import RemotePoint
from nassim.scene.forces import LinearActuator, PointTorque
from nassim.scene.motion_sensors import AngleSensor, Pose
from nassim.scene.springs import Bushing

OBLIQUE = turned_by(0.8, -0.5, 1.3)
ODD = (0.3, -0.8, 0.6)
AXES = turned_by(0.4, 1.0, -0.2)


@pytest.fixture(scope="module")
def reduced():
    return craig_bampton(lattice(), n_modes=4, progress=False)


def bench(reduced, fidelity, frame=None, free=("x", "rz")):
    """A turned lattice in a sprung joint with a load on an oblique bushing beside its end."""
    body = FlexibleBody("bar", reduced, rotation=OBLIQUE, fidelity=fidelity, frame=frame)
    left, right = body.point_position("left"), body.point_position("right")
    place = right + np.array([0.004, -0.003, 0.006])
    load = RigidBody("load", {"o": AXES.T @ [0.01, 0.0, -0.02], "c": (0, 0, 0)}, 0.3, 0.05 * INERTIA,
                     place - [0.01, 0.0, -0.02], rotation=AXES)  # fmt: skip
    base = ground(left=left, away=left + np.array([0.05, 0.2, -0.1]), load=load.point_position("o"))
    springs = (
        Bushing("mount", "bar.right", "load.o", STIFF, 1e-4 * STIFF, OBLIQUE),
        SpringDamper("rail", "ground.away", "bar.right", ODD, 3e4, 2.0, frame="bar.right"),
        SpringDamper("world", "bar.left", "ground.left", ODD, 2e4, 1.0),
        SpringDamper("line", "bar.right", "ground.away", "line", 1e4, 3.0),
        Bushing("hinge", "ground.left", "bar.left", 0.3 * STIFF, 1e-5 * STIFF, AXES),
    )
    actuators = (
        PointForce("force", "bar.right", ODD, "force"),
        PointTorque("torque", "bar.right", ODD, "torque"),
        PointForce("follower", "bar.left", (1, 2, 1), "force", frame="bar.left"),
        PointTorque("spin", "load.o", (1, 0, 1), "torque", frame="load.o"),
        LinearActuator("leg", "ground.away", "bar.right", "leg"),
    )
    sensors = [
        Encoder("world", "ground.away", "bar.right", ODD),
        Encoder("framed", "bar.right", "load.o", ODD, "bar.left"),
        Encoder("line", "bar.right", "ground.away", "line"),
        AngleSensor("angle", "bar.left", "bar.right", ODD),
        AngleSensor("other", "ground.left", "load.c", ODD),
        Pose("pose", "bar.right", "load.c", AXES),
        Pose("back", "load.c", "bar.left", AXES),
    ]
    for order in (1, 2):
        for point in ("bar.left", "bar.right", "load.o"):
            sensors += [Motions(f"{point}{order}{frame}", point, order, frame) for frame in ("", "bar.right", "load.c")]
            if order == 1:
                sensors += [Motions(f"{point}w{frame}", point, 1, frame, turns=True) for frame in ("", "bar.right")]
    joints = (Joint("pin", "ground.left", "bar.left", free, OBLIQUE),)
    return Scene("bench", (base, body, load), joints, tuple(actuators), tuple(sensors), springs, damping_ratio=0.0)


def pushes(time):
    wave = 1e-3 * np.sin(np.pi * time / time[-1]) ** 4
    return TimeHistory(
        time, np.array([wave, 0.05 * wave * np.cos(80 * time), 2 * wave]), ("force", "torque", "leg"), ()
    )


@pytest.mark.usefixtures("plain_steps")
@pytest.mark.parametrize("frame", ["left", "right"])
def test_small_motion_is_the_same_in_every_fidelity(reduced, frame):
    """Forces, torques, springs, bushings apart, encoders, angles, poses, velocities, accelerations: some 1e-5 rad.

    The steps are long and damped, because constraints' rounding is in accelerations divided by their square.
    """
    time = np.arange(101) * 1e-3

    def outputs(fidelity):
        scene = bench(reduced, fidelity, frame)
        return simulate(scene, pushes(time), time_step=1e-3, progress=False, spectral_radius=0.7).values[3:]

    linear, floating = outputs("linear"), outputs("ffrf")
    size = np.abs(linear).max(axis=1)
    assert size.min() > 0
    assert (np.abs(floating - linear).max(axis=1) < 1e-4 * size).all()
    assert np.median(np.abs(floating - linear).max(axis=1) / size) < 1e-5


def test_small_motion_is_the_same_in_every_engine(reduced):
    """Exact steps, Exudyn's and the linear model's frequency response, all in small motion."""
    time, scene = np.arange(5001) * 2e-5, bench(reduced, "linear")
    exact = simulate(scene, pushes(time), time_step=2e-5, progress=False, method="exact").values[3:]
    implicit = simulate(scene, pushes(time), time_step=2e-5, progress=False).values[3:]
    assert (np.abs(exact - implicit).max(axis=1) < 1e-5 * np.abs(exact).max(axis=1)).all()


@pytest.mark.usefixtures("plain_steps")
def test_linear_bodies_beside_floating_ones(reduced):
    """A linear body's points, a passive one too, in the axes of a floating one, are read as in small motion."""
    time, aside, right = np.arange(101) * 1e-3, np.array([0.01, -0.02, 0.005]), reduced.point("right")
    motions = np.zeros((6, len(reduced.mass_matrix)))
    motions[:, 6 * reduced.point_names.index("right") :][:, :6] = rigid_transfer(aside)
    tip = PassivePoint(RemotePoint("tip", (), right.position + aside), motions)
    tipped = replace(reduced, readouts={**reduced.readouts, "tip": tip})

    def outputs(fidelity):
        scene = bench(tipped, "linear")
        other = FlexibleBody("other", reduced, position=(1.0, 0, 0), fidelity=fidelity)
        push = PointForce("side", "other.right", ODD, "force")
        read = tuple(Motions(f"seen{order}", "bar.right", order, "other.right") for order in (1, 2))
        read += (Encoder("tip", "other.right", "bar.tip", ODD),)
        springs = (
            Bushing("coincident", "ground.left", "bar.left", STIFF),
            Bushing("far", "ground.f", "other.left", STIFF),
            SpringDamper("aside", "ground.f", "bar.tip", "line", 2e4),
        )
        base = ground(**{**dict(scene.bodies[0].points), "f": other.point_position("left")})
        scene = replace(
            scene, bodies=(base, *scene.bodies[1:], other), sensors=(*scene.sensors[:4], scene.sensors[5], *read),
            springs=(*scene.springs[2:], *springs), joints=(Joint("hold", "load.o", "ground.load", ("x", "rx")),),
            actuators=(scene.actuators[0], scene.actuators[1], scene.actuators[4], push),
        )  # fmt: skip
        return simulate(scene, pushes(time), time_step=1e-3, progress=False, spectral_radius=0.7).values[3:]

    linear, mixed = outputs("linear"), outputs("ffrf")
    size = np.abs(linear).max(axis=1)
    assert size.min() > 0
    assert (np.abs(mixed - linear).max(axis=1) < 1e-4 * size).all()


def test_readings_of_a_floating_body_that_turns_far(reduced):
    """Velocities and accelerations, of remote and passive points, are the derivatives of displacements."""
    body = FlexibleBody("bar", reduced, rotation=OBLIQUE, frame="right", angular_velocity=(20.0, -30.0, 25.0))
    far = OBLIQUE @ (reduced.point("right").position - reduced.point("left").position)
    time = np.arange(3001) * 2e-5
    push = TimeHistory(time, 2.0 * np.sin(40 * time)[None], ("push",), ("N",))
    actuators = (PointForce("push", "bar.right", (0, 1, 0), "push", frame="bar.right"),)
    points = ("bar.left", "bar.right")
    sensors = tuple(Motions(f"{p}{k}", p, k) for p in points for k in (0, 1, 2))
    sensors += tuple(Motions(f"{p}{k}turning", p, k, "bar.left") for p in points for k in (1, 2))
    sensors += (Motions("turn", "bar.left", 1, turns=True), Motions("own", "bar.left", 1, "bar.left", turns=True))
    sensors += (
        Encoder("length", "bar.left", "bar.right", "line"),
        Encoder("along", "bar.left", "bar.right", far, "bar.left"),
    )
    scene = Scene("thrown", (body,), actuators=actuators, sensors=sensors, damping_ratio=0.2)
    record = simulate(scene, push, time_step=2e-5, progress=False, spectral_radius=0.9)
    inner = slice(1000, -20)  # once the blow of the start has died away
    for p in points:
        u, v, a = (three(record, f"{p}{k}") for k in (0, 1, 2))
        assert np.abs(u).max() > 0.015
        for lower, upper in ((u, v), (v, a)):
            rate = (lower[2:] - lower[:-2]) / 4e-5
            assert np.abs(rate - upper[1:-1])[inner].max() < 1e-3 * np.abs(upper).max()
        for k, world in ((1, v), (2, a)):
            turning = three(record, f"{p}{k}turning")
            assert np.allclose(np.linalg.norm(turning, axis=1), np.linalg.norm(world, axis=1), rtol=1e-9)
    assert np.allclose(
        np.linalg.norm(three(record, "turn"), axis=1), np.linalg.norm(three(record, "own"), axis=1), rtol=1e-9
    )
    moved = three(record, "bar.right0") - three(record, "bar.left0") + far
    assert np.abs(record["length"] - (np.linalg.norm(moved, axis=1) - np.linalg.norm(far))).max() < 1e-12
    assert np.abs(record["along"] - record["length"]).max() < 1e-5
    # Velocity of one end against the other in turning axes: the turn's own, but for what deformation adds.
    slip = three(record, "bar.right1turning") - three(record, "bar.left1turning")
    common = np.cross(three(record, "own"), far)
    assert np.abs(slip - common).max() < 0.01 * np.abs(slip).max()
