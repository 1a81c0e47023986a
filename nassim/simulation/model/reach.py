"""Bounds of the bodies' displacements in a run, from the scene and its excitation.

Let p = sqrt(2 E), with E the energy of a scene. Forces f add at most f v to it per unit of time; joints, springs and
dampers add nothing. So p' <= |M^(-1/2) f|, and a body of mass m moves by at most the integral of p / sqrt(m). This also
holds in large motion, for forces and torques on the bodies moved as rigid bodies: weight, inputs, ground acceleration
and commands up to the limits of their converters. Drives move what they carry at their own speed, and can throw it at
that speed. Forces within a body move other bodies only by its deformation, which has bounds of its own.

A loop without a limit may add energy, but a stable loop does not move a body many times as far as its excitation alone
could, unless that distance is below the size of the scene. So a loop runs away when it moves a body farther than the
scene is large and `MARGIN` times as far as that bound.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_motions
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.terms import PrescribedMotion
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.initial_velocities import starting_energy
from nassim.simulation.model.motion_size import scene_size

MARGIN = 10.0
"""Factor on the displacement without loops above which a loop runs away."""


@dataclass(frozen=True)
class Reach:
    """Bounds of all moving bodies' displacements.

    Attributes:
        size: size of the scene [m].
        path: integral of p until each sample, (n_samples,) [m kg^(1/2)].
        masses: masses of the bodies, by name [kg].
    """

    size: float
    path: Array
    masses: Mapping[str, float]

    def at(self, sample: int) -> dict[str, float]:
        """Return the bounds of the bodies' displacements at a sample, by name [m]."""
        path = MARGIN * float(self.path[min(sample, len(self.path) - 1)])
        return {name: self.size + path / np.sqrt(mass) for name, mass in self.masses.items()}


def find_reach(assembly: Assembly, inputs: Array, time_step: float) -> Reach:
    """Compute the bounds of the bodies' displacements in a run.

    Args:
        assembly: the assembled scene.
        inputs: the excitation at all time steps, (inputs, n_samples).
        time_step: time step [s].

    Returns:
        The bounds.
    """
    return GrowingReach(assembly, time_step).after(inputs)


class GrowingReach:
    """Finds how far bodies can get, from one piece of a run to the next."""

    def __init__(self, assembly: Assembly, time_step: float) -> None:
        scene = assembly.scene
        bodies = [body for body in scene.bodies if body.moves]
        self._scene, self._time_step = scene, time_step
        self._masses = {body.name: body.rigid_inertia[0] for body in bodies}
        self._mass, self._size = float(np.sum([*self._masses.values()])), scene_size(scene)
        self._limits = np.zeros(len(scene.inputs))
        for loop in scene.loops:
            if np.isfinite(loop.controller.limit):
                self._limits[[scene.inputs.index(name) for name in loop.driven]] += loop.controller.limit
        self._strengths = _strengths(assembly, bodies)
        joints = scene.constraints
        self._drives = [
            (drive, 1.0 if joints[drive.constraint].measure.rotation_axis(drive.component) is None else self._size)
            for drive in scene.terms_of(PrescribedMotion)
        ]
        self._levers = {
            scene.inputs.index(name): {"m": 1.0, "rad": self._size}.get(unit, 0.0)
            for name, unit in scene.read_by_loops.items()
        }
        self._farthest = dict.fromkeys(self._levers, 0.0)
        self._momentum, self._speed, self._path = np.sqrt(2 * starting_energy(scene)), 0.0, 0.0

    def after(self, inputs: Array) -> Reach:
        """Return the bounds at the samples of a next piece of the run.

        Args:
            inputs: the excitation there, shape (inputs, n_samples).
        """
        scene, mass, size, time_step = self._scene, self._mass, self._size, self._time_step
        # A new mapping, because the states of a run that are saved share the old one.
        self._farthest = {
            k: max(self._farthest[k], lever * float(np.abs(inputs[k]).max(initial=0.0)))
            for k, lever in self._levers.items()
        }
        size += sum(self._farthest.values())
        forces = (np.abs(inputs) + self._limits[:, None]).T @ self._strengths
        forces = forces + np.sqrt(mass) * float(np.linalg.norm(scene.gravity))
        speeds = np.zeros(inputs.shape[1])
        for drive, lever in self._drives:
            speeds += lever * abs(drive.speed)
            if drive.input:
                k = scene.inputs.index(drive.input)
                if inputs.shape[1] > 1:
                    speeds += lever * np.abs(np.gradient(inputs[k], time_step))
                size += lever * float(self._limits[k])
        momentum = self._momentum + time_step * np.cumsum(forces)
        fastest = np.maximum(np.maximum.accumulate(speeds), self._speed)
        path = self._path + time_step * np.cumsum(momentum + np.sqrt(mass) * fastest)
        self._momentum, self._speed, self._path = float(momentum[-1]), float(fastest[-1]), float(path[-1])
        return Reach(size, path, self._masses)


def _strengths(assembly: Assembly, bodies: list[Body]) -> Array:
    """Return |M^(-1/2) f| of the bodies moved as rigid bodies per unit of each input, (inputs,)."""
    forces = assembly.signals.forces_at_rest
    squares = np.zeros(forces.shape[1])
    for body in bodies:
        rigid = np.eye(len(body.mass_matrix))
        if isinstance(body, FlexibleBody):
            points = body.reduced.positions - body.reduced.center_of_mass
            rigid = rigid_motions(points, len(body.mass_matrix))
        acting = rigid.T @ forces[assembly.coordinates.slices[body.name]]
        inverse = np.linalg.pinv(rigid.T @ body.mass_matrix @ rigid, rcond=1e-9, hermitian=True)
        squares += np.sum(acting * (inverse @ acting), axis=0)
    return np.sqrt(squares)
