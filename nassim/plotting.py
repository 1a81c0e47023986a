"""Pictures of finished results; each function returns its Axes."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MultipleLocator, NullFormatter
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from nassim.base.checks import Array, known
from nassim.bodies.reduced_body import ReducedBody
from nassim.exchange.inspection import signed_frequencies
from nassim.exchange.row_order import rigid_residual
from nassim.exchange.superelement import Superelement
from nassim.identification.modal_fit import ModalFit
from nassim.signals.frf import FRF
from nassim.signals.time_history import TimeHistory
from nassim.systems.noise_budget import NoiseBudget
from nassim.systems.root_locus import Optimum, RootLocus

COLORS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")

LOWEST = 1e-6
"""What eigenfrequencies of zero are drawn as [Hz]."""


def plot_frf(
    frfs: Sequence[FRF],
    *,
    output: str,
    input: str,
    unit: str,
    markers: Sequence[str] = (),
    figure: Any = None,
) -> Sequence[Any]:
    """Bode plot of one entry of several FRFs, with the coherence below where one of them has it.

    unit: of the magnitude; markers: labels of FRFs drawn as points instead of lines
    figure: matplotlib figure or subfigure to draw in (default: a new one)

    Returns the Axes: magnitude, phase and, with any coherence, coherence.
    """
    with_coherence = any(frf.coherence is not None for frf in frfs)
    figure = figure or plt.figure(figsize=(7, 7), layout="constrained")
    ratios = [3, 2, 1] if with_coherence else [3, 2]
    axes = list(figure.subplots(len(ratios), 1, sharex=True, gridspec_kw={"height_ratios": ratios}))
    for color, frf in zip(_colors(len(frfs)), frfs, strict=True):
        response = frf.response(output, input)
        style: dict[str, Any] = {"color": color, "label": frf.label, "lw": 1.2}
        if frf.coherence is not None:  # estimated: broad, so that the model's line stays visible on top
            style.update(lw=3.5, alpha=0.5)
        if frf.label in markers:
            style.update(ls="", marker="o", ms=4, mfc="none")
        axes[0].loglog(frf.frequency, np.abs(response), **style)
        axes[1].semilogx(frf.frequency, _phase(response), **style)
        if frf.coherence is not None:
            axes[2].semilogx(frf.frequency, frf.coherence[frf.outputs.index(output)], **style)
    axes[0].set_ylabel(f"magnitude [{unit}]")
    axes[0].set_title(f"{output} / {input}".replace("_", " "), fontsize=11)
    axes[0].legend(fontsize=9)
    axes[1].set_ylabel("phase [deg]")
    axes[1].yaxis.set_major_locator(MultipleLocator(90))
    if with_coherence:
        axes[2].set_ylabel("coherence [-]")
        axes[2].set_ylim(0, 1.05)
    axes[-1].set_xlabel("frequency [Hz]")
    for ax in axes:
        ax.grid(True, which="both", alpha=0.25)
    return axes


def plot_frf_error(
    frfs: Sequence[FRF], references: Sequence[FRF], *, output: str, input: str, figure: Any = None
) -> Sequence[Any]:
    """Relative difference |H / H_ref - 1| of estimated FRFs from references at the same frequencies, with coherence.

    Returns the Axes: error, incoherence 1 - gamma^2.
    """
    figure = figure or plt.figure(figsize=(7, 5), layout="constrained")
    axes = list(figure.subplots(2, 1, sharex=True))
    for color, frf, reference in zip(_colors(len(frfs)), frfs, references, strict=True):
        error = np.abs(frf.response(output, input) / reference.response(output, input) - 1)
        axes[0].loglog(frf.frequency, 100 * error, color=color, label=frf.label, lw=1.2)
        if frf.coherence is not None:
            incoherence = np.maximum(1 - frf.coherence[frf.outputs.index(output)], 1e-16)
            axes[1].loglog(frf.frequency, incoherence, color=color, lw=1.2)
    axes[0].set_title(f"{output} / {input}".replace("_", " "), fontsize=11)
    axes[0].set_ylabel("difference from the model [%]")
    axes[0].legend(fontsize=9)
    axes[1].set_ylabel("1 - coherence [-]")
    axes[1].set_xlabel("frequency [Hz]")
    for ax in axes:
        ax.grid(True, which="both", alpha=0.25)
    return axes


def plot_modal_fit(
    fit: ModalFit, models: Sequence[FRF], *, output: str, unit: str, figure: Any = None
) -> Sequence[Any]:
    """Recorded responses of one output line by line, the fit and models over them, and what the fit leaves over.

    models: FRFs to compare with, such as a scene's before and after; unit: of the response

    Returns the Axes: magnitude, phase, residual.
    """
    figure = figure or plt.figure(figsize=(7, 8), layout="constrained")
    axes = list(figure.subplots(3, 1, sharex=True, gridspec_kw={"height_ratios": [3, 2, 2]}))
    dots: dict[str, Any] = {"ls": "", "marker": ".", "ms": 2, "color": "0.65", "rasterized": True}
    recorded = fit.recorded.response(output, fit.input)
    # Lines that are mostly noise say nothing of the phase.
    clear = np.abs(recorded) > 3 * fit.noise[fit.outputs.index(output)]
    frequency = fit.recorded.frequency
    axes[0].loglog(frequency, np.abs(recorded), label="recorded, line by line", **dots)
    fine = np.geomspace(frequency[0], frequency[-1], 4000)
    identified = fit.response(fine, label="identified")
    response = identified.response(output, fit.input)
    phase = _phase(response)

    def near_phase(x: Array, values: Array) -> Array:
        """Phase without jumps against the fit's [deg]."""
        own = fit.response(x).response(output, fit.input)
        turns = np.round((np.interp(x, fine, phase) - np.angle(own, deg=True)) / 360)
        result: Array = np.angle(own, deg=True) + 360 * turns + np.angle(values / own, deg=True)
        return result

    axes[1].semilogx(frequency[clear], near_phase(frequency[clear], recorded[clear]), **dots)
    for k, frf in enumerate((identified, *models)):
        style: dict[str, Any] = {"color": COLORS[k % len(COLORS)], "ls": ("-", "--", "-.", ":")[k % 4], "lw": 1.4}
        values = frf.response(output, fit.input)
        axes[0].loglog(frf.frequency, np.abs(values), label=frf.label, **style)
        axes[1].semilogx(frf.frequency, near_phase(frf.frequency, values), **style)
    axes[2].loglog(frequency, np.abs(fit.residual.response(output, fit.input)), label="residual", **dots)
    noise = fit.noise[fit.outputs.index(output)]
    axes[2].loglog(*_running_median(frequency, noise), color="black", lw=1.2, label="noise, standard deviation")
    axes[2].loglog(fine, np.abs(response), color=COLORS[0], lw=0.8, label="identified")
    axes[0].set_title(f"{output} / {fit.input}".replace("_", " "), fontsize=11)
    axes[0].set_ylabel(f"magnitude [{unit}]")
    axes[1].set_ylabel("phase [deg]")
    axes[1].yaxis.set_major_locator(MultipleLocator(90))
    axes[2].set_ylabel(f"residual [{unit}]")
    axes[2].set_xlabel("frequency [Hz]")
    for ax in (axes[0], axes[2]):
        ax.legend(fontsize=8)
    axes[2].xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes[2].xaxis.set_major_formatter("{x:g}")
    axes[2].xaxis.set_minor_formatter(NullFormatter())
    for ax in axes:
        ax.grid(True, which="both", alpha=0.25)
    return axes


