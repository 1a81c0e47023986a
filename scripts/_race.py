"""Routes through the same time that are raced against each other, and what they miss of the exact one."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from _costs import cpu_time
from threadpoolctl import threadpool_limits

from nassim import Scene, TimeHistory, simulate


@dataclass(frozen=True)
class Route:
    """A way to d_e, (n_samples,); step: between samples [s]; true: name of the route that is right.

    brief: the same in a few steps, whose time is not counted
    limit: what the steps cannot do without; peer: name of the route of another program
    """

    work: Callable[[], Any]
    step: float
    true: str
    brief: Callable[[], Any] | None = None
    limit: Callable[[], Any] | None = None
    peer: str = ""


def simulated(scene: Scene, excitation: TimeHistory, output: str, step: float, method: str) -> Callable[[], Any]:
    """A simulation that gives one output."""
    run = partial(simulate, scene, excitation, time_step=step, method=method, outputs=[output], progress=False)
    return lambda: run()[output]


def race(routes: Mapping[str, Route], turns: int) -> dict[str, dict[str, float | None]]:
    """Figures of every route: the fastest of some turns, in which all run one after the other, on one thread.

    Times are the processor's: other work on the machine matters little.
    """
    whole, start, bare = ({name: np.inf for name in routes} for _ in range(3))
    found, best = {}, {}
    for name, route in list(routes.items()) * turns:
        with threadpool_limits(1):
            begun, brief = cpu_time(route.brief) if route.brief else ([0.0], 0.0)
            found[name], took = cpu_time(route.work)
            whole[name], start[name] = min(whole[name], took), min(start[name], brief)
            # Of few steps on a busy machine the start may be all that is seen.
            best[name] = max(whole[name] - start[name], 1e-3 * took) / (len(found[name]) - len(begun))
            if route.limit:
                bare[name] = min(bare[name], cpu_time(route.limit)[1] / (len(found[name]) - 1))
    figures = {}
    for name, route in routes.items():
        peer = found.get(route.peer)
        figures[name] = {
            "step_s": route.step,
            "us_per_step": 1e6 * best[name],
            "limit_us_per_step": 1e6 * bare[name] if route.limit else None,
            "peer_us_per_step": None if peer is None else 1e6 * best[route.peer],
            "speed_over_peer": None if peer is None else best[route.peer] / best[name],
            "difference": None if peer is None else _deviation(found[name], peer),
            "steps_per_s": 1 / best[name],
            "speed_over_real_time": route.step / best[name],
            "encoder_error": _deviation(found[name], found[route.true]),
        }
    return figures


def _deviation(found: Any, true: Any) -> float:
    """Largest difference, as far as both go, as a share of the largest value."""
    n = min(len(found), len(true))
    return float(np.abs(found[:n] - true[:n]).max() / np.abs(true[:n]).max())
