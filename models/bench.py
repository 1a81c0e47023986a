"""The paper's test bench: granite base, amplified piezo actuator, guided mass on top, encoder."""

import math
from typing import Any

import numpy as np

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
from nassim.base.field_types import ArrayLike
from nassim.fem import full_frequency_response

from .apa300ml import PORTS, PZT, STACK, STEEL, VENDOR_STIFFNESS, reduced_apa300ml

AMPLIFIER_GAIN = 20.0
"""Stack voltage per DAC voltage [V/V]."""
SENSOR_RESISTANCE = 80e3
"""Resistance across the sensor stack, at the converter's input [Ohm]; it prevents charging by bias currents.

The value is typical of benches of this actuator, but unverified. With the capacitance of the stack it is a high-pass
filter at 0.4 to 0.6 Hz.
"""
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
    """Make the test bench as a scene: input "actuator_voltage" (DAC) [V]; outputs "sensor_voltage" [V], "encoder" [m].

    Args:
        payload_mass: mass on top of the actuator, guided along z [kg]
        fidelity: fidelity of the actuator, see `FlexibleBody`
        damping_ratio: damping ratio of every mode of the bench [-]; an assumption until it is measured
        cutoff_frequency: the model is reduced to what the bench needs below this frequency [Hz], see `Scene`; default:
            no reduction
        gravity: include the weights of payload and actuator; simulations then start from static equilibrium
        ports: whether the stacks act and measure over their volume, as electrical ports of the actuator, or by a
            simpler pair of forces and the elongation between remote points (default: ports, unless `apa` has none)
        resistance: resistance across the sensor stack [Ohm]; math.inf for an open one (default: `SENSOR_RESISTANCE`).
            The pair of forces has no electrical model: its sensor is open but has the stiffness of a shorted one.
        disturbances: add two inputs along z, "payload_force" [N] and "ground_acceleration" [m/s2]; the encoder then
            measures relative to the ground
        apa: a reduced APA300ML (default: `reduced_apa300ml` with `PORTS`, or with plane faces on the stack line for the
            pair of forces; from the cache)

    Raises:
        ValueError: for a resistance without ports
    """
    if ports is None:
        ports = apa is None or bool(apa.ports)
    if resistance is not None and not ports:
        raise ValueError(
            "a resistance needs the sensor's electrical port, which the pair of forces does not have; use ports=True"
        )
    if apa is None:
        apa = reduced_apa300ml(ports=PORTS) if ports else reduced_apa300ml(stack_coupling="rbe2")
    body = apa
    loaded = SENSOR_RESISTANCE if resistance is None else resistance
    drive, measure = electrical_ports(loaded) if ports else force_pair()
    bottom, top = (body.point(name).position for name in ("bottom", "top"))
    # The payload is a steel cube; because of the guide, only its mass matters.
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
    """Return drive and sensor of the stacks of a body "apa" between its remote points, see `make_bench`."""
    # Two equal stacks in series with one voltage act on their outer ends with the force of one stack.
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
    """Return the voltage per elongation between `sensor_end` and `junction` [V/m]: sensor stack and spacer in series.

    The voltage of an open stack is V = -d F / C, whatever transmits the force. F is the elongation of the span times
    its stiffness, 1 / (l / EA of the ceramic + l / EA of the steel).
    """
    spacer = 5e-3 / (STEEL.young_modulus * STACK.area)
    stiffness = 1 / (STACK.length / (PZT.young_modulus * STACK.area) + spacer)
    return STACK.stroke_per_volt * stiffness / STACK.capacitance


def electrical_ports(resistance: float = SENSOR_RESISTANCE) -> tuple[VoltageDrive, VoltageSensor]:
    """Return drive and sensor of a body "apa" by its ports.

    Args:
        resistance: resistance across the sensor [Ohm]
    """
    drive = VoltageDrive("actuator_stacks", "apa.actuator", "actuator_voltage", gain=AMPLIFIER_GAIN)
    return drive, VoltageSensor("sensor_voltage", "apa.sensor", resistance=resistance)


def formula_frequency(payload_mass: float = 5.0) -> float:
    """Return sqrt(k / m) / 2 pi with the vendor's stiffness [Hz] (equation 1 of the paper, 95.3 Hz for 5 kg)."""
    return math.sqrt(VENDOR_STIFFNESS / payload_mass) / (2 * math.pi)


BENCH_CONDITIONS: dict[str, Any] = {"fixed": ["bottom"], "guided": {"top": "z"}}
"""Boundary conditions of the bench at the actuator's remote points, for `eigenfrequencies` and the full FE model."""


def full_bench_response(
    condensed: Condensation,
    frequency: ArrayLike,
    *,
    payload_mass: float = 5.0,
    damping_ratio: float = 0.01,
    resistance: float = SENSOR_RESISTANCE,
    tolerance: float = 1e-6,
    progress: bool = True,
) -> FRF:
    """Compute the bench's FRFs by the full FE model with both stacks as electrical ports.

    The model has two voltages as inputs, of the drive and of the sensor, and the sensor's charge Q as output. The
    resistance then relates the two voltages: Q' = -V / R. This model shares the ports and points of the FE model with
    the reduced bench, but neither a reduction nor a scene. The damping ratio applies to the modes with the sensor
    shorted.

    Args:
        condensed: static condensation of the actuator's FE model
        frequency: frequencies, shape (n,) [Hz]
        payload_mass: mass on top of the actuator [kg]
        damping_ratio: damping ratio of every mode [-]
        resistance: resistance across the sensor stack [Ohm]
        tolerance: see `full_frequency_response`; the default is far below the errors of a reduction [-]
        progress: show the stages and their times
    """
    full = full_frequency_response(
        condensed,
        np.asarray(frequency, dtype=float),
        inputs={"actuator_voltage": {"actuator": AMPLIFIER_GAIN}, "sensor": {"sensor": 1.0}},
        outputs={"charge": {"sensor": 1.0}, "encoder": {"top.uz": 1.0}},
        damping_ratio=damping_ratio,
        masses={"top": payload_mass},
        tolerance=tolerance,
        progress=progress,
        **BENCH_CONDITIONS,
    ).frf
    (by_drive, by_sensor), (moved, moved_by_sensor) = full.values
    leak = 1 / resistance / (2j * np.pi * full.frequency)
    voltage = -by_drive / (by_sensor + leak)
    values = np.stack([voltage, moved + moved_by_sensor * voltage])[:, None]
    return FRF(full.frequency, values, ("sensor_voltage", "encoder"), ("actuator_voltage",), None, full.label)


def make_passive_bench(body: ReducedBody, *, payload_mass: float = 1.0, fidelity: str = "ffrf") -> Scene:
    """Make the bench with any body of two ends as actuator: the first end is clamped, the second carries a payload.

    The payload is guided along the coordinate axis nearest to the line through the ends (z if the ends coincide), and
    its weight acts against this direction. The output is "encoder", the displacement of the payload [m]. There are no
    inputs.

    Args:
        body: a reduced body
        payload_mass: mass of the payload [kg]
        fidelity: fidelity of the body, see `FlexibleBody`

    Raises:
        ValueError: for a body without exactly two remote points
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
