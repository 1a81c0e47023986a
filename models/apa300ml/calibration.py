"""Calibration of the APA300ML: parameters, reference values and the fit."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from inspect import signature
from typing import Any

import numpy as np

from nassim import ElectricalPort, FEModel, Solid, build_fe_model, craig_bampton, open_circuit
from nassim.base import stage, write_atomically
from nassim.base.checks import known
from nassim.fem import Material, replace_materials
from nassim.identification import Parameter, Target, at_bounds, calibrate, check_determined, sensitivities

from . import (
    CALIBRATION,
    PAPER_FREQUENCY_FE,
    PRISMS,
    PZT_TABLE_1,
    STACK,
    VENDOR_STIFFNESS,
    VENDOR_STROKE,
    APAGeometry,
    make_apa300ml,
)

PARAMETERS = {
    p.name: p
    for p in (
        Parameter("pzt_modulus", start=49.5e9, lowest=30e9, highest=80e9),  # Pa
        Parameter("arm_thickness", start=1.40e-3, lowest=1.1e-3, highest=1.8e-3),  # m
        Parameter("pad_fillet", start=0.70e-3, lowest=0.3e-3, highest=0.70e-3),
        Parameter("relief", start=3.5e-3, lowest=2.5e-3, highest=4.4e-3),
    )
}
"""Modulus of table 1 and the measured dimensions, with bounds."""
FIGURES = ("axial_stiffness", "frequency_5kg", "blocked_1", "blocked_2", "free_1", "stroke")
PUBLISHED = {"axial_stiffness": VENDOR_STIFFNESS, "frequency_5kg": PAPER_FREQUENCY_FE, "stroke": VENDOR_STROKE}
PORTS = (ElectricalPort("all", ("sensor_stack", "actuator_stack_1", "actuator_stack_2"), STACK),)


CIRCUITS = ("shorted", "open")
"""Electrical state of all stacks to which a vendor's stiffness may refer.

