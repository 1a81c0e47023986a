"""Modes of scenes as motion to be looked at: damped and spinning ones too, whose points go round in ellipses."""

import numpy as np
from numpy.typing import ArrayLike

from nassim.base.checks import Array
from nassim.scene.motion import Motion
from nassim.scene.scene import Scene
from nassim.simulation.linear.linearization import STANDING, spun, state_space
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.recorded_motion import recorded_motion, traced

FRAMES = 48
LARGEST = 1e-3
"""Largest displacement over the size of a scene, and rotation [rad], of a mode that is shown."""


def mode_motion(
    scene: Scene,
    number: int,
    *,
    frames: int = FRAMES,
    angular_velocity: ArrayLike = STANDING,
    axis_point: ArrayLike = STANDING,
) -> tuple[complex, Motion]:
    """A period of one mode of a scene's linear model, as if it did not decay, and its pole [rad/s].

    number: 1 for the oscillation that is slowest, and so on; frames: how many in the period, which ends where it begins
    angular_velocity, axis_point: of a scene that turns, see `linearize`; the motion is then as seen by who turns along

    Its size is one at which everything is small. Drives do not move. Raises ValueError for a mode that there is not.
    """
    assembly, spin = spun(traced(scene), angular_velocity, axis_point, None, "turning")
    poles, vectors = np.linalg.eig(state_space(assembly, spin)[0])
    swinging = np.flatnonzero(poles.imag > 1e-9 * np.abs(poles).max())
    order = swinging[np.argsort(np.abs(poles[swinging]))]
    if not 1 <= number <= len(order):
        raise ValueError(f"scene {scene.name!r} has oscillations 1 ... {len(order)}, got {number}")
    pole, vector = poles[order[number - 1]], vectors[:, order[number - 1]]
    shape = assembly.basis @ (assembly.shapes @ vector[: len(assembly.frequency)])
    angle = np.linspace(0, 2 * np.pi, frames)
    swing = np.real(np.outer(np.exp(1j * angle), shape / _size(assembly, shape)))
    own = {name: swing[:, place] for name, place in assembly.slices.items()}
    return complex(pole), recorded_motion(assembly, angle / pole.imag, own, {})


def _size(assembly: Assembly, shape: Array) -> float:
    """What makes a shape small: its largest rotation, and displacement over the distance between points."""
    rows, places = [], []
    for body in assembly.scene.bodies:
        names = body.point_names
        places += [body.point_position(name) for name in names]
        if body.moves:
            rows += [body.motion(name) @ shape[assembly.slices[body.name]] for name in names]
    span = float(np.linalg.norm(np.ptp(places, axis=0))) or 1.0
    moved = np.abs(np.reshape(rows, (-1, 6))) / np.repeat([span, 1.0], 3)
    return float(moved.max(initial=0.0)) / LARGEST or 1.0
