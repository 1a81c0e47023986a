"""Springs and dampers of a scene as Exudyn's connectors: within bodies, along lines and directions, in all six at once.

Exudyn's spring along directions that turn has two traps. Along the axes of its first marker it acts on either body at
its own marker, so that a displacement upsets the balance of moments; its intrinsic formulation acts on both in the
middle, along axes halfway. And in both the dampers take the difference of two velocities for the rate at which a
displacement grows, so that they brake common turns. Functions of Python put that right where both bodies move.
"""

from collections.abc import Callable
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.scene.part import Line, Row, SixSprings, Spring
from nassim.scene.scene import Scene
from nassim.simulation.exudyn.items import Items, on_coordinates

Wrench = Callable[..., Array]
LOCAL = exu.OutputVariableType.AngularVelocityLocal


def reaches(scene: Scene) -> list[tuple[str, Array]]:
    """Points that carry springs in the place of other points, and these places, world frame at the start."""
    found = [(word.a, scene.point_position(word.b)) for word in scene.said(SixSprings)]
    for word in scene.said(Spring):
        if isinstance(word.row, Row) and "." in word.row.frame:
            found += [(word.row.frame, scene.point_position(path)) for path, _ in word.row.points]
    return found


def add_spring(items: Items, word: Spring) -> None:
    """Add a spring-damper, relaxed at the start: within bodies, along a line, or along a direction."""
    nodes = on_coordinates(items, word.row) if word.row.within else []
    if nodes:
        row = np.concatenate([piece for _, piece in nodes])
        items.mbs.AddObject(
            eii.ObjectGenericODE2(
                nodeNumbers=[node for node, _ in nodes],
                massMatrix=np.zeros((0, 0)),
                stiffnessMatrix=word.stiffness * np.outer(row, row),
                dampingMatrix=word.damping * np.outer(row, row),
                forceVector=np.zeros(len(row)),
            )
        )
    elif isinstance(word.row, Line):
        a, b = word.row.paths
        length = float(np.linalg.norm(items.scene.point_position(b) - items.scene.point_position(a)))
        items.mbs.AddObject(
            eii.ObjectConnectorSpringDamper(
                markerNumbers=[items.marker(a), items.marker(b)],
                referenceLength=length,
                stiffness=word.stiffness,
                damping=word.damping,
            )
        )
    elif not word.row.within:
        _add_along(items, word, word.row)


def _add_along(items: Items, word: Spring, row: Row) -> None:
    """A spring between two points along a direction of the world, or of one of the points."""
    (a, along_a), (b, along_b) = row.points
    if np.any(along_b[3:]) or np.any(along_a + along_b):
        raise ValueError(f"between {a!r} and {b!r}: in large motion a spring acts on the distance along a direction")
    along = along_b[:3]
    if not row.frame and np.count_nonzero(along) == 1:
        items.mbs.AddObject(
            eii.ObjectConnectorCartesianSpringDamper(
                markerNumbers=[items.marker(a), items.marker(b)],
                stiffness=list(word.stiffness * along**2),
                damping=list(word.damping * along**2),
                offset=list(items.scene.point_position(b) - items.scene.point_position(a)),
            )
        )
        return
    frame = row.frame or next((path for path in (a, b) if not items.moves(path)), "")
    if frame not in (a, b):
        raise ValueError(
            f"between {a!r} and {b!r}: in large motion a spring acts along one of the world's axes, or along any "
            "direction of one of its points (frame=...), or of the ground that one of them belongs to"
        )
    other = b if frame == a else a
    markers = items.marker(frame, at=items.scene.point_position(other)), items.marker(other)
    if items.moves(frame):
        pull = _pull_along(markers[0], along, word.stiffness, word.damping)
        _connect(items, markers, useIntrinsicFormulation=True, springForceTorqueUserFunction=pull)
    else:
        six = np.zeros((6, 6))
        six[:3, :3] = np.outer(along, along)
        _connect(items, markers, stiffness=word.stiffness * six, damping=word.damping * six)


def add_six_springs(items: Items, word: SixSprings) -> None:
    """Add a bushing: where its points lie apart, a's body reaches rigidly to the place of b."""
    markers = (
        items.marker(word.a, axes=word.axes, at=items.scene.point_position(word.b)),
        items.marker(word.b, axes=word.axes),
    )
    options: dict[str, Any] = {"stiffness": word.stiffness, "damping": word.damping}
    if np.any(word.damping) and items.moves(word.a) and items.moves(word.b):
        options["springForceTorqueUserFunction"] = _pull_of_six(markers[0], word.stiffness, word.damping)
    _connect(items, markers, useIntrinsicFormulation=True, **options)


def _connect(items: Items, markers: tuple[int, int], **options: Any) -> None:
    items.mbs.AddObject(eii.ObjectConnectorRigidBodySpringDamper(markerNumbers=list(markers), **options))


def _pull_of_six(first: int, stiffness: Array, damping: Array) -> Wrench:
    """What pulls at the first marker, in the middle and along axes halfway, (6,), as Exudyn asks for it.

    It is given the logarithm of the motion (displacement, turned) of the second marker against the first, and
    differences of velocities and of angular velocities, all along the axes halfway.
    """

    def pull(mbs: Any, _t: float, _n: int, logarithm: Array, turned: Array, *more: Array) -> Array:
        speed, turning = np.asarray(more[0]), np.asarray(more[1])
        displacement, to_half = _halfway(logarithm, turned)
        spin = to_half @ mbs.GetMarkerOutput(first, LOCAL) + turning / 2
        grows = np.concatenate([speed - np.cross(spin, displacement), turning])
        result: Array = stiffness @ np.concatenate([logarithm, turned]) + damping @ grows
        return result

    return pull


def _pull_along(first: int, along: Array, stiffness: float, damping: float) -> Wrench:
    """As `_pull_of_six`, along a direction of the first marker's axes, in the place of the second marker."""

    def pull(mbs: Any, _t: float, _n: int, logarithm: Array, turned: Array, *more: Array) -> Array:
        displacement, to_half = _halfway(logarithm, turned)
        direction, spin = to_half @ along, to_half @ mbs.GetMarkerOutput(first, LOCAL)
        grows = direction @ (np.asarray(more[0]) - np.cross(spin, displacement))
        force = (stiffness * (direction @ displacement) + damping * grows) * direction
        return np.concatenate([force, np.cross(displacement, force) / 2])

    return pull


def _halfway(logarithm: Array, turned: Array) -> tuple[Array, Array]:
    """Displacement along axes halfway, (3,), and the turn from the first marker's axes into these, (3, 3)."""
    turned, logarithm = np.asarray(turned), np.asarray(logarithm)
    half = float(np.linalg.norm(turned)) / 2
    across = np.sinc(half / np.pi)
    axis = turned / (2 * half) if half else turned
    displacement = across * logarithm + (1 - across) * (axis @ logarithm) * axis
    return displacement, Rotation.from_rotvec(-turned / 2).as_matrix()
