"""Study the APA300ML within its tolerances: effects on pole, zero, axial stiffness, stroke and lateral modes.

Every run builds, meshes and reduces a new actuator with coarse prisms. Some runs are repeated with elements of one
order more, to estimate the effect of the coarse mesh on sensitivities. The same command continues a study that was
stopped; with more runs, only the new ones are computed.
"""

import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm, uniform

from common.arguments import parser, run, whole
from common.report import print_report, print_table, write_summary
from common.study_tables import REFINED, labelled, print_spread, refinement, spread
from models.apa300ml import PORTS, PZT, STACK, STEEL, APAGeometry, make_apa300ml
from models.two_mass import actuator_figures
from nassim import ReducedBody, Solid, build_fe_model, craig_bampton
from nassim.plotting import plot_scatter, plot_tornado, plt, save_figure
from nassim.studies import correlations, linear_effects, sobol_points, sweep

LAYERS, GLUE = 5, {"thickness": 30e-6, "modulus": 5e9}
"""Layers of glue at the ends of the three stacks and the spacer; nominal values [m], [Pa], assumed."""
SPACER = 5e-3
NOMINAL = APAGeometry()
PURE_CERAMIC = 1 / (1 / PZT.young_modulus - LAYERS * GLUE["thickness"] / (GLUE["modulus"] * 3 * STACK.length))
"""Modulus of the ceramic [Pa] without glue; with `GLUE`, the actuator is as stiff as the default one."""
TOLERANCES: dict[str, tuple[Any, str]] = {
    "arm_thickness": (norm(NOMINAL.arm_thickness, 10e-6), "m"),
    "relief": (norm(NOMINAL.relief, 25e-6), "m"),
    "hole_diameter": (norm(NOMINAL.hole_diameter, 25e-6), "m"),
    "depth": (norm(NOMINAL.depth, 25e-6), "m"),
    "steel_modulus": (norm(STEEL.young_modulus, 0.015 * STEEL.young_modulus), "Pa"),
    "ceramic_modulus": (norm(PURE_CERAMIC, 0.025 * PURE_CERAMIC), "Pa"),
    "glue_thickness": (uniform(10e-6, 40e-6), "m"),
    "glue_modulus": (uniform(3e9, 4e9), "Pa"),
}
"""Assumed distributions: twice the standard deviation is 20 um on wire-cut arms, 50 um elsewhere, 3 %, 5 % on moduli.

The fillets at the pads do not vary: smaller ones leave slivers, at which Netgen often fails to join prisms and
tetrahedra."""
FIGURES = dict(pole="Hz", zero="Hz", axial_stiffness="N/m", stroke="m", lateral_x="Hz", lateral_y="Hz")
"""Figures: pole and zero with 5 kg and an open sensor, stiffness with shorted stacks, clamped lateral modes."""
ONE_LAYER = {"arm_roots": 1e-3, "pad_fillets": 1e-3, "holes": 3e-3}
COARSE: dict[str, Any] = {"extrude": "y", "layer_thickness": 20e-3, "element_size": 10e-3, "local_sizes": ONE_LAYER}
"""Arguments of `build_fe_model`: one layer of prisms over the depth; `--order` gives their order."""

arguments = parser(__doc__, "tolerance_study")
arguments.add_argument("--runs", type=whole(16), default=64, help="number of runs, a power of two (default: 64)")
arguments.add_argument("--order", type=whole(1), default=3, help="order of the coarse elements (default: 3)")
arguments.add_argument("--refined", type=whole(0), default=6, help="runs repeated with one order more (default: 6)")
arguments.add_argument("--seed", type=whole(0), default=0, help="seed of the plan (default: 0)")
UNITS = FIGURES | {name: unit for name, (_, unit) in TOLERANCES.items()}
PERCENT = {name.replace("_", " "): f"{name}:+.2f" for name in FIGURES}
REPORT = """
{finished} of {runs} runs have figures; change of each figure in per cent of its mean, by a linear fit,
while one parameter goes through the range of 90 % of all parts"""


