"""Reduction of a whole scene to one flexible body: Craig-Bampton of the assembled scene.

The scene is first described by its own eigenmodes, in which the mass is one and the stiffness the squared frequencies,
then by the motions of the retained points and the modes with these held.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import scipy

from nassim.base.checks import Array, unique
from nassim.bodies.inertia import estimate_gram, transform_gram
from nassim.bodies.piezo import PortCoupling
from nassim.bodies.projection import trim_body
from nassim.bodies.readouts import BodyDamping, PassivePoint, Picture, Readout, Surface, by_name
from nassim.bodies.reduced_body import ReducedBody
from nassim.bodies.remote_points import RemotePoint
from nassim.bodies.strain import has_rigid_modes, remove_rounding
from nassim.bodies.stress import GaugeStrain, StressField
from nassim.bodies.stress_stiffness import StressStiffness
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.measures import DirectionalMeasure
from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint, ForceLaw, PrescribedMotion
from nassim.simulation.loaded.scene_stress import scene_stress
from nassim.simulation.model.assembly import Assembly, assemble
from nassim.simulation.model.coordinates import Coordinates

DEPENDENT_POINTS = 1e-9
"""Smallest singular value, of motions scaled to one, of points that move independently."""


def reduce_scene(
    scene: Scene,
    name: str,
    *,
    points: Mapping[str, str],
    passive: Mapping[str, str] | None = None,
    cutoff_frequency: float | None = None,
) -> ReducedBody:
    """Reduce the bodies, joints and springs of a scene to one body, whose frame is the scene's, for `FlexibleBody`.

    Electrical ports and places of stress keep their names, or are named "body/port" where two bodies have the same
    name; no port is wired yet. The new body has the damping of the dampers among the springs and of the bodies, whose
    ratios are of modes with all ports short-circuited (`FlexibleBody.damping_ratio`). Actuators, sensors, gravity and
    the scene's own damping_ratio are left out.

    With all modes, small motion without loads is exactly the scene's. If all deformable bodies hold their geometric
    stiffness, the new body holds that of bodies, joints and springs. Under loads its joints and springs keep their
    directions, so its responses are off by the size of the rotations of the scene's bodies against each other. In a
    floating frame, deformation is small relative to the frame. Large motion has all required integrals where the
    integrals of all bodies are complete.

    Args:
        scene: the scene.
        name: name of the body.
        points: remote points of the new body, each a point of the scene: {"bottom": "foot.low", "top": "head.high"}.
            The motions of all must be independent, as those of points on different bodies with something elastic
            between them.
        passive: points that follow the motion, for encoders and the like, in the same way.
        cutoff_frequency: frequency above which modes with all points held are left out [Hz], as `trim_body` does:
            static responses at the points and to voltages stay exact, and `enriched` is the whole. Default: the
            scene's; if that is None: all modes.

    Returns:
        The body.

    Raises:
        ValueError: for a scene that one body cannot represent: with fixed bodies, drives, loops or spinning bodies,
            with springs along axes of the world (which would not rotate with the body), with bodies that move freely
            against each other, and for points that are unknown or do not move independently.
    """
    _check(scene)
    cutoff = scene.cutoff_frequency if cutoff_frequency is None else cutoff_frequency
    holding = tuple(part for part in scene.actuators if any(isinstance(t, Constraint) for t in part.terms(scene)))
    assembly = assemble(replace(scene, actuators=holding, sensors=(), cutoff_frequency=None, damping_ratio=0.0))
    _check_whole(assembly)
    body = _whole(assembly, name, dict(points), dict(passive or {}))
    if cutoff is None or not body.n_modes:
        return body
    return trim_body(body, points=points, loads=np.zeros((len(body.mass_matrix), 0)), cutoff_frequency=cutoff)


def _check(scene: Scene) -> None:
    label = f"scene {scene.name!r} cannot be one body"
    for kind, found in (
        ("fixed bodies", [body.name for body in scene.bodies if not body.moves]),
        ("loops", [loop.name for loop in scene.loops]),
        ("drives of joints", [term.constraint for term in scene.terms_of(PrescribedMotion)]),
        ("spinning bodies", scene.spinning),
    ):
        if found:
            raise ValueError(f"{label}: it has {kind} ({', '.join(found)}); reduce it without and add them to the new")
    for part in (*scene.joints, *scene.springs):
        for term in part.terms(scene):
            if not isinstance(term, ForceLaw):
                continue
            if isinstance(term.measure, DirectionalMeasure) and not term.measure.axes_of:
                raise ValueError(
                    f"{label}: spring {part.name!r} acts along an axis of the world, which would not turn with the "
                    'body; give it frame="body.point", or the axis "line"'
                )
            if not term.is_linear:
                raise ValueError(f"{label}: spring {part.name!r} is not linear; add it to the new body")


def _check_whole(assembly: Assembly) -> None:
    free = int(np.sum(assembly.modal.rigid_modes))
    if free != 6:
        raise ValueError(
            f"scene {assembly.scene.name!r} cannot be one body: it has {free} rigid-body modes and a body has 6; "
            + ("join its bodies, or hold them by springs" if free > 6 else "something ties it to the world")
        )


def _whole(assembly: Assembly, name: str, points: dict[str, str], passive: dict[str, str]) -> ReducedBody:
    """Make the body with all modes."""
    if not unique("remote point", (*points, *passive))[: len(points)]:
        raise ValueError(f"body {name!r} needs at least one point, on which its frame rides")
    scene, coordinates = assembly.scene, assembly.coordinates
    shapes, omega = assembly.modal.modes, assembly.modal.omega
    interface = _motions(coordinates, points) @ shapes
    condensed, stiffness = _condensed(omega, interface, f"the points {', '.join(points)} of body {name!r}")
    remote = tuple(_point(scene, *item) for item in points.items())
    places = np.array([point.position for point in remote])
    if not has_rigid_modes(stiffness, condensed.T @ condensed, places):
        raise ValueError(f"scene {scene.name!r} cannot be one body: something ties it to the world")
    change, stiffness = shapes @ condensed, remove_rounding(stiffness, places)
    ports = {name: (body, port.name) for body, port, name in _ports(scene) if scene.body(body).deforms}
    stress = scene_stress(assembly, change, stiffness, [*points.values()], ports)
    along = [PassivePoint(_point(scene, *p), _motions(coordinates, dict([p])) @ change) for p in passive.items()]
    damping = _symmetric(condensed.T @ assembly.modal.damping.of_modes @ condensed)
    own: list[Readout] = [*([BodyDamping(damping)] if np.any(damping) else []), *([stress] if stress else [])]
    return ReducedBody(
        name,
        remote_points=remote,
        mass_matrix=_symmetric(condensed.T @ condensed),
        stiffness_matrix=stiffness,
        gram=_gram(coordinates, change),
        readouts=by_name([*along, *_readouts(coordinates, change), *own]),
        record={"scene": scene.name, "bodies": ", ".join(body.name for body in scene.bodies)},
        full_integrals=all(body.reduced.full_integrals for body in scene.deformable_bodies),
    )


def _condensed(omega: Array, interface: Array, label: str) -> tuple[Array, Array]:
    """Change from the eigenmodes to the points' motions and the modes with these held.

    Args:
        omega: angular frequencies of the eigenmodes, (n,) [rad/s].
        interface: motions of the points per unit of the eigenmodes, (6 r, n).
        label: name of the points, for messages.

    Returns:
        The change of coordinates and the stiffness, (n, n) each.
    """
    size = np.linalg.norm(interface, axis=1)
    _, independent, right = np.linalg.svd(interface / np.where(size > 0, size, 1.0)[:, None])
    if len(independent) < len(interface) or independent[-1] < DEPENDENT_POINTS:
        raise ValueError(f"{label} do not move independently; keep one of those that move together and pass the others")
    m = len(interface)
    held = right[m:].T
    # Modes and static shapes from strains, not from their squares: soft joints stay exact in series with stiff plates.
    stretch, frequency, combinations = np.linalg.svd(omega[:, None] * held, full_matrices=False)
    modes = held @ combinations[::-1].T
    follow = np.linalg.pinv(interface / size[:, None]) / size
    relaxed = follow - modes @ ((stretch[:, ::-1] / frequency[::-1]).T @ (omega[:, None] * follow))
    strain = omega[:, None] * relaxed
    stiffness = scipy.linalg.block_diag(_symmetric(strain.T @ strain), np.diag(frequency[::-1] ** 2))
    return np.hstack([relaxed, modes]), stiffness


def _gram(coordinates: Coordinates, change: Array) -> Array:
    """Integrate over all bodies, in the scene's frame."""
    size = 4 + 3 * change.shape[1]
    total = np.zeros((size, size))
    for body, rows in _parts(coordinates, change):
        if isinstance(body, FlexibleBody):
            gram, place, axes = body.reduced.gram, body.position, body.rotation
        else:
            gram, place, axes = estimate_gram(body.mass_matrix, np.zeros((1, 3))), body.position, np.eye(3)
        total += transform_gram(gram, place, axes, rows)
    return _symmetric(total)


