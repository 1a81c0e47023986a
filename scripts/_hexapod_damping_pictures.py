"""Pictures of the hexapod with its loops: damped plants, compliances, decays."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from nassim import FRF, TimeHistory
from nassim.plotting import COLORS, plt


def plot_plants(frfs: Sequence[FRF]) -> Any:
    """Encoders' answers to the voltage of strut 1 by gain, its own and its neighbour's; returns two Axes."""
    _, axes = plt.subplots(1, 2, figsize=(13, 5), sharey=True, layout="constrained")
    for ax, row in zip(axes, (1, 2), strict=True):
        for color, frf in zip(COLORS, frfs, strict=False):
            response = frf.response(f"strut_{row}/encoder", "strut_1/actuator_voltage")
            ax.loglog(frf.frequency, np.abs(response), color=color, lw=1.3, label=frf.label)
        ax.set_title(f"encoder of strut {row} for the voltage of strut 1", fontsize=11)
        ax.set_xlabel("frequency [Hz]")
        ax.grid(True, which="both", alpha=0.25)
    axes[0].set_ylabel("magnitude [m/V]")
    axes[0].legend(fontsize=9)
    return list(axes)


def plot_compliances(frfs: Sequence[FRF]) -> Any:
    """The payload's motion for forces and torques on it, along and about each axis; returns six Axes."""
    _, axes = plt.subplots(2, 3, figsize=(13, 7.5), sharex=True, sharey="row", layout="constrained")
    pairs = [("u", "force"), ("r", "torque")]
    for row, (motion, load) in enumerate(pairs):
        for column, axis in enumerate("xyz"):
            ax = axes[row, column]
            for color, frf in zip(COLORS, frfs, strict=False):
                response = frf.response(f"pose.{motion}{axis}", f"payload_{load}_{axis}")
                ax.loglog(frf.frequency, np.abs(response), color=color, lw=1.2, label=frf.label)
            ax.set_title(f"{load} {'along' if load == 'force' else 'about'} {axis}", fontsize=11)
            ax.grid(True, which="both", alpha=0.25)
            axes[1, column].set_xlabel("frequency [Hz]")
    axes[0, 0].set_ylabel("compliance [m/N]")
    axes[1, 0].set_ylabel("compliance [rad/(N m)]")
    axes[0, 0].legend(fontsize=9)
    return list(axes.flat)


def plot_decays(records: Mapping[float, Sequence[TimeHistory]]) -> Any:
    """Simulated poses after the pushes, by gain [1/s]: along x after the first, along z after the last one."""
    _, axes = plt.subplots(2, 1, figsize=(8, 6), sharex=True, layout="constrained")
    for color, (gain, decays) in zip(COLORS[1:], records.items(), strict=False):
        for ax, record, name in zip(axes, (decays[0], decays[-1]), ("pose.ux", "pose.uz"), strict=True):
            ax.plot(record.time, 1e6 * record[name], color=color, lw=1.2, label=f"gain {gain:.0f}/s")
            ax.set_ylabel(f"{name} [µm]")
    axes[0].set_title("simulated, after a push on the payload", fontsize=11)
    axes[0].legend(fontsize=9)
    axes[1].set_xlabel("time [s]")
    for ax in axes:
        ax.grid(True, alpha=0.25)
    return list(axes)
