"""Trials of active damping: the bench with a loop or a damper, its first mode predicted and simulated."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from nassim import (
    Controller,
    LinearModel,
    Loop,
    Scene,
    SpringDamper,
    TimeHistory,
    linearize,
    simulate,
)
from nassim.base import decay_poles
from nassim.simulation import linearize_closed

WIRES = {"measured": "sensor_voltage", "driven": "actuator_voltage"}
TRIALS = {
    "damping predicted": "damping_predicted:.5f",
    "simulated": "damping_simulated:.5f",
    "difference [%]": "damping_difference_percent:.4f",
    "frequency predicted [Hz]": "frequency_predicted_Hz:.2f",
    "simulated [Hz]": "frequency_simulated_Hz:.2f",
}
"""Columns that print what `trial` gives."""


def first_mode(model: LinearModel, near: float) -> tuple[float, float]:
    """Frequency [Hz] and damping ratio of the oscillation below three times a frequency that decays slowest."""
    return _slowest(model.poles(), near)


def excite(duration: float, time_step: float, **signals: Any) -> TimeHistory:
    """Functions of time as signals of the bench's three inputs; those not given are zero."""
    time = np.arange(round(duration / time_step) + 1) * time_step
    units = {"actuator_voltage": "V", "payload_force": "N", "ground_acceleration": "m/s2"}
    values = [signals[name](time) if name in signals else np.zeros_like(time) for name in units]
    return TimeHistory(time, values, tuple(units), tuple(units.values()))


def simulated_mode(scene: Scene, time_step: float, near: float) -> tuple[float, float]:
    """As first_mode, from the decay after a pulse of force on the payload in the time simulation."""
    pulse = excite(0.25, time_step, payload_force=lambda t: np.exp(-(((t - 0.01) / 0.002) ** 2)))
    record = simulate(scene, pulse, time_step=time_step, method="exact", progress=False).after(0.02)
    poles = decay_poles(record.select(["sensor_voltage", "encoder"]).values[:, ::5], 5 * time_step, n_poles=16)
    return _slowest(poles, near)


def _slowest(poles: np.ndarray, near: float) -> tuple[float, float]:
    candidates = poles[(poles.imag > 0) & (np.abs(poles) < 2 * np.pi * 3 * near)]
    pole = candidates[np.argmax(candidates.real)]
    return float(abs(pole) / (2 * np.pi)), float(-pole.real / abs(pole))


def with_loop(bench: Scene, unit: Controller, gain: float) -> Scene:
    """The bench with a controller of unit gain times a gain."""
    return replace(bench, loops=(Loop("iff", replace(unit, C=gain * unit.C, D=gain * unit.D), **WIRES),))


def trial(scene: Scene, gain: float, *, time_step: float, near: float) -> dict[str, float]:
    """First mode of the bench with a loop of some gain, by the linear model and by the time simulation."""
    predicted = first_mode(linearize_closed(scene), near)
    found = simulated_mode(scene, time_step, near)
    return {
        "gain_per_s": gain,
        "damping_predicted": predicted[1],
        "damping_simulated": found[1],
        "damping_difference_percent": 100 * (found[1] / predicted[1] - 1),
        "frequency_predicted_Hz": predicted[0],
        "frequency_simulated_Hz": found[0],
    }


def with_damper(bench: Scene, rate: float) -> Scene:
    """The bench with a passive damper between ground and payload [N s/m]."""
    damper = SpringDamper("damper", "base.guide", "payload.bottom", "z", damping=rate)
    return replace(bench, springs=(damper,))


def equal_damper(bench: Scene, damping_ratio: float, *, near: float, payload_mass: float) -> float:
    """Rate of the passive damper that damps the first mode as much [N s/m]."""
    most = 1.5 * 2 * np.pi * near * payload_mass
    return brentq(lambda rate: first_mode(linearize(with_damper(bench, rate)), near)[1] - damping_ratio, 1.0, most)
