"""Small scenes to export: loaded with filters, with loops of two rates, turning under its weight; and their records."""

from dataclasses import replace

import numpy as np

from nassim import (
    Drive,
    Encoder,
    Geophone,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    prismatic,
    revolute,
    simulate,
)
from nassim.systems import pid, proportional

STEP = 2e-4


def hanging():
    """Two masses on springs under gravity, one above the other, with a geophone on the upper one."""
    bodies = (
        RigidBody("base", {"rail": [0, 0, 0]}, fixed=True),
        RigidBody("lower", {"rail": [0, 0, 0]}, 4.0, 0.02 * np.eye(3)),
        RigidBody("upper", {"rail": [0, 0, 0]}, 2.0, 0.01 * np.eye(3)),
    )
    pairs = ("base.rail", "lower.rail"), ("lower.rail", "upper.rail")
    return Scene(
        "hanging",
        bodies,
        joints=tuple(prismatic(f"slide_{k}", *pair, axis="z") for k, pair in enumerate(pairs)),
        actuators=(PointForce("push", "lower.rail", "z", "force"), PointForce("pull", "upper.rail", "z", "2nd force")),
        sensors=(
            Encoder("tower/way", *pairs[0], axis="z"),
            Encoder("tower/gap", *pairs[1], axis="z"),
            Geophone("geophone", "upper.rail", sensitivity=80.0),
        ),
        springs=tuple(SpringDamper(f"k_{k}", *pair, "z", 4e5, 60.0 + 90.0 * k) for k, pair in enumerate(pairs)),
        gravity=(0, 0, -9.81),
        damping_ratio=0.0,
    )


def servoed():
    """Two carriages whose servos of two rates saturate, wait, quantise and follow references, one by feedforward."""
    bodies = (
        RigidBody("base", {"rail": [0, 0, 0]}, fixed=True),
        RigidBody("x_carriage", {"rail": [0, 0, 0]}, 4.0, 0.02 * np.eye(3)),
        RigidBody("y_carriage", {"rail": [0, 0, 0]}, 2.0, 0.01 * np.eye(3)),
    )
    pairs = {"x": ("base.rail", "x_carriage.rail"), "y": ("x_carriage.rail", "y_carriage.rail")}
    scene = Scene(
        "servoed",
        bodies,
        joints=tuple(prismatic(f"{axis}_slide", *pair, axis=axis, damping=20.0) for axis, pair in pairs.items()),
        actuators=tuple(PointForce(f"{a}_motor", pair[1], a, input=f"{a}_force") for a, pair in pairs.items()),
        sensors=tuple(Encoder(axis, *pair, axis=axis) for axis, pair in pairs.items()),
    )
    crossover = 2 * np.pi * 40.0

    def servo(mass, rate, **options):
        kp = 0.5 * mass * crossover**2
        gains = {"ki": 0.1 * kp * crossover, "kd": mass * crossover, "derivative_bandwidth": 400.0}
        return pid(kp, **gains, sample_rate=rate, **options)

    fast, slow = servo(6.0, 1 / STEP, limit=30.0, delay=2), servo(2.0, 0.5 / STEP, limit=20.0, delay=0)
    ahead = proportional(1e3, sample_rate=1 / STEP, delay=2)
    loops = (
        Loop("x_servo", fast, "x", "x_force", 1.1e-6, 3e-3, reference="x_set", feedforward=ahead, noise="x_noise"),
        Loop("y_servo", slow, "y", "y_force", output_step=1.3e-3, reference="y_set"),
    )
    return replace(scene, loops=loops)


def turning():
    """A mass on two slides with springs, on a turntable whose axis lies: its weight turns as the table sees it."""
    light = 1e-6 * np.diag([1.0, 1.0, 1.5])
    seat = "mass.seat"
    return Scene(
        "turning",
        (
            RigidBody("ground", {"axle": np.zeros(3)}, fixed=True),
            RigidBody("table", {"axle": np.zeros(3), "rail": np.zeros(3)}, 1.0, np.diag([1.0, 1.0, 1.5])),
            RigidBody("slide", {"rail": np.zeros(3), "seat": np.zeros(3)}, 1e-9, 1e-3 * light),
            RigidBody("mass", {"seat": np.zeros(3)}, 1.0, light),
        ),
        (
            revolute("spindle", "ground.axle", "table.axle", "z"),
            Joint("u", "table.rail", "slide.rail", ("x",)),
            Joint("v", "slide.seat", seat, ("y",)),
        ),
        (Drive("spindle", "spindle", "rz", speed=30.0), PointForce("push", seat, "x", "force", frame=seat)),
        tuple(Encoder(f"d_{a}", "table.rail", seat, a, frame="table.rail") for a in "xy"),
        tuple(SpringDamper(f"k_{a}", "table.rail", seat, a, 1e5, 20.0, frame="table.rail") for a in "xy"),
        gravity=(0, -9.81, 0),
        damping_ratio=0.0,
    )


def excited(scene, n=300):
    """Return smooth inputs of general sizes, which jump for references, (inputs, n)."""
    time = np.arange(n) * STEP
    sizes = {"m": 1e-3}
    rows = [
        sizes.get(scene.input_unit(name), 1.0) * (np.sin((70 + 40 * k) * time + 0.3 * k) + 0.5 * (time > 0.01 * k))
        for k, name in enumerate(scene.inputs)
    ]
    return np.array(rows)


def record(scene, inputs, hold_order, **options):
    """Return outputs and commands by exact steps, (outputs, n)."""
    time = np.arange(inputs.shape[1]) * STEP
    given = TimeHistory(time, inputs, scene.inputs, tuple(map(scene.input_unit, scene.inputs)))
    options |= {"method": "exact", "hold_order": hold_order, "progress": False}
    found = simulate(scene, given, time_step=STEP, **options)
    return np.array([found[name] for name in (*scene.outputs, *scene.commands)])
