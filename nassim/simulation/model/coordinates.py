"""Coordinates of a scene: all coordinates of its moving bodies, and measures on them."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.bodies.floating_frames import FloatingFrame, floating_frame
from nassim.scene.bodies import Body, FlexibleBody, RigidBody
from nassim.scene.measures import Measure
from nassim.scene.scene import Scene
from nassim.scene.terms import BaseAcceleration
from nassim.simulation.model.states import ReferenceState, SceneState


@dataclass(frozen=True)
class Coordinates:
    """All coordinates of a scene's moving bodies in the reference configuration, and measures on them.

    Attributes:
        scene: the scene.
        slices: slice of each moving body's coordinates among all, by name (flexible: motions of the remote points and
            modes, in the body's frame; rigid: motion of the centre of mass in the world's frame).
        mass: mass matrix of all coordinates, (n_all, n_all).
    """

    scene: Scene
    slices: dict[str, slice]
    mass: Array

    @classmethod
    def of(cls, scene: Scene) -> "Coordinates":
        """Number the coordinates of a scene."""
        bodies = [body for body in scene.bodies if body.moves]
        blocks = [body.mass_matrix for body in bodies]
        ends = np.cumsum([0, *map(len, blocks)])
        places = {body.name: slice(ends[k], ends[k + 1]) for k, body in enumerate(bodies)}
        return cls(scene, places, scipy.linalg.block_diag(*blocks))

    @property
    def size(self) -> int:
        """Number n_all of all coordinates."""
        return len(self.mass)

    @cached_property
    def scale(self) -> Array:
        """Square roots of the masses of all coordinates, (n_all,)."""
        return np.sqrt(np.diag(self.mass))

    @cached_property
    def frames(self) -> dict[str, FloatingFrame]:
        """Floating frame of each flexible body, by name."""
        return {
            body.name: floating_frame(body.reduced, self.scene.frame_point(body)) for body in self.scene.flexible_bodies
        }

    @cached_property
    def size_rows(self) -> dict[str, tuple[Array, Array]]:
        """Rotations of each moving body's points [rad] and their displacements by deformation over its size [-].

        They are rows on the body's coordinates, (k, n) each, by name.
        """
        return {name: self._size_rows(self.scene.body(name)) for name in self.slices}

    @cached_property
    def stacked_size_rows(self) -> tuple[Any, Array]:
        """`size_rows` of all bodies on all coordinates, sparse, for one product at each check of a run.

        A row of zeros ends the rotations and the displacements of each body, so that none are empty.

        Returns:
            The rows, and the first row of each body's rotations and of its displacements, (2 bodies,).
        """
        parts = [np.pad(rows, ((0, 1), (0, 0))) for both in self.size_rows.values() for rows in both]
        stacks = [np.vstack(parts[k : k + 2]) for k in range(0, len(parts), 2)]
        starts = np.cumsum([0, *map(len, parts)])[:-1]
        return scipy.sparse.csr_array(scipy.linalg.block_diag(*stacks)), starts

    def _size_rows(self, body: Body) -> tuple[Array, Array]:
        if isinstance(body, RigidBody):
            return np.eye(6)[3:], np.zeros((0, 6))
        n = len(body.mass_matrix)
        if not isinstance(body, FlexibleBody):
            return np.vstack([body.motion(point)[3:] for point in body.point_names]), np.zeros((0, n))
        points = np.arange(6 * len(body.reduced.remote_points)).reshape(-1, 6)
        rotations, displacements = points[:, 3:], points[:-1, :3]
        middle = body.reduced.gram[1:4, 1:4] / body.reduced.mass - np.outer(*[body.reduced.center_of_mass] * 2)
        deformation = self.frames[body.name].deformation(body.reduced)[displacements.ravel()]
        return np.eye(n)[rotations.ravel()], deformation / np.sqrt(np.trace(middle))

    @property
    def reference(self) -> "Coordinates":
        """These coordinates in the reference configuration."""
        return self

    @cached_property
    def states(self) -> dict[str, SceneState]:
        """States of all bodies in the reference configuration, by name."""
        return {body.name: ReferenceState(body) for body in self.scene.bodies}

    def of_body(self, name: str) -> Array:
        """Select the coordinates of one body, (n, n_all)."""
        return np.eye(self.size)[self.slices[name]]

    def jacobian(self, measure: Measure, states: Mapping[str, SceneState] | None = None) -> Array:
        """Evaluate a measure's rows on all coordinates.

        Args:
            measure: the measure, of k components.
            states: states of the bodies, by name; default: the reference configuration.

        Returns:
            The rows, (k, n_all).
        """
        if states is not None:
            return self._rows(measure, states)
        if id(measure) not in self._known_rows:
            self._known_rows[id(measure)] = measure, self._rows(measure, self.states)
        return self._known_rows[id(measure)][1].copy()

    @cached_property
    def _known_rows(self) -> dict[int, tuple[Measure, Array]]:
        """Rows of measures by the measure's identity; the measure is kept too, so that no other gets its identity."""
        return {}

    def _rows(self, measure: Measure, states: Mapping[str, SceneState]) -> Array:
        _, parts = measure.evaluate(states)
        result = np.zeros((len(measure.components), self.size))
        for name, rows in parts.items():
            if name in self.slices:
                result[:, self.slices[name]] = rows
        return result

    def motion(self, path: str) -> Array:
        """Return the small motion of a point in the world's frame, (6, n_all)."""
        body, point = self.scene.split(path)
        rows = np.zeros((6, self.size))
        if body.moves:
            rows[:, self.slices[body.name]] = body.motion(point)
        return rows

    def weight(self, gravity: Array, states: Mapping[str, SceneState] | None = None) -> Array:
        """Return the forces of a uniform gravity, world frame, (3,) [m/s2], on all coordinates, (n_all,)."""
        result = np.zeros(self.size)
        for name, place in self.slices.items():
            result[place] = (states or self.states)[name].weight(gravity)
        return result

    def base_direction(self, term: BaseAcceleration, states: Mapping[str, SceneState] | None = None) -> Array:
        """Return the acceleration of the base per unit of the input, world axes, (3,); states as `jacobian`."""
        direction = np.asarray(term.direction)
        if term.axes_of:
            body, point = self.scene.split(term.axes_of)
            direction = (states or self.states)[body.name].pose(point)[1] @ direction
        return direction

    def of_base(self, term: BaseAcceleration, states: Mapping[str, SceneState] | None = None) -> Array:
        """Return the forces of a unit acceleration of the base on all coordinates, (n_all,); states as `jacobian`."""
        return self.weight(-self.base_direction(term, states), states)
