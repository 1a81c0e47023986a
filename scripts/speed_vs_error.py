"""Compare speed and error of reductions of the APA300ML or of a CAD file, over elements, modes and coupling.

Every variant runs in its own process. Errors are those of the first five eigenfrequencies, clamped at the bottom and
free, and of the axial stiffness, relative to the finest variant; its own convergence is printed above the table. They
contain no truncation error. The errors by number of modes are truncation errors only.

With --cad, the remote points are on the faces nearest to the given points, and the first of them is clamped:

    python scripts/speed_vs_error.py --cad part.step --point=0,0,0 --point=50,0,10
"""

import json
import sys
import time
from argparse import Namespace
from typing import Any

import numpy as np

from common.arguments import fraction, parser, positive, run
from common.costs import cost_since, run_in_own_process
from common.report import print_table, write_summary
from common.variants import by_name, save_pareto, write_rows
from models.apa300ml import PRISMS as PRISM_MESH, axial_stiffness, make_apa300ml
from nassim import (
    FEModel,
    Material,
    NearestTo,
    ReducedBody,
    RemotePoint,
    Solid,
    build_fe_model,
    condense,
    craig_bampton,
    read_solid,
)

PRISMS, TETS, TOLERANCE = "prisms", "tetrahedra", "by tolerance"
Variant = tuple[str, int, float, str]
"""Elements, order, element size [mm] or tolerance [%], coupling."""
MANY_MODES = 30

REFERENCE: list[Variant] = [(PRISMS, order, 5.0, "rbe3") for order in (3, 4, 5)]
VARIANTS: list[Variant] = [
    *((TETS, 1, size, "rbe3") for size in (5.0, 2.0)),
    *((TETS, 2, size, "rbe3") for size in (8.0, 5.0, 2.0)),
    *((TETS, 3, size, "rbe3") for size in (8.0, 5.0, 3.0)),
    *((TETS, 4, size, "rbe3") for size in (8.0, 5.0)),
    *((PRISMS, 2, size, "rbe3") for size in (5.0, 3.0)),
    *((PRISMS, 3, size, "rbe3") for size in (8.0, 5.0, 3.0)),
    (PRISMS, 4, 5.0, "rbe3"),
    (PRISMS, 3, 5.0, "rbe2"),
    (TOLERANCE, 3, 1.0, "rbe3"),
    (TOLERANCE, 3, 0.2, "rbe3"),
]
QUICK_REFERENCE: list[Variant] = [(TETS, 1, 5.0, "rbe3"), (TETS, 2, 5.0, "rbe3")]
QUICK: list[Variant] = [(TETS, 1, 8.0, "rbe3"), (TETS, 2, 8.0, "rbe2")]
ANSWERS = {
    "DoF": "n_dofs",
    **{f"{k + 1} [Hz]": f"clamped_Hz/{k}:.2f" for k in range(5)},
    "stiffness [N/um]": "stiffness_N_per_m*1e-6:.4f",
}
ERRORS = {
    "DoF": "n_dofs",
    **{f"{kind} [%]": f"{kind}_error*100:.3f" for kind in ("clamped", "free", "stiffness")},
    "time [s]": "time_s:.1f",
    "memory [GB]": "memory_B*1e-9:.2f",
    "estimate [%]": "estimate*100:.3f",
}
TRUNCATION = {
    "coordinates": "n_coordinates",
    "clamped [%]": "clamped*100:.5f",
    "estimate": "clamped_estimate*100:.5f",
    "free [%]": "free*100:.5f",
    "its estimate": "free_estimate*100:.5f",
}
arguments = parser(__doc__, "speed_vs_error")
arguments.add_argument("--quick", action="store_true", help="few coarse variants, for a quick look at the report")
arguments.add_argument("--cad", metavar="FILE", help="STEP, IGES or BREP file in place of the APA300ML")
arguments.add_argument(
    "--point", action="append", default=[], metavar="X,Y,Z", help="with --cad: position of a remote point [mm]"
)
arguments.add_argument(
    "--young-modulus", type=positive, default=200.0, help="with --cad: Young's modulus [GPa] (default: 200)"
)
arguments.add_argument("--poisson-ratio", type=fraction, default=0.3, help="with --cad: Poisson's ratio (default: 0.3)")
arguments.add_argument("--density", type=positive, default=7800.0, help="with --cad: density [kg/m3] (default: 7800)")
arguments.add_argument(
    "--child", nargs=4, metavar=("KIND", "ORDER", "SIZE", "COUPLING"), help="for the script's own use"
)