def plot_pareto(
    lines: Mapping[str, Sequence[tuple[float, float, str]]], xlabel: str, ylabel: str, *, ax: Any = None
) -> Any:
    """Error over cost on logarithmic axes: per named line the points (cost, error, label); returns the axes."""
    ax = ax or plt.subplots(figsize=(8, 5.5), layout="constrained")[1]
    for name, points in lines.items():
        x, y, labels = zip(*sorted(points), strict=True)
        (line,) = ax.loglog(x, y, "o-", markersize=5, linewidth=1.2, label=name)
        for a, b, text in zip(x, y, labels, strict=True):
            ax.annotate(text, (a, b), xytext=(4, 4), textcoords="offset points", fontsize=7, color=line.get_color())
    ax.set(xlabel=xlabel, ylabel=ylabel)
    ax.grid(visible=True, which="both", alpha=0.3)
    ax.legend(fontsize=8)
    return ax


def plot_noise_budget(
    budget: NoiseBudget, *, output: str, limit: float | None = None, figure: Any = None
) -> Sequence[Any]:
    """One output's amplitude spectral density and, summed from high to low frequencies, its cumulative amplitude.

    Both by disturbance, those with the largest rms first, and in total; limit: of the rms, drawn in the second.

    Returns the Axes: density, cumulative amplitude.
    """
    figure = figure or plt.figure(figsize=(7.5, 7), layout="constrained")
    axes = list(figure.subplots(2, 1, sharex=True))
    row = budget.outputs.index(known("output", output, budget.outputs))
    order = np.argsort(-budget.rms()[row])
    black: dict[str, Any] = {"color": "black", "lw": 1.8}
    curves = [(budget, k, {"color": COLORS[n % len(COLORS)], "lw": 1.2}) for n, k in enumerate(order)]
    for part, k, style in [*curves, (budget.total, 0, black)]:
        amplitude = part.cumulative()[row, k]
        shown = amplitude > 0
        axes[0].loglog(part.frequency, np.sqrt(part.psd[row, k]), **style)
        label = f"{part.inputs[k]}: {amplitude[0]:.3g} {budget.units[row]}".replace("_", " ").rstrip()
        axes[1].loglog(part.frequency[shown], amplitude[shown], label=label, **style)
    total = budget.total.rms()[row, 0]
    if limit is not None:
        axes[1].axhline(limit, color="0.4", ls="--", lw=1.2, label=f"limit: {limit:.3g} {budget.units[row]}".rstrip())
    if total > 0:
        top, peak = 2 * max(total, limit or 0.0), 2 * np.sqrt(budget.total.psd[row, 0].max())
        axes[1].set_ylim(1e-4 * top, top)
        axes[0].set_ylim(1e-8 * peak, peak)
    unit = budget.units[row] or "-"
    axes[0].set_title(output.replace("_", " "), fontsize=11)
    axes[0].set_ylabel(f"amplitude density [{unit}/√Hz]")
    axes[1].set(xlabel="frequency [Hz]", ylabel=f"rms above the frequency [{unit}]")
    axes[1].legend(fontsize=8)
    for ax in axes:
        ax.grid(True, which="both", alpha=0.25)
    return axes


