"""Pictures of experiments on the end-station."""

from pathlib import Path

import numpy as np

from common.station_experiments import DISTURBANCES, HIGHEST, LOWEST, MACHINES, Experiment, Station
from common.station_scans import SPINDLE, TILT, tomography
from common.station_spectra import AIMS
from models.nass import SIX
from nassim import simulate_motion
from nassim.plotting import COLORS, plt, save_figure
from nassim.signals import sample_times
from nassim.systems import recorded_budget
from nassim.viewer import view_motion, write_page

LABELS = {"ux": "Dx", "uy": "Dy", "uz": "Dz", "rx": "Rx", "ry": "Ry", "rz": "Rz"}
COLOR = dict(zip(MACHINES, (COLORS[k] for k in (0, 2, 1)), strict=True))
TURNS_ON_PAGE = 0.5


def unit(six: str) -> str:
    """Return the unit of figures of a direction."""
    return "nm" if six[0] == "u" else "nrad"


def plot_tomography(experiments: list[Experiment], path: Path) -> None:
    """Plot the errors across and along the axis over the angle of the spindle, open and closed."""
    rows = sorted({(e.scan.rpm, e.payload) for e in experiments})
    figure, axes = plt.subplots(len(rows), 2, figsize=(11, 2.2 * len(rows) + 1), squeeze=False, layout="constrained")
    for row, case in zip(axes, rows, strict=True):
        for ax, six in zip(row, ("uy", "uz"), strict=True):
            for e in experiments:
                if (e.scan.rpm, e.payload) == case and e.machine != "damped":
                    draw_error(ax, e, six, e.scan.rpm / 60 * e.errors.time)
            ax.axhspan(-1e9 * AIMS[six], 1e9 * AIMS[six], color="0.6", alpha=0.35, lw=0)
            title_and_legend(ax, f"{LABELS[six]}, {case[0]:g} rpm, {case[1]:g} kg")
    for ax in axes[-1]:
        ax.set_xlabel("turns of the spindle")
    figure.suptitle("errors along the axes of the beam; grey: aim of the rms", fontsize=11)
    save_figure(axes.flat, path)


def draw_error(ax: plt.Axes, experiment: Experiment, six: str, places: np.ndarray) -> None:
    """Draw an error over places, with its rms."""
    k = SIX.index(six)
    rms = 1e9 * experiment.rms[k]
    label = f"{experiment.machine}, {rms:.{1 if rms < 100 else 0}f} {unit(six)} rms"
    ax.plot(places, 1e9 * experiment.errors.values[k], COLOR[experiment.machine], lw=0.7, label=label)
    ax.set_ylabel(f"error [{unit(six)}]")
    ax.grid(visible=True, alpha=0.25)


def title_and_legend(ax: plt.Axes, title: str) -> None:
    """Put a title and the legend above a plot, where no curve is."""
    ax.set_title(title, fontsize=10, loc="left")
    place = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.0}
    ax.legend(fontsize=8, ncols=2, frameon=False, **place)


def plot_scan(experiments: list[Experiment], path: Path) -> None:
    """Plot the set point of a scan over time, and three errors below it, open and closed."""
    scan = experiments[0].scan
    (name, drive), at = next(iter(scan.drives.items())), experiments[0].errors.time
    figure, axes = plt.subplots(4, 1, figsize=(10, 9), sharex=True, layout="constrained")
    units = {SPINDLE: (180 / np.pi, "deg"), TILT: (1e3, "mrad")}
    factor, unit_of_path = units.get(name, (1e3, "mm"))
    axes[0].plot(at, factor * drive[-len(at) :], "k", lw=1)
    axes[0].set_ylabel(f"{name.replace('_', ' ')} [{unit_of_path}]")
    axes[0].grid(visible=True, alpha=0.25)
    for ax, six in zip(axes[1:], ("ux" if scan.follows == TILT else "uy", "uz", "ry"), strict=True):
        for e in experiments:
            draw_error(ax, e, six, at)
        ax.axhspan(-1e9 * AIMS[six], 1e9 * AIMS[six], color="0.6", alpha=0.35, lw=0)
        title_and_legend(ax, f"{LABELS[six]}; grey: aim of the rms")
    for ax in axes:
        ax.fill_between(at, 0, 1, ~scan.measured[-len(at) :], transform=ax.get_xaxis_transform(), color="C3", alpha=0.1)
    axes[-1].set(xlabel="time [s]", xlim=(at[0], at[-1]))
    figure.suptitle(f"{scan.name.replace('_', ' ')}, {experiments[0].payload:g} kg; pink: not measured", fontsize=11)
    save_figure(axes, path)