def described(variant: Variant) -> dict[str, Any]:
    """Return a variant with its name as a row of a table."""
    kind, order, size, coupling = variant
    name = f"{size:g} % {kind}" if kind == TOLERANCE else f"{size:g} mm {kind}, order {order}"
    return {"name": f"{name}, {coupling}", "kind": kind, "order": order, "size_mm": size, "coupling": coupling}


def measure(variant: Variant, args: Namespace) -> dict[str, Any]:
    """Measure time and memory from CAD to a reduced body; add its results without truncation error."""
    start = time.perf_counter()
    fe_model = fe_model_of(variant, args)
    body = craig_bampton(fe_model, discretization=False)
    cost = cost_since(start)
    assert body.enriched is not None
    frequencies = {f"{case}_Hz": first_five(body.enriched, case).tolist() for case in ("clamped", "free")}
    estimate = fe_model.discretization_error if variant[0] == TOLERANCE else None
    stiffness = softest(body) if args.cad else axial_stiffness(body)
    return {"n_dofs": fe_model.n_dofs, "stiffness_N_per_m": stiffness, "estimate": estimate, **frequencies, **cost}


def softest(body: ReducedBody) -> float:
    """Return the smallest stiffness of the last point in any direction, with the first point clamped [N/m]."""
    return float(1 / np.linalg.eigvalsh(body.compliance(fixed=body.point_names[:1])[-6:-3, -6:-3])[-1])


def errors_against(reference: dict[str, Any], row: dict[str, Any]) -> dict[str, Any]:
    """Return relative errors of a variant, one by one, and the largest one of each kind."""
    result = {}
    for key in ("clamped_Hz", "free_Hz", "stiffness_N_per_m"):
        errors = np.abs(np.divide(row[key], reference[key]) - 1)
        case = key.split("_")[0]
        result |= {f"{case}_error": float(errors.max()), f"{case}_errors": errors}
    return result


def compare_modes(variant: Variant, args: Namespace) -> list[dict[str, Any]]:
    """Return truncation errors by number of modes on the mesh of a variant: estimated and true."""
    condensed = condense(fe_model_of(variant, args, progress=False), progress=False)
    rich = craig_bampton(condensed, n_modes=MANY_MODES, discretization=False, progress=False).enriched
    assert rich is not None
    result = []
    for n_modes in (0, 2, 4, 6, 10, 15, 20):
        body = craig_bampton(condensed, n_modes=n_modes, discretization=False, progress=False)
        errors: dict[str, Any] = {"name": f"{n_modes} modes", "n_coordinates": len(body.mass_matrix)}
        for case, fixed in (("clamped", body.point_names[:1]), ("free", ())):
            errors[case] = float(np.max(first_five(body, case) / first_five(rich, case) - 1))
            estimates = body.truncation_errors(fixed=fixed)[: 5 + 6 * (case == "free")]
            errors[f"{case}_estimate"] = float(np.max(estimates))
        result.append(errors)
    return result


def fe_model_of(variant: Variant, args: Namespace, *, progress: bool = True) -> FEModel:
    """Build the FE model of a variant."""
    kind, order, size, coupling = variant
    solid = solid_of(args, coupling)
    if kind == TOLERANCE:
        return build_fe_model(solid, tolerance=0.01 * size, progress=progress)
    mesh = PRISM_MESH if kind == PRISMS else {}
    return build_fe_model(solid, element_size=1e-3 * size, order=order, progress=progress, **mesh)


