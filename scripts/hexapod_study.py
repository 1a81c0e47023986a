"""Hexapods on a spindle: damping and stability over payload, speed and gain, and what tolerances of their parts do.

First a grid: least damping ratio with six loops of integral force feedback, and the largest stable gain. Then the same
hexapod at rest, its 12 flexible joints and the directions of its six struts within tolerances: which of them brings how
much of the scatter. The same command goes on with a study that was stopped, and with more runs does the new ones only.
"""

from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm
from scipy.stats import norm

from common.arguments import parser, positive, run, whole
from common.report import print_report, print_table, write_summary
from common.spinning import HIGHEST, Machine, own_machine
from common.study_tables import group_shares, labelled, print_shares, print_spread, spread
from models.hexapods import NANO_HEXAPOD
from models.nano_hexapod import make_nano_hexapod
from models.strut import two_mass_strut, with_own_damping
from nassim import LinearModel, Scene, frequency_response, linearize
from nassim.kinematics import strut_frames, strut_lengths
from nassim.plotting import plot_sobol, plt, save_figure
from nassim.studies import linear_effects, saltelli_points, sobol_indices, sweep
from nassim.systems import decentralised, largest_stable_gain, sampled

SIX = range(1, 7)
JOINTS = {f"joint_{k}_{end}": norm(1.0, 0.05) for k in SIX for end in ("bottom", "top")}
"""All six stiffnesses of each flexible joint over their nominal values; a deviation of 5 %, assumed."""
TILTS = {f"tilt_{k}_{axis}": norm(0.0, 0.6e-3) for k in SIX for axis in "xy"}
"""By which each strut is turned about the x and y of its own frame [rad]: its upper joint 0.05 mm off, assumed."""
POSE = [f"pose.{name}" for name in ("ux", "uy", "uz", "rx", "ry", "rz")]
RESULTS = dict(lowest_mode="Hz", highest_mode="Hz", damping_ratio="", shift_x="", shift_y="", tilt_x="rad/m")
"""Of the suspension modes; least damping with six loops; what a push along z, by the nominal machine, moves beside."""
LEVELS = np.array([0, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5])

arguments = parser(__doc__, "hexapod_study")
arguments.add_argument(
    "--runs", type=whole(2), default=32, help="points of the tolerances, a power of two; 26 runs each (default: 32)"
)
arguments.add_argument("--gains", type=whole(2), default=10, help="of the grid (default: 10)")
arguments.add_argument("--speeds", type=whole(2), default=5, help="of the grid, up to 500 rpm (default: 5)")
arguments.add_argument("--payload-mass", type=positive, default=10.0, help="of the tolerances [kg] (default: 10)")
arguments.add_argument("--gain", type=positive, default=50.0, help="of the tolerances' loops [1/s] (default: 50)")
arguments.add_argument("--sample-rate", type=positive, default=10e3, help="of the loops [Hz] (default: 10000)")
arguments.add_argument("--seed", type=whole(0), default=0, help="of the plan (default: 0)")
PAYLOADS = [1.0, 10.0, 25.0, 50.0]
GRID_UNITS = {"payload_mass": "kg", "spindle_rpm": "1/min", "gain": "1/s", "growth": "1/s"}
REPORT = """
{failed} of {grid_runs} runs of the grid failed; tolerances: {runs} runs on {points} points, {payload_mass_kg:g} kg, \
gain {gain_per_s:g}/s"""


@cache
def _sampled(payload_mass: float, spindle_rpm: float, sample_rate: float) -> tuple[Machine, LinearModel]:
    machine = own_machine(payload_mass)
    return machine, sampled(machine.plant(spindle_rpm, parallel=True), sample_rate)


def damped(payload_mass: float, spindle_rpm: float, gain: float, *, sample_rate: float) -> dict[str, float]:
    """Least damping ratio below `HIGHEST` and fastest growth [1/s] of a hexapod with six integrators; gain [1/s]."""
    machine, plant = _sampled(payload_mass, spindle_rpm, sample_rate)
    poles = machine.closed(plant, gain, 0.0).poles()
    return {"damping_ratio": _least_damping(poles), "growth": float(poles.real.max())}


def edge(payload_mass: float, spindle_rpm: float, *, sample_rate: float) -> dict[str, float]:
    """Largest gain of the six integrators that is stable [1/s]; 0 where every gain makes a slow motion grow."""
    machine, plant = _sampled(payload_mass, spindle_rpm, sample_rate)
    six = decentralised(*[machine.controller(1.0, 0.0, sample_rate)] * 6)
    gains = np.append(0.0, np.geomspace(1.0, sample_rate, 30))
    return {"largest_stable_gain": largest_stable_gain(plant, six, gains, **machine.wires)}


