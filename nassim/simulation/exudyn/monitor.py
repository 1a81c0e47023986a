"""Monitor of a running Exudyn system: sizes of motion, preloads, speeds and divergence at its checks."""

from typing import Any

import exudyn as exu
import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.scene.bodies import FlexibleBody
from nassim.simulation.exudyn.frame_poses import FramePoses
from nassim.simulation.exudyn.running_system import System
from nassim.simulation.model.axial_preload import axial_forces_under
from nassim.simulation.model.motion_size import SMALL_MOTION
from nassim.simulation.model.reach import Reach
from nassim.simulation.model.runaway import RUNAWAY, deformed, farthest, too_far
from nassim.simulation.model.stopped_runs import ValidSamples
from nassim.simulation.model.ties import tied_bodies

DIVERGENCE = 1.0
"""Deformation over the body's size, or rotation by deformation [rad], above which a run diverges."""
DRIFT = 1e-2
"""Share of a body's fastest rotation by which its rotation may violate the constraint on its Euler parameters."""
TURNED = 0.1
"""Rotation [rad] of a body since the start of a run above which it is not rounding."""


class Monitor:
    """Extreme values and failures of a run at its checks.

    Attributes:
        shifts: largest relative motion of every two connected bodies, see `FramePoses.shifting`.
        speeds: largest angular speeds of floating bodies [rad/s].
        lost: bodies that are deformed beyond the limit of a run, or farther away than they can get, and a message for
            each.
        valid: samples until the first invalid one.
        drifting: the first body whose velocities violate the constraints, and the sample.
    """

    def __init__(self, system: System, reach: Reach | None = None) -> None:
        """Start with the system at its initial state.

        Args:
            system: the system.
            reach: bounds of the bodies' displacements; None without bounds.
        """
        scene = system.assembly.scene
        self.reach, self.valid = reach, ValidSamples()
        self.system, self.frames = system, FramePoses(system)
        self.threshold = RUNAWAY if scene.loops else DIVERGENCE
        self.names = list(system.flexible)
        self.sizes = np.zeros((len(self.names), 2))
        self.placed = [name for name in self.names if name not in system.framed]
        self.rows, self.constants, self.starts, self.places = self._gather()
        self.tensions = self._seen()[1].copy()
        self.states: dict[str, Array] = {}
        self.shifts = {pair: np.zeros(2) for pair in tied_bodies(scene) if set(pair) <= system.framed}
        self.shifting = self.frames.shifting(list(self.shifts))
        floating = [body.name for body in scene.of_fidelity("ffrf")]
        self.speeds = {name: 0.0 for name in floating if name in system.nodes}
        self.lost: list[tuple[str, str]] = []
        self.drifting: tuple[str, int] | None = None
        self.rotation = _RotationCheck(system)

    def _gather(self) -> tuple[Any, Array, Array, dict[str, slice]]:
        """Return the monitored quantities per unit of all of Exudyn's coordinates, sparse, for one product per check.

        Each body has its rotations and its displacements, with a row of zeros each so that none is empty. The axial
        forces of deforming bodies follow, then the first three coordinates of bodies without a frame's node, which
        are the displacement of their first point.

        Returns:
            The rows, the constant parts of the axial forces, the first row of each group of rotations or displacements
            and of the axial forces, (2 n + 1,), and the slice of each body among the axial forces.
        """
        system, bodies = self.system, {body.name: body for body in self.system.assembly.scene.bodies}
        size = system.mbs.systemData.ODE2Size()
        motions, tensions, constants = [np.zeros((0, size))], [np.zeros((0, size))], [np.zeros(0)]
        places, end = {}, 0
        displacements = np.zeros((3 * len(self.placed), size))
        for name in self.names:
            body, coordinates = bodies[name], system.flexible[name].coordinates @ system.selection(name)
            sizes = system.assembly.coordinates.size_rows[name]
            motions += [np.vstack([rows @ coordinates, np.zeros((1, size))]) for rows in sizes]
            if name in self.placed:
                first = 3 * self.placed.index(name)
                displacements[first : first + min(3, len(coordinates))] = coordinates[:3]
            if isinstance(body, FlexibleBody):
                rows, constant = axial_forces_under(system.assembly, body)
                tensions.append(rows @ coordinates)
                constants.append(constant)
                places[name] = slice(end, end + len(rows))
                end = places[name].stop
        starts = np.cumsum([len(rows) for rows in motions])
        rows = scipy.sparse.csr_array(np.vstack([*motions, *tensions, displacements]))
        return rows, np.concatenate(constants), starts, places

    def _seen(self) -> tuple[Array, Array, Array]:
        """Return present motions and axial forces, and displacements of bodies without a node, (placed, 3)."""
        values = self.rows @ self.system.mbs.systemData.GetODE2Coordinates()
        motions, tensions, displacements = np.split(values, [self.starts[-1], len(values) - 3 * len(self.placed)])
        return motions, tensions + self.constants, displacements.reshape(-1, 3)

    @property
    def largest(self) -> dict[str, Array]:
        """Largest size of motion of each body, see `motion_sizes`, (2,), by name."""
        return dict(zip(self.names, self.sizes, strict=True))

    @property
    def most_turned(self) -> dict[str, Array]:
        """Coordinates of each floating body by deformation, (n,), where its points had turned most, by name."""
        scene, flexible = self.system.assembly.scene, self.system.flexible
        floating = [body.name for body in scene.of_fidelity("ffrf") if body.name in self.states]
        return {name: flexible[name].coordinates @ self.system.selection(name) @ self.states[name] for name in floating}

    @property
    def slackest(self) -> dict[str, Array]:
        """Least `axial_forces` of each body that deforms, by name."""
        return {name: self.tensions[place] for name, place in self.places.items()}

    def look(self, sample: int) -> None:
        """Compare the present state, that of a sample, with the earlier ones."""
        sound, distances = True, dict[str, float]()
        if self.names:
            motions, tensions, displacements = self._seen()
            distances = dict(zip(self.placed, np.linalg.norm(displacements, axis=1).tolist(), strict=True))
            sizes = np.maximum.reduceat(np.abs(motions), self.starts[:-1]).reshape(-1, 2)
            beyond = np.flatnonzero(~np.all(sizes < self.threshold, axis=1))
            most = np.argsort(-np.nan_to_num(sizes[beyond].max(axis=1), nan=np.inf), kind="stable")
            self.lost += [(self.names[k], deformed(self.names[k])) for k in beyond[most]]
            sound = bool(np.all(sizes <= SMALL_MOTION))
            for k in np.flatnonzero(sizes[:, 0] > self.sizes[:, 0]):
                self.states[self.names[k]] = self.system.mbs.systemData.GetODE2Coordinates()
            np.maximum(self.sizes, sizes, out=self.sizes)
            np.minimum(self.tensions, tensions, out=self.tensions)
        if self.reach:
            allowed = self.reach.at(sample)
            far = {name: distances[name] if name in distances else self.frames.distance(name) for name in allowed}
            if name := farthest(far, allowed):
                self.lost.append((name, too_far(name, far[name], allowed[name])))
        if self.shifts:
            for pair, now in zip(self.shifts, self.shifting(), strict=True):
                self.shifts[pair] = np.maximum(self.shifts[pair], now)
        for name in self.speeds:
            self.speeds[name] = max(self.speeds[name], self.frames.speed(name))
        drifting = self.rotation.drifting()
        if drifting and not self.drifting:
            self.drifting = drifting, sample
        self.valid.check(sample, valid=sound and not self.lost and not self.drifting)

    def describe_drift(self, time_step: float, spectral_radius: float) -> str:
        """Describe velocities that violate the constraints; empty where there are none.

        Args:
            time_step: time step [s].
            spectral_radius: spectral radius of the rule [-].

        Returns:
            The message.
        """
        if not self.drifting:
            return ""
        name, sample = self.drifting
        turn = time_step * self.rotation.fastest_turn(name)
        bears = abs(float(np.log(spectral_radius))) if spectral_radius else np.inf
        return (
            f"body {name!r} has velocities that violate its constraints, from t = {sample * time_step:g} s on: it "
            f"turns by up to {turn:.2g} rad in a step, and a spectral_radius of "
            f"{spectral_radius:g} holds for {bears:.2g} rad; take a smaller time_step or a smaller spectral_radius"
        )