def solid_of(args: Namespace, coupling: str) -> Solid:
    """Return the actuator, or the solid of a CAD file."""
    if not args.cad:
        return make_apa300ml(coupling=coupling, stack_coupling=coupling)
    material = Material("material", 1e9 * args.young_modulus, args.poisson_ratio, args.density)
    places = {f"point {k}": place_of(text) for k, text in enumerate(args.point, start=1)}
    points = tuple(RemotePoint(name, name, place, coupling) for name, place in places.items())
    faces = {name: NearestTo(place) for name, place in places.items()}
    return read_solid(args.cad, material, faces=faces, remote_points=points)


def place_of(text: str) -> Any:
    """Read a position from an option in millimetres [m].

    Raises:
        ValueError: for anything but three numbers
    """
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        raise ValueError(f"--point must be three numbers, such as --point=0,0,10 [mm], got {text!r}") from None
    return 1e-3 * np.array([x, y, z])


def variants_of(args: Namespace) -> tuple[list[Variant], list[Variant]]:
    """Return the references, of which the last one is the truth, and the variants."""
    if not args.cad:
        return (QUICK_REFERENCE, QUICK) if args.quick else (REFERENCE, VARIANTS)
    length = 1e3 * np.ptp([tuple(corner) for corner in solid_of(args, "rbe3").shape.bounding_box], axis=0).max()
    sizes = [float(f"{length / parts:.2g}") for parts in ((5,) if args.quick else (10, 20))]
    orders, tolerances = ((2,), (10.0,)) if args.quick else ((2, 3, 4), (3.0, 1.0, 0.3))
    uniform = [(TETS, order, size, "rbe3") for order in orders for size in sizes]
    by_tolerance = [(TOLERANCE, orders[0], tolerance, "rbe3") for tolerance in tolerances]
    return [(TOLERANCE, 3, 5.0 if args.quick else 0.1, "rbe3")], uniform + by_tolerance


def first_five(body: ReducedBody, case: str) -> Any:
    """Return the first five elastic eigenfrequencies [Hz], clamped at the first point or free."""
    free = case == "free"
    return body.eigenfrequencies(fixed=() if free else body.point_names[:1])[6 if free else 0 :][:5]


def main() -> None:
    args = arguments.parse_args()
    if args.cad and len(args.point) < 2:
        arguments.error("--cad needs two --point=X,Y,Z or more")
    if args.child:
        kind, order, size, coupling = args.child
        print("\n" + json.dumps(measure((kind, int(order), float(size), coupling), args)))
        return
    references, variants = variants_of(args)
    reference = [measured(variant) for variant in references]
    rows = [measured(variant) for variant in variants]
    rows = [row | errors_against(reference[-1], row) for row in rows]
    summary = {"reference": reference, "variants": rows, "modes": compare_modes(references[0], args)}

    print_table("convergence of the reference, clamped", by_name(reference), ANSWERS)
    print_table("largest error of five frequencies", by_name(rows), ERRORS)
    print_table("modes kept: largest truncation error of five frequencies", by_name(summary["modes"]), TRUNCATION)
    columns = ["name", "n_dofs", "clamped_error", "free_error", "stiffness_error", "time_s", "memory_B"]
    write_rows(args.output / "variants.csv", rows, columns)
    if not args.no_plot:
        save_pareto(
            args.output / "pareto.png",
            [row for row in rows if row["coupling"] == "rbe3"],
            ("time, mesh included [s]", "largest error of five clamped eigenfrequencies [-]"),
            line=lambda row: row["kind"] if row["kind"] == TOLERANCE else f"{row['kind']}, order {row['order']}",
            point=lambda row: (
                row["time_s"],
                row["clamped_error"],
                f"{row['size_mm']:g} {'%' if row['kind'] == TOLERANCE else 'mm'}",
            ),
        )
    write_summary(args.output, summary)


def measured(variant: Variant) -> dict[str, Any]:
    """Measure a variant in its own process, with the same options."""
    options = [word for word in sys.argv[1:] if word not in ("--quick", "--no-plot")]
    return described(variant) | run_in_own_process(__file__, *variant, *options)


if __name__ == "__main__":
    run(main)
