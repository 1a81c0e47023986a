"""Modes of a surface as a page of plotly, k3d and PyVista."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

Swings = list[list[np.ndarray]]
"""Points (n, 3) by mode and instant."""


def by_plotly(points: np.ndarray, triangles: np.ndarray, swings: Swings, path: Path) -> None:
    go = import_module("plotly.graph_objects")

    def mesh(p: np.ndarray) -> Any:
        x, y, z = p.astype(np.float32).T
        i, j, k = triangles.astype(np.int32).T
        return go.Mesh3d(x=x, y=y, z=z, i=i, j=j, k=k, intensity=np.linalg.norm(p - points, axis=1).astype(np.float32))

    frames = [go.Frame(data=[mesh(p)]) for swing in swings for p in swing]
    go.Figure(data=[mesh(points)], frames=frames).write_html(path, include_plotlyjs=True)


def by_k3d(points: np.ndarray, triangles: np.ndarray, swings: Swings, path: Path) -> None:
    k3d = import_module("k3d")

    plot = k3d.plot()
    for swing in swings:
        moving = {str(n): p.astype(np.float32) for n, p in enumerate(swing)}
        shown = {n: np.linalg.norm(p - points, axis=1).astype(np.float32) for n, p in moving.items()}
        mesh = k3d.mesh(moving["0"], triangles.astype(np.uint32), attribute=shown["0"])
        mesh.vertices, mesh.attribute = moving, shown
        plot += mesh
    path.write_text(plot.get_snapshot(), encoding="utf-8")


def by_pyvista(points: np.ndarray, triangles: np.ndarray, swings: Swings, path: Path) -> None:
    pyvista = import_module("pyvista")

    mesh = pyvista.PolyData.from_regular_faces(swings[0][0], triangles)
    plotter = pyvista.Plotter(off_screen=True)
    plotter.add_mesh(mesh, scalars=np.linalg.norm(mesh.points - points, axis=1))
    plotter.trame.export_html(path)


OTHERS: dict[str, Callable[..., None]] = {"plotly": by_plotly, "k3d": by_k3d, "pyvista": by_pyvista}
