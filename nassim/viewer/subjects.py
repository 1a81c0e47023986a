"""Views of what the chain makes: solids, meshes, bodies and their modes, scenes at rest, vibrating and in motion."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from nassim.base.checks import Array, known
from nassim.bodies.readouts import Surface
from nassim.bodies.reduced_body import ReducedBody
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.motion import Motion
from nassim.scene.scene import Scene
from nassim.simulation.model.recorded_motion import scene_modes
from nassim.viewer.forms import MATERIALS, body_form, bushing_sides, label_colors, scene_form
from nassim.viewer.marks import point_mark, scene_marks
from nassim.viewer.views import Form, Mode, Shape, View

if TYPE_CHECKING:
    from nassim.bodies.interface import RemotePoint
    from nassim.fem.fe_model import FEModel
    from nassim.fem.solid import Solid


def view_solid(solid: "Solid") -> View:
    """A CAD object with its remote points and their faces."""
    from nassim.fem.tessellation import solid_surface  # noqa: PLC0415  loads OpenCASCADE

    return _at_rest(solid.name, solid_surface(solid), solid.remote_points, "CAD")


def view_mesh(fe_model: "FEModel") -> View:
    """The outer faces of a mesh with its remote points and their faces.

    Raises ValueError for a model that has none, because it was made by hand.
    """
    if fe_model.surface is None:
        raise ValueError(f"FE model {fe_model.name!r} has no surface to draw: it was not made from a mesh")
    return _at_rest(fe_model.name, fe_model.surface, fe_model.remote_points, fe_model.description)


def view_body(body: ReducedBody) -> View:
    """A reduced body with its remote points and their faces; one without a surface as rods between these."""
    shape = _body_shape(body)
    return View(body.name, (shape,), tuple(point_mark(point, body.name) for point in body.remote_points))


def view_modes(
    body: ReducedBody,
    shapes: Mapping[str, Array] | None = None,
    *,
    fixed: Collection[str] = (),
    guided: Mapping[str, str] | None = None,
    masses: Mapping[str, float] | None = None,
    n: int = 6,
) -> View:
    """Motions of a body to choose from: its first n modes, or `shapes`.

    shapes: coordinates of the body by the name of what they are, (n_coordinates,) each; the other arguments are those
        of `ReducedBody.eigenmodes`
    """
    if shapes is None:
        frequency, vectors = body.eigenmodes(fixed=fixed, guided=guided, masses=masses, n=n)
        held = [f"{', '.join(fixed)} held"] * bool(fixed)
        held += [f"{point} free along {direction}" for point, direction in (guided or {}).items()]
        held += [f"{mass:g} kg at {point}" for point, mass in (masses or {}).items()]
        title = f"{body.name}: {', '.join(held) or 'free'}"
        shapes = {_mode_name(k, f): vector for k, (f, vector) in enumerate(zip(frequency, vectors.T, strict=True))}
    else:
        title = body.name
    modes = tuple(Mode(name, {body.name: vector}) for name, vector in shapes.items())
    return replace(view_body(body), title=title, modes=modes)


def view_scene(scene: Scene, *, looks: Mapping[str, Surface] | None = None) -> View:
    """A scene at rest: its bodies, joints with the axes that they leave free, springs, actuators and sensors.

    Flexible bodies look like their surface, trimmed ones too, and those that have none, such as imported ones, like
    rods from the centre of mass to the points.
    looks: surfaces of rigid bodies by name, around the centre of mass and along the body's axes, see `block`,
        `cylinder` and `nassim.fem.solid_surface`; others look like a box of their inertia, or, where a bushing holds
        two together in the centre of both, as halves of a flexible joint, like two cones along its stiffest axis
    Raises ValueError for looks of bodies that are unknown or flexible.
    """
    return View(scene.name, _scene_shapes(scene, looks), scene_marks(scene))


def view_scene_modes(scene: Scene, *, n: int = 12, looks: Mapping[str, Surface] | None = None) -> View:
    """A scene's first n modes of small motion about its start, free motions included; undamped, inputs at zero.

    looks: see `view_scene`
    """
    frequency, moved = scene_modes(scene, n=n)
    moving = [body for body in scene.bodies if body.name in moved]
    modes = tuple(
        Mode(_mode_name(k, f), {body.name: _own(body, moved[body.name][:, k]) for body in moving})
        for k, f in enumerate(frequency)
    )
    return View(f"{scene.name}: modes", _scene_shapes(scene, looks), scene_marks(scene), modes)


def view_motion(scene: Scene, motion: Motion, *, frames: int = 300, looks: Mapping[str, Surface] | None = None) -> View:
    """A scene's motion, played back.

    motion: from `simulate_motion`, or one of a mode, also of a scene that spins, from `mode_motion`
    frames: how many of its times are kept at most, evenly
    looks: see `view_scene`
    """
    if frames < 1:
        raise ValueError(f"frames must be 1 or more, got {frames}")
    last = len(motion.time) - 1
    kept = np.unique(np.round(np.linspace(0, last, min(frames, last + 1))).astype(int))
    fields = {"positions": motion.positions, "rotations": motion.rotations, "coordinates": motion.coordinates}
    thinned = {field: {name: values[kept] for name, values in given.items()} for field, given in fields.items()}
    shapes = _scene_shapes(scene, looks)
    return View(scene.name, shapes, scene_marks(scene), motion=Motion(motion.time[kept], **thinned))


def _at_rest(name: str, surface: Surface, points: "tuple[RemotePoint, ...]", text: str) -> View:
    names = tuple(point.name for point in points)
    form = Form(surface, names, np.array([point.position for point in points]).reshape(-1, 3))
    shape = Shape(name, form, colors=label_colors(surface, names), text=text)
    return View(name, (shape,), tuple(point_mark(point, name) for point in points))


def _body_shape(body: ReducedBody) -> Shape:
    form = body_form(body)
    text = f"{1e3 * body.mass:.4g} g, {len(body.mass_matrix)} coordinates"
    return Shape(body.name, form, colors=label_colors(form.surface, body.all_point_names), text=text)


def _scene_shapes(scene: Scene, looks: Mapping[str, Surface] | None) -> tuple[Shape, ...]:
    """Bodies that are copies of one reduced body share its form, rigid ones of one name in several scenes a colour."""
    looks = looks or {}
    for name in looks:
        known("body", name, [body.name for body in scene.bodies])
    forms: dict[int, Form] = {}
    shapes = []
    roles: dict[str, str] = {}
    sides = bushing_sides(scene)
    for body in scene.bodies:
        if isinstance(body, FlexibleBody) and body.name not in looks:
            form = forms.setdefault(id(body.reduced), scene_form(body))
            colors = label_colors(form.surface, body.reduced.all_point_names)
            text = f"{1e3 * body.reduced.mass:.4g} g, flexible ({body.fidelity})"
        else:
            form = scene_form(body, looks.get(body.name), sides.get(body.name))
            color = roles.setdefault(body.name.rpartition("/")[2], MATERIALS[len(roles) % len(MATERIALS)])
            colors = dict.fromkeys(form.surface.labels, color)
            text = _rigid_text(body)
        shapes.append(Shape(body.name, form, body.position, body.rotation, colors, text))
    return tuple(shapes)


def _rigid_text(body: Body) -> str:
    return f"{body.rigid_inertia[0]:.4g} kg, rigid" if body.moves else "fixed"


def _own(body: Body, coordinates: Array) -> Array:
    """Coordinates of a body's form: along the body's axes, where a rigid body's are along the world's."""
    if isinstance(body, FlexibleBody):
        return coordinates
    result: Array = np.kron(np.eye(2), body.rotation.T) @ coordinates
    return result


def _mode_name(k: int, frequency: float) -> str:
    return f"mode {k + 1}: " + (f"{frequency:.5g} Hz" if frequency else "free motion")
