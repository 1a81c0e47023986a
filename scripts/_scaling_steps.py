"""What a step costs of scenes of growing size, and a response a line, for benchmark_scaling.py."""

from typing import Any

import numpy as np
from _costs import cpu_time
from _scaling_scenes import chain, ring
from _signal_rows import RATE

from models.apa300ml import reduced_apa300ml
from nassim import Scene, TimeHistory, frequency_response, linearize, simulate
from nassim.signals import band_limited_noise

METHODS = {"exact": ("linear", "exact", 20_000), "linear": ("linear", None, 2000), "ffrf": ("ffrf", None, 100)}
"""Fidelity, method and so many steps, whose cost is that of five times as many less that of as many."""
TURNS = 3
"""The fastest of which counts."""
FREQUENCIES = np.geomspace(1.0, 1e3, 1000)
"""Of responses [Hz]."""


def struts(count: float) -> dict[str, float]:
    """Rings of struts with trimmed bodies, in every fidelity."""
    apa, n = reduced_apa300ml(progress=False), round(count)
    found = {
        f"{name}_us_per_step": stepped(ring(fidelity, apa, n), method, steps)
        for name, (fidelity, method, steps) in METHODS.items()
    }
    return {"size": n, **found}


def states(n_bodies: float) -> dict[str, float]:
    """Chains of bodies: exact steps, and responses line by line."""
    scene = chain(round(n_bodies))
    model = linearize(scene)
    responding = min(cpu_time(frequency_response, model, FREQUENCIES)[1] for _ in range(TURNS))
    stepping = stepped(scene, "exact", METHODS["exact"][2])
    return {"size": len(model.A), "exact_us_per_step": stepping, "response_us": 1e6 * responding / len(FREQUENCIES)}


def stepped(scene: Scene, method: str | None, steps: int) -> float:
    """CPU time of one more step of 0.1 ms [us]."""
    push = band_limited_noise(5 * steps / RATE, RATE, cutoff_frequency=300.0, rms=0.1)
    units = tuple(map(scene.input_unit, scene.inputs))
    values = np.outer(np.arange(len(scene.inputs)) == 0, push.values[0])
    options: dict[str, Any] = {"time_step": 1 / RATE, "progress": False} | ({"method": method} if method else {})
    both = [TimeHistory(push.time[: n + 1], values[:, : n + 1], scene.inputs, units) for n in (steps, 5 * steps)]
    few, many = (min(cpu_time(simulate, scene, one, **options)[1] for _ in range(TURNS)) for one in both)
    return 1e6 * (many - few) / (4 * steps)
