"""Compute a dynamic error budget of the end-station: motion of the sample by each disturbance, with and without loops.

Floor motion, runout of the spindle and noise of the stages act on granite, stages and nano-hexapod. There are three
machines: the open one, one damped by six loops of integral force feedback, and the damped one within a loop of the
sample's pose, sampled and delayed. The spindle is locked. The effect of its rotation on poles is computed for a station
with equal properties in all directions across the spindle's axis. Spectra are ASSUMED unless a file gives them, and
describe no real floor, spindle or stage. Most values of the stages are assumed too (`models.nass`). Whether targets are
met says nothing about the real machine.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

from common.arguments import parser, positive, run
from common.report import print_report, print_table, write_summary
from common.station_spectra import AIMS, assumed_spectra
from models.hexapods import NANO_HEXAPOD
from models.nass import SIX, alike_across, make_nass, suspension
from models.nass_loops import POSE, force_loop, pose_loop
from nassim import FRF, LinearModel, Loop, linearize
from nassim.kinematics import StewartPlatform
from nassim.plotting import COLORS, plt, save_figure
from nassim.signals import TabulatedSpectrum
from nassim.systems import (
    NoiseBudget,
    close_loop,
    damping,
    noise_budget,
    open_loop,
    sampled,
    sensitivity,
    unstable_poles,
)

SHOWN = {"ux": "x", "uz": "z", "ry": "ry"}
UNITS = {"u": ("nm", 1e9), "r": ("nrad", 1e9)}
arguments = parser(__doc__, "nass_budget")
arguments.add_argument("--spectra", type=Path, help="CSV: frequency [Hz], and density of each input in SI, unit^2/Hz")
for name, default, text in (
    ("--floor", 0.2e-6, "rms velocity per third of an octave below 20 Hz, assumed [m/s]"),
    ("--runout", 50e-9, "rms of the spindle's runout, mostly below 5 Hz, assumed [m]"),
    ("--stage", 20e-9, "rms of the stages' noise, mostly below 5 Hz, assumed [m]"),
    ("--payload-mass", 10.0, "mass of the payload [kg]"),
    ("--height", 0.1, "height of the sample above the plate [m]"),
    ("--gain", 200.0, "gain of the force feedback [1/s]"),
    ("--crossover", 15.0, "crossover frequency of the pose loops [Hz]"),
    ("--speed", 60.0, "speed of the spindle for the poles [rpm]"),
    ("--sample-rate", 10e3, "sample rate of all loops [Hz]"),
    ("--highest", 500.0, "highest frequency of the budget [Hz]"),
):
    arguments.add_argument(name, type=positive, default=default, help=f"{text} (default: {default:g})")
arguments.add_argument(
    "--coordinates", choices=("struts", "cartesian"), default="struts", help="coordinates of the pose loops"
)
REPORT = """
spectra: {spectra}; stages: figures assumed or unverified, see models.nass
loops at {sample_rate_Hz:g} Hz with a sample of delay: force feedback {gain_per_s:g}/s; pose by {coordinates}, \
crossover {crossover_Hz:g} Hz, largest sensitivity {largest_sensitivity:.2f}
least damping ratio below 150 Hz: open {least_damping/open*100:.2f} %, damped {least_damping/damped*100:.2f} %, \
pose {least_damping/pose*100:.2f} %
at {speed_rpm:g} rpm, stages alike across the axis, force feedback: {spinning}; modes move by up to \
{spinning_shift_Hz:.2f} Hz"""
MODES = {"frequency [Hz]": "Hz:.2f", "moves most": "moves"}
AXES = {"x [nm]": "ux*1e9:.1f", "y [nm]": "uy*1e9:.1f", "z [nm]": "uz*1e9:.1f", "rx [nrad]": "rx*1e9:.0f"}
AXES |= {"ry [nrad]": "ry*1e9:.0f", "rz [nrad]": "rz*1e9:.0f"}


def read_spectra(path: Path, inputs: Sequence[str]) -> dict[str, TabulatedSpectrum]:
    """Read spectra from a CSV file.

    The file has a column "frequency" [Hz], and by name of an input its one-sided density in SI units, unit^2/Hz.

    Raises:
        ValueError: for unknown columns, rows of unequal lengths and entries that are no numbers
    """
    with path.open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.reader(file, skipinitialspace=True) if row and not row[0].startswith("#")]
    header = [name.strip() for name in rows[0]] if rows else []
    if "frequency" not in header or len(header) < 2:
        raise ValueError(f"{path}: the first line must name the columns, frequency and some of {', '.join(inputs)}")
    unknown = [name for name in header if name not in ("frequency", *inputs)]
    if unknown:
        raise ValueError(f"{path}: unknown input {unknown[0]!r}; known: {', '.join(inputs)}")
    try:
        table = np.array([[float(cell) for cell in row] for row in rows[1:]])
        columns: Mapping[str, np.ndarray] = dict(zip(header, table.T, strict=True))
    except ValueError as error:
        raise ValueError(f"{path}: each row must have {len(header)} numbers ({error})") from error
    return {name: TabulatedSpectrum(columns["frequency"], columns[name]) for name in header if name != "frequency"}


def with_loop(model: LinearModel, loop: Loop) -> LinearModel:
    """Return a sampled model with a closed loop."""
    return close_loop(model, loop.controller, measured=loop.measured, driven=loop.driven)


def machines(
    model: LinearModel, force: Loop, crossover: float, coordinates: str, platform: StewartPlatform
) -> tuple[dict[str, LinearModel], Loop]:
    """Return sampled end-stations "open", "damped" by force feedback and in the "pose" loop, and that loop."""
    assert model.time_step is not None
    damped = with_loop(model, force)
    pose = pose_loop(damped, crossover, coordinates=coordinates, sample_rate=1 / model.time_step, platform=platform)
    return {"open": model, "damped": damped, "pose": with_loop(damped, pose)}, pose


def pose_sensitivity(damped: LinearModel, pose: Loop, frequency: np.ndarray) -> FRF:
    """Return the sensitivity of the sample's motion in the pose loop, (6, 6, n)."""
    return sensitivity(open_loop(damped, pose.controller, frequency, measured=pose.measured, driven=pose.driven))[0]


