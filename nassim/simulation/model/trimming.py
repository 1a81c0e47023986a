"""Trimming: scenes whose bodies are reduced to what their parts need below a cut-off frequency."""

from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np

from nassim.base.checks import Array
from nassim.bodies.projection import keep_ports, remove_surface, trim_body
from nassim.bodies.reduced_body import ReducedBody
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.field_kinds import point_of
from nassim.scene.measures import Measure
from nassim.scene.scene import Scene
from nassim.scene.terms import AppliedForce, CoilForce, ForceLaw, Output, Shunt, Term
from nassim.simulation.model.damping import held_alone
from nassim.simulation.model.states import ReferenceState


def trim_scene(scene: Scene) -> Scene:
    """Reduce the bodies of a scene further, to what its parts need below its cut-off frequency.

    Remote points that nothing holds are no longer coordinates; static responses to the stacks stay exact.

    Args:
        scene: the scene; without a cut-off frequency it is returned as it is.

    Returns:
        The scene with trimmed bodies, without a cut-off frequency.

    Raises:
        ValueError: for a body with damping ratios by mode above the cut-off frequency, which would become those of
            other modes.
    """
    if scene.cutoff_frequency is None:
        return scene
    shared: dict[tuple[Hashable, ...], ReducedBody] = {}
    bodies = tuple(_trimmed(scene, body, scene.cutoff_frequency, shared) for body in scene.bodies)
    return replace(scene, bodies=bodies, cutoff_frequency=None)


def without_pictures(scene: Scene) -> Scene:
    """Remove the bodies' surfaces from a scene: trimming them costs more than everything else."""
    reduced = {id(body.reduced): body.reduced for body in scene.bodies if isinstance(body, FlexibleBody)}
    plain = {number: remove_surface(body) for number, body in reduced.items()}
    bodies = [
        replace(body, reduced=plain[id(body.reduced)]) if isinstance(body, FlexibleBody) else body
        for body in scene.bodies
    ]
    return replace(scene, bodies=tuple(bodies))


def with_enriched_bodies(scene: Scene) -> Scene:
    """Replace reduced bodies by their `enriched` form, where they have one, without a cut-off frequency."""
    richer = {
        body.name: replace(body, reduced=body.reduced.enriched)
        for body in scene.flexible_bodies
        if body.reduced.enriched is not None
    }
    bodies = [richer.get(body.name, body) for body in scene.bodies]
    return replace(scene, bodies=bodies, cutoff_frequency=None)


def _trimmed(
    scene: Scene, body: Body, cutoff_frequency: float, shared: dict[tuple[Hashable, ...], ReducedBody]
) -> Body:
    """Return a trimmed body; equal bodies that the scene uses in the same way share one reduced body of `shared`."""
    if not body.deforms:
        return body
    assert isinstance(body, FlexibleBody)
    below = body.reduced.eigenfrequencies(fixed=held_alone(scene, body)) < cutoff_frequency
    given = () if body.damping_ratio is None else np.atleast_1d(body.damping_ratio)
    if len(given) > np.count_nonzero(below) + 1:
        raise ValueError(
            f"body {body.name!r} has damping ratios by mode, and cutoff_frequency removes its modes above "
            f"{cutoff_frequency:g} Hz, so the ratios would be those of other modes: trim it before, by trim_body of "
            "nassim.bodies, then give it its damping"
        )
    used = {point_of(path) for part in scene.parts for path in part.claims if scene.split(path)[0] is body}
    ports = [port for port in body.reduced.ports if port.name in used]
    points = frozenset({scene.frame_point(body), *scene.held_points(body)})
    loads = _loads(scene, body.name, [port.forces for port in ports])
    key = id(body.reduced), tuple(port.name for port in ports), points, loads.shape, loads.tobytes()
    if key not in shared:
        reduced = keep_ports(body.reduced, used)
        shared[key] = trim_body(reduced, points=points, loads=loads, cutoff_frequency=cutoff_frequency)
    return replace(body, reduced=shared[key], frame=scene.frame_point(body))


def _loads(scene: Scene, name: str, ports: Sequence[Array]) -> Array:
    """Return the rows on a body's own coordinates that terms use, (n, k), without those of its ports."""
    found, states = list(ports), {body.name: ReferenceState(body) for body in scene.bodies}
    for measure in _measures(scene.terms):
        if name in measure.bodies:
            for row in measure.evaluate(states)[1][name]:
                if not any(np.array_equal(row, other) for other in found):
                    found.append(row)
    n = len(scene.body(name).mass_matrix)
    return np.column_stack([np.zeros((n, 0)), *found[len(ports) :]])


def _measures(terms: Sequence[Term]) -> list[Measure]:
    """Return the measures of terms that push, resist or record; points of joints are retained whole."""
    return [term.measure for term in terms if isinstance(term, (AppliedForce, CoilForce, ForceLaw, Output, Shunt))]
