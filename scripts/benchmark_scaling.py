"""Measure how costs grow with nodes (reduction), struts and states (steps, responses), and samples (signals).

Every size runs in its own process on one thread. Times are CPU times, so other work on the machine has little effect.
Memory is the largest memory of the process; the table also has its growth after the libraries were loaded. Exponents
are those of cost ~ size^exponent, by least squares of the logarithms, with standard errors. A cost that does not depend
on the size lowers the exponent at small sizes.

simulate, estimate_frf and identify_modes process the samples in one process, whose memory is that of all three.
"""

import json
import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import netgen.occ  # noqa: F401  (before ngsolve: loads the CAD kernel)
import ngsolve as ng
import numpy as np
import scipy
from matplotlib.ticker import EngFormatter, LogLocator

from common.arguments import parser, positive, run, several, whole
from common.costs import cpu_time, run_in_own_process
from common.limits import held_unknowns
from common.reductions import N_MODES, N_SOLVES
from common.report import print_table, write_summary
from common.signal_routes import RATE, SIGNALS
from models.apa300ml import make_apa300ml, reduced_apa300ml
from models.bench import make_bench
from models.strut import LENGTH, fe_strut
from nassim import (
    Bushing,
    Encoder,
    PointForce,
    ReducedBody,
    RigidBody,
    Scene,
    TimeHistory,
    craig_bampton,
    estimate_frf,
    fixed,
    frequency_response,
    identify_modes,
    joined,
    linearize,
    placed,
    simulate,
)
from nassim.base import peak_memory
from nassim.fem import assemble_mesh, generate_mesh
from nassim.fem.solver import factorize
from nassim.plotting import COLORS, plt, save_figure
from nassim.signals import band_limited_noise

RADIUS = 0.1
"""Radius of the ring [m]."""
CUTOFF = 600.0
"""Cut-off frequency of the struts' bodies [Hz]."""
METHODS = {"exact": ("linear", "exact", 20_000), "linear": ("linear", None, 2000), "ffrf": ("ffrf", None, 100)}
"""Fidelity, method and n steps. The time of n steps is subtracted from that of 5 n, so the start does not count."""
TURNS = 3
"""Number of repetitions, of which the fastest counts."""
FREQUENCIES = np.geomspace(1.0, 1e3, 1000)
"""Frequencies of the responses [Hz]."""
BLOCK = 16
"""Number of right-hand sides that are solved together."""
MANY = 1_000_000
"""Number of samples from which on one repetition is enough."""
Rows = Mapping[str, Mapping[str, float]]
"""Measured values by the size that the user gave."""
TITLES = {
    "nodes": "nodes of the FE model",
    "samples": "samples of the record",
    "struts": "struts",
    "states": "states",
}
CURVES = {
    "nodes": {"reduction_s": "reduction", "solves_s": "its 78 solves", "factorisation_s": "its factorisation"},
    "samples": {
        "simulate_s": "simulate, exact",
        "estimate_frf_s": "estimate_frf",
        "identify_modes_s": "identify_modes",
    },
    "struts": {"ffrf_us_per_step": "ffrf", "linear_us_per_step": "linear", "exact_us_per_step": "exact"},
    "states": {"response_us": "frequency_response, a line", "exact_us_per_step": "exact, a step"},
}
MEMORY = {"grown_B": "memory beyond the start"}
"""The memory of struts and states is mostly that of loaded libraries."""
PANELS = (
    ("nodes", "CPU time [s]", CURVES["nodes"], 1.0),
    ("samples", "CPU time [s]", CURVES["samples"], 1.0),
    ("struts", "CPU time a step [us]", CURVES["struts"], 1.0),
    ("nodes", "memory [GB]", MEMORY, 1e-9),
    ("samples", "memory [GB]", MEMORY, 1e-9),
    ("states", "CPU time [us]", CURVES["states"], 1.0),
)

