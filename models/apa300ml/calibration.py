"""What of the APA300ML can be calibrated, and the figures to calibrate it with."""

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from models.apa300ml import (
    PAPER_FREQUENCY_FE,
    PZT_TABLE_1,
    STACK,
    VENDOR_STIFFNESS,
    VENDOR_STROKE,
    APAGeometry,
    make_apa300ml,
)
from nassim import ElectricalPort, FEModel, Solid, build_fe_model, craig_bampton, open_circuit
from nassim.base.checks import known
from nassim.fem import Material, with_materials
from nassim.identification import Parameter

PARAMETERS = {
    p.name: p
    for p in (
        Parameter("pzt_modulus", start=49.5e9, lowest=30e9, highest=80e9),  # Pa
        Parameter("arm_thickness", start=1.40e-3, lowest=1.1e-3, highest=1.8e-3),  # m
        Parameter("pad_fillet", start=0.70e-3, lowest=0.3e-3, highest=0.70e-3),
        Parameter("relief", start=3.5e-3, lowest=2.5e-3, highest=4.4e-3),
    )
}
"""Table 1's modulus and the measured dimensions, with bounds."""
FIGURES = ("axial_stiffness", "frequency_5kg", "blocked_1", "blocked_2", "free_1", "stroke")
PUBLISHED = {"axial_stiffness": VENDOR_STIFFNESS, "frequency_5kg": PAPER_FREQUENCY_FE, "stroke": VENDOR_STROKE}
PORTS = (ElectricalPort("all", ("sensor_stack", "actuator_stack_1", "actuator_stack_2"), STACK),)


CIRCUITS = ("shorted", "open")
"""Electrical state of all stacks that a vendor's stiffness may refer to. Data sheets give the stiffness together with
stroke and blocked force of an actuator on its amplifier, which holds the voltage: as with a short. An open stack is
stiffer by 1 / (1 - k33^2)."""


def variant(values: Mapping[str, float]) -> Solid:
    """The APA300ML with some parameters changed from their start; all three stacks are one electrical port."""
    chosen = {name: p.start for name, p in PARAMETERS.items()} | dict(values)
    geometry = APAGeometry(**{f.name: chosen[f.name] for f in fields(APAGeometry) if f.name in chosen})
    return make_apa300ml(geometry, ceramic=_ceramic(chosen["pzt_modulus"]), ports=PORTS)


def data_sheet_figures(fe_model: FEModel, *, circuit: str = "shorted") -> dict[str, float]:
    """Figures of a variant's FE model that data sheets and papers give [SI units].

    circuit: of all stacks, for stiffness and frequencies, see `CIRCUITS`; the stroke is always driven
    axial_stiffness: of the whole actuator [N/m]; stroke: with all stacks from 0 to their full range [m]
    frequency_5kg: bottom fixed, top guided with 5 kg; blocked_1, blocked_2: bottom clamped; free_1: free [Hz]
    """
    known("circuit", circuit, CIRCUITS)
    body = craig_bampton(fe_model, n_modes=8, remote_points=["bottom", "top"], progress=False)
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
    """The figures as a function of the parameters, on meshes made with the given arguments of `build_fe_model`.

    circuit: see `data_sheet_figures`
    A geometry is meshed once; where only the ceramic changes, its mesh is used again.
    """
    models: dict[tuple[tuple[str, float], ...], FEModel] = {}

    def figures(values: Mapping[str, float]) -> Mapping[str, float]:
        geometry = tuple(sorted((name, value) for name, value in values.items() if name != "pzt_modulus"))
        if geometry not in models:
            models[geometry] = build_fe_model(variant(dict(geometry)), progress=False, **mesh)
        ceramic = _ceramic(values.get("pzt_modulus", PARAMETERS["pzt_modulus"].start))
        stacks = {name: ceramic for name in PORTS[0].bodies}
        return data_sheet_figures(with_materials(models[geometry], stacks), circuit=circuit)

    return figures


def _ceramic(young_modulus: float) -> Material:
    return replace(PZT_TABLE_1, young_modulus=young_modulus)
