"""Estimated against true discretisation errors on twelve solids, and what a tolerance costs beside uniform meshes.

The true error is that against a much finer mesh, which was refined where its own estimate is largest. It is counted
where it is above five times the reference's own estimate and above 0.05 %. The efficiency is the estimate over the true
error, for each frequency and static stiffness to which a tolerance applies.
"""

import time
from typing import Any

import numpy as np

from common.arguments import parser, positive, run, whole
from common.hard_solids import HARD_SOLIDS
from common.report import print_table, write_summary
from common.variants import by_name
from nassim import FEModel, Solid, build_fe_model, condense
from nassim.base import stage
from nassim.fem.accuracy import Targets, find_targets

N_FREQUENCIES = 5
UNIFORM = {"uniform, 1/10 of the length": 10, "uniform, 1/20 of the length": 20}
COUNTED = 5e-4
FACTOR_ON_REFERENCE = 5.0
COLUMNS = {
    "unknowns": "n_dofs",
    "CPU time [s]": "cpu_time_s:.1f",
    "true [%]": "true_error*100:.2f",
    "estimate [%]": "estimate*100:.2f",
    "efficiency from": "efficiency_min:.2f",
    "to": "efficiency_max:.2f",
    "reference's own [%]": "reference_estimate*100:.3f",
}
arguments = parser(__doc__, "mesh_accuracy")
arguments.add_argument("--solids", default=",".join(HARD_SOLIDS), help="names with commas between: %(default)s")
arguments.add_argument(
    "--tolerance", type=positive, default=0.01, help="tolerance of the errors (default: %(default)s)"
)
arguments.add_argument(
    "--reference", type=whole(1000), default=100_000, help="most unknowns of a reference (default: %(default)s)"
)


def measure(solid: Solid, tolerance: float, reference_unknowns: int) -> list[dict[str, Any]]:
    """Costs and errors of the meshes of a solid."""
    fine = build_fe_model(
        solid, tolerance=tolerance / 50, n=N_FREQUENCIES, order=4, max_unknowns=reference_unknowns, progress=False
    )
    truth = targets(fine)
    corners = np.array([tuple(corner) for corner in solid.shape.bounding_box])
    length = float(np.ptp(corners, axis=0).max())
    options: dict[str, dict[str, Any]] = {name: {"element_size": length / parts} for name, parts in UNIFORM.items()}
    options[f"tolerance {100 * tolerance:g} %"] = {"tolerance": tolerance, "n": N_FREQUENCIES}
    rows = []
    for name, choice in options.items():
        start = time.process_time()
        model = build_fe_model(solid, progress=False, **choice)
        found = targets(model)
        cost = {"n_dofs": model.n_dofs, "order": model.order, "cpu_time_s": time.process_time() - start}
        rows.append({"name": f"{solid.name}: {name}", **cost, **compare(found, truth)})
        if model.n_dofs > reference_unknowns:
            break
    return rows


def targets(model: FEModel) -> Targets:
    """What a tolerance applies to, of a model: free, held at one point and at both."""
    names = tuple(point.name for point in model.remote_points)
    return find_targets(condense(model, progress=False), N_FREQUENCIES, [(), *((name,) for name in names), names])


def compare(found: Targets, truth: Targets) -> dict[str, Any]:
    """The largest errors, true and estimated, and the range of the efficiencies; an unknown error is None."""
    true, estimate, own = found.values / truth.values - 1, found.errors(), truth.errors()
    counted = (true > COUNTED) & (true > FACTOR_ON_REFERENCE * own) & np.isfinite(estimate)
    efficiency = estimate[counted] / true[counted]
    result = {
        "true_error": float(true.max()),
        "estimate": float(estimate.max()),
        "reference_estimate": float(own.max()),
        "efficiency_min": float(efficiency.min()) if counted.any() else None,
        "efficiency_max": float(efficiency.max()) if counted.any() else None,
        "counted": int(np.count_nonzero(counted)),
        "unknown": int(np.count_nonzero(np.isinf(estimate))),
        "largest_called_known": float(np.max(true[np.isfinite(estimate)], initial=0.0)),
        "smallest_called_unknown": float(np.min(true[np.isinf(estimate)])) if np.isinf(estimate).any() else None,
    }
    return result


def main() -> None:
    args = arguments.parse_args()
    rows: list[dict[str, Any]] = []
    for name in args.solids.split(","):
        with stage(name):
            rows += measure(HARD_SOLIDS[name](), args.tolerance, args.reference)
        write_summary(args.output, {"rows": rows})
    print_table("largest errors of frequencies and static stiffnesses", by_name(rows), COLUMNS)


if __name__ == "__main__":
    run(main)
