"""Compare estimated and true discretisation errors on thirteen solids, and what uniform meshes and tolerances cost.

The true error is relative to the reference: the best of all meshes and of a finer one of order 4, which is refined
where its own estimate is largest. The efficiency is the estimate over the true error of a frequency or static stiffness
to which a tolerance applies. It is evaluated where the true error is above 0.05 % and above three times the estimate of
the reference, and where the order of modes is certain.

The APA300ML also has its hand-made mesh of prisms. The time of a mesh is that of the model and of its figures.

The gain of a mesh by tolerance is the number of unknowns with which uniform elements would have the same estimate,
over its own. The estimates of uniform elements are taken as a power of their unknowns through both uniform meshes, so
the gain is unknown where one of these estimates is.
"""

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.arguments import parser, positive, run, whole
from common.hard_solids import HARD_SOLIDS
from common.report import print_table, write_summary
from common.variants import by_name
from models.apa300ml import PRISMS, make_apa300ml
from nassim import FEModel, Solid, build_fe_model, condense
from nassim.base import stage
from nassim.bodies.reduced_body import error_text
from nassim.fem.mesh_targets import MeshTargets, find_targets

N_FREQUENCIES = 5
UNIFORM = {"coarse": 200, "finer": 1200}
"""Uniform meshes of order 3, with their approximate number of tetrahedra without thin walls."""
SOLIDS = HARD_SOLIDS | {"apa300ml": make_apa300ml}
HAND_MADE: dict[str, dict[str, Any]] = {"apa300ml": {"hand-made": {"element_size": 5e-3, **PRISMS}}}
COUNTED = 5e-4
FACTOR_ON_REFERENCE = 3.0
REFERENCE_UNKNOWNS = {"neck": 300_000, "frame": 110_000, "apa300ml": 220_000}
"""Largest number of unknowns of references that need more than the others."""
COLUMNS = {
    "unknowns": "n_dofs",
    "gain": "gain",
    "CPU time [s]": "cpu_time_s:.1f",
    "true [%]": "true_error*100:.2f",
    "estimate": "estimate",
    "efficiency": "efficiency",
    "counted": "n_counted",
    "unknown": "n_unknown",
    "reference's unknowns": "reference_n_dofs",
    "reference's own [%]": "reference_estimate*100:.3f",
}
arguments = parser(__doc__, "mesh_accuracy")
arguments.add_argument("--solids", default=",".join(SOLIDS), help="names, separated by commas (default: %(default)s)")
arguments.add_argument(
    "--tolerance", type=positive, default=0.01, help="tolerance of the errors (default: %(default)s)"
)
arguments.add_argument(
    "--reference",
    type=whole(1000),
    default=40_000,
    help="largest number of unknowns of usual references (default: %(default)s)",
)


def measure(solid: Solid, tolerance: float, reference_unknowns: int) -> list[dict[str, Any]]:
    """Measure costs and errors of the meshes of a solid."""
    fine = build_fe_model(
        solid, tolerance=tolerance / 20, n=N_FREQUENCIES, order=4, max_unknowns=reference_unknowns, progress=False
    )
    volume = sum(body.mass for body in solid.shape.solids)
    options: dict[str, dict[str, Any]] = {
        name: {"element_size": (6 * volume / count) ** (1 / 3)} for name, count in UNIFORM.items()
    }
    options |= HAND_MADE.get(solid.name, {})
    options["by tolerance"] = {"tolerance": tolerance, "n": N_FREQUENCIES}
    rows, unknowns, answers = [], [fine.n_dofs], [targets(fine)]
    for name, choice in options.items():
        start = time.process_time()
        model = build_fe_model(solid, progress=False, **choice)
        made = time.process_time()
        answers.append(targets(model))
        end = made if "tolerance" in choice else time.process_time()
        unknowns.append(model.n_dofs)
        cost = {"n_dofs": model.n_dofs, "order": model.order, "cpu_time_s": end - start}
        rows.append({"name": f"{solid.name}, {name}", **cost, "gain": "-"})
    best = int(np.argmin([found.errors().max() for found in answers]))
    reference = {"reference_n_dofs": unknowns[best]}
    rows = [row | reference | compare(found, answers[best]) for row, found in zip(rows, answers[1:], strict=True)]
    errors = [float(found.errors()[in_order(found)].max()) for found in answers]
    ratio = gain(*([values[1], values[2], values[-1]] for values in (unknowns, errors)))
    return [*rows[:-1], rows[-1] | {"gain": f"{ratio:.1f}" if np.isfinite(ratio) else "-"}]


def gain(unknowns: list[int], errors: list[float]) -> float:
    """Return the unknowns of a uniform mesh with the error of the third mesh, over its own; not finite if unknown."""
    if not np.isfinite(errors).all():
        return np.inf
    power = np.log(unknowns[1] / unknowns[0]) / np.log(errors[0] / errors[1])
    return float(unknowns[1] / unknowns[2] * (errors[1] / errors[2]) ** power)


def targets(model: FEModel) -> MeshTargets:
    """Find the values of a model to which a tolerance applies: free, held at each point, and at all points."""
    names = tuple(point.name for point in model.remote_points)
    return find_targets(condense(model, progress=False), N_FREQUENCIES + 3, [(), *((name,) for name in names), names])


def compare(found: MeshTargets, truth: MeshTargets) -> dict[str, Any]:
    """Return the largest errors, true and estimated, and the range of the efficiencies."""
    chosen = in_order(found)
    true, estimate, own = (found.values / truth.values - 1)[chosen], found.errors()[chosen], truth.errors()[chosen]
    counted = (true > COUNTED) & (true > FACTOR_ON_REFERENCE * own) & np.isfinite(estimate)
    efficiency, labels = estimate[counted] / true[counted], np.array(found.labels)[chosen]
    return {
        "true_error": float(true.max()),
        "estimate": error_text(float(estimate.max())),
        "reference_estimate": float(own.max()),
        "efficiency": f"{efficiency.min():.2f} to {efficiency.max():.2f}" if counted.any() else "-",
        "n_counted": int(np.count_nonzero(counted)),
        "n_unknown": int(np.count_nonzero(np.isinf(estimate))),
        "efficiencies": dict(zip(labels[counted].tolist(), efficiency, strict=True)),
        "true_errors": dict(zip(labels.tolist(), true, strict=True)),
    }


def in_order(found: MeshTargets) -> NDArray[np.bool_]:
    """Select stiffnesses, and frequencies that are among the first ones before and after correction by estimates."""
    errors, result = found.errors(), np.ones(len(found.labels), dtype=bool)
    corrected = found.values / (1 + np.where(np.isinf(errors), 0.0, errors))
    for places in found.sequences:
        order = np.argsort(corrected[places], kind="stable")
        result[places] = (order == np.arange(len(order))) & (order < N_FREQUENCIES)
    return result


def main() -> None:
    args = arguments.parse_args()
    rows: list[dict[str, Any]] = []
    for name in args.solids.split(","):
        with stage(name):
            most = max(args.reference, REFERENCE_UNKNOWNS.get(name, 0))
            rows += measure(SOLIDS[name](), args.tolerance, most)
        write_summary(args.output, {"rows": rows})
    print_table("largest errors of frequencies and static stiffnesses", by_name(rows), COLUMNS)


if __name__ == "__main__":
    run(main)