def plot_root_locus(locus: RootLocus, *, frequency: float, optimum: Optimum | None = None, ax: Any = None) -> Any:
    """Branches of a root locus in the plane of s over 2 pi, with lines of equal damping; returns the Axes.

    frequency: up to which natural frequency it is drawn [Hz]; crosses: poles at the first gain; circles: zeros
    optimum: marked with its gain, damping ratio and frequency
    """
    ax = ax or plt.subplots(figsize=(7.5, 6), layout="constrained")[1]
    right = 0.2 * frequency
    ax.axvspan(0, right, color="#d62728", alpha=0.06, lw=0)
    for ratio in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9):
        end = frequency * np.array([-ratio, np.sqrt(1 - ratio**2)])
        ax.plot([0, end[0]], [0, end[1]], color="0.85", lw=0.7, zorder=0)
        ax.annotate(f"{ratio:g}", 1.03 * end, fontsize=7, color="0.45", ha="center", va="center", zorder=0)
    turn = np.linspace(np.pi / 2, np.pi, 90)
    for part in (0.25, 0.5, 0.75, 1.0):
        ax.plot(part * frequency * np.cos(turn), part * frequency * np.sin(turn), color="0.85", lw=0.7, zorder=0)
    # The upper half shows all: poles come in conjugate pairs, which share a colour.
    points = locus.poles.real / (2 * np.pi) + 1j * np.abs(locus.poles.imag) / (2 * np.pi)
    points[np.abs(points) > 1.1 * frequency] = np.nan
    drawn = np.flatnonzero(np.any(np.isfinite(points), axis=0))
    pairs = sorted({f"{size:.6e}" for size in locus.frequency[0, drawn]}, key=float)
    for k in drawn:
        color = COLORS[pairs.index(f"{locus.frequency[0, k]:.6e}") % len(COLORS)]
        ax.plot(points[:, k].real, points[:, k].imag, ".-", color=color, lw=1.4, ms=3)
        ax.plot(points[0, k].real, points[0, k].imag, "x", color=color, ms=9, mew=2)
    zeros = locus.zeros[locus.zeros.imag >= 0] / (2 * np.pi)
    ax.plot(zeros.real, zeros.imag, "o", color="black", mfc="none", ms=8, mew=1.3)
    handles = [
        Line2D([], [], ls="", marker="x", color="black", label=f"poles at gain {locus.gains[0]:g}"),
        Line2D([], [], ls="", marker="o", color="black", mfc="none", label="zeros of the open loop"),
        Line2D([], [], color="black", marker=".", label=f"poles up to gain {locus.gains[-1]:.4g}"),
    ]
    if optimum is not None:
        root = optimum.frequency * np.array([-optimum.damping_ratio, np.sqrt(max(1 - optimum.damping_ratio**2, 0.0))])
        ax.plot(*root, "*", color="black", ms=13, zorder=5)
        text = f"gain {optimum.gain:.4g}: damping {optimum.damping_ratio:.3g} at {optimum.frequency:.4g} Hz"
        handles.append(Line2D([], [], ls="", marker="*", color="black", ms=10, label=text))
    ax.set(xlim=(-1.1 * frequency, right), ylim=(-0.03 * frequency, 1.1 * frequency), aspect="equal")
    ax.set(xlabel="Re s / 2π [Hz]", ylabel="Im s / 2π [Hz]")
    ax.axhline(0, color="0.6", lw=0.7, zorder=0)
    ax.axvline(0, color="0.4", lw=0.8, zorder=0)
    ax.legend(handles=handles, fontsize=8, loc="upper left")
    return ax


