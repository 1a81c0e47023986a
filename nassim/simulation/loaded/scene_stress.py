"""Geometric stiffness of the body that a scene becomes, by unit cases on its bodies, joints and springs.

The cases are those of `nassim.bodies.stress_stiffness`: unit motions of the retained points, body forces and voltages
with these points held. In each of them the bodies have their stress, and joints and springs the forces that they bear.
The coordinates of a deformable body are the displacements of its points. Forces at these points keep their direction,
so the stiffness of its stress is the whole. A rigid body carries its other points on circles, which forces on them
feel.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from nassim.base.checks import Array
from nassim.bodies.stress_stiffness import BODY_FORCES, GeometricTerms, StressStiffness
from nassim.scene.bodies import FlexibleBody
from nassim.scene.field_kinds import body_of
from nassim.simulation.loaded.body_stress import InnerForces, stress_of_bodies
from nassim.simulation.loaded.geometric_stiffness import GeometricStiffness, spring_forces, stiffness_of_point
from nassim.simulation.loaded.spinning import body_force_terms, integrals
from nassim.simulation.model.assembly import Assembly

Voltages = Mapping[str, Mapping[str, float]]


def scene_stress(
    assembly: Assembly, change: Array, stiffness: Array, points: Sequence[str], ports: Mapping[str, tuple[str, str]]
) -> StressStiffness | None:
    """Compute the geometric stiffness of a scene in the coordinates of one body.

    Args:
        assembly: the assembled scene, without loads.
        change: all coordinates per unit of the n new ones, (n_all, n): motions of the points along the axes of the
            scene, then amplitudes of modes with the points held.
        stiffness: stiffness of the new coordinates, (n, n), without coupling between points and modes.
        points: paths of the r retained points.
        ports: body and port of each electrical port, by its new name.

    Returns:
        The geometric stiffness; None where a body does not hold its own.
    """
    bodies = {body.name: body for body in assembly.scene.deformable_bodies}
    if any(body.reduced.stress_stiffness is None for body in bodies.values()):
        return None
    cases = _Cases(assembly, change, stiffness, tuple(points))
    found = [*cases.of_points(), *cases.of_body_forces(), *cases.of_voltages(ports.values())]
    rows = np.eye(len(found), change.shape[1]) * (np.arange(len(found)) < 6 * len(points))[:, None]
    stress, shape = (np.array([getattr(one, part) for one in found]) for part in ("stress", "shape"))
    blocked = np.zeros((len(ports), *2 * [change.shape[1]]))
    for k, (name, port) in enumerate(ports.values()):
        own = bodies[name].reduced.stress_stiffness
        assert own is not None
        part = change[assembly.coordinates.slices[name]]
        blocked[k] = part.T @ own.of_voltages({port: 1.0}) @ part
    return StressStiffness(rows, stress, shape, tuple(ports), blocked)


@dataclass(frozen=True)
class _Cases:
    """Unit cases of a scene's geometric stiffness; attributes are arguments of `scene_stress`."""

    assembly: Assembly
    change: Array
    stiffness: Array
    points: tuple[str, ...]

    def of_points(self) -> list[GeometricTerms]:
        """Compute the terms of unit motions of the points."""
        unloaded, r = np.zeros(len(self.change)), 6 * len(self.points)
        return [self.terms(self.change[:, k], unloaded, self.stiffness[:r, k]) for k in range(r)]

    def of_body_forces(self) -> Iterator[GeometricTerms]:
        """Compute the terms of body forces, see `body_force_terms`, along the scene's axes with the points held."""
        for k in range(BODY_FORCES):
            whole, fields, force = np.zeros((3, 4)), {}, np.zeros(len(self.change))
            whole[k % 3, k // 3] = 1.0
            for name, place in self.assembly.coordinates.slices.items():
                body = self.assembly.scene.body(name)
                rotation, origin, _ = integrals(body)
                fields[name] = rotation.T @ whole @ np.block([[1.0, np.zeros((1, 3))], [origin[:, None], rotation]])
                force[place] = body_force_terms(body, self.geometric.frames[name], place, fields[name])[0]
            yield self._with_points_held(force, fields)

    def of_voltages(self, ports: Iterable[tuple[str, str]]) -> Iterator[GeometricTerms]:
        """Compute the terms of unit voltages at ports, by body and port, with the points held."""
        for name, port in ports:
            body, force = self.assembly.scene.body(name), np.zeros(len(self.change))
            assert isinstance(body, FlexibleBody)
            force[self.assembly.coordinates.slices[name]] = body.reduced.port(port).forces
            yield self._with_points_held(force, voltages={name: {port: 1.0}})

    def _with_points_held(
        self, force: Array, fields: Mapping[str, Array] | None = None, voltages: Voltages | None = None
    ) -> GeometricTerms:
        """Compute the terms of forces, (n_all,), while other forces hold the points; others as of `terms`."""
        r = 6 * len(self.points)
        moved = self.change[:, r:] @ (self.change[:, r:].T @ force / np.diag(self.stiffness)[r:])
        return self.terms(moved, force, -self.change[:, :r].T @ force, fields, voltages)

    @cached_property
    def geometric(self) -> GeometricStiffness:
        """Geometric stiffness of joints and springs; deformable bodies have displacements of points as coordinates."""
        whole = GeometricStiffness.of(self.assembly)
        deformable = {body.name for body in self.assembly.scene.deformable_bodies}
        frames = {
            name: replace(frame, motion=0 * frame.motion) if name in deformable else frame
            for name, frame in whole.frames.items()
        }
        return replace(whole, frames=frames)

    def terms(
        self,
        moved: Array,
        force: Array,
        held: Array,
        fields: Mapping[str, Array] | None = None,
        voltages: Voltages | None = None,
    ) -> GeometricTerms:
        """Compute the stiffness of one case in the n new coordinates.

        Args:
            moved: displacement in all coordinates, (n_all,).
            force: forces on them, (n_all,).
            held: forces and torques that hold the points, (6 r,).
            fields: body force of each body, see `body_force_terms`, by name.
            voltages: voltages at electrical ports, by body and port [V].
        """
        assembly, coordinates, geometric = self.assembly, self.assembly.coordinates, self.geometric
        fields = fields or dict.fromkeys(coordinates.slices, np.zeros((3, 4)))
        total, shape = geometric.of_springs(moved), np.zeros((coordinates.size,) * 2)
        borne = force - spring_forces(assembly.tangents, moved)
        for path, wrench in zip(self.points, held.reshape(-1, 6), strict=True):
            motion, frame = coordinates.motion(path), geometric.frames[body_of(path)]
            borne += motion.T @ wrench
            arm = assembly.scene.point_position(path) - frame.position
            total += stiffness_of_point(frame.motion, motion, arm, -wrench)
        inside = stress_of_bodies(assembly, moved, fields, InnerForces(voltages or {}))
        for name, place in coordinates.slices.items():
            body = assembly.scene.body(name)
            total[place, place] += body_force_terms(body, geometric.frames[name], place, fields[name])[1]
            if name in inside:
                assert body.strain is not None
                borne[place] -= body.strain.root.T @ (body.strain.root @ moved[place])
                total[place, place] += inside[name].stress
                shape[place, place] = inside[name].shape
        total += geometric.of_joints(borne)
        return GeometricTerms(
            self.change.T @ (0.5 * (total + total.T)) @ self.change, self.change.T @ shape @ self.change
        )
