"""Speed against error of reductions: which elements, how many modes and which coupling pay.

Every variant runs in a process of its own. Errors are those of the first five eigenfrequencies, clamped at the bottom
and free, and of the axial stiffness, against the finest variant, whose own convergence stands above the table; they
hold no error of truncation. The errors by number of modes kept are those of truncation alone.
"""

import json
import time
from typing import Any

import numpy as np

from common.arguments import parser, run
from common.costs import cost_since, run_in_own_process
from common.report import print_table, write_summary
from common.variants import by_name, save_pareto, write_rows
from models.apa300ml import PRISMS as PRISM_MESH, axial_stiffness, make_apa300ml
from nassim import FEModel, ReducedBody, build_fe_model, condense, craig_bampton

PRISMS, TETS = "prisms", "tetrahedra"
Variant = tuple[str, int, float, str]
"""Elements, order, element size [mm], coupling."""
CASES: dict[str, dict[str, Any]] = {"clamped": {"fixed": ["bottom"]}, "free": {}}
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
}
TRUNCATION = {
    "coordinates": "n_coordinates",
    "clamped [%]": "clamped*100:.5f",
    "estimate": "clamped_estimate*100:.5f",
    "free [%]": "free*100:.5f",
    "its estimate": "free_estimate*100:.5f",
}
arguments = parser(__doc__, "speed_vs_error")
arguments.add_argument("--quick", action="store_true", help="few coarse variants, to see the report's form")
arguments.add_argument(
    "--child", nargs=4, metavar=("KIND", "ORDER", "SIZE", "COUPLING"), help="for the script's own use"
)


def described(variant: Variant) -> dict[str, Any]:
    """A variant with its name as a row of a table."""
    kind, order, size, coupling = variant
    name = f"{size:g} mm {kind}, order {order}, {coupling}"
    return {"name": name, "kind": kind, "order": order, "size_mm": size, "coupling": coupling}


def measure(variant: Variant) -> dict[str, Any]:
    """Time and memory from CAD to 36 coordinates; then the answers, without the error of truncation."""
    start = time.perf_counter()
    fe_model = fe_model_of(variant)
    body = craig_bampton(fe_model)
    cost = cost_since(start)
    assert body.enriched is not None
    frequencies = {f"{case}_Hz": first_five(body.enriched, case).tolist() for case in CASES}
    return {"n_dofs": fe_model.n_dofs, "stiffness_N_per_m": axial_stiffness(body), **frequencies, **cost}


def errors_against(reference: dict[str, Any], row: dict[str, Any]) -> dict[str, Any]:
    """Relative errors of a variant's answers, each and the largest of a kind."""
    result = {}
    for key in ("clamped_Hz", "free_Hz", "stiffness_N_per_m"):
        errors = np.abs(np.divide(row[key], reference[key]) - 1)
        case = key.split("_")[0]
        result |= {f"{case}_error": float(errors.max()), f"{case}_errors": errors}
    return result


def compare_modes(variant: Variant) -> list[dict[str, Any]]:
    """Truncation errors by number of modes on the mesh of a variant: as each body estimates them, and true."""
    condensed = condense(fe_model_of(variant, progress=False), progress=False)
    rich = craig_bampton(condensed, n_modes=MANY_MODES, discretization=False, progress=False).enriched
    assert rich is not None
    result = []
    for n_modes in (0, 2, 4, 6, 10, 15, 20):
        body = craig_bampton(condensed, n_modes=n_modes, discretization=False, progress=False)
        errors: dict[str, Any] = {"name": f"{n_modes} modes", "n_coordinates": len(body.mass_matrix)}
        for case, conditions in CASES.items():
            errors[case] = float(np.max(first_five(body, case) / first_five(rich, case) - 1))
            errors[f"{case}_estimate"] = float(np.max(body.truncation_errors(**conditions)[: 5 + 6 * (case == "free")]))
        result.append(errors)
    return result


def fe_model_of(variant: Variant, *, progress: bool = True) -> FEModel:
    """The FE model of a variant."""
    kind, order, size, coupling = variant
    solid = make_apa300ml(coupling=coupling, stack_coupling=coupling)
    mesh = PRISM_MESH if kind == PRISMS else {}
    return build_fe_model(solid, element_size=1e-3 * size, order=order, progress=progress, **mesh)


def first_five(body: ReducedBody, case: str) -> Any:
    """The first five elastic eigenfrequencies [Hz]."""
    return body.eigenfrequencies(**CASES[case])[6 if case == "free" else 0 :][:5]


def main() -> None:
    args = arguments.parse_args()
    if args.child:
        kind, order, size, coupling = args.child
        print("\n" + json.dumps(measure((kind, int(order), float(size), coupling))))
        return
    references, variants = (QUICK_REFERENCE, QUICK) if args.quick else (REFERENCE, VARIANTS)
    reference = [described(variant) | run_in_own_process(__file__, *variant) for variant in references]
    rows = [described(variant) | run_in_own_process(__file__, *variant) for variant in variants]
    rows = [row | errors_against(reference[-1], row) for row in rows]
    summary = {"reference": reference, "variants": rows, "modes": compare_modes(references[0])}

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
            line=lambda row: f"{row['kind']}, order {row['order']}",
            point=lambda row: (row["time_s"], row["clamped_error"], f"{row['size_mm']:g} mm"),
        )
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
