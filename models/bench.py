"""The paper's test bench: granite base, amplified piezo actuator, guided mass on top, encoder."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from models.apa300ml import PORTS, PZT, STACK, STEEL, VENDOR_STIFFNESS, reduced_apa300ml
from nassim import (
    FRF,
    Condensation,
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
from nassim.fem import full_frequency_response

AMPLIFIER_GAIN = 20.0
"""Stack voltage per DAC voltage [V/V]."""
SENSOR_RESISTANCE = 80e3
"""Across the sensor stack [Ohm]: a resistor beside the converter's input, which keeps bias currents from charging it.
Of the size that benches of this actuator use, unverified; with the stack's capacitance a high-pass at 0.4 to 0.6 Hz."""
GRAVITY = np.array([0.0, 0.0, -9.81])


def make_bench(
    payload_mass: float = 5.0,
    fidelity: str = "ffrf",
    *,
    damping_ratio: float = 0.01,
    cutoff_frequency: float | None = None,
    gravity: bool = False,
    ports: bool | None = None,
    resistance: float | None = None,
    disturbances: bool = False,
    apa: ReducedBody | None = None,
) -> Scene:
    """The test bench as a scene: input "actuator_voltage" (DAC) [V]; outputs "sensor_voltage" [V], "encoder" [m].

    payload_mass: guided along z, on top of the actuator [kg]
    fidelity: of the actuator, see `FlexibleBody`
    damping_ratio: of every mode of the bench [-]; an assumption until measured
    cutoff_frequency: models only what the bench needs below it [Hz], see `Scene`; default: all
    gravity: let the payload's and the actuator's weight act; simulations then start from static equilibrium
    ports: whether the stacks act and measure over their volume, as electrical ports of the actuator, or by the cheaper
        pair of forces and elongation between remote points (default: ports, unless `apa` has none)
    resistance: across the sensor stack [Ohm]; math.inf for an open one (default: `SENSOR_RESISTANCE`). The pair of
        forces knows no electricity: its sensor is open and as stiff as a shorted one.
    disturbances: two more inputs along z, "payload_force" [N] and "ground_acceleration" [m/s2]; the encoder then
        measures against the ground
    apa: a reduced APA300ML (default: `reduced_apa300ml` with `PORTS`, or with plane faces on the stack line for the
        pair of forces; cached)
    """
    if ports is None:
        ports = apa is None or bool(apa.ports)
    if resistance is not None and not ports:
        raise ValueError("a resistance loads the sensor's electrical port, which the pair of forces does without")
    if apa is None:
        apa = reduced_apa300ml(ports=PORTS) if ports else reduced_apa300ml(stack_coupling="rbe2")
    body = apa
    loaded = SENSOR_RESISTANCE if resistance is None else resistance
    drive, measure = electrical_ports(loaded) if ports else force_pair()
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


def force_pair() -> tuple[StackActuator, StackSensor]:
    """Drive and sensor of the stacks of a body "apa" between its remote points, see `make_bench`."""
    # Two equal stacks in line at one voltage push their outer ends with the force of one.
    drive = StackActuator(
        "actuator_stacks",
        "apa.junction",
        "apa.actuator_end",
        force_per_volt=STACK.force_per_volt,
        input="actuator_voltage",
        gain=AMPLIFIER_GAIN,
    )
    return drive, StackSensor("sensor_voltage", "apa.sensor_end", "apa.junction", sensor_span_constant())


def sensor_span_constant() -> float:
    """Voltage per elongation between `sensor_end` and `junction` [V/m]: of the sensor stack with the spacer in line.

    An open stack reads V = -d F / C, whatever passes the force on; F is the span's elongation times its stiffness,
    1 / (l / EA of the ceramic + l / EA of the steel).
    """
    spacer = 5e-3 / (STEEL.young_modulus * STACK.area)
    stiffness = 1 / (STACK.length / (PZT.young_modulus * STACK.area) + spacer)
    return STACK.stroke_per_volt * stiffness / STACK.capacitance


def electrical_ports(resistance: float = SENSOR_RESISTANCE) -> tuple[VoltageDrive, VoltageSensor]:
    """Drive and sensor of a body "apa" by its ports; resistance: across the sensor [Ohm]."""
    drive = VoltageDrive("actuator_stacks", "apa.actuator", "actuator_voltage", gain=AMPLIFIER_GAIN)
    return drive, VoltageSensor("sensor_voltage", "apa.sensor", resistance=resistance)


def formula_frequency(payload_mass: float = 5.0) -> float:
    """sqrt(k / m) / 2 pi with the vendor's stiffness [Hz], the paper's equation 1, which prints 95.3 Hz for 5 kg."""
    return math.sqrt(VENDOR_STIFFNESS / payload_mass) / (2 * math.pi)


BENCH_CONDITIONS: dict[str, Any] = {"fixed": ["bottom"], "guided": {"top": "z"}}
"""What the bench's joints do to the actuator's remote points, for `eigenfrequencies` and the full FE model."""


def full_bench_response(
    condensed: Condensation,
    frequency: ArrayLike,
    *,
    payload_mass: float = 5.0,
    damping_ratio: float = 0.01,
    resistance: float = SENSOR_RESISTANCE,
    progress: bool = True,
) -> FRF:
    """The bench's FRFs by the full FE model with both stacks as electrical ports, at frequencies (n,) [Hz].

    The model answers two voltages, of the drive and at the sensor, with the sensor's charge Q; the resistance then says
    which sensor voltage goes with which drive: Q' = -V / R. Beside the reduced bench this shares the ports and the
    points of the FE model, but no reduction and no scene. Damping is that of the modes with the sensor shorted.
    """
    full = full_frequency_response(
        condensed,
        np.asarray(frequency, dtype=float),
        inputs={"actuator_voltage": {"actuator": AMPLIFIER_GAIN}, "sensor": {"sensor": 1.0}},
        outputs={"charge": {"sensor": 1.0}, "encoder": {"top.uz": 1.0}},
        damping_ratio=damping_ratio,
        masses={"top": payload_mass},
        progress=progress,
        **BENCH_CONDITIONS,
    ).frf
    (by_drive, by_sensor), (moved, moved_by_sensor) = full.values
    leak = 1 / resistance / (2j * np.pi * full.frequency)
    voltage = -by_drive / (by_sensor + leak)
    values = np.stack([voltage, moved + moved_by_sensor * voltage])[:, None]
    return FRF(full.frequency, values, ("sensor_voltage", "encoder"), ("actuator_voltage",), None, full.label)


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
