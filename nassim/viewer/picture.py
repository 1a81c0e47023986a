"""Pictures of a view for reports, rendered off screen. This is the only module that uses PyVista."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nassim.base.checks import Array, finite_array, known, of_kind, positive, whole_number
from nassim.base.field_types import ArrayLike
from nassim.base.rigid_motion import unit_vector
from nassim.base.storage import write_atomically
from nassim.viewer.view_content import GREY, MARK_COLORS, Mark, View

CAMERA = (0.435, -0.819, 0.375)
"""Direction from the centre to the camera, the same as at the start of a page."""
SHARE = 0.06
"""Largest displacement of a mode in a picture over the size of the view, as on a page."""
LINE_COLOR, RESTING = "#23272e", "#8a94a3"
ROOM = 1.45
"""Size of a picture over that of the view; the margin is for names and motion."""
MOST_NAMES = 12
"""Largest number of marks, and of rows of a legend, that a picture names, because more names would overlap."""
ON_FACES, BEFORE_ALL = -4.0, -66000.0
"""Depth offsets in units of the smallest step: of lines on faces, and of marks, which lie inside bodies."""
MISSING = 'pictures of bodies need PyVista: pip install "nassim[viewer]"; pages of nassim.viewer do without'


def save_picture(
    view: View,
    path: str | Path,
    *,
    modes: str | Sequence[str] | None = None,
    frame: int | None = None,
    magnification: float = 1.0,
    mesh: bool = False,
    camera: ArrayLike = CAMERA,
    size: tuple[int, int] = (1200, 900),
) -> Path:
    """Write a view as a PNG file.

    Args:
        view: the view.
        path: file to write, with the ending .png.
        modes: name of a mode, or names of several modes, side by side (default: at rest).
        frame: index of an image of the motion (default: at rest).
        magnification: factor on the motion, or on the deformation only where shapes move far [-].
        mesh: show the lines of the mesh.
        camera: direction from the centre to the camera, (3,).
        size: width and height of the file, two whole numbers [pixels].

    Returns:
        Path of the file.

    Raises:
        ImportError: without PyVista.
        ValueError: for modes or images that the view does not have, for another ending, and for arguments out of range.
    """
    of_kind("view", view, View, "view_scene, view_modes and others make one")
    try:
        import pyvista  # noqa: PLC0415  an extra
    except ImportError as error:
        raise ImportError(MISSING) from error
    known("file ending", Path(path).suffix.lower(), (".png",))
    names = [modes] if isinstance(modes, str) or modes is None else [*modes]
    if not names:
        raise ValueError(f"name at least one mode; known: {', '.join(mode.name for mode in view.modes) or 'none'}")
    frame = None if frame is None else whole_number("frame", frame)
    pixels = finite_array("size of a picture", size, (2,)).tolist()
    width, height = (whole_number("size of a picture", length, 1) for length in pixels)
    drawings = [_drawing(view, name, frame, positive("magnification", magnification)) for name in names]
    columns = int(np.ceil(np.sqrt(len(names))))
    shape = (-(-len(names) // columns), columns)
    # VTK warns of a missing screen, although it can render without one.
    with pyvista.vtk_verbosity("off"), write_atomically(path) as temporary:
        plotter = pyvista.Plotter(off_screen=True, shape=shape, window_size=[width, height], border=False)
        plotter.set_background("white")
        for k, drawing in enumerate(drawings):
            plotter.subplot(*divmod(k, columns))
            _draw(pyvista, plotter, view, drawing, mesh=mesh, alone=len(names) == 1)
            _aim(plotter, view, unit_vector(camera))
            _draw_numbers(pyvista, plotter, view)
        buffer = io.BytesIO()
        plotter.screenshot(buffer)
        plotter.close()
        temporary.write_bytes(buffer.getvalue())
    return Path(path)


@dataclass(frozen=True)
class _Drawing:
    """Content of one picture.

    Attributes:
        title: title.
        points: positions of the points of each shape, (n, 3) [m].
        moves: whether it is an image of a mode or of a motion.
        quantity: quantity that colours show, for the scale; "" where they are those of the labels.
        values: values of the quantity at these points, (n,) each.
        ticks: figures of the scale, from 0 to the value at its upper end.
    """

    title: str
    points: Mapping[str, Array]
    moves: bool = False
    quantity: str = ""
    values: Mapping[str, Array] = field(default_factory=dict)
    ticks: tuple[float, ...] = (0.0, 0.5, 1.0)


def _drawing(view: View, mode: str | None, frame: int | None, magnification: float) -> _Drawing:
    rest = {shape.name: shape.points for shape in view.shapes}
    _check_frame(view, frame)
    if mode is not None:
        view.mode(mode)
        moved = {name: view.displacement(name, mode=mode) for name in rest}
        factor = SHARE * view.size / (_largest(moved) or 1.0)
        return _Drawing(mode, {name: rest[name] + factor * moved[name] for name in rest}, True, *_lengths(moved))
    if frame is None:
        return _Drawing(view.title, rest)
    assert view.motion is not None
    moved = {name: view.displacement(name, frame=frame) for name in rest}
    own = {name: view.deformation(name, frame) @ _turn(view, name, frame).T for name in rest}
    magnified = moved if view.small else own
    points = {name: rest[name] + moved[name] + (magnification - 1) * magnified[name] for name in rest}
    what = f", {'motion' if view.small else 'deformation'} x {magnification:g}" if magnification != 1 else ""
    title = f"{view.title}: {view.motion.time[frame]:.4g} s{what}"
    colorings = {shape.name: shape.coloring for shape in view.shapes if shape.coloring is not None}
    if colorings:
        values = {name: coloring.values[frame] for name, coloring in colorings.items()}
        coloring = next(iter(colorings.values()))
        return _Drawing(title, points, True, coloring.quantity, values, coloring.ticks)
    return _Drawing(title, points, True, *_lengths(magnified, "displacement" if view.small else "deformation"))


def _largest(moved: Mapping[str, Array]) -> float:
    """Return the largest displacement [m]."""
    return max((float(np.linalg.norm(shift, axis=1).max(initial=0.0)) for shift in moved.values()), default=0.0)


def _lengths(moved: Mapping[str, Array], kind: str = "displacement") -> tuple[str, dict[str, Array]]:
    """Return the quantity of displacements and its values: shares of the largest; nothing where all are zero."""
    largest = _largest(moved)
    if not largest:
        return "", {}
    shares = {name: np.linalg.norm(shift, axis=1) / largest for name, shift in moved.items()}
    return f"share of the largest {kind}", shares


def _check_frame(view: View, frame: int | None) -> None:
    if frame is None:
        return
    if view.motion is None:
        raise ValueError(f"view {view.title!r} has no motion, so no image {frame}")
    if not 0 <= frame < len(view.motion.time):
        raise ValueError(f"view {view.title!r} has the images 0 to {len(view.motion.time) - 1}, not {frame}")


def _turn(view: View, name: str, frame: int) -> Array:
    turns = {} if view.motion is None else view.motion.rotations
    return turns[name][frame] if name in turns else view.shape(name).rotation


def _draw(pyvista: Any, plotter: Any, view: View, drawing: _Drawing, *, mesh: bool, alone: bool) -> None:
    legend: dict[str, str] = {}
    seen = [shape for shape in view.shapes if len(shape.form.surface.triangles)]
    for shape in seen:
        surface, points = shape.form.surface, 1e3 * drawing.points[shape.name]
        body = pyvista.PolyData.from_regular_faces(points, surface.triangles)
        light = {"ambient": 0.25, "diffuse": 0.8, "show_scalar_bar": False}
        if drawing.quantity:
            values = drawing.values.get(shape.name, np.zeros(0))
            body["value"] = np.pad(values, (0, max(0, len(points) - len(values))))[: len(points)]
            shown = plotter.add_mesh(body, scalars="value", cmap="viridis", clim=(0, drawing.ticks[-1]), **light)
            _add_lines(pyvista, plotter, 1e3 * shape.points, shape.form.outline, RESTING, 1.2)
        else:
            colors = {label: shape.colors.get(label, GREY) for label in shape.form.labels}
            legend |= colors if len(seen) == 1 else {shape.name: colors[shape.form.labels[0]]}
            body.cell_data["color"] = np.array([pyvista.Color(colors[k]).int_rgb for k in surface.labels], np.uint8)
            plotter.add_mesh(body, scalars="color", rgb=True, **light)
        _add_lines(pyvista, plotter, points, shape.form.outline, LINE_COLOR, 1.6)
        if mesh:
            _add_lines(pyvista, plotter, points, surface.edges, LINE_COLOR, 1.0, opacity=0.3)
    if not drawing.quantity:
        numbered = any(mark.kind == "face" for mark in view.marks)
        legend = legend if len(legend) <= MOST_NAMES and not numbered else {}
        if not drawing.moves:
            _draw_marks(pyvista, plotter, view)
            legend |= {f"{mark.kind}s": MARK_COLORS[mark.kind] for mark in view.marks if mark.kind != "face"}
        _add_legend(pyvista, plotter, legend)
    elif alone:
        plotter.add_scalar_bar(
            title=f"{drawing.quantity}\n",  # the line keeps the title off the labels
            mapper=shown.mapper,
            color="black",
            vertical=False,
            n_labels=len(drawing.ticks),
            width=0.36,
            height=0.1,
            position_x=0.6,
            position_y=0.02,
            fmt="%.4g",
            title_font_size=18,
            label_font_size=16,
        )
    plotter.add_text(drawing.title, font_size=12, color="black", position="upper_left")
    plotter.add_axes(line_width=3, viewport=(0, 0, 0.16, 0.16))


def _add_lines(
    pyvista: Any, plotter: Any, points: Array, pairs: NDArray[np.int64], color: str, width: float, **style: Any
) -> None:
    if len(pairs):
        cells = np.column_stack([np.full(len(pairs), 2), pairs]).ravel()
        lines = pyvista.PolyData(points, lines=cells)
        _bring_forward(plotter.add_mesh(lines, color=color, line_width=width, lighting=False, **style), ON_FACES)


def _bring_forward(actor: Any, offset: float) -> None:
    """Render lines and points with a depth offset towards the camera."""
    actor.mapper.SetResolveCoincidentTopologyToPolygonOffset()
    actor.mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0.0, offset)
    actor.mapper.SetRelativeCoincidentTopologyPointOffsetParameter(offset)


def _add_legend(pyvista: Any, plotter: Any, colors: Mapping[str, str]) -> None:
    """Add coloured squares and black names in the upper right corner."""
    from vtkmodules.vtkRenderingCore import vtkActor2D, vtkPolyDataMapper2D  # noqa: PLC0415  comes with PyVista

    width, height = plotter.renderer.GetSize()
    left, row, side = 0.8 * width, 26.0, 14.0
    corners = side * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    for k, (name, color) in enumerate(colors.items()):
        low = height - 40.0 - row * k
        mapper = vtkPolyDataMapper2D()
        mapper.SetInputData(pyvista.PolyData(corners + np.array([left, low, 0.0]), faces=[4, 0, 1, 2, 3]))
        square = vtkActor2D()
        square.SetMapper(mapper)
        square.GetProperty().SetColor(*pyvista.Color(color).float_rgb)
        plotter.renderer.AddViewProp(square)
        plotter.add_text(name, position=(left + 22, low - 3), font_size=9, color="black")


def _draw_marks(pyvista: Any, plotter: Any, view: View) -> None:
    """Draw points and lines of marks in front of all shapes, and their names, joined for marks in one place."""
    reach = 60.0 * view.size
    named: dict[tuple[float, ...], list[str]] = {}
    others = [mark for mark in view.marks if mark.kind != "face"]
    for kind, color in MARK_COLORS.items():
        marks = [mark for mark in others if mark.kind == kind]
        places = [[1e3 * _place(view, end) for end in mark.ends] for mark in marks]
        for mark, ends in zip(marks, places, strict=True):
            named.setdefault(tuple(np.round(ends[-1], 6)), []).append(mark.name)
        if not marks:
            continue
        dots = pyvista.PolyData(np.array([end for ends in places for end in ends]))
        actors = [plotter.add_mesh(dots, color=color, point_size=13, render_points_as_spheres=True, ambient=0.6)]
        segments = [line for mark, ends in zip(marks, places, strict=True) for line in _rods(mark, ends, reach)]
        if segments:
            points: Array = np.array(segments).reshape(-1, 3)
            cells = np.column_stack([np.full(len(segments), 2), np.arange(len(points)).reshape(-1, 2)]).ravel()
            lines = pyvista.PolyData(points, lines=cells)
            actors.append(plotter.add_mesh(lines, color=color, line_width=3, lighting=False))
        for actor in actors:
            _bring_forward(actor, BEFORE_ALL)
    if named and len(others) <= MOST_NAMES:
        texts = [f"  {', '.join(dict.fromkeys(names))}" for names in named.values()]
        style = {"always_visible": True, "shape": None, "font_size": 17, "bold": False, "show_points": False}
        plotter.add_point_labels(np.array(list(named)), texts, text_color="black", **style)


def _draw_numbers(pyvista: Any, plotter: Any, view: View) -> None:
    """Draw the names of the faces whose marks the camera sees."""
    places = {mark.name: 1e3 * _place(view, mark.ends[0]) for mark in view.marks if mark.kind == "face"}
    bodies = [
        pyvista.PolyData.from_regular_faces(1e3 * shape.points, shape.form.surface.triangles) for shape in view.shapes
    ]
    seen = {
        name: place
        for name, place in places.items()
        if not any(len(body.ray_trace(place, plotter.camera.position)[0]) for body in bodies)
    }
    if seen:
        style = {"always_visible": True, "shape": None, "font_size": 17, "bold": False, "show_points": False}
        plotter.add_point_labels(np.array(list(seen.values())), list(seen), text_color="black", **style)


def _rods(mark: Mark, ends: Sequence[Array], reach: float) -> list[tuple[Array, Array]]:
    """Return the lines of a mark: between its ends, and along its axes (to both sides unless an actuator or sensor)."""
    back = 0.0 if mark.kind in ("actuator", "sensor") else 1.0
    axes = [(ends[-1] - back * reach * axis, ends[-1] + reach * axis) for axis in mark.axes]
    return [(ends[0], ends[1]), *axes] if len(ends) == 2 else axes


def _place(view: View, end: tuple[str, str]) -> Array:
    shape = view.shape(end[0])
    return shape.points[shape.form.index(end[1])]


def _aim(plotter: Any, view: View, direction: Array) -> None:
    """Set a parallel projection, which shows lengths to scale."""
    middle = 1e3 * view.bounds.mean(axis=0)
    plotter.enable_parallel_projection()
    up = (0, 0, 1) if abs(direction[2]) < 0.99 else (0, 1, 0)
    plotter.camera_position = [tuple(middle + 5e3 * view.size * direction), tuple(middle), up]
    right = np.cross(up, direction)
    axes = np.array([right / np.linalg.norm(right), np.cross(direction, right / np.linalg.norm(right))])
    spread = np.ptp(np.vstack([1e3 * shape.points for shape in view.shapes]) @ axes.T, axis=0)
    width, height = plotter.renderer.GetSize()
    plotter.camera.parallel_scale = 0.5 * ROOM * max(spread[1], spread[0] * height / width)
    plotter.renderer.ResetCameraClippingRange()
    plotter.enable_anti_aliasing("ssaa")