def apa_figures(
    arm_thickness: float,
    relief: float,
    hole_diameter: float,
    depth: float,
    steel_modulus: float,
    ceramic_modulus: float,
    glue_thickness: float,
    glue_modulus: float,
    *,
    mesh: dict[str, Any],
) -> dict[str, float]:
    """Compute `FIGURES` of a new actuator; mesh: arguments of `build_fe_model`.

    Where Netgen fails to join prisms and tetrahedra, the run fails, because results of another kind of mesh would not
    be comparable.
    """
    geometry = replace(NOMINAL, arm_thickness=arm_thickness, relief=relief, hole_diameter=hole_diameter, depth=depth)
    steel, ceramic = replace(STEEL, young_modulus=steel_modulus), replace(PZT, young_modulus=ceramic_modulus)
    solid = make_apa300ml(geometry, steel=steel, ceramic=ceramic, ports=PORTS)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*fails to mesh")
        model = build_fe_model(_glued(solid, LAYERS * glue_thickness / glue_modulus), progress=False, **mesh)
    body = craig_bampton(model, discretization=False, progress=False)
    found = actuator_figures(body)
    return {
        "pole": found.pole,
        "zero": found.zero,
        "axial_stiffness": found.shorted_stiffness,
        "stroke": abs(found.stroke) * STACK.voltage_range,
        **_lateral(body),
    }


def _glued(solid: Solid, softness: float) -> Solid:
    """Return the actuator with all its glue in the spacer; softness: thickness / modulus."""
    spacer = solid.materials["spacer"]
    softer = replace(spacer, young_modulus=SPACER / (SPACER / spacer.young_modulus + softness))
    return replace(solid, materials={**solid.materials, "spacer": softer})


def _lateral(body: ReducedBody) -> dict[str, float]:
    """Return the frequencies of the clamped modes with the largest motion of the top along x and along y [Hz]."""
    frequency, shapes = body.eigenmodes(fixed=["bottom"], n=3)
    rows = {axis: body.coordinate_names.index(f"top.u{axis}") for axis in "xy"}
    return {f"lateral_{axis}": float(frequency[np.argmax(np.abs(shapes[row]))]) for axis, row in rows.items()}


def plot_all(study: Any, effects: Any, correlations: Any, folder: Path) -> None:
    """Plot tornado diagrams of all figures, and each figure over each parameter."""
    axes = plt.figure(figsize=(15, 7), layout="constrained").subplots(2, 3).ravel()
    for ax, (result, unit) in zip(axes, FIGURES.items(), strict=True):
        plot_tornado(effects, result=result, unit=unit, ax=ax)
    save_figure(axes, folder / "tornado.png")
    save_figure(plot_scatter(study, correlations), folder / "scatter.png")


def main() -> None:
    args = arguments.parse_args()
    samples = sobol_points({name: law for name, (law, _) in TOLERANCES.items()}, args.runs, seed=args.seed)
    orders = (args.order, args.order + 1)
    coarse, fine = (partial(apa_figures, mesh=COARSE | {"order": order}) for order in orders)
    study = sweep(coarse, samples=samples, units=UNITS, folder=args.output / "study")
    effects, ranks = linear_effects(study), correlations(study)
    percent, rank = (100 * effects.effect / effects["mean"]).transpose(), ranks.spearman.transpose()
    summary = {
        "runs": args.runs,
        "finished": int((study.status == "ok").sum()),
        "figures": spread(study, effects),
        "effects_percent": labelled(percent),
        "rank_correlations": labelled(rank),
    }
    if args.refined:
        first = {name: samples[name][: args.refined] for name in samples.names}
        refined = sweep(fine, samples=first, units=UNITS, folder=args.output / "refined")
        summary["refined"] = refinement(study, refined, FIGURES)

    print_spread("figure [SI units]", summary["figures"])
    print_report(REPORT, summary)
    print_table("effect [%]", summary["effects_percent"], PERCENT)
    if args.refined:
        print_table(f"{args.refined} runs one order higher", summary["refined"], REFINED)
    if not args.no_plot:
        plot_all(study, effects, ranks, args.output)
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
