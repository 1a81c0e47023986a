"""Pages of models and moving machines for the browser, and pictures where PyVista is installed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.nano_hexapod import PLATE_HEIGHT, PLATE_RADIUS
from nassim import RigidBody, Scene
from nassim.bodies import Surface
from nassim.scene import Motion, seen_from
from nassim.viewer import View, block, cylinder, save_picture, view_motion, write_page

FRAMES = 200
SPAN = 0.2
"""Duration of the end of a run that is shown [s], with ten images per period of 100 Hz."""
LIFT = np.array([0.0, 0.0, 5e-3])
"""Half of the thickness of plates [m]."""


def show(view: View, path: Path, **picture: Any) -> None:
    """Write path.html and path.png; print a line if there can be no picture. picture: as of `save_picture`."""
    write_page(view, path.with_suffix(".html"))
    try:
        save_picture(view, path.with_suffix(".png"), **picture)
    except ImportError as error:
        print(f"no {path.name}.png: {error}")


def last_frames(duration: float) -> np.ndarray:
    """Return the times of the images of a run [s]."""
    return np.linspace(max(duration - SPAN, 0.0), duration, FRAMES)


def write_bench(scene: Scene, motion: Motion, path: Path) -> None:
    """Write the bench; base and payload are plates, because they would hide the actuator."""
    base, payload = (scene.body(name) for name in ("base", "payload"))
    low, high = base.points["top"], payload.points["bottom"]
    looks = {
        "base": block((0.12, 0.06, 0.01), low - LIFT),
        "payload": block((0.05, 0.04, 0.01), high + LIFT),
    }
    write_page(view_motion(scene, motion, looks=looks), path)


def write_hexapod(scene: Scene, motion: Motion, path: Path, *, discs: Sequence[str] = ("plate", "payload")) -> None:
    """Write a hexapod in motion."""
    write_page(view_motion(scene, motion, looks=hexapod_looks(scene, discs)), path)


def hexapod_looks(scene: Scene, discs: Sequence[str] = ("plate", "payload")) -> Mapping[str, Surface]:
    """Return discs as the looks of a hexapod's rigid base and of other named rigid bodies."""
    looks = {"base": cylinder(PLATE_RADIUS, PLATE_HEIGHT, (0, 0, PLATE_HEIGHT / 2))}
    for name in discs:
        body = scene.body(name)
        if isinstance(body, RigidBody):
            looks[name] = disc_of(body)
    return looks


def write_spinning(trials: Mapping[str, tuple[Scene, Motion]], folder: Path, title: str) -> None:
    """Write a hexapod on a spindle: several trials in the rotor frame, and the first trial in the stator frame.

    The payload is a box, so its rotation is visible.
    """
    for number, (name, (scene, motion)) in enumerate(trials.items()):
        label = f"{title} {name}".replace(" ", "_")
        if not number:
            write_hexapod(scene, motion, folder / f"{label}_turning.html", discs=["plate"])
        seen = seen_from(scene, motion, "base")
        # In the rotor frame the ground turns and is not drawn. All other motion is small and shown magnified.
        moving = seen.select([body.name for body in scene.bodies if body.moves])
        write_hexapod(scene, moving, folder / f"{label}.html", discs=["plate"])


def disc_of(body: RigidBody) -> Surface:
    """Return a homogeneous cylinder along z with mass and inertia of a rigid body."""
    across, along = body.inertia[0, 0] / body.mass, body.inertia[2, 2] / body.mass
    return cylinder(np.sqrt(2 * along), np.sqrt(12 * across - 6 * along), label=body.name)