Data sheets give the stiffness together with stroke and blocked force of an actuator on its amplifier. The amplifier
holds the voltage, which is equivalent to a short. An open stack is stiffer by 1 / (1 - k33^2).
"""


def variant(values: Mapping[str, float]) -> Solid:
    """Make the APA300ML with some parameters changed from their start and all three stacks as one electrical port."""
    chosen = {name: p.start for name, p in PARAMETERS.items()} | dict(values)
    geometry = APAGeometry(**{f.name: chosen[f.name] for f in fields(APAGeometry) if f.name in chosen})
    return make_apa300ml(geometry, ceramic=_ceramic(chosen["pzt_modulus"]), ports=PORTS)


def data_sheet_figures(fe_model: FEModel, *, circuit: str = "shorted") -> dict[str, float]:
    """Compute values of a variant's FE model that data sheets and papers give [SI units].

    Args:
        fe_model: FE model of a variant
        circuit: electrical state of all stacks for stiffness and frequencies, see `CIRCUITS`; the stroke is always that
            of a driven actuator

    Returns:
        "axial_stiffness" of the whole actuator [N/m]; "stroke" with all stacks from 0 to their full range [m];
        "frequency_5kg" with bottom fixed and top guided with 5 kg, "blocked_1" and "blocked_2" with bottom clamped, and
        "free_1" without supports [Hz].
    """
    known("circuit", circuit, CIRCUITS)
    body = craig_bampton(fe_model, n_modes=8, remote_points=["bottom", "top"], discretization=False, progress=False)
    free = np.arange(6, len(body.mass_matrix))
    forces = body.port("all").forces[free] * STACK.voltage_range
    motion = np.linalg.solve(body.stiffness_matrix[np.ix_(free, free)], forces)
    if circuit == "open":
        body = open_circuit(body, {"all": 0.0})
    compliance = body.compliance(fixed=["bottom"])
    blocked = body.eigenfrequencies(fixed=["bottom"])
    return {
        "axial_stiffness": float(1 / compliance[8, 8]),
        "stroke": float(abs(motion[2])),
        "frequency_5kg": float(body.eigenfrequencies(fixed=["bottom"], guided={"top": "z"}, masses={"top": 5.0})[0]),
        "blocked_1": float(blocked[0]),
        "blocked_2": float(blocked[1]),
        "free_1": float(body.eigenfrequencies()[6]),
        "mass": body.mass,
    }


def make_model(*, circuit: str = "shorted", **mesh: Any) -> Callable[[Mapping[str, float]], Mapping[str, float]]:
    """Return the values of `data_sheet_figures` as a function of the parameters.

    A geometry is meshed once. If only the ceramic changes, its mesh is used again.

    Args:
        circuit: see `data_sheet_figures`
        **mesh: arguments of `build_fe_model`
    """
    signature(build_fe_model).bind_partial(**mesh)  # a misspelt name is told before the geometry is made
    models: dict[tuple[tuple[str, float], ...], FEModel] = {}

    def figures(values: Mapping[str, float]) -> Mapping[str, float]:
        geometry = tuple(sorted((name, value) for name, value in values.items() if name != "pzt_modulus"))
        if geometry not in models:
            models[geometry] = build_fe_model(variant(dict(geometry)), progress=False, **mesh)
        ceramic = _ceramic(values.get("pzt_modulus", PARAMETERS["pzt_modulus"].start))
        stacks = {name: ceramic for name in PORTS[0].bodies}
        return data_sheet_figures(replace_materials(models[geometry], stacks), circuit=circuit)

    return figures


def fit(
    names: Sequence[str],
    targets: Sequence[Target],
    *,
    circuit: str = "shorted",
    element_size: float = 5e-3,
    order: int = 3,
    coarse_size: float = 5e-3,
) -> dict[str, Any]:
    """Fit parameters to targets on a fine mesh, with sensitivities from a coarse one.

    Args:
        names: names of the fitted `PARAMETERS`; the others keep their start value
        targets: targets for values of `FIGURES`
        circuit: electrical state of the targets, see `data_sheet_figures`
        element_size: element size of the fine mesh, with prisms where possible [m]
        order: order of the fine elements
        coarse_size: element size of the coarse mesh, of order 2 [m]

    Returns:
        Record of the fit. It includes the change of the fit if the other parameters were at their bounds (fitted again
        on the coarse mesh).

    Raises:
        ValueError: if the targets do not determine the parameters
    """
    chosen = [PARAMETERS[name] for name in names]
    others = [parameter for parameter in PARAMETERS.values() if parameter not in chosen]
    coarse = make_model(circuit=circuit, element_size=coarse_size, order=2)
    with stage("sensitivities", total=2 * len(PARAMETERS), unit="evaluations") as advance:
        table = sensitivities(coarse, list(PARAMETERS.values()), FIGURES, advance=advance)
    columns = [list(PARAMETERS).index(name) for name in names]
    sensitivity = table[np.ix_([FIGURES.index(target.name) for target in targets], columns)]
    check_determined(chosen, targets, sensitivity, largest_deviation=0.1)
    kinds = PRISMS if "arm_thickness" not in names else {}
    fine = make_model(circuit=circuit, element_size=element_size, order=order, **kinds)
    fixed = {parameter.name: parameter.start for parameter in others}
    with stage("fit on the fine mesh"):
        result = calibrate(lambda values: fine(fixed | dict(values)), chosen, targets, sensitivity=sensitivity)
    with stage("fits with others at their bounds", total=2 * len(others), unit="fits") as advance:
        moved = at_bounds(coarse, chosen, others, targets, sensitivity=sensitivity, advance=advance)
    return {
        "parameters": fixed | dict(result.values),
        "relative_deviations": dict(result.deviations),
        "targets": {target.name: target.value for target in targets},
        "target_tolerance": targets[0].tolerance,
        "circuit": circuit,
        "relative_changes_with_others_at_their_bounds": {
            "command": "python scripts/calibrate_apa.py",
            **{other.name: {"bounds": [other.lowest, other.highest], **moved[other.name]} for other in others},
        },
        "figures": dict(result.figures),
        "mesh": f"{1e3 * element_size:g} mm, order {order}, {'prisms' if kinds else 'tetrahedra'}",
        "sensitivities": {
            name: dict(zip(PARAMETERS, row, strict=True)) for name, row in zip(FIGURES, table.tolist(), strict=True)
        },
    }


def figures_with_5kg(figures: Mapping[str, float]) -> dict[str, float]:
    """Return the moving mass with 5 kg from stiffness and frequency, and the stiffness for the paper's frequency."""
    moving = figures["axial_stiffness"] / (2 * np.pi * figures["frequency_5kg"]) ** 2
    implied = (2 * np.pi * PAPER_FREQUENCY_FE) ** 2 * moving
    return {
        "moving_mass_kg": moving,
        "stiffness_of_the_papers_frequency_N_per_m": implied,
        "stiffness_of_the_papers_frequency_over_vendors_percent": 100 * (implied / VENDOR_STIFFNESS - 1),
    }


def make_default(record: Mapping[str, Any]) -> None:
    """Make a fit the default of the model: its record, with at least "parameters", is written to `CALIBRATION`."""
    with write_atomically(CALIBRATION) as temporary:
        temporary.write_text(json.dumps(record, indent=2) + "\n")


def _ceramic(young_modulus: float) -> Material:
    return replace(PZT_TABLE_1, young_modulus=young_modulus)
