"""Modes of scenes as motion for pictures: damped and spinning modes too, whose points move on ellipses."""

from dataclasses import replace
from typing import Any

import numpy as np

from nassim.base.checks import Array
from nassim.base.field_types import ArrayLike
from nassim.scene.motion import Motion
from nassim.scene.scene import Scene
from nassim.scene.terms import AppliedForce, BaseAcceleration, Output, OutputFilter, SpringForce
from nassim.simulation.linear.linearization import loaded_assembly
from nassim.simulation.linear.scene_state_space import state_space
from nassim.simulation.loaded.loaded_state import NO_LOAD
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.motion_size import scene_size
from nassim.simulation.model.recorded_motion import recorded_motion, traced
from nassim.simulation.model.trimming import trim_scene

N_IMAGES = 48
"""Images in a period."""
SIGNALS = AppliedForce, BaseAcceleration, Output, OutputFilter, SpringForce
"""Terms that have no effect on free motion."""
SHOWN_AMPLITUDE = 1e-3
"""Largest displacement over the size of a scene, and largest rotation [rad], of a mode's motion."""


def mode_motion(
    scene: Scene,
    number: int,
    *,
    frames: int = N_IMAGES,
    angular_velocity: ArrayLike = NO_LOAD,
    axis_point: ArrayLike = NO_LOAD,
) -> tuple[complex, Motion]:
    """Compute one period of a mode of a scene's linear model, without its decay.

    The amplitude is small. Drives do not move. Forces and sensors have no effect on a mode, so they may be along any
    axes, also in a scene that rotates; the filters of sensors are no oscillations here.

    Args:
        scene: the scene.
        number: number of the oscillation, from 1 for the slowest.
        frames: number of images in the period, the last of which equals the first.
        angular_velocity: angular velocity of a scene that rotates, (3,) [rad/s], see `linearize`; the motion is then
            that in the rotating frame.
        axis_point: a point of the axis, (3,) [m].

    Returns:
        The pole [rad/s], and the motion.

    Raises:
        ValueError: for a number without a mode.
    """
    silent = _without_signals(trim_scene(traced(scene)))
    assembly = loaded_assembly(silent, angular_velocity=angular_velocity, axis_point=axis_point)
    poles, vectors = np.linalg.eig(state_space(assembly)[0])
    swinging = np.flatnonzero(poles.imag > 1e-9 * np.abs(poles).max())
    order = swinging[np.argsort(np.abs(poles[swinging]))]
    if not 1 <= number <= len(order):
        raise ValueError(f"scene {scene.name!r} has oscillations 1 ... {len(order)}, got {number}")
    pole, vector = poles[order[number - 1]], vectors[:, order[number - 1]]
    shape = assembly.modal.modes @ vector[: len(assembly.modal.frequency)]
    angle = np.linspace(0, 2 * np.pi, frames)
    swing = np.real(np.outer(np.exp(1j * angle), shape / _size(assembly.coordinates, shape)))
    own = {name: swing[:, place] for name, place in assembly.coordinates.slices.items()}
    return complex(pole), recorded_motion(assembly.scene, angle / pole.imag, own, {})


def _without_signals(scene: Scene) -> Scene:
    """Return a scene without loops, and without the parts that only push or read."""

    def act(parts: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(part for part in parts if not all(isinstance(term, SIGNALS) for term in part.all_terms(scene)))

    return replace(scene, loops=(), actuators=act(scene.actuators), sensors=act(scene.sensors))


def _size(coordinates: Coordinates, shape: Array) -> float:
    """Return the largest rotation [rad] or displacement over the size of the scene, over `SHOWN_AMPLITUDE`."""
    rows = [
        body.motion(name) @ shape[coordinates.slices[body.name]]
        for body in coordinates.scene.bodies
        if body.moves
        for name in body.point_names
    ]
    size = scene_size(coordinates.scene)
    moved = np.abs(np.reshape(rows, (-1, 6))) / np.repeat([size, 1.0], 3)
    return float(moved.max(initial=0.0)) / SHOWN_AMPLITUDE or 1.0
