"""Pictures of the end-station's error budget."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from models.nass import SIX
from models.nass_loops import POSE
from nassim import FRF
from nassim.plotting import plt, save_figure
from nassim.systems import NoiseBudget

SHOWN = {"ux": "x", "uz": "z", "ry": "ry"}
UNITS = {"u": ("nm", 1e9), "r": ("nrad", 1e9)}


def plot_budgets(budgets: Mapping[str, NoiseBudget], limits: Mapping[str, float], label: str, path: Path) -> None:
    """Cumulative amplitudes from high to low frequencies by disturbance: a row per direction, a column per machine."""
    figure, axes = plt.subplots(
        len(SHOWN), len(budgets), figsize=(13, 9.5), sharex=True, sharey="row", layout="constrained"
    )
    for row, (six, letter) in zip(axes, SHOWN.items(), strict=True):
        unit, factor = UNITS[six[0]]
        for ax, (name, budget) in zip(row, budgets.items(), strict=True):
            k = budget.outputs.index(f"metrology.{six}")
            for j, source in enumerate(budget.inputs):
                line, style = factor * budget.cumulative()[k, j], "-" if j < 6 else "--"
                ax.loglog(budget.frequency, np.maximum(line, 1e-9), style, color=f"C{j}", lw=1.1, label=source)
            total = budget.total
            ax.loglog(budget.frequency, np.maximum(factor * total.cumulative()[k, 0], 1e-9), "k", lw=1.8, label="total")
            rms = factor * total.rms()[k, 0]
            ax.axhline(factor * limits[six], color="0.5", ls=":", lw=1.6, label="aim")
            ax.set_title(f"{letter}, {name}: {rms:.3g} {unit} rms, aim {factor * limits[six]:g}", fontsize=10)
            top = factor * max(b.total.rms()[k, 0] for b in budgets.values())
            ax.set_ylim(1e-3 * top, 3 * top)
            ax.grid(visible=True, which="major", alpha=0.25)
        row[0].set_ylabel(f"{letter}, rms above a frequency [{unit}]")
    for ax in axes[-1]:
        ax.set_xlabel("frequency [Hz]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=8)
    figure.suptitle(f"spectra: {label}; stages: figures assumed or unverified", fontsize=10)
    save_figure(axes.flat, path)


def plot_sensitivity(left: FRF, path: Path) -> None:
    """What the pose's loop leaves of each motion of the sample, and where it makes more of it."""
    ax = plt.subplots(figsize=(7.5, 4.5), layout="constrained")[1]
    for k, six in enumerate(SIX):
        ax.loglog(left.frequency, np.abs(left.response(POSE[k], POSE[k])), color=f"C{k}", lw=1.3, label=six)
    ax.axhline(1.0, color="0.5", lw=1)
    ax.set(xlabel="frequency [Hz]", ylabel="sensitivity of the pose's loop [-]")
    ax.legend(fontsize=8, ncols=2)
    ax.grid(visible=True, which="both", alpha=0.25)
    save_figure(ax, path)
