"""Geometry of Stewart platforms.

Frames: F is fixed to the base, with z up. M is fixed to the top plate, above F by the height and parallel to F at rest.
B, the point of interest, is fixed to M. Arrays of struts have one row per strut. Source of the parametrisation and of
the cubic configuration: the Stewart platform model of T. Dehaeze and others (MIT licence).
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY

import numpy as np

from nassim.base.checks import Array, finite, finite_array, freeze, positive
from nassim.base.field_types import ArrayField, ArrayLike, data_class, held
from nassim.base.rigid_motion import axes_along
from nassim.base.short_repr import short_repr


@data_class
class StewartPlatform:
    """Six struts between a base and a platform.

    Attributes:
        base_joints: start points a of the struts, from F, shape (6, 3) [m]
        platform_joints: end points b of the struts, from M, shape (6, 3) [m]
        height: height of M above F at rest [m]
        point: position of B from M, shape (3,) [m]. Motions, forces and stiffness refer to B; use
            `dataclasses.replace(platform, point=...)` for another point.

    Raises:
        ValueError: for a strut of zero length
    """

    _: KW_ONLY
    base_joints: ArrayField
    platform_joints: ArrayField
    height: float
    point: ArrayField = held((0.0, 0.0, 0.0))
    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze(
            self,
            base_joints=finite_array("base_joints", self.base_joints, (6, 3)),
            platform_joints=finite_array("platform_joints", self.platform_joints, (6, 3)),
            height=positive("height", self.height, "m"),
            point=finite_array("point", self.point, (3,)),
        )
        short = np.flatnonzero(strut_lengths(self) < 1e-9 * self.height)
        if short.size:
            raise ValueError(f"struts {', '.join(map(str, short))} (from 0) begin where they end; move their joints")

    @classmethod
    def from_angles(
        cls,
        *,
        height: float,
        base_radius: float,
        base_angles: Sequence[float],
        base_height: float,
        platform_radius: float,
        platform_angles: Sequence[float],
        platform_depth: float,
        point: ArrayLike = (0.0, 0.0, 0.0),
    ) -> "StewartPlatform":
        """Make a platform whose joints are on two circles about z.

        Args:
            height: height of M above F at rest [m]
            base_radius: radius of the lower circle [m]
            base_angles: angles of the six joints on it from x, in the order of the struts [degrees]
            base_height: height of the lower circle above F [m]
            platform_radius: radius of the upper circle [m]
            platform_angles: angles of the six joints on it from x, in the order of the struts [degrees]
            platform_depth: depth of the upper circle below M [m]
            point: position of B from M, shape (3,) [m]

        Raises:
            ValueError: if a radius is not positive
        """
        base = _circle("base", base_radius, base_angles, base_height)
        top = _circle("platform", platform_radius, platform_angles, -platform_depth)
        return cls(base_joints=base, platform_joints=top, height=height, point=np.asarray(point))

    @classmethod
    def cubic(
        cls,
        *,
        height: float,
        edge_height: float,
        centre_height: float,
        base_height: float,
        platform_depth: float,
        point: ArrayLike = (0.0, 0.0, 0.0),
    ) -> "StewartPlatform":
        """Make a platform whose struts lie on the six middle edges of a cube that stands on its corner.

        Struts 0 and 1 begin near the x axis, 2 and 3 near 120 degrees, 4 and 5 near 240 degrees. Struts with odd
        numbers go round z in the positive direction.

        Args:
            height: height of M above F at rest [m]
            edge_height: vertical extent of these edges (Hc of the published model); an edge of the cube is sqrt(3)
                times as long [m]
            centre_height: height of the cube's centre above F [m]
            base_height: height of the plane of the base joints above F [m]
            platform_depth: depth of the plane of the platform joints below M [m]
            point: position of B from M, shape (3,) [m]

        Raises:
            ValueError: for planes that do not cut the edges, or if the base's plane is not the lower one
        """
        half = positive("edge_height", edge_height, "m") / 2
        low, high = base_height - centre_height, height - platform_depth - centre_height
        if not -half * (1 + 1e-9) <= low < high <= half * (1 + 1e-9):
            raise ValueError(
                f"the joints' planes lie {low:g} and {high:g} m above the cube's centre; its middle edges go from "
                f"{-half:g} to {half:g} m, and the base's plane must be the lower one"
            )
        turn = np.deg2rad(np.repeat([0.0, 120.0, 240.0], 2))
        bend = turn + np.deg2rad(np.tile([-60.0, 60.0], 3))
        radius = edge_height * np.sqrt(2)
        starts, ends = (np.column_stack([np.cos(a), np.sin(a)]) * radius for a in (turn, bend))

        def cut(level: float) -> Array:
            return starts + (ends - starts) * (level + half) / edge_height

        return cls(
            base_joints=np.column_stack([cut(low), np.full(6, base_height)]),
            platform_joints=np.column_stack([cut(high), np.full(6, -platform_depth)]),
            height=height,
            point=np.asarray(point),
        )


def _circle(name: str, radius: float, angles: Sequence[float], level: float) -> Array:
    """Return six points on a circle about z, shape (6, 3) [m]."""
    turn = np.deg2rad(finite_array(f"{name}_angles", angles, (6,)))
    ring = positive(f"{name}_radius", radius, "m") * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.column_stack([ring, np.full(6, finite(f"{name}'s level", level))])


def strut_vectors(platform: StewartPlatform) -> Array:
    """Return the vectors from a to b at rest in the axes of F, shape (6, 3) [m]."""
    return platform.platform_joints + np.array([0, 0, platform.height]) - platform.base_joints


def strut_lengths(platform: StewartPlatform) -> Array:
    """Return the distances from a to b at rest, shape (6,) [m]."""
    return np.asarray(np.linalg.norm(strut_vectors(platform), axis=1))


def strut_directions(platform: StewartPlatform) -> Array:
    """Return the unit vectors from a to b at rest in the axes of F, shape (6, 3)."""
    return strut_vectors(platform) / strut_lengths(platform)[:, None]


def strut_frames(platform: StewartPlatform) -> Array:
    """Return the axes of the struts at rest as columns in F, shape (6, 3, 3): z along the strut, x = y of F cross z.

    To place a strut that was modelled along z, use these rotations at `platform.base_joints`.

    Args:
        platform: the Stewart platform

    Raises:
        ValueError: if a strut is parallel to the y axis of F
    """
    along = strut_directions(platform)
    across = np.cross([0.0, 1.0, 0.0], along)
    if np.linalg.norm(across, axis=1).min() < 1e-9:
        raise ValueError("a strut lies along F's y axis, across which its own x axis is not defined; turn the platform")
    return np.array([axes_along(z, x) for z, x in zip(along, across, strict=True)])
