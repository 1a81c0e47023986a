"""Views of solids, meshes, bodies and their modes, and of scenes at rest, in modes and in motion."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from nassim.base.checks import Array, known, of_kind, whole_number
from nassim.base.rigid_motion import rotated_motion
from nassim.base.warning_log import warn
from nassim.bodies.readouts import Surface
from nassim.bodies.reduced_body import ReducedBody, error_text
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.motion import Motion
from nassim.scene.scene import Scene
from nassim.simulation.loaded.buckling_factors import buckling_factors
from nassim.simulation.model.recorded_motion import scene_modes
from nassim.viewer.forms import MATERIALS, body_form, bushing_sides, label_colors, scene_form
from nassim.viewer.marks import point_mark, scene_marks
from nassim.viewer.view_content import Form, Mark, Mode, Shape, View

LIFT = 0.003
"""Distance of the number of a face from the face, over the size."""
MOST_TURNED = 1 / 3
"""Largest rotation of a drive from image to image [turns]."""

if TYPE_CHECKING:
    from nassim.bodies.remote_points import RemotePoint
    from nassim.fem.fe_model import FEModel
    from nassim.fem.solid import Solid


def view_solid(solid: "Solid") -> View:
    """Return a view of a CAD object with its remote points and their faces.

    Args:
        solid: the CAD object.
    """
    from nassim.fem.tessellation import solid_surface  # noqa: PLC0415  loads OpenCASCADE

    return _at_rest(solid.name, solid_surface(solid), solid.remote_points, "CAD")


def view_faces(solid: "Solid") -> View:
    """Return a view of the outer faces of a CAD object with their numbers.

    Args:
        solid: the CAD object.
    """
    from nassim.fem.faces import list_faces  # noqa: PLC0415  loads OpenCASCADE
    from nassim.fem.tessellation import face_surface  # noqa: PLC0415

    surface = face_surface(solid.shape)
    faces = [face for face in list_faces(solid.shape) if len(face.bodies) == 1]
    lift = LIFT * np.ptp(surface.points, axis=0).max()
    numbers = tuple(str(face.number) for face in faces)
    form = Form(surface, numbers, np.array([face.place + lift * face.normal for face in faces]))
    pale = label_colors(replace(surface, labels=tuple(face.bodies[0] for face in faces)), ())
    shape = Shape(solid.name, form, colors={str(face): face.colour or pale[face.bodies[0]] for face in faces})
    marks = tuple(
        Mark(number, "face", ((solid.name, number),), text=str(face).partition(": ")[2])
        for number, face in zip(numbers, faces, strict=True)
    )
    return View(f"{solid.name}: faces", (shape,), marks)


def view_mesh(fe_model: "FEModel") -> View:
    """Return a view of the outer faces of a mesh with its remote points and their faces.

    Args:
        fe_model: the FE model.

    Raises:
        ValueError: for a model without a mesh.
    """
    if fe_model.surface is None:
        raise ValueError(f"FE model {fe_model.name!r} has no surface to draw: it was not made from a mesh")
    return _at_rest(fe_model.name, fe_model.surface, fe_model.remote_points, fe_model.description)


def view_body(body: ReducedBody) -> View:
    """Return a view of a reduced body with its remote points and their faces, or of rods between these.

    A body without a surface appears as rods from its centre of mass to its points.

    Args:
        body: the reduced body.
    """
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
    """Return a view of modes of a body, or of given motions.

    Pages say the estimated errors of the frequency of each elastic mode, where the body knows them.

    Args:
        body: the reduced body.
        shapes: coordinates of the body by name, (n_coordinates,) each (default: the first n modes).
        fixed: see `ReducedBody.eigenmodes`.
        guided: see `ReducedBody.eigenmodes`.
        masses: see `ReducedBody.eigenmodes` [kg].
        n: number of modes.
    """
    if shapes is None:
        frequency, vectors = body.eigenmodes(fixed=fixed, guided=guided, masses=masses, n=n)
        held = [f"{', '.join(fixed)} held"] * bool(fixed)
        held += [f"{point} free along {direction}" for point, direction in (guided or {}).items()]
        held += [f"{mass:g} kg at {point}" for point, mass in (masses or {}).items()]
        title = f"{body.name}: {', '.join(held) or 'free'}"
        texts = _error_texts(body, fixed=fixed, guided=guided, masses=masses, n=n) or [""] * len(frequency)
        modes = tuple(
            Mode(_mode_name(k, f), {body.name: vector}, rigid=f == 0, text=text if f else "")
            for k, (f, vector, text) in enumerate(zip(frequency, vectors.T, texts, strict=True))
        )
    else:
        title = body.name
        modes = tuple(Mode(name, {body.name: vector}) for name, vector in shapes.items())
    return replace(view_body(body), title=title, modes=modes)


def _error_texts(body: ReducedBody, **held: Any) -> list[str]:
    """Return the estimated errors of each eigenfrequency as text, none if nothing is known."""
    known: dict[str, Array] = {}
    if body.enriched is not None:
        known["truncation"] = body.truncation_errors(**held)
    if body.released_stiffness is not None:
        known["discretisation"] = body.discretization_errors(**held)
    rows = zip(*known.values(), strict=True)
    texts = (", ".join(f"{kind} {error_text(e)}" for kind, e in zip(known, row, strict=True)) for row in rows)
    return [f"estimated errors: {text}" for text in texts]


def view_scene(scene: Scene, *, looks: Mapping[str, Surface] | None = None) -> View:
    """Return a view of a scene at rest: bodies, joints with their free axes, springs, actuators and sensors.

    Flexible bodies, also trimmed ones, appear with their surface, and those without one, such as imported bodies, as
    rods from the centre of mass to the points. Rigid bodies without a given surface appear as a box of equal inertia.
    Two of them whose centres coincide in a bushing appear as the halves of a flexible joint, two cones along its
    stiffest axis.

    Args:
        scene: the scene.
        looks: surfaces of rigid bodies by name, around the centre of mass and along the axes of the body; see `block`,
            `cylinder` and `nassim.fem.solid_surface`.

    Raises:
        ValueError: for looks of bodies that are unknown or flexible.
    """
    return View(scene.name, _scene_shapes(scene, looks), scene_marks(scene))


def view_scene_modes(scene: Scene, *, n: int = 12, looks: Mapping[str, Surface] | None = None) -> View:
    """Return a view of the first modes of small motion of a scene, undamped, with inputs at zero.

    The modes are those of the reference configuration and include rigid-body modes. The stiffness that gravity and spin
    add is left out, as the title tells: a pendulum does not swing. `mode_motion` has the modes about the equilibrium.

    Args:
        scene: the scene.
        n: number of modes.
        looks: see `view_scene`.
    """
    frequency, moved = scene_modes(scene, n=n)
    names = [_mode_name(k, f) for k, f in enumerate(frequency)]
    left_out = ["gravity"] * bool(np.any(scene.gravity)) + ["rotation"] * bool(scene.speeds)
    what = f"modes without {' and '.join(left_out)}" if left_out else "modes"
    view = _in_shapes(scene, what, names, moved, looks)
    return replace(view, modes=tuple(replace(m, rigid=f == 0) for m, f in zip(view.modes, frequency, strict=True)))


def view_buckling(
    scene: Scene,
    *,
    inputs: Mapping[str, float] | None = None,
    n: int = 1,
    looks: Mapping[str, Surface] | None = None,
) -> View:
    """Return a view of the shapes in which a scene buckles under gravity and constant inputs.

    Args:
        scene: the scene.
        inputs: see `nassim.simulation.buckling_factors`.
        n: number of shapes.
        looks: see `view_scene`.
    """
    factors, moved = buckling_factors(scene, inputs=inputs, n=n)
    names = [f"shape {k + 1}: {factor:.4g} times the loads" for k, factor in enumerate(factors)]
    return _in_shapes(scene, "buckling", names, moved, looks)


def view_motion(scene: Scene, motion: Motion, *, frames: int = 300, looks: Mapping[str, Surface] | None = None) -> View:
    """Return a view of the motion of a scene for playback.

    Args:
        scene: the scene.
        motion: result of `simulate_motion`, or the motion of a mode, also of a spinning scene, from `mode_motion`.
        frames: largest number of images, at evenly spaced times of the motion.
        looks: see `view_scene`.

    Raises:
        ValueError: for frames that is not a whole number of at least 1, and for a motion of other bodies.
    """
    of_kind("motion", motion, Motion, "simulate_motion returns one beside the record")
    shown = thinned(motion, frames)
    _warn_of_aliasing(scene, motion.time[-1] - motion.time[0], len(shown.time))
    return View(scene.name, _scene_shapes(scene, looks), scene_marks(scene), motion=shown)


def thinned(motion: Motion, frames: int) -> Motion:
    """Return a motion at a number of its times at most, evenly spaced.

    Args:
        motion: the motion.
        frames: largest number of times.

    Raises:
        ValueError: for a number of images that is not a whole number of at least 1.
    """
    last = len(motion.time) - 1
    n_images = min(whole_number("frames", frames, 1), last + 1)
    kept = np.unique(np.round(np.linspace(0, last, n_images)).astype(int))
    return motion.at(kept)


def _warn_of_aliasing(scene: Scene, duration: float, frames: int) -> None:
    """Warn of drives that turn too far between two images to be seen turning."""
    turns = max((abs(term.speed) for term in scene.speeds if term.unit == "rad"), default=0.0) / (2 * np.pi)
    if frames > 1 and turns * duration > MOST_TURNED * (frames - 1):
        warn(
            f"a drive of scene {scene.name!r} turns by more than a third of a turn from image to image, so the page "
            f"shows another rotation: take {int(np.ceil(turns * duration / MOST_TURNED)) + 1} images, or a shorter run"
        )


def _in_shapes(
    scene: Scene, what: str, names: Sequence[str], moved: Mapping[str, Array], looks: Mapping[str, Surface] | None
) -> View:
    """Return a view of shapes of a scene; moved: by body, coordinates as `scene_modes` returns them."""
    moving = [body for body in scene.bodies if body.name in moved]
    modes = tuple(
        Mode(name, {body.name: _own(body, moved[body.name][:, k]) for body in moving}) for k, name in enumerate(names)
    )
    return View(f"{scene.name}: {what}", _scene_shapes(scene, looks), scene_marks(scene), modes)


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
    """Return the shapes of a scene.

    Copies of one reduced body share its form, and rigid bodies with one name in several placed scenes share a colour.
    """
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
    """Return the coordinates of a body's form, which are along the body's axes, from those of the scene."""
    if isinstance(body, FlexibleBody):
        return coordinates
    return rotated_motion(body.rotation.T) @ coordinates


def _mode_name(k: int, frequency: float) -> str:
    return f"mode {k + 1}: " + (f"{frequency:.5g} Hz" if frequency else "rigid-body mode")
