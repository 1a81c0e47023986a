"""Compute the stroke that a leaf flexure and a notch hinge bear, and compare it with the closed forms of handbooks.

Both are cut from a block, with fillets, and reduced with the stress on their surface. The limit of the von Mises stress
gives the stroke of the leaf, whose end is guided, and the angle of the hinge. The closed forms are those of a beam for
the leaf (S. T. Smith, Flexures, 2000), and of J. M. Paros and L. Weisbord (1965) for the stiffness of the notch, with
Smith's factor of stress concentration.
"""

from typing import Any

import netgen.occ as occ
import numpy as np

from common.arguments import parser, positive, run
from common.report import print_table, write_summary
from nassim import (
    FlexibleBody,
    Material,
    PointForce,
    PointTorque,
    ReducedBody,
    RemotePoint,
    RigidBody,
    Scene,
    Solid,
    StressPoint,
    StressSurface,
    build_fe_model,
    craig_bampton,
    fixed,
    frequency_response,
    linearize,
    load_limit,
    peak_stress,
    prismatic,
    static_motion,
    von_mises,
)
from nassim.plotting import COLORS, plt, save_figure
from nassim.scene import AngleSensor, Encoder, Motion

STEEL = Material("steel", 200e9, 0.3, 7800.0)
WIDTH, BLOCK, HEIGHT = 10e-3, 6e-3, 8e-3
"""Of the flexures across the bending, and of the blocks at their ends along and in the plane of bending [m]."""

arguments = parser(__doc__, "flexure_stress")
arguments.add_argument(
    "--limit", type=positive, default=250.0, help="largest allowed von Mises stress [MPa] (default: 250)"
)
arguments.add_argument("--length", type=positive, default=25.0, help="length of the leaf [mm] (default: 25)")
arguments.add_argument("--leaf", type=positive, default=0.5, help="thickness of the leaf [mm] (default: 0.5)")
arguments.add_argument(
    "--fillet", type=positive, default=0.5, help="radius at the ends of the leaf [mm] (default: 0.5)"
)
arguments.add_argument("--radius", type=positive, default=3.0, help="radius of the notch [mm] (default: 3)")
arguments.add_argument("--neck", type=positive, default=0.5, help="thickness of the notch [mm] (default: 0.5)")


def leaf_spring(length: float, thickness: float, fillet: float) -> Any:
    """A leaf between two blocks, along x from the origin, with rounded corners, called "round"."""
    shape = occ.Box(occ.Pnt(-BLOCK, -WIDTH / 2, -HEIGHT / 2), occ.Pnt(length + BLOCK, WIDTH / 2, HEIGHT / 2))
    for side in (1, -1):
        low, high = sorted((side * thickness / 2, side * HEIGHT))
        pocket = occ.Box(occ.Pnt(0, -WIDTH, low), occ.Pnt(length, WIDTH, high))
        corners = [
            edge
            for edge in pocket.edges
            if abs(edge.center.z - side * thickness / 2) < 1e-9 and abs(edge.center.y) < 1e-9
        ]
        shape -= pocket.MakeFillet(corners, fillet)
    return shape


def notch_hinge(radius: float, thickness: float) -> Any:
    """Two blocks along x with a circular notch at the origin, whose faces are called "round"."""
    half = radius + BLOCK
    shape = occ.Box(occ.Pnt(-half, -WIDTH / 2, -HEIGHT / 2), occ.Pnt(half, WIDTH / 2, HEIGHT / 2))
    for side in (1, -1):
        centre = occ.Pnt(0, -WIDTH, side * (radius + thickness / 2))
        shape -= occ.Cylinder(centre, occ.Y, radius, 2 * WIDTH)
    return shape


def reduced(name: str, shape: Any, *, thickness: float, radius: float, points: tuple[StressPoint, ...]) -> ReducedBody:
    """A flexure with the stress on its surface, held at both ends; elements are small at round faces."""
    shape.solids.name = name
    for face in shape.faces:
        low, high = face.bounding_box
        flat = min(high.x - low.x, high.z - low.z) < 1e-6
        face.name = face.name if flat else "round"
    ends = {"root": shape.faces.Min(occ.X), "tip": shape.faces.Max(occ.X)}
    for end, face in ends.items():
        face.name = end
    remote = tuple(RemotePoint(end, end, [face.center.x, 0.0, 0.0]) for end, face in ends.items())
    solid = Solid(name, shape, {name: STEEL}, remote)
    small = min(thickness, radius) / 3
    model = build_fe_model(
        solid, element_size=2e-3, local_sizes={"round": small}, order=3, extrude="y", layer_thickness=WIDTH / 2
    )
    return craig_bampton(model, n_modes=0, discretization=False, stress=[*points, StressSurface()])


def guided_leaf(body: ReducedBody) -> Scene:
    """The leaf, whose tip moves along z without a rotation."""
    wall = RigidBody("wall", {"root": body.point("root").position, "tip": body.point("tip").position}, fixed=True)
    return Scene(
        "leaf",
        (wall, FlexibleBody("flexure", body, fidelity="linear")),
        (fixed("clamp", "wall.root", "flexure.root"), prismatic("guide", "wall.tip", "flexure.tip", (0.0, 0.0, 1.0))),
        (PointForce("push", "flexure.tip", "z", "load"),),
        (Encoder("stroke", "wall.tip", "flexure.tip", "z"),),
    )


def bent_hinge(body: ReducedBody) -> Scene:
    """The hinge under a torque at its tip."""
    wall = RigidBody("wall", {"root": body.point("root").position}, fixed=True)
    return Scene(
        "hinge",
        (wall, FlexibleBody("flexure", body, fidelity="linear")),
        (fixed("clamp", "wall.root", "flexure.root"),),
        (PointTorque("turn", "flexure.tip", "y", "load"),),
        (AngleSensor("stroke", "flexure.root", "flexure.tip", "y"),),
    )


