"""What a variant of the APA300ML's mesh and reduction costs, and how its answers compare, for speed_vs_error.py."""

import time
from typing import Any

import numpy as np
from _costs import cost_since

from models.apa300ml import PRISMS as PRISM_MESH, axial_stiffness, make_apa300ml
from nassim import FEModel, ReducedBody, build_fe_model, condense, craig_bampton

PRISMS, TETS = "prisms", "tetrahedra"
Variant = tuple[str, int, float, str]
"""Elements, order, element size [mm], coupling."""
CASES: dict[str, dict[str, Any]] = {"clamped": {"fixed": ["bottom"]}, "free": {}}
MANY_MODES = 30


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


def fe_model_of(variant: Variant, *, progress: bool = True) -> FEModel:
    """The FE model of a variant."""
    kind, order, size, coupling = variant
    solid = make_apa300ml(coupling=coupling, stack_coupling=coupling)
    mesh = PRISM_MESH if kind == PRISMS else {}
    return build_fe_model(solid, element_size=1e-3 * size, order=order, progress=progress, **mesh)


def first_five(body: ReducedBody, case: str) -> Any:
    """The first five elastic eigenfrequencies [Hz]."""
    return body.eigenfrequencies(**CASES[case])[6 if case == "free" else 0 :][:5]
