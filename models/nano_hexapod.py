"""The nano-hexapod: six struts between two plates, a payload on top, a fixed base or a spindle below.

`make_nano_hexapod` places six struts of `models.strut` according to the geometry of a `StewartPlatform`. Frames: F is
the world frame, on the outer face of the base. M is on the upper face of the top plate, where the payload stands. B,
the point of interest, is at `platform.point` above M.
"""

import math
from collections.abc import Sequence
from typing import Any

import netgen.occ as occ
import numpy as np

from nassim import (
    Drive,
    FlexibleBody,
    PointForce,
    PointTorque,
    Pose,
    ReducedBody,
    RemotePoint,
    RigidBody,
    Scene,
    Solid,
    build_fe_model,
    craig_bampton,
    fixed,
    joined,
    placed,
    revolute,
)
from nassim.base import code_fingerprint, fingerprint, load_or_compute
from nassim.base.checks import finite, not_negative
from nassim.base.field_types import ArrayLike
from nassim.fem import glue, shape_bytes, solver_name
from nassim.kinematics import StewartPlatform, strut_frames, strut_lengths

from .apa300ml import STEEL
from .hexapods import NANO_HEXAPOD
from .strut import WEIGHTLESS, fe_strut

BASE_MASS, TOP_MASS = 3.87, 5.19
"""Masses of the plates in steel [kg], from the volumes of public CAD."""
PLATE_RADIUS = 0.15
"""Radius of both plates [m], assumed; the joints are at radii of 110 and 114 mm."""
PLATE_HEIGHT = 9.4e-3
"""Height of the top plate [m], which gives its mass with this radius."""
PAYLOAD_RADIUS = 0.1
"""Radius of the usual payload, a steel cylinder [m], assumed."""
PAD_RADIUS, CENTRE_RADIUS = 12e-3, 30e-3
"""Radii of the areas at which struts and payload are connected to a meshed plate [m], assumed."""
SAME_LENGTH = 1e-9
"""Difference below which two lengths are equal [m]."""
GRAVITY = (0.0, 0.0, -9.81)


def make_nano_hexapod(
    struts: Scene | Sequence[Scene] | None = None,
    *,
    platform: StewartPlatform = NANO_HEXAPOD,
    plate: RigidBody | FlexibleBody | None = None,
    payload_mass: float = 1.0,
    payload_centre: ArrayLike | None = None,
    payload_inertia: ArrayLike | None = None,
    spindle_rpm: float = 0.0,
    damping_ratio: float | None = None,
    cutoff_frequency: float | None = None,
    gravity: bool = False,
) -> Scene:
    """Make the hexapod as a scene: struts "strut_1" to "strut_6" and the bodies "base", "plate" and "payload".

    Inputs are those of the struts, such as "strut_1/actuator_voltage", and forces and torques on the payload at B,
    "payload_force_x" [N] ... "payload_torque_z" [N m], along axes that turn with the payload. Outputs are
    "strut_1/sensor_voltage", "strut_1/encoder" ..., and the pose of B relative to the base, "pose.ux" ... "pose.rz".

    Args:
        struts: one strut for all six, or six (default: `fe_strut`), with the lengths of the platform
        platform: geometry and point of interest
        plate: top plate, from `rigid_plate` or `flexible_plate` (default: rigid, of steel)
        payload_mass: mass of the payload [kg], 1 to 50 for the real machine, 0 for none
        payload_centre: its centre of mass, from M, shape (3,) [m]
        payload_inertia: its inertia about the centre of mass, shape (3, 3) [kg m2] (default: a steel cylinder of
            `PAYLOAD_RADIUS` that stands on M)
        spindle_rpm: speed of the base about z [1/min]; 0 for a fixed base without a spindle
        damping_ratio: see `Scene` (default: that of the struts)
        cutoff_frequency: see `Scene`
        gravity: include the weights

    Raises:
        ValueError: if there are not six struts, or their lengths differ from those of the platform
    """
    top = rigid_plate(platform) if plate is None else plate
    legs = _placed_struts(fe_strut() if struts is None else struts, platform)
    ground, spindle, drive = _spindle(finite("spindle_rpm", spindle_rpm))
    feet = [fixed(f"foot_{k}", f"base.joint_{k}", f"strut_{k}/bottom.end") for k in range(1, 7)]
    heads = [fixed(f"head_{k}", f"strut_{k}/top.end", f"{top.name}.joint_{k}") for k in range(1, 7)]
    payload = _payload(platform, payload_mass, payload_centre, payload_inertia)
    return joined(
        "nano-hexapod",
        *legs,
        bodies=(*ground, _base(platform, turns=bool(ground)), top, payload),
        joints=(*spindle, *feet, *heads, fixed("payload", f"{top.name}.centre", "payload.foot")),
        actuators=(*drive, *_wrench("payload.target")),
        sensors=(Pose("pose", "base.centre", "payload.target"),),
        damping_ratio=damping_ratio,
        gravity=GRAVITY if gravity else np.zeros(3),
        cutoff_frequency=cutoff_frequency,
    )