def plot_time_history(history: TimeHistory, *, names: Sequence[str] | None = None, figure: Any = None) -> Sequence[Any]:
    """Signals over time, one below the other; returns an Axes per signal."""
    names = list(history.names if names is None else names)
    figure = figure or plt.figure(figsize=(7, 1.8 * len(names) + 0.6), layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(len(names), 1, sharex=True)))
    for ax, name in zip(axes, names, strict=True):
        unit = history.units[history.names.index(known("signal", name, history.names))]
        ax.plot(history.time, history[name], lw=0.7)
        ax.set_ylabel(f"{name}\n[{unit}]".replace("_", " "))
        ax.grid(True, alpha=0.25)
    axes[-1].set_xlabel("time [s]")
    return axes


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


def plot_inspection(bodies: Mapping[str, Superelement], *, figure: Any = None) -> Sequence[Any]:
    """Eigenfrequencies of labelled versions of a body, and what force each rigid motion meets in them.

    Returns the Axes: eigenfrequencies (open markers: unstable), residual of the six rigid motions.
    """
    figure = figure or plt.figure(figsize=(11, 4.5), layout="constrained")
    axes = list(figure.subplots(1, 2, gridspec_kw={"width_ratios": [3, 2]}))
    width = 0.8 / len(bodies)
    for k, (color, (label, body)) in enumerate(zip(_colors(len(bodies)), bodies.items(), strict=True)):
        stiffness, mass = (0.5 * (m + m.T) for m in (body.stiffness_matrix, body.mass_matrix))
        frequency = signed_frequencies(stiffness, mass)
        number = np.arange(1, len(frequency) + 1)
        shift = 0.15 * (k - 0.5 * (len(bodies) - 1))
        for kind, face in ((frequency > 0, color), (frequency <= 0, "none")):
            size = np.maximum(np.abs(frequency[kind]), LOWEST)
            axes[0].semilogy(number[kind] + shift, size, "os"[k % 2], color=color, mfc=face, ms=6)
        axes[0].plot([], [], "os"[k % 2], color=color, label=label)
        residual = np.maximum(rigid_residual(stiffness, body.rigid_motions), 1e-18)
        axes[1].bar(np.arange(6) + (k + 0.5) * width - 0.4, residual, width, color=color, label=label)
    axes[0].axvspan(0.5, 6.5, color="0.92", zorder=0)
    axes[0].text(3.5, 0.97, "rigid motions", ha="center", va="top", transform=axes[0].get_xaxis_transform(), fontsize=9)
    axes[0].set(xlabel="mode (open: unstable)", ylabel="eigenfrequency [Hz]", xlim=(0.5, None))
    axes[0].xaxis.set_major_locator(MultipleLocator(2))
    axes[1].set(yscale="log", ylim=(1e-18, 1e3), ylabel="force against it, over its terms [-]", xlabel="rigid motion")
    axes[1].set_xticks(range(6), ["x", "y", "z", "rx", "ry", "rz"])
    for ax in axes:
        ax.grid(visible=True, alpha=0.3)
        ax.legend(fontsize=9)
    return axes


def save_figure(axes: Any, path: str | Path) -> Path:
    """Write the figure that an Axes (or the first of several) belongs to, and close it; returns the path."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure: Figure = np.atleast_1d(np.array(axes, dtype=object))[0].get_figure(root=True)
    figure.savefig(target, dpi=150, bbox_inches="tight")
    plt.close(figure)
    return target


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


def _colors(n: int) -> list[str]:
    return [COLORS[i % len(COLORS)] for i in range(n)]


def _running_median(frequency: Array, values: Array, n_bins: int = 200) -> tuple[Array, Array]:
    edges = np.geomspace(frequency[0], frequency[-1] * (1 + 1e-9), n_bins + 1)
    groups = [(frequency >= low) & (frequency < high) for low, high in itertools.pairwise(edges)]
    filled = [group for group in groups if group.any()]
    return np.array([frequency[g].mean() for g in filled]), np.array([np.median(values[g]) for g in filled])


def _phase(response: Array) -> Array:
    """Phase in degrees without jumps, starting in -180 ... 180 (180 up to rounding counts as -180)."""
    degrees: Array = np.unwrap(np.angle(response, deg=True), period=360.0)
    return degrees - 360.0 * np.round((degrees[0] + 1.0) / 360.0)
