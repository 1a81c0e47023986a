"""Speed against error of reductions: which elements, how many modes and which coupling pay.

Every variant runs in a process of its own. Errors are those of the first five eigenfrequencies, clamped at the bottom
and free, and of the axial stiffness, against the finest variant, whose own convergence stands above the table; they
hold no error of truncation. The errors by number of modes kept are those of truncation alone.
"""

import csv
import json
import time
from typing import Any

import numpy as np
from _common import parser, peak_memory, run, run_in_own_process, write_summary

from models.apa300ml import PRISMS as PRISM_MESH
from models.apa300ml import make_apa300ml
from nassim import ReducedBody, build_fe_model, condense, craig_bampton
from nassim.plotting import plot_pareto, save_figure

PRISMS, TETS = "prisms", "tetrahedra"
Variant = tuple[str, int, float, str]  # elements, order, element size [mm], coupling
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
QUICK_REFERENCE: list[Variant] = [(TETS, 2, 5.0, "rbe3"), (TETS, 3, 5.0, "rbe3")]
QUICK: list[Variant] = [(TETS, 1, 5.0, "rbe3"), (TETS, 2, 8.0, "rbe3"), (TETS, 2, 5.0, "rbe2")]
CASES: dict[str, dict[str, Any]] = {"clamped": {"fixed": ["bottom"]}, "free": {}}
MANY_MODES = 30

arguments = parser(__doc__, "speed_vs_error")
arguments.add_argument("--quick", action="store_true", help="few coarse variants, to see the report's form")
arguments.add_argument(
    "--child", nargs=4, metavar=("KIND", "ORDER", "SIZE", "COUPLING"), help="for the script's own use"
)


def main() -> None:
    args = arguments.parse_args()
    if args.child:
        kind, order, size, coupling = args.child
        print("\n" + json.dumps(measure((kind, int(order), float(size), coupling))))
        return
    reference = [in_own_process(variant) for variant in (QUICK_REFERENCE if args.quick else REFERENCE)]
    print("convergence of the reference: first five clamped eigenfrequencies [Hz], axial stiffness [N/um]")
    for row in reference:
        values = " ".join(f"{f:8.2f}" for f in row["clamped_Hz"])
        print(f"  {row['name']:<32}{row['n_dofs']:7d} DoF {values} {1e-6 * row['stiffness_N_per_m']:8.4f}")

    print("\nlargest error of five frequencies           DoF   clamped      free stiffness  time [s]  memory [GB]")
    rows = []
    for variant in QUICK if args.quick else VARIANTS:
        row = in_own_process(variant)
        for key in ("clamped_Hz", "free_Hz", "stiffness_N_per_m"):
            errors = np.abs(np.divide(row[key], reference[-1][key]) - 1)
            case = key.split("_")[0]
            row |= {f"{case}_error": float(errors.max()), f"{case}_errors": errors}
        print(
            f"  {row['name']:<32}{row['n_dofs']:13d} "
            + " ".join(f"{100 * row[key + '_error']:7.3f} %" for key in ("clamped", "free", "stiffness"))
            + f" {row['time_s']:8.1f} {1e-9 * row['memory_B']:12.2f}",
            flush=True,
        )
        rows.append(row)

    print("\nmodes kept: largest truncation error of five frequencies, true and (estimated)")
    modes = compare_modes(reference[0])
    for row in modes:
        cases = "   ".join(f"{c} {100 * row[c]:9.5f} % ({100 * row[c + '_estimate']:9.5f} %)" for c in CASES)
        print(f"  {row['name']:>8}, {row['n_coordinates']:3d} coordinates   {cases}")

    args.output.mkdir(parents=True, exist_ok=True)
    with (args.output / "variants.csv").open("w", newline="", encoding="utf-8") as file:
        columns = ["name", "n_dofs", "clamped_error", "free_error", "stiffness_error", "time_s", "memory_B"]
        writer = csv.DictWriter(file, columns, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    if not args.no_plot:
        lines: dict[str, list[tuple[float, float, str]]] = {}
        for row in rows:
            if row["coupling"] == "rbe3":
                point = (row["time_s"], row["clamped_error"], f"{row['size_mm']:g} mm")
                lines.setdefault(f"{row['kind']}, order {row['order']}", []).append(point)
        ax = plot_pareto(lines, "time, mesh included [s]", "largest error of five clamped eigenfrequencies [-]")
        save_figure(ax, args.output / "pareto.png")
    write_summary(args.output, {"reference": reference, "variants": rows, "modes": modes})


def in_own_process(variant: Variant) -> dict[str, Any]:
    kind, order, size, coupling = variant
    name = f"{size:g} mm {kind}, order {order}, {coupling}"
    described = {"name": name, "kind": kind, "order": order, "size_mm": size, "coupling": coupling}
    return described | run_in_own_process(__file__, "--child", *variant)


def measure(variant: Variant) -> dict[str, Any]:
    """Time and memory from CAD to 36 coordinates; then the answers, without the error of truncation."""
    kind, order, size, coupling = variant
    start = time.perf_counter()
    solid = make_apa300ml(coupling=coupling, stack_coupling=coupling)
    mesh = PRISM_MESH if kind == PRISMS else {}
    fe_model = build_fe_model(solid, element_size=1e-3 * size, order=order, **mesh)
    body = craig_bampton(fe_model)
    cost = {"time_s": time.perf_counter() - start, "memory_B": peak_memory()}
    assert body.enriched is not None
    top = body.coordinate_names.index("top.uz")
    frequencies = {f"{case}_Hz": first_five(body.enriched, case).tolist() for case in CASES}
    stiffness = 1.0 / body.compliance(fixed=["bottom"])[top, top]
    return {"n_dofs": fe_model.n_dofs, "stiffness_N_per_m": stiffness, **frequencies, **cost}


def compare_modes(row: dict[str, Any]) -> list[dict[str, Any]]:
    """Truncation errors by number of modes on the mesh of a reference: as each body estimates them, and true."""
    mesh = PRISM_MESH if row["kind"] == PRISMS else {}
    solid = make_apa300ml(coupling=row["coupling"], stack_coupling=row["coupling"])
    model = build_fe_model(solid, element_size=1e-3 * row["size_mm"], order=row["order"], progress=False, **mesh)
    condensed = condense(model, progress=False)
    rich = craig_bampton(condensed, n_modes=MANY_MODES, progress=False).enriched
    assert rich is not None
    result = []
    for n_modes in (0, 2, 4, 6, 10, 15, 20):
        body = craig_bampton(condensed, n_modes=n_modes, progress=False)
        errors: dict[str, Any] = {"name": f"{n_modes} modes", "n_coordinates": len(body.mass_matrix)}
        for case, conditions in CASES.items():
            errors[case] = float(np.max(first_five(body, case) / first_five(rich, case) - 1))
            errors[f"{case}_estimate"] = float(np.max(body.truncation_errors(**conditions)[: 5 + 6 * (case == "free")]))
        result.append(errors)
    return result


def first_five(body: ReducedBody, case: str) -> Any:
    """The first five elastic eigenfrequencies [Hz]."""
    return body.eigenfrequencies(**CASES[case])[6 if case == "free" else 0 :][:5]


if __name__ == "__main__":
    run(main)