def toleranced(
    *, payload_mass: float, gain: float, sample_rate: float, push: np.ndarray, **deviations: float
) -> dict[str, float]:
    """`RESULTS` of a standing hexapod whose joints and struts deviate, by names of `JOINTS` and `TILTS`.

    push: voltages, (6,), that move the nominal one along z by 1 m; gain: of the six integrators [1/s]
    """
    model, machine = linearize(_hexapod(payload_mass, deviations)), own_machine(payload_mass)
    modes = np.sort(np.abs(model.poles()))[:12:2] / (2 * np.pi)
    moved = _statics(model, machine) @ push
    return {
        "lowest_mode": modes[0],
        "highest_mode": modes[5],
        "damping_ratio": _least_damping(machine.closed(sampled(model, sample_rate), gain, 0.0).poles()),
        "shift_x": moved[0],
        "shift_y": moved[1],
        "tilt_x": moved[3],
    }


def nominal_push(payload_mass: float) -> np.ndarray:
    """Voltages of the six actuators that move the hexapod as drawn along z by 1 m, if it could, (6,)."""
    statics = _statics(linearize(_hexapod(payload_mass, {})), own_machine(payload_mass))
    return np.linalg.solve(statics, np.eye(6)[2])


def _statics(model: LinearModel, machine: Machine) -> np.ndarray:
    response = frequency_response(model, np.array([1e-3]))
    return np.array([[response.response(y, u)[0].real for u in machine.wires["driven"]] for y in POSE])


def _hexapod(payload_mass: float, deviations: dict[str, float]) -> Scene:
    """The machine of `own_machine` that stands, with deviations."""
    lengths, axes = strut_lengths(NANO_HEXAPOD), strut_frames(NANO_HEXAPOD)
    turns = np.array([[deviations.get(f"tilt_{k}_{a}", 0.0) for a in "xy"] for k in SIX])
    # A turn about x moves the upper end along -y, one about y along x.
    moved = lengths[:, None] * np.einsum("kij,kj->ki", axes[:, :, :2], turns[:, ::-1] * [1.0, -1.0])
    platform = replace(NANO_HEXAPOD, platform_joints=NANO_HEXAPOD.platform_joints + moved)
    struts = [_strut(k, float(length), deviations) for k, length in zip(SIX, strut_lengths(platform), strict=True)]
    return make_nano_hexapod(struts, platform=platform, payload_mass=payload_mass)


def _strut(k: int, length: float, deviations: dict[str, float]) -> Scene:
    strut = two_mass_strut(length=length)
    factors = {f"{end}_joint": deviations.get(f"joint_{k}_{end}", 1.0) for end in ("bottom", "top")}
    springs = [replace(s, stiffness=factors.get(s.name, 1.0) * s.stiffness) for s in strut.springs]
    return with_own_damping(replace(strut, springs=tuple(springs)), 0.01)


def _least_damping(poles: np.ndarray) -> float:
    counted = poles[(poles.imag > 0) & (np.abs(poles) < 2 * np.pi * HIGHEST)]
    return float((-counted.real / np.abs(counted)).min())


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


def main() -> None:
    args = arguments.parse_args()
    rate = {"sample_rate": args.sample_rate}
    grid = {"payload_mass": PAYLOADS, "spindle_rpm": np.linspace(0.0, 500.0, args.speeds)}
    edges = sweep(partial(edge, **rate), grid=grid, folder=args.output / "edges", units={"spindle_rpm": "1/min"})
    gains = {"gain": np.geomspace(5.0, 5000.0, args.gains)}
    damping = sweep(partial(damped, **rate), grid=grid | gains, folder=args.output / "damping", units=GRID_UNITS)

    samples = saltelli_points(JOINTS | TILTS, args.runs, seed=args.seed)
    push = nominal_push(args.payload_mass)
    machine = partial(toleranced, payload_mass=args.payload_mass, gain=args.gain, push=push, **rate)
    study = sweep(machine, samples=samples, folder=args.output / "tolerances", units=RESULTS)
    indices, independent = sobol_indices(study), study.isel(run=slice(2 * args.runs))
    shares, uncertainties = group_shares(indices, {"12 joints": list(JOINTS), "directions of 6 struts": list(TILTS)})
    best = damping.damping_ratio.where(damping.growth < 0).max("gain")
    summary = {
        "failed": int((damping.status == "failed").sum()),
        "grid_runs": damping.status.size,
        "largest_stable_gain_per_s": labelled(edges.largest_stable_gain),
        "largest_damping_ratio": labelled(best),
        "runs": len(samples),
        "points": args.runs,
        "payload_mass_kg": args.payload_mass,
        "gain_per_s": args.gain,
        "tolerances": spread(independent, linear_effects(study)),
        "shares": shares,
        "share_uncertainties": uncertainties,
        "total_shares": labelled(indices.total.transpose()),
    }

    for title, key, form in (
        ("largest stable gain [1/s]", "largest_stable_gain_per_s", ":.0f"),
        ("damping ratio at the best gain", "largest_damping_ratio", ":.3f"),
    ):
        rows = {f"{payload} kg": row for payload, row in summary[key].items()}
        print_table(title, rows, {f"{speed:g} rpm": f"{speed:g}{form}" for speed in grid["spindle_rpm"]})
    print_report(REPORT, summary)
    print_spread("result", summary["tolerances"])
    print_shares(summary["shares"], summary["share_uncertainties"])
    if not args.no_plot:
        plot_damping(damping, edges, args.output / "damping.png")
        plot_tolerances(independent, indices, args.output)
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
