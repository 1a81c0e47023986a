"""Recording of the bodies' motion at some steps of an Exudyn run, for pictures."""

from collections.abc import Iterable

import numpy as np

from nassim.base.checks import Array
from nassim.scene.motion import Motion
from nassim.simulation.exudyn.frame_poses import FramePoses
from nassim.simulation.exudyn.running_system import System
from nassim.simulation.model.recorded_motion import recorded_motion


class MotionRecorder:
    """Recorder of a system's state at some steps; call it at every step with its number."""

    def __init__(self, system: System, steps: Iterable[int]) -> None:
        scene = system.assembly.scene
        linear = {body.name for body in scene.of_fidelity("linear")}
        self.system, self.frames, self.steps = system, FramePoses(system), frozenset(map(int, steps))
        self.deformations: dict[str, list[Array]] = {name: [] for name in system.flexible}
        floating = [body for body in scene.bodies if body.name in system.framed and body.name not in linear]
        self.poses: dict[str, list[tuple[Array, Array]]] = {body.name: [] for body in floating}
        self.bodies = floating

    def __call__(self, step: int) -> None:
        """Record the present state at a step to be recorded."""
        if step in self.steps:
            for name, kept in self.deformations.items():
                kept.append(self.system.deformation(name))
            for body in self.bodies:
                self.poses[body.name].append(self.frames.pose(body))

    def motion(self, time: Array) -> Motion:
        """Return the recorded motion; time: times of the recorded steps, (n,) [s]."""
        poses = {
            name: (np.array([place for place, _ in kept]), np.array([turn for _, turn in kept]))
            for name, kept in self.poses.items()
        }
        coordinates = {name: np.array(kept) for name, kept in self.deformations.items()}
        if loads := self.system.assembly.loads:
            coordinates = {name: loads.elastic(name, kept) for name, kept in coordinates.items()}
        return recorded_motion(self.system.assembly.scene, time, coordinates, poses)
