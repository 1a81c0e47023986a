"""Steady rotation of a rotor: known functions of its angle that act on small motion, and where the bodies are."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array, finite_array, freeze
from nassim.scene.bodies import FlexibleBody
from nassim.scene.scene import Scene


@dataclass(frozen=True)
class SteadyRotation:
    """Constant rotation of a rotor against its stator, and its effect on small motion.

    Small motion is described in the frame of the rotor or of the stator. Beside the inputs, four known functions of
    time act: one, cosine and sine of the rotor's angle, and the angle itself.

    Attributes:
        velocity: angular velocity of the rotor, (3,) [rad/s].
        point: a point of the axis, (3,) [m].
        rotor: names of the bodies of the rotor.
        frame: "rotor" or "stator".
        force: forces on the modal amplitudes per cosine and sine of the angle, (n, 2).
        readings: readings of the rotation itself by the outputs, constant and per radian of the angle, (outputs, 2).
        released: rates of the modal amplitudes at the start of a scene that is released, (n,).
    """

    velocity: Array
    point: Array
    rotor: frozenset[str]
    frame: str
    force: Array
    readings: Array
    released: Array

    def __post_init__(self) -> None:
        freeze(
            self,
            velocity=finite_array("angular velocity", self.velocity, (3,)),
            point=finite_array("point of the axis", self.point, (3,)),
            force=finite_array("forces that rotate", self.force, (None, 2)),
            readings=finite_array("readings of the rotation", self.readings, (None, 2)),
            released=finite_array("rates at the start", self.released, (len(self.force),)),
        )

    @property
    def rate(self) -> float:
        """Angular speed [rad/s]."""
        return float(np.linalg.norm(self.velocity))

    @property
    def known(self) -> tuple[Array, Array]:
        """Generator S (4, 4) and start (4,) of the known functions z, which obey z' = S z."""
        generator = np.zeros((4, 4))
        generator[1, 2], generator[2, 1], generator[3, 0] = -self.rate, self.rate, self.rate
        return generator, np.array([1.0, 1.0, 0.0, 0.0])

    def poses(self, scene: Scene, time: Array, coordinates: Mapping[str, Array]) -> dict[str, tuple[Array, Array]]:
        """Find the poses of the bodies' own frames.

        Args:
            scene: the scene as modelled.
            time: times, (n,) [s].
            coordinates: small motion of the bodies in the describing frame, by name, (n, n_own) each; that of flexible
                bodies is not in the poses.

        Returns:
            Positions (n, 3) [m] and rotations to the world's axes (n, 3, 3), by name of the body.
        """
        turned = Rotation.from_rotvec(np.outer(time, self.velocity)).as_matrix()
        still = np.broadcast_to(np.eye(3), turned.shape)
        view = turned if self.frame == "rotor" else still
        turns = {body.name: turned if body.name in self.rotor else still for body in scene.bodies}
        return turned_poses(scene, self.point, turns, dict.fromkeys(turns, view), coordinates)


def turned_poses(
    scene: Scene,
    point: Array,
    turns: Mapping[str, Array],
    views: Mapping[str, Array],
    coordinates: Mapping[str, Array],
) -> dict[str, tuple[Array, Array]]:
    """Find the poses of bodies that turn about a point.

    Args:
        scene: the scene as modelled.
        point: the point, (3,) [m].
        turns: rotations of the bodies, by name, (n, 3, 3).
        views: rotations of the axes along which the small motion of each body is, by name, (n, 3, 3).
        coordinates: small motion, by name, (n, n_own) each; that of flexible bodies is not in the poses.

    Returns:
        Positions (n, 3) [m] and rotations to the world's axes (n, 3, 3), by name of the body.
    """
    result = {}
    for body in scene.bodies:
        turn, own = turns[body.name], coordinates.get(body.name)
        place, rotation = point + turn @ (body.position - point), turn @ body.rotation
        if own is not None and not isinstance(body, FlexibleBody):
            motion = (views[body.name] @ own.reshape(-1, 2, 3).swapaxes(1, 2)).swapaxes(1, 2)
            place = place + motion[:, 0]
            rotation = Rotation.from_rotvec(motion[:, 1]).as_matrix() @ rotation
        result[body.name] = place, rotation
    return result
