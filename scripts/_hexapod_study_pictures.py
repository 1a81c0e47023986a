"""Pictures of a study of hexapods: damping over speed and gain, and what tolerances do."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm

from nassim.plotting import plot_sobol, plt, save_figure

LEVELS = np.array([0, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5])


def plot_damping(damping: Any, edges: Any, path: Path) -> None:
    """Least damping ratio over speed and gain, red where unstable, and the largest stable gain; a map per payload."""
    payloads = damping.payload_mass.values
    size = (3.4 * len(payloads) + 1, 3.8)
    figure, axes = plt.subplots(1, len(payloads), figsize=size, sharey=True, squeeze=False, layout="constrained")
    norm, speeds = BoundaryNorm(LEVELS, 256), damping.spindle_rpm.values
    places = np.arange(len(speeds))
    for payload, ax in zip(payloads, axes[0], strict=True):
        chosen, edge = damping.sel(payload_mass=payload), edges.sel(payload_mass=payload).largest_stable_gain.values
        ratio = chosen.damping_ratio.where(chosen.growth < 0).clip(max=LEVELS[-1] - 1e-9).transpose("gain", ...)
        ax.set_facecolor("#f4dada")
        mesh = ax.pcolormesh(places, damping.gain, ratio, norm=norm, cmap="viridis", shading="nearest", rasterized=True)
        for place, gain in zip(places, np.nan_to_num(edge, posinf=0.0), strict=True):
            if damping.gain[0] < gain < damping.gain[-1]:
                ax.plot([place - 0.5, place + 0.5], [gain, gain], color="#d62728", lw=2)
        ax.set_xticks(places, [f"{speed:g}" for speed in speeds])
        ax.set(yscale="log", title=f"{payload:g} kg", xlabel="speed [rpm]")
    axes[0, 0].set_ylabel("gain of six integrators [1/s]")
    figure.colorbar(mesh, ax=axes, label="least damping ratio [-]", ticks=LEVELS)
    save_figure(axes, path)


def plot_tolerances(study: Any, indices: Any, folder: Path) -> None:
    """Histograms of all results, and which parameter brings which share of their variance; study: independent runs."""
    results = indices.result.values.tolist()
    axes = plt.figure(figsize=(12, 5.5), layout="constrained").subplots(2, 3).ravel()
    for name, ax in zip(results, axes, strict=True):
        unit = study[name].attrs.get("units") or "-"
        ax.hist(study[name].values, bins=12, color="#1f77b4")
        ax.set(xlabel=f"{name.replace('_', ' ')} [{unit}]", ylabel="runs")
        ax.ticklabel_format(axis="x", useOffset=False)
        ax.locator_params(axis="x", nbins=4)
        ax.grid(visible=True, alpha=0.25)
    save_figure(axes, folder / "tolerances.png")
    save_figure(plot_sobol(indices), folder / "sobol.png")
