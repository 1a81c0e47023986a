"""Runs of a study of hexapods: over payload, spindle speed and gain, and within tolerances of joints and struts.

This is a module because the processes that run the study import it.
"""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.stats import norm

from common.spinning import HIGHEST, Machine, own_machine
from models.hexapods import NANO_HEXAPOD
from models.nano_hexapod import make_nano_hexapod
from models.strut import two_mass_strut, with_own_damping
from nassim import LinearModel, Scene, frequency_response, linearize
from nassim.kinematics import strut_frames, strut_lengths
from nassim.systems import decentralised, largest_stable_gain, sampled

SIX = range(1, 7)
JOINTS = {f"joint_{k}_{end}": norm(1.0, 0.05) for k in SIX for end in ("bottom", "top")}
"""Factors on all six stiffnesses of each flexible joint, with an assumed deviation of 5 %."""
TILTS = {f"tilt_{k}_{axis}": norm(0.0, 0.6e-3) for k in SIX for axis in "xy"}
"""Rotations of each strut about its own x and y axes [rad], for 0.05 mm at its upper joint, assumed."""
POSE = [f"pose.{name}" for name in ("ux", "uy", "uz", "rx", "ry", "rz")]
RESULTS = dict(lowest_mode="Hz", highest_mode="Hz", damping_ratio="", shift_x="", shift_y="", tilt_x="rad/m")
"""Suspension modes, least damping ratio with six loops, and cross-coupling of a push along the nominal z axis."""


@cache
def _sampled(payload_mass: float, spindle_rpm: float, sample_rate: float) -> tuple[Machine, LinearModel]:
    machine = own_machine(payload_mass)
    return machine, sampled(machine.plant(spindle_rpm, parallel=True), sample_rate)


def damped(payload_mass: float, spindle_rpm: float, gain: float, *, sample_rate: float) -> dict[str, float]:
    """Return least damping ratio below `HIGHEST` and largest growth rate [1/s] with six integrators of a gain [1/s]."""
    machine, plant = _sampled(payload_mass, spindle_rpm, sample_rate)
    poles = machine.closed(plant, gain, 0.0).poles()
    return {"damping_ratio": _least_damping(poles), "growth": float(poles.real.max())}


def edge(payload_mass: float, spindle_rpm: float, *, sample_rate: float) -> dict[str, float]:
    """Return the largest stable gain of the six integrators [1/s]; 0 where every gain makes a slow motion grow."""
    machine, plant = _sampled(payload_mass, spindle_rpm, sample_rate)
    six = decentralised(*[machine.controller(1.0, 0.0, sample_rate)] * 6)
    gains = np.append(0.0, np.geomspace(1.0, sample_rate, 30))
    return {"largest_stable_gain": largest_stable_gain(plant, six, gains, **machine.wires)}


def toleranced(
    *, payload_mass: float, gain: float, sample_rate: float, push: np.ndarray, **deviations: float
) -> dict[str, float]:
    """Compute `RESULTS` of a hexapod with a fixed base, with deviations of joints and struts by names of `JOINTS`,
    `TILTS`.

    push: voltages, (6,), that move the nominal hexapod along z by 1 m; gain: of the six integrators [1/s]
    """
    model, machine = linearize(_hexapod(payload_mass, deviations)), own_machine(payload_mass)
    modes = np.sort(np.abs(model.poles()))[:12:2] / (2 * np.pi)
    moved = _statics(model, machine) @ push
    return {
        "lowest_mode": modes[0],
        "highest_mode": modes[5],
        "damping_ratio": _least_damping(machine.closed(sampled(model, sample_rate), gain, 0.0).poles()),
        "shift_x": moved[0],
        "shift_y": moved[1],
        "tilt_x": moved[3],
    }


def nominal_push(payload_mass: float) -> np.ndarray:
    """Return the voltages of the six actuators that would move the nominal hexapod along z by 1 m, (6,)."""
    statics = _statics(linearize(_hexapod(payload_mass, {})), own_machine(payload_mass))
    return np.linalg.solve(statics, np.eye(6)[2])


def _statics(model: LinearModel, machine: Machine) -> np.ndarray:
    response = frequency_response(model, np.array([1e-3]))
    return np.array([[response.response(y, u)[0].real for u in machine.wires["driven"]] for y in POSE])


def _hexapod(payload_mass: float, deviations: dict[str, float]) -> Scene:
    """Return the hexapod of `own_machine` with a fixed base and deviations."""
    lengths, axes = strut_lengths(NANO_HEXAPOD), strut_frames(NANO_HEXAPOD)
    turns = np.array([[deviations.get(f"tilt_{k}_{a}", 0.0) for a in "xy"] for k in SIX])
    # A turn about x moves the upper end along -y, one about y along x.
    moved = lengths[:, None] * np.einsum("kij,kj->ki", axes[:, :, :2], turns[:, ::-1] * [1.0, -1.0])
    platform = replace(NANO_HEXAPOD, platform_joints=NANO_HEXAPOD.platform_joints + moved)
    struts = [_strut(k, float(length), deviations) for k, length in zip(SIX, strut_lengths(platform), strict=True)]
    return make_nano_hexapod(struts, platform=platform, payload_mass=payload_mass)


def _strut(k: int, length: float, deviations: dict[str, float]) -> Scene:
    strut = two_mass_strut(length=length)
    factors = {f"{end}_joint": deviations.get(f"joint_{k}_{end}", 1.0) for end in ("bottom", "top")}
    springs = [replace(s, stiffness=factors.get(s.name, 1.0) * s.stiffness) for s in strut.springs]
    return with_own_damping(replace(strut, springs=tuple(springs)), 0.01)


def _least_damping(poles: np.ndarray) -> float:
    counted = poles[(poles.imag > 0) & (np.abs(poles) < 2 * np.pi * HIGHEST)]
    return float((-counted.real / np.abs(counted)).min())
