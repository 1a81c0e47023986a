"""Pictures of active damping from simulated records: FRFs and answers to a step."""

from pathlib import Path

import numpy as np
from _damping_trials import excite

from nassim import FRF, Scene, TimeHistory, estimate_frf, frequency_response, simulate
from nassim.plotting import plot_frf, plot_time_history, plt, save_figure
from nassim.signals import band_limited_noise
from nassim.simulation import linearize_closed


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


def plot_steps(scenes: dict[str, Scene], time_step: float, path: Path) -> None:
    """Answers to a step of 1 N on the payload, within 0.15 s."""
    step = excite(0.15, time_step, payload_force=lambda t: 1.0 * (t > 0.005))
    records = [simulate(s, step, time_step=time_step, method="exact", progress=False) for s in scenes.values()]
    values = np.array([1e6 * record["encoder"] for record in records])
    axes = plot_time_history(TimeHistory(step.time, values, tuple(scenes), ("um",) * len(scenes)))
    save_figure(axes, path)