def least_damping(model: LinearModel) -> float:
    """Return the least damping ratio of oscillations between 3 and 150 Hz."""
    frequency, ratio = damping(model)
    return float(ratio[(frequency > 3) & (frequency < 150) & (ratio < 0.99)].min())


def spinning_figures(speed: float, force: Loop, platform: StewartPlatform, payload_mass: float) -> dict[str, object]:
    """Tell whether the damped station is stable at a speed, and how far its twelve lowest modes shift.

    The stages have equal properties in all directions across the axis, which a linear model of rotation requires.
    """
    options = {"stages": alike_across(), "platform": platform, "payload_mass": payload_mass}
    spinning, at_rest = (linearize(make_nass(spindle_rpm=rpm, frame="rotor", **options)) for rpm in (speed, 0.0))
    moved = np.abs(damping(spinning)[0][:12] - damping(at_rest)[0][:12])
    growing = unstable_poles(with_loop(sampled(spinning, force.controller.sample_rate), force))
    return {
        "speed_rpm": speed,
        "spinning": f"unstable, {growing[0]}" if growing else "stable",
        "spinning_shift_Hz": moved.max(),
    }


def by_axis(rms: np.ndarray) -> dict[str, float]:
    """Return six figures by direction."""
    return dict(zip(SIX, map(float, rms), strict=True))


def shares(budgets: Mapping[str, NoiseBudget]) -> dict[str, dict[str, dict[str, float]]]:
    """Return rms values by machine, disturbance (and "total") and direction."""
    return {
        name: {k: by_axis(rms) for b in (budget, budget.total) for k, rms in zip(b.inputs, b.rms().T, strict=True)}
        for name, budget in budgets.items()
    }


