"""Closed loops that run away: their check and their messages."""

import math
from collections.abc import Mapping

import numpy as np

from nassim.base.checks import Array
from nassim.scene.scene import Scene
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.motion_size import SMALL_MOTION, motion_sizes
from nassim.simulation.model.reach import Reach

RUNAWAY = 0.1
"""A deformation of this share of a body's size, or this rotation [rad], means that a loop runs away."""


def see_runaway(coordinates: Coordinates, reach: Reach, values: Array, sample: int) -> tuple[str, bool]:
    """Find a body that a loop has deformed or moved beyond its bounds.

    Args:
        coordinates: coordinates of the scene.
        reach: bounds of its bodies' displacements.
        values: values of all coordinates now, (n_all,).
        sample: number of the present sample.

    Returns:
        Description of the body that is farthest beyond them, empty without one, and whether the model is valid for all
        bodies.
    """
    allowed, places = reach.at(sample), coordinates.slices
    sizes = motion_sizes(coordinates, values[:, None])
    largest = {name: float(size.max()) for name, size in sizes.items()}
    if name := farthest(largest, dict.fromkeys(places, RUNAWAY)):
        return deformed(name), False
    distances = {name: math.hypot(*values[place][:3].tolist()) for name, place in places.items()}
    if name := farthest(distances, allowed):
        return too_far(name, distances[name], allowed[name]), False
    return "", all(size <= SMALL_MOTION for size in largest.values())


def farthest(sizes: Mapping[str, float], allowed: Mapping[str, float]) -> str:
    """Return the name of the body whose size is farthest beyond what is allowed; empty where none is beyond it."""
    excess = {name: size - allowed[name] for name, size in sizes.items() if not size < allowed[name]}
    return max(excess, key=lambda name: math.inf if math.isnan(excess[name]) else excess[name], default="")


def deformed(body: str) -> str:
    """Describe a body that a loop has deformed too much."""
    return f"body {body!r} is deformed by more than {100 * RUNAWAY:g} % of its size or turned by {RUNAWAY:g} rad"


def too_far(body: str, distance: float, allowed: float) -> str:
    """Describe a body that a loop has moved too far; distance and allowed distance in [m]."""
    return (
        f"body {body!r} has moved by {distance:.3g} m, where the scene's size, forces, speeds and drives account for "
        f"{allowed:.3g} m at most"
    )


def runaway(scene: Scene, happened: str, outputs: Array, time_step: float) -> str:
    """Describe a loop that runs away: when, which of its signals has grown most, and by how much.

    Args:
        scene: the scene.
        happened: description of a body, from `see_runaway`.
        outputs: outputs of the scene from the start until now, (n_samples, outputs).
        time_step: time step [s].

    Returns:
        The message.
    """
    n = len(outputs)
    recent, before = outputs[-max(1, n // 8) :], outputs[: max(1, n // 2)]
    size = np.abs(recent).max(axis=0)
    growth = size / np.maximum(np.abs(before).max(axis=0), np.finfo(float).tiny)
    measured = [scene.outputs.index(name) for loop in scene.loops for name in loop.measured]
    worst = max(measured, key=lambda k: growth[k])
    names = ", ".join(repr(loop.name) for loop in scene.loops)
    return (
        f"the closed loop runs away: at t = {(n - 1) * time_step:g} s {scene.outputs[worst]!r} has grown to "
        f"{size[worst]:.3g} {scene.output_units[worst]} and {happened}. Unstable, unless the excitation is far too "
        f"large: check the sign, gain and delay of loop {names} on the linear model (linearize_closed, unstable_poles)"
    )
