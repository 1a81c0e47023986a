"""Any point of any body is pushed, held and read alike in every fidelity and by every engine."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from conftest import lattice

from nassim import Encoder, FlexibleBody, Joint, PointForce, RigidBody, Scene, SpringDamper, TimeHistory, simulate
from nassim import craig_bampton
from nassim.bodies.projection import trim_body
from nassim.scene.mechanics import AngleSensor, Bushing, LinearActuator, PointTorque, Pose
from nassim.scene.part import Reading, Row, Sensor
from test_large_motion import INERTIA, STIFF, Motions, ground, three, turn

OBLIQUE = turn(0.8, -0.5, 1.3)
ODD = (0.3, -0.8, 0.6)
AXES = turn(0.4, 1.0, -0.2)


@pytest.fixture(scope="module")
def reduced():
    return craig_bampton(lattice(), n_modes=4, progress=False)


def bench(reduced, fidelity, frame=None, free=("x", "rz"), far=None):
    """A turned lattice in a sprung joint with a load on an oblique bushing beside its end."""
    body = FlexibleBody("bar", reduced, rotation=OBLIQUE, fidelity=fidelity, frame=frame)
    left, right = body.point_position("left"), body.point_position("right")
    place = right + [0.004, -0.003, 0.006]
    load = RigidBody("load", {"o": AXES.T @ [0.01, 0.0, -0.02], "c": (0, 0, 0)}, 0.3, 0.05 * INERTIA,
                     place - [0.01, 0.0, -0.02], rotation=AXES)  # fmt: skip
    base = ground(left=left, away=left + [0.05, 0.2, -0.1])
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


@pytest.mark.parametrize("frame", ["left", "right"])
def test_small_motion_is_the_same_in_every_engine(reduced, frame):
    """Forces, torques, springs, bushings apart, encoders, angles, poses, velocities and accelerations."""
    time = np.arange(1001) * 1e-4

    def outputs(scene, **options):
        return simulate(scene, pushes(time), time_step=1e-4, progress=False, outputs=scene.outputs, **options).values[
            3:
        ]

    linear = bench(reduced, "linear")
    exact = outputs(linear, method="exact")
    implicit, floating = outputs(linear), outputs(bench(reduced, "ffrf", frame))
    size = np.abs(implicit).max(axis=1)
    assert size.min() > 0
    for name, a, b, c, s in zip(linear.outputs, exact, implicit, floating, size):
        print(name, s, np.abs(a - b).max() / s, np.abs(c - b).max() / s)
    assert np.abs(exact - implicit).max(axis=1).max() < 1
    assert (np.abs(floating - implicit).max(axis=1) < 1e-6 * size).all()
