"""The rotating platform of T. Dehaeze, C. Collette, Engineering Research Express 3 (2021) 015036.

A mass is held by two orthogonal struts in a table that turns at constant speed. It is the smallest machine whose force
feedback becomes unstable by rotation. Each strut consists of a spring and a damper, whose force the sensor measures, an
actuator, and a parallel spring.
"""

from dataclasses import replace

import numpy as np

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

from .strut import sensors_in_line


def make_rotating_platform(
    speed: float,
    *,
    mass: float = 1.0,
    stiffness: float = 1.0,
    damping: float = 0.05,
    parallel_share: float = 0.0,
) -> Scene:
    """Make the platform as a scene: struts "u" and "v" along axes that turn with the table.

    Inputs are "u/actuator_force", "v/actuator_force" [N]. Outputs are "u/encoder", "v/encoder" [m], and
    "u/sensor_force", "v/sensor_force" [N], the tension in spring and damper. `platform_model` has the sensors of the
    article.

    Args:
        speed: speed of the table, not 0 [rad/s]
        mass: the mass [kg]
        stiffness: stiffness of each strut [N/m]
        damping: damping of each strut [N s/m]
        parallel_share: share of the stiffness that is parallel to the force sensor [-]

    Raises:
        ValueError: if parallel_share is not at least 0 and below 1
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
        measured, parallel = (1 - parallel_share) * stiffness, parallel_share * stiffness
        springs.append(SpringDamper(f"{name}/spring", *ends, stiffness=measured, damping=damping, **held))
        if parallel:
            springs.append(SpringDamper(f"{name}/beside", *ends, stiffness=parallel, **held))
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
    """Linearise the platform in the rotating frame, with sensors of the whole strut force: f = F - (c s + k_a) d.

    Args:
        speed: speed of the table, not 0 [rad/s]
        **options: as in `make_rotating_platform`
    """
    model = sensors_in_line(linearize(make_rotating_platform(speed, **options)))
    sign = np.where([name.endswith("sensor_force") for name in model.outputs], -1.0, 1.0)[:, None]
    return replace(model, C=sign * model.C, D=sign * model.D)
