"""Appearance of bodies: their surface, a box of equal inertia, rods between their points, blocks and cylinders."""

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from nassim.base.checks import Array, finite_array, positive
from nassim.base.field_types import ArrayLike
from nassim.base.rigid_motion import axes_along, rigid_transfer
from nassim.bodies.readouts import Surface, Trace, readouts_of
from nassim.bodies.reduced_body import ReducedBody
from nassim.scene.bodies import Body, FlexibleBody, RigidBody
from nassim.scene.rotation_measures import RelativePose
from nassim.scene.scene import Scene
from nassim.scene.terms import Spring
from nassim.viewer.view_content import Form

INTERFACES = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")
MATERIALS = ("#c9ccd1", "#e8c98a", "#a9c6a0", "#d8a58a", "#b9a9cf", "#8fb3c9")
THIN = 0.02
"""Thickness of rods, and smallest side of boxes, over the size of the body."""
LIGHTEST, WATER = 10.0, 1000.0
"""A box of equal inertia below the first density [kg/m^3] is shrunk to the second: bodies of 1 g that only connect
joints often have inertias of any size."""
AROUND = 48
NECK = 0.2
"""Smaller radius of the cones of a joint over the larger one."""
SAME_POINT = 1e-9
"""Distance below which points coincide [m]."""
NEAREST_POINTS = 12
"""Number of surface points that determine the motion of a place between them."""
CENTRE = "centre of mass"


def block(
    size: ArrayLike, centre: ArrayLike = (0, 0, 0), *, axes: ArrayLike | None = None, label: str = "block"
) -> Surface:
    """Return the surface of a block.

    Args:
        size: lengths of the sides, (3,) [m].
        centre: centre, (3,) [m].
        axes: directions of the sides as columns, (3, 3) (default: x, y, z).
        label: label of the surface.

    Raises:
        ValueError: for sides that are not positive.
    """
    lengths = finite_array("size of a block", size, (3,))
    if lengths.min() <= 0:
        raise ValueError(f"size of a block must be positive, got {lengths.tolist()} m")
    turn = np.eye(3) if axes is None else finite_array("axes of a block", axes, (3, 3))
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    points = finite_array("centre of a block", centre, (3,)) + (signs * lengths) @ turn.T
    faces = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return _of_faces(points, faces, label)


def cylinder(radius: float, height: float, centre: ArrayLike = (0, 0, 0), *, label: str = "cylinder") -> Surface:
    """Return the surface of a cylinder along z.

    Args:
        radius: radius [m].
        height: height [m].
        centre: centre, (3,) [m].
        label: label of the surface.
    """
    radius, half = positive("radius", radius, "m"), 0.5 * positive("height", height, "m")
    surface = _of_rings(np.eye(3), (radius, radius), (-half, half), label)
    return replace(surface, points=surface.points + finite_array("centre of a cylinder", centre, (3,)))


def body_form(body: ReducedBody) -> Form:
    """Return the form of a reduced body: its surface, or without one rods from its centre of mass to its points.

    The named points include the remote points, the electrical ports with a known position, which move with the surface
    around them, and `CENTRE`, the centre of mass at rest, which moves with the mean of the motions of the remote
    points.

    Args:
        body: the reduced body.
    """
    centre, ports = body.center_of_mass, [port for port in body.ports if port.place is not None]
    points = body.all_point_names
    names = (*points, *(port.name for port in ports), CENTRE)
    positions = np.array([*(body.point(name).position for name in points), *(port.place for port in ports), centre])
    motions = [body.motion(name)[:3] for name in points]
    motions += [*(_amid(body, np.asarray(port.place)) for port in ports), _between(body, centre)]
    if body.surface is not None and body.surface_modes is not None:
        return Form(body.surface, names, positions, np.concatenate([body.surface_modes, motions]))
    surface, rows = _rods(body)
    return Form(surface, names, positions, np.concatenate([rows, motions]))


