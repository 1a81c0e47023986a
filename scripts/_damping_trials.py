"""Trials and pictures of active damping, for active_damping.py."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from _common import pole_and_zero_of

from nassim import FRF, LinearModel, Scene, SpringDamper, TimeHistory, estimate_frf, frequency_response, simulate
from nassim.base import decay_poles
from nassim.plotting import plot_frf, plot_time_history, plt, save_figure
from nassim.signals import band_limited_noise
from nassim.simulation import linearize_closed


def pole_zero_level(plant: LinearModel) -> tuple[float, float, float]:
    """Pole and zero of V_s/V_a [Hz], and the level that it tends to between this and the next pole [V/V]."""
    pole, zero = pole_and_zero_of(plant)
    between = 3 * pole
    response = frequency_response(plant, np.array([between])).response("sensor_voltage", "actuator_voltage")
    return pole, zero, float(np.abs(response[0]) * abs(pole**2 - between**2) / abs(zero**2 - between**2))


def first_mode(model: LinearModel, near: float) -> tuple[float, float]:
    """Frequency [Hz] and damping ratio of the oscillation below three times a frequency that decays slowest."""
    poles = model.poles()
    candidates = poles[(poles.imag > 0) & (np.abs(poles) < 2 * np.pi * 3 * near)]
    pole = candidates[np.argmax(candidates.real)]
    return float(abs(pole) / (2 * np.pi)), float(-pole.real / abs(pole))


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
    candidates = poles[(poles.imag > 0) & (np.abs(poles) < 2 * np.pi * 3 * near)]
    pole = candidates[np.argmax(candidates.real)]
    return float(abs(pole) / (2 * np.pi)), float(-pole.real / abs(pole))


def with_damper(bench: Scene, rate: float) -> Scene:
    """The bench with a passive damper between ground and payload [N s/m]."""
    damper = SpringDamper("damper", "base.guide", "payload.bottom", "z", damping=rate)
    return replace(bench, springs=(damper,))


def plot_trials(scenes: dict[str, Scene], *, duration: float, time_step: float, path: Path) -> None:
    """FRFs of the damped bench from simulated records of noise, as points on the linear prediction."""
    frequency = np.geomspace(5.0, 900.0, 3000)
    noise = band_limited_noise(duration, 1 / time_step, cutoff_frequency=600.0, rms=0.1).values[0]
    excitation = excite(duration, time_step, actuator_voltage=lambda _t: noise)
    frfs, markers = [], []
    for name, scene in scenes.items():
        frfs.append(frequency_response(linearize_closed(scene, continuous=True), frequency, label=f"{name}, linear"))
        record = simulate(scene, excitation, time_step=time_step, method="exact", progress=False)
        found = estimate_frf(
            record,
            inputs=["actuator_voltage"],
            outputs=["sensor_voltage", "encoder"],
            segment_duration=2.0,
            label=f"{name}, simulated",
        ).band(5, 600)
        chosen = np.searchsorted(found.frequency, np.geomspace(5, found.frequency[-1], 90))
        thin = np.unique(chosen.clip(max=len(found.frequency) - 1))
        values = found.values[:, :, thin]
        frfs.append(FRF(found.frequency[thin], values, found.outputs, found.inputs, None, found.label))
        markers.append(frfs[-1].label)
    columns = plt.figure(figsize=(13, 7), layout="constrained").subfigures(1, 2)
    for column, (output, unit) in zip(columns, (("sensor_voltage", "V/V"), ("encoder", "m/V")), strict=True):
        axes = plot_frf(frfs, output=output, input="actuator_voltage", unit=unit, markers=markers, figure=column)
        for ax in axes:
            for line, points in zip(ax.lines[::2], ax.lines[1::2], strict=False):
                points.set_color(line.get_color())
        axes[0].legend(fontsize=8)
    save_figure(axes, path)


def plot_isolation(frfs: list[FRF], isolation: list[FRF], path: Path) -> None:
    """Transmissibility from the ground and compliance of the payload, side by side."""
    columns = plt.figure(figsize=(13, 7), layout="constrained").subfigures(1, 2)
    plot_frf(isolation, output="absolute motion", input="ground", unit="m/m", figure=columns[0])
    save_figure(plot_frf(frfs, output="encoder", input="payload_force", unit="m/N", figure=columns[1]), path)


def plot_steps(scenes: dict[str, Scene], time_step: float, path: Path) -> None:
    """Answers to a step of 1 N on the payload, within 0.15 s."""
    step = excite(0.15, time_step, payload_force=lambda t: 1.0 * (t > 0.005))
    records = [simulate(s, step, time_step=time_step, method="exact", progress=False) for s in scenes.values()]
    values = np.array([1e6 * record["encoder"] for record in records])
    axes = plot_time_history(TimeHistory(step.time, values, tuple(scenes), ("um",) * len(scenes)))
    save_figure(axes, path)
