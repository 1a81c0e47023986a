"""Pictures of hexapods on a spindle: poles over speed, damping over speed and gain, trials."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm

from nassim import TimeHistory
from nassim.plotting import plt, save_figure

COLORS = {"pure": "#d62728", "leaky": "#1f77b4", "parallel stiffness": "#2ca02c"}
LEVELS = np.array([0, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5])


def plot_speeds(speeds: np.ndarray, machines: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """Frequencies of the suspension modes, and the fastest growth with loops at one gain, a column per machine.

    machines: by title "frequency_Hz" (speeds, 6), "gain_per_s", and "growth_per_s" by variant (speeds,)
    """
    _, axes = plt.subplots(2, len(machines), figsize=(5.8 * len(machines), 7.5), sharex=True, layout="constrained")
    for (upper, lower), (title, found) in zip(axes.T, machines.items(), strict=True):
        upper.plot(speeds, found["frequency_Hz"], color="0.2", lw=1.3)
        upper.plot(speeds, speeds / 60, "--", color="0.6", lw=1)
        upper.annotate("spindle", (speeds[-1], speeds[-1] / 60), color="0.45", fontsize=8, ha="right", va="top")
        upper.set(title=title, ylabel="suspension modes, frame that turns [Hz]", ylim=(0, None))
        lower.axhspan(0, 100, color="#d62728", alpha=0.06, lw=0)
        for name, growth in found["growth_per_s"].items():
            lower.plot(speeds, growth, color=COLORS[name], lw=1.5, label=name)
        lower.set_yscale("symlog", linthresh=0.01, linscale=0.4)
        lower.set(xscale="log", xlabel="speed [rpm]", ylabel=f"largest real part, gain {found['gain_per_s']:g}/s [1/s]")
        lower.set_ylim(-30, 30)
        lower.legend(fontsize=8, loc="upper left", title="unstable above 0", title_fontsize=8)
        for ax in (upper, lower):
            ax.axvspan(1, 60, color="0.5", alpha=0.08, lw=0)
            ax.grid(visible=True, which="major", alpha=0.25)
    save_figure(axes.flat, path)


def plot_maps(speeds: np.ndarray, machines: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """Least damping ratio over speed and gain, red where unstable, a row per machine and a column per variant.

    machines: by title "gains_per_s" (gains,), by variant "growth_map" and "ratio_map" (speeds, gains), and "trials"
    """
    norm = BoundaryNorm(LEVELS, 256)
    figure, axes = plt.subplots(len(machines), 3, figsize=(13, 4 * len(machines)), sharex=True, layout="constrained")
    for row, (title, found) in zip(np.atleast_2d(axes), machines.items(), strict=True):
        gains = found["gains_per_s"]
        for ax, name in zip(row, COLORS, strict=True):
            growth, ratio = found["growth_map"][name].T, found["ratio_map"][name].T
            shown = np.ma.masked_where(growth > 0, np.clip(ratio, 0, LEVELS[-1] - 1e-9))
            ax.set_facecolor("#f4dada")
            mesh = ax.pcolormesh(speeds, gains, shown, norm=norm, cmap="viridis", shading="nearest", rasterized=True)
            if growth.min() < 0 < growth.max():
                ax.contour(speeds, gains, growth, levels=[0], colors="#d62728", linewidths=1.8)
            if growth.max() > 0:
                ax.text(0.97, 0.95, "unstable", transform=ax.transAxes, color="#a01c1c", ha="right", va="top")
            for trial in [found["trials"][name]] if name in found["trials"] else []:
                text = f"simulated: {trial['growth_simulated_per_s']:+.3f}/s"
                place = trial["speed_rpm"], trial["gain_per_s"]
                ax.plot(*place, "o", mfc="w", mec="k", ms=8)
                box = {"fc": "w", "ec": "0.5", "lw": 0.5, "alpha": 0.85, "pad": 2}
                ax.annotate(text, place, xytext=(-8, 12), textcoords="offset points", fontsize=8, ha="right", bbox=box)
            ax.axvline(60, color="0.4", ls=":", lw=1.2)
            ax.set(xlim=speeds[[0, -1]], ylim=gains[[0, -1]], xscale="log", yscale="log")
            ax.set(title=f"{title}, {name}", xlabel="speed [rpm]")
        row[0].set_ylabel("gain [1/s]")
        figure.colorbar(mesh, ax=row, label="least damping ratio", ticks=LEVELS)
    save_figure(np.ravel(axes), path)


def plot_trials(trials: Mapping[str, Mapping[str, Any]], records: Mapping[str, TimeHistory], path: Path) -> None:
    """Simulated distance of the payload from the axis, and the growth or decay that was predicted."""
    ax = plt.subplots(figsize=(7.5, 4.5), layout="constrained")[1]
    for name, trial in trials.items():
        time, distance = records[name].time, 1e6 * np.hypot(records[name]["pose.ux"], records[name]["pose.uy"])
        growth, start = trial["growth_predicted_per_s"], int(np.searchsorted(time, 0.4))
        ax.semilogy(time[1:], distance[1:], color=COLORS[name], lw=2, label=f"{name}, simulated")
        expected = distance[start] * np.exp(growth * (time[start:] - time[start]))
        ax.semilogy(time[start:], expected, "k--", lw=1, label=f"predicted: {growth:+.3f}/s")
    speed, gain = (trial[key] for key in ("speed_rpm", "gain_per_s"))
    ax.set(xlabel="time after a push begins [s]", ylabel="payload from the axis [um]", ylim=(1e-3, None))
    ax.set_title(f"{speed:g} rpm, gain {gain:g}/s")
    ax.legend(fontsize=8)
    ax.grid(visible=True, alpha=0.25)
    save_figure(ax, path)
