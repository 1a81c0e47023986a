"""What is seen of a running Exudyn system whenever it is looked at."""

from typing import Any

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.scene.bodies import FlexibleBody
from nassim.simulation.buckling import axial_rows
from nassim.simulation.damping import tied_bodies
from nassim.simulation.exudyn.state import System
from nassim.simulation.running_loops import RUNAWAY
from nassim.simulation.small_motion import motion_rows

LOST = 1.0
"""A deformation of this share of the body's size, or this rotation [rad] by deformation, means that a run diverges."""


class Watch:
    """What is seen of a run whenever it is looked at.

    shifts: of every two bodies tied together, as `System.shifting` tells; speeds: of floating bodies [rad/s]
    lost: bodies that are deformed beyond what a run may do
    """

    def __init__(self, system: System) -> None:
        scene = system.assembly.scene
        self.system = system
        self.threshold = RUNAWAY if scene.loops else LOST
        self.names = list(system.carriers)
        self.sizes = np.zeros((len(self.names), 2))
        self.rows, self.starts, self.places = self._gather()
        self.tensions = self._seen()[self.starts[-1] :]
        self.shifts = {pair: np.zeros(2) for pair in tied_bodies(scene) if set(pair) <= set(system.nodes)}
        self.shifting = system.shifting(list(self.shifts))
        self.speeds = {body.name: 0.0 for body in scene.flexible_bodies if body.fidelity == "ffrf" and system.nodes}
        self.lost: list[str] = []

    def _gather(self) -> tuple[Any, Array, dict[str, slice]]:
        """What is seen per unit of all of Exudyn's coordinates, sparse: one product, no calls for each body.

        First, by body, the rotations and the displacements, each with a row of zeros so that there is one, then the
        axial forces of bodies that deform. Beside it where each of the former begins, and the latter do, (2 n + 1,),
        and where among these each body has its own.
        """
        system, bodies = self.system, {body.name: body for body in self.system.assembly.scene.bodies}
        size = system.mbs.systemData.ODE2Size()
        motions, tensions, places, end = [np.zeros((0, size))], [np.zeros((0, size))], {}, 0
        for name in self.names:
            body, carried = bodies[name], system.carriers[name].coordinates @ system.taken(name)
            motions += [np.vstack([rows @ carried, np.zeros((1, size))]) for rows in motion_rows(system.assembly, name)]
            if isinstance(body, FlexibleBody):
                tensions.append(axial_rows(body.reduced) @ carried)
                places[name] = slice(end, end + len(tensions[-1]))
                end = places[name].stop
        starts = np.cumsum([len(rows) for rows in motions])
        return scipy.sparse.csr_array(np.vstack([*motions, *tensions])), starts, places

    def _seen(self) -> Array:
        result: Array = self.rows @ self.system.mbs.systemData.GetODE2Coordinates()
        return result

    @property
    def largest(self) -> dict[str, Array]:
        """Largest `motion_size` of each body, (2,)."""
        return dict(zip(self.names, self.sizes, strict=True))

    @property
    def slackest(self) -> dict[str, Array]:
        """Least `axial_forces` of each body that deforms."""
        return {name: self.tensions[place] for name, place in self.places.items()}

    def look(self) -> None:
        """Compare the present state with the earlier ones."""
        system = self.system
        if self.names:
            seen, end = self._seen(), self.starts[-1]
            sizes = np.maximum.reduceat(np.abs(seen[:end]), self.starts[:-1]).reshape(-1, 2)
            self.lost += [self.names[k] for k in np.flatnonzero(~np.all(sizes < self.threshold, axis=1))]
            np.maximum(self.sizes, sizes, out=self.sizes)
            np.minimum(self.tensions, seen[end:], out=self.tensions)
        if self.shifts:
            for pair, now in zip(self.shifts, self.shifting(), strict=True):
                self.shifts[pair] = np.maximum(self.shifts[pair], now)
        for name in self.speeds:
            self.speeds[name] = max(self.speeds[name], system.speed(name))
