"""Loops of the end-station: six loops of integral force feedback inside a loop of the sample's pose.

Such control is known as HAC-LAC: a low-authority loop in each strut damps, and a high-authority loop outside holds the
sample.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from nassim import Controller, LinearModel, Loop
from nassim.base.checks import Array, known
from nassim.kinematics import StewartPlatform, jacobian
from nassim.systems import (
    balanced_truncation,
    close_loop,
    controller_from_model,
    crossover_controller,
    decentralised,
    decoupled,
    frequency_response,
    integral_force_feedback,
    mixed_sensitivity,
    subsystem,
    weighting_filter,
    with_inputs,
    with_outputs,
)

from .hexapods import NANO_HEXAPOD
from .nass import SIX

VOLTAGES = [f"strut_{k}/actuator_voltage" for k in range(1, 7)]
SENSORS = [f"strut_{k}/sensor_voltage" for k in range(1, 7)]
POSE = [f"metrology.{six}" for six in SIX]
TARGETS = [f"target.{six}" for six in SIX]
"""Set points of the pose [m], [rad]; the negative of them is noise of the metrology."""
CONVERTERS = [f"converter_{k}" for k in range(1, 7)]
"""Set points of the force feedback [V], which are 0 but for the noise of the sensors' converters."""

SCHEDULE: dict[float, tuple[float, float]] = {1.0: (200.0, 15.0), 10.0: (200.0, 15.0), 50.0: (60.0, 4.0)}
"""Gain of the force feedback [1/s] and bandwidth of the pose loops [Hz] by mass of the payload [kg]."""
SLOW, BLIND = 0.1, 1e-4
"""Frequency [Hz] at which the metrology is checked, and relative size of a motion there that counts as not seen."""
PLANT_ERROR = 0.05
"""Error of the plant that a synthesis uses, over its static gain."""


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


def _check_metrology(model: LinearModel, platform: StewartPlatform) -> None:
    """Raise ValueError where the metrology sees nothing of a motion of the sample that the struts cause."""
    scale = np.linalg.norm(np.linalg.inv(jacobian(platform)), axis=1)
    part = subsystem(model, inputs=VOLTAGES, outputs=POSE)
    directions, sizes, _ = np.linalg.svd(frequency_response(part, np.array([SLOW])).values[..., 0] / scale[:, None])
    if sizes[-1] <= BLIND * sizes[0]:
        unseen = SIX[int(np.argmax(np.abs(directions[:, -1])))]
        raise ValueError(
            f"the metrology sees nothing of the sample's motion along {unseen!r}, which six pose loops would leave to "
            "drift: give it a sensor of that motion"
        )


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
        ValueError: if there is no stable controller for a loop, see `crossover_controller`, and if the metrology sees
            nothing of some motion
    """
    known("coordinates", coordinates, ("struts", "cartesian"))
    _check_metrology(model, platform)
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


def shaped_pose_loop(
    model: LinearModel,
    bandwidth: float,
    *,
    sample_rate: float,
    n_states: int = 10,
    delay: int = 1,
    platform: StewartPlatform = NANO_HEXAPOD,
) -> Loop:
    """Make six equal loops of the sample's pose by H-infinity synthesis, one for the length of each strut.

    The weights bound the sensitivity below the bandwidth, the drive at high frequency, and the complementary
    sensitivity from six times the bandwidth on. The loops take no account of each other: `family_margins` tells
    whether they are stable together.

    Args:
        model: continuous linear model of the machine with its force feedback
        bandwidth: frequency at which the weight of the sensitivity is 1 [Hz]
        sample_rate: samples per second [Hz]
        n_states: states of each controller, after balanced truncation
        delay: delay [samples]
        platform: geometry of the hexapod; the pose is measured at its point of interest

    Raises:
        ValueError: if the metrology sees nothing of some motion
    """
    _check_metrology(model, platform)
    lengths = jacobian(platform)
    strut = with_outputs(model, "length", lengths[:1], of=POSE)
    strut = subsystem(strut, inputs=VOLTAGES[0], outputs="length")
    static = float(np.abs(frequency_response(strut, np.array([0.1])).values[0, 0, 0]))
    found = mixed_sensitivity(
        balanced_truncation(strut, error=PLANT_ERROR * static).model,
        measured="length",
        driven=VOLTAGES[0],
        performance=weighting_filter(bandwidth, low=300.0, high=0.5),
        effort=weighting_filter(300.0, low=0.01 * static, high=10 * static, gain=static),
        robustness=weighting_filter(6 * bandwidth, low=0.4, high=100.0, order=2),
    )
    small = balanced_truncation(found.controller, n_states).model
    each = controller_from_model(small, sample_rate=sample_rate, delay=delay)
    return Loop("pose", decoupled(*[each] * 6, measure=lengths, drive=np.eye(6)), POSE, VOLTAGES)


def scheduled(payload_mass: float, schedule: Mapping[float, tuple[float, float]] = SCHEDULE) -> tuple[float, float]:
    """Return the gain of the force feedback [1/s] and the bandwidth of the pose loops [Hz] for a payload.

    Between the payloads of the schedule both are interpolated by straight lines on logarithmic axes.

    Args:
        payload_mass: mass of the payload [kg]
        schedule: see `SCHEDULE`

    Raises:
        ValueError: for a payload outside the schedule
    """
    masses = np.array(sorted(schedule))
    if not masses[0] <= payload_mass <= masses[-1]:
        raise ValueError(f"the schedule has payloads from {masses[0]:g} to {masses[-1]:g} kg, got {payload_mass:g} kg")
    values = np.log([schedule[mass] for mass in masses])
    gain, bandwidth = (float(np.exp(np.interp(np.log(payload_mass), np.log(masses), column))) for column in values.T)
    return gain, bandwidth


def hac_lac(model: LinearModel, payload_mass: float, *, sample_rate: float) -> tuple[Loop, Loop]:
    """Make the force feedback and the pose loops of the schedule for a machine with a payload.

    Both have set points as inputs, `CONVERTERS` and `TARGETS`.

    Args:
        model: continuous linear model of the machine without loops
        payload_mass: mass of the payload [kg]
        sample_rate: samples per second [Hz]
    """
    gain, bandwidth = scheduled(payload_mass)
    force = force_loop(gain, sample_rate=sample_rate)
    damped = close_loop(model, force.controller, measured=SENSORS, driven=VOLTAGES)
    pose = shaped_pose_loop(damped, bandwidth, sample_rate=sample_rate)
    return replace(force, reference=CONVERTERS), replace(pose, reference=TARGETS)