DEFAULTS = {"nodes": "4,2.2,1.6,1.4", "struts": "1,2,3,4,6,8,12", "states": "4,8,16,32,64"}
DEFAULTS["samples"] = "100000,316000,1000000,3160000,10000000"
arguments = parser(__doc__, "benchmark_scaling")
arguments.add_argument(
    "--nodes",
    type=several(positive),
    default=DEFAULTS["nodes"],
    help="element sizes [mm]; 0.92 gives 150 000 nodes; '' skips a part (default: %(default)s)",
)
arguments.add_argument(
    "--struts", type=several(whole(1)), default=DEFAULTS["struts"], help="numbers of struts (default: %(default)s)"
)
arguments.add_argument(
    "--states", type=several(whole(1)), default=DEFAULTS["states"], help="numbers of bodies (default: %(default)s)"
)
arguments.add_argument(
    "--samples",
    type=several(whole(20_000)),
    default=DEFAULTS["samples"],
    help="numbers of samples (default: %(default)s)",
)
arguments.add_argument("--child", nargs=2, metavar=("KIND", "SIZE"), help="for the script's own use")


def ring(fidelity: str, apa: ReducedBody, count: int) -> Scene:
    """Make a ring of n upright struts on a base, under one plate of 1 kg per strut.

    The input is a force that pushes the plate up.
    """
    angles = 2 * np.pi * np.arange(count) / count
    feet = {f"joint_{k}": (RADIUS * np.cos(t), RADIUS * np.sin(t), 0.0) for k, t in enumerate(angles)}
    height = np.array([0.0, 0.0, LENGTH])
    plate = RigidBody("plate", {**feet, "centre": np.zeros(3)}, count, 1e-2 * count * np.eye(3), height)
    legs = [placed(fe_strut(fidelity, apa=apa), f"strut_{k}", position=foot) for k, foot in enumerate(feet.values())]
    return joined(
        "ring",
        *legs,
        bodies=(RigidBody("base", feet, fixed=True), plate),
        joints=[
            joint
            for k in range(count)
            for joint in (
                fixed(f"foot_{k}", f"base.joint_{k}", f"strut_{k}/bottom.end"),
                fixed(f"head_{k}", f"strut_{k}/top.end", f"plate.joint_{k}"),
            )
        ],
        actuators=(PointForce("push", "plate.centre", "z", "force"),),
        # Damping of modes is not quite the same in every fidelity.
        damping_ratio=0.0,
        cutoff_frequency=CUTOFF,
    )


def chain(count: int) -> Scene:
    """Make a chain of n bodies on a base, each connected to the previous one in all six directions.

    The input is a force on the last body.
    """
    ends = {"low": (0.0, 0.0, -0.05), "high": (0.0, 0.0, 0.05)}
    bodies = [RigidBody(f"body_{k}", ends, 1.0, 1e-3 * np.eye(3), (0.0, 0.0, 0.1 * k + 0.05)) for k in range(count)]
    tops = ["base.top", *(f"body_{k}.high" for k in range(count))]
    stiffness = np.array([1e7, 1e7, 1e7, 1e5, 1e5, 1e5])
    return Scene(
        "chain",
        (RigidBody("base", {"top": np.zeros(3)}, fixed=True), *bodies),
        (),
        (PointForce("push", tops[-1], "z", "force"),),
        (Encoder("height", "base.top", tops[-1], axis="z"),),
        [Bushing(f"spring_{k}", tops[k], f"body_{k}.low", stiffness) for k in range(count)],
        damping_ratio=0.01,
    )


def struts(count: float) -> dict[str, float]:
    """Measure steps of rings of struts with trimmed bodies, in every fidelity."""
    apa, n = reduced_apa300ml(progress=False), round(count)
    found = {
        f"{name}_us_per_step": stepped(ring(fidelity, apa, n), method, steps)
        for name, (fidelity, method, steps) in METHODS.items()
    }
    return {"size": n, **found}


def states(n_bodies: float) -> dict[str, float]:
    """Measure exact steps and frequency responses of chains of bodies."""
    scene = chain(round(n_bodies))
    model = linearize(scene)
    responding = min(cpu_time(frequency_response, model, FREQUENCIES)[1] for _ in range(TURNS))
    stepping = stepped(scene, "exact", METHODS["exact"][2])
    return {"size": len(model.A), "exact_us_per_step": stepping, "response_us": 1e6 * responding / len(FREQUENCIES)}


