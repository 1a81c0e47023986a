"""The paper's test bench: granite base, amplified piezo actuator, guided mass on top, encoder."""

import math

import numpy as np

from models.apa300ml import PORTS, STACK, reduced_apa300ml
from nassim import (
    Encoder,
    FlexibleBody,
    GroundAcceleration,
    Joint,
    PointForce,
    ReducedBody,
    RigidBody,
    Scene,
    StackActuator,
    StackSensor,
    VoltageDrive,
    VoltageSensor,
)

AMPLIFIER_GAIN = 20.0
"""Stack voltage per DAC voltage [V/V]."""
GRAVITY = np.array([0.0, 0.0, -9.81])


def make_bench(
    payload_mass: float = 5.0,
    fidelity: str = "ffrf",
    *,
    damping_ratio: float = 0.01,
    cutoff_frequency: float | None = None,
    gravity: bool = False,
    ports: bool = False,
    resistance: float = math.inf,
    disturbances: bool = False,
    apa: ReducedBody | None = None,
) -> Scene:
    """The test bench as a scene: input "actuator_voltage" (DAC) [V]; outputs "sensor_voltage" [V], "encoder" [m].

    payload_mass: guided along z, on top of the actuator [kg]
    fidelity: of the actuator, see `FlexibleBody`
    damping_ratio: of every mode of the bench [-]; an assumption until measured
    cutoff_frequency: models only what the bench needs below it [Hz], see `Scene`; default: all
    gravity: let the payload's and the actuator's weight act; simulations then start from static equilibrium
    ports: let the stacks act and measure over their volume, as electrical ports of the actuator, with the sensor open
        or loaded by `resistance` [Ohm]; otherwise by a pair of forces and an elongation between remote points
    disturbances: two more inputs along z, "payload_force" [N] and "ground_acceleration" [m/s2]; the encoder then
        measures against the ground
    apa: a reduced APA300ML (default: `reduced_apa300ml()`, with `PORTS` where they are asked for; cached)
    """
    if np.isfinite(resistance) and not ports:
        raise ValueError("a resistance loads the sensor's electrical port; give ports=True too")
    body = reduced_apa300ml(ports=PORTS if ports else ()) if apa is None else apa
    drive, measure = _ports(resistance) if ports else _force_pair()
    bottom, top = (body.point(name).position for name in ("bottom", "top"))
    # A steel cube would do: the guide leaves only the mass to matter.
    side = np.cbrt(payload_mass / 7800.0) if payload_mass > 0 else 1.0
    below = np.array([0.0, 0.0, -side / 2])
    centre = top - below
    return Scene(
        name="bench",
        bodies=(
            RigidBody("base", points={"top": bottom, "guide": top}, fixed=True),
            FlexibleBody("apa", body, fidelity=fidelity, frame="bottom"),
            RigidBody(
                "payload",
                points={"bottom": below},
                mass=payload_mass,
                inertia=payload_mass * side**2 / 6 * np.eye(3),
                position=centre,
            ),
        ),
        joints=(
            Joint("clamp", "base.top", "apa.bottom"),
            Joint("mount", "apa.top", "payload.bottom"),
            Joint("guide", "base.guide", "payload.bottom", free=("z",)),
        ),
        actuators=(drive, *(DISTURBANCES if disturbances else ())),
        sensors=(measure, Encoder("encoder", "base.guide", "payload.bottom", axis="z")),
        damping_ratio=damping_ratio,
        cutoff_frequency=cutoff_frequency,
        gravity=GRAVITY if gravity else np.zeros(3),
    )


DISTURBANCES = (
    PointForce("push", "payload.bottom", "z", "payload_force"),
    GroundAcceleration("ground", "z", "ground_acceleration"),
)


def _force_pair() -> tuple[StackActuator, StackSensor]:
    # Two equal stacks in line at one voltage push their outer ends with the force of one.
    drive = StackActuator(
        "actuator_stacks",
        "apa.junction",
        "apa.actuator_end",
        force_per_volt=STACK.force_per_volt,
        input="actuator_voltage",
        gain=AMPLIFIER_GAIN,
    )
    return drive, StackSensor("sensor_voltage", "apa.sensor_end", "apa.junction", STACK.voltage_per_elongation)


def _ports(resistance: float) -> tuple[VoltageDrive, VoltageSensor]:
    drive = VoltageDrive("actuator_stacks", "apa.actuator", "actuator_voltage", gain=AMPLIFIER_GAIN)
    return drive, VoltageSensor("sensor_voltage", "apa.sensor", resistance=resistance)


BENCH_CONDITIONS = {"fixed": ["bottom"], "guided": {"top": "z"}}
"""What the bench's joints do to the actuator's remote points, for `eigenfrequencies` and the full FE model."""


def bench_forces_and_readings() -> tuple[dict[str, dict[str, float]], dict[str, dict[str, float]]]:
    """The bench's input and outputs at the actuator's remote points, for `full_frequency_response`.

    Written out by hand: a second route to what `make_bench` says by names of stacks and sensors.
    """
    force = AMPLIFIER_GAIN * STACK.force_per_volt
    sensitivity = STACK.voltage_per_elongation
    inputs = {"actuator_voltage": {"actuator_end.ux": force, "junction.ux": -force}}
    outputs = {
        "sensor_voltage": {"sensor_end.ux": sensitivity, "junction.ux": -sensitivity},
        "encoder": {"top.uz": 1.0},
    }
    return inputs, outputs


def make_passive_bench(body: ReducedBody, *, payload_mass: float = 1.0, fidelity: str = "ffrf") -> Scene:
    """The bench with any body of two ends in the actuator's place: its first end clamped, its second carries a payload.

    The payload is guided along the line through the ends (along the nearest axis; z where the ends lie in one place),
    and its weight acts against it. Outputs: "encoder", the payload's displacement [m]. No inputs.
    Raises ValueError for a body with more or fewer than two remote points.
    """
    if len(body.point_names) != 2:
        raise ValueError(f"body {body.name!r} has {len(body.point_names)} remote points; the bench needs one with two")
    first, last = (point.position for point in body.remote_points)
    line = last - first
    along = 2 if np.abs(line).max() < 1e-6 else int(np.argmax(np.abs(line)))
    axis = "xyz"[along]
    side = np.cbrt(payload_mass / 7800.0)
    return Scene(
        name=f"bench with {body.name}",
        bodies=(
            RigidBody("base", points={"top": first, "guide": last}, fixed=True),
            FlexibleBody("body", body, fidelity=fidelity),
            RigidBody(
                "payload",
                points={"end": np.zeros(3)},
                mass=payload_mass,
                inertia=payload_mass * side**2 / 6 * np.eye(3),
                position=last,
            ),
        ),
        joints=(
            Joint("clamp", "base.top", f"body.{body.point_names[0]}"),
            Joint("mount", f"body.{body.point_names[1]}", "payload.end"),
            Joint("guide", "base.guide", "payload.end", free=(axis,)),
        ),
        sensors=(Encoder("encoder", "base.guide", "payload.end", axis=axis),),
        gravity=-9.81 * np.eye(3)[along],
    )
