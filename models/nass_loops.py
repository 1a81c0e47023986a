"""Loops of the end-station: six of integral force feedback, and around them one of the sample's pose."""

import numpy as np

from models.hexapods import NANO_HEXAPOD
from models.nass import SIX
from nassim import Controller, LinearModel, Loop
from nassim.base.checks import Array
from nassim.kinematics import StewartPlatform, jacobian
from nassim.systems import (
    close_loop,
    crossover_controller,
    decentralised,
    decoupled,
    integral_force_feedback,
    with_inputs,
)

VOLTAGES = [f"strut_{k}/actuator_voltage" for k in range(1, 7)]
SENSORS = [f"strut_{k}/sensor_voltage" for k in range(1, 7)]
POSE = [f"metrology.{six}" for six in SIX]


def force_loop(gain: float, *, sample_rate: float, leak: float = 1.0, delay: int = 1) -> Loop:
    """Each strut's sensor drives its own actuator; gain [1/s], leak [Hz], as of `integral_force_feedback`."""
    each = integral_force_feedback(gain, sample_rate=sample_rate, corner_frequency=leak, delay=delay)
    return Loop("force_feedback", decentralised(*[each] * 6), SENSORS, VOLTAGES)


def wrench_shares(platform: StewartPlatform = NANO_HEXAPOD) -> Array:
    """J^-T: what each strut pushes for a unit of force or torque at the point of interest, (6, 6)."""
    result: Array = np.linalg.inv(jacobian(platform)).T
    return result


def pose_loop(
    model: LinearModel,
    crossover: float,
    *,
    phase_margin: float = 60.0,
    sample_rate: float,
    delay: int = 1,
    platform: StewartPlatform = NANO_HEXAPOD,
) -> Loop:
    """Cartesian loops of the sample's pose: each motion drives the wrench along it, which the struts make by J^-T.

    model: the machine, damped, continuous or sampled at the rate; crossover [Hz] and phase_margin [deg] of each of the
        six loops, closed one after the other, so that those that follow know those before
    platform: geometry of the hexapod, at whose point the pose is measured

    Below its modes the hexapod is stiff, so each loop integrates up to twice its crossover and rolls off from three
    times that. Raises ValueError where a loop finds no stable controller, see `crossover_controller`.
    """
    drive = wrench_shares(platform)
    wrenches = [f"wrench_{six}" for six in SIX]
    machine = with_inputs(model, wrenches, drive, of=VOLTAGES)
    controllers: list[Controller] = []
    for measured, driven in zip(POSE, wrenches, strict=True):
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
    return Loop("pose", decoupled(*controllers, measure=np.eye(6), drive=drive), POSE, VOLTAGES)
