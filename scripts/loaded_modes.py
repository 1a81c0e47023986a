"""Compute modes under load: bench and nano-hexapod over payload and preload, and a bladed rotor over speed.

The linear model with the stiffness of its loads is compared with the one without, for the hexapod also with Exudyn's
floating frames. The rotor consists of three thin blades on a stiff hub; centrifugal tension stiffens them.
"""

import warnings
from collections.abc import Sequence
from typing import Any

import netgen.occ as occ
import numpy as np
from scipy.spatial.transform import Rotation

from common.arguments import not_negative, parser, positive, run, several
from common.hexapod import METHODS
from common.report import print_table, write_summary
from models.apa300ml import COARSE, PORTS, reduced_apa300ml
from models.bench import make_bench
from models.nano_hexapod import make_nano_hexapod
from models.strut import fe_strut
from nassim import (
    FRF,
    FlexibleBody,
    LinearModel,
    Material,
    ReducedBody,
    RemotePoint,
    RigidBody,
    Scene,
    Solid,
    build_fe_model,
    craig_bampton,
    fixed,
    frequency_response,
    linearize,
)
from nassim.plotting import COLORS, plot_frf, plt, save_figure
from nassim.simulation import exudyn_eigenfrequencies

STRUT_MODE = 6
"""Index of the first mode of the struts, after six suspension modes."""
LENGTH, WIDTH, THICKNESS, ROOT = 0.3, 0.03, 2e-3, 0.05
"""Radial length, tangential width and axial thickness of a blade, and radius of the hub [m]."""
STEEL = Material("steel", 200e9, 0.3, 7800.0)
FREQUENCY = np.geomspace(10.0, 200.0, 800)

arguments = parser(__doc__, "loaded_modes")
arguments.add_argument("--coarse", action="store_true", help="actuator mesh of 8 mm, for a quick look")
arguments.add_argument(
    "--payloads", type=several(positive), default=[1.0, 10.0, 50.0], help="payload masses [kg] (default: 1,10,50)"
)
arguments.add_argument(
    "--preloads",
    type=several(positive),
    default=[100.0],
    help="compression and tension of the bench [N] (default: 100)",
)
arguments.add_argument(
    "--cutoff", type=positive, default=600.0, help="cut-off frequency of the struts [Hz] (default: 600)"
)
arguments.add_argument(
    "--speeds",
    type=several(not_negative),
    default=[0.0, 10.0, 20.0, 30.0, 40.0, 50.0],
    help="speeds of the rotor [Hz] (default: 0,10,20,30,40,50)",
)


def modes(model: LinearModel, n: int) -> np.ndarray:
    """Return the first n frequencies of a model's oscillations, (n,) [Hz]."""
    poles = model.poles()
    return np.sort(np.abs(poles[poles.imag > 0]))[:n] / (2 * np.pi)


def bench_modes(apa: ReducedBody, payloads: Sequence[float], preloads: Sequence[float]) -> dict[str, dict[str, float]]:
    """Return the first mode of the bench with several payloads, and with preloads on the first payload."""
    rows = {}
    signed = [sign * force for force in preloads for sign in (-1, 1)]
    for mass, force in [*((mass, 0.0) for mass in payloads), *((payloads[0], force) for force in signed)]:
        scene = make_bench(mass, apa=apa, gravity=True, disturbances=True)
        (loaded,) = modes(linearize(scene, constant_inputs={"payload_force": force}), 1)
        (without,) = modes(linearize(scene, loaded=False), 1)
        rows[f"{mass:g} kg, {force:+g} N" if force else f"{mass:g} kg"] = compared(without, loaded)
    return rows


def hexapod_modes(apa: ReducedBody, payloads: Sequence[float], cutoff: float) -> dict[str, dict[str, float]]:
    """Return the first and last suspension mode of the hexapod, and the first mode of its struts."""
    rows = {}
    for mass in payloads:
        linear, floating = (
            make_nano_hexapod(
                fe_strut(apa=apa, fidelity=METHODS[method][0]),
                payload_mass=mass,
                damping_ratio=0.0,
                gravity=True,
                cutoff_frequency=cutoff,
            )
            for method in ("linear", "ffrf")
        )
        without, loaded = (modes(linearize(linear, loaded=with_loads), 7) for with_loads in (False, True))
        stepped, in_time = (exudyn_eigenfrequencies(scene, loaded=True, n_modes=7) for scene in (linear, floating))
        for name, k in (("suspension, first", 0), ("suspension, last", STRUT_MODE - 1), ("struts, first", STRUT_MODE)):
            row = compared(without[k], loaded[k])
            rows[f"{mass:g} kg, {name}"] = row | {"ffrf_over_linear_percent": 100 * (in_time[k] / stepped[k] - 1)}
    return rows


def compared(without: float, loaded: float) -> dict[str, float]:
    """Return a frequency without loads and with them [Hz], and the change."""
    return {"without_Hz": without, "loaded_Hz": loaded, "change_percent": 100 * (loaded / without - 1)}


