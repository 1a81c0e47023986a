"""Description of a scene as text: what is modelled, with how many coordinates, and what is left out."""

import re
from collections.abc import Collection, Mapping

import numpy as np

from nassim.base.checks import Array, of_kind
from nassim.base.progress import wrap_text
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.field_kinds import point_of
from nassim.scene.lever_arms import describe_arm
from nassim.scene.loop import Loop
from nassim.scene.part import Part
from nassim.scene.scene import Scene
from nassim.scene.terms import AppliedForce, CoilForce, ForceLaw, Output, Shunt
from nassim.simulation.model.constraints import Constraints
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.damping import damps, held_alone
from nassim.simulation.model.rigid_groups import RigidGroups, find_rigid_groups
from nassim.simulation.model.ties import loose_bodies
from nassim.simulation.model.trimming import trim_scene

DIRECTION = re.compile(r"\b(along|about) (?:[xyz]\b|\([^()]*\))")
"""A direction in the description of a part, which turns with a placed scene."""


def describe(scene: Scene) -> str:
    """Describe a scene as text: the model of each body with its coordinates, what is left out and why, and the wiring.

    Placed scenes with equal descriptions, such as six struts, are described once, with the directions of the first.

    Args:
        scene: the scene.

    Returns:
        The text.
    """
    of_kind("scene", scene, Scene, "print() describes a linear model")
    trimmed = trim_scene(scene)
    fewer, groups = {body.name: body for body in trimmed.flexible_bodies}, _groups(trimmed)
    entries = [(_placed_in(body.name), _body(scene, body, fewer, groups)) for body in scene.bodies]
    entries += [(_placed_in(part.name), _part(scene, part)) for part in scene.parts if not part.claims]
    entries += [
        (_placed_in(one.name), [f"sensor {one.name}: low-pass of order {one.order} at {one.bandwidth:g} Hz"])
        for one in scene.sensors
        if np.isfinite(one.bandwidth)
    ]
    alike = _alike(scene, entries)
    described = {name for others in alike.values() for name in others}
    often = {first: f" (x {1 + len(others)})" for first, others in alike.items()}
    inputs, outputs = (
        ", ".join(f"{name}{often.get(_placed_in(name), '')}" for name in names if _placed_in(name) not in described)
        for names in (scene.inputs, scene.outputs)
    )
    lines = [f"scene {scene.name!r}: inputs {inputs or 'none'}; outputs {outputs}"]
    for first, others in alike.items():
        own, *copies = (_lines(entries, name) for name in (first, *others))
        turned = "" if all(copy == own for copy in copies) else ", in other directions,"
        lines.append(f"  {first}/, and the same again{turned} {', '.join(f'{other}/' for other in others)}:")
        lines += [f"    {line}" for line in own]
    rest = [line for name, text in entries if name not in described and name not in alike for line in text]
    return "\n".join(map(_folded, [*lines, *(f"  {line}" for line in (*rest, *_rest(scene)))]))


def _folded(line: str) -> str:
    return wrap_text(line, next_indent=" " * (len(line) - len(line.lstrip()) + 6))


def _placed_in(name: str) -> str:
    """Return the name of the placed scene that a body, part or signal belongs to; empty for the scene's own."""
    return name.rpartition("/")[0]


def _within(line: str, placed: str) -> str:
    """Return a line as the placed scene itself would write it."""
    return re.sub(rf"(?<!\S){re.escape(placed)}/", "", line)


def _lines(entries: list[tuple[str, list[str]]], placed: str) -> list[str]:
    """Return the lines of a placed scene as it would write them itself."""
    return [_within(line, placed) for name, text in entries if name == placed for line in text]


def _alike(scene: Scene, entries: list[tuple[str, list[str]]]) -> dict[str, list[str]]:
    """Return placed scenes with equal descriptions but for directions: the first one -> the others."""
    found: dict[tuple[str, ...], list[str]] = {}
    for placed in dict.fromkeys(name for name, _ in entries if name):
        lines = [DIRECTION.sub(r"\1", line) for line in _lines(entries, placed)]
        lines += sorted(_within(name, placed) for name in (*scene.inputs, *scene.outputs) if _placed_in(name) == placed)
        found.setdefault(tuple(lines), []).append(placed)
    return {first: others for first, *others in found.values() if others}


def _groups(scene: Scene) -> RigidGroups:
    """Return the rigid groups of a scene; in small motion joints leave fewer coordinates without them."""
    if scene.in_small_motion:
        return RigidGroups({}, frozenset(), {}, {})
    with np.errstate(divide="ignore", invalid="ignore"):  # a body without mass is described too
        constraints = Constraints.of(Coordinates.of(scene))
    return find_rigid_groups(constraints, bending=scene.at_rest or bool(scene.speeds))


def _body(scene: Scene, body: Body, fewer: Mapping[str, FlexibleBody], groups: RigidGroups) -> list[str]:
    if isinstance(body, FlexibleBody) and body.deforms:
        first, *more = _flexible(scene, body, fewer[body.name], groups.grounded.get(body.name, ()))
        return [f"{body.name}: {first}; {_mass(body)}", *(f"  {line}" for line in (*more, *_ports(scene, body)))]
    if not body.moves:
        return [f"{body.name}: fixed"]
    reason = "; the others left out by its fidelity" if isinstance(body, FlexibleBody) else ""
    leader = groups.leaders.get(body.name, body.name)
    if leader in groups.hosts:
        host, _, point = groups.hosts[leader].partition(".")
        carried = f"part of {host}, whose {point} carries it: no coordinates of its own"
        return [f"{body.name}: rigid, {carried}{reason}; {_mass(body)}"]
    if not scene.body(leader).moves:
        return [f"{body.name}: rigid, held rigidly to {leader}, which is fixed{reason}; {_mass(body)}"]
    count = len(groups.groups.get(leader, ()))
    shared = f" shared by {count} bodies that rigid joints make one" if count > 1 else ""
    return [f"{body.name}: rigid, 6 coordinates{shared}{reason}; {_mass(body)}"]


