"""Measure what stress costs: a reduction with stress on the actuator's whole surface, and steps of the bench with it.

A body with stress has further coordinates, the static responses to body forces, so steps cost more even where nothing
reads the stress. Here a sensor reads its six components. Runs with and without stress alternate, on one thread,
and the fastest counts. Times are CPU times.
"""

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from common.arguments import parser, run, whole
from common.costs import compared
from common.report import print_table, write_summary
from models.apa300ml import COARSE, PORTS, make_apa300ml
from models.bench import make_bench
from nassim import (
    FEModel,
    ReducedBody,
    Scene,
    StressAt,
    StressPoint,
    StressSurface,
    TimeHistory,
    build_fe_model,
    condense,
    craig_bampton,
    simulate,
)
from nassim.bodies.stress import StressField

STEP = 1e-4
PLACES = (StressPoint("edge", (32.5e-3, 0.0, 5e-3), "frame"), StressSurface())
arguments = parser(__doc__, "benchmark_stress")
arguments.add_argument("--steps", type=whole(20), default=2000, help="steps of 0.1 ms (default: 2000)")
arguments.add_argument(
    "--turns", type=whole(1), default=5, help="repetitions, of which the fastest counts (default: 5)"
)
COLUMNS = {"without [ms]": "without_s*1e3:.3g", "with [ms]": "with_s*1e3:.3g", "ratio": "ratio:.2f"}


def reduction(model: FEModel, stress: tuple[StressPoint | StressSurface, ...]) -> ReducedBody:
    """The body of an FE model, from the mesh."""
    return craig_bampton(condense(model, progress=False), stress=stress, progress=False)


def run_in_time(scene: Scene, n_steps: int, method: str) -> TimeHistory:
    """Steps of a bench."""
    time = np.arange(n_steps + 1) * STEP
    excitation = TimeHistory(time, 1e-3 * np.sin(2 * np.pi * 50 * time)[None], scene.inputs, ("V",))
    return simulate(scene, excitation, time_step=STEP, method=method, progress=False)


def main() -> None:
    args = arguments.parse_args()
    model = build_fe_model(make_apa300ml(ports=PORTS), element_size=COARSE["element_size"], order=COARSE["order"])
    plain, stressed = (reduction(model, places) for places in ((), PLACES))
    ways: dict[str, tuple[Callable[[], Any], Callable[[], Any], int]] = {
        "reduction": (partial(reduction, model, ()), partial(reduction, model, PLACES), 1)
    }
    for fidelity, method in (("ffrf", "generalized_alpha"), ("linear", "exact")):
        bench, sensed = (make_bench(apa=apa, fidelity=fidelity) for apa in (plain, stressed))
        sensed = replace(sensed, sensors=(*sensed.sensors, StressAt("stress", "apa.edge")))
        pair = (partial(run_in_time, scene, args.steps, method) for scene in (bench, sensed))
        ways[f"step in {'exact' if method == 'exact' else fidelity}"] = (*pair, args.steps)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*that its finite elements leave")
        rows = {name: compared(*work, args.turns) for name, work in ways.items()}
    print_table("stress on the surface", rows, COLUMNS)
    kept = stressed.readouts["stress"]
    assert isinstance(kept, StressField)
    memory = kept.rows.nbytes + kept.deviations.nbytes
    print(f"{len(kept.positions)} points, {kept.n_coordinates} coordinates: {1e-6 * memory:.0f} MB")
    figures: dict[str, Any] = {"points": len(kept.positions), "coordinates": kept.n_coordinates, "memory_B": memory}
    write_summary(args.output, {**rows, **figures, "coordinates_without": len(plain.mass_matrix)})


if __name__ == "__main__":
    run(main)