def stepped(scene: Scene, method: str | None, steps: int) -> float:
    """Return the CPU time per additional step of 0.1 ms [us]."""
    push = band_limited_noise(5 * steps / RATE, RATE, cutoff_frequency=300.0, rms=0.1)
    units = tuple(map(scene.input_unit, scene.inputs))
    values = np.outer(np.arange(len(scene.inputs)) == 0, push.values[0])
    options: dict[str, Any] = {"time_step": 1 / RATE, "progress": False} | ({"method": method} if method else {})
    both = [TimeHistory(push.time[: n + 1], values[:, : n + 1], scene.inputs, units) for n in (steps, 5 * steps)]
    few, many = (min(cpu_time(simulate, scene, one, **options)[1] for _ in range(TURNS)) for one in both)
    return 1e6 * (many - few) / (4 * steps)


def measure(kind: str, size: float) -> dict[str, float]:
    """Run the work of one kind and size; return CPU times, largest memory and growth of memory [bytes]."""
    before = peak_memory()
    figures = WORKS[kind](size)
    memory = peak_memory()
    return {**figures, "memory_B": memory, "grown_B": memory - before}


def reduction(element_size: float) -> dict[str, float]:
    """Time the reduction of the APA300ML from a mesh of order 2 with RBE2, and the solver alone."""
    solid = make_apa300ml(coupling="rbe2", stack_coupling="rbe2")
    mesh = ng.Mesh(generate_mesh(solid, element_size=1e-3 * element_size, curvature=0.5))
    mesh.Curve(2)
    model, assembly = cpu_time(assemble_mesh, mesh, solid, 2)
    reducing = cpu_time(craig_bampton, model, n_modes=N_MODES, progress=False)[1]
    factor, factorisation = cpu_time(factorize, model.stiffness, held=held_unknowns(model))
    block = np.random.default_rng(0).standard_normal((model.n_dofs, BLOCK))
    widths = [min(BLOCK, N_SOLVES - start) for start in range(0, N_SOLVES, BLOCK)]
    solving = cpu_time(lambda: [factor.solve(block[:, :width]) for width in widths])[1]
    return {
        "size": model.n_dofs // 3,
        "reduction_s": assembly + reducing,
        "factorisation_s": factorisation,
        "solves_s": solving,
    }


def samples(count: float) -> dict[str, float]:
    """Time simulation of a record of the bench, estimation of its FRFs and identification of its mode together."""
    bench = make_bench(apa=reduced_apa300ml(progress=False), fidelity="linear")
    signals(bench, 20_000)  # loads what is loaded when it is used
    turns = [signals(bench, round(count)) for _ in range(TURNS if count <= MANY else 1)]
    return {key: min(turn[key] for turn in turns) for key in turns[0]}


def signals(bench: Scene, count: int) -> dict[str, float]:
    """Simulate, estimate and identify once."""
    noise = band_limited_noise(count / RATE, RATE, cutoff_frequency=300.0, rms=1e-3)
    record, simulating = cpu_time(simulate, bench, noise, time_step=1 / RATE, method="exact", progress=False)
    inputs, outputs = [SIGNALS["input"]], SIGNALS["outputs"]
    estimating = cpu_time(estimate_frf, record, inputs=inputs, outputs=outputs, segment_duration=1.0)[1]
    identify = partial(identify_modes, band=(20.0, 300.0), hold_order=1, n_modes=1)
    return {
        "size": len(record.time),
        "simulate_s": simulating,
        "estimate_frf_s": estimating,
        "identify_modes_s": cpu_time(identify, record, **SIGNALS)[1],
    }


WORKS = {"nodes": reduction, "struts": struts, "states": states, "samples": samples}


def exponent(sizes: Any, costs: Any) -> dict[str, float]:
    """Fit the exponent of cost ~ size^exponent and its standard error to three sizes or more by least squares."""
    fit = scipy.stats.linregress(np.log(sizes), np.log(costs))
    return {"exponent": float(fit.slope), "std": float(fit.stderr), "cost_of_1": float(np.exp(fit.intercept))}


