"""Motion of the bodies of a scene, from which pictures of a run are made."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array, finite_array, freeze, known
from nassim.base.rigid_motion import proper_rotation
from nassim.base.short_repr import short_repr
from nassim.scene.bodies import FlexibleBody
from nassim.scene.scene import Scene

NOT_ORTHOGONAL = 1e-6
"""Largest entry of R^T R - I that rounding may leave in a rotation matrix."""


@dataclass(frozen=True)
class Motion:
    """Motion of the bodies of a scene at n times.

    A point x of a reduced body's surface is at position + rotation @ (x + surface_modes @ coordinates). In small motion
    a reduced body's frame stays at its place and the coordinates hold all of the motion; in large motion the frame
    moves.

    Attributes:
        time: ascending times, (n,) [s].
        positions: positions of the origins of the bodies' own frames (of a rigid body, the centre of mass) in the
            world, by name, (n, 3) [m].
        rotations: rotations from the bodies' axes to the world's, by name, (n, 3, 3).
        coordinates: coordinates of the reduced bodies that strain them, by name, (n, n_coordinates), as of
            `FlexibleBody.reduced`; a body without an entry does not deform.
        voltages: voltages of electrical ports that stress a body, by name of the body and of the port, (n,) [V]; ports
            without an entry have an unknown voltage.

    Raises:
        ValueError: for times that do not rise, for bodies without both position and rotation, for arrays of other
            lengths and for matrices that are no rotations.
    """

    time: Array
    positions: Mapping[str, Array]
    rotations: Mapping[str, Array]
    coordinates: Mapping[str, Array]
    voltages: Mapping[str, Mapping[str, Array]] = field(default_factory=dict)
    __repr__ = short_repr

    def __post_init__(self) -> None:
        time = finite_array("time", self.time, (None,))
        n = len(time)
        if not n or np.any(np.diff(time) <= 0):
            raise ValueError(f"a motion needs times that rise, got {n} from {time.min(initial=0):g} s on")
        if self.positions.keys() != self.rotations.keys():
            odd = ", ".join(sorted(self.positions.keys() ^ self.rotations.keys()))
            raise ValueError(f"each body needs positions and rotations; only one of them is given for {odd}")
        positions = {k: finite_array(f"positions of {k!r}", v, (n, 3)) for k, v in self.positions.items()}
        rotations = {
            k: proper_rotation(f"rotations of {k!r}", v, (n, 3, 3), tolerance=NOT_ORTHOGONAL)
            for k, v in self.rotations.items()
        }
        coordinates = {k: finite_array(f"coordinates of {k!r}", v, (n, None)) for k, v in self.coordinates.items()}
        voltages = {
            body: {k: finite_array(f"voltages of '{body}.{k}'", v, (n,)) for k, v in ports.items()}
            for body, ports in self.voltages.items()
        }
        for name in (*coordinates, *voltages):
            known("body", name, positions)
        freeze(
            self,
            time=time,
            positions=positions,
            rotations=rotations,
            coordinates=coordinates,
            voltages=voltages,
        )

    def select(self, bodies: Sequence[str]) -> "Motion":
        """Return the motion of the named bodies.

        Raises:
            ValueError: for an unknown body.
        """
        names = [known("body", name, self.positions) for name in bodies]
        poses, turns, coordinates = (
            {name: values[name] for name in names if name in values}
            for values in (self.positions, self.rotations, self.coordinates)
        )
        voltages = {name: self.voltages[name] for name in names if name in self.voltages}
        return Motion(self.time, poses, turns, coordinates, voltages)

    def at(self, kept: NDArray[np.int64]) -> "Motion":
        """Return the motion at some of its times, given by their ascending numbers, (m,)."""
        poses, turns, coordinates = (
            {name: values[kept] for name, values in given.items()}
            for given in (self.positions, self.rotations, self.coordinates)
        )
        voltages = {body: {port: volts[kept] for port, volts in ports.items()} for body, ports in self.voltages.items()}
        return Motion(self.time[kept], poses, turns, coordinates, voltages)


def seen_from(scene: Scene, motion: Motion, body: str) -> Motion:
    """Transform a motion to a body's frame, as an observer on the rotating body sees it.

    Args:
        scene: the scene.
        motion: the motion in the world.
        body: name of the body, which stays in its reference configuration.

    Returns:
        The relative motion of all bodies.

    Raises:
        ValueError: for a body that the scene or its motion does not have.
    """
    reference = scene.body(body)
    known("body of the motion", body, motion.positions)
    back = reference.rotation @ motion.rotations[body].transpose(0, 2, 1)
    moved = {name: places - motion.positions[body] for name, places in motion.positions.items()}
    places = {name: reference.position + np.einsum("nij,nj->ni", back, moved[name]) for name in moved}
    rotations = {name: back @ matrices for name, matrices in motion.rotations.items()}
    return replace(motion, positions=places, rotations=rotations)


def point_motion(scene: Scene, motion: Motion, path: str) -> tuple[Array, Array]:
    """Compute position and rotation of a point "body.point" of a scene over time.

    A point of a reduced body rotates by the body's rotation and by the small rotation of its deformation.

    Args:
        scene: the scene.
        motion: motion of its bodies at n times.
        path: the point, "body.point".

    Returns:
        Positions, (n, 3) [m], and rotation matrices of the body's axes at the point, (n, 3, 3).

    Raises:
        ValueError: for an unknown point and for a point of a body that the motion leaves out.
    """
    body, point = scene.split(path)
    known("body of the motion", body.name, motion.positions)
    place, rotations = motion.positions[body.name], motion.rotations[body.name]
    if not isinstance(body, FlexibleBody):
        arm = body.rotation.T @ (body.point_position(point) - body.position)
        return place + rotations @ arm, rotations
    rows = body.reduced.motion(point)
    shifts = motion.coordinates.get(body.name, np.zeros((len(motion.time), rows.shape[1]))) @ rows.T
    arms = body.reduced.point(point).position + shifts[:, :3]
    return place + np.einsum("nij,nj->ni", rotations, arms), rotations @ Rotation.from_rotvec(shifts[:, 3:]).as_matrix()
