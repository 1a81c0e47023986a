"""Poles, damping and simulated trials of hexapods on a spindle."""

import numpy as np
from _pages import FRAMES
from _spinning import HIGHEST, Machine

from nassim import LinearModel, Scene, TimeHistory, simulate_motion
from nassim.base import decay_poles
from nassim.scene import Motion
from nassim.simulation import linearize_closed
from nassim.systems import sampled

TRIALS = {
    "speed [rpm]": "speed_rpm:.0f",
    "gain [1/s]": "gain_per_s:.0f",
    "predicted [1/s]": "growth_predicted_per_s:.4f",
    "simulated [1/s]": "growth_simulated_per_s:.4f",
    "difference [%]": "growth_difference_percent:.3f",
    "predicted [Hz]": "frequency_predicted_Hz:.4f",
    "simulated [Hz]": "frequency_simulated_Hz:.4f",
}
"""Columns that print what `trial` gives."""
PUSHED = 0.2
"""How long a trial's push lasts [s]."""


def growth_and_damping(
    machine: Machine, speeds: np.ndarray, gains: np.ndarray, *, parallel: bool, leak: float, sample_rate: float
) -> tuple[np.ndarray, np.ndarray]:
    """Largest real part of all poles [1/s] and least damping ratio below `HIGHEST`, (speeds, gains) each."""
    growth, ratio = np.zeros((2, len(speeds), len(gains)))
    for k, rpm in enumerate(speeds):
        plant = sampled(machine.plant(rpm, parallel), sample_rate)
        for j, gain in enumerate(gains):
            poles = machine.closed(plant, gain, leak).poles()
            growth[k, j] = poles.real.max()
            counted = poles[(poles.imag > 0) & (np.abs(poles) < 2 * np.pi * HIGHEST)]
            ratio[k, j] = (-counted.real / np.abs(counted)).min()
    return growth, ratio


def frequencies(machine: Machine, speeds: np.ndarray) -> np.ndarray:
    """Of the six suspension modes in the frame that turns, loops open, (speeds, 6) [Hz]."""
    result = []
    for rpm in speeds:
        poles = machine.plant(rpm, parallel=True).poles()
        swinging = poles[(poles.imag > 0) & (-poles.real < 0.5 * np.abs(poles))]
        result.append(np.sort(swinging.imag)[:6] / (2 * np.pi))
    return np.array(result)


def trial(
    machine: Machine, *, speed: float, gain: float, parallel: bool, leak: float, sample_rate: float, duration: float
) -> tuple[dict[str, float], TimeHistory, np.ndarray, tuple[Scene, Motion]]:
    """The slowest or fastest growing pole of a machine with its loops, by the linear model and by a run in time.

    The run is of bodies in large motion that turn with the spindle, after a push on the payload. Also its record, and
    the payload's distance from the axis that the linear model gives for the same push [m], and how the machine moved.
    """
    scene = machine.looped(speed, parallel, gain, leak, sample_rate)
    model = linearize_closed(scene)
    poles = model.poles()
    expected = poles[np.argmax(poles.real + 1e-9 * poles.imag)]
    time = np.arange(round(duration * sample_rate) + 1) / sample_rate
    push = np.sin(np.pi * np.minimum(time / PUSHED, 1.0)) ** 2
    values = np.outer([1.0, 0.3], push)
    forces = TimeHistory(time, values, ("payload_force_x", "payload_force_y"), ("N", "N"))
    silent = [name for name in scene.inputs if name not in (*machine.wires["driven"], *forces.names)]
    quiet = TimeHistory(time, np.zeros((len(silent), len(time))), tuple(silent), tuple(map(scene.input_unit, silent)))
    names, units = forces.names + quiet.names, forces.units + quiet.units
    excitation = TimeHistory(time, np.vstack([values, quiet.values]), names, units)
    steps = {"time_step": 1 / sample_rate, "frames": np.linspace(0.0, time[-1], FRAMES)}
    record, motion = simulate_motion(scene, excitation, **steps, progress=False)
    distance = np.hypot(*responses(model, forces))
    after = record.after(PUSHED + 2 / sample_rate).select([f"pose.{c}" for c in ("ux", "uy", "rx", "ry")])
    every = max(1, round(sample_rate / 100))
    scaled = after.values / np.abs(after.values).max(axis=1, keepdims=True)
    found = decay_poles(scaled[:, ::every], every / sample_rate, n_poles=14)
    pole = found[np.argmin(np.abs(found - expected))]
    figures = {
        "speed_rpm": speed,
        "gain_per_s": gain,
        "growth_predicted_per_s": expected.real,
        "growth_simulated_per_s": pole.real,
        "growth_difference_percent": 100 * abs(pole.real / expected.real - 1),
        "frequency_predicted_Hz": abs(expected.imag) / (2 * np.pi),
        "frequency_simulated_Hz": abs(pole.imag) / (2 * np.pi),
    }
    return figures, record, distance, (scene, motion)


def responses(model: LinearModel, forces: TimeHistory) -> np.ndarray:
    """Displacement of the payload along x and y from rest under forces, by a sampled model, (2, n) [m]."""
    columns, rows = [model.inputs.index(n) for n in forces.names], [model.outputs.index(f"pose.u{c}") for c in "xy"]
    state, result = np.zeros(len(model.A)), np.zeros((2, len(forces.time)))
    for k, force in enumerate(forces.values.T):
        result[:, k] = model.C[rows] @ state
        state = model.A @ state + model.B[:, columns] @ force
    return result