def scene_form(body: Body, look: Surface | None = None, side: Array | None = None) -> Form:
    """Return the form of a body in a scene.

    A flexible body has the form of `body_form`, trimmed or not, and moves by the coordinates in which motions of scenes
    are given. A rigid body without a surface appears as the homogeneous box of equal inertia (smaller if the box would
    be lighter than `LIGHTEST`), or with `side` as a cone of about half the size of that box. A fixed body without a
    surface is invisible. Rigid bodies move by six coordinates along their axes: translation of the centre of mass and
    rotation.

    Args:
        body: the body.
        look: surface of a rigid body in its own frame, around its centre of mass.
        side: direction of the cone, world frame, (3,), as from `bushing_sides`.

    Raises:
        ValueError: for a look of a flexible body.
    """
    if isinstance(body, FlexibleBody):
        if look is not None:
            raise ValueError(
                f"body {body.name!r} is flexible and appears with its own surface; give looks to rigid bodies"
            )
        form = body_form(body.reduced)
        assert form.modes is not None
        # The motion of a trimmed body is given in the coordinates from before the trimming, which the trace reads.
        traces = readouts_of(body.reduced.readouts, Trace)
        return replace(form, modes=form.modes @ np.linalg.pinv(traces[0].rows)) if traces else form
    surface = look if look is not None else _of_inertia(body, side)
    places = [body.point_position(point) - body.position for point in body.point_names]
    positions = np.reshape(places, (-1, 3)) @ body.rotation
    points = np.vstack([surface.points, positions])
    modes = np.array([rigid_transfer(point)[:3] for point in points]).reshape(-1, 3, 6)
    return Form(surface, body.point_names, positions, modes)


def label_colors(surface: Surface, points: tuple[str, ...]) -> Mapping[str, str]:
    """Return colours by label of a surface: strong ones for interfaces of remote points, pale ones for CAD bodies.

    Args:
        surface: the surface.
        points: names of the remote points.
    """
    solids = [label for label in Form(surface).labels if label not in points]
    strong = zip(points, itertools.cycle(INTERFACES), strict=False)
    return dict(strong) | dict(zip(solids, itertools.cycle(MATERIALS), strict=False))


def bushing_sides(scene: Scene) -> dict[str, Array]:
    """Return directions that separate rigid bodies whose centres coincide in a bushing, world frame, (3,), by name.

    Without them the halves of such a flexible joint would hide each other. The directions are along the stiffest axis
    of the bushing, on the sides of the points of the bodies; where these do not decide, the second body is on the
    positive side.

    Args:
        scene: the scene.
    """
    found: dict[str, Array] = {}
    for spring in scene.terms_of(Spring):
        pose = spring.measure
        # A bushing that leaves a rotation free is a bearing, whose bodies are no halves of a joint.
        if not isinstance(pose, RelativePose) or np.diag(spring.matrices[0])[3:].min() <= 0:
            continue
        held = [body for body, _ in map(scene.split, pose.points) if isinstance(body, RigidBody) and body.moves]
        away = [np.abs(body.position - scene.point_position(pose.b)).max() for body in held]
        if len(held) == 2 and max(away) < SAME_POINT:
            along = pose.axes[:, np.argmax(np.diag(spring.matrices[0])[:3])]
            first, second = (np.mean([body.point_position(point) for point in body.points], axis=0) for body in held)
            along = along if along @ (second - first) >= 0 else -along
            found |= {held[0].name: -along, held[1].name: along}
    return found


def _of_inertia(body: Body, side: Array | None) -> Surface:
    if not isinstance(body, RigidBody) or body.mass is None or body.inertia is None:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3), dtype=int), np.zeros((0, 2), dtype=int), ())
    moments, axes = np.linalg.eigh(body.inertia)
    # A box with sides a, b, c has 12 Ix = m (b^2 + c^2), and likewise for y and z.
    squares = 6 / body.mass * (moments.sum() - 2 * moments)
    sides = np.sqrt(np.maximum(squares, (THIN**2) * squares.max()))
    density = body.mass / sides.prod()
    if density < LIGHTEST:
        sides *= np.cbrt(density / WATER)
    if side is None:
        return block(sides, axes=axes, label=body.name)
    along = body.rotation.T @ side
    height = 0.5 * float(np.abs(along @ axes) @ sides)
    radius = np.sqrt(sides.prod() / (2 * np.pi * height))
    return _of_rings(axes_along(along), (NECK * radius, radius), (0.0, height), body.name)