def exponents(rows: Rows) -> dict[str, dict[str, float]]:
    """Fit the exponents of all costs that were measured at every size."""
    columns = {key: [row[key] for row in rows.values()] for key in next(iter(rows.values()), {})}
    sizes = columns.pop("size", [])
    return {key: exponent(sizes, costs) for key, costs in columns.items() if len(costs) >= 3 and min(costs) > 0}


def print_growth(kind: str, rows: Rows, fits: Mapping[str, Mapping[str, float]]) -> None:
    """Print the costs by size, and the exponents below them."""
    units = {"_s": ("[s]", ":.3g"), "ep": ("[us]", ":.3g"), "us": ("[us]", ":.3g")}
    columns = {f"{name} {units[key[-2:]][0]}": key + units[key[-2:]][1] for key, name in CURVES[kind].items()}
    columns |= {"memory [GB]": "memory_B*1e-9:.2f", "grown by [GB]": "grown_B*1e-9:.3f"}
    print_table(TITLES[kind], {f"{row['size']:,.0f}": row for row in rows.values()}, columns)
    for key, name in (CURVES[kind] | MEMORY).items():
        if key in fits and (key not in MEMORY or kind in ("nodes", "samples")):
            print(f"  {name}: exponent {fits[key]['exponent']:.2f} +- {fits[key]['std']:.2f}")


def save_picture(path: Path, rows: Mapping[str, Rows], fits: Mapping[str, Mapping[str, Any]]) -> None:
    """Plot costs and fitted lines over sizes on logarithmic axes, with a line of proportional growth."""
    figure = plt.figure(figsize=(13, 7.5), layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    for ax, (kind, label, curves, factor) in zip(axes, PANELS, strict=True):
        for (key, name), color, marker in zip(curves.items(), COLORS, "os^", strict=False):
            shown = [(row["size"], factor * row[key]) for row in rows[kind].values() if row[key] > 0]
            size, cost = np.reshape(shown, (-1, 2)).T
            fit = fits[kind].get(key)
            text = f"{name}, p = {fit['exponent']:.2f} ± {fit['std']:.2f}" if fit else name
            ax.loglog(size, cost, marker, ms=5, color=color, label=text)
            if fit:
                ax.loglog(size, factor * fit["cost_of_1"] * size ** fit["exponent"], lw=1.2, color=color)
                ax.loglog(size, cost[0] * size / size[0], ls=":", lw=0.9, color="0.55")
            ax.set_xticks(size)
        ax.xaxis.set_major_formatter(EngFormatter(places=0, sep=""))
        ax.yaxis.set_major_locator(LogLocator(subs=(1, 3)))
        ax.yaxis.set_major_formatter("{x:g}")
        ax.minorticks_off()
        low, high = ax.get_ylim()
        ax.set(xlabel=TITLES[kind], ylabel=label, ylim=(low, high * (high / low) ** 0.3))  # room for the legend
        ax.grid(visible=True, alpha=0.25)
        ax.legend(fontsize=9, loc="upper left")
    figure.suptitle("cost ~ size$^p$; dotted: in proportion to the size", fontsize=11)
    save_figure(axes, path)


def main() -> None:
    args = arguments.parse_args()
    if args.child:
        print("\n" + json.dumps(measure(args.child[0], float(args.child[1]))))
        return
    reduced_apa300ml()  # in the cache from now on
    os.environ.update(dict.fromkeys(("NASSIM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))
    summary: dict[str, Any] = {"exponents": {}}
    for kind in DEFAULTS:
        summary[kind] = {f"{size:.12g}": run_in_own_process(__file__, kind, size) for size in getattr(args, kind)}
        summary["exponents"][kind] = exponents(summary[kind])
    for kind in DEFAULTS:
        print_growth(kind, summary[kind], summary["exponents"][kind])
    if not args.no_plot:
        save_picture(args.output / "scaling.png", summary, summary["exponents"])
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