def rigid_plate(
    platform: StewartPlatform = NANO_HEXAPOD,
    *,
    mass: float = TOP_MASS,
    radius: float = PLATE_RADIUS,
    height: float = PLATE_HEIGHT,
) -> RigidBody:
    """Make a rigid disc below M as top plate. The published model has 1 kg, 100 mm and 10 mm.

    Args:
        platform: geometry
        mass: mass [kg]
        radius: radius [m]
        height: height [m]
    """
    centre = np.array([0, 0, platform.height - height / 2])
    points = _joints(platform.platform_joints + np.array([0, 0, platform.height]) - centre)
    points["centre"] = np.array([0, 0, height / 2])
    return RigidBody("plate", points, mass, _disc(mass, radius, height), centre)


def flexible_plate(
    platform: StewartPlatform = NANO_HEXAPOD,
    *,
    fidelity: str = "linear",
    height: float = PLATE_HEIGHT,
    radius: float = PLATE_RADIUS,
    element_size: float = 20e-3,
    order: int = 2,
    n_modes: int = 6,
    progress: bool = True,
) -> FlexibleBody:
    """Make a steel disc below M as top plate, meshed and reduced to the centres of the joints and M; uses the cache.

    Args:
        platform: geometry
        fidelity: see `FlexibleBody`
        height: height of the disc [m]; the default gives the mass of the real plate
        radius: radius of the disc [m]
        element_size: size of the finite elements [m]
        order: order of the finite elements
        n_modes: number of fixed-interface modes
        progress: show the stages and their times
    """
    body = _reduced_plate(make_plate(platform, height=height, radius=radius), element_size, order, n_modes, progress)
    return FlexibleBody("plate", body, np.array([0, 0, platform.height]), np.eye(3), fidelity, "centre")


def make_plate(platform: StewartPlatform, *, height: float, radius: float) -> Solid:
    """Make the disc as a solid in the axes of M, with remote points "joint_1" to "joint_6" and "centre".

    The centre of each joint is coupled to a circular area of the lower face above it, M to one of the upper face.

    Args:
        platform: geometry
        height: height of the disc [m]
        radius: radius of the disc [m]
    """
    joints = platform.platform_joints
    down = occ.Vec(0, 0, -1)
    pads = [occ.Cylinder(occ.Pnt(x, y, 0), down, PAD_RADIUS, height) for x, y, _ in joints]
    centre = occ.Cylinder(occ.Pnt(0, 0, 0), down, CENTRE_RADIUS, height)
    rest = occ.Cylinder(occ.Pnt(0, 0, 0), down, radius, height)
    for k, pad in enumerate(pads, start=1):
        rest = rest - pad
        pad.faces.Min(occ.Z).name = f"joint_{k}"
    centre.faces.Max(occ.Z).name = "centre"
    pieces = [rest - centre, centre, *pads]
    for piece in pieces:
        piece.solids.name = "plate"
    places = {f"joint_{k}": place for k, place in enumerate(joints, start=1)} | {"centre": np.zeros(3)}
    points = tuple(RemotePoint(name, name, place) for name, place in places.items())
    return Solid("plate", glue([solid for piece in pieces for solid in piece.solids]), {"plate": STEEL}, points)