def plot_budgets(budgets: Mapping[str, NoiseBudget], limits: Mapping[str, float], label: str, path: Path) -> None:
    """Plot cumulative amplitudes from high to low frequencies by disturbance; rows: directions, columns: machines."""
    figure, axes = plt.subplots(
        len(SHOWN), len(budgets), figsize=(13, 9.5), sharex=True, sharey="row", layout="constrained"
    )
    for row, (six, letter) in zip(axes, SHOWN.items(), strict=True):
        unit, factor = UNITS[six[0]]
        for ax, (name, budget) in zip(row, budgets.items(), strict=True):
            k = budget.outputs.index(f"metrology.{six}")
            for j, source in enumerate(budget.inputs):
                line, style = factor * budget.cumulative()[k, j], "-" if j < 6 else "--"
                look = {"color": COLORS[j % len(COLORS)], "lw": 1.1, "label": source}
                ax.loglog(budget.frequency, np.maximum(line, 1e-9), style, **look)
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
    """Plot the sensitivity of each motion of the sample in the pose loop."""
    ax = plt.subplots(figsize=(7.5, 4.5), layout="constrained")[1]
    for pose, six, color in zip(POSE, SIX, COLORS, strict=False):
        style = "--" if six[1] == "y" else "-"  # for stages alike in x and y, whose curves lie on each other
        ax.loglog(left.frequency, np.abs(left.response(pose, pose)), style, color=color, lw=1.3, label=six)
    ax.axhline(1.0, color="0.5", lw=1)
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set(xlabel="frequency [Hz]", ylabel="sensitivity of the pose's loop [-]")
    ax.legend(fontsize=8, ncols=2)
    ax.grid(visible=True, which="both", alpha=0.25)
    save_figure(ax, path)


def main() -> None:
    args = arguments.parse_args()
    platform = replace(NANO_HEXAPOD, point=np.array([0, 0, args.height]))
    scene = make_nass(platform=platform, payload_mass=args.payload_mass)
    if args.spectra:
        label, spectra = f"from {args.spectra}", read_spectra(args.spectra, scene.inputs)
    else:
        label = f"ASSUMED: floor {args.floor:g} m/s, runout {args.runout:g} m, stages {args.stage:g} m"
        spectra = assumed_spectra(scene.inputs, floor=args.floor, runout=args.runout, stage=args.stage)
    force = force_loop(args.gain, sample_rate=args.sample_rate)
    models, pose = machines(
        sampled(linearize(scene), args.sample_rate), force, args.crossover, args.coordinates, platform
    )
    band = np.geomspace(1.0, args.highest, 300)
    budgets = {name: noise_budget(model, spectra, band, outputs=POSE) for name, model in models.items()}
    left = pose_sensitivity(models["damped"], pose, band)
    summary = {
        "spectra": label,
        **{"sample_rate_Hz": args.sample_rate, "gain_per_s": args.gain},
        "crossover_Hz": args.crossover,
        "coordinates": args.coordinates,
        "modes": [{"Hz": f, "moves": ", ".join(list(shares)[:3])} for f, shares in suspension(scene)],
        "least_damping": {name: least_damping(model) for name, model in models.items()},
        "largest_sensitivity": np.abs(np.einsum("iif->if", left.values)).max(),
        **spinning_figures(args.speed, force, platform, args.payload_mass),
        "rms": shares(budgets),
        "aims": AIMS,
    }
    print_table("modes below 150 Hz", {str(k): mode for k, mode in enumerate(summary["modes"], 1)}, MODES)
    print_report(REPORT, summary)
    for name, rows in summary["rms"].items():
        print_table(f"{name}, rms", {**rows, "aim": summary["aims"]}, AXES)
    if not args.no_plot:
        plot_budgets(budgets, AIMS, label, args.output / "budget.png")
        plot_sensitivity(left, args.output / "sensitivity.png")
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
