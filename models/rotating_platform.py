"""The rotating platform of T. Dehaeze, C. Collette, Engineering Research Express 3 (2021) 015036.

A mass on two orthogonal struts in a table that turns at constant speed: the smallest machine whose force feedback a
spindle makes unstable. Each strut is a spring and a damper, which its force sensor feels, an actuator, and a spring
beside both.
"""

from dataclasses import replace

import numpy as np

from models.strut import sensors_in_line
from nassim import (
    Drive,
    Encoder,
    Joint,
    LinearModel,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    linearize,
    revolute,
)
from nassim.scene import ForceSensor


def make_rotating_platform(
    speed: float,
    *,
    mass: float = 1.0,
    stiffness: float = 1.0,
    damping: float = 0.05,
    parallel_share: float = 0.0,
) -> Scene:
    """The platform as a scene: struts "u" and "v" along axes that turn with the table.

    speed: of the table [rad/s], not 0; mass [kg]; stiffness [N/m], damping [N s/m]: of each strut
    parallel_share: of the stiffness, that lies beside the force sensor [-]

    Inputs: "u/actuator_force", "v/actuator_force" [N]; outputs: "u/encoder", "v/encoder" [m], and "u/sensor_force",
    "v/sensor_force" [N], what spring and damper pull with. `platform_model` has the article's sensors.
    """
    if not 0 <= parallel_share < 1:
        raise ValueError(f"parallel_share must be at least 0 and below 1, got {parallel_share:g}")
    light = 1e-9 * mass
    ground = RigidBody("ground", {"axle": np.zeros(3)}, fixed=True)
    table = RigidBody("table", {"axle": np.zeros(3), "rail": np.zeros(3)}, mass, mass * np.diag([1.0, 1.0, 1.5]))
    slide = RigidBody("slide", {"rail": np.zeros(3), "seat": np.zeros(3)}, light, light * np.eye(3))
    load = RigidBody("mass", {"seat": np.zeros(3)}, mass, 1e-6 * mass * np.diag([1.0, 1.0, 1.5]))
    ends, springs, sensors, forces = ("table.rail", "mass.seat"), [], [], []
    for name, axis in (("u", "x"), ("v", "y")):
        held = {"axis": axis, "frame": "table.rail"}
        felt, beside = (1 - parallel_share) * stiffness, parallel_share * stiffness
        springs.append(SpringDamper(f"{name}/spring", *ends, stiffness=felt, damping=damping, **held))
        if beside:
            springs.append(SpringDamper(f"{name}/beside", *ends, stiffness=beside, **held))
        sensors += [Encoder(f"{name}/encoder", *ends, **held), ForceSensor(f"{name}/sensor_force", f"{name}/spring")]
        forces.append(PointForce(f"{name}/actuator", "mass.seat", axis, f"{name}/actuator_force", frame="mass.seat"))
    return Scene(
        "rotating platform",
        (ground, table, slide, load),
        (
            revolute("spindle", "ground.axle", "table.axle", "z"),
            Joint("u", "table.rail", "slide.rail", ("x",)),
            Joint("v", "slide.seat", "mass.seat", ("y",)),
        ),
        (Drive("spindle", "spindle", "rz", speed=speed), *forces),
        sensors,
        springs,
        damping_ratio=0.0,
    )


def platform_model(speed: float, **options: float) -> LinearModel:
    """The linear model in the turning frame whose sensors feel actuator, spring and damper: f = F - (c s + k_a) d.

    Arguments as of `make_rotating_platform`.
    """
    model = sensors_in_line(linearize(make_rotating_platform(speed, **options)))
    sign = np.where([name.endswith("sensor_force") for name in model.outputs], -1.0, 1.0)[:, None]
    return replace(model, C=sign * model.C, D=sign * model.D)
