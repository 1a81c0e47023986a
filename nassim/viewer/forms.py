"""What bodies look like: their surface, a box of their inertia, rods between their points, blocks and cylinders."""

import itertools
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from nassim.base.checks import Array, finite_array, positive
from nassim.base.rigid_motion import rigid_transfer
from nassim.bodies.readouts import Surface
from nassim.bodies.reduced_body import ReducedBody
from nassim.scene.bodies import Body, FlexibleBody, RigidBody
from nassim.viewer.views import Form

INTERFACES = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")
MATERIALS = ("#c9ccd1", "#e8c98a", "#a9c6a0", "#d8a58a", "#b9a9cf", "#8fb3c9")
THIN = 0.02
"""Thickness of rods, and the least of boxes, over the size of the body."""
AROUND = 48
CENTRE = "centre of mass"


def block(
    size: ArrayLike, centre: ArrayLike = (0, 0, 0), *, axes: Array | None = None, label: str = "block"
) -> Surface:
    """A block of three lengths [m] around a centre [m]; axes: of the lengths, as columns, (3, 3)."""
    lengths = finite_array("size of a block", size, (3,))
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    points = (
        finite_array("centre of a block", centre, (3,)) + (signs * lengths) @ (np.eye(3) if axes is None else axes).T
    )
    faces = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return _of_faces(points, faces, label)


def cylinder(radius: float, height: float, centre: ArrayLike = (0, 0, 0), *, label: str = "cylinder") -> Surface:
    """A cylinder along z around a centre, lengths in [m]."""
    angle = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    ring = positive("radius", radius, "m") * np.column_stack([np.cos(angle), np.sin(angle)])
    half = 0.5 * positive("height", height, "m")
    points = np.vstack([np.column_stack([ring, np.full(AROUND, z)]) for z in (-half, half)])
    low, high = tuple(range(AROUND)), tuple(range(AROUND, 2 * AROUND))
    walls = [(k, (k + 1) % AROUND, (k + 1) % AROUND + AROUND, k + AROUND) for k in low]
    return _of_faces(points + finite_array("centre of a cylinder", centre, (3,)), (low[::-1], high, *walls), label)


def body_form(body: ReducedBody) -> Form:
    """A reduced body with its points: as its surface, without one as rods from its centre to its remote points.

    One more point, `CENTRE`, is where its centre of mass is at rest, moved as the mean of what remote points carry.
    """
    centre, names = body.center_of_mass, body.all_point_names
    positions = np.array([*(body.point(name).position for name in names), centre])
    motions, names = [*(body.motion(name)[:3] for name in names), _between(body, centre)], (*names, CENTRE)
    if body.surface is not None and body.surface_modes is not None:
        return Form(body.surface, names, positions, np.concatenate([body.surface_modes, motions]))
    surface, rows = _rods(body)
    return Form(surface, names, positions, np.concatenate([rows, motions]))


def scene_form(body: Body, look: Surface | None = None) -> Form:
    """A body of a scene; look: its surface in its own frame, of a rigid body around its centre of mass.

    Without one, a rigid body looks like the box of even density that has its inertia, and a fixed one like nothing.
    Rigid bodies move by six coordinates: shifts of the centre of mass and turns, along the body's axes.
    """
    if isinstance(body, FlexibleBody):
        if look is not None:
            raise ValueError(
                f"body {body.name!r} is flexible and looks like its own surface; give looks to rigid bodies"
            )
        return body_form(body.reduced)
    surface = look if look is not None else _inertia_box(body)
    positions = np.array(list(body.points.values())).reshape(-1, 3)
    points = np.vstack([surface.points, positions])
    modes = np.array([rigid_transfer(point)[:3] for point in points]).reshape(-1, 3, 6)
    return Form(surface, tuple(body.points), positions, modes)


def label_colors(surface: Surface, points: tuple[str, ...]) -> Mapping[str, str]:
    """Colours of a surface's labels: strong ones of remote points' interfaces, pale ones of CAD bodies."""
    solids = [label for label in Form(surface).labels if label not in points]
    strong = zip(points, itertools.cycle(INTERFACES), strict=False)
    return dict(strong) | dict(zip(solids, itertools.cycle(MATERIALS), strict=False))


def _inertia_box(body: RigidBody) -> Surface:
    if body.mass is None or body.inertia is None:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3), dtype=int), np.zeros((0, 2), dtype=int), ())
    moments, axes = np.linalg.eigh(body.inertia)
    # Of a box with sides a, b, c: 12 Ix = m (b^2 + c^2) and so on.
    squares = 6 / body.mass * (moments.sum() - 2 * moments)
    sides = np.sqrt(np.maximum(squares, (THIN**2) * squares.max()))
    return block(sides, axes=axes, label=body.name)


def _rods(body: ReducedBody) -> tuple[Surface, Array]:
    """Prisms from the centre of mass to the remote points, each of which moves its end as a rigid body."""
    centre, points = body.center_of_mass, body.positions
    span = max(float(np.linalg.norm(points - centre, axis=1).max()), 1e-6)
    corners: list[Array] = []
    faces: list[tuple[int, ...]] = []
    rows: list[Array] = []
    for name, point in zip(body.point_names, points, strict=True):
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
    """Displacement of a place that a remote point carries along, per unit of the coordinates, (3, n)."""
    return (rigid_transfer(place - body.point(name).position) @ body.motion(name))[:3]


def _between(body: ReducedBody, place: Array) -> Array:
    """The mean of what all remote points carry along, (3, n)."""
    result: Array = np.mean([_carried(body, name, place) for name in body.point_names], axis=0)
    return result


def _of_faces(points: Array, faces: Iterable[tuple[int, ...]], label: str) -> Surface:
    """A surface of flat, convex faces, each the ring of its points."""
    rings = list(faces)
    triangles = [(ring[0], ring[k], ring[k + 1]) for ring in rings for k in range(1, len(ring) - 1)]
    edges = {tuple(sorted(pair)) for ring in rings for pair in zip(ring, ring[1:] + ring[:1], strict=True)}
    return Surface(
        points,
        np.array(triangles, dtype=int).reshape(-1, 3),
        np.array(sorted(edges), dtype=int).reshape(-1, 2),
        (label,) * len(triangles),
    )