def at_limit(scene: Scene, limit: float) -> tuple[dict[str, float], Motion]:
    """Load, stroke, stiffness and stress of the point at the limit, and the flexure there."""
    found = load_limit(scene, limit, body="flexure", inputs={"load": 1.0}, place="stress")
    per_load = linearize(scene, loaded=False)
    stroke = abs(float(frequency_response(per_load, np.zeros(1)).values[0, 0, 0].real)) * found.factor
    motion = static_motion(scene, inputs={"load": found.factor})
    figures = {
        "load": found.factor,
        "stroke": stroke,
        "stiffness": found.factor / stroke,
        "stress_at_point_Pa": abs(peak_stress(motion, scene.bodies[1], place="point").stress[0]),
        "mesh_error_percent": 100 * found.mesh_error,
    }
    return figures, motion


def of_leaf(
    found: dict[str, float], limit: float, *, length: float, thickness: float
) -> dict[str, dict[str, float | None]]:
    """The leaf by elements and by a beam: stroke, stiffness, and stress at a quarter of its length."""
    inertia = WIDTH * thickness**3 / 12
    stiffness = 12 * STEEL.young_modulus * inertia / length**3
    stroke = limit * length**2 / (3 * STEEL.young_modulus * thickness)
    quarter = found["load"] * length / 4 * thickness / 2 / inertia
    return {
        "stroke at the limit [mm]": compared(1e3 * found["stroke"], 1e3 * stroke),
        "stiffness [N/mm]": compared(1e-3 * found["stiffness"], 1e-3 * stiffness),
        "stress at a quarter [MPa]": compared(1e-6 * found["stress_at_point_Pa"], 1e-6 * quarter),
        "mesh error of the peak [%]": compared(found["mesh_error_percent"], None),
    }


def of_hinge(
    found: dict[str, float], limit: float, *, radius: float, thickness: float
) -> dict[str, dict[str, float | None]]:
    """The hinge by elements and by closed forms: angle, stiffness, and stress in the middle of the neck."""
    stiffness = 2 * STEEL.young_modulus * WIDTH * thickness**2.5 / (9 * np.pi * radius**0.5)
    concentration = (1 + thickness / (2 * radius)) ** (9 / 20)
    per_torque = concentration * 6 / (WIDTH * thickness**2)
    return {
        "angle at the limit [mrad]": compared(1e3 * found["stroke"], 1e3 * limit / per_torque / stiffness),
        "stiffness [N m/rad]": compared(found["stiffness"], stiffness),
        "stress of the neck [MPa]": compared(1e-6 * found["stress_at_point_Pa"], 1e-6 * found["load"] * per_torque),
        "mesh error of the peak [%]": compared(found["mesh_error_percent"], None),
    }


def compared(elements: float, closed: float | None) -> dict[str, float | None]:
    """A figure by elements and by a closed form, if there is one, and the difference."""
    difference = None if closed is None else 100 * (elements / closed - 1)
    return {"elements": elements, "closed_form": closed, "difference_percent": difference}


def plot_surface_stress(bodies: dict[str, ReducedBody], motions: dict[str, Motion]) -> Any:
    """Von Mises stress of all points of the surface over their place along each flexure; returns Axes."""
    _, axes = plt.subplots(1, len(bodies), figsize=(9, 4), layout="constrained", sharey=True)
    for ax, (name, body), color in zip(axes, bodies.items(), COLORS, strict=False):
        field = body.readouts["stress"]
        stress = von_mises(field.stress(motions[name].coordinates["flexure"][0]))
        ax.plot(1e3 * field.positions[:, 0], 1e-6 * stress, ".", ms=2, color=color)
        ax.set(title=name, xlabel="along the flexure [mm]")
        ax.grid(True, alpha=0.25)
    axes[0].set_ylabel("von Mises stress at the limit [MPa]")
    return axes


def main() -> None:
    """Compute, print and draw."""
    args = arguments.parse_args()
    limit = 1e6 * args.limit
    length, leaf, fillet = 1e-3 * args.length, 1e-3 * args.leaf, 1e-3 * args.fillet
    radius, neck = 1e-3 * args.radius, 1e-3 * args.neck
    of_point = StressPoint("point", (length / 4, 0.0, leaf / 2)), StressPoint("point", (0.0, 0.0, neck / 2))
    bodies = {
        "leaf": reduced("leaf", leaf_spring(length, leaf, fillet), thickness=leaf, radius=fillet, points=of_point[:1]),
        "hinge": reduced("hinge", notch_hinge(radius, neck), thickness=neck, radius=radius, points=of_point[1:]),
    }
    leaf_found, leaf_motion = at_limit(guided_leaf(bodies["leaf"]), limit)
    hinge_found, hinge_motion = at_limit(bent_hinge(bodies["hinge"]), limit)
    tables = {
        "leaf": of_leaf(leaf_found, limit, length=length, thickness=leaf),
        "hinge": of_hinge(hinge_found, limit, radius=radius, thickness=neck),
    }
    columns = {
        "elements": "elements:.4g",
        "closed form": "closed_form:.4g",
        "difference [%]": "difference_percent:+.2f",
    }
    for name, rows in tables.items():
        print_table(name, rows, columns)
    if not args.no_plot:
        motions = {"leaf": leaf_motion, "hinge": hinge_motion}
        save_figure(plot_surface_stress(bodies, motions), args.output / "stress.png")
    write_summary(args.output, {"limit_MPa": args.limit, **tables})


if __name__ == "__main__":
    run(main)
