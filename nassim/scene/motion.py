"""How the bodies of a scene moved: what pictures of a run are drawn from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array, finite_array, freeze, frozen_mapping, known
from nassim.scene.bodies import FlexibleBody
from nassim.scene.scene import Scene

TURNED = 1e-6
"""Largest entry of R^T R less one that rounding may leave in a rotation matrix."""


@dataclass(frozen=True)
class Motion:
    """The bodies of a scene at n times.

    time: ascending, shape (n,) [s]
    positions, rotations: of the bodies' own frames, by name: the place of the origin, of a rigid body's centre of mass,
        in the world, (n, 3) [m], and from the body's axes to the world's, (n, 3, 3)
    coordinates: of the reduced bodies, by name, (n, n_coordinates), on the coordinates of `FlexibleBody.reduced`;
        one without does not deform

    A point x of a reduced body's surface is at position + rotation @ (x + surface_modes @ coordinates). In small motion
    a reduced body's frame stays and the coordinates hold all of the motion; in large motion it goes along.

    Raises ValueError for times that do not rise, for bodies without both position and rotation, for arrays of other
    lengths and for matrices that are no rotations.
    """

    time: Array
    positions: Mapping[str, Array]
    rotations: Mapping[str, Array]
    coordinates: Mapping[str, Array]

    def __post_init__(self) -> None:
        time = finite_array("time", self.time, (None,))
        n = len(time)
        if not n or np.any(np.diff(time) <= 0):
            raise ValueError(f"a motion needs times that rise, got {n} from {time.min(initial=0):g} s on")
        if self.positions.keys() != self.rotations.keys():
            odd = ", ".join(sorted(self.positions.keys() ^ self.rotations.keys()))
            raise ValueError(f"each body needs positions and rotations; only one of them is given of: {odd}")
        positions = {k: finite_array(f"positions of {k!r}", v, (n, 3)) for k, v in self.positions.items()}
        rotations = {k: finite_array(f"rotations of {k!r}", v, (n, 3, 3)) for k, v in self.rotations.items()}
        coordinates = {k: finite_array(f"coordinates of {k!r}", v, (n, None)) for k, v in self.coordinates.items()}
        for name in coordinates:
            known("body", name, positions)
        for name, turns in rotations.items():
            off = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max()
            if off > TURNED or np.linalg.det(turns).min() < 0:
                raise ValueError(f"rotations of {name!r} must be proper orthogonal matrices")
        freeze(
            self,
            time=time,
            positions=frozen_mapping(positions),
            rotations=frozen_mapping(rotations),
            coordinates=frozen_mapping(coordinates),
        )

    def select(self, bodies: Sequence[str]) -> "Motion":
        """Return the named bodies' motion as one of its own; raises ValueError for an unknown one."""
        names = [known("body", name, self.positions) for name in bodies]
        fields = self.positions, self.rotations, self.coordinates
        return Motion(self.time, *({name: field[name] for name in names if name in field} for field in fields))


def seen_from(scene: Scene, motion: Motion, body: str) -> Motion:
    """The motion against a body's frame, which stays as it is drawn: of what turns, as seen by who turns along.

    Raises ValueError for a body that the scene or its motion does not have.
    """
    drawn, _ = scene.split(f"{body}.")
    known("body of the motion", body, motion.positions)
    back = drawn.rotation @ motion.rotations[body].transpose(0, 2, 1)
    moved = {name: places - motion.positions[body] for name, places in motion.positions.items()}
    places = {name: drawn.position + np.einsum("nij,nj->ni", back, moved[name]) for name in moved}
    return replace(motion, positions=places, rotations={name: back @ turns for name, turns in motion.rotations.items()})


def point_motion(scene: Scene, motion: Motion, path: str) -> tuple[Array, Array]:
    """Where a point "body.point" of a scene was, (n, 3) [m], and how its axes stood, the body's at rest, (n, 3, 3).

    A point of a reduced body turns by the body's rotation and the small rotation of its deformation. Raises ValueError
    for an unknown point and for one of a body that the motion leaves out.
    """
    body, point = scene.split(path)
    known("body of the motion", body.name, motion.positions)
    place, turns = motion.positions[body.name], motion.rotations[body.name]
    if not isinstance(body, FlexibleBody):
        arm = body.rotation.T @ (body.point_position(point) - body.position)
        return place + turns @ arm, turns
    rows = body.reduced.motion(point)
    shifts = motion.coordinates.get(body.name, np.zeros((len(motion.time), rows.shape[1]))) @ rows.T
    arms = body.reduced.point(point).position + shifts[:, :3]
    return place + np.einsum("nij,nj->ni", turns, arms), turns @ Rotation.from_rotvec(shifts[:, 3:]).as_matrix()
