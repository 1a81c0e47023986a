"""The nano-hexapod as it stands: surfaces of its actuators, flexible joints as dots, plates as discs."""

from typing import Any

import numpy as np
from matplotlib.colors import LightSource
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from nassim import FlexibleBody, Scene
from nassim.kinematics import StewartPlatform
from nassim.plotting import COLORS, plt

ROUND = np.linspace(0, 2 * np.pi, 73)


def plot_machine(scene: Scene, platform: StewartPlatform) -> Any:
    """The struts of a scene whose actuators have surfaces, between its plates; returns the Axes."""
    # Axes in 3-D keep a wide margin, which lies outside the figure.
    ax = plt.figure(figsize=(7, 4.2)).add_axes((-0.02, -0.33, 1.04, 1.66), projection="3d", computed_zorder=False)
    low, high = platform.base_joints[:, 2].mean(), platform.height + platform.platform_joints[:, 2].mean()
    radii = [np.linalg.norm(joints[:, :2], axis=1).max() for joints in (platform.base_joints, platform.platform_joints)]
    span = 1.2 * max(radii)
    ax.set(xlim=(-span, span), ylim=(-span, span), zlim=(0, platform.height + 0.2 * low))
    ax.autoscale(False)
    _disc(ax, 1.15 * radii[0], 0.0, 0.3 * low)
    corners, shades = [], []
    for k in range(1, 7):
        body, _ = scene.split(f"strut_{k}/apa.")
        assert isinstance(body, FlexibleBody)
        assert body.reduced.surface is not None
        points = body.reduced.surface.points @ body.rotation.T + body.position
        corners.append(points[body.reduced.surface.triangles])
        shades.append(np.full(len(corners[-1]), k - 1))
        for end in ("bottom", "top"):
            line = np.array([scene.point_position(f"strut_{k}/{end}.end"), body.point_position(end)])
            ax.plot(*line.T, color="0.35", lw=4, solid_capstyle="butt", zorder=2)
            ax.plot(*line[:1].T, "o", color="0.1", ms=5, zorder=5)
    triangles, colors = np.vstack(corners), np.array(COLORS)[np.concatenate(shades).astype(int) % len(COLORS)]
    shaded = Poly3DCollection(triangles, facecolors=colors, shade=True, lightsource=LightSource(200, 40), zorder=3)
    ax.add_collection3d(shaded)
    _disc(ax, 1.15 * radii[1], high + 0.5 * (platform.height - high), platform.height, alpha=0.2, zorder=4)
    ax.set_box_aspect((2 * span, 2 * span, platform.height + 0.2 * low), zoom=1.25)
    ax.view_init(20, 35)
    ax.set_axis_off()
    return ax


def _disc(ax: Any, radius: float, bottom: float, top: float, *, alpha: float = 1.0, zorder: float = 1) -> None:
    ring = np.stack([radius * np.cos(ROUND), radius * np.sin(ROUND)], axis=1)
    rims = [np.column_stack([ring, np.full(len(ring), height)]) for height in (bottom, top)]
    walls = [np.array([a, b, c, d]) for a, b, c, d in zip(rims[0], rims[0][1:], rims[1][1:], rims[1], strict=False)]
    faces = Poly3DCollection([*walls, rims[1]], facecolors="0.75", edgecolors="none", alpha=alpha, zorder=zorder)
    ax.add_collection3d(faces)
    ax.plot(*rims[1].T, color="0.45", lw=0.8, zorder=zorder)