def _rods(body: ReducedBody) -> tuple[Surface, Array]:
    """Return prisms from the centre of mass to the points, each of which moves the end of its prism as a rigid body."""
    names = body.all_point_names
    centre, points = body.center_of_mass, np.array([body.point(name).position for name in names])
    span = max(float(np.linalg.norm(points - centre, axis=1).max()), 1e-6)
    corners: list[Array] = []
    faces: list[tuple[int, ...]] = []
    rows: list[Array] = []
    for name, point in zip(names, points, strict=True):
        along = point - centre
        if np.linalg.norm(along) < THIN * span:
            continue
        across = np.linalg.svd(along[None])[2][1:]
        ring = THIN * span * np.array([across[0], across[1], -across[0], -across[1]])
        start = len(corners)
        corners += [*(centre + ring), *(point + ring)]
        rows += [_between(body, centre + offset) for offset in ring]
        rows += [_carried(body, name, point + offset) for offset in ring]
        faces += [tuple(start + k for k in (a, (a + 1) % 4, (a + 1) % 4 + 4, a + 4)) for a in range(4)]
        faces.append(tuple(range(start + 4, start + 8)))
    surface = _of_faces(np.array(corners).reshape(-1, 3), faces, body.name)
    return surface, np.array(rows).reshape(-1, 3, len(body.mass_matrix))


def _carried(body: ReducedBody, name: str, place: Array) -> Array:
    """Return the displacement of a place fixed to a remote point, per unit of the coordinates, (3, n)."""
    return (rigid_transfer(place - body.point(name).position) @ body.motion(name))[:3]


def _between(body: ReducedBody, place: Array) -> Array:
    """Return the mean displacement of a place fixed to each of the points, (3, n)."""
    return np.mean([_carried(body, name, place) for name in body.all_point_names], axis=0)


def _amid(body: ReducedBody, place: Array) -> Array:
    """Return the motion of a place from the nearest points of the surface, (3, n); without a surface as `_between`."""
    if body.surface is None or body.surface_modes is None:
        return _between(body, place)
    away = body.surface.points - place
    near = np.argsort(np.linalg.norm(away, axis=1))[:NEAREST_POINTS]
    # The weighted mean of the points' positions is the place, so that the mean is exact for rigid-body motion.
    sums = np.vstack([np.full((1, len(near)), np.linalg.norm(away[near], axis=1).max()), away[near].T])
    weights = np.linalg.lstsq(sums, np.array([sums[0, 0], 0.0, 0.0, 0.0]), rcond=None)[0]
    return np.einsum("p,pcn->cn", weights, body.surface_modes[near])


def _of_rings(axes: Array, radii: tuple[float, float], heights: tuple[float, float], label: str) -> Surface:
    """Return the closed surface between two circles around the last axis, with the radii and heights of both."""
    angle = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    points = np.vstack([np.column_stack([r * ring, np.full(AROUND, z)]) for r, z in zip(radii, heights, strict=True)])
    low, high = tuple(range(AROUND)), tuple(range(AROUND, 2 * AROUND))
    walls = [(k, (k + 1) % AROUND, (k + 1) % AROUND + AROUND, k + AROUND) for k in low]
    return _of_faces(points @ axes.T, (low[::-1], high, *walls), label)


def _of_faces(points: Array, faces: Iterable[tuple[int, ...]], label: str) -> Surface:
    """Return a surface of flat, convex faces, each given by its points in order."""
    rings = list(faces)
    triangles = [(ring[0], ring[k], ring[k + 1]) for ring in rings for k in range(1, len(ring) - 1)]
    edges = {tuple(sorted(pair)) for ring in rings for pair in zip(ring, ring[1:] + ring[:1], strict=True)}
    return Surface(
        points,
        np.array(triangles, dtype=int).reshape(-1, 3),
        np.array(sorted(edges), dtype=int).reshape(-1, 2),
        (label,) * len(triangles),
    )
