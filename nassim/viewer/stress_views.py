"""Views of the von Mises stress on a body's surface: of one state in bands, of a motion as it changes."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from nassim.base.checks import finite_array, known, positive
from nassim.base.field_types import ArrayLike
from nassim.bodies.readouts import Surface, readouts_of
from nassim.bodies.reduced_body import ReducedBody
from nassim.bodies.stress import StressField, von_mises
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.motion import Motion
from nassim.scene.port_voltages import stressing_voltages
from nassim.viewer.forms import scene_form
from nassim.viewer.marks import point_mark
from nassim.viewer.view_content import SAME_TICK, Coloring, Form, Shape, View, round_step
from nassim.viewer.views import thinned

COLORS = (
    "#3d358b",
    "#477bf2",
    "#28bceb",
    "#20eaac",
    "#79fe59",
    "#c3f134",
    "#f6c33a",
    "#fb7e21",
    "#dd3d08",
    "#a11201",
)
"""Colours of the bands from the lowest: A. Mikhailov, Turbo, an improved rainbow colormap (2019)."""
ABOVE = "#ff00ff"
"""Colour of stress above the largest that is shown."""


@dataclass(frozen=True)
class _Banded(Form):
    """A surface whose labels are bands of stress."""

    @property
    def labels(self) -> tuple[str, ...]:
        """The bands from the highest, as a legend lists them."""
        return tuple(sorted(set(self.surface.labels), key=_lower_end, reverse=True))


def view_stress(
    body: ReducedBody,
    coordinates: ArrayLike,
    *,
    place: str = "stress",
    voltages: Mapping[str, float] | None = None,
    largest: float | None = None,
) -> View:
    """Return a view of the von Mises stress on a body's surface in one state: at rest under loads, of a mode, in a run.

    The surface has a part for each band of stress, up to ten between round numbers, so that the list of parts is a
    legend in MPa. Pages can hide bands. Triangles have the mean of their corners.

    Args:
        body: the reduced body.
        coordinates: its coordinates, (n,): an entry of `Motion.coordinates`, or a mode times an amplitude.
        place: name of the body's `StressSurface`.
        voltages: voltages of its electrical ports, by name [V]; 0 for a shorted one. Those of ports that stress the
            surface must be given.
        largest: stress at the upper end of the bands, by which views compare [Pa] (default: a round one above the
            largest of this state). What is above has a colour of its own.

    Raises:
        ValueError: for a body that keeps no stress on a surface, for an unknown place or port, and for a port that
            stresses the surface and has no voltage given.
    """
    field, surface = _surface_stress(body, place)
    q = finite_array("coordinates", coordinates, (field.n_coordinates,))
    corners = von_mises(field.stress(q, stressing_voltages(body, [field], voltages, {})))
    peak = int(np.argmax(corners))
    top = _upper_end(float(corners[peak]), largest)
    step = round_step(top)
    ends = np.append(step * np.arange(np.ceil((1 - SAME_TICK) * top / step)), top)
    values = 1e-6 * corners[surface.triangles].mean(axis=1)
    bands = np.searchsorted(ends, values, side="right") - 1
    if largest is None:
        bands = np.minimum(bands, len(ends) - 2)
    names = [f"{low:.4g} to {high:.4g} MPa" for low, high in itertools.pairwise(ends)]
    colors = [COLORS[k] for k in np.rint(np.linspace(0, len(COLORS) - 1, len(names))).astype(int)]
    names.append(f"{top:.4g} MPa and above")
    points = body.all_point_names
    form = _Banded(
        replace(surface, labels=tuple(names[band] for band in bands.tolist())),
        points,
        np.array([body.point(name).position for name in points]).reshape(-1, 3),
    )
    error = float(field.mesh_error(q)[peak])
    title = f"{body.name}: von Mises stress up to {1e-6 * corners[peak]:.4g} MPa (mesh: +-{1e-6 * error:.2g} MPa)"
    shape = Shape(body.name, form, colors=dict(zip(names, (*colors, ABOVE), strict=True)))
    return View(title, (shape,), tuple(point_mark(point, body.name) for point in body.remote_points))


def view_stress_motion(
    body: Body,
    motion: Motion,
    *,
    place: str = "stress",
    voltages: Mapping[str, ArrayLike] | None = None,
    largest: float | None = None,
    frames: int = 300,
) -> View:
    """Return a view of the von Mises stress on a body's surface during a motion, for playback.

    Args:
        body: the flexible body of the scene.
        motion: the motion, as of `simulate_motion`.
        place: name of the body's `StressSurface`.
        voltages: voltages of its electrical ports, by name [V]: numbers, or one value per time of the motion; in place
            of those that the motion knows.
        largest: stress at the upper end of the colours [Pa] (default: a round one above the largest of the motion).
        frames: largest number of images, at evenly spaced times of the motion.

    Raises:
        ValueError: for a rigid body, for one that keeps no stress on a surface, for an unknown place or port, for a
            body that the motion leaves out, and for a port that stresses the surface and has no known voltage.
    """
    if not isinstance(body, FlexibleBody):
        raise ValueError(f"body {body.name!r} is rigid, so it has no stress")
    field, surface = _surface_stress(body.reduced, place)
    known("flexible body of the motion", body.name, motion.coordinates)
    shown = thinned(motion.select([body.name]), frames)
    all_volts = stressing_voltages(body.reduced, [field], voltages, motion.voltages.get(body.name, {}))
    volts = {
        name: np.interp(shown.time, motion.time, np.broadcast_to(np.asarray(value, dtype=float), len(motion.time)))
        for name, value in all_volts.items()
    }
    stress = von_mises(field.stress(shown.coordinates[body.name], volts))
    top = _upper_end(float(stress.max()), largest)
    whole = scene_form(body)
    modes = None
    if whole.modes is not None and len(whole.surface.points):
        nearest = cKDTree(whole.surface.points).query(surface.points)[1]
        modes = np.concatenate([whole.modes[nearest], whole.modes[len(whole.surface.points) :]])
    shape = Shape(
        body.name,
        Form(surface, whole.names, whole.positions, modes),
        body.position,
        body.rotation,
        coloring=Coloring("von Mises stress [MPa]", 1e-6 * stress, top),
    )
    title = f"{body.name}: von Mises stress up to {1e-6 * float(stress.max()):.4g} MPa"
    return View(
        title, (shape,), tuple(point_mark(point, body.name) for point in body.reduced.remote_points), motion=shown
    )


def _upper_end(found: float, largest: float | None) -> float:
    """Return the upper end of the colours: that given, or a round one above the stress found, both in Pa [MPa]."""
    if largest is not None:
        return 1e-6 * positive("largest", largest, "Pa")
    highest = 1e-6 * found or 1.0
    step = round_step(highest)
    return float(step * np.ceil((1 - SAME_TICK) * highest / step))


def _surface_stress(body: ReducedBody, place: str) -> tuple[StressField, Surface]:
    """Return the stress of a body on a surface, and the surface."""
    fields = {field.name: field for field in readouts_of(body.readouts, StressField) if field.surface is not None}
    field = fields[known(f"stress surface of body {body.name!r}", place, fields)]
    assert field.surface is not None
    return field, field.surface


def _lower_end(band: str) -> float:
    """Return the number with which the name of a band begins."""
    return float(band.partition(" ")[0])