def rotor(blade: ReducedBody) -> Scene:
    """Make a rotor of three blades on a hub that is held at its centre."""
    turns = [Rotation.from_euler("z", 120 * k, degrees=True).as_matrix() for k in range(3)]
    roots = {f"root_{k}": turn @ [ROOT, 0, 0] for k, turn in enumerate(turns)}
    hub = RigidBody("hub", roots, fixed=True)
    blades = [FlexibleBody(f"blade_{k}", blade, roots[f"root_{k}"], turn) for k, turn in enumerate(turns)]
    joints = [fixed(f"joint_{k}", f"hub.root_{k}", f"blade_{k}.root") for k in range(3)]
    return Scene("rotor", (hub, *blades), tuple(joints), damping_ratio=0.0)


def reduced_blade() -> ReducedBody:
    """Reduce a thin blade along x, with its geometric stiffness; its root is at the hub."""
    shape = occ.Box(occ.Pnt(0, -WIDTH / 2, -THICKNESS / 2), occ.Pnt(LENGTH, WIDTH / 2, THICKNESS / 2))
    shape.name = "blade"
    shape.faces.Min(occ.X).name = "root"
    solid = Solid("blade", shape, {"blade": STEEL}, (RemotePoint("root", "root", np.zeros(3), "rbe2"),))
    model = build_fe_model(solid, element_size=WIDTH / 2, order=3, extrude="z", layer_thickness=THICKNESS)
    return craig_bampton(model, n_modes=8, geometric_stiffness=True)


def campbell(scene: Scene, speeds: Sequence[float], *, loaded: bool) -> np.ndarray:
    """Return the first nine frequencies in the rotor frame, for three equal blades, (speeds, 9) [Hz]."""
    turning = [2 * np.pi * speed * np.array([0.0, 0.0, 1.0]) for speed in speeds]
    with warnings.catch_warnings():
        if not loaded:
            warnings.filterwarnings("ignore", message=".*stress stiffening within the body")  # what this is about
        return np.array([modes(linearize(scene, angular_velocity=w, loaded=loaded), 9) for w in turning])


def plot_campbell(speeds: Sequence[float], loaded: np.ndarray, without: np.ndarray) -> Any:
    """Plot frequencies over speed, with and without tension, and the multiples of the speed; return Axes."""
    _, ax = plt.subplots(figsize=(8, 5.5), layout="constrained")
    for found, color, style, name in ((loaded, COLORS[0], "-", "with tension"), (without, COLORS[1], "--", "without")):
        lines = ax.plot(speeds, found, style, color=color, lw=1.4)
        lines[0].set_label(name)
    top = 1.05 * max(loaded.max(), without.max())
    for multiple in range(1, 5):
        ax.plot(speeds, multiple * np.array(speeds), ":", color="0.6", lw=1)
        ax.annotate(f"{multiple}x", (speeds[-1], multiple * speeds[-1]), color="0.4", fontsize=9)
    ax.set(xlabel="speed [Hz]", ylabel="frequency in the rotor frame [Hz]", ylim=(0, top))
    ax.grid(True, alpha=0.25)
    ax.legend(fontsize=9)
    return ax


def bench_responses(apa: ReducedBody, mass: float) -> list[FRF]:
    """Return responses of the bench under its heaviest payload with and without geometric stiffness."""
    scene = make_bench(mass, apa=apa, gravity=True)
    named = {"without": linearize(scene, loaded=False), "loaded": linearize(scene)}
    return [frequency_response(model, FREQUENCY, label=name) for name, model in named.items()]


def main() -> None:
    """Compute, print and plot."""
    args = arguments.parse_args()
    apa = reduced_apa300ml(ports=PORTS, geometric_stiffness=True, **(COARSE if args.coarse else {}))
    columns = {"without [Hz]": "without_Hz:.2f", "loaded [Hz]": "loaded_Hz:.2f", "change [%]": "change_percent:+.2f"}
    bench = bench_modes(apa, args.payloads, args.preloads)
    print_table("bench, first mode", bench, columns)
    hexapod = hexapod_modes(apa, args.payloads, args.cutoff)
    print_table("nano-hexapod", hexapod, columns | {"ffrf off by [%]": "ffrf_over_linear_percent:+.3f"})
    scene = rotor(reduced_blade())
    loaded, without = (campbell(scene, args.speeds, loaded=with_loads) for with_loads in (True, False))
    found = {"without": without, "loaded": loaded}
    rows = {
        f"{speed:g} Hz": {f"{name}_{n}": values[k][3 * n] for name, values in found.items() for n in range(3)}
        for k, speed in enumerate(args.speeds)
    }
    headings = {f"mode {n + 1} {name}": f"{name}_{n}:.2f" for n in range(3) for name in found}
    print_table("rotor [Hz]", rows, headings)
    if not args.no_plot:
        save_figure(plot_campbell(args.speeds, loaded, without), args.output / "campbell.png")
        wires = {"input": "actuator_voltage", "output": "encoder", "unit": "m/V"}
        save_figure(plot_frf(bench_responses(apa, max(args.payloads)), **wires), args.output / "frf.png")
    write_summary(args.output, {"bench": bench, "hexapod": hexapod, "rotor": rows})


if __name__ == "__main__":
    run(main)