def _part(scene: Scene, part: Part) -> list[str]:
    text = part.describe()
    return [text + describe_arm(scene, part)] if text else []


def _mass(body: Body) -> str:
    return f"{body.rigid_inertia[0]:.4g} kg"


def _flexible(scene: Scene, body: FlexibleBody, fewer: FlexibleBody, grounded: Collection[str]) -> list[str]:
    n, points, p = len(fewer.mass_matrix), fewer.reduced.point_names, fewer.reduced.n_modes
    kind = "floating frame" if body.fidelity == "ffrf" else "linear"
    limit = fewer.reduced.valid_frequency
    complete = f", complete up to {limit:.4g} Hz" if np.isfinite(limit) else ""
    if fewer.reduced.enriched is None and not fewer.reduced.full_integrals:  # imported
        complete = ", complete up to an unknown frequency"
    lines = [f"{kind}, {n} coordinates: {', '.join(points)} x 6 + {p} modes and load shapes{complete}"]
    if grounded:
        kept = n - 6 * len(grounded)
        lines.append(f"held rigidly to the ground by {', '.join(sorted(grounded))}, which leaves {kept} coordinates")
    if len(body.mass_matrix) > n:
        idle = ", ".join(name for name in body.reduced.point_names if name not in points) or "none"
        lines.append(
            f"left out: {len(body.mass_matrix) - n} coordinates: points that no joint holds ({idle}) and modes above "
            f"{scene.cutoff_frequency:g} Hz; static answers to the stacks are kept"
        )
    used = {scene.frame_point(body), *_used_points(scene, body)}
    idle_points = [name for name in points if name not in used]
    if idle_points:
        lines.append(f"nothing uses {', '.join(idle_points)}: a cutoff_frequency would condense them")
    if body.reduced.damping_matrix is not None:
        lines.append("own damping: of the bodies and dampers of which it was made")
    if body.damping_ratio is not None:
        held = " and ".join(f"{point} clamped" for point in held_alone(scene, body)) or "free"
        lines.append(f"own damping: {_ratios(np.atleast_1d(body.damping_ratio))}, {held}")
    return lines


def _used_points(scene: Scene, body: FlexibleBody) -> set[str]:
    measures = scene.measures_of(AppliedForce, CoilForce, Output, ForceLaw)
    paths = [path for measure in measures for path in measure.points if scene.split(path)[0] is body]
    return {*scene.held_points(body), *(point_of(path) for path in paths)}


def _ports(scene: Scene, body: FlexibleBody) -> list[str]:
    wired = {path: part.describe() for part in scene.parts for path in part.claims}
    names = [port.name for port in body.reduced.ports]
    return [f"port {name}: {wired.get(f'{body.name}.{name}', 'short-circuited')}" for name in names]


def _rest(scene: Scene) -> list[str]:
    """Describe bodies that nothing holds, damping, gravity and loops."""
    bodies = any(body.is_damped for body in scene.deformable_bodies)
    modes = _ratios(scene.mode_ratios) + ("; plus the bodies' own" if bodies else "")
    dampers = any(damps(term) for term in scene.terms_of(ForceLaw))
    others = dampers or any(isinstance(term, (Shunt, CoilForce)) for term in scene.terms) or scene.loops
    pull = " ".join(f"{g:g}" for g in scene.gravity)
    loose = ", ".join(loose_bodies(scene))
    return [
        *([f"not held: no joint and no spring connects {loose} to a fixed body"] if loose else []),
        f"damping: {modes}" + ("; plus dampers and loops" if others else ""),
        f"gravity: {pull} m/s2" if np.any(scene.gravity) else "gravity: none",
        *(_loop(scene, loop) for loop in scene.loops),
    ]


def _loop(scene: Scene, loop: Loop) -> str:
    """Describe a loop: signals, timing, set points, and the ranges and resolutions of its converters."""
    read = "/".join(dict.fromkeys(map(scene.output_unit, loop.measured)))
    written = "/".join(dict.fromkeys(map(scene.input_unit, loop.driven)))
    delay = loop.controller.delay
    parts = [
        f"loop {loop.name}: {', '.join(loop.measured)} to {', '.join(loop.driven)} at "
        f"{loop.controller.sample_rate:g} Hz",
        f"{delay} sample{'s' * (delay != 1)} of delay",
        f"reference {', '.join(loop.reference)}" if loop.reference else "",
        "with feedforward" if loop.feedforward else "",
        f"noise {', '.join(loop.noise)}" if loop.noise else "",
        f"limit {loop.controller.limit:g} {written}" if loop.controller.limit < np.inf else "",
        f"reads in steps of {loop.input_step:g} {read}" if loop.input_step else "",
        f"reads up to {loop.input_limit:g} {read}" if loop.input_limit < np.inf else "",
        f"drives in steps of {loop.output_step:g} {written}" if loop.output_step else "",
    ]
    return ", ".join(filter(None, parts))


def _ratios(ratios: Array) -> str:
    percent = [f"{100 * ratio:g} %" for ratio in ratios]
    if len(percent) > 1:
        return f"{', '.join(percent)} of critical in the first elastic modes, {percent[-1]} in all others"
    return f"{percent[0]} of critical in every elastic mode" if np.any(ratios) else "none in modes"
