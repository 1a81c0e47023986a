"""Study hexapods on a spindle: damping and stability over payload, speed and gain, and effects of tolerances.

A grid gives the least damping ratio with six loops of integral force feedback, and the largest stable gain. A second
study has the hexapod at rest, with its 12 flexible joints and the directions of its six struts within tolerances. It
shows which share of the scatter each tolerance causes. The same command continues a study that was stopped; with more
runs, only the new ones are computed.
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm
from matplotlib.ticker import MaxNLocator

from common.arguments import parser, positive, run, whole
from common.hexapod_machines import JOINTS, RESULTS, TILTS, damped, edge, nominal_push, toleranced
from common.report import print_report, print_table, write_summary
from common.study_tables import group_shares, labelled, print_shares, print_spread, spread
from nassim.plotting import COLORS, plot_sobol, plt, save_figure
from nassim.studies import linear_effects, saltelli_points, sobol_indices, sweep

LEVELS = np.array([0, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5])

arguments = parser(__doc__, "hexapod_study")
arguments.add_argument(
    "--runs", type=whole(2), default=32, help="tolerance points, a power of two; 26 runs each (default: 32)"
)
arguments.add_argument("--gains", type=whole(2), default=10, help="gains of the grid (default: 10)")
arguments.add_argument("--speeds", type=whole(2), default=5, help="speeds of the grid, up to 500 rpm (default: 5)")
arguments.add_argument(
    "--payload-mass", type=positive, default=10.0, help="payload of the tolerance study [kg] (default: 10)"
)
arguments.add_argument("--gain", type=positive, default=50.0, help="gain of the tolerance study [1/s] (default: 50)")
arguments.add_argument(
    "--sample-rate", type=positive, default=10e3, help="sample rate of the loops [Hz] (default: 10000)"
)
arguments.add_argument("--seed", type=whole(0), default=0, help="seed of the tolerance points (default: 0)")
PAYLOADS = [1.0, 10.0, 25.0, 50.0]
GRID_UNITS = {"payload_mass": "kg", "spindle_rpm": "1/min", "gain": "1/s", "growth": "1/s"}
REPORT = """
{failed} of {grid_runs} runs of the grid failed; tolerances: {runs} runs on {points} points, {payload_mass_kg:g} kg, \
gain {gain_per_s:g}/s"""


def plot_damping(damping: Any, edges: Any, path: Path) -> None:
    """Plot the least damping ratio over speed and gain, red where unstable, and the largest stable gain, by payload."""
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
    """Plot histograms of all results, and the share of each parameter in their variance."""
    results = indices.result.values.tolist()
    axes = plt.figure(figsize=(12, 5.5), layout="constrained").subplots(2, 3).ravel()
    for name, ax in zip(results, axes, strict=True):
        unit = study[name].attrs.get("units") or "-"
        ax.hist(study[name].values, bins=12, color=COLORS[0])
        ax.set(xlabel=f"{name.replace('_', ' ')} [{unit}]", ylabel="runs")
        ax.ticklabel_format(axis="x", useOffset=False)
        ax.locator_params(axis="x", nbins=4)
        ax.yaxis.set_major_locator(MaxNLocator(integer=True))
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