def _reduced_plate(solid: Solid, element_size: float, order: int, n_modes: int, progress: bool) -> ReducedBody:
    figures = (element_size, order, n_modes)
    key = fingerprint(
        shape_bytes(solid.shape), solid.materials, solid.remote_points, figures, solver_name(), code_fingerprint()
    )

    def build() -> ReducedBody:
        fe_model = build_fe_model(solid, element_size=element_size, order=order, progress=progress)
        return craig_bampton(fe_model, n_modes=n_modes, discretization=False, progress=progress)

    return load_or_compute("plate", key, build, progress=progress)


def _placed_struts(struts: Scene | Sequence[Scene], platform: StewartPlatform) -> list[Scene]:
    six = [struts] * 6 if isinstance(struts, Scene) else list(struts)
    if len(six) != 6:
        raise ValueError(f"a hexapod has six struts, got {len(six)}; give one scene for all, or six")
    legs = []
    places = zip(six, platform.base_joints, strut_frames(platform), strut_lengths(platform), strict=True)
    for k, (strut, foot, axes, length) in enumerate(places, start=1):
        ends = [strut.point_position(path) for path in ("bottom.end", "top.end")]
        if np.abs(ends - np.array([[0, 0, 0], [0, 0, length]])).max() > SAME_LENGTH:
            raise ValueError(
                f"strut {k}: the platform wants its ends at (0, 0, 0) and (0, 0, {length:.9g}) m, got {ends[0]} and "
                f"{ends[1]}; make it by a function of models.strut with length=strut_lengths(platform)[{k - 1}]"
            )
        legs.append(placed(strut, f"strut_{k}", position=foot, rotation=axes))
    return legs


def _joints(places: ArrayLike) -> dict[str, Any]:
    return {f"joint_{k}": place for k, place in enumerate(np.asarray(places), start=1)}


def _disc(mass: float, radius: float, height: float) -> np.ndarray:
    across = mass * (radius**2 / 4 + height**2 / 12)
    return np.diag([across, across, mass * radius**2 / 2])


def _base(platform: StewartPlatform, *, turns: bool) -> RigidBody:
    points = _joints(platform.base_joints) | {"centre": np.zeros(3)}
    if not turns:
        return RigidBody("base", points, fixed=True)
    # The centre of mass is on the axis; its height has no effect on motion about that axis.
    height = BASE_MASS / (STEEL.density * math.pi * PLATE_RADIUS**2)
    return RigidBody("base", points, BASE_MASS, _disc(BASE_MASS, PLATE_RADIUS, height))


def _spindle(rpm: float) -> tuple[tuple[RigidBody, ...], tuple[Any, ...], tuple[Drive, ...]]:
    if not rpm:
        return (), (), ()
    ground = RigidBody("ground", {"spindle": np.zeros(3)}, fixed=True)
    turning = Drive("spindle", "spindle", "rz", speed=2 * math.pi * rpm / 60)
    return (ground,), (revolute("spindle", "ground.spindle", "base.centre"),), (turning,)


def _payload(platform: StewartPlatform, mass: float, centre: ArrayLike | None, inertia: ArrayLike | None) -> RigidBody:
    mass = not_negative("payload_mass", mass, "kg") or WEIGHTLESS
    height = mass / (STEEL.density * math.pi * PAYLOAD_RADIUS**2)
    at = np.array([0, 0, height / 2]) if centre is None else np.asarray(centre, dtype=float)
    moments = _disc(mass, PAYLOAD_RADIUS, height) if inertia is None else np.asarray(inertia, dtype=float)
    points = {"foot": -at, "target": platform.point - at}
    return RigidBody("payload", points, mass, moments, at + np.array([0, 0, platform.height]))


def _wrench(point: str) -> tuple[PointForce | PointTorque, ...]:
    kinds = ((PointForce, "payload_force"), (PointTorque, "payload_torque"))
    return tuple(
        kind(f"{name}_{axis}", point, axis, f"{name}_{axis}", frame=point) for kind, name in kinds for axis in "xyz"
    )