def _readouts(coordinates: Coordinates, change: Array) -> Iterator[Readout]:
    """Collect the bodies' read-outs, except points, which `reduce_scene` is given, geometric stiffness and damping."""
    parts = [(body, rows) for body, rows in _parts(coordinates, change) if isinstance(body, FlexibleBody)]
    names = {(body, port.name): name for body, port, name in _ports(coordinates.scene)}
    stressed = [
        readout.name
        for body, _ in parts
        for readout in body.reduced.readouts.values()
        if isinstance(readout, (StressField, GaugeStrain))
    ]
    pictures = []
    for body, rows in parts:
        for readout in body.reduced.readouts.values():
            if isinstance(readout, Picture):
                points = body.position + readout.surface.points @ body.rotation.T
                pictures.append((replace(readout.surface, points=points), body.rotation @ (readout.modes @ rows)))
            elif isinstance(readout, PortCoupling):
                place = None if readout.place is None else body.position + body.rotation @ readout.place
                yield replace(readout.projected(rows), name=names[body.name, readout.name], place=place)
            elif isinstance(readout, (StressField, GaugeStrain)):
                name = f"{body.name}/{readout.name}" if stressed.count(readout.name) > 1 else readout.name
                moved = replace(readout.projected(rows).moved(body.position, body.rotation), name=name)
                if isinstance(moved, StressField):
                    of_ports = {names.get((body.name, port), port): stress for port, stress in moved.voltages.items()}
                    moved = replace(moved, voltages=of_ports)
                yield moved
            elif not isinstance(readout, (PassivePoint, StressStiffness, BodyDamping)):
                yield readout.projected(rows)
    if pictures:
        starts = np.cumsum([0, *(len(surface.points) for surface, _ in pictures)])
        surface = Surface(
            points=np.vstack([surface.points for surface, _ in pictures]),
            triangles=np.vstack([s.triangles + k for (s, _), k in zip(pictures, starts, strict=False)]),
            edges=np.vstack([s.edges + k for (s, _), k in zip(pictures, starts, strict=False)]),
            labels=tuple(label for surface, _ in pictures for label in surface.labels),
        )
        yield Picture(surface, np.concatenate([modes for _, modes in pictures]))


def _ports(scene: Scene) -> list[tuple[str, PortCoupling, str]]:
    """Return body, port and new name of all electrical ports, which names the body where others have the same."""
    found = [(body.name, port) for body in scene.flexible_bodies for port in body.reduced.ports]
    names = [port.name for _, port in found]
    return [(b, port, f"{b}/{port.name}" if names.count(port.name) > 1 else port.name) for b, port in found]


def _parts(coordinates: Coordinates, change: Array) -> Iterator[tuple[Body, Array]]:
    """Yield each body and its coordinates per unit of the new ones."""
    for body in coordinates.scene.bodies:
        yield body, change[coordinates.slices[body.name]]


def _motions(coordinates: Coordinates, points: dict[str, str]) -> Array:
    """Return the motions of the points along the scene's axes per unit of all coordinates, (6 r, n_all)."""
    return np.vstack([coordinates.motion(path) for path in points.values()])


def _point(scene: Scene, name: str, path: str) -> RemotePoint:
    return RemotePoint(name, (), scene.point_position(path))


def _symmetric(matrix: Array) -> Array:
    return 0.5 * (matrix + matrix.T)
