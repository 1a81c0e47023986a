"""Where Exudyn's bodies are at some steps of a run."""

from collections.abc import Iterable

import numpy as np

from nassim.base.checks import Array
from nassim.scene.motion import Motion
from nassim.simulation.exudyn.state import System
from nassim.simulation.model.recorded_motion import recorded_motion


class MotionRecorder:
    """Keeps a system's state at some steps; to be called at every step with its number."""

    def __init__(self, system: System, steps: Iterable[int]) -> None:
        scene = system.assembly.scene
        linear = {body.name for body in scene.flexible_bodies if body.fidelity == "linear"}
        self.system, self.steps = system, frozenset(map(int, steps))
        self.deformations: dict[str, list[Array]] = {name: [] for name in system.flexible}
        floating = [body for body in scene.bodies if body.name in system.nodes and body.name not in linear]
        self.poses: dict[str, list[tuple[Array, Array]]] = {body.name: [] for body in floating}
        self.bodies = floating

    def __call__(self, step: int) -> None:
        """Keep the present state, if it is one of those to keep."""
        if step in self.steps:
            for name, kept in self.deformations.items():
                kept.append(self.system.deformation(name))
            for body in self.bodies:
                self.poses[body.name].append(self.system.pose(body))

    def motion(self, time: Array) -> Motion:
        """What was kept; time: of the steps that were [s]."""
        poses = {
            name: (np.array([place for place, _ in kept]), np.array([turn for _, turn in kept]))
            for name, kept in self.poses.items()
        }
        coordinates = {name: np.array(kept) for name, kept in self.deformations.items()}
        return recorded_motion(self.system.assembly, time, coordinates, poses)
