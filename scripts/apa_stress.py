"""Compute the stress of the APA300ML under 100 N along its axis, and with two and three stacks at full voltage.

The peaks of the von Mises stress are those of the fillets at the pads and of the ends of the slots. Both are refined on
a second mesh: a peak that stands is a result, with the change between the meshes as its error. The stress at the edge
of a stack's glued end grows with every refinement, because linear elasticity has no finite stress there.

The actuator stands on its lower pad. Stacks without a voltage are shorted.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from common.arguments import parser, positive, run
from common.report import key_of, print_table, write_summary
from models.apa300ml import PORTS, make_apa300ml
from nassim import (
    FlexibleBody,
    PointForce,
    ReducedBody,
    RigidBody,
    Scene,
    StressPoint,
    StressSurface,
    VoltageDrive,
    build_fe_model,
    craig_bampton,
    fixed,
    static_motion,
    stress_convergence,
    von_mises,
)
from nassim.plotting import COLORS, plt, save_figure

PLACES = (
    StressSurface("fillet", "pad_fillets"),
    StressSurface("slot end", "arm_roots"),
    StressPoint("glued edge", (32.5e-3, 0.0, 5e-3), "frame"),
)
MESHES = ({"order": 3, "slots": 0.15e-3, "glue": 4e-3}, {"order": 4, "slots": 0.1e-3, "glue": 1e-3})
"""Coarser and finer mesh: order, and sizes of the elements at the ends of the slots and at the glued edge [m]."""
QUICK = ({"order": 2, "slots": 0.4e-3, "glue": 4e-3}, {"order": 3, "slots": 0.3e-3, "glue": 2e-3})
"""The same for a quick look."""

arguments = parser(__doc__, "apa_stress")
arguments.add_argument("--force", type=positive, default=100.0, help="force along the axis [N] (default: 100)")
arguments.add_argument("--voltage", type=positive, default=170.0, help="voltage of the stacks [V] (default: 170)")
arguments.add_argument("--coarse", action="store_true", help="larger elements, for a quick look")


def reduced(*, order: int, slots: float, glue: float) -> ReducedBody:
    """The actuator with its stress. The fillets at the pads are refined by the order of their elements only."""
    sizes = {"pad_fillets": 0.5e-3, "holes": 1.5e-3, "arm_roots": slots, "actuator_stack_end": glue}
    model = build_fe_model(
        make_apa300ml(ports=PORTS),
        element_size=5e-3,
        order=order,
        extrude="y",
        layer_thickness=5e-3,
        local_sizes=sizes,
    )
    return craig_bampton(model, n_modes=0, remote_points=["bottom", "top"], discretization=False, stress=PLACES)


def held(body: ReducedBody) -> Scene:
    """The actuator on a wall, with a force on its upper pad and a voltage at each port."""
    wall = RigidBody("wall", {"pad": body.point("bottom").position}, fixed=True)
    return Scene(
        "actuator",
        (wall, FlexibleBody("apa", body, fidelity="linear")),
        (fixed("clamp", "wall.pad", "apa.bottom"),),
        (
            PointForce("load", "apa.top", "z", "force"),
            VoltageDrive("drive", "apa.actuator", "actuator"),
            VoltageDrive("third drive", "apa.sensor", "sensor"),
        ),
    )


def peaks(scene: Scene, finer: ReducedBody, load: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """The largest stress at each place under a load."""
    result = {}
    for place in PLACES:
        found = stress_convergence(scene, finer, body="apa", inputs=load, place=place.name, n_spots=1)
        spot = found.spots[0]
        result[place.name] = {
            "MPa": 1e-6 * spot.von_mises,
            "change_MPa": 1e-6 * spot.change,
            "mesh_error_MPa": 1e-6 * spot.mesh_error,
            "verdict": spot.verdict,
            "position_mm": 1e3 * spot.position,
        }
    return result


def plot_arcs(scene: Scene, finer: ReducedBody, load: Mapping[str, float]) -> Any:
    """Von Mises stress of all points of the fillets and slot ends over their height, on both meshes; returns Axes."""
    _, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    for ax, place in zip(axes, PLACES[:2], strict=True):
        for body, label, color in zip((scene.bodies[1].reduced, finer), ("coarser", "finer"), COLORS, strict=False):
            motion = static_motion(held(body), inputs=load)
            field = body.readouts[place.name]
            stress = von_mises(field.stress(motion.coordinates["apa"][0]))
            ax.plot(1e3 * np.abs(field.positions[:, 2]), 1e-6 * stress, ".", ms=3, color=color, label=label)
        ax.set(title=place.name, xlabel="distance from the middle along the axis [mm]", ylabel="von Mises stress [MPa]")
        ax.grid(True, alpha=0.25)
    axes[0].legend()
    return axes


def main() -> None:
    """Compute, print and draw."""
    args = arguments.parse_args()
    coarser, finer = (reduced(**mesh) for mesh in (QUICK if args.coarse else MESHES))
    scene = held(coarser)
    loads = {
        f"{args.force:g} N": {"force": args.force},
        f"two stacks {args.voltage:g} V": {"actuator": args.voltage},
        f"three stacks {args.voltage:g} V": {"actuator": args.voltage, "sensor": args.voltage},
    }
    summary: dict[str, Any] = {}
    for name, load in loads.items():
        rows = peaks(scene, finer, load)
        columns = {
            "von Mises [MPa]": "MPa:.4g",
            "change by refining [MPa]": "change_MPa:+.2g",
            "mesh error [MPa]": "mesh_error_MPa:.2g",
            "verdict": "verdict",
        }
        print_table(name, rows, columns)
        for place, figures in rows.items():
            summary |= {f"{key_of(place)}_{key_of(name)}_{key}": value for key, value in figures.items()}
        top = static_motion(held(finer), inputs=load).coordinates["apa"][0] @ finer.motion("top")[2]
        summary[f"elongation_{key_of(name)}_um"] = 1e6 * float(top)
    if not args.no_plot:
        save_figure(plot_arcs(scene, finer, loads[f"{args.force:g} N"]), args.output / "stress.png")
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
