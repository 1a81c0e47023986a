"""Time-domain simulation and static equilibrium of scenes."""

from collections.abc import Mapping, Sequence

import numpy as np

from nassim.checks import Array, known, positive
from nassim.exudyn_system import build_system, eigenfrequencies, solve_dynamic, solve_static
from nassim.scene import Scene
from nassim.signals import TimeHistory, occupied_bandwidth

METHODS = ("generalized_alpha",)
STEPS_PER_PERIOD = 8
"""Fewest time steps in the shortest period that an excitation holds."""


def simulate(
    scene: Scene,
    excitation: TimeHistory,
    *,
    time_step: float,
    duration: float | None = None,
    outputs: Sequence[str] | None = None,
    method: str = "generalized_alpha",
    spectral_radius: float = 1.0,
    progress: bool = True,
) -> TimeHistory:
    """Simulate a scene and record its inputs and outputs together at every time step.

    excitation: one signal per input of the scene; between its samples it runs straight
    time_step: of the integrator [s]; duration [s] (default: the excitation's)
    outputs: names (default: all of the scene)
    method: "generalized_alpha"; spectral_radius: numerical damping at infinite frequency, 1 (none, the
        trapezoidal rule) ... 0; a step h lengthens a period T by about (2 pi h / T)^2 / 12
    progress: show a bar; Ctrl-C stops the run at the end of a step

    Returns the signals of `excitation`, sampled at the time steps, then the outputs. Raises ValueError for unknown
    names and for a step that gives the excitation's shortest period fewer than 8 steps; RuntimeError when the
    integration fails.
    """
    known("method", method, METHODS)
    names = scene.outputs if outputs is None else tuple(outputs)
    for name in names:
        known("output", name, scene.outputs)
    if not 0.0 <= spectral_radius <= 1.0:
        raise ValueError(f"spectral_radius must lie in 0 ... 1, got {spectral_radius:g}")
    n_steps = _steps(excitation, time_step, duration)
    missing = set(scene.inputs) - set(excitation.names)
    if missing:
        raise ValueError(f"the excitation lacks the input(s) {', '.join(sorted(missing))}; it has {excitation.names}")
    for name in excitation.names:
        known("input", name, scene.inputs)
    _check_time_step(excitation, time_step)

    time = np.arange(n_steps + 1) * time_step
    driven = np.array([np.interp(time + excitation.time[0], excitation.time, row) for row in excitation.values])
    signals = {name: row.tolist() for name, row in zip(excitation.names, driven, strict=True)}
    system = build_system(scene, lambda name, t: signals[name][int(t / time_step + 0.5)])
    if np.any(scene.gravity):
        solve_static(system)
    solve_dynamic(system, n_steps, time_step, spectral_radius, progress)
    sensors = [scene.sensors[scene.outputs.index(name)] for name in names]
    readings = np.array([system.recorded(sensor) for sensor in sensors]).reshape(len(names), n_steps + 1)
    return TimeHistory(
        time,
        np.vstack([driven, readings]),
        (*excitation.names, *names),
        (*excitation.units, *(sensor.unit for sensor in sensors)),
    )


def static_response(scene: Scene, inputs: Mapping[str, float] | None = None) -> dict[str, float]:
    """Outputs of a scene in static equilibrium under constant inputs [V] and its gravity, by Exudyn's static solver.

    Raises ValueError for unknown inputs, RuntimeError when there is no equilibrium (a body that can move freely).
    """
    values = {name: 0.0 for name in scene.inputs}
    for name, value in (inputs or {}).items():
        values[known("input", name, scene.inputs)] = value
    system = build_system(scene, lambda name, t: values[name])
    solve_static(system)
    return {sensor.name: float(system.recorded(sensor)[-1]) for sensor in scene.sensors}


def exudyn_eigenfrequencies(scene: Scene, *, n_modes: int | None = None) -> Array:
    """Undamped eigenfrequencies [Hz] of a scene as Exudyn linearises it about its start, ascending, (n_modes,)."""
    return eigenfrequencies(build_system(scene, lambda name, t: 0.0))[:n_modes]


def _steps(excitation: TimeHistory, time_step: float, duration: float | None) -> int:
    step = positive("time_step", time_step, "s")
    length = excitation.duration if duration is None else positive("duration", duration, "s")
    if length > excitation.duration * (1 + 1e-9):
        raise ValueError(f"duration {length:g} s is longer than the excitation ({excitation.duration:g} s)")
    n_steps = round(length / step)
    if n_steps < 1:
        raise ValueError(f"time_step {step:g} s is longer than the duration {length:g} s")
    return n_steps


def _check_time_step(excitation: TimeHistory, time_step: float) -> None:
    highest = occupied_bandwidth(excitation)
    if highest * time_step * STEPS_PER_PERIOD > 1.0:
        raise ValueError(
            f"time_step {time_step:g} s is too long: the excitation holds frequencies up to {highest:.4g} Hz; take at "
            f"most {1 / (STEPS_PER_PERIOD * highest):.3g} s ({STEPS_PER_PERIOD} steps per period) or filter it"
        )
