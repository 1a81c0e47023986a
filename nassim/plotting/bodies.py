"""Surfaces of reduced bodies: with their remote points, and in motion."""

from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from nassim.base.checks import Array
from nassim.bodies.reduced_body import ReducedBody
from nassim.plotting.figures import COLORS, plt


def plot_body(body: ReducedBody, *, ax: Any = None) -> Any:
    """The meshed surface, coloured by CAD body, with the remote points and their interfaces; returns the Axes.

    Raises ValueError when the body has no surface (made by hand or imported).
    """
    ax = ax or plt.figure(figsize=(8, 6)).add_subplot(projection="3d")
    surface = _surface(body)
    interfaces = dict(zip(body.point_names, COLORS, strict=False))
    materials = sorted(set(surface.labels) - set(interfaces), key=surface.labels.count, reverse=True)
    greys = dict(zip(materials, ("#c9ccd1", "#e8c98a", "#d8b36a", "#c79f55", "#a8adb5"), strict=False))
    colors = np.array([to_rgb((interfaces | greys).get(label, "#c9ccd1")) for label in surface.labels])
    _draw(ax, surface.points, surface.triangles, colors, edge_width=0.1)
    for name, color in interfaces.items():
        x, y, z = 1e3 * body.point(name).position
        ax.plot([x], [y], [z], "o", color=color, mec="black", ms=8, zorder=10)
    handles = [Line2D([], [], ls="", marker="o", color=color, mec="black", label=n) for n, color in interfaces.items()]
    ax.legend(handles=handles, title="remote points", loc="upper left", fontsize=9)
    return ax


def plot_mode(body: ReducedBody, shape: Array, *, title: str = "", ax: Any = None) -> Any:
    """A motion of the body, shape (n_coordinates,), exaggerated and coloured by its size; returns the Axes.

    Raises ValueError when the body has no surface (made by hand or imported).
    """
    ax = ax or plt.figure(figsize=(8, 6)).add_subplot(projection="3d")
    surface = _surface(body)
    assert body.surface_modes is not None
    displacement = body.surface_modes @ shape
    size = np.linalg.norm(displacement, axis=1)
    factor = 0.08 * np.ptp(surface.points, axis=0).max() / size.max()
    level = size[surface.triangles].mean(axis=1) / size.max()
    _draw(ax, surface.points + factor * displacement, surface.triangles, plt.get_cmap("viridis")(level)[:, :3])
    ax.set_title(title, fontsize=10)
    ax.set_axis_off()
    return ax


def _draw(ax: Any, points: Array, triangles: Array, colors: Array, *, edge_width: float = 0.0) -> None:
    corners = 1e3 * points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    # Light from the viewer's side; either side of a face may be seen.
    light = 0.55 + 0.45 * np.abs(normal @ (np.array([0.35, -0.75, 0.55]) / 0.994))
    shaded = np.clip(colors * light[:, None], 0, 1)
    edges = "black" if edge_width else shaded
    ax.add_collection3d(Poly3DCollection(corners, facecolors=shaded, edgecolors=edges, linewidths=edge_width or 0.2))
    low, high = corners.reshape(-1, 3).min(axis=0), corners.reshape(-1, 3).max(axis=0)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect(np.maximum(high - low, 1e-9), zoom=1.0 if edge_width else 0.9)
    ax.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    ax.view_init(elev=22, azim=-62)
    ax.set_yticks([0.0])
    ax.locator_params(axis="x", nbins=5)
    ax.locator_params(axis="z", nbins=4)
    ax.tick_params(labelsize=7)


def _surface(body: ReducedBody) -> Any:
    if body.surface is None or body.surface_modes is None:
        raise ValueError(f"body {body.name!r} has no surface to draw: it was not reduced from a mesh")
    return body.surface