def plot_spectra(experiments: list[Experiment], path: Path) -> None:
    """Plot the cumulative rms of three directions along the axes of the beam, of the runs and of the linear models."""
    case = max((e.scan.rpm, -e.payload) for e in experiments)
    chosen = [e for e in experiments if (e.scan.rpm, -e.payload) == case]
    figure, axes = plt.subplots(1, 3, figsize=(12, 4.2), layout="constrained")
    for ax, six in zip(axes, ("uy", "uz", "ry"), strict=True):
        row = SIX.index(six)
        for e in chosen:
            found = recorded_budget(e.errors, segment_duration=min(2.0, e.errors.duration / 4))
            ax.loglog(
                found.frequency, 1e9 * found.cumulative()[row, 0], COLOR[e.machine], lw=1.2, label=f"{e.machine}, run"
            )
            line = 1e9 * e.predicted_above(row)
            ax.loglog(e.budget.frequency, line, COLOR[e.machine], ls="--", lw=1.2, label=f"{e.machine}, linear model")
        ax.axhline(1e9 * AIMS[six], color="0.5", ls=":", lw=1.6, label="aim")
        label = f"{LABELS[six]}, rms above a frequency [{unit(six)}]"
        ax.set(xlabel="frequency [Hz]", ylabel=label, xlim=(LOWEST, HIGHEST))
        top = 1e9 * max(e.rms[row] for e in chosen)
        ax.set_ylim(1e-3 * top, 3 * top)
        ax.grid(visible=True, which="both", alpha=0.25)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=7, fontsize=9)
    figure.suptitle(f"tomography at {case[0]:g} rpm with {-case[1]:g} kg", fontsize=11)
    save_figure(axes.flat, path)


def plot_shares(experiments: list[Experiment], path: Path) -> None:
    """Plot the mean square of closed machines by disturbance over the square of the aim."""
    closed = [e for e in experiments if e.machine == "closed"]
    height = 0.35 * len(closed) + 1.6
    figure, axes = plt.subplots(1, 3, figsize=(13, height), sharey=True, layout="constrained")
    for ax, six in zip(axes, ("uy", "uz", "ry"), strict=True):
        k, left = SIX.index(six), np.zeros(len(closed))
        for color, name in zip(COLORS, DISTURBANCES, strict=True):
            widths = 100 * np.array([(e.shares[name][k] / AIMS[six]) ** 2 for e in closed])
            ax.barh(range(len(closed)), widths, left=left, color=color, label=name)
            left += widths
        runs = [100 * (e.rms[k] / AIMS[six]) ** 2 for e in closed]
        ax.plot(runs, range(len(closed)), "kd", ms=5, label="run")
        ax.axvline(100.0, color="k", ls=":", lw=1.4, label="aim")
        ax.set_xlim(0.0, 1.06 * max(100.0, *runs, *left))
        ax.set_xlabel(f"{LABELS[six]}: mean square over that of the aim [%]")
        ax.grid(visible=True, axis="x", alpha=0.25)
    axes[0].set_yticks(range(len(closed)), [e.title.replace("_", " ") for e in closed], fontsize=9)
    axes[0].invert_yaxis()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=10, fontsize=9)
    save_figure(axes, path)


def write_motion(experiment: Experiment, station: Station, path: Path) -> None:
    """Write a page on which the machine turns and its motion is magnified."""
    rpm, duration, rate = experiment.scan.rpm, TURNS_ON_PAGE * 60 / experiment.scan.rpm, station.args.sample_rate
    scene = station.scene(rpm, machine=experiment.machine)
    scan = tomography(sample_times(duration, rate), rpm, 0.0)
    given = station.excitation(scene, scan, station.noise(scene, duration, 2 / duration), station.equilibrium(rpm))
    _, motion = simulate_motion(scene, given, time_step=1 / rate, method="exact", frames=150, progress=False)
    write_page(view_motion(scene, motion), path)
