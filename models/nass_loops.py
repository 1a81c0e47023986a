"""Loops of the end-station: six loops of integral force feedback inside a loop of the sample's pose."""

import numpy as np

from nassim import Controller, LinearModel, Loop
from nassim.base.checks import Array, known
from nassim.kinematics import StewartPlatform, jacobian
from nassim.systems import (
    close_loop,
    crossover_controller,
    decentralised,
    decoupled,
    integral_force_feedback,
    with_inputs,
    with_outputs,
)

from .hexapods import NANO_HEXAPOD
from .nass import SIX

VOLTAGES = [f"strut_{k}/actuator_voltage" for k in range(1, 7)]
SENSORS = [f"strut_{k}/sensor_voltage" for k in range(1, 7)]
POSE = [f"metrology.{six}" for six in SIX]


def force_loop(gain: float, *, sample_rate: float, leak: float = 1.0, delay: int = 1) -> Loop:
    """Make a loop in which each strut's sensor drives its own actuator.

    Args:
        gain: gain of the integrator [1/s], see `integral_force_feedback`
        sample_rate: samples per second [Hz]
        leak: corner frequency of the integrator [Hz], see `integral_force_feedback`
        delay: delay [samples]
    """
    each = integral_force_feedback(gain, sample_rate=sample_rate, corner_frequency=leak, delay=delay)
    return Loop("force_feedback", decentralised(*[each] * 6), SENSORS, VOLTAGES)


def wrench_shares(platform: StewartPlatform = NANO_HEXAPOD) -> Array:
    """Return J^-T, shape (6, 6): force of each strut per unit of force or torque at the point of interest."""
    result: Array = np.linalg.inv(jacobian(platform)).T
    return result


def pose_loop(
    model: LinearModel,
    crossover: float,
    *,
    coordinates: str = "struts",
    phase_margin: float = 60.0,
    sample_rate: float,
    delay: int = 1,
    platform: StewartPlatform = NANO_HEXAPOD,
) -> Loop:
    """Make six loops of the sample's pose for a machine with active damping.

    Below its modes the hexapod behaves as a spring. Each controller therefore integrates up to twice its crossover
    frequency and rolls off from three times that frequency. The six loops are closed one after the other, and each one
    is designed for the machine with the previous loops closed.

    Args:
        model: linear model of the machine, continuous or sampled at the sample rate
        crossover: crossover frequency of each loop [Hz]
        coordinates: "struts": the Jacobian J converts the pose to lengths of the struts, and each length drives its own
            strut. Each strut is held by its own stiffness, so the loops hardly interact at low frequencies.
            "cartesian": each motion drives the force or torque along it, distributed to the struts by J^-T. Tilt and
            displacement of a point above the struts interact.
        phase_margin: phase margin of each loop [deg]
        sample_rate: samples per second [Hz]
        delay: delay [samples]
        platform: geometry of the hexapod; the pose is measured at its point of interest

    Raises:
        ValueError: if there is no stable controller for a loop, see `crossover_controller`
    """
    known("coordinates", coordinates, ("struts", "cartesian"))
    along_struts = coordinates == "struts"
    measure = jacobian(platform) if along_struts else np.eye(6)
    drive = np.eye(6) if along_struts else wrench_shares(platform)
    outputs, inputs = ([f"{kind}_{k}" for k in range(1, 7)] for kind in ("coordinate", "effort"))
    machine = with_outputs(with_inputs(model, inputs, drive, of=VOLTAGES), outputs, measure, of=POSE)
    controllers: list[Controller] = []
    for measured, driven in zip(outputs, inputs, strict=True):
        controller = crossover_controller(
            machine,
            measured=measured,
            driven=driven,
            frequency=crossover,
            phase_margin=phase_margin,
            integral_frequency=2 * crossover,
            low_pass_frequency=3 * crossover,
            sample_rate=sample_rate,
            delay=delay,
        )
        machine = close_loop(machine, controller, measured=measured, driven=driven)
        controllers.append(controller)
    return Loop("pose", decoupled(*controllers, measure=measure, drive=drive), POSE, VOLTAGES)
