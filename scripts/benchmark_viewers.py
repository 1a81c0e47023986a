"""Compare pages of the actuator's modes for a browser by nassim and other libraries: file size and downloads.

Each library receives the same surface. Libraries that can only play given shapes receive every mode at several instants
of its oscillation. PyVista's export has no animation and receives one mode at one instant. Libraries that are not
installed are left out.
"""

import re
import time
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from common.arguments import parser, run, whole
from common.report import print_table, write_summary
from models.apa300ml import reduced_apa300ml
from nassim.viewer import View, view_modes, write_page

Swings = list[list[np.ndarray]]
"""Points by mode and instant, (n, 3) each."""

arguments = parser(__doc__, "benchmark_viewers")
arguments.add_argument("--modes", type=whole(1), default=6, help="number of modes (default: 6)")
arguments.add_argument("--instants", type=whole(2), default=12, help="instants of an oscillation (default: 12)")
FETCHED = re.compile(r"""<script[^>]*\bsrc=["']https?:|<link[^>]*\bhref=["']https?:|\bimport\(?\s*["']https?:""")
"""Files that an incomplete page downloads when it opens."""
COLUMNS = {
    "version": "version",
    "size [MB]": "size_B*1e-6:.2f",
    "processor time [s]": "cpu_time_s:.1f",
    "parts it fetches": "fetched:d",
}


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


def cost(write: Callable[..., Any], *given: Any) -> dict[str, float]:
    start = time.process_time()
    write(*given)
    spent, text = time.process_time() - start, given[-1].read_text(encoding="utf-8")
    return {"size_B": len(text.encode()), "cpu_time_s": spent, "fetched": len(FETCHED.findall(text))}


def swings_of(view: View, instants: int) -> Swings:
    (shape,) = view.shapes
    form, phases = shape.form, np.cos(2 * np.pi * np.arange(instants) / instants)
    moved = [form.modes @ mode.coordinates[shape.name] for mode in view.modes]
    return [[form.surface.points + phase * u[: len(form.surface.points)] for phase in phases] for u in moved]


def main() -> None:
    args = arguments.parse_args()
    view = view_modes(reduced_apa300ml(), fixed=["bottom"], n=args.modes)
    surface = view.shapes[0].form.surface
    summary = {"nassim": {"version": version("nassim"), **cost(write_page, view, args.output / "nassim.html")}}
    for name, write in OTHERS.items():
        given = surface.points, surface.triangles, swings_of(view, args.instants), args.output / f"{name}.html"
        try:
            summary[name] = {"version": version(name), **cost(write, *given)}
        except ImportError as error:
            print(f"{name} is left out: {error}")
    print_table(f"{args.modes} modes, {len(surface.triangles)} triangles", summary, COLUMNS)
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