class _RotationCheck:
    """Check of bodies' velocities against the constraint on their Euler parameters, e e' = 0.

    Generalized-alpha enforces constraints on positions. At a spectral radius r, the velocities' violation by rounding
    changes sign and shrinks to r in a step, but grows by the angle [rad] by which the constraints rotate in a step: as
    the bodies do at joints, and half as far for Euler parameters alone. So a radius holds for rotations up to -ln(r).
    """

    def __init__(self, system: System) -> None:
        scene = system.assembly.scene
        linear = {body.name for body in scene.of_fidelity("linear")}
        self.data = system.mbs.systemData
        # One body of each node, which is its own where others share it.
        own = {node: name for name, node in reversed(system.nodes.items())}
        self.names = [name for node, name in reversed(own.items()) if name not in linear]
        firsts = [system.mbs.GetNodeODE2Index(system.nodes[name]) + 3 for name in self.names]
        self.places = np.reshape(firsts, (-1, 1)).astype(int) + np.arange(4)
        self.reference = self.data.GetODE2Coordinates(exu.ConfigurationType.Reference)
        self.start = (self.reference + self.data.GetODE2Coordinates())[self.places]
        self.fastest, self.turned = np.zeros(len(self.names)), np.zeros(len(self.names), dtype=bool)

    def fastest_turn(self, name: str) -> float:
        """Return the fastest angular speed of a body so far [rad/s]."""
        return 2 * float(self.fastest[self.names.index(name)])

    def drifting(self) -> str:
        """Return the name of a body that has rotated and whose velocities violate the constraint; empty without one."""
        if not self.names:
            return ""
        parameters = (self.reference + self.data.GetODE2Coordinates())[self.places]
        rates = self.data.GetODE2Coordinates_t()[self.places]
        self.fastest = np.maximum(self.fastest, np.linalg.norm(rates, axis=1))
        cosines = np.abs(np.sum(parameters * self.start, axis=1))
        self.turned |= ~(cosines > np.cos(TURNED / 2))
        apart = np.abs(np.sum(parameters * rates, axis=1))
        parted = self.turned & ~(apart <= DRIFT * self.fastest)
        return self.names[int(np.argmax(parted))] if parted.any() else ""
