"""The end-station open, damped and with its pose in a loop, and what a spindle that turns does to it."""

from collections.abc import Mapping

import numpy as np

from models.nass import SIX, alike_across, make_nass
from models.nass_loops import pose_loop
from nassim import FRF, LinearModel, Loop, linearize
from nassim.kinematics import StewartPlatform
from nassim.systems import (
    NoiseBudget,
    close_loop,
    damping,
    open_loop,
    sampled,
    sensitivity,
    unstable_poles,
)


def with_loop(model: LinearModel, loop: Loop) -> LinearModel:
    """A sampled model with a loop closed."""
    return close_loop(model, loop.controller, measured=loop.measured, driven=loop.driven)


def machines(
    model: LinearModel, force: Loop, crossover: float, coordinates: str, platform: StewartPlatform
) -> tuple[dict[str, LinearModel], Loop]:
    """A sampled end-station "open", "damped" by force feedback and in the loop of its "pose", and that loop."""
    assert model.time_step is not None
    damped = with_loop(model, force)
    pose = pose_loop(damped, crossover, coordinates=coordinates, sample_rate=1 / model.time_step, platform=platform)
    return {"open": model, "damped": damped, "pose": with_loop(damped, pose)}, pose


def pose_sensitivity(damped: LinearModel, pose: Loop, frequency: np.ndarray) -> FRF:
    """What the loop leaves of the sample's motion, (6, 6, n)."""
    return sensitivity(open_loop(damped, pose.controller, frequency, measured=pose.measured, driven=pose.driven))[0]


def least_damping(model: LinearModel) -> float:
    """Of oscillations between 3 and 150 Hz."""
    frequency, ratio = damping(model)
    return float(ratio[(frequency > 3) & (frequency < 150) & (ratio < 0.99)].min())


def turning_figures(speed: float, force: Loop, platform: StewartPlatform, payload_mass: float) -> dict[str, object]:
    """Whether the damped station is stable with its spindle turning, and by how much its twelve lowest modes move.

    Its stages are made alike in all directions across the axis, as a linear model of what turns needs.
    """
    options = {"stages": alike_across(), "platform": platform, "payload_mass": payload_mass}
    turning, standing = (linearize(make_nass(spindle_rpm=rpm, axes="turning", **options)) for rpm in (speed, 0.0))
    moved = np.abs(damping(turning)[0][:12] - damping(standing)[0][:12])
    growing = unstable_poles(with_loop(sampled(turning, force.controller.sample_rate), force))
    return {
        "speed_rpm": speed,
        "spinning": f"unstable, {growing[0]}" if growing else "stable",
        "spinning_shift_Hz": moved.max(),
    }


def by_axis(rms: np.ndarray) -> dict[str, float]:
    """Six figures by direction."""
    return dict(zip(SIX, map(float, rms), strict=True))


def shares(budgets: Mapping[str, NoiseBudget]) -> dict[str, dict[str, dict[str, float]]]:
    """Rms by machine, disturbance ("total" too) and direction."""
    return {
        name: {k: by_axis(rms) for b in (budget, budget.total) for k, rms in zip(b.inputs, b.rms().T, strict=True)}
        for name, budget in budgets.items()
    }
