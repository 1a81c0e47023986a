"""The bench in longer and shorter steps, and hexapods with loops, as routes of a race."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from _limits import bare_product, exudyns_steps
from _race import Route, simulated

from models.bench import make_bench
from models.nano_hexapod import make_nano_hexapod
from models.strut import fe_strut, two_mass_strut, with_own_damping
from nassim import Loop, ReducedBody, Scene, TimeHistory, linearize
from nassim.signals import band_limited_noise
from nassim.systems import integral_force_feedback

STEP, CUTOFF, EXACT = 1e-4, 600.0, "exact"
COMPENSATED = (0.05, 0.1, 0.2, 0.4, 1.0)
"""Steps of the bench [ms]."""
ROUTES = {"exact": ("linear", EXACT), "linear": ("linear", "generalized_alpha"), "ffrf": ("ffrf", "generalized_alpha")}

LONGER = {"exact": 10, "linear": 1, "ffrf": 0.1}
"""How many times the steps asked for tell these routes' time from that of their start."""


def limit(scene: Scene, method: str, step: float, n_steps: int, inputs: int = 1) -> Callable[[], Any]:
    """What steps from so many inputs to one output cannot do without."""
    if method != EXACT:
        return exudyns_steps(scene, step, n_steps)
    return bare_product(len(linearize(replace(scene, loops=())).A), inputs, 1, n_steps)


def compensated(apa: ReducedBody, steps: int) -> dict[str, Route]:
    """The bench in several steps through the same time, that of so many of 0.1 ms; noise up to 80 Hz."""
    # Straight lines between 1 ms, so that all steps see the same voltage.
    noise = band_limited_noise(max(steps * STEP, 0.05), 1e3, cutoff_frequency=80.0, rms=1e-5)
    result = {}
    for step in (1e-3 * milliseconds for milliseconds in COMPENSATED):
        for name, (fidelity, method) in ROUTES.items():
            bench = make_bench(apa=apa, fidelity=fidelity)
            label = f"bench {name}, {1e3 * step:g} ms"
            work = simulated(bench, noise, "encoder", step, method)
            bare = limit(bench, method, step, round(noise.duration / step))
            result[label] = Route(work, step, f"bench {EXACT}, {1e3 * step:g} ms", limit=bare)
    return result


def hexapods(apa: ReducedBody, steps: int) -> dict[str, Route]:
    """Trimmed hexapods with 2, 4 or 6 struts of finite elements, the others of two masses; a loop for each."""
    pushes = band_limited_noise(LONGER[EXACT] * steps * STEP, 1 / STEP, cutoff_frequency=300.0, rms=1e-3)
    result = {}
    for count in (2, 4, 6):
        for name, (fidelity, method) in ROUTES.items():
            scene, n = _hexapod(apa, count, fidelity), max(100, round(steps * LONGER[name]))
            forces = [word for word in scene.inputs if word.startswith("payload")]
            values = np.outer([word == "payload_force_z" for word in forces], pushes.values[0])
            units = tuple(map(scene.input_unit, forces))
            work, brief = (
                simulated(
                    scene,
                    TimeHistory(pushes.time[:samples], values[:, :samples], tuple(forces), units),
                    "strut_1/encoder",
                    STEP,
                    method,
                )
                for samples in (n + 1, max(n // 5, 40) + 1)
            )
            bare = limit(scene, method, STEP, n, len(forces))
            result[f"{count} struts {name}"] = Route(work, STEP, f"{count} struts {EXACT}", brief, bare)
    return result


def _hexapod(apa: ReducedBody, count: int, fidelity: str) -> Scene:
    # The middle mass of the two-mass actuator swings at 21 kHz: undamped, sampled loops drive it.
    struts = [fe_strut(fidelity, apa=apa)] * count + [with_own_damping(two_mass_strut())] * (6 - count)
    # Without damping of modes, which floating frames realise in part: the loops damp.
    hexapod = make_nano_hexapod(struts, damping_ratio=0.0, cutoff_frequency=CUTOFF)
    iff = integral_force_feedback(20.0, sample_rate=1 / STEP)
    names = [f"strut_{k}" for k in range(1, 7)]
    wires = [(f"{name}/sensor_voltage", f"{name}/actuator_voltage") for name in names]
    loops = [Loop(name, iff, *wire) for name, wire in zip(names, wires, strict=True)]
    return replace(hexapod, loops=tuple(loops))
